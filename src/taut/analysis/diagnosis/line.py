"""A line in a signal: its frequency, and whether it grows or dies out, by damped least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from taut.base.types import Float64Array

__all__ = ["Line", "line_of"]

PERIODS: Final = 4.0  # in a window: fewer are no oscillation that lasts
LEAST: Final = 32  # ticks of a window


@dataclass(frozen=True, kw_only=True)
class Line:
    """y = exp(growth t) (a cos(omega t) + b sin(omega t)) + c + d t over a window."""

    omega: float  # [rad/s]
    growth: float  # [1/s]
    amplitude: float  # in the middle of the window, in the signal's unit
    last: float  # at its end
    share: float  # 0 to 1: of the signal's variance about its trend

    @property
    def frequency(self) -> float:
        """[Hz]."""
        return self.omega / (2.0 * math.pi)

    @property
    def zeta(self) -> float:
        """Damping ratio; negative where it grows."""
        return -self.growth / math.hypot(self.growth, self.omega)


def line_of(y: Float64Array, dt: float, above: float = 0.0) -> Line | None:
    """The strongest line of a signal, of at least four periods in the window.

    The peak of its Hann-windowed spectrum is where a fit of y = exp(s t) (a cos + b sin) + trend starts, by least
    squares in s and omega, the rest solved for in each step (variable projection).

    Args:
        y: (k,) the signal.
        dt: Period [s].
        above: [rad/s] only lines faster than this.

    Returns:
        The line; None in a window that is too short, or without motion.
    """
    k = len(y)
    if k < LEAST or not np.isfinite(y).all():
        return None
    x = np.linspace(-1.0, 1.0, k)  # the window: growth is scaled with half of it
    trend = np.column_stack([np.ones(k), x])
    ac = y - trend @ np.linalg.lstsq(trend, y, rcond=None)[0]
    power = float(np.sum(ac**2))
    spectrum = np.abs(np.fft.rfft(ac * np.hanning(k)))
    omegas = 2.0 * math.pi * np.fft.rfftfreq(k, dt)
    low = max(above, PERIODS * 2.0 * math.pi / (k * dt))
    spectrum[omegas < low] = 0.0
    if power <= 0.0 or not spectrum.any():
        return None
    start = float(omegas[int(np.argmax(spectrum))])
    half = 0.5 * (k - 1) * dt
    tau = x * half
    width = 2.0 * math.pi / (k * dt)

    def basis(p: Float64Array) -> Float64Array:
        grown = np.exp(p[0] * x)
        angle = (start + p[1] * width) * tau
        return np.column_stack([grown * np.cos(angle), grown * np.sin(angle), trend])

    def left(p: Float64Array) -> Float64Array:
        B = basis(p)
        return np.asarray(y - B @ np.linalg.lstsq(B, y, rcond=None)[0])

    scale = math.sqrt(power)
    found = least_squares(lambda p: left(p) / scale, [0.0, 0.0], bounds=([-40.0, -2.0], [40.0, 2.0]), max_nfev=40)
    values = np.linalg.lstsq(basis(found.x), y, rcond=None)[0]
    # At half of the rate sine and cosine are one at the ticks, and their numbers may be anything.
    shown = float(np.abs(basis(found.x)[:, :2] @ values[:2] * np.exp(-found.x[0] * x)).max())
    amplitude = min(math.hypot(values[0], values[1]), shown)
    return Line(
        omega=start + float(found.x[1]) * width,
        growth=float(found.x[0]) / half,
        amplitude=amplitude,
        last=amplitude * math.exp(found.x[0]),
        share=1.0 - float(np.sum(left(found.x) ** 2)) / power,
    )
