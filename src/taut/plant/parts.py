"""What the plants of taut are made of: options checked together, and the run-time parameters by path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import COMMANDS, Arm, CommandKind
from taut.arm.friction import AT_REST, check_at_rest
from taut.arm.parts import checked_payload_entry
from taut.base.checks import finite_array, one_of, require_range
from taut.base.errors import RangeError, ShapeError, UsageError, unknown_name
from taut.base.fields import Declared
from taut.base.paths import flatten
from taut.base.types import ArrayLike, Float64Array
from taut.maths.adds import Adds
from taut.plant.contact import Contacts
from taut.plant.drives.actuation import Actuation
from taut.plant.drives.drivetrain import Drivetrain, FrictionLaw, require_rotors
from taut.plant.environments.environment import Environment, require_environment
from taut.plant.sensors.sensors import Sensors

__all__ = ["PlantParts"]

STIFFNESS: Final = "actuation.transmission.stiffness"  # which is infinite for a joint that is rigid
ROTOR: Final = "plant.rotor_inertia"
FRICTION: Final = "plant.friction."
OF_WRENCHES: Final = ((6,), (6, 6))  # one number of these is of the position alone


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantParts:
    """A true arm, its drives and sensors, and what touches it.

    Args:
        name: What messages call the plant.
        arm: The arm.
        friction: "arm" for its own, None for none, or a law of the user's.
        takes: The command.
        adds: What the plant adds to it itself.
        actuation: The drives.
        sensors: The sensors.
        environment: What touches the tool.
        contacts: What holds the arm rigidly.
        smooth: Whether the integrator needs smooth forces.
        scene: Whether an engine knows of more that may touch the tool.

    Raises:
        UsageError, ShapeError: What does not go together, or is of another kind or size.
    """

    name: str
    arm: Arm
    friction: Literal["arm"] | FrictionLaw | None
    takes: CommandKind
    adds: Adds
    actuation: Actuation
    sensors: Sensors
    environment: Environment | None
    contacts: Contacts | None = None
    smooth: bool = False
    scene: bool = False

    def __post_init__(self) -> None:
        one_of("takes", self.takes, COMMANDS)
        kinds: dict[str, tuple[type, str]] = {
            "arm": (Arm, "an Arm from taut.load_arm"),
            "actuation": (Actuation, "taut.drives.Actuation(...)"),
            "sensors": (Sensors, "taut.sensors.Sensors(...)"),
        }
        for name, (kind, words) in kinds.items():
            if not isinstance(getattr(self, name), kind):
                raise UsageError(f"{name} must be {words}; got {type(getattr(self, name)).__name__}", name=name)
        if not isinstance(self.friction, FrictionLaw) and self.friction not in ("arm", None):
            raise UsageError(
                f"friction must be 'arm', None or a taut.drives.FrictionLaw; got {self.friction!r}; another friction "
                "is the arm's: arm.with_friction(...)",
                name="friction",
            )
        if self.environment is not None:
            require_environment("environment", self.environment)
        if self.takes != "torque":
            self._check_drives()
        names = self.arm.joint_names
        self.actuation.check_size(names, "actuation.")
        self.sensors.check_arm(self.arm, touched=self.touched)
        if isinstance(self.friction, FrictionLaw):
            self.friction.check_size(names, "plant.friction.")
            if self.adds.friction:
                raise UsageError("the plant adds the arm's friction, and has a law of its own; keep one", name="adds")
        require_rotors(self.arm, self.drivetrain.compliant)
        if self.actuation.torque_loop is not None and getattr(self.sensors.torque, "side", "") != "link":
            raise UsageError(
                "actuation.torque_loop reads the torque sensor at the link, behind gear and friction; give the plant "
                "one, sensors.torque, or leave the loop out",
                name="torque_loop",
            )
        if self.contacts is not None:
            self.contacts.check()
        if self.smooth:
            self._check_smooth()

    def _check_drives(self) -> None:
        """Drives that take velocities or positions have a bandwidth and a delay, and nothing that is for torques."""
        if self.actuation.bandwidth is None:
            raise UsageError(
                f"a plant that takes {self.takes} needs the bandwidth of its drives, actuation.bandwidth: 50, say",
                name="actuation",
            )
        for_torques = {f"actuation.{name}": True for name in self.actuation.for_torque_only} | {
            "adds": bool(self.adds.names),
            "contact": self.contacts is not None,
            "a friction law of your own": isinstance(self.friction, FrictionLaw),
        }
        for name, there in for_torques.items():
            if there:
                raise UsageError(
                    f"{name} is for torque commands; this plant takes {self.takes}, which its drives follow by "
                    "themselves",
                    name=name,
                )

    def _check_smooth(self) -> None:
        train = self.drivetrain
        sticks = "dry friction" if train.friction is not None and train.friction.dry else "gears that lose power"
        rough = {
            sticks: train.dry,
            "elastic transmissions or backlash": bool(train.compliant),
            "a contact": self.contacts is not None,
        }
        for what, there in rough.items():
            if there:
                raise UsageError(
                    f"rk4 moves the arm alone, under smooth forces, and this plant has {what}; use "
                    "semi-implicit-euler, in MuJoCo discrete",
                    name="integrator",
                )

    @cached_property
    def drivetrain(self) -> Drivetrain:
        """Rotors, friction and transmissions."""
        friction: Any = self.friction
        if friction == "arm":
            friction = None if self.adds.friction else self.arm.friction
        return Drivetrain(arm=self.arm, friction=friction, transmission=self.actuation.transmission)

    @property
    def touched(self) -> bool:
        """Whether a sensor at the wrist has anything to measure."""
        held = self.contacts is not None and self.contacts.measured
        return self.scene or held or self.environment is not None

    # ---------------------------------------------------------------- parameters

    @cached_property
    def values(self) -> dict[str, Float64Array]:
        """Run-time parameters by path, as the plant was made with them: those that are there."""
        payload = self.arm.payload
        plant: dict[str, Any] = {
            "payload": {"mass": np.asarray(payload.mass), "com": payload.com, "inertia": payload.inertia},
            "friction": self.drivetrain.parameters(),
        }
        if self.arm.rotor_inertia.any():
            plant["rotor_inertia"] = self.arm.rotor_inertia
        below = {
            "plant": plant,
            "actuation": self.actuation.parameters(),
            "sensors": self.sensors.parameters(),
            "environment": {} if self.environment is None else self.environment.parameters(),
            "contact": {} if self.contacts is None else self.contacts.parameters(),
        }
        return flatten(below)

    def checked(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, checked like the first one and in its shape.

        Raises:
            UnknownNameError: There is no such parameter.
            ShapeError: Another shape.
            RangeError: NaN, infinite, or against its rule.
        """
        if path not in self.values:
            raise unknown_name(f"plant '{self.name}'", "parameter", path, self.values)
        shape, new = self.values[path].shape, self._checked(path, value)
        one_for_all = new.ndim == 0 and not (path.startswith("environment.") and shape in OF_WRENCHES)
        if new.shape == shape or one_for_all:
            return np.broadcast_to(new, shape)
        if shape == (6, 6) and new.shape == (6,):
            return np.diag(new)
        raise ShapeError(
            f"{path} has shape {shape}; got shape {new.shape}; make the plant with a value of the new shape",
            name=path,
        )

    def _checked(self, path: str, value: ArrayLike) -> Float64Array:
        """By the declaration of what has it."""
        head, _, rest = path.partition(".")
        if path.startswith(("plant.payload.", "sensors.wrench.tool.")):
            return checked_payload_entry(path, value)
        if head == "environment":
            assert self.environment is not None
            return np.asarray(self.environment.changed(rest, value, name=path).parameters()[rest])
        if head == "contact":
            assert self.contacts is not None
            return self.contacts.checked(rest, value)
        owners: dict[str, Declared] = {"actuation": self.actuation, "sensors": self.sensors}
        if path.startswith(FRICTION) and isinstance(self.drivetrain.friction, FrictionLaw):
            head, rest, owners = "", path.removeprefix(FRICTION), {"": self.drivetrain.friction}
        if head in owners:
            new = owners[head].checked_parameter(rest, value, name=path, joints=self.arm.joint_names)
            owners[head].changed(rest, new, name=path)
            if path == STIFFNESS:
                self._check_kept_apart(new)
            return new
        new = finite_array(path, value)
        if path == f"{FRICTION}stribeck_shape":
            require_range(path, new, above=0.0)
        else:
            require_range(path, new, minimum=0.0, joints=self.arm.joint_names if new.shape == (self.arm.n,) else None)
        if path == ROTOR and new.shape in ((), (self.arm.n,)):
            require_rotors(self.arm, self.drivetrain.compliant, np.broadcast_to(new, (self.arm.n,)))
        return new

    def _check_kept_apart(self, stiffness: Float64Array) -> None:
        """Which joints are rigid is known when a plant is made.

        Raises:
            RangeError: Another joint is.
        """
        for i, value in enumerate(np.broadcast_to(stiffness, (self.arm.n,))):
            if np.isinf(value) == (i in self.drivetrain.compliant):
                was = "elastic" if np.isinf(value) else "rigid"
                raise RangeError(
                    f"{STIFFNESS} of joint '{self.arm.joint_names[i]}' got {value:g}, and the plant was made with "
                    f"this joint {was}; make another plant for that, or give one number per joint",
                    name=STIFFNESS,
                    joint=self.arm.joint_names[i],
                    value=float(value),
                )

    @staticmethod
    def check_together(values: Mapping[str, ArrayLike]) -> None:
        """Refuse values by path that do not go together, each of which is right by itself.

        Raises:
            RangeError: Less friction at rest than in motion.
        """
        for at_rest, moving in AT_REST.items():
            rest = values.get(FRICTION + at_rest)
            if rest is not None:
                check_at_rest(rest, values.get(FRICTION + moving, 0.0), at_rest, prefix=FRICTION)
