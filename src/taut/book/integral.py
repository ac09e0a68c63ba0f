"""Section 10.2.1.1: set-points under PD and PID control, and claims on tracking, delays and large gains."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import taut
from taut import JointMotion, LinearSystem, Run, error_dynamics, linearise
from taut.analysis import root_locus, second_order
from taut.analysis.stability.loci import bisected
from taut.base.plot_style import DASHED, INK, SMALL
from taut.base.types import Float64Array
from taut.book.models import (
    KD,
    KI,
    KP,
    REST,
    SAMPLED,
    B,
    M,
    R,
    controller,
    held_radius,
    link,
    looped,
    on_link,
    rms,
    solved,
    two_poles,
    weight,
)
from taut.book.page import ODE, ROOTS, Shown, arrow, curve, entry, legend, panels, row, words
from taut.drives import Actuation
from taut.laws import PID
from taut.trajectories import Sine

HOME: Final = -math.pi / 2.0  # [rad] where figure 10.6 starts
PID_DURATION: Final = 12.0  # [s]
BOUND: Final = (B + KD) * KP / M  # [N m/(rad s)] of Ki


def figure_10_6(ki: float, kp: float = KP) -> Run:
    """A run of figure 10.6."""
    return on_link(PID(kp=kp, kd=KD, ki=ki), duration=PID_DURATION, q0=HOME)


def written_10_6(ki: float, times: Float64Array) -> Float64Array:
    """(k,) error of the same loop by SciPy."""

    def tau(_: float, theta: float, v: float, e_int: float) -> float:
        return -KP * theta + ki * e_int - KD * v

    return solved(tau, times, q0=HOME).e


@entry("eq-10.11", "the link in gravity under PD control")
def eq_10_11() -> Shown:
    """The goal is theta = 0; gains of figure 10.6."""
    for kp, name, states in (
        (KP, "error at rest of PD control [rad]", ""),
        (10.0 * KP, "with Kp ten times as large [rad]", "small"),
    ):
        wanted = brentq(lambda e, kp=kp: kp * e - weight(-e), 0.0, 1.0)
        rested = -figure_10_6(0.0, kp).q[-1, 0]
        yield row(name, rested, wanted, "root of Kp e = m g r cos(theta)", rel=1e-6, states=states)


@cache
def constant_disturbance(ki: float) -> Run:
    """A run of a slide of 3 kg under its weight, a constant disturbance; critically damped."""
    slide = taut.load_arm("gantry3").subset(["z"]).with_joints(viscous=0.0)
    return on_link(PID(kp=300.0, kd=60.0, ki=ki), JointMotion(q=[0.1]), plant=slide, duration=10.0)


@entry("eq-10.12", "a constant disturbance, with an integral")
def eq_10_12() -> Shown:
    """Chosen: a slide of 3 kg under its weight, Kp = 300 N/m, Kd = 60 N s/m, Ki = 400 N/(m s)."""
    mass, kp, kd, ki, push, at = 3.0, 300.0, 60.0, 400.0, 3.0 * 9.81, 0.5
    run = constant_disturbance(ki)
    A = np.array([[0, 1, 0, 0], [-kp / mass, -kd / mass, -ki / mass, push / mass], [1, 0, 0, 0], [0, 0, 0, 0]])
    wanted = (expm(A * at) @ np.array([0.1, 0.0, 0.0, 1.0]))[0]
    got = 0.1 - run.q[int(np.searchsorted(run.t, at - 1e-9)), 0]
    name = "error 0.5 s after a step, with a constant disturbance [m]"
    yield row(name, got, wanted, "scipy.linalg.expm", rel=2e-3)


@entry("eq-10.13", "third-order error dynamics")
def eq_10_13() -> Shown:
    """An integral removes the steady-state error of a constant disturbance. Numbers of equation 10.12."""
    with_i, without = (0.1 - constant_disturbance(ki).q[-1, 0] for ki in (400.0, 0.0))
    yield row("error in the end, Ki = 0 [m]", without, 3.0 * 9.81 / 300.0, "tau_dist / Kp", rel=1e-6)
    yield row("error in the end, Ki > 0 [m]", with_i, 0.0, "equation 10.13", near=1e-6)


@entry("eq-10.14", "characteristic equation of PID control, and the bound of Ki")
def eq_10_14() -> Shown:
    """Gains of figure 10.6 but for Ki; runs of 30 s in a horizontal plane."""
    plane, source = link(gravity=False), "(b + Kd) Kp / M"
    largest = second_order(M=M, b=B, kp=KP, kd=KD).largest_ki
    yield row("bound of Ki [N m/(rad s)]", largest, BOUND, source)
    ctrl = controller(PID(kp=KP, kd=KD, ki=KI), plane)
    loop = looped(ctrl, plane, REST, friction="arm", integrator="rk4")

    def stable(ki: float) -> bool:
        loop.parameters["law.ki"] = ki
        return linearise(loop, at=[0.0]).stable

    limit = bisected(stable, 0.8 * BOUND, 1.2 * BOUND, tolerance=1e-6)
    yield row("Ki at which taut.laws.PID loses stability [N m/(rad s)]", limit, BOUND, source, rel=2e-4)
    for factor in (0.9, 1.1):
        ctrl.parameters["law.ki"] = factor * BOUND
        run = on_link(ctrl, plant=plane, duration=30.0, q0=0.01)
        got = max(two_poles(run.between(6.0, 30.0).q[::100, 0], 0.01).real)
        wanted = np.roots([M, B + KD, KP, factor * BOUND]).real.max()
        name = f"exponential growth rate of an oscillation, Ki = {factor:g} of the bound [1/s]"
        yield row(name, got, wanted, f"{ROOTS} of 10.14", rel=0.01)


@entry("fig-10.6", "PD and PID control in gravity")
def fig_10_6() -> Shown:
    """All numbers are the chapter's; ticks of 0.1 ms, 12 s."""
    runs = {"PD": figure_10_6(0.0), "PID": figure_10_6(KI)}
    written = {name: written_10_6(ki, runs["PD"].t[::10]) for name, ki in (("PD", 0.0), ("PID", KI))}
    zeta = second_order(M=M, b=B, kp=KP, kd=KD).zeta
    yield row("damping ratio of the PD design", zeta, 1.0, "the chapter: critical damping", states="1")
    for name, run in runs.items():
        e, wanted = -run.q[:, 0], written[name]
        yield row(f"{name}: error in the end [rad]", e[-1], wanted[-1], ODE, rel=SAMPLED, near=1e-6)
        yield row(f"{name}: least error [rad]", e.min(), wanted.min(), ODE, rel=SAMPLED, near=1e-5)
        yield row(f"{name}: RMS error [rad]", rms(e), rms(wanted), ODE, rel=SAMPLED)
    over, wanted_over = 100.0 * e.min() / HOME, 100.0 * wanted.min() / HOME
    yield row("PID: overshoot [%]", over, wanted_over, ODE, rel=SAMPLED, states="significant overshoot")
    P, I = runs["PD"].terms["P"][-1, 0], runs["PID"].terms["I"][-1, 0]
    yield row("PD: torque of Kp in the end [N m]", P, weight(-written["PD"][-1]), "m g r cos(theta)", rel=SAMPLED)
    yield row("PID: torque of Ki in the end [N m]", I, weight(0.0), "m g r", rel=5e-3)
    titles = ("error", "error [rad]", "t [s]"), ("terms", "torque [N m]", "t [s]"), None
    figure, (left, middle, right) = panels(*titles, height=2.6, width_ratios=[1.2, 1.5, 0.9])
    left.axhline(0.0, color=INK, linewidth=0.6)
    for k, (name, run) in enumerate(runs.items()):
        curve(left, run.t[::50], -run.q[::50, 0], name, k)
        whole = name == "PID"
        style = {"linestyle": "-" if whole else DASHED, "linewidth": 1.3 if whole else 1.0}
        for term, values in run.terms.items():
            if whole or term != "I":
                curve(middle, run.t[::50], values[::50, 0], f"{name} {term}", 2 + "PID".index(term), **style)
    for ax in (left, middle):
        legend(ax, ncols=1 if ax is left else 2)
        ax.set_xlim(0.0, PID_DURATION)
    middle.set_ylim(-3.0, 5.0)
    right.set_title("start and goal", fontsize=SMALL + 0.5, color=INK, loc="left")
    for theta, face, label in ((HOME, "#E4EBF2", "start"), (0.0, "#C9D8E6", "goal")):
        end = 2.2 * R * np.array([math.cos(theta), math.sin(theta)])
        right.plot([0.0, end[0]], [0.0, end[1]], color=face, linewidth=9.0, solid_capstyle="round")
        words(right, 0.62 * end, label)
    right.plot(0.0, 0.0, "o", color=INK, markersize=5.0)
    arrow(right, (0.2, -0.08), (0.2, -0.2), width=1.4)
    words(right, (0.225, -0.14), "g")
    right.set(xlim=(-0.05, 0.26), ylim=(-0.27, 0.06))
    yield figure


@entry("fig-10.7", "root locus over Ki")
def fig_10_7() -> Shown:
    """Gains of figure 10.6: both roots of PD control at -2.1 1/s. "1" marks Ki = 1, that of figure 10.6."""

    def joint(ki: float) -> LinearSystem:
        return error_dynamics(M=M, b=B, kp=KP, kd=KD, ki=ki)

    values = np.unique([*(1.5 * BOUND * np.linspace(0.0, 1.0, 300) ** 2), KI])
    found = root_locus(joint, values, label="Ki [N m/(rad s)]")
    limit, breakaway, unit = found.limits[0], found.breakaways[-1], "[N m/(rad s)]"
    half = 0.5 * (B + KD) / M  # the two collocated roots are at -half, with Ki = 0 beside a third at the origin
    s = -half * 2.0 / 3.0 + math.sqrt((half * 2.0 / 3.0) ** 2 - KP / M / 3.0)  # where d Ki / d s = 0
    there = -s * (M * s * s + (B + KD) * s + KP)
    third = min(joint(breakaway.value).poles.real)
    bound = "(b + Kd) Kp / M"
    yield row(f"Ki at which the roots cross {unit}", limit.value, BOUND, bound, rel=1e-6, states=bound)
    yield row("imaginary part there [1/s]", abs(limit.pole.imag), math.sqrt(KP / M), "sqrt(Kp / M)", rel=1e-6)
    yield row(f"Ki at which two roots break away {unit}", breakaway.value, there, "d Ki / d s = 0", rel=1e-6)
    yield row("where they do [1/s]", breakaway.pole.real, s, "d Ki / d s = 0", rel=1e-4)
    source = "-(b + Kd) / M, less the two"
    yield row("the third root there [1/s]", third, -(B + KD) / M - 2.0 * s, source, rel=1e-6)
    figure, (ax,) = panels(("", "", ""), height=3.1)
    found.draw(ax, mark=[KI])
    yield figure


SERVO_RATE: Final = 100.0  # [Hz]


def amplitude(run: Run, w: float) -> float:
    """Amplitude of the error at a frequency, over the last whole periods of a run."""
    turn = 2.0 * math.pi / w
    last = run.between(run.t[-1] - 2.0 * turn, run.t[-1] - 1.0 / run.rate)
    assert last.error is not None
    return float(abs(2.0 * np.mean(last.error[:, 0] * np.exp(-1j * w * last.t))))


@entry("sec-10.2.1.1", "an integral does not remove the tracking error of a sine")
def following() -> Shown:
    """The chapter: integral control does not eliminate tracking error along arbitrary trajectories.

    Here it even grows. Chosen: 0.5 rad at 2 rad/s in a horizontal plane, gains of figure 10.6.
    """
    w, size = 2.0, 0.5
    sine = Sine(center=[0.0], amplitude=size, frequency=w / (2.0 * math.pi))
    for ki in (0.0, KI):
        run = on_link(PID(kp=KP, kd=KD, ki=ki), sine, plant=link(gravity=False), duration=10.0 * math.pi)
        s = 1j * w
        wanted = size * abs((M * s**2 + B * s) * s / (M * s**3 + (B + KD) * s**2 + KP * s + ki))
        name = f"amplitude of the error, Ki = {ki:g} [rad]"
        yield row(name, amplitude(run, w), wanted, "the transfer function", rel=2e-3)


@entry("sec-10.2.1.1", "delayed feedback destabilises")
def delayed() -> Shown:
    """The chapter: delayed feedback can cause instability.

    Gains of figure 10.6, which are critically damped without a delay, in a horizontal plane at 100 Hz.
    """

    def open_loop(w: float) -> complex:
        return (KP + KD * 1j * w) / (M * (1j * w) ** 2 + B * 1j * w)

    crossover = brentq(lambda w: abs(open_loop(w)) - 1.0, 0.1, 100.0)
    margin = math.pi + float(np.angle(open_loop(crossover)))
    limit = (margin % (2.0 * math.pi)) / crossover
    found = error_dynamics(M=M, b=B, kp=KP, kd=KD, rate=SERVO_RATE).margins().delay
    source = "phase margin / crossover, less half a tick"
    yield row("delay up to which PD control is stable [s]", found, limit - 0.5 / SERVO_RATE, source, rel=0.002)
    plane = link(gravity=False)
    ctrl = controller(PID(kp=KP, kd=KD), plane, rate=SERVO_RATE)
    for factor in (0.95, 1.05):
        delay = round(SERVO_RATE * factor * limit) / SERVO_RATE
        run = on_link(ctrl, plant=plane, duration=24.0, q0=0.1, actuation=Actuation(delay=delay))
        late, early = (float(np.abs(run.between(*ends).q).max()) for ends in ((18.0, 24.0), (10.0, 16.0)))
        yield row(f"it grows with a delay of {delay:g} s [0 or 1]", late > early, factor > 1.0, "that limit")


@entry("sec-10.2.1.1", "practical bounds on gains")
def bounded() -> Shown:
    """Critically damped designs at 100 Hz with differenced positions; in continuous time all are stable.

    According to the simple model Kp and Kd could grow without bound. With a servo of 100 Hz and differenced
    positions as in figure 10.8 they cannot, even with a torque that has no limits. In a horizontal plane.
    """

    def sampled(omega_n: float) -> LinearSystem:
        return error_dynamics(M=M, b=B, omega_n=omega_n, zeta=1.0, rate=SERVO_RATE, velocity="difference")

    def radius(omega_n: float) -> float:
        return held_radius(M, B, M * omega_n**2, 2.0 * M * omega_n - B, SERVO_RATE)

    limit = bisected(lambda omega_n: sampled(omega_n).stable, 1.0, 100.0)
    gains = second_order(M=M, b=B, omega_n=limit, zeta=1.0)
    wanted = brentq(lambda omega_n: radius(omega_n) - 1.0, 1.0, 100.0)
    source = "poles of the held link, bisected"
    yield row("omega_n up to which zeta = 1 is stable at 100 Hz [rad/s]", limit, wanted, source, rel=1e-6)
    yield row("Kp there [N m/rad]", gains.kp, M * wanted**2, source, rel=1e-6)
    continuous = error_dynamics(M=M, b=B, kp=gains.kp, kd=gains.kd).stable
    yield row("the same in continuous time: stable [0 or 1]", continuous, 1.0, "Re s < 0")
    plane = link(gravity=False)
    for factor in (0.95, 1.05):
        omega_n = factor * limit
        law = PID(kp=M * omega_n**2, kd=2.0 * M * omega_n - B)
        ctrl = controller(law, plane, rate=SERVO_RATE, differenced=True)
        run = on_link(ctrl, plant=plane, duration=1.5, q0=1e-3, substeps=4)
        got = float(np.exp(max(two_poles(run.q[60:, 0], 1.0).real)))
        name, claim = (
            "factor by which an oscillation grows in a tick, omega_n =",
            "instability due to the finite servo rate",
        )
        name = f"{name} {factor:g} of that"
        yield row(name, got, radius(omega_n), "poles of the held link", rel=1e-4, states=claim)
