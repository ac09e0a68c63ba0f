"""Scenario: an experiment in one TOML file. Code never comes from a scenario: files name built-ins only."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import MODEL_FILES, FileError, RangeError, UnknownNameError, quoted_list, unknown_name
from taut.base.fields import Declared, Field, Plain
from taut.base.types import ArrayLike
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.sensing import Sensing
from taut.control.side_by_side import SideBySide
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import Reference
from taut.record.metrics import METRICS
from taut.runtime.events import Event
from taut.scenarios.experiment import read_experiment
from taut.scenarios.plants import Plant, Spread, read_plant, read_spread
from taut.scenarios.reading import Table, read, read_toml, shown, with_values

__all__ = [
    "FILES",
    "Outputs",
    "PassFigure",
    "Scenario",
    "Trial",
    "built_in_scenarios",
    "load_scenario",
    "scenario_file",
]

OF_A_CASE: Final = ("arm", "laws", "phases", "control", "plant", "reference", "run", "event")
OF_ALL_CASES: Final = ("title", "outputs", "pass")
MAX_CASES: Final = 200
MAX_NAME: Final = 200  # bytes of a file's name; systems take 255, and a file is written under a longer one first
FILES: Final = {
    "plot": (".png", ".pdf", ".svg"),
    "video": (".gif", ".mp4"),
    "log": (".mcap",),
    "csv": (".csv",),
}


class OfRuns(Declared):
    """Base of sections about the runs: of which case, which joint, and which part of the time."""

    joint: Plain[str | None] = Plain(str, optional=True)  # the joint; all joints together if left out
    window: Field = Field(unit="s", shape=2, minimum=0.0, optional=True)  # [start, end] of the part of a run

    def check(self) -> None:
        if self.window is not None and not self.window[0] < self.window[1]:
            self.refuse(
                "window", f"must be [start, end] with start < end [s]; got {self.window.tolist()}", RangeError
            )

    @property
    def span(self) -> tuple[float, float] | None:
        """Start and end of the window [s]."""
        if self.window is None:
            return None
        start, end = np.asarray(self.window).tolist()
        return start, end

    def check_metrics(self, field: str, names: Any) -> None:
        """Names of metrics, each once."""
        if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
            self.refuse(field, f"must name one metric at least, each once; got {shown(names)}")
        for name in names:
            if name not in METRICS:
                unknown = unknown_name("a run", "metric", name, METRICS)
                self.refuse(field, f"must name what is measured: {unknown}", UnknownNameError)

    def check_fit(self, table: Table, scenario: Scenario) -> None:
        """The joint and the window are of the runs."""
        if self.joint is not None and self.joint not in scenario.arm.joint_names:
            with table.blamed("joint"):
                raise unknown_name(f"arm '{scenario.arm.name}'", "joint", self.joint, scenario.arm.joint_names)
        if self.window is not None and self.window[1] > scenario.duration:
            raise table.error(
                f"must end with the run, at {scenario.duration:g} [s]; got {self.window[1]:g}", "window"
            )


class Outputs(OfRuns):
    """[outputs]: the files that a scenario makes, and what its table and pictures show."""

    plot: Plain[str | None] = Plain(str, optional=True)
    video: Plain[str | None] = Plain(str, optional=True)
    log: Plain[str | None] = Plain(str, optional=True)
    csv: Plain[str | None] = Plain(str, optional=True)
    shown: Plain[str | None] = Plain(str, optional=True)  # the law of video and log; the last if left out
    shown_case: Plain[str | None] = Plain(str, optional=True)  # the case; the last if left out
    columns: Plain[list[str] | None] = Plain(list, optional=True)  # metrics in the table and the plot

    def check(self) -> None:
        super().check()
        if self.columns is not None:
            self.check_metrics("columns", self.columns)
        for kind, suffixes in FILES.items():
            name = getattr(self, kind)
            if name is None:
                continue
            path = Path(name)
            if path.name != name or path.suffix not in suffixes or len(name.encode()) > MAX_NAME:
                rule = f"must be a file name of at most {MAX_NAME} bytes that ends in {' or '.join(suffixes)}"
                self.refuse(kind, f"{rule}; got {shown(name)}")


class PassFigure(OfRuns):
    """[[pass]]: a bound on a metric that decides whether a scenario passes."""

    law: Plain[str] = Plain(str)
    metric: Plain[str] = Plain(str)
    case: Plain[str | None] = Plain(str, optional=True)  # every case if left out
    part: Plain[str | None] = Plain(str, optional=True)  # of laws side by side the one, or of a task the phase
    min: Field = Field(optional=True)
    max: Field = Field(optional=True)

    def check(self) -> None:
        super().check()
        self.check_metrics("metric", [self.metric])
        if self.min is None and self.max is None:
            self.refuse("", "needs min, max or both")
        low, high = self.bounds
        if low > high:
            self.refuse("min", f"must be <= max, which is {high:g}; got {low:g}", RangeError)

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest value that passes."""
        return -math.inf if self.min is None else float(self.min), math.inf if self.max is None else float(self.max)

    def check_fit(self, table: Table, scenario: Scenario) -> None:
        """Joint, window and part are of the runs."""
        super().check_fit(table, scenario)
        if self.joint is not None and not METRICS[self.metric].per_joint:
            raise table.error(f"'{self.metric}' is of the tool; leave joint out", "metric")
        law = scenario.laws.get(self.law)  # another runs where it is of the user's own
        if self.part is None or law is None:
            return
        parts = law.phases if isinstance(law, Task) else law.parts if isinstance(law, SideBySide) else ()
        if self.part not in parts:
            with table.blamed("part"):
                raise unknown_name(f"the law '{self.law}'", "part", self.part, parts)


class Trial(NamedTuple):
    """One run of a scenario: a law in a case."""

    case: str  # empty in a scenario without cases
    law: str

    @property
    def label(self) -> str:
        """What a message calls it."""
        return f"{self.case}: {self.law}" if self.case else self.law


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """An experiment: laws for one arm, against one plant, along one reference."""

    name: str
    source: str  # what messages call it
    title: str
    arm: Arm
    laws: Mapping[str, Law | Task]
    rate: float  # [Hz]
    sensing: Sensing
    limits: Limits | None
    plant: Plant
    reference: Reference
    duration: float  # [s]
    q0: ArrayLike | None
    v0: ArrayLike | None
    seed: int
    events: tuple[Event, ...]
    outputs: Outputs
    figures: tuple[PassFigure, ...]
    cases: Mapping[str, Scenario]  # the scenario with some keys replaced; where there are any, only they are run
    spread: Spread | None = None  # what chance does to it; its runs are the cases
    text: str = ""  # of the file

    @property
    def trials(self) -> dict[Trial, Scenario]:
        """What is run: every law in every case."""
        places = self.cases or {"": self}
        return {Trial(case, law): place for case, place in places.items() for law in self.laws}

    @property
    def shown(self) -> Trial:
        """The run whose video, log and table are made."""
        cases, laws = list(self.cases) or [""], list(self.laws)
        law = self.outputs.shown if self.outputs.shown in laws else laws[-1]
        return Trial(self.outputs.shown_case or cases[-1], law)


# -------------------------------------------------------------------- files


def built_in_scenarios() -> dict[str, Path]:
    """The scenarios that come with taut, by name."""
    folder = Path(str(resources.files("taut.scenarios"))) / "files"
    try:
        return {path.stem: path for path in sorted(folder.glob("*.toml"))}
    except OSError as wrong:
        raise FileError(f"folder '{folder}' cannot be read: {wrong.strerror or wrong}") from wrong


def scenario_file(name: str) -> Path:
    """The file of a scenario, by its name or path.

    Raises:
        UnknownNameError: There is no such scenario.
        FileError: It is a file of another kind.
    """
    known = built_in_scenarios()
    if name in known:
        return known[name]
    path = Path(name)
    if os.path.isdir(path):  # noqa: PTH112  (long names)
        raise FileError(f"'{path}' is a folder; name a scenario in it, a .toml file", name=str(path))
    if path.suffix == ".toml" or (path.name != name and not os.path.exists(path)):  # noqa: PTH110
        return path
    if os.path.exists(path):  # noqa: PTH110
        what = "a robot model, which taut check reads" if path.suffix.lower() in MODEL_FILES else "no scenario"
        raise FileError(f"'{path}' is {what}; a scenario is a .toml file", name=str(path))
    raise unknown_name("taut", "scenario", name, known, hint="or give the path of a .toml file")


def load_scenario(
    name: str, own_laws: Mapping[str, Law] | None = None, *, values: Mapping[str, Any] | None = None
) -> Scenario:
    """A scenario by the name of a built-in one, or by the path of a file.

    Args:
        name: Name or path.
        own_laws: Laws that take the place of the scenario's own, by the place that they were loaded from.
        values: Keys that get another value, by their path in the file: {"run.duration": 2.0, "laws.PD.kp": 5.0}.
            "law.kp" is a gain of the scenario's only law.

    Raises:
        ScenarioError: The file breaks the schema, or its parts do not fit; the message names file, section and key.
        FileError: It cannot be read.
        UnknownNameError: There is no such scenario.
    """
    path = scenario_file(name)
    root = with_values(read_toml(path, f"scenario '{name}'"), values or {})
    root.only([*OF_A_CASE, *OF_ALL_CASES, "cases", "spread"])
    spread = read_spread(root)
    whole = read_experiment(root, own_laws)
    experiments = {case: read_experiment(table, own_laws) for case, table in _cases_of(root).items()}
    for case, plant in () if spread is None else spread.plants(root.table("plant")):
        experiments[case] = {**whole, "plant": read_plant(plant, whole["arm"], whole["rate"])}
    outputs, figures = root.table("outputs"), root.tables("pass")
    common: dict[str, Any] = {
        "name": path.stem,
        "title": root.text("title", path.stem),
        "text": path.read_text(encoding="utf-8-sig"),
        "outputs": read(Outputs, outputs),
        "figures": tuple(read(PassFigure, table) for table in figures),
    }
    cases = {case: Scenario(**fields, **common, cases={}) for case, fields in experiments.items()}
    scenario = Scenario(**whole, **common, cases=cases, spread=spread)
    labels = list(root.table("laws").values) or list(whole["laws"])
    for section, table in zip((scenario.outputs, *scenario.figures), (outputs, *figures), strict=True):
        _require_one(table, {"shown": labels, "law": labels, "shown_case": list(cases), "case": list(cases)})
        case_of = getattr(section, "case", None)
        for case, one in (cases or {"": scenario}).items():
            if case_of in (None, case):
                section.check_fit(table, one)
    return scenario


def _require_one(table: Table, known: Mapping[str, list[str]]) -> None:
    """Names of laws and cases are those of the scenario."""
    for key, names in known.items():
        if key in table and not names:
            raise table.error(f"is for a scenario with cases, [cases.{table.get(key)!r}]; leave it out", key)
        table.choice(key, names)


def _cases_of(root: Table) -> dict[str, Table]:
    """The root table of each case, by its name: the scenario with some of its keys replaced.

    Raises:
        ScenarioError: A case that replaces what belongs to all of them, or has a law of its own.
    """
    if "cases" not in root:
        return {}
    table = root.table("cases")
    if not 0 < len(table.values) <= MAX_CASES or not all(name.strip() for name in table.values):
        raise table.error(
            f"needs 1 to {MAX_CASES} cases, each with a name; got {len(table.values)}; write "
            '[cases."G = 100".plant.gears] with the keys that it replaces'
        )
    whole, laws = root.without("cases"), root.table("laws").values
    cases = {}
    for name in table.values:
        changes = table.table(name)
        changes.only(OF_A_CASE)
        more = changes.get("laws", {}).keys() - laws.keys() if isinstance(changes.get("laws"), dict) else ()
        if more:
            raise changes.error(
                f"changes the law {quoted_list(sorted(more))}, which [laws] does not have: each law runs in each case"
            )
        cases[name] = whole.merged(changes.values, f"{root.where}: case '{name}'")
    return cases
