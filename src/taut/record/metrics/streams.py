"""Metrics as sums and maxima that are kept while a run goes on, so that its ticks need not be: for sweeps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.limits import LIMIT_TERMS
from taut.control.trajectories.task_reference import TaskMotion
from taut.loop import DT, Loop
from taut.maths import dynamics as dyn
from taut.maths.spatial import rotation_log
from taut.record.metrics.declaration import METRICS
from taut.record.run import Run
from taut.trace import math as tm

Values: TypeAlias = Mapping[str, Any]
Kind: TypeAlias = Literal["rms", "peak", "last", "integral", "variation"]
KEPT: Final[Mapping[Kind, tuple[str, ...]]] = {
    "rms": ("sum",),
    "peak": ("peak",),
    "last": ("last",),
    "integral": ("sum", "before"),
    "variation": ("sum", "before"),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Tick:
    """A tick of a loop while it is traced."""

    loop: Loop
    record: Values
    reference: Any  # the sample

    @cached_property
    def error(self) -> Any:
        """(n,) tracking error; None where the reference is none of joints."""
        wanted = getattr(self.reference, "q", None)
        return None if wanted is None else self.loop.plant.arm.difference(wanted, self.record["q"])

    @cached_property
    def pose(self) -> Any:
        """Of the frame that the law controls, by the controller's model."""
        side = self.loop.side
        return dyn.pose(side.model, self.record["q"], side.law.controlled_frame)

    @cached_property
    def motion(self) -> Any:
        """The motion of the task that is asked for; None where there is none."""
        motion = self.reference.motion
        return motion if isinstance(motion, TaskMotion) else None


Numbers: TypeAlias = Callable[[Tick, list[int]], Any]
"""(m,) numbers of a tick, of some joints where they are of joints; None where they have no meaning."""


def _position(tick: Tick, _: list[int]) -> Any:
    return None if tick.motion is None else tick.motion.p - tick.pose.p


def _rotation(tick: Tick, _: list[int]) -> Any:
    return None if tick.motion is None else rotation_log(tick.motion.R @ tick.pose.R.T)


def _error(tick: Tick, joints: list[int]) -> Any:
    return None if tick.error is None else tick.error[joints]


def _of_limit(column: str, limit: str) -> Numbers:
    def numbers(tick: Tick, joints: list[int]) -> Any:
        limits = np.asarray(getattr(tick.loop.side.arm, limit))
        known = [i for i in joints if np.isfinite(limits[i])]
        return 100.0 * tick.record[column][known] / limits[known] if known else None

    return numbers


def _limited(tick: Tick, joints: list[int]) -> Any:
    terms = [tick.record[path] for name in LIMIT_TERMS if (path := f"terms.{name}") in tick.record]
    if not terms:
        return None
    return tm.array([tm.where(sum(abs(term[i]) for term in terms for i in joints) > 0.0, 1.0, 0.0)])


def _normed(numbers: Numbers) -> Numbers:
    def norm(tick: Tick, joints: list[int]) -> Any:
        found = numbers(tick, joints)
        return None if found is None else tm.array([tm.norm(found)])

    return norm


def _place(axis: int) -> Numbers:
    return lambda tick, _: tick.pose.p[axis : axis + 1]


STREAMS: Final[Mapping[str, tuple[Kind, Numbers]]] = {
    "rms_error": ("rms", _error),
    "peak_error": ("peak", _normed(_error)),
    "final_error": ("last", _normed(_error)),
    "task_rms": ("rms", _position),
    "task_peak": ("peak", _normed(_position)),
    "task_final": ("last", _normed(_position)),
    "task_rms_rotation": ("rms", _rotation),
    "task_peak_rotation": ("peak", _normed(_rotation)),
    **{f"final_{name}": ("last", _place(axis)) for axis, name in enumerate("xyz")},
    "effort": ("integral", lambda tick, joints: tick.record["tau"][joints] ** 2),
    "peak_torque": ("peak", lambda tick, joints: tick.record["tau"][joints]),
    "torque_use": ("peak", _of_limit("tau", "effort")),
    "speed_use": ("peak", _of_limit("v", "velocity")),
    "saturation_time": ("integral", _limited),
    "chatter": ("variation", lambda tick, joints: tick.record["tau"][joints]),
}
"""By the name of the metric: how its numbers in each tick make one number of the run."""


class Streams:
    """Metrics of a loop as what is kept from tick to tick; a column for each metric, and unit where it has several.

    Args:
        loop: The loop.
        columns: By name: the metric, and the joints whose numbers it has.
    """

    def __init__(self, loop: Loop, columns: Mapping[str, tuple[str, Sequence[int]]]) -> None:
        self._loop = loop
        self._columns = {name: (metric, list(joints)) for name, (metric, joints) in columns.items()}

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of what is kept, by path."""
        return {
            f"{name}:{part}": (len(joints),) if self._kind(name) == "variation" and part == "before" else ()
            for name, (_, joints) in self._columns.items()
            for part in KEPT[self._kind(name)]
        }

    def _kind(self, column: str) -> Kind:
        return STREAMS[self._columns[column][0]][0]

    def reduce(self, inputs: Values, parameters: Values, record: Values, kept: Values) -> dict[str, Any]:
        """What is kept after a tick."""
        sample = self._loop.side.law.reference.of(subtree(inputs, "ref"))
        tick, out = Tick(loop=self._loop, record=record, reference=sample), dict[str, Any]()
        first = inputs["t"] < 0.5 * parameters[DT]
        for name, (metric, joints) in self._columns.items():
            kind, numbers = STREAMS[metric]
            x, before = numbers(tick, joints), {part: kept[f"{name}:{part}"] for part in KEPT[kind]}
            assert x is not None, f"{metric} has no meaning here"
            out |= {f"{name}:{part}": value for part, value in _after(kind, x, before, first).items()}
        return out

    def values(self, kept: Mapping[str, Float64Array], ticks: Float64Array) -> dict[str, Float64Array]:
        """(k,) each metric by column, of (k, ...) what was kept; NaN of a run without a tick."""
        dt, out = self._loop.dt, dict[str, Float64Array]()
        with np.errstate(divide="ignore", invalid="ignore"):
            for name in self._columns:
                kind = self._kind(name)
                value = kept[f"{name}:{KEPT[kind][0]}"]
                if kind == "rms":
                    value = np.sqrt(value / ticks)
                elif kind == "integral":
                    value = value * dt
                elif kind == "variation":
                    value = value / ((ticks - 1.0) * dt)
                out[name] = np.where(ticks > 0.0, value, np.nan)
        return out


def _after(kind: Kind, x: Any, kept: Values, first: Any) -> dict[str, Any]:
    if kind == "rms":
        return {"sum": kept["sum"] + x @ x}
    if kind == "peak":
        peak = kept["peak"]
        for each in x:
            peak = tm.maximum(peak, abs(each))
        return {"peak": peak}
    if kind == "last":
        return {"last": x[0]}
    if kind == "integral":  # what acts in the last tick, acts after the run
        return {"sum": kept["sum"] + kept["before"], "before": sum(x)}
    change = sum(abs(a - b) for a, b in zip(x, kept["before"], strict=True))
    return {"sum": kept["sum"] + tm.where(first, 0.0, change), "before": x}


def columns_of(run: Run, names: Sequence[str]) -> dict[str, tuple[str, list[int]]]:
    """Columns of metrics by the units that they have in a run: "rms_error", or "rms_error [m]" and another."""
    out: dict[str, tuple[str, list[int]]] = {}
    for name in names:
        units = METRICS[name].units_of(run)
        several = len(set(units)) > 1
        for unit in dict.fromkeys(units):
            joints = [i for i in range(run.n) if not METRICS[name].per_joint or units[i] == unit]
            out[f"{name} [{unit}]" if several else name] = (name, joints)
    return out
