"""Section 10.2.1.1: what its text claims of tracking, of delays and of large gains, as numbers."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.optimize import brentq

from taut.analysis.loci import bisected
from taut.base.plot_style import colour, prepared
from taut.book.drawing import legend, panels
from taut.book.link import KD, KI, KP, B, M, controller, link, on_link
from taut.book.oracle import held_radius
from taut.book.page import Entry, Page, row
from taut.book.simulation import two_poles
from taut.control.laws.joint import PID
from taut.control.trajectories.joint import Sine
from taut.control.trajectories.reference import JointMotion
from taut.linear.joint_loop import error_dynamics, second_order
from taut.linear.linear_system import LinearSystem
from taut.plant.drives.actuation import Actuation
from taut.record.run import Run

__all__ = ["ENTRIES"]

RATE: Final = 100.0  # [Hz]


def amplitude(run: Run, w: float) -> float:
    """Of the error's part at a frequency, over the last whole turns of a run."""
    turn = 2.0 * math.pi / w
    last = run.between(run.t[-1] - 2.0 * turn, run.t[-1] - 1.0 / run.rate)
    assert last.error is not None
    phase = np.exp(-1j * w * last.t)
    return float(abs(2.0 * np.mean(last.error[:, 0] * phase)))


def following() -> Page:
    w, size = 2.0, 0.5
    sine = Sine(center=[0.0], amplitude=size, frequency=w / (2.0 * math.pi))
    rows = []
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "error while a sine is followed", "error [rad]", "t [s]")
    for k, ki in enumerate((0.0, KI)):
        run = on_link(
            PID(kp=KP, kd=KD, ki=ki), plant=link(gravity=False), ref=sine, duration=10.0 * math.pi, q0=[0.0]
        )  # fmt: skip
        s = 1j * w
        wanted = size * abs((M * s**2 + B * s) * s / (M * s**3 + (B + KD) * s**2 + KP * s + ki))
        name = f"Ki = {ki:g}"
        rows.append(
            row(
                f"amplitude of the error, {name}", "rad", amplitude(run, w), wanted, "the transfer function", rel=2e-3
            )
        )
        assert run.error is not None
        ax.plot(run.t[::100], run.error[::100, 0], color=colour(k), linewidth=1.4, label=name)
    ax.set_ylim(-0.32, 0.42)
    legend(ax, ncols=2)
    note = (
        "The chapter: integral control does not eliminate tracking error along arbitrary trajectories. Here it even "
        "grows. Chosen: 0.5 rad at 2 rad/s in a horizontal plane, gains of figure 10.6."
    )
    return Page(rows=tuple(rows), figure=figure, note=note)


def delayed() -> Page:
    def gain(w: float) -> float:
        s = 1j * w
        return abs((KP + KD * s) / (M * s**2 + B * s)) - 1.0

    crossover = brentq(gain, 0.1, 100.0)
    s = 1j * crossover
    margin = math.pi + float(np.angle((KP + KD * s) / (M * s**2 + B * s)))
    border = (margin % (2.0 * math.pi)) / crossover
    found = error_dynamics(M=M, b=B, kp=KP, kd=KD, rate=RATE).margins().delay
    rows = [
        row(
            "delay up to which PD control is stable",
            "s",
            found,
            border - 0.5 / RATE,
            "phase margin / crossover, less half a tick",
            rel=0.002,
        )
    ]
    for factor in (0.95, 1.05):
        taps = round(RATE * factor * border)
        run = on_link(
            controller(PID(kp=KP, kd=KD), link(gravity=False), rate=RATE), plant=link(gravity=False),
            ref=JointMotion(q=[0.0]), duration=24.0, q0=[0.1], actuation=Actuation(delay=taps / RATE),
        )  # fmt: skip
        late, early = (float(np.abs(run.between(*ends).q).max()) for ends in ((18.0, 24.0), (10.0, 16.0)))
        rows.append(
            row(f"it grows with a delay of {taps / RATE:g} s", "0 or 1", late > early, factor > 1.0, "that limit")
        )
    note = (
        "The chapter: delayed feedback can cause instability. Gains of figure 10.6, which are critically damped "
        "without a delay, in a horizontal plane at 100 Hz."
    )
    return Page(rows=tuple(rows), note=note)


def bounded() -> Page:
    """Critically damped designs at 100 Hz with differenced positions: in the book any of them is stable."""

    def sampled(omega_n: float) -> LinearSystem:
        return error_dynamics(M=M, b=B, omega_n=omega_n, zeta=1.0, rate=RATE, velocity="difference")

    def radius(omega_n: float) -> float:
        return held_radius(M, B, M * omega_n**2, 2.0 * M * omega_n - B, RATE)

    limit = bisected(lambda omega_n: sampled(omega_n).stable, 1.0, 100.0)
    gains = second_order(M=M, b=B, omega_n=limit, zeta=1.0)
    wanted = brentq(lambda omega_n: radius(omega_n) - 1.0, 1.0, 100.0)
    source = "poles of the held link, bisected"
    claim = "instability due to the finite servo rate"
    rows = [
        row("omega_n up to which zeta = 1 is stable at 100 Hz", "rad/s", limit, wanted, source, rel=1e-6),
        row("Kp there", "N m/rad", gains.kp, M * wanted**2, source, rel=1e-6),
        row(
            "the same in continuous time: stable",
            "0 or 1",
            error_dynamics(M=M, b=B, kp=gains.kp, kd=gains.kd).stable,
            1.0,
            "Re s < 0",
        ),
    ]
    plane, rest = link(gravity=False), JointMotion(q=[0.0])
    for factor in (0.95, 1.05):
        omega_n = factor * limit
        law = PID(kp=M * omega_n**2, kd=2.0 * M * omega_n - B)
        run = on_link(
            controller(law, plane, rate=RATE, differenced=True), plant=plane, ref=rest, duration=1.5, q0=[1e-3],
            substeps=4,
        )  # fmt: skip
        got = float(np.exp(max(two_poles(run.q[60:, 0], 1.0).real)))
        name = f"growth of an oscillation in a tick, omega_n = {factor:g} of that"
        rows.append(row(name, "", got, radius(omega_n), "poles of the held link", rel=1e-4, states=claim))
    note = (
        "According to the simple model Kp and Kd could grow without bound. With a servo of 100 Hz and differenced "
        "positions as in figure 10.8 they cannot, even with a torque that has no limits. In a horizontal plane."
    )
    return Page(rows=tuple(rows), note=note)


ENTRIES: Final = (
    Entry(
        id="sec-10.2.1.1",
        title="an integral does not remove the tracking error of a sine",
        make=following,
        part="sine",
    ),
    Entry(id="sec-10.2.1.1", title="delayed feedback destabilises", make=delayed, part="delay"),
    Entry(id="sec-10.2.1.1", title="practical bounds on gains", make=bounded, part="bounds"),
)
