"""What dry friction does to a motion: how long a joint rests that should move, how far it is off where it turns."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.types import Float64Array

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["MOVING", "RESTING", "reversal_error", "stuck"]

RESTING: Final = 1e-4  # [rad/s | m/s] a joint that is slower than this rests
MOVING: Final = 1e-3  # [rad/s | m/s] a reference that is faster than this moves


def stuck(run: Run) -> Float64Array | None:
    """(k, n) 1.0 where a joint rests (|v| < 1e-4) while its reference moves (|v_ref| > 1e-3).

    NaN in the columns of joints whose reference never moves; None where the reference has no velocity.
    """
    wanted = _wanted(run)
    if wanted is None:
        return None
    moving = np.abs(wanted) > MOVING
    resting = (np.abs(run.v) < RESTING) & moving
    return np.where(moving.any(axis=0), resting.astype(np.float64), np.nan)


def reversal_error(run: Run) -> Float64Array:
    """(n,) the largest error between a reversal of the reference and halfway to the next; NaN without a reversal.

    A reference reverses in the tick in which it first moves (|v_ref| > 1e-3) the other way, after a rest or not.
    After its last reversal all that is left of the run counts.
    """
    wanted, error = _wanted(run), run.error
    out = np.full(run.n, np.nan)
    if wanted is None or error is None:
        return out
    for i in range(run.n):
        ways = np.where(np.abs(wanted[:, i]) > MOVING, np.sign(wanted[:, i]), 0.0)
        ticks = np.flatnonzero(ways)
        turns = ticks[1:][ways[ticks[1:]] != ways[ticks[:-1]]].tolist()
        halfway = [(k + following) // 2 for k, following in pairwise(turns)]
        windows = zip(turns, [*halfway, len(error) - 1], strict=False)
        out[i] = max((np.abs(error[k : end + 1, i]).max() for k, end in windows), default=np.nan)
    return out


def _wanted(run: Run) -> Float64Array | None:
    """(k, n) the velocity that the reference asks for."""
    v: Any = getattr(run.reference, "v", None)
    return None if v is None else np.broadcast_to(np.asarray(v, dtype=np.float64), run.v.shape)
