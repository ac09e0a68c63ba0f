"""From links and joints as a file gives them to an Arm: one way for URDF, MJCF, screws and Pinocchio.

A loader fills a Tree and reports what it cannot read; `assemble` checks what is there, locks joints, lumps
the links that hang on each other, and either gives an Arm or raises with every problem at once.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from taut.arm.angles import TURN
from taut.arm.doubts import indefinite
from taut.arm.gears import rotor_doubts
from taut.arm.loaders.lump import Lumps
from taut.arm.parts import STANDARD_GRAVITY, CommandKind, Frame, Joint, Shape
from taut.arm.rules import (
    AXIS_TOLERANCE,
    OTHER_KINDS,
    joint_problems,
    mass_problems,
    structure_problems,
)
from taut.base.checks import finite_scalar, vector
from taut.base.errors import ModelError, Problem, RangeError, UsageError, quoted_list, unknown_name
from taut.base.types import ArrayLike, Float64Array
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.arm.description import Arm

__all__ = [
    "LinkInertia",
    "Tree",
    "TreeJoint",
    "TreeLink",
    "TreeVisual",
    "Words",
    "assemble",
    "require_within_limits",
    "rest_position",
]

TreeKind = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "ball"]


@dataclass(frozen=True, kw_only=True)
class LinkInertia:
    """Mass properties of one link as the file gives them."""

    mass: float  # [kg]
    com: Float64Array  # (3,) in the link's frame [m]
    inertia: Float64Array  # (3, 3) about com, in the link's axes [kg m^2]


@dataclass(frozen=True, kw_only=True)
class TreeVisual:
    """Something to draw, fixed to a link."""

    placement: Pose
    shape: Shape
    size: tuple[float, ...]
    file: str = ""
    rgba: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)


@dataclass(kw_only=True)
class TreeLink:
    """One link of the file."""

    name: str
    inertia: LinkInertia | None = None
    line: int | None = None
    lines: dict[str, int] = field(default_factory=dict)  # where an attribute stands, if not at `line`
    visuals: list[TreeVisual] = field(default_factory=list)
    is_frame: bool = True  # False: only a loader's helper, which no caller should see
    unreadable: bool = False  # its mass properties could not be read, which the reader has reported
    if_massless: Problem | None = None  # what to say if a joint moves it and nothing gives it mass


@dataclass(kw_only=True)
class TreeJoint:
    """One joint of the file. NaN stands for a limit that the file should give and does not."""

    name: str
    kind: TreeKind
    parent: str
    child: str
    origin: Pose = field(default_factory=Pose.identity)
    axis: Float64Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0]))
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    viscous: float = 0.0
    coulomb: float = 0.0
    static: float | None = None
    stribeck: float = 0.0
    stribeck_shape: float = 2.0
    load_motor: float = 0.0
    load_external: float = 0.0
    load_motor_static: float | None = None
    load_external_static: float | None = None
    gear: float = 1.0
    rotor_inertia: float = 0.0
    mimic: str | None = None  # the joint that it follows; "" for a coupling with none
    line: int | None = None
    lines: dict[str, int] = field(default_factory=dict)  # where an attribute stands, if not at `line`


@dataclass(frozen=True, kw_only=True)
class Words:
    """What sentences about a model call its parts, and where its numbers are mended."""

    link: str = "link"
    no_mass: str = "give it an inertial element"
    wrong_inertia: str = "fix the inertial element"
    hold: str = "or hold it still: load_arm(..., locked={{'{joint}': 0.0}})"  # how a joint is locked


@dataclass(kw_only=True)
class Tree:
    """Links and joints of one file, with the problems met while reading it."""

    name: str
    source: str
    line: int | None = None  # where the model begins
    links: list[TreeLink] = field(default_factory=list)
    joints: list[TreeJoint] = field(default_factory=list)
    frames: list[tuple[str, str, Pose]] = field(default_factory=list)  # extra: name, link, T_link_frame
    problems: list[Problem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    gravity: ArrayLike | None = None  # (3,) [m/s^2] where the file states it
    home: dict[str, float] = field(default_factory=dict)  # joint positions where the file states them
    leaves: list[str] | None = None  # frames at the ends, where links alone do not tell
    structure_unknown: bool = False  # something unreadable hides how the links hang together
    words: Words = field(default_factory=Words)

    def problem(self, object_: str, attribute: str | None, message: str, line: int | None = None) -> None:
        """Report one thing that is wrong."""
        self.problems.append(Problem(object=object_, attribute=attribute, message=message, line=line))


def assemble(
    arm_class: type[Arm],
    tree: Tree,
    *,
    locked: Mapping[str, float] | None = None,
    tool: str | None = None,
    T_WB: Pose | None = None,
    gravity: ArrayLike | None = None,
    home: Mapping[str, float] | ArrayLike | None = None,
    commands: tuple[CommandKind, ...] = ("torque",),
) -> Arm:
    """The Arm of a tree of links and joints.

    Args:
        arm_class: The class of what is made, `Arm`, which stands above its loaders.
        tree: What a loader read.
        locked: Joints that do not move, with the position [rad | m] at which they are held.
        tool: Frame that carries the payload; the only leaf link by default.
        T_WB: Where the base stands in the world.
        gravity: (3,) [m/s^2] in the world.
        home: Joint positions by name, or (n,); by default zero, or mid-range where zero is out of limits.
        commands: What the real arm takes.

    Raises:
        ModelError: Everything that is wrong with the model.
        UnknownNameError: A locked joint or a tool that does not exist.
        UsageError: More than one leaf and no tool named.
    """
    held = _checked_locks(tree, locked or {})
    problems = [*tree.problems, *structure_problems(tree)]
    sound = len(problems) == len(tree.problems)
    problems += joint_problems(tree, held)
    problems += mass_problems(tree)
    lumps = Lumps(tree, held) if sound and not tree.structure_unknown else None
    if lumps is not None:
        problems += lumps.problems()
    if lumps is not None and not problems and not lumps.joints():
        text = "no joint moves; an arm needs one at least"
        problems.append(Problem(object=tree.name, attribute="joint", message=text, line=tree.line))
    if problems or lumps is None:
        raise ModelError(tree.source, sorted(problems, key=_by_line))
    joints = lumps.joints()
    frames = lumps.frames()
    arm = arm_class(
        name=tree.name,
        joints=joints,
        bodies=lumps.bodies(),
        frames=frames,
        tool=_tool(tree, lumps, frames, tool),
        home=_home(tree, joints, home),
        gravity=_gravity(tree, gravity),
        T_WB=Pose.identity() if T_WB is None else T_WB,
        commands=commands,
        visuals=lumps.visuals(),
        source=tree.source,
        notes=(*tree.notes, *_limit_notes(joints)),
    )
    least = indefinite(arm)
    if least is not None:
        text = (
            f"the mass matrix is not positive definite in floating point (least eigenvalue {least:.1g}, scaled); "
            "lengths, masses or inertias differ by too much: were all of them given in m, kg and kg m^2?"
        )
        raise ModelError(tree.source, [Problem(object=tree.name, attribute="inertial", message=text, line=tree.line)])
    return dataclasses.replace(arm, notes=(*arm.notes, *rotor_doubts(arm)))


def _by_line(problem: Problem) -> float:
    return math.inf if problem.line is None else problem.line


def _checked_locks(tree: Tree, locked: Mapping[str, float]) -> dict[str, float]:
    """The joints that are held, each at a position that it can have."""
    joints = {joint.name: joint for joint in tree.joints}
    held: dict[str, float] = {}
    for name, value in locked.items():
        if name not in joints:
            movable = [joint.name for joint in tree.joints if joint.kind != "fixed"]
            raise unknown_name(f"model '{tree.name}'", "joint", name, movable)
        joint = joints[name]
        at = f"locked['{name}']"
        if joint.kind == "fixed":
            raise UsageError(f"joint '{name}' is fixed in the file already; leave it out of locked=", name=at)
        unit = "m" if joint.kind == "prismatic" else "rad"
        held[name] = finite_scalar(at, value, unit=unit)
        if joint.kind in OTHER_KINDS and held[name] != 0.0:
            raise RangeError(
                f"{at} must be 0.0, where the file puts it: a {joint.kind} joint has no single position; "
                f"got {held[name]!r}",
                name=at,
                joint=name,
                value=held[name],
            )
        if held[name] != 0.0 and not np.linalg.norm(joint.axis) > AXIS_TOLERANCE:
            raise RangeError(f"{at} must be 0.0: the joint's axis is zero; got {held[name]!r}", name=at, joint=name)
        require_within_limits(at, held[name], joint)
    return held


def require_within_limits(at: str, value: float, joint: Joint | TreeJoint) -> None:
    """A position that the joint can have.

    Raises:
        RangeError: It is out of the joint's limits; the message calls it `at`.
    """
    slack = 1e-9 * max(1.0, abs(value))
    if joint.lower < joint.upper and not joint.lower - slack <= value <= joint.upper + slack:
        unit = "m" if joint.kind == "prismatic" else "rad"
        limits = f"[{joint.lower:g}, {joint.upper:g}]"
        raise RangeError(
            f"{at} must be within the joint's limits {limits} [{unit}]; got {value!r}",
            name=at,
            joint=joint.name,
            value=value,
            rule=f"within {limits}",
        )
    if joint.kind != "prismatic" and abs(value) > 1.5 * TURN and math.isinf(joint.upper - joint.lower):
        raise RangeError(
            f"{at} must be an angle in radians; got {value:g}, which is {abs(value) / TURN:.0f} turns; if it is in "
            "degrees, np.radians(...) converts it",
            name=at,
            joint=joint.name,
            value=value,
            rule="radians",
        )


def _gravity(tree: Tree, gravity: ArrayLike | None) -> Float64Array:
    if gravity is None:
        gravity = STANDARD_GRAVITY if tree.gravity is None else tree.gravity
    return vector("gravity", gravity, 3, unit="m/s^2")


def _tool(tree: Tree, lumps: Lumps, frames: tuple[Frame, ...], tool: str | None) -> str:
    """The frame that was asked for, or the only leaf that a joint moves."""
    names = [frame.name for frame in frames]
    if tool is not None:
        if tool not in names:
            raise unknown_name(
                f"model '{tree.name}'",
                "frame",
                tool,
                names,
                hint=f"{len(names)} frames: taut check MODEL lists them",
            )
        return tool
    leaves = tree.leaves
    if leaves is None:
        parents = {joint.parent for joint in tree.joints}
        leaves = [link.name for link in tree.links if link.name not in parents and lumps.moved(link.name)]
    if len(leaves) == 1:
        return leaves[0]
    raise UsageError(
        f"model '{tree.name}' has {len(leaves)} leaves ({quoted_list(leaves)}); "
        f"say which frame is the tool: tool='{leaves[0]}'",
        name="tool",
        value=leaves[0],
    )


def _home(tree: Tree, joints: tuple[Joint, ...], home: Mapping[str, float] | ArrayLike | None) -> Float64Array:
    """The pose that was asked for, else the file's, else zero or what of it the limits allow."""
    names = [joint.name for joint in joints]
    if home is not None and not isinstance(home, Mapping):
        q = vector("home", home, len(joints), joints=names)
    else:
        by_name = tree.home if home is None else home
        for name in by_name:
            if name not in {joint.name for joint in tree.joints}:
                raise unknown_name(f"model '{tree.name}'", "joint", name, names)
        rest = [by_name.get(joint.name, rest_position(joint)) for joint in joints]
        q = vector("home", rest, len(joints), joints=names)
    for i, joint in enumerate(joints):
        require_within_limits(f"home[{i}] (joint '{joint.name}')", float(q[i]), joint)
    return q


def rest_position(joint: Joint | TreeJoint) -> float:
    """Zero, or where the limits leave it out, the middle between them [rad | m]."""
    if joint.lower <= 0.0 <= joint.upper or math.isnan(joint.lower) or math.isnan(joint.upper):
        return 0.0
    if math.isinf(joint.lower) or math.isinf(joint.upper):
        return joint.lower if math.isinf(joint.upper) else joint.upper
    return 0.5 * (joint.lower + joint.upper)


def _limit_notes(joints: tuple[Joint, ...]) -> Iterator[str]:
    for attribute, words in (
        ("upper", "position"),
        ("velocity", "speed"),
        ("effort", "effort"),
    ):
        free = [
            joint.name
            for joint in joints
            if math.isinf(getattr(joint, attribute)) and not (attribute == "upper" and joint.kind == "continuous")
        ]
        if free:
            yield f"no {words} limit on {quoted_list(free)}"
