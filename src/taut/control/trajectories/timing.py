"""Motions with declared fields, and their timing: s from 0 to 1 over time, in a given time or within limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Generic, Literal, TypeAlias, TypeVar

import numpy as np

from taut.base.checks import finite_scalar
from taut.base.errors import RangeError
from taut.base.fields import Declared
from taut.base.types import Float64Array
from taut.control.trajectories.reference import Sample

S = TypeVar("S", bound=Sample)
Scaling: TypeAlias = tuple[Float64Array, Float64Array, Float64Array]
"""s, its rate [1/s] and the rate of that [1/s^2], one number per time."""
ScalingKind = Literal["quintic", "cubic", "septic", "trapezoidal"]

MAX_OF_MOTION: Final = (
    1e30  # of a time, a place, a speed, an acceleration; floats end at 1e308, and these are squared
)
COEFFICIENTS: Final = {
    "quintic": np.polynomial.Polynomial((0.0, 0.0, 0.0, 10.0, -15.0, 6.0)),  # minimum jerk
    "cubic": np.polynomial.Polynomial((0.0, 0.0, 3.0, -2.0)),
    "septic": np.polynomial.Polynomial((0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0)),  # minimum snap
}
GRID: Final = np.linspace(0.0, 1.0, 2001)  # where the largest acceleration of a polynomial is searched for
GRID_ERROR: Final = 1e-6  # relative, more than the maximum can exceed that of the grid points
MAX_ACROSS: Final = math.sqrt(0.5)  # of the acceleration that a trapezoid on a curve may take across its path


class Motion(Declared, Generic[S]):
    """Base of trajectories: declared fields, and samples at many times by `rows`; at rest outside its duration."""

    def rows(self, times: Float64Array) -> S:
        """Samples at many times, as arrays (k, ...)."""
        raise NotImplementedError

    def at(self, t: float) -> S:
        """The sample at time t [s]."""
        rows = self.rows(np.array([finite_scalar("t", t, unit="s")]))
        return rows.of({name: values[0] for name, values in rows.stated().items()})


@dataclass(frozen=True, kw_only=True)
class Size:
    """Constants of a path from s = 0 to 1."""

    length: float  # [m] of the path of the tool's origin: its speed per unit of s'
    bend: float  # [m] its acceleration across the path per unit of s'^2
    turn: float  # [rad] of the orientation


@dataclass(frozen=True, kw_only=True)
class Timing:
    """s over time: a polynomial, or a trapezoid of limited rate and acceleration; at rest outside [0, duration]."""

    kind: ScalingKind
    duration: float  # [s]
    rate: float = math.inf  # [1/s] of a trapezoid
    acceleration: float = math.inf  # [1/s^2] of a trapezoid
    distance: float = 1.0  # [rad | m] largest displacement

    def __post_init__(self) -> None:
        shortest = math.sqrt(max(self.distance, 1.0) / MAX_OF_MOTION)
        if self.duration != 0.0 and not shortest <= self.duration <= MAX_OF_MOTION:
            raise RangeError(
                f"duration must be from {shortest:.3g} to {MAX_OF_MOTION:g} s, for a distance of {self.distance:g} "
                f"[rad | m]; got {self.duration:g}",
                name="duration",
                value=self.duration,
            )

    @classmethod
    def trapezoid(cls, rate: float, acceleration: float, distance: float = 1.0) -> Timing:
        """As fast as a rate [1/s] and an acceleration [1/s^2] of s allow; no time at all if both are infinite."""
        v, a = np.float64(rate), np.float64(acceleration)
        duration = np.float64(0.0)
        if not np.isinf(v):
            with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of limits that are refused then
                duration = 1.0 / v + v / a if v * v <= a else 2.0 / np.sqrt(a)
        return cls(
            kind="trapezoidal", duration=float(duration), rate=rate, acceleration=acceleration, distance=distance
        )

    @classmethod
    def fastest(cls, kind: ScalingKind, size: Size, velocity: Float64Array, acceleration: Float64Array) -> Timing:
        """The shortest within largest speeds and accelerations, (linear, angular) each."""
        distance = max(size.length, size.turn, size.bend)
        if kind == "trapezoidal":
            rate, second = _trapezoid_limits(size, velocity, acceleration)
            return cls.trapezoid(rate, second, distance)
        p = COEFFICIENTS[kind]  # its rates fall with T and T^2
        p1, p2 = p.deriv()(GRID), p.deriv(2)(GRID)
        linear = float(np.max(np.hypot(p2 * size.length, p1**2 * size.bend)))
        angular = float(np.max(np.abs(p2))) * size.turn
        with np.errstate(over="ignore"):  # of limits that are refused then
            by_speed = float(np.max(p1)) * max(size.length / velocity[0], size.turn / velocity[1])
            by_acceleration = (1.0 + GRID_ERROR) * max(linear / acceleration[0], angular / acceleration[1])
        return cls(kind=kind, duration=max(by_speed, math.sqrt(by_acceleration)), distance=distance)

    @classmethod
    def lasting(cls, kind: ScalingKind, duration: float, distance: float) -> Timing:
        """A motion in a given time [s]; of a trapezoid a third each for ramp, cruise and ramp."""
        return cls(
            kind=kind,
            duration=duration,
            rate=1.5 / duration,
            acceleration=4.5 / duration / duration,
            distance=distance,
        )

    def at(self, times: Float64Array) -> Scaling:
        """s and its two rates at many times [s]."""
        T = self.duration
        if T == 0.0:
            zero = np.zeros_like(times)
            return zero + (times >= 0.0), zero, zero
        t, inside = np.clip(times, 0.0, T), (times >= 0.0) & (times <= T)
        if self.kind == "trapezoidal":
            return self._trapezoid_at(t, inside)
        p, x = COEFFICIENTS[self.kind], t / T
        return p(x), p.deriv()(x) / T * inside, p.deriv(2)(x) / T / T * inside

    def jerk_and_snap(self, times: Float64Array) -> tuple[Float64Array, ...]:
        """The next two rates of s [1/s^3, 1/s^4], of a septic; nothing where the jerk jumps."""
        if self.kind != "septic":
            return ()
        p, x = COEFFICIENTS[self.kind], np.clip(times / self.duration, 0.0, 1.0)
        inside = (times >= 0.0) & (times <= self.duration)
        return tuple(p.deriv(k)(x) / self.duration**k * inside for k in (3, 4))

    def _trapezoid_at(self, t: Float64Array, inside: Any) -> Scaling:
        a, remaining = self.acceleration, self.duration - t
        v = min(self.rate, math.sqrt(a))  # a short path never reaches the speed
        ramp = v / a
        ending = 1.0 - 0.5 * a * remaining**2
        s = np.where(t < ramp, 0.5 * a * t**2, np.where(remaining < ramp, ending, v * (t - 0.5 * ramp)))
        s_dot = np.minimum(np.minimum(a * t, a * remaining), v)
        return s, s_dot, a * ((t < ramp) * 1.0 - (remaining < ramp) * 1.0) * inside


def _trapezoid_limits(size: Size, velocity: Float64Array, acceleration: Float64Array) -> tuple[float, float]:
    """Largest rate and acceleration of s; on a curve the speed leaves room for the acceleration along the path."""
    if size.length == size.turn == 0.0:
        return math.inf, math.inf
    with np.errstate(divide="ignore", over="ignore"):
        length, bend, turn = np.array([size.length]), np.array([size.bend]), np.array([size.turn])
        rate = float(min(velocity[0] / length, velocity[1] / turn, np.sqrt(MAX_ACROSS * acceleration[0] / bend))[0])
        across = rate * rate * size.bend
        along = math.sqrt(acceleration[0] ** 2 - across**2) / length
        second = float(min(along, acceleration[1] / turn)[0])
    return min(rate, math.sqrt(second)), second
