"""Gears: what a joint sees of its motor's rotor, the ratio that matches it to the link, and numbers to doubt."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.checks import finite_array, require_range
from taut.base.errors import ShapeError, warn
from taut.base.types import ArrayLike, Float64Array

if TYPE_CHECKING:
    from taut.arm.description import Arm, Joint

__all__ = ["doubt_rotors", "matched_ratio", "reflected_inertia", "rotor_doubts"]

MOST_TIMES: Final = 100.0  # the largest inertia of links in the arm; a wrong unit is off by 1e3 to 1e7
MOST_ROTOR: Final = 1000.0  # [kg m^2] or [kg] seen at any joint
OTHER_UNIT: Final = "if it was given in kg cm^2, kg mm^2 or g cm^2: 1 kg m^2 is 1e4, 1e6 and 1e7 of these"


def reflected_inertia(ratio: ArrayLike, motor_inertia: ArrayLike) -> Float64Array:
    """What a joint sees of a rotor through its gear: ratio^2 motor_inertia [kg m^2 | kg].

    Law:  K = (I_link + G^2 I_motor) v^2 / 2, since the rotor turns G times as fast as the link

    Args:
        ratio: G, turns of the motor per turn of the joint; rad/m for a prismatic joint.
        motor_inertia: Of the rotor about its own axis [kg m^2].

    Raises:
        RangeError: A ratio that is not above zero, or a negative inertia.

    Example:
        A link of 1 kg m^2 with a rotor of 1e-3 kg m^2: in direct drive 99.9 % of the inertia is the link's; behind
        a gear of 100 the rotor is ten times the link.

        >>> round(100.0 / (1.0 + float(reflected_inertia(1.0, 1e-3))), 1)
        99.9
        >>> round(float(reflected_inertia(100.0, 1e-3)), 9)
        10.0

    References:
        Chapter, section 10.2.1.5 the effect of gearing.
    """
    G, rotor = _two("ratio", ratio, "motor_inertia", motor_inertia)
    require_range("ratio", G, above=0.0)
    require_range("motor_inertia", rotor, minimum=0.0, unit="kg m^2")
    return np.asarray(G**2 * rotor)


def matched_ratio(link_inertia: ArrayLike, motor_inertia: ArrayLike) -> Float64Array:
    """The gear ratio that gives the link half of the torque, and the most acceleration: sqrt(I_link / I_motor).

    Law:  a(G) = G tau / (I_link + G^2 I_motor) is largest where I_link = G^2 I_motor: inertia matched

    Args:
        link_inertia: About the joint's axis [kg m^2].
        motor_inertia: Of the rotor about its own axis [kg m^2].

    Raises:
        RangeError: An inertia that is not above zero.

    Example:
        >>> round(float(matched_ratio(1.0, 1e-3)), 2)
        31.62

    References:
        Chapter, section 10.2.1.5 the effect of gearing.
    """
    link, rotor = _two("link_inertia", link_inertia, "motor_inertia", motor_inertia)
    require_range("link_inertia", link, above=0.0, unit="kg m^2")
    require_range("motor_inertia", rotor, above=0.0, unit="kg m^2")
    return np.asarray(np.sqrt(link / rotor))


def _two(name: str, a: ArrayLike, other: str, b: ArrayLike) -> tuple[Float64Array, Float64Array]:
    first, second = finite_array(name, a), finite_array(other, b)
    try:
        np.broadcast_shapes(first.shape, second.shape)
    except ValueError as cause:
        raise ShapeError(
            f"{name} and {other} must be one number each or one per joint; got shapes {first.shape} and "
            f"{second.shape}",
            name=other,
        ) from cause
    return first, second


# -------------------------------------------------------------------- numbers to doubt


def rotor_doubts(arm: Arm) -> tuple[str, ...]:
    """What is hard to believe of the rotor inertias, in sentences; nothing of it is refused."""
    if not arm.rotor_inertia.any():
        return ()
    largest = _largest_link_inertia(arm)
    doubted = [
        joint
        for joint in arm.joints
        if joint.rotor_inertia > min(MOST_ROTOR, MOST_TIMES * largest[joint.kind == "prismatic"])
    ]
    return tuple(_doubt(joint, largest[joint.kind == "prismatic"]) for joint in doubted)


def doubt_rotors(arm: Arm) -> Arm:
    """The same arm, after a warning where its rotor inertias are hard to believe."""
    for text in rotor_doubts(arm):
        warn(text)
    return arm


def _doubt(joint: Joint, link: float) -> str:
    unit = "kg" if joint.kind == "prismatic" else "kg m^2"
    geared = f", gear {joint.gear:g}" if joint.gear != 1.0 else ""
    return (
        f"the rotor inertia of joint '{joint.name}', {joint.rotor_inertia:.4g} [{unit}] seen at the joint{geared}, "
        f"is hard to believe: no joint of its kind can see more than {link:.3g} [{unit}] of links; {OTHER_UNIT}"
    )


def _largest_link_inertia(arm: Arm) -> dict[bool, float]:
    """The most that links can weigh on any joint, by whether it is prismatic: an upper bound over all poses."""
    most = {True: 0.0, False: 0.0}
    for i, joint in enumerate(arm.joints):
        sliding = joint.kind == "prismatic"
        parts = [(mass, 0.0 if sliding else mass * far * far + moment) for mass, far, moment in _carried(arm, i)]
        most[sliding] = max(most[sliding], sum(mass if sliding else about for mass, about in parts))
    return most


def _carried(arm: Arm, i: int) -> Iterator[tuple[float, float, float]]:
    """Mass, largest distance from the joint's origin and largest principal moment of each body that joint i moves."""
    for k, body in enumerate(arm.bodies):
        path = arm.ancestors(k)
        if i not in path:
            continue
        far = float(np.linalg.norm(body.com))
        for j in path[path.index(i) + 1 :]:
            joint = arm.joints[j]
            far += float(np.linalg.norm(joint.placement.p))
            ends = (joint.lower, joint.upper) if joint.kind == "prismatic" else ()
            far += max((abs(end) for end in ends), default=0.0)
        yield body.mass, far, float(np.linalg.eigvalsh(body.inertia)[-1])
