"""Scalings of time: how far along its path a motion is, s from 0 to 1, with both rates.

Every one of them rests before 0 and after its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array

__all__ = [
    "CUBIC",
    "QUINTIC",
    "Scaling",
    "polynomial",
    "quintic_between",
    "require_finite",
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
