"""taut.doctor: what went wrong in a recorded run, by a table of checks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.analysis.diagnosis.check import NEEDS, Check, ExaminedRun, Finding
from taut.analysis.diagnosis.checks import CHECKS, SHARED
from taut.analysis.diagnosis.model import ArmModel
from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.result import Content, Result, Table
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOO_FAST: Final = 1e3  # [rad/s | m/s] no arm is as fast
BEYOND_LIMITS: Final = 10.0  # times the limits of torque and speed: the loop ran away


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis(Result):
    """What went wrong in a run.

    Args:
        findings: Causes before their consequences; of each, those first that explain most of the feedback effort.
        problems: Why the run could not be examined as a whole: a fault, gaps, too few ticks.
        notes: Checks that were left out, with the reason.
    """

    findings: tuple[Finding, ...]
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def healthy(self) -> bool:
        """Whether nothing was found, in a whole run."""
        return not self.findings and not self.problems

    def content(self) -> Content:
        """The description of the diagnosis."""
        nothing = "no fault found in the part that was examined" if self.problems else "no fault found"
        findings = [
            (
                each.name,
                each.term,
                each.joint,
                each.part,
                100.0 * each.fraction,
                each.of,
                ", ".join(each.follows or ()),
            )
            for each in self.findings
        ]
        evidence = [(each.name, name, x.value, x.unit) for each in self.findings for name, x in each.evidence.items()]
        tables = (
            Table(
                title="findings",
                columns=("finding", "term", "joint", "part", "explains [%]", "of", "consequence of"),
                rows=findings,
            ),
            Table(title="evidence", columns=("finding", "quantity", "value", "unit"), rows=evidence),
        )
        figures: dict[str, Callable[[], Figure]] = {
            f"{i}. {each.name}": each.plot for i, each in enumerate(self.findings, start=1) if len(each.signals)
        }
        return Content(
            title=f"Diagnosis: {self.findings[0].name if self.findings else nothing}",
            summary=[f"{i}. {finding}" for i, finding in enumerate(self.findings, start=1)],
            faults=self.problems,
            tables=[table for table in tables if table.rows],
            notes=[f"not checked: {note}" for note in self.notes],
            figures=figures,
        )


def doctor(run: Run, *, arm: Arm | None = None, checks: Sequence[Check] = CHECKS) -> Diagnosis:
    """Find what went wrong in a recorded run: wrong signs, oscillation, wrong payload, saturation, friction, ...

    Each check is a test of physical quantities of the record against thresholds that stand in one table with unit and
    reason, see the page on the doctor. The plant's parameters are never read, so that the record of a real arm is
    judged alike. A task is examined phase by phase, and laws side by side each by itself.

    Args:
        run: From `taut.run` or `taut.load_run`.
        arm: The controller's arm; by default the run's own. Without one, checks that need a model are left out.
        checks: The checks to make; `[*taut.analysis.CHECKS, mine]` adds one of your own.

    Raises:
        UsageError: No run, no arm, no checks.
        MatchError: An arm with other joints.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("panda")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> run = taut.run(ctrl, taut.RigidPlant(arm.with_payload(1.5)), duration=0.5)
        >>> found = taut.doctor(run).findings[0]
        >>> found.name, found.term, round(found.evidence["beyond the declared"].value, 3)
        ('wrong payload', 'nonlinear', 1.5)

    References:
        Astrom and Hagglund, PID Controllers (1995), section 3.5 (wind-up). Armstrong-Helouvry, Dupont and Canudas de
        Wit, Automatica 30 (1994), section 4 (stick-slip). Nordin and Gutman, Automatica 38 (2002) (backlash).
        Khalil and Dombre, Modeling, identification and control of robots (2002), chapter 12 (payload).
    """
    if not isinstance(run, Run):
        raise UsageError(f"doctor takes a Run from taut.run or taut.load_run; got {type(run).__name__}", name="run")
    if arm is not None:
        run.require_arm(arm)
    wrong = [type(check).__name__ for check in checks if not isinstance(check, Check)]
    if wrong:
        raise UsageError(f"checks are taut.analysis.Check; got {wrong[0]}", name="checks")
    threshold = {each.name: each.value for each in (*SHARED, *(x for check in checks for x in check.thresholds))}
    problems = [] if run.outcome.ok else [f"the run ended in a fault: {run.outcome}"]
    whole, lost = _longest_complete(_while_it_acts(run), int(threshold["ticks"]))
    problems += lost
    if whole is None:
        return Diagnosis(findings=(), problems=tuple(problems), notes=())
    kept = _before_running_away(whole, int(threshold["ticks"]) // 2)
    ran_away = len(kept) < len(whole) or run.outcome.kind == "diverged"
    if len(kept) < len(whole):
        problems.append(f"the loop ran away: what came after {kept.t[-1]:.4g} s was left out")
    shortest = max(threshold["ticks"], threshold["duration"] * run.rate)
    if len(kept) < shortest:
        problems.append(f"{len(kept)} ticks, {len(kept) / run.rate:.3g} s, are too short for most checks")
    found: dict[tuple[str, str], list[Finding]] = {}
    notes = list[str]()
    for part, own in _parts(kept):
        label = "" if part is None else f"{part}: "
        if part is not None and len(own) < shortest:
            notes.append(f"{label}{len(own) / run.rate:.3g} s are too short")
            continue
        known, model = own.info.controller_arm if arm is None else arm, None
        if known is not None and known.joint_names == own.joint_names:  # one of laws side by side has fewer
            model = ArmModel(run=own, arm=known)
        case = ExaminedRun(run=own, model=model, threshold=threshold, ran_away=ran_away)
        with np.errstate(over="ignore"):
            findings, left_out = _examined(case, checks)
        notes += [f"{label}{note}" for note in left_out]
        for each in findings:
            if each.name != "torque jump at the start" or own.t[0] == kept.t[0]:
                found.setdefault((each.name, each.term), []).append(dataclasses.replace(each, part=part))
    return Diagnosis(
        findings=_ordered([_once(group) for group in found.values()]),
        problems=tuple(problems),
        notes=tuple(notes),
    )


def _parts(run: Run) -> Iterator[tuple[str | None, Run]]:
    """Each visit to a phase of a task, each of laws side by side, or the whole run, with its label."""
    if not run.info.phases and not run.info.parts:
        yield None, run
    for name in run.info.parts:
        yield f"part '{name}'", run.part(name)
    visits: dict[str, int] = {}
    for window in run.phases if run.info.phases else ():
        visit = visits[window.name] = visits.get(window.name, -1) + 1
        yield f"phase '{window.name}'" + (f", visit {visit + 1}" if visit else ""), run.phase(window.name, visit)


def _examined(case: ExaminedRun, checks: Sequence[Check]) -> tuple[list[Finding], list[str]]:
    """The findings of a run, in the order of the checks, and the checks that were left out with the reason."""
    findings, left_out = list[Finding](), dict[str, list[str]]()
    for check in checks:
        missing: str | None = "the run is too short"
        if len(case.run) >= case.threshold["ticks"] or (case.ran_away and check.name == "oscillation"):
            missing = next((why for why, has in map(NEEDS.__getitem__, check.needs) if not has(case)), None)
        if missing is not None:
            left_out.setdefault(missing, []).append(check.name)
        elif (found := check.examine(case)) is not None:
            findings.append(found)
    return findings, [f"{', '.join(names)}: {why}" for why, names in left_out.items()]


def _once(group: Sequence[Finding]) -> Finding:
    """What was found in several parts, where it explains most."""
    first = max(group, key=lambda each: each.fraction)
    also = [str(each.part) for each in group if each is not first]
    return dataclasses.replace(first, part=f"{first.part}, also in {', '.join(also)}") if also else first


def _ordered(found: Sequence[Finding]) -> tuple[Finding, ...]:
    """Causes before their consequences, those first that explain most; of two that follow each other likewise."""
    by_size = sorted(found, key=lambda each: -each.fraction)
    first, then = [], []
    for i, each in enumerate(by_size):
        causes = [
            other.name
            for k, other in enumerate(by_size)
            if other.name in (each.follows or ()) and not (k > i and each.name in (other.follows or ()))
        ]
        if causes:
            then.append(dataclasses.replace(each, follows=(causes[0],)))
        else:
            first.append(dataclasses.replace(each, follows=()))
    return (*first, *then)


def _while_it_acts(run: Run) -> Run:
    """The ticks of a robot's record until the controlled stop, which is not the law's doing."""
    stops = run.extra.get("safe.mode", np.ones(len(run))) < 0.5
    k = int(np.argmax(stops)) if stops.any() else 0
    return run.ticks(slice(k)) if k else run


def _longest_complete(run: Run, min_ticks: int) -> tuple[Run | None, list[str]]:
    """The longest part of a run without missing ticks and NaN, and what is missing.

    A tick is missing where the time jumps by whole periods and the ticks' numbers do too; divergence is not meant.
    """
    if not len(run):
        return None, ["no tick was recorded"]
    problems = []
    known, starts = np.ones(len(run), dtype=bool), np.zeros(len(run), dtype=bool)
    skipped = np.maximum(np.round(np.diff(run.t) * run.rate) - 1.0, 0.0)
    missing, first = int(np.sum(skipped)), round(float(run.t[0]) * run.rate)
    if missing and run.outcome.tick + 1 - first >= len(run) + missing:
        problems.append(f"gaps: {missing} ticks are missing")
        starts[1:] = skipped > 0.0
    if run.outcome.kind != "diverged":
        columns = [run.q, run.v, run.tau, run.command, *run.terms.values(), run.extra.get("F_ext", run.q)]
        known = np.all([np.isfinite(x).all(axis=1) for x in columns], axis=0)
        problems += [] if known.all() else [f"{int(np.sum(~known))} ticks have values that are no numbers"]
    if not problems:
        return run, []
    edges = np.unique(np.concatenate([[0, len(run)], np.flatnonzero(starts | ~known), np.flatnonzero(~known) + 1]))
    parts = [(int(a), int(b)) for a, b in pairwise(edges) if known[a]]
    start, end = max(parts, key=lambda part: part[1] - part[0], default=(0, 0))
    if end - start < min_ticks:
        return None, [*problems, f"no {min_ticks} ticks in a row are complete; record the run again"]
    return run.ticks(slice(start, end)), [*problems, f"examined from {run.t[start]:.4g} to {run.t[end - 1]:.4g} s"]


def _before_running_away(run: Run, min_ticks: int) -> Run:
    """The ticks before the loop ran away, where a command is NaN or a joint faster than any arm.

    Of a run that ended so or in a fault, what follows ten times the limits of torque or speed is left out too.
    """
    speed, effort = (
        np.array([run.info.limits.get(kind, {}).get(joint, np.inf) for joint in run.joint_names])
        for kind in ("velocity", "effort")
    )
    away = (np.abs(run.v) > TOO_FAST).any(axis=1) | ~np.isfinite(run.command).all(axis=1)
    if away.any() or not run.outcome.ok:
        away |= (np.abs(run.v) > BEYOND_LIMITS * speed).any(axis=1)
        if run.kind == "torque":
            away |= (np.abs(run.command) > BEYOND_LIMITS * effort).any(axis=1)
    return run.ticks(slice(0, max(int(np.argmax(away)), min_ticks))) if away.any() else run
