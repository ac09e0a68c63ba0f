"""Calibration of a wrist sensor: bias, tool mass and centre of mass from readings in a few poses at rest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, instance_of, one_of, read_only
from taut.base.errors import NumericalError, RangeError, ShapeError
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.sensing import Wrist
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.maths.wrist import sensor_place
from taut.trace import math as tm

MIN_SPREAD: Final = 0.05  # [rad] RMS, about 3 degrees: rotation of gravity that tells the numbers apart
SIGNIFICANT: Final = 4.0  # standard deviations by which a mass must differ from zero
AT_END: Final = 1.0 - 1e-9  # of the range
FORCE_AND_MOMENT: Final = "N, N m"


@dataclass(frozen=True, kw_only=True, eq=False)
class WristCalibration(Result):
    """Calibrated numbers of a wrist sensor, with the standard deviation of each.

    Frames:
        Bias and centre of mass are in the sensor's axes at its origin, force first.
    """

    bias: Float64Array  # (6,) [N, N m]
    mass: float  # [kg] of the tool beyond the sensor; 0 where it is not significant
    com: Float64Array  # (3,) [m] its centre of mass; zeros where the mass is not significant
    bias_std: Float64Array  # (6,) [N, N m]
    mass_std: float  # [kg]
    com_std: Float64Array  # (3,) [m]; infinite where the mass is not significant
    residual: Float64Array  # (6,) root mean square [N, N m]
    condition: float  # of the least squares, 1 at best; above 10 the poses are too much alike
    poses: int  # readings that were used
    frame: str | None  # the sensor's frame; None for the tool's own
    range: Float64Array | None  # (6,) [N, N m]

    @property
    def wrist(self) -> Wrist:
        """For `taut.Sensing(wrist=...)`; other fields of it by `dataclasses.replace`."""
        return Wrist(bias=self.bias, mass=self.mass, com=self.com, range=self.range, frame=self.frame)

    def content(self) -> Content:
        """Each number with its standard deviation, and the residual."""
        names = ("mass [kg]", *(f"com {axis} [m]" for axis in "xyz"))
        names += tuple(f"bias {axis} [{unit}]" for unit in ("N", "N m") for axis in "xyz")
        values = [self.mass, *self.com.tolist(), *self.bias.tolist()]
        deviations = [self.mass_std, *self.com_std.tolist(), *self.bias_std.tolist()]
        rows = list(zip(names, values, deviations, strict=True))
        force, torque = (float(np.sqrt(np.mean(part**2))) for part in (self.residual[:3], self.residual[3:]))
        return Content(
            title=f"calibration of a wrist sensor from {self.poses} readings",
            tables=[Table(columns=("quantity", "value", "standard deviation"), rows=rows)],
            notes=[f"residual {force:.3g} N, {torque:.3g} N m RMS; condition number {self.condition:.3g}"],
        )


def calibrate_wrist(
    wrenches: ArrayLike,
    arm: Arm,
    *,
    q: ArrayLike,
    axes: Literal["sensor", "world"] = "sensor",
    frame: str | None = None,
    range: ArrayLike | None = None,
) -> WristCalibration:
    """Bias of a wrist sensor, and mass and centre of the tool beyond it, by least squares.

    Law:          reading_i = bias + (m g_i, m c x g_i), with gravity g_i in the sensor's axes: linear in bias, m, m c

    Poses must rotate gravity in the sensor's axes: two directions determine the mass, three that are not on one line
    the centre of mass too, and a rotation about the vertical adds nothing. A mass that is not significant is taken
    for none.

    Args:
        wrenches: (k, 6) readings at rest without contact, force first: of the tool on the arm, the sign of F_ext.
        arm: The arm.
        q: (k, n) measured positions at each reading [rad | m].
        axes: "sensor", at its origin; "world" for F_ext of `ctrl.step` and runs, at the tool's origin of the arm.
        frame: The sensor's frame, one of the tool's body; the tool's own if None.
        range: (6,) or (force, moment), range of the sensor [N, N m]: readings there are refused.

    Raises:
        ShapeError: Another number of positions than of readings.
        RangeError: A reading that is not finite, at the end of the range, or of the opposite sign; no gravity.
        NumericalError: Poses that do not determine the numbers.

    Example:
        >>> import taut
        >>> arm, q = taut.load_arm("panda"), [[0, 0, 0, -1.6, 0, a, 0] for a in (0.5, 1.6, 2.5)]
        >>> q += [[0, 0, 0, -1.6, 1.2, 1.6, 0]]
        >>> tool = lambda g: [*(0.7 * g), *np.cross([0.0, 0.0, 0.035], g)]
        >>> g = [taut.snapshot(arm, each).T().R.T @ arm.gravity for each in q]
        >>> found = calibrate_wrist([np.add([1, 2, 3, 0, 0, 0.1], tool(each)) for each in g], arm, q=q)
        >>> round(found.mass, 9), found.com.round(9)[2].item(), found.bias.round(9)[:3].tolist()
        (0.7, 0.05, [1.0, 2.0, 3.0])

    References:
        Kubus, Kroeger and Wahl, On-line rigid object recognition and pose estimation based on inertial parameters,
        IROS (2007).
    """
    one_of("axes", axes, ("sensor", "world"))
    F = finite_array("wrenches", wrenches, unit=FORCE_AND_MOMENT)
    if F.ndim != 2 or F.shape[1] != 6:
        raise ShapeError(
            f"wrenches must have shape (k, 6) [{FORCE_AND_MOMENT}]; got shape {F.shape}", name="wrenches"
        )
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    if not np.any(arm.gravity):
        raise RangeError("arm must have gravity: without it a tool has no weight to read", name="arm")
    positions = finite_array("q", q, shape=(len(F), arm.n), unit="rad | m")
    place, model = sensor_place(arm, frame, "calibrate_wrist"), model_of(arm)
    rotations = [np.asarray(dyn.pose(model, row).R) for row in positions]
    if axes == "world":
        F = np.array([place.in_sensor(reading, R_WE) for reading, R_WE in zip(F, rotations, strict=True)])
    end = Wrist(range=range).range
    if end is not None:
        _require_within(F, end)
    return _fitted(F, np.array([(R_WE @ place.R_ES).T @ arm.gravity for R_WE in rotations]), frame, end)


def _require_within(F: Float64Array, end: Float64Array) -> None:
    beyond = np.argwhere(np.abs(F) >= AT_END * end)
    if len(beyond):
        row, axis = (int(i) for i in beyond[0])
        raise RangeError(
            f"wrenches[{row}, {axis}] is at the end of the sensor's range of {end[axis]:g}, so that the true "
            "wrench is not known; leave that pose out, or use a lighter tool",
            name="wrenches",
            value=float(F[row, axis]),
        )


def _fitted(F: Float64Array, g: Float64Array, frame: str | None, end: Float64Array | None) -> WristCalibration:
    """Least squares of force and of moment, which share no unknown but the mass that divides m c."""
    size = float(np.linalg.norm(g[0]))
    _require_determined(g / size)
    force, moment = _regressors(g)

    def fit(unknowns: slice) -> tuple[Any, Any, Float64Array]:
        """Of force and moment: the solutions, their variances, and the residuals."""
        parts = [_least_squares(A[:, unknowns], y) for A, y in ((force, F[:, :3]), (moment, F[:, 3:]))]
        return [part[0] for part in parts], [part[1] for part in parts], np.hstack([part[2] for part in parts])

    x, variance, residual = fit(slice(None))
    mass, mass_std = float(x[0][3]), math.sqrt(variance[0][3])
    smallest = max(SIGNIFICANT * mass_std, 1e-9 * float(np.abs(F).max()) / size)
    if mass < -smallest:
        raise RangeError(
            f"the readings give a tool of {mass:.3g} +- {mass_std:.1g} kg; they must be the wrench of the tool on "
            "the arm; give minus the readings of a sensor that gives the arm on the tool",
            name="wrenches",
            value=mass,
        )
    if mass > smallest:
        com = x[1][3:] / mass
        com_std = np.sqrt(variance[1][3:] + com**2 * mass_std**2) / mass
    else:
        x, variance, residual = fit(slice(0, 3))
        mass, com, com_std = 0.0, np.zeros(3), np.full(3, np.inf)
    return WristCalibration(
        bias=read_only(np.concatenate([part[:3] for part in x])),
        mass=mass,
        com=read_only(com),
        bias_std=read_only(np.sqrt(np.concatenate([part[:3] for part in variance]))),
        mass_std=mass_std,
        com_std=read_only(com_std),
        residual=read_only(np.sqrt(np.mean(residual**2, axis=0))),
        condition=max(float(np.linalg.cond(A)) for A in _regressors(g / size)),
        poses=len(F),
        frame=frame,
        range=end,
    )


def _regressors(g: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(3k, 4) of bias force and mass, (3k, 6) of bias moment and m c."""
    force = np.vstack([np.column_stack([np.eye(3), row]) for row in g])
    moment = np.vstack([np.hstack([np.eye(3), -np.asarray(tm.skew(row))]) for row in g])
    return force, moment


def _least_squares(A: Float64Array, y: Float64Array) -> tuple[Any, Any, Float64Array]:
    """The solution, its variances, and (k, 3) the residuals."""
    x = np.linalg.lstsq(A, y.ravel(), rcond=None)[0]
    residual = y - (A @ x).reshape(y.shape)
    variance = float(np.sum(residual**2)) / (y.size - A.shape[1])
    return x, variance * np.diag(np.linalg.inv(A.T @ A)), residual


def _require_determined(u: Float64Array) -> None:
    """Refuse poses in which gravity rotates too little in the sensor's axes, or about one line only."""
    variances = np.linalg.eigvalsh(np.cov(u.T, bias=True))
    if variances[0] + variances[1] < MIN_SPREAD**2:
        raise NumericalError(
            f"the {len(u)} poses must rotate gravity to three directions of the sensor's axes that are not on one "
            "line, or bias, mass and com are not determined; add poses with the tool tilted another way (a rotation "
            "about the vertical adds nothing)",
            name="q",
        )
