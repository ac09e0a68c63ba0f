"""How a tool pressed on a surface: against the true normals of its contacts, whatever the law took them for."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.types import Float64Array
from taut.control.trajectories.hybrid_motion import HybridMotion
from taut.record.info import TOOL

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["estimated_normal", "pressed_measures", "true_normal", "wanted_press"]

PRESSED: Final = "contact.normal_force"  # column of a run
ESTIMATED: Final = "estimate.normal"  # end of the name of a column
TOUCHES: Final = 1e-9  # [N]


def true_normal(run: Run) -> tuple[Float64Array, Float64Array] | None:
    """(k,) the force along the normals of the contacts [N], and (k, 3) their direction, zero where nothing touches.

    None where the run does not tell.
    """
    if PRESSED not in run.extra:
        return None
    force = np.asarray(run.extra[PRESSED], dtype=np.float64)
    N = np.linalg.norm(force, axis=1)
    return N, force / np.where(N > TOUCHES, N, np.inf)[:, np.newaxis]


def wanted_press(reference: HybridMotion, n: Float64Array) -> Float64Array | None:
    """(k,) the force into the surface that was asked for [N]: press, and what of F_app is against the normal.

    None where multipliers were asked for, for a run does not have the rows that they belong to.

    Args:
        reference: Of k ticks.
        n: (k, 3) the normal, zero where nothing touches: there that of the tick before counts, or of the first.
    """
    if np.any(reference.lam):
        return None
    touching = np.linalg.norm(n, axis=1) > 0.0
    nearest = np.maximum.accumulate(np.where(touching, np.arange(len(n)), int(np.argmax(touching))))
    press = np.asarray(reference.press, dtype=np.float64)[:, 0]
    wanted: Float64Array = press - np.sum(np.asarray(reference.F_app)[:, :3] * n[nearest], axis=1)
    return wanted


def estimated_normal(run: Run) -> Float64Array | None:
    """(k, 3) what the law took for the normal, where it estimates one; NaN where no phase that does acts."""
    taken = [np.asarray(column) for name, column in run.extra.items() if name.endswith(ESTIMATED)]
    return functools.reduce(lambda a, b: np.where(np.isnan(a), b, a), taken) if taken else None


def pressed_measures(run: Run) -> dict[str, float]:
    """The metrics of pressing, where they have a meaning."""
    told = true_normal(run)
    if told is None or not len(run):
        return {}
    N, n = told
    touching = N > TOUCHES
    out = {"largest_press": float(N.max())}
    if not isinstance(run.reference, HybridMotion) or not touching.any():
        return out
    wanted = wanted_press(run.reference, n)
    if wanted is not None:
        error = wanted - N
        out |= {"press_rms": float(np.sqrt(np.mean(error**2))), "press_peak": float(np.abs(error).max())}
    off = run.task.position_error if TOOL in run.info else None
    if off is not None:
        across = off - np.sum(off * n, axis=1)[:, np.newaxis] * n
        size = np.linalg.norm(across[touching], axis=1)
        out |= {"surface_rms": float(np.sqrt(np.mean(size**2))), "surface_peak": float(size.max())}
    taken = estimated_normal(run)
    known = touching if taken is None else touching & np.isfinite(taken).all(axis=1)
    if taken is not None and known.any():
        last = int(np.flatnonzero(known)[-1])
        sine, cosine = np.linalg.norm(np.cross(taken[last], n[last])), taken[last] @ n[last]
        out["normal_error"] = float(np.rad2deg(np.arctan2(sine, cosine)))
    return out
