"""The sensors that come with taut: encoders, tachometers, torque and wrench sensors, accelerometers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

import numpy as np

from taut.arm.description import Payload
from taut.base.fields import Choice, Field, Part, Plain
from taut.base.paths import subtree
from taut.base.types import Array, Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues
from taut.maths.wrist import load_wrench, sensor_place
from taut.plant.sensors.sensor import FaultySensor, Side, saturated

__all__ = ["Accelerometer", "Encoder", "Tachometer", "TorqueSensor", "WrenchSensor"]

Values = Mapping[str, Any]
TURN: Final = 2.0 * np.pi  # [rad] the largest step of an encoder: 4096 counts are no resolution of 4096 rad
NO_STEPS: Final = "leave it out where there are no steps"
NO_END: Final = "leave it out for a sensor without end"
FORCE_AND_MOMENT: Final = "N, N m"


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

    The noise is white from tick to tick: its standard deviation is the same at every rate, so that its density grows
    as the rate falls.

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

    References:
        Chapter, section 10.1 control system overview.
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

    References:
        Chapter, section 10.1 control system overview.
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
        reading = the wrench of the environment on the arm + load + bias + noise, cut at +-range: that is what the
        real part does, and a run records in how many ticks it did
        load = m (g - a_c) and its moment, less I alpha + omega x I omega: weight and inertia of the tool and of the
        plant's payload, where `tool` is given; without it nothing weighs, as if all that had been taken out exactly

    Frames:
        What it gives is F_ext, in world axes at the tool's origin. Bias, noise, range and load are of the sensor's
        own axes and origin, force first: those of `frame`. A driver rotates the reading into the world by the
        positions that the arm measures, and so does this: an encoder that is wrong rotates it wrongly. Accelerations
        are those of the last step of the integrator, zero before the first, as F_ext is.

    Args:
        bias: (6,) or (force, moment), what it reads without load [N, N m].
        noise: (6,) or (force, moment), standard deviation [N, N m], new in every tick.
        range: (6,) or (force, moment), the largest reading [N, N m], infinity for one without end; None for none.
        tool: What stands beyond the sensor and is part of the arm's own bodies, such as a gripper, in the sensor's
            frame; `taut.Payload()` if that weighs nothing. The plant's payload hangs beyond it too. None for a sensor
            whose reading has no weight in it.
        frame: Where it stands: a frame of the tool's body; the tool's own if None.

    Raises:
        ShapeError: One number for forces and moments.
        RangeError: A range of zero or below, negative noise, NaN.
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
