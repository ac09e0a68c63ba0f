"""How fast a path of task space is gone along: in a given time, or as fast as limits of the tool allow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.base.checks import one_of, positive_scalar, require_positive, vector
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.scaling import (
    CUBIC,
    QUINTIC,
    Scaling,
    polynomial,
    require_finite,
    trapezoid,
    trapezoid_duration,
)

__all__ = ["ScalingKind", "Size", "Timing", "timed"]

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
