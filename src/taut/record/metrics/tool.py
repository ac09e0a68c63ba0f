"""The metrics of the tool: its motion and errors, the forces on it, and its deviation under them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from taut.base.types import Float64Array
from taut.control.trajectories.force_reference import HybridMotion
from taut.control.trajectories.task_reference import TaskMotion
from taut.record.metrics.declaration import Metric
from taut.record.tool import Deviation, estimated_normal, force_error, true_normal, wanted_press

if TYPE_CHECKING:
    from taut.record.run import Run

Series: TypeAlias = "Callable[[Run], Float64Array | None]"
Number: TypeAlias = Callable[[Float64Array], float]

MIN_DEVIATION: Final = 1e-6  # [m] RMS below which nothing moved the tool


def _rms(x: Float64Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _peak(x: Float64Array) -> float:
    return float(np.max(np.abs(x)))


def _declare(name: str, title: str, unit: str, doc: str, series: Series, number: Number) -> None:
    """A metric that is one number of a series over the run, which is None where it has no meaning."""

    def compute(run: Run) -> float | None:
        values = series(run)
        return None if values is None else number(values)

    Metric(name=name, title=title, unit=unit, doc=doc)(compute)


def _declare_error(name: str, title: str, unit: str, what: str, series: Series) -> None:
    """RMS and peak of an error."""
    _declare(f"{name}_rms", f"{title} RMS", unit, f"RMS of {what}", series, _rms)
    _declare(f"{name}_peak", f"{title} peak", unit, f"Peak of {what}", series, _peak)


def _final(run: Run, axis: int) -> float | None:
    return float(run.task.p[-1, axis]) if run.info.tool is not None else None


for _i, _axis in enumerate("xyz"):
    Metric(name=f"final_{_axis}", unit="m", doc=f"Position of the tool at the end along the world's {_axis} axis")(
        partial(_final, axis=_i)
    )


@Metric(title="lateral speed RMS", unit="m/s")
def lateral_speed_rms(run: Run) -> float | None:
    """RMS speed of the tool's origin along its own y axis."""
    return _rms(np.sum(run.task.R[:, :, 1] * run.task.twist[:, :3], axis=1)) if run.info.tool is not None else None


def _position_errors(run: Run) -> Float64Array | None:
    """(k,) [m] norm of the position error, where the reference is one of the task."""
    error = run.task.position_error if _is_of_task(run) else None
    return None if error is None else np.asarray(np.linalg.norm(error, axis=1))


def _rotation_errors(run: Run) -> Float64Array | None:
    """(k,) [rad] angle of the rotation error, where the reference is one of the task."""
    error = run.task.rotation_error if _is_of_task(run) else None
    return None if error is None else np.asarray(np.linalg.norm(error, axis=1))


def _is_of_task(run: Run) -> bool:
    return run.info.tool is not None and isinstance(run.reference.motion, TaskMotion)


def _last(x: Float64Array) -> float:
    return float(x[-1])


_declare_error("task", "task", "m", "the norm of the tool's position error", _position_errors)
_what = "Norm of the tool's position error in the last tick"
_declare("task_final", "task final", "m", _what, _position_errors, _last)
_ANGLE: Final = "the angle of the tool's rotation error, log(R_des R^T)"
_declare("task_rms_rotation", "rotation RMS", "rad", f"RMS of {_ANGLE}", _rotation_errors, _rms)
_declare("task_peak_rotation", "rotation peak", "rad", f"Peak of {_ANGLE}", _rotation_errors, _peak)


@Metric(title="smallest singular value", unit="1")
def min_singular_value(run: Run) -> float | None:
    """Smallest singular value of the tool's Jacobian in the run, metres and radians alike; 0 at a singularity."""
    return float(run.task.min_singular_value.min()) if _is_of_task(run) else None


def _sizes(rows: Float64Array | None, part: slice) -> Float64Array | None:
    """(k,) norms of the force or the moment of a wrench (k, 6)."""
    return None if rows is None else np.asarray(np.linalg.norm(rows[:, part], axis=1))


_FORCE: Final = slice(0, 3)
_MOMENT: Final = slice(3, 6)


def _external(run: Run, part: slice) -> Float64Array | None:
    """(k,) of the environment's wrench; None where nothing touched the arm."""
    F_ext = run.extra.get("F_ext")
    return _sizes(F_ext, part) if F_ext is not None and F_ext.any() else None


def _error(run: Run, part: slice) -> Float64Array | None:
    """Wanted less applied, both of the arm on the environment at the tool."""
    return _sizes(force_error(run), part)


def _least(x: Float64Array) -> float:
    return float(x.min())


_force, _moment = partial(_external, part=_FORCE), partial(_external, part=_MOMENT)
_declare("min_force", "minimum force", "N", "Smallest norm of the environment's force on the arm", _force, _least)
_declare("force_rms", "force RMS", "N", "RMS of the norm of the environment's force", _force, _rms)
_declare("peak_force", "peak force", "N", "Peak of the norm of the environment's force", _force, _peak)
_declare("peak_moment", "peak moment", "N m", "Peak of the norm of the environment's moment", _moment, _peak)
_declare("moment_rms", "moment RMS", "N m", "RMS of the norm of the environment's moment", _moment, _rms)
_what = "the norm of the error of the {} at the tool, wanted less applied by the arm"
_declare_error("force_error", "force error", "N", _what.format("force"), partial(_error, part=_FORCE))
_declare_error("moment_error", "moment error", "N m", _what.format("moment"), partial(_error, part=_MOMENT))


@Metric(title="contact lost", unit="s")
def contact_lost_time(run: Run) -> float | None:
    """Time in which a law within taut.laws.LossOfContact measured less than a contact gives while more was wanted."""
    lost = [column for name, column in run.extra.items() if name.startswith("law.") and name.endswith(".lost")]
    if not lost:
        return None
    any_lost = np.any([column > 0.0 for column in lost], axis=0)  # NaN where the law's phase does not act
    return float(np.sum(any_lost[:-1] * np.diff(run.t)))


def _normal_force_error(run: Run) -> Float64Array | None:
    """(k,) [N] error of the force into the surface; None where multipliers were wanted, or nothing touched."""
    contact = true_normal(run)
    if contact is None or not isinstance(run.reference, HybridMotion) or not contact[1].any():
        return None
    wanted = wanted_press(run.reference, contact[1])
    return None if wanted is None else wanted - contact[0]


_along = "the error of the force along the true normals, which a MujocoPlant with a scene gives"
_declare_error("normal_force_error", "normal force error", "N", _along, _normal_force_error)


@Metric(title="peak normal force", unit="N")
def peak_normal_force(run: Run) -> float | None:
    """Peak of the force along the true normals, such as of an impact."""
    return None if (contact := true_normal(run)) is None else float(contact[0].max())


def _path_errors(run: Run) -> Float64Array | None:
    """(k,) [m] norm of the tool's position error across the true normal, in the ticks of contact."""
    contact = true_normal(run)
    if contact is None or run.info.tool is None or not isinstance(run.reference, HybridMotion):
        return None
    error, n = run.task.position_error, contact[1]
    touching = n.any(axis=1)
    if error is None or not touching.any():
        return None
    across = error - np.sum(error * n, axis=1)[:, np.newaxis] * n
    return np.asarray(np.linalg.norm(across[touching], axis=1))


_across = "the tool's position error along the true surface, in contact"
_declare_error("path_error", "path error", "m", _across, _path_errors)


@Metric(title="normal error", unit="deg")
def normal_error(run: Run) -> float | None:
    """Angle between the normal that the law estimates and the true one, when the tool last touched."""
    contact, estimate = true_normal(run), estimated_normal(run)
    if contact is None or estimate is None or not isinstance(run.reference, HybridMotion):
        return None
    n = contact[1]
    known = np.flatnonzero(n.any(axis=1) & np.isfinite(estimate).all(axis=1))
    if not known.size:
        return None
    last = int(known[-1])
    sine, cosine = np.linalg.norm(np.cross(estimate[last], n[last])), estimate[last] @ n[last]
    return float(np.rad2deg(np.arctan2(sine, cosine)))


@Metric(title="against eq. 10.48", unit="%")
def impedance_error(run: Run) -> float | None:
    """RMS distance of the tool from its position by eq. 10.48 with the run's F_ext, as a percentage of its RMS.

    K, B and D are the law's. Without D the inertia, and with zeta the damping, is that at the start.
    """
    deviation = Deviation.of(run)
    if deviation is None:
        return None
    expected = deviation.expected()[:, :3]
    size = _rms(np.linalg.norm(expected, axis=1))
    error = _rms(np.linalg.norm(deviation.x[:, :3] - expected, axis=1))
    return 100.0 * error / size if size > MIN_DEVIATION else None


@Metric(title="apparent mass", unit="kg")
def apparent_mass(run: Run) -> float | None:
    """m of F_ext - K x = m a + b v, by least squares over ticks and directions, K being the law's.

    NaN where the law asks for another mass in each direction.
    """
    deviation = Deviation.of(run)
    return None if deviation is None else deviation.mass()
