"""The tool in a run: its pose and reference, the contact forces on it, and its deviation under them."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.control.closed_loop import ApparentImpedance
from taut.control.trajectories.force_reference import HybridMotion, TaskForce
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.spatial import log_rows

if TYPE_CHECKING:
    from taut.record.run import Run

NORMAL_FORCE: Final = "contact.normal_force"  # column of a run
ESTIMATE: Final = ".normal"  # end of the name of a column
MIN_FORCE: Final = 1e-9  # [N] of a contact
SAME_MASS: Final = 1e-6  # relative difference of masses that are one
CHANGES: Final = ("law.", "model.")  # parameters whose change makes another promise


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
    def min_singular_value(self) -> Float64Array:
        """(k,) the smallest of the singular values of J, metres and radians taken as alike: 0 at a singularity."""
        if not len(self.J):
            return np.zeros(0)
        return np.asarray(np.linalg.svd(self.J, compute_uv=False)[:, -1], dtype=np.float64)


def task_of(run: Run) -> TaskSide:
    """The task side of a run; UsageError if the run does not state where its tool is."""
    chain = run.info.tool
    if chain is None:
        raise UsageError(
            "the run does not hold which frame its law controls; only runs of taut.run and their logs do", name="task"
        )
    R, p = chain.poses(run.q)
    J = chain.jacobians(run.q)
    wanted = motion if isinstance(motion := run.reference.motion, TaskMotion) else None
    twist = np.einsum("kij,kj->ki", J, run.v)
    return TaskSide(frame=chain.frame, p=p, R=R, J=J, twist=twist, wanted=wanted)


def wanted_wrench(run: Run) -> Float64Array | None:
    """(k, 6) desired F_app at the tool that the law controls, world axes; None without one.

    Of a hybrid law it is the F_app of its reference, of which its rows may leave parts uncontrolled.
    """
    if run.info.tool is None or not len(run):
        return None
    if isinstance(run.reference, HybridMotion):
        asked = np.asarray(run.reference.F_app, dtype=np.float64)
        return asked if np.any(asked) else None
    if not isinstance(run.reference, TaskForce):
        return None
    return np.asarray(run.reference.in_world(run.task.R), dtype=np.float64)


def force_error(run: Run) -> Float64Array | None:
    """(k, 6) wanted less applied wrench [N, N m]; what nothing touches applies nothing."""
    wanted = wanted_wrench(run)
    if wanted is None:
        return None
    return wanted + np.asarray(run.extra["F_ext"]) if "F_ext" in run.extra else wanted


def true_normal(run: Run) -> tuple[Float64Array, Float64Array] | None:
    """(k,) force along the normals of the contacts [N], and (k, 3) these, zero without contact; None if unknown."""
    if NORMAL_FORCE not in run.extra:
        return None
    force = np.asarray(run.extra[NORMAL_FORCE], dtype=np.float64)
    N = np.linalg.norm(force, axis=1)
    return N, force / np.where(N > MIN_FORCE, N, np.inf)[:, np.newaxis]


def wanted_press(reference: HybridMotion, n: Float64Array) -> Float64Array | None:
    """(k,) the desired force into the surface [N]: press, and what of F_app is against the normal n (k, 3).

    Where n is zero (no contact) that of the tick before counts, or the first. None with multipliers, whose rows a run
    does not have.
    """
    if np.any(reference.lam):
        return None
    touching = np.linalg.norm(n, axis=1) > 0.0
    nearest = np.maximum.accumulate(np.where(touching, np.arange(len(n)), int(np.argmax(touching))))
    press = np.asarray(reference.press, dtype=np.float64)[:, 0]
    wanted: Float64Array = press - np.sum(np.asarray(reference.F_app)[:, :3] * n[nearest], axis=1)
    return wanted


def estimated_normal(run: Run) -> Float64Array | None:
    """(k, 3) the normal that the law estimates, where it estimates one; NaN while no such phase acts."""
    taken = [np.asarray(column) for name, column in run.extra.items() if name.endswith(ESTIMATE)]
    return functools.reduce(lambda a, b: np.where(np.isnan(a), b, a), taken) if taken else None


def expected_deviation(run: Run) -> Float64Array | None:
    """(k, 6) deviation from the reference that eq. 10.48 makes of the run's own F_ext, world axes [m, rad].

    From the deviation and its rate at the first tick on. None without an impedance, a wrench, or constant gains.
    """
    deviation = Deviation.of(run)
    return None if deviation is None else deviation.expected()


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """The tool's deviation from its reference under a wrench."""

    t: Float64Array  # (k,) [s]
    F_ext: Float64Array  # (k, 6) [N, N m]
    x: Float64Array  # (k, 6) [m, rad]
    v: Float64Array  # (k, 6) [m/s, rad/s]
    impedance: ApparentImpedance

    @classmethod
    def of(cls, run: Run) -> Deviation | None:
        """None where the law states no impedance, where nothing pushes the tool, or where gains change in the run."""
        if run.info.impedance is None or len(run) < 3 or not isinstance(run.reference.motion, TaskMotion):
            return None
        changed = [path for event in run.info.events for path in event.set]
        if run.first_contact is None or any(p.startswith(CHANGES) for p in changed):
            return None
        task = run.task
        assert task.position_error is not None
        assert task.rotation_error is not None
        return cls(
            t=run.t,
            F_ext=np.asarray(run.extra["F_ext"]),
            x=-np.hstack([task.position_error, task.rotation_error]),
            v=task.twist - np.asarray(run.reference.motion.twist, dtype=np.float64),
            impedance=run.info.impedance,
        )

    def expected(self) -> Float64Array:
        """(k, 6) eq. 10.48 integrated from the first tick on."""
        return self.impedance.response(self.t, self.F_ext, self.x[0], self.v[0])[0]

    def mass(self) -> float:
        """m of F_ext - K x = m a + b v, by least squares over all ticks and the three directions.

        NaN where the law asks for another mass in each direction, or one that couples with rotations.
        """
        D = self.impedance.D
        if np.abs(D[:3] - D[0, 0] * np.eye(3, 6)).max() > SAME_MASS * D[0, 0]:
            return np.nan
        net = (self.F_ext - self.x @ self.impedance.K.T)[:, :3]
        a = np.gradient(self.v[:, :3], self.t, axis=0)
        rows = np.column_stack([a.ravel(), self.v[:, :3].ravel()])
        if not np.isfinite(rows).all() or np.linalg.matrix_rank(rows) < 2:
            return np.nan
        return float(np.linalg.lstsq(rows, net.ravel(), rcond=None)[0][0])
