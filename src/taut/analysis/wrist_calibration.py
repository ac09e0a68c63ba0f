"""Calibration of a wrist sensor: bias, tool mass and centre from readings in a few poses at rest."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import STANDARD_GRAVITY, Arm
from taut.base.checks import finite_array, one_of, read_only, vector
from taut.base.errors import NumericalError, RangeError, ShapeError, UsageError
from taut.base.quantity import FORCE_AND_MOMENT, Quantity, six_of
from taut.base.types import ArrayLike, Float64Array
from taut.control.sensing.wrist import Wrist
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.maths.wrist import sensor_place
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["WristCalibration", "calibrate_wrist"]

SPREAD: Final = 0.05  # rad, root mean square: gravity must turn by this much, about 3 degrees, to tell numbers apart
SIGNIFICANT: Final = 4.0  # standard deviations by which a mass must differ from zero
AT_END: Final = 1.0 - 1e-9  # of the range
NOISE: Final = Quantity(unit=FORCE_AND_MOMENT, rule="> 0", instead="leave it out to take it from the residual")
RANGE: Final = Quantity(unit=FORCE_AND_MOMENT, rule="> 0", infinite=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class WristCalibration:
    """What a calibration found, with the standard deviation of each number.

    Frames:
        Bias and centre of mass are in the sensor's axes at its origin, force first.
    """

    bias: Float64Array  # (6,) [N, N m]
    mass: float  # [kg] of what hangs beyond the sensor; 0 where it is too small to tell
    com: Float64Array  # (3,) [m] its centre; zeros where the mass is too small to tell
    bias_std: Float64Array  # (6,) [N, N m]
    mass_std: float  # [kg]
    com_std: Float64Array  # (3,) [m]; infinite where the mass is too small to tell
    residual: Float64Array  # (6,) root mean square of what the model leaves [N, N m]
    spread: tuple[float, float]  # [rad] turning of gravity in the sensor's axes: in all, and off its main direction
    condition: float  # of the least squares, 1 at best; numbers above 10 mean poses that are too much alike
    poses: int  # readings that were used
    frame: str | None  # where the sensor stands: a frame of the arm; None for the tool's own, or without an arm
    range: Float64Array | None  # (6,) [N, N m]

    @property
    def wrist(self) -> Wrist:
        """What `taut.Sensing(wrist=...)` takes; other numbers of it by `dataclasses.replace`."""
        return Wrist(bias=self.bias, mass=self.mass, com=self.com, range=self.range, frame=self.frame)

    def __str__(self) -> str:
        rows: list[tuple[str, Any, Any, str]] = [
            ("mass", [self.mass], [self.mass_std], "kg"),
            ("com", self.com, self.com_std, "m"),
        ]
        rows += [("bias force", self.bias[:3], self.bias_std[:3], "N")]
        rows += [("bias moment", self.bias[3:], self.bias_std[3:], "N m")]
        lines = [
            f"{name:12}" + ", ".join(f"{x:.5g} +- {s:.2g}" for x, s in zip(xs, stds, strict=True)) + f"  [{unit}]"
            for name, xs, stds, unit in rows
        ]
        force, moment = (float(np.sqrt(np.mean(part**2))) for part in (self.residual[:3], self.residual[3:]))
        lines += [
            f"residual    {force:.3g} N, {moment:.3g} N m in {self.poses} poses; condition {self.condition:.3g}"
        ]
        return "\n".join(lines)


def calibrate_wrist(
    wrenches: ArrayLike,
    *,
    arm: Arm | None = None,
    q: ArrayLike | None = None,
    poses: Iterable[Pose] | None = None,
    axes: Literal["sensor", "world"] = "sensor",
    frame: str | None = None,
    gravity: ArrayLike | None = None,
    noise: ArrayLike | None = None,
    range: ArrayLike | None = None,
) -> WristCalibration:
    """Bias of a wrist sensor, and mass and centre of the tool beyond it, by least squares.

    Law:          reading_i = bias + (m g_i, m c x g_i), with gravity g_i in the sensor's axes: linear in bias, m, m c

    Poses must turn gravity in the sensor's axes: two directions tell the mass, three that are not on one line the
    centre too, and turning about the vertical changes nothing. `taut.analysis.calibration_poses(arm)` suggests good
    ones. A mass that cannot be told from zero is taken for none.

    Args:
        wrenches: (k, 6) readings at rest with nothing touching, force first: the wrench of the tool on the arm, as
            F_ext counts; the readings of a sensor that gives the arm on the tool are minus these.
        arm: The arm, with q; or give poses.
        q: (k, n) measured positions at each reading [rad | m].
        poses: Instead, k poses of the sensor in the world.
        axes: "sensor" for readings in the sensor's axes at its origin; "world" for F_ext as `ctrl.step` takes it and
            runs record it, in world axes at the tool's origin, which needs the arm.
        frame: Where the sensor stands: a frame of the tool's body; the tool's own if None. With the arm only.
        gravity: (3,) in the world [m/s^2]; the arm's, or 9.81 m/s^2 downwards.
        noise: (6,) or (force, moment), standard deviation of a reading; from what the model leaves if None.
        range: (6,) or (force, moment), where the sensor ends [N, N m]: readings there are refused, and
            `WristCalibration.wrist` has it.

    Raises:
        UsageError: Neither an arm with positions nor poses, or both.
        ShapeError: Another number of poses than of readings.
        RangeError: A reading that is not finite, or at the end of the range; readings of the opposite sign.
        NumericalError: Poses that do not determine the numbers; the message says which, and what pose would help.

    Example:
        >>> import taut
        >>> turns = [taut.Pose(rpy=rpy) for rpy in ([0, 0, 0], [1.57, 0, 0], [0, 1.57, 0], [-1.57, 0, 0])]
        >>> tool = lambda g: [*(0.7 * g), *np.cross([0.0, 0.0, 0.035], g)]
        >>> F = [np.add([1, 2, 3, 0, 0, 0.1], tool(T.R.T @ [0, 0, -9.81])) for T in turns]
        >>> found = calibrate_wrist(F, poses=turns)
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
    if arm is not None:
        if poses is not None:
            raise UsageError("calibrate_wrist takes an arm with q=, or poses=; got both", name="poses")
        F, R = _by_arm(arm, q, F, axes, frame)
    else:
        F, R = _by_poses(poses, q, F, axes, frame)
    g = vector("gravity", _gravity_of(arm) if gravity is None else gravity, 3, unit="m/s^2")
    if not g.any():
        raise RangeError("gravity must not be zero: without it a tool has no weight to read", name="gravity")
    end = None if range is None else six_of("range", RANGE, range)
    if end is not None:
        _require_within(F, end)
    std = None if noise is None else six_of("noise", NOISE, noise)
    return _fitted(F, np.array([turn.T @ g for turn in R]), std, frame, end)


# -------------------------------------------------------------------- what is given


def _gravity_of(arm: Arm | None) -> Float64Array:
    return np.array(STANDARD_GRAVITY) if arm is None else arm.gravity


def _by_arm(
    arm: Arm, q: ArrayLike | None, F: Float64Array, axes: str, frame: str | None
) -> tuple[Float64Array, list[Float64Array]]:
    """Readings in the sensor's axes, and its orientations."""
    if not isinstance(arm, Arm):  # callers without a type checker
        raise UsageError(f"arm must be an Arm from taut.load_arm; got {type(arm).__name__}", name="arm")
    if q is None:
        raise UsageError("calibrate_wrist needs q=, the positions at each reading, with the arm", name="q")
    positions = finite_array("q", q, shape=(len(F), arm.n), unit="rad | m")
    place, model = sensor_place(arm, frame, "calibrate_wrist"), model_of(arm)
    turns = [np.asarray(dyn.pose(model, row).R) for row in positions]
    if axes == "world":
        F = np.array([place.in_sensor(reading, R_WE) for reading, R_WE in zip(F, turns, strict=True)])
    return F, [R_WE @ place.R_ES for R_WE in turns]


def _by_poses(
    poses: Iterable[Pose] | None, q: ArrayLike | None, F: Float64Array, axes: str, frame: str | None
) -> tuple[Float64Array, list[Float64Array]]:
    """The same without an arm."""
    if poses is None:
        raise UsageError(
            "calibrate_wrist needs arm= with q=, or poses=, those of the sensor; got neither", name="arm"
        )
    for name, given in (("q", q), ("frame", frame), ("axes='world'", None if axes == "sensor" else axes)):
        if given is not None:
            raise UsageError(f"calibrate_wrist takes {name} with arm= only; poses are those of the sensor", name=name)
    turns = list(poses)
    if not all(isinstance(T, Pose) for T in turns):
        raise UsageError("poses must be a list of taut.Pose", name="poses")
    if len(turns) != len(F):
        raise ShapeError(
            f"poses must be as many as readings; got {len(turns)} poses and {len(F)} readings", name="poses"
        )
    return F, [np.asarray(T.R, dtype=np.float64) for T in turns]


def _require_within(F: Float64Array, end: Float64Array) -> None:
    beyond = np.argwhere(np.abs(F) >= AT_END * end)
    if len(beyond):
        row, axis = (int(i) for i in beyond[0])
        raise RangeError(
            f"wrenches[{row}, {axis}] is at the end of the sensor's range of {end[axis]:g}, so that what is really "
            "there is not known; leave that pose out, or use a lighter tool",
            name="wrenches",
            value=float(F[row, axis]),
        )


# -------------------------------------------------------------------- the fit


def _fitted(
    F: Float64Array, g: Float64Array, noise: Float64Array | None, frame: str | None, end: Float64Array | None
) -> WristCalibration:
    """Least squares of force and moment, which have no number in common but the mass that divides m c."""
    size = float(np.linalg.norm(g[0]))
    spread = _require_determined(g / size)
    A_f, A_m = _regressors(g)
    x_f, cov_f, left_f = _least_squares(A_f, F[:, :3], None if noise is None else noise[:3])
    x_m, cov_m, left_m = _least_squares(A_m, F[:, 3:], None if noise is None else noise[3:])
    mass, mass_std = float(x_f[3]), math.sqrt(cov_f[3, 3])
    least = max(SIGNIFICANT * mass_std, 1e-9 * float(np.abs(F).max()) / size)
    if mass < -least:
        raise RangeError(
            f"the readings say that the tool weighs {mass:.3g} +- {mass_std:.1g} kg; they must be the wrench of the "
            "tool on the arm; give minus what a sensor reads that gives the arm on the tool",
            name="wrenches",
            value=mass,
        )
    if mass > least:
        com = x_m[3:] / mass
        com_std = np.sqrt(np.diag(cov_m)[3:] + com**2 * mass_std**2) / mass
        bias, variance = np.concatenate([x_f[:3], x_m[:3]]), np.concatenate([np.diag(cov_f)[:3], np.diag(cov_m)[:3]])
    else:
        x_f, cov_f, left_f = _least_squares(A_f[:, :3], F[:, :3], None if noise is None else noise[:3])
        x_m, cov_m, left_m = _least_squares(A_m[:, :3], F[:, 3:], None if noise is None else noise[3:])
        mass, com, com_std = 0.0, np.zeros(3), np.full(3, np.inf)
        bias, variance = np.concatenate([x_f, x_m]), np.concatenate([np.diag(cov_f), np.diag(cov_m)])
    left = np.hstack([left_f, left_m])
    return WristCalibration(
        bias=read_only(bias),
        mass=mass,
        com=read_only(com),
        bias_std=read_only(np.sqrt(variance)),
        mass_std=mass_std,
        com_std=read_only(com_std),
        residual=read_only(np.sqrt(np.mean(left**2, axis=0))),
        spread=spread,
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


def _least_squares(A: Float64Array, y: Float64Array, std: Float64Array | None) -> tuple[Any, Any, Float64Array]:
    """The solution, its covariance, and (k, 3) what is left."""
    weights = np.ones(y.size) if std is None else np.tile(1.0 / std, len(y))
    W = A * weights[:, np.newaxis]
    x = np.linalg.lstsq(W, y.ravel() * weights, rcond=None)[0]
    left = y - (A @ x).reshape(y.shape)
    free = y.size - A.shape[1]
    variance = float(np.sum(left**2)) / free if std is None else 1.0
    return x, variance * np.linalg.inv(W.T @ W), left


def _require_determined(u: Float64Array) -> tuple[float, float]:
    """How far gravity turns in the sensor's axes [rad]: in all, and off the line along which it turns most.

    Raises:
        NumericalError: Not far enough to tell the numbers apart.
    """
    middle = u.mean(axis=0)
    values, ways = np.linalg.eigh((u - middle).T @ (u - middle) / len(u))
    values = np.maximum(values, 0.0)
    whole, off = math.sqrt(values.sum()), math.sqrt(values[0] + values[1])
    if whole < SPREAD:
        across = _words(_perpendicular(u[0]))
        raise NumericalError(
            f"the {len(u)} poses have the same orientation to gravity within {math.degrees(whole):.1f} degrees, so "
            "that mass, com, the bias force along gravity and the bias moment are not determined; add poses in which "
            f"gravity points along other axes of the sensor, such as {across} (turning about the vertical changes "
            "nothing)",
            name="poses",
        )
    if off < SPREAD:
        main = ways[:, 2]
        way = np.cross(main, middle)
        size = float(np.linalg.norm(way))
        help_ = _words(way / size if size > SPREAD else _perpendicular(main))
        raise NumericalError(
            f"gravity points along no more than two directions of the sensor's axes in the {len(u)} poses, so that "
            f"com along {_words(main)} and the bias moment across it are not determined; add a pose in which "
            f"gravity points along {help_}",
            name="poses",
        )
    return whole, off


def _perpendicular(u: Float64Array) -> Float64Array:
    """A unit vector across another one, along the axis of the sensor that is the most across."""
    axis = np.eye(3)[int(np.argmin(np.abs(u)))]
    across = axis - u * (u @ axis)
    out: Float64Array = across / np.linalg.norm(across)
    return out


def _words(u: Float64Array) -> str:
    """A direction in the sensor's axes, whose sign does not matter."""
    sign = -1.0 if u[int(np.argmax(np.abs(u)))] < 0.0 else 1.0
    return "(" + ", ".join(f"{sign * x + 0.0:.2f}" for x in u) + ")"
