"""Arm: the robot's joints, bodies, frames, gravity and limits; data, no maths.

Joint i moves body i, whose frame is the joint's own. Parents come before children; the base, written -1, is at T_WB.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from taut.arm.friction import AT_REST, FRICTION_FIELDS, Friction
from taut.arm.parts import (
    BASE,
    COMMANDS,
    STANDARD_GRAVITY,
    Body,
    CommandKind,
    Frame,
    Joint,
    JointKind,
    Payload,
    Shape,
    Visual,
    short_way,
)
from taut.base.checks import finite_array, instance_of, read_only, vector
from taut.base.errors import UsageError, count_of, unknown_name
from taut.base.types import Array, ArrayLike, Float64Array, Point3, Vector
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.arm.servo import Servo

__all__ = [
    "BASE",
    "COMMANDS",
    "STANDARD_GRAVITY",
    "Arm",
    "Body",
    "CommandKind",
    "Frame",
    "Friction",
    "Joint",
    "JointKind",
    "Payload",
    "Shape",
    "Visual",
]


def _per_joint(field_of_joint: str, doc: str) -> cached_property[Float64Array]:
    """A property with one number for each joint, which nobody can write to."""

    def values(arm: Arm) -> Float64Array:
        return read_only([getattr(joint, field_of_joint) for joint in arm.joints])

    values.__doc__ = doc
    return cached_property(values)


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """A robot arm: a tree of joints with one tool, mounted in the world.

    Made by `taut.load_arm` or `Arm.from_screws`; the methods below give changed copies.

    Example:
        >>> from taut import load_arm
        >>> arm = load_arm("planar2")
        >>> arm.n, arm.joint_names
        (2, ('joint1', 'joint2'))
    """

    name: str
    joints: tuple[Joint, ...]
    bodies: tuple[Body, ...]
    frames: tuple[Frame, ...]
    tool: str  # name of the frame that carries the payload and that tasks mean
    home: Float64Array  # (n,) a pose to start from
    gravity: Point3 = field(default_factory=lambda: np.array(STANDARD_GRAVITY))  # [m/s^2] in W
    T_WB: Pose = field(default_factory=Pose.identity)
    payload: Payload = field(default_factory=Payload)
    commands: tuple[CommandKind, ...] = ("torque",)  # what the real arm takes
    visuals: tuple[Visual, ...] = ()
    source: str = ""
    notes: tuple[str, ...] = ()  # what the loader supplied or left out, in words

    def __post_init__(self) -> None:
        kept = {"home": read_only(self.home), "gravity": read_only(self.gravity), "T_WB": self.T_WB.kept()}
        for name, value in kept.items():
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of moving joints."""
        return len(self.joints)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of q."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames."""
        return tuple(frame.name for frame in self.frames)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Unit, rad or m, of each entry of q."""
        return tuple(joint.unit for joint in self.joints)

    lower = _per_joint("lower", "(n,) lower position limits [rad | m]; -inf where there is none.")
    upper = _per_joint("upper", "(n,) upper position limits [rad | m]; inf where there is none.")
    velocity = _per_joint("velocity", "(n,) speed limits [rad/s | m/s]; inf where there is none.")
    effort = _per_joint("effort", "(n,) torque limits [N m | N]; inf where there is none.")
    viscous = _per_joint("viscous", "(n,) viscous friction [N m s/rad | N s/m].")
    coulomb = _per_joint("coulomb", "(n,) dry friction in motion [N m | N].")
    gear = _per_joint("gear", "(n,) turns of the motor per turn of the joint [1 | rad/m]; 1 where nothing is known.")
    rotor_inertia = _per_joint("rotor_inertia", "(n,) rotor inertia seen at the joint [kg m^2 | kg].")

    @cached_property
    def friction(self) -> Friction:
        """All of its friction, each number (n,)."""
        values = {name: [getattr(joint, name) for joint in self.joints] for name in FRICTION_FIELDS}
        for name, moving in AT_REST.items():
            values[name] = [m if x is None else x for x, m in zip(values[name], values[moving], strict=True)]
        return Friction(**values)

    @cached_property
    def continuous(self) -> tuple[int, ...]:
        """Indices of the joints that wrap at +-pi."""
        return tuple(i for i, joint in enumerate(self.joints) if joint.kind == "continuous")

    @cached_property
    def total_mass(self) -> float:
        """Mass of everything that moves, without payload [kg]."""
        return float(sum(body.mass for body in self.bodies))

    def frame(self, name: str | None = None) -> Frame:
        """The frame of that name (UnknownNameError if the arm has none); the tool by default."""
        name = self.tool if name is None else name
        for frame in self.frames:
            if frame.name == name:
                return frame
        raise unknown_name(
            "the arm",
            "frame",
            name,
            self.frame_names,
            hint=f"{len(self.frames)} frames: taut check MODEL lists them",
        )

    def joint_index(self, name: str) -> int:
        """Index in q of the joint of that name; UnknownNameError if the arm has none."""
        if name in self.joint_names:
            return self.joint_names.index(name)
        raise unknown_name(f"arm '{self.name}'", "joint", name, self.joint_names)

    def ancestors(self, body: int) -> tuple[int, ...]:
        """The joints between the base and a body, root first, its own joint included."""
        path: list[int] = []
        while body != BASE:
            path.append(body)
            body = self.joints[body].parent
        return tuple(reversed(path))

    def difference(self, q_to: Array, q_from: Array) -> Vector:
        """(n,) the shortest way q_to - q_from; continuous joints wrap to [-pi, pi). Floats or symbols."""
        return short_way(q_to - q_from, self.continuous)

    def with_tool(self, frame: str, T_FE: Pose | None = None, name: str = "tool") -> Arm:
        """A copy whose tool is another frame, or a new frame at T_FE in it. Raises UnknownNameError, UsageError."""
        if not isinstance(frame, str):  # callers without a type checker
            raise UsageError(f"with_tool takes the name of a frame; got {frame!r}", name="frame")
        base = self.frame(frame)
        if T_FE is None:
            return dataclasses.replace(self, tool=frame)
        if name in self.frame_names:
            raise UsageError(f"the arm has a frame '{name}' already; give another name=", name=name)
        new = Frame(name=name, body=base.body, placement=base.placement @ T_FE)
        return dataclasses.replace(self, frames=(*self.frames, new), tool=name)

    def mounted(self, T_WB: Pose) -> Arm:
        """A copy whose base stands at T_WB in the world."""
        instance_of("T_WB", T_WB, Pose, "a taut.Pose")
        return dataclasses.replace(self, T_WB=T_WB)

    def with_gravity(self, gravity: ArrayLike) -> Arm:
        """A copy under another gravity (3,) [m/s^2], given in the world."""
        return dataclasses.replace(self, gravity=vector("gravity", gravity, 3, unit="m/s^2"))

    def with_payload(
        self,
        mass: float,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ) -> Arm:
        """A copy that carries a payload: mass [kg], centre of mass [m] and inertia in the tool frame.

        Warns of a centre of mass that is more than three lengths of the arm away.
        """
        from taut.arm.change import loaded

        com, inertia = finite_array("payload.com", com), finite_array("payload.inertia", inertia)
        return loaded(self, Payload(mass=mass, com=com, inertia=inertia))

    def subset(self, joints: Iterable[str], q: ArrayLike | None = None) -> Arm:
        """A copy in which only these joints move, the others locked at q (home). UnknownNameError, UsageError."""
        from taut.arm.change import locked_copy

        return locked_copy(self, joints, q)

    def perturbed(
        self,
        *,
        seed: int,
        mass: float = 0.0,
        com: float = 0.0,
        inertia: float = 0.0,
        friction: float = 0.0,
    ) -> Arm:
        """A copy with a modelling error, drawn once from `seed`; every draw is a possible rigid body.

        Args:
            seed: Seed of the draw.
            mass: Relative standard deviation of each mass; its inertia scales along.
            com: Standard deviation of each centre of mass [m].
            inertia: Relative standard deviation of the body's size about its centre of mass, axis by axis.
            friction: Relative standard deviation of viscous and dry friction.
        """
        from taut.arm.change import perturbed_copy

        return perturbed_copy(self, seed=seed, mass=mass, com=com, inertia=inertia, friction=friction)

    def with_body(
        self,
        joint: str,
        *,
        mass: float | None = None,
        com: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
    ) -> Arm:
        """A copy in which the body that `joint` moves has another mass, centre of mass or inertia."""
        from taut.arm.change import body_replaced

        return body_replaced(self, joint, mass=mass, com=com, inertia=inertia)

    def with_joints(self, **values: ArrayLike | Mapping[str, float]) -> Arm:
        """A copy with other joint values by field name, one per joint or by joint name.

        Fields: lower, upper, velocity, effort, gear, rotor_inertia, and those of `taut.Friction`.

        Example:
            >>> from taut import load_arm
            >>> load_arm("planar2").with_joints(viscous=[0.1, 0.2]).viscous.tolist()
            [0.1, 0.2]
        """
        from taut.arm.change import joints_replaced

        return joints_replaced(self, values)

    def with_friction(self, friction: Friction) -> Arm:
        """A copy with another friction, in all its parts: `arm.with_friction(Friction(viscous=0.1))`."""
        if not isinstance(friction, Friction):
            raise UsageError(f"with_friction takes a taut.Friction; got {type(friction).__name__}", name="friction")
        return self.with_joints(**{name: getattr(friction, name) for name in FRICTION_FIELDS})

    def with_gears(self, ratio: ArrayLike | Mapping[str, float], motor_inertia: ArrayLike) -> Arm:
        """A copy with geared motors, reflected inertia ratio^2 motor_inertia; warns of an implausible rotor inertia.

        Args:
            ratio: Turns of the motor per turn of the joint, or per metre [rad/m]: one number, (n,), or by joint name.
            motor_inertia: Of each rotor about its own axis [kg m^2]: one number, or (n,).

        Raises:
            RangeError: A ratio <= 0, or a negative inertia.
            UnknownNameError: The arm has no such joint.

        Example:
            >>> from taut import load_arm
            >>> arm = load_arm("planar2").with_gears({"joint2": 50.0}, 2e-5)
            >>> arm.gear.tolist(), arm.rotor_inertia.round(6).tolist()
            ([1.0, 50.0], [0.0, 0.05])

        References:
            Chapter, section 10.2.1.5 the effect of gearing.
        """
        from taut.arm.change import geared

        return geared(self, ratio, motor_inertia)

    def with_servo(self, servos: Servo | Mapping[str, Servo]) -> Arm:
        """A copy with the friction and rotor inertia of a servo in every joint, or of one each by joint name.

        A servo's numbers are those of its output, so that the gear ratio becomes 1. Effort and speed limits stay.
        Raises UnknownNameError, UsageError (prismatic joint).

        Example:
            >>> from taut import Friction, Servo, load_arm
            >>> servo = Servo(friction=Friction(coulomb=0.05, viscous=0.06), rotor_inertia=0.028)
            >>> load_arm("planar2").with_servo({"joint2": servo}).coulomb.tolist()
            [0.0, 0.05]
        """
        from taut.arm.servo import with_servos

        return with_servos(self, servos)

    @classmethod
    def from_screws(
        cls,
        Mlist: ArrayLike,
        Glist: ArrayLike,
        Slist: ArrayLike,
        gravity: ArrayLike = STANDARD_GRAVITY,
        name: str = "arm",
    ) -> Arm:
        """An arm in the textbook's own notation; the only place where angular parts come first.

        Args:
            Mlist: (n + 1, 4, 4) link frame i in frame i - 1 at the zero pose; the last one is the tool.
            Glist: (n, 6, 6) spatial inertia of each link in its own frame, diag(I, m 1).
            Slist: (6, n) screw axes in the space frame, (omega, v) in each column.
            gravity: (3,) [m/s^2] in the space frame.
            name: Name of the arm.

        Raises:
            ShapeError: The lists do not fit together.
            ModelError: An impossible inertia or screw axis.

        References:
            Lynch and Park, Modern Robotics (2017), sections 3.3.2, 8.2 and 8.3.
        """
        from taut.arm.loaders.memory import arm_from_screws

        return arm_from_screws(cls, Mlist, Glist, Slist, gravity, name)

    def __repr__(self) -> str:
        return f"Arm('{self.name}', {count_of(self.n, 'joint')}, tool '{self.tool}')"
