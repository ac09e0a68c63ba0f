"""Servos: friction, rotor and motor constants that somebody identified, all seen at the output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taut.arm.friction import FRICTION_FIELDS, Friction
from taut.base.checks import finite_scalar, require_at_least, require_positive
from taut.base.errors import ShapeError, UsageError, quoted_list
from taut.base.types import Float64Array

if TYPE_CHECKING:
    from taut.arm.description import Arm

__all__ = ["Servo", "with_servos"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Servo:
    """A servo's friction, rotor and motor, all seen at its output. `arm.with_servo(servo)` puts it into joints.

    Law:  tau = torque_constant i, i = (u - torque_constant v) / resistance, for a voltage u and a speed v

    Args:
        friction: At the output, each number a scalar.
        rotor_inertia: Seen at the output, gear ratio squared times that of the rotor [kg m^2].
        torque_constant: [N m/A | V s/rad] at the output, if known.
        resistance: Of the winding [ohm], if known.
        voltage: Of the supply [V], if known; parameter files have none.
        name: What it is called.
        model: The model of friction that the numbers were fitted with.
        source: Where the numbers are from.
        notes: What was left out of the source, and what is to be doubted.

    Raises:
        ShapeError: Not one number each.
        RangeError: A negative number, or no finite one.

    Example:
        The Feetech STS3215 of the SO-101, as published with better-actuator-models 1.0.2, model m1:

        >>> sts3215 = Servo(
        ...     friction=Friction(coulomb=0.0524, viscous=0.0591), rotor_inertia=0.0284,
        ...     torque_constant=1.212, resistance=2.676, voltage=7.4,
        ... )
        >>> round(sts3215.stall_torque, 2), round(sts3215.no_load_speed, 2)
        (3.35, 6.11)
    """

    friction: Friction
    rotor_inertia: float
    torque_constant: float | None = None
    resistance: float | None = None
    voltage: float | None = None
    name: str = ""
    model: str = ""
    source: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.friction, Friction):  # callers without a type checker
            raise UsageError(
                f"a servo's friction must be a taut.Friction; got {type(self.friction).__name__}", name="friction"
            )
        for name in FRICTION_FIELDS:
            if np.ndim(getattr(self.friction, name)):
                shape = np.shape(getattr(self.friction, name))
                raise ShapeError(f"a servo's friction.{name} must be one number; got shape {shape}", name=name)
        rotor = finite_scalar("rotor_inertia", self.rotor_inertia, unit="kg m^2")
        require_at_least("rotor_inertia", np.asarray(rotor), 0.0, unit="kg m^2")
        object.__setattr__(self, "rotor_inertia", rotor)
        for name, unit in (("torque_constant", "N m/A"), ("resistance", "ohm"), ("voltage", "V")):
            if getattr(self, name) is not None:
                value = finite_scalar(name, getattr(self, name), unit=unit)
                require_positive(name, np.asarray(value), unit=unit)
                object.__setattr__(self, name, value)

    @property
    def stall_torque(self) -> float:
        """The motor's torque at rest under its full voltage, of which friction takes a part [N m].

        Raises:
            UsageError: The torque constant, the resistance or the voltage is not known.
        """
        kt, R, u = self._known("stall torque", "torque_constant", "resistance", "voltage")
        return kt * u / R

    @property
    def no_load_speed(self) -> float:
        """The speed at which the motor has no torque left under its full voltage [rad/s].

        Raises:
            UsageError: The torque constant or the voltage is not known.
        """
        kt, u = self._known("no-load speed", "torque_constant", "voltage")
        return u / kt

    def _known(self, what: str, *names: str) -> list[float]:
        missing = [name for name in names if getattr(self, name) is None]
        if missing:
            raise UsageError(
                f"the {what} of a servo needs its {quoted_list(missing)}; give it: {_way_out(missing)}",
                name=missing[0],
            )
        return [float(getattr(self, name)) for name in names]


def _way_out(missing: list[str]) -> str:
    """A file has no voltage, and a loader asks for it; what else is missing only the one who has the servo knows."""
    if missing == ["voltage"]:
        return "taut.load_servo(path, voltage=...), or taut.Servo(...)"
    return f"dataclasses.replace(servo, {', '.join(f'{name}=...' for name in missing)}), or taut.Servo(...)"


def with_servos(arm: Arm, servos: Servo | Mapping[str, Servo]) -> Arm:
    """The arm with the friction and the rotors of servos, in all of its joints or in those that are named."""
    by_joint = dict(servos) if isinstance(servos, Mapping) else dict.fromkeys(arm.joint_names, servos)
    columns: dict[str, Float64Array] = {
        name: np.array(getattr(arm.friction, name), dtype=np.float64) for name in FRICTION_FIELDS
    }
    columns["rotor_inertia"], columns["gear"] = arm.rotor_inertia.copy(), arm.gear.copy()
    for name, servo in by_joint.items():
        i = arm.joint_index(name)
        if not isinstance(servo, Servo):  # callers without a type checker
            raise UsageError(
                f"with_servo takes a taut.Servo, or one by joint name; got {type(servo).__name__}", name=name
            )
        if arm.joints[i].kind == "prismatic":
            raise UsageError(
                f"joint '{name}' is prismatic, and a servo's numbers are those of a rotation; give the joint its own "
                "friction and rotor inertia, with_joints(...)",
                name=name,
            )
        for field in FRICTION_FIELDS:
            columns[field][i] = float(np.asarray(getattr(servo.friction, field)))
        columns["rotor_inertia"][i] = servo.rotor_inertia
        columns["gear"][i] = 1.0  # all of a servo's numbers are those of its output
    return arm.with_joints(**columns)
