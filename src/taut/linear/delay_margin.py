"""How much delay a sampled loop of one direction bears, exactly, without a state for each period of it."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from taut.linear.sampled import SampledLoop

__all__ = ["largest_delay"]

POINTS: Final = 4000
SLOWEST: Final = 1e-4  # of omega T, and as much less as the gain at it is not large
LARGE: Final = 1e3
SMALLER: Final = 0.1
PARTS: Final = 4  # of a period, between which no border is passed unseen
FAR: Final = 1e12  # periods: for ever
CLOSE: Final = 1e-13
ROUNDING: Final = 1e-12  # of a pole's modulus


def largest_delay(loop: SampledLoop, *, whole: bool = False) -> float:
    """The delay in periods up to which a loop of one direction is stable: the first border from none.

    Law:          with L the loop's response at a delay of part of a period, a further delay of d periods brings a
                  pole to z = exp(j theta) where abs(L) = 1 and d theta = arg(L) + pi, modulo 2 pi; from a stable
                  start the least such d is the border

    Args:
        loop: The loop, with a spring or an integral; its own delay does not count.
        whole: Whether delays are whole periods.

    Returns:
        Zero if it is unstable without delay.
    """
    if whole:
        return float(max(math.ceil(_further(loop, 0.0)) - 1, 0))
    high = min(k / PARTS + max(math.ceil(_further(loop, k / PARTS)), 0) for k in range(PARTS))
    if high == 0.0:
        return 0.0
    low = high - 1.0 / PARTS
    d = math.floor(low)

    def left(delay: float) -> float:
        part = delay - d
        return (_further(loop, part) if part < 1.0 else _further(loop, 0.0) - 1.0) - d

    return float(brentq(left, low, high, xtol=CLOSE, rtol=CLOSE))


def _further(loop: SampledLoop, part: float) -> float:
    """The least delay, in periods and not whole, that makes it unstable on top of part of one; -1 if that does."""
    late = dataclasses.replace(loop, delay=part * loop.T)
    return min(_critical(late), FAR) if late.radius < 1.0 - ROUNDING else -1.0


def _critical(loop: SampledLoop) -> float:
    """The least further delay, in periods and not whole, that brings a pole of a stable loop onto the unit circle."""

    def response(theta: NDArray[np.float64]) -> NDArray[np.complex128]:
        return loop.loop_response(theta)[:, 0, 0]

    def size(theta: float) -> float:
        return float(np.log(np.abs(response(np.array([theta]))[0])))

    slowest = SLOWEST
    while abs(response(np.array([slowest]))[0]) < LARGE:  # without end at rest, for a spring or an integral pulls
        slowest *= SMALLER
    grid = np.geomspace(slowest, math.pi, POINTS)
    above = np.abs(response(grid)) > 1.0
    least = math.inf
    for i in np.flatnonzero(above[1:] != above[:-1]).tolist():
        theta = float(brentq(size, grid[i], grid[i + 1], xtol=1e-300, rtol=1e-14))
        phase = float(np.angle(response(np.array([theta]))[0])) + math.pi
        least = min(least, (phase % (2.0 * math.pi)) / theta)
    return least
