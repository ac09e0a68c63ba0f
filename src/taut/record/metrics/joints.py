"""The metrics of joints.

Errors are wanted minus true. A torque acts unchanged from its tick to the next, so integrals over time are sums.

References:
    Chapter, section 10.2.1.1, figure 10.4 (overshoot, settling time, steady-state error); figure 10.12 (effort).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.parts import short_way
from taut.base.types import Array, Float64Array
from taut.control.limits import LIMIT_TERMS
from taut.record.metrics.declaration import Metric

if TYPE_CHECKING:
    from taut.record.run import Run

RESTING: Final = 1e-4  # [rad/s | m/s] a joint that is slower than this rests
MOVING: Final = 1e-3  # [rad/s | m/s] a reference that is faster than this moves
SETTLING_BAND: Final = 0.02  # of the step: the chapter's 2 %
MIN_STEP: Final = 1e-6  # [rad | m] an initial error below this is none
TAIL_FRACTION: Final = 0.02  # of the run: its mean is the steady state


def _period(run: Run) -> Float64Array:
    """(k - 1, 1) how long each row's torque acted [s]."""
    return np.asarray(np.diff(run.t)[:, np.newaxis])


def step_response(t: Float64Array, error: Float64Array) -> tuple[float, float, float]:
    """Overshoot [%], settling time [s], steady-state error [%] of one joint; NaN where it had no step to answer.

    The error starts at e0 and tends to e_ss. With y = (e - e_ss) / (e0 - e_ss), which starts at 1 and tends to 0, the
    overshoot is -min(y), the settling time the last time at which |y| = 0.02, and the steady-state error e_ss / e0.
    """
    if abs(error[0]) < MIN_STEP or not np.isfinite(error).all():
        return np.nan, np.nan, np.nan
    e = error / error[0]
    tail = max(1, round(TAIL_FRACTION * len(e)))
    e_ss = float(np.mean(e[-tail:]))
    if abs(1.0 - e_ss) < SETTLING_BAND:  # the joint never moved, so that it has no overshoot
        return np.nan, np.nan, 100.0 * e_ss
    y = (e - e_ss) / (1.0 - e_ss)
    before = min(round(0.9 * len(y)), len(y) - 1)
    at_rest = abs(float(np.mean(y[before : before + tail]))) <= 0.1 * SETTLING_BAND
    settling_time = _last_crossing(t, y) if at_rest else np.inf
    return 100.0 * max(0.0, -_minimum(y)), settling_time, 100.0 * e_ss


def _minimum(y: Float64Array) -> float:
    """The least value, between the ticks too: the vertex of the parabola through the lowest three."""
    k = int(np.argmin(y))
    if not 0 < k < len(y) - 1:
        return float(y[k])
    slope, bend = 0.5 * (y[k + 1] - y[k - 1]), y[k + 1] - 2.0 * y[k] + y[k - 1]
    return float(y[k] - 0.5 * slope**2 / bend) if bend > 0.0 else float(y[k])


def _last_crossing(t: Float64Array, y: Float64Array) -> float:
    """Time since the start of the last crossing of the band, linear between two ticks."""
    outside = np.flatnonzero(np.abs(y) > SETTLING_BAND)
    if not outside.size:
        return 0.0
    k = int(outside[-1])
    if k + 1 == len(y):
        return np.inf
    inwards = abs(float(y[k] - y[k + 1]))
    into = (abs(float(y[k])) - SETTLING_BAND) / inwards
    return float(t[k] + into * (t[k + 1] - t[k]) - t[0])


def _of_step(run: Run, entry: int) -> Float64Array | None:
    error = run.error
    if error is None or not run.is_setpoint:
        return None
    return np.array([step_response(run.t, error[:, i])[entry] for i in range(run.n)])


@Metric(unit="%", per_joint=True)
def overshoot(run: Run) -> Float64Array | None:
    """Percentage of the initial error by which the joint goes beyond where it comes to rest (figure 10.4)."""
    return _of_step(run, 0)


@Metric(unit="s", per_joint=True)
def settling_time(run: Run) -> Float64Array | None:
    """Time after which the error stays within 2 % of where it comes to rest; infinite if it does not settle."""
    return _of_step(run, 1)


@Metric(title="steady-state error", unit="%", per_joint=True)
def steady_state_error(run: Run) -> Float64Array | None:
    """Percentage of the initial error that remains: mean of the last 2 % of the run."""
    return _of_step(run, 2)


@Metric(title="RMS error", unit="{q}", per_joint=True, together="norm")
def rms_error(run: Run) -> Float64Array | None:
    """Root of the mean square of the tracking error."""
    return None if run.error is None else np.sqrt(np.mean(run.error**2, axis=0))


def _peak_of_norm(run: Run, joints: Sequence[int]) -> float:
    return np.nan if run.error is None else float(np.max(np.sqrt(np.sum(run.error[:, list(joints)] ** 2, axis=1))))


@Metric(unit="{q}", per_joint=True, together=_peak_of_norm)
def peak_error(run: Run) -> Float64Array | None:
    """Largest magnitude of the tracking error."""
    return None if run.error is None else _peak(run.error)


@Metric(unit="{q}", per_joint=True, together="norm")
def final_error(run: Run) -> Float64Array | None:
    """Tracking error of the last tick."""
    return None if run.error is None else np.asarray(run.error[-1])


def _reference_velocity(run: Run) -> Float64Array | None:
    """(k, n) the velocity that the reference asks for."""
    v: Any = getattr(run.reference, "v", None)
    return None if v is None else np.broadcast_to(np.asarray(v, dtype=np.float64), run.v.shape)


def stuck(run: Run) -> Float64Array | None:
    """(k, n) 1.0 where a joint rests (|v| < 1e-4) while its reference moves (|v_ref| > 1e-3): stiction.

    NaN in the columns of joints whose reference never moves; None where the reference has no velocity.
    """
    wanted = _reference_velocity(run)
    if wanted is None:
        return None
    moving = np.abs(wanted) > MOVING
    resting = (np.abs(run.v) < RESTING) & moving
    return np.where(moving.any(axis=0), resting.astype(np.float64), np.nan)


def _any_stuck(run: Run, joints: Sequence[int]) -> float:
    rows = stuck(run)
    if rows is None or np.isnan(rows[:, list(joints)]).all():
        return np.nan
    return float(np.sum((rows[:-1, list(joints)] == 1.0).any(axis=1) * np.diff(run.t)))


@Metric(title="stuck", unit="s", per_joint=True, together=_any_stuck)
def stuck_time(run: Run) -> Float64Array | None:
    """Time in which the joint rests, slower than 1e-4, while its reference moves, faster than 1e-3: stiction."""
    rows = stuck(run)
    return None if rows is None else np.asarray(np.sum(rows[:-1] * _period(run), axis=0))


@Metric(unit="{q}", per_joint=True)
def reversal_error(run: Run) -> Float64Array | None:
    """Largest tracking error after a reversal of the reference, until halfway to the next one.

    A reference reverses in the tick in which it first moves (|v_ref| > 1e-3) the other way, after a rest or not.
    After its last reversal all that remains of the run counts.
    """
    wanted, error = _reference_velocity(run), run.error
    if wanted is None or error is None:
        return None
    out = np.full(run.n, np.nan)
    for i in range(run.n):
        directions = np.where(np.abs(wanted[:, i]) > MOVING, np.sign(wanted[:, i]), 0.0)
        ticks = np.flatnonzero(directions)
        reversals = ticks[1:][directions[ticks[1:]] != directions[ticks[:-1]]].tolist()
        halfway = [(k + following) // 2 for k, following in pairwise(reversals)]
        windows = zip(reversals, [*halfway, len(error) - 1], strict=False)
        out[i] = max((np.abs(error[k : end + 1, i]).max() for k, end in windows), default=np.nan)
    return out


@Metric(unit="({tau})^2 s", per_joint=True, together="sum")
def effort(run: Run) -> Float64Array:
    """Integral of tau^2, as in figure 10.12."""
    return np.asarray(np.sum(run.tau[:-1] ** 2 * _period(run), axis=0))


@Metric(unit="{tau}", per_joint=True)
def peak_torque(run: Run) -> Float64Array:
    """Largest magnitude of tau."""
    return _peak(run.tau)


def _limited(run: Run) -> Array | None:
    """(k, n) whether a limit acts on the command."""
    parts = [run.terms[name] != 0.0 for name in LIMIT_TERMS if name in run.terms]
    return np.any(parts, axis=0) if parts else None


def _any_limited(run: Run, joints: Sequence[int]) -> float:
    rows = _limited(run)
    return np.nan if rows is None else float(np.sum(rows[:-1, list(joints)].any(axis=1) * np.diff(run.t)))


@Metric(title="saturated", unit="s", per_joint=True, together=_any_limited)
def saturation_time(run: Run) -> Float64Array | None:
    """Time in which the limits cut the command."""
    rows = _limited(run)
    return None if rows is None else np.asarray(np.sum(rows[:-1] * _period(run), axis=0))


@Metric(unit="{tau}/s", per_joint=True, together="sum")
def chatter(run: Run) -> Float64Array | None:
    """Total variation of tau per second."""
    duration = float(run.t[-1] - run.t[0])
    return np.asarray(np.sum(np.abs(np.diff(run.tau, axis=0)), axis=0) / duration) if duration else None


@Metric(unit="J", per_joint=True, together="sum")
def energy(run: Run) -> Float64Array:
    """Work of tau on the joint."""
    # A torque that is constant over the period does the work tau (q_next - q), whatever v does in between.
    return np.asarray(np.sum(run.tau[:-1] * short_way(np.diff(run.q, axis=0), run.continuous), axis=0))


@Metric(unit="{tau}", per_joint=True)
def torque_jump(run: Run) -> Float64Array | None:
    """Largest jump of tau: difference of its change in a tick from that in the tick before or after, the smaller one.

    A continuous torque has next to none, however steep.
    """
    if len(run) <= 3:
        return None
    steps = np.diff(run.tau, axis=0)
    before, after = (np.abs(steps[1:-1] - beside) for beside in (steps[:-2], steps[2:]))
    return _peak(np.minimum(before, after))


def _fraction_of_limit(run: Run, rows: Float64Array, limit: str) -> Float64Array:
    limits = run.info.limits.get(limit, {})
    return np.asarray(100.0 * _peak(rows) / np.array([limits.get(joint, np.nan) for joint in run.joint_names]))


@Metric(title="torque", unit="% of limit", per_joint=True)
def torque_use(run: Run) -> Float64Array:
    """Largest magnitude of tau, as a percentage of the arm's effort limit."""
    return _fraction_of_limit(run, run.tau, "effort")


@Metric(title="speed", unit="% of limit", per_joint=True)
def speed_use(run: Run) -> Float64Array:
    """Largest speed, as a percentage of the arm's velocity limit."""
    return _fraction_of_limit(run, run.v, "velocity")


def _peak(rows: Float64Array) -> Float64Array:
    return np.asarray(np.max(np.abs(rows), axis=0))
