"""The force side of a run: the wrench that was wanted, and the one that the arm applied."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taut.base.types import Float64Array
from taut.control.trajectories.hybrid_motion import HybridMotion
from taut.control.trajectories.task_force import TaskForce
from taut.record.info import TOOL

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["applied_wrench", "force_error", "wanted_wrench"]


def wanted_wrench(run: Run) -> Float64Array | None:
    """(k, 6) F_app that was asked for, at the tool that the law controls, world axes; None where none was.

    Of a hybrid law it is what was asked for as F_app, with a motion; what its rows do not hold may be anything.
    """
    if TOOL not in run.info or not len(run):
        return None
    if isinstance(run.reference, HybridMotion):
        asked = np.asarray(run.reference.F_app, dtype=np.float64)
        return asked if np.any(asked) else None
    if not isinstance(run.reference, TaskForce):
        return None
    return np.asarray(run.reference.in_world(run.task.R), dtype=np.float64)


def applied_wrench(run: Run) -> Float64Array | None:
    """(k, 6) F_app of the arm on the environment at the arm's tool, world axes; None where nothing could touch it."""
    return -np.asarray(run.extra["F_ext"], dtype=np.float64) if "F_ext" in run.extra else None


def force_error(run: Run) -> Float64Array | None:
    """(k, 6) wanted less applied wrench [N, N m]; what nothing touches applies nothing."""
    wanted = wanted_wrench(run)
    if wanted is None:
        return None
    applied = applied_wrench(run)
    return wanted if applied is None else wanted - applied
