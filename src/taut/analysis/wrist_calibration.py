"""Calibration of a wrist sensor: bias, tool mass and centre of mass from readings in a few poses at rest."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import STANDARD_GRAVITY, Arm
from taut.base.checks import finite_array, one_of, positive_scalar, read_only, vector, whole_number
from taut.base.errors import NumericalError, RangeError, ShapeError, UsageError
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.sensing import Wrist
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.wrist import sensor_place
from taut.trace import math as tm
from taut.trace.pose import Pose

MIN_SPREAD: Final = 0.05  # [rad] RMS, about 3 degrees: rotation of gravity that tells the numbers apart
SIGNIFICANT: Final = 4.0  # standard deviations by which a mass must differ from zero
AT_END: Final = 1.0 - 1e-9  # of the range
FORCE_AND_MOMENT: Final = "N, N m"

CANDIDATES: Final = 400
SEED: Final = 0
JOINT_LIMIT_MARGIN: Final = 0.05  # of a joint's range, to its limits
MAX_LOAD: Final = 0.9  # of a joint's torque limit, under the weight of the arm in a pose
TRAVEL_WEIGHT: Final = 0.5  # of the displacement from the start, against the logarithm of the information
MIN_SUGGESTED_SPREAD: Final = 0.1  # [rad] RMS
FLOOR: Final = 1e-3  # of the information, so that the first poses count too


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
    spread: tuple[float, float]  # [rad] rotation of gravity in the sensor's axes: in all, and off its main direction
    condition: float  # of the least squares, 1 at best; above 10 the poses are too much alike
    poses: int  # readings that were used
    frame: str | None  # the sensor's frame; None for the tool's own, or without an arm
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
    *,
    arm: Arm | None = None,
    q: ArrayLike | None = None,
    poses: Iterable[Pose] | None = None,
    axes: Literal["sensor", "world"] = "sensor",
    frame: str | None = None,
    gravity: ArrayLike | None = None,
    range: ArrayLike | None = None,
) -> WristCalibration:
    """Bias of a wrist sensor, and mass and centre of the tool beyond it, by least squares.

    Law:          reading_i = bias + (m g_i, m c x g_i), with gravity g_i in the sensor's axes: linear in bias, m, m c

    Poses must rotate gravity in the sensor's axes: two directions determine the mass, three that are not on one line
    the centre of mass too, and a rotation about the vertical adds nothing. `taut.analysis.calibration_poses(arm)`
    suggests good ones. A mass that is not significant is taken for none.

    Args:
        wrenches: (k, 6) readings at rest without contact, force first: of the tool on the arm, the sign of F_ext.
        arm: The arm, with q; or give poses.
        q: (k, n) measured positions at each reading [rad | m].
        poses: Instead, k poses of the sensor in the world.
        axes: "sensor", at its origin; "world" for F_ext of `ctrl.step` and runs, at the tool's origin of the arm.
        frame: The sensor's frame, one of the tool's body; the tool's own if None. With the arm only.
        gravity: (3,) in the world [m/s^2]; the arm's, or 9.81 m/s^2 downwards.
        range: (6,) or (force, moment), range of the sensor [N, N m]: readings there are refused.

    Raises:
        UsageError: Neither an arm with positions nor poses, or both.
        ShapeError: Another number of poses than of readings.
        RangeError: A reading that is not finite, at the end of the range, or of the opposite sign.
        NumericalError: Poses that do not determine the numbers; the message names them and a pose that helps.

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
    default = np.array(STANDARD_GRAVITY) if arm is None else arm.gravity
    g = vector("gravity", default if gravity is None else gravity, 3, unit="m/s^2")
    if not g.any():
        raise RangeError("gravity must not be zero: without it a tool has no weight to read", name="gravity")
    end = Wrist(range=range).range
    if end is not None:
        _require_within(F, end)
    return _fitted(F, np.array([turn.T @ g for turn in R]), frame, end)


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
    """Readings in the sensor's axes, and its orientations, without an arm."""
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
            f"wrenches[{row}, {axis}] is at the end of the sensor's range of {end[axis]:g}, so that the true "
            "wrench is not known; leave that pose out, or use a lighter tool",
            name="wrenches",
            value=float(F[row, axis]),
        )


def _fitted(F: Float64Array, g: Float64Array, frame: str | None, end: Float64Array | None) -> WristCalibration:
    """Least squares of force and of moment, which share no unknown but the mass that divides m c."""
    size = float(np.linalg.norm(g[0]))
    spread = _require_determined(g / size)
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


def _least_squares(A: Float64Array, y: Float64Array) -> tuple[Any, Any, Float64Array]:
    """The solution, its variances, and (k, 3) the residuals."""
    x = np.linalg.lstsq(A, y.ravel(), rcond=None)[0]
    residual = y - (A @ x).reshape(y.shape)
    variance = float(np.sum(residual**2)) / (y.size - A.shape[1])
    return x, variance * np.diag(np.linalg.inv(A.T @ A)), residual


def _require_determined(u: Float64Array) -> tuple[float, float]:
    """Rotation of gravity in the sensor's axes [rad]: in all, and off the line along which it is largest."""
    middle = u.mean(axis=0)
    values, directions = np.linalg.eigh((u - middle).T @ (u - middle) / len(u))
    values = np.maximum(values, 0.0)
    whole, off = math.sqrt(values.sum()), math.sqrt(values[0] + values[1])
    if whole < MIN_SPREAD:
        across = _words(_perpendicular(u[0]))
        raise NumericalError(
            f"the {len(u)} poses have the same orientation to gravity within {math.degrees(whole):.1f} degrees, so "
            "that mass, com, the bias force along gravity and the bias moment are not determined; add poses in which "
            f"gravity points along other axes of the sensor, such as {across} (a rotation about the vertical adds "
            "nothing)",
            name="poses",
        )
    if off < MIN_SPREAD:
        main = directions[:, 2]
        normal = np.cross(main, middle)
        size = float(np.linalg.norm(normal))
        missing = _words(normal / size if size > MIN_SPREAD else _perpendicular(main))
        raise NumericalError(
            f"gravity points along no more than two directions of the sensor's axes in the {len(u)} poses, so that "
            f"com along {_words(main)} and the bias moment across it are not determined; add a pose in which "
            f"gravity points along {missing}",
            name="poses",
        )
    return whole, off


def _perpendicular(u: Float64Array) -> Float64Array:
    """A unit vector across another one, along the axis of the sensor that is the most across."""
    axis = np.eye(3)[int(np.argmin(np.abs(u)))]
    across = axis - u * (u @ axis)
    return np.asarray(across / np.linalg.norm(across))


def _words(u: Float64Array) -> str:
    """A direction in the sensor's axes, whose sign does not matter."""
    sign = -1.0 if u[int(np.argmax(np.abs(u)))] < 0.0 else 1.0
    return "(" + ", ".join(f"{sign * x + 0.0:.2f}" for x in u) + ")"


def calibration_poses(
    arm: Arm, *, count: int = 8, travel: float = 1.5, q: ArrayLike | None = None, frame: str | None = None
) -> Float64Array:
    """(count, n) poses [rad | m] for `calibrate_wrist`, in which bias, mass and its centre are well determined.

    After the arm's own pose, each is the candidate that adds the most to the determinant of the information on the
    centre of mass, less a little for the displacement, with a margin to the limits of joints and torques. Obstacles
    and self-collision are not considered: look at the poses before a real arm goes there.

    Args:
        arm: The arm.
        count: Number of poses, at least 3.
        travel: Largest displacement of a joint from q [rad | m].
        q: (n,) where to start from; home if None.
        frame: The sensor's frame, one of the tool's body; the tool's own if None.


    Raises:
        RangeError: Fewer than three poses, no travel.
        NumericalError: The arm cannot rotate its tool against gravity, or hold its own weight in enough poses.

    Example:
        >>> import taut
        >>> calibration_poses(taut.load_arm("planar3"), count=4).shape
        (4, 3)
    """
    count = whole_number("count", count, minimum=3)  # directions of gravity that determine all numbers
    travel = positive_scalar("travel", travel, unit="rad | m")
    start = arm.home if q is None else finite_array("q", q, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
    place, model = sensor_place(arm, frame, "calibration_poses"), model_of(arm)
    near = _candidates(arm, start, travel)
    gravity = np.array([(dyn.pose(model, row).R @ place.R_ES).T @ arm.gravity for row in near])
    u = gravity / np.linalg.norm(arm.gravity)
    cost = TRAVEL_WEIGHT * np.abs(near - start).max(axis=1) / travel
    if len(near) < count:
        raise NumericalError(
            f"the torques of arm '{arm.name}' hold its weight in {len(near) - 1} of {CANDIDATES} poses around the "
            f"start, which are too few to choose {count} from; start from another q=, or give less travel=",
            name="arm",
        )
    chosen = [0]
    for _ in range(count - 1):
        sets = np.array([u[[*chosen, i]] for i in range(len(near))])
        gain = np.linalg.slogdet(_information(sets) + FLOOR * np.eye(3))[1] - cost
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
    if np.linalg.eigvalsh(_information(u[chosen]))[0] < len(chosen) * MIN_SUGGESTED_SPREAD**2:
        raise NumericalError(
            f"arm '{arm.name}' rotates its tool too little against gravity within {travel:g} rad of the start to "
            "tell mass and com from the bias; start from another q=, give more travel=, or weigh the tool",
            name="arm",
        )
    return near[chosen]


def _candidates(arm: Arm, start: Float64Array, travel: float) -> Float64Array:
    """The start, and positions around it in which the torque limits hold the weight."""
    rng = np.random.default_rng(SEED)
    span = np.where(np.isfinite(arm.upper - arm.lower), arm.upper - arm.lower, 0.0)
    low = np.maximum(arm.lower + JOINT_LIMIT_MARGIN * span, start - travel)
    high = np.minimum(arm.upper - JOINT_LIMIT_MARGIN * span, start + travel)
    low, high = np.minimum(low, start), np.maximum(high, start)  # for a start that is closer to a limit
    drawn = rng.uniform(low, high, size=(CANDIDATES, arm.n))
    drawn[: CANDIDATES // 2, : max(arm.n - 3, 0)] = start[: max(arm.n - 3, 0)]  # half of them move the wrist alone
    payload = PayloadValues(mass=arm.payload.mass, com=arm.payload.com, inertia=arm.payload.inertia)
    model = model_of(arm)
    held = [row for row in drawn if (np.abs(dyn.gravity_torque(model, row, payload)) <= MAX_LOAD * arm.effort).all()]
    return np.vstack([start, *held])


def _information(u: Float64Array) -> Float64Array:
    """(..., 3, 3) information of directions of gravity (..., k, 3) on a centre of mass beside an unknown bias."""
    off = u - u.mean(axis=-2, keepdims=True)
    S = np.swapaxes(off, -1, -2) @ off
    return np.asarray(np.trace(S, axis1=-2, axis2=-1)[..., np.newaxis, np.newaxis] * np.eye(3) - S)
