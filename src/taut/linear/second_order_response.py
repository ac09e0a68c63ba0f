"""The response of second-order error dynamics in closed form, in all three cases of damping and between them."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
from scipy.optimize import brentq

from taut.base.types import Float64Array
from taut.linear.step_response import BAND

__all__ = ["FASTEST", "overshoot_of", "settling_angle", "shape", "swing", "zeta_of_overshoot"]

FASTEST: Final = math.log(1.0 / BAND) / math.hypot(math.log(1.0 / BAND), math.pi)
"""The damping ratio, 0.78, whose overshoot is the band: nothing settles earlier for its natural frequency."""

EARLY, LATE = 0.9, 0.1  # parts of the error between which it rises


def swing(
    sigma: float, square: float, excess: float, e0: float, v0: float, t: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Error and its rate of a second-order system, without a difference of large numbers where roots meet.

    Law:          e = exp(-sigma t) (e0 C + (v0 + sigma e0) t S),  v = exp(-sigma t) (v0 C - (w^2 e0 + sigma v0) t S)
                  with d = sigma^2 - w^2,  C = cosh(sqrt(d) t) and S = sinh(sqrt(d) t) / (sqrt(d) t),  whole functions
                  of d: cos and sin where it is negative, 1 where it is zero

    Args:
        sigma: zeta omega_n [1/s].
        square: w^2 = omega_n^2 [1/s^2].
        excess: d, which decides between the cases [1/s^2].
        e0: Error at the start.
        v0: Its rate at the start.
        t: Times from the start [s].
    """
    root = math.sqrt(abs(excess))
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        if excess <= 0.0:
            envelope, C, tS = np.exp(-sigma * t), np.cos(root * t), t * np.sinc(root * t / math.pi)
        else:
            slow = -square / (sigma + root) if sigma > 0.0 else root - sigma
            x = 2.0 * root * t
            envelope, C = np.exp(slow * t), 0.5 * (1.0 + np.exp(-x))
            tS = t * np.divide(-np.expm1(-x), x, out=np.ones_like(x), where=x > 0.0)
        e = envelope * (e0 * C + (v0 + sigma * e0) * tS)
        v = envelope * (v0 * C - (square * e0 + sigma * v0) * tS)
    return e, v


def overshoot_of(zeta: float) -> float:
    """[%] exp(-pi zeta / sqrt(1 - zeta^2)), below equation 10.10; 0 from zeta = 1 on."""
    if zeta >= 1.0:
        return 0.0
    return 100.0 * math.exp(-math.pi * zeta / math.sqrt((1.0 - zeta) * (1.0 + zeta)))


def zeta_of_overshoot(percent: float) -> float:
    """The damping ratio that overshoots so far, for 0 <= percent <= 100; of none the least, critical damping."""
    if percent == 0.0:
        return 1.0
    decrement = math.log(100.0 / percent)
    return decrement / math.hypot(decrement, math.pi)


def _error(zeta: float, angle: float) -> float:
    excess = (zeta - 1.0) * (zeta + 1.0)
    return float(swing(zeta, 1.0, excess, 1.0, 0.0, np.array([angle]))[0][0])


def _crossing(zeta: float, level: float, low: float, high: float) -> float:
    """Where the error passes a level, as an angle omega_n t."""
    return float(brentq(lambda angle: _error(zeta, angle) - level, low, high, xtol=1e-15 * high, rtol=1e-15))


@cache
def settling_angle(zeta: float) -> float:
    """omega_n times the exact 2 % settling time: the last angle at which the error leaves the band of 2 %.

    Between two extremes of the error, exp(-k pi zeta / sqrt(1 - zeta^2)) high, it crosses the band once. Infinite
    without damping.
    """
    if zeta <= 0.0:
        return math.inf
    if zeta >= 1.0:
        return _crossing(zeta, BAND, 0.0, 16.0 * zeta)
    damped = math.sqrt((1.0 - zeta) * (1.0 + zeta))
    last = max(math.ceil(math.log(1.0 / BAND) * damped / (math.pi * zeta)) - 1, 0)
    half = math.pi / damped
    return _crossing(zeta, -BAND if last % 2 else BAND, last * half, (last + 1) * half)


def shape(zeta: float) -> tuple[float, float, float, float]:
    """Overshoot [%], and the angles omega_n t of settling, rise (90 % to 10 %) and peak; NaN for what is not."""
    if zeta <= 0.0:
        return math.nan, math.inf, math.nan, math.nan
    damped = math.sqrt((1.0 - zeta) * (1.0 + zeta)) if zeta < 1.0 else 0.0
    peak = math.pi / damped if damped else math.nan
    end = peak if damped else 16.0 * zeta
    rise = _crossing(zeta, LATE, 0.0, end) - _crossing(zeta, EARLY, 0.0, end)
    return overshoot_of(zeta), settling_angle(zeta), rise, peak
