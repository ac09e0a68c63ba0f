"""Section 10.2.1.4: static friction, dithering against it, and larger gains near zero velocity."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import brentq

from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.base.plot_style import DASHED, INK, colour, prepared
from taut.book.drawing import legend, panels
from taut.book.friction import KINETIC, REST, STATIC, STICKING
from taut.book.link import M, controller, link, on_link
from taut.book.page import Entry, Page, row
from taut.book.single_joint import ConstantTorque
from taut.control.law import Law
from taut.control.laws.friction import Dither, RaisedGains
from taut.control.laws.joint import PID
from taut.control.trajectories.reference import JointMotion
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ENTRIES"]

AMPLITUDE, FREQUENCY = 1.5, 40.0  # [N m], [Hz] chosen: three times b_static
OMEGA: Final = 2.0 * math.pi * FREQUENCY
SETTLED, LAST = 20, 40  # periods of the dither after which a mean is taken, and until when
PUSHES: Final = (0.05, 0.1, 0.2)  # [N m], all below b_kinetic
SHAKEN: Final = math.sqrt(AMPLITUDE**2 - (4.0 * KINETIC / math.pi) ** 2) / (OMEGA * M)  # [rad/s]
GAIN, FACTOR = 5.0, 4.0  # [N m/rad] of PD control near rest, and times that
SOLVED: Final = "M a + tau_fric = tau, arc by arc"


@cache
def dry() -> Arm:
    """The link in a horizontal plane, with static and kinetic friction and no other."""
    return link(gravity=False, b=0.0).with_friction(Friction(coulomb=KINETIC, static=STATIC))


def pushed(push: float, law: Law | None, duration: float = LAST / FREQUENCY) -> Run:
    """A run under a constant torque, and a law beside it."""
    constant = ConstantTorque(tau=push)
    ctrl = controller(constant if law is None else constant + law, dry())
    steps = 4  # of the plant in a tick: each rest ends in one of them
    return on_link(ctrl, plant=dry(), ref=REST, duration=duration, q0=[0.0], integrator=STICKING, substeps=steps)


def mean_speed(push: float) -> float:
    """Of a run with dither, over whole periods [rad/s]."""
    run = pushed(push, Dither(amplitude=AMPLITUDE, frequency=FREQUENCY))
    first = round(SETTLED / FREQUENCY * run.rate)
    return float((run.q[-1, 0] - run.q[first, 0]) / (run.t[-1] - run.t[first]))


def mean_speed_solved(push: float) -> float:
    """The same of the equation of motion, whose arcs between rests are known functions of time.

    While it slides, M v = M v0 + A (cos(w t0) - cos(w t)) / w + (push - s b_kinetic) (t - t0), s the sign of v. At
    rest it stays until the torque is b_static.
    """
    t, q, marks = 0.0, 0.0, {}
    while t < LAST / FREQUENCY:
        t = _breaks_away(t, push)
        s = math.copysign(1.0, push + AMPLITUDE * math.sin(OMEGA * t))
        end = _rests(t, push, s)
        for k in (SETTLED, LAST):
            if t <= k / FREQUENCY < end:
                marks[k] = q + _way(t, k / FREQUENCY, push, s)
            elif k / FREQUENCY < t:
                marks.setdefault(k, q)
        q, t = q + _way(t, end, push, s), end
    marks.setdefault(LAST, q)
    return (marks[LAST] - marks[SETTLED]) * FREQUENCY / (LAST - SETTLED)


def _breaks_away(t: float, push: float) -> float:
    """When a joint at rest moves again: the first time from t on at which the torque is b_static."""
    over = [abs(push + AMPLITUDE * math.sin(OMEGA * u)) - STATIC for u in _grid(t)]
    k = next(k for k, y in enumerate(over) if y >= 0.0)
    if k == 0:
        return t
    u = _grid(t)
    return float(brentq(lambda u: abs(push + AMPLITUDE * math.sin(OMEGA * u)) - STATIC, u[k - 1], u[k], xtol=1e-15))


def _rests(t: float, push: float, s: float) -> float:
    """When a joint that breaks away at t, in the direction s, is at rest again."""

    def momentum(u: float) -> float:
        shaken = AMPLITUDE * (math.cos(OMEGA * t) - math.cos(OMEGA * u)) / OMEGA
        return s * (shaken + (push - s * KINETIC) * (u - t))

    u = _grid(t)
    k = next(k for k in range(2, len(u)) if momentum(u[k]) <= 0.0)
    return float(brentq(momentum, u[k - 1], u[k], xtol=1e-15))


def _way(t: float, end: float, push: float, s: float) -> float:
    """How far it slides meanwhile [rad]."""
    h = end - t
    shaken = AMPLITUDE / OMEGA * (math.cos(OMEGA * t) * h - (math.sin(OMEGA * end) - math.sin(OMEGA * t)) / OMEGA)
    return (shaken + 0.5 * (push - s * KINETIC) * h * h) / M


def _grid(t: float) -> list[float]:
    """Times in the next two periods, close enough to see each change of sign."""
    return [t + 2.0 * k / (400.0 * FREQUENCY) for k in range(401)]


def sec_10_2_1_4() -> Page:
    wave = controller(Dither(amplitude=AMPLITUDE, frequency=FREQUENCY), link(gravity=False))
    run = on_link(wave, plant=link(gravity=False), ref=REST, duration=1.0, q0=[0.0])
    dither = run.tau[: round(run.rate), 0]
    rows = [
        row(
            "mean of a dither of 1.5 N m at 40 Hz, over its size", "", np.mean(dither) / np.max(np.abs(dither)), 0.0,
            "zero mean", near=1e-9, states="zero-mean",
        ),
        row(
            f"speed after 1 s under {PUSHES[-1]:g} N m, from rest, no dither", "rad/s",
            pushed(PUSHES[-1], None, 1.0).v[-1, 0], 0.0, "|tau| < b_static", near=1e-12,
            states="some torque without any motion",
        ),
    ]  # fmt: skip
    got = {push: mean_speed(push) for push in PUSHES}
    for push, speed in got.items():
        wanted = mean_speed_solved(push)
        rows.append(row(f"mean speed under {push:g} N m, with dither", "rad/s", speed, wanted, SOLVED, rel=0.005))
    push, speed = next(iter(got.items()))
    wanted = push / (SHAKEN * math.sin(0.5 * math.pi * push / KINETIC))
    source = "viscous friction, (2 b_kinetic / pi) asin(v / V)"
    states = "to smooth the discontinuity"
    rows.append(
        row(f"{push:g} N m over that mean speed", "N m s/rad", push / speed, wanted, source, rel=0.03, states=states)
    )
    for factor in (1.0, FACTOR):
        for share in (0.99, 1.01):
            e = share * STATIC / (factor * GAIN)
            rows.append(
                row(
                    f"PD control, {'gains as they are' if factor == 1.0 else 'four times the gains at rest'}: moves "
                    f"at an error of {e:.4g} rad",
                    "0 or 1",
                    moves(e, factor),
                    share > 1.0,
                    "Kp e > b_static",
                    states="larger gains near rest" if factor > 1.0 and share > 1.0 else "",
                )
            )
    note = (
        "Chosen: b_static = 0.5 N m and b_kinetic = 0.3 N m as in figure 10.14 d, no other friction, a dither of "
        f"1.5 N m at 40 Hz, that shakes the link with V = {SHAKEN:.3g} rad/s; PD control with Kp = 5 N m/rad, and "
        "four times that near zero velocity."
    )
    return Page(rows=tuple(rows), figure=drawn(), note=note)


def moves(e: float, factor: float) -> bool:
    """Whether a joint at rest with an error breaks away, under PD control with its gains raised near rest."""
    law = RaisedGains(inner=PID(kp=GAIN, kd=1.0), factor=factor, width=0.05)
    run = on_link(
        controller(law, dry()), plant=dry(), ref=JointMotion(q=[e]), duration=0.05, q0=[0.0], integrator=STICKING
    )
    return bool(np.abs(run.q[:, 0]).max() > 1e-9)


def drawn() -> Figure:
    """The mean friction over the mean speed, with dither and without."""
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "friction, on average", "[N m]", "mean speed [rad/s]")
    pushes = np.linspace(-0.27, 0.27, 7)
    speeds = np.linspace(-SHAKEN, SHAKEN, 101)
    smooth = 2.0 * KINETIC / math.pi * np.arcsin(speeds / SHAKEN)
    ax.plot(speeds, smooth, color=INK, linewidth=0.9, label="(2 b / π) asin(v / V)")
    means = [mean_speed(push) for push in pushes.tolist()]
    ax.plot(means, pushes, "o", color=colour(1), markersize=4.0, label="runs with dither")
    step = [-KINETIC, -KINETIC, KINETIC, KINETIC]
    ax.plot([-SHAKEN, 0.0, 0.0, SHAKEN], step, color=colour(0), linestyle=DASHED, linewidth=1.0, label="without")
    legend(ax)
    return figure


ENTRIES: Final = (
    Entry(id="sec-10.2.1.4", title="dithering, and larger gains near zero velocity", make=sec_10_2_1_4),
)
