"""Metrics: how well a run went, in numbers, each defined once.

Errors are wanted minus true. A torque acts unchanged from its tick to the next, so integrals over time are sums.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.angles import short_way
from taut.base.checks import read_only
from taut.base.types import Float64Array
from taut.record.step import StepResponse, step_response

if TYPE_CHECKING:
    from taut.record.run import Run

__all__ = ["MEASURES", "Measure", "Metrics", "metrics_of"]


@dataclass(frozen=True, kw_only=True)
class Measure:
    """What one of the metrics is called, its unit, and how it is put together for all joints."""

    title: str
    unit: str  # {q} stands for rad or m, {tau} for N m or N, {command} for the command's unit
    overall: str  # in words


MEASURES: Final = {
    "overshoot": Measure(title="overshoot", unit="%", overall="the largest"),
    "settling_time": Measure(title="settling time", unit="s", overall="the latest"),
    "steady_state_error": Measure(title="steady-state error", unit="%", overall="the largest, with its sign"),
    "rms_error": Measure(title="RMS error", unit="{q}", overall="RMS of the error's norm"),
    "peak_error": Measure(title="peak error", unit="{q}", overall="peak of the error's norm"),
    "final_error": Measure(title="final error", unit="{q}", overall="norm of the final error"),
    "effort": Measure(title="effort", unit="({tau})^2 s", overall="the sum"),
    "peak_torque": Measure(title="peak torque", unit="{tau}", overall="the largest"),
    "saturation_time": Measure(title="saturated", unit="s", overall="time in which any joint's command was cut"),
    "largest_cut": Measure(title="largest cut", unit="{command}", overall="the largest"),
    "chatter": Measure(title="chatter", unit="{tau}/s", overall="the sum"),
    "energy": Measure(title="energy", unit="J", overall="the sum"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Metrics:
    """How well a run went: one number per joint by attribute, and one for all joints in `overall`.

    NaN (null in JSON) where a number has no meaning: overshoot, settling time and steady-state error where the
    reference is not constant, or where a joint had no initial error; saturation where nothing limits the command;
    an overall number of joints with different units.

    Attributes:
        overshoot: (n,) [%] of the initial error, beyond where the joint came to rest (chapter, below figure 10.4).
        settling_time: (n,) [s] after which the error stays within 2 % of where it came to rest, interpolated
            between ticks; inf if it had not come to rest when the run ended.
        steady_state_error: (n,) [%] of the initial error that is left: mean of the last 2 % of the run.
        rms_error: (n,) [rad | m] root of the mean square of the tracking error.
        peak_error: (n,) [rad | m] largest magnitude of the tracking error.
        final_error: (n,) [rad | m] tracking error of the last tick.
        effort: (n,) [(N m)^2 s | N^2 s] integral of tau^2, as in figure 10.12.
        peak_torque: (n,) [N m | N] largest magnitude of tau.
        saturation_time: (n,) [s] in which the limits cut the command.
        largest_cut: (n,) [N m | N] largest magnitude that the limits took away, in the command's unit.
        chatter: (n,) [N m/s | N/s] total variation of tau per second.
        energy: (n,) [J] work of tau on the joint, integral of tau v.
        overall: One number of each for all joints together; `MEASURES[name].overall` says which.

    References:
        Chapter, section 10.2.1.1, figure 10.4 (overshoot, settling time, steady-state error); figure 10.12 (effort).
    """

    joint_names: tuple[str, ...]
    units: dict[str, tuple[str, ...]]  # of each metric, joint by joint
    duration: float  # [s]
    setpoint: bool  # whether the reference is constant
    overshoot: Float64Array
    settling_time: Float64Array
    steady_state_error: Float64Array
    rms_error: Float64Array
    peak_error: Float64Array
    final_error: Float64Array
    effort: Float64Array
    peak_torque: Float64Array
    saturation_time: Float64Array
    largest_cut: Float64Array
    chatter: Float64Array
    energy: Float64Array
    overall: dict[str, float]

    def unit(self, name: str) -> str:
        """Unit of a metric; of joints with different units, both."""
        return " | ".join(dict.fromkeys(self.units[name]))

    def json(self) -> dict[str, Any]:
        """As plain values: {"duration": ..., "setpoint": ..., "rms_error": {"unit", "overall", "joints"}, ...}."""
        out: dict[str, Any] = {"duration": {"unit": "s", "overall": self.duration}, "setpoint": self.setpoint}
        for name in MEASURES:
            per_joint = zip(self.joint_names, getattr(self, name), strict=True)
            out[name] = {
                "unit": self.unit(name),
                "overall": _plain(self.overall[name]),
                "joints": {joint: _plain(value) for joint, value in per_joint},
            }
        return out

    def __str__(self) -> str:
        from taut.record.table import metrics_table

        return metrics_table(self)


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


# -------------------------------------------------------------------- one run


def metrics_of(run: Run) -> Metrics:
    """The metrics of a run."""
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged may hold huge numbers
        columns, overall, setpoint = _measured(run)
    return Metrics(
        joint_names=run.joint_names,
        units={name: _units(run, measure.unit) for name, measure in MEASURES.items()},
        duration=float(run.t[-1] - run.t[0]) if len(run) else 0.0,
        setpoint=setpoint,
        overall=overall,
        **{name: read_only(values) for name, values in columns.items()},
    )


def _units(run: Run, text: str) -> tuple[str, ...]:
    rows = zip(run.units, run.effort_units, run.command_units, strict=True)
    return tuple(text.format(q=q, tau=tau, command=command).replace("(N)^2", "N^2") for q, tau, command in rows)


def _measured(run: Run) -> tuple[dict[str, Float64Array], dict[str, float], bool]:
    """Per joint, overall, and whether it was a set-point run."""
    columns = {name: np.full(run.n, np.nan) for name in MEASURES}
    overall = dict.fromkeys(MEASURES, np.nan)
    if not len(run):
        return columns, overall, False
    alike = len(set(run.units)) == 1
    error, setpoint = run.error, _is_setpoint(run)
    if error is not None:
        norm = np.sqrt(np.sum(error**2, axis=1))
        for name, number in (("rms_error", _rms), ("peak_error", _peak), ("final_error", _final)):
            columns[name] = number(error)
            overall[name] = float(number(norm)) if alike else np.nan
    if error is not None and setpoint:
        steps = [step_response(run.t, error[:, i]) for i in range(run.n)]
        for name in ("overshoot", "settling_time", "steady_state_error"):
            columns[name] = np.array([getattr(step, name) for step in steps])
            overall[name] = _worst(name, steps)
    for name, values, combined in _of_torque(run):
        columns[name] = values
        overall[name] = combined if alike or name in ("saturation_time", "energy") else np.nan
    return columns, overall, setpoint


def _rms(x: Float64Array) -> Float64Array:
    root: Float64Array = np.sqrt(np.mean(x**2, axis=0))
    return root


def _peak(x: Float64Array) -> Float64Array:
    peak: Float64Array = np.max(np.abs(x), axis=0)
    return peak


def _final(x: Float64Array) -> Float64Array:
    final: Float64Array = x[-1]
    return final


def _is_setpoint(run: Run) -> bool:
    """Whether the reference asks for one position throughout."""
    q, v = getattr(run.reference, "q", None), getattr(run.reference, "v", None)
    return q is not None and not np.any(q != q[0]) and not np.any(v)


def _worst(name: str, steps: list[StepResponse]) -> float:
    values = np.array([getattr(step, name) for step in steps])
    values = values[~np.isnan(values)]
    return float(values[np.argmax(np.abs(values))]) if values.size else np.nan


def _of_torque(run: Run) -> list[tuple[str, Float64Array, float]]:
    """Name, number per joint and number overall of everything about torque."""
    dt = np.diff(run.t)[:, np.newaxis]  # (k - 1, 1) how long each row's torque acted [s]
    duration = float(dt.sum())
    acting = run.tau[:-1]
    largest: Callable[[Float64Array], float] = lambda x: float(np.max(x))  # noqa: E731
    effort = np.sum(acting**2 * dt, axis=0)
    peak = _peak(run.tau)
    # A torque that is constant over the period does the work tau (q_next - q), whatever v does in between.
    energy = np.sum(acting * short_way(np.diff(run.q, axis=0), run.continuous), axis=0)
    chatter = np.sum(np.abs(np.diff(run.tau, axis=0)), axis=0) / duration if duration else np.full(run.n, np.nan)
    out = [
        ("effort", effort, float(effort.sum())),
        ("peak_torque", peak, largest(peak)),
        ("energy", energy, float(energy.sum())),
        ("chatter", chatter, float(chatter.sum())),
    ]
    if "limits" in run.terms:
        cut = run.terms["limits"]
        saturated = cut[:-1] != 0.0
        out += [
            ("saturation_time", np.sum(saturated * dt, axis=0), float(np.sum(saturated.any(axis=1) * dt[:, 0]))),
            ("largest_cut", _peak(cut), largest(_peak(cut))),
        ]
    return out
