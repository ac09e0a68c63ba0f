"""A sweep of a scenario with one of its laws, and its samples as scenarios of their own."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.analysis.sweeps.plan import REF, STATE, Variation, changed_reference, reference_fields
from taut.analysis.sweeps.sweep import Sweep, sweep_with
from taut.base.errors import TautError, UsageError
from taut.base.paths import subtree
from taut.base.result import Content, Result
from taut.control.law import Law
from taut.control.tasks.task import Task
from taut.loop import Loop, ModelPlant, state_at_start
from taut.record.log.files import checked_target, written_aside
from taut.record.report import report
from taut.scenarios.references import POSITIONS
from taut.scenarios.run import value_of
from taut.scenarios.scenario import PassFigure, Scenario, load_scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE_KEYS: Final = ("model", "scene", "file")  # of a scenario, whose values may be paths from its folder
WORST: Final = "worst.toml"


@dataclass(frozen=True, kw_only=True, eq=False)
class ScenarioSweep(Result):
    """A sweep of a scenario, and the files that were made of it."""

    found: Sweep
    outputs: Mapping[str, Path]
    skipped: Mapping[str, str]  # what could not be made, and why
    repeat: str = ""  # the command that runs the worst case
    pictures: Mapping[str, Figure] = field(default_factory=dict)  # that are drawn

    def content(self) -> Content:
        """Of the sweep, with its files."""
        content = self.found.content()
        notes = [f"{kind:10} {path}" for kind, path in self.outputs.items()]
        faults = [*content.faults, *(f"no {kind}: {reason}" for kind, reason in self.skipped.items())]
        texts = {"Worst case": self.outputs["worst"].read_text(encoding="utf-8")} if "worst" in self.outputs else {}
        again = [f"{'run it':10} {self.repeat}"] if self.repeat and "worst" in self.outputs else []
        drawn = {name: partial(_same, figure) for name, figure in self.pictures.items()}
        return replace(content, notes=[*content.notes, *notes, *again], faults=faults, texts=texts, figures=drawn)

    def json(self) -> dict[str, Any]:
        found, rate = self.found, self.found.success if self.found.samples else None
        return {
            "samples": found.samples,
            "complete": found.complete,
            "success": None if rate is None else {"rate": rate.value, "interval": list(rate.interval)},
            "worst": found.worst if found.samples else None,
            "outputs": {kind: str(path) for kind, path in self.outputs.items()},
            **super().json(),
        }


def _same(figure: Figure) -> Figure:
    return figure


def sweep_scenario(scenario: Scenario, name: str, vary: Mapping[str, Variation], **options: Any) -> Sweep:
    """`taut.sweep` of a scenario with one of its laws; a run succeeds that meets the law's pass criteria.

    Raises UsageError where the scenario has events during the run, and as `taut.sweep`, which takes the options.
    """
    law, where = scenario.laws[name], scenario.experiment.prepared(scenario.laws[name])
    if any(event.t > 0.0 for event in where.events):
        raise UsageError(f"scenario '{scenario.name}' has events, which a sweep does not have; use another scenario")
    ctrl, plant, known = where.controller(law), where.plant, dict(where.parameters)
    for event in where.events:
        known |= event.set
    given: dict[str, Any] = {"plant": plant, "ref": where.reference, "duration": where.duration}
    if ctrl.side.task is not None:
        del given["ref"]
    subject: Any = ctrl
    if isinstance(plant, ModelPlant):
        subject, given = Loop(ctrl, plant, given.get("ref"), duration=where.duration), {}
        for path, value in known.items():
            subject.parameters[path] = value
    else:
        for path in known.keys() & set(ctrl.parameters):
            ctrl.parameters[path] = known.pop(path)
        plant.set_parameters(known)
    bounds, figures = dict[str, tuple[float, float]](), {}
    for figure in _criteria(scenario, name):
        column = _column(figure)
        low, high = bounds.get(column, (-np.inf, np.inf))
        bounds[column] = max(low, figure.bounds[0]), min(high, figure.bounds[1])
        if column != figure.metric:
            figures[column] = partial(value_of, figure)
    return sweep_with(figures, subject, vary, **given, q0=where.q0, v0=where.v0, success=bounds, **options)


def _criteria(scenario: Scenario, law: str) -> list[PassFigure]:
    """The pass criteria of a law, but those of single cases."""
    return [each for each in scenario.figures if each.law == law and each.case is None]


def _column(figure: PassFigure) -> str:
    """What a sweep calls the number of a pass criterion: its metric, and of what."""
    words = [figure.metric]
    words += [f"of '{each}'" for each in (figure.joint, figure.part) if each is not None]
    words += [] if figure.span is None else ["from {:g} to {:g} s".format(*figure.span)]
    return " ".join(words)


# -------------------------------------------------------------------- files


def written(
    scenario: Scenario, law: str, found: Sweep, folder: Path, *, own: Mapping[str, Law] | None = None, more: str = ""
) -> ScenarioSweep:
    """The pictures, the report and the worst case of a sweep, written to its folder; `more` ends the command."""
    outputs, skipped, worst = dict[str, Path](), dict[str, str](), folder / WORST
    if found.samples and found.worst is not None:
        try:
            outputs["worst"] = write_sample(scenario, law, found, found.worst, worst, own)
        except TautError as cause:
            skipped["worst case"] = str(cause)
    pictures = {kind: draw() for kind, draw in found.content().figures.items()}
    for kind, figure in pictures.items():
        file = checked_target("picture", folder / f"{kind}.png", (".png",))
        with written_aside("picture", file) as aside:
            figure.savefig(aside, dpi=150)
        outputs[kind] = file
    made = ScenarioSweep(
        found=found, outputs=outputs, skipped=skipped, repeat=f"taut run {worst}{more}", pictures=pictures
    )
    return replace(made, outputs=outputs | {"report": report(made, folder / "report.html", repeat=made.repeat)})


def write_sample(
    scenario: Scenario, law: str, found: Sweep, sample: int, path: Path, own: Mapping[str, Law] | None = None
) -> Path:
    """A sample as a scenario: `taut run` of it is that run, to the last bit.

    Raises UsageError where no scenario holds it; it is read back and compared.
    """
    file = checked_target("scenario", path, (".toml",))
    if scenario.experiment.preparation is not None:
        raise UsageError(
            f"scenario '{scenario.name}' has [preparation], which would be made again for the values of the sample; "
            f"in Python, sweep.run({sample}) runs it",
            name="preparation",
        )
    drawn = found.plan.drawn(sample, 1)
    values = {target: each[0] for target, each in found.plan.values(drawn).items()}
    seed = int(found.plan.seeds(drawn)[0])
    with written_aside("scenario", file) as aside:
        aside.write_text(_text(_changed(scenario, law, found, sample, values, seed), own), encoding="utf-8")
        again = load_scenario(str(aside), own).experiment
        ref, new = found.plan.subject.ref, {k: v for k, v in values.items() if k in found.plan.subject.parameters}
        start = state_at_start(again.plant.arm, again.q0, again.v0)
        asked = [*_numbers(reference_fields(changed_reference(ref, values)))]
        asked += _numbers({name: values.get(name, getattr(found.plan.subject, name)) for name in STATE} | new)
        set_at_start = {path: value for event in again.events for path, value in event.set.items()}
        got = [*_numbers(reference_fields(again.reference)), *_numbers(dict(zip(STATE, start, strict=True)))]
        got += _numbers({path: np.broadcast_to(set_at_start[path], np.shape(new[path])) for path in new})
        if asked != got or again.seed != seed:
            raise UsageError(
                f"the numbers of sample {sample} do not all stand in a scenario as they are, as where a reference is "
                f"relative to home; in Python, sweep.run({sample}) runs it",
                name="ref",
            )
    return file


def _numbers(values: Mapping[str, Any]) -> list[tuple[str, bytes]]:
    return [(name, np.asarray(value, dtype=np.float64).tobytes()) for name, value in values.items()]


def _changed(
    scenario: Scenario, law: str, found: Sweep, sample: int, values: Mapping[str, Any], seed: int
) -> dict[str, Any]:
    """The file of a scenario with the values of a sample, its one law and that law's pass criteria."""
    whole = {key: value for key, value in scenario.root.values.items() if key not in ("cases", "spread")}
    file: dict[str, Any] = _absolute(whole, scenario.root.folder.resolve())
    known = dict[str, Any]()
    for event in scenario.experiment.events:
        known |= event.set
    known |= {path: value for path, value in values.items() if path in found.plan.subject.parameters}
    file["title"] = f"{scenario.title}: sample {sample} of a sweep"
    file["run"] = {**file["run"], "seed": seed, **{name: values[name].tolist() for name in STATE if name in values}}
    file["event"] = [{"t": 0.0, "set": {path: np.asarray(value).tolist() for path, value in known.items()}}]
    if not known:
        del file["event"]
    if not isinstance(scenario.laws[law], Task):
        file["laws"] = {law: file.get("laws", {}).get(law, {})}
    file["pass"] = [each for each in file.get("pass", []) if each["law"] == law and "case" not in each]
    file["outputs"] = {k: v for k, v in file.get("outputs", {}).items() if k not in ("shown", "shown_case")}
    new = {name: value.tolist() for name, value in subtree(values, REF.rstrip(".")).items()}
    if new:
        old = file["reference"]
        if old.get("relative_to_home") and new.keys() & set(POSITIONS):  # the sum with home would not be the same
            here = reference_fields(found.plan.subject.ref)
            old = old | {key: here[key].tolist() for key in POSITIONS if key in old} | {"relative_to_home": False}
        file["reference"] = old | new
    return file


def _absolute(value: Any, folder: Path, key: str = "") -> Any:
    """Values of a file that is moved: paths of files that are in its folder become absolute."""
    if isinstance(value, dict):
        return {name: _absolute(each, folder, name) for name, each in value.items()}
    if isinstance(value, list):
        return [_absolute(each, folder) for each in value]
    if key in FILE_KEYS and isinstance(value, str) and (folder / value).is_file():
        return str(folder / value)
    return value


def _text(file: Mapping[str, Any], own: Mapping[str, Law] | None) -> str:
    """A file as TOML; without its laws where the user's own takes their place."""
    root = {key: value for key, value in file.items() if key != "laws" or own is None}
    return "\n".join(_lines("", root)) + "\n"


def _lines(path: str, table: Mapping[str, Any]) -> Iterator[str]:
    """A table: its values, then the tables below it."""
    below = {key: value for key, value in table.items() if isinstance(value, dict)}
    many = {key: value for key, value in table.items() if _are_tables(value)}
    for key, value in table.items():
        if key not in below and key not in many:
            yield f"{_key(key)} = {_inline(value)}"
    for key, value in below.items():
        place = f"{path}{_key(key)}"
        if not value or not all(isinstance(each, dict) for each in value.values()):
            yield f"\n[{place}]"
        yield from _lines(f"{place}.", value)
    for key, values in many.items():
        for value in values:
            yield f"\n[[{path}{_key(key)}]]"
            for name, each in value.items():
                yield f"{_key(name)} = {_inline(each)}"


def _are_tables(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, dict) for each in value)


def _key(key: str) -> str:
    return key if key.isascii() and key.replace("_", "").replace("-", "").isalnum() else json.dumps(key)


def _inline(value: Any) -> str:
    """A value on one line; numbers with all their digits."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{_key(key)} = {_inline(each)}' for key, each in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, (str, bool)) else repr(value)
