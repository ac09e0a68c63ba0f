"""Figure 10.17: a haptic display of one direction, and how stiff an environment it can be."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from taut.apps.book.drawing import arrow, box, panels, words
from taut.apps.book.page import Entry, Page, Row, row
from taut.apps.book.tick import two_poles
from taut.arm.load import load_arm
from taut.control.joint import PID
from taut.control.reference import JointMotion
from taut.controller import compile
from taut.plant.rigid import RigidPlant
from taut.record.style import DASHED, INK, SMALL, colour, prepared
from taut.runtime.simulate import run
from taut.study.limits import stiffness_limits

__all__ = ["ENTRIES"]

MASS, DAMPING, RATE = 0.2, 1.0, 1000.0  # [kg], [N s/m], [Hz] of the display, chosen


def radius(stiffness: float, B_virtual: float, rate: float) -> float:
    """Largest modulus of the poles of a mass under u = -K x - B v, which is held over a tick."""
    T = 1.0 / rate
    A = np.array([[0.0, 1.0, 0.0], [0.0, -DAMPING / MASS, 1.0 / MASS], [0.0, 0.0, 0.0]])
    held = expm(A * T)
    closed = held[:2, :2] - np.outer(held[:2, 2], [stiffness, B_virtual])
    return float(np.abs(np.linalg.eigvals(closed)).max())


def stiffest(B_virtual: float, rate: float) -> float:
    """Up to which it is stable, by bisection on those poles [N/m]."""
    return float(brentq(lambda k: radius(k, B_virtual, rate) - 1.0, 1.0, 1e7))


def fig_10_17() -> Page:
    rows: list[Row] = []
    rates = np.array([250.0, 500.0, 1000.0, 2000.0, 4000.0])
    told = [stiffness_limits(mass=MASS, damping=DAMPING, rate=float(rate)) for rate in rates]
    for limits, rate in zip(told, rates.tolist(), strict=True):
        rows.append(
            row(
                f"stiffest stable spring at {rate:g} Hz",
                "N/m",
                limits.stable,
                stiffest(0.0, rate),
                "poles of the held mass, bisected",
                rel=1e-5,
            )
        )
    rows.append(
        row(
            "stiffest spring that is safe in any hand, 1 kHz",
            "N/m",
            told[2].passive,
            DAMPING * 2.0 * RATE,
            "Colgate: (b - |B|) / (T / 2)",
            rel=1e-3,
        )
    )
    slide = (
        load_arm("gantry3")
        .subset(["z"])
        .with_body("z", mass=MASS)
        .with_joints(viscous=DAMPING)
        .with_gravity([0.0, 0.0, 0.0])
    )
    ctrl = compile(PID(kp=1.0), slide, rate=RATE)
    for factor in (0.8, 1.2):
        ctrl.parameters["law.kp"] = factor * told[2].stable
        out = run(
            ctrl, RigidPlant(slide, integrator="rk4"), JointMotion(q=[0.0]), duration=0.4, q0=[1e-3], progress=False
        )
        got = float(np.exp(max(two_poles(out.q[:, 0], 1.0).real)))
        rows.append(
            row(
                f"growth of a swing in a tick, K = {factor:g} of the limit",
                "",
                got,
                radius(factor * told[2].stable, 0.0, RATE),
                "poles of the held mass",
                rel=1e-5,
            )
        )
    figure, (left, right) = panels(2, 2.5, width_ratios=[1.0, 1.1])
    _display(left)
    prepared(right, "how stiff the environment may be", "K [N/m]", "servo rate [Hz]")
    right.loglog(
        rates,
        [each.stable for each in told],
        "o-",
        color=colour(0),
        markersize=4.0,
        linewidth=1.3,
        label="stable alone",
    )
    right.loglog(
        rates,
        [each.passive for each in told],
        "o-",
        color=colour(2),
        markersize=4.0,
        linewidth=1.3,
        label="safe in any hand",
    )
    right.loglog(rates, 2.0 * DAMPING * rates, color=INK, linestyle=DASHED, linewidth=0.9, label="2 b / T")
    right.legend(fontsize=SMALL, frameon=False, labelcolor=INK)
    note = "Chosen: a display of 0.2 kg with 1 N s/m that shows a spring. More of it is on the page about haptics."
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
    arrow(ax, (3.7, 1.0), (3.02, 1.0), width=1.6)
    words(ax, 3.45, 1.2, "f: the hand", ha="center")
    arrow(ax, (2.5, 1.85), (3.1, 1.85))
    words(ax, 3.2, 1.85, "x")
    ax.set_xlim(-0.1, 4.0)
    ax.set_ylim(-0.1, 2.2)


ENTRIES: Final = (Entry(id="fig-10.17", title="a virtual mass, spring and damper", make=fig_10_17),)
