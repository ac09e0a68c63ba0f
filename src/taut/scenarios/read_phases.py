"""The task of a scenario: [[phases]], each with its law, what it follows and its guards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import TautError, quoted_list
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.tasks.guards import Guard, GuardView, contact, lasting, moved, no_contact, settled
from taut.control.tasks.phase import Phase, PhaseReference
from taut.control.tasks.task import Task
from taut.control.trajectories.force_reference import hybrid_kind, pressing
from taut.control.trajectories.reference import Reference
from taut.control.trajectories.task import Line, Steady
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.scenarios.read_laws import read_law
from taut.scenarios.read_reference import read_forces, read_reference
from taut.scenarios.toml import Section
from taut.trace.pose import Pose

__all__ = ["TASK", "read_phases"]

TASK: Final = "task"  # what the law of a task is called in tables and in [[pass]]
WORDS: Final = ("contact", "no_contact", "moved", "elapsed", "settled")
OF_CONTACT: Final = ("direction", "frame")
OF_HYBRID: Final = hybrid_kind(TaskMotion)
OF_SETTLED: Final = ("q", "position", "rotation", "v")

Condition = Callable[[GuardView], Any]


def read_phases(root: Section, sections: list[Section], arm: Arm, home: Float64Array, folder: Path) -> Task:
    """The task of a scenario.

    Args:
        root: The scenario, which an error of the phases together is about.
        sections: [[phases]], in their order.
        arm: The arm that follows them.
        home: (n,) what "home" means in a reference [rad | m].
        folder: Where files of samples lie.
    """
    phases = [_phase(section, arm, home, folder) for section in sections]
    try:
        return Task.of(phases)
    except TautError as cause:
        raise root.error(f"[[phases]]: {cause}") from cause


def _phase(section: Section, arm: Arm, home: Float64Array, folder: Path) -> Phase:
    law = read_law(section.section("law", required=True))
    reference = _reference(section.section("reference"), law, arm, home, folder)
    until, unless = (_guard(section.section(word)) if word in section else None for word in ("until", "unless"))
    values = section.fields(("name", "timeout", "otherwise", "then", "contact"))
    with section.blamed():
        return Phase(law, reference, until=until, unless=unless, **values)


# -------------------------------------------------------------------- what it follows


def _reference(section: Section, law: Law, arm: Arm, home: Float64Array, folder: Path) -> PhaseReference:
    """A motion from where the phase begins, or a reference as in [reference]."""
    kind = section.peek("kind")
    if kind == "steady":
        return _steady(section, law)
    if kind == "by":
        return _by(section, law)
    return read_reference(section, arm, home, folder, {TASK: law}) if section.left else None


def _steady(section: Section, law: Law) -> PhaseReference:
    forces = read_forces(section)
    values = section.fields(("kind", "velocity", "angular", "ramp"))
    values.pop("kind")
    with section.blamed():
        _with_forces(Steady(T0=Pose(np.zeros(3)), **values), law, forces)
    _require_tool(section, law, forces)
    frame = law.controlled_frame
    return lambda x: _with_forces(Steady(T0=x.T(frame), **values), law, forces)


def _by(section: Section, law: Law) -> PhaseReference:
    """A way from where the phase begins: in a straight line within a duration, or at once."""
    forces = read_forces(section)
    values = section.fields(("kind", "p", "duration"), ("kind", "p"))
    way, duration = values["p"], values.get("duration")
    start = Pose(np.zeros(3))
    with section.blamed("p"):
        there = Pose(way)
    if duration is not None:
        with section.blamed("duration"):
            Line(T0=start, T1=there, duration=duration)
    with section.blamed():
        _with_forces(TaskMotion(pose=start), law, forces)
    _require_tool(section, law, forces)
    frame = law.controlled_frame

    def reference(x: Snapshot) -> Reference:
        T = x.T(frame)
        T1 = Pose(T.p + there.p, R=T.R)
        motion = TaskMotion(pose=T1) if duration is None else Line(T0=T, T1=T1, duration=duration)
        return _with_forces(motion, law, forces)

    return reference


def _with_forces(motion: TaskMotion | Line | Steady, law: Law, forces: Mapping[str, Any]) -> Reference:
    """A motion as the law follows it: that of a hybrid law has forces, if only none."""
    return pressing(motion, **forces) if forces or law.reference is OF_HYBRID else motion


def _require_tool(section: Section, law: Law, forces: Mapping[str, Any]) -> None:
    if law.reference is TaskMotion and forces:
        raise section.error(f"{next(iter(forces))} is for a hybrid law, and {type(law).__name__} applies no forces")
    if law.reference not in (TaskMotion, OF_HYBRID):
        raise section.error(
            f"kind is for a law that follows the tool, and {type(law).__name__} follows a {law.reference.described()}"
        )


# -------------------------------------------------------------------- its guards


def _guard(section: Section) -> Guard:
    """One condition or several, all of which have to hold; `ticks` for how many ticks on end."""
    ticks = section.whole("ticks", None)
    conditions = [_CONDITIONS[word](section) for word in WORDS if word in section]
    section.only(*WORDS, *OF_CONTACT)
    if not conditions:
        known = quoted_list(WORDS, most=len(WORDS))
        raise section.error(f"needs a condition, such as {{ contact = 2.0 }}: one or more of {known}")
    if set(OF_CONTACT) & set(section.left):
        raise section.error("direction and frame are for contact and no_contact; leave them out")

    def guard(x: GuardView) -> Any:
        holds: Any = np.bool_(True)
        for condition in conditions:
            holds = condition(x) & holds
        return holds

    with section.blamed():
        return guard if ticks is None else lasting(guard, ticks=ticks)


def _contact(word: str, function: Callable[..., Any]) -> Callable[[Section], Condition]:
    def read(section: Section) -> Condition:
        force = section.number(word)
        axes: Mapping[str, Any] = {name: section.take(name) for name in OF_CONTACT if name in section}
        return lambda x: function(x, force, **axes)

    return read


def _moved(section: Section) -> Condition:
    distance = section.number("moved")
    return lambda x: moved(x, distance)


def _elapsed(section: Section) -> Condition:
    duration = section.number("elapsed")
    return lambda x: x.elapsed >= duration


def _settled(section: Section) -> Condition:
    tolerances = section.section("settled").fields(OF_SETTLED)
    return lambda x: settled(x, **tolerances)


_CONDITIONS: Final[Mapping[str, Callable[[Section], Condition]]] = {
    "contact": _contact("contact", contact),
    "no_contact": _contact("no_contact", no_contact),
    "moved": _moved,
    "elapsed": _elapsed,
    "settled": _settled,
}
