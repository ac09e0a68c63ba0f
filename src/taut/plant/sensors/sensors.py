"""The sensors of a plant: pure functions with parameters, like a law."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.parts import checked_payload_entry
from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.front_door import public_name
from taut.base.paths import subtree
from taut.base.quantity import six_of
from taut.base.types import ArrayLike, Float64Array
from taut.maths.model import Model
from taut.maths.wrist import sensor_place
from taut.plant.sensors.joint_sensors import Encoder, Tachometer, TorqueSensor
from taut.plant.sensors.readings import Sensor, numbers_of
from taut.plant.sensors.tool_sensors import Accelerometer, WrenchSensor

__all__ = ["SENSORS", "Sensors"]

Values = Mapping[str, Any]

TURN: Final = 2.0 * np.pi  # [rad]

SENSORS: Final[Mapping[str, tuple[str, type[Sensor]]]] = {
    "position": ("q", Encoder),
    "velocity": ("v", Tachometer),
    "motor": ("q_motor", Encoder),
    "motor_velocity": ("v_motor", Tachometer),
    "torque": ("tau_meas", TorqueSensor),
    "wrench": ("F_ext", WrenchSensor),
    "tip": ("a_tip", Accelerometer),
}
"""Each sensor: the measurement that it gives, and its class."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensors:
    """The sensors of an arm, each of which may be left out but the positions. All noise comes from the run's seed.

    Ideal ones read the truth: positions, velocities and torques of the joints, and the wrench where something
    touches the tool. What has no sensor is not measured, and a law that asks for it is refused.

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

    position: Encoder = field(default_factory=Encoder)
    velocity: Tachometer | None = field(default_factory=Tachometer)
    motor: Encoder | None = None
    motor_velocity: Tachometer | None = None
    torque: TorqueSensor | None = field(default_factory=TorqueSensor)
    wrench: WrenchSensor | None = field(default_factory=WrenchSensor)
    tip: Accelerometer | None = None

    def __post_init__(self) -> None:
        for name, (_, kind) in SENSORS.items():
            sensor = getattr(self, name)
            if isinstance(sensor, kind) or (sensor is None and name != "position"):
                continue
            or_none = "" if name == "position" else " or None"
            got = type(sensor).__name__
            raise UsageError(f"sensors.{name} must be {public_name(kind)}(...){or_none}; got {got}", name=name)
        for name in ("position", "velocity", "motor", "motor_velocity"):
            sensor, at_motor = getattr(self, name), name.startswith("motor")
            if sensor is None:
                continue
            if at_motor and sensor.side == "link":
                raise UsageError(
                    f"sensors.{name} is at the motor; got side='link'; leave side out, or give it as "
                    f"{'position' if name == 'motor' else 'velocity'}=",
                    name=name,
                )
            side = sensor.side or ("motor" if at_motor else "link")
            object.__setattr__(self, name, dataclasses.replace(sensor, side=side))

    # ---------------------------------------------------------------- what they declare

    def _there(self, touched: bool) -> dict[str, tuple[str, Sensor]]:
        """Measurement and sensor of all that read something, by the sensor's name."""
        return {
            name: (measurement, getattr(self, name))
            for name, (measurement, _) in SENSORS.items()
            if getattr(self, name) is not None and (touched or self.weighs or name != "wrench")
        }

    @property
    def weighs(self) -> bool:
        """Whether the wrench sensor reads the weight of tool and payload."""
        return self.wrench is not None and self.wrench.tool is not None

    @property
    def needs_acceleration(self) -> bool:
        """Whether one of them feels how the arm accelerates."""
        return self.tip is not None or self.weighs

    def measures(self, *, touched: bool) -> frozenset[str]:
        """What they measure besides positions; `touched` if something touches the tool."""
        return frozenset(measurement for measurement, _ in self._there(touched).values()) - {"q"}

    def distorts(self, *, touched: bool) -> frozenset[str]:
        """The measurements that differ from the truth at the link."""
        return frozenset(
            measurement
            for name, (measurement, sensor) in self._there(touched).items()
            if numbers_of(sensor)
            or (name == "wrench" and self.weighs)
            or (name in ("position", "velocity") and getattr(sensor, "side", "") == "motor")
        )

    def noise(self, arm: Arm, *, touched: bool) -> dict[str, tuple[int, ...]]:
        """Shapes of the standard normal numbers that they need in every tick, by measurement."""
        return {
            measurement: (sensor.size(arm),)
            for measurement, sensor in self._there(touched).values()
            if "noise" in numbers_of(sensor)
        }

    def parameters(self) -> dict[str, dict[str, Float64Array]]:
        """Run-time parameters by sensor and name: the numbers that are there."""
        out = {name: numbers_of(sensor) for name, (_, sensor) in self._there(touched=True).items()}
        if self.wrench is not None:
            out["wrench"] |= self.wrench.tool_numbers()
        return out

    # ---------------------------------------------------------------- checks

    def check(self, arm: Arm, *, touched: bool) -> None:
        """Whether they fit the arm.

        Raises:
            ShapeError: A number that is neither a scalar nor one per joint or axis.
            RangeError: An encoder with steps of more than a turn.
            UsageError: A wrench sensor with faults where nothing touches the tool, or at a frame of another body.
        """
        if self.wrench is not None:
            sensor_place(arm, self.wrench.frame, "sensors.wrench")
        for name, (_, sensor) in self._there(touched=True).items():
            size = sensor.size(arm)
            for word, values in numbers_of(sensor).items():
                if values.ndim:
                    path, joints = f"sensors.{name}.{word}", _joints_of(name, arm)
                    finite_array(path, values, shape=(size,), joints=joints, allow_infinite=True)
                if isinstance(sensor, Encoder) and word == "resolution":
                    _require_within_a_turn(f"sensors.{name}.{word}", values, arm)
        if not touched and not self.weighs and self.wrench is not None and numbers_of(self.wrench):
            raise UsageError(
                "sensors.wrench is for a plant that something touches, or whose tool it weighs; give the plant an "
                "environment or the sensor its tool, or leave it out",
                name="wrench",
            )

    def checked_parameter(self, path: str, value: ArrayLike, arm: Arm) -> Float64Array:
        """A new value of a parameter by its whole path, checked like the first one, in the shape it has.

        Raises:
            ShapeError: Another shape.
            RangeError: Against its rule.
        """
        _, name, word = path.split(".", 2)
        if word.startswith("tool."):
            return checked_payload_entry(path, value)
        sensor: Sensor = getattr(self, name)
        quantity, shape = sensor.quantities[word], np.shape(getattr(sensor, word))
        if isinstance(sensor, WrenchSensor):
            return six_of(path, quantity, value)
        new = quantity.checked(path, value, joints=_joints_of(name, arm))
        if new.shape not in ((), shape):
            raise ShapeError(
                f"{path} has shape {shape}; got shape {new.shape}; make the plant with a value of the new shape",
                name=path,
            )
        if isinstance(sensor, Encoder) and word == "resolution":
            _require_within_a_turn(path, new, arm)
        return np.broadcast_to(new, shape)

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
        """
        out: dict[str, Any] = {}
        for name, (measurement, sensor) in self._there("F_ext" in true).items():
            known = {**true, "q_read": out.get("q")}  # positions come first
            value, cut = sensor.read(model, known, noise.get(measurement), subtree(parameters, name))
            out[measurement] = value
            if cut is not None:
                out[f"saturated.{measurement}"] = cut
        return out


def _require_within_a_turn(path: str, resolution: ArrayLike, arm: Arm) -> None:
    """A step of an encoder is a turn of its shaft at most: 4096 counts are no resolution of 4096 rad."""
    for joint, step in zip(arm.joints, np.broadcast_to(np.asarray(resolution), (arm.n,)), strict=True):
        if joint.kind != "prismatic" and step > TURN:
            raise RangeError(
                f"{path} of joint '{joint.name}' must be at most a turn, {TURN:.4g} [rad]; got {float(step):g}; N "
                "counts in a turn are steps of 2*pi/N",
                name=path,
                value=float(step),
            )


def _joints_of(name: str, arm: Arm) -> tuple[str, ...] | None:
    """Names of the entries of a sensor's numbers; None where they are axes."""
    return None if name in ("wrench", "tip") else arm.joint_names
