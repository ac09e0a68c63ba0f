"""Dampers of a sampled loop: of the tool, and of motion against a constraint."""

from __future__ import annotations

from typing import Any

from taut.base.types import Matrix, Vector
from taut.trace import math as tm

__all__ = ["damping_force"]


def damping_force(kdamp: Matrix, mobility: Matrix, rate: Vector, dt: Any) -> Vector:
    """(k,) D y of a damper kdamp on y, with D = (kdamp^-1 + dt mobility)^-1 = (I + kdamp mobility dt)^-1 kdamp.

    It is kdamp times the y that this force alone leaves when the tick ends. Held over a tick, kdamp y itself reverses
    what is light, such as a last link about its own axis, and diverges where kdamp mobility dt > 2; the eigenvalues
    of D mobility dt are in [0, 1) for any kdamp.

    Args:
        kdamp: (k, k) symmetric, positive semidefinite.
        mobility: (k, k) by which a force accelerates y: J M^-1 J^T, symmetric, positive semidefinite.
        rate: (k,) y.
        dt: Control period [s].
    """
    out: Vector = tm.solve(tm.eye(len(mobility)) + dt * (kdamp @ mobility), kdamp @ rate)
    return out
