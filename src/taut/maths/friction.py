"""Joint friction of a plant, with real sticking."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base import math as tm
from taut.base.linalg import LTDL
from taut.base.types import Vector

__all__ = ["SWEEPS", "dry_friction"]

SWEEPS: Final = 10  # of projected Gauss-Seidel; started from the last step's forces they converge along the way


def dry_friction(
    factors: LTDL, v_free: Vector, limit: Vector, guess: Vector, stop: Vector, dt: Any, sweeps: int = SWEEPS
) -> tuple[Vector, Vector]:
    """(n,) velocities after dry friction, and (n,) the friction torques that give them.

    A joint sticks at zero velocity as long as the torque for that stays within its limit; else it slips under the
    full limit. For coupled joints this is a complementarity problem in the velocities,

        v = v_free + dt M^-1 f,   f_i = -mu_i sgn(v_i) where v_i != 0,   |f_i| <= mu_i where v_i = 0,

    solved by a fixed number of projected Gauss-Seidel sweeps, so that it is straight-line code. Where friction can
    stop every joint at once it does, exactly and from the first step on; else the sweeps start from the last step's
    torques.

    Args:
        factors: Factors of the mass matrix (with implicit damping, if any).
        v_free: (n,) velocities that the step would give without dry friction.
        limit: (n,) dry friction [N m | N].
        guess: (n,) friction torques of the last step.
        stop: (n,) friction torques that would stop every joint within this step.
        dt: Length of the step [s].
        sweeps: Number of sweeps.
    """
    n = len(limit)
    response = dt * factors.solve(np.eye(n))
    start = tm.where(np.all(tm.abs(stop) <= limit), stop, guess)
    f = [tm.clip(start[i], -limit[i], limit[i]) for i in range(n)]
    v = v_free + response @ tm.array(f)
    for _ in range(sweeps):
        for i in range(n):
            new = tm.clip(f[i] - v[i] / response[i, i], -limit[i], limit[i])
            v = v + response[:, i] * (new - f[i])
            f[i] = new
    return v, tm.array(f)
