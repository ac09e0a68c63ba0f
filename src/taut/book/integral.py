"""Section 10.2.1.1: set-points under PD and PID control, and claims on tracking, delays and large gains."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from taut.analysis.loci import bisected, root_locus
from taut.arm.load import load_arm
from taut.base.plot_style import DASHED, INK, SMALL, colour, prepared
from taut.book.models import (
    KD,
    KI,
    KP,
    SAMPLED,
    B,
    M,
    R,
    controller,
    held_radius,
    link,
    looped,
    on_link,
    solved,
    two_poles,
    weight,
)
from taut.book.page import ODE, ROOTS, Shown, arrow, entry, legend, panels, row, words
from taut.control.laws.joint import PID
from taut.control.trajectories.joint import Sine
from taut.control.trajectories.reference import JointMotion
from taut.linear.joint_loop import error_dynamics, second_order
from taut.linear.linear_system import LinearSystem
from taut.linear.linearise import linearise
from taut.plant.actuation import Actuation
from taut.record.run import Run

__all__: list[str] = []

HOME: Final = -math.pi / 2.0  # [rad] where figure 10.6 starts
PID_DURATION: Final = 12.0  # [s]
BOUND: Final = (B + KD) * KP / M  # [N m/(rad s)] of Ki


def figure_10_6(ki: float, kp: float = KP) -> Run:
    """A run of figure 10.6."""
    return on_link(PID(kp=kp, kd=KD, ki=ki), ref=JointMotion(q=[0.0]), duration=PID_DURATION, q0=[HOME])


def written_10_6(ki: float, times: np.ndarray) -> np.ndarray:
    """(k,) the error of the same by SciPy."""

    def tau(_: float, theta: float, v: float, e_int: float) -> float:
        return -KP * theta + ki * e_int - KD * v

    return solved(tau, np.zeros_like, times=times, q0=HOME).e


@entry("eq-10.11", "the link in gravity under PD control")
def eq_10_11() -> Shown:
    for kp, name, states in (
        (KP, "error at rest of PD control", ""),
        (10.0 * KP, "with Kp ten times as large", "small"),
    ):
        wanted = brentq(lambda e, kp=kp: kp * e - weight(-e), 0.0, 1.0)
        rested = -figure_10_6(0.0, kp).q[-1, 0]
        yield row(name, "rad", rested, wanted, "root of Kp e = m g r cos(theta)", rel=1e-6, states=states)
    yield "The goal is theta = 0; gains of figure 10.6."


def constant_disturbance(ki: float) -> Run:
    """The weight of a slide of 3 kg, which is the same everywhere; critically damped."""
    slide = load_arm("gantry3").subset(["z"]).with_joints(viscous=0.0)
    return on_link(
        PID(kp=300.0, kd=60.0, ki=ki), plant=slide, ref=JointMotion(q=[0.1]), duration=10.0, q0=[0.0]
    )  # fmt: skip


@entry("eq-10.12", "a constant disturbance, with an integral")
def eq_10_12() -> Shown:
    mass, kp, kd, ki, push, at = 3.0, 300.0, 60.0, 400.0, 3.0 * 9.81, 0.5
    run = constant_disturbance(ki)
    A = np.array(
        [[0.0, 1.0, 0.0, 0.0], [-kp / mass, -kd / mass, -ki / mass, push / mass], [1.0, 0, 0, 0], [0, 0, 0, 0]]
    )
    wanted = (expm(A * at) @ np.array([0.1, 0.0, 0.0, 1.0]))[0]
    k = int(np.searchsorted(run.t, at - 1e-9))
    yield row(
        "error 0.5 s after a step, with a constant disturbance",
        "m",
        0.1 - run.q[k, 0],
        wanted,
        "scipy.linalg.expm",
        rel=2e-3,
    )
    yield "Chosen: a slide of 3 kg under its weight, Kp = 300 N/m, Kd = 60 N s/m, Ki = 400 N/(m s)."


@entry("eq-10.13", "third-order error dynamics")
def eq_10_13() -> Shown:
    with_i, without = constant_disturbance(400.0), constant_disturbance(0.0)
    yield row("error in the end, Ki = 0", "m", 0.1 - without.q[-1, 0], 3.0 * 9.81 / 300.0, "tau_dist / Kp", rel=1e-6)
    yield row("error in the end, Ki > 0", "m", 0.1 - with_i.q[-1, 0], 0.0, "equation 10.13", near=1e-6)
    yield "An integral removes what a constant disturbance leaves. Numbers of equation 10.12."


@entry("eq-10.14", "their characteristic equation, and the bound of Ki")
def eq_10_14() -> Shown:
    pd = second_order(M=M, b=B, kp=KP, kd=KD)
    yield row("bound of Ki", "N m/(rad s)", pd.largest_ki, BOUND, "(b + Kd) Kp / M")
    plane = link(gravity=False)
    ctrl = controller(PID(kp=KP, kd=KD, ki=KI), plane)
    loop = looped(ctrl, plane, JointMotion(q=[0.0]), friction="arm", integrator="rk4")

    def stable(ki: float) -> bool:
        loop.parameters["law.ki"] = ki
        return linearise(loop, at=[0.0]).stable

    limit = bisected(stable, 0.8 * BOUND, 1.2 * BOUND, tolerance=1e-6)
    yield row("Ki at which taut.laws.PID loses stability", "N m/(rad s)", limit, BOUND, "(b + Kd) Kp / M", rel=2e-4)
    for factor in (0.9, 1.1):
        ki = factor * BOUND
        wanted = np.roots([M, B + KD, KP, ki])
        pole = wanted[wanted.real.argmax()]
        ctrl.parameters["law.ki"] = ki
        run = on_link(ctrl, plant=link(gravity=False), ref=JointMotion(q=[0.0]), duration=30.0, q0=[0.01])
        got = max(two_poles(run.between(6.0, 30.0).q[::100, 0], 0.01).real)
        yield row(
            f"growth of an oscillation, Ki = {factor:g} of the bound",
            "1/s",
            got,
            pole.real,
            f"{ROOTS} of 10.14",
            rel=0.01,
        )
    yield "Gains of figure 10.6 but for Ki; runs of 30 s in a horizontal plane."


@entry("fig-10.6", "PD and PID control in gravity")
def fig_10_6() -> Shown:
    runs = {"PD": figure_10_6(0.0), "PID": figure_10_6(KI)}
    times = runs["PD"].t[::10]
    written = {"PD": written_10_6(0.0, times), "PID": written_10_6(KI, times)}
    e = {name: -run.q[:, 0] for name, run in runs.items()}
    start = -HOME
    yield row(
        "damping ratio of the PD design",
        "",
        second_order(M=M, b=B, kp=KP, kd=KD).zeta,
        1.0,
        "the chapter: critical damping",
        states="1",
    )
    for name in runs:
        yield row(f"{name}: error in the end", "rad", e[name][-1], written[name][-1], ODE, rel=SAMPLED, near=1e-6)
        yield row(f"{name}: least error", "rad", e[name].min(), written[name].min(), ODE, rel=SAMPLED, near=1e-5)
        yield row(
            f"{name}: RMS error",
            "rad",
            math.sqrt(np.mean(e[name] ** 2)),
            math.sqrt(np.mean(written[name] ** 2)),
            ODE,
            rel=SAMPLED,
        )
    wanted = -100.0 * written["PID"].min() / start
    yield row(
        "PID: overshoot",
        "%",
        -100.0 * e["PID"].min() / start,
        wanted,
        ODE,
        rel=SAMPLED,
        states="significant overshoot",
    )
    yield row(
        "PD: torque of Kp in the end",
        "N m",
        runs["PD"].terms["P"][-1, 0],
        weight(-written["PD"][-1]),
        "m g r cos(theta)",
        rel=SAMPLED,
    )
    yield row("PID: torque of Ki in the end", "N m", runs["PID"].terms["I"][-1, 0], weight(0.0), "m g r", rel=5e-3)
    figure, axes = panels(3, 2.6, width_ratios=[1.2, 1.5, 0.9])
    prepared(axes[0], "error", "error [rad]", "t [s]")
    prepared(axes[1], "terms", "torque [N m]", "t [s]")
    for k, (name, run) in enumerate(runs.items()):
        axes[0].plot(run.t[::50], e[name][::50], color=colour(k), linewidth=1.5, label=name)
    axes[0].axhline(0.0, color=INK, linewidth=0.6)
    styles = {"P": colour(2), "I": colour(3), "D": colour(4)}
    for name, run in runs.items():
        for term, values in run.terms.items():
            if name == "PID" or term != "I":
                whole = name == "PID"
                axes[1].plot(
                    run.t[::50], values[::50, 0], color=styles[term], label=f"{name} {term}",
                    linestyle="-" if whole else DASHED, linewidth=1.3 if whole else 1.0,
                )  # fmt: skip
    for ax in axes[:2]:
        legend(ax, ncols=1 if ax is axes[0] else 2)
        ax.set_xlim(0.0, PID_DURATION)
    axes[1].set_ylim(-3.0, 5.0)
    ax = axes[2]
    ax.set_title("start and goal", fontsize=SMALL + 0.5, color=INK, loc="left")
    ax.axis("off")
    ax.set_aspect("equal")
    for theta, face, label in ((HOME, "#E4EBF2", "start"), (0.0, "#C9D8E6", "goal")):
        end = 2.2 * R * np.array([math.cos(theta), math.sin(theta)])
        ax.plot([0.0, end[0]], [0.0, end[1]], color=face, linewidth=9.0, solid_capstyle="round")
        words(ax, 0.62 * float(end[0]), 0.62 * float(end[1]), label)
    ax.plot(0.0, 0.0, "o", color=INK, markersize=5.0)
    arrow(ax, (0.2, -0.08), (0.2, -0.2), width=1.4)
    words(ax, 0.225, -0.14, "g")
    ax.set_xlim(-0.05, 0.26)
    ax.set_ylim(-0.27, 0.06)
    yield figure
    yield "All numbers are the chapter's; ticks of 0.1 ms, 12 s."


@entry("fig-10.7", "root locus over Ki")
def fig_10_7() -> Shown:

    def joint(ki: float) -> LinearSystem:
        return error_dynamics(M=M, b=B, kp=KP, kd=KD, ki=ki)

    values = np.unique([*(1.5 * BOUND * np.linspace(0.0, 1.0, 300) ** 2), KI])
    found = root_locus(joint, values, label="Ki [N m/(rad s)]")
    border, breakaway = found.limits[0], found.breakaways[-1]
    half = 0.5 * (B + KD) / M  # the two collocated roots are at -half, with Ki = 0 beside a third at the origin
    s = -half * 2.0 / 3.0 + math.sqrt((half * 2.0 / 3.0) ** 2 - KP / M / 3.0)  # where d Ki / d s = 0
    yield row(
        "Ki at which the roots cross",
        "N m/(rad s)",
        border.value,
        BOUND,
        "(b + Kd) Kp / M",
        rel=1e-6,
        states="(b + Kd) Kp / M",
    )
    yield row("imaginary part there", "1/s", abs(border.pole.imag), math.sqrt(KP / M), "sqrt(Kp / M)", rel=1e-6)
    yield row(
        "Ki at which two roots break away",
        "N m/(rad s)",
        breakaway.value,
        -s * (M * s * s + (B + KD) * s + KP),
        "d Ki / d s = 0",
        rel=1e-6,
    )
    yield row("where they do", "1/s", breakaway.pole.real, s, "d Ki / d s = 0", rel=1e-4)
    yield row(
        "the third root there",
        "1/s",
        min(joint(breakaway.value).poles.real),
        -(B + KD) / M - 2.0 * s,
        "-(b + Kd) / M, less the two",
        rel=1e-6,
    )
    figure, (ax,) = panels(1, 3.1)
    found.draw(ax, mark=[KI])

    yield figure
    yield 'Gains of figure 10.6: both roots of PD control at -2.1 1/s. "1" marks Ki = 1, that of figure 10.6.'


SERVO_RATE: Final = 100.0  # [Hz]


def amplitude(run: Run, w: float) -> float:
    """Of the error's part at a frequency, over the last whole turns of a run."""
    turn = 2.0 * math.pi / w
    last = run.between(run.t[-1] - 2.0 * turn, run.t[-1] - 1.0 / run.rate)
    assert last.error is not None
    phase = np.exp(-1j * w * last.t)
    return float(abs(2.0 * np.mean(last.error[:, 0] * phase)))


@entry("sec-10.2.1.1", "an integral does not remove the tracking error of a sine", part="sine")
def following() -> Shown:
    w, size = 2.0, 0.5
    sine = Sine(center=[0.0], amplitude=size, frequency=w / (2.0 * math.pi))
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "error while a sine is followed", "error [rad]", "t [s]")
    for k, ki in enumerate((0.0, KI)):
        run = on_link(
            PID(kp=KP, kd=KD, ki=ki), plant=link(gravity=False), ref=sine, duration=10.0 * math.pi, q0=[0.0]
        )  # fmt: skip
        s = 1j * w
        wanted = size * abs((M * s**2 + B * s) * s / (M * s**3 + (B + KD) * s**2 + KP * s + ki))
        name = f"Ki = {ki:g}"
        yield row(
            f"amplitude of the error, {name}", "rad", amplitude(run, w), wanted, "the transfer function", rel=2e-3
        )
        assert run.error is not None
        ax.plot(run.t[::100], run.error[::100, 0], color=colour(k), linewidth=1.4, label=name)
    ax.set_ylim(-0.32, 0.42)
    legend(ax, ncols=2)

    yield figure
    yield (
        "The chapter: integral control does not eliminate tracking error along arbitrary trajectories. Here it even "
        "grows. Chosen: 0.5 rad at 2 rad/s in a horizontal plane, gains of figure 10.6."
    )


@entry("sec-10.2.1.1", "delayed feedback destabilises", part="delay")
def delayed() -> Shown:
    def gain(w: float) -> float:
        s = 1j * w
        return abs((KP + KD * s) / (M * s**2 + B * s)) - 1.0

    crossover = brentq(gain, 0.1, 100.0)
    s = 1j * crossover
    margin = math.pi + float(np.angle((KP + KD * s) / (M * s**2 + B * s)))
    border = (margin % (2.0 * math.pi)) / crossover
    found = error_dynamics(M=M, b=B, kp=KP, kd=KD, rate=SERVO_RATE).margins().delay
    yield row(
        "delay up to which PD control is stable",
        "s",
        found,
        border - 0.5 / SERVO_RATE,
        "phase margin / crossover, less half a tick",
        rel=0.002,
    )
    for factor in (0.95, 1.05):
        taps = round(SERVO_RATE * factor * border)
        run = on_link(
            controller(PID(kp=KP, kd=KD), link(gravity=False), rate=SERVO_RATE), plant=link(gravity=False),
            ref=JointMotion(q=[0.0]), duration=24.0, q0=[0.1], actuation=Actuation(delay=taps / SERVO_RATE),
        )  # fmt: skip
        late, early = (float(np.abs(run.between(*ends).q).max()) for ends in ((18.0, 24.0), (10.0, 16.0)))
        yield row(
            f"it grows with a delay of {taps / SERVO_RATE:g} s", "0 or 1", late > early, factor > 1.0, "that limit"
        )

    yield (
        "The chapter: delayed feedback can cause instability. Gains of figure 10.6, which are critically damped "
        "without a delay, in a horizontal plane at 100 Hz."
    )


@entry("sec-10.2.1.1", "practical bounds on gains", part="bounds")
def bounded() -> Shown:
    """Critically damped designs at 100 Hz with differenced positions: in the book any of them is stable."""

    def sampled(omega_n: float) -> LinearSystem:
        return error_dynamics(M=M, b=B, omega_n=omega_n, zeta=1.0, rate=SERVO_RATE, velocity="difference")

    def radius(omega_n: float) -> float:
        return held_radius(M, B, M * omega_n**2, 2.0 * M * omega_n - B, SERVO_RATE)

    limit = bisected(lambda omega_n: sampled(omega_n).stable, 1.0, 100.0)
    gains = second_order(M=M, b=B, omega_n=limit, zeta=1.0)
    wanted = brentq(lambda omega_n: radius(omega_n) - 1.0, 1.0, 100.0)
    source = "poles of the held link, bisected"
    claim = "instability due to the finite servo rate"
    yield row("omega_n up to which zeta = 1 is stable at 100 Hz", "rad/s", limit, wanted, source, rel=1e-6)
    yield row("Kp there", "N m/rad", gains.kp, M * wanted**2, source, rel=1e-6)
    yield row(
        "the same in continuous time: stable",
        "0 or 1",
        error_dynamics(M=M, b=B, kp=gains.kp, kd=gains.kd).stable,
        1.0,
        "Re s < 0",
    )
    plane, rest = link(gravity=False), JointMotion(q=[0.0])
    for factor in (0.95, 1.05):
        omega_n = factor * limit
        law = PID(kp=M * omega_n**2, kd=2.0 * M * omega_n - B)
        run = on_link(
            controller(law, plane, rate=SERVO_RATE, differenced=True), plant=plane, ref=rest, duration=1.5, q0=[1e-3],
            substeps=4,
        )  # fmt: skip
        got = float(np.exp(max(two_poles(run.q[60:, 0], 1.0).real)))
        name = f"growth of an oscillation in a tick, omega_n = {factor:g} of that"
        yield row(name, "", got, radius(omega_n), "poles of the held link", rel=1e-4, states=claim)

    yield (
        "According to the simple model Kp and Kd could grow without bound. With a servo of 100 Hz and differenced "
        "positions as in figure 10.8 they cannot, even with a torque that has no limits. In a horizontal plane."
    )
