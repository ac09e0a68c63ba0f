"""Trajectories: joint motions as functions of time, with `at(t)` for one time and `rows(times)` for many.

Before its start a trajectory rests at its first point, after its end at its last.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.base.checks import finite_array, finite_scalar, positive_scalar, read_only, require_positive
from taut.base.errors import NumericalError, ShapeError, missing_extra
from taut.base.types import ArrayLike, Float64Array
from taut.control.tables import read_rows, require_moderate, sample_times
from taut.control.trajectories.reference import JointMotion
from taut.control.trajectories.timing import (
    CUBIC,
    QUINTIC,
    Scaling,
    polynomial,
    require_finite,
    trapezoid,
    trapezoid_duration,
)

__all__ = [
    "Cubic",
    "JerkLimited",
    "Quintic",
    "Samples",
    "Sine",
    "Spline",
    "Trapezoidal",
]


def _motion(q: Float64Array, v: Float64Array, a: Float64Array, one: bool) -> JointMotion:
    if one:
        q, v, a = q[0], v[0], a[0]
    return JointMotion.of({"q": q, "v": v, "a": a})


def _points(**named: ArrayLike) -> list[Float64Array]:
    """Vectors (n,) of one length; scalars become vectors of that length."""
    arrays = {name: finite_array(name, value) for name, value in named.items()}
    sizes = {name: array.shape for name, array in arrays.items() if array.ndim}
    shape = next(iter(sizes.values()), (1,))
    for name, size in sizes.items():
        if size != shape or len(size) != 1:
            raise ShapeError(f"{name} must have shape {shape[:1]}, like the others; got {size}", name=name)
    return [read_only(np.broadcast_to(array, shape)) for array in arrays.values()]


def _instant(t: float) -> Float64Array:
    """(1,) one time, checked."""
    return np.array([finite_scalar("t", t, unit="s")])


@dataclass(frozen=True, kw_only=True, eq=False)
class Sine:
    """q(t) = center + amplitude sin(2 pi frequency t + phase), each joint on its own.

    Args:
        center: (n,) [rad | m].
        amplitude: (n,) or scalar [rad | m].
        frequency: (n,) or scalar [Hz].
        phase: (n,) or scalar [rad].

    Example:
        >>> Sine(center=[0.0], amplitude=1.0, frequency=0.25).at(1.0).q.tolist()
        [1.0]
    """

    center: ArrayLike
    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0

    def __post_init__(self) -> None:
        names = ("center", "amplitude", "frequency", "phase")
        for name, array in zip(names, _points(**{k: getattr(self, k) for k in names}), strict=True):
            object.__setattr__(self, name, array)

    def at(self, t: float) -> JointMotion:
        """The sample at time t [s]."""
        return self._at(_instant(t), True)

    def rows(self, times: Float64Array) -> JointMotion:
        """Samples at many times, as arrays (k, n)."""
        return self._at(times, False)

    def _at(self, times: Float64Array, one: bool) -> JointMotion:
        omega = 2.0 * np.pi * np.asarray(self.frequency)
        angle = np.outer(times, omega) + np.asarray(self.phase)
        amplitude = np.asarray(self.amplitude)
        q = np.asarray(self.center) + amplitude * np.sin(angle)
        v = amplitude * omega * np.cos(angle)
        return _motion(q, v, -amplitude * omega**2 * np.sin(angle), one)


# -------------------------------------------------------------------- point to point


def _straight(q0: Any, q1: Any, scaling: Scaling, one: bool) -> JointMotion:
    """The straight line q0 + s (q1 - q0), with s and its two rates over time."""
    s, s_dot, s_ddot = (x[:, np.newaxis] for x in scaling)
    reach = q1 - q0
    return _motion(q0 + reach * s, reach * s_dot, reach * s_ddot, one)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cubic:
    """From rest at q0 to rest at q1 in `duration` seconds, s = 3 x^2 - 2 x^3; the acceleration jumps at both ends.

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        duration: [s].
    """

    q0: ArrayLike
    q1: ArrayLike
    duration: float

    def __post_init__(self) -> None:
        _check_line(self)

    def at(self, t: float) -> JointMotion:
        """The sample at time t [s]."""
        return _straight(self.q0, self.q1, self._scaling(_instant(t)), True)

    def rows(self, times: Float64Array) -> JointMotion:
        """Samples at many times, as arrays (k, n)."""
        return _straight(self.q0, self.q1, self._scaling(times), False)

    def _scaling(self, times: Float64Array) -> Scaling:
        return polynomial(times, self.duration, CUBIC)


@dataclass(frozen=True, kw_only=True, eq=False)
class Quintic:
    """From rest at q0 to rest at q1 in `duration` seconds, s = 10 x^3 - 15 x^4 + 6 x^5: minimum jerk.

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        duration: [s].

    Example:
        >>> Quintic(q0=[0.0], q1=[2.0], duration=1.0).at(0.5).q.tolist()
        [1.0]
    """

    q0: ArrayLike
    q1: ArrayLike
    duration: float

    def __post_init__(self) -> None:
        _check_line(self)

    def at(self, t: float) -> JointMotion:
        """The sample at time t [s]."""
        return _straight(self.q0, self.q1, self._scaling(_instant(t)), True)

    def rows(self, times: Float64Array) -> JointMotion:
        """Samples at many times, as arrays (k, n)."""
        return _straight(self.q0, self.q1, self._scaling(times), False)

    def _scaling(self, times: Float64Array) -> Scaling:
        return polynomial(times, self.duration, QUINTIC)


def _check_line(line: Cubic | Quintic | Trapezoidal | JerkLimited) -> None:
    q0, q1 = _points(q0=line.q0, q1=line.q1)
    object.__setattr__(line, "q0", q0)
    object.__setattr__(line, "q1", q1)
    if isinstance(line, (Cubic, Quintic)):
        object.__setattr__(line, "duration", positive_scalar("duration", line.duration, unit="s"))
        require_finite(line.duration, float(np.abs(q1 - q0).max(initial=0.0)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Trapezoidal:
    """From rest to rest with bounded speed and acceleration; all joints start and stop together.

    The slowest joint runs at its limits, the others are scaled to it.

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        velocity: (n,) or scalar, largest speed [rad/s | m/s].
        acceleration: (n,) or scalar, largest acceleration [rad/s^2 | m/s^2].
    """

    q0: ArrayLike
    q1: ArrayLike
    velocity: ArrayLike
    acceleration: ArrayLike

    def __post_init__(self) -> None:
        _check_line(self)
        _, v, a = _points(q0=self.q0, velocity=self.velocity, acceleration=self.acceleration)
        require_positive("velocity", v)
        require_positive("acceleration", a)
        object.__setattr__(self, "velocity", v)
        object.__setattr__(self, "acceleration", a)
        farthest = float(np.abs(np.asarray(self.q1) - np.asarray(self.q0)).max(initial=0.0))
        require_finite(0.0, 0.0, velocity=v, acceleration=a)
        require_finite(self.duration, farthest)

    def _limits(self) -> tuple[float, float]:
        """Largest rate and acceleration of s from 0 to 1 that no joint's limits forbid."""
        reach = np.abs(np.asarray(self.q1) - np.asarray(self.q0))
        with np.errstate(divide="ignore", over="ignore"):
            return float(np.min(self.velocity / reach)), float(np.min(self.acceleration / reach))

    @property
    def duration(self) -> float:
        """Time from start to stop [s]."""
        return trapezoid_duration(*self._limits())

    def at(self, t: float) -> JointMotion:
        """The sample at time t [s]."""
        return _straight(self.q0, self.q1, self._scaling(_instant(t)), True)

    def rows(self, times: Float64Array) -> JointMotion:
        """Samples at many times, as arrays (k, n)."""
        return _straight(self.q0, self.q1, self._scaling(times), False)

    def _scaling(self, times: Float64Array) -> Scaling:
        return trapezoid(times, *self._limits())


@dataclass(frozen=True, kw_only=True, eq=False)
class JerkLimited:
    """From rest to rest, time-optimal under limits of speed, acceleration and jerk (Ruckig).

    Args:
        q0: (n,) [rad | m].
        q1: (n,) [rad | m].
        velocity: (n,) or scalar [rad/s | m/s].
        acceleration: (n,) or scalar [rad/s^2 | m/s^2].
        jerk: (n,) or scalar [rad/s^3 | m/s^3].

    Raises:
        MissingExtraError: Ruckig is not installed.

    References:
        Berscheid and Kroeger, Jerk-limited real-time trajectory generation, RSS 2021.
    """

    q0: ArrayLike
    q1: ArrayLike
    velocity: ArrayLike
    acceleration: ArrayLike
    jerk: ArrayLike

    def __post_init__(self) -> None:
        _check_line(self)
        names = ("velocity", "acceleration", "jerk")
        _, *limits = _points(q0=self.q0, **{name: getattr(self, name) for name in names})
        for name, limit in zip(names, limits, strict=True):
            require_positive(name, limit)
            object.__setattr__(self, name, limit)
        object.__setattr__(self, "_plan", self._planned())

    def _planned(self) -> Any:
        try:
            import ruckig
        except ImportError as cause:
            raise missing_extra("a jerk-limited trajectory", "ruckig", "ruckig") from cause
        n = len(np.asarray(self.q0))
        task = ruckig.InputParameter(n)
        task.current_position = list(np.asarray(self.q0))
        task.target_position = list(np.asarray(self.q1))
        task.max_velocity = list(np.asarray(self.velocity))
        task.max_acceleration = list(np.asarray(self.acceleration))
        task.max_jerk = list(np.asarray(self.jerk))
        plan = ruckig.Trajectory(n)
        try:
            result = ruckig.Ruckig(n).calculate(task, plan)
        except ruckig.RuckigError as cause:  # numbers that it cannot work with, such as limits of 1e-300
            raise NumericalError(
                "Ruckig cannot work with numbers as large or small as these; give positions and limits in rad or m "
                "and seconds",
                name="JerkLimited",
            ) from cause
        if result not in (ruckig.Result.Working, ruckig.Result.Finished):
            raise NumericalError(f"Ruckig found no jerk-limited trajectory ({result}); relax the limits")
        return plan

    @property
    def duration(self) -> float:
        """Time from start to stop [s]."""
        return float(self._plan.duration)  # type: ignore[attr-defined]  # set in __post_init__

    def at(self, t: float) -> JointMotion:
        """The sample at time t [s]."""
        return self._at(_instant(t), True)

    def rows(self, times: Float64Array) -> JointMotion:
        """Samples at many times, as arrays (k, n)."""
        return self._at(times, False)

    def _at(self, times: Float64Array, one: bool) -> JointMotion:
        end = self.duration
        rows = [self._plan.at_time(float(min(max(t, 0.0), end)))[:3] for t in times]  # type: ignore[attr-defined]
        q, v, a = (np.array([row[k] for row in rows]) for k in range(3))
        a[(times < 0.0) | (times > end)] = 0.0
        return _motion(q, v, a, one)


# -------------------------------------------------------------------- through points


@dataclass(frozen=True, kw_only=True, eq=False)
class Spline:
    """A cubic spline through points, at rest at both ends; position, velocity and acceleration are continuous.

    Args:
        times: (k,) [s], increasing, k >= 2.
        points: (k, n) joint positions [rad | m].
    """

    times: ArrayLike
    points: ArrayLike

    def __post_init__(self) -> None:
        times, points = _table("points", self.times, self.points)
        if len(times) < 2:
            raise ShapeError("a spline needs two points at least; got 1", name="points")
        from scipy.interpolate import CubicSpline

        object.__setattr__(self, "times", times)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "_spline", CubicSpline(times, points, bc_type="clamped"))

    @property
    def duration(self) -> float:
        """Time of the last point [s]."""
        return float(np.asarray(self.times)[-1])

    def at(self, t: float) -> JointMotion:
        """The sample at time t [s]."""
        return self._at(_instant(t), True)

    def rows(self, times: Float64Array) -> JointMotion:
        """Samples at many times, as arrays (k, n)."""
        return self._at(times, False)

    def _at(self, times: Float64Array, one: bool) -> JointMotion:
        knots = np.asarray(self.times)
        t = np.clip(times, knots[0], knots[-1])
        inside = ((times >= knots[0]) & (times <= knots[-1]))[:, np.newaxis]
        spline = self._spline  # type: ignore[attr-defined]  # set in __post_init__
        return _motion(spline(t), spline(t, 1) * inside, spline(t, 2) * inside, one)


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Recorded or computed samples, linear in between.

    Args:
        times: (k,) [s], increasing.
        q: (k, n) [rad | m].
        v: (k, n) [rad/s | m/s]; differences of q if left out.
        a: (k, n) [rad/s^2 | m/s^2]; differences of v if left out.

    Example:
        >>> Samples(times=[0.0, 1.0, 2.0], q=[[0.0], [1.0], [2.0]]).at(0.5).v.tolist()
        [1.0]
    """

    times: ArrayLike
    q: ArrayLike
    v: ArrayLike | None = None
    a: ArrayLike | None = None

    def __post_init__(self) -> None:
        times, q = _table("q", self.times, self.q)
        many = len(times) > 1
        v = self.v if self.v is not None else (np.gradient(q, times, axis=0) if many else np.zeros_like(q))
        v = finite_array("v", v, shape=q.shape)
        a = self.a if self.a is not None else (np.gradient(v, times, axis=0) if many else np.zeros_like(q))
        a = finite_array("a", a, shape=q.shape)
        for name, value in (("times", times), ("q", q), ("v", v), ("a", a)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str]) -> Samples:
        """Samples from a CSV file: a header, then rows of t and n positions, or also n velocities, n accelerations.

        Args:
            path: The header names the columns `t`, `q1` ... `qn`, and optionally `v1` ... and `a1` ...

        Raises:
            FileError: No such file, no header, a column or a number that does not fit.
        """
        return _read_csv(path)

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(np.asarray(self.times)[-1])

    def at(self, t: float) -> JointMotion:
        """The sample at time t [s]."""
        return self._at(_instant(t), True)

    def rows(self, times: Float64Array) -> JointMotion:
        """Samples at many times, as arrays (k, n)."""
        return self._at(times, False)

    def _at(self, times: Float64Array, one: bool) -> JointMotion:
        knots = np.asarray(self.times)
        columns = [
            np.stack([np.interp(times, knots, table[:, i]) for i in range(table.shape[1])], axis=-1)
            for table in (np.asarray(self.q), np.asarray(self.v), np.asarray(self.a))
        ]
        outside = (times < knots[0]) | (times > knots[-1])
        for rate in columns[1:]:
            rate[outside] = 0.0
        return _motion(columns[0], columns[1], columns[2], one)


def _table(name: str, times: ArrayLike, values: ArrayLike) -> tuple[Float64Array, Float64Array]:
    t = finite_array("times", times, unit="s")
    table = finite_array(name, values, unit="rad | m")
    if t.ndim != 1 or table.ndim != 2 or len(t) != len(table) or not len(t):
        raise ShapeError(f"times must have shape (k,) and {name} (k, n); got {t.shape} and {table.shape}", name=name)
    require_moderate(name, table)
    return sample_times(t), table


def _read_csv(path: str | os.PathLike[str]) -> Samples:
    header, table = read_rows(path, "t, q1, q2, ...", _columns)
    n = sum(word.startswith("q") for word in header)
    letters = dict.fromkeys(word[0] for word in header[1:])
    parts = {letter: table[:, 1 + k * n : 1 + (k + 1) * n] for k, letter in enumerate(letters)}
    return Samples(times=table[:, 0], q=parts["q"], v=parts.get("v"), a=parts.get("a"))


def _columns(header: Sequence[str]) -> list[str]:
    """What the columns of a file with this header should be."""
    letters = ["q", *(letter for letter in "va" if any(word.startswith(letter) for word in header[1:]))]
    n = max(1, sum(word.startswith("q") for word in header))
    return ["t", *(f"{letter}{i + 1}" for letter in letters for i in range(n))]
