"""Running a scenario: every law against the plant, then the table, the files and the verdict."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from taut.analysis.constraints.natural_constraints import natural_constraints
from taut.base.errors import FileError, MissingExtraError, ScenarioError, TautError, UsageError, warn
from taut.base.result import Cell, Content, Result, Table
from taut.control.combine import bare
from taut.control.laws.hybrid import HybridMotionForce
from taut.controller import Controller, compile
from taut.maths.snapshot import Snapshot, snapshot
from taut.record.info import ScenarioInfo
from taut.record.log.files import cannot_write, checked_target, written_aside
from taut.record.metrics import METRICS, Metrics
from taut.record.plots.comparison import compare, spread_figure
from taut.record.run import Run
from taut.runtime.simulate import run
from taut.scenarios.scenario import PassFigure, Scenario, Trial
from taut.scenarios.sections import FILES

__all__ = ["ScenarioResult", "run_scenario"]

SECTIONS: Final = {"duration": "run", "ref": "reference"}  # which an error of a run is about, by its name
READABLE: Final = 100  # letters of a row
COLUMNS = (
    "rms_error",
    "peak_error",
    "final_error",
    "task_rms",
    "task_peak",
    "task_rms_rotation",
    "task_peak_rotation",
    "peak_force",
    "overshoot",
    "settling_time",
    "effort",
    "peak_torque",
    "saturation_time",
    "chatter",
)


@dataclass(frozen=True, kw_only=True)
class ScenarioResult(Result):
    """What a scenario gave."""

    scenario: Scenario
    runs: Mapping[Trial, Run]
    outputs: Mapping[str, Path]
    skipped: Mapping[str, str]  # outputs that could not be made, and why
    missed: tuple[str, ...]  # pass figures that were not reached, in words

    @property
    def figures(self) -> int:
        """How many pass figures there were to reach: of each run those that are about it."""
        return sum(_is_about(figure, trial) for figure in self.scenario.figures for trial in self.runs)

    @property
    def ok(self) -> bool:
        """Whether every run went to its end, every pass figure was reached and every file was made."""
        return not self.missed and not self.skipped and all(one.outcome.ok for one in self.runs.values())

    def json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "scenario": self.scenario.name,
            "metrics": _by_case({trial: one.metrics.json() for trial, one in _apart(self.runs).items()}),
            "outcomes": _by_case({trial: one.outcome.json() for trial, one in self.runs.items()}),
            "outputs": {kind: str(path) for kind, path in self.outputs.items()},
            "skipped": dict(self.skipped),
            "ok": self.ok,
            "missed": list(self.missed),
        }

    def content(self) -> Content:
        """Metrics, of joints in rad and of joints in m apart, what was missed, and the files."""
        faults = [f"missed: {text}" for text in self.missed]
        faults += [f"no {kind}: {reason}" for kind, reason in self.skipped.items()]
        outcomes = [
            f"{trial.label}: {one.outcome}"
            for trial, one in self.runs.items()
            if not one.outcome.ok or one.info.phases or "; " in one.outcome.message
        ]
        reached = f"reached: {self.figures - len(self.missed)} of {self.figures} pass figures"
        return Content(
            title=self.scenario.title,
            faults=faults,
            summary=[*outcomes, *([reached] if self.figures else [])],
            tables=[self._of_runs() if self.scenario.spread is None else self._of_spread()],
            notes=[f"{kind:8} {path}" for kind, path in self.outputs.items()],
            texts={"Scenario": self.scenario.text},
        )

    @property
    def _names(self) -> Sequence[str]:
        return self.scenario.outputs.columns or COLUMNS

    def _of_runs(self) -> Table:
        """A row for each metric and a column for each run; the other way round where there are more runs."""
        joint, window = self.scenario.outputs.joint, self.scenario.outputs.window
        runs = _apart(self.runs)
        values = [[_within(one, window).by_unit(name, joint) for name in self._names] for one in runs.values()]
        columns: list[list[Cell]] = [["", *(trial.label for trial in runs)]]
        for i, name in enumerate(self._names):
            for unit in dict.fromkeys(unit for row in values for unit in row[i]):
                numbers = [row[i].get(unit, math.nan) for row in values]
                if not all(math.isnan(number) for number in numbers):
                    columns.append([f"{METRICS[name].title} [{unit}]", *numbers])
        columns.append(["outcome", *(one.outcome.kind for one in runs.values())])
        rows = columns if len(runs) < len(columns) else [list(row) for row in zip(*columns, strict=True)]
        of = [] if joint is None else [f"of joint '{joint}'"]
        of += [] if window is None else [f"from {window[0]:g} to {window[1]:g} s"]
        return Table(title=", ".join(of), columns=[str(head) for head in rows[0]], rows=rows[1:])

    def _of_spread(self) -> Table:
        """A row for each metric: how it is spread over the runs of each law, and which run has the largest."""
        rows: list[list[Cell]] = []
        for law in self.scenario.laws:
            runs = {trial.case: one for trial, one in self.runs.items() if trial.law == law}
            for name in self._names:
                found = {case: one.metrics.by_unit(name, self.scenario.outputs.joint) for case, one in runs.items()}
                for unit in dict.fromkeys(unit for numbers in found.values() for unit in numbers):
                    row = _spread_row({case: numbers.get(unit, math.nan) for case, numbers in found.items()})
                    if row is not None:
                        rows.append([law, f"{METRICS[name].title} [{unit}]", *row])
            ended = sum(one.outcome.ok for one in runs.values())
            rows.append([law, "completed", ended, None, None, None, ""])
        heads = ("law", "metric", "runs", "smallest", "median", "largest", "largest in")
        return Table(columns=heads, rows=rows)


def _within(one: Run, window: tuple[float, float] | None) -> Metrics:
    """The metrics of a run in a window of it; of all of it where it ended before."""
    if window is None or not len(one) or one.t[-1] < window[0]:
        return one.metrics
    return one.between(*window).metrics


def _spread_row(values: Mapping[str, float]) -> list[Cell] | None:
    """Count, smallest, median and largest of what is a number, and the run of the largest; None if nothing is."""
    known = {case: value for case, value in values.items() if not math.isnan(value)}
    if not known:
        return None
    smallest, median, largest = (f(known.values()) for f in (min, statistics.median, max))
    return [len(known), smallest, median, largest, max(known, key=lambda case: known[case])]


def _apart(runs: Mapping[Trial, Run]) -> dict[Trial, Run]:
    """Runs of laws side by side by their parts, those of a task by its phases, and all others as they are."""
    out: dict[Trial, Run] = {}
    for trial, one in _by_part(runs).items():
        out |= _by_phase(trial, one) or {trial: one}
    return out


def _by_part(runs: Mapping[Trial, Run]) -> dict[Trial, Run]:
    """Runs of laws side by side by their parts, which have the metrics, and all others as they are."""
    out: dict[Trial, Run] = {}
    for trial, one in runs.items():
        parts = {Trial(trial.case, f"{trial.law}: {name}"): one.part(name) for name in one.info.parts}
        out |= parts or {trial: one}
    return out


def _by_phase(trial: Trial, one: Run) -> dict[Trial, Run]:
    """The runs of the phases of a task; a phase that acted again has a number."""
    out: dict[Trial, Run] = {}
    for window in one.phases if one.info.phases else ():
        visit = sum(label.law.partition(" ")[0] == window.name for label in out)
        label = window.name if visit == 0 else f"{window.name} {visit + 1}"
        out[Trial(trial.case, label)] = one.phase(window.name, visit)
    return out


def _by_case(values: Mapping[Trial, Any]) -> dict[str, Any]:
    """Values by law, or by case and law where there are cases."""
    out: dict[str, Any] = {}
    for trial, value in values.items():
        (out.setdefault(trial.case, {}) if trial.case else out)[trial.law] = value
    return out


def run_scenario(
    scenario: Scenario, folder: Path, *, say: Callable[[str], None], engine: str = "auto"
) -> ScenarioResult:
    """Run every law of a scenario and write its files.

    Args:
        scenario: What to run.
        folder: Where the files go; made if it is not there.
        say: Takes a line of progress.
        engine: Engine of the controllers.

    Returns:
        What happened, files that could not be made included.

    Raises:
        FileError: Something stands where the folder or a file should be; nothing has run yet.
        ScenarioError: A law that cannot be compiled, a run that cannot begin.
    """
    files = _targets(scenario, folder)
    runs: dict[Trial, Run] = {}
    made: dict[str, Controller] = {}  # in a spread the plants differ, and the controllers do not
    for trial, one in scenario.trials.items():
        ctrl = made.get(trial.law)
        if ctrl is None:
            ctrl = _compiled(one, trial, engine)
            remark = _remark(ctrl, one)
            if remark:
                say(f"law '{trial.law}': {remark}")
        if scenario.spread is not None:
            made[trial.law] = ctrl
        log = files.get("log") if trial == scenario.shown else None
        runs[trial] = _one_run(one, ctrl, trial, say, log)
    outputs, skipped = _written(scenario, runs, files, say)
    missed = tuple(text for figure in scenario.figures for text in _missed(figure, runs))
    return ScenarioResult(scenario=scenario, runs=runs, outputs=outputs, skipped=skipped, missed=missed)


def _compiled(scenario: Scenario, trial: Trial, engine: str) -> Controller:
    with _blamed(scenario, trial):
        return compile(
            scenario.laws[trial.law],
            scenario.arm,
            rate=scenario.rate,
            sensing=scenario.sensing,
            limits=scenario.limits,
            adds=scenario.plant.adds,
            engine=engine,  # type: ignore[arg-type]  # the command line checks the word
        )


def _one_run(scenario: Scenario, ctrl: Controller, trial: Trial, say: Callable[[str], None], log: Path | None) -> Run:
    """A run, with a log beside the one that is wanted, which is there if the run is broken off."""
    say(f"running {trial.label} ...")
    if log is not None:
        try:
            _make_folder(log.parent)
        except FileError:  # which is reported with the other files
            log = None
    with _blamed(scenario, trial):
        done = run(
            ctrl,
            scenario.plant,
            None if ctrl.side.task is not None else scenario.reference,
            duration=scenario.duration,
            q0=scenario.q0,
            v0=scenario.v0,
            seed=scenario.seed,
            events=scenario.events,
            log=None if log is None else _partial(log),
        )
    built_in = scenario.source.partition(":")[0] == f"scenario '{scenario.name}'"
    made_by = ScenarioInfo(name=scenario.name, **trial._asdict(), text=scenario.text, built_in=built_in)
    return dataclasses.replace(done, info=dataclasses.replace(done.info, scenario=made_by))


@contextmanager
def _blamed(scenario: Scenario, trial: Trial) -> Iterator[None]:
    """What loading could not see, such as code that cannot be traced or memory that is full, names its place."""
    try:
        yield
    except TautError as cause:
        section = SECTIONS.get((cause.name or "").partition(".")[0])
        place = f"[{section}]" if section else f"law '{trial.law}':"
        raise ScenarioError(f"{scenario.source}: {place} {cause}") from cause


def _remark(ctrl: Controller, scenario: Scenario) -> str:
    """The natural constraints of hybrid laws, before a run."""
    q = scenario.arm.home if scenario.q0 is None else scenario.q0
    x = snapshot(scenario.arm, q)
    if ctrl.side.task is None:
        law = bare(ctrl.side.single_law)
        return _natural_constraints_of(law, x) if isinstance(law, HybridMotionForce) else ""
    laws = {name: bare(law) for name, law in ctrl.side.task.laws.items()}
    hybrid = {name: law for name, law in laws.items() if isinstance(law, HybridMotionForce)}
    return "\n".join(f"phase '{name}': {_natural_constraints_of(law, x)}" for name, law in hybrid.items())


def _natural_constraints_of(law: HybridMotionForce, x: Snapshot) -> str:
    """The table of natural constraints; without rows that are unreadable sums, as of a chain of many joints."""
    table = natural_constraints(law.constraint, at=x)
    if max(len(row.natural) for row in table.rows) <= READABLE:
        return str(table)
    rows = "its rows are sums of many joints: taut.analysis.natural_constraints prints them"
    return "\n".join([table.content().title, rows, *table.notes])


# -------------------------------------------------------------------- files


def _targets(scenario: Scenario, folder: Path) -> dict[str, Path]:
    """The files to write, by kind. What can be known to stand in their way is refused before the run.

    Raises:
        FileError: The folder cannot be made, or takes no files; a folder has the name of a file.
    """
    wanted = {kind: getattr(scenario.outputs, kind) for kind in FILES}
    files = {kind: folder / name for kind, name in wanted.items() if name is not None}
    files["metrics"] = folder / f"{scenario.name}.json"
    try:
        there = next((place for place in (folder, *folder.parents) if place.exists()), Path())
        if not there.is_dir():
            raise FileError(f"the folder '{folder}' cannot be made: '{there}' is a file", name=str(folder))
        if not os.access(there, os.W_OK):
            raise FileError(
                f"the folder '{folder}' cannot be written; '{there}' is read-only for you", name=str(folder)
            )
        if there == folder:
            for kind, path in files.items():
                checked_target(kind, path, (path.suffix,))
    except FileError:
        raise
    except OSError as cause:  # such as a name that is too long
        raise cannot_write("output", folder, cause) from cause
    return files


def _written(
    scenario: Scenario, runs: Mapping[Trial, Run], files: Mapping[str, Path], say: Callable[[str], None]
) -> tuple[dict[str, Path], dict[str, str]]:
    """The files that were made, and why others were not: what happened in the runs must not be lost with them."""
    shown = runs[scenario.shown]
    writers: dict[str, Callable[[Path], object]] = {
        "plot": lambda path: _save_plot(scenario, runs, path),
        "video": lambda path: _film(shown, path),
        "log": lambda path: _save_log(shown, path),
        "csv": shown.to_csv,
        "metrics": lambda path: _save_metrics(runs, path),
    }
    made: dict[str, Path] = {}
    skipped: dict[str, str] = {}
    for kind, path in files.items():
        say(f"writing {path} ...")
        try:
            _make_folder(path.parent)
            writers[kind](path)
        except TautError as cause:
            skipped[kind] = str(cause)
        else:
            made[kind] = path
    return made, skipped


def _partial(log: Path) -> Path:
    """The log of a run that is going on, until there is a whole one."""
    return log.with_name(f"{log.stem}.partial{log.suffix}")


def _save_log(shown: Run, path: Path) -> None:
    try:
        shown.save(path)
    finally:
        with suppress(OSError):
            _partial(path).unlink(missing_ok=True)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise FileError(f"the folder '{folder}' cannot be made: {cause.strerror}", name=str(folder)) from cause


def _save_plot(scenario: Scenario, runs: Mapping[Trial, Run], path: Path) -> None:
    runs = _by_part(runs)
    labels = {trial: _plot_label(trial, list(scenario.laws)) for trial in runs}
    drawn = {labels[trial]: one for trial, one in runs.items() if len(one)}
    if not drawn:
        raise UsageError("there is nothing to plot: no law got through its first tick", name="plot")
    wanted, joints = scenario.outputs, None if scenario.outputs.joint is None else [scenario.outputs.joint]
    if scenario.spread is not None:
        figure = spread_figure(drawn)
    elif len(runs) > 1:
        whole = wanted.window is None or all(one.t[-1] >= wanted.window[1] for one in drawn.values())
        window = wanted.window if whole else None
        figure = compare(drawn, measures=wanted.columns, joint=wanted.joint, window=window)
    else:
        figure = next(iter(drawn.values())).plot(joints=joints)
    with written_aside("plot", path) as aside:
        figure.savefig(aside, dpi=150)


def _plot_label(trial: Trial, laws: Sequence[str]) -> str:
    """What a line is called: without the law where there is only one."""
    if len(laws) > 1:
        return trial.label
    part = trial.law.removeprefix(laws[0]).removeprefix(": ")
    return ": ".join(word for word in (trial.case, part) if word) or trial.law


def _film(shown: Run, path: Path) -> None:
    if not len(shown):
        raise UsageError("there is nothing to film: the law did not get through its first tick", name="video")
    try:
        shown.video(path)
    except MissingExtraError as missing:  # the run is done, and its other files are made
        warn(str(missing))


def _save_metrics(runs: Mapping[Trial, Run], path: Path) -> None:
    metrics = _by_case({trial: one.metrics.json() for trial, one in _apart(runs).items()})
    with written_aside("metrics", path) as aside:
        aside.write_text(json.dumps(metrics, indent=1) + "\n", encoding="utf-8")


# -------------------------------------------------------------------- pass figures


def _is_about(figure: PassFigure, trial: Trial) -> bool:
    """Whether a pass figure judges a run."""
    return trial.law == figure.law and figure.case in (None, trial.case)


def _missed(figure: PassFigure, runs: Mapping[Trial, Run]) -> Iterator[str]:
    """In words, the runs in which a pass figure is not reached."""
    for trial, one in runs.items():
        if _is_about(figure, trial):
            text = _shortfall_of_part(figure, one)
            if text is not None:
                yield f"{trial.label}{'' if figure.part is None else f', {figure.part}'}: {text}"


def _shortfall_of_part(figure: PassFigure, one: Run) -> str | None:
    """In words, if what a pass figure is about does not reach it: the run, a law beside others, or a phase."""
    measured = one
    if figure.part is not None and not one.info.phases:
        measured = one.part(figure.part)
    elif figure.part is not None:
        if figure.part not in (window.name for window in one.phases):
            return "the phase did not act"
        measured = one.phase(figure.part)
    return _shortfall(figure, _within(measured, figure.window))


def _shortfall(figure: PassFigure, metrics: Metrics) -> str | None:
    """In words, if a run does not reach a pass figure."""
    what = figure.metric
    if figure.joint is None:
        value = metrics.overall[figure.metric]
    else:
        what += f" of joint '{figure.joint}'"
        value = getattr(metrics, figure.metric)[metrics.joint_names.index(figure.joint)]
    if math.isnan(value):
        return f"{what} has no meaning in this run, so that no bound on it is reached"
    low, high = figure.bounds
    if low <= value <= high:
        return None
    bound = f"<= {high:g}" if not value <= high else f">= {low:g}"
    return f"{what} must be {bound}; got {value:.6g}"
