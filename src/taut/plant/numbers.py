"""The run-time parameters that model plants and engines share: of arm, drives, sensors, and what touches the tool."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.friction import AT_REST, check_at_rest
from taut.arm.parts import checked_payload_entry
from taut.base.checks import finite_array, require_at_least, require_positive
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.paths import flatten
from taut.base.types import ArrayLike, Float64Array
from taut.plant.contact import Contacts
from taut.plant.drives.actuation import Actuation
from taut.plant.drives.drivetrain import Drivetrain, FrictionLaw
from taut.plant.drives.transmission import require_rotors
from taut.plant.environments.environment import Environment, checked_change
from taut.plant.sensors.sensors import Sensors

__all__ = ["PlantNumbers", "require_torque_sensor"]

STIFFNESS: Final = "actuation.transmission.stiffness"  # which is infinite for a joint that is rigid
ROTOR: Final = "plant.rotor_inertia"
FRICTION: Final = "plant.friction."


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantNumbers:
    """Parameters of a true arm, by path, and what they may become."""

    arm: Arm
    drivetrain: Drivetrain
    actuation: Actuation
    sensors: Sensors
    environment: Environment | None = None
    contacts: Contacts | None = None

    def values(self) -> dict[str, Float64Array]:
        """The numbers that the plant was made with: those that are there."""
        payload = self.arm.payload
        plant: dict[str, Any] = {
            "payload": {"mass": np.asarray(payload.mass), "com": payload.com, "inertia": payload.inertia},
            "friction": self.drivetrain.parameters(),
        }
        if self.arm.rotor_inertia.any():
            plant["rotor_inertia"] = self.arm.rotor_inertia
        stages = {"actuation": self.actuation.parameters(), "sensors": self.sensors.parameters()}
        touching = {} if self.environment is None else self.environment.parameters()
        held = {} if self.contacts is None else self.contacts.parameters()
        out = flatten({"plant": plant, **stages}) | {f"environment.{name}": x for name, x in touching.items()}
        return out | {f"contact.{name}": x for name, x in held.items()}

    def checked(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value, checked like the first one and in its shape.

        Raises:
            ShapeError: Another shape.
            RangeError: NaN, infinite, or against its rule.
        """
        if path.startswith("plant.payload."):
            return checked_payload_entry(path, value)
        if path.startswith("sensors."):
            return self.sensors.checked_parameter(path, value, self.arm)
        if path.startswith("environment."):
            assert self.environment is not None
            return checked_change(self.environment, path.partition(".")[2], value)
        if path.startswith("contact."):
            assert self.contacts is not None
            return self.contacts.checked(path.partition(".")[2], value)
        law = self.drivetrain.friction
        if path.startswith(FRICTION) and isinstance(law, FrictionLaw):
            name = path.removeprefix(FRICTION)
            old, changed = law.parameters()[name], law.changed(name, value, name=path)
            return np.broadcast_to(changed.parameters()[name], old.shape)
        shape = self.values()[path].shape
        new = finite_array(path, value, allow_infinite=path == STIFFNESS)
        if new.shape not in ((), shape):
            raise ShapeError(
                f"{path} has shape {shape}; got shape {new.shape}; make the plant with a value of the new shape",
                name=path,
            )
        if path == STIFFNESS:
            self._check_kept_apart(new)
        if path.startswith("actuation."):
            self.actuation.changed(path.partition(".")[2], new, name=path)
        elif path == f"{FRICTION}stribeck_shape":
            require_positive(path, new)
        else:
            joints = self.arm.joint_names if shape == (self.arm.n,) else None
            require_at_least(path, new, 0.0, joints=joints)
        if path == ROTOR:
            require_rotors(self.arm, self.drivetrain.compliant, np.broadcast_to(new, shape))
        return np.broadcast_to(new, shape)

    def _check_kept_apart(self, stiffness: Float64Array) -> None:
        """Which joints are rigid is known when a plant is made.

        Raises:
            RangeError: Another joint is.
        """
        compliant = self.drivetrain.compliant
        for i, value in enumerate(np.broadcast_to(stiffness, (self.arm.n,))):
            if np.isinf(value) == (i in compliant):
                was = "elastic" if i in compliant else "rigid"
                raise RangeError(
                    f"{STIFFNESS} of joint '{self.arm.joint_names[i]}' got {value:g}, and the plant was made with "
                    f"this joint {was}; make another plant for that, or give one number per joint",
                    name=STIFFNESS,
                    joint=self.arm.joint_names[i],
                    value=float(value),
                )

    @staticmethod
    def check_together(values: Mapping[str, ArrayLike]) -> None:
        """Refuse values that do not go together, each of which is right by itself.

        Raises:
            RangeError: Less friction at rest than in motion.
        """
        for at_rest, moving in AT_REST.items():
            rest = values.get(FRICTION + at_rest)
            if rest is not None:
                check_at_rest(rest, values.get(FRICTION + moving, 0.0), at_rest, prefix=FRICTION)


def require_torque_sensor(actuation: Actuation, sensors: Sensors) -> None:
    """An inner torque loop reads the torque behind gear and friction.

    Raises:
        UsageError: There is no sensor of it.
    """
    if actuation.torque_loop is None or (sensors.torque is not None and sensors.torque.side == "link"):
        return
    got = "None" if sensors.torque is None else "one at the motor"
    raise UsageError(
        "actuation.torque_loop reads the torque sensor at the link, behind gear and friction; sensors.torque is "
        f"{got}; give it one, sensors.torque, or leave the loop out",
        name="torque_loop",
    )
