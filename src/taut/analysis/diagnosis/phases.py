"""A task looked at phase by phase: each visit by what its phase was asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.analysis.diagnosis.finding import Finding, Number
from taut.record.run import Run

__all__ = ["SHORT", "SHORT_TIME", "Judged", "of_phases"]

SHORT: Final = 64  # ticks under which most tests have nothing to go by
SHORT_TIME: Final = 0.2  # [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """What the tests of a diagnosis say of a run of one law, or of the phases of a task together."""

    found: tuple[Finding, ...]
    notes: tuple[str, ...]
    looked_at: Mapping[str, Number]
    model: str


def of_phases(run: Run, judged: Callable[[Run], Judged]) -> Judged:
    """Judge each visit to a phase by itself, and put together what was found.

    What was found in several phases is told once, of the phase whose feedback it explains most, and names the others.
    A phase that begins with a torque near the last one of the phase before does not jump. Phases that are too short
    are left out, and a note says so.
    """
    found: list[Finding] = []
    notes: list[str] = []
    looked_at: dict[str, Number] = {}
    models: list[str] = []
    visits: dict[str, int] = {}
    for window in run.phases:
        visit = visits[window.name] = visits.get(window.name, -1) + 1
        label = f"phase '{window.name}'" + (f", visit {visit + 1}" if visit else "")
        own = run.phase(window.name, visit)
        if len(own) < SHORT or len(own) < SHORT_TIME * run.rate:
            notes.append(f"anything in {label}, for {len(own) / run.rate:.3g} s are too short")
            continue
        told = judged(own)
        steps = np.abs(run.command[window.first] - run.command[max(window.first - 1, 0)])
        found += [
            dataclasses.replace(each, phase=label)
            for each in told.found
            if window.first == 0 or _new(each, own, steps)
        ]
        notes += [f"in {label}, {note}" for note in told.notes]
        looked_at |= {f"{label}: {name}": number for name, number in told.looked_at.items()}
        models.append(told.model)
    words = ", ".join(dict.fromkeys(models)) or "none was needed"
    return Judged(found=_once(found), notes=tuple(notes), looked_at=looked_at, model=words)


def _new(each: Finding, run: Run, steps: np.ndarray[tuple[int], np.dtype[np.float64]]) -> bool:
    """Whether what is found at the start of a later phase was not there before: half of a jump is in the command."""
    if each.name != "jumps at start" or each.joint is None:
        return True
    return bool(steps[run.joint_names.index(each.joint)] >= 0.5 * abs(each.evidence["jump"].value))


def _once(found: list[Finding]) -> tuple[Finding, ...]:
    """Findings of one name and term once, with all phases that they are of."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for each in found:
        groups.setdefault((each.name, each.term), []).append(each)
    out = []
    for group in groups.values():
        first = max(group, key=lambda each: each.share)
        others = [str(each.phase) for each in group if each is not first]
        also = f"{first.phase}, also in {', '.join(others)}" if others else first.phase
        out.append(dataclasses.replace(first, phase=also))
    return tuple(out)
