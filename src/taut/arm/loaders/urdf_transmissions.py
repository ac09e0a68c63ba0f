"""Gears of a URDF: the <transmission> elements of ROS, and Drake's words for the rotor inertia.

A transmission that is not one joint and one actuator is no gear of a joint; it is left out and said.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from taut.arm.loaders.tree import Tree, TreeJoint
from taut.arm.loaders.xml import BadNumberError, Element, numbers
from taut.base.errors import quoted_list

__all__ = ["read_transmissions"]

RATIO: Final = "drake:gear_ratio"
ROTOR: Final = "drake:rotor_inertia"
REDUCTION: Final = "mechanicalReduction"


@dataclass(frozen=True, kw_only=True)
class Gear:
    """What one transmission says of one joint."""

    ratio: float
    rotor: float | None  # [kg m^2] of the rotor itself


def read_transmissions(robot: Element, tree: Tree) -> None:
    """Put gear ratios and rotor inertias into the joints of the tree; problems and notes too."""
    joints = {joint.name: joint for joint in tree.joints if joint.kind != "fixed"}
    found: dict[str, list[Gear]] = {}
    coupled: list[str] = []
    for transmission in robot.all("transmission"):
        names = [end.get("name") or "".join(end.text).strip() for end in transmission.all("joint")]
        actuators = transmission.all("actuator")
        if len(names) != 1 or len(actuators) != 1:
            coupled += [name for name in names if name in joints]
        elif names[0] in joints:
            found.setdefault(names[0], []).append(_gear(transmission, actuators[0], names[0], tree))
    several = []
    for name, gears in found.items():
        if len({(gear.ratio, gear.rotor) for gear in gears}) > 1:
            several.append(name)
        else:
            _put(joints[name], gears[0])
    tree.notes.extend(_notes(coupled, several))


def _put(joint: TreeJoint, gear: Gear) -> None:
    joint.gear = gear.ratio
    if gear.rotor is not None:
        joint.rotor_inertia = gear.ratio**2 * gear.rotor


def _notes(coupled: list[str], several: list[str]) -> Iterator[str]:
    if coupled:
        names = quoted_list(dict.fromkeys(coupled))
        yield f"transmissions of several joints or motors are left out, with their gears, on {names}"
    if several:
        yield f"transmissions that contradict each other are left out, with their gears, on {quoted_list(several)}"


def _gear(transmission: Element, actuator: Element, joint: str, tree: Tree) -> Gear:
    ratio = 1.0
    for place in (actuator, transmission):  # ROS 1 puts it into the actuator, the PR2 beside it
        for element in place.all(REDUCTION):
            ratio = abs(_number(element, "".join(element.text), joint, tree, 1.0, least=None))
    for element in actuator.all(RATIO):
        ratio = abs(_number(element, element.get("value"), joint, tree, 1.0, least=None))
    rotor = None
    for element in actuator.all(ROTOR):
        rotor = _number(element, element.get("value"), joint, tree, 0.0, least=0.0)
    return Gear(ratio=ratio, rotor=rotor)


def _number(
    element: Element, text: str | None, joint: str, tree: Tree, default: float, *, least: float | None
) -> float:
    """A number of a transmission: a ratio is not zero, of either sign; an inertia is >= 0."""
    try:
        (value,) = numbers(text or "", 1)
        if least is None and value == 0.0:
            raise BadNumberError("must not be 0: a gear has a ratio, and direct drive is 1")
        if least is not None and value < least:
            raise BadNumberError(f"must be >= 0 [kg m^2]; got {value:g}")
    except BadNumberError as wrong:
        tree.problem(
            joint, element.tag, f"joint '{joint}': <{element.tag}> of its transmission {wrong}", element.line
        )
        return default
    return value
