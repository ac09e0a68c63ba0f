"""Chunks of a sweep: from the numbers of some samples to their results, wherever that runs.

`runner_of(plan)` makes a runner in any process, and `runner.results(first, count)` gives the same bits in each.
"""

from __future__ import annotations

import functools
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from taut.analysis.sweeps.plan import REF, STATE, Plan, Runs, changed_reference
from taut.base.errors import TautError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.functions import DOUBLE, SINGLE
from taut.codegen.lanes.loop import LANE_ALIVE, LANE_TICKS, LaneLoop, NotInLanes, Rows
from taut.codegen.lanes.loop import Run as LaneRun
from taut.codegen.llvm import Lanes
from taut.codegen.loop import steps_of
from taut.codegen.native import host_lanes
from taut.codegen.program import failure
from taut.control.tasks.feed import ReferenceFeed
from taut.control.trajectories.reference import Hold, Stream
from taut.loop import DT, Loop, ModelPlant
from taut.record.info import Outcome
from taut.record.log.export import column_names
from taut.record.metrics import METRICS
from taut.record.metrics.streams import STREAMS, Streams
from taut.record.run import Run
from taut.runtime.events import Schedule
from taut.runtime.ongoing import FusedRun
from taut.runtime.tape import Tape

CHUNKS: Final = 64  # of a sweep, so that they can be shared
IN_LANES: Final = (64, 1024)  # samples in a chunk, at least and at most
ON_GPU: Final = (32_768, 65_536)  # eight warps on each of 128 processors: as many as their registers hold
ONE_BY_ONE: Final = (1, 16)
BATCH_BYTES: Final = 64e6  # of one thread: what is recorded, or references of samples, at a time
TICKS_AT_ONCE: Final = 4096  # between two looks at whether to stop


class Stopped(Exception):  # noqa: N818  # no error
    """The sweep ends before the chunk does."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """What became of some samples.

    Args:
        table: (count, ...) columns by name: "sample", what was drawn by path, "seed", "outcome", "ticks", metrics.
        rows: (k,) columns of what was recorded, by name, with "sample" and "t".
        messages: Of samples that failed, by number.
    """

    table: dict[str, Any]
    rows: dict[str, Float64Array] = field(default_factory=dict)
    messages: dict[int, str] = field(default_factory=dict)

    @property
    def columns(self) -> dict[str, Any]:
        """The table with the messages."""
        texts = [self.messages.get(k, "") for k in self.table["sample"].tolist()]
        return {**self.table, "message": np.array(texts, dtype=object)}


class Runner(ABC):
    """Runs samples of a plan."""

    size: int
    """Samples in a chunk."""

    @abstractmethod
    def results(self, first: int, count: int, step: Callable[[], None] = lambda: None) -> Results:
        """The results of `count` samples from `first` on; `step` is called now and then, and may raise `Stopped`."""


def runner_of(plan: Plan, loop: Loop | None = None, nominal: Run | None = None) -> Runner:
    """The runner for a plan: in lanes where nothing asks Python between ticks.

    `loop` is one that is compiled, and `nominal` its own run; they are made where they are left out.
    """
    if loop is None and isinstance(plan.subject.plant, ModelPlant):
        loop = plan.subject.loop(plan.subject.ref)
    if loop is not None and loop.engine == "native" and loop.side.task is None and not isinstance(loop.ref, Stream):
        with suppress(NotInLanes):
            return LaneRuns(plan, loop, nominal)
    return SingleRuns(plan)


def _size(plan: Plan, limits: tuple[int, int]) -> int:
    return max(limits[0], min(limits[1], plan.samples // CHUNKS))


def numbers_of(plan: Plan, run: Run) -> dict[str, float]:
    """The metrics and other numbers of a run by column."""
    out = {}
    for column, (metric, joints) in plan.columns.items():
        one = METRICS[metric]
        value = one.of(run)
        out[column] = one.of_joints(run, np.asarray(value), joints) if one.per_joint else float(np.asarray(value))
    return out | {name: figure(run) for name, figure in plan.figures.items()}


def recorded_rows(plan: Plan, sample: int, run: Run) -> dict[str, Float64Array]:
    """What a plan records of a run, one row for each tick that it takes."""
    kept, names, out = run.ticks(slice(None, None, plan.every)), column_names(run), dict[str, Float64Array]()
    for name in ("t", *plan.record):
        flat = kept.arrays()[name].reshape(len(kept), -1)
        out |= {column: flat[:, i] for i, column in enumerate(names[name])}
    return {"sample": np.full(len(kept), sample), **out}


def _table(
    plan: Plan, first: int, drawn: dict[str, Float64Array], outcomes: Any, ticks: Any, metrics: Mapping[str, Any]
) -> dict[str, Any]:
    """The columns of some samples from `first` on."""
    return {
        "sample": np.arange(first, first + len(outcomes)),
        **drawn,
        "seed": plan.seeds(drawn),
        "outcome": np.array(outcomes, dtype=object),
        "ticks": np.asarray(ticks, dtype=np.int64),
        **{name: np.asarray(column, dtype=np.float64) for name, column in metrics.items()},
    }


class LaneRuns(Runner):
    """Samples of a loop of a model plant, side by side in lanes."""

    def __init__(self, plan: Plan, loop: Loop, nominal: Run | None = None) -> None:
        subject = plan.subject
        if nominal is not None:
            self._nominal = nominal
        there = plan.device == "cuda"
        self._plan, self._loop, self.size = plan, loop, _size(plan, ON_GPU if there else IN_LANES)
        schedule = Schedule(self._loop.side, self._loop.plant, self._loop.parameters, (), self._loop.ticks)
        fused = FusedRun(self._loop, subject.q0, subject.v0, 0, schedule)
        self._blocks = inputs, self._parameters, _ = fused.blocks
        summed = not plan.figures and all(metric in STREAMS for metric, _ in plan.columns.values())
        self._recorded = bool(plan.record) or not summed
        self._streams = Streams(self._loop, {} if self._recorded else plan.columns)
        real = SINGLE if plan.real == "float" else DOUBLE
        lanes = Lanes(1, real, thread=True) if there else Lanes(host_lanes(real), real)
        self._code = LaneLoop(
            steps_of(self._loop, *self._blocks), lanes, kept=self._streams.shapes, reduce=self._streams.reduce,
            recorded=self._recorded, run=_gpu_run if there else None,
        )  # fmt: skip
        self._inputs, self._lock = inputs, threading.Lock()
        targets = {each.target for each in plan.varied}
        held = isinstance(self._loop.ref, Hold) and self._loop.ref.sample is None and not targets.isdisjoint(STATE)
        self._own_reference = held or any(target.startswith(REF) for target in targets)
        self._base = self._parameters.pack({**self._loop.parameters, DT: self._loop.dt})
        if plan.record:  # a chunk's rows are in memory together
            each = sum(column.nbytes for column in recorded_rows(plan, 0, self._nominal).values())
            self.size = max(1, min(self.size, int(BATCH_BYTES / each)))

    def results(self, first: int, count: int, step: Callable[[], None] = lambda: None) -> Results:
        code, plan, loop, subject = self._code, self._plan, self._loop, self._plan.subject
        drawn = plan.drawn(first, count)
        values, flat = plan.values(drawn), np.repeat(self._base[np.newaxis], count, axis=0)
        for path, view in self._parameters.views(flat).items():
            if path in values:
                view[...] = values[path]
        at_start = {name: np.repeat(getattr(subject, name)[np.newaxis], count, axis=0) for name in STATE} | values
        states = np.hstack([at_start[name] for name in STATE])
        keys, parameters = code.keys(plan.seeds(drawn)), code.spread(flat)
        memory = code.block(len(parameters), code.memory.size)
        memory[:, : states.shape[1]] = code.spread(states)
        feeds = self._feeds(values, states[:, : loop.plant.arm.n]) if self._own_reference else None
        made: list[tuple[dict[str, float], dict[str, Float64Array]]] = []
        for groups in self._batches(len(parameters)):
            part = keys[groups], parameters[groups], memory[groups]
            some = None if feeds is None else feeds[groups.start * code.lanes.side : groups.stop * code.lanes.side]
            if self._recorded:
                step()
                out = code.block(len(part[1]), code.outputs.size, loop.ticks)
                rows = self._rows(some, 0, loop.ticks)
                code.advance(0, rows, *part, out)
                made += self._runs(first, groups, count, rows, out, memory)
                continue
            for tick in range(0, loop.ticks, self._ticks_at_once(len(part[1]))):
                step()
                ticks = min(self._ticks_at_once(len(part[1])), loop.ticks - tick)
                code.advance(tick, self._rows(some, tick, ticks), *part)
        kept = code.memory.views(code.gathered(memory, count))
        metrics: Mapping[str, Any] = self._streams.values(kept, kept[LANE_TICKS])
        if self._recorded:
            metrics = {name: np.array([numbers[name] for numbers, _ in made]) for name in plan.numbers}
        ended = np.array(["diverged", "completed"], dtype=object)[(kept[LANE_ALIVE] == 1.0).astype(int)]
        table = _table(plan, first, drawn, ended, kept[LANE_TICKS], metrics)
        return Results(table=table, rows=_joined([rows for _, rows in made] if plan.record else []))

    def _ticks_at_once(self, groups: int) -> int:
        each = self._inputs.size * self._code.lanes.side * 8.0 * groups
        return max(1, min(TICKS_AT_ONCE, int(BATCH_BYTES / each))) if self._own_reference else TICKS_AT_ONCE

    def _batches(self, groups: int) -> Iterator[slice]:
        """Groups whose records are in memory together."""
        each = self._code.outputs.size * self._code.lanes.side * 8.0 * self._loop.ticks
        many = max(1, int(BATCH_BYTES / each)) if self._recorded else groups
        return (slice(k, min(k + many, groups)) for k in range(0, groups, many))

    def _feeds(self, values: Mapping[str, Float64Array], q: Float64Array) -> list[ReferenceFeed]:
        """The feed of each sample's own reference, one for each lane of all groups."""
        side, out = self._loop.side, []
        for i in range(len(q)):
            ref = changed_reference(self._loop.ref, {path: x[i] for path, x in values.items()})
            out.append(ReferenceFeed(ref, side.law.reference, side.arm, side.dt, side.at_rest(q[i])))
        return out + [out[-1]] * (-len(out) % self._code.lanes.side)

    def _rows(self, feeds: list[ReferenceFeed] | None, first: int, ticks: int) -> Rows:
        """Inputs of some ticks but noise: (ticks, size), or (groups, ticks, size, lanes) of own feeds."""
        if feeds is None:
            with self._lock:
                return self._shared(first, ticks)
        w, size = self._code.lanes.side, self._code.row_size
        rows = np.array([self._filled(feed, first, ticks) for feed in feeds])
        out = self._code.block(len(feeds) // w, size, ticks)
        out[...] = rows.reshape(-1, w, ticks, size).transpose(0, 2, 3, 1)
        return out

    @functools.cached_property
    def _shared(self) -> Callable[[int, int], Rows]:
        side, ref = self._loop.side, self._loop.ref
        feed = ReferenceFeed(ref, side.law.reference, side.arm, side.dt, side.at_rest(self._plan.subject.q0))
        real = self._code.lanes.real.dtype

        def rows(first: int, ticks: int) -> Rows:
            return np.ascontiguousarray(self._filled(feed, first, ticks), dtype=real)

        return functools.lru_cache(maxsize=16)(rows)

    def _filled(self, feed: ReferenceFeed, first: int, ticks: int) -> Float64Array:
        """Inputs of some ticks, with what a feed gives."""
        rows = np.zeros((ticks, self._inputs.size))
        views = self._inputs.views(rows)
        views["t"][...] = np.arange(first, first + ticks) * self._loop.dt
        done = 0
        while done < ticks:  # a reference that fails in a later tick raises when it is asked for that one
            part = {name: view[done:] for name, view in subtree(views, "ref").items()}
            done += feed.fill(part, first + done, lambda: None)
        return rows[:, : self._code.row_size]

    # ---------------------------------------------------------------- whole runs

    @functools.cached_property
    def _nominal(self) -> Run:
        return Runs(self._plan).run({}, 0)

    def _runs(
        self, first: int, groups: slice, count: int, rows: Rows, out: Rows, memory: Rows
    ) -> Iterator[tuple[dict[str, float], dict[str, Float64Array]]]:
        """Metrics and recorded rows of each sample in some groups."""
        code, w = self._code, self._code.lanes.side
        start = groups.start * w
        many = min(groups.stop * w, count) - start
        ends = code.memory.views(code.gathered(memory[groups], many))
        for i in range(many):
            own = rows if rows.ndim == 2 else rows[i // w, :, :, i % w]
            alive, ticks = ends[LANE_ALIVE][i] == 1.0, int(ends[LANE_TICKS][i])
            tape = Tape(self._loop.side, self._loop.plant, self._loop.ticks, self._inputs, code.outputs)
            tape.input_rows[:, : code.row_size] = own
            tape.output_rows[...] = out[i // w, :, :, i % w]
            tape.info = self._nominal.info
            outcome = Outcome(kind="completed" if alive else "diverged", message="", tick=ticks - 1)
            run = tape.piece(0, ticks, outcome)
            yield numbers_of(self._plan, run), recorded_rows(self._plan, first + start + i, run)


def _gpu_run(code: LaneLoop) -> LaneRun:
    from taut.codegen.cuda import GpuLoop

    return GpuLoop(code)


def _joined(parts: list[dict[str, Float64Array]]) -> dict[str, Float64Array]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}


class SingleRuns(Runner):
    """Samples one by one, by `taut.run`."""

    def __init__(self, plan: Plan) -> None:
        self._plan, self._runs, self.size = plan, Runs(plan), _size(plan, ONE_BY_ONE)

    def results(self, first: int, count: int, step: Callable[[], None] = lambda: None) -> Results:
        plan, drawn = self._plan, self._plan.drawn(first, count)
        values, seeds = plan.values(drawn), plan.seeds(drawn)
        outcomes, ticks, messages, rows = list[str](), list[int](), dict[int, str](), list[dict[str, Float64Array]]()
        metrics: dict[str, list[float]] = {name: [] for name in plan.numbers}
        for i in range(count):
            step()
            numbers = dict.fromkeys(plan.numbers, np.nan)
            try:
                run = self._runs.run({path: x[i] for path, x in values.items()}, int(seeds[i]))
            except Exception as error:
                outcomes.append("failed")
                ticks.append(0)
                messages[first + i] = str(error) if isinstance(error, TautError) else failure(error)
            else:
                numbers = numbers_of(plan, run)
                outcomes.append(run.outcome.kind)
                ticks.append(len(run))
                if plan.record:
                    rows.append(recorded_rows(plan, first + i, run))
                if not run.outcome.ok:
                    messages[first + i] = run.outcome.message
            for name, value in numbers.items():
                metrics[name].append(value)
        table = _table(plan, first, drawn, outcomes, ticks, metrics)
        return Results(table=table, rows=_joined(rows), messages=messages)


def failed_results(plan: Plan, first: int, count: int, message: str) -> Results:
    """The results of samples of which none is known but why."""
    nothing = {name: np.full(count, np.nan) for name in plan.numbers}
    table = _table(plan, first, plan.drawn(first, count), ["failed"] * count, np.zeros(count), nothing)
    return Results(table=table, messages=dict.fromkeys(range(first, first + count), message))
