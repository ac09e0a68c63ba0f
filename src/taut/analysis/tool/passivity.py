"""Passivity of a sampled loop: whether a passive thing that touches it can get energy out of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array
from taut.linear.sampled import SampledLoop, largest_factor

__all__ = ["all_passive", "largest_passive", "spare_damping", "spare_damping_in_band"]

POINTS: Final = 256  # of the frequency grid, for each period of delay
SMALLEST: Final = 1e-4  # of omega T: below it everything is at its limit for slow motion
ZOOMS: Final = 3  # each is 64 times finer
Complex = NDArray[np.complex128]


def spare_damping(loop: SampledLoop) -> float:
    """Physical damping above what no passive environment can beat, in the worst direction and frequency.

    Law:          with H = K + B F (1 - z^-1) / T of positions, z = exp(j theta), and D = z^-d (1 - s + s z^-1) of a
                  delay of d + s periods, the loop is stable with every passive environment if and only if
                  damping - p D - (p D)^H - (1 - |D|^2) p^H damping^-1 p > 0   for all theta in (0, pi],
                  p = j T H exp(-j theta/2) / (4 sin(theta/2))
                  For whole periods this is Colgate and Schenkel's damping > T/2 Re((1 - z^-1) H z^-d) / (1 - cos
                  theta), for no filter and no delay damping > K T/2 + |B|.

    A measured velocity has no such bound unless B is zero: its samples do not tell what the arm does in between, so
    that resonances of the environment far above the rate can beat any damping; then this is minus infinity.

    With an integral it is minus infinity too: a slow enough motion gets more out of it than any damping takes.

    Returns:
        [N s/m]; negative where some passive environment makes the loop unstable.

    References:
        Colgate and Schenkel, Passivity of a class of sampled-data systems: application to haptic interfaces (1997),
        theorem 1. Its proof for a fraction of a period is ours: the aliases of the environment's response are discs,
        their weighted sum is one, and its centre moves with the fraction as its radius does not.
    """
    if loop.integrates or (not loop.differenced and np.any(np.asarray(loop.B))):
        return -math.inf
    return _least(loop, lambda theta: _spare(loop, theta))


def spare_damping_in_band(loop: SampledLoop, band: float | None = None) -> float:
    """Physical damping above what keeps every sinusoidal motion below a frequency from getting energy out.

    Law:          damping + He(H_0) > 0,  H_0 = exp(-j omega delay) (1 - z^-1)/(j omega T) (K + B F v/x) / (j omega)
                  the force's first harmonic over the velocity, v/x = j omega measured, (1 - z^-1) / T differenced

    Args:
        loop: The loop.
        band: [Hz], at most half the rate, which it is if left out.

    Returns:
        [N s/m]; minus infinity with an integral, which gives energy to slow motions.
    """
    if loop.integrates:
        return -math.inf
    top = math.pi if band is None else min(2.0 * math.pi * band * loop.T, math.pi)
    return _least(loop, lambda theta: _harmonic(loop, theta), top)


def largest_passive(loop: SampledLoop, band: float | None = None, *, everything: bool = True) -> float:
    """The factor on K up to which spare damping is not negative: for every environment, or for motion in a band."""
    largest = float(np.abs(np.linalg.eigvalsh(np.asarray(loop.K))).max())
    spare = spare_damping if everything else lambda loop: spare_damping_in_band(loop, band)
    if largest == 0.0:
        return math.inf if spare(loop) >= 0.0 else 0.0
    damping = np.asarray(loop.damping), np.asarray(loop.B)
    scale = max(*(float(np.abs(each).max()) for each in damping), 1e-12) * loop.rate / largest
    # The condition is affine in K: what is good is an interval.
    return largest_factor(lambda factor: spare(loop.with_stiffness(factor)) >= 0.0, 1e-6 * scale, 1e3 * scale, 1, 36)


def all_passive(loop: SampledLoop) -> bool:
    """Whether no passive environment makes it unstable."""
    return spare_damping(loop) >= 0.0


# -------------------------------------------------------------------- over all frequencies


def _least(loop: SampledLoop, spare: Callable[[Float64Array], Float64Array], top: float = math.pi) -> float:
    """The least value of a function of theta, on a grid that zooms in where it is least."""
    count = round(POINTS * (1.0 + loop.delay * loop.rate))
    theta = np.linspace(SMALLEST, top, count)
    for _ in range(ZOOMS):
        values = spare(theta)
        i = int(values.argmin())
        theta = np.linspace(theta[max(i - 1, 0)], theta[min(i + 1, len(theta) - 1)], 65)
    return float(min(values.min(), spare(theta).min()))


def _of_positions(loop: SampledLoop, theta: Float64Array) -> Complex:
    """(k, n, n) the law as a filter of positions."""
    z = np.exp(-1j * theta)
    velocity = loop.filter_response(theta) * (1.0 - z) * loop.rate
    made: Complex = np.asarray(loop.K) + velocity[:, np.newaxis, np.newaxis] * np.asarray(loop.B)
    return made


def _spare(loop: SampledLoop, theta: Float64Array) -> Float64Array:
    """(k,) the smallest eigenvalue of Colgate's condition, in its form for any delay."""
    whole, part = loop.periods
    D = np.exp(-1j * whole * theta) * (1.0 - part + part * np.exp(-1j * theta))
    factor = 0.25j * loop.T * np.exp(-0.5j * theta) / np.sin(0.5 * theta)
    p = factor[:, np.newaxis, np.newaxis] * _of_positions(loop, theta)
    pD = p * D[:, np.newaxis, np.newaxis]
    damping = np.broadcast_to(np.asarray(loop.damping), p.shape)
    spare = damping - pD - _adjoint(pD)
    if not part:
        return np.asarray(np.linalg.eigvalsh(spare)[:, 0])
    # The Schur complement of this matrix is the condition, without an inverse of damping.
    off = np.sqrt(1.0 - np.abs(D) ** 2)[:, np.newaxis, np.newaxis] * p
    both = np.concatenate(
        [np.concatenate([spare, _adjoint(off)], axis=2), np.concatenate([off, damping], axis=2)], axis=1
    )
    return np.asarray(np.linalg.eigvalsh(both)[:, 0])


def _harmonic(loop: SampledLoop, theta: Float64Array) -> Float64Array:
    """(k,) the smallest eigenvalue of the resistance against a sinusoidal motion."""
    s = 1j * theta * loop.rate
    hold = np.exp(-s * loop.delay) * (1.0 - np.exp(-1j * theta)) / (s * loop.T)
    if loop.differenced:
        law = _of_positions(loop, theta)
    else:
        law = np.asarray(loop.K) + (s * loop.filter_response(theta))[:, np.newaxis, np.newaxis] * np.asarray(loop.B)
    z = (hold / s)[:, np.newaxis, np.newaxis] * law
    return np.asarray(np.linalg.eigvalsh(np.asarray(loop.damping) + 0.5 * (z + _adjoint(z)))[:, 0])


def _adjoint(matrices: Complex) -> Complex:
    return matrices.conj().swapaxes(1, 2)
