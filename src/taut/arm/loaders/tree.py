"""From links and joints, as URDF, MJCF, screws or Pinocchio give them, to an Arm.

A loader fills a Tree; `assemble` checks it, locks joints, lumps fixed links, and raises every problem at once.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from taut.arm.parts import BASE, STANDARD_GRAVITY, Body, CommandKind, Frame, Joint, Visual, require_few_turns
from taut.arm.rules import (
    AXIS_TOLERANCE,
    FIX_MASS,
    OTHER_KINDS,
    check_inertia,
    indefinite,
    joint_problems,
    mass_problems,
    problem_at,
    structure_problems,
    wrong_mass,
)
from taut.base.checks import entry_names, finite_scalar, vector
from taut.base.errors import ModelError, Problem, RangeError, UsageError, quoted_list, unknown_name
from taut.base.types import ArrayLike, Float64Array
from taut.trace.pose import Pose, axis_angle

if TYPE_CHECKING:
    from taut.arm.description import Arm


@dataclass(kw_only=True)
class TreeLink:
    """One link of the file."""

    name: str
    inertia: Body | None = None  # as the file gives it
    line: int | None = None
    lines: dict[str, int] = field(default_factory=dict)  # where an attribute stands, if not at `line`
    visuals: list[Visual] = field(default_factory=list)
    is_frame: bool = True  # False: only a loader's helper, which no caller should see
    unreadable: bool = False  # its mass properties could not be read, which the reader has reported
    if_massless: Problem | None = None  # what to say if a joint moves it and nothing gives it mass


@dataclass(kw_only=True)
class TreeJoint:
    """One joint of the file and the links that it joins. NaN stands for a limit that the file should give."""

    joint: Joint  # placed in the parent link's frame
    parent: str
    child: str
    mimic: str | None = None  # the joint that it follows; "" for a coupling with none
    line: int | None = None
    lines: dict[str, int] = field(default_factory=dict)  # where an attribute stands, if not at `line`

    @classmethod
    def fixed(cls, parent: str, child: str, placement: Pose) -> TreeJoint:
        """A joint that fixes a link to another one, named after it."""
        return cls(joint=Joint(name=f"<{child}>", kind="fixed", placement=placement), parent=parent, child=child)

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.joint.name


@dataclass(kw_only=True)
class Tree:
    """Links and joints of one model, with the problems met while reading it, and what the catalogue adds."""

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
    locked: Mapping[str, float | None] = field(default_factory=dict)  # positions of joints held [rad | m]; None: free
    tool: str | None = None  # the frame that carries the payload, where it is known
    commands: tuple[CommandKind, ...] = ("torque",)  # what the real arm takes
    leaves: list[str] | None = None  # frames at the ends, where links alone do not tell
    structure_unknown: bool = False  # something unreadable hides how the links hang together
    link_word: str = "link"  # what messages call a link

    def problem(self, object_: str, attribute: str | None, message: str, line: int | None = None) -> None:
        """Report one thing that is wrong."""
        self.problems.append(Problem(object=object_, attribute=attribute, message=message, line=line))

    @property
    def movable(self) -> dict[str, Joint]:
        """The joints that are not fixed, by name."""
        return {item.name: item.joint for item in self.joints if item.joint.kind != "fixed"}


def assemble(
    arm_class: type[Arm],
    tree: Tree,
    *,
    T_WB: Pose | None = None,
    gravity: ArrayLike | None = None,
    home: Mapping[str, float] | ArrayLike | None = None,
) -> Arm:
    """The Arm of a tree of links and joints, with T_WB, gravity in the world and home (by name, or (n,)) if given.

    Home is otherwise the tree's, else zero, or mid-range where zero is out of limits. ModelError has every problem.
    """
    locked = _checked_locks(tree)
    problems = [*tree.problems, *structure_problems(tree)]
    sound = len(problems) == len(tree.problems)
    problems += [*joint_problems(tree, locked), *mass_problems(tree)]
    lumps = _Lumps(tree, locked) if sound and not tree.structure_unknown else None
    if lumps is not None:
        problems += lumps.problems()
        if not problems and not lumps.joints:
            text = "no joint moves; an arm needs one at least"
            problems.append(Problem(object=tree.name, attribute="joint", message=text, line=tree.line))
    if problems or lumps is None:
        raise ModelError(tree.source, sorted(problems, key=_by_line))
    if gravity is None:
        gravity = STANDARD_GRAVITY if tree.gravity is None else tree.gravity
    frames = lumps.frames()
    arm = arm_class(
        name=tree.name,
        joints=tuple(lumps.joints),
        bodies=tuple(lumps.body(i) for i in range(len(lumps.joints))),
        frames=frames,
        tool=_tool(tree, lumps, [frame.name for frame in frames]),
        home=_home(tree, lumps.joints, home),
        gravity=vector("gravity", gravity, 3, unit="m/s^2"),
        T_WB=Pose.identity() if T_WB is None else T_WB,
        commands=tree.commands,
        visuals=lumps.visuals(),
        source=tree.source,
        notes=(*tree.notes, *_limit_notes(lumps.joints)),
    )
    least = indefinite(arm)
    if least is not None:
        text = (
            f"the mass matrix is not positive definite in floating point (least eigenvalue {least:.1g}, scaled); "
            "lengths, masses or inertias differ by too much: were all of them given in m, kg and kg m^2?"
        )
        raise ModelError(tree.source, [Problem(object=tree.name, attribute="inertial", message=text, line=tree.line)])
    return arm


def _by_line(problem: Problem) -> float:
    return math.inf if problem.line is None else problem.line


def _checked_locks(tree: Tree) -> dict[str, float]:
    """The joints that are held, each at a position that it can have."""
    joints = {item.name: item.joint for item in tree.joints}
    locked: dict[str, float] = {}
    for name, value in tree.locked.items():
        if name not in joints:
            raise unknown_name(f"model '{tree.name}'", "joint", name, tree.movable)
        joint, at = joints[name], f"locked['{name}']"
        if joint.kind == "fixed":
            raise UsageError(f"joint '{name}' is fixed in the file already; leave it out of locked=", name=at)
        if value is None:
            continue
        locked[name] = finite_scalar(at, value, unit=joint.unit)
        one_position = joint.kind not in OTHER_KINDS and np.linalg.norm(joint.axis) > AXIS_TOLERANCE
        if locked[name] != 0.0 and not one_position:
            raise RangeError(
                f"{at} must be 0.0, where the file puts it: a {joint.kind} joint, or one whose axis is zero, has no "
                f"single position; got {locked[name]!r}",
                name=at,
                joint=name,
                value=locked[name],
            )
        _require_within_limits(at, locked[name], joint)
    return locked


def _require_within_limits(at: str, value: float, joint: Joint) -> None:
    """Refuse a position out of the joint's limits, called `at` in the message."""
    slack = 1e-9 * max(1.0, abs(value))
    if joint.lower < joint.upper and not joint.lower - slack <= value <= joint.upper + slack:
        limits = f"[{joint.lower:g}, {joint.upper:g}]"
        raise RangeError(
            f"{at} must be within the joint's limits {limits} [{joint.unit}]; got {value!r}",
            name=at,
            joint=joint.name,
            value=value,
            rule=f"within {limits}",
        )


def _tool(tree: Tree, lumps: _Lumps, names: list[str]) -> str:
    """The frame that was asked for, or the only leaf that a joint moves."""
    if tree.tool is not None:
        if tree.tool not in names:
            hint = f"{len(names)} frames: taut check MODEL lists them"
            raise unknown_name(f"model '{tree.name}'", "frame", tree.tool, names, hint=hint)
        return tree.tool
    leaves = tree.leaves
    if leaves is None:
        parents = {joint.parent for joint in tree.joints}
        leaves = [link.name for link in tree.links if link.name not in parents and lumps.at[link.name][0] != BASE]
    if len(leaves) == 1:
        return leaves[0]
    raise UsageError(
        f"model '{tree.name}' has {len(leaves)} leaves ({quoted_list(leaves)}); "
        f"say which frame is the tool: tool='{leaves[0]}'",
        name="tool",
        value=leaves[0],
    )


def _home(tree: Tree, joints: list[Joint], home: Mapping[str, float] | ArrayLike | None) -> Float64Array:
    """The pose that was asked for, else the file's, else zero or what of it the limits allow."""
    by_name = tree.home if home is None else home
    if isinstance(by_name, Mapping):
        for name in by_name:
            if name not in {joint.name for joint in tree.joints}:
                raise unknown_name(f"model '{tree.name}'", "joint", name, [joint.name for joint in joints])
        by_name = [by_name.get(joint.name, _rest_position(joint)) for joint in joints]
    return positions_within_limits("home", by_name, joints)


def positions_within_limits(name: str, q: ArrayLike, joints: Sequence[Joint]) -> Float64Array:
    """(n,) positions that the joints can have [rad | m], called `name` in messages. Raises ShapeError, RangeError."""
    names = [joint.name for joint in joints]
    positions = vector(name, q, len(joints), joints=names)
    for i, joint in enumerate(joints):
        _require_within_limits(entry_names(name, [i], names), float(positions[i]), joint)
    require_few_turns(name, positions, joints)
    return positions


def _rest_position(joint: Joint) -> float:
    """Zero, or where the limits leave it out, the middle between them [rad | m]."""
    if joint.lower <= 0.0 <= joint.upper or math.isnan(joint.lower) or math.isnan(joint.upper):
        return 0.0
    if math.isinf(joint.lower) or math.isinf(joint.upper):
        return joint.lower if math.isinf(joint.upper) else joint.upper
    return 0.5 * (joint.lower + joint.upper)


def _limit_notes(joints: list[Joint]) -> Iterator[str]:
    for attribute, words in (("upper", "position"), ("velocity", "speed"), ("effort", "effort")):
        limited = [joint for joint in joints if attribute != "upper" or joint.kind != "continuous"]
        free = [joint.name for joint in limited if math.isinf(getattr(joint, attribute))]
        if free:
            yield f"no {words} limit on {quoted_list(free)}"


class _Lumps:
    """Bodies, joints, frames and visuals of a partly locked tree; parents before children, each chain contiguous."""

    def __init__(self, tree: Tree, locked: Mapping[str, float]) -> None:
        self._tree = tree
        self._links = {link.name: link for link in tree.links}
        self.joints: list[Joint] = []  # those that move
        self.at: dict[str, tuple[int, Pose]] = {}  # link -> (body, T_body_link), in the order of the walk
        self._walk(locked)
        self._on_body: dict[int, list[TreeLink]] = {i: [] for i in range(BASE, len(self.joints))}
        for link, (body, _) in self.at.items():
            self._on_body[body].append(self._links[link])

    def _walk(self, locked: Mapping[str, float]) -> None:
        children: dict[str, list[TreeJoint]] = {}
        for item in self._tree.joints:
            children.setdefault(item.parent, []).append(item)
        has_parent = {item.child for item in self._tree.joints}
        root = next(link for link in self._links if link not in has_parent)
        self.at[root] = (BASE, Pose.identity())
        # Depth first and iterative. A joint is numbered when the walk reaches it, so that chains stay whole.
        stack = list(reversed(children.get(root, [])))
        while stack:
            item = stack.pop()
            joint = item.joint
            body, T_body_link = self.at[item.parent]
            T = T_body_link @ joint.placement
            if joint.kind == "fixed":
                self.at[item.child] = (body, T)
            elif joint.name in locked:
                self.at[item.child] = (body, T @ _held(joint, locked[joint.name]))
            else:
                self.joints.append(dataclasses.replace(joint, parent=body, placement=T, axis=_unit_axis(joint.axis)))
                self.at[item.child] = (len(self.joints) - 1, Pose.identity())
            stack.extend(reversed(children.get(item.child, [])))

    def frames(self) -> tuple[Frame, ...]:
        """A frame for each link, and the file's own."""
        links = [(name, name, Pose.identity()) for name in self.at if self._links[name].is_frame]
        frames = []
        for name, link, T_link_frame in (*links, *self._tree.frames):
            body, T_body_link = self.at[link]
            frames.append(Frame(name=name, body=body, placement=T_body_link @ T_link_frame))
        return tuple(frames)

    def visuals(self) -> tuple[Visual, ...]:
        """What can be drawn, on the bodies."""
        return tuple(
            dataclasses.replace(visual, body=body, placement=T_body_link @ visual.placement)
            for link, (body, T_body_link) in self.at.items()
            for visual in self._links[link].visuals
        )

    def body(self, i: int) -> Body:
        """Mass, centre of mass and inertia of all links on one body, in that body's frame."""
        parts = []
        for link in self._on_body[i]:
            if link.inertia is not None and link.inertia.mass > 0.0:
                T = self.at[link.name][1]
                R = T.R
                parts.append((link.inertia.mass, T.act(link.inertia.com), R @ link.inertia.inertia @ R.T))
        links = tuple(link.name for link in self._on_body[i])
        mass = float(sum(m for m, _, _ in parts))
        if mass <= 0.0:
            return Body(mass=mass, com=np.zeros(3), inertia=np.zeros((3, 3)), links=links)
        com = np.sum([m * c for m, c, _ in parts], axis=0) / mass
        total = np.zeros((3, 3))
        for m, c, about_com in parts:
            d = c - com
            total += about_com + m * (float(d @ d) * np.eye(3) - np.outer(d, d))
        return Body(mass=mass, com=com, inertia=0.5 * (total + total.T), links=links)

    def problems(self) -> Iterator[Problem]:
        """Bodies that no joint can move: without mass, or with an inertia that no rigid body has."""
        for i, joint in enumerate(self.joints):
            links = self._on_body[i]
            if any(link.unreadable or wrong_mass(link) for link in links):
                continue  # reported already
            body = self.body(i)
            wrong = check_inertia(body.mass, body.inertia)
            if wrong is None:
                continue
            attribute, text = wrong
            owner = next((link for link in links if link.inertia is not None), None)
            if owner is None and links[0].if_massless is not None:
                yield links[0].if_massless
                continue
            if owner is None:
                owner, text = links[0], f" is moved by joint '{joint.name}' and has no mass; give it mass and inertia"
            else:
                fixed = [link.name for link in links if link is not owner and link.is_frame]
                along = f", with {quoted_list(fixed, 3)} fixed to it" if fixed else ""
                text = f"{along}: {text}; {FIX_MASS}"
            yield problem_at(owner, attribute, f"{self._tree.link_word} '{owner.name}'{text}")


def _unit_axis(axis: Float64Array) -> Float64Array:
    """The axis with length 1, exact along x, y and z; a zero axis, which is reported, as it is."""
    length = np.linalg.norm(axis)
    if not length >= AXIS_TOLERANCE:
        return axis
    unit = np.asarray(axis, dtype=np.float64) / length
    nearest = np.round(unit)
    return np.where(np.abs(unit - nearest) < 1e-11, nearest, unit) + 0.0


def _held(joint: Joint, q: float) -> Pose:
    """The motion of a joint that is held at q, as a pose; `assemble` has checked that q fits the joint."""
    if q == 0.0:
        return Pose.identity()
    axis = _unit_axis(joint.axis)
    return Pose(axis * q) if joint.kind == "prismatic" else Pose(R=axis_angle(axis, q))
