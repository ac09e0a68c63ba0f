"""How much delay a sampled loop of one direction bears, exactly, without a state for each period of it."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from taut.base.types import Float64Array
from taut.study.sampled import SampledLoop

__all__ = ["largest_delay"]

POINTS: Final = 4000
SLOWEST: Final = 1e-7  # of omega T
STEP: Final = 0.25  # of a period
HALVINGS: Final = 50
ROUNDING: Final = 1e-12  # of a pole's modulus


def largest_delay(loop: SampledLoop, *, whole: bool = False) -> float:
    """The delay in periods up to which a loop of one direction is stable: the first border from none.

    Law:          with a delay of d + s periods the characteristic polynomial is z^d D(z) + N_s(z); from a stable
                  start a pole first reaches the unit circle where abs(N_s) = abs(D) at z = exp(j theta) and
                  d theta = arg(N_s / D) - pi, modulo 2 pi

    Args:
        loop: The loop; its own delay does not count.
        whole: Whether delays are whole periods.

    Returns:
        Zero if it is unstable without delay; infinite if none makes it unstable.
    """
    if not _stable(loop, 0.0):
        return 0.0
    near = _critical(loop, 0.0)
    if not math.isfinite(near):
        return math.inf
    if whole:
        return float(max(math.ceil(near) - 1, 0))
    low = max(near - 1.0, 0.0)  # a fraction of a period is nearly, not exactly, as much less phase
    while not _stable(loop, low):
        low = max(low - 1.0, 0.0)
    high = low + STEP
    while _stable(loop, high):
        low, high = high, high + STEP
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _stable(loop, middle) else (low, middle)
    return low


def _stable(loop: SampledLoop, periods: float) -> bool:
    d = math.floor(periods)
    part = periods - d
    return _of(loop, part).radius < 1.0 - ROUNDING and d < _critical(loop, part)


def _of(loop: SampledLoop, part: float, share: float = 1.0) -> SampledLoop:
    """The loop with part of a period of delay, and a share of its gains."""
    K, B, Ki = (share * np.asarray(gain) for gain in (loop.K, loop.B, loop.Ki))
    return dataclasses.replace(loop, delay=part * loop.T, K=K, B=B, Ki=Ki)


def _critical(loop: SampledLoop, part: float) -> float:
    """The least further delay, in periods and not whole, that brings a pole onto the unit circle."""
    closed: Float64Array = np.real(np.poly(_of(loop, part).matrix()))
    half: Float64Array = np.real(np.poly(_of(loop, part, 0.5).matrix()))
    N = 2.0 * (closed - half)  # the polynomial is affine in all gains together
    D = closed - N

    def ratio(theta: Float64Array) -> NDArray[np.complex128]:
        z = np.exp(1j * theta)
        return np.asarray(np.polyval(N, z) / np.polyval(D, z), dtype=np.complex128)

    def size(theta: float) -> float:
        return float(np.log(np.abs(ratio(np.array([theta]))[0])))

    grid = np.geomspace(SLOWEST, math.pi, POINTS)
    above = np.abs(ratio(grid)) > 1.0
    least = math.inf
    for i in np.flatnonzero(above[1:] != above[:-1]).tolist():
        theta = float(brentq(size, grid[i], grid[i + 1], xtol=1e-300, rtol=1e-14))
        phase = float(np.angle(ratio(np.array([theta]))[0])) - math.pi
        least = min(least, (phase % (2.0 * math.pi)) / theta)
    return least
