"""Scenario: an experiment in one TOML file. Code never comes from a scenario: files name built-ins only."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from taut.analysis.comparison import Experiment
from taut.arm.parts import require_few_turns
from taut.base.errors import (
    FileError,
    RangeError,
    TautError,
    UnknownNameError,
    quoted_list,
    unknown_name,
)
from taut.base.fields import Declared, Field, Plain, Whole
from taut.control.combine import SideBySide
from taut.control.law import Law
from taut.control.laws.via_mit import ViaMit
from taut.control.lawside import LawSide
from taut.control.tasks.feed import feed_of
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import Reference
from taut.controller import compile
from taut.loop import check_fit, duration_of_ticks, state_at_start
from taut.maths.snapshot import snapshot
from taut.plant.rigid import RigidPlant
from taut.record.metrics import METRICS
from taut.runtime.events import Event, Schedule
from taut.scenarios.reading import Table, read, read_toml, shown, with_values
from taut.scenarios.references import TASK, read_phases, read_reference
from taut.scenarios.sections import Plant, Spread, read_arm, read_control, read_law, read_plant, read_spread

MAX_RUN_TICKS: Final = 10_000_000  # of a run, which keeps every one: gigabytes
GLANCE: Final = 200  # ticks of a reference that are looked at before a run

OF_A_CASE: Final = ("arm", "laws", "phases", "control", "plant", "reference", "preparation", "run", "event")
OF_CONTROLLERS: Final = ("arm", "laws", "control", "preparation")
OF_ALL_CASES: Final = ("title", "outputs", "pass")
LQR: Final = "lqr"  # the law of a table that is designed
MAX_CASES: Final = 200
MAX_NAME: Final = 200  # bytes of a file's name; systems take 255, and a file is written under a longer one first
FILES: Final = {
    "plot": (".png", ".pdf", ".svg"),
    "video": (".gif",),
    "log": (".mcap",),
}


class RunSection(Declared):
    """[run]: how long each run takes, from where, and with which noise."""

    duration: Field = Field(unit="s", above=0.0)
    seed: Whole = Whole(0)  # of the noise
    q0: Plain[Any] = Plain(default=None)  # positions at the start, or "home"; the plant's home if left out
    v0: Plain[Any] = Plain(default=None)  # velocities at the start; at rest if left out


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
        if self.joint is not None:
            with table.blamed("joint"):
                scenario.experiment.arm.joint_index(self.joint)
        duration = scenario.experiment.duration
        if self.window is not None and self.window[1] > duration:
            raise table.error(f"must end with the run, at {duration:g} [s]; got {self.window[1]:g}", "window")


class Outputs(OfRuns):
    """[outputs]: the files that a scenario makes, and what its table and pictures show."""

    plot: Plain[str | None] = Plain(str, optional=True)
    video: Plain[str | None] = Plain(str, optional=True)
    log: Plain[str | None] = Plain(str, optional=True)
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
        return f"{self.case}: {self.law}" if self.case else self.law


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """An experiment: laws for one arm, against one plant, along one reference."""

    name: str
    title: str
    laws: Mapping[str, Law | Task]
    experiment: Experiment
    outputs: Outputs
    figures: tuple[PassFigure, ...]
    root: Table  # the file with the values given
    cases: Mapping[str, Scenario]  # the scenario with some keys replaced; where there are any, only they are run
    spread: Spread | None = None  # what chance does to it; its runs are the cases

    @property
    def trials(self) -> dict[Trial, Scenario]:
        """The runs: every law in every case."""
        places = self.cases or {"": self}
        return {Trial(case, law): place for case, place in places.items() for law in self.laws}

    @property
    def shown(self) -> Trial:
        """The run whose video, log and table are made."""
        cases, laws = list(self.cases) or [""], list(self.laws)
        law = self.outputs.shown if self.outputs.shown in laws else laws[-1]
        return Trial(self.outputs.shown_case or cases[-1], law)


def built_in_scenarios() -> dict[str, Path]:
    """The scenarios that come with taut, by name."""
    folder = Path(str(resources.files("taut.scenarios"))) / "files"
    try:
        return {path.stem: path for path in sorted(folder.glob("*.toml"))}
    except OSError as wrong:
        raise FileError(f"folder '{folder}' cannot be read: {wrong.strerror or wrong}") from wrong


def scenario_file(name: str) -> Path:
    """The file of a scenario, by its name or path. Raises UnknownNameError."""
    known = built_in_scenarios()
    if name in known:
        return known[name]
    path = Path(name)
    if path.suffix or path.name != name:
        return path
    raise unknown_name("taut", "scenario", name, known, hint="or give the path of a .toml file")


def load_scenario(
    name: str, own_laws: Mapping[str, Law] | None = None, *, values: Mapping[str, Any] | None = None
) -> Scenario:
    """A scenario by the name of a built-in one, or by the path of a file.

    `own_laws` take the place of the scenario's, by the place they were loaded from. `values` replaces keys of the
    file, {"run.duration": 2.0, "laws.PD.kp": 5.0}, and parameters of each law's loop from the start: {"law.kp": 5.0}.
    Raises ScenarioError, whose message names file, section and key, FileError or UnknownNameError.
    """
    path = scenario_file(name)
    keys = (*OF_A_CASE, *OF_ALL_CASES, "cases", "spread")
    of_file = {place: value for place, value in (values or {}).items() if place.partition(".")[0] in keys}
    parameters = {place: value for place, value in (values or {}).items() if place not in of_file}
    root = with_values(read_toml(path, f"scenario '{name}'"), of_file)
    root.only(keys)
    text = path.read_text(encoding="utf-8-sig")
    outputs, figures = root.table("outputs"), root.tables("pass")
    common: dict[str, Any] = {
        "name": path.stem,
        "title": root.text("title", path.stem),
        "outputs": read(Outputs, outputs),
        "figures": tuple(read(PassFigure, table) for table in figures),
        "root": root,
    }

    def read_one(table: Table) -> Scenario:
        laws, experiment = read_experiment(table, own_laws, text, parameters)
        return Scenario(**common, laws=laws, experiment=experiment, cases={})

    spread, whole = read_spread(root), read_one(root)
    cases: dict[str, Scenario] = {}
    for case, table in _cases_of(root).items():
        same = "phases" not in root and all(table.get(key) == root.get(key) for key in OF_CONTROLLERS)
        one = read_one(table)
        cases[case] = replace(one, laws=whole.laws) if same else one  # compiled once
    for case, plant in () if spread is None else spread.plants(root.table("plant")):
        moved = read_plant(plant, whole.experiment.arm, whole.experiment.rate)
        place = replace(whole.experiment, name=f"{root.where}: case '{case}'", plant=moved)
        cases[case] = replace(whole, experiment=place)
    scenario = replace(whole, cases=cases, spread=spread)
    labels = list(root.table("laws").values) or list(whole.laws)
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
    """The root table of each case, by its name: the scenario with some of its keys replaced. Raises ScenarioError."""
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


def read_control_side_and_plant(root: Table) -> dict[str, Any]:
    """arm, plant, rate, sensing and limits of a file with [arm], [plant] and [control]. Raises ScenarioError."""
    arm = read_arm(root.table("arm", required=True))
    rate, sensing, limits = read_control(root.table("control"), arm)
    plant = read_plant(root.table("plant", required=True), arm, rate)
    return {"arm": arm, "plant": plant, "rate": rate, "sensing": sensing, "limits": limits}


def read_experiment(
    root: Table, own_laws: Mapping[str, Law] | None, text: str, parameters: Mapping[str, Any]
) -> tuple[dict[str, Law | Task], Experiment]:
    """The laws of a scenario or of one case, `own_laws` in their place, and their experiment, checked together.

    `parameters` are values of parameters from the start.
    """
    out = read_control_side_and_plant(root)
    arm, plant, rate = out["arm"], out["plant"], out["rate"]
    laws, places = _laws(root, own_laws, out)
    table, run_table, events = root.table("reference"), root.table("run", required=True), root.tables("event")
    if "phases" in root:
        laws = {TASK: read_phases(root, arm, plant.arm.home)}
    alone = {label: law for label, law in laws.items() if isinstance(law, Law)}
    reference = read_reference(table, arm, plant.arm.home, alone)
    run: RunSection = read(RunSection, run_table)
    duration, q0 = float(run.duration), plant.arm.home if run.q0 == "home" else run.q0
    if duration * rate > MAX_RUN_TICKS:
        raise run_table.error(
            f"must be <= {MAX_RUN_TICKS / rate:g} [s] at {rate:g} Hz, as a run keeps every tick; got {duration:g}",
            "duration",
        )
    with run_table.blamed():
        duration_of_ticks(duration, 1.0 / rate)
        q, v = state_at_start(plant.arm, q0, run.v0)
        require_few_turns("q0", q, plant.arm.joints)
    sides = {label: _law_side(law, out, places[label], root.table("control")) for label, law in laws.items()}
    for side in sides.values():
        with root.table("plant").blamed():
            check_fit(side, plant)
        with table.blamed("kind"):
            _check_reference(side, reference, q, v)
    check = partial(_check_event, ticks=round(duration * rate) + 1, sides=list(sides.values()), plant=plant)
    due = [_event(each, check) for each in events]
    if parameters:
        with Table("--set:", "", {}).blamed():
            due.append(Event(t=0.0, set=parameters))  # after those at t = 0, over which it wins
            check(due[-1])
    experiment = Experiment(
        name=root.where,
        reference=reference,
        duration=duration,
        q0=q0,
        v0=run.v0,
        seed=run.seed,
        events=tuple(due),
        texts={"Scenario": text},
        **out,
    )
    if "preparation" in root:
        from taut.scenarios.preparation import read_preparation

        preparation = read_preparation(root.table("preparation"), experiment, sides.values())
        experiment = replace(experiment, preparation=preparation)
    return laws, experiment


def _laws(
    root: Table, own_laws: Mapping[str, Law] | None, out: Mapping[str, Any]
) -> tuple[dict[str, Law | Task], dict[str, Table]]:
    """The laws by their labels, and the table that each comes from; none of a task, which is made with the plant."""
    if "phases" in root:
        if own_laws is not None:
            raise root.error("has [[phases]], each with a law of its own, which --law cannot take the place of")
        for name in ("laws", "reference"):
            if name in root:
                raise root.error(f"has [[phases]], each with its law and its reference; leave [{name}] out")
        return {}, {TASK: root}
    if own_laws is not None:
        tables = {label: Table(f"--law {label}:", "", {}) for label in own_laws}
        laws: dict[str, Law | Task] = dict(own_laws)
        for label, law in own_laws.items():
            side = _law_side(law, out, tables[label], root.table("control"))
            if (side.gives, out["plant"].takes) == ("torque", "mit"):
                laws[label] = ViaMit(law=law, kp_motor=0.0, kd_motor=0.0)
        return laws, tables
    root.need("laws", "the section [laws], or --law FILE.py:CLASS, which also made the file where it is of a sweep")
    section = root.table("laws")
    if not section.values:
        raise section.error("needs one law at least: [laws.PID] with law = 'PID' and its gains")
    tables = {label: section.table(label) for label in section.values}
    return {label: _designed(table, out) or read_law(table, [LQR]) for label, table in tables.items()}, tables


def _designed(table: Table, out: Mapping[str, Any]) -> Law | None:
    """The law of law = "lqr", for the arm as the controllers know it; None for another one."""
    if table.get("law") != LQR:
        return None
    from taut.analysis import lqr

    model = RigidPlant(out["arm"], friction=None, integrator="rk4", adds=out["plant"].adds)
    found = read(lqr, table, others=["law"], arm=out["arm"], rate=out["rate"], plant=model)
    law: Law = found.law
    return law


def _law_side(law: Law | Task, out: Mapping[str, Any], table: Table, control: Table) -> LawSide:
    """The law with what surrounds it, tried once on plain numbers."""
    names = ("arm", "rate", "sensing", "limits")
    with _blamed_one_of(table, control):
        return compile(law, **{name: out[name] for name in names}, adds=out["plant"].adds, engine="float").side


@contextlib.contextmanager
def _blamed_one_of(*tables: Table) -> Iterator[None]:
    """An error names the table that has the key that it is about, else the first one."""
    try:
        yield
    except TautError as cause:
        words = (cause.name or "").split(".")
        table = next((each for each in tables if any(word in each for word in words)), tables[0])
        with table.blamed():
            raise


def _check_reference(side: LawSide, reference: Reference, q: Any, v: Any) -> None:
    """A law follows its reference, from where the run starts."""
    parameters = dict(side.parameters)
    side.check_start(q, parameters, reference)
    feed = feed_of(side, reference, q, lambda: parameters)
    if side.task is None:
        fields = side.law.reference.fields(side.arm.n)
        views = {name: np.zeros((GLANCE, *shape)) for name, shape in fields.items()}
        with np.errstate(all="ignore"):
            feed.fill(views, 0, lambda: snapshot(side.arm, q, v))


def _event(table: Table, check: Callable[[Event], None]) -> Event:
    """An event that sets parameters, or one that pushes, during the run and with each of the laws."""
    if "push" in table:
        table.only(("t", "push"))
        table.need("t")
        event: Event = read(Event.push, table.table("push"), blame="t", t=table.get("t"))
    else:
        event = read(Event, table)
    with table.blamed("t"), table.table("push").blamed("of") if "push" in table else table.blamed("set"):
        check(event)
    return event


def _check_event(event: Event, ticks: int, sides: list[LawSide], plant: Plant) -> None:
    for side in sides:
        Schedule(side, plant, {**side.parameters, **plant.parameters}, [event], ticks)
