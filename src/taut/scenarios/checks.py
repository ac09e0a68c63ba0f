"""What is right in each section of a scenario and does not fit together is refused before anything runs."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.angles import require_radians
from taut.arm.description import Arm
from taut.base.errors import TautError, quoted_list, unknown_name
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.side_by_side import SideBySide
from taut.control.tasks.task import Task
from taut.control.trajectories.force_reference import HybridMotion, Pressing, TaskForce, hybrid_kind
from taut.control.trajectories.reference import (
    Hold,
    JointMotion,
    Reference,
    Sample,
    Stream,
    Trajectory,
    sample_rows,
)
from taut.control.trajectories.samples import Chunk, TaskSamples
from taut.control.trajectories.task import Circle, Line, Screw
from taut.control.trajectories.task_reference import TaskMotion
from taut.controller import compile
from taut.loop import check_fit, duration_of_ticks, state_at_start
from taut.plant.rigid import RigidPlant
from taut.record.metrics import METRICS, names_that_need
from taut.runtime.events import Event, sorted_events
from taut.scenarios.references import FORCE_KINDS, JOINT_KINDS, TASK_KINDS
from taut.scenarios.toml import Table

if TYPE_CHECKING:
    from taut.scenarios.plants import Plant
    from taut.scenarios.scenario import PassFigure, Scenario

__all__ = ["Places", "refuse_misfits"]

MOST_TICKS: Final = 10_000_000  # of a run, which keeps every one: gigabytes
MOST_RUNS: Final = 8  # in one figure
GLANCES: Final = 200  # at a trajectory
ERRORS_OF: Final[Mapping[type[Sample], tuple[str, ...]]] = {
    JointMotion: names_that_need("set-point", "joint motion"),
    TaskMotion: names_that_need("task motion"),
    TaskForce: names_that_need("force"),
    hybrid_kind(TaskMotion): names_that_need("task motion", "press", "force"),
}
WHOSE: Final[Mapping[type[Sample], str]] = {
    JointMotion: "joints",
    TaskMotion: "the tool",
    hybrid_kind(TaskMotion): "a contact",
    TaskForce: "forces",
}


@dataclass(frozen=True, kw_only=True)
class Places:
    """The sections that a scenario came from, to name them in messages."""

    labels: list[str]  # of the laws in the file, which are others where a law of the user's own runs
    laws: Mapping[str, Table]
    control: Table
    plant: Table
    reference: Table
    run: Table
    events: Sequence[Table]


def refuse_misfits(scenario: Scenario, places: Places) -> None:
    """Check what concerns more than one table.

    Raises:
        ScenarioError: The message names file, section and key.
    """
    longest = MOST_TICKS / scenario.rate
    if scenario.duration > longest:
        raise places.run.error(
            f"must be <= {longest:g} [s] at {scenario.rate:g} Hz, as a run keeps every tick; got "
            f"{scenario.duration:g}",
            "duration",
        )
    with places.run.blamed():
        duration_of_ticks(scenario.duration, 1.0 / scenario.rate)
        state_at_start(scenario.plant.arm, scenario.q0, scenario.v0)
    for label, law in scenario.laws.items():
        _check_kind(scenario.reference, label, law, places.reference)
    with places.reference.blamed():
        _look_at_reference(scenario)
    for label, law in scenario.laws.items():
        side = _law_side(scenario, law, places.laws[label], places.control)
        with places.plant.blamed(_key_of_plant(side, scenario.plant)):
            check_fit(side, scenario.plant)
        for event, table in zip(scenario.events, places.events, strict=True):
            _check_event(scenario, event, side, table, label)


def refuse_unfit_results(scenario: Scenario, outputs: Table, figures: Sequence[Table]) -> None:
    """Check that files can be made, and that each number that is asked for will be there.

    Raises:
        ScenarioError: The message names file, section and key.
    """
    _check_files(scenario, outputs)
    places = scenario.cases or {"": scenario}
    for one in places.values():
        _check_window(scenario.outputs.window, outputs, one)
    if scenario.outputs.joint is not None:
        for one in places.values():
            _check_joint(scenario.outputs.joint, outputs, one.arm)
    for figure, table in zip(scenario.figures, figures, strict=True):
        for case, one in places.items():
            if figure.case in (None, case):
                _check_figure(figure, table, one)


def _look_at_reference(scenario: Scenario) -> None:
    """A trajectory may be right at its points and wrong in between: too fast for a float, say."""
    reference, arm = scenario.reference, scenario.arm
    if isinstance(reference, JointMotion):
        require_radians("q", np.asarray(reference.q), arm)
    elif isinstance(reference, Trajectory):
        rows = _glances(scenario, reference)
        if "q" in rows:
            require_radians("q", rows["q"], arm)


def _check_kind(reference: Reference, label: str, law: Law | Task, table: Table) -> None:
    """A reference is of the kind of sample that each law follows; a hold is of any kind."""
    given, wanted = _kind_of(reference), law.reference
    if isinstance(reference, Hold) or given is wanted:
        return
    kinds = {
        TaskMotion: list(TASK_KINDS),
        hybrid_kind(TaskMotion): list(TASK_KINDS),
        TaskForce: list(FORCE_KINDS),
    }.get(wanted, list(JOINT_KINDS))
    raise table.error(
        f"gives a {given.__name__}, and the law '{label}' follows a {wanted.__name__}; take one of "
        f"{quoted_list(['hold', *kinds], most=len(kinds) + 1)}",
        "kind",
    )


def _kind_of(reference: Reference) -> type[Sample]:
    """The kind of sample that a reference of a scenario gives."""
    if isinstance(reference, Chunk):
        return type(reference.samples[0])
    if isinstance(reference, TaskForce):
        return TaskForce
    if isinstance(reference, (HybridMotion, Pressing)):
        return hybrid_kind(TaskMotion)
    of_task = isinstance(reference, (TaskMotion, Line, Screw, Circle, TaskSamples, Stream))  # of a policy of the tool
    return TaskMotion if of_task else JointMotion


def _glances(scenario: Scenario, reference: Trajectory) -> Mapping[str, Float64Array]:
    """Rows of a trajectory, from start to end."""
    times = np.linspace(0.0, scenario.duration, GLANCES)
    with np.errstate(all="ignore"):
        return sample_rows(reference, times, _kind_of(reference), scenario.arm.n)


def _moves(scenario: Scenario) -> bool:
    """Whether the reference asks for more than one position, so that nothing settles."""
    reference = scenario.reference
    if isinstance(reference, Trajectory):
        rows = _glances(scenario, reference)
        return "q" in rows and bool(np.any(rows["q"] != rows["q"][0]) or np.any(rows["v"]))
    return isinstance(reference, JointMotion) and bool(np.any(reference.v))


def _check_figure(figure: PassFigure, table: Table, scenario: Scenario) -> None:
    """A pass figure is a number that the runs will have."""
    arm = scenario.arm
    law = scenario.laws.get(figure.law)  # another runs where it is of the user's own
    if figure.part is not None:
        law = _part(figure.part, figure.law, law, table)
    names, units = arm.joint_names, arm.units
    if figure.joint is not None:
        _check_joint(figure.joint, table, arm)
        if not METRICS[figure.metric].per_joint:
            raise table.error(f"'{figure.metric}' is of the tool; leave joint out", "metric")
    if law is not None:
        _check_kind_of_figure(figure, law, table)
    if figure.joint is None and METRICS[figure.metric].per_unit and len(set(units)) > 1:
        raise table.error(
            f"'{figure.metric}' has no one number for joints in rad and joints in m together; add joint, one "
            f"of {quoted_list(names, most=len(names))}",
            "metric",
        )
    _check_window(figure.window, table, scenario)
    if METRICS[figure.metric].needs == "set-point" and _moves(scenario):
        raise table.error(
            f"'{figure.metric}' is for a set-point, and the [reference] moves; take one of "
            f"{quoted_list([name for name, one in METRICS.items() if one.needs != 'set-point'])}",
            "metric",
        )


def _check_window(window: tuple[float, float] | None, table: Table, scenario: Scenario) -> None:
    if window is not None and window[1] > scenario.duration:
        raise table.error(f"must end with the run, at {scenario.duration:g} [s]; got {list(window)}", "window")


def _part(part: str, label: str, law: Law | Task | None, table: Table) -> Law | None:
    """One of laws side by side."""
    if law is None:
        return None
    if isinstance(law, Task):
        if part not in law.phases:
            with table.blamed("part"):
                raise unknown_name("the task", "phase", part, law.phases)
        return law.laws[part]
    if not isinstance(law, SideBySide):
        raise table.error(f"is for laws side by side, and '{label}' is one law; leave part out", "part")
    if part not in law.parts:
        with table.blamed("part"):
            raise unknown_name(f"the law '{label}'", "part", part, law.parts)
    return law.parts[part]


def _check_kind_of_figure(figure: PassFigure, law: Law | Task, table: Table) -> None:
    """Errors of joints are for laws that follow joints, of the task for those of the tool, of forces for theirs."""
    fitting = ERRORS_OF.get(law.reference)
    whose = next((kind for kind, names in ERRORS_OF.items() if figure.metric in names), None)
    if fitting is not None and whose is not None and figure.metric not in fitting:
        raise table.error(
            f"'{figure.metric}' is of {WHOSE[whose]}, and the law '{figure.law}' follows a "
            f"{law.reference.__name__}; take one of {quoted_list(fitting, most=len(fitting))}",
            "metric",
        )


def _check_joint(joint: str, table: Table, arm: Arm) -> None:
    if joint not in arm.joint_names:
        with table.blamed("joint"):
            raise unknown_name(f"arm '{arm.name}'", "joint", joint, arm.joint_names)


def _law_side(scenario: Scenario, law: Law | Task, place: Table, control: Table) -> LawSide:
    """The law with what surrounds it, tried once on plain numbers."""
    try:
        return compile(
            law,
            scenario.arm,
            rate=scenario.rate,
            sensing=scenario.sensing,
            limits=scenario.limits,
            adds=scenario.plant.adds,
            engine="float",
        ).side
    except TautError as cause:
        head, _, last = (cause.name or "").partition(".")
        # A torque limit for a command that is no torque, a filter of what the law does not use.
        key = {"limits": "limits", "sensing": last}.get(head)
        with (place if key is None else control).blamed(key or ""):
            raise


def _key_of_plant(side: LawSide, plant: Plant) -> str:
    """The key to blame if a law and the plant do not fit."""
    if side.arm.units != plant.arm.units or side.arm.joint_names != plant.arm.joint_names:
        return "model"
    return "takes" if isinstance(plant, RigidPlant) and side.probe.kind != plant.takes else "kind"


def _check_event(scenario: Scenario, event: Event, side: LawSide, table: Table, label: str) -> None:
    """An event acts during the run, on parameters that there are with each of the laws."""
    with table.blamed("t"):
        sorted_events([event], scenario.rate, round(scenario.duration * scenario.rate) + 1)
    plant = scenario.plant
    for path, value in event.set.items():
        with table.blamed("set"):
            if path in side.parameters:
                side.checked_parameter(path, value)
            elif path in plant.parameters:
                plant.checked_parameter(path, value)
            else:
                whose = "the loop" if len(scenario.laws) == 1 else f"the loop of the law '{label}'"
                refusal = unknown_name(whose, "parameter", path, [*side.parameters, *plant.parameters])
                raise table.error(f": {refusal}", "set")


def _parts(law: Law | Task | None) -> int:
    """How many lines a law makes in a figure."""
    return len(law.parts) if isinstance(law, SideBySide) else 1


def _check_files(scenario: Scenario, table: Table) -> None:
    """Files that could not be made after the run."""
    wanted = scenario.outputs
    runs = sum(_parts(one.laws.get(trial.law)) for trial, one in scenario.trials.items())
    if wanted.plot is not None and scenario.spread is None and runs > MOST_RUNS:
        what = "laws, counted in each case" if scenario.cases else "laws"
        raise table.error(f"draws at most {MOST_RUNS} {what}; got {runs}; leave it out, or some of the laws", "plot")
    if wanted.video is not None and wanted.video.endswith(".mp4") and shutil.which("ffmpeg") is None:
        raise table.error(
            f"'{wanted.video}' needs the program ffmpeg, which is not on the PATH; install it, or write a .gif",
            "video",
        )
