"""The forces against the rows of a constraint: what is asked for, whether it is met, and what cannot be borne."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base.types import Float64Array, Vector
from taut.control.laws.force import misses
from taut.control.trajectories.hybrid_motion import HybridMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.rows import ConstraintRows
from taut.trace import math as tm

__all__ = ["asked_multipliers", "braking", "gentler", "missed", "of_wrench", "per_row", "swung"]

UNBORNE: Final = 0.01  # of a wrench, outside the range of A^T, is told
PULL: Final = 1e-6  # [N, N m] of a multiplier that is no rounding
GENTLE: Final = 2.0  # times what counts as contact, with which a surface that was lost is still pressed for
BRAKING: Final = 0.02  # [s] in which motion against a surface that was lost is braked
SWINGS: Final = 4  # ticks in which the error of a force turns round, one after the other, before that is told


def per_row(constraint: Constraint, pair: tuple[float, float]) -> Float64Array:
    """(k,) the first number for each row that is a force, the second one for each that is a moment."""
    return np.where(constraint.moments, pair[1], pair[0])


def of_wrench(rows: ConstraintRows, F_app: Vector) -> Vector:
    """(k,) the multipliers of a wrench of the arm on the environment: (A A^T)^-1 A F_app."""
    assert rows.A is not None
    out: Vector = rows.factors.solve(rows.A @ F_app)
    return out


def asked_multipliers(constraint: Constraint, rows: ConstraintRows, ref: HybridMotion) -> tuple[Vector, Any]:
    """(k,) the multipliers that are asked for, and 1 where some of it cannot be borne, else 0.

    What cannot be borne is not in them: press where the first row is no surface, a part of F_app outside the range of
    A^T. A pull at a contact is told too.
    """
    k, F = rows.count, ref.F_app
    lam: Vector = ref.lam[:k]
    unborne: Any = (ref.given[0] > 0.5) & (tm.abs(ref.given[0] - float(k)) > 0.5)
    if rows.A is None:
        unborne = unborne | (ref.press[0] > 0.0) | (F @ F > 0.0)
    else:
        along = rows.A @ F
        held = rows.factors.solve(along)
        unborne = unborne | (along @ held < (1.0 - UNBORNE * UNBORNE) * (F @ F))
        lam = lam + held
        if constraint.surface:
            gradient = rows.A[0, :3]
            lam = lam + tm.array([-ref.press[0] / tm.sqrt(gradient @ gradient + 1e-24), *([0.0] * (k - 1))])
        else:
            unborne = unborne | (ref.press[0] > 0.0)
    for row in _contacts(rows):
        unborne = unborne | (lam[row] > PULL)
    return lam, tm.where(unborne, 1.0, 0.0)


def missed(rows: ConstraintRows, wanted: Vector, measured: Vector, least: Vector) -> list[Any]:
    """(k,) of each row, 1 where a contact is pressed and does not bear it, else 0: what holds both ways is there."""
    out: list[Any] = [0.0] * rows.count
    for row in _contacts(rows):
        out[row] = misses(-wanted[row], measured[row] * wanted[row], least[row])
    return out


def gentler(rows: ConstraintRows, lam: Vector, share: Vector, least: Vector) -> Vector:
    """(k,) multipliers of which a contact that misses has its share: with none it is pressed for gently."""
    out = list(lam)
    for row in _contacts(rows):
        soft = tm.maximum(lam[row], -GENTLE * least[row])
        out[row] = soft + share[row] * (lam[row] - soft)
    return tm.array(out)


def braking(rows: ConstraintRows, rate: Vector, share: Vector, dt: Any) -> Vector:
    """(k,) the rate of `rate` that brakes motion against contacts, as far as they miss; stable at any period."""
    out: list[Any] = [0.0] * rows.count
    for row in _contacts(rows):
        out[row] = (share[row] - 1.0) * rate[row] / (BRAKING + dt)
    return tm.array(out)


def swung(e: Vector, last: Vector, turned: Any, least: Vector) -> dict[str, object]:
    """Memory: the error, in how many ticks it has turned round one after the other, and 1 where those are many."""
    round_: Any = -np.inf
    for old, new, size in zip(last, e, least, strict=True):
        round_ = tm.maximum(round_, -old * new - size * size)
    turned = tm.where(round_ > 0.0, turned + 1.0, 0.0)
    return {"e_last": e, "reversals": turned, "swings": tm.where(turned > SWINGS - 0.5, 1.0, 0.0)}


def _contacts(rows: ConstraintRows) -> list[int]:
    return [row for row, side in enumerate(rows.one_sided) if side]
