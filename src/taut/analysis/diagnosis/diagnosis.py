"""taut.doctor: why a recorded run is as it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.analysis.diagnosis.case import MODEL_TERMS, Case
from taut.analysis.diagnosis.chatter import chatter_findings
from taut.analysis.diagnosis.finding import FAULTS, Finding, Number
from taut.analysis.diagnosis.hybrid import bounce_findings, surface_findings
from taut.analysis.diagnosis.limits import beyond_limits_findings, limit_findings, period_findings
from taut.analysis.diagnosis.lines import TURNS
from taut.analysis.diagnosis.load import load_findings
from taut.analysis.diagnosis.model import model_of_run
from taut.analysis.diagnosis.oscillation import runaway_findings, swing_findings
from taut.analysis.diagnosis.phases import SHORT, SHORT_TIME, Judged, of_phases
from taut.analysis.diagnosis.sign import sign_findings
from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.types import Array, Float64Array
from taut.control.limiting import LIMIT_TERMS
from taut.record.info import PHASES
from taut.record.run import Run

if TYPE_CHECKING:
    from taut.record.report.page import Page

__all__ = ["Diagnosis", "doctor"]

START: Final = "jumps at start"  # which says nothing of the end
EFFECTS: Final = frozenset({START, "saturates", "chatters"})  # of a loop that runs away
FEWEST: Final = 16  # ticks that say anything
COMMANDS: Final = {"velocity": "velocities", "position": "positions"}
NONE: Final = 1e-9  # what is less is rounding
WILD: Final = 1e3  # [rad/s | m/s] no arm is as fast
BEYOND: Final = 10.0  # times the limits of an arm that has run away
CALM: Final = 0.05  # [s] within the limits: what was beyond them before is over
CAUSES: Final[Mapping[str, frozenset[str]]] = {
    "wrong sign": frozenset(FAULTS) - {"wrong sign", "runs late"},
    "runs late": frozenset({"oscillates", "saturates"}),
    "loses rank": frozenset({"oscillates", "saturates", "jumps at start", "chatters"}),
    "oscillates": frozenset({"saturates", "chatters", "winds up", "sticks", "sags"}),
    "bounces": frozenset({"saturates", "chatters", "oscillates", "sags", "sticks", "winds up", "jumps at start"}),
    "sticks": frozenset({"sags"}),
    "wrong surface": frozenset({"sags", "sticks", "winds up"}),
    "stick-slip": frozenset({"sticks", "sags", "winds up"}),
    "backlash": frozenset({"saturates", "sticks", "sags"}),
    "jumps at start": frozenset({"beyond limits"}),
    "chatters": frozenset({"saturates"}),
    "winds up": frozenset({"saturates"}),
    "gravity twice": frozenset({"sags", "sticks"}),
    "gravity not compensated": frozenset({"sags", "sticks"}),
    "wrong payload": frozenset({"sags", "sticks"}),
}
"""What else a fault brings about: found beside it, that comes after it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """Why a run is as it is.

    Attributes:
        findings: What is wrong: causes before what follows from them, and of each those first that explain most of
            the feedback's effort.
        problems: What keeps the run from being judged as a whole: a fault, gaps, too few ticks. Findings are then
            what can be said of the rest.
        notes: What was not looked for, because the run does not tell enough of it.
        looked_at: The figures that were looked at, by name; those of a task by phase.
        model: Where the model comes from that the torques were compared with.
    """

    findings: tuple[Finding, ...]
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    looked_at: Mapping[str, Number]
    model: str

    @property
    def healthy(self) -> bool:
        """Whether nothing was found, in a whole run."""
        return not self.findings and not self.problems

    def json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "healthy": self.healthy,
            "findings": [finding.json() for finding in self.findings],
            "problems": list(self.problems),
            "notes": list(self.notes),
            "looked_at": {name: number.json() for name, number in self.looked_at.items()},
            "model": self.model,
        }

    def report_page(self) -> Page:
        """What `taut.report` makes of it."""
        from taut.analysis.diagnosis.page import page_of_diagnosis

        return page_of_diagnosis(self)

    def __str__(self) -> str:
        lines = [f"not a whole run: {problem}" for problem in self.problems]
        lines += [f"{i}. {finding}" for i, finding in enumerate(self.findings, start=1)]
        if not self.findings:
            lines.append("no cause found in what was judged" if self.problems else "nothing found")
        lines += [f"not looked for: {note}" for note in self.notes]
        lines.append("looked at: " + ", ".join(f"{name} {number}" for name, number in self.looked_at.items()))
        lines.append(f"model: {self.model}")
        return "\n".join(lines)


def doctor(run: Run, *, arm: Arm | None = None) -> Diagnosis:
    """Say why a recorded run sags, oscillates, sticks, winds up, saturates, chatters, ...

    Each finding is a test of physical quantities of the record, whose thresholds are numbers of the theory, not of
    an arm: an error counts from 2 % of what a joint was asked to move, and 1 mm at the tool; torques are weighed with
    the joint's effort limit. Of the run's parameters only those of the controller are read, never the plant's, so
    that a record of a real arm says as much. `taut.analysis.diagnosis.finding.FAULTS` lists the names.

    * wrong sign: the spring's work on the error is negative, or tau - (M a + h) = 2 tau, and the error grows
    * oscillates: one line of damping ratio under 0.1 is half of a joint's feedback; the term whose work feeds it
    * stick-slip, backlash: such a line of constant size, with rests, or with a dwell without torque
    * chatters: jitter above a twentieth of the rate, with more than 10 effort limits of variation per second
    * gravity twice, or not: the part of g in the residual tau + J^T F_ext - (M a + h), and in the law's terms
    * wrong payload: its mass explains all but 2 % of the residual, or mass and centre all but half a percent
    * sticks: a joint rests off its target, while its torque changes or is within its dry friction
    * sags: a steady error at rest that feedback holds against a constant load
    * winds up: the integral gains a tenth of the feedback while cut, and carries the joint beyond its target
    * saturates: a limit cuts in a twentieth of the run while the error counts
    * beyond limits: torque above the arm's effort limit in three ticks or more, and nothing else is wrong later
    * bounces: a pressed contact opens ten times and more, and its force varies by a quarter of its mean
    * loses rank: the smallest singular value is under the border of `sizes_of`, and the law gives something up
    * jumps at start: feedback begins with a quarter of the effort
    * wrong surface: in contact, phi of a hybrid law's constraint is 2 mm or 2 mrad RMS
    * runs late: one period in a hundred is longer than one and a half

    A task is judged phase by phase, each visit by what that phase was asked for; a hybrid law by its error along the
    constraint; a law that promises an impedance by where the measured wrench should have taken the tool; laws side
    by side by the error of each.

    Args:
        run: From `taut.run` or `taut.load_run`.
        arm: The arm that the controller was compiled for; by default the one that the run holds, in memory and in its
            log. Without one, gravity and payload are not looked at.

    Returns:
        The diagnosis; `str()` of it is a report.

    Raises:
        UsageError: No run, or an arm that is none.
        MatchError: An arm with other joints.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("panda")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> run = taut.run(ctrl, taut.RigidPlant(arm.with_payload(1.5)), duration=0.5)
        >>> found = taut.doctor(run).findings[0]
        >>> found.name, found.term, round(found.evidence["beyond it"].value, 3)
        ('wrong payload', 'nonlinear', 1.5)

    References:
        Astrom and Hagglund, PID Controllers (1995), section 3.5 (wind-up). Armstrong-Helouvry, Dupont and Canudas de
        Wit, Automatica 30 (1994), section 4 (stick-slip). Nordin and Gutman, Automatica 38 (2002) (backlash).
        Khalil and Dombre, Modeling, identification and control of robots (2002), chapter 12 (payload).
    """
    if not isinstance(run, Run):
        raise UsageError(f"doctor takes a Run from taut.run or taut.load_run; got {type(run).__name__}", name="run")
    problems = [] if run.outcome.ok else [f"it ended in a fault: {run.outcome}"]
    if len(run) < FEWEST:
        return _of_a_few_ticks(run, arm, problems)
    whole, gaps = _without_gaps(run)
    problems += gaps
    whole, unknown = (None, []) if whole is None else _with_numbers(whole)
    problems += unknown
    if whole is None:
        return Diagnosis(findings=(), problems=tuple(problems), notes=(), looked_at={}, model="none was needed")
    sane, finite = _sane(whole)
    if len(sane) < len(whole):
        problems.append(f"it ran away: what came after {sane.t[-1]:.4g} s says nothing of the arm and was left out")
    if len(sane) < SHORT or len(sane) < SHORT_TIME * run.rate:
        problems.append(
            f"{len(sane)} ticks, {len(sane) / run.rate:.3g} s, are too short: what needs {SHORT} ticks, "
            f"{SHORT_TIME:g} s or a settled arm was not judged"
        )
    with np.errstate(over="ignore"):
        late = [] if gaps else list(period_findings(run.t, run.rate))
        told = of_phases(sane, lambda one: _judged(one, arm)) if PHASES in run.info else _judged(sane, arm)
        if len(sane) < len(whole) and PHASES not in run.info and all(each.name in EFFECTS for each in told.found):
            ran_away = tuple(runaway_findings(Case(run=finite, model=model_of_run(finite, arm)[0])))
            told = dataclasses.replace(told, found=(*told.found, *ran_away))
        if PHASES not in run.info and all(finding.name == START for finding in told.found):
            problems += _not_at_rest(sane)
    return Diagnosis(
        findings=_ordered([*late, *told.found]),
        problems=tuple(problems),
        notes=tuple(dict.fromkeys(told.notes)),
        looked_at=told.looked_at,
        model=told.model,
    )


def _of_a_few_ticks(run: Run, arm: Arm | None, problems: list[str]) -> Diagnosis:
    """The diagnosis of a run that is over before most tests have anything to go by: an oscillation that grows."""
    model, words = model_of_run(run, arm)
    found: list[Finding] = []
    if len(run) > TURNS and PHASES not in run.info:
        with np.errstate(over="ignore"):
            found = list(runaway_findings(Case(run=_sane(run)[1], model=model)))
    few = f"{len(run)} ticks are too few for anything but an oscillation that grows; {FEWEST} at least are needed"
    return Diagnosis(
        findings=tuple(found),
        problems=(*problems, few),
        notes=(),
        looked_at={"ticks": Number(float(len(run)))},
        model=words,
    )


def _judged(run: Run, arm: Arm | None) -> Judged:
    """What all tests but that of the clock say of a run of one law."""
    model, words = model_of_run(run, arm)
    case = Case(run=run, model=model)
    swings = list(swing_findings(case))
    found = [*sign_findings(case), *swings, *chatter_findings(case, bool(swings)), *limit_findings(case)]
    found += [*surface_findings(case), *bounce_findings(case)]
    if not any(finding.term == "transmission" for finding in swings):  # else the torque is not that of the link
        found += load_findings(case)
    if all(finding.name == START for finding in found):  # what else is wrong asks for any torque
        found += beyond_limits_findings(case)
    return Judged(found=tuple(found), notes=tuple(_not_looked_for(case)), looked_at=_looked_at(case), model=words)


def _not_at_rest(run: Run) -> list[str]:
    """What a run that shows no fault does not show either: it ends before the arm is where it was asked to be."""
    case = Case(run=run, model=None)
    i = case.on_its_way
    if i is None or case.error is None:
        return []
    return [
        f"{len(run) / run.rate:.3g} s are too short: joint '{run.joint_names[i]}' was on its way, "
        f"{abs(case.error[-1, i]):.3g} {run.units[i]} from where it was to rest, and what is left there was not "
        "judged; record it for longer"
    ]


def _not_looked_for(case: Case) -> Iterator[str]:
    """What a run does not tell enough of."""
    if case.of_torque and case.limits_of_effort is None:
        yield "jumps at start, for the effort limits of the arm are not known"
    if case.error is None and case.of_hybrid:
        yield "what shows in the error along a constraint, which is known with a model and computed torque alone"
    elif case.error is None and not case.of_force:
        yield "what shows in an error, for it is not known what the law was asked for"
    if not case.of_torque:
        yield f"what shows in torques, for the law commands {COMMANDS.get(case.run.kind, case.run.kind)}"
    elif case.model is not None and case.in_contact:
        yield "gravity and payload, for the arm touched something, and no column tells with which wrench"


def _without_gaps(run: Run) -> tuple[Run | None, list[str]]:
    """The longest stretch of a run without missing ticks, and what is missing.

    A tick is missing where the time jumps by whole periods and the number of the last tick says that there were more.
    """
    periods = np.round(np.diff(run.t) * run.rate)
    missing = int(np.sum(np.maximum(periods - 1.0, 0.0)))
    first = round(float(run.t[0]) * run.rate)
    if not missing or run.outcome.tick + 1 - first < len(run) + missing:
        return run, []
    edges = np.concatenate([[0], np.flatnonzero(periods > 1.0) + 1, [len(run)]])
    return _longest(run, np.column_stack([edges[:-1], edges[1:]]), f"gaps: {missing} ticks are missing")


def _longest(run: Run, stretches: Array, what: str) -> tuple[Run | None, list[str]]:
    """The longest of the stretches of a run, (k, 2) first tick and the one after the last, and what is wrong else.

    None where it is too short to be judged.
    """
    lengths = stretches[:, 1] - stretches[:, 0]
    start, end = map(int, stretches[int(np.argmax(lengths))]) if len(lengths) else (0, 0)
    if end - start < FEWEST:
        return None, [f"it has {what}, and no stretch of {FEWEST} ticks without; record it anew"]
    words = f"it has {what}; judged from {run.t[start]:.4g} to {run.t[end - 1]:.4g} s"
    return run.between(float(run.t[start]), float(run.t[end - 1])), [words]


def _with_numbers(run: Run) -> tuple[Run | None, list[str]]:
    """The longest stretch of a run in which all is a number, and what is none: a sensor that was unplugged.

    A run that diverged ends without numbers, which is another matter.
    """
    if run.outcome.kind == "diverged":
        return run, []
    columns = {"q": run.q, "v": run.v, "torque": run.tau, "command": run.command, **run.terms}
    if "F_ext" in run.extra:
        columns["F_ext"] = run.extra["F_ext"]
    known = {name: np.isfinite(value.reshape(len(run), -1)).all(axis=1) for name, value in columns.items()}
    lost = [name for name, ticks in known.items() if not ticks.all()]
    if not lost:
        return run, []
    good = np.all([known[name] for name in lost], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.intp), [0]]))).reshape(-1, 2)
    return _longest(run, edges, f"{int(np.sum(~good))} tick(s) without a number, in {', '.join(lost)}")


def _sane(run: Run) -> tuple[Run, Run]:
    """The ticks before the loop ran away, and those that are numbers: what comes after says nothing of the arm.

    It has where a command is no number or a joint is faster than any arm. Of a run with such an end, or that ended in
    a fault, what comes before it is left out too, as far as torque or speed are ten times the limit, with less than
    50 ms of calm in between: a swing that only is as large may last. Eight ticks are kept at least.
    """
    case = Case(run=run, model=None)
    speeds = run.info.get("limits", {}).get("velocity", {})
    fastest = np.array([speeds.get(joint, np.inf) for joint in run.joint_names], dtype=np.float64)
    strongest = np.full(run.n, np.inf) if case.limits_of_effort is None else case.limits_of_effort
    beyond = (np.abs(run.v) > BEYOND * fastest) | (case.of_torque & (np.abs(run.command) > BEYOND * strongest))
    wild = np.flatnonzero((np.abs(run.v) > WILD).any(axis=1) | ~np.isfinite(run.command).all(axis=1))
    away = np.flatnonzero(beyond.any(axis=1))
    calm = CALM * run.rate
    ends = [int(wild[0])] if wild.size else []
    if away.size and (ends or not run.outcome.ok) and len(run) - 1 - away[-1] < calm:
        pauses = np.flatnonzero(np.diff(away) > calm)
        ends.append(int(away[pauses[-1] + 1 if pauses.size else 0]))
    if not ends:
        return run, run
    return _until(run, min(ends)), _until(run, int(wild[0])) if wild.size else run


def _until(run: Run, tick: int) -> Run:
    return run.between(float(run.t[0]), float(run.t[min(max(tick, FEWEST // 2), len(run)) - 1]))


def _ordered(found: list[Finding]) -> tuple[Finding, ...]:
    """Causes before what follows from them, those first that explain most."""
    by_share = sorted(found, key=lambda finding: -finding.share)
    out, follow = [], []
    for finding in by_share:
        cause = next(
            (other.name for other in by_share if _causes(other, finding) and other.name not in finding.apart), None
        )
        if cause is None:
            out.append(finding)
        else:
            follow.append(dataclasses.replace(finding, follows=cause))
    return (*out, *follow)


def _causes(one: Finding, other: Finding) -> bool:
    """Whether a finding brings about another; what a limit feeds comes of the limit, and of I of winding up."""
    limited = (one.name, other.name)
    if limited == ("winds up", "oscillates"):
        return other.term == "I"
    if limited == ("oscillates", "winds up"):
        return one.term != "I"
    if limited == ("saturates", "oscillates"):
        return other.term in LIMIT_TERMS
    if limited == ("oscillates", "saturates"):
        return one.term not in LIMIT_TERMS
    if limited == ("saturates", "chatters"):
        return not _cut_for_jitter(other, one)
    if limited == ("chatters", "saturates"):
        return _cut_for_jitter(one, other)
    return other.name in CAUSES.get(one.name, ())


def _cut_for_jitter(chatter: Finding, cut: Finding) -> bool:
    """Whether a limit cuts jitter: it takes no more than there is, and no model asks for it."""
    return chatter.term not in MODEL_TERMS and cut.share <= chatter.share


def _looked_at(case: Case) -> dict[str, Number]:
    """The figures of a run that the tests judged, each of the joint where it is largest."""
    run = case.run
    of = "% of the effort" if case.limits_of_effort is not None else "% of the largest torque"
    out = {"ticks": Number(float(len(run)))}
    if case.error is not None:
        parts = np.abs(case.error) / case.tolerance
        out["peak error"] = Number(float(parts.max()), "times what counts")
        out["steady error"] = Number(float((np.abs(case.steady_error) / case.tolerance).max()), "times what counts")
    if case.of_torque:
        out["torque"] = Number(100.0 * _largest(run.tau / case.size), of)
        out["first feedback"] = Number(100.0 * _largest(case.given[:1] / case.size), of)
        out["chatter"] = Number(float((run.metrics.chatter / case.size).max()), "efforts/s")
    out["cut"] = Number(100.0 * float((case.cut != 0.0).any(axis=1).mean()), "% of the ticks")
    out["longest period"] = Number(float(np.diff(run.t).max() * run.rate), "times the nominal")
    if case.of_task:
        out["least singular value"] = Number(float(run.task.min_singular_value.min()))
    if case.model is not None and case.of_torque and not case.in_contact:
        out["torque beyond the model"] = Number(100.0 * _largest(case.model.residual / case.size), of)
    return out


def _largest(x: Float64Array) -> float:
    found = float(np.abs(x).max())
    return found if found > NONE else 0.0
