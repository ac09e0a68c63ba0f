"""What swings: oscillations by the term that feeds them, limit cycles of friction and play, chatter."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.signal import butter, sosfiltfilt

from taut.base.types import Float64Array
from taut.control.limiting import LIMIT_TERMS
from taut.control.limits import RATE_PER_EFFORT
from taut.record.sticking import RESTING
from taut.study.diagnosis_case import Case
from taut.study.diagnosis_finding import Finding, Number, Picture
from taut.study.diagnosis_line import Line, line_of

__all__ = ["chatter_findings", "swing_findings"]

LINE: Final = 0.5  # of the variance of a joint's feedback that is one line
RINGING: Final = 0.1  # damping ratio under which it takes more than six periods to the chapter's 2 %
BOLTING: Final = 0.3  # what grows faster, sixfold in a period, is no oscillation but runs away
CONSTANT: Final = 1e-3  # damping ratio that a loop has by chance only: half a per cent in a period
STEADY: Final = 0.01  # damping ratio within which an oscillation neither grows nor dies out
LEAST_TORQUE: Final = 0.02  # of the effort: smaller oscillations count only by their error
LEAST_SHARE: Final = 0.01  # of the feedback's effort in the run: less is not why a run is as it is
HARMONICS: Final = 5.0  # of the reference's frequency: what the reference itself brings
FED: Final = 0.05  # of the work that is done on it: a term that feeds it does more
SAMPLED: Final = 0.3  # omega T from which the rate matters: a design stays below
RESTS: Final = 0.1  # of the window in which the joint rests, in a limit cycle of dry friction
FREE: Final = 3.0  # times the dwell at no torque that a sine would have
SMOOTH: Final = 20.0  # parts of the rate: what is faster is not motion that a loop controls
ORDER: Final = 4


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

    * stick-slip where the joint rests (|v| < 1e-4) for a tenth of the window between its jumps;
    * backlash where it neither grows nor dies out, no limit acts, and the link's acceleration dwells at none three
      times as long as that of a sine would; or where its size is constant within half a per cent in a period though
      one term feeds it and another brakes it: a linear loop would need luck for that;
    * else it is the loop's: the integral (I), the drives (delay), a limit (its term), or the gains against the rate
      (P, D); where no term feeds it, damping is missing (D).
    """
    if not case.of_torque:
        return
    found = _strongest(case)
    if found is None:
        return
    run, i = case.run, found.joint
    rest = _resting(case, found)
    if rest is not None:
        yield _limit_cycle(
            case,
            found,
            "stick-slip",
            "I" if _integrates(case, i) else "friction",
            {"rests for": Number(100.0 * rest, "% of the time")},
            "the joint sticks, the feedback grows until it breaks away, and it overshoots",
            "add FrictionCompensation(at='ref') or a Dither; or lower ki, or stop the integral within the tolerance",
        )
        return
    dwell = _dwell(case, found)
    if dwell is not None:
        yield _limit_cycle(
            case,
            found,
            "backlash",
            "transmission",
            {"without torque for": Number(100.0 * dwell, "% of the time")},
            "a cycle of constant size that no limit holds: the link goes to and fro between two teeth",
            f"lower kp at '{run.joint_names[i]}' (the gain bound of backlash, 2 friction / backlash), measure at the "
            "motor, or preload the gear",
        )
        return
    yield _of_the_loop(case, found)


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
    """Work of each term of feedback on the swinging motion, and, as "delay", of what the drives make of the sum."""
    run = case.run
    window = slice(found.window.start, min(found.window.stop, len(run) - 1))
    steps = _ac(case.steps[window])
    works = {name: float(np.sum(_ac(value[window]) * steps)) for name, value in case.feedback_terms.items()}
    works["delay"] = float(np.sum(_ac(run.tau[window] - run.command[window]) * steps))
    for name in LIMIT_TERMS:
        if name in run.terms:
            works[name] = float(np.sum(_ac(run.terms[name][window]) * steps))
    return works


# -------------------------------------------------------------------- limit cycles


def _resting(case: Case, found: _Swing) -> float | None:
    """The part of the window in which the joint rests while its feedback goes on, if it is a tenth of it."""
    at = np.abs(case.run.v[found.window, found.joint]) < RESTING
    share = float(at.mean())
    return share if RESTS < share < 1.0 and found.line.omega * case.dt < SAMPLED else None


def _integrates(case: Case, i: int) -> bool:
    """Whether an integral has a part in a joint's feedback that counts."""
    integral = case.feedback_terms.get("I", np.zeros_like(case.feedback))[:, i]
    return float(np.sum(integral**2)) > LEAST_SHARE * float(np.sum(case.feedback[:, i] ** 2))


def _dwell(case: Case, found: _Swing) -> float | None:
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
    works = _works(case, found)
    done = sum(abs(work) for work in works.values()) or 1.0
    balanced = max(works.values()) > FED * done and min(works.values()) < -FED * done
    if dwell > FREE * 2.0 / math.pi * math.asin(band) or (abs(line.zeta) < CONSTANT and balanced):
        return dwell
    return None


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


def _of_the_loop(case: Case, found: _Swing) -> Finding:
    run, i, line = case.run, found.joint, found.line
    works = _works(case, found)
    done = sum(abs(work) for work in works.values()) or 1.0
    late = works["delay"] > FED * done  # then what a limit takes acts late too, and brakes
    feeds = max((name for name in works if not (late and name in LIMIT_TERMS)), key=lambda name: works[name])
    fed = works[feeds] / done
    if fed < FED or (feeds == "P" and line.omega * case.dt < SAMPLED):
        feeds = "D"  # nothing feeds it: it lacks damping
        remedy = _more_damping(case, found)
    elif feeds == "I":
        remedy = _less_integral(case, found)
    elif feeds == "delay":
        remedy = _less_delay(case, found)
    elif feeds in LIMIT_TERMS:
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


# -------------------------------------------------------------------- chatter


def chatter_findings(case: Case, swings: bool) -> Iterator[Finding]:
    """Chatter: torque that jitters faster than any motion, and faster than a drive likes.

    What the law asks for above a twentieth of the rate is jitter. It is chatter where its total variation per second
    is more than ten times the effort limit, the rate that `Limits.of(arm, rate=True)` allows, and above that of the
    rest of the torque; and where no single line holds half of it, which would be an oscillation.
    """
    run = case.run
    if len(run) < 64 or not case.of_torque:
        return
    asked = run.command - sum((run.terms[name] for name in LIMIT_TERMS if name in run.terms), np.zeros_like(run.q))
    sos = butter(ORDER, 2.0 / SMOOTH, output="sos")
    fast = asked - sosfiltfilt(sos, asked, axis=0)
    edge = min(round(SMOOTH), len(run) // 8)
    inside = slice(edge, len(run) - edge)
    jitter = np.sum(np.abs(np.diff(fast[inside], axis=0)), axis=0) / ((inside.stop - inside.start) * case.dt)
    smooth = np.sum(np.abs(np.diff((asked - fast)[inside], axis=0)), axis=0) / (
        (inside.stop - inside.start) * case.dt
    )
    bad = (jitter > RATE_PER_EFFORT * case.size) & (jitter > smooth)
    if not bad.any():
        return
    i = int(np.argmax(bad * jitter / case.size))
    line = line_of(fast[inside, i], case.dt)
    if swings or (line is not None and line.share > LINE):
        return
    parts = {}
    for name, value in run.terms.items():
        if name not in LIMIT_TERMS:
            part = value - sosfiltfilt(sos, value, axis=0)
            parts[name] = float(np.sum(np.abs(np.diff(part[inside, i]))))
    term = max(parts, key=lambda name: parts[name])
    spectrum = np.abs(np.fft.rfft(fast[inside, i] * np.hanning(inside.stop - inside.start))) ** 2
    frequencies = np.fft.rfftfreq(inside.stop - inside.start, case.dt)
    share = np.cumsum(spectrum) / spectrum.sum()
    low, high = (float(frequencies[int(np.searchsorted(share, x))]) for x in (0.1, 0.9))
    joint, unit = run.joint_names[i], run.effort_units[i]
    part = fast * (np.arange(case.n) == i) if not bad.all() else fast
    over = jitter[i] / (RATE_PER_EFFORT * case.size[i])
    cutoff = max(5.0, high * over ** (-2.0 / 3.0) / 4.0)
    remedy = {
        "D": f"low-pass the velocity, sensing=taut.Sensing(velocity=taut.Difference(cutoff={cutoff:.0f})), a finer "
        f"encoder, or {over:.2g} times less kd",
        "friction": "give friction by the reference, FrictionCompensation(at='ref'), or with a larger width",
    }.get(term, f"low-pass what {term} is made of, or lower its gain {over:.2g} times")
    yield Finding(
        name="chatters",
        term=term,
        joint=joint,
        share=float(np.sum((part / case.size) ** 2)) / case.effort,
        evidence={
            "total variation above the band": Number(float(jitter[i]), f"{unit}/s"),
            "of the rest": Number(float(smooth[i]), f"{unit}/s"),
            "band from": Number(low, "Hz"),
            "band to": Number(high, "Hz"),
        },
        text=f"the torque of '{joint}' jitters by {jitter[i]:.3g} {unit} per second between {low:.0f} and "
        f"{high:.0f} Hz",
        remedy=remedy,
        picture=Picture(
            title=f"{joint}: torque, and what is faster than {run.rate / SMOOTH:.0f} Hz of it",
            ylabel=f"[{unit}]",
            t=run.t,
            curves={"torque asked for": asked[:, i], "jitter": fast[:, i]},
        ),
    )
