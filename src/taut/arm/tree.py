"""From links and joints as a file gives them to an Arm: one way for URDF, MJCF, screws and Pinocchio.

A loader fills a Tree and reports what it cannot read; `assemble` checks what is there, locks joints, lumps
the links that hang on each other, and either gives an Arm or raises with every problem at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from taut.arm.description import (
    BASE,
    STANDARD_GRAVITY,
    Arm,
    Body,
    CommandKind,
    Frame,
    Joint,
    JointKind,
    Visual,
)
from taut.base.checks import vector
from taut.base.errors import ModelError, Problem, UsageError, quoted_list, unknown_name
from taut.base.pose import Pose, axis_angle
from taut.base.types import ArrayLike, Float64Array

__all__ = ["LinkInertia", "Tree", "TreeJoint", "TreeLink", "TreeVisual", "assemble", "check_inertia"]

TreeKind = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "ball"]
MOVING: Final[tuple[JointKind, ...]] = ("revolute", "continuous", "prismatic")
AXIS_TOLERANCE: Final = 1e-3  # an axis shorter or longer than 1 by more is refused, inside it is normalised
INERTIA_TOLERANCE: Final = 1e-6  # relative slack of the triangle inequality, for rounded files


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
    shape: Literal["mesh", "box", "cylinder", "sphere"]
    size: tuple[float, ...]
    file: str = ""
    rgba: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)


@dataclass(kw_only=True)
class TreeLink:
    """One link of the file."""

    name: str
    inertia: LinkInertia | None = None
    line: int | None = None
    visuals: list[TreeVisual] = field(default_factory=list)


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
    rotor_inertia: float = 0.0
    mimic: str | None = None
    line: int | None = None


@dataclass(kw_only=True)
class Tree:
    """Links and joints of one file, with the problems met while reading it."""

    name: str
    source: str
    links: list[TreeLink] = field(default_factory=list)
    joints: list[TreeJoint] = field(default_factory=list)
    frames: list[tuple[str, str, Pose]] = field(default_factory=list)  # extra: name, link, T_link_frame
    problems: list[Problem] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def problem(self, object_: str, attribute: str | None, message: str, line: int | None = None) -> None:
        """Report one thing that is wrong."""
        self.problems.append(Problem(object=object_, attribute=attribute, message=message, line=line))


def assemble(
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
    locked = dict(locked or {})
    names = [joint.name for joint in tree.joints]
    for name in locked:
        if name not in names:
            raise unknown_name(f"model '{tree.name}'", "joint", name, names)
    problems = [*tree.problems, *_structure_problems(tree)]
    if problems:
        raise ModelError(tree.source, problems)
    problems = list(_joint_problems(tree, locked))
    lumps = _Lumps(tree, locked)
    problems += lumps.problems()
    if problems:
        raise ModelError(tree.source, problems)
    joints, bodies = lumps.joints(), lumps.bodies()
    frames = lumps.frames()
    notes = (*tree.notes, *_limit_notes(joints))
    return Arm(
        name=tree.name,
        joints=joints,
        bodies=bodies,
        frames=frames,
        tool=_tool(tree, frames, tool),
        home=_home(joints, home),
        gravity=vector("gravity", STANDARD_GRAVITY if gravity is None else gravity, 3, unit="m/s^2"),
        T_WB=Pose.identity() if T_WB is None else T_WB,
        commands=commands,
        visuals=lumps.visuals(),
        source=tree.source,
        notes=notes,
    )


# -------------------------------------------------------------------- what can be wrong


def _structure_problems(tree: Tree) -> Iterator[Problem]:
    """Names that are empty, doubled or unknown; more than one root or parent; cycles."""
    links = {link.name: link for link in tree.links}
    if not tree.links:
        yield Problem(object=tree.name, attribute=None, message="the model has no links")
        return
    for kind, items in (("link", tree.links), ("joint", tree.joints)):
        seen: set[str] = set()
        for item in items:
            if not item.name:
                yield Problem(
                    object=kind,
                    attribute="name",
                    message=f"a {kind} has an empty name; give it one",
                    line=item.line,
                )
            elif item.name in seen:
                yield Problem(
                    object=item.name,
                    attribute="name",
                    message=f"{kind} '{item.name}' is there twice; rename one",
                    line=item.line,
                )
            seen.add(item.name)
    parent_joint: dict[str, TreeJoint] = {}
    for joint in tree.joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                yield Problem(
                    object=joint.name,
                    attribute=role,
                    message=f"joint '{joint.name}': its {role} link '{link}' does not exist",
                    line=joint.line,
                )
        if joint.child == joint.parent:
            yield Problem(
                object=joint.name,
                attribute="child",
                message=f"joint '{joint.name}' joins link '{joint.child}' to itself",
                line=joint.line,
            )
        elif joint.child in parent_joint:
            first = parent_joint[joint.child].name
            yield Problem(
                object=joint.child,
                attribute="parent",
                message=f"link '{joint.child}' has two parents, joints '{first}' and '{joint.name}'; "
                "an arm is a tree: cut the loop at one of them and state the closure as a constraint",
                line=joint.line,
            )
        else:
            parent_joint[joint.child] = joint
    roots = [link.name for link in tree.links if link.name not in parent_joint]
    if len(roots) > 1:
        yield Problem(
            object=roots[1],
            attribute="parent",
            message=f"the model has {len(roots)} roots ({quoted_list(roots)}); an arm has one base: "
            "join the others to it with fixed joints",
            line=links[roots[1]].line,
        )
    for link in _on_cycles(parent_joint):
        yield Problem(
            object=link,
            attribute="parent",
            message=f"link '{link}' is on a closed chain; an arm is a tree: cut the loop at one joint and "
            "state the closure as a constraint",
            line=links[link].line if link in links else None,
        )


def _on_cycles(parent_joint: Mapping[str, TreeJoint]) -> list[str]:
    """One link of each cycle of parents."""
    found: list[str] = []
    settled: set[str] = set()
    for start in parent_joint:
        path: list[str] = []
        on_path: set[str] = set()
        link = start
        while link in parent_joint and link not in settled and link not in on_path:
            path.append(link)
            on_path.add(link)
            link = parent_joint[link].parent
        if link in on_path:
            found.append(link)
        settled.update(path)
    return found


def _bad(joint: TreeJoint, attribute: str, text: str) -> Problem:
    return Problem(
        object=joint.name,
        attribute=attribute,
        message=f"joint '{joint.name}': {text}",
        line=joint.line,
    )


def _joint_problems(tree: Tree, locked: Mapping[str, float]) -> Iterator[Problem]:
    """Types that an arm cannot have; axes, limits and friction of the joints that move."""
    for joint in tree.joints:
        if joint.kind == "fixed" or joint.name in locked:
            continue
        if joint.kind in ("floating", "planar"):
            yield _bad(
                joint,
                "type",
                f"a {joint.kind} joint is not one of an arm; cut the model there or make it fixed",
            )
        elif joint.kind == "ball":
            yield _bad(joint, "type", "ball joints are not supported; write it as three hinges")
        elif joint.mimic is not None:
            yield _bad(
                joint,
                "mimic",
                f"it mimics '{joint.mimic}', and taut has no coupled joints; lock it: "
                f"load_arm(..., locked={{'{joint.name}': 0.0}})",
            )
        else:
            yield from _value_problems(joint)


def _value_problems(joint: TreeJoint) -> Iterator[Problem]:
    if not np.isfinite(joint.axis).all():
        yield _bad(joint, "axis", f"axis must be finite; got {joint.axis.tolist()}")
    elif np.linalg.norm(joint.axis) < AXIS_TOLERANCE:
        yield _bad(joint, "axis", "axis must not be zero; a moving joint needs a direction")
    for attribute in ("lower", "upper", "velocity", "effort"):
        if math.isnan(getattr(joint, attribute)):
            yield _bad(joint, attribute, f"it has no {attribute} limit; give one in <limit>")
    if joint.lower >= joint.upper:
        yield _bad(
            joint,
            "limit",
            f"lower limit {joint.lower:g} must be below upper limit {joint.upper:g}; "
            "a joint that does not move is type fixed",
        )
    for attribute, word in (("velocity", "speed"), ("effort", "effort")):
        value = getattr(joint, attribute)
        if value <= 0.0:
            yield _bad(joint, attribute, f"{word} limit must be > 0; got {value:g}")
    for attribute, word in (
        ("viscous", "damping"),
        ("coulomb", "friction"),
        ("rotor_inertia", "rotor inertia"),
    ):
        value = getattr(joint, attribute)
        if not (math.isfinite(value) and value >= 0.0):
            yield _bad(joint, attribute, f"{word} must be finite and >= 0; got {value:g}")


def check_inertia(mass: float, inertia: Float64Array) -> tuple[str, str] | None:
    """What is wrong with a rigid body's mass properties: (attribute, text), or None.

    A body exists only if its mass is positive, its inertia positive definite, and no principal moment
    larger than the sum of the other two.
    """
    if not math.isfinite(mass) or not np.isfinite(inertia).all():
        return "inertia", "mass and inertia must be finite"
    if mass <= 0.0:
        return "mass", f"mass must be > 0; got {mass:g}"
    if np.abs(inertia - inertia.T).max() > 1e-9 * max(np.abs(inertia).max(), 1e-300):
        return "inertia", "inertia must be symmetric"
    small, middle, large = np.linalg.eigvalsh(inertia)
    if small <= 0.0:
        return (
            "inertia",
            f"inertia must be positive definite; its smallest principal moment is {small:.3g}",
        )
    if large > (small + middle) * (1.0 + INERTIA_TOLERANCE):
        axes = "xyz"
        diagonal = np.diag(inertia)
        k = int(np.argmax(diagonal))
        others = [i for i in range(3) if i != k]
        if np.allclose(inertia, np.diag(diagonal)):
            a, b = others
            got = (
                f"I{axes[k]}{axes[k]} {diagonal[k]:.4g} > I{axes[a]}{axes[a]} + I{axes[b]}{axes[b]} "
                f"{diagonal[a] + diagonal[b]:.4g}"
            )
        else:
            got = f"principal moments {small:.4g} + {middle:.4g} < {large:.4g}"
        return "inertia", f"inertia violates the triangle inequality ({got})"
    return None


# -------------------------------------------------------------------- lumping


class _Lumps:
    """Every link of a sound tree, sorted onto the bodies that the moving joints carry."""

    def __init__(self, tree: Tree, locked: Mapping[str, float]) -> None:
        self._links = {link.name: link for link in tree.links}
        self._extra = tree.frames
        self._moving: list[TreeJoint] = []
        self._parents: list[int] = []
        self._placements: list[Pose] = []
        self._at: dict[str, tuple[int, Pose]] = {}  # link -> (body, T_body_link)
        children: dict[str, list[TreeJoint]] = {}
        for joint in tree.joints:
            children.setdefault(joint.parent, []).append(joint)
        has_parent = {joint.child for joint in tree.joints}
        root = next(link.name for link in tree.links if link.name not in has_parent)
        stack: list[tuple[str, int, Pose]] = [(root, BASE, Pose.identity())]
        while stack:
            link, body, T_body_link = stack.pop()
            self._at[link] = (body, T_body_link)
            below = []
            for joint in children.get(link, []):
                T_body_joint = T_body_link @ joint.origin
                if joint.kind == "fixed":
                    below.append((joint.child, body, T_body_joint))
                elif joint.name in locked:
                    below.append((joint.child, body, T_body_joint @ _held(joint, locked[joint.name])))
                else:
                    below.append((joint.child, self._add(joint, body, T_body_joint), Pose.identity()))
            stack.extend(reversed(below))
        self._order = self._depth_first()

    def _add(self, joint: TreeJoint, parent: int, placement: Pose) -> int:
        self._moving.append(joint)
        self._parents.append(parent)
        self._placements.append(placement)
        return len(self._moving) - 1

    def _depth_first(self) -> list[int]:
        """The moving joints, parents before children, each chain in one piece."""
        children: dict[int, list[int]] = {}
        for i, parent in enumerate(self._parents):
            children.setdefault(parent, []).append(i)
        order: list[int] = []
        stack = list(reversed(children.get(BASE, [])))
        while stack:
            i = stack.pop()
            order.append(i)
            stack.extend(reversed(children.get(i, [])))
        return order

    def _index(self, body: int) -> int:
        return BASE if body == BASE else self._order.index(body)

    def joints(self) -> tuple[Joint, ...]:
        return tuple(
            Joint(
                name=self._moving[i].name,
                kind=_moving_kind(self._moving[i]),
                parent=self._index(self._parents[i]),
                placement=self._placements[i],
                axis=_unit_axis(self._moving[i].axis),
                lower=self._moving[i].lower,
                upper=self._moving[i].upper,
                velocity=self._moving[i].velocity,
                effort=self._moving[i].effort,
                viscous=self._moving[i].viscous,
                coulomb=self._moving[i].coulomb,
                rotor_inertia=self._moving[i].rotor_inertia,
            )
            for i in self._order
        )

    def frames(self) -> tuple[Frame, ...]:
        frames = [
            Frame(name=link, body=self._index(body), placement=pose)
            for link, (body, pose) in self._at.items()
        ]
        for name, link, T_link_frame in self._extra:
            body, T_body_link = self._at[link]
            frames.append(Frame(name=name, body=self._index(body), placement=T_body_link @ T_link_frame))
        return tuple(frames)

    def visuals(self) -> tuple[Visual, ...]:
        return tuple(
            Visual(
                body=self._index(body),
                placement=T_body_link @ visual.placement,
                shape=visual.shape,
                size=visual.size,
                file=visual.file,
                rgba=visual.rgba,
            )
            for link, (body, T_body_link) in self._at.items()
            for visual in self._links[link].visuals
        )

    def _links_of(self, i: int) -> list[str]:
        return [link for link, (body, _) in self._at.items() if body == i]

    def bodies(self) -> tuple[Body, ...]:
        return tuple(self._lump(i) for i in self._order)

    def _lump(self, i: int) -> Body:
        """Mass, centre of mass and inertia of all links on one body, in that body's frame."""
        parts = []
        for link in self._links_of(i):
            inertia = self._links[link].inertia
            if inertia is not None and inertia.mass > 0.0:
                T = self._at[link][1]
                parts.append((inertia.mass, T.act(inertia.com), T.R @ inertia.inertia @ T.R.T))
        links = tuple(self._links_of(i))
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
        """What is wrong with the masses: of any one link, and of each lumped body."""
        sound = True
        for link in self._links.values():
            inertia = link.inertia
            if inertia is None:
                continue
            numbers = np.concatenate([[inertia.mass], np.ravel(inertia.com), np.ravel(inertia.inertia)])
            if not np.isfinite(numbers).all() or inertia.mass < 0.0:
                sound = False
                got = "not finite" if not np.isfinite(numbers).all() else f"{inertia.mass:g}"
                yield Problem(
                    object=link.name,
                    attribute="mass",
                    message=f"link '{link.name}': mass must be finite and >= 0, and centre of mass and "
                    f"inertia finite; got {got}; fix the inertial element",
                    line=link.line,
                )
        if not self._moving:
            sound = False
            yield Problem(object="model", attribute=None, message="no joint moves; an arm needs one at least")
        if not sound:
            return
        for i in self._order:
            body = self._lump(i)
            wrong = check_inertia(body.mass, body.inertia)
            if wrong is None:
                continue
            attribute, text = wrong
            owner = next(
                (link for link in body.links if self._links[link].inertia is not None),
                body.links[0],
            )
            fixed = [link for link in body.links if link != owner]
            along = f", with {quoted_list(fixed, 3)} fixed to it" if fixed else ""
            yield Problem(
                object=owner,
                attribute=attribute,
                message=f"link '{owner}'{along}: {text}; fix the inertial element",
                line=self._links[owner].line,
            )


def _moving_kind(joint: TreeJoint) -> JointKind:
    for kind in MOVING:
        if joint.kind == kind:
            return kind
    raise AssertionError(joint.kind)


def _unit_axis(axis: Float64Array) -> Float64Array:
    unit = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    nearest = np.round(unit)
    unit = np.where(np.abs(unit - nearest) < 1e-11, nearest, unit) + 0.0
    unit.flags.writeable = False
    return unit


def _held(joint: TreeJoint, q: float) -> Pose:
    """The motion of a joint at position q, as a pose."""
    axis = _unit_axis(joint.axis)
    if joint.kind == "prismatic":
        return Pose(axis * q)
    return Pose(R=axis_angle(axis, q))


# -------------------------------------------------------------------- defaults


def _tool(tree: Tree, frames: tuple[Frame, ...], tool: str | None) -> str:
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
    parents = {joint.parent for joint in tree.joints}
    leaves = [link.name for link in tree.links if link.name not in parents]
    if len(leaves) == 1:
        return leaves[0]
    raise UsageError(
        f"model '{tree.name}' has {len(leaves)} leaves ({quoted_list(leaves)}); "
        f"say which frame is the tool: tool='{leaves[0]}'",
        name="tool",
    )


def _home(joints: tuple[Joint, ...], home: Mapping[str, float] | ArrayLike | None) -> Float64Array:
    names = [joint.name for joint in joints]
    rest = np.zeros(len(joints))
    for i, joint in enumerate(joints):
        if not joint.lower <= 0.0 <= joint.upper:
            rest[i] = 0.5 * (joint.lower + joint.upper)
    if home is None:
        return vector("home", rest, len(joints))
    if isinstance(home, Mapping):
        for i, name in enumerate(names):
            rest[i] = home.get(name, rest[i])
        return vector("home", rest, len(joints), joints=names)
    return vector("home", home, len(joints), joints=names)


def _limit_notes(joints: tuple[Joint, ...]) -> Iterator[str]:
    for attribute, words in (
        ("upper", "position"),
        ("velocity", "speed"),
        ("effort", "effort"),
    ):
        free = [
            joint.name
            for joint in joints
            if math.isinf(getattr(joint, attribute))
            and not (attribute == "upper" and joint.kind == "continuous")
        ]
        if free:
            yield f"no {words} limit on {quoted_list(free)}"
