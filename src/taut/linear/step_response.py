"""Step response of a linear system: overshoot, settling, rise and peak time, exactly.

A step is the free response of what is still to go: x_final - exp(A t) x_final. It is followed on a grid, and where it
crosses a level between two points the crossing is solved for with the matrix exponential.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taut.base.result import Table
from taut.base.types import Float64Array

__all__ = ["BAND", "StepInfo", "powers", "step_response"]

BAND: Final = 0.02  # [-] of a step: the settling band
EARLY, LATE = 0.9, 0.1  # [-] of a step that are still to go at the ends of the rise time
TIME_CONSTANTS: Final = 25.0  # [-] of the slowest pole, for which a response is followed
POINTS: Final = 4000  # of a continuous response at least
PER_RADIAN: Final = 10.0  # points of its fastest oscillation
MAX_POINTS: Final = 2_000_000  # points that are followed at most
CHUNK: Final = 8192  # of them at once
NO_OVERSHOOT: Final = 1e-9  # [-] of a step: a smaller overshoot is rounding


@dataclass(frozen=True, kw_only=True)
class StepInfo:
    """Step response of one output to one input, as figure 10.4 of the chapter defines its numbers.

    Args:
        final: The output in the end, after a unit step.
        overshoot: [%] of the final value; NaN if the response does not settle.
        settling_time: [s] from which on the output is within 2 % of its final value; infinite if it does not settle,
            NaN if it is so lightly damped that it was not followed to its end.
        rise_time: [s] from 10 % to 90 %; NaN if it does not settle.
        peak_time: [s] of the largest overshoot; NaN without one.
    """

    final: float
    overshoot: float
    settling_time: float
    rise_time: float
    peak_time: float

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
    start: Float64Array,
    row: Float64Array,
    *,
    dt: float | None,
    s_poles: NDArray[np.complex128],
    final: float,
) -> StepInfo:
    """Numbers of a step response by the decay of row @ x from x = start.

    Args:
        A: (n, n), continuous or of a period.
        start: (n,) the state in the end of the step, which is what is still to go at its beginning.
        row: (n,) by which what is still to go is row @ x, as a fraction of the final value.
        dt: Period [s], or None.
        s_poles: (n,) poles [1/s].
        final: The final value, for the result.
    """
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

    def state(k: int) -> Float64Array:
        return np.asarray(np.linalg.matrix_power(step, k) @ start)

    def crossing(k: int, level: float) -> float:
        """The time after sample k at which what is still to go passes a level; of a sampled system the next tick."""
        if dt:
            return (k + 1) * h
        x = state(k)
        ends = [value - level for value in (remaining[k], remaining[k + 1])]
        if ends[0] * ends[1] >= 0.0:
            return (k + 1) * h
        return k * h + float(brentq(lambda t: row @ scipy.linalg.expm(A * t) @ x - level, 0.0, h, rtol=1e-14))

    def first(level: float) -> float:
        below = np.flatnonzero(remaining <= level)
        return 0.0 if not len(below) or below[0] == 0 else crossing(int(below[0]) - 1, level)

    outside = np.flatnonzero(np.abs(remaining) > BAND)
    last = int(outside[-1]) if len(outside) else -1
    if last == count - 1:
        settling = math.nan
    else:
        settling = 0.0 if last < 0 else crossing(last, math.copysign(BAND, remaining[last]))
    peak, k = -float(remaining.min()), int(remaining.argmin())
    if dt is None and 0 < k < count - 1:
        x, rates = state(k - 1), row @ A
        slope = [float(rates @ scipy.linalg.expm(A * t) @ x) for t in (0.0, 2.0 * h)]
        if slope[0] < 0.0 < slope[1]:
            at = float(brentq(lambda t: rates @ scipy.linalg.expm(A * t) @ x, 0.0, 2.0 * h, rtol=1e-14))
            peak, k_time = -float(row @ scipy.linalg.expm(A * at) @ x), (k - 1) * h + at
        else:
            k_time = k * h
    else:
        k_time = k * h
    return StepInfo(
        final=final,
        overshoot=100.0 * peak if peak > NO_OVERSHOOT else 0.0,
        settling_time=settling,
        rise_time=first(LATE) - first(EARLY),
        peak_time=k_time if peak > NO_OVERSHOOT else math.nan,
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
