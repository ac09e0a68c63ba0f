"""Through singularities: the joint accelerations that a task asks for, calm where the arm cannot follow.

Where J loses rank, the inverse asks for any speed and any torque. Here only the direction that is nearly lost is
damped, what it asks of the joints is held within what the joints can do, and away from singularities nothing is changed.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.reach import reach
from taut.base import math as tm
from taut.base.linalg import factor_spd
from taut.base.types import Float64Array, Matrix, Vector
from taut.maths.snapshot import Snapshot

__all__ = ["BORDER", "DAMPING", "SHARE", "Resolved", "resolve", "singular_border"]

BORDER: Final = 0.1  # smallest singular value of J below which an arm of human size is near a singularity
DAMPING: Final = 0.1  # lambda, in parts of the border
SHARE: Final = 0.1  # of the torque that gravity and Coriolis forces leave, which motion may use near a singularity
TOP_SPEED: Final = 0.97  # of a joint's limit
TINY: Final = 1e-10  # of the largest eigenvalues: keeps pivots from zero
FULL: Final = 0.9  # of the border, where limits act in full
LEAST_ROOM: Final = 0.05  # of the effort, where gravity takes all of it
STEEP: Final = 0.5  # of the border, where damping acts in full


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """What the lengths of an arm say about a task: its border, and how rotations weigh against positions."""

    border: float
    length: float  # [m/rad]


@functools.lru_cache(maxsize=64)
def sizes(arm: Arm) -> Sizes:
    """Lengths of an arm, from its reach; those of an arm of 1.4 m if it has no end."""
    r = reach(arm)
    r = 1.4 if not np.isfinite(r) or r <= 0.0 else r
    return Sizes(border=BORDER * min(1.0, r / 0.9), length=0.36 * r)


def singular_border(arm: Arm) -> float:
    """The smallest singular value of J [m, rad per unit of the joints] under which `resolve` may act."""
    return sizes(arm).border


@dataclass(frozen=True, kw_only=True, eq=False)
class Resolved:
    """What the joints do for a task: accelerations, a linear map of the task's, and what becomes of the torque."""

    total: Vector  # (n,) accelerations of the joints, before `scale` [rad/s^2 | m/s^2]
    scale: Any  # of the torque of motion; 1 away from singularities
    lost: Any  # 0 to 1: how much of the nearly lost direction is taken
    held: Any  # memory: how much of the limits still acts
    share_of: Callable[[Vector], Vector]  # (n,) what a task acceleration (k,) has in `total`
    M: Matrix
    project_acceleration: Callable[[Vector], Vector]

    def torque(self, accelerations: Any) -> Any:
        """(n,) torques for accelerations of the joints, or named terms of them that add up to `total`."""
        return self.scale * (self.M @ accelerations)


def resolve(
    x: Snapshot,
    J: Matrix,
    a: Vector,
    *,
    rate: Any,
    held: Any,
    damping: Any = DAMPING,
    share: Any = SHARE,
) -> Resolved:
    """..."""
    k, n = J.shape
    size, v, arm = sizes(x.arm), x.v, x.arm
    weight = np.ones(k)
    if k == 6:
        weight[3:] = size.length**2
    wide = n > k
    if wide:
        back = x.M_factors.solve(J.T)
        factors = factor_spd(J @ back + TINY * tm.eye(k))
        u = factor_spd(J @ J.T + TINY * tm.eye(k)).least_direction()
        moved = J.T @ u
        r = u / weight
        r = r / (u @ r)
    else:
        side = (weight[:, None] * J).T
        factors = factor_spd(side @ J + TINY * tm.eye(n))
        r = factors.least_direction()
        moved = J @ r

    solve = factors.solve
    z = solve(r)
    inside = r @ z
    plain = moved @ moved
    ratio = 1.0 / (inside * (plain + TINY)) if wide else 1.0
    lam2 = ratio * _ramp(plain, size.border, STEEP) * (damping * size.border) ** 2
    f = 1.0 / (1.0 + lam2 * inside)
    near = tm.maximum(held, _ramp(plain, size.border, FULL))
    lost_motion = (back @ z if wide else z) * f

    def along(b: Vector) -> Any:  # of the least direction
        return u @ b if wide else r @ (side @ b)

    def damped(b: Vector) -> Vector:
        y = solve(b if wide else side @ b)
        y = y - z * (lam2 * f * (r @ y))
        return back @ y if wide else y

    asked = a + (near if wide else 1.0) * rate * (J @ v)
    part = lost_motion * along(asked)
    target = damped(asked)
    if wide:
        target = target + ((1.0 - near) * rate) * v
    limit = TOP_SPEED * rate * arm.velocity
    other = target - part
    rho: Any = 1.0
    bounded = [i for i in range(n) if np.isfinite(arm.velocity[i])]
    for i in bounded:
        room = limit[i] - tm.where(part[i] > 0.0, other[i], -other[i])
        rho = tm.minimum(rho, tm.maximum(room, 0.0) / (tm.abs(part[i]) + 1e-9))
    wanted = other + rho * part
    most: Any = 1.0
    for i in bounded:
        most = tm.maximum(most, tm.abs(wanted[i]) / limit[i])
    rest = near * (1.0 - rho)
    slow = 1.0 - near * (1.0 - 1.0 / most)
    total = slow * (target - rest * part) - rate * v
    tau, use = x.M @ total, 1.0
    for i in range(n):
        if np.isfinite(arm.effort[i]):
            room = tm.maximum(arm.effort[i] - tm.abs(x.h[i]), LEAST_ROOM * arm.effort[i]) * share
            use = tm.minimum(use, room / (tm.abs(tau[i]) + 1e-9))
    cutting = tm.minimum(tm.minimum(rho, 1.0 / most), use) < 1.0

    def share_of(b: Vector) -> Vector:
        return slow * (damped(b) - lost_motion * (rest * along(b)))

    return Resolved(
        total=total,
        scale=1.0 - near * (1.0 - use),
        lost=1.0 - f,
        held=tm.where(cutting, near, 0.0),
        share_of=share_of,
        M=x.M,
        project_acceleration=lambda b: b - damped(J @ b),
    )


def _ramp(square: Any, border: float, full: float) -> Any:
    """0 where the square of a singular value is above border^2, 1 below (full border)^2, smooth between."""
    top = border * border
    s = tm.clip((top - square) / ((1.0 - full * full) * top), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)
