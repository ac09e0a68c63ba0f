"""taut.sweep: many runs of one closed loop over gains, models, states, references and noise, and their figures."""

from __future__ import annotations

import dataclasses
import os
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from taut.analysis.sweeps.answers import (
    BARS,
    PANELS,
    PERCENTILES,
    Bands,
    Rate,
    Share,
    bands_of,
    drawn_bands,
    drawn_shares,
    rate_of,
    shares_of,
)
from taut.analysis.sweeps.chunks import LaneRuns, Results, runner_of
from taut.analysis.sweeps.cluster import check_ray, run_on_ray
from taut.analysis.sweeps.plan import SEED, Plan, Runs, Subject, Variation, changed_reference
from taut.analysis.sweeps.store import Memory, Store
from taut.analysis.sweeps.workers import Chunk, run_chunks
from taut.base.checks import one_of, whole_number
from taut.base.errors import RangeError, UsageError, count_of, unknown_name
from taut.base.paths import Named
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.native import cores
from taut.control.tasks.phase import Phase
from taut.controller import Controller
from taut.loop import Loop, ModelPlant
from taut.record.metrics import METRICS
from taut.record.metrics.streams import STREAMS, columns_of
from taut.record.progress import Progress
from taut.record.run import Run
from taut.runtime.simulate import Plant, run, what_to_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
SUCCESS: Final = "success"
SHARE_NOTE: Final = (
    "share: of the variance of ranks, what one parameter alone explains, +- of 95 %, if parameters were drawn "
    "independently; the rest is due to joint effects and noise"
)
Bounds: TypeAlias = Mapping[str, tuple[float, float]]
"""Smallest and largest value that a number may have, by its column."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep(Result):
    """What `taut.sweep` found. Print it for success, percentiles, what matters most, and the worst case.

    Args:
        plan: What was varied, and what was kept.
        samples: Number of samples that are done.
        complete: Whether all are; not where Ctrl-C ended it.
        tables: Where their columns are.
        bounds: Within which the numbers of a run that succeeds are; `dataclasses.replace(found, bounds={...})` judges
            the same samples by others.
    """

    plan: Plan
    samples: int
    complete: bool
    tables: Memory | Store
    bounds: Bounds = field(default_factory=dict)

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

    @cached_property
    def succeeded(self) -> NDArray[np.bool_]:
        """(samples,) whether each run came to its end with its numbers within bounds."""
        good = self.completed.copy()
        for name, (low, high) in self.bounds.items():
            good &= (self.table[name] >= low) & (self.table[name] <= high)
        return good

    @property
    def success(self) -> Rate:
        """The fraction of runs that succeed, with its interval."""
        return rate_of(self.succeeded)

    @cached_property
    def inputs(self) -> dict[str, Float64Array]:
        """(samples,) each number that was varied, by path: "law.kp", "q0[1]"."""
        out: dict[str, Float64Array] = {}
        for each in self.plan.varied:
            if each.path != SEED:
                flat = np.reshape(self.table[each.path], (self.samples, -1))
                names = [f"{each.path}[{i}]" for i in range(flat.shape[1])] if each.shape else [each.path]
                out |= dict(zip(names, np.asarray(flat, dtype=np.float64).T, strict=True))
        return out

    def bands(self, number: str, path: str) -> Bands:
        """Percentiles of a number, of the runs that came to their end, over a varied one of `inputs`."""
        return bands_of(Named("the sweep", "number", self.inputs)[path], self._values(number))

    def shares(self, number: str = SUCCESS) -> tuple[Share, ...]:
        """Which parameter matters most for a number, or for success: the largest share first.

        Empty where all samples are alike, and of less than 40 samples. See `taut.analysis.Share` for what a share is;
        it assumes that parameters were drawn independently, as distributions are.
        """
        return shares_of(self.inputs, self._values(number))

    def _values(self, number: str) -> Float64Array:
        if number == SUCCESS:
            return self.succeeded.astype(np.float64)
        if number not in self.plan.numbers:
            raise unknown_name("the sweep", "number", number, (SUCCESS, *self.plan.numbers))
        return np.where(self.completed, self.table[number], np.nan)

    @property
    def worst(self) -> int | None:
        """The worst sample: of runs that did not come to their end the shortest, else that of the first number.

        That has the largest number without its sign, or the smallest where success has only a lower bound for it.
        """
        if not self.completed.all():
            return int(self.table["sample"][np.argmin(np.where(self.completed, np.inf, self.table["ticks"]))])
        for name in self.plan.numbers:
            return self._worst_of(name)
        return None

    def _worst_of(self, number: str) -> int | None:
        values, (low, high) = self._values(number), self.bounds.get(number, (-np.inf, np.inf))
        size = -values if high == np.inf and low > -np.inf else np.abs(values)
        return int(self.table["sample"][np.nanargmax(size)]) if np.isfinite(size).any() else None

    def loop(self, sample: int) -> Loop:
        """The loop of a sample of a model plant, with its parameters and reference, as `taut.tune` takes several."""
        if not isinstance(self.plan.subject.plant, ModelPlant):
            raise UsageError("loops of samples are those of a model plant, such as taut.RigidPlant", name="plant")
        values = self._of(sample)
        loop = self.plan.subject.loop(changed_reference(self.plan.subject.ref, values))
        loop.parameters.update({path: x for path, x in values.items() if path in self.plan.subject.parameters})
        return loop

    def _of(self, sample: int) -> dict[str, Float64Array]:
        """The values of what is varied, by target."""
        number = whole_number("sample", sample, maximum=self.plan.samples - 1)
        return {path: value[0] for path, value in self.plan.values(self.plan.drawn(number, 1)).items()}

    def run(self, sample: int) -> Run:
        """The run of a sample once more, everything recorded: the same bits, where the sweep was in doubles."""
        return self._runs.run(self._of(sample), int(self.plan.seeds(self.plan.drawn(sample, 1))[0]))

    @cached_property
    def _runs(self) -> Runs:
        return Runs(self.plan)

    def content(self) -> Content:
        """Success, percentiles of each number over the runs that came to their end, what matters most, the worst."""
        title = f"sweep of {', '.join(each.path for each in self.plan.varied) or 'noise'}"
        faults = [] if self.complete else [f"interrupted after {self.samples} of {self.plan.samples} samples"]
        if not self.samples:
            return Content(title=title, faults=faults)
        ended = [f"{(self.table['outcome'] == kind).sum()} {kind}" for kind in self._kinds]
        rules = ["completed", *(f"{name} {_rule(*ends)}" for name, ends in self.bounds.items())]
        judged = f"success: {self.success}: {', '.join(rules)}"
        if not self.bounds:
            judged = f"completed: {self.success}; no criteria of success were given"
        summary = [f"{count_of(self.samples, 'sample')}: {', '.join(ended)}", judged]
        if self.worst is not None:
            summary.append(f"worst case: sample {self.worst}; .run({self.worst}) runs it again, to the last bit")
        rows: list[Sequence[Cell]] = []
        for name in self.plan.numbers:
            worst, values = self._worst_of(name), self._values(name)
            if worst is not None:
                numbers = np.nanpercentile(values, PERCENTILES).tolist()
                rows.append((self._title(name), *numbers, values[self.table["sample"] == worst].item(), worst))
        heads = ("metric", *(f"{percent:g} %" for percent in PERCENTILES), "worst", "sample")
        tables = [Table(title="metrics of the runs that came to their end", columns=heads, rows=rows)]
        matter = [(name, *dataclasses.astuple(one)) for name, each in self._matters.items() for one in each[:BARS]]
        if matter:
            heads = ("of", "parameter", "share", "+-", "correlation")
            tables.append(Table(title="which parameter matters most", columns=heads, rows=matter, note=SHARE_NOTE))
        return Content(title=title, faults=faults, summary=summary, tables=tables, figures=self._figures())

    @cached_property
    def _matters(self) -> dict[str, tuple[Share, ...]]:
        """Shares of success and of the first number, by title; without those that have none."""
        both = {SUCCESS: self.shares()} | {self._title(name): self.shares(name) for name in self.plan.numbers[:1]}
        return {name: each for name, each in both.items() if each}

    def _figures(self) -> dict[str, Callable[[], Figure]]:
        if not self._matters:
            return {}
        ranked = dict.fromkeys(one.path for each in reversed(self._matters.values()) for one in each)
        shown, name = {path: self.inputs[path] for path in list(ranked)[:PANELS]}, self.plan.numbers[:1]
        shares = {title: each[:BARS] for title, each in self._matters.items()}
        figures: dict[str, Callable[[], Figure]] = {"shares": partial(drawn_shares, shares)}
        if name:
            bands = partial(drawn_bands, shown, self._title(name[0]), self._values(name[0]), self.succeeded)
            figures = {"bands": bands, **figures}
        return figures

    def _title(self, name: str) -> str:
        """What a number is called, with its unit where it is a metric's."""
        metric = self.plan.columns[name][0] if name in self.plan.columns else ""
        title = name.partition(" [")[0].replace(metric, METRICS[metric].title, 1) if metric else name
        return f"{title} [{self.plan.units[name]}]" if name in self.plan.units else title

    @property
    def _kinds(self) -> list[str]:
        return sorted(set(self.table["outcome"].tolist())) if self.samples else []


def _rule(low: float, high: float) -> str:
    """Bounds in words."""
    return (
        f"from {low:g} to {high:g}"
        if np.isfinite([low, high]).all()
        else f">= {low:g}"
        if np.isfinite(low)
        else f"<= {high:g}"
    )


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
    success: Bounds | None = None,
    record: Sequence[str] = (),
    every: int = 1,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    ray: str | None = None,
    real: Literal["double", "float"] = "double",
    device: Literal["cpu", "cuda"] = "cpu",
    progress: bool | None = None,
) -> Sweep:
    """Many runs of one closed loop, each with its own values of what is varied and its own noise.

    A loop of a model plant is compiled once and runs in the lanes of the processor and in threads: seven to eight
    million steps a second and core for a Panda. A loop with a plant of another kind, such as MuJoCo, a task and a
    stream with a source run one by one, each in a process of its own. Results depend on the seed alone: not on the
    number of workers, of lanes, or on the order in which chunks are done. Ctrl-C ends the sweep with what is done.
    With `ray` the same chunks run on a cluster.

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
        success: By metric, the smallest and the largest value of a run that succeeds: {"peak_error": (0.0, 0.03)}; a
            run that does not come to its end never does.
        record: What is kept of every run besides, of `run.arrays()`: ("q", "tau"). It needs `out`.
        every: Tick of which that is kept.
        out: Folder for a Parquet file of each chunk. A sweep that was interrupted goes on where it stopped.
        workers: Threads or processes; as many as there are cores if left out. 1 needs no other process. With `ray`,
            chunks in flight at most.
        ray: A Ray cluster that runs already: "auto" for the one of this machine, "HOST:PORT" or "ray://HOST:PORT".
        real: "float" runs twice as many lanes in single precision, with its rounding.
        device: "cuda" runs a loop of a model plant in each thread of the first GPU of this machine.
        progress: As in `taut.run`.

    Returns:
        The table of samples, with success rate, percentiles, which parameter matters most and the worst case;
        `sweep.run(i)` runs one of them again, with everything recorded.

    Raises:
        UnknownNameError: No such path, metric or column.
        RangeError, ShapeError, UsageError: Values that the loop refuses, before the first run.
        FileError, MissingExtraError: A folder that holds another sweep, or cannot be used; no pyarrow, no Ray.
        ClusterError: A cluster that does not answer, has no worker that can run the loop, or is lost.

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
    return sweep_with(
        {}, loop, vary, plant, ref, samples=samples, seed=seed, duration=duration, q0=q0, v0=v0, metrics=metrics,
        success=success, record=record, every=every, out=out, workers=workers, ray=ray, real=real, device=device,
        progress=progress,
    )  # fmt: skip


def sweep_with(
    figures: Mapping[str, Callable[[Run], float]],
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
    success: Bounds | None = None,
    record: Sequence[str] = (),
    every: int = 1,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    ray: str | None = None,
    real: Literal["double", "float"] = "double",
    device: Literal["cpu", "cuda"] = "cpu",
    progress: bool | None = None,
) -> Sweep:
    """`sweep`, which keeps other numbers of each run too: functions of whole runs, by name."""
    one_of("device", device, ("cpu", "cuda"))
    if device == "cuda" and ray is not None:
        raise UsageError("device='cuda' is the GPU of this machine; leave out ray", name="device")
    if ray is not None:
        check_ray(ray)
    made, target, reference, length = what_to_run(loop, plant, ref, duration)
    plan = Plan.of(Subject.of(made, target, reference, length, q0, v0), vary, samples, seed)
    given = None if isinstance(made, Loop) else (target, None if made.side.task is not None else reference)
    nominal = run(made, *(given or ()), duration=None if given is None else length, q0=q0, v0=v0, progress=False)
    bounds = _bounds(success or {})
    plan = dataclasses.replace(plan, figures=figures, device=device)
    plan = _kept(plan, nominal, metrics, bounds, record, every, real)
    if plan.record and out is None:
        raise UsageError("record keeps what runs record in files; give out='a folder'", name="out")
    runner = runner_of(plan, made if isinstance(made, Loop) else None, nominal)
    number = None if workers is None else whole_number("workers", workers, minimum=1)
    alone = ray is None and (isinstance(runner, LaneRuns) or (number or cores()) == 1)
    if not alone:
        _require_pickle(plan)
    for name, value in {"real": real, "device": device}.items():
        if value in ("float", "cuda") and not isinstance(runner, LaneRuns):
            raise UsageError(f"{name}='{value}' is for loops that run in lanes, with a model plant", name=name)
    run_all = partial(run_chunks, plan, runner if alone else None, number or cores())
    if ray is not None:
        run_all = partial(run_on_ray, plan, ray, number)
    return dataclasses.replace(_swept(plan, runner.size, run_all, out, progress), bounds=bounds)


def _swept(
    plan: Plan,
    size: int,
    run_all: Callable[[list[Chunk]], Iterator[Results]],
    out: str | os.PathLike[str] | None,
    progress: bool | None,
) -> Sweep:
    """Run all chunks that are not done."""
    complete = True
    store = Memory(plan.samples) if out is None else Store(out, plan, size)
    chunks = [(first, min(size, plan.samples - first)) for first in range(0, plan.samples, size)]
    left = [chunk for chunk in chunks if not store.has(chunk[0])]
    done = plan.samples - sum(count for _, count in left)
    with Progress(plan.samples, progress, "sweeping") as bar:
        bar.advance(done)
        try:
            for results in run_all(left) if left else ():
                store.write(results)
                done += len(results.table["sample"])
                bar.advance(len(results.table["sample"]))
        except KeyboardInterrupt:
            complete = done == plan.samples
    return Sweep(plan=plan, samples=done, complete=complete, tables=store)


def _bounds(success: Bounds) -> dict[str, tuple[float, float]]:
    """Bounds by column, checked."""
    out: dict[str, tuple[float, float]] = {}
    if not isinstance(success, Mapping):
        raise UsageError(
            f"success must be bounds by metric, {{'rms_error': (0.0, 0.03)}}; got {success!r}", name="success"
        )
    for name, pair in success.items():
        ends = np.asarray(pair, dtype=np.float64)
        if ends.shape != (2,) or not ends[0] <= ends[1]:
            raise RangeError(
                f"success['{name}'] must be (smallest, largest) value; got {pair!r}; infinite is for no bound",
                name="success",
            )
        out[name] = (float(ends[0]), float(ends[1]))
    return out


def _kept(
    plan: Plan,
    nominal: Run,
    metrics: Sequence[str] | None,
    bounds: Bounds,
    record: Sequence[str],
    every: int,
    real: str,
) -> Plan:
    """The plan with what is kept of each run: metrics that have a meaning in the loop's own run, by default."""
    one_of("real", real, ("double", "float"))
    if isinstance(metrics, str) or isinstance(record, str):
        raise UsageError("metrics and record are lists of names, such as ['rms_error']", name="metrics")
    judged = [name.partition(" [")[0] for name in bounds if name not in plan.figures]
    for name in (*(metrics or ()), *judged):
        if name not in METRICS:
            raise unknown_name("a run", "metric", name, METRICS)
    for name in record:
        if name not in nominal.arrays():
            raise unknown_name("the run", "column", name, nominal.arrays())
    known = [name for name in STREAMS if _has(nominal, name)]
    names = [*judged, *(name for name in USUAL if name in known)] if metrics is None else [*metrics, *judged]
    names = list(dict.fromkeys(names))
    for name in names:
        if name in STREAMS and name not in known:
            raise RangeError(f"metric '{name}' has no meaning in this loop's own run; leave it out", name=name)
    columns = columns_of(nominal, names)
    for name in bounds:
        if name not in columns and name not in plan.figures:
            raise unknown_name("the sweep", "number", name, columns)
    units = {name: METRICS[metric].units_of(nominal) for name, (metric, _) in columns.items()}
    return dataclasses.replace(
        plan, columns=columns, record=tuple(record), every=whole_number("every", every, minimum=1), real=real,
        units={name: each[columns[name][1][0] if len(each) > 1 else 0] for name, each in units.items()},
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
