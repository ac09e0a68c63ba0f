"""Sections 10.2.1.2 and 10.2.1.3: feedforward, and feedforward plus feedback linearisation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from scipy.linalg import expm

from taut import JointMotion, Law, Run, snapshot
from taut.base.plot_style import DASHED, colour, legend_above
from taut.base.types import Float64Array
from taut.book.models import (
    KD,
    KI,
    KP,
    SAMPLED,
    WRONG_R,
    B,
    M,
    Solved,
    link,
    on_link,
    rms,
    solved,
    ticked,
    total,
    weight,
)
from taut.book.page import BY_HAND, ODE, Row, Shown, curve, entry, law_diagram, legend, panels, row
from taut.book.single_joint import W, angles, line_by_line, ticks, trajectory
from taut.laws import PID, ComputedTorque, FeedForward, FrictionCompensation
from taut.trajectories import Sine

STATE: Final = JointMotion(q=[0.9], v=[0.5], a=[-1.2])  # desired, chosen
THETA, V = 0.7, 1.3  # [rad], [rad/s] actual, chosen
FED_FORWARD: Final = FeedForward() + FrictionCompensation(at="ref")


def model_torque(theta: float, v: float, a: float, r: float = WRONG_R) -> float:
    """M a + m g r cos(theta) + b v with the model of figure 10.10 [N m]."""
    return M * a + float(weight(theta, r)) + B * v


@entry("eq-10.15", "the controller's model")
def eq_10_15() -> Shown:
    """The model of figure 10.10 at theta = 0.7 rad, theta-dot = 1.3 rad/s."""
    x = snapshot(link(r=WRONG_R), [THETA], [V])
    h = x.h[0] + float(x.arm.viscous[0]) * V
    yield row("the model's M [kg m^2]", x.M[0, 0], M, "section 10.2.1")
    yield row("the model's h, with r = 0.08 m [N m]", h, model_torque(THETA, V, 0.0), BY_HAND)


@entry("eq-10.16", "feedforward control")
def eq_10_16() -> Shown:
    """The chapter's h includes friction, so FrictionCompensation is added to the law."""
    tau = total(ticked(FED_FORWARD, link(r=WRONG_R), [THETA], [V], STATE).terms)[0]
    yield row("torque at theta_d = 0.9, 0.5, -1.2 [N m]", tau, model_torque(0.9, 0.5, -1.2), BY_HAND)


@entry("fig-10.9", "pseudocode of feedforward control")
def fig_10_9() -> Shown:
    """Chosen: a sine as trajectory."""
    got = ticks(FED_FORWARD, angles(100), link(r=WRONG_R))
    written = [model_torque(*trajectory(W * 0.01 * k)) for k in range(100)]
    yield from line_by_line(got, written)


CENTRES: Final = {1: -0.5 * math.pi, 2: 0.5 * math.pi}  # [rad] of the tasks of figure 10.10


def desired(number: int, t: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Angle, rate and acceleration of a task of figure 10.10."""
    return CENTRES[number] - np.cos(t), np.sin(t), np.cos(t)


def compared_task(
    number: int, law: Law, tau: Callable[..., float], r: float = WRONG_R
) -> tuple[Run, Float64Array, Solved]:
    """A task as a run with a model, its error, and the same by SciPy with its torque written out."""
    start = float(desired(number, np.zeros(1))[0][0])
    task = Sine(center=[CENTRES[number]], amplitude=-1.0, frequency=0.5 / math.pi, phase=math.pi / 2.0)
    run = on_link(law, task, model=link(r=r), plant=link(), duration=math.pi, q0=start)
    assert run.error is not None
    return run, run.error[:, 0], solved(tau, run.t, desired=lambda t: desired(number, t)[0], q0=start)


def fed_forward(number: int, r: float = WRONG_R) -> Callable[..., float]:
    """The torque of feedforward control along a task."""

    def tau(t: float, *_: float) -> float:
        q, v, a = (float(each) for each in desired(number, np.asarray(t)))
        return model_torque(q, v, a, r)

    return tau


def of_run(name: str, run: Run, written: Solved, states: str = "") -> Iterator[Row]:
    """Rows of the errors and the effort of a run, beside those by SciPy."""
    assert run.error is not None
    e, wanted = run.error[:, 0], written.e
    yield row(f"{name}: RMS error [rad]", rms(e), rms(wanted), ODE, rel=SAMPLED, states=states)
    yield row(f"{name}: largest error [rad]", np.abs(e).max(), np.abs(wanted).max(), ODE, rel=SAMPLED)
    yield row(f"{name}: integral of tau^2 [(N m)^2 s]", run.metrics.effort[0], written.effort[-1], ODE, rel=2e-3)


@entry("fig-10.10", "feedforward control with a wrong model")
def fig_10_10() -> Shown:
    """Numbers of the chapter. The chapter's h includes friction, so FrictionCompensation is added to the law."""
    figure, axes = panels(*((f"Task {number}", "angle [rad]", "t [s]") for number in (1, 2)), height=2.6)
    peaks, wanted_peaks = [], []
    for number, ax in enumerate(axes, 1):
        run, _, written = compared_task(number, FED_FORWARD, fed_forward(number))
        yield from of_run(f"Task {number}", run, written)
        q = desired(number, run.t)[0]
        peaks.append(np.abs(run.q[:, 0] - q).max())
        wanted_peaks.append(np.abs(written.e).max())
        curve(ax, run.t, q, "desired", linestyle=DASHED)
        curve(ax, run.t, run.q[:, 0], "actual", number - 1)
        legend(ax)
    name = "largest error of Task 2 over that of Task 1"
    ratio, wanted, claim = peaks[1] / peaks[0], wanted_peaks[1] / wanted_peaks[0], "small in Task 1, larger in Task 2"
    yield row(name, ratio, wanted, ODE, rel=2e-3, states=claim)
    _, exact, _ = compared_task(2, FED_FORWARD, fed_forward(2, 0.1), 0.1)
    name = "Task 2 with r = 0.1 m: largest error [rad]"
    yield row(name, np.abs(exact).max(), 0.0, "the chapter: follows exactly", near=1e-3)
    yield figure


def controllers() -> dict[str, tuple[Law, Callable[..., float]]]:
    """Controllers of figure 10.12 and their torques written out; the gains of figure 10.6 in both readings."""

    def feedback(t: float, theta: float, v: float, e_int: float) -> float:
        q, qdot, _ = (float(each) for each in desired(2, np.asarray(t)))
        return KP * (q - theta) + KI * e_int + KD * (qdot - v)

    def both(share: float) -> tuple[Law, Callable[..., float]]:
        def tau(t: float, theta: float, v: float, e_int: float) -> float:
            return model_torque(theta, v, math.cos(t) + share * feedback(t, theta, v, e_int))

        law = ComputedTorque(kp=share * KP, kd=share * KD, ki=share * KI) + FrictionCompensation(at="meas")
        return law, tau

    return {
        "ff": (FED_FORWARD, fed_forward(2)),
        "fb": (PID(kp=KP, kd=KD, ki=KI), feedback),
        "ff+fb, gains as accelerations": both(1.0),
        "ff+fb, gains as torques": both(1.0 / M),
    }


@entry("fig-10.12", "feedforward, feedback, and both")
def fig_10_12() -> Shown:
    """Gains of figure 10.6 multiply errors into torques, those of equation 10.19 into accelerations.

    Both readings are computed, the second with the gains divided by M. Both confirm the chapter: better tracking than
    either alone, less effort than feedback alone. FrictionCompensation is added to the law for the friction in h.
    """
    titles = (
        ("Task 2", "angle [rad]", "t [s]"), ("tracking error", "error [rad]", "t [s]"),
        ("effort", "integral of tau^2 [(N m)^2 s]", ""),
    )  # fmt: skip
    figure, (left, middle, right) = panels(*titles, height=2.9, width_ratios=[1.0, 1.0, 0.8])
    error, effort = {}, {}
    for k, (name, (law, tau)) in enumerate(controllers().items()):
        run, e, written = compared_task(2, law, tau)
        yield from of_run(name, run, written, "slip: gains are taken from figure 10.6" if "gains" in name else "")
        q = desired(2, run.t)[0]
        error[name], effort[name] = (
            (rms(run.q[:, 0] - q), rms(written.e)),
            (run.metrics.effort[0], written.effort[-1]),
        )
        curve(left, run.t, run.q[:, 0], k=k)
        curve(middle, run.t, e, name, k)
        right.bar(k, effort[name][0], color=colour(k))
    curve(left, run.t, q, "desired", linestyle=DASHED)
    right.set_xticks([])
    legend_above(figure, [*middle.lines, left.lines[-1]])
    for name in list(error)[2:]:
        for measure, of, other in (("RMS error", error, "ff"), ("RMS error", error, "fb"), ("effort", effort, "fb")):
            got, wanted = np.divide(of[name], of[other])
            yield row(f"{name}: {measure} over that of {other}", got, wanted, ODE, rel=3e-3, states="below 1")
    yield figure


@entry("eq-10.17", "error dynamics along any trajectory")
def eq_10_17() -> Shown:
    """Chosen: Kp = 100, Kd = 20, Ki = 150, 0.8 rad at 0.7 Hz.

    The chapter's h includes friction, so FrictionCompensation is added to the law.
    """
    kp, kd, ki, at = 100.0, 20.0, 150.0, 0.3
    law, sine = LINEARISING + FrictionCompensation(at="meas"), Sine(center=[0.3], amplitude=0.8, frequency=0.7)
    first = sine.at(0.0)
    run = on_link(law, sine, duration=at, q0=first.q[0] - 0.1, v0=first.v[0])
    A = np.array([[0.0, 1.0, 0.0], [-kp, -kd, -ki], [1.0, 0.0, 0.0]])
    wanted = (expm(A * at) @ np.array([0.1, 0.0, 0.0]))[0]
    assert run.error is not None
    name = "error 0.3 s after 0.1 rad, along a sine in gravity [rad]"
    yield row(name, run.error[-1, 0], wanted, "scipy.linalg.expm", near=1e-4)


LINEARISING: Final = ComputedTorque(kp=100.0, kd=20.0, ki=150.0)


def linearised() -> tuple[dict[str, float], float, float]:
    """Terms of a tick of ComputedTorque; the commanded acceleration and the torque, written out."""
    terms = ticked(LINEARISING, link(), [THETA], [V], STATE).terms
    a = -1.2 + 100.0 * (0.9 - THETA) + 150.0 * (0.9 - THETA) * 1e-3 + 20.0 * (0.5 - V)
    return {name: float(value[0]) for name, value in terms.items()}, a, M * a + float(weight(THETA))


@entry("eq-10.18", "the commanded acceleration")
def eq_10_18() -> Shown:
    """Chosen: Kp = 100, Kd = 20, Ki = 150, first tick of 1 ms."""
    terms, a, _ = linearised()
    got = sum(terms[name] for name in ("feedforward", "P", "I", "D")) / M
    yield row("commanded acceleration [rad/s^2]", got, a, BY_HAND)


@entry("eq-10.19", "feedback linearisation")
def eq_10_19() -> Shown:
    """Numbers of equation 10.18; without friction."""
    terms, _, tau = linearised()
    yield row("torque [N m]", sum(terms.values()), tau, BY_HAND)


@entry("fig-10.11", "block diagram of feedback linearisation")
def fig_10_11() -> Shown:
    """Numbers of equation 10.18; without friction."""
    terms, a, tau = linearised()
    yield row("acceleration fed forward [rad/s^2]", terms["feedforward"] / M, -1.2, "theta-ddot_d")
    yield row("acceleration of the feedback [rad/s^2]", sum(terms[name] for name in "PID") / M, a + 1.2, BY_HAND)
    yield row("all terms together [N m]", sum(terms.values()), tau, BY_HAND)
    yield law_diagram(list(terms), "feedback linearisation: the terms of taut.laws.ComputedTorque")


@entry("fig-10.13", "pseudocode of feedback linearisation")
def fig_10_13() -> Shown:
    """Chosen: recorded angles, a sine as trajectory, Kp = 100, Kd = 20, Ki = 150."""
    angle, dt = angles(200), 0.01
    got = ticks(LINEARISING + FrictionCompensation(at="meas"), angle, link(r=WRONG_R))
    written, eint, qprev = [], 0.0, float(angle[0])
    for k, q in enumerate(angle.tolist()):
        qd, qdotd, qdotdotd = trajectory(W * k * dt)
        qdot = (q - qprev) / dt
        qprev = q
        e, edot = qd - q, qdotd - qdot
        eint = eint + e * dt
        written.append(model_torque(q, qdot, qdotdotd + 100.0 * e + 20.0 * edot + 150.0 * eint))
    yield from line_by_line(got, written)
