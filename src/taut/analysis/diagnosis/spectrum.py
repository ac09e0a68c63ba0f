"""Oscillation and chatter: a damped sinusoid in the feedback, the work that feeds it, and broad-band torque noise."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import butter, detrend, sosfiltfilt

from taut.base.types import Float64Array
from taut.control.limits import LIMIT_TERMS

if TYPE_CHECKING:
    from taut.analysis.diagnosis.check import ExaminedRun, Finding

MIN_PERIODS: Final = 4.0  # in a window: fewer are not a sustained oscillation
MIN_TICKS: Final = 32  # of a window
EXCITATION: Final = ("environment", "dither", "feedforward", "wrench", "sensor")  # which excite an arm: no fault
TWO_PI: Final = 2.0 * math.pi


@dataclass(frozen=True, kw_only=True)
class Sinusoid:
    """y = exp(growth t) (a cos(omega t) + b sin(omega t)) + c + d t over a window."""

    omega: float  # [rad/s]
    growth: float  # [1/s]
    amplitude: float  # in the middle of the window, in the unit of the signal
    last: float  # amplitude at its end
    fraction: float  # 0 to 1: of the variance of the signal about its trend

    @property
    def zeta(self) -> float:
        """Damping ratio; negative where it grows."""
        return -self.growth / math.hypot(self.growth, self.omega)


def fit_sinusoid(y: Float64Array, dt: float, above: float = 0.0, fraction: float = 0.0) -> Sinusoid | None:
    """The strongest damped sinusoid of a signal, of at least four periods; None of a short or constant window.

    From the peak of the Hann-windowed spectrum, least squares in growth and frequency; the linear parameters are
    solved for in each step (variable projection). Half of the variance `fraction` must be at omega > above [rad/s].
    """
    k = len(y)
    if k < MIN_TICKS or not np.isfinite(y).all():
        return None
    x = np.linspace(-1.0, 1.0, k)  # growth is scaled with half of the window
    trend = np.column_stack([np.ones(k), x])
    ac = detrend(y)
    power = float(np.sum(ac**2))
    spectrum = np.abs(np.fft.rfft(ac * np.hanning(k)))
    omegas = TWO_PI * np.fft.rfftfreq(k, dt)
    whole = float(np.sum(spectrum**2))
    spectrum[omegas < max(above, MIN_PERIODS * TWO_PI / (k * dt))] = 0.0
    if power <= 0.0 or not spectrum.any() or float(np.sum(spectrum**2)) < 0.5 * fraction * whole:
        return None
    start, width, half = float(omegas[int(np.argmax(spectrum))]), TWO_PI / (k * dt), 0.5 * (k - 1) * dt

    def basis(p: Float64Array) -> Float64Array:
        grown, angle = np.exp(p[0] * x), (start + p[1] * width) * half * x
        return np.column_stack([grown * np.cos(angle), grown * np.sin(angle), trend])

    def rest(p: Float64Array) -> Float64Array:
        B = basis(p)
        return np.asarray(y - B @ np.linalg.lstsq(B, y, rcond=None)[0]) / math.sqrt(power)

    p = least_squares(rest, [0.0, 0.0], bounds=([-40.0, -2.0], [40.0, 2.0]), max_nfev=40).x
    values = np.linalg.lstsq(basis(p), y, rcond=None)[0]
    # At half of the rate sine and cosine coincide at the ticks, and the size of each may be anything.
    shown = float(np.abs(basis(p)[:, :2] @ values[:2] * np.exp(-p[0] * x)).max())
    amplitude = min(math.hypot(values[0], values[1]), shown)
    return Sinusoid(
        omega=start + float(p[1]) * width,
        growth=float(p[0]) / half,
        amplitude=amplitude,
        last=amplitude * math.exp(p[0]),
        fraction=1.0 - float(np.sum(rest(p) ** 2)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Oscillation:
    """An oscillation of the feedback of a joint."""

    joint: int  # where it is strongest
    window: slice  # its ticks
    fraction: float  # 0 to 1: of the feedback effort in the run
    sinusoid: Sinusoid | None  # None of an unstable loop that left its limits too fast
    kind: str = "oscillation"  # or "stick-slip", "backlash"
    term: str = ""  # that feeds it; "D" where it lacks damping
    evidence: Mapping[str, tuple[float, str]] = field(default_factory=dict)  # of its kind


def find_oscillation(run: ExaminedRun) -> Oscillation | None:
    """The oscillation of a run, by kind and by the term that feeds it.

    It is fed by the term that does positive work on it, sum tau_term dq over whole ticks, with the zero-order hold.
    It is stick-slip where the joint comes to rest again and again; backlash, or a flexible joint, where the drives'
    torque takes work out of a sustained one; none where the environment or a term without error excites the arm.
    """
    found = _strongest(run) or _unstable(run)
    if found is None:
        return None
    limit, i, line = run.threshold, found.joint, found.sinusoid
    slow = line is not None and abs(line.zeta) < limit["damping ratio"] and line.omega * run.dt < limit["frequency"]
    at_rest = run.resting[found.window, i]
    stops = int(np.sum(at_rest[1:] & ~at_rest[:-1]))
    if slow and limit["at rest"] < at_rest.mean() < 1.0 and stops >= 3:
        terms = run.run.terms
        term = "friction" if np.any(terms.get("friction", 0.0)) or not _integrates(run, i) else "I"
        rest = {"at rest": (100.0 * float(at_rest.mean()), "% of the time")}
        return dataclasses.replace(found, kind="stick-slip", term=term, evidence=rest)
    work, taken = _work(run, found.window)
    done = sum(abs(x) for x in work.values()) or 1.0
    term = max(work, key=lambda name: work[name])
    fed = work[term] / done
    if (term in EXCITATION and fed > limit["part"]) or (
        line is not None and line.zeta < -0.01 and fed <= limit["part"]
    ):
        return None  # excited from outside; or nothing could make it grow
    gives = slow and line is not None and abs(line.zeta) < 0.01 and taken > 0.01 * done
    if gives and line is not None:
        third = _third_harmonic(run, found.window, i, line.omega)
        kind = "backlash" if third > limit["third harmonic"] and not run.cut[found.window].any() else "oscillation"
        evidence = {"third harmonic": (100.0 * third, "%"), "work taken out": (100.0 * taken / done, "%")}
        return dataclasses.replace(found, kind=kind, term="transmission", evidence=evidence)
    limits = (*LIMIT_TERMS, "torque")
    if work["delay"] > limit["part"] * done:  # what a limit takes then acts late too
        term = max((name for name in work if name not in limits), key=lambda name: work[name])
    fed = work[term] / done
    if fed < limit["part"] or (term == "P" and line is not None and line.omega * run.dt < limit["frequency"]):
        term, fed = "D", 0.0  # nothing feeds it: it lacks damping
    more = {"of the work on it": (100.0 * max(fed, 0.0), "%")}
    if term == "delay" and line is not None:
        more["delay"] = (1e3 * _delay(run, found, line.omega), "ms")
    return dataclasses.replace(found, kind="oscillation", term=term, evidence=more)


def _strongest(run: ExaminedRun) -> Oscillation | None:
    """The sinusoid that explains most of the feedback of any joint, in the last half of the run or else in all."""
    limit, count = run.threshold, len(run.run)
    for window in (slice(count // 2, count), slice(0, count)):
        y = run.feedback[window] / run.scale
        variance = np.sum((y - y.mean(axis=0)) ** 2, axis=0)
        of_run = run.energy(run.feedback[window]) / run.effort
        best: Oscillation | None = None
        for i in np.flatnonzero(of_run * variance > limit["effect"] * variance.sum()).tolist():
            line = fit_sinusoid(
                y[:, i], run.dt, 5.0 * _reference_frequency(run, window), limit["part of the variance"]
            )
            if (
                line is None
                or line.fraction < limit["part of the variance"]
                or not -0.3 < line.zeta < limit["damping ratio"]
            ):
                continue
            moved = fit_sinusoid(run.run.q[window, i], run.dt, 0.5 * line.omega)
            amplitude = 0.0 if moved is None else moved.amplitude * math.sqrt(max(moved.fraction, 0.0))
            if max(line.amplitude, line.last) < limit["torque change"] and amplitude < run.tolerance[i]:
                continue
            fraction = min(1.0, of_run * line.fraction * float(variance[i]) / (float(variance.sum()) or 1.0))
            if best is None or fraction > best.fraction:
                best = Oscillation(joint=i, sinusoid=line, window=window, fraction=fraction)
        if best is not None and best.fraction >= limit["effect"]:
            return best
    return None


def _unstable(run: ExaminedRun) -> Oscillation | None:
    """A loop that left its limits before a sinusoid could be fitted, and that was judged unstable at its start."""
    judged = run.run.info.stability
    if not run.ran_away or judged is None or judged.stable is not False or len(run.run) < 3:
        return None
    i = int(np.argmax(np.max(np.abs(run.feedback / run.scale), axis=0)))
    return Oscillation(joint=i, window=slice(0, len(run.run)), fraction=1.0, sinusoid=None)


def _reference_frequency(run: ExaminedRun, window: slice) -> float:
    """[rad/s] of the reference: RMS of its acceleration over RMS of its speed."""
    v = run.reference_speed[window]
    speed = float(np.sqrt(np.mean(v**2)))
    return float(np.sqrt(np.mean((np.diff(v, axis=0) / run.dt) ** 2))) / speed if speed > 0.0 else 0.0


def _work(run: ExaminedRun, window: slice) -> tuple[dict[str, float], float]:
    """Work on the oscillation by term, and what drives and environment together take out of it.

    "delay" is what the drives make of the command, "torque" what is beyond their limit, "environment" J^T F_ext.
    """
    record = run.run
    window = slice(window.start, min(window.stop, len(record) - 1))
    steps = detrend(run.steps[window], axis=0)

    def work(x: Float64Array) -> float:
        return float(np.sum(detrend(x[window], axis=0) * steps))

    pinned = run.cuts["torque"]
    names = [*run.feedback_terms, *(name for name in (*LIMIT_TERMS, *EXCITATION) if name in record.terms)]
    out = {name: work(record.terms[name]) for name in names}
    out |= {
        "torque": work(pinned),
        "delay": work(record.tau - record.command - pinned),
        "environment": work(run.external),
    }
    return out, -work(record.tau + run.external)


def _third_harmonic(run: ExaminedRun, window: slice, i: int, omega: float) -> float:
    """The third harmonic of the acceleration of a joint over its first: a spring gives next to none."""
    first, third = (abs(_component(np.diff(run.run.v[window, i]), m * omega * run.dt)) for m in (1, 3))
    return third / max(first, np.finfo(np.float64).tiny)


def _component(x: Float64Array, angle: float) -> complex:
    """The component of a signal that rotates by an angle a tick [rad], in a Hann window."""
    return complex(np.sum(x * np.hanning(len(x)) * np.exp(-1j * angle * np.arange(len(x)))))


def _integrates(run: ExaminedRun, i: int) -> bool:
    """Whether an integral has a part in the feedback of a joint."""
    integral = run.feedback_terms.get("I", np.zeros_like(run.feedback))[:, i]
    return float(np.sum(integral**2)) > 0.01 * float(np.sum(run.feedback[:, i] ** 2))


def _delay(run: ExaminedRun, found: Oscillation, omega: float) -> float:
    """[s] between command and torque, less than a period of the oscillation."""
    asked, given = (
        _component(detrend(x[found.window, found.joint]), omega * run.dt) for x in (run.run.command, run.run.tau)
    )
    return float(-np.angle(given / asked) % TWO_PI) / omega if asked else 0.0


def oscillation(run: ExaminedRun, kind: str) -> Finding | None:
    """A sinusoid of little damping that is half of the feedback of a joint, of a kind, by the term that feeds it."""
    found = run.oscillation
    if found is None or found.kind != kind:
        return None
    i, line, ticks = found.joint, found.sinusoid, len(run.run)
    judged = run.run.info.stability
    evidence: dict[str, tuple[float, str]] = {}
    if line is None:
        evidence = {"spectral radius": (math.nan if judged is None or judged.radius is None else judged.radius, "1")}
    else:
        ticks = max(64, round(12.0 * TWO_PI / (line.omega * run.dt)))
        evidence = {
            "frequency": (line.omega / TWO_PI, "Hz"),
            "damping ratio": (line.zeta, "1"),
            "growth": (line.growth, "1/s"),
        }
    shown = slice(max(0, found.window.stop - ticks), found.window.stop)
    evidence["amplitude"] = (0.5 * float(np.ptp(run.run.q[shown, i])), run.run.units[i])
    lacks = found.term == "D" and found.evidence["of the work on it"][0] == 0.0
    factor = f", about {0.7 / line.zeta:.2g} times for a damping ratio of 0.7" if line and line.zeta > 0.005 else ""
    stability = f"; {judged.message}" if judged is not None and judged.stable is False else ""
    return run.finding(
        *(found.term, i, found.fraction, {**evidence, **found.evidence}),
        window=shown,
        remedy=f"raise the damping (kd, B or zeta){factor}" if lacks else "",
        note=stability,
    )


def chatter(run: ExaminedRun) -> Finding | None:
    """Broad-band torque above a fraction of the rate, with a total variation above ten effort limits per second."""
    record, limit = run.run, run.threshold
    asked = record.command - run.cut
    sos = butter(4, 2.0 * limit["band"], output="sos")
    edge = min(round(1.0 / limit["band"]), len(record) // 8)
    inside = slice(edge, len(record) - edge)

    def fast(x: Float64Array) -> Float64Array:
        return np.asarray(x - sosfiltfilt(sos, x, axis=0))

    def variation(x: Float64Array) -> Float64Array:
        return np.asarray(np.abs(np.diff(x[inside], axis=0)).sum(axis=0) / ((inside.stop - inside.start) * run.dt))

    noise = fast(asked)
    rate, rest = variation(noise), variation(asked - noise)
    bad = (rate > limit["torque rate"] * run.scale) & (rate > rest)
    if not bad.any() or run.oscillation is not None:
        return None
    i = int(np.argmax(bad * rate / run.scale))
    line = fit_sinusoid(noise[inside, i], run.dt)
    if line is not None and line.fraction > limit["part of the variance"]:
        return None  # an oscillation
    parts = {name: float(variation(fast(x))[i]) for name, x in record.terms.items() if name not in LIMIT_TERMS}
    evidence = {
        "total variation": (rate[i], f"{record.effort_units[i]}/s"),
        "lowest frequency": (limit["band"] / run.dt, "Hz"),
    }
    fraction = run.energy(noise * (bad if bad.all() else np.arange(run.n) == i)) / run.effort
    return run.finding(max(parts, key=lambda name: parts[name]), i, fraction, evidence)
