"""The bandwidth of a design: where a sine of the reference is first followed with half of the power."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.optimize import brentq

from taut.base.types import Float64Array
from taut.linear.error_dynamics import ErrorDynamics

__all__ = ["bandwidth_of", "bandwidth_seen"]

HALF: Final = 0.5  # of the power
FINER: Final = 8  # bins of a spectrum for one of a step's own
DECADES: Final = 4.0  # to either side of the mean pole
POINTS: Final = 400


def bandwidth_of(dynamics: ErrorDynamics) -> float:
    """[rad/s] of error dynamics in continuous time, whose reference steps without a velocity; NaN if unstable."""
    if not dynamics.stable:
        return math.nan
    a = np.asarray(dynamics.coefficients, dtype=np.float64)
    numerator = a[-1 - int(dynamics.integral) :]

    def power(w: float) -> float:
        return float(np.abs(np.polyval(numerator, 1j * w) / np.polyval(a, 1j * w)) ** 2)

    middle = float(np.exp(np.mean(np.log(np.abs(dynamics.poles)))))
    return _first(power, middle * np.logspace(-DECADES, DECADES, POINTS))


def bandwidth_seen(y: Float64Array, dt: float) -> float:
    """[rad/s] of a loop by its response y (k,) to a unit step at the ticks, to its end; NaN if it does not settle.

    Its spectrum is that of what it does to a unit impulse, whichever poles and zeros it has.
    """
    if not np.isfinite(y).all() or abs(y[-1] - 1.0) > HALF:
        return math.nan
    impulse, t = np.diff(y, prepend=0.0), dt * np.arange(len(y))

    def power(w: float) -> float:
        return float(np.abs(impulse @ np.exp(-1j * w * t)) ** 2)

    spectrum = np.abs(np.fft.rfft(impulse, 2 * FINER * len(y))) ** 2
    return _first(power, np.linspace(0.0, math.pi / dt, len(spectrum)), spectrum)


def _first(power: Callable[[float], float], grid: Float64Array, known: Float64Array | None = None) -> float:
    """Where the power first falls to its half; NaN if nowhere on the grid."""
    values = np.array([power(w) for w in grid.tolist()]) if known is None else known
    below = np.flatnonzero(values < HALF)
    if not below.size or below[0] == 0:
        return math.nan
    k = int(below[0])
    return float(brentq(lambda w: power(w) - HALF, grid[k - 1], grid[k], xtol=1e-12 * grid[k]))
