"""Sections 10.2.1.4 and 10.2.1.5: friction, dithering against it, and gearing."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import minimize_scalar

from taut import Arm, Friction, JointMotion, Law, Run, snapshot
from taut.arm.builtin import one_joint
from taut.base.plot_style import WIDTH, prepared
from taut.book.models import M, controller, link, on_link
from taut.book.page import Shown, curve, entry, legend, row
from taut.book.single_joint import ConstantTorque
from taut.drives import matched_ratio, reflected_inertia, rotor_share
from taut.laws import PID, Dither, RaisedGains
from taut.maths.friction import FrictionValues, dry_limit, friction_torque

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STATIC, KINETIC, VISCOUS, STRIBECK = 0.5, 0.3, 0.2, 0.1  # [N m], [N m], [N m s/rad], [rad/s] chosen
LAWS: Final = {
    "(a) viscous": Friction(viscous=VISCOUS),
    "(b) Coulomb": Friction(coulomb=KINETIC),
    "(c) static and viscous": Friction(coulomb=KINETIC, viscous=VISCOUS),
    "(d) static and kinetic": Friction(coulomb=KINETIC, static=STATIC),
    "(e) static, kinetic, viscous": Friction(coulomb=KINETIC, static=STATIC, viscous=VISCOUS),
    "(f) Stribeck": Friction(coulomb=KINETIC, static=STATIC, viscous=VISCOUS, stribeck=STRIBECK),
}
STICKING: Final = "semi-implicit-euler"


def torque(panel: str, v: float) -> float:
    """Friction of a joint that moves, by the law of a panel [N m]."""
    dry = {"(a) viscous": 0.0}.get(panel, KINETIC)
    if panel == "(f) Stribeck":
        dry = KINETIC + (STATIC - KINETIC) * math.exp(-((v / STRIBECK) ** 2))
    return math.copysign(dry, v) + (VISCOUS * v if "viscous" in panel or panel == "(f) Stribeck" else 0.0)


@entry("fig-10.14", "laws of friction")
def fig_10_14() -> Shown:
    """Chosen: b_static = 0.5 N m, b_kinetic = 0.3 N m, b_viscous = 0.2 N m s/rad, a Stribeck speed of 0.1 rad/s.

    To initiate motion the torque on the joint must be |tau| >= b_static, in either direction; the chapter asks it
    of the friction torque, and without the sign.
    """
    ctrl = controller(ConstantTorque(tau=1.0), link(gravity=False))
    for panel, friction in LAWS.items():
        arm = link(gravity=False).with_friction(friction)
        for v in (0.05, -1.0):
            run = on_link(ctrl, plant=arm, duration=1e-3, v0=v, integrator=STICKING)
            got = 1.0 - M * ((run.v[1, 0] - run.v[0, 0]) * run.rate)
            name = f"{panel}: friction at {v:g} rad/s [N m]"
            yield row(name, got, torque(panel, v), "the law of the panel, written out", near=1e-4)
    arm = link(gravity=False).with_friction(LAWS["(d) static and kinetic"])
    for tau in (0.99 * STATIC, 1.01 * STATIC, -0.99 * STATIC, -1.01 * STATIC):
        ctrl.parameters["law.tau"] = tau
        run = on_link(ctrl, plant=arm, duration=0.5, integrator=STICKING)
        breaks = abs(tau) > STATIC
        wanted = 0.5 * (tau - math.copysign(KINETIC, tau)) / M if breaks else 0.0
        slip = "slip: tau_fric >= |b_static|" if tau < 0.0 and breaks else ""
        name = f"(d): speed after 0.5 s under {tau:g} N m, from rest [rad/s]"
        yield row(name, run.v[-1, 0], wanted, "|tau| >= b_static", rel=1e-3, near=1e-12, states=slip)
    yield laws_drawn()


def laws_drawn() -> Figure:
    """Friction over speed, with the sign of the speed that it opposes; at rest all that it can hold."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(WIDTH, 4.3), dpi=150, layout="constrained")
    axes = list(figure.subplots(2, 3, sharex=True, sharey=True).flat)
    v = np.linspace(1e-6, 1.0, 401)
    none = np.zeros(len(v))
    for ax, (title, friction) in zip(axes, LAWS.items(), strict=True):
        prepared(ax, title, "friction [N m]", "v [rad/s]")
        values = FrictionValues.fixed(friction)
        torques = -friction_torque(values, v, none, none)
        hold = float(dry_limit(values, np.zeros(1), np.array([True]), none[:1], none[:1])[0])
        curve(ax, v, torques, "in motion", 0)
        curve(ax, -v, -torques, "", 0)
        curve(ax, [0.0, 0.0], [-hold, hold], "at rest: any value between", 1)
    legend(axes[0])
    return figure


AMPLITUDE, FREQUENCY = 1.5, 40.0  # [N m], [Hz] chosen: three times b_static
OMEGA: Final = 2.0 * math.pi * FREQUENCY
SETTLED_PERIODS, LAST = 20, 40  # periods of the dither after which a mean is taken, and until when
PUSHES: Final = (0.05, 0.1, 0.15)  # [N m], all below b_kinetic
SHAKEN: Final = math.sqrt(AMPLITUDE**2 - (4.0 * KINETIC / math.pi) ** 2) / (OMEGA * M)  # [rad/s]
GAIN, FACTOR = 5.0, 4.0  # [N m/rad] of PD control near rest, and times that


@cache
def dry() -> Arm:
    """The link in a horizontal plane, with static and kinetic friction and no other."""
    return link(gravity=False, b=0.0).with_friction(Friction(coulomb=KINETIC, static=STATIC))


def pushed(push: float, law: Law | None, duration: float = LAST / FREQUENCY) -> Run:
    """A run under a constant torque plus the torque of a law."""
    constant = ConstantTorque(tau=push)
    ctrl = controller(constant if law is None else constant + law, dry())
    # four steps of the plant in a tick: each rest ends in one of them
    return on_link(ctrl, plant=dry(), duration=duration, integrator=STICKING, substeps=4)


def mean_speed(push: float) -> float:
    """Mean speed of a run with dither, over whole periods [rad/s]."""
    run = pushed(push, Dither(amplitude=AMPLITUDE, frequency=FREQUENCY))
    first = round(SETTLED_PERIODS / FREQUENCY * run.rate)
    return float((run.q[-1, 0] - run.q[first, 0]) / (run.t[-1] - run.t[first]))


@entry("sec-10.2.1.4", "dithering, and larger gains near zero velocity")
def sec_10_2_1_4() -> Shown:
    """Chosen: b_static = 0.5 N m and b_kinetic = 0.3 N m as in figure 10.14 d, no other friction.

    A dither of 1.5 N m at 40 Hz shakes the link with V = 0.0115 rad/s. PD control has Kp = 5 N m/rad, and four times
    that near zero velocity.
    """
    wave = controller(Dither(amplitude=AMPLITUDE, frequency=FREQUENCY), link(gravity=False))
    run = on_link(wave, plant=link(gravity=False), duration=1.0)
    dither = run.tau[: round(run.rate), 0]
    name, mean = "mean of a dither of 1.5 N m at 40 Hz, over its size", np.mean(dither) / np.max(np.abs(dither))
    yield row(name, mean, 0.0, "zero mean", near=1e-9, states="zero-mean")
    name, states = f"under {PUSHES[-1]:g} N m, from rest, no dither [rad/s]", "some torque without any motion"
    still = pushed(PUSHES[-1], None, 1.0).v[-1, 0]
    yield row(f"speed after 1 s {name}", still, 0.0, "|tau| < b_static", near=1e-12, states=states)
    source = "viscous friction, (2 b_kinetic / pi) asin(v / V)"
    for push in PUSHES:
        name = f"mean speed under {push:g} N m, with dither [rad/s]"
        wanted = SHAKEN * math.sin(0.5 * math.pi * push / KINETIC)
        yield row(name, mean_speed(push), wanted, source, rel=0.03, states="to smooth the discontinuity")
    for factor, gains in ((1.0, "gains as they are"), (FACTOR, "four times the gains at rest")):
        for share in (0.99, 1.01):
            e = share * STATIC / (factor * GAIN)
            name = f"PD control, {gains}: moves at an error of {e:.4g} rad [0 or 1]"
            states = "larger gains near rest" if factor > 1.0 and share > 1.0 else ""
            yield row(name, moves(e, factor), share > 1.0, "Kp e > b_static", states=states)


def moves(e: float, factor: float) -> bool:
    """A joint at rest with an error breaks away, under PD control with its gains raised near rest."""
    ctrl = controller(RaisedGains(inner=PID(kp=GAIN, kd=1.0), factor=factor, width=0.05), dry())
    run = on_link(ctrl, JointMotion(q=[e]), plant=dry(), duration=0.05, integrator=STICKING)
    return bool(np.abs(run.q[:, 0]).max() > 1e-9)


I_LINK, I_MOTOR = 1.0, 1e-3  # [kg m^2] the chapter's example
SUMS: Final = "I_link / (I_link + G^2 I_motor)"


def geared(ratio: float, *, load: float = 0.0, b: float = 0.0) -> Arm:
    """The chapter's example in a horizontal plane, with the inertia of a load [kg m^2]."""
    return one_joint(M=I_LINK + load, m=1.0, r=0.1, b=b).with_gravity([0.0, 0.0, 0.0]).with_gears(ratio, I_MOTOR)


def accelerated(arm: Arm, tau: float, substeps: int = 1) -> Run:
    """A run of 0.1 s under a torque of the joint, from rest."""
    ctrl = controller(ConstantTorque(tau=tau), arm, rate=1000.0)
    return on_link(ctrl, plant=arm, duration=0.1, substeps=substeps)


def acceleration(ratio: float) -> float:
    """Acceleration of a run of the geared link, under 1 N m of the motor [rad/s^2]."""
    run = accelerated(geared(ratio), ratio)
    return float(run.v[-1, 0] / run.t[-1])


@entry("sec-10.2.1.5", "the effect of gearing")
def sec_10_2_1_5() -> Shown:
    """I_link = 1 kg m^2 and I_motor = 1e-3 kg m^2, as in the chapter."""

    def wanted(G: float) -> float:
        return G / (I_LINK + G**2 * I_MOTOR)

    matched = float(matched_ratio(I_LINK, I_MOTOR))
    best = minimize_scalar(lambda G: -wanted(G), bounds=(1.0, 200.0), method="bounded", options={"xatol": 1e-9}).x
    direct, at_matched = (float(rotor_share(geared(G))[0]) for G in (1.0, matched))
    yield row("inertia that is the link's, G = 1 [%]", 100.0 * (1.0 - direct), 100.0 / 1.001, SUMS, states="99.9 %")
    name = "torque that accelerates the motor, G = 1 [%]"
    yield row(name, 100.0 * direct, 0.1 / 1.001, SUMS, states="0.1 %")
    name, reflected = (
        "the motor's inertia over the link's, G = 100",
        float(reflected_inertia(100.0, I_MOTOR)) / I_LINK,
    )
    yield row(name, reflected, 10.0, "the chapter", states="ten times")
    source, states = "scipy.optimize: largest acceleration", "sqrt(I_link / I_motor)"
    yield row("inertia matched at G", matched, best, source, rel=1e-6, states=states)
    yield row("torque that accelerates the motor there", at_matched, 0.5, "the chapter", states="half")
    for G in (10.0, matched, 100.0):
        name = f"acceleration of a run, 1 N m of the motor, G = {G:.4g} [rad/s^2]"
        yield row(name, acceleration(G), wanted(G), "G tau / (I_link + G^2 I_motor)")
    for G, states in ((1.0, ""), (100.0, "geared: less sensitive")):
        loaded, empty = (snapshot(geared(G, load=load), [0.0]).M[0, 0] for load in (1.0, 0.0))
        name = f"change of the inertia with a load of 1 kg m^2, G = {G:g} [%]"
        yield row(name, 100.0 * (loaded / empty - 1.0), 100.0 / (I_LINK + G**2 * I_MOTOR), SUMS, states=states)


@entry("sec-10.2.1.5", "where friction dominates")
def first_order() -> Shown:
    """A joint dominated by friction behaves more like a first-order viscous system.

    Chosen: b = 0.1 N m s/rad in direct drive, and 1000 with G = 100: the motor's friction, times G^2.
    """
    for G, b in ((1.0, 0.1), (100.0, 1000.0)):
        q = accelerated(geared(G, b=b), 1.0, substeps=10).q[-1, 0]
        tau = (I_LINK + G**2 * I_MOTOR) / b
        wanted = (0.1 - tau * (1.0 - math.exp(-0.1 / tau))) / b
        source = "the solution of M a + b v = tau"
        yield row(f"displacement in 0.1 s under 1 N m, G = {G:g}, b = {b:g} [rad]", q, wanted, source, rel=1e-6)
        name = f"the same as a fraction of that of the first-order system tau = b v, G = {G:g}"
        yield row(name, q * b / 0.1, wanted * b / 0.1, "the same", rel=1e-6)
