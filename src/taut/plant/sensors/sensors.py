"""The sensors of a plant: pure functions with parameters, like a law."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import ShapeError, UsageError
from taut.base.fields import Declared, Part
from taut.base.paths import subtree
from taut.maths.model import Model
from taut.maths.snapshot import measurement_shapes
from taut.maths.wrist import sensor_place
from taut.plant.sensors.kinds import Accelerometer, Encoder, ShaftSensor, Tachometer, TorqueSensor, WrenchSensor
from taut.plant.sensors.sensor import FaultySensor, Sensor

__all__ = ["MEASUREMENT_OF", "Sensors"]

Values = Mapping[str, Any]

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

    # ---------------------------------------------------------------- what they declare

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

    # ---------------------------------------------------------------- checks

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

    # ---------------------------------------------------------------- the pure function

    def read(self, model: Model, true: Values, noise: Values, parameters: Values) -> dict[str, Any]:
        """What they give, by measurement; and saturated.F_ext, saturated.a_tip: 1.0 in a tick that is at its range.

        Args:
            model: The constants of the true arm.
            true: What is true, by name: q, v and tau; q_motor, v_motor and tau_link where the transmission makes
                them differ; F_ext where something touches the tool; a, the joints' acceleration, for `tip` and
                for a wrench sensor that weighs, and payload.mass, payload.com and payload.inertia for the latter.
            noise: Standard normal numbers by measurement.
            parameters: The sensors' parameters, by path below "sensors".

        Raises:
            ShapeError: A sensor of the user's own gives a reading of another shape.
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
