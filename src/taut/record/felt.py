"""How the tool felt in a run, against what its law promises: eq. 10.48 integrated, and the mass that F_ext met."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.control.laws.apparent import FeltImpedance
from taut.control.trajectories.task_reference import TaskMotion
from taut.record.info import IMPEDANCE

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["deviation_promised", "felt_measures"]

LEAST: Final = 1e-6  # [m] RMS below which nothing was felt
ALIKE: Final = 1e-6  # relative: masses that are one
CHANGES: Final = ("law.", "model.")  # parameters whose change makes another promise


def felt_measures(run: Run) -> dict[str, float]:
    """The metrics `impedance_error` [%] and `felt_mass` [kg]; NaN where a law promises nothing or nothing pushed."""
    out = {"impedance_error": np.nan, "felt_mass": np.nan}
    motion = _Motion.of(run)
    if motion is None:
        return out
    wanted = motion.promised()[:, :3]
    size = _rms(wanted)
    if size > LEAST:
        out["impedance_error"] = 100.0 * _rms(motion.x[:, :3] - wanted) / size
    out["felt_mass"] = motion.mass()
    return out


def deviation_promised(run: Run) -> Float64Array | None:
    """(k, 6) what eq. 10.48 makes of the run's own F_ext: deviation from the reference, world axes [m, rad].

    From the deviation and its rate at the first tick on. None where the law promises no impedance, where there is no
    wrench, or where its gains change in the run.
    """
    motion = _Motion.of(run)
    return None if motion is None else motion.promised()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motion:
    """The tool's deviation from its reference under a wrench."""

    t: Float64Array  # (k,) [s]
    F_ext: Float64Array  # (k, 6) [N, N m]
    x: Float64Array  # (k, 6) [m, rad]
    v: Float64Array  # (k, 6) [m/s, rad/s]
    felt: FeltImpedance

    @classmethod
    def of(cls, run: Run) -> _Motion | None:
        values: Mapping[str, Any] | None = run.info.get(IMPEDANCE)
        if (
            values is None
            or "F_ext" not in run.extra
            or len(run) < 3
            or not isinstance(run.reference.motion, TaskMotion)
        ):
            return None
        if not np.any(run.extra["F_ext"]):
            return None
        changed = [path for event in run.info.get("events", ()) for path in event["set"]]
        if any(path.startswith(CHANGES) for path in changed):
            return None
        task = run.task
        assert task.position_error is not None
        assert task.rotation_error is not None
        return cls(
            t=run.t,
            F_ext=np.asarray(run.extra["F_ext"]),
            x=-np.hstack([task.position_error, task.rotation_error]),
            v=task.twist - np.asarray(run.reference.motion.twist, dtype=np.float64),
            felt=FeltImpedance.of_json(values),
        )

    def promised(self) -> Float64Array:
        return self.felt.response(self.t, self.F_ext, self.x[0], self.v[0])[0]

    def mass(self) -> float:
        """m of F_ext - K x = m a + b v, by least squares over all ticks and the three directions.

        NaN where the law asks for another mass in each direction, or one that rotations feel.
        """
        D = self.felt.D
        if np.abs(D[:3] - D[0, 0] * np.eye(3, 6)).max() > ALIKE * D[0, 0]:
            return np.nan
        net = (self.F_ext - self.x @ self.felt.K.T)[:, :3]
        a = np.gradient(self.v[:, :3], self.t, axis=0)
        rows = np.column_stack([a.ravel(), self.v[:, :3].ravel()])
        if not np.isfinite(rows).all() or np.linalg.matrix_rank(rows) < 2:
            return np.nan
        return float(np.linalg.lstsq(rows, net.ravel(), rcond=None)[0][0])


def _rms(rows: Float64Array) -> float:
    return float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))
