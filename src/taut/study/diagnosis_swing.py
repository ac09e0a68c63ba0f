"""What swings: oscillations by the term that feeds them, limit cycles of friction and play."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.control.limiting import LIMIT_TERMS
from taut.record.sticking import RESTING
from taut.study.diagnosis_case import Case
from taut.study.diagnosis_finding import Finding, Number, Picture
from taut.study.diagnosis_line import Line, line_of

__all__ = ["swing_findings"]

LINE: Final = 0.5  # of the variance of a joint's feedback that is one line
RINGING: Final = 0.1  # damping ratio under which it takes more than six periods to the chapter's 2 %
BOLTING: Final = 0.3  # what grows faster, sixfold in a period, is no oscillation but runs away
LOST: Final = 0.01  # of the work that is done on a swing, beyond which the torque takes it out
TOO_MUCH: Final = 1.15  # times the dry friction that the motion showed
STOPS: Final = 3  # times that a joint comes to rest in a cycle of sticking, in four periods and more
THIRD: Final = 0.1  # of a cycle's acceleration, that a spring does not make
SHAKEN: Final = ("environment", "dither", "feedforward", "wrench", "sensor")  # what shakes an arm, and is no fault
STEADY: Final = 0.01  # damping ratio within which an oscillation neither grows nor dies out
LEAST_TORQUE: Final = 0.02  # of the effort: smaller oscillations count only by their error
LEAST_SHARE: Final = 0.01  # of the feedback's effort in the run: less is not why a run is as it is
HARMONICS: Final = 5.0  # of the reference's frequency: what the reference itself brings
FED: Final = 0.05  # of the work that is done on it: a term that feeds it does more
SAMPLED: Final = 0.3  # omega T from which the rate matters: a design stays below
RESTS: Final = 0.1  # of the window in which the joint rests, in a limit cycle of dry friction
FREE: Final = 3.0  # times the dwell at no torque that a sine would have


@dataclass(frozen=True, kw_only=True, eq=False)
class _Swing:
    """A line in a joint's feedback in a window of the run."""

    joint: int
    line: Line
    window: slice
    share: float


def swing_findings(case: Case) -> Iterator[Finding]:
    """Oscillation: one line that makes up half of the variance of a joint's feedback, in four periods or more.

    The line is fitted by damped least squares in the last half, and else the whole, of the run. It counts where its
    damping ratio is under 0.1 (more than six periods to 2 %) and above -0.3 (a joint that runs away), where it moves
    the joint by an error that counts or its torque by 2 % of the effort (of one that grows, at its end), and where it
    is faster than five times what the reference moves at. It is fed
    by the term that does positive work on it, sum tau_term dq over whole ticks, so that the hold counts:

    * stick-slip where the joint rests (|v| < 1e-4) for a tenth of the window, again and again between its jumps;
    * none, where the environment or a term that answers no error (dither, feedforward) feeds it: the arm is shaken;
    * the transmission's, where the torque takes work out of it and it goes on all the same, so that the motor moves
      otherwise than the link: backlash where the link's acceleration dwells at none three times as long as that of a
      sine would, or has a tenth of its third harmonic; else a joint that gives;
    * else the loop's: the integral (I), the drives (delay), a limit (its term), or the gains against the rate (P, D);
      where no term feeds what lasts or dies out, damping is missing (D).
    """
    if not case.of_torque:
        return
    found = _strongest(case)
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


# -------------------------------------------------------------------- finding the line


def _strongest(case: Case) -> _Swing | None:
    """The line that explains most of any joint's feedback, in the last half of the run or else in all of it."""
    run, count = case.run, len(case.run)
    for window in (slice(count // 2, count), slice(0, count)):
        y = case.feedback[window] / case.size
        slow = _reference_speed(case, window)
        total = float(np.sum((y - y.mean(axis=0)) ** 2)) or 1.0
        best: _Swing | None = None
        for i in range(case.n):
            line = line_of(y[:, i], case.dt, HARMONICS * slow)
            if line is None or line.share < LINE or not -BOLTING < line.zeta < RINGING:
                continue
            swing = line_of(run.q[window, i], case.dt, 0.5 * line.omega)
            moves = 0.0 if swing is None else swing.amplitude * math.sqrt(max(swing.share, 0.0))
            if max(line.amplitude, line.last * (line.growth > 0.0)) < LEAST_TORQUE and moves < case.tolerance[i]:
                continue
            part = line.share * float(np.sum((y[:, i] - y[:, i].mean()) ** 2)) / total
            if best is None or part > best.share:
                best = _Swing(joint=i, line=line, window=window, share=part)
        if best is not None:
            energy = float(np.sum((case.feedback[best.window] / case.size) ** 2)) / case.effort
            share = min(1.0, best.share * energy)
            if share >= LEAST_SHARE:
                return _Swing(joint=best.joint, line=best.line, window=best.window, share=share)
    return None


def _reference_speed(case: Case, window: slice) -> float:
    """[rad/s] the frequency around which the reference moves: RMS of its acceleration over that of its speed."""
    v = case.moving_reference[window]
    speed = float(np.sqrt(np.mean(v**2)))
    if speed == 0.0:
        return 0.0
    return float(np.sqrt(np.mean((np.diff(v, axis=0) / case.dt) ** 2))) / speed


def _ac(x: Float64Array) -> Float64Array:
    """(k, n) without its straight trend."""
    t = np.linspace(-1.0, 1.0, len(x))
    basis = np.column_stack([np.ones(len(x)), t])
    return np.asarray(x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0])


def _works(case: Case, found: _Swing) -> dict[str, float]:
    """Work on the swinging motion of each term that answers an error, of limits, and of what shakes the arm.

    As "delay" that of what the drives make of the sum, as "torque" of what is beyond their own limit, and as
    "environment" that of J^T F_ext.
    """
    run = case.run
    window = slice(found.window.start, min(found.window.stop, len(run) - 1))
    steps = _ac(case.steps[window])

    def work(x: Float64Array) -> float:
        return float(np.sum(_ac(x[window]) * steps))

    names = [*case.feedback_terms, *(name for name in (*LIMIT_TERMS, *SHAKEN) if name in run.terms)]
    works = {name: work(run.terms[name]) for name in names}
    pinned = case.pinned
    works["torque"] = work(pinned)
    works["delay"] = work(run.tau - run.command - pinned)
    works["environment"] = work(case.pushed)
    return works


def _taken(case: Case, found: _Swing) -> float:
    """Work that the drives' torques take out of a swing that lasts, less what the environment gives to it.

    Of the motion of the links; a motor that moves as its link does can take none out of what lasts.
    """
    window = slice(found.window.start, min(found.window.stop, len(case.run) - 1))
    steps = _ac(case.steps[window])
    return -float(np.sum(_ac((case.run.tau + case.pushed)[window]) * steps))


# -------------------------------------------------------------------- limit cycles


def _resting(case: Case, found: _Swing) -> float | None:
    """The part of the window in which the joint rests, if it is a tenth of it and it rests again and again."""
    at = np.abs(case.run.v[found.window, found.joint]) < RESTING
    share, stops = float(at.mean()), int(np.sum(at[1:] & ~at[:-1]))
    lasts = abs(found.line.zeta) < RINGING
    if not (lasts and RESTS < share < 1.0 and stops >= STOPS) or found.line.omega * case.dt > SAMPLED:
        return None
    return share


def _stick_slip(case: Case, found: _Swing, rest: float) -> Finding:
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
    remedy = "add FrictionCompensation(at='ref') or a Dither; or lower ki, or stop the integral within the tolerance"
    return _limit_cycle(case, found, "stick-slip", "I" if _integrates(case, i) else "friction", share, text, remedy)


def _integrates(case: Case, i: int) -> bool:
    """Whether an integral has a part in a joint's feedback that counts."""
    integral = case.feedback_terms.get("I", np.zeros_like(case.feedback))[:, i]
    return float(np.sum(integral**2)) > LEAST_SHARE * float(np.sum(case.feedback[:, i] ** 2))


def _gives(case: Case, found: _Swing, works: dict[str, float]) -> bool:
    """Whether something gives between motor and link: torque takes work out of a swing that lasts all the same."""
    done = sum(abs(work) for work in works.values()) or 1.0
    slow = found.line.omega * case.dt <= SAMPLED
    return abs(found.line.zeta) < STEADY and slow and _taken(case, found) > LOST * done


def _dwell(case: Case, found: _Swing, works: dict[str, float]) -> float | None:
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
    case: Case, found: _Swing, name: str, term: str, more: dict[str, Number], text: str, remedy: str
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


def _shown(case: Case, found: _Swing) -> Picture:
    run, i = case.run, found.joint
    last = slice(
        max(0, found.window.stop - max(64, round(12.0 / (found.line.frequency * case.dt)))), found.window.stop
    )
    curves = {name: value[last, i] for name, value in case.feedback_terms.items() if np.any(value[last, i])}
    title = f"{run.joint_names[i]}: {found.line.frequency:.3g} Hz"
    return Picture(title=title, ylabel=f"[{run.effort_units[i]}]", t=run.t[last], curves=curves)


# -------------------------------------------------------------------- the loop's own


def _of_the_loop(case: Case, found: _Swing, works: dict[str, float]) -> Finding:
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
        remedy = _more_damping(case, found)
    elif feeds == "I":
        remedy = _less_integral(case, found)
    elif feeds == "delay":
        remedy = _less_delay(case, found)
    elif feeds in limits:
        remedy = f"ask for less than the {feeds.replace('_', ' ')} gives: what it takes away comes late"
    else:
        remedy = _lower_gain(case, found, feeds)
    words = (
        "grows" if line.growth > STEADY * line.omega else "lasts" if abs(line.zeta) < STEADY else "dies out slowly"
    )
    swing = line_of(run.q[found.window, i], case.dt, 0.5 * line.omega)
    return Finding(
        name="oscillates",
        term=feeds,
        joint=run.joint_names[i],
        share=found.share,
        evidence={
            "frequency": Number(line.frequency, "Hz"),
            "growth": Number(line.growth, "1/s"),
            "damping ratio": Number(line.zeta),
            "amplitude": Number(0.0 if swing is None else swing.amplitude, run.units[i]),
            "of the work on it": Number(100.0 * max(fed, 0.0), "%"),
        },
        text=f"'{run.joint_names[i]}' oscillates at {line.frequency:.3g} Hz, which {words}",
        remedy=remedy,
        picture=_shown(case, found),
    )


def _slope(y: Float64Array, x: Float64Array) -> float:
    """Least squares of y = k x, both about their trends."""
    y, x = _ac(y[:, np.newaxis])[:, 0], _ac(x[:, np.newaxis])[:, 0]
    return float(np.sum(y * x) / max(float(np.sum(x * x)), np.finfo(np.float64).tiny))


def _stiff_and_damped(case: Case, found: _Swing) -> tuple[float, float, float]:
    """Stiffness, damping and inertia of a joint in its oscillation: k = -P / q, d = -D / v, m = k / omega^2."""
    run, i, w = case.run, found.joint, found.window
    k = -_slope(run.terms["P"][w, i], run.q[w, i]) if "P" in run.terms else 0.0
    d = -_slope(run.terms["D"][w, i], run.v[w, i]) if "D" in run.terms else 0.0
    if case.model is not None:
        return k, d, float(case.model.inertia_felt(w.start)[i])
    return k, d, abs(k) / found.line.omega**2


def _more_damping(case: Case, found: _Swing) -> str:
    k, d, m = _stiff_and_damped(case, found)
    units = f"{case.run.effort_units[found.joint]} s/{case.run.units[found.joint]}"
    if k <= 0.0 or m <= 0.0:
        return "raise the damping (kd, B or zeta); it does next to no work on this oscillation"
    return (
        f"raise the damping of '{case.run.joint_names[found.joint]}' from {max(d, 0.0):.3g} to "
        f"{2.0 * 0.7 * math.sqrt(k * m):.3g} {units} for zeta = 0.7"
    )


def _less_integral(case: Case, found: _Swing) -> str:
    run, i, w = case.run, found.joint, found.window
    k, d, _ = _stiff_and_damped(case, found)
    m = abs(k) / found.line.omega**2
    if k <= 0.0 or case.error is None:
        return "lower ki: the integral feeds this oscillation"
    rate = _slope(np.diff(run.terms["I"][w, i]) / case.dt, case.error[w, i][1:])
    return (
        f"lower ki: as torques it is {rate:.3g} at '{run.joint_names[i]}', and it must stay under "
        f"(b + kd) kp / M = {max(d, 0.0) * k / m:.3g}"
    )


def _less_delay(case: Case, found: _Swing) -> str:
    """What the phase between command and torque says of the delay, and what it allows."""
    run, i, w, omega = case.run, found.joint, found.window, found.line.omega
    turn = np.exp(-1j * omega * run.t[w]) * np.hanning(w.stop - w.start)
    asked, given = (complex(np.sum(_ac(x[w, i : i + 1])[:, 0] * turn)) for x in (run.command, run.tau))
    late = (-np.angle(given / asked) if asked else 0.0) % (2.0 * math.pi) / omega
    _, d, m = _stiff_and_damped(case, found)
    most = math.pi * m / (6.0 * (late + 0.5 * case.dt))
    return (
        f"the drives give the torque {1e3 * late:.3g} ms late: make them faster, or lower the damping of "
        f"'{run.joint_names[i]}' from {max(d, 0.0):.3g} to {most:.3g} {run.effort_units[i]} s/{run.units[i]} "
        "(60 deg of phase margin) and kp with its square"
    )


def _lower_gain(case: Case, found: _Swing, term: str) -> str:
    run, i = case.run, found.joint
    _, d, m = _stiff_and_damped(case, found)
    if term == "D" and case.model is not None:
        return (
            f"lower kd, or raise the rate: the damping of '{run.joint_names[i]}' is {d:.3g}, and a sampled loop "
            f"bears 2 M / T = {2.0 * m / case.dt:.3g} {run.effort_units[i]} s/{run.units[i]} at most, less with a "
            "filter or differenced velocities"
        )
    return f"lower the gain of {term} to a half, or raise the rate from {run.rate:g} Hz: it feeds this oscillation"
