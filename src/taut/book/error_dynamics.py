"""Section 10.2.1.1: error dynamics of PD control, their roots, and figures 10.4 and 10.5."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq

from taut.analysis.design.design import design
from taut.analysis.loci import root_locus
from taut.arm.load import load_arm
from taut.base.plot_style import DASHED, DOTTED, INK, SMALL, colour, prepared
from taut.book.drawing import legend, panels
from taut.book.link import FAST, KD, B, M, link, on_link
from taut.book.page import ROOTS, Entry, Page, Row, row
from taut.book.simulation import looped, two_poles
from taut.control.laws.joint import PID
from taut.control.trajectories.reference import JointMotion
from taut.linear.joint_loop import error_dynamics, second_order
from taut.linear.linear_system import LinearSystem
from taut.linear.linearise import linearise
from taut.linear.routh_table import routh

__all__ = ["ENTRIES", "settling"]

FORMULA: Final = "the formula"
STIFF_KD: Final = 10.0  # [N m s/rad] figure 10.5
ZETAS: Final = (1.5, 1.0, 0.5)  # of its roots "1", "2" and "3"


def settling(zeta: float) -> float:
    """omega_n times the exact 2 % settling time, by bisection on the written-out step response."""

    def y(x: float) -> float:
        if zeta == 1.0:
            return (1.0 + x) * math.exp(-x)
        if zeta > 1.0:
            s, S = zeta - math.sqrt(zeta**2 - 1.0), zeta + math.sqrt(zeta**2 - 1.0)
            return (S * math.exp(-s * x) - s * math.exp(-S * x)) / (S - s)
        w = math.sqrt(1.0 - zeta**2)
        return math.exp(-zeta * x) * (math.cos(w * x) + zeta / w * math.sin(w * x))

    grid = np.linspace(0.0, 40.0 / min(zeta, 1.0 / zeta), 40001)
    outside = np.flatnonzero(np.abs([y(float(x)) for x in grid]) > 0.02)
    last = int(outside[-1])
    return float(brentq(lambda x: abs(y(x)) - 0.02, grid[last], grid[last + 1], xtol=1e-14))


def eq_10_9() -> Page:
    d = second_order(M=M, b=B, kp=5.0, kd=KD)
    gains: Any = design(PID, link(gravity=False), zeta=1.0, omega_n=(B + KD) / (2.0 * M), friction="arm").law
    kp, kd = gains.kp.as_array()[0], gains.kd.as_array()[0]
    rows = (
        row("damping ratio", "", d.zeta, (B + KD) / (2.0 * math.sqrt(5.0 * M)), FORMULA),
        row("natural frequency", "rad/s", d.omega_n, math.sqrt(5.0 / M), FORMULA),
        row(
            "Kp for critical damping with Kd = 2",
            "N m/rad",
            second_order(M=M, b=B, kd=KD, zeta=1.0).kp,
            2.205,
            "figure 10.6",
            states="2.205",
        ),
        row("the same of taut.design, with omega_n = 2.1 rad/s", "N m/rad", kp, 2.205, "figure 10.6"),
        row("and its Kd", "N m s/rad", kd, 2.0, "figure 10.6", states="2"),
    )
    return Page(rows=rows, note="Chosen: Kp = 5 N m/rad, Kd = 2 N m s/rad, which is underdamped.")


def eq_10_10() -> Page:
    d = error_dynamics(M=M, b=B, kp=5.0, kd=KD)
    wanted = np.roots([1.0, (B + KD) / M, 5.0 / M])
    upper = wanted[wanted.imag.argmax()]
    got = d.poles[d.poles.imag.argmax()]
    plane, rest = link(gravity=False), JointMotion(q=[0.0])
    run = on_link(PID(kp=5.0, kd=KD), plant=plane, ref=rest, duration=1.0, q0=[1.0])
    fitted = two_poles(run.q[::10, 0], 1e-3)
    found = fitted[fitted.imag.argmax()]
    (mode,) = linearise(
        looped(PID(kp=5.0, kd=KD), plane, rest, rate=FAST, friction="arm", integrator="rk4"), at=[0.0]
    ).modes
    slip = "slip: -zeta omega_n +- omega_d, without the j"
    rows = (
        row("real part of the roots", "1/s", got.real, upper.real, ROOTS),
        row("imaginary part of the roots", "1/s", got.imag, upper.imag, ROOTS, states=slip),
        row("real part, of the loop linearised", "1/s", mode.s.real, upper.real, ROOTS, rel=1e-3),
        row("imaginary part, of the loop linearised", "1/s", mode.s.imag, upper.imag, ROOTS, rel=1e-3),
        row("real part, fitted to a run", "1/s", found.real, upper.real, ROOTS, rel=1e-3),
        row("imaginary part, fitted to a run", "1/s", found.imag, upper.imag, ROOTS, rel=1e-3),
    )
    note = (
        "Underdamped roots are -zeta omega_n +- j omega_d; the chapter leaves the j out. The numbers are those of Kp "
        "= 5 N m/rad and Kd = 2 N m s/rad."
    )
    return Page(rows=rows, note=note)


def sec_10_2_1_1() -> Page:
    third = [M, B + KD, 2.205]
    border = (B + KD) * 2.205 / M
    rows: list[Row] = [
        row(
            "second order, signs all equal: stable",
            "0 or 1",
            routh([1.0, 2.0, 3.0]).stable,
            max(np.roots([1.0, 2.0, 3.0]).real) < 0,
            ROOTS,
        ),
        row(
            "third order, a2 a1 = 1.01 a3 a0: stable",
            "0 or 1",
            routh([*third, border / 1.01]).stable,
            max(np.roots([*third, border / 1.01]).real) < 0,
            ROOTS,
        ),
        row(
            "third order, a2 a1 = 0.99 a3 a0: stable",
            "0 or 1",
            routh([*third, border / 0.99]).stable,
            max(np.roots([*third, border / 0.99]).real) < 0,
            ROOTS,
        ),
    ]
    for zeta in (0.25, 0.5, 0.78, 1.0, 1.5):
        d = error_dynamics(omega_n=1.0, zeta=zeta).step()
        slowest = zeta if zeta <= 1.0 else zeta - math.sqrt(zeta**2 - 1.0)
        rows.append(
            row(
                f"omega_n times 2 % settling time, zeta = {zeta:g}", "", d.settling_time, settling(zeta),
                "last crossing of 2 %, bisected", states=f"about 4 tau = {4.0 / slowest:.3g}",
            )
        )  # fmt: skip
    for zeta in (0.2, 0.5, 0.8):
        d = error_dynamics(omega_n=1.0, zeta=zeta).step()
        wanted = 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
        rows.append(row(f"overshoot, zeta = {zeta:g}", "%", d.overshoot, wanted, "exp(-pi zeta / sqrt(1 - zeta^2))"))
    note = (
        "4 tau is a rule for the envelope. The exact settling time is 5.83 / omega_n at zeta = 1 and 3.60 / omega_n "
        "at 0.78, where 4 tau would be 4 and 5.1."
    )
    return Page(rows=tuple(rows), note=note)


def fig_10_4() -> Page:
    """A slide under a constant force stands for the link: its steady-state error is exact, its response linear."""
    zeta, omega_n, step = 0.25, 20.0, 0.2
    slide = load_arm("gantry3").subset(["z"]).with_joints(viscous=0.0)
    mass = 3.0
    d = second_order(M=mass, zeta=zeta, omega_n=omega_n)
    start = -0.1
    run = on_link(
        PID(kp=d.kp, kd=d.kd), plant=slide, ref=JointMotion(q=[start + step]), duration=2.0, q0=[start]
    )  # fmt: skip
    e = (start + step - run.q[:, 0]) / step
    droop = mass * 9.81 / (mass * omega_n**2) / step
    wanted = 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
    rows = (
        row("overshoot", "%", run.metrics.overshoot[0], wanted, "exp(-pi zeta / sqrt(1 - zeta^2))", rel=2e-3),
        row(
            "2 % settling time",
            "s",
            run.metrics.settling_time[0],
            settling(zeta) / omega_n,
            "last crossing of 2 %, bisected",
            rel=2e-3,
            states=f"about 4 tau = {4.0 / (zeta * omega_n):.3g} s",
        ),
        row(
            "steady-state error",
            "% of the step",
            run.metrics.steady_state_error[0],
            100.0 * droop,
            "m g / Kp",
            rel=2e-3,
        ),
    )
    figure, (ax,) = panels(1, 2.8)
    prepared(ax, "error after a step", "error / step", "t [s]")
    ax.plot(run.t, e, color=colour(0), linewidth=1.5)
    T = settling(zeta) / omega_n
    band = 0.02 * (1.0 - droop)
    ax.axhspan(droop - band, droop + band, color=colour(2), alpha=0.25, linewidth=0.0, label="2 % band")
    ax.axhline(droop, color=INK, linewidth=0.9, linestyle=DASHED, label="steady-state error")
    ax.axvline(T, color=colour(1), linewidth=1.0, linestyle=DOTTED, label=f"settled, {T:.3g} s")
    k = int(np.argmin(e))
    ax.annotate(
        "", (run.t[k], e[k]), (run.t[k], droop), arrowprops={"arrowstyle": "<->", "color": INK, "linewidth": 0.9}
    )
    ax.text(run.t[k] + 0.085, e[k] + 0.1, "overshoot", fontsize=SMALL, color=INK, va="center")
    legend(ax)
    ax.set_xlim(0.0, 1.5)
    note = "Chosen: a slide of 3 kg that its weight pulls down, zeta = 0.25, omega_n = 20 rad/s, a step of 0.2 m."
    return Page(rows=rows, figure=figure, note=note)


def fig_10_5() -> Page:
    designs = [second_order(M=M, b=B, kd=STIFF_KD, zeta=zeta) for zeta in ZETAS]

    def joint(kp: float) -> LinearSystem:
        return error_dynamics(M=M, b=B, kp=kp, kd=STIFF_KD)

    values = np.unique([*np.linspace(0.0, 1.3 * designs[-1].kp, 200), *(d.kp for d in designs)])
    found = root_locus(joint, values, label="Kp [N m/rad]")
    meeting = found.breakaways[0]
    critical = (B + STIFF_KD) ** 2 / (4.0 * M)
    rows = [
        row("Kp where the roots meet", "N m/rad", meeting.value, critical, "(b + Kd)^2 / 4 M", rel=1e-6),
        row("where they meet", "1/s", meeting.pole.real, -(B + STIFF_KD) / (2.0 * M), "-(b + Kd) / 2 M", rel=1e-6),
    ]
    figure, (left, right) = panels(2, 2.9)
    found.draw(left, mark=[d.kp for d in designs])
    prepared(right, "error after a step of 1 rad", "error [rad]", "t [s]")
    for k, (zeta, d) in enumerate(zip(ZETAS, designs, strict=True)):
        wanted = np.roots([M, B + STIFF_KD, d.kp])
        slow = wanted[wanted.real.argmax()]
        rows += [
            row(f'"{k + 1}", zeta = {zeta:g}: Kp', "N m/rad", d.kp, critical / zeta**2, "critical Kp / zeta^2"),
            row(
                f'"{k + 1}": real part of the slower root',
                "1/s",
                max(joint(d.kp).poles.real),
                slow.real,
                ROOTS,
                rel=1e-6,
            ),
        ]
        run = on_link(
            PID(kp=d.kp, kd=STIFF_KD), plant=link(gravity=False), ref=JointMotion(q=[1.0]), duration=6.0, q0=[0.0]
        )  # fmt: skip
        T = settling(zeta) / d.omega_n
        states = "slip: unaffected beyond critical damping" if zeta < 1.0 else ""
        rows.append(
            row(
                f'"{k + 1}": 2 % settling time of a run',
                "s",
                run.metrics.settling_time[0],
                T,
                "last crossing of 2 %, bisected",
                rel=2e-3,
                states=states,
            )
        )
        right.plot(run.t, 1.0 - run.q[:, 0], color=colour(k), linewidth=1.5, label=f'"{k + 1}", zeta = {zeta:g}')
    right.axhline(0.0, color=INK, linewidth=0.6)
    right.set_xlim(0.0, 1.5)
    legend(right)
    note = (
        "Kd = 10 N m s/rad in a horizontal plane. The chapter: the settling time is unaffected as Kp is increased "
        "beyond critical damping. That is 4 tau; the exact settling time changes, as the rows say."
    )
    return Page(rows=tuple(rows), figure=figure, note=note)


ENTRIES: Final = (
    Entry(id="sec-10.2.1.1", title="stability, settling and overshoot", make=sec_10_2_1_1),
    Entry(id="eq-10.9", title="the standard second-order form", make=eq_10_9),
    Entry(id="eq-10.10", title="its roots", make=eq_10_10),
    Entry(id="fig-10.4", title="the response to a step", make=fig_10_4),
    Entry(id="fig-10.5", title="root locus over Kp, and three responses", make=fig_10_5),
)
