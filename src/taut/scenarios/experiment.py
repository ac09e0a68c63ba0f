"""One experiment of a scenario: its sections, read, and checked together before anything runs."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from taut.base.errors import TautError
from taut.base.fields import Declared, Field, Plain, Whole
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.tasks.feed import feed_of
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import Reference
from taut.controller import compile
from taut.loop import check_fit, duration_of_ticks, state_at_start
from taut.maths.snapshot import snapshot
from taut.runtime.events import Event, Schedule
from taut.scenarios.arms import read_arm
from taut.scenarios.laws import read_control, read_law
from taut.scenarios.plants import Plant, read_plant
from taut.scenarios.reading import Table, read
from taut.scenarios.references import TASK, read_phases, read_reference

__all__ = ["read_control_side_and_plant", "read_experiment"]

MAX_RUN_TICKS: Final = 10_000_000  # of a run, which keeps every one: gigabytes
GLANCE: Final = 200  # ticks of a reference that are looked at before a run


class RunSection(Declared):
    """[run]: how long each run takes, from where, and with which noise."""

    duration: Field = Field(unit="s", above=0.0)
    seed: Whole = Whole(0)  # of the noise
    q0: Plain[Any] = Plain(default=None)  # positions at the start, or "home"; the plant's home if left out
    v0: Plain[Any] = Plain(default=None)  # velocities at the start; at rest if left out


def read_control_side_and_plant(root: Table) -> dict[str, Any]:
    """arm, plant, rate, sensing and limits of a file with [arm], [plant] and [control].

    Raises:
        ScenarioError: A section breaks the schema.
        FileError: The file cannot be read.
    """
    arm = read_arm(root.table("arm", required=True))
    rate, sensing, limits = read_control(root.table("control"), arm)
    plant = read_plant(root.table("plant", required=True), arm, rate)
    return {"arm": arm, "plant": plant, "rate": rate, "sensing": sensing, "limits": limits}


def read_experiment(root: Table, own_laws: Mapping[str, Law] | None) -> dict[str, Any]:
    """The fields of a scenario that state what is run.

    Args:
        root: The scenario, or one of its cases.
        own_laws: Laws that take the place of its own, by the place that they were loaded from.

    Raises:
        ScenarioError: The message names file, section and key.
    """
    out = read_control_side_and_plant(root)
    arm, plant, rate = out["arm"], out["plant"], out["rate"]
    laws, places = _laws(root, own_laws)
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
    sides = {label: _law_side(law, out, places[label], root.table("control")) for label, law in laws.items()}
    for side in sides.values():
        with root.table("plant").blamed():
            check_fit(side, plant)
        with table.blamed("kind"):
            _check_reference(side, reference, q, v)
    due = [_event(each, rate, duration, list(sides.values()), plant) for each in events]
    run_fields = {"duration": duration, "seed": run.seed, "q0": q0, "v0": run.v0}
    return {"source": root.where, "laws": laws, "reference": reference, "events": tuple(due), **out, **run_fields}


def _laws(root: Table, own_laws: Mapping[str, Law] | None) -> tuple[dict[str, Law | Task], dict[str, Table]]:
    """The laws by their labels, and the table that each comes from; none of a task, which is made with the plant."""
    if "phases" in root:
        if own_laws is not None:
            raise root.error("has [[phases]], each with a law of its own, which --law cannot take the place of")
        for name in ("laws", "reference"):
            if name in root:
                raise root.error(f"has [[phases]], each with its law and its reference; leave [{name}] out")
        return {}, {TASK: root}
    if own_laws is not None:
        return dict(own_laws), {label: Table(f"--law {label}:", "", {}) for label in own_laws}
    section = root.table("laws", required=True)
    if not section.values:
        raise section.error("needs one law at least: [laws.PID] with law = 'PID' and its gains")
    tables = {label: section.table(label) for label in section.values}
    return {label: read_law(table) for label, table in tables.items()}, tables


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


def _event(table: Table, rate: float, duration: float, sides: list[LawSide], plant: Plant) -> Event:
    """An event that sets parameters, or one that pushes, during the run and with each of the laws."""
    if "push" in table:
        table.only(("t", "push"))
        table.need("t")
        event: Event = read(Event.push, table.table("push"), blame="t", t=table.get("t"))
    else:
        event = read(Event, table)
    ticks = round(duration * rate) + 1
    for side in sides:
        with table.blamed("t"), table.table("push").blamed("of") if "push" in table else table.blamed("set"):
            Schedule(side, plant, {**side.parameters, **plant.parameters}, [event], ticks)
    return event
