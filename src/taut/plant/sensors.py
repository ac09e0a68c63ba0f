"""Sensors of a plant: pure functions with parameters, from what is true to what is read."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import reduce
from typing import Any, ClassVar, Final, Literal

import numpy as np

from taut.arm.description import Arm, Payload
from taut.base.errors import ShapeError, UsageError
from taut.base.fields import Choice, Declared, Field, Part, Plain
from taut.base.paths import subtree
from taut.base.types import Array, Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues
from taut.maths.snapshot import measurement_shapes
from taut.maths.wrist import load_wrench, sensor_place
from taut.trace import math as tm

Values = Mapping[str, Any]
TURN: Final = 2.0 * np.pi  # [rad] the largest step of an encoder: 4096 counts are no resolution of 4096 rad
NO_STEPS: Final = "leave it out where there are no steps"
NO_END: Final = "leave it out for a sensor without end"
FORCE_AND_MOMENT: Final = "N, N m"
Side = Literal["link", "motor"]


class Sensor(Declared):
    """Base of sensors, and of your own: declared fields, and one pure function.

    Your own one stands in the place of that which gives the same measurement: `Sensors(position=...)`. Each `Field`
    is a parameter of the plant by its path, sensors.position.NAME. A field that is called `noise` makes the run draw
    standard normal numbers for it in every tick, from the run's seed.

    Example:
        >>> import taut
        >>> import taut.math as tm
        >>> class Resolver(taut.sensors.Sensor):
        ...     ripple: taut.sensors.Field = taut.sensors.Field(unit="rad", shape="n", minimum=0.0)
        ...
        ...     def read(self, model, true, p, noise):
        ...         return true["q"] + p["ripple"] * tm.sin(2.0 * true["q"])
        >>> sensors = taut.sensors.Sensors(position=Resolver(ripple=1e-3))
        >>> float(taut.RigidPlant(taut.load_arm("one_joint"), sensors=sensors).parameters["sensors.position.ripple"])
        0.001
    """

    needs_acceleration: ClassVar[bool] = False
    """Whether `read` looks at true["a"], the joints' acceleration in the last step."""

    def read(self, model: Model, true: Values, p: Values, noise: Array | None) -> Any:
        """The reading; of a sensor with a range a pair: the reading, and 1.0 in a tick in which it is cut, else 0.0.

        Args:
            model: The constants of the true arm, for `taut.dynamics`.
            true: What is true, by name: q, v, tau (of the motors), tau_link, F_ext where something touches the tool,
                q_motor and v_motor where they differ from the link's.
            p: Current values of the fields by name.
            noise: Standard normal numbers, one for each entry; None without a field `noise`.
        """
        raise NotImplementedError

    @property
    def ideal(self) -> bool:
        """Whether it reads the truth at the link."""
        return False


class FaultySensor(Sensor):
    """Base of the sensors that come with taut, which are ideal where no fault is given."""

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name: those that change the reading."""
        own = Declared.parameters(self)
        return {name: x for name, x in own.items() if "." in name or np.any(np.isfinite(x) & (x != 0.0))}

    @property
    def ideal(self) -> bool:
        """Whether it reads the truth at the link."""
        return not self.parameters()

    @staticmethod
    def faulty(x: Array, p: Values, noise: Array | None) -> Array:
        """A quantity with a constant error, noise, and then steps, where they are there."""
        for constant in ("offset", "bias"):
            if constant in p:
                x = x + p[constant]
        if noise is not None:
            x = x + p["noise"] * noise
        return quantised(x, p["resolution"]) if "resolution" in p else x


def quantised(x: Array, step: Array) -> Array:
    """The nearest whole number of steps; an entry whose step is zero has none."""
    some = tm.where(step > 0.0, step, 1.0)
    steps: Array = tm.where(step > 0.0, some * tm.floor(x / some + 0.5), x)
    return steps


def saturated(x: Array, limit: Array) -> tuple[Array, Any]:
    """x cut at +-limit, and 1.0 where that took something from any entry, else 0.0."""
    bound = limit + np.zeros(len(x)) if np.ndim(limit) == 0 else limit
    over = tm.abs(x) - bound
    return tm.clip(x, -bound, bound), tm.where(reduce(tm.maximum, over) > 0.0, 1.0, 0.0)


class ShaftSensor(FaultySensor):
    """Base of sensors of the joints' motion, at the link or on the motor's shaft behind the gear."""

    quantity: ClassVar[str]

    side: Choice[Side | None] = Choice("link", "motor", optional=True)

    @property
    def ideal(self) -> bool:
        """Whether it reads the truth at the link."""
        return self.side != "motor" and not self.parameters()

    def read(self, model: Model, true: Values, p: Values, noise: Array | None) -> Array:
        """(n,) in joint units, with the faults of a sensor on the link or on the motor's shaft."""
        x: Array = true[self.quantity]
        if self.side != "motor":
            return self.faulty(x, p, noise)
        x = true.get(f"{self.quantity}_motor", x)  # of rigid transmissions the same
        if not p:
            return x
        gear = model.arm.gear
        seen: Array = self.faulty(gear * x, p, noise) / gear
        return seen


class Encoder(ShaftSensor):
    """A position sensor of every joint. An encoder has steps; a potentiometer or a resolver has noise instead.

    Model:
        reading = resolution round((shaft + offset + noise) / resolution), with standard normal noise in every tick
        The shaft is the link, or the motor behind a gear: then the numbers are those of the motor's shaft, and the
        joint sees each of them divided by the gear ratio, `arm.gear`. Either way the reading is in joint units.

    The noise is white, with one standard deviation at every rate, so that its density grows as the rate falls.

    Args:
        resolution: (n,) or scalar, the step [rad | m at the link, rad at the motor]; None for none, and among
            several 0 for joints without steps. N counts in a turn are steps of 2*pi/N.
        offset: (n,) or scalar, what it reads at zero [the same].
        noise: (n,) or scalar, standard deviation [the same].
        side: "link" or "motor"; by default the link, and the motor where it is `Sensors(motor=...)`.

    Raises:
        RangeError: A resolution of zero or below or of more than a turn, negative noise, NaN.

    Example:
        >>> Encoder(resolution=2e-5).resolution.tolist()
        2e-05

    References:
        Chapter, section 10.1 control system overview.
    """

    quantity = "q"

    resolution: Field = Field(
        unit="rad | m", shape="n", above=0.0, maximum=TURN, zero_for_none=True, optional=True, hint=NO_STEPS
    )
    offset: Field = Field(0.0, unit="rad | m", shape="n")
    noise: Field = Field(0.0, unit="rad | m", shape="n", minimum=0.0)


class Tachometer(ShaftSensor):
    """A velocity sensor of every joint.

    Model:
        reading = shaft + offset + noise, with standard normal noise in every tick; the shaft is that of the link, or
        of the motor behind a gear, as for `Encoder`

    Args:
        offset: (n,) or scalar, what it reads at rest [rad/s | m/s at the link, rad/s at the motor].
        noise: (n,) or scalar, standard deviation [the same].
        side: "link" or "motor"; by default the link, and the motor where it is `Sensors(motor_velocity=...)`.

    Raises:
        RangeError: Negative noise, NaN.
    """

    quantity = "v"

    offset: Field = Field(0.0, unit="rad/s | m/s", shape="n")
    noise: Field = Field(0.0, unit="rad/s | m/s", shape="n", minimum=0.0)


class TorqueSensor(FaultySensor):
    """A torque sensor of every joint, in joint units; a prismatic joint's is a force.

    Model:
        reading = resolution round((tau + bias + noise) / resolution)
        At the link tau is what the transmission gives to it, as a strain gauge behind gear and friction has it; at
        the motor it is the motor's own torque times the gear ratio, from its current. What is read in a tick is
        that of the last step of the integrator.

    Args:
        resolution: (n,) or scalar, the step [N m | N]; None for none, and among several 0 for joints without steps.
        bias: (n,) or scalar, what it reads without load [N m | N].
        noise: (n,) or scalar, standard deviation [N m | N].
        side: "link" or "motor".

    Raises:
        RangeError: A resolution of zero or below, negative noise, NaN.
    """

    resolution: Field = Field(unit="N m | N", shape="n", above=0.0, zero_for_none=True, optional=True, hint=NO_STEPS)
    bias: Field = Field(0.0, unit="N m | N", shape="n")
    noise: Field = Field(0.0, unit="N m | N", shape="n", minimum=0.0)
    side: Choice[Side] = Choice("link", "motor")

    def read(self, model: Model, true: Values, p: Values, noise: Array | None) -> Array:  # noqa: ARG002
        """(n,) torques [N m | N]."""
        at_motor = true["tau"]
        return self.faulty(at_motor if self.side == "motor" else true.get("tau_link", at_motor), p, noise)


class WrenchSensor(FaultySensor):
    """A six-axis force-torque sensor between arm and tool.

    Model:
        reading = the wrench of the environment on the arm + load + bias + noise, cut at +-range
        load = m (g - a_c) and its moment, less I alpha + omega x I omega: weight and inertia of the tool and of the
        plant's payload, where `tool` is given; without it there is no load, as if perfectly compensated
        A run records in how many ticks the reading was cut.

    Frames:
        It gives F_ext in world axes at the tool's origin. Bias, noise, range and load are of the sensor's own axes
        and origin, force first: those of `frame`. As by a driver, the reading is rotated into the world by the
        measured
        positions: an encoder that is wrong rotates it wrongly. Accelerations are those of the last step of the
        integrator, zero before the first, as F_ext is.

    Args:
        bias: (6,) or (force, moment), what it reads without load [N, N m].
        noise: (6,) or (force, moment), standard deviation [N, N m], new in every tick.
        range: (6,) or (force, moment), the largest reading [N, N m], infinity for one without end; None for none.
        tool: What stands beyond the sensor and is part of the arm's own bodies, such as a gripper, in the sensor's
            frame; `taut.Payload()` if that weighs nothing. The plant's payload hangs beyond it too. None for a sensor
            whose reading has no weight in it.
        frame: Where it stands: a frame of the tool's body; the tool's own if None.

    Raises:
        ShapeError, RangeError: One number for forces and moments; a range of zero or below, negative noise, NaN.
        UsageError: A tool that is no payload.

    Example:
        >>> WrenchSensor(range=(200.0, 10.0)).range.tolist()
        [200.0, 200.0, 200.0, 10.0, 10.0, 10.0]

    References:
        Chapter, section 10.3 force control, figure 10.15.
    """

    bias: Field = Field(unit=FORCE_AND_MOMENT, shape=6, accepts=("pair",), optional=True)
    noise: Field = Field(unit=FORCE_AND_MOMENT, shape=6, accepts=("pair",), minimum=0.0, optional=True)
    range: Field = Field(
        unit=FORCE_AND_MOMENT, shape=6, accepts=("pair",), above=0.0, optional=True, infinite=True, hint=NO_END
    )
    tool: Part[Payload | None] = Part(Payload, optional=True)
    frame: Plain[str | None] = Plain(str, optional=True)

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name, with those of what stands beyond it."""
        own = FaultySensor.parameters(self)
        if self.tool is None:
            return own
        return own | {f"tool.{name}": np.asarray(getattr(self.tool, name)) for name in ("mass", "com", "inertia")}

    def read(self, model: Model, true: Values, p: Values, noise: Array | None) -> tuple[Array, Any]:
        """(6,) F_ext [N, N m], world axes."""
        F_W = true.get("F_ext", np.zeros(6))
        if not p:
            return F_W, None
        place = sensor_place(model.arm, self.frame, "sensors.wrench")
        F_S = place.in_sensor(F_W, dyn.pose(model, true["q"]).R)
        if self.tool is not None:
            tool = PayloadValues.of(subtree(p, "tool")).body()
            payload = PayloadValues.of(subtree(true, "payload")).body()
            g, a, omega, alpha = place.motion(model, true["q"], true["v"], true["a"])
            F_S = F_S + load_wrench(tool + place.from_tool(payload), g, a, omega, alpha)
        F_S, cut = self.faulty(F_S, p, noise), None
        if "range" in p:
            F_S, cut = saturated(F_S, p["range"])
        return place.in_world(F_S, dyn.pose(model, true["q_read"]).R), cut


class Accelerometer(FaultySensor):
    """A three-axis accelerometer at the tool's origin.

    Model:
        reading = R_WE^T (a_tool - g) + bias + noise, cut at +-range: the proper acceleration, which is 9.81 m/s^2
        upwards at rest and zero in free fall; a_tool is that of the last step of the integrator, zero before the
        first

    Frames:
        Axes of the tool.

    Args:
        bias: (3,) or scalar, what it reads in free fall [m/s^2].
        noise: (3,) or scalar, standard deviation [m/s^2], new in every tick.
        range: (3,) or scalar, the largest reading [m/s^2]; None for no end.

    Raises:
        RangeError: A range of zero or below, negative noise, NaN.

    References:
        Chapter, section 10.5 impedance control.
    """

    needs_acceleration = True

    bias: Field = Field(0.0, unit="m/s^2", shape=3, accepts=("scalar",))
    noise: Field = Field(0.0, unit="m/s^2", shape=3, accepts=("scalar",), minimum=0.0)
    range: Field = Field(
        unit="m/s^2", shape=3, accepts=("scalar",), above=0.0, optional=True, infinite=True, hint=NO_END
    )

    def read(self, model: Model, true: Values, p: Values, noise: Array | None) -> tuple[Array, Any]:
        """(3,) proper acceleration [m/s^2], axes of the tool."""
        q, v = true["q"], true["v"]
        J, Jdot_v = dyn.jacobian(model, q), dyn.jacobian_rate_v(model, q, v)
        a_W = (J @ true["a"] + Jdot_v)[:3]
        a_E = self.faulty(dyn.pose(model, q).R.T @ (a_W - model.arm.gravity), p, noise)
        return saturated(a_E, p["range"]) if "range" in p else (a_E, None)


MEASUREMENT_OF: Final[Mapping[str, str]] = {
    "position": "q",
    "velocity": "v",
    "motor": "q_motor",
    "motor_velocity": "v_motor",
    "torque": "tau_meas",
    "wrench": "F_ext",
    "tip": "a_tip",
}
"""The measurement that each sensor gives."""


class OneSensor(Part[Any]):
    """A sensor of the stated class, or one of the user's own."""

    def checked(self, value: Any, owner: Any = None, joints: Any = None) -> Any:
        if isinstance(value, FaultySensor) or not isinstance(value, Sensor):
            value = super().checked(value, owner, joints)
        if not isinstance(value, ShaftSensor):
            return value
        at_motor = self.name.startswith("motor")
        if at_motor and value.side == "link":
            self.refuse("is at the motor; got side='link'; leave side out", value)
        return dataclasses.replace(value, side="motor") if at_motor and value.side is None else value


class Sensors(Declared):
    """The sensors of an arm, each of which may be left out but the positions. All noise comes from the run's seed.

    Ideal ones read the truth: positions, velocities and torques of the joints, and the wrench where something
    touches the tool. What has no sensor is not measured, and a law that asks for it is refused. Each may be a
    `taut.sensors.Sensor` of your own.

    Args:
        position: Positions of the joints, `x.q`.
        velocity: Velocities of the joints, a measured `x.v`; None for an arm without tachometers.
        motor: Second encoders, on the motors: `x.q_motor`.
        motor_velocity: Tachometers on the motors: `x.v_motor`.
        torque: Torques of the joints: `x.tau_meas`.
        wrench: The wrench at the tool, `x.F_ext`, where the plant has an environment, or where the sensor weighs.
        tip: Acceleration of the tool: `x.a_tip`.

    Raises:
        UsageError: A sensor of another kind, or a second encoder at the link.

    Example:
        >>> import taut
        >>> sensors = Sensors(position=Encoder(resolution=1e-4, side="motor"), velocity=None, tip=Accelerometer())
        >>> sorted(taut.RigidPlant(taut.load_arm("planar2"), sensors=sensors).measures)
        ['a_tip', 'tau_meas']

    References:
        Chapter, section 10.1 control system overview and figure 10.1.
    """

    position: OneSensor = OneSensor(Encoder, default=Encoder())
    velocity: OneSensor = OneSensor(Tachometer, default=Tachometer(), optional=True)
    motor: OneSensor = OneSensor(Encoder, optional=True)
    motor_velocity: OneSensor = OneSensor(Tachometer, optional=True)
    torque: OneSensor = OneSensor(TorqueSensor, default=TorqueSensor(), optional=True)
    wrench: OneSensor = OneSensor(WrenchSensor, default=WrenchSensor(), optional=True)
    tip: OneSensor = OneSensor(Accelerometer, optional=True)

    def by_measurement(self, *, touched: bool = True) -> dict[str, tuple[str, Sensor]]:
        """Name and sensor of each that reads something; `touched` if something touches the tool."""
        return {
            measurement: (name, sensor)
            for name, measurement in MEASUREMENT_OF.items()
            if (sensor := getattr(self, name)) is not None and (touched or self.weighs or name != "wrench")
        }

    @property
    def weighs(self) -> bool:
        """Whether the wrench sensor reads the weight of tool and payload."""
        return isinstance(self.wrench, WrenchSensor) and self.wrench.tool is not None

    @property
    def needs_acceleration(self) -> bool:
        """Whether the reading of one depends on how the arm accelerates."""
        return self.weighs or any(sensor.needs_acceleration for _, sensor in self.by_measurement().values())

    def measures(self, *, touched: bool) -> frozenset[str]:
        """What they measure besides positions."""
        return frozenset(self.by_measurement(touched=touched)) - {"q"}

    def distorts(self, *, touched: bool) -> frozenset[str]:
        """The measurements that differ from the truth at the link."""
        there = self.by_measurement(touched=touched)
        return frozenset(measurement for measurement, (_, sensor) in there.items() if not sensor.ideal)

    def noise(self, arm: Arm, *, touched: bool) -> dict[str, tuple[int, ...]]:
        """Shapes of the standard normal numbers that they need in every tick, by measurement."""
        shapes, there = measurement_shapes(arm.n), self.by_measurement(touched=touched)
        return {name: shapes[name] for name, (_, sensor) in there.items() if "noise" in sensor.parameters()}

    def check_arm(self, arm: Arm, *, touched: bool) -> None:
        """Whether they fit the arm.

        Raises:
            ShapeError: A number that is neither a scalar nor one per joint or axis.
            UsageError: A wrench sensor with faults where nothing touches the tool, or at a frame of another body.
        """
        self.check_size(arm.joint_names, "sensors.")
        if not isinstance(self.wrench, WrenchSensor):
            return
        sensor_place(arm, self.wrench.frame, "sensors.wrench")
        if not touched and not self.weighs and not self.wrench.ideal:
            raise UsageError(
                "sensors.wrench is for a plant that something touches, or whose tool it weighs; give the plant an "
                "environment or the sensor its tool, or leave it out",
                name="wrench",
            )

    def read(self, model: Model, true: Values, noise: Values, parameters: Values) -> dict[str, Any]:
        """Their readings, by measurement; and saturated.F_ext, saturated.a_tip: 1.0 in a tick that is at its range.

        Args:
            model: The constants of the true arm.
            true: By name: q, v and tau; q_motor, v_motor and tau_link where the transmission makes them differ; F_ext
                where something touches the tool; a, the joints' acceleration, for `tip` and for a wrench sensor that
                weighs, and payload.mass, payload.com and payload.inertia for the latter.
            noise: Standard normal numbers by measurement.
            parameters: The sensors' parameters, by path below "sensors".
        """
        out: dict[str, Any] = {}
        shapes = measurement_shapes(model.arm.n)
        for measurement, (name, sensor) in self.by_measurement(touched="F_ext" in true).items():
            known = {**true, "q_read": out.get("q")}  # positions come first
            given = sensor.read(model, known, subtree(parameters, name), noise.get(measurement))
            value, cut = given if isinstance(given, tuple) else (given, None)
            if np.shape(value) != shapes[measurement]:
                raise ShapeError(
                    f"{type(sensor).__name__}.read must give shape {shapes[measurement]} as sensors.{name}; got "
                    f"shape {np.shape(value)}",
                    name=name,
                )
            out[measurement] = value
            if cut is not None:
                out[f"saturated.{measurement}"] = cut
        return out
