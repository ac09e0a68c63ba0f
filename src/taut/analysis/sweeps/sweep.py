"""taut.sweep: many runs of one closed loop over gains, models, states, references and noise, and their figures."""

from __future__ import annotations

import dataclasses
import os
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taut.analysis.sweeps.chunks import LaneRuns, Runner, runner_of
from taut.analysis.sweeps.plan import Plan, Runs, Subject, Variation
from taut.analysis.sweeps.store import Memory, Store
from taut.analysis.sweeps.workers import cores, run_chunks
from taut.base.checks import one_of, whole_number
from taut.base.errors import RangeError, UsageError, count_of, unknown_name
from taut.base.paths import Named
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.tasks.phase import Phase
from taut.controller import Controller
from taut.loop import Loop
from taut.record.metrics import METRICS
from taut.record.metrics.streams import STREAMS, columns_of
from taut.record.progress import Progress
from taut.record.run import Run
from taut.runtime.simulate import Plant, run, what_to_run

USUAL: Final = (
    "rms_error",
    "peak_error",
    "final_error",
    "task_rms",
    "task_peak",
    "task_final",
    "peak_torque",
    "effort",
)
PERCENTILES: Final = (5.0, 50.0, 95.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep(Result):
    """What `taut.sweep` found. Print it for the percentiles of each metric.

    Args:
        plan: What was varied, and what was kept.
        samples: Number of samples that are done.
        complete: Whether all are; not where Ctrl-C ended it.
        tables: Where their columns are.
    """

    plan: Plan
    samples: int
    complete: bool
    tables: Memory | Store

    @cached_property
    def table(self) -> Named[NDArray[Any]]:
        """Columns by name, one row for each sample that is done, in their order.

        "sample"; what was varied, by path; "seed" of its noise; "outcome": completed, diverged, stopped or failed;
        "ticks" that ended in finite numbers; the metrics, NaN where a run failed, up to there where it diverged.
        """
        return Named("the sweep", "column", {k: column for k, column in self._columns.items() if k != "message"})

    @cached_property
    def messages(self) -> dict[int, str]:
        """Why samples did not come to their end, by number, where their runs say it."""
        if not self._columns:
            return {}
        said = np.flatnonzero(self._columns["message"] != "")
        return {int(self._columns["sample"][i]): str(self._columns["message"][i]) for i in said}

    @cached_property
    def _columns(self) -> dict[str, Any]:
        return self.tables.table()

    @property
    def completed(self) -> NDArray[np.bool_]:
        """(samples,) whether each run came to its end."""
        return np.asarray(self.table["outcome"] == "completed")

    def run(self, sample: int) -> Run:
        """The run of a sample once more, everything recorded: the same bits, where the sweep was in doubles."""
        number = whole_number("sample", sample, maximum=self.plan.samples - 1)
        drawn = self.plan.drawn(number, 1)
        values = {path: value[0] for path, value in self.plan.values(drawn).items()}
        return self._runs.run(values, int(self.plan.seeds(drawn)[0]))

    @cached_property
    def _runs(self) -> Runs:
        return Runs(self.plan)

    def content(self) -> Content:
        """Percentiles of each metric over the runs that came to their end, and the worst with its sample."""
        rows: list[Sequence[Cell]] = []
        done = self.completed if self.samples else np.zeros(0, dtype=bool)
        for column, (metric, _) in self.plan.columns.items():
            values: Float64Array = np.where(done, self.table[column], np.nan) if self.samples else np.zeros(0)
            if np.isfinite(values).any():
                worst = int(np.nanargmax(np.abs(values)))
                numbers = np.nanpercentile(values, PERCENTILES).tolist()
                rows.append((METRICS[metric].title, *numbers, float(values[worst]), int(self.table["sample"][worst])))
        ended = [f"{(self.table['outcome'] == kind).sum()} {kind}" for kind in self._kinds]
        heads = ("metric", *(f"{percent:g} %" for percent in PERCENTILES), "worst", "sample")
        return Content(
            title=f"sweep of {', '.join(each.path for each in self.plan.varied) or 'noise'}",
            faults=[] if self.complete else [f"interrupted after {self.samples} of {self.plan.samples} samples"],
            summary=[f"{count_of(self.samples, 'sample')}: {', '.join(ended)}"],
            tables=[Table(title="metrics of the runs that came to their end", columns=heads, rows=rows)],
        )

    @property
    def _kinds(self) -> list[str]:
        return sorted(set(self.table["outcome"].tolist())) if self.samples else []


def sweep(
    loop: Loop | Controller | Sequence[Phase],
    vary: Mapping[str, Variation],
    plant: Plant | None = None,
    ref: object = None,
    *,
    samples: int,
    seed: int = 0,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    metrics: Sequence[str] | None = None,
    record: Sequence[str] = (),
    every: int = 1,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    real: Literal["double", "float"] = "double",
    progress: bool | None = None,
) -> Sweep:
    """Many runs of one closed loop, each with its own values of what is varied and its own noise.

    A loop of a model plant is compiled once and runs in the lanes of the processor and in threads: some ten million
    steps a second and core. A loop with a plant of another kind, such as MuJoCo, a task and a stream with a source
    run one by one, each worker in a process of its own. Results depend on the seed alone: not on the number of
    workers, of lanes, or on the order in which chunks are done. Ctrl-C ends the sweep with what is done.

    Args:
        loop: What `taut.run` takes: a `taut.Loop`; or a controller or a task, with plant, ref and duration.
        vary: By path, a distribution such as `taut.uniform(0, 3)`, or a value for each sample. Paths are those of
            `loop.parameters`; "q0" and "v0"; "ref.amplitude" and other numbers of the reference; "seed" of the noise,
            which is another one in each sample if left out. "law.kp[2]" is one entry.
        plant: As in `taut.run`.
        ref: As in `taut.run`.
        samples: Number of runs.
        seed: Of all that is drawn.
        duration: [s], as in `taut.run`.
        q0: (n,) where runs start [rad | m]; home if left out.
        v0: (n,) [rad/s | m/s]; zero if left out.
        metrics: Names of `taut.analysis.METRICS`, your own too. Some, such as those of the default, are summed up
            while a run goes on; any other takes whole runs in memory, a few at a time.
        record: What is kept of every run besides, of `run.arrays()`: ("q", "tau"). It needs `out`.
        every: Tick of which that is kept.
        out: Folder for a Parquet file of each chunk. A sweep that was interrupted goes on where it stopped.
        workers: Threads or processes; as many as there are cores if left out. 1 needs no other process.
        real: "float" runs twice as many lanes in single precision, with its rounding.
        progress: As in `taut.run`.

    Returns:
        The table of samples; `sweep.run(i)` runs one of them again, with everything recorded.

    Raises:
        UnknownNameError: No such path, metric or column.
        RangeError, ShapeError, UsageError: Values that the loop refuses, before the first run.
        FileError, MissingExtraError: A folder that holds another sweep, or cannot be used; no pyarrow.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=5.0, kd=2.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.5]), duration=1.0)
        >>> found = taut.sweep(loop, {"plant.payload.mass": taut.uniform(0.0, 0.5)}, samples=100)
        >>> heavy = found.table["plant.payload.mass"] > 0.4
        >>> bool(found.table["rms_error"][heavy].min() > found.table["rms_error"][~heavy].min())
        True
    """
    made, target, reference, length = what_to_run(loop, plant, ref, duration)
    plan = Plan.of(Subject.of(made, target, reference, length, q0, v0), vary, samples, seed)
    given = None if isinstance(made, Loop) else (target, None if made.side.task is not None else reference)
    nominal = run(made, *(given or ()), duration=None if given is None else length, q0=q0, v0=v0, progress=False)
    plan = _kept(plan, nominal, metrics, record, every, real)
    if plan.record and out is None:
        raise UsageError("record keeps what runs record in files; give out='a folder'", name="out")
    runner = runner_of(plan, made if isinstance(made, Loop) else None, nominal)
    threads = cores() if workers is None else whole_number("workers", workers, minimum=1)
    alone = isinstance(runner, LaneRuns) or threads == 1
    if not alone:
        _require_pickle(plan)
    if real == "float" and not isinstance(runner, LaneRuns):
        raise UsageError("real='float' is for loops that run in lanes, with a model plant", name="real")
    return _swept(plan, runner, runner if alone else None, threads, out, progress)


def _swept(
    plan: Plan,
    runner: Runner,
    shared: Runner | None,
    threads: int,
    out: str | os.PathLike[str] | None,
    progress: bool | None,
) -> Sweep:
    """Run all chunks that are not done."""
    size, complete = runner.size, True
    store = Memory(plan.samples) if out is None else Store(out, plan, size)
    chunks = [(first, min(size, plan.samples - first)) for first in range(0, plan.samples, size)]
    left = [chunk for chunk in chunks if not store.has(chunk[0])]
    done = plan.samples - sum(count for _, count in left)
    with Progress(plan.samples, progress, "sweeping") as bar:
        bar.advance(done)
        try:
            for results in run_chunks(plan, shared, left, min(threads, max(1, len(left)))):
                store.write(results)
                done += len(results.table["sample"])
                bar.advance(len(results.table["sample"]))
        except KeyboardInterrupt:
            complete = done == plan.samples
    return Sweep(plan=plan, samples=done, complete=complete, tables=store)


def _kept(
    plan: Plan, nominal: Run, metrics: Sequence[str] | None, record: Sequence[str], every: int, real: str
) -> Plan:
    """The plan with what is kept of each run: metrics that have a meaning in the loop's own run, by default."""
    one_of("real", real, ("double", "float"))
    if isinstance(metrics, str) or isinstance(record, str):
        raise UsageError("metrics and record are lists of names, such as ['rms_error']", name="metrics")
    for name in metrics or ():
        if name not in METRICS:
            raise unknown_name("a run", "metric", name, METRICS)
    for name in record:
        if name not in nominal.arrays():
            raise unknown_name("the run", "column", name, nominal.arrays())
    known = [name for name in STREAMS if _has(nominal, name)]
    names = [name for name in USUAL if name in known] if metrics is None else list(metrics)
    for name in names:
        if name in STREAMS and name not in known:
            raise RangeError(f"metric '{name}' has no meaning in this loop's own run; leave it out", name=name)
    return dataclasses.replace(
        plan, columns=columns_of(nominal, names), record=tuple(record), every=whole_number("every", every, minimum=1),
        real=real,
    )  # fmt: skip


def _has(nominal: Run, name: str) -> bool:
    return not np.isnan(np.asarray(METRICS[name].of(nominal))).all()


def _require_pickle(plan: Plan) -> None:
    try:
        pickle.dumps(plan)
    except Exception as cause:
        raise UsageError(
            f"the loop cannot be sent to other processes: {cause}; workers=1 runs it in this one, and what a "
            "module of its own defines can be sent",
            name="loop",
        ) from cause
