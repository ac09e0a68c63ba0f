"""Chatter: torque that jitters faster than any motion, and faster than a drive likes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.signal import butter, sosfiltfilt

from taut.analysis.diagnosis.case import Case
from taut.analysis.diagnosis.finding import Finding, Number, Picture
from taut.analysis.diagnosis.line import line_of
from taut.control.limits import LIMIT_TERMS, RATE_PER_EFFORT

__all__ = ["chatter_findings"]

LINE: Final = 0.5  # of the variance of the jitter: more in one line is an oscillation
FEWEST: Final = 64  # ticks
SMOOTH: Final = 20.0  # parts of the rate: what is faster is not motion that a loop controls
ORDER: Final = 4


def chatter_findings(case: Case, swings: bool) -> Iterator[Finding]:
    """Chatter: torque that jitters faster than any motion, and faster than a drive likes.

    What the law asks for above a twentieth of the rate is jitter. It is chatter where its total variation per second
    is more than ten times the effort limit, the rate that `Limits.of(arm, rate=True)` allows, and above that of the
    rest of the torque; and where no single line holds half of it, which would be an oscillation.
    """
    run = case.run
    if len(run) < FEWEST or not case.of_torque:
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
        "D": "low-pass the velocity, "
        f"sensing=taut.Sensing(velocity=taut.sensors.Difference(cutoff={cutoff:.0f})), a finer "
        f"encoder, or kd divided by {Number(over)}",
        "friction": "give friction by the reference, FrictionCompensation(at='ref'), or with a larger width",
    }.get(term, f"low-pass what {term} is made of, or divide its gain by {Number(over)}")
    yield Finding(
        name="chatters",
        term=term,
        joint=joint,
        share=min(1.0, float(np.sum((part / case.size) ** 2)) / case.effort),
        evidence={
            "total variation above the band": Number(float(jitter[i]), f"{unit}/s"),
            "of the rest": Number(float(smooth[i]), f"{unit}/s"),
            "band from": Number(low, "Hz"),
            "band to": Number(high, "Hz"),
        },
        text=f"the torque of '{joint}' jitters by {Number(float(jitter[i]))} {unit} per second between {low:.0f} and "
        f"{high:.0f} Hz",
        remedy=remedy,
        picture=Picture(
            title=f"{joint}: torque, and what is faster than {run.rate / SMOOTH:.0f} Hz of it",
            ylabel=f"[{unit}]",
            t=run.t,
            curves={"torque asked for": asked[:, i], "jitter": fast[:, i]},
        ),
    )
