"""Running a scenario: every law against the plant, then the table, the files and the verdict."""

from __future__ import annotations

import dataclasses
import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.base.errors import (
    FileError,
    MissingExtraError,
    ScenarioError,
    StabilityWarning,
    TautError,
    UsageError,
    warn,
)
from taut.base.result import Cell, Content, Result, Table
from taut.codegen.engine import EngineChoice
from taut.controller import Controller
from taut.record.comparison_plot import MAX_RUNS, compare
from taut.record.info import ScenarioInfo
from taut.record.log.files import checked_target, written_aside
from taut.record.metrics import METRICS, Metrics
from taut.record.run import HALF, Run
from taut.runtime.realtime.robot import Robot
from taut.scenarios.on_robot import ready_for, run_on_robot
from taut.scenarios.scenario import FILES, PassFigure, Scenario, Trial

SECTIONS: Final = {"duration": "run", "ref": "reference"}  # which an error of a run is about, by its name
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
    """Result of a scenario: its runs, the files that were made, and what was missed."""

    scenario: Scenario
    runs: Mapping[Trial, Run]
    outputs: Mapping[str, Path]
    skipped: Mapping[str, str]  # outputs that could not be made, and why
    logs: Mapping[Trial, Path] = dataclasses.field(default_factory=dict)  # of a robot
    ended: str = ""  # why a robot did not run all laws

    @property
    def verdicts(self) -> list[str]:
        """A sentence for each pass criterion and its run: how it is missed; empty where it is met."""
        return [
            f"{trial.label}{'' if figure.part is None else f', {figure.part}'}: {text}" if text else ""
            for figure in self.scenario.figures
            for trial, one in self.runs.items()
            if trial.law == figure.law and figure.case in (None, trial.case)
            for text in [_shortfall(figure, one)]
        ]

    @property
    def missed(self) -> list[str]:
        """The pass criteria that were not reached, in words."""
        return [text for text in self.verdicts if text]

    @property
    def ok(self) -> bool:
        """True where every run went to its end, every pass criterion was reached and every file was made."""
        faults = self.missed or self.skipped or self.ended
        return not faults and all(one.outcome.ok for one in self.runs.values())

    def json(self) -> dict[str, Any]:
        return {
            "scenario": self.scenario.name,
            "metrics": _metrics_by_case(self.runs),
            "outcomes": _by_case({trial: one.outcome.json() for trial, one in self.runs.items()}),
            "outputs": {kind: str(path) for kind, path in self.outputs.items()},
            "skipped": dict(self.skipped),
            "logs": _by_case({trial: str(path) for trial, path in self.logs.items()}),
            "ended": self.ended,
            "ok": self.ok,
            "missed": self.missed,
        }

    def content(self) -> Content:
        """Metrics, of joints in rad and of joints in m apart, what was missed, and the files."""
        verdicts, missed = self.verdicts, self.missed
        outcomes = [
            f"{trial.label}: {one.outcome}"
            for trial, one in self.runs.items()
            if not one.outcome.ok or one.info.phases or "; " in one.outcome.message
        ]
        reached = f"passed: {len(verdicts) - len(missed)} of {len(verdicts)} pass criteria"
        spans = dict.fromkeys("{:g} to {:g} s".format(*x.span) for x in self.scenario.figures if x.span)
        reached += f" (windows: {', '.join(spans)})" if spans else ""
        return Content(
            title=self.scenario.title,
            faults=[
                *(f"missed: {text}" for text in missed),
                *(f"no {kind}: {reason}" for kind, reason in self.skipped.items()),
                *filter(None, [self.ended]),
            ],
            summary=[*outcomes, *([reached] if verdicts else [])],
            tables=[self._of_runs()] if self.runs else [],
            notes=[
                *(f"{kind:8} {path}" for kind, path in self.outputs.items()),
                *(f"robot    {path} ({trial.label})" for trial, path in self.logs.items()),
            ],
            texts=self.scenario.experiment.texts,
        )

    def _rows(self, runs: Mapping[Trial, Run]) -> Iterator[tuple[str, list[float]]]:
        """Each metric by its title and unit, with its value in each run; those without any are left out."""
        outputs = self.scenario.outputs
        metrics = [_within(one, outputs.span) for one in runs.values()]
        for name in outputs.columns or COLUMNS:
            values = [one.by_unit(name, outputs.joint) for one in metrics]
            for unit in dict.fromkeys(unit for of_run in values for unit in of_run):
                numbers = [of_run.get(unit, math.nan) for of_run in values]
                if not all(map(math.isnan, numbers)):
                    yield f"{METRICS[name].title} [{unit}]", numbers

    def _of_runs(self) -> Table:
        """A row for each metric and a column for each run; the other way round where there are more runs."""
        joint, window = self.scenario.outputs.joint, self.scenario.outputs.span
        runs = _apart(self.runs, window)
        rows: list[list[Cell]] = [["", *(trial.label for trial in runs)]]
        rows += [[title, *numbers] for title, numbers in self._rows(runs)]
        rows.append(["outcome", *(one.outcome.kind for one in runs.values())])
        if len(runs) >= len(rows):
            rows = [list(column) for column in zip(*rows, strict=True)]
        of = [] if joint is None else [f"of joint '{joint}'"]
        of += [] if window is None else [f"from {window[0]:g} to {window[1]:g} s"]
        return Table(title=", ".join(of), columns=[str(head) for head in rows[0]], rows=rows[1:])


def _within(one: Run, window: tuple[float, float] | None) -> Metrics:
    """The metrics of a run in a window of it; of all of it where it ended before."""
    if window is None or not len(one) or one.t[-1] < window[0]:
        return one.metrics
    return one.between(*window).metrics


def _apart(runs: Mapping[Trial, Run], span: tuple[float, float] | None = None) -> dict[Trial, Run]:
    """Runs of laws side by side by their parts, those of a task by its phases, and all others as they are.

    Of several phases the whole run is there too, as a jump between two of them is in neither. A phase without two
    ticks in the span is left out.
    """
    out: dict[Trial, Run] = {}
    for trial, one in _by_part(runs).items():
        phases = {}
        for window in one.phases if one.info.phases else ():
            label = f"{window.name} {window.visit + 1}" if window.visit else window.name
            phase = one.phase(window.name, window.visit)
            if span is None or np.sum((phase.t > span[0] - HALF) & (phase.t < span[1] + HALF)) > 1:
                phases[Trial(trial.case, label)] = phase
        out |= phases if len(phases) == 1 and one.outcome.ok else {trial: one} | phases
    return out


def _by_part(runs: Mapping[Trial, Run]) -> dict[Trial, Run]:
    """Runs of laws side by side by their parts, which have the metrics, and all others as they are."""
    out: dict[Trial, Run] = {}
    for trial, one in runs.items():
        parts = {Trial(trial.case, f"{trial.law}: {name}"): one.part(name) for name in one.info.parts}
        out |= parts or {trial: one}
    return out


def _by_case(values: Mapping[Trial, Any]) -> dict[str, Any]:
    """Values by law, or by case and law where there are cases."""
    out: dict[str, Any] = {}
    for trial, value in values.items():
        (out.setdefault(trial.case, {}) if trial.case else out)[trial.law] = value
    return out


def _metrics_by_case(runs: Mapping[Trial, Run]) -> dict[str, Any]:
    return _by_case({trial: one.metrics.json() for trial, one in _apart(runs).items()})


def _shortfall(figure: PassFigure, one: Run) -> str:
    """Sentence on how a pass criterion is missed: the run, a law beside others, or a phase; empty if not."""
    what = figure.metric if figure.joint is None else f"{figure.metric} of joint '{figure.joint}'"
    if not one.outcome.ok:
        return f"{what} counts only in a run that goes to its end; this one {one.outcome.kind}"
    values = _values(figure, one)
    if not values:
        return "the phase did not act"
    if len(values) > 1:
        return f"{what} has no one number for joints in rad and joints in m together; add joint"
    low, high = figure.bounds
    if math.isnan(values[0]):
        return f"{what} has no meaning in this run, so that no bound on it is reached"
    if low <= values[0] <= high:
        return ""
    return f"{what} must be {f'<= {high:g}' if values[0] > high else f'>= {low:g}'}; got {values[0]:.6g}"


def _values(figure: PassFigure, one: Run) -> list[float]:
    """What a pass criterion is about, by unit; nothing where its phase did not act."""
    if figure.part is not None and one.info.phases:
        if figure.part not in (window.name for window in one.phases):
            return []
        one = one.phase(figure.part)
    elif figure.part is not None:
        one = one.part(figure.part)
    return list(_within(one, figure.span).by_unit(figure.metric, figure.joint).values())


def value_of(figure: PassFigure, one: Run) -> float:
    """The one number that a pass criterion is about; NaN where a run has none."""
    values = _values(figure, one)
    return values[0] if len(values) == 1 else math.nan


def run_scenario(
    scenario: Scenario,
    folder: Path,
    *,
    say: Callable[[str], None],
    engine: EngineChoice = "auto",
    robot: Robot | None = None,
) -> ScenarioResult:
    """Run every law of a scenario and write its files to a folder; the result lists files that could not be made.

    On a robot, if one is given, in place of the scenario's plant, until a law ends in a fault; its logs are in the
    folder's `robot`.

    Raises ScenarioError before the first motion of a robot, and FileError before the first run where something stands
    in the way of a file. `say` takes lines of progress.
    """
    files, logs, ended = _targets(scenario, folder), dict[Trial, Path](), ""
    if robot is None:
        runs = _simulated(scenario, files, say, engine)
    else:
        runs, logs, ended = _on_robot(scenario, robot, folder / "robot", say)
    outputs, skipped = _written(scenario, runs, files, say)
    return ScenarioResult(scenario=scenario, runs=runs, outputs=outputs, skipped=skipped, logs=logs, ended=ended)


def _on_robot(
    scenario: Scenario, robot: Robot, log: Path, say: Callable[[str], None]
) -> tuple[dict[Trial, Run], dict[Trial, Path], str]:
    """The runs until one ends in a fault, their logs, and a sentence on laws behind it."""
    ready: dict[Trial, Controller] = {}
    for trial, one in scenario.trials.items():
        with _blamed(one, trial):
            ready[trial] = ready_for(robot, one.experiment, one.laws[trial.law])
    runs, logs, why = dict[Trial, Run](), dict[Trial, Path](), ""
    for trial, ctrl in ready.items():
        say(f"running {trial.label} ...")
        try:
            done, logs[trial] = run_on_robot(robot, scenario.experiment, ctrl, log)
        except TautError as error:
            why = f"{error}; its logs are in {log}"
            break
        runs[trial] = _labelled(done, scenario, trial)
        say(f"{trial.label}: {done.outcome}")
        if not done.outcome.ok:
            why = f"{trial.label} stopped"
            break
    left = ", ".join(trial.label for trial in ready if trial not in runs)
    return runs, logs, f"not run: {left}, as {why}" if left else ""


def _simulated(
    scenario: Scenario, files: Mapping[str, Path], say: Callable[[str], None], engine: EngineChoice
) -> dict[Trial, Run]:
    runs: dict[Trial, Run] = {}
    made: dict[str, Controller] = {}
    for trial, one in scenario.trials.items():
        say(f"running {trial.label} ...")
        with _blamed(one, trial), warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)  # the outcome has its sentence
            ctrl, law, adds = made.get(trial.law), one.laws[trial.law], one.experiment.plant.adds
            experiment = one.experiment.prepared(law, engine)
            if ctrl is None or ctrl.law is not law or ctrl.side.adds != adds or experiment is not one.experiment:
                ctrl = made[trial.law] = experiment.controller(law, engine)
            log = _partial(files["log"]) if "log" in files and trial == scenario.shown else None
            try:
                done = experiment.run(ctrl, log=log)
            except KeyboardInterrupt:
                if log is None or not log.exists():
                    raise
                raise KeyboardInterrupt(f"the run until then is in {log}") from None
            runs[trial] = _labelled(done, one, trial)
    return runs


def _labelled(done: Run, scenario: Scenario, trial: Trial) -> Run:
    """The run with the scenario that it is of."""
    info = ScenarioInfo(
        name=scenario.name,
        **trial._asdict(),
        text=scenario.experiment.texts["Scenario"],
        built_in=scenario.experiment.name.partition(":")[0] == f"scenario '{scenario.name}'",
    )
    return dataclasses.replace(done, info=dataclasses.replace(done.info, scenario=info))


@contextmanager
def _blamed(scenario: Scenario, trial: Trial) -> Iterator[None]:
    """Name the place of errors that loading could not see, such as code that cannot be traced or full memory."""
    try:
        yield
    except ScenarioError:  # of a preparation
        raise
    except TautError as cause:
        section = SECTIONS.get((cause.name or "").partition(".")[0])
        place = f"[{section}]" if section else f"law '{trial.law}':"
        raise ScenarioError(f"{scenario.experiment.name}: {place} {cause}") from cause


def _targets(scenario: Scenario, folder: Path) -> dict[str, Path]:
    """The files to write, by kind, in a folder that is made. Raises FileError if something is in their way."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as cause:  # such as a name that is too long, or of a file
        raise FileError(f"the folder '{folder}' cannot be made: {cause.strerror}", name=str(folder)) from cause
    names = {kind: getattr(scenario.outputs, kind) for kind in FILES} | {"metrics": f"{scenario.name}.json"}
    files = {kind: folder / name for kind, name in names.items() if name is not None}
    return {kind: checked_target(kind, path, (path.suffix,)) for kind, path in files.items()}


def _written(
    scenario: Scenario, runs: Mapping[Trial, Run], files: Mapping[str, Path], say: Callable[[str], None]
) -> tuple[dict[str, Path], dict[str, str]]:
    """The files that were made, and why others were not: what happened in the runs must not be lost with them."""
    writers: dict[str, Callable[[Path], object]] = {
        "plot": lambda path: _save_plot(scenario, runs, path),
        "video": lambda path: _film(_shown(scenario, runs), path),
        "log": lambda path: _save_log(_shown(scenario, runs), path),
        "metrics": lambda path: _save_metrics(runs, path),
    }
    made: dict[str, Path] = {}
    skipped: dict[str, str] = {}
    for kind, path in files.items():
        say(f"writing {path} ...")
        try:
            writers[kind](path)
        except TautError as cause:
            skipped[kind] = str(cause)
        else:
            made[kind] = path
    return made, skipped


def _shown(scenario: Scenario, runs: Mapping[Trial, Run]) -> Run:
    """The run of video and log; the last one where a robot did not come to it."""
    if not runs:
        raise UsageError("no law was run", name="shown")
    return runs.get(scenario.shown, list(runs.values())[-1])


def _partial(log: Path) -> Path:
    """The log of a run that is going on, until there is a whole one."""
    return log.with_name(f"{log.stem}.partial{log.suffix}")


def _save_log(shown: Run, path: Path) -> None:
    try:
        shown.save(path)
    finally:
        with suppress(OSError):
            _partial(path).unlink(missing_ok=True)


def _save_plot(scenario: Scenario, runs: Mapping[Trial, Run], path: Path) -> None:
    outputs, parts, laws = scenario.outputs, _by_part(runs), list(scenario.laws)
    drawn = {_plot_label(trial, laws): one for trial, one in parts.items() if len(one)}
    if not drawn:
        raise UsageError("there is nothing to plot: no law got through its first tick", name="plot")
    if len(runs) > 1 and len(drawn) <= MAX_RUNS:
        whole = outputs.span is None or all(one.t[-1] >= outputs.span[1] for one in drawn.values())
        window = outputs.span if whole else None
        figure = compare(drawn, measures=outputs.columns, joint=outputs.joint, window=window)
    else:
        one = drawn.get(_plot_label(scenario.shown, laws), next(iter(drawn.values())))
        figure = one.plot(joints=None if outputs.joint is None else [outputs.joint])
    with written_aside("plot", path) as aside:
        figure.savefig(aside, dpi=150)


def _plot_label(trial: Trial, laws: Sequence[str]) -> str:
    """Label of a line: without the law where there is only one."""
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
    with written_aside("metrics", path) as aside:
        aside.write_text(json.dumps(_metrics_by_case(runs), indent=1) + "\n", encoding="utf-8")
