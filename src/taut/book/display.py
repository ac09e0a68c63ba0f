"""Figure 10.17: a haptic display of one direction, and how stiff an environment it can be."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.optimize import brentq

from taut.analysis.stiffness import check_virtual_wall
from taut.arm.load import load_arm
from taut.base.plot_style import DASHED, INK, SMALL, colour, prepared
from taut.book.drawing import arrow, box, legend, panels, words
from taut.book.oracle import held_radius
from taut.book.page import Entry, Page, Row, row
from taut.book.simulation import simulated, two_poles
from taut.control.laws.joint import PID
from taut.control.sensing.sensing import Sensing
from taut.control.trajectories.reference import JointMotion
from taut.controller import compile

__all__ = ["ENTRIES"]

MASS, DAMPING, VIRTUAL, RATE = 0.2, 1.0, 0.5, 1000.0  # [kg], [N s/m], [N s/m], [Hz] of the display, chosen
POLES: Final = "poles of the held mass"


def radius(stiffness: float, rate: float) -> float:
    """Largest modulus of the display's poles."""
    return held_radius(MASS, DAMPING, stiffness, VIRTUAL, rate)


def stiffest(rate: float) -> float:
    """Up to which it is stable, by bisection on those poles [N/m]."""
    return float(brentq(lambda k: radius(k, rate) - 1.0, 1.0, 1e6))


def fig_10_17() -> Page:
    rows: list[Row] = []
    rates = np.array([250.0, 500.0, 1000.0, 2000.0, 4000.0])
    walls = [
        check_virtual_wall(mass=MASS, damping=DAMPING, B=VIRTUAL, rate=float(rate), velocity="difference")
        for rate in rates
    ]
    for wall, rate in zip(walls, rates.tolist(), strict=True):
        name = f"stiffest stable spring at {rate:g} Hz"
        rows.append(row(name, "N/m", wall.limit, stiffest(rate), f"{POLES}, bisected", rel=1e-5))
    passive = (DAMPING - VIRTUAL) * 2.0 * RATE
    name = "stiffest spring that is safe in any hand, 1 kHz"
    rows.append(row(name, "N/m", walls[2].passive_limit, passive, "Colgate: (b - |B|) / (T / 2)", rel=1e-3))
    z = load_arm("gantry3").subset(["z"]).with_body("z", mass=MASS)
    slide = z.with_joints(viscous=DAMPING).with_gravity([0.0, 0.0, 0.0])
    ctrl = compile(PID(kp=1.0, kd=VIRTUAL), slide, rate=RATE, sensing=Sensing(velocity="difference"))
    for factor in (0.8, 1.2):
        K = factor * walls[2].limit
        ctrl.parameters["law.kp"] = K
        rest = JointMotion(q=[0.0])
        out = simulated(ctrl, slide, rest, duration=0.4, q0=[1e-3], friction="arm", integrator="rk4")
        got = float(np.exp(max(two_poles(out.q[100:, 0], 1.0).real)))
        states = "oscillatory in stiff virtual environments" if factor > 1.0 else ""
        name = f"growth of an oscillation in a tick, K = {factor:g} of the limit"
        rows.append(row(name, "", got, radius(K, RATE), POLES, rel=1e-5, states=states))
    figure, (left, right) = panels(2, 2.5, width_ratios=[1.0, 1.1])
    _display(left)
    prepared(right, "how stiff the environment may be", "K [N/m]", "servo rate [Hz]")
    for k, name, values in (
        (0, "stable alone", [each.limit for each in walls]),
        (2, "safe in any hand", [each.passive_limit for each in walls]),
    ):
        right.plot(rates, values, "o-", color=colour(k), markersize=4.0, linewidth=1.3, label=name)
    right.plot(
        rates, 2.0 * (DAMPING - VIRTUAL) * rates, color=INK, linestyle=DASHED, linewidth=0.9, label="2 (b - |B|) / T"
    )
    right.set_xticks([250.0, 1000.0, 2000.0, 4000.0])
    right.set_ylim(0.0, None)
    legend(right)
    note = (
        "Chosen: a display of 0.2 kg with 1 N s/m that shows a spring and 0.5 N s/m, with differenced positions. "
        "More of it is on the page about haptics."
    )
    return Page(rows=tuple(rows), figure=figure, note=note)


def _display(ax: Any) -> None:
    """A mass on a spring and a damper, that a hand pushes."""
    ax.axis("off")
    ax.set_aspect("equal")
    box(ax, 0.05, 1.0, 0.1, 1.6, fill="#D9DEE4")
    x = np.linspace(0.1, 2.0, 200)
    zigzag = 1.45 + 0.16 * np.interp((x - 0.4) * 5.0 % 1.0, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0]) * (
        (x > 0.4) & (x < 1.7)
    )
    ax.plot(x, zigzag, color=INK, linewidth=1.1)
    words(ax, 1.05, 1.8, "k", size=SMALL + 1.0)
    ax.plot([0.1, 0.85], [0.6, 0.6], color=INK, linewidth=1.1)
    ax.plot([1.3, 0.85, 0.85, 1.3], [0.76, 0.76, 0.44, 0.44], color=INK, linewidth=1.1)
    ax.plot([1.1, 1.1], [0.48, 0.72], color=INK, linewidth=1.6)
    ax.plot([1.1, 2.0], [0.6, 0.6], color=INK, linewidth=1.1)
    words(ax, 1.05, 0.26, "b", size=SMALL + 1.0)
    box(ax, 2.5, 1.0, 1.0, 1.2)
    words(ax, 2.5, 1.0, "m", size=SMALL + 1.0, zorder=3)
    arrow(ax, (3.0, 1.0), (3.68, 1.0), width=1.6)
    words(ax, 3.5, 1.2, "f: the hand", ha="center")
    arrow(ax, (2.5, 1.85), (3.1, 1.85))
    words(ax, 3.2, 1.85, "x")
    ax.set_xlim(-0.1, 4.0)
    ax.set_ylim(-0.1, 2.2)


ENTRIES: Final = (Entry(id="fig-10.17", title="a virtual mass, spring and damper", make=fig_10_17),)
