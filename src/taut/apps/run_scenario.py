"""Running a scenario: every law against the plant, then the table, the files and the verdict."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from taut.apps.scenario import PassFigure, Scenario
from taut.base.errors import FileError, ScenarioError, unknown_name
from taut.controller import compile
from taut.record.metrics import MEASURES
from taut.record.plot import compare
from taut.record.run import Run
from taut.record.table import number_text
from taut.runtime.simulate import run

__all__ = ["ScenarioResult", "run_scenario"]

COLUMNS = (
    "rms_error",
    "peak_error",
    "final_error",
    "overshoot",
    "settling_time",
    "effort",
    "peak_torque",
    "saturation_time",
    "chatter",
)


@dataclass(frozen=True, kw_only=True)
class ScenarioResult:
    """What a scenario gave."""

    scenario: Scenario
    runs: Mapping[str, Run]
    outputs: Mapping[str, Path]
    missed: tuple[str, ...]  # pass figures that were not reached, in words

    @property
    def ok(self) -> bool:
        """Whether every run went to its end and every pass figure was reached."""
        return not self.missed and all(one.outcome.ok for one in self.runs.values())

    def json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "scenario": self.scenario.name,
            "metrics": {label: one.metrics.json() for label, one in self.runs.items()},
            "outcomes": {label: one.outcome.json() for label, one in self.runs.items()},
            "outputs": {kind: str(path) for kind, path in self.outputs.items()},
            "ok": self.ok,
            "missed": list(self.missed),
        }

    def table(self) -> Table:
        """One row per law, with the numbers that mean something for all joints together."""
        metrics = {label: one.metrics for label, one in self.runs.items()}
        names = [name for name in COLUMNS if any(not math.isnan(m.overall[name]) for m in metrics.values())]
        unit = {name: next(iter(metrics.values())).unit(name) for name in names}
        heads = [escape(f"{MEASURES[name].title}\n[{unit[name]}]") for name in names]
        table = Table("law", *heads, "outcome", title=self.scenario.title)
        for label, one in self.runs.items():
            cells = [number_text(metrics[label].overall[name]) for name in names]
            table.add_row(escape(label), *cells, one.outcome.kind)
        return table


def run_scenario(
    scenario: Scenario, folder: Path, *, say: Callable[[str], None], engine: str = "auto"
) -> ScenarioResult:
    """Run every law of a scenario and write its files.

    Args:
        scenario: What to run.
        folder: Where the files go; made if it is not there.
        say: Takes a line of progress.
        engine: Engine of the controllers.

    Raises:
        TautError: A law and the plant do not fit, or a file cannot be written.
    """
    _check_metrics(scenario)
    runs: dict[str, Run] = {}
    for label, law in scenario.laws.items():
        plant = scenario.make_plant()
        ctrl = compile(
            law,
            scenario.arm,
            rate=scenario.rate,
            sensing=scenario.sensing,
            limits=scenario.limits,
            adds=plant.adds,
            engine=engine,  # type: ignore[arg-type]  # the command line checks the word
        )
        say(f"running {label} ...")
        runs[label] = run(
            ctrl,
            plant,
            scenario.reference,
            duration=scenario.duration,
            q0=scenario.q0,
            v0=scenario.v0,
            seed=scenario.seed,
            events=scenario.events,
        )
    outputs = _written(scenario, runs, folder, say)
    missed = tuple(text for figure in scenario.figures if (text := _missed(figure, runs)) is not None)
    return ScenarioResult(scenario=scenario, runs=runs, outputs=outputs, missed=missed)


def _written(
    scenario: Scenario, runs: Mapping[str, Run], folder: Path, say: Callable[[str], None]
) -> dict[str, Path]:
    wanted, shown = scenario.outputs, runs[scenario.outputs.shown]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise FileError(f"the folder '{folder}' cannot be made: {cause.strerror}", name=str(folder)) from cause
    made: dict[str, Path] = {}
    if wanted.plot is not None:
        say("drawing ...")
        figure = compare(runs) if len(runs) > 1 else shown.plot()
        made["plot"] = folder / wanted.plot
        figure.savefig(made["plot"], dpi=150)
    if wanted.video is not None:
        say(f"filming {wanted.shown} ...")
        made["video"] = shown.video(folder / wanted.video)
    if wanted.log is not None:
        made["log"] = folder / wanted.log
        shown.save(made["log"])
    if wanted.csv is not None:
        made["csv"] = folder / wanted.csv
        shown.to_csv(made["csv"])
    made["metrics"] = folder / f"{scenario.name}.json"
    metrics = {label: one.metrics.json() for label, one in runs.items()}
    made["metrics"].write_text(json.dumps(metrics, indent=1) + "\n", encoding="utf-8")
    return made


# -------------------------------------------------------------------- pass figures


def _check_metrics(scenario: Scenario) -> None:
    for figure in scenario.figures:
        if figure.metric not in MEASURES:
            raise ScenarioError(
                f"{scenario.name}: [[pass]] {unknown_name('a run', 'metric', figure.metric, MEASURES)}"
            )


def _missed(figure: PassFigure, runs: Mapping[str, Run]) -> str | None:
    """In words, if a pass figure is not reached."""
    if figure.law not in runs:
        return None
    value = runs[figure.law].metrics.overall[figure.metric]
    if figure.least <= value <= figure.most:
        return None
    bound = f"<= {figure.most:g}" if not value <= figure.most else f">= {figure.least:g}"
    return f"{figure.law}: {figure.metric} must be {bound}; got {value:.6g}"
