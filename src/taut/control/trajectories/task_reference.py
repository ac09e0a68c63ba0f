"""TaskMotion: what a law of task space follows; and TaskSamples, recorded or computed poses as a motion."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from taut.base.checks import finite_scalar, one_of, read_only, vector
from taut.base.errors import FileError, ShapeError, TautError, UsageError
from taut.base.types import Array, ArrayLike, Float64Array
from taut.control.tables import read_rows, require_moderate, sample_times
from taut.control.trajectories.reference import Sample
from taut.control.trajectories.task_blend import between
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import exp_rows, log_rows, rotated
from taut.trace.pose import Pose

__all__ = ["TaskMotion", "TaskSamples"]

MotionFrame = Literal["world", "tool"]
FRAMES: Final[tuple[MotionFrame, ...]] = ("world", "tool")


@dataclass(frozen=True, slots=True, init=False, eq=False)
class TaskMotion(Sample):
    """Desired pose, twist and acceleration of the tool.

    Frames:
        `pose` is T_WD, of the desired tool frame D in the world. With frame="world" `twist` is the velocity of D's
        origin and its angular velocity, in world axes, and `acceleration` the rate of both. With frame="tool" they
        are the body twist of D and the rate of its numbers, as the textbook's are; they are kept in world axes.

    Args:
        pose: Where the tool is to be.
        twist: (6,) linear part first [m/s, rad/s]; zero if left out.
        acceleration: (6,) linear part first [m/s^2, rad/s^2]; zero if left out.
        frame: The axes of twist and acceleration, "world" or "tool".

    Raises:
        UsageError: No Pose, or a frame that is neither.
        ShapeError: Not six numbers.
        RangeError: NaN or infinite numbers.

    Example:
        >>> pose = Pose([0.4, 0.0, 0.3], rpy=[0.0, np.pi, 0.0])
        >>> ref = TaskMotion(pose=pose, twist=[0, 0, 1, 0, 0, 0], frame="tool")
        >>> ref.twist.round(6).tolist()
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]

    References:
        Section 10.2.3 task space motion control.
    """

    p: Array  # (3,) [m]
    R: Array  # (3, 3)
    twist: Array  # (6,) world axes
    acceleration: Array  # (6,) world axes

    def __init__(
        self,
        *,
        pose: Pose,
        twist: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        frame: MotionFrame = "world",
    ) -> None:
        if not isinstance(pose, Pose):  # callers without a type checker
            raise UsageError(
                f"ref.pose must be a taut.Pose(p=..., rpy=...); got {type(pose).__name__}", name="ref.pose"
            )
        one_of("frame", frame, FRAMES)
        V = np.zeros(6) if twist is None else vector("ref.twist", twist, 6, unit="m/s, rad/s")
        rate = vector("ref.acceleration", np.zeros(6) if acceleration is None else acceleration, 6)
        if frame == "tool":
            rate = rotated(pose.R, rate) + np.append(np.cross(pose.R @ V[3:], pose.R @ V[:3]), np.zeros(3)) + 0.0
            V = rotated(pose.R, V) + 0.0
        for name, value in (("p", pose.p), ("R", pose.R), ("twist", V), ("acceleration", rate)):
            object.__setattr__(self, name, read_only(value))

    @property
    def pose(self) -> Pose:
        """T_WD, where the tool is to be."""
        return Pose.of(self.R, self.p)

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:  # noqa: ARG003
        return {"p": (3,), "R": (3, 3), "twist": (6,), "acceleration": (6,)}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        made = object.__new__(cls)
        for name in ("p", "R", "twist", "acceleration"):
            object.__setattr__(made, name, values[name])
        return made

    @classmethod
    def between(
        cls, times: Float64Array, knots: Float64Array, rows: Mapping[str, Float64Array]
    ) -> dict[str, Float64Array]:
        return between(times, knots, rows)

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:
        T, zero = x.T(tool), np.zeros(6)
        return cls.of({"p": T.p, "R": T.R, "twist": zero, "acceleration": zero})

    def __repr__(self) -> str:
        if self.p.dtype == object:
            return "TaskMotion(<traced>)"
        return (
            f"TaskMotion(pose={self.pose!r}, twist={self.twist.tolist()}, acceleration={self.acceleration.tolist()})"
        )


Interpolation = Literal["spline", "linear"]
WAYS: Final[tuple[Interpolation, ...]] = ("spline", "linear")
ORDERS: Final = {  # of a rotation's columns in a file
    "xyzw": ("qx", "qy", "qz", "qw"),
    "wxyz": ("qw", "qx", "qy", "qz"),
    "rpy": ("roll", "pitch", "yaw"),
}
EXAMPLE: Final = "t, x, y, z, qx, qy, qz, qw"


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskSamples:
    """Poses at stated times. Before the first it rests there, after the last there.

    With "spline", positions are a cubic spline and orientations a rotation spline with continuous acceleration
    (SciPy's `RotationSpline`); both start and end at rest. With "linear", positions are linear in between and
    orientations slerp; the twist jumps at each sample, and the acceleration is zero. Twists and accelerations are the
    rates of that motion. Of a rotation by exactly pi from one sample to the next either way may be gone.

    Args:
        times: (k,) [s], increasing.
        poses: k poses.
        interpolation: "spline" or "linear".

    Raises:
        ShapeError: Not as many poses as times.
        RangeError: Times that do not increase.
        UsageError: Something that is no pose, another interpolation.

    Example:
        >>> poses = [Pose([0.4, 0.0, 0.3]), Pose([0.4, 0.1, 0.3]), Pose([0.4, 0.1, 0.4])]
        >>> TaskSamples(times=[0.0, 1.0, 2.0], poses=poses, interpolation="linear").at(0.5).twist.tolist()
        [0.0, 0.1, 0.0, 0.0, 0.0, 0.0]
    """

    times: ArrayLike  # (k,) [s]
    poses: Sequence[Pose]
    interpolation: Interpolation = "spline"

    def __post_init__(self) -> None:
        one_of("interpolation", self.interpolation, WAYS)
        times, poses = sample_times(self.times), self.poses
        if not isinstance(poses, Sequence) or not all(isinstance(pose, Pose) for pose in poses):
            raise UsageError("poses must be a list of taut.Pose(p=..., rpy=...)", name="poses")
        if len(poses) != len(times):
            raise ShapeError(
                f"poses must have one pose per time; got {len(poses)} for {len(times)} times", name="poses"
            )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "poses", tuple(poses))
        p, R = np.stack([pose.p for pose in poses]), np.stack([pose.R for pose in poses])
        require_moderate("poses", p)
        made: Any = _Linear(times, p, R)
        if self.interpolation == "spline" and len(times) > 1:
            made = _Spline(times, p, R)
        object.__setattr__(self, "_motion", made)

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str], *, interpolation: Interpolation = "spline") -> TaskSamples:
        """Samples from a CSV file: a header, then one row per sample.

        Args:
            path: The header names the columns `t, x, y, z` and those of the rotation, which say its order:
                `qx, qy, qz, qw`, or `qw, qx, qy, qz`, or `roll, pitch, yaw` [rad].
            interpolation: "spline" or "linear".

        Raises:
            FileError: No such file, no header, a column or a number that does not fit, a row that is no pose.
        """
        header, table = read_rows(path, EXAMPLE, _columns)
        order = next(word for word, names in ORDERS.items() if tuple(header[4:]) == names)
        poses = []
        for number, row in enumerate(table, start=1):
            try:
                poses.append(Pose(row[1:4], **{order: row[4:]}))
            except TautError as cause:
                raise FileError(f"{path}, sample {number}: {cause}", name=str(path)) from cause
        return cls(times=table[:, 0], poses=poses, interpolation=interpolation)

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(np.asarray(self.times)[-1])

    def at(self, t: float) -> TaskMotion:
        """The sample at time t [s]."""
        rows = self.rows(np.array([finite_scalar("t", t, unit="s")]))
        return TaskMotion.of({name: getattr(rows, name)[0] for name in TaskMotion.fields(1)})

    def rows(self, times: Float64Array) -> TaskMotion:
        """Samples at many times, as arrays (k, ...)."""
        knots = np.asarray(self.times)
        p, R, twist, acceleration = self._motion.rows(np.clip(times, knots[0], knots[-1]))  # type: ignore[attr-defined]
        outside = (times < knots[0]) | (times > knots[-1])
        twist[outside] = acceleration[outside] = 0.0
        return TaskMotion.of({"p": p, "R": R, "twist": twist, "acceleration": acceleration})


def _columns(header: Sequence[str]) -> list[str]:
    """What the columns of a file with this header should be."""
    rotation = next((names for names in ORDERS.values() if names[0] == (header[4:5] or [""])[0]), ORDERS["xyzw"])
    return ["t", "x", "y", "z", *rotation]


Rows = tuple[Float64Array, Float64Array, Float64Array, Float64Array]  # p, R, twist, acceleration


class _Linear:
    """Straight lines with slerp."""

    def __init__(self, knots: Float64Array, p: Float64Array, R: Float64Array) -> None:
        self._knots, self._p, self._R = knots, p, R
        h = np.diff(knots)[:, np.newaxis]
        self._v = np.diff(p, axis=0) / h
        self._omega = log_rows(R[:-1].transpose(0, 2, 1) @ R[1:]) / h  # in the axes of both ends

    def rows(self, times: Float64Array) -> Rows:
        zero = np.zeros((len(times), 6))
        if len(self._knots) == 1:
            places = np.zeros(len(times), dtype=np.intp)
            return self._p[places], self._R[places], zero, zero.copy()
        i = np.clip(np.searchsorted(self._knots, times, side="right") - 1, 0, len(self._knots) - 2)
        passed = (times - self._knots[i])[:, np.newaxis]
        R = self._R[i] @ exp_rows(passed * self._omega[i])
        twist = np.hstack([self._v[i], np.einsum("kij,kj->ki", self._R[i], self._omega[i])])
        return self._p[i] + passed * self._v[i], R, twist, zero


class _Spline:
    """A cubic spline of positions and a rotation spline, both at rest at their ends."""

    def __init__(self, knots: Float64Array, p: Float64Array, R: Float64Array) -> None:
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        self._knots = knots
        self._p = CubicSpline(knots, p, bc_type="clamped")
        self._R = RotationSpline(knots, Rotation.from_matrix(R))

    def rows(self, times: Float64Array) -> Rows:
        s, rate, second = self._eased(times)
        R = self._R(s).as_matrix()
        omega = rate * self._R(s, 1)  # in the tool's axes
        alpha = rate**2 * self._R(s, 2) + second * self._R(s, 1)
        angular = [np.einsum("kij,kj->ki", R, x) for x in (omega, alpha)]
        twist, acceleration = (np.hstack([self._p(times, k + 1), x]) for k, x in enumerate(angular))
        return self._p(times), R, twist, acceleration

    def _eased(self, times: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Time of the rotation spline, which starts and ends at a rate: eased in its first and last piece.

        The time runs evenly where the pieces meet, so that the angular acceleration stays continuous.
        """
        knots = self._knots
        s, rate, second = times.copy(), np.ones((len(times), 1)), np.zeros((len(times), 1))
        ease = EASE if len(knots) > 2 else REST_TO_REST
        for end, inner, forwards in ((knots[0], knots[1], True), (knots[-1], knots[-2], False)):
            h = inner - end
            here = (times <= inner) if forwards else (times > inner)
            if len(knots) == 2:
                here = np.full(len(times), forwards)
            x = (times[here] - end) / h
            s[here] = end + h * ease(x)
            rate[here, 0] = ease.deriv()(x)
            second[here, 0] = ease.deriv(2)(x) / h
        return s, rate, second


EASE: Final = np.polynomial.Polynomial((0.0, 0.0, 3.0, -3.0, 1.0))  # from rest to an even run
REST_TO_REST: Final = np.polynomial.Polynomial((0.0, 0.0, 3.0, -2.0))
