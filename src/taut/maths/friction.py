"""Dry friction of coupled joints, with real sticking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.types import Vector
from taut.trace import math as tm
from taut.trace.linalg import LTDL

__all__ = ["SWEEPS", "DryFriction", "dry_friction"]

REST: Final = 1e-12  # [rad/s | m/s] of a joint that friction holds is rounding: it rests, and sgn(v) is 0
SWEEPS: Final = 6  # of projected Gauss-Seidel, half of them before the joints that are held are solved for exactly


@dataclass(frozen=True, kw_only=True)
class DryFriction:
    """What dry friction does in one step."""

    v: Vector  # (n,) velocities after it
    f: Vector  # (n,) its torques [N m | N]; zero for joints without any
    at_rest: Vector  # (n,) 1.0 for the joints that it holds, else 0.0
    residual: Any  # largest torque by which a further sweep would change it [N m | N]


def dry_friction(
    factors: LTDL,
    v_free: Vector,
    low: Vector,
    high: Vector,
    guess: Vector,
    dt: Any,
    *,
    joints: Sequence[int],
    stop: Vector | None = None,
    sweeps: int = SWEEPS,
) -> DryFriction:
    """Velocities after dry friction, and the friction torques that give them.

    A joint sticks at zero velocity as long as the torque for that stays within its limits; else it slips under the
    full limit. For coupled joints this is a complementarity problem in the velocities,

        v = v_free + dt M^-1 f
        f_i = -low_i where v_i > 0,   f_i = high_i where v_i < 0,   -low_i <= f_i <= high_i where v_i = 0

    solved by a fixed number of projected Gauss-Seidel sweeps, so that it is straight-line code. Where friction can
    stop every joint at once it does, exactly and from the first step on; else the sweeps start from the last step's
    torques. Half of them find which joints are held; these are then solved for together, exactly, and the other half
    puts right what that moved.

    Args:
        factors: Factors of the mass matrix (with implicit damping, if any).
        v_free: (n,) velocities that the step would give without dry friction.
        low: (n,) largest friction against motion in the positive direction [N m | N].
        high: (n,) the same against motion in the negative direction.
        guess: (n,) friction torques of the last step.
        dt: Length of the step [s].
        joints: Indices of the joints that have dry friction.
        stop: (n,) friction torques that would stop all n joints in this step, where all have dry friction and the
            torques are at hand; else they are computed.
        sweeps: Number of sweeps.
    """
    n, k = len(low), len(joints)
    W = factors.inverse()
    response = [[W[i, j] for j in joints] for i in joints]
    inverse = [1.0 / response[a][a] for a in range(k)]
    # In impulses p = dt f: p_a = c_a - sum of R_ab p_b brings joint a to rest, the others held.
    c = [-v_free[i] * inverse[a] for a, i in enumerate(joints)]
    R = [[response[a][b] * inverse[a] for b in range(k)] for a in range(k)]
    least, most = [-low[i] * dt for i in joints], [high[i] * dt for i in joints]
    if stop is not None and k == n:
        halt = [stop[i] * dt for i in joints]
    else:
        halt = list(tm.solve_spd(tm.array(response), -tm.array([v_free[i] for i in joints])))
    within = tm.array([(halt[a] >= least[a]) & (halt[a] <= most[a]) for a in range(k)])
    all_stop = np.all(within)
    p = [_within(tm.where(all_stop, halt[a], guess[i] * dt), least[a], most[a]) for a, i in enumerate(joints)]

    def stopping(a: int) -> Any:
        """The impulse that brings joint a to rest."""
        # The newest one comes last: only its product waits for the one before.
        total = c[a]
        for b in (*range(a + 1, k), *range(a)):
            total = total - R[a][b] * p[b]
        return total

    def sweep(count: int) -> None:
        for _ in range(count):
            for a in range(k):
                p[a] = _within(stopping(a), least[a], most[a])

    if k == 1:
        sweep(1)
    else:
        sweep(sweeps // 2)
        p = [
            _within(x, least[a], most[a])
            for a, x in enumerate(_held_exactly(response, joints, v_free, p, least, most))
        ]
        sweep(sweeps - sweeps // 2)
    v, f, at_rest = list(v_free), [0.0] * n, [0.0] * n
    residual: Any = 0.0
    for a, i in enumerate(joints):
        # What is left to rest is the velocity; of a joint that friction holds it is rounding.
        total = stopping(a)
        held = (p[a] > least[a]) & (p[a] < most[a])
        v[i] = response[a][a] * (p[a] - total)
        v[i] = tm.where(held & (tm.abs(v[i]) < REST), 0.0, v[i])
        at_rest[i] = tm.where(held, 1.0, 0.0)
        f[i] = p[a] / dt
        if k > 1:
            residual = tm.maximum(residual, tm.abs(_within(total, least[a], most[a]) - p[a]))
    for i in set(range(n)) - set(joints):
        for a, j in enumerate(joints):
            v[i] = v[i] + W[i, j] * p[a]
    return DryFriction(v=tm.array(v), f=tm.array(f), at_rest=tm.array(at_rest), residual=residual / dt)


def _held_exactly(
    response: list[list[Any]], joints: Sequence[int], v_free: Vector, p: list[Any], least: list[Any], most: list[Any]
) -> list[Any]:
    """Impulses that bring all joints to rest which are within their limits now, the others staying at theirs."""
    k = len(p)
    held = [tm.where((p[a] > least[a]) & (p[a] < most[a]), 1.0, 0.0) for a in range(k)]
    slipping = [p[a] - held[a] * p[a] for a in range(k)]
    A: list[list[Any]] = [[0.0] * k for _ in range(k)]
    rhs = []
    for a, i in enumerate(joints):
        total = v_free[i]
        for b in range(k):
            total = total + response[a][b] * slipping[b]
        for b in range(a):
            A[a][b] = A[b][a] = held[a] * held[b] * response[a][b]
        A[a][a] = tm.where(held[a] > 0.5, response[a][a], 1.0)
        rhs.append(tm.where(held[a] > 0.5, -total, p[a]))
    return list(tm.solve_spd(tm.array(A), tm.array(rhs)))


def _within(x: Any, least: Any, most: Any) -> Any:
    """x within its bounds, in two instructions; `clip` heeds the sign of zero too, and takes three times as long."""
    return tm.where(x < least, least, tm.where(x > most, most, x))
