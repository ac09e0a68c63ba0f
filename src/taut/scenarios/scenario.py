"""Scenario: an experiment in one TOML file. Code never comes from a scenario: files name built-ins only."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final, NamedTuple

from taut.arm.description import Arm
from taut.base.errors import MODEL_FILES, FileError, quoted_list, unknown_name
from taut.base.types import ArrayLike
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.sensing.sensing import Sensing
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import Reference
from taut.runtime.events import Event
from taut.scenarios.arms import read_arm
from taut.scenarios.checks import Places, refuse_misfits, refuse_unfit_results
from taut.scenarios.laws import read_control, read_law
from taut.scenarios.phases import TASK, read_phases
from taut.scenarios.plants import Plant, Spread, read_plant, read_spread
from taut.scenarios.reading import read
from taut.scenarios.references import read_reference
from taut.scenarios.sections import Outputs, PassFigure, RunSection, read_event, require_case, require_one
from taut.scenarios.toml import Table, read_toml, with_values

__all__ = [
    "Outputs",
    "PassFigure",
    "Scenario",
    "Trial",
    "built_in_scenarios",
    "load_scenario",
    "read_control_side_and_plant",
    "scenario_file",
]

OF_A_CASE: Final = ("arm", "laws", "phases", "control", "plant", "reference", "run", "event")
OF_ALL_CASES: Final = ("title", "outputs", "pass")
MAX_CASES: Final = 200


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


def built_in_scenarios() -> dict[str, Path]:
    """The scenarios that come with taut, by name."""
    folder = resources.files("taut.scenarios") / "files"
    try:
        found = [Path(str(item)) for item in folder.iterdir() if item.name.endswith(".toml")]
    except OSError as cause:  # no file descriptor left
        raise FileError(f"the built-in scenarios cannot be read: {cause.strerror}", name=str(folder)) from cause
    return {path.stem: path for path in sorted(found)}


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
    root = read_toml(path, f"scenario '{name}'")
    if values:
        root = with_values(root, values)
    root.only([*OF_A_CASE, *OF_ALL_CASES, "cases", "spread"])
    spread, changed = read_spread(root), _cases_of(root)
    outputs, figures = root.table("outputs"), root.tables("pass")
    parts, places = _experiment(root, path.parent, own_laws)
    others = {case: _experiment(each, path.parent, own_laws) for case, each in changed.items()}
    chances = [] if spread is None else list(spread.plants())
    names = [*others, *(case for case, _ in chances)]
    labels = places.labels or list(parts["laws"])
    common: dict[str, Any] = {
        "name": path.stem,
        "title": root.text("title", path.stem),
        "text": path.read_text(encoding="utf-8-sig"),
        "outputs": read(Outputs, outputs),
        "figures": tuple(read(PassFigure, table) for table in figures),
    }
    require_one(outputs, "shown", common["outputs"].shown, labels)
    require_case(outputs, "shown_case", common["outputs"].shown_case, names)
    for figure, table in zip(common["figures"], figures, strict=True):
        require_one(table, "law", figure.law, labels)
        require_case(table, "case", figure.case, names)
    cases = {case: Scenario(**fields, **common, cases={}) for case, (fields, _) in others.items()}
    for case, table in chances:
        plant = read_plant(table, parts["arm"], parts["rate"], path.parent)
        cases[case] = Scenario(**{**parts, "plant": plant}, **common, cases={})
    scenario = Scenario(**parts, **common, cases=cases, spread=spread)
    refuse_misfits(scenario, places)
    for case, (_, places_of_case) in others.items():
        refuse_misfits(cases[case], places_of_case)
    refuse_unfit_results(scenario, outputs, figures)
    return scenario


def _cases_of(root: Table) -> dict[str, Table]:
    """The root table of each case, by its name: the scenario with some of its keys replaced.

    Raises:
        ScenarioError: A case that replaces what belongs to all of them, or has a law of its own.
    """
    if "cases" not in root:
        return {}
    table = root.table("cases")
    if not table.values:
        raise table.error('needs one case at least: [cases."G = 100".plant.gears] with the keys that it replaces')
    if len(table.values) > MAX_CASES:
        raise table.error(f"has {len(table.values)} cases; at most {MAX_CASES} are read")
    whole, laws = root.without("cases"), root.get("laws")
    cases = {}
    for name in table.values:
        changes = table.table(name)
        changes.only(OF_A_CASE, elsewhere=dict.fromkeys(OF_ALL_CASES, ", which all cases share"))
        theirs = changes.get("laws")
        if not name.strip():
            raise table.error("has a case without a name")
        if isinstance(laws, dict) and isinstance(theirs, dict) and not theirs.keys() <= laws.keys():
            raise changes.error(
                f"changes the law {quoted_list([law for law in theirs if law not in laws])}, which [laws] does not "
                "have: every law runs in every case"
            )
        cases[name] = whole.replaced(changes.values, f"{root.where}: case '{name}'")
    return cases


def _experiment(root: Table, folder: Path, own_laws: Mapping[str, Law] | None) -> tuple[dict[str, Any], Places]:
    """The fields of a scenario that say what is run, and the tables that they came from."""
    arm = read_arm(root.table("arm", required=True), folder)
    task = root.tables("phases")
    _refuse_beside_task(root, task, own_laws)
    section = root.table("laws", required=own_laws is None and not task)
    labels = [TASK] if task else list(section.values)
    laws: dict[str, Law] = dict(own_laws or {})
    task_law: dict[str, Law | Task] = {}
    if task:
        law_places = {TASK: task[0]}
    elif own_laws is None:
        if not labels:
            raise section.error("needs one law at least: [laws.PID] with law = 'PID' and its gains")
        law_places = {label: section.table(label) for label in labels}
        laws = {label: read_law(table) for label, table in law_places.items()}
    else:
        law_places = {label: Table(f"--law {label}:", "", {}) for label in own_laws}
    control, run, events = root.table("control"), root.table("run", required=True), root.tables("event")
    rate, sensing, limits = read_control(control, arm)
    plant = read_plant(root.table("plant", required=True), arm, rate, folder)
    if task:
        task_law = {TASK: read_phases(root, task, arm, plant.arm.home, folder)}
    reference = root.table("reference")
    fields = {
        "source": root.where,
        "arm": arm,
        "laws": task_law or laws,
        "rate": rate,
        "sensing": sensing,
        "limits": limits,
        "plant": plant,
        "reference": read_reference(reference, arm, plant.arm.home, folder, laws),
        "events": tuple(read_event(table) for table in events),
        **read(RunSection, run).values(plant.arm),
    }
    places = Places(
        labels=labels,
        laws=law_places,
        control=control,
        plant=root.table("plant"),
        reference=reference,
        run=run,
        events=events,
    )
    return fields, places


def read_control_side_and_plant(path: Path) -> dict[str, Any]:
    """arm, plant, rate and sensing of a file with [arm], [plant] and [control], such as a scenario.

    Raises:
        ScenarioError: A section breaks the schema.
        FileError: The file cannot be read.
    """
    root = read_toml(path, f"plant '{path}'")
    arm = read_arm(root.table("arm", required=True), path.parent)
    rate, sensing, _ = read_control(root.table("control"), arm)
    plant = read_plant(root.table("plant", required=True), arm, rate, path.parent)
    return {"arm": arm, "plant": plant, "rate": rate, "sensing": sensing}


def _refuse_beside_task(root: Table, task: list[Table], own_laws: Mapping[str, Law] | None) -> None:
    """Each phase has its law and its reference."""
    if not task:
        return
    if own_laws is not None:
        raise root.error("has [[phases]], each with a law of its own, which --law cannot take the place of")
    for name in ("laws", "reference"):
        if name in root:
            raise root.error(f"has [[phases]], each with its law and its reference; leave [{name}] out")


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
    _refuse_other_files(path)
    if name.endswith(".toml") or "/" in name or "\\" in name:
        return path
    hint = "or give the path of a .toml file"
    try:
        if Path(f"{name}.toml").is_file():
            hint = f"or mean the file {name}.toml"
    except OSError:  # a name that is too long for a file
        pass
    raise unknown_name("taut", "scenario", name, known, hint=hint)


def _refuse_other_files(path: Path) -> None:
    """A file of another kind is refused by its kind, not that no scenario has its name."""
    if os.path.isdir(path):  # noqa: PTH112  (long names)
        raise FileError(f"'{path}' is a folder; name a scenario in it, a .toml file", name=str(path))
    if path.suffix.lower() == ".toml" or not os.path.isfile(path):  # noqa: PTH113
        return
    if path.suffix.lower() in MODEL_FILES:
        raise FileError(
            f"'{path}' is a robot model, which taut check reads; a scenario is a .toml file", name=str(path)
        )
    raise FileError(f"'{path}' is no scenario; a scenario is a .toml file", name=str(path))
