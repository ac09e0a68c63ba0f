"""Sections 10.2.1.4 and 10.2.1.5: friction, dithering against it, and gearing."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from taut.arm.builtin import one_joint
from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.arm.gears import matched_ratio, reflected_inertia
from taut.base.plot_style import DASHED, DOTTED, INK, colour, prepared
from taut.book.models import M, controller, link, on_link
from taut.book.page import Shown, entry, legend, panels, row
from taut.book.single_joint import ConstantTorque
from taut.control.law import Law
from taut.control.laws.joint import PID, Dither, RaisedGains
from taut.control.trajectories.reference import JointMotion
from taut.maths.snapshot import snapshot
from taut.maths.task_inertia import rotor_share
from taut.record.plots.friction_curves import plot_friction
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__: list[str] = []


STATIC, KINETIC, VISCOUS, STRIBECK = 0.5, 0.3, 0.2, 0.1  # [N m], [N m], [N m s/rad], [rad/s] chosen
LAWS: Final = {
    "(a) viscous": Friction(viscous=VISCOUS),
    "(b) Coulomb": Friction(coulomb=KINETIC),
    "(c) static and viscous": Friction(coulomb=KINETIC, viscous=VISCOUS),
    "(d) static and kinetic": Friction(coulomb=KINETIC, static=STATIC),
    "(e) static, kinetic, viscous": Friction(coulomb=KINETIC, static=STATIC, viscous=VISCOUS),
    "(f) Stribeck": Friction(coulomb=KINETIC, static=STATIC, viscous=VISCOUS, stribeck=STRIBECK),
}
SPEEDS: Final = (0.05, -1.0)  # [rad/s]
REST: Final = JointMotion(q=[0.0])
STICKING: Final = "semi-implicit-euler"
EQUATION: Final = "the law of the panel, written out"


def torque(panel: str, v: float) -> float:
    """What each panel says of a joint that moves [N m]."""
    dry = {"(a) viscous": 0.0}.get(panel, KINETIC)
    if panel == "(f) Stribeck":
        dry = KINETIC + (STATIC - KINETIC) * math.exp(-((v / STRIBECK) ** 2))
    return math.copysign(dry, v) + (VISCOUS * v if "viscous" in panel or panel == "(f) Stribeck" else 0.0)


@entry("fig-10.14", "laws of friction")
def fig_10_14() -> Shown:
    ctrl = controller(ConstantTorque(tau=1.0), link(gravity=False))
    for panel, friction in LAWS.items():
        arm = link(gravity=False).with_friction(friction)
        for v in SPEEDS:
            ctrl.parameters["law.tau"] = 1.0
            run = on_link(ctrl, plant=arm, ref=REST, duration=1e-3, q0=[0.0], v0=[v], integrator=STICKING)
            a = (run.v[1, 0] - run.v[0, 0]) * run.rate
            yield row(f"{panel}: friction at {v:g} rad/s", "N m", 1.0 - M * a, torque(panel, v), EQUATION, near=1e-4)
    arm = link(gravity=False).with_friction(LAWS["(d) static and kinetic"])
    for tau in (0.99 * STATIC, 1.01 * STATIC, -0.99 * STATIC, -1.01 * STATIC):
        ctrl.parameters["law.tau"] = tau
        run = on_link(ctrl, plant=arm, ref=REST, duration=0.5, q0=[0.0], integrator=STICKING)
        breaks = abs(tau) > STATIC
        wanted = 0.5 * (tau - math.copysign(KINETIC, tau)) / M if breaks else 0.0
        slip = "slip: tau_fric >= |b_static|" if tau < 0.0 and breaks else ""
        yield row(
            f"(d): speed after 0.5 s under {tau:g} N m, from rest",
            "rad/s",
            run.v[-1, 0],
            wanted,
            "|tau| >= b_static",
            rel=1e-3,
            near=1e-12,
            states=slip,
        )

    yield plot_friction(LAWS, speed=1.0)
    yield (
        "Chosen: b_static = 0.5 N m, b_kinetic = 0.3 N m, b_viscous = 0.2 N m s/rad, a Stribeck speed of 0.1 rad/s. "
        "To initiate motion the torque on the joint must be |tau| >= b_static, in either direction; the chapter asks "
        "it of the friction torque, and without the sign."
    )


AMPLITUDE, FREQUENCY = 1.5, 40.0  # [N m], [Hz] chosen: three times b_static
OMEGA: Final = 2.0 * math.pi * FREQUENCY
SETTLED_PERIODS, LAST = 20, 40  # periods of the dither after which a mean is taken, and until when
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
    first = round(SETTLED_PERIODS / FREQUENCY * run.rate)
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
        for k in (SETTLED_PERIODS, LAST):
            if t <= k / FREQUENCY < end:
                marks[k] = q + _way(t, k / FREQUENCY, push, s)
            elif k / FREQUENCY < t:
                marks.setdefault(k, q)
        q, t = q + _way(t, end, push, s), end
    marks.setdefault(LAST, q)
    return (marks[LAST] - marks[SETTLED_PERIODS]) * FREQUENCY / (LAST - SETTLED_PERIODS)


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


@entry("sec-10.2.1.4", "dithering, and larger gains near zero velocity")
def sec_10_2_1_4() -> Shown:
    wave = controller(Dither(amplitude=AMPLITUDE, frequency=FREQUENCY), link(gravity=False))
    run = on_link(wave, plant=link(gravity=False), ref=REST, duration=1.0, q0=[0.0])
    dither = run.tau[: round(run.rate), 0]
    yield row(
        "mean of a dither of 1.5 N m at 40 Hz, over its size",
        "",
        np.mean(dither) / np.max(np.abs(dither)),
        0.0,
        "zero mean",
        near=1e-9,
        states="zero-mean",
    )
    yield row(
        f"speed after 1 s under {PUSHES[-1]:g} N m, from rest, no dither",
        "rad/s",
        pushed(PUSHES[-1], None, 1.0).v[-1, 0],
        0.0,
        "|tau| < b_static",
        near=1e-12,
        states="some torque without any motion",
    )
    got = {push: mean_speed(push) for push in PUSHES}
    for push, speed in got.items():
        wanted = mean_speed_solved(push)
        yield row(f"mean speed under {push:g} N m, with dither", "rad/s", speed, wanted, SOLVED, rel=0.005)
    push, speed = next(iter(got.items()))
    wanted = push / (SHAKEN * math.sin(0.5 * math.pi * push / KINETIC))
    source = "viscous friction, (2 b_kinetic / pi) asin(v / V)"
    states = "to smooth the discontinuity"
    yield row(
        f"{push:g} N m over that mean speed", "N m s/rad", push / speed, wanted, source, rel=0.03, states=states
    )
    for factor in (1.0, FACTOR):
        for share in (0.99, 1.01):
            e = share * STATIC / (factor * GAIN)
            yield row(
                f"PD control, {'gains as they are' if factor == 1.0 else 'four times the gains at rest'}: moves "
                f"at an error of {e:.4g} rad",
                "0 or 1",
                moves(e, factor),
                share > 1.0,
                "Kp e > b_static",
                states="larger gains near rest" if factor > 1.0 and share > 1.0 else "",
            )

    yield drawn()
    yield (
        "Chosen: b_static = 0.5 N m and b_kinetic = 0.3 N m as in figure 10.14 d, no other friction, a dither of "
        f"1.5 N m at 40 Hz, that shakes the link with V = {SHAKEN:.3g} rad/s; PD control with Kp = 5 N m/rad, and "
        "four times that near zero velocity."
    )


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


I_LINK, I_MOTOR = 1.0, 1e-3  # [kg m^2] the chapter's example
AT_ZERO: Final = JointMotion(q=[0.0])
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
        ref=AT_ZERO,
        duration=0.1,
        q0=[0.0],
    )
    return float(run.v[-1, 0] / run.t[-1])


@entry("sec-10.2.1.5", "the effect of gearing")
def sec_10_2_1_5() -> Shown:
    matched = float(matched_ratio(I_LINK, I_MOTOR))
    best = minimize_scalar(
        lambda G: -G / (I_LINK + G**2 * I_MOTOR), bounds=(1.0, 200.0), method="bounded", options={"xatol": 1e-9}
    )
    share = [float(rotor_share(geared(G))[0]) for G in (1.0, 100.0, matched)]
    carried = [
        float(snapshot(geared(G, load=1.0), [0.0]).M[0, 0] / snapshot(geared(G), [0.0]).M[0, 0] - 1.0)
        for G in (1.0, 100.0)
    ]
    yield row(
        "inertia that is the link's, G = 1", "%", 100.0 * (1.0 - share[0]), 100.0 / 1.001, SUMS, states="99.9 %"
    )
    yield row("torque that accelerates the motor, G = 1", "%", 100.0 * share[0], 0.1 / 1.001, SUMS, states="0.1 %")
    yield row(
        "the motor's inertia over the link's, G = 100",
        "",
        float(reflected_inertia(100.0, I_MOTOR)) / I_LINK,
        10.0,
        "the chapter",
        states="ten times",
    )
    yield row(
        "inertia matched at G",
        "",
        matched,
        best.x,
        "scipy.optimize: largest acceleration",
        rel=1e-6,
        states="sqrt(I_link / I_motor)",
    )
    yield row("torque that accelerates the motor there", "", share[2], 0.5, "the chapter", states="half")
    for G in (10.0, matched, 100.0):
        wanted = G / (I_LINK + G**2 * I_MOTOR)
        yield row(
            f"acceleration of a run, 1 N m of the motor, G = {G:.4g}",
            "rad/s^2",
            acceleration(G),
            wanted,
            "G tau / (I_link + G^2 I_motor)",
            rel=1e-9,
        )
    for G, got in zip((1.0, 100.0), carried, strict=True):
        wanted = 100.0 / (I_LINK + G**2 * I_MOTOR)
        name, states = f"change of the inertia with a load of 1 kg m^2, G = {G:g}", ""
        if G > 1.0:
            states = "geared: less sensitive"
        yield row(name, "%", 100.0 * got, wanted, SUMS, states=states)
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
    yield figure
    yield "I_link = 1 kg m^2 and I_motor = 1e-3 kg m^2, as in the chapter."


@entry("sec-10.2.1.5", "where friction dominates", part="friction")
def first_order() -> Shown:
    """Where friction dominates, the joint is nearer to a viscous system of first order."""
    for G, b in ((1.0, 0.1), (100.0, 1000.0)):
        arm = geared(G, b=b)
        run = on_link(
            controller(ConstantTorque(tau=1.0), arm, rate=1000.0),
            plant=arm,
            ref=AT_ZERO,
            duration=0.1,
            q0=[0.0],
            substeps=10,
        )
        tau = (I_LINK + G**2 * I_MOTOR) / b
        wanted = (0.1 - tau * (1.0 - math.exp(-0.1 / tau))) / b
        yield row(
            f"way in 0.1 s under 1 N m, G = {G:g}, b = {b:g}",
            "rad",
            run.q[-1, 0],
            wanted,
            "the solution of M a + b v = tau",
            rel=1e-6,
        )
        yield row(
            "of what a first-order system tau = b v would go",
            "",
            run.q[-1, 0] * b / 0.1,
            wanted * b / 0.1,
            "the same",
            rel=1e-6,
        )
    yield "Chosen: b = 0.1 N m s/rad in direct drive, and 1000 with G = 100: the motor's friction, times G^2."
