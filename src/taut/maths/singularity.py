"""Joint accelerations that are smooth through singularities and at the end of the reach, where an arm cannot follow.

Where J is singular its inverse asks for any speed and any torque. Only the direction that is nearly lost is damped,
and what it asks of the joints is limited to what they can do; elsewhere nothing changes. Targets that are certainly
out of reach lie outside of a sphere which a point of the tool can never leave; within all of them is no proof of
reach.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from taut.arm.description import Arm
from taut.arm.reach import reach
from taut.base.types import Array, Float64Array, Matrix, Vector, Vector3
from taut.maths.model import Chain, Model
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import least_direction
from taut.trace import math as tm
from taut.trace.linalg import factor_spd

BORDER: Final = 0.1  # smallest singular value of J under which an arm of 0.9 m and more is near a singularity
DAMPING_AT_SINGULARITY: Final = 0.1  # lambda at the singularity, as a fraction of the limit of manipulability
SHARE: Final = 0.1  # of the torque that gravity and Coriolis forces leave: what motion may use near a singularity
TOP_SPEED: Final = 0.97  # of a joint's limit
LEAST_ROOM: Final = 0.05  # of the effort: what is taken to be left where gravity takes all of it
FULL: Final = 0.9  # of that limit: where limits act in full
STEEP: Final = 0.5  # of that limit: where damping acts in full
LEAST_CUT: Final = 1e-9  # of what is asked: the tolerance of a cut
TINY: Final = 1e-12  # keeps the pivots of what is to be inverted from zero
ENDLESS: Final = 1.4  # [m] reach of an arm whose slides have no ends
CLEAR: Final = (1.0, 1.01)  # of a radius: where a target begins to count as out of reach, and where in full
FAR: Final = (1.1, 1.2)
PARALLEL: Final = 1e-6  # of the sine between two axes

Asked = Literal["pose", "position"]


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """What an arm's reach says about its tasks."""

    border: float  # of the smallest singular value of J, in m and rad
    length: float  # [m/rad] how a rotation weighs against a way, in what is given up


@functools.lru_cache(maxsize=64)
def sizes_of(arm: Arm) -> Sizes:
    """Border and length of an arm: 0.1, less where it reaches less than 0.9 m, and about a third of its reach."""
    longest = reach(arm)
    if not 0.0 < longest < np.inf:
        longest = ENDLESS
    return Sizes(border=BORDER * min(1.0, longest / 0.9), length=0.36 * longest)


@dataclass(frozen=True, kw_only=True, eq=False)
class ResolvedMotion:
    """What the joints do for a task."""

    accelerations: Vector  # (n,) of the joints, before `scale` [rad/s^2 | m/s^2]
    of: Callable[[Vector], Vector]  # (n,) what a part (k,) of the task's acceleration has in them: a linear map
    scale: Any  # of the torque of motion; 1 away from singularities
    lost: Any  # 0 to 1: how much of the nearly lost direction is given up
    held: Any  # memory: how far the limits of a singularity still act
    project: Callable[[Vector], Vector]  # (n,) N^T tau, which does not move the task; none near


def resolve(
    x: Snapshot,  # at the measured state
    J: Matrix,  # (k, n) of the task
    a: Vector,  # (k,) task acceleration less J-dot v
    *,
    rate: Any,  # k [1/s] of joints that the task does not move: the damping of the task
    held: Any,  # memory, zero at the start
    beyond: Any = 0.0,  # 0 to 1: how clearly the target is out of reach
    damping: Any = DAMPING_AT_SINGULARITY,  # lambda at the singularity, as a fraction of the limit of manipulability
    share: Any = SHARE,  # of the torque that h leaves, for motion near a singularity
) -> ResolvedMotion:
    """Joint accelerations for a task acceleration: J^# a away from singularities, and smooth through them.

    Law:          v_c = v_g + rho v_u,  v_g + v_u = v + (J_d^# (a + k J v) - k v) / k,  q_ddot = s k (c v_c - v)
                  J^# = M^-1 J^T Lambda for n > k joints; for n <= k the least-squares inverse (J^T W J)^-1 J^T W,
                    W weighing a rotation against a displacement with a third of the arm's reach
                  J_d^# the same, damped by lambda^2 along the one direction in which J moves least
                  v_u   what that direction asks of the joints; rho <= 1 leaves of it what their speed limits allow
                  c <= 1 brings the rest within the speed limits, s <= 1 the torque of motion M q_ddot within `share`
                    of what h leaves of the effort
                  lambda = 0 and rho = c = s = 1 where J moves everything by more than that limit: q_ddot = J^# a.
                    rho, c and s act on until nothing is left to cut: what a singularity leaves behind is worked off
                    within the limits. They act too while the target is `beyond` reach, on the way to the singularity
                    at which that ends
    Closed loop:  near a singularity v follows v_c at the rate k, so that no joint gets faster than its limit, and
                  motion in the lost direction dies out at the rate k; what is given up is along that direction only
                  N^T tau_0 fades out towards a singularity, where the rate k takes its place

    References:
        Nakamura and Hanafusa (1986), ASME J. Dynamic Systems 108. Chiaverini (1997), IEEE Transactions on Robotics
        and Automation 13 (3).
    """
    (k, n), arm, size = J.shape, x.arm, sizes_of(x.arm)
    wide = n > k
    weight = np.ones(k)
    if k == 6:
        weight[3:] = size.length**2
    if wide:
        half, side = x.M_factors.half(J.T), np.eye(k)
        u, square = least_direction(J)  # the square is not under that of the least singular value, whatever u is
        r = u / weight
        r = r / (u @ r)
        loose = TINY * _ramp(square, size.border, STEEP * size.border)
        factors = factor_spd(half.T @ x.M_factors.weighed(half) + loose * tm.eye(k))
    else:
        side = (weight[:, None] * J).T
        factors = factor_spd(side @ J + TINY * tm.eye(n))
        u, _ = factors.least_direction()
        r, moved = u, J @ u
        square = moved @ moved
    z = factors.solve(r)
    inside = r @ z
    scale = 1.0 / (inside * (square + TINY)) if wide else 1.0  # from the kinetic to the kinematic measure
    extra = scale * _ramp(square, size.border, STEEP * size.border) * (damping * size.border) ** 2
    kept = 1.0 / (1.0 + extra * inside)
    near = tm.maximum(tm.maximum(held, beyond), _ramp(square, size.border, FULL * size.border))

    def back(y: Vector) -> Vector:
        return x.M_factors.other_half(half @ y) if wide else y

    lost_way = back(z) * kept

    def along(b: Vector) -> Any:
        return u @ (b if wide else side @ b)

    def solved(b: Vector) -> Vector:
        y = factors.solve(b)
        out: Vector = y - z * (extra * kept * (r @ y))
        return out

    def damped(b: Vector) -> Vector:
        return back(solved(b if wide else side @ b))

    smooth = (
        near if wide else 1.0
    )  # the motion that a task of fewer directions leaves free is damped near singularities
    asked = a + (smooth * rate) * (J @ x.v)
    target = damped(asked)
    if wide:
        target = target + ((1.0 - near) * rate) * x.v
    part = lost_way * along(asked)
    rho, slow = _within(part, target - part, TOP_SPEED * rate, arm.velocity)
    given_up = near * (1.0 - rho)
    slowed = 1.0 - near * (1.0 - slow)
    accelerations = slowed * (target - given_up * part) - rate * x.v
    use = _use(x.M @ accelerations, x.h, arm.effort, share)

    def of(b: Vector) -> Vector:
        out: Vector = slowed * (damped(b) - lost_way * (given_up * along(b)))
        return out

    def project(tau: Vector) -> Vector:
        if wide:
            moving = J.T @ solved(half.T @ x.M_factors.weighed(x.M_factors.half(tau)))
        else:
            moving = x.M @ damped(J @ x.M_factors.solve(tau))
        out: Vector = (1.0 - near) * (tau - moving)
        return out

    return ResolvedMotion(
        accelerations=accelerations,
        of=of,
        scale=1.0 - near * (1.0 - use),
        lost=1.0 - kept * (1.0 - given_up),
        held=near * tm.minimum((1.0 - tm.minimum(tm.minimum(rho, slow), use)) * (1.0 / LEAST_CUT), 1.0),
        project=project,
    )


def _ramp(square: Any, start: float, full: float) -> Any:
    """0 where a square is that of `start`, 1 where it is that of `full` or beyond, smooth between."""
    s = tm.clip((square - start**2) * (1.0 / (full**2 - start**2)), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


def _within(part: Vector, other: Vector, scale: Any, velocity: Float64Array) -> tuple[Any, Any]:
    """The largest rho <= 1 that keeps |other + rho part| within limits, and the factor that brings the sum there."""
    joints = [i for i, top in enumerate(velocity) if np.isfinite(top)]
    # (limit - other sign(part)) / |part|, without a jump where part changes its sign
    shares = [1.0]
    for i in joints:
        room = scale * velocity[i] * tm.abs(part[i]) - other[i] * part[i]
        shares.append((room + TINY) / (part[i] * part[i] + TINY * TINY))
    rho = tm.maximum(0.0, _folded(tm.minimum, shares))
    sizes = [tm.abs(other[i] + rho * part[i]) * (1.0 / velocity[i]) for i in joints]
    return rho, scale / _folded(tm.maximum, [scale, *sizes])


def _use(tau: Vector, h: Vector, effort: Float64Array, share: Any) -> Any:
    """The factor <= 1 that brings torques of motion within a share of what h leaves of the effort."""
    joints = [i for i, most in enumerate(effort) if np.isfinite(most)]
    rooms = [tm.maximum(effort[i] - tm.abs(h[i]), LEAST_ROOM * effort[i]) for i in joints]
    most = _folded(tm.maximum, [share, *(tm.abs(tau[i]) / room for i, room in zip(joints, rooms, strict=True))])
    return share / most


def _folded(pick: Callable[[Any, Any], Any], values: list[Any]) -> Any:
    """The smallest or largest of some numbers, by pairs: short chains are fast."""
    while len(values) > 1:
        pairs = [pick(a, b) for a, b in zip(values[::2], values[1::2], strict=False)]
        values = pairs + values[len(pairs) * 2 :]
    return values[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere:
    """Where a point of the tool can be, whatever the joints do within their limits."""

    centre: Float64Array  # (3,) origin of the first joint on the chain, in the world [m]
    point: Float64Array  # (3,) in the tool's frame [m]
    radius: float  # [m]


@functools.lru_cache(maxsize=64)
def spheres(model: Model, frame: str | None, asked: Asked) -> tuple[Sphere, ...]:
    """Of the tool's origin and, for a pose, of the last axis' point nearest to the axis before (wrist centre)."""
    chain = Chain.of(model, frame)
    if not chain.links:
        return ()
    points = [np.zeros(3)]
    if asked == "pose" and len(chain.links) > 1 and not chain.links[-1].prismatic:
        points.append(chain.R.T @ (_nearest_to_axis_before(chain) - chain.p))
    centre = chain.p_WB + chain.R_WB @ chain.links[0].p
    found = [Sphere(centre=centre, point=p, radius=reach(model.arm, chain.frame, p)) for p in points]
    return tuple(sphere for sphere in found if 0.0 < sphere.radius < np.inf)


def _nearest_to_axis_before(chain: Chain) -> Float64Array:
    """(3,) the point of the last axis that is nearest to the one before, in the last link's own frame."""
    last = chain.links[-1]
    if chain.links[-2].prismatic:
        return np.zeros(3)
    axis, origin = last.R[2], -last.R.T @ last.p  # of the joint before
    away = 1.0 - axis[2] ** 2
    along = 0.0 if away < PARALLEL**2 else (origin[2] - axis[2] * (origin @ axis)) / away
    return np.array([0.0, 0.0, along])


@dataclass(frozen=True, kw_only=True, eq=False)
class Beyond:
    """How clearly a target is out of reach: 0 where it is within all spheres, 1 where it is clearly not."""

    clear: Any  # full from a hundredth of a radius outside of one on
    far: Any  # none up to a tenth outside, full from a fifth on
    reach: float  # [m] of the tool's origin

    @classmethod
    def of(cls, all_of: tuple[Sphere, ...], p: Vector3, R: Array) -> Self:
        past: Any = 1.0
        for sphere in all_of:
            way = p + R @ sphere.point - sphere.centre if sphere.point.any() else p - sphere.centre
            past = tm.maximum(past, (way @ way) * (1.0 / sphere.radius**2))
        return cls(clear=_ramp(past, *CLEAR), far=_ramp(past, *FAR), reach=all_of[0].radius)


def distance_beyond(of: tuple[Sphere, ...], p: Float64Array, R: Float64Array) -> Float64Array:
    """(k,) how far at least poses p (k, 3), R (k, 3, 3) are out of reach [m]; 0 and less where nothing says so."""
    ways = [np.linalg.norm(p + R @ s.point - s.centre, axis=1) - s.radius for s in of]
    return np.max(ways, axis=0) if ways else np.full(len(p), -np.inf)
