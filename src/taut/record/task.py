"""The task side of a run: where the tool was, where it should have been, and how near it came to a singularity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.chain import Chain
from taut.maths.rotation_rows import log_rows
from taut.record.info import TOOL

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["TaskSide", "task_of"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskSide:
    """What the controlled frame did, from the true joint positions and the kinematics of the controller's arm.

    All arrays have one row per tick. Errors are wanted minus true, in world axes.
    """

    frame: str  # that the law controls
    p: Float64Array  # (k, 3) [m] its origin in the world
    R: Float64Array  # (k, 3, 3) its orientation in the world
    J: Float64Array  # (k, 6, n) its Jacobian, linear part first, world axes
    twist: Float64Array  # (k, 6) linear part first, world axes [m/s, rad/s]
    wanted: TaskMotion | None  # (k, ...) the reference, where it is one of the task

    def __repr__(self) -> str:
        return f"TaskSide(frame '{self.frame}', {len(self.p)} ticks)"

    @cached_property
    def position_error(self) -> Float64Array | None:
        """(k, 3) wanted minus true position [m]; None where the reference is none of the task."""
        return None if self.wanted is None else np.asarray(self.wanted.p, dtype=np.float64) - self.p

    @cached_property
    def rotation_error(self) -> Float64Array | None:
        """(k, 3) rotation vector from the true to the wanted orientation, log(R_des R^T) [rad]; None likewise."""
        if self.wanted is None:
            return None
        return log_rows(np.asarray(self.wanted.R, dtype=np.float64) @ self.R.transpose(0, 2, 1))

    @cached_property
    def least_singular_value(self) -> Float64Array:
        """(k,) the smallest of the singular values of J, metres and radians taken as alike: 0 at a singularity."""
        if not len(self.J):
            return np.zeros(0)
        return np.asarray(np.linalg.svd(self.J, compute_uv=False)[:, -1], dtype=np.float64)


def task_of(run: Run) -> TaskSide:
    """The task side of a run.

    Raises:
        UsageError: The run does not say where its tool is.
    """
    if TOOL not in run.info:
        raise UsageError(
            "the run does not say which frame its law controls: run.info has no 'tool'; only runs of taut.run and "
            "their logs have a task side",
            name="task",
        )
    chain = Chain.of_json(run.info[TOOL])
    R, p = chain.poses(run.q)
    J = chain.jacobians(run.q)
    wanted = motion if isinstance(motion := run.reference.motion, TaskMotion) else None
    twist = np.einsum("kij,kj->ki", J, run.v)
    return TaskSide(frame=chain.frame, p=p, R=R, J=J, twist=twist, wanted=wanted)
