"""How a linear system that was set off comes to rest, for any order, in continuous time and in ticks.

Where it ends is proved, not looked for: a Lyapunov function of the system bounds all that comes after a state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_lyapunov
from scipy.optimize import brentq

from taut.base.types import Float64Array
from taut.linear.second_order_response import EARLY, LATE, swing
from taut.linear.step_response import BAND

__all__ = ["NEVER", "StepShape", "companion", "powers", "sampled_shape", "step_shape"]

PER_TURN: Final = 48  # points in one turn, or in six time constants, of the fastest pole that is still alive
ALIVE: Final = 40.0  # time constants after which a pole is gone
CHUNK: Final = 8192
MOST: Final = 2_000_000  # points looked at
NOTHING: Final = 1e-9  # of the step: below it there is no overshoot


@dataclass(frozen=True, kw_only=True)
class StepShape:
    """What the chapter reads off the response to a step: figure 10.4.

    Args:
        overshoot: [%] of the step; NaN if it does not settle.
        settling_time: [s] after which the error stays within 2 %; infinite if it does not settle, NaN if it is so
            lightly damped that it was not followed to its end: more than two million points, and not a single pair.
        rise_time: [s] from 90 % to 10 % of the error; NaN if it does not settle.
        peak_time: [s] of the largest overshoot; NaN if there is none.
    """

    overshoot: float
    settling_time: float
    rise_time: float
    peak_time: float


NEVER: Final = StepShape(overshoot=math.nan, settling_time=math.inf, rise_time=math.nan, peak_time=math.nan)


def powers(step: Float64Array, start: Float64Array, count: int) -> Float64Array:
    """(N, count) start, step start, step^2 start, ..., doubled each time rather than one by one."""
    made, jump = start[:, np.newaxis], step
    while made.shape[1] < count:
        made = np.hstack([made, jump @ made[:, : count - made.shape[1]]])
        jump = jump @ jump
    return made


def companion(a: Float64Array, poles: NDArray[np.complex128]) -> tuple[Float64Array, float]:
    """The matrix of e^(k) / w^k, and w: the mean size of the poles, so that its entries are of one size."""
    sizes = np.abs(poles)
    w = float(np.exp(np.mean(np.log(sizes[sizes > 0.0])))) if (sizes > 0.0).any() else 1.0
    n = len(poles)
    A = np.diag(np.full(n - 1, w), 1)
    A[-1] = -a[:0:-1] / a[0] * w ** (np.arange(n) - n + 1.0)
    return A, w


def step_shape(A: Float64Array, start: Float64Array, c: Float64Array) -> StepShape:
    """The shape of e = c exp(A t) start, of e(0) = 1, for an A whose eigenvalues have negative real parts."""
    poles = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    slowest = float(np.abs(poles.real).min())

    def pieces() -> Iterator[tuple[float, float, Float64Array]]:
        t, x = 0.0, start
        while True:
            alive = np.abs(poles[np.abs(poles.real) * t < ALIVE])
            spacing = 2.0 * math.pi / (PER_TURN * float(alive.max(initial=slowest)))
            count = min(CHUNK, max(PER_TURN, math.ceil(t / spacing)))
            states = powers(expm(A * spacing), x, count + 1)
            yield t, spacing, states
            t, x = t + count * spacing, states[:, -1]

    def passes(row: Float64Array, level: float, low: float, high: float) -> float:
        def beyond(t: float) -> float:
            return float(row @ expm(A * t) @ start) - level

        return float(brentq(beyond, low, high, xtol=1e-15 * high, rtol=1e-14))

    found = _look(pieces(), c, _bound(A, c, solve_continuous_lyapunov))
    settled = passes(c, found.level, *found.last) if found.settled else _end_of_a_pair(A, c, found, poles)
    lowest, peak = 0.0, math.nan
    if found.trough is not None:
        peak = passes(c @ A, 0.0, *found.trough)
        lowest = float(c @ expm(A * peak) @ start)
    return StepShape(
        overshoot=100.0 * abs(lowest),
        settling_time=settled,
        rise_time=passes(c, LATE, *found.passed[LATE]) - passes(c, EARLY, *found.passed[EARLY]),
        peak_time=peak,
    )


def sampled_shape(A: Float64Array, start: Float64Array, c: Float64Array, T: float) -> StepShape:
    """The shape of e_k = c A^k start in ticks, for an A whose eigenvalues lie within the unit circle.

    Times are those of ticks: settling that of the first one from which on all are within the band.
    """

    def pieces() -> Iterator[tuple[float, float, Float64Array]]:
        k, x, count = 0, start, PER_TURN
        while True:
            states = powers(A, x, count + 1)
            yield float(k), 1.0, states
            k, x, count = k + count, states[:, -1], CHUNK

    found = _look(pieces(), c, _bound(A, c, lambda At, Q: solve_discrete_lyapunov(At, -Q)))
    return StepShape(
        overshoot=100.0 * abs(found.lowest),
        settling_time=T * found.last[1] if found.settled else math.nan,
        rise_time=T * (found.passed[LATE][1] - found.passed[EARLY][1]),
        peak_time=math.nan if found.trough is None else T * (found.trough[1] - 1.0),
    )


def _end_of_a_pair(A: Float64Array, c: Float64Array, found: _Found, poles: NDArray[np.complex128]) -> float:
    """When the last pair alive, hardly damped, comes to rest: its envelope tells the half-turn, and that the time.

    NaN if it is not alone.
    """
    slow = poles[poles.real.argmax()]
    sigma, omega_d = -float(slow.real), abs(float(slow.imag))
    others = poles[(np.abs(poles - slow) > 0.0) & (np.abs(poles - slow.conjugate()) > 0.0)]
    if not omega_d or np.any(-others.real * found.seen < ALIVE):
        return math.nan
    e, v = float(c @ found.state), float(c @ A @ found.state)
    sine = (v + sigma * e) / omega_d
    phase, lag = math.atan2(sine, e), math.atan2(sigma, omega_d)
    reach = math.log(math.hypot(e, sine) * math.cos(lag) / BAND) / sigma
    extreme = (phase - lag + math.pi * math.floor((omega_d * reach - phase + lag) / math.pi)) / omega_d

    def beyond(t: float) -> float:
        size = swing(sigma, sigma**2 + omega_d**2, -(omega_d**2), e, v, np.array([t]))[0][0]
        return abs(float(size)) - BAND

    quarter = (0.5 * math.pi + lag) / omega_d  # to the zero after the extreme
    return found.seen + float(brentq(beyond, extreme, extreme + quarter, xtol=1e-15 * extreme, rtol=1e-14))


def _bound(
    A: Float64Array, c: Float64Array, solve: Callable[[Float64Array, Float64Array], Float64Array]
) -> Callable[[Float64Array], float]:
    """What abs(c x) can never exceed again after a state."""
    P = solve(A.T, -np.eye(len(A)))
    P = 0.5 * (P + P.T)
    reach = float(c @ np.linalg.solve(P, c))
    return lambda x: math.sqrt(max(reach * float(x @ P @ x), 0.0))


@dataclass
class _Found:
    """Where a response passes its levels: each between two times."""

    settled: bool
    lowest: float
    level: float
    last: tuple[float, float]
    passed: dict[float, tuple[float, float]]
    trough: tuple[float, float] | None
    seen: float  # [s | ticks] up to which
    state: Float64Array


def _look(
    pieces: Iterator[tuple[float, float, Float64Array]], c: Float64Array, bound: Callable[[Float64Array], float]
) -> _Found:
    """One stretch after the other, until all that is left is within the band and above the lowest error."""
    found = _Found(settled=False, lowest=0.0, level=BAND, last=(0.0, 0.0), passed={}, trough=None, seen=0.0, state=c)
    points = 0
    for t0, spacing, states in pieces:
        e = c @ states
        t = t0 + spacing * np.arange(len(e))
        k = int(e.argmin())
        if e[k] < found.lowest - NOTHING:
            found.lowest, found.trough = float(e[k]), (float(t[k] - spacing), float(t[k] + spacing))
        outside = np.flatnonzero(np.abs(e[:-1]) > BAND)
        if outside.size:
            i = int(outside[-1])
            found.level, found.last = math.copysign(BAND, e[i]), (float(t[i]), float(t[i + 1]))
        for level in (EARLY, LATE):
            below = np.flatnonzero((e[:-1] > level) & (e[1:] <= level))
            if level not in found.passed and below.size:
                found.passed[level] = (float(t[below[0]]), float(t[below[0] + 1]))
        found.seen, found.state = float(t[-1]), states[:, -1]
        left = bound(found.state)
        if left <= min(BAND, max(-found.lowest, NOTHING)):
            found.settled = True
            break
        points += len(e)
        if points > MOST:
            break
    return found
