"""The metrics of joints.

Errors are wanted minus true. A torque acts unchanged from its tick to the next, so integrals over time are sums.

References:
    Chapter, section 10.2.1.1, figure 10.4 (overshoot, settling time, steady-state error); figure 10.12 (effort).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.angles import short_way
from taut.base.types import Array, Float64Array
from taut.control.limits import LIMIT_TERMS
from taut.record.metrics.declaration import metric
from taut.record.step import step_response

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["MOVING", "RESTING", "stuck"]

RESTING: Final = 1e-4  # [rad/s | m/s] a joint that is slower than this rests
MOVING: Final = 1e-3  # [rad/s | m/s] a reference that is faster than this moves


def _period(run: Run) -> Float64Array:
    """(k - 1, 1) how long each row's torque acted [s]."""
    return np.asarray(np.diff(run.t)[:, np.newaxis])


# -------------------------------------------------------------------- response to a set-point


def _of_step(run: Run, quantity: str) -> Float64Array | None:
    """(n,) of the response of each joint to a step; what it was worked out with belongs to `step_response`."""
    error = run.error
    if error is None or not run.is_setpoint:
        return None
    return np.array([getattr(step_response(run.t, error[:, i]), quantity) for i in range(run.n)])


metric(
    name="overshoot",
    unit="%",
    doc="Percentage of the initial error by which the joint goes beyond where it comes to rest (figure 10.4)",
    per_joint=True,
    needs="set-point",
)(partial(_of_step, quantity="overshoot"))
metric(
    name="settling_time",
    unit="s",
    doc="Time after which the error stays within 2 % of where it comes to rest; infinite if it does not settle",
    per_joint=True,
    needs="set-point",
)(partial(_of_step, quantity="settling_time"))
metric(
    name="steady_state_error",
    title="steady-state error",
    unit="%",
    doc="Percentage of the initial error that remains: mean of the last 2 % of the run",
    per_joint=True,
    needs="set-point",
)(partial(_of_step, quantity="steady_state_error"))


# -------------------------------------------------------------------- tracking


@metric(title="RMS error", unit="{q}", per_joint=True, together="norm", needs="joint motion")
def rms_error(run: Run) -> Float64Array | None:
    """Root of the mean square of the tracking error."""
    return None if run.error is None else np.sqrt(np.mean(run.error**2, axis=0))


def _peak_of_norm(run: Run, joints: Sequence[int]) -> float:
    return np.nan if run.error is None else float(np.max(np.sqrt(np.sum(run.error[:, list(joints)] ** 2, axis=1))))


@metric(unit="{q}", per_joint=True, combine=_peak_of_norm, needs="joint motion")
def peak_error(run: Run) -> Float64Array | None:
    """Largest magnitude of the tracking error."""
    return None if run.error is None else _peak(run.error)


@metric(unit="{q}", per_joint=True, together="norm", needs="joint motion")
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


@metric(title="stuck", unit="s", per_joint=True, combine=_any_stuck, needs="joint motion")
def stuck_time(run: Run) -> Float64Array | None:
    """Time in which the joint rests, slower than 1e-4, while its reference moves, faster than 1e-3: stiction."""
    rows = stuck(run)
    return None if rows is None else np.asarray(np.sum(rows[:-1] * _period(run), axis=0))


@metric(unit="{q}", per_joint=True, needs="joint motion")
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


# -------------------------------------------------------------------- torque


@metric(unit="({tau})^2 s", per_joint=True, together="sum")
def effort(run: Run) -> Float64Array:
    """Integral of tau^2, as in figure 10.12."""
    return np.asarray(np.sum(run.tau[:-1] ** 2 * _period(run), axis=0))


@metric(unit="{tau}", per_joint=True)
def peak_torque(run: Run) -> Float64Array:
    """Largest magnitude of tau."""
    return _peak(run.tau)


def _limited(run: Run, terms: Sequence[str]) -> Array | None:
    """(k, n) whether one of these terms acts on the command."""
    parts = [run.terms[name] != 0.0 for name in terms if name in run.terms]
    return np.any(parts, axis=0) if parts else None


def _time_limited(run: Run, terms: Sequence[str]) -> Float64Array | None:
    rows = _limited(run, terms)
    return None if rows is None else np.asarray(np.sum(rows[:-1] * _period(run), axis=0))


def _any_limited(run: Run, joints: Sequence[int], terms: Sequence[str]) -> float:
    rows = _limited(run, terms)
    return np.nan if rows is None else float(np.sum(rows[:-1, list(joints)].any(axis=1) * np.diff(run.t)))


def _declare_time(name: str, title: str, doc: str, terms: Sequence[str]) -> None:
    together: Callable[[Run, Sequence[int]], float] = partial(_any_limited, terms=terms)
    declare = metric(name=name, title=title, unit="s", doc=doc, per_joint=True, combine=together)
    declare(partial(_time_limited, terms=terms))


_LIMITED: Final[Mapping[str, tuple[str, str]]] = {
    "rate_limit": ("rate limited", "Time in which the limit of the torque rate cut the command"),
    "speed_limit": ("speed limited", "Time in which the speed limit cut the command"),
    "torque_limit": ("torque limited", "Time in which the torque limit cut the command"),
}
_declare_time("saturation_time", "saturated", "Time in which the limits cut the command", LIMIT_TERMS)
for _term, (_title, _doc) in _LIMITED.items():
    _declare_time(f"{_term}_time", _title, _doc, [_term])
_declare_time("blend_time", "blending", "Time in which a change of law or parameters was blended in", ["blend"])


@metric(unit="{command}", per_joint=True)
def limit_excess(run: Run) -> Float64Array | None:
    """Largest magnitude that the limits took away from the command."""
    cuts = [run.terms[name] for name in LIMIT_TERMS if name in run.terms]
    return _peak(np.sum(cuts, axis=0)) if cuts else None


@metric(unit="{tau}/s", per_joint=True, together="sum")
def chatter(run: Run) -> Float64Array | None:
    """Total variation of tau per second."""
    duration = float(run.t[-1] - run.t[0])
    return np.asarray(np.sum(np.abs(np.diff(run.tau, axis=0)), axis=0) / duration) if duration else None


@metric(unit="J", per_joint=True, together="sum")
def energy(run: Run) -> Float64Array:
    """Work of tau on the joint."""
    # A torque that is constant over the period does the work tau (q_next - q), whatever v does in between.
    return np.asarray(np.sum(run.tau[:-1] * short_way(np.diff(run.q, axis=0), run.continuous), axis=0))


@metric(unit="{tau}", per_joint=True)
def torque_jump(run: Run) -> Float64Array | None:
    """Largest jump of tau: how far its change in a tick is at least off those in the ticks before and after.

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


@metric(title="torque", unit="% of limit", per_joint=True)
def torque_use(run: Run) -> Float64Array:
    """Percentage of the arm's effort limit that the largest magnitude of tau is."""
    return _fraction_of_limit(run, run.tau, "effort")


@metric(title="speed", unit="% of limit", per_joint=True)
def speed_use(run: Run) -> Float64Array:
    """Percentage of the arm's velocity limit that the largest speed is."""
    return _fraction_of_limit(run, run.v, "velocity")


def _peak(rows: Float64Array) -> Float64Array:
    return np.asarray(np.max(np.abs(rows), axis=0))
