"""URDF to links and joints. Every number that matters to motion is checked, and every problem is kept."""

from __future__ import annotations

import dataclasses
import difflib
import itertools
import math
from collections.abc import Container, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink
from taut.arm.loaders.visuals import SIZES, MeshPaths, colours_of, urdf_visuals
from taut.arm.loaders.xml import BadNumberError, Element, numbers
from taut.arm.parts import Body, Joint, JointKind, inertia_matrix
from taut.arm.rules import MAX_LINKS
from taut.base.errors import ModelError, Problem, quoted_list, unknown_name
from taut.trace.pose import Pose

KINDS: Final[tuple[JointKind, ...]] = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
LIMITS: Final = ("lower", "upper", "velocity", "effort")
INERTIA: Final = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
ELEMENTS: Final = {
    "robot": ("link", "joint"),
    "link": ("inertial", "visual", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}
ATTRIBUTES: Final = {
    "link": ("name",),
    "joint": ("name", "type"),
    "origin": ("xyz", "rpy"),
    "mass": ("value",),
    "inertia": INERTIA,
    "parent": ("link",),
    "child": ("link",),
    "axis": ("xyz",),
    "limit": LIMITS,
    "dynamics": ("damping", "friction"),
    "mimic": ("joint", "multiplier", "offset"),
}
GEAR_RATIO: Final = "drake:gear_ratio"
ROTOR_INERTIA: Final = "drake:rotor_inertia"
REDUCTION: Final = "mechanicalReduction"
MAX_ATTRIBUTES: Final = 50  # an element with more is a vendor's own
LIKE: Final = 0.75  # difflib's ratio from which a word is taken for another


def urdf_tree(robot: Element, path: Path, packages: Mapping[str, Path] | None = None) -> Tree:
    """The links and joints of a URDF document, and its problems, which `assemble` raises.

    `packages` has the folders that stand for `package://NAME` in mesh names.
    """
    name = robot.get("name") or path.stem
    tree = Tree(name=name, source=str(path), line=robot.line)
    if name != robot.get("name"):
        tree.notes.append(f"the robot has no name; it is called '{name}' after its file")
    for tag in ("link", "joint"):
        if len(robot.all(tag)) > MAX_LINKS:  # before any of them is read
            text = f"the model has {len(robot.all(tag))} {tag}s; an arm has {MAX_LINKS} at most"
            raise ModelError(str(path), [Problem(object=name, attribute=tag, message=text, line=robot.line)])
    meshes = MeshPaths(path.parent, packages)
    _Reader(tree).read(robot, meshes)
    tree.notes.extend(meshes.notes())
    return tree


class _Reader:
    """Fills one tree; what is wrong goes into `tree.problems`, and reading goes on."""

    def __init__(self, tree: Tree) -> None:
        self._tree = tree
        self._wrapping: list[str] = []  # continuous joints that give position limits

    def read(self, robot: Element, meshes: MeshPaths) -> None:
        self._refuse_macros(robot)
        self._check_words(f"robot '{self._tree.name}'", robot)
        colours = colours_of(robot)
        for element in robot.all("link"):
            link = self._link(element)
            link.visuals = urdf_visuals(element, meshes, colours)
            self._tree.links.append(link)
        for element in robot.all("joint"):
            joint = self._joint(element)
            if joint is None:
                self._tree.structure_unknown = True
            else:
                self._tree.joints.append(joint)
        _read_transmissions(robot, self._tree)
        if self._wrapping:
            text = "continuous, so the position limits in the file are left out"
            self._tree.notes.append(f"{quoted_list(self._wrapping)}: {text}")

    def _link(self, element: Element) -> TreeLink:
        link = TreeLink(name=element.get("name") or "", line=element.line)
        owner = f"link '{link.name}'"
        self._check_words(owner, element)
        self._check_sizes(owner, element)
        inertial = self._only(owner, element, "inertial")
        if inertial is None:
            return link
        before = len(self._tree.problems)
        origin = self._origin(owner, inertial)
        mass, inertia = self._only(owner, inertial, "mass"), self._only(owner, inertial, "inertia")
        for tag, found in (("mass", mass), ("inertia", inertia)):
            if found is None:
                self._problem(owner, tag, f"its <inertial> has no <{tag}>; give it one", inertial.line)
            else:
                link.lines[tag] = found.line
        m = self._number(owner, mass, "value", 0.0, required=True) if mass is not None else 0.0
        six = [self._number(owner, inertia, name, 0.0, required=True) for name in INERTIA] if inertia else [0.0] * 6
        if len(self._tree.problems) > before:
            link.unreadable = True
            return link
        I = inertia_matrix(six)
        link.inertia = Body(mass=m, com=origin.p, inertia=origin.R @ I @ origin.R.T)
        return link

    def _joint(self, element: Element) -> TreeJoint | None:
        name = element.get("name") or ""
        owner = f"joint '{name}'"
        self._check_words(owner, element)
        kind = self._kind(owner, element)
        parent, child = (self._end(owner, element, role) for role in ("parent", "child"))
        lines = {end.tag: end.line for end in element.children if end.tag in ("parent", "child")}
        placement, direction = self._origin(owner, element), np.array((1.0, 0.0, 0.0))
        axis = self._only(owner, element, "axis")
        if axis is not None:
            lines["axis"] = axis.line
            direction = np.array(self._numbers(owner, axis, "xyz", (1.0, 0.0, 0.0), required=True))
        limit = self._only(owner, element, "limit")
        if limit is not None:
            lines |= dict.fromkeys(("limit", *LIMITS), limit.line)
        values = self._limits(owner, name, kind, limit)
        dynamics = self._only(owner, element, "dynamics")
        if dynamics is not None:
            lines["damping"] = lines["friction"] = dynamics.line
            values["viscous"] = self._number(owner, dynamics, "damping", 0.0)
            values["coulomb"] = self._number(owner, dynamics, "friction", 0.0)
        mimic = self._only(owner, element, "mimic")
        if mimic is not None:
            lines["mimic"] = mimic.line
            self._number(owner, mimic, "multiplier", 1.0)
            self._number(owner, mimic, "offset", 0.0)
        if parent is None or child is None:
            return None
        return TreeJoint(
            joint=Joint(name=name, kind=kind, placement=placement, axis=direction, **values),
            parent=parent,
            child=child,
            mimic=None if mimic is None else mimic.get("joint") or "",
            line=element.line,
            lines=lines,
        )

    def _kind(self, owner: str, element: Element) -> JointKind:
        given = element.get("type")
        for kind in KINDS:
            if given == kind:
                return kind
        if given is None:
            text = f"it has no type; give it one of {', '.join(KINDS)}"
        else:
            text = str(unknown_name("URDF", "joint type", given, KINDS))
        self._problem(owner, "type", text, element.line)
        return "fixed"

    def _end(self, owner: str, element: Element, role: str) -> str | None:
        end = self._only(owner, element, role)
        link = None if end is None else end.get("link")
        if not link:
            what = f"<{role} link=...>"
            text = f"it has no {what}; a joint joins a parent link to a child link"
            self._problem(owner, role, text, element.line if end is None else end.line)
        return link or None

    def _limits(self, owner: str, name: str, kind: JointKind, limit: Element | None) -> dict[str, Any]:
        """Position, speed and effort limits; NaN where the joint should have one and the file gives none."""
        needed = math.nan if kind in ("revolute", "prismatic") else math.inf
        read: dict[str, Any] = {word: -needed if word == "lower" else needed for word in LIMITS}
        if limit is not None:
            read = {word: self._number(owner, limit, word, read[word], bounded=False) for word in LIMITS}
            if kind == "continuous":
                if "lower" in limit.attributes or "upper" in limit.attributes:
                    self._wrapping.append(name)
                read["lower"], read["upper"] = -math.inf, math.inf
        return read

    def _problem(self, owner: str, attribute: str, text: str, line: int) -> None:
        name = owner.partition("'")[2].removesuffix("'") or owner.partition(" ")[0]
        self._tree.problem(name, attribute, f"{owner}: {text}", line)

    def _refuse_macros(self, robot: Element) -> None:
        for element in (robot, *robot.children):
            if element.tag.startswith("xacro:"):
                text = f"<{element.tag}> is a macro; expand the file first: xacro MODEL.xacro > MODEL.urdf"
                self._problem(f"robot '{self._tree.name}'", element.tag, text, element.line)
                return

    def _check_words(self, owner: str, element: Element) -> None:
        for word, text, line in _slips(element):
            self._problem(owner, word, text, line)

    def _check_sizes(self, owner: str, element: Element) -> None:
        """Shapes are never needed to control an arm, but one of a negative size is a slip."""
        shapes = (*element.all("visual"), *element.all("collision"))
        bodies = [body for shape in shapes for geometry in shape.all("geometry") for body in geometry.children]
        sizes = {(tag, name): count for tag, counts in SIZES.items() for name, count in counts.items()}
        for body, ((tag, name), count) in itertools.product(bodies, sizes.items()):
            with suppress(BadNumberError):  # which is left out of what is drawn
                if body.tag == tag and min(numbers(body.get(name) or "", count)) < 0.0:
                    text = f"{name} of <{tag}> must be >= 0 [m]; got {body.get(name)}"
                    self._problem(owner, name, text, body.line)

    def _only(self, owner: str, element: Element, tag: str) -> Element | None:
        """The one child of that tag; a second one is a problem."""
        found = element.all(tag)
        for second in found[1:]:
            text = f"<{element.tag}> has two <{tag}> (the first in line {found[0].line}); delete one"
            self._problem(owner, tag, text, second.line)
        if not found:
            return None
        self._check_words(owner, found[0])
        return found[0]

    def _origin(self, owner: str, element: Element) -> Pose:
        origin = self._only(owner, element, "origin")
        if origin is None:
            return Pose.identity()
        zero = (0.0, 0.0, 0.0)
        return Pose(
            self._numbers(owner, origin, "xyz", zero),
            rpy=self._numbers(owner, origin, "rpy", zero),
        )

    def _number(self, owner: str, element: Element, attribute: str, default: float, **options: bool) -> float:
        return self._numbers(owner, element, attribute, (default,), **options)[0]

    def _numbers(
        self,
        owner: str,
        element: Element,
        attribute: str,
        default: tuple[float, ...],
        *,
        required: bool = False,
        bounded: bool = True,
    ) -> tuple[float, ...]:
        text = element.get(attribute)
        where = f"{attribute} of <{element.tag}>"
        if text is None:
            if required:
                self._problem(owner, attribute, f"<{element.tag}> has no {attribute}; give it one", element.line)
            return default
        try:
            return numbers(text, len(default), bounded=bounded)
        except BadNumberError as wrong:
            self._problem(owner, attribute, f"{where} {wrong}", element.line)
            # NaN stands for "missing"; what is there and wrong is reported once
            return tuple(math.copysign(math.inf, d) if math.isnan(d) else d for d in default)


# A vendor's own elements and attributes are fine; a misspelt known word, left out, would change the arm in silence.


def _slips(element: Element) -> Iterator[tuple[str, str, int]]:
    """(word, sentence, line) of likely misspellings, only where the known word itself is missing."""
    tags = {child.tag: child.line for child in element.children}
    for tag, line in tags.items():
        like = _meant(tag, ELEMENTS.get(element.tag, ()), tags)
        if like is not None:
            yield tag, f"<{element.tag}> has an unknown <{tag}>; did you mean <{like}>?", line
    if len(element.attributes) > MAX_ATTRIBUTES:
        return
    for attribute in element.attributes:
        like = _meant(attribute, ATTRIBUTES.get(element.tag, ()), element.attributes)
        if like is not None:
            text = f"<{element.tag}> has an unknown attribute '{attribute}'; did you mean '{like}'?"
            yield attribute, text, element.line


def _meant(word: str, known: tuple[str, ...], present: Container[str]) -> str | None:
    if word in known:
        return None
    close = [other for other in known if sorted(other) == sorted(word.lower())]  # xzy for xyz
    close = close or difflib.get_close_matches(word.lower(), known, n=1, cutoff=LIKE)
    return close[0] if close and close[0] not in present else None


# <transmission> of ROS, and Drake's rotor inertia; without one joint and one actuator it is left out with a note.


def _read_transmissions(robot: Element, tree: Tree) -> None:
    """Put gear ratios and rotor inertias into the joints of the tree; problems and notes too."""
    items = {item.name: item for item in tree.joints if item.joint.kind != "fixed"}
    found: dict[str, set[tuple[float, float]]] = {}
    coupled: list[str] = []
    for transmission in robot.all("transmission"):
        names = [end.get("name") or "".join(end.text).strip() for end in transmission.all("joint")]
        actuators = transmission.all("actuator")
        if len(names) != 1 or len(actuators) != 1:
            coupled += [name for name in names if name in items]
        elif names[0] in items:
            found.setdefault(names[0], set()).add(_gear_of(transmission, actuators[0], names[0], tree))
    several = [name for name, gears in found.items() if len(gears) > 1]
    for name, gears in found.items():
        if name not in several:
            ((ratio, rotor),) = gears
            items[name].joint = dataclasses.replace(items[name].joint, gear=ratio, rotor_inertia=ratio**2 * rotor)
    for names, text in ((coupled, "of several joints or motors"), (several, "that contradict each other")):
        if names:
            joints = quoted_list(dict.fromkeys(names))
            tree.notes.append(f"transmissions {text} are left out, with their gears, on {joints}")


def _gear_of(transmission: Element, actuator: Element, joint: str, tree: Tree) -> tuple[float, float]:
    """Gear ratio of one transmission, and the inertia of its rotor itself [kg m^2]."""
    ratio, rotor = 1.0, 0.0
    for place in (actuator, transmission):  # ROS 1 puts it into the actuator, the PR2 beside it
        for element in place.all(REDUCTION):
            ratio = abs(_transmission_number(element, "".join(element.text), joint, tree, ratio))
    for element in actuator.all(GEAR_RATIO):
        ratio = abs(_transmission_number(element, element.get("value"), joint, tree, ratio))
    for element in actuator.all(ROTOR_INERTIA):
        rotor = _transmission_number(element, element.get("value"), joint, tree, rotor)
    return ratio, rotor


def _transmission_number(element: Element, text: str | None, joint: str, tree: Tree, default: float) -> float:
    """A number of a transmission: a ratio is not zero, of either sign; an inertia is >= 0."""
    try:
        (value,) = numbers(text or "", 1)
        if element.tag == ROTOR_INERTIA and value < 0.0:
            raise BadNumberError(f"must be >= 0 [kg m^2]; got {value:g}")
        if element.tag != ROTOR_INERTIA and value == 0.0:
            raise BadNumberError("must not be 0: a gear has a ratio, and direct drive is 1")
    except BadNumberError as wrong:
        text = f"joint '{joint}': <{element.tag}> of its transmission {wrong}"
        tree.problem(joint, element.tag, text, element.line)
        return default
    return value
