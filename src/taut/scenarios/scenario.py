"""Scenario: an experiment in one TOML file. Code never comes from a scenario: files name built-ins only."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.analysis.compare.truth import PlantChange
from taut.arm.description import Arm
from taut.base.checks import positive_scalar, rate_in_hertz
from taut.base.errors import MODEL_FILES, FileError, quoted_list, unknown_name
from taut.base.types import ArrayLike
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.sensing.sensing import Sensing
from taut.control.trajectories.reference import Reference
from taut.record.metrics import METRICS
from taut.runtime.events import Event
from taut.scenarios.cases import OF_A_CASE, Trial, cases_of
from taut.scenarios.fit import Places, refuse_misfits, refuse_unfit_results
from taut.scenarios.read_arm import read_arm
from taut.scenarios.read_laws import read_law, read_limits
from taut.scenarios.read_phases import TASK, read_phases
from taut.scenarios.read_plant import Plant, read_plant
from taut.scenarios.read_reference import read_reference
from taut.scenarios.read_sensing import SENSED, read_sensing
from taut.scenarios.spread import Spread, read_spread
from taut.scenarios.toml import Section, read_toml

__all__ = ["Outputs", "PassFigure", "Scenario", "built_in_scenarios", "load_scenario", "read_control_side_and_plant"]

SECTIONS: Final = (*OF_A_CASE, "title", "outputs", "pass", "cases", "spread")
SUFFIXES: Final = {
    "plot": (".png", ".pdf", ".svg"),
    "video": (".gif", ".mp4"),
    "log": (".mcap",),
    "csv": (".csv",),
}
MAX_RATE: Final = 1e6  # [Hz] of any controller that there is
MOST_BYTES: Final = 200  # of a file's name; systems take 255, and a file is written under a longer one first


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Files that a scenario makes; None for those that it does not make."""

    plot: str | None
    video: str | None
    log: str | None
    csv: str | None
    shown: Trial  # whose video, log and table are made
    columns: tuple[str, ...] | None  # metrics in the table and the plot; None for the usual ones
    joint: str | None  # whose numbers and motion these are; None for all joints together
    window: tuple[float, float] | None  # [s] of the run that the table is about; None for all of it


@dataclass(frozen=True, kw_only=True)
class PassFigure:
    """A bound on a metric that decides whether a scenario passes."""

    case: str | None  # None for every case
    law: str
    metric: str
    joint: str | None  # None for all joints together
    part: str | None  # of laws side by side, the one that it is about; None for the whole
    least: float
    most: float
    window: tuple[float, float] | None  # [s] of the run that it is about; None for all of it


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """An experiment: laws for one arm, against one plant, along one reference."""

    name: str
    source: str  # what messages call it
    title: str
    arm: Arm
    laws: Mapping[str, Law]
    rate: float  # [Hz]
    sensing: Sensing
    limits: Limits | None
    plant: Plant
    another_plant: Callable[[PlantChange], Plant]  # like it, and different in what is stated
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


def built_in_scenarios() -> dict[str, Path]:
    """The scenarios that come with taut, by name."""
    folder = resources.files("taut.scenarios") / "files"
    try:
        found = [Path(str(item)) for item in folder.iterdir() if item.name.endswith(".toml")]
    except OSError as cause:  # no file descriptor left
        raise FileError(f"the built-in scenarios cannot be read: {cause.strerror}", name=str(folder)) from cause
    return {path.stem: path for path in sorted(found)}


def load_scenario(name: str, own_laws: Mapping[str, Law] | None = None) -> Scenario:
    """A scenario by the name of a built-in one, or by the path of a file.

    Args:
        name: Name or path.
        own_laws: Laws that take the place of the scenario's own, by the place that they were loaded from.

    Raises:
        ScenarioError: The file breaks the schema, or its parts do not fit; the message names file, section and key.
        FileError: It cannot be read.
        UnknownNameError: There is no such scenario.
    """
    path = _found(name)
    source = f"scenario '{name}'"
    root = read_toml(path, source)
    root.only(*SECTIONS)
    spread = read_spread(root)
    changed = cases_of(root)
    title, outputs, figures = root.text("title", path.stem), root.section("outputs"), root.sections("pass")
    parts, places = _experiment(root, path.parent, own_laws)
    others = {case: _experiment(section, path.parent, own_laws) for case, section in changed.items()}
    chances = [] if spread is None else list(spread.plants())
    names = [*others, *(name for name, _ in chances)]
    laws = list(parts["laws"])
    common: dict[str, Any] = {
        "name": path.stem,
        "title": title,
        "text": path.read_text(encoding="utf-8-sig"),
        "outputs": _outputs(outputs, laws, places.labels, names),
        "figures": tuple(_figure(section, places.labels or laws, names) for section in figures),
    }
    cases = {case: Scenario(**fields, **common, cases={}) for case, (fields, _) in others.items()}
    for case, section in chances:
        plants = _plants(section, parts["arm"], parts["rate"], path.parent)
        cases[case] = Scenario(**{**parts, **plants}, **common, cases={})
    scenario = Scenario(**parts, **common, cases=cases, spread=spread)
    refuse_misfits(scenario, places)
    for case, (_, places_of_case) in others.items():
        refuse_misfits(cases[case], places_of_case)
    refuse_unfit_results(scenario, outputs, figures)
    return scenario


def _experiment(root: Section, folder: Path, own_laws: Mapping[str, Law] | None) -> tuple[dict[str, Any], Places]:
    """The fields of a scenario that say what is run, and the sections that they came from."""
    arm = read_arm(root.section("arm", required=True), folder)
    task = root.sections("phases")
    _refuse_beside_task(root, task, own_laws)
    laws_section = root.section("laws", required=own_laws is None and not task)
    labels = [TASK] if task else laws_section.left
    if task:
        law_places = {TASK: task[0]}
    elif own_laws is None:
        law_places = _law_sections(laws_section)
        laws = {label: read_law(section) for label, section in law_places.items()}
    else:
        law_places = {label: Section(f"--law {label}:", "", {}) for label in own_laws}
        laws = dict(own_laws)
    control, plant_section = root.section("control"), root.section("plant", required=True)
    reference_section, run = root.section("reference"), root.section("run", required=True)
    events = root.sections("event")
    rate, sensing, limits = _control(control, arm)
    plants = _plants(plant_section, arm, rate, folder)
    plant: Plant = plants["plant"]
    if task:
        laws = {TASK: read_phases(root, task, arm, plant.arm.home, folder)}
    fields = {
        "source": root.where,
        "arm": arm,
        "laws": laws,
        "rate": rate,
        "sensing": sensing,
        "limits": limits,
        **plants,
        "reference": read_reference(reference_section, arm, plant.arm.home, folder, laws),
        "events": tuple(_event(section) for section in events),
        **_run(run, plant.arm),
    }
    places = Places(
        labels=labels,
        laws=law_places,
        control=control,
        plant=plant_section,
        reference=reference_section,
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
    arm = read_arm(root.section("arm", required=True), path.parent)
    rate, sensing, _ = _control(root.section("control"), arm)
    plant = read_plant(root.section("plant", required=True), arm, rate, path.parent)
    return {"arm": arm, "plant": plant, "rate": rate, "sensing": sensing}


def _plants(section: Section, arm: Arm, rate: float, folder: Path) -> dict[str, Any]:
    """The plant of a scenario, and what makes others like it: the fields that [plant] states."""
    untouched = section.copy()

    def another(change: PlantChange) -> Plant:
        return read_plant(untouched.copy(), arm, rate, folder, change=change)

    return {"plant": read_plant(section, arm, rate, folder), "another_plant": another}


def _refuse_beside_task(root: Section, task: list[Section], own_laws: Mapping[str, Law] | None) -> None:
    """Each phase has its law and its reference."""
    if not task:
        return
    if own_laws is not None:
        raise root.error("has [[phases]], each with a law of its own, which --law cannot take the place of")
    for name in ("laws", "reference"):
        if name in root:
            raise root.error(f"has [[phases]], each with its law and its reference; leave [{name}] out")


def _found(name: str) -> Path:
    """The file of a scenario."""
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
    """A file of another kind is told what it is, not that no scenario has its name."""
    if os.path.isdir(path):  # noqa: PTH112  (long names)
        raise FileError(f"'{path}' is a folder; name a scenario in it, a .toml file", name=str(path))
    if path.suffix.lower() == ".toml" or not os.path.isfile(path):  # noqa: PTH113
        return
    if path.suffix.lower() in MODEL_FILES:
        raise FileError(
            f"'{path}' is a robot model, which taut check reads; a scenario is a .toml file", name=str(path)
        )
    raise FileError(f"'{path}' is no scenario; a scenario is a .toml file", name=str(path))


def _law_sections(section: Section) -> dict[str, Section]:
    if not section.left:
        raise section.error("needs one law at least: [laws.PID] with law = 'PID' and its gains")
    return {label: section.section(label) for label in section.left}


def _control(section: Section, arm: Arm) -> tuple[float, Sensing, Limits | None]:
    """Rate [Hz], sensing and limits."""
    rate = section.number("rate", 1000.0)
    with section.blamed():
        rate = rate_in_hertz(rate)
    if rate > MAX_RATE:
        raise section.error(f"rate must be <= {MAX_RATE:g} [Hz]; got {rate:g}")
    sensing = read_sensing(section, arm, rate)
    limits = read_limits(section, arm, rate)
    section.only(*SENSED)
    return rate, sensing, limits


def _run(section: Section, arm: Arm) -> dict[str, Any]:
    """The fields of a scenario that [run] states."""
    duration, seed = section.number("duration"), section.whole("seed", 0)
    q0, v0 = section.take("q0", None), section.numbers("v0", None)
    section.done()
    with section.blamed():
        duration = positive_scalar("duration", duration, unit="s")
    if isinstance(q0, str) and q0 != "home":
        raise section.error(f'q0 must be numbers, one per joint, or "home"; got {q0!r}')
    if seed < 0:
        raise section.error(f"seed must be a whole number >= 0; got {seed}")
    return {"duration": duration, "seed": seed, "q0": arm.home if q0 == "home" else q0, "v0": v0}


def _event(section: Section) -> Event:
    t, push = section.number("t"), section.section("push") if "push" in section else None
    section.take("push", None)
    if push is not None:
        if "set" in section:
            raise section.error("sets parameters or pushes; got both set and push; write two events")
        section.done()
        return _push(t, push, section)
    values = section.take("set")
    section.done()
    example = '{ "law.kp" = 150.0 }'
    if not isinstance(values, dict) or not values:
        raise section.error(f"set must be a table such as {example}; got {values!r}")
    for path, value in values.items():
        if isinstance(value, dict):
            raise section.error(f"set must have each path in quotes, such as {example}; got a table '{path}'")
    with section.blamed():
        return Event(t=t, set=values)


def _push(t: float, table: Section, section: Section) -> Event:
    """{ peak, duration, of }: a push at the time of the event, by the push of the plant's environment."""
    values = table.fields(("peak", "duration", "of"))
    of = values.get("of", "environment")
    if not isinstance(of, str):
        raise table.error(f'of must be the path of a push, such as "environment.push"; got {of!r}')
    with section.blamed("t"):
        Event.push(t=t)
    with table.blamed():
        if "duration" in values:
            positive_scalar("duration", values["duration"], unit="s")
        return Event.push(t=t, **values)


# -------------------------------------------------------------------- outputs and pass figures


def _outputs(section: Section, laws: list[str], labels: list[str], cases: list[str]) -> Outputs:
    """File names, and what is shown.

    Args:
        section: [outputs].
        laws: Labels of the laws that run.
        labels: Labels of the laws in the file, which are others where a law of the user's own runs.
        cases: Names of the cases.
    """
    shown = section.text("shown", None)
    if shown is not None and shown not in (labels or laws):
        raise section.error(f"shown must be one of the laws {quoted_list(labels or laws)}; got {shown!r}")
    case = _case(section, "shown_case", cases)
    columns = section.texts("columns", None, example='["rms_error", "stuck_time"]')
    with section.blamed("columns"):
        for name in columns or ():
            if name not in METRICS:
                raise unknown_name("a run", "metric", name, METRICS)
    if columns is not None and not 0 < len(columns) == len(set(columns)):
        raise section.error(f"columns must name one metric at least, each once; got {columns}")
    files = {}
    for word, suffixes in SUFFIXES.items():
        name = files[word] = section.text(word, None)
        if name is None:
            continue
        if Path(name).name != name or Path(name).suffix not in suffixes or not name.isprintable():
            raise section.error(f"{word} must be a file name ending in {' or '.join(suffixes)}; got {name!r}")
        if len(name.encode()) > MOST_BYTES:
            raise section.error(f"{word} must be a file name of at most {MOST_BYTES} bytes; got {len(name.encode())}")
    joint, window = section.text("joint", None), _window(section)
    section.done()
    return Outputs(
        window=window,
        shown=Trial(case or (cases[-1] if cases else ""), shown if shown in laws else laws[-1]),
        columns=None if columns is None else tuple(columns),
        joint=joint,
        **files,
    )


def _case(section: Section, key: str, cases: list[str]) -> str | None:
    """The name of a case; None if the key is not there."""
    case = section.text(key, None)
    if case is None or case in cases:
        return case  # type: ignore[no-any-return]
    if not cases:
        raise section.error(f"{key} is for a scenario with cases, [cases.{case!r}]; leave it out")
    raise section.error(f"{key} must be one of {quoted_list(cases)}; got {case!r}")


def _figure(section: Section, labels: list[str], cases: list[str]) -> PassFigure:
    case = _case(section, "case", cases)
    label, metric, joint = section.text("law"), section.text("metric"), section.text("joint", None)
    part = section.text("part", None)
    least, most, window = section.number("min", -np.inf), section.number("max", np.inf), _window(section)
    section.done()
    if label not in labels:
        raise section.error(f"law must be one of {quoted_list(labels)}; got {label!r}")
    with section.blamed("metric"):
        if metric not in METRICS:
            raise unknown_name("a run", "metric", metric, METRICS)
    if np.isinf(least) and np.isinf(most):
        raise section.error("needs min, max or both")
    if least > most:
        raise section.error(f"min must be <= max, which is {most:g}; got {least:g}")
    return PassFigure(
        case=case,
        law=label,
        metric=metric,
        joint=joint,
        part=part,
        least=float(least),
        most=float(most),
        window=window,
    )


def _window(section: Section) -> tuple[float, float] | None:
    """window = [start, end] of the run [s]."""
    given = section.numbers("window", None)
    if given is None:
        return None
    if not isinstance(given, list) or len(given) != 2 or not 0.0 <= given[0] < given[1]:
        raise section.error(f"window must be [start, end] with 0 <= start < end [s]; got {given}")
    return float(given[0]), float(given[1])
