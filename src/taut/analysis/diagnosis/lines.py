"""The line that swings in a run: the strongest in any joint's feedback, or one that turns round in every tick."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.line import Line, line_of
from taut.base.types import Float64Array

__all__ = ["RINGING", "TURNS", "Swing", "alternating_swing", "bolting_swing", "strongest_swing", "without_trend"]

LINE: Final = 0.5  # of the variance of a joint's feedback that is one line
RINGING: Final = 0.1  # damping ratio under which it takes more than six periods to the chapter's 2 %
BOLTING: Final = 0.3  # what grows faster, sixfold in a period, is no oscillation but runs away
LEAST_TORQUE: Final = 0.02  # of the effort: smaller oscillations count only by their error
LEAST_SHARE: Final = 0.01  # of the feedback's effort in the run: less is not why a run is as it is
TURNS: Final = 5  # ticks in a row, each with more feedback than the last and the other way round
HARMONICS: Final = 5.0  # of the reference's frequency: what the reference itself brings
SLOWLY: Final = 0.05  # damping ratio of what grows by a third in a period
CLEAR: Final = 0.8  # of the variance that such a line is: of a pulse late in the window it is less
CROSSINGS: Final = 3  # of its trend, in two periods of what grows
TWO_PI: Final = 2.0 * math.pi
MAIN_SHARE: Final = 0.1  # of the feedback's effort, that what runs away is: less is tossed about by another joint
WAVES: Final = 4  # half waves in a row, each larger than the last
AWAY: Final = 3.0  # times as large as the first of them and all before: the last
EVEN: Final = 2.0  # times as long as the shortest of them: the longest


@dataclass(frozen=True, kw_only=True, eq=False)
class Swing:
    """A line in a joint's feedback in a window of the run."""

    joint: int
    line: Line
    window: slice
    share: float


def strongest_swing(case: Case) -> Swing | None:
    """The line that explains most of any joint's feedback, in the last half of the run or else in all of it."""
    run, count = case.run, len(case.run)
    for window in (slice(count // 2, count), slice(0, count)):
        y = case.feedback[window] / case.size
        slow = _reference_speed(case, window)
        total = float(np.sum((y - y.mean(axis=0)) ** 2)) or 1.0
        best: Swing | None = None
        for i in range(case.n):
            line = line_of(y[:, i], case.dt, HARMONICS * slow)
            if line is None or line.share < LINE or not -BOLTING < line.zeta < RINGING:
                continue
            if line.zeta < -SLOWLY and not (line.share > CLEAR and _turns_round(y[:, i], line, case.dt)):
                continue
            swing = line_of(run.q[window, i], case.dt, 0.5 * line.omega)
            moves = 0.0 if swing is None else swing.amplitude * math.sqrt(max(swing.share, 0.0))
            if max(line.amplitude, line.last * (line.growth > 0.0)) < LEAST_TORQUE and moves < case.tolerance[i]:
                continue
            part = line.share * float(np.sum((y[:, i] - y[:, i].mean()) ** 2)) / total
            if best is None or part > best.share:
                best = Swing(joint=i, line=line, window=window, share=part)
        if best is not None:
            energy = float(np.sum((case.feedback[best.window] / case.size) ** 2)) / case.effort
            share = min(1.0, best.share * energy)
            if share >= LEAST_SHARE:
                return Swing(joint=best.joint, line=best.line, window=best.window, share=share)
    return None


def _turns_round(y: Float64Array, line: Line, dt: float) -> bool:
    """Whether what grows goes to and fro in its last two periods: a step at the end of a window does not."""
    last = y[-max(round(2.0 * TWO_PI / (line.omega * dt)), 4) :]
    last = without_trend(last[:, np.newaxis])[:, 0]
    return int(np.count_nonzero(last[1:] * last[:-1] < 0.0)) >= CROSSINGS


def alternating_swing(case: Case) -> Swing | None:
    """What grows too fast to be fitted: feedback that turns round from each tick to the next, at half of the rate.

    That is how a sampled loop of too much gain runs away, in fewer ticks than a line needs. At the end of the run the
    feedback of the joint turns round in each of five ticks and more, and grows in each.
    """
    y = case.feedback / case.size
    turns = (y[1:] * y[:-1] < 0.0) & (np.abs(y[1:]) > np.abs(y[:-1]))
    in_a_row = np.cumprod(turns[::-1], axis=0).sum(axis=0).astype(np.intp)
    bad = (in_a_row >= TURNS) & (np.abs(y[-1]) > LEAST_TORQUE)
    if not bad.any():
        return None
    i = int(np.argmax(bad * np.abs(y[-1])))
    start = len(y) - 1 - int(in_a_row[i])
    first, last = float(abs(y[start, i])), float(abs(y[-1, i]))
    growth = math.log(last / first) / (in_a_row[i] * case.dt)
    line = Line(omega=math.pi / case.dt, growth=growth, amplitude=math.sqrt(first * last), last=last, share=1.0)
    share = float(np.sum(y[start:, i] ** 2)) / case.effort
    return Swing(joint=i, line=line, window=slice(start, len(y)), share=min(1.0, share))


def bolting_swing(case: Case) -> Swing | None:
    """What grows so fast that the run ends within four periods: half waves at its end, each larger than the last.

    Four of them and more, about as long as each other and faster than what the reference moves at, the last of which
    is three times as large as the first and as all that the feedback was before. That is how a loop runs away whose
    damping comes late, or drives; noise grows so by no chance.
    """
    best: Swing | None = None
    for i in range(case.n):
        y = case.feedback[:, i] / case.size[i]
        y = y - np.median(y)
        edges = [0, *(np.flatnonzero(y[1:] * y[:-1] < 0.0) + 1).tolist(), len(y)]
        peaks = [float(np.abs(y[a:b]).max()) for a, b in pairwise(edges)]
        if len(peaks) > 1 and peaks[-1] < peaks[-2]:  # the last one may be cut short
            edges, peaks = edges[:-1], peaks[:-1]
        count = 1
        while count < len(peaks) and peaks[-count - 1] < peaks[-count]:
            count += 1
        if count < WAVES:
            continue
        start, end, first, last = edges[-count - 1], edges[-1], peaks[-count], peaks[-1]
        whole = np.diff(edges[-count - 1 :])[1:-1]  # the first may begin, and the last may end, within one
        before = float(np.abs(y[:start]).max()) if start else 0.0
        step = float(whole.mean()) * case.dt
        window = slice(start, end)
        if (
            last < AWAY * max(first, before)
            or whole.max() > EVEN * whole.min() + 1
            or math.pi / step < HARMONICS * _reference_speed(case, window)
        ):
            continue
        moves = float(np.ptp(case.run.q[window, i]))
        if last < LEAST_TORQUE and moves < case.tolerance[i]:
            continue
        growth = math.log(last / first) / ((count - 1) * step)
        line = Line(omega=math.pi / step, growth=growth, amplitude=math.sqrt(first * last), last=last, share=1.0)
        share = min(1.0, float(np.sum((case.feedback[window, i] / case.size[i]) ** 2)) / case.effort)
        if share >= MAIN_SHARE and (best is None or share > best.share):
            best = Swing(joint=i, line=line, window=window, share=share)
    return best


def _reference_speed(case: Case, window: slice) -> float:
    """[rad/s] the frequency around which the reference moves: RMS of its acceleration over that of its speed."""
    v = case.moving_reference[window]
    speed = float(np.sqrt(np.mean(v**2)))
    if speed == 0.0:
        return 0.0
    return float(np.sqrt(np.mean((np.diff(v, axis=0) / case.dt) ** 2))) / speed


def without_trend(x: Float64Array) -> Float64Array:
    """(k, n) without its straight trend."""
    t = np.linspace(-1.0, 1.0, len(x))
    basis = np.column_stack([np.ones(len(x)), t])
    return np.asarray(x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0])
