"""Section 10.2.1: the link, its friction, PID control, error dynamics and their roots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import taut
from taut import Gain, JointMotion, Law, LinearSystem, Snapshot, Torque, error_dynamics, snapshot
from taut.analysis import root_locus, routh, second_order
from taut.base.plot_style import DASHED, DOTTED, INK, SMALL, colour
from taut.base.types import Float64Array
from taut.book.models import (
    FAST,
    KD,
    KI,
    KP,
    MASS,
    REST,
    SAMPLED,
    B,
    G,
    M,
    R,
    controller,
    link,
    looped,
    on_link,
    solved,
    ticked,
    two_poles,
    weight,
)  # fmt: skip
from taut.book.page import (
    BY_HAND,
    ODE,
    ROOTS,
    Row,
    Shown,
    arrow,
    curve,
    entry,
    frame,
    law_diagram,
    legend,
    panels,
    pole,
    row,
    rows,
    words,
)  # fmt: skip
from taut.control.trajectories.reference import Sample
from taut.laws import PID, FrictionCompensation
from taut.trajectories import Sine

THETA, V, A = 0.7, 1.3, -0.4  # [rad], [rad/s], [rad/s^2] a state of the link, chosen
STATE: Final = f"Chosen: theta = {THETA} rad, theta-dot = {V} rad/s, theta-ddot = {A} rad/s^2."


class ConstantTorque(Law):
    """A constant torque.

    Law:          tau = tau_0
    Closed loop:  M a + h = tau_0
    """

    ignores_reference = True
    tau: Gain = Gain(minimum=-math.inf)  # [N m | N]

    def command(self, x: Snapshot, ref: Sample) -> Torque:  # noqa: ARG002
        return Torque(constant=self.tau @ np.ones(x.n))


@entry("eq-10.1", "the link without friction")
def eq_10_1() -> Shown:
    """Chosen: theta = 0.7 rad, theta-dot = 1.3 rad/s, theta-ddot = -0.4 rad/s^2."""
    tau = snapshot(link(), [THETA], [V]).inverse_dynamics(np.array([A]))[0]
    yield row("torque without friction [N m]", tau, M * A + weight(THETA), BY_HAND)


@entry("eq-10.2", "viscous friction")
def eq_10_2() -> Shown:
    """Chosen: theta = 0.7 rad, theta-dot = 1.3 rad/s, theta-ddot = -0.4 rad/s^2."""
    ctrl = ticked(FrictionCompensation(at="meas"), link(), [THETA], [V], JointMotion(q=[THETA]))
    yield row("friction torque [N m]", ctrl.terms["friction"][0], B * V, BY_HAND)


@entry("eq-10.3", "the link with friction")
def eq_10_3() -> Shown:
    """Chosen: a start at 0.7 rad and 1.3 rad/s, and the torque."""
    torque, duration = 0.8, 1.5
    run = on_link(ConstantTorque(tau=torque), duration=duration, q0=THETA, v0=V)
    wanted = solved(lambda *_: torque, np.array([0.0, duration]), q0=THETA, v0=V)
    yield row("angle after 1.5 s under 0.8 N m [rad]", run.q[-1, 0], wanted.theta[-1], ODE)
    yield row("its rate [rad/s]", run.v[-1, 0], wanted.v[-1], ODE, rel=1e-8)


@entry("eq-10.4", "the same in two terms")
def eq_10_4() -> Shown:
    """Here x.h is C v + g, and friction is a separate term; their sum is the chapter's h.

    Chosen: theta = 0.7 rad, theta-dot = 1.3 rad/s, theta-ddot = -0.4 rad/s^2.
    """
    x = snapshot(link(), [THETA], [V])
    h = x.h[0] + float(x.arm.viscous[0]) * V
    yield row("M [kg m^2]", x.M[0, 0], M, "section 10.2.1", states="0.5 kg m^2")
    yield row("h: gravity and friction [N m]", h, weight(THETA) + B * V, BY_HAND)


@entry("eq-10.5", "the error")
def eq_10_5() -> Shown:
    e = link().difference(np.array([1.0]), np.array([0.25]))[0]
    yield row("theta_d = 1.0 less theta = 0.25 [rad]", e, 0.75, BY_HAND)


def angles(count: int) -> Float64Array:
    """(count,) what senseAngle gives in the pseudocode at 100 Hz: a motion other than the desired one."""
    t = 0.01 * np.arange(count)
    made: Float64Array = 0.4 * np.sin(2.0 * t) + 0.02 * np.cos(11.0 * t)
    return made


W: Final = 2.0 * math.pi * 0.4  # [rad/s] of the desired motion of the pseudocode


def trajectory(phase: float) -> tuple[float, float, float]:
    """Angle, rate and acceleration of that motion."""
    return 0.2 + 0.5 * math.sin(phase), 0.5 * W * math.cos(phase), -0.5 * W * W * math.sin(phase)


def ticks(law: Law, angle: Float64Array, model: taut.Arm) -> Float64Array:
    """(k,) the torques at 100 Hz of a law that is given angles alone and differences them."""
    ctrl, wanted = (
        controller(law, model, rate=100.0, differenced=True),
        Sine(center=[0.2], amplitude=0.5, frequency=0.4),
    )
    return np.array([ctrl.step([q], ref=wanted.at(k / 100.0))[0] for k, q in enumerate(angle)])


def line_by_line(got: Float64Array, written: Sequence[float]) -> Iterator[Row]:
    """Rows of torques tick by tick, beside those of the pseudocode."""
    worst, source = int(np.argmax(np.abs(got - written))), "the pseudocode, line by line"
    yield row(f"last torque of {len(got)} ticks at 100 Hz [N m]", got[-1], written[-1], source, rel=1e-10)
    yield row("the torque that differs most [N m]", got[worst], written[worst], source, rel=1e-8)


@entry("eq-10.6", "PID control")
def eq_10_6() -> Shown:
    """The integral is the sum over ticks of 1 ms, this tick included, as in figure 10.8; gains of 10.6."""
    ref = JointMotion(q=[1.0], v=[0.3])
    ctrl = controller(PID(kp=KP, kd=KD, ki=KI), link(), rate=1000.0)
    e_int = 0.0
    for theta in (0.2, 0.25, 0.31):
        tau = ctrl.step([theta], [V], ref)[0]
        e_int += (1.0 - theta) * 1e-3
    yield row("torque in the third tick [N m]", tau, KP * (1.0 - 0.31) + KI * e_int + KD * (0.3 - V), BY_HAND)


@entry("eq-10.7", "the closed loop of PD control in a horizontal plane")
def eq_10_7() -> Shown:
    """Chosen: PD gains of figure 10.6, 0.5 rad at 0.2 Hz, ticks of 0.1 ms."""
    duration, w = 2.0, 2.0 * math.pi * 0.2
    sine = Sine(center=[0.0], amplitude=0.5, frequency=0.2)
    run = on_link(PID(kp=KP, kd=KD), sine, plant=link(gravity=False), duration=duration)

    def tau(t: float, theta: float, v: float, _: float) -> float:
        return KP * (0.5 * math.sin(w * t) - theta) + KD * (0.5 * w * math.cos(w * t) - v)

    times = np.array([0.0, duration])
    wanted = solved(tau, times, desired=lambda t: 0.5 * np.sin(w * t), q0=0.0, gravity=False).theta[-1]
    yield row("angle after 2 s of following a sine [rad]", run.q[-1, 0], wanted, ODE, rel=SAMPLED)


@entry("eq-10.8", "error dynamics of a set-point")
def eq_10_8() -> Shown:
    run = on_link(PID(kp=KP, kd=KD), JointMotion(q=[1.0]), plant=link(gravity=False), duration=1.0)
    s = (B + KD) / (2.0 * M)  # both roots: critically damped
    source = "(1 + s t) exp(-s t), s = (b + Kd) / 2 M"
    yield row("error 1 s after a step [rad]", 1.0 - run.q[-1, 0], (1.0 + s) * math.exp(-s), source, rel=SAMPLED)


@entry("fig-10.2", "the link in gravity")
def fig_10_2() -> Shown:
    """Drawn at 35 degrees, from the arm's own frames: the world {s} and the tool {b}."""
    theta = math.radians(35.0)
    x = snapshot(link(), [theta])
    T = x.T("tool")
    centre = np.asarray(T.p)[[0, 2]]
    yield row("height of the centre of mass [m]", centre[1], R * math.sin(theta), "r sin(theta)")
    yield row("torque of gravity about the joint [N m]", x.g[0], MASS * G * R * math.cos(theta), "m g r cos(theta)")
    figure, (ax,) = panels(None, height=2.9)
    along = centre / R
    across = np.array([-along[1], along[0]])
    corners = ((-0.02, -0.02), (0.22, -0.02), (0.22, 0.02), (-0.02, 0.02))
    outline = np.array([a * along + b * across for a, b in corners])
    ax.fill(*outline.T, facecolor="#E4EBF2", edgecolor=INK, linewidth=1.0)
    ax.plot(0.0, 0.0, "o", color=INK, markersize=7.0)
    ax.plot(*centre, "o", color=colour(3), markersize=6.0)
    ends = [place + 0.03 * across for place in (np.zeros(2), centre)]
    arrow(ax, *ends, width=0.8)
    arrow(ax, *ends[::-1], width=0.8)
    words(ax, centre + np.array([0.015, -0.007]), "m", size=SMALL + 1.0)
    words(ax, 0.5 * (ends[0] + ends[1]) + 0.011 * across, "r", size=SMALL + 1.0)
    motor = np.linspace(-0.75 * math.pi, -0.2 * math.pi, 30)
    arrow(ax, *(0.038 * np.column_stack([np.cos(motor), np.sin(motor)])), width=1.4)
    words(ax, (0.0, -0.05), r"$\tau$", size=SMALL + 2.0)
    ax.plot([0.0, 0.24], [0.0, 0.0], color=INK, linewidth=0.6, linestyle="--")
    turn = np.linspace(0.0, theta, 30)
    ax.plot(0.13 * np.cos(turn), 0.13 * np.sin(turn), color=INK, linewidth=0.9)
    words(ax, (0.148 * math.cos(0.5 * theta), 0.148 * math.sin(0.5 * theta)), r"$\theta$", size=SMALL + 2.0)
    arrow(ax, (0.3, 0.14), (0.3, 0.04), width=1.6)
    words(ax, (0.318, 0.09), "g", size=SMALL + 1.0)
    frame(ax, np.zeros(2), 0.05 * np.eye(2), "s", aside=np.array([-0.045, 0.0]))
    frame(ax, centre, 0.05 * np.asarray(T.R)[np.ix_([0, 2], [0, 2])], "b", aside=-0.022 * along)
    ax.set(xlim=(-0.09, 0.35), ylim=(-0.07, 0.17))
    yield figure


@entry("fig-10.3", "block diagram of PID control")
def fig_10_3() -> Shown:
    """Chosen: theta_d = 1.0 rad, theta = 0.2 rad, theta-dot = 1.3 rad/s; gains of figure 10.6."""
    terms, e = ticked(PID(kp=KP, kd=KD, ki=KI), link(), [0.2], [V], JointMotion(q=[1.0])).terms, 0.8
    yield row("term P [N m]", terms["P"][0], KP * e, BY_HAND)
    yield row("term I, after one tick of 1 ms [N m]", terms["I"][0], KI * e * 1e-3, BY_HAND)
    yield row("term D [N m]", terms["D"][0], -KD * V, BY_HAND)
    yield law_diagram(list(terms), "PID: the terms of taut.laws.PID")


@entry("fig-10.8", "pseudocode of PID control")
def fig_10_8() -> Shown:
    """Chosen: recorded angles, a sine as trajectory, gains of figure 10.6."""
    angle = angles(200)
    eint, qprev, written, dt = 0.0, angle[0], [], 0.01
    for k, q in enumerate(angle):  # line by line
        qd, qdotd, _ = trajectory(W * k * dt)
        qdot = (q - qprev) / dt
        qprev = q
        e = qd - q
        edot = qdotd - qdot
        eint = eint + e * dt
        written.append(KP * e + KD * edot + KI * eint)
    got = ticks(PID(kp=KP, kd=KD, ki=KI), angle, link())
    yield from line_by_line(got, written)


FORMULA: Final = "the formula"
STIFF_KD: Final = 10.0  # [N m s/rad] figure 10.5
LAST_CROSSING: Final = "last crossing of 2 %, bisected"


def settling(zeta: float) -> float:
    """omega_n times the exact 2 % settling time, by bisection on the matrix exponential."""
    A = np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]])

    def y(x: Any) -> Any:
        return expm(A * np.asarray(x)[..., np.newaxis, np.newaxis])[..., 0, 0]

    grid = np.linspace(0.0, 8.0 / min(zeta, 1.0 / zeta), 2001)
    last = int(np.flatnonzero(np.abs(y(grid)) > 0.02)[-1])
    return float(brentq(lambda x: abs(y(x)) - 0.02, grid[last], grid[last + 1], xtol=1e-14))


def overshoot(zeta: float) -> float:
    """Overshoot by the formula [%]."""
    return 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))


@entry("eq-10.9", "the standard second-order form")
def eq_10_9() -> Shown:
    """Chosen: Kp = 5 N m/rad, Kd = 2 N m s/rad, which is underdamped."""
    d = second_order(M=M, b=B, kp=5.0, kd=KD)
    gains: Any = taut.design(PID, link(gravity=False), zeta=1.0, omega_n=(B + KD) / (2.0 * M)).law
    critical = second_order(M=M, b=B, kd=KD, zeta=1.0).kp
    yield row("damping ratio", d.zeta, (B + KD) / (2.0 * math.sqrt(5.0 * M)), FORMULA)
    yield row("natural frequency [rad/s]", d.omega_n, math.sqrt(5.0 / M), FORMULA)
    yield row("Kp for critical damping with Kd = 2 [N m/rad]", critical, 2.205, "figure 10.6", states="2.205")
    name = "the same of taut.design, with omega_n = 2.1 rad/s [N m/rad]"
    yield row(name, gains.kp.as_array()[0], 2.205, "figure 10.6")
    yield row("and its Kd, less b [N m s/rad]", gains.kd.as_array()[0] - B, 2.0, "figure 10.6", states="2")


@entry("eq-10.10", "its roots")
def eq_10_10() -> Shown:
    """Underdamped roots are -zeta omega_n +- j omega_d; the chapter leaves the j out.

    The numbers are those of Kp = 5 N m/rad and Kd = 2 N m s/rad.
    """

    def upper(poles: Any) -> complex:
        return complex(poles[poles.imag.argmax()])

    wanted = upper(np.roots([1.0, (B + KD) / M, 5.0 / M]))
    law, plane = PID(kp=5.0, kd=KD), link(gravity=False)
    run = on_link(law, plant=plane, duration=1.0, q0=1.0)
    loop = looped(law, plane, REST, rate=FAST, friction="arm", integrator="rk4")
    (mode,) = taut.linearise(loop, at=[0.0]).modes
    slip = "slip: -zeta omega_n +- omega_d, without the j"
    exact = upper(error_dynamics(M=M, b=B, kp=5.0, kd=KD).poles)
    yield from pole("{} of the roots", exact, wanted, ROOTS, imaginary=slip)
    yield from pole("{}, of the loop linearised", mode.s, wanted, ROOTS, rel=1e-3)
    yield from pole("{}, fitted to a run", upper(two_poles(run.q[::10, 0], 1e-3)), wanted, ROOTS, rel=1e-3)


@entry("sec-10.2.1.1", "stability, settling and overshoot")
def sec_10_2_1_1() -> Shown:
    """4 tau is a rule of thumb for the envelope.

    The exact settling time is 5.83 / omega_n at zeta = 1 and 3.60 / omega_n at 0.78, where 4 tau would be 4 and
    5.1.
    """
    third, bound = [M, B + KD, 2.205], (B + KD) * 2.205 / M
    for name, coefficients in (
        ("second order, signs all equal", [1.0, 2.0, 3.0]),
        ("third order, a2 a1 = 1.01 a3 a0", [*third, bound / 1.01]),
        ("third order, a2 a1 = 0.99 a3 a0", [*third, bound / 0.99]),
    ):
        stable = max(np.roots(coefficients).real) < 0
        yield row(f"{name}: stable [0 or 1]", routh(coefficients).stable, stable, ROOTS)
    for zeta in (0.25, 0.5, 0.78, 1.0, 1.5):
        got = error_dynamics(omega_n=1.0, zeta=zeta).step().settling_time
        slowest = zeta if zeta <= 1.0 else zeta - math.sqrt(zeta**2 - 1.0)
        name, states = f"omega_n times 2 % settling time, zeta = {zeta:g}", f"about 4 tau = {4.0 / slowest:.3g}"
        yield row(name, got, settling(zeta), LAST_CROSSING, states=states)
    zetas = (0.2, 0.5, 0.8)
    found = [error_dynamics(omega_n=1.0, zeta=zeta).step().overshoot for zeta in zetas]
    source = "exp(-pi zeta / sqrt(1 - zeta^2))"
    yield from rows("overshoot, zeta = {:g} [%]", zetas, found, map(overshoot, zetas), source)


@entry("fig-10.4", "the response to a step")
def fig_10_4() -> Shown:
    """A slide under its weight replaces the link: its response is linear, its steady-state error exact.

    Chosen: a slide of 3 kg that its weight pulls down, zeta = 0.25, omega_n = 20 rad/s, a step of 0.2 m.
    """
    zeta, omega_n, step, start, mass = 0.25, 20.0, 0.2, -0.1, 3.0
    slide = taut.load_arm("gantry3").subset(["z"]).with_joints(viscous=0.0)
    d = second_order(M=mass, zeta=zeta, omega_n=omega_n)
    run = on_link(PID(kp=d.kp, kd=d.kd), JointMotion(q=[start + step]), plant=slide, duration=2.0, q0=start)
    e = (start + step - run.q[:, 0]) / step
    droop, T = mass * 9.81 / (mass * omega_n**2) / step, settling(zeta) / omega_n
    found, source = run.metrics, "exp(-pi zeta / sqrt(1 - zeta^2))"
    yield row("overshoot [%]", found.overshoot[0], overshoot(zeta), source, rel=2e-3)
    states = f"about 4 tau = {4.0 / (zeta * omega_n):.3g} s"
    yield row("2 % settling time [s]", found.settling_time[0], T, LAST_CROSSING, rel=2e-3, states=states)
    name = "steady-state error [% of the step]"
    yield row(name, found.steady_state_error[0], 100.0 * droop, "m g / Kp", rel=2e-3)
    figure, (ax,) = panels(("error after a step", "error / step", "t [s]"), height=2.8)
    curve(ax, run.t, e, k=0)
    band = 0.02 * (1.0 - droop)
    ax.axhspan(droop - band, droop + band, color=colour(2), alpha=0.25, linewidth=0.0, label="2 % band")
    ax.axhline(droop, color=INK, linewidth=0.9, linestyle=DASHED, label="steady-state error")
    ax.axvline(T, color=colour(1), linewidth=1.0, linestyle=DOTTED, label=f"settled, {T:.3g} s")
    at, least = run.t[np.argmin(e)], e.min()
    ax.annotate("", (at, least), (at, droop), arrowprops={"arrowstyle": "<->", "color": INK, "linewidth": 0.9})
    words(ax, (at + 0.085, least + 0.1), "overshoot", ha="left")
    legend(ax)
    ax.set_xlim(0.0, 1.5)
    yield figure


@entry("fig-10.5", "root locus over Kp, and three responses")
def fig_10_5() -> Shown:
    """Kd = 10 N m s/rad in a horizontal plane.

    The chapter: the settling time is unaffected as Kp is increased beyond critical damping. That is 4 tau; the
    exact settling time changes, as the rows say.
    """
    zetas = (1.5, 1.0, 0.5)  # of its roots "1", "2" and "3"
    designs = [second_order(M=M, b=B, kd=STIFF_KD, zeta=zeta) for zeta in zetas]

    def joint(kp: float) -> LinearSystem:
        return error_dynamics(M=M, b=B, kp=kp, kd=STIFF_KD)

    values = np.unique([*np.linspace(0.0, 1.3 * designs[-1].kp, 200), *(d.kp for d in designs)])
    locus = root_locus(joint, values, label="Kp [N m/rad]")
    meeting, critical = locus.breakaways[0], (B + STIFF_KD) ** 2 / (4.0 * M)
    yield row("Kp where the roots meet [N m/rad]", meeting.value, critical, "(b + Kd)^2 / 4 M", rel=1e-6)
    half = -(B + STIFF_KD) / (2.0 * M)
    yield row("where they meet [1/s]", meeting.pole.real, half, "-(b + Kd) / 2 M", rel=1e-6)
    titles = ("", "", ""), ("error after a step of 1 rad", "error [rad]", "t [s]")
    figure, (left, right) = panels(*titles, height=2.9)
    locus.draw(left, mark=[d.kp for d in designs])
    for k, (zeta, d) in enumerate(zip(zetas, designs, strict=True)):
        name = f'"{k + 1}", zeta = {zeta:g}'
        yield row(f"{name}: Kp [N m/rad]", d.kp, critical / zeta**2, "critical Kp / zeta^2")
        slow = np.roots([M, B + STIFF_KD, d.kp]).real.max()
        found = max(joint(d.kp).poles.real)
        yield row(f'"{k + 1}": real part of the slower root [1/s]', found, slow, ROOTS, rel=1e-6)
        law = PID(kp=d.kp, kd=STIFF_KD)
        run = on_link(law, JointMotion(q=[1.0]), plant=link(gravity=False), duration=6.0)
        states = "slip: unaffected beyond critical damping" if zeta < 1.0 else ""
        T, wanted = run.metrics.settling_time[0], settling(zeta) / d.omega_n
        what = f'"{k + 1}": 2 % settling time of a run [s]'
        yield row(what, T, wanted, LAST_CROSSING, rel=2e-3, states=states)
        curve(right, run.t, 1.0 - run.q[:, 0], name, k)
    right.axhline(0.0, color=INK, linewidth=0.6)
    right.set_xlim(0.0, 1.5)
    legend(right)
    yield figure
