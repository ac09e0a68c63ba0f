"""Performance of a linear system: its step response, and its stability margins.

A step is the free response of the remaining error, x_final - exp(A t) x_final, on a grid; where it crosses a level
between two points the crossing is solved for. All margins are read off the sensitivity S = (I + L)^-1 where signals
are added to those at which a loop is opened, so that a joint in closed form and a linearised arm need the same code.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taut.base.result import Cell, Table
from taut.base.types import Float64Array

Complex = NDArray[np.complex128]
Sensitivity = Callable[[Float64Array], Complex]
BAND: Final = 0.02  # [-] of a step: the settling band
EARLY, LATE = 0.9, 0.1  # [-] of a step that are still to go at the ends of the rise time
TIME_CONSTANTS: Final = 25.0  # [-] of the slowest pole, for which a response is followed
POINTS: Final = 4000  # of a continuous response at least
PER_RADIAN: Final = 10.0  # points of its fastest oscillation
MAX_POINTS: Final = 2_000_000  # points that are followed at most
CHUNK: Final = 8192  # of them at once
NO_OVERSHOOT: Final = 1e-9  # [-] of a step: a smaller overshoot is rounding
GRID: Final = 1000  # frequencies of the grid, besides those about poles
DECADES_BELOW: Final = 5.0  # of the grid, below half the rate
DECADES_AROUND: Final = 4.0  # of the grid in continuous time, below the slowest and above the fastest pole
NEAR: Final = np.array([0.9, 0.97, 0.99, 1.0, 1.01, 1.03, 1.1])  # [-] frequencies about each pole
SCALING_SWEEPS: Final = 60  # sweeps of the scaling that makes the bound tight
BALANCED: Final = 1e-4  # [-] change of the scaling at which they end


@dataclass(frozen=True, kw_only=True)
class StepInfo:
    """Step response of one output to one input, as in figure 10.4; NaN if it does not settle."""

    final: float  # after a unit step
    overshoot: float  # [%] of the final value
    settling_time: float  # [s] to stay within 2 %; infinite if it never does, NaN if too lightly damped to follow
    rise_time: float  # [s] from 10 % to 90 %
    peak_time: float  # [s] of the largest overshoot; NaN without one

    @classmethod
    def none(cls, final: float = math.nan) -> StepInfo:
        """That of a response that does not settle."""
        nan = math.nan
        return cls(final=final, overshoot=nan, settling_time=math.inf, rise_time=nan, peak_time=nan)

    def table(self) -> Table:
        """The numbers as one row."""
        columns = ("final value", "overshoot [%]", "2 % settling time [s]", "rise time [s]", "peak time [s]")
        row = [self.final, self.overshoot, self.settling_time, self.rise_time, self.peak_time]
        return Table(title="step response", columns=columns, rows=[row])


def powers(row: Float64Array, step: Float64Array, count: int) -> Float64Array:
    """(count, n) row, row step, row step^2, ...: doubled each time rather than one by one."""
    made, jump = row[np.newaxis], step
    while len(made) < count:
        made = np.vstack([made, made[: count - len(made)] @ jump])
        jump = jump @ jump
    return made


def step_response(
    A: Float64Array,
    start: Float64Array,  # (n,) final state, which is the remaining error at the beginning
    row: Float64Array,  # (n,) remaining error as a fraction of the final value: row @ x
    *,
    dt: float | None,
    s_poles: Complex,  # (n,) [1/s]
    final: float,
) -> StepInfo:
    """Numbers of a step response by the decay of row @ x from x = start."""
    import scipy.linalg
    from scipy.optimize import brentq

    some = s_poles[np.isfinite(s_poles.real) & (s_poles.real < 0.0)]
    horizon = TIME_CONSTANTS / float(-some.real.max(initial=-np.inf)) if len(some) else 0.0
    h = dt or min(horizon / POINTS, 1.0 / (PER_RADIAN * max(float(np.abs(some.imag).max(initial=0.0)), 1e-300)))
    count = min(math.ceil(horizon / h) + 2, MAX_POINTS)
    step = A if dt else np.asarray(scipy.linalg.expm(A * h))
    remaining = _followed(step, start, row, count)
    if not np.isfinite(remaining).all():
        return StepInfo.none(final)

    def value(seen: Float64Array, t: float) -> float:
        return float(seen @ scipy.linalg.expm(A * t) @ start)

    def crossing(seen: Float64Array, first: int, last: int, level: float = 0.0) -> float:
        """Time between two samples at which what a row shows passes a level; of a sampled system the last."""
        before, after = first * h, last * h
        if dt or (value(seen, before) - level) * (value(seen, after) - level) >= 0.0:
            return after
        return float(brentq(lambda t: value(seen, t) - level, before, after, rtol=1e-14))

    def first(level: float) -> float:
        below = np.flatnonzero(remaining <= level)
        return 0.0 if not len(below) or below[0] == 0 else crossing(row, int(below[0]) - 1, int(below[0]), level)

    outside = np.flatnonzero(np.abs(remaining) > BAND)
    last = int(outside[-1]) if len(outside) else -1
    settling = 0.0 if last < 0 else math.nan
    if 0 <= last < count - 1:
        settling = crossing(row, last, last + 1, math.copysign(BAND, remaining[last]))
    k = int(remaining.argmin())
    peak, peak_time = -float(remaining[k]), k * h
    if dt is None and 0 < k < count - 1:
        peak_time = crossing(row @ A, k - 1, k + 1)
        peak = -value(row, peak_time)
    return StepInfo(
        final=final,
        overshoot=100.0 * peak if peak > NO_OVERSHOOT else 0.0,
        settling_time=settling,
        rise_time=first(LATE) - first(EARLY),
        peak_time=peak_time if peak > NO_OVERSHOOT else math.nan,
    )


def _followed(step: Float64Array, start: Float64Array, row: Float64Array, count: int) -> Float64Array:
    """(count,) row @ step^k @ start."""
    rows = powers(row, step, min(count, CHUNK))
    jump = np.linalg.matrix_power(step, len(rows))
    parts, x = [], start
    for _ in range(math.ceil(count / len(rows))):
        parts.append(rows @ x)
        x = jump @ x
    return np.concatenate(parts)[:count]


@dataclass(frozen=True, kw_only=True)
class SignalMargins:
    """Margins of the loop opened at one signal, with the others closed."""

    signal: str
    gain: tuple[float, float]  # smallest and largest stable factor on the signal [-]; 0 and infinity for none
    phase: float  # [deg], lead or lag; infinite for a loop whose gain never is one
    delay: float  # [s]; of a sampled loop exact for whole periods: a part of one acts within the hold
    crossover: float  # frequency of the phase margin [rad/s]; NaN without one


@dataclass(frozen=True, kw_only=True)
class DiskMargin:
    """Margin of all signals at once: each may be multiplied by its own complex number of a disk.

    The disk is (1 + d alpha / 2) / (1 - d alpha / 2), |d| < 1; the alpha here is a lower bound.

    References:
        Seiler, Packard and Gahinet, An introduction to disk margins, IEEE Control Systems Magazine 40 (2020).
    """

    alpha: float  # size of the disk [-]; at most 2
    omega: float  # frequency at which it is smallest [rad/s]

    @property
    def gain(self) -> tuple[float, float]:
        """Factors on all signals at once, each another one, between which the loop is stable [-]."""
        half = 0.5 * self.alpha
        return (1.0 - half) / (1.0 + half), (1.0 + half) / (1.0 - half) if half < 1.0 else np.inf

    @property
    def phase(self) -> float:
        """Phase by which all signals may be rotated, each by another [deg]."""
        return float(np.degrees(2.0 * np.arctan(0.5 * self.alpha)))


@dataclass(frozen=True, kw_only=True)
class Margins:
    """Stability margins of a loop; all zero for an unstable one."""

    signals: tuple[SignalMargins, ...]  # of the loop opened at each signal alone
    disk: DiskMargin  # of all signals at once

    @property
    def gain(self) -> tuple[float, float]:
        """Factors on any one signal between which the loop is stable [-]."""
        return max(each.gain[0] for each in self.signals), min(each.gain[1] for each in self.signals)

    @property
    def phase(self) -> float:
        """The smallest phase margin [deg]."""
        return min(each.phase for each in self.signals)

    @property
    def delay(self) -> float:
        """The smallest delay margin [s]."""
        return min(each.delay for each in self.signals)

    def table(self) -> Table:
        """A row for each signal, and one for all of them at once."""
        rows: list[list[Cell]] = [
            [each.signal, *each.gain, each.phase, 1e3 * each.delay, each.crossover] for each in self.signals
        ]
        rows.append(["all at once (disk)", *self.disk.gain, self.disk.phase, None, self.disk.omega])
        columns = ("signal", "gain from [-]", "to [-]", "phase [deg]", "delay [ms]", "at [rad/s]")
        return Table(title="margins", columns=columns, rows=rows, note=f"disk margin alpha = {self.disk.alpha:.4g}")


def frequency_grid(dt: float | None, poles: Float64Array) -> Float64Array:
    """Frequencies [rad/s], closer together about those of (k,) poles [rad/s]; up to half the rate if sampled."""
    some = poles[(poles > 0.0) & np.isfinite(poles)]
    if dt:
        highest = np.pi / dt
        wide = highest * np.logspace(-DECADES_BELOW, 0.0, GRID)
    else:
        low, high = (float(some.min()), float(some.max())) if len(some) else (1.0, 1.0)
        highest = high * 10.0**DECADES_AROUND
        wide = np.geomspace(low / 10.0**DECADES_AROUND, highest, 2 * GRID)
    apart = np.unique(np.round(np.log(some[some > wide[0]]), 2))  # to 1 %: joints have many alike
    near = np.outer(np.exp(apart), NEAR).ravel()
    return np.unique(np.concatenate([wide, near[(near > wide[0]) & (near < highest)]]))


def margins_of(
    sensitivity: Sensitivity, signals: tuple[str, ...], dt: float | None, poles: Float64Array, *, stable: bool
) -> Margins:
    """Margins from the sensitivity (k, n, n) at n signals, on a grid closer about the poles' frequencies [rad/s]."""
    if not stable:
        none = tuple(SignalMargins(signal=j, gain=(1.0, 1.0), phase=0.0, delay=0.0, crossover=0.0) for j in signals)
        return Margins(signals=none, disk=DiskMargin(alpha=0.0, omega=0.0))
    omega = frequency_grid(dt, poles)
    S = sensitivity(omega)
    each = tuple(_of_signal(name, i, sensitivity, omega, S[:, i, i]) for i, name in enumerate(signals))
    return Margins(signals=each, disk=_disk(sensitivity, omega, S))


def _of_signal(name: str, i: int, sensitivity: Sensitivity, omega: Float64Array, S: Complex) -> SignalMargins:
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
    for w, late in _unit_crossings(loop, omega, L):
        turn = min(late, 2.0 * np.pi - late)
        delay = min(delay, late / w)
        if np.degrees(turn) < phase:
            phase, crossover = float(np.degrees(turn)), w
    return SignalMargins(
        signal=name, gain=(float(low), float(high)), phase=phase, delay=float(delay), crossover=crossover
    )


def _crossings(function: Callable[[float], float], omega: Float64Array, values: Float64Array) -> list[float]:
    """Where a function changes its sign, between the frequencies at which it is known."""
    from scipy.optimize import brentq

    places = np.flatnonzero(np.isfinite(values[:-1] * values[1:]) & (values[:-1] * values[1:] < 0.0))
    ends = [(omega[k], omega[k + 1]) for k in places]
    # A value that is zero but for rounding has one sign here and another there, and crosses nothing.
    ends = [(low, high) for low, high in ends if function(low) * function(high) < 0.0]
    return [float(brentq(function, low, high, xtol=1e-9 * low, rtol=1e-12)) for low, high in ends]


def _unit_crossings(
    locus: Callable[[float], complex], omega: Float64Array, values: Complex
) -> list[tuple[float, float]]:
    """Frequencies at which a locus crosses the unit circle, and its angle there beyond -180 degrees, 0 to 2 pi."""
    found = _crossings(lambda w: abs(locus(w)) - 1.0, omega, np.abs(values) - 1.0)
    return [(w, float(np.angle(locus(w)) + np.pi) % (2.0 * np.pi)) for w in found]


def common_delay(sensitivity: Sensitivity, dt: float, poles: Float64Array) -> float:
    """Delay margin of all signals delayed together, in periods, not whole, of a stable loop.

    Law:          det(I + L z^-d) = 0: an eigenvalue of L has modulus 1 and d omega dt = arg + pi, modulo 2 pi
    """

    def loci(omega: Float64Array) -> Complex:
        S = sensitivity(omega)
        found = np.linalg.eigvals(np.linalg.inv(S) - np.eye(S.shape[1]))
        return np.asarray(np.take_along_axis(found, np.argsort(np.abs(found), axis=1), axis=1))

    def locus(w: float, i: int) -> complex:
        return complex(loci(np.array([w]))[0, i])

    omega = frequency_grid(dt, poles)
    crossings = (_unit_crossings(partial(locus, i=i), omega, L) for i, L in enumerate(loci(omega).T))
    return min((late / (w * dt) for each in crossings for w, late in each), default=math.inf)


def _disk(sensitivity: Sensitivity, omega: Float64Array, S: Complex) -> DiskMargin:
    """alpha = 1 / max over omega of mu(S - I / 2), mu from above by a scaled norm."""
    from scipy.optimize import minimize_scalar

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
    """(k,) upper bounds of mu of (k, n, n) for independent complex factors: |D M D^-1|, D after Osborne (1960)."""
    off = np.abs(M) ** 2 * (1.0 - np.eye(M.shape[1]))
    d = np.ones(M.shape[:2])  # squares of D
    for _ in range(SCALING_SWEEPS):
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
