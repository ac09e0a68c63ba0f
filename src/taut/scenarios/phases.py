"""The task of a scenario: [[phases]], each with its law, what it follows and its guards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import TautError, quoted_list
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.control.tasks.guards import Guard, GuardView, contact, lasting, moved, no_contact, settled
from taut.control.tasks.phase import Phase, PhaseReference
from taut.control.tasks.task import Task
from taut.control.trajectories.force_reference import hybrid_kind, pressing
from taut.control.trajectories.reference import Reference
from taut.control.trajectories.task import Line, Steady
from taut.control.trajectories.task_reference import TaskMotion
from taut.scenarios.laws import read_law
from taut.scenarios.reading import arguments, read
from taut.scenarios.references import FORCES, forces_of, read_reference
from taut.scenarios.toml import Table
from taut.trace.pose import Pose

__all__ = ["TASK", "read_phases"]

TASK: Final = "task"  # what the law of a task is called in tables and in [[pass]]
OF_PHASE: Final = ("law", "reference", "until", "unless")
OF_CONTACT: Final = ("direction", "frame")
OF_HYBRID: Final = hybrid_kind(TaskMotion)

Condition = Callable[[GuardView], Any]


def read_phases(root: Table, tables: list[Table], arm: Arm, home: Float64Array, folder: Path) -> Task:
    """The law of a task.

    Args:
        root: The scenario, which an error of the phases together is about.
        tables: [[phases]], in their order.
        arm: The arm that follows them.
        home: (n,) what "home" means in a reference [rad | m].
        folder: Where files of samples lie.
    """
    phases = [_phase(table, arm, home, folder) for table in tables]
    try:
        return Task.of(phases)
    except TautError as cause:
        raise root.error(f"[[phases]]: {cause}") from cause


def _phase(table: Table, arm: Arm, home: Float64Array, folder: Path) -> Phase:
    law = read_law(table.table("law", required=True))
    reference = _reference(table.table("reference"), law, arm, home, folder)
    until, unless = (_guard(table.table(word)) if word in table else None for word in ("until", "unless"))
    made: Phase = read(Phase, table, others=OF_PHASE, law=law, reference=reference, until=until, unless=unless)
    return made


# -------------------------------------------------------------------- what it follows


def _reference(table: Table, law: Law, arm: Arm, home: Float64Array, folder: Path) -> PhaseReference:
    """A motion from where the phase begins, or a reference as in [reference]."""
    kind = table.get("kind")
    if kind in MOTIONS:
        return _from_begin(table, MOTIONS[kind], law)
    return read_reference(table, arm, home, folder, {TASK: law}) if table.values else None


def _from_begin(table: Table, motion: Callable[..., Any], law: Law) -> PhaseReference:
    """A motion of the tool from where the phase begins, and what it presses with."""
    forces, own = forces_of(table), table.without(*FORCES)
    made = read(motion, own, others=["kind"], T0=Pose(np.zeros(3)))  # tried at once, so that an error names its key
    with table.blamed():
        _with_forces(made, law, forces)
    _require_tool(table, law, forces)
    values = own.without("kind").values
    return lambda x: _with_forces(motion(T0=x.T(law.controlled_frame), **values), law, forces)


def _by(T0: Pose, *, p: ArrayLike, duration: float | None = None) -> TaskMotion | Line:
    """A displacement from where the phase begins: in a straight line within a duration, or at once."""
    T1 = Pose(T0.p + Pose(p).p, R=T0.R)
    return TaskMotion(pose=T1) if duration is None else Line(T0=T0, T1=T1, duration=duration)


MOTIONS: Final[Mapping[str, Callable[..., Any]]] = {"steady": Steady, "by": _by}


def _with_forces(motion: TaskMotion | Line | Steady, law: Law, forces: Mapping[str, Any]) -> Reference:
    """A motion as the law follows it: that of a hybrid law has forces, if only none."""
    return pressing(motion, **forces) if forces or law.reference is OF_HYBRID else motion


def _require_tool(table: Table, law: Law, forces: Mapping[str, Any]) -> None:
    if law.reference is TaskMotion and forces:
        raise table.error(f"{next(iter(forces))} is for a hybrid law, and {type(law).__name__} applies no forces")
    if law.reference not in (TaskMotion, OF_HYBRID):
        raise table.error(
            f"kind is for a law that follows the tool, and {type(law).__name__} follows a {law.reference.described()}"
        )


# -------------------------------------------------------------------- its guards


def _guard(table: Table) -> Guard:
    """One condition or several, all of which have to hold; `ticks` for how many ticks on end."""
    words = [word for word in CONDITIONS if word in table]
    table.only((*CONDITIONS, "ticks", *OF_CONTACT))
    if not words:
        known = quoted_list(CONDITIONS, most=len(CONDITIONS))
        raise table.error(f"needs a condition, such as {{ contact = 2.0 }}: one or more of {known}")
    axes = {name: table.get(name) for name in OF_CONTACT if name in table}
    if axes and not {"contact", "no_contact"} & set(words):
        raise table.error("direction and frame are for contact and no_contact; leave them out")
    conditions = [CONDITIONS[word](table, word, axes) for word in words]

    def guard(x: GuardView) -> Any:
        holds: Any = np.bool_(True)
        for condition in conditions:
            holds = condition(x) & holds
        return holds

    with table.blamed():
        return lasting(guard, ticks=table.get("ticks")) if "ticks" in table else guard


def _contact(table: Table, word: str, axes: Mapping[str, Any]) -> Condition:
    force, function = table.number(word), contact if word == "contact" else no_contact
    return lambda x: function(x, force, **axes)


def _moved(table: Table, word: str, axes: Mapping[str, Any]) -> Condition:  # noqa: ARG001
    distance = table.number(word)
    return lambda x: moved(x, distance)


def _elapsed(table: Table, word: str, axes: Mapping[str, Any]) -> Condition:  # noqa: ARG001
    duration = table.number(word)
    return lambda x: x.elapsed >= duration


def _settled(table: Table, word: str, axes: Mapping[str, Any]) -> Condition:  # noqa: ARG001
    below = table.table(word)
    below.only(name for name in arguments(settled) if name != "x")
    return lambda x: settled(x, **below.values)


CONDITIONS: Final[Mapping[str, Callable[[Table, str, Mapping[str, Any]], Condition]]] = {
    "contact": _contact,
    "no_contact": _contact,
    "moved": _moved,
    "elapsed": _elapsed,
    "settled": _settled,
}
