"""Margins of stability of a sampled loop: broken at one joint's command, and at all of them at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar

from taut.base.types import Float64Array

__all__ = ["DiskMargin", "JointMargins", "Margins", "common_delay", "frequency_grid", "margins_of", "scaled_norm"]

Complex = NDArray[np.complex128]
Sensitivity = Callable[[Float64Array], Complex]
GRID: Final = 1000  # frequencies from a ten-thousandth of half the rate on
DECADES: Final = 5.0
NEAR: Final = np.array([0.9, 0.97, 0.99, 1.0, 1.01, 1.03, 1.1])  # about each pole
BALANCING: Final = 60  # sweeps of the scaling that makes the bound tight
BALANCED: Final = 1e-4  # where they end


@dataclass(frozen=True, kw_only=True)
class JointMargins:
    """Of the loop broken at one joint's command, with the others closed.

    Args:
        joint: Its name.
        gain: The least and the greatest factor on the command between which it is stable; 0 and infinity for none.
        phase: [deg] that the command may be turned either way; infinite for a loop that never has gain one.
        delay: [s] that the command may be late besides.
        crossover: [rad/s] where the phase margin is.
    """

    joint: str
    gain: tuple[float, float]
    phase: float
    delay: float
    crossover: float


@dataclass(frozen=True, kw_only=True)
class DiskMargin:
    """Of all commands at once: each may be multiplied by any complex number of a disk, each by another.

    The disk is (1 + d alpha / 2) / (1 - d alpha / 2) with d inside the unit circle. The alpha here is on the safe
    side: the loop is stable for at least that much.

    Args:
        alpha: Its size; at most 2.
        omega: [rad/s] where it is tightest.

    References:
        Seiler, Packard and Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020).
    """

    alpha: float
    omega: float

    @property
    def gain(self) -> tuple[float, float]:
        """Factors on all commands at once, each another one, between which it is stable."""
        half = 0.5 * self.alpha
        return (1.0 - half) / (1.0 + half), (1.0 + half) / (1.0 - half) if half < 1.0 else np.inf

    @property
    def phase(self) -> float:
        """[deg] that all commands may be turned, each another way."""
        return float(np.degrees(2.0 * np.arctan(0.5 * self.alpha)))


@dataclass(frozen=True, kw_only=True)
class Margins:
    """How far a loop is from instability; all zero for one that is unstable."""

    joints: tuple[JointMargins, ...]
    disk: DiskMargin

    def __str__(self) -> str:
        width = max(len(each.joint) for each in self.joints)
        lines = [f"   {'joint':<{width}}   gain               phase [deg]   delay [ms]   at [rad/s]"]
        for each in self.joints:
            gain = f"{each.gain[0]:.3g} to {each.gain[1]:.3g}"
            lines.append(
                f"   {each.joint:<{width}}   {gain:<17}  {_told(each.phase):>11}   {_told(1e3 * each.delay):>10}   "
                f"{'-' if math.isnan(each.crossover) else f'{each.crossover:.4g}':>10}"
            )
        low, high = self.disk.gain
        lines.append(
            f"   all at once (disk, alpha {self.disk.alpha:.3g}): gain {low:.3g} to {high:.3g}, "
            f"phase {self.disk.phase:.3g} deg, at {self.disk.omega:.4g} rad/s"
        )
        return "\n".join(lines)


def _told(margin: float) -> str:
    return "any" if math.isinf(margin) else f"{margin:.3g}"


def frequency_grid(dt: float, poles: Float64Array) -> Float64Array:
    """Frequencies up to half the rate, closer together about those of the poles [rad/s]."""
    most = np.pi / dt
    wide = most * np.logspace(-DECADES, 0.0, GRID)
    apart = np.unique(np.round(np.log(poles[poles > wide[0]]), 2))  # to 1 %: joints have many alike
    near = np.outer(np.exp(apart), NEAR).ravel()
    return np.unique(np.concatenate([wide, near[(near > wide[0]) & (near < most)]]))


def margins_of(
    sensitivity: Sensitivity, joints: tuple[str, ...], dt: float, poles: Float64Array, *, stable: bool
) -> Margins:
    """Margins from the sensitivity at the commands.

    Args:
        sensitivity: Gives (k, n, n) at (k,) frequencies [rad/s].
        joints: Names.
        dt: Period [s].
        poles: Their frequencies [rad/s], about which to look closely.
        stable: Whether the loop is stable; an unstable one has no margin.
    """
    if not stable:
        none = tuple(JointMargins(joint=j, gain=(1.0, 1.0), phase=0.0, delay=0.0, crossover=0.0) for j in joints)
        return Margins(joints=none, disk=DiskMargin(alpha=0.0, omega=0.0))
    omega = frequency_grid(dt, poles)
    S = sensitivity(omega)
    each = tuple(_of_joint(name, i, sensitivity, omega, S[:, i, i]) for i, name in enumerate(joints))
    return Margins(joints=each, disk=_disk(sensitivity, omega, S))


def _of_joint(name: str, i: int, sensitivity: Sensitivity, omega: Float64Array, S: Complex) -> JointMargins:
    def loop(w: float) -> complex:
        s = complex(sensitivity(np.array([w]))[0, i, i])
        return 1.0 / s - 1.0

    L = 1.0 / S - 1.0
    low, high = 0.0, np.inf
    # The sign of the imaginary part changes where the phase is 0 or -180 degrees; the grid's end is such a place.
    ends = [omega[-1]] if abs(L[-1].imag) < 1e-9 * abs(L[-1]) else []
    for w in [*_crossings(lambda w: loop(w).imag, omega, L.imag), *ends]:
        real = loop(w).real
        if real < 0.0 and np.isfinite(real):
            factor = -1.0 / real
            low, high = (max(low, factor), high) if factor < 1.0 else (low, min(high, factor))
    phase, delay, crossover = np.inf, np.inf, np.nan
    for w in _crossings(lambda w: abs(loop(w)) - 1.0, omega, np.abs(L) - 1.0):
        late = float(np.angle(loop(w)) + np.pi) % (2.0 * np.pi)
        turn = min(late, 2.0 * np.pi - late)
        delay = min(delay, late / w)
        if np.degrees(turn) < phase:
            phase, crossover = float(np.degrees(turn)), w
    return JointMargins(
        joint=name, gain=(float(low), float(high)), phase=phase, delay=float(delay), crossover=crossover
    )


def _crossings(function: Callable[[float], float], omega: Float64Array, values: Float64Array) -> list[float]:
    """Where a function changes its sign, between the frequencies at which it is known."""
    places = np.flatnonzero(np.isfinite(values[:-1] * values[1:]) & (values[:-1] * values[1:] < 0.0))
    ends = [(omega[k], omega[k + 1]) for k in places]
    # A value that is zero but for rounding has one sign here and another there, and crosses nothing.
    ends = [(low, high) for low, high in ends if function(low) * function(high) < 0.0]
    return [float(brentq(function, low, high, xtol=1e-9 * low, rtol=1e-12)) for low, high in ends]


def common_delay(sensitivity: Sensitivity, dt: float, poles: Float64Array) -> float:
    """How many periods more all commands may be late, not whole, of a stable loop: where it first is not.

    Law:          det(I + L z^-d) = 0: an eigenvalue of L has modulus 1 and d omega dt = arg + pi, modulo 2 pi
    """

    def loci(omega: Float64Array) -> Complex:
        S = sensitivity(omega)
        found = np.linalg.eigvals(np.linalg.inv(S) - np.eye(S.shape[1]))
        return np.asarray(np.take_along_axis(found, np.argsort(np.abs(found), axis=1), axis=1))

    def size(w: float, i: int) -> float:
        return float(np.log(np.abs(loci(np.array([w]))[0, i])))

    omega = frequency_grid(dt, poles)
    sizes, least = np.log(np.abs(loci(omega))), math.inf
    for i in range(sizes.shape[1]):
        for w in _crossings(partial(size, i=i), omega, sizes[:, i]):
            late = float(np.angle(loci(np.array([w]))[0, i]) + np.pi) % (2.0 * np.pi)
            least = min(least, late / (w * dt))
    return least


def _disk(sensitivity: Sensitivity, omega: Float64Array, S: Complex) -> DiskMargin:
    """alpha = 1 / max over omega of mu(S - I / 2), mu from above by a scaled norm."""
    eye = np.eye(S.shape[1])
    sizes = scaled_norm(S - 0.5 * eye)
    k = int(np.argmax(sizes))

    def size(w: float) -> float:
        return -float(scaled_norm(sensitivity(np.array([w])) - 0.5 * eye)[0])

    around = omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)]
    best = minimize_scalar(size, bounds=around, method="bounded", options={"xatol": 1e-6 * omega[k]})
    worst, at = max((sizes[k], omega[k]), (-float(best.fun), float(best.x)))
    return DiskMargin(alpha=float(min(2.0, 1.0 / worst)), omega=float(at))


def scaled_norm(M: Complex) -> Float64Array:
    """(k,) upper bounds of mu of (k, n, n) for independent complex factors: the norm of D M D^-1.

    The diagonal D makes each row of the matrix as large as the column beside it, after Osborne (1960).
    """
    off = np.abs(M) ** 2 * (1.0 - np.eye(M.shape[1]))
    d = np.ones(M.shape[:2])  # squares of D
    for _ in range(BALANCING):
        scaled = off * d[:, :, None] / d[:, None, :]
        rows, columns = scaled.sum(axis=2), scaled.sum(axis=1)
        some = (rows > 0.0) & (columns > 0.0)
        change = np.where(some, np.sqrt(columns / np.where(some, rows, 1.0)), 1.0)
        d = d * change
        if np.abs(change - 1.0).max() < BALANCED:
            break
    root = np.sqrt(d)
    norms = [np.linalg.norm(x, 2, axis=(1, 2)) for x in (root[:, :, None] * M / root[:, None, :], M)]
    return np.asarray(np.minimum(*norms))
