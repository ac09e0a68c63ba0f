"""Angles in degrees, told from angles in radians by what a joint can reach."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import RangeError
from taut.base.types import Float64Array

__all__ = ["require_radians"]

TURN: Final = 2.0 * math.pi


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
