"""What swings: oscillations by the term that feeds them, limit cycles of friction and play."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.finding import Finding, Number, Picture
from taut.analysis.diagnosis.line import line_of
from taut.analysis.diagnosis.lines import (
    RINGING,
    Swing,
    alternating_swing,
    bolting_swing,
    strongest_swing,
    without_trend,
)
from taut.analysis.diagnosis.remedy import less_delay, less_integral, lower_gain, more_damping
from taut.base.types import Float64Array
from taut.control.limiting import LIMIT_TERMS
from taut.record.metrics import RESTING

__all__ = ["runaway_findings", "swing_findings"]

LOST: Final = 0.01  # of the work that is done on a swing, beyond which the torque takes it out
TOO_MUCH: Final = 1.15  # times the dry friction that the motion showed
STOPS: Final = 3  # times that a joint comes to rest in a cycle of sticking, in four periods and more
THIRD: Final = 0.1  # of a cycle's acceleration, that a spring does not make
SHAKEN: Final = ("environment", "dither", "feedforward", "wrench", "sensor")  # what shakes an arm, and is no fault
STEADY: Final = 0.01  # damping ratio within which an oscillation neither grows nor dies out
LEAST_SHARE: Final = 0.01  # of the feedback's effort in the run: less is not why a run is as it is
FED: Final = 0.05  # of the work that is done on it: a term that feeds it does more
SAMPLED: Final = 0.3  # omega T from which the rate matters: a design stays below
RESTS: Final = 0.1  # of the window in which the joint rests, in a limit cycle of dry friction
FREE: Final = 3.0  # times the dwell at no torque that a sine would have


def swing_findings(case: Case) -> Iterator[Finding]:
    """Oscillation: one line that makes up half of the variance of a joint's feedback, in four periods or more.

    The line is fitted by damped least squares in the last half, and else the whole, of the run. It counts where its
    damping ratio is under 0.1 (more than six periods to 2 %) and above -0.3 (a joint that runs away), where it moves
    the joint by an error that counts or its torque by 2 % of the effort (of one that grows, at its end), and where it
    is faster than five times what the reference moves at; else a feedback that turns round in every tick and grows,
    which runs away before a line can be fitted, or one
    of four half waves and more, each larger than the last, at the end of the run. It is fed
    by the term that does positive work on it, sum tau_term dq over whole ticks, so that the hold counts:

    * stick-slip where the joint rests (|v| < 1e-4) for a tenth of the window, again and again between its jumps;
    * none, where the environment or a term that answers no error (dither, feedforward) feeds it: the arm is shaken;
    * the transmission's, where the torque takes work out of it and it goes on all the same, so that the motor moves
      otherwise than the link: backlash where the link's acceleration dwells at none three times as long as that of a
      sine would, or has a tenth of its third harmonic; else a joint that gives;
    * else the loop's: the integral (I), the drives (delay), a limit (its term), or the gains against the rate (P, D);
      where no term feeds what lasts or dies out, damping is missing (D).
    """
    if case.of_torque:
        yield from _findings(case, strongest_swing(case) or alternating_swing(case) or bolting_swing(case))


def runaway_findings(case: Case) -> Iterator[Finding]:
    """The oscillation by which a loop ran away, of a run with what came when it was far beyond its limits."""
    if case.of_torque:
        yield from _findings(case, alternating_swing(case) or bolting_swing(case))


def _findings(case: Case, found: Swing | None) -> Iterator[Finding]:
    if found is None:
        return
    run, i = case.run, found.joint
    rest = _resting(case, found)
    if rest is not None:
        yield _stick_slip(case, found, rest)
        return
    works = _works(case, found)
    done = sum(abs(work) for work in works.values()) or 1.0
    feeds = max(works, key=lambda name: works[name])
    grows = found.line.growth > STEADY * found.line.omega
    if works[feeds] > FED * done and feeds in SHAKEN:
        return
    if grows and works[feeds] <= FED * done:  # nothing could make it grow
        return
    dwell = _dwell(case, found, works)
    if dwell is not None:
        yield _limit_cycle(
            case,
            found,
            "backlash",
            "transmission",
            {"without torque for": Number(100.0 * dwell, "% of the time")},
            "a cycle that the torque takes work out of: the link goes to and fro between two teeth",
            f"lower kp at '{run.joint_names[i]}' (the gain bound of backlash, 2 friction / backlash), measure at the "
            "motor, or preload the gear",
        )
        return
    yield _of_the_loop(case, found, works)


# -------------------------------------------------------------------- work


def _works(case: Case, found: Swing) -> dict[str, float]:
    """Work on the swinging motion of each term that answers an error, of limits, and of what shakes the arm.

    As "delay" that of what the drives make of the sum, as "torque" of what is beyond their own limit, and as
    "environment" that of J^T F_ext.
    """
    run = case.run
    window = slice(found.window.start, min(found.window.stop, len(run) - 1))
    steps = without_trend(case.steps[window])

    def work(x: Float64Array) -> float:
        return float(np.sum(without_trend(x[window]) * steps))

    names = [*case.feedback_terms, *(name for name in (*LIMIT_TERMS, *SHAKEN) if name in run.terms)]
    works = {name: work(run.terms[name]) for name in names}
    pinned = case.pinned
    works["torque"] = work(pinned)
    works["delay"] = work(run.tau - run.command - pinned)
    works["environment"] = work(case.pushed)
    return works


def _taken(case: Case, found: Swing) -> float:
    """Work that the drives' torques take out of a swing that lasts, less what the environment gives to it.

    Of the motion of the links; a motor that moves as its link does can take none out of what lasts.
    """
    window = slice(found.window.start, min(found.window.stop, len(case.run) - 1))
    steps = without_trend(case.steps[window])
    return -float(np.sum(without_trend((case.run.tau + case.pushed)[window]) * steps))


# -------------------------------------------------------------------- limit cycles


def _resting(case: Case, found: Swing) -> float | None:
    """The part of the window in which the joint rests, if it is a tenth of it and it rests again and again."""
    at = np.abs(case.run.v[found.window, found.joint]) < RESTING
    share, stops = float(at.mean()), int(np.sum(at[1:] & ~at[:-1]))
    lasts = abs(found.line.zeta) < RINGING
    if not (lasts and RESTS < share < 1.0 and stops >= STOPS) or found.line.omega * case.dt > SAMPLED:
        return None
    return share


def _stick_slip(case: Case, found: Swing, rest: float) -> Finding:
    """The cycle of a joint that rests between jumps; of friction that the law has too much of, where it shows."""
    i, share = found.joint, {"rests for": Number(100.0 * rest, "% of the time")}
    given = float(np.abs(case.run.terms["friction"][found.window, i]).max()) if "friction" in case.run.terms else 0.0
    fit = case.fit
    if fit is not None and 0.0 < TOO_MUCH * fit.coulomb[i] < given:
        unit = case.run.effort_units[i]
        more = {"friction given": Number(given, unit), "dry friction fitted": Number(float(fit.coulomb[i]), unit)}
        text = "the law gives more dry friction than there is, which drives the joint on until it sticks again"
        remedy = (
            f"give {fit.coulomb[i]:.3g} {unit} of Coulomb friction instead of {given:.3g}, or less, or take it from "
            "the reference, FrictionCompensation(at='ref')"
        )
        return _limit_cycle(case, found, "stick-slip", "friction", share | more, text, remedy)
    text = "the joint sticks, the feedback grows until it breaks away, and it overshoots"
    remedy = "add FrictionCompensation(at='ref') or a Dither"
    remedy += (
        "; or lower ki, or stop the integral within the tolerance" if _integrates(case, i) else ", or more damping"
    )
    return _limit_cycle(case, found, "stick-slip", "I" if _integrates(case, i) else "friction", share, text, remedy)


def _integrates(case: Case, i: int) -> bool:
    """Whether an integral has a part in a joint's feedback that counts."""
    integral = case.feedback_terms.get("I", np.zeros_like(case.feedback))[:, i]
    return float(np.sum(integral**2)) > LEAST_SHARE * float(np.sum(case.feedback[:, i] ** 2))


def _gives(case: Case, found: Swing, works: dict[str, float]) -> bool:
    """Whether something gives between motor and link: torque takes work out of a swing that lasts all the same."""
    done = sum(abs(work) for work in works.values()) or 1.0
    slow = found.line.omega * case.dt <= SAMPLED
    if case.model is not None and not case.in_contact:  # what the links' motion explains went into no spring
        beyond = case.model.residual[:, found.joint] / case.size[found.joint]
        if float(np.mean(beyond**2)) < LOST**2 * float(np.mean((case.run.tau / case.size)[:, found.joint] ** 2)):
            return False
    return abs(found.line.zeta) < STEADY and slow and _taken(case, found) > LOST * done


def _dwell(case: Case, found: Swing, works: dict[str, float]) -> float | None:
    """The part of the window in which the link has next to no acceleration, where play is what holds the cycle."""
    run, i, line = case.run, found.joint, found.line
    if case.cut[found.window].any() or abs(line.zeta) > STEADY or line.omega * case.dt > SAMPLED:
        return None
    a = np.diff(run.v[found.window, i]) / case.dt
    peak = float(np.quantile(np.abs(a), 0.98))
    if peak <= 0.0:
        return None
    band = 0.1
    dwell = float(np.mean(np.abs(a) < band * peak))
    feeds = max(works, key=lambda name: works[name])
    free = dwell > FREE * 2.0 / math.pi * math.asin(band) and feeds != "delay"
    return dwell if free or (_gives(case, found, works) and _third(a, line.omega * case.dt) > THIRD) else None


def _third(a: Float64Array, step: float) -> float:
    """The third harmonic of a cycle over its first: small of a spring, more than a tenth of one with play."""
    window = a * np.hanning(len(a))
    first, third = (abs(complex(np.sum(window * np.exp(-1j * m * step * np.arange(len(a)))))) for m in (1, 3))
    return third / max(first, np.finfo(np.float64).tiny)


def _limit_cycle(
    case: Case, found: Swing, name: str, term: str, more: dict[str, Number], text: str, remedy: str
) -> Finding:
    run, i = case.run, found.joint
    swing = 0.5 * float(np.ptp(run.q[found.window, i]))
    return Finding(
        name=name,
        term=term,
        joint=run.joint_names[i],
        share=found.share,
        evidence={
            "frequency": Number(found.line.frequency, "Hz"),
            "amplitude": Number(swing, run.units[i]),
            "damping ratio": Number(found.line.zeta),
            **more,
        },
        text=text,
        remedy=remedy,
        picture=_shown(case, found),
    )


def _shown(case: Case, found: Swing) -> Picture:
    run, i = case.run, found.joint
    last = slice(
        max(0, found.window.stop - max(64, round(12.0 / (found.line.frequency * case.dt)))), found.window.stop
    )
    curves = {name: value[last, i] for name, value in case.feedback_terms.items() if np.any(value[last, i])}
    title = f"{run.joint_names[i]}: {found.line.frequency:.3g} Hz"
    return Picture(title=title, ylabel=f"[{run.effort_units[i]}]", t=run.t[last], curves=curves)


# -------------------------------------------------------------------- the loop's own


def _of_the_loop(case: Case, found: Swing, works: dict[str, float]) -> Finding:
    run, i, line = case.run, found.joint, found.line
    done = sum(abs(work) for work in works.values()) or 1.0
    late = works["delay"] > FED * done  # then what a limit takes acts late too, and brakes
    limits = (*LIMIT_TERMS, "torque")
    feeds = max((name for name in works if not (late and name in limits)), key=lambda name: works[name])
    fed = works[feeds] / done
    if _gives(case, found, works):
        feeds, fed = "transmission", _taken(case, found) / done
        remedy = (
            f"what is between motor and link of '{run.joint_names[i]}' gives: lower kd and kp, measure at the motor, "
            "or make it stiffer"
        )
    elif fed < FED or (feeds == "P" and line.omega * case.dt < SAMPLED):
        feeds = "D"  # nothing feeds it: it lacks damping
        remedy = more_damping(case, found)
    elif feeds == "I":
        remedy = less_integral(case, found)
    elif feeds == "delay":
        remedy = less_delay(case, found)
    elif feeds in limits:
        remedy = f"ask for less than the {feeds.replace('_', ' ')} gives: what it takes away comes late"
    else:
        remedy = lower_gain(case, found, feeds)
    words = (
        "grows" if line.growth > STEADY * line.omega else "lasts" if abs(line.zeta) < STEADY else "dies out slowly"
    )
    swing = line_of(run.q[found.window, i], case.dt, 0.5 * line.omega)
    amplitude = 0.5 * float(np.ptp(run.q[found.window, i])) if swing is None else swing.amplitude
    return Finding(
        name="oscillates",
        term=feeds,
        joint=run.joint_names[i],
        share=found.share,
        evidence={
            "frequency": Number(line.frequency, "Hz"),
            "growth": Number(line.growth, "1/s"),
            "damping ratio": Number(line.zeta),
            "amplitude": Number(amplitude, run.units[i]),
            "of the work on it": Number(100.0 * max(fed, 0.0), "%"),
        },
        text=f"'{run.joint_names[i]}' oscillates at {line.frequency:.3g} Hz, which {words}",
        remedy=remedy,
        picture=_shown(case, found),
    )
