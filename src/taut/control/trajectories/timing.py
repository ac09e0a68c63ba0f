"""Timing: how far along its path a motion is, s from 0 to 1, with both rates; in a given time or within limits.

Every scaling rests before 0 and after its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from taut.base.checks import one_of, positive_scalar, require_positive, vector
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array

__all__ = [
    "CUBIC",
    "QUINTIC",
    "Scaling",
    "ScalingKind",
    "Size",
    "Timing",
    "polynomial",
    "quintic_between",
    "require_finite",
    "timed",
    "trapezoid",
    "trapezoid_duration",
]

Scaling: TypeAlias = tuple[Float64Array, Float64Array, Float64Array]
"""s, its rate [1/s] and the rate of that [1/s^2], one number per time."""

LARGEST: Final = 1e30  # of a time, a speed, an acceleration; floats end at 1e308, and these are squared
CUBIC: Final = (0.0, 0.0, 3.0, -2.0)
QUINTIC: Final = (0.0, 0.0, 0.0, 10.0, -15.0, 6.0)  # minimum jerk


def polynomial(times: Float64Array, duration: float, coefficients: Sequence[float]) -> Scaling:
    """s = sum c_k (t/T)^k."""
    T = duration
    x = np.clip(times, 0.0, T) / T
    p = np.polynomial.Polynomial(coefficients)
    inside = (times >= 0.0) & (times <= T)
    return p(x), p.deriv()(x) / T * inside, p.deriv(2)(x) / T / T * inside


def trapezoid_duration(speed: float, acceleration: float) -> float:
    """Time [s] that a trapezoid takes with that rate [1/s] and acceleration [1/s^2] of s; 0 if both are infinite."""
    v, a = np.float64(speed), np.float64(acceleration)
    if np.isinf(v):
        return 0.0
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # of limits that `require_finite` refuses
        return float(1.0 / v + v / a if v * v <= a else 2.0 / np.sqrt(a))


def require_finite(duration: float, distance: float, **limits: Float64Array) -> None:
    """Numbers of a motion with which its speed and acceleration are finite at any time.

    Args:
        duration: [s]; 0 for a jump.
        distance: The farthest that anything goes.
        limits: Of speed and acceleration.

    Raises:
        RangeError: One that is beyond what floats can work with.
    """
    for name, limit in limits.items():
        if limit.size and not (limit.max() < LARGEST and limit.min() > 1.0 / LARGEST):
            raise RangeError(f"{name} must be from {1.0 / LARGEST:g} to {LARGEST:g}; got {limit.tolist()}", name=name)
    if not duration < LARGEST:
        raise RangeError(f"duration must be at most {LARGEST:g} s; got {duration:g}", name="duration", value=duration)
    if duration and max(distance, 1.0) / LARGEST > duration * duration:
        raise RangeError(
            f"duration must be long enough for a distance of {distance:g} [rad | m]; got {duration:g} s",
            name="duration",
            value=duration,
        )


def trapezoid(times: Float64Array, speed: float, acceleration: float) -> Scaling:
    """As fast as speed and acceleration of s allow; a short way never reaches the speed."""
    a, T = acceleration, trapezoid_duration(speed, acceleration)
    if T == 0.0:
        zero = np.zeros_like(times)
        return zero + (times >= 0.0), zero, zero
    v = min(speed, np.sqrt(a))
    ramp = v / a
    t = np.clip(times, 0.0, T)
    left = T - t
    s = np.where(t < ramp, 0.5 * a * t**2, np.where(left < ramp, 1.0 - 0.5 * a * left**2, v * (t - 0.5 * ramp)))
    s_dot = np.minimum(np.minimum(a * t, a * left), v)
    inside = (times >= 0.0) & (times <= T)
    s_ddot = a * ((t < ramp) * 1.0 - (left < ramp) * 1.0) * inside
    return s, s_dot, s_ddot


def quintic_between(x: Float64Array, h: Float64Array | float, start: Scaling, end: Scaling) -> Scaling:
    """The quintic with the given values, rates and accelerations at both ends, and its two rates.

    Args:
        x: (k,) where between the ends, 0 to 1.
        h: (k,) or one number: time from end to end [s].
        start: Value, rate and acceleration at x = 0, (k, m) each, or (m,).
        end: The same at x = 1.
    """
    x, h = x[:, np.newaxis], np.asarray(h, dtype=np.float64).reshape(-1, 1)
    (y0, v0, a0), (y1, v1, a1) = start, end
    v0, v1, a0, a1 = v0 * h, v1 * h, a0 * h**2, a1 * h**2
    way = y1 - y0
    c3 = 10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    c4 = -15.0 * way + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1
    c5 = 6.0 * way - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
    y = y0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
    rate = v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))
    return y, rate / h, (a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))) / h**2


ScalingKind = Literal["quintic", "cubic", "trapezoidal"]
KINDS: Final[tuple[ScalingKind, ...]] = ("quintic", "cubic", "trapezoidal")
COEFFICIENTS: Final = {"quintic": QUINTIC, "cubic": CUBIC}
UNITS: Final = {"velocity": "m/s, rad/s", "acceleration": "m/s^2, rad/s^2"}
GRID: Final = 2001  # points of a polynomial at which the largest acceleration is looked for
GRID_ERROR: Final = 1e-6  # relative, more than what lies between two of them
SLACK: Final = 1e-9  # relative, of a duration that is the shortest one
CURVED: Final = math.sqrt(0.5)  # share of the acceleration that a trapezoid's speed on a curve may take


@dataclass(frozen=True, kw_only=True)
class Size:
    """What a path is, from s = 0 to 1, where all of it is constant."""

    length: float  # [m] of the way of the tool's origin: its speed per unit of s'
    bend: float  # [m] its acceleration across the way per unit of s'^2
    turn: float  # [rad] of the orientation

    @property
    def is_point(self) -> bool:
        """Whether there is nothing to go."""
        return self.length == 0.0 and self.turn == 0.0


@dataclass(frozen=True, kw_only=True)
class Timing:
    """The way over time: a polynomial, or a trapezoid with a largest rate and acceleration of s."""

    kind: ScalingKind
    duration: float  # [s]
    rate: float = math.inf  # [1/s] of a trapezoid
    acceleration: float = math.inf  # [1/s^2] of a trapezoid

    def at(self, times: Float64Array) -> Scaling:
        """s and its two rates at many times [s]."""
        if self.duration == 0.0:
            zero = np.zeros_like(times)
            return zero + (times >= 0.0), zero, zero
        if self.kind == "trapezoidal":
            return trapezoid(times, self.rate, self.acceleration)
        return polynomial(times, self.duration, COEFFICIENTS[self.kind])


def timed(
    who: str,
    size: Size,
    kind: ScalingKind,
    duration: float | None,
    velocity: ArrayLike | None,
    acceleration: ArrayLike | None,
) -> Timing:
    """The timing that a trajectory is asked for: in `duration`, or the shortest under limits, or both.

    Raises:
        UsageError: Neither a duration nor both limits, another kind of scaling.
        ShapeError: Limits that are no pair.
        RangeError: Nothing above zero, or a duration that the limits do not allow; the message has the shortest.
    """
    one_of("scaling", kind, KINDS)
    asked = None if duration is None else positive_scalar("duration", duration, unit="s")
    farthest = max(size.length, size.turn, size.bend)
    if asked is not None:
        require_finite(asked, farthest)
    if velocity is None and acceleration is None:
        if asked is None:
            raise UsageError(
                f"{who} needs duration= [s], or velocity= and acceleration=, each (linear, angular)", name="duration"
            )
        return _in_time(kind, asked)
    if velocity is None or acceleration is None:
        missing = "velocity" if velocity is None else "acceleration"
        raise UsageError(f"{who} needs {missing}= too, as (linear, angular) [{UNITS[missing]}]", name=missing)
    limits = _pair("velocity", velocity), _pair("acceleration", acceleration)
    fastest = _trapezoid(size, *limits) if kind == "trapezoidal" else _shortest(size, kind, *limits)
    require_finite(fastest.duration, farthest)
    if asked is None:
        return fastest
    if asked < fastest.duration * (1.0 - SLACK):
        raise RangeError(
            f"duration must be >= {fastest.duration:.6g} [s], which velocity and acceleration allow; got {asked:g}",
            name="duration",
            value=asked,
            rule="as the limits allow",
        )
    if fastest.duration == 0.0 or kind != "trapezoidal":
        return _in_time(kind, asked)
    slower = fastest.duration / asked
    return Timing(
        kind=kind, duration=asked, rate=slower * fastest.rate, acceleration=slower * slower * fastest.acceleration
    )


def _pair(name: str, value: ArrayLike) -> Float64Array:
    if np.shape(value) != (2,):
        raise ShapeError(f"{name} must be (linear, angular) [{UNITS[name]}]; got {value!r}", name=name, value=value)
    pair = vector(name, value, 2, unit=UNITS[name])
    require_positive(name, pair, unit=UNITS[name])
    require_finite(0.0, 0.0, **{name: pair})
    return pair


def _in_time(kind: ScalingKind, duration: float) -> Timing:
    if kind != "trapezoidal":
        return Timing(kind=kind, duration=duration)
    return Timing(kind=kind, duration=duration, rate=1.5 / duration, acceleration=4.5 / (duration * duration))


def _shortest(size: Size, kind: ScalingKind, velocity: Float64Array, acceleration: Float64Array) -> Timing:
    """A polynomial as fast as the limits allow: its rates fall with T and T^2."""
    p = np.polynomial.Polynomial(COEFFICIENTS[kind])
    x = np.linspace(0.0, 1.0, GRID)
    rate, second = p.deriv()(x), p.deriv(2)(x)
    linear = float(np.max(np.hypot(second * size.length, rate**2 * size.bend)))
    angular = float(np.max(np.abs(second))) * size.turn
    fastest = float(np.max(rate)) * max(size.length / velocity[0], size.turn / velocity[1])
    hardest = (1.0 + GRID_ERROR) * max(linear / acceleration[0], angular / acceleration[1])
    return Timing(kind=kind, duration=max(fastest, math.sqrt(hardest)))


def _trapezoid(size: Size, velocity: Float64Array, acceleration: Float64Array) -> Timing:
    """A trapezoid; on a curve its speed leaves room for the acceleration along the way."""
    if size.is_point:
        return Timing(kind="trapezoidal", duration=0.0)
    with np.errstate(divide="ignore"):
        length, bend, turn = np.array([size.length]), np.array([size.bend]), np.array([size.turn])
        rate = float(min(velocity[0] / length, velocity[1] / turn, np.sqrt(CURVED * acceleration[0] / bend))[0])
        across = rate * rate * size.bend
        along = math.sqrt(acceleration[0] ** 2 - across**2) / length
        a = float(min(along, acceleration[1] / turn)[0])
    rate = min(rate, math.sqrt(a))
    return Timing(kind="trapezoidal", duration=trapezoid_duration(rate, a), rate=rate, acceleration=a)
