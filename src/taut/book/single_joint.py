"""Section 10.2.1: the link, its friction, the error, and PID control of it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from taut.base.plot_style import INK, SMALL, colour
from taut.base.types import Float64Array
from taut.book.drawing import arrow, frame, law_diagram, panels, words
from taut.book.link import (
    KD,
    KI,
    KP,
    MASS,
    SAMPLED,
    B,
    G,
    M,
    R,
    controller,
    link,
    on_link,
    solved,
    weight,
)
from taut.book.page import BY_HAND, ODE, Entry, Page, row
from taut.book.simulation import ticked
from taut.control.command import Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.laws.friction import FrictionCompensation
from taut.control.laws.joint import PID
from taut.control.trajectories.joint import Sine
from taut.control.trajectories.reference import JointMotion, Sample
from taut.maths.snapshot import Snapshot, snapshot

__all__ = ["ENTRIES", "ConstantTorque", "pseudocode"]

THETA, V, A = 0.7, 1.3, -0.4  # [rad], [rad/s], [rad/s^2] a state of the link, chosen
STATE: Final = f"Chosen: theta = {THETA} rad, theta-dot = {V} rad/s, theta-ddot = {A} rad/s^2."


class ConstantTorque(Law):
    """A torque that nothing changes.

    Law:          tau = tau_0
    Closed loop:  M a + h = tau_0
    """

    ignores_reference = True
    tau: Gain = Gain(minimum=-math.inf)  # [N m | N]

    def command(self, x: Snapshot, ref: Sample) -> Torque:  # noqa: ARG002
        return Torque(constant=self.tau @ np.ones(x.n))


def eq_10_1() -> Page:
    tau = snapshot(link(), [THETA], [V]).inverse_dynamics(np.array([A]))[0]
    return Page(rows=(row("torque without friction", "N m", tau, M * A + weight(THETA), BY_HAND),), note=STATE)


def eq_10_2() -> Page:
    ctrl = ticked(FrictionCompensation(at="meas"), link(), [THETA], [V], JointMotion(q=[THETA]))
    return Page(rows=(row("friction torque", "N m", ctrl.terms["friction"][0], B * V, BY_HAND),), note=STATE)


def eq_10_3() -> Page:
    torque, duration = 0.8, 1.5
    run = on_link(ConstantTorque(tau=torque), ref=JointMotion(q=[0.0]), duration=duration, q0=[THETA], v0=[V])
    wanted = solved(lambda *_: torque, np.zeros_like, times=np.array([0.0, duration]), q0=THETA, v0=V)
    rows = (
        row("angle after 1.5 s under 0.8 N m", "rad", run.q[-1, 0], wanted.theta[-1], ODE),
        row("its rate", "rad/s", run.v[-1, 0], wanted.v[-1], ODE, rel=1e-8),
    )
    return Page(rows=rows, note="Chosen: a start at 0.7 rad and 1.3 rad/s, and the torque.")


def eq_10_4() -> Page:
    x = snapshot(link(), [THETA], [V])
    h = x.h[0] + float(x.viscous[0]) * V
    rows = (
        row("M", "kg m^2", x.M[0, 0], M, "section 10.2.1", states="0.5 kg m^2"),
        row("h: gravity and friction", "N m", h, weight(THETA) + B * V, BY_HAND),
    )
    return Page(
        rows=rows, note=f"Here x.h is C v + g, and friction a term of its own; the two are the chapter's h. {STATE}"
    )


def eq_10_5() -> Page:
    arm = link()
    rows = (
        row(
            "theta_d = 1.0 less theta = 0.25",
            "rad",
            arm.difference(np.array([1.0]), np.array([0.25]))[0],
            0.75,
            BY_HAND,
        ),
    )
    return Page(rows=rows)


def angles(count: int, dt: float) -> Float64Array:
    """(count,) what senseAngle gives in the pseudocode: some motion that is not the desired one."""
    t = dt * np.arange(count)
    made: Float64Array = 0.4 * np.sin(2.0 * t) + 0.02 * np.cos(11.0 * t)
    return made


WANTED: Final = Sine(center=[0.2], amplitude=0.5, frequency=0.4)


def pseudocode(angle: Float64Array, dt: float) -> Float64Array:
    """(k,) figure 10.8, line by line."""
    eint, qprev, commands = 0.0, angle[0], []
    for k, q in enumerate(angle):
        w = 2.0 * math.pi * 0.4
        qd, qdotd = 0.2 + 0.5 * math.sin(w * k * dt), 0.5 * w * math.cos(w * k * dt)
        qdot = (q - qprev) / dt
        qprev = q
        e = qd - q
        edot = qdotd - qdot
        eint = eint + e * dt
        commands.append(KP * e + KD * edot + KI * eint)
    return np.array(commands)


def ticks(law: Law, angle: Float64Array, rate: float) -> Float64Array:
    """(k,) the torques of a law that is given angles alone and differences them."""
    ctrl = controller(law, link(), rate=rate, differenced=True)
    return np.array([ctrl.step([q], ref=WANTED.at(k / rate))[0] for k, q in enumerate(angle)])


def eq_10_6() -> Page:
    law, ref = PID(kp=KP, kd=KD, ki=KI), JointMotion(q=[1.0], v=[0.3])
    ctrl = controller(law, link(), rate=1000.0)
    e_int = 0.0
    for theta in (0.2, 0.25, 0.31):
        tau = ctrl.step([theta], [V], ref)[0]
        e_int += (1.0 - theta) * 1e-3
    wanted = KP * (1.0 - 0.31) + KI * e_int + KD * (0.3 - V)
    return Page(
        rows=(row("torque in the third tick", "N m", tau, wanted, BY_HAND),),
        note="The integral is the sum over ticks of 1 ms, this tick included, as in figure 10.8; gains of 10.6.",
    )


def eq_10_7() -> Page:
    sine, duration = Sine(center=[0.0], amplitude=0.5, frequency=0.2), 2.0
    plane = link(gravity=False)
    run = on_link(PID(kp=KP, kd=KD), plant=plane, ref=sine, duration=duration, q0=[0.0])
    w = 2.0 * math.pi * 0.2

    def tau(t: float, theta: float, v: float, _: float) -> float:
        return KP * (0.5 * math.sin(w * t) - theta) + KD * (0.5 * w * math.cos(w * t) - v)

    wanted = solved(tau, lambda t: 0.5 * np.sin(w * t), times=np.array([0.0, duration]), q0=0.0, gravity=False)
    rows = (row("angle after 2 s of following a sine", "rad", run.q[-1, 0], wanted.theta[-1], ODE, rel=SAMPLED),)
    return Page(rows=rows, note="Chosen: PD gains of figure 10.6, 0.5 rad at 0.2 Hz, ticks of 0.1 ms.")


def eq_10_8() -> Page:
    plane, duration = link(gravity=False), 1.0
    run = on_link(PID(kp=KP, kd=KD), plant=plane, ref=JointMotion(q=[1.0]), duration=duration, q0=[0.0])
    s = (B + KD) / (2.0 * M)  # both roots: critically damped
    wanted = (1.0 + s * duration) * math.exp(-s * duration)
    rows = (
        row(
            "error 1 s after a step",
            "rad",
            1.0 - run.q[-1, 0],
            wanted,
            "(1 + s t) exp(-s t), s = (b + Kd) / 2 M",
            rel=SAMPLED,
        ),
    )
    return Page(rows=rows)


def fig_10_2() -> Page:
    theta = math.radians(35.0)
    x = snapshot(link(), [theta])
    T = x.T("tool")
    p = np.asarray(T.p)
    rows = (
        row("height of the centre of mass", "m", p[2], R * math.sin(theta), "r sin(theta)"),
        row("torque of gravity about the joint", "N m", x.g[0], MASS * G * R * math.cos(theta), "m g r cos(theta)"),
    )
    figure, (ax,) = panels(1, 2.9)
    ax.axis("off")
    ax.set_aspect("equal")
    centre, along = p[[0, 2]], p[[0, 2]] / R
    across = np.array([-along[1], along[0]])
    outline = np.array(
        [a * along + b * across for a, b in ((-0.02, -0.02), (0.22, -0.02), (0.22, 0.02), (-0.02, 0.02))]
    )
    ax.fill(*outline.T, facecolor="#E4EBF2", edgecolor=INK, linewidth=1.0)
    ax.plot(0.0, 0.0, "o", color=INK, markersize=7.0)
    ax.plot(*centre, "o", color=colour(3), markersize=6.0)
    ends = [place + 0.03 * across for place in (np.zeros(2), centre)]
    for one, other in (ends, ends[::-1]):
        arrow(ax, tuple(one), tuple(other), width=0.8)
    beside = centre + np.array([0.015, -0.007])
    for place, letter in ((beside, "m"), (0.5 * (ends[0] + ends[1]) + 0.011 * across, "r")):
        words(ax, float(place[0]), float(place[1]), letter, size=SMALL + 1.0)
    motor = 0.038 * np.array([[math.cos(a), math.sin(a)] for a in np.linspace(-0.75 * math.pi, -0.2 * math.pi, 30)])
    arrow(ax, *[tuple(each) for each in motor.tolist()], width=1.4)
    words(ax, 0.0, -0.05, r"$\tau$", size=SMALL + 2.0)
    ax.plot([0.0, 0.24], [0.0, 0.0], color=INK, linewidth=0.6, linestyle="--")
    turn = np.linspace(0.0, theta, 30)
    ax.plot(0.13 * np.cos(turn), 0.13 * np.sin(turn), color=INK, linewidth=0.9)
    words(ax, 0.148 * math.cos(0.5 * theta), 0.148 * math.sin(0.5 * theta), r"$\theta$", size=SMALL + 2.0)
    arrow(ax, (0.3, 0.14), (0.3, 0.04), width=1.6)
    words(ax, 0.318, 0.09, "g", size=SMALL + 1.0)
    frame(ax, np.zeros(2), np.eye(2), "s", aside=np.array([-0.045, 0.0]), length=0.05)
    R_W = np.asarray(T.R)
    frame(ax, centre, R_W[np.ix_([0, 2], [0, 2])], "b", aside=-0.022 * along, length=0.05)
    ax.set_xlim(-0.09, 0.35)
    ax.set_ylim(-0.07, 0.17)
    return Page(
        rows=rows,
        figure=figure,
        note="Drawn at 35 degrees, from the arm's own frames: the world {s} and the tool {b}.",
    )


def fig_10_3() -> Page:
    ctrl = ticked(PID(kp=KP, kd=KD, ki=KI), link(), [0.2], [V], JointMotion(q=[1.0]))
    e = 0.8
    rows = (
        row("term P", "N m", ctrl.terms["P"][0], KP * e, BY_HAND),
        row("term I, after one tick of 1 ms", "N m", ctrl.terms["I"][0], KI * e * 1e-3, BY_HAND),
        row("term D", "N m", ctrl.terms["D"][0], -KD * V, BY_HAND),
    )
    figure = law_diagram(list(ctrl.terms), "PID: the terms of taut.laws.PID", inertia=False)
    note = "Chosen: theta_d = 1.0 rad, theta = 0.2 rad, theta-dot = 1.3 rad/s; gains of figure 10.6."
    return Page(rows=rows, figure=figure, note=note)


def fig_10_8() -> Page:
    angle, rate = angles(200, 0.01), 100.0
    got, written = ticks(PID(kp=KP, kd=KD, ki=KI), angle, rate), pseudocode(angle, 1.0 / rate)
    worst = int(np.argmax(np.abs(got - written)))
    rows = (
        row("last torque of 200 ticks at 100 Hz", "N m", got[-1], written[-1], "figure 10.8 line by line", rel=1e-11),
        row("the torque that differs most", "N m", got[worst], written[worst], "figure 10.8 line by line", rel=1e-9),
    )
    return Page(rows=rows, note="Chosen: recorded angles, a sine as trajectory, gains of figure 10.6.")


ENTRIES: Final = (
    Entry(id="eq-10.1", title="the link without friction", make=eq_10_1),
    Entry(id="eq-10.2", title="viscous friction", make=eq_10_2),
    Entry(id="eq-10.3", title="the link with friction", make=eq_10_3),
    Entry(id="eq-10.4", title="the same in two terms", make=eq_10_4),
    Entry(id="fig-10.2", title="the link in gravity", make=fig_10_2),
    Entry(id="eq-10.5", title="the error", make=eq_10_5),
    Entry(id="eq-10.6", title="PID control", make=eq_10_6),
    Entry(id="fig-10.3", title="block diagram of PID control", make=fig_10_3),
    Entry(id="eq-10.7", title="the closed loop of PD control in a horizontal plane", make=eq_10_7),
    Entry(id="eq-10.8", title="error dynamics of a set-point", make=eq_10_8),
    Entry(id="fig-10.8", title="pseudocode of PID control", make=fig_10_8),
)
