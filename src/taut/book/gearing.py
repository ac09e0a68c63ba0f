"""Section 10.2.1.5: what a gear does to a joint."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from taut.arm.builtin import one_joint
from taut.arm.description import Arm
from taut.arm.gears import matched_ratio, reflected_inertia
from taut.base.plot_style import DOTTED, INK, colour, prepared
from taut.book.drawing import legend, panels
from taut.book.link import controller, on_link
from taut.book.page import Entry, Page, row
from taut.book.single_joint import ConstantTorque
from taut.control.trajectories.reference import JointMotion
from taut.maths.snapshot import snapshot
from taut.maths.task_inertia import rotor_share

__all__ = ["ENTRIES"]

I_LINK, I_MOTOR = 1.0, 1e-3  # [kg m^2] the chapter's example
REST: Final = JointMotion(q=[0.0])
SUMS: Final = "I_link / (I_link + G^2 I_motor)"


def geared(ratio: float, *, load: float = 0.0, b: float = 0.0) -> Arm:
    """The chapter's example in a horizontal plane, with what it carries [kg m^2]."""
    return one_joint(M=I_LINK + load, m=1.0, r=0.1, b=b).with_gravity([0.0, 0.0, 0.0]).with_gears(ratio, I_MOTOR)


def acceleration(ratio: float, motor_torque: float = 1.0, load: float = 0.0) -> float:
    """Of a run of the geared link, under a torque of the motor [rad/s^2]."""
    arm = geared(ratio, load=load)
    run = on_link(
        controller(ConstantTorque(tau=ratio * motor_torque), arm, rate=1000.0),
        plant=arm,
        ref=REST,
        duration=0.1,
        q0=[0.0],
    )
    return float(run.v[-1, 0] / run.t[-1])


def sec_10_2_1_5() -> Page:
    matched = float(matched_ratio(I_LINK, I_MOTOR))
    best = minimize_scalar(
        lambda G: -G / (I_LINK + G**2 * I_MOTOR), bounds=(1.0, 200.0), method="bounded", options={"xatol": 1e-9}
    )
    share = [float(rotor_share(geared(G))[0]) for G in (1.0, 100.0, matched)]
    carried = [
        float(snapshot(geared(G, load=1.0), [0.0]).M[0, 0] / snapshot(geared(G), [0.0]).M[0, 0] - 1.0)
        for G in (1.0, 100.0)
    ]
    rows = [
        row("inertia that is the link's, G = 1", "%", 100.0 * (1.0 - share[0]), 100.0 / 1.001, SUMS, states="99.9 %"),
        row("torque that accelerates the motor, G = 1", "%", 100.0 * share[0], 0.1 / 1.001, SUMS, states="0.1 %"),
        row(
            "the motor's inertia over the link's, G = 100",
            "",
            float(reflected_inertia(100.0, I_MOTOR)) / I_LINK,
            10.0,
            "the chapter",
            states="ten times",
        ),
        row(
            "inertia matched at G",
            "",
            matched,
            best.x,
            "scipy.optimize: largest acceleration",
            rel=1e-6,
            states="sqrt(I_link / I_motor)",
        ),
        row("torque that accelerates the motor there", "", share[2], 0.5, "the chapter", states="half"),
    ]
    for G in (10.0, matched, 100.0):
        wanted = G / (I_LINK + G**2 * I_MOTOR)
        rows.append(
            row(
                f"acceleration of a run, 1 N m of the motor, G = {G:.4g}",
                "rad/s^2",
                acceleration(G),
                wanted,
                "G tau / (I_link + G^2 I_motor)",
                rel=1e-9,
            )
        )
    for G, got in zip((1.0, 100.0), carried, strict=True):
        wanted = 100.0 / (I_LINK + G**2 * I_MOTOR)
        name, states = f"change of the inertia with a load of 1 kg m^2, G = {G:g}", ""
        if G > 1.0:
            states = "geared: less sensitive"
        rows.append(row(name, "%", 100.0 * got, wanted, SUMS, states=states))
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "1 N m of the motor", "acceleration of the link [rad/s²]", "gear ratio G")
    ratios = np.geomspace(1.0, 300.0, 200)
    ax.plot(
        ratios,
        ratios / (I_LINK + ratios**2 * I_MOTOR),
        color=INK,
        linewidth=0.9,
        label="G tau / (I_link + G² I_motor)",
    )
    some = np.array([3.0, 10.0, matched, 100.0])
    ax.plot(some, [acceleration(G) for G in some.tolist()], "o", color=colour(1), markersize=4.0, label="runs")
    ax.axvline(matched, color=colour(0), linewidth=1.0, linestyle=DOTTED, label=f"inertia matched, {matched:.3g}")
    ax.set_xscale("log")
    legend(ax)
    return Page(
        rows=tuple(rows), figure=figure, note="I_link = 1 kg m^2 and I_motor = 1e-3 kg m^2, as in the chapter."
    )


def first_order() -> Page:
    """Where friction dominates, the joint is nearer to a viscous system of first order."""
    rows = []
    for G, b in ((1.0, 0.1), (100.0, 1000.0)):
        arm = geared(G, b=b)
        run = on_link(
            controller(ConstantTorque(tau=1.0), arm, rate=1000.0),
            plant=arm,
            ref=REST,
            duration=0.1,
            q0=[0.0],
            substeps=10,
        )
        tau = (I_LINK + G**2 * I_MOTOR) / b
        wanted = (0.1 - tau * (1.0 - math.exp(-0.1 / tau))) / b
        rows.append(
            row(
                f"way in 0.1 s under 1 N m, G = {G:g}, b = {b:g}",
                "rad",
                run.q[-1, 0],
                wanted,
                "the solution of M a + b v = tau",
                rel=1e-6,
            )
        )
        rows.append(
            row(
                "of what a first-order system tau = b v would go",
                "",
                run.q[-1, 0] * b / 0.1,
                wanted * b / 0.1,
                "the same",
                rel=1e-6,
            )
        )
    return Page(
        rows=tuple(rows),
        note="Chosen: b = 0.1 N m s/rad in direct drive, and 1000 with G = 100: the motor's friction, times G^2.",
    )


ENTRIES: Final = (
    Entry(id="sec-10.2.1.5", title="the effect of gearing", make=sec_10_2_1_5),
    Entry(id="sec-10.2.1.5", title="where friction dominates", make=first_order, part="friction"),
)
