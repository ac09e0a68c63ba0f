"""Runs of a part: the phases of a task, and the laws side by side."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.errors import RangeError, UsageError, unknown_name
from taut.base.types import Float64Array
from taut.control.tasks.phase import STOP
from taut.control.tasks.task import ENDED, NO_CONTACT
from taut.control.trajectories.compound import PhaseSample
from taut.record.info import Outcome

if TYPE_CHECKING:
    from taut.record.run import Run

WELL: Final = "until"
NONE: Final = ENDED[NO_CONTACT]


@dataclass(frozen=True, kw_only=True)
class PhaseWindow:
    """A stretch of a run in which one phase acted."""

    name: str  # of the phase; "stop" where the task has stopped
    first: int  # tick
    last: int  # tick
    start: float  # [s] time of the first tick
    end: float  # [s] time of the first tick of what followed; of its last one where nothing did
    ended: str | None  # "until", "unless", "timeout", "no contact"; None where nothing followed
    visit: int = 0  # which time that the phase acts, from 0 on

    def __str__(self) -> str:
        if self.name == STOP:
            return f"stopped at {self.start:.6g} s"
        if self.ended is None:
            return f"{self.name} still going on"
        how = {WELL: "", NONE: ": it needs contact and began without"}.get(self.ended, f" ({self.ended})")
        return f"{self.name} to {self.end:.6g} s{how}"


def windows(
    names: Sequence[str], phase: Float64Array, ended: Float64Array, t: Float64Array
) -> tuple[PhaseWindow, ...]:
    """The stretches of a run, in order, by (k,) the phase that acted and (k,) a code of what ended it, or 0."""
    if not len(t):
        return ()
    lasts = [int(k) for k in np.flatnonzero(ended)]
    if not lasts or lasts[-1] != len(t) - 1:
        lasts.append(len(t) - 1)
    out, first = [], 0
    visits: Counter[str] = Counter()
    for last in lasts:
        followed, name = last + 1 < len(t), names[int(phase[last])]
        out.append(
            PhaseWindow(
                name=name,
                first=first,
                last=last,
                start=float(t[first]),
                end=float(t[last + 1] if followed else t[last]),
                ended=ENDED.get(int(ended[last])),
                visit=visits[name],
            )
        )
        visits[name] += 1
        first = last + 1
    return tuple(out)


def outcome_with_phases(
    found: Sequence[PhaseWindow], outcome: Outcome, contact: Callable[[PhaseWindow], str]
) -> Outcome:
    """The outcome of a run with how each phase of its task ended, and what was measured at a start without contact.

    A task that stopped for another reason than its last `until` did not go to its end.
    """
    last = found[-1]
    before = found[-2] if last.name == STOP and len(found) > 1 else last
    wrong = outcome.kind == "completed" and before.ended not in (None, WELL)
    said = [f"{one} ({why})" if one.ended == NONE and (why := contact(one)) else str(one) for one in found]
    if not outcome.ok and last.ended is None and last.name != STOP:
        said[-1] = f"{last.name} until then"
    message = f"{outcome.message}; phases: {', '.join(said)}"
    if wrong:
        message = message.replace("completed", "stopped", 1)
    return dataclasses.replace(outcome, kind="stopped" if wrong else outcome.kind, message=message)


def phases_of(run: Run) -> tuple[PhaseWindow, ...]:
    """The stretches of a run of a task."""
    if not run.info.phases:
        raise UsageError("the run has no phases: its law is not a task, a list of taut.Phase", name="phases")
    return windows([*run.info.phases, STOP], run.extra["phase"], run.extra["phase_ended"], run.t)


def phase_of(run: Run, name: str, visit: int) -> Run:
    """The ticks of one phase as a run of its own, with what it followed as reference."""
    found, about = phases_of(run), run.info.phases
    if name not in (*about, STOP):
        raise unknown_name("the run", "phase", name, [*about, STOP])
    visits = [window for window in found if window.name == name]
    if not 0 <= visit < len(visits):
        acted = ", ".join(dict.fromkeys(window.name for window in found))
        raise RangeError(
            f"phase '{name}' acted {len(visits)} times in this run, so that there is no visit {visit}; what acted "
            f"is {acted}",
            name="visit",
            value=float(visit),
        )
    window = visits[visit]
    others = tuple(f"law.{other}." for other in (*about, STOP) if other != name)  # what they remember is old
    part = run.ticks(slice(window.first, window.last + 1))
    own = about.get(name)
    reference, info = part.reference, dataclasses.replace(run.info, phases={}, impedance=None)
    if own is not None:
        info = dataclasses.replace(info, tool=own.tool, impedance=own.impedance)
        if isinstance(reference, PhaseSample) and own.follows:
            reference = getattr(reference, own.follows)
    outcome = Outcome(kind="completed", message=str(window), tick=len(part) - 1)
    if not run.outcome.ok and window.name != STOP and window.ended is None:  # the run ended in it
        outcome = dataclasses.replace(run.outcome, tick=outcome.tick)
    extra = {key: values for key, values in part.extra.items() if not key.startswith(others)}
    return dataclasses.replace(part, extra=extra, reference=reference, outcome=outcome, info=info)


def part_of(run: Run, name: str) -> Run:
    """The joints, terms and reference of one of the laws side by side."""
    parts = run.info.parts
    if not parts:
        raise UsageError("the run has no parts: its law is not taut.SideBySide", name="part")
    if name not in parts:
        raise unknown_name("the run", "part", name, parts)
    part = parts[name]
    own = [run.joint_names.index(joint) for joint in part.joints]
    info = dataclasses.replace(run.info, parts={}, tool=part.tool, impedance=part.impedance)
    return dataclasses.replace(
        run,
        **{key: getattr(run, key)[:, own] for key in ("q", "v", "tau", "command")},
        terms={key: values[:, own] for key, values in run.terms.items()},
        extra={key: values for key, values in run.extra.items() if key == "F_ext" and part.impedance is not None},
        reference=getattr(run.reference, name),
        joint_names=tuple(run.joint_names[i] for i in own),
        units=tuple(run.units[i] for i in own),
        continuous=tuple(k for k, i in enumerate(own) if i in run.continuous),
        info=info,
        arm=None,
    )
