"""Angles: the short way from one to another, and degrees recognised by what a joint can reach."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Array, Float64Array
from taut.trace import math as tm

if TYPE_CHECKING:
    from taut.arm.description import Arm

__all__ = ["require_radians", "short_way"]

TURN: Final = 2.0 * math.pi


def short_way(delta: Array, continuous: Sequence[int]) -> Array:
    """Differences of joint positions (..., n); those of continuous joints wrap to [-pi, pi). Floats or symbols."""
    if not continuous:
        return delta
    short, columns = tm.array(delta), list(continuous)
    angle = short[..., columns]
    short[..., columns] = angle - TURN * tm.floor((angle + math.pi) / TURN)
    return short


def require_radians(name: str, q: Float64Array, arm: Arm) -> None:
    """Refuse joint positions that lie more than a whole turn beyond a joint's limits.

    A hinge with limits cannot be there, and no motion that is meant for it has a reason to go there: these are
    degrees. A joint without limits may be anywhere.

    Args:
        name: What the positions are called in the message.
        q: (n,) or (k, n) joint positions [rad | m].
        arm: The arm that has the limits.

    Raises:
        RangeError: An angle that looks like degrees.
    """
    hinge = np.array([unit == "rad" for unit in arm.units])
    far = hinge & ((q < arm.lower - TURN) | (q > arm.upper + TURN))
    if not far.any():
        return
    *_, joint = index = [int(i) for i in np.argwhere(far)[0]]
    angle, who = float(q[tuple(index)]), arm.joint_names[joint]
    raise RangeError(
        f"{name}[{joint}] (joint '{who}') must be an angle in radians; got {angle:g}, and the joint turns from "
        f"{arm.lower[joint]:.4g} to {arm.upper[joint]:.4g} rad; if it is in degrees, np.radians(...) converts it",
        name=name,
        joint=who,
        value=angle,
        rule="radians",
    )
