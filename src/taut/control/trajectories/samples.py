"""Samples at stated times as trajectories: of joints, of the tool, of a learned policy; and CSV files of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from io import StringIO
from typing import Any, Final

import numpy as np

from taut.base.checks import finite_array, readable_file
from taut.base.errors import FileError, RangeError, ShapeError, TautError
from taut.base.fields import Field, Parts, Plain
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.reference import JointMotion, Sample, Trajectory, rows_of, stacked
from taut.control.trajectories.task_reference import TaskMotion, differences, rotated_rows
from taut.control.trajectories.timing import COEFFICIENTS, MAX_OF_MOTION, Motion, S
from taut.trace.pose import Pose

MIN_SAMPLE_GAP: Final = 1e-12  # [s]
MAX_CSV_BYTES: Final = 32 * 2**20  # half a million samples of an arm
MAX_QUOTED: Final = 300  # letters of a quotation in a message
SAME_TICK: Final = 1e-6  # [ticks] by which rounding may put a time before its tick


def sample_times(times: ArrayLike) -> Float64Array:
    """(k,) times [s], one at least, increasing."""
    t = finite_array("times", times, unit="s")
    if t.ndim != 1 or not t.size:
        raise ShapeError(f"times must be a vector (k,); got shape {t.shape}", name="times")
    wrong = np.diff(t) < MIN_SAMPLE_GAP
    if wrong.any():
        k = int(np.argmax(wrong))
        raise RangeError(
            f"times must increase; times[{k + 1}] = {t[k + 1]:.15g} follows {t[k]:.15g}",
            name="times",
            rule="increasing",
        )
    return t


class Sampled(Motion[S]):
    """Base of motions by samples at stated `times`, which `check` keeps as `_knots`, a sample of arrays (k, ...)."""

    def rows(self, times: Float64Array) -> S:
        knots = self.__dict__["_knots"]
        table = {name: getattr(knots, name) for name in knots.fields(1)}
        made: S = knots.of(knots.between(times, self.__dict__["times"], table))
        return made

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.__dict__["times"][-1])


def stated_times() -> Field:
    """The field `times` of a motion by samples."""
    return Field(unit="s", shape="k", minimum=-MAX_OF_MOTION, maximum=MAX_OF_MOTION, convert=sample_times)


def _table(unit: str, *, optional: bool = False) -> Field:
    return Field(unit=unit, shape=("k", "n"), minimum=-MAX_OF_MOTION, maximum=MAX_OF_MOTION, optional=optional)


class Samples(Sampled[JointMotion]):
    """Recorded or computed samples of joints, linear in between.

    Args:
        times: (k,) [s], increasing.
        q: (k, n) [rad | m].
        v: (k, n) [rad/s | m/s]; differences of q if left out.
        a: (k, n) [rad/s^2 | m/s^2]; differences of v if left out.

    Example:
        >>> Samples(times=[0.0, 1.0, 2.0], q=[[0.0], [1.0], [2.0]]).at(0.5).v.tolist()
        [1.0]
    """

    times: Field = stated_times()
    q: Field = _table("rad | m")
    v: Field = _table("rad/s | m/s", optional=True)
    a: Field = _table("rad/s^2 | m/s^2", optional=True)

    def check(self) -> None:
        k, n = len(self.times), self.q.shape[1]
        for name, before in (("q", "q"), ("v", "q"), ("a", "v")):
            if getattr(self, name) is None:
                self.__dict__[name] = _rates(self.times, getattr(self, before))
            if getattr(self, name).shape != (k, n):
                rule = f"must have shape ({k}, {n}), a row for each of the times; got {getattr(self, name).shape}"
                self.refuse(name, rule, ShapeError)
        self.__dict__["_knots"] = JointMotion.of({name: getattr(self, name) for name in "qva"})

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> Samples:
        """Samples from a CSV file: a header, then rows of t and n positions, or also n velocities, n accelerations.

        Args:
            path: The header names the columns `t`, `q1` ... `qn`, and optionally `v1` ... and `a1` ...

        Raises:
            FileError: No such file, no header, a column or a number that does not fit.
        """
        header, table = read_rows(path, _joint_columns)
        n = sum(word.startswith("q") for word in header)
        letters = dict.fromkeys(word[0] for word in header[1:])
        parts = {letter: table[:, 1 + k * n : 1 + (k + 1) * n] for k, letter in enumerate(letters)}
        return cls(times=table[:, 0], **parts)


class Learned(Motion[JointMotion]):
    """A motion of joints with an input added to its acceleration, such as `taut.analysis.learn` finds.

    The input is held from tick to tick, and is zero before and after its samples.

    Args:
        motion: A sample or a trajectory of joints.
        u: (k, n) input [rad/s^2 | m/s^2], from time 0 on.
        period: Time between samples of the input [s].

    Example:
        >>> Learned(motion=JointMotion(q=[0.5]), u=[[1.0], [2.0]], period=0.1).at(0.15).a.tolist()
        [2.0]
    """

    motion: Plain[Any] = Plain()
    u: Field = Field(unit="rad/s^2 | m/s^2", shape=("k", "n"), minimum=-MAX_OF_MOTION, maximum=MAX_OF_MOTION)
    period: Field = Field(unit="s", above=0.0, run_time=False)

    def check(self) -> None:
        if not isinstance(self.motion, (Sample, Trajectory)):
            self.refuse("motion", f"must be a sample or a trajectory of joints; got {type(self.motion).__name__}")
        n = rows_of(self.motion, np.zeros(1), JointMotion).q.shape[1]  # type: ignore[attr-defined]  # of joints
        if self.u.shape[1] != n:
            self.refuse("u", f"must have a column for each of the {n} joints; got {self.u.shape}", ShapeError)

    def rows(self, times: Float64Array) -> JointMotion:
        sample: Any = rows_of(self.motion, times, JointMotion)
        k = np.floor(times / self.period + SAME_TICK).astype(np.intp)
        inside = (k >= 0) & (k < len(self.u))
        held = self.u[np.clip(k, 0, len(self.u) - 1)] * inside[:, np.newaxis]
        return JointMotion.of({"q": sample.q, "v": sample.v, "a": sample.a + held})


def _rates(times: Float64Array, values: Float64Array) -> Float64Array:
    """(k, n) differences of values (k, n) over the times."""
    if len(times) == 1 or len(values) != len(times):
        return np.zeros_like(values)
    return np.asarray(np.gradient(values, times, axis=0))


def _joint_columns(header: Sequence[str]) -> list[str]:
    """Expected columns of a file with this header."""
    letters = ["q", *(letter for letter in "va" if any(word.startswith(letter) for word in header[1:]))]
    n = max(1, sum(word.startswith("q") for word in header))
    return ["t", *(f"{letter}{i + 1}" for letter in letters for i in range(n))]


ROTATION_COLUMNS: Final = {  # in a file
    "xyzw": ("qx", "qy", "qz", "qw"),
    "wxyz": ("qw", "qx", "qy", "qz"),
    "rpy": ("roll", "pitch", "yaw"),
}
EASE: Final = np.polynomial.Polynomial((0.0, 0.0, 3.0, -3.0, 1.0))  # from rest to an even run


class TaskSamples(Sampled[TaskMotion]):
    """Poses at stated times. Before the first and after the last it rests.

    Positions are a cubic spline and orientations a rotation spline with continuous acceleration (SciPy's
    `RotationSpline`); both start and end at rest. A rotation by exactly pi between samples may go in either
    direction.

    Args:
        times: (k,) [s], increasing, k >= 2.
        poses: k poses.

    Raises:
        ShapeError, RangeError: Not as many poses as times, or only one; times that do not increase.
        UsageError: Something that is no pose.
    """

    times: Field = stated_times()
    poses: Parts[tuple[Pose, ...]] = Parts(Pose)  # type: ignore[arg-type]  # a tuple of them

    def check(self) -> None:
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        if len(self.poses) != len(self.times) or len(self.times) < 2:
            rule = f"must have one pose for each time, and two at least; got {len(self.poses)} for {len(self.times)}"
            self.refuse("poses", f"{rule} times", ShapeError)
        p, R = np.stack([pose.p for pose in self.poses]), np.stack([pose.R for pose in self.poses])
        if np.abs(p).max() > MAX_OF_MOTION:
            self.refuse("poses", f"must be within +-{MAX_OF_MOTION:g} m; got {np.abs(p).max():g}", RangeError)
        self.__dict__["_p"] = CubicSpline(self.times, p, bc_type="clamped")
        self.__dict__["_R"] = RotationSpline(self.times, Rotation.from_matrix(R))

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> TaskSamples:
        """Samples from a CSV file: a header, then one row per sample.

        Args:
            path: The header names the columns `t, x, y, z` and those of the rotation, which say its order:
                `qx, qy, qz, qw`, or `qw, qx, qy, qz`, or `roll, pitch, yaw` [rad].

        Raises:
            FileError: No such file, no header, a column or a number that does not fit, a row that is no pose.
        """
        header, table = read_rows(path, _task_columns)
        order = next(word for word, names in ROTATION_COLUMNS.items() if tuple(header[4:]) == names)
        poses = []
        for number, row in enumerate(table, start=1):
            try:
                poses.append(Pose(row[1:4], **{order: row[4:]}))
            except TautError as cause:
                raise FileError(f"{path}, sample {number}: {cause}", name=str(path)) from cause
        return cls(times=table[:, 0], poses=poses)

    def rows(self, times: Float64Array) -> TaskMotion:
        t = np.clip(times, self.times[0], self.times[-1])
        position, rotation = self.__dict__["_p"], self.__dict__["_R"]
        s, rate, second = self._eased(t)
        R = rotation(s).as_matrix()
        omega = rate * rotation(s, 1)  # in the tool's axes
        alpha = rate**2 * rotation(s, 2) + second * rotation(s, 1)
        inside = (t == times)[:, np.newaxis]
        twist = np.hstack([position(t, 1), rotated_rows(R, omega)]) * inside
        acceleration = np.hstack([position(t, 2), rotated_rows(R, alpha)]) * inside
        return TaskMotion.of({"p": position(t), "R": R, "twist": twist, "acceleration": acceleration})

    def _eased(self, times: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Time of the rotation spline, which does not start and end at rest: eased in its first and last piece.

        The time runs evenly where the pieces meet, so that the angular acceleration stays continuous.
        """
        knots = self.times
        s, rate, second = times.copy(), np.ones((len(times), 1)), np.zeros((len(times), 1))
        ease = EASE if len(knots) > 2 else COEFFICIENTS["cubic"]
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


def _task_columns(header: Sequence[str]) -> list[str]:
    """Expected columns of a file with this header."""
    orders = ROTATION_COLUMNS.values()
    return ["t", "x", "y", "z", *next((names for names in orders if names[:1] == tuple(header[4:5])), (*orders,)[0])]


class Chunk(Sampled[Sample]):
    """A few future samples with their times, as a learned policy emits them; made by `taut.chunk`.

    Between joint motions it is linear in each number, between task motions a smooth motion through their poses,
    twists and accelerations. Before its first time it rests at its first position, after its last time at its last.
    """

    times: Field = stated_times()  # from the moment it starts
    samples: Parts[tuple[Sample, ...]] = Parts(Sample)  # type: ignore[arg-type]  # a tuple of them

    def check(self) -> None:
        if len(self.samples) != len(self.times):
            rule = f"must have one sample for each time; got {len(self.samples)} for {len(self.times)} times"
            self.refuse("targets", rule, ShapeError)
        self.__dict__["_knots"] = stacked(self.samples)


def chunk(times: ArrayLike, targets: Sequence[Sample] | Sequence[Pose] | ArrayLike) -> Chunk:
    """A few future samples with their times.

    From one `taut.TaskMotion` to the next the tool moves smoothly, as a quintic of its position and of its rotation
    vector that has their twists and accelerations, zero by default. From poses alone twists and accelerations follow
    by differences, so that two of them make a straight line with slerp.

    Args:
        times: (k,) [s] from the moment the chunk starts, increasing.
        targets: k samples, or k poses, or joint positions (k, n), whose velocities then follow from the differences.

    Raises:
        ShapeError, RangeError: Not as many targets as times, or times that do not increase.

    Example:
        >>> chunk([0.0, 0.1], [[0.0], [1.0]]).at(0.05).q.tolist()
        [0.5]
        >>> ahead = chunk([0.0, 0.1], [Pose([0.4, 0.0, 0.3]), Pose([0.4, 0.02, 0.3], rpy=[0.0, 0.0, 0.2])])
        >>> ahead.at(0.05).pose.rpy.round(6).tolist(), ahead.at(0.05).twist.round(6).tolist()
        ([0.0, 0.0, 0.1], [0.0, 0.2, 0.0, 0.0, 0.0, 2.0])
    """
    t = sample_times(times)
    kinds: Any = {type(target) for target in targets} if isinstance(targets, Sequence) else set()
    if kinds and all(issubclass(kind, Sample) for kind in kinds):
        return Chunk(times=t, samples=targets)
    if kinds == {Pose}:
        return Chunk(times=t, samples=_through_poses(t, targets))  # type: ignore[arg-type]  # checked in the line above
    q = finite_array("targets", targets, unit="rad | m")  # type: ignore[arg-type]  # checked inside
    if q.ndim != 2:
        raise ShapeError(f"targets must have shape (k, n); got {q.shape}", name="targets")
    return Chunk(times=t, samples=[JointMotion(q=row, v=v) for row, v in zip(q, _rates(t, q), strict=True)])


def _through_poses(t: Float64Array, poses: Sequence[Pose]) -> list[TaskMotion]:
    """Samples at poses, with twists and accelerations by differences."""
    if len(poses) != len(t):
        return [TaskMotion(pose=pose) for pose in poses]  # which the chunk refuses
    p, R = np.stack([pose.p for pose in poses]), np.stack([pose.R for pose in poses])
    rows = zip(poses, *differences(t, p, R), strict=True)
    return [TaskMotion(pose=pose, twist=V, acceleration=rate) for pose, V, rate in rows]


def read_rows(
    path: str | os.PathLike[str], columns: Callable[[Sequence[str]], Sequence[str]]
) -> tuple[list[str], Float64Array]:
    """Header and numbers (rows, columns) of a CSV file with first column t; `columns` gives the expected header."""
    file = readable_file("CSV file", path)
    name = str(file)
    if file.stat().st_size > MAX_CSV_BYTES:
        raise FileError(
            f"CSV file '{file}' is larger than {MAX_CSV_BYTES // 2**20} MB; give longer tables as arrays: "
            "taut.trajectories.Samples(...)",
            name=name,
        )
    with file.open(encoding="utf-8-sig", errors="replace") as lines:
        header, numbers = [word.strip() for word in lines.readline().split(",")], lines.read()
    expected = list(columns(header))
    if header != expected:
        raise FileError(f"{file}: the columns must be {_quoted(expected)}; got {_quoted(header)}", name=name)
    if not numbers.strip():
        raise FileError(f"{file}: there are no samples below the header", name=name)
    try:
        table = np.loadtxt(StringIO(numbers), delimiter=",", ndmin=2, comments=None)
    except ValueError as cause:
        raise FileError(f"{file}: below the header, {_quoted([str(cause)])}", name=name) from cause
    if table.shape[1] != len(header):
        raise FileError(f"{file}: {len(header)} numbers are needed in a row; got {table.shape[1]}", name=name)
    return header, table


def _quoted(words: Sequence[str]) -> str:
    text = ", ".join(words)
    return text if len(text) <= MAX_QUOTED else f"{text[: MAX_QUOTED - 3]}..."
