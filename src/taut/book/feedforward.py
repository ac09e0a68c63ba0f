"""Sections 10.2.1.2 and 10.2.1.3: feedforward, and feedforward plus feedback linearisation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import expm

from taut.base.plot_style import DASHED, INK, SMALL, colour, prepared
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
    controller,
    link,
    on_link,
    rms,
    solved,
    task,
    ticked,
    total,
    weight,
)  # fmt: skip
from taut.book.page import BY_HAND, ODE, Row, Shown, entry, law_diagram, legend, panels, row
from taut.book.single_joint import WANTED, angles
from taut.control.law import Law
from taut.control.laws.joint import PID, ComputedTorque, FeedForward, FrictionCompensation
from taut.control.trajectories.joint import Sine
from taut.control.trajectories.reference import JointMotion
from taut.maths.snapshot import snapshot
from taut.record.run import Run

__all__: list[str] = []

LINE_BY_LINE: Final = "the pseudocode, line by line"
STATE: Final = JointMotion(q=[0.9], v=[0.5], a=[-1.2])  # desired, chosen
THETA, V = 0.7, 1.3  # [rad], [rad/s] actual, chosen
FRICTION: Final = "The chapter's h has friction, so that FrictionCompensation stands beside the law."


def model_torque(theta: float, v: float, a: float, r: float = WRONG_R) -> float:
    """M a + m g r cos(theta) + b v with the model of figure 10.10 [N m]."""
    return M * a + float(weight(theta, r)) + B * v


@entry("eq-10.15", "the controller's model")
def eq_10_15() -> Shown:
    x = snapshot(link(r=WRONG_R), [THETA], [V])
    h = x.h[0] + float(x.viscous[0]) * V
    yield row("the model's M", "kg m^2", x.M[0, 0], M, "section 10.2.1")
    yield row("the model's h, with r = 0.08 m", "N m", h, model_torque(THETA, V, 0.0), BY_HAND)
    yield "The model of figure 10.10 at theta = 0.7 rad, theta-dot = 1.3 rad/s."


@entry("eq-10.16", "feedforward control")
def eq_10_16() -> Shown:
    law = FeedForward() + FrictionCompensation(at="ref")
    ctrl = ticked(law, link(r=WRONG_R), [THETA], [V], STATE)
    tau = total(ctrl.terms)[0]
    wanted = model_torque(0.9, 0.5, -1.2)
    yield row("torque at theta_d = 0.9, 0.5, -1.2", "N m", tau, wanted, BY_HAND)
    yield FRICTION


@entry("fig-10.9", "pseudocode of feedforward control")
def fig_10_9() -> Shown:
    ctrl = controller(FeedForward() + FrictionCompensation(at="ref"), link(r=WRONG_R), rate=100.0, differenced=True)
    got = [ctrl.step([q], ref=WANTED.at(k / 100.0))[0] for k, q in enumerate(angles(100, 0.01))]
    written = []
    w = 0.8 * math.pi
    for k in range(100):
        qd, qdotd = 0.2 + 0.5 * math.sin(w * 0.01 * k), 0.5 * w * math.cos(w * 0.01 * k)
        written.append(model_torque(qd, qdotd, -0.5 * w * w * math.sin(w * 0.01 * k)))
    worst = int(np.argmax(np.abs(np.subtract(got, written))))
    yield row("last torque of 100 ticks at 100 Hz", "N m", got[-1], written[-1], LINE_BY_LINE, rel=1e-11)
    yield row("the torque that differs most", "N m", got[worst], written[worst], LINE_BY_LINE)
    yield "Chosen: a sine as trajectory."


# -------------------------------------------------------------------- figures 10.10 and 10.12


def desired(number: int, t: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Angle, rate and acceleration of a task of figure 10.10."""
    centre = {1: -0.5, 2: 0.5}[number] * math.pi
    return centre - np.cos(t), np.sin(t), np.cos(t)


def fed_forward(number: int, plant_model: float = WRONG_R) -> tuple[Run, Solved]:
    """A task by feedforward alone, as a run and by SciPy."""
    law = FeedForward() + FrictionCompensation(at="ref")
    start = float(desired(number, np.zeros(1))[0][0])
    run = on_link(law, model=link(r=plant_model), plant=link(), ref=task(number), duration=math.pi, q0=[start])

    def tau(t: float, *_: float) -> float:
        q, v, a = (float(each) for each in desired(number, np.asarray(t)))
        return model_torque(q, v, a, plant_model)

    return run, solved(tau, lambda t: desired(number, t)[0], times=run.t, q0=start)


def of_run(name: str, run: Run, written: Solved, states: str = "") -> list[Row]:
    """Errors and effort of a run beside those by SciPy."""
    assert run.error is not None
    e = run.error[:, 0]
    return [
        row(f"{name}: RMS error", "rad", rms(e), rms(written.e), ODE, rel=SAMPLED, states=states),
        row(f"{name}: largest error", "rad", np.abs(e).max(), np.abs(written.e).max(), ODE, rel=SAMPLED),
        row(f"{name}: integral of tau^2", "(N m)^2 s", run.metrics.effort[0], written.effort[-1], ODE, rel=2e-3),
    ]


@entry("fig-10.10", "feedforward control with a wrong model")
def fig_10_10() -> Shown:
    figure, axes = panels(2, 2.6)
    peaks, written_peaks = [], []
    for k, ax in enumerate(axes):
        number = k + 1
        run, written = fed_forward(number)
        yield from of_run(f"Task {number}", run, written)
        peaks.append(np.abs(run.q[:, 0] - desired(number, run.t)[0]).max())
        written_peaks.append(np.abs(written.e).max())
        prepared(ax, f"Task {number}", "angle [rad]", "t [s]")
        ax.plot(run.t, desired(number, run.t)[0], color=INK, linewidth=0.9, linestyle=DASHED, label="desired")
        ax.plot(run.t, run.q[:, 0], color=colour(k), linewidth=1.5, label="actual")
        legend(ax)
    yield row(
        "largest error of Task 2 over that of Task 1",
        "",
        peaks[1] / peaks[0],
        written_peaks[1] / written_peaks[0],
        ODE,
        rel=2e-3,
        states="small in Task 1, larger in Task 2",
    )
    exact = fed_forward(2, 0.1)[0]
    assert exact.error is not None
    yield row(
        "Task 2 with r = 0.1 m: largest error",
        "rad",
        np.abs(exact.error).max(),
        0.0,
        "the chapter: follows exactly",
        near=1e-3,
    )
    yield figure
    yield f"Numbers of the chapter. {FRICTION}"


@dataclass(frozen=True, kw_only=True)
class Controlled:
    """One of the controllers of figure 10.12, and its torque written out."""

    law: Law
    tau: Callable[..., float]


def controllers() -> dict[str, Controlled]:
    """Those of figure 10.12; the gains of figure 10.6 in both readings."""

    def wanted(t: float) -> tuple[float, float, float]:
        q, v, a = desired(2, np.asarray(t))
        return float(q), float(v), float(a)

    def alone(t: float, *_: float) -> float:
        return model_torque(*wanted(t))

    def feedback(t: float, theta: float, v: float, e_int: float) -> float:
        q, qdot, _ = wanted(t)
        return KP * (q - theta) + KI * e_int + KD * (qdot - v)

    def linearising(share: float) -> Callable[..., float]:
        def tau(t: float, theta: float, v: float, e_int: float) -> float:
            q, qdot, a = wanted(t)
            asked = a + share * (KP * (q - theta) + KI * e_int + KD * (qdot - v))
            return model_torque(theta, v, asked)

        return tau

    def both(share: float) -> Law:
        return ComputedTorque(kp=share * KP, kd=share * KD, ki=share * KI) + FrictionCompensation(at="meas")

    return {
        "ff": Controlled(law=FeedForward() + FrictionCompensation(at="ref"), tau=alone),
        "fb": Controlled(law=PID(kp=KP, kd=KD, ki=KI), tau=feedback),
        "ff+fb, gains as accelerations": Controlled(law=both(1.0), tau=linearising(1.0)),
        "ff+fb, gains as torques": Controlled(law=both(1.0 / M), tau=linearising(1.0 / M)),
    }


@entry("fig-10.12", "feedforward, feedback, and both")
def fig_10_12() -> Shown:
    start = float(desired(2, np.zeros(1))[0][0])
    figure, axes = panels(3, 2.9, width_ratios=[1.0, 1.0, 0.8])
    prepared(axes[0], "Task 2", "angle [rad]", "t [s]")
    prepared(axes[1], "tracking error", "error [rad]", "t [s]")
    prepared(axes[2], "effort", "integral of tau^2 [(N m)^2 s]", "")
    runs: dict[str, tuple[Run, Solved]] = {}
    for k, (name, each) in enumerate(controllers().items()):
        run = on_link(each.law, model=link(r=WRONG_R), plant=link(), ref=task(2), duration=math.pi, q0=[start])
        written = solved(each.tau, lambda t: desired(2, t)[0], times=run.t, q0=start)
        runs[name] = run, written
        yield from of_run(name, run, written, "slip: gains are taken from figure 10.6" if "gains" in name else "")
        assert run.error is not None
        axes[0].plot(run.t, run.q[:, 0], color=colour(k), linewidth=1.3)
        axes[1].plot(run.t, run.error[:, 0], color=colour(k), linewidth=1.3, label=name)
        axes[2].bar(k, run.metrics.effort[0], color=colour(k))
    axes[0].plot(run.t, desired(2, run.t)[0], color=INK, linewidth=0.9, linestyle=DASHED, label="desired")
    axes[2].set_xticks([])
    names, wanted_too = (axes[k].get_legend_handles_labels() for k in (1, 0))
    figure.legend(
        names[0] + wanted_too[0], names[1] + wanted_too[1], loc="outside upper left", ncols=5, fontsize=SMALL,
        frameon=False, labelcolor=INK, columnspacing=1.2, handlelength=1.6,
    )  # fmt: skip
    error = {name: (rms(run.q[:, 0] - desired(2, run.t)[0]), rms(written.e)) for name, (run, written) in runs.items()}
    effort = {name: (run.metrics.effort[0], written.effort[-1]) for name, (run, written) in runs.items()}
    for name in list(runs)[2:]:
        for measure, of, other, claim in (
            ("RMS error", error, "ff", "below 1"),
            ("RMS error", error, "fb", "below 1"),
            ("effort", effort, "fb", "below 1"),
        ):
            got, wanted = (of[name][k] / of[other][k] for k in (0, 1))
            yield row(f"{name}: {measure} over that of {other}", "", got, wanted, ODE, rel=3e-3, states=claim)

    yield figure
    yield (
        "Gains of figure 10.6 are torques, and those of 10.19 accelerations: both readings are here, the second with "
        "the gains over M. Both confirm the chapter: better tracking than either alone, less effort than feedback "
        "alone. " + FRICTION
    )


# -------------------------------------------------------------------- feedback linearisation


@entry("eq-10.17", "error dynamics along any trajectory")
def eq_10_17() -> Shown:
    kp, kd, ki, at = 100.0, 20.0, 150.0, 0.3
    law = ComputedTorque(kp=kp, kd=kd, ki=ki) + FrictionCompensation(at="meas")
    sine = Sine(center=[0.3], amplitude=0.8, frequency=0.7)
    first = sine.at(0.0)
    run = on_link(law, ref=sine, duration=at, q0=first.q - 0.1, v0=first.v)
    A = np.array([[0.0, 1.0, 0.0], [-kp, -kd, -ki], [1.0, 0.0, 0.0]])
    wanted = (expm(A * at) @ np.array([0.1, 0.0, 0.0]))[0]
    assert run.error is not None
    yield row(
        "error 0.3 s after 0.1 rad, along a sine in gravity",
        "rad",
        run.error[-1, 0],
        wanted,
        "scipy.linalg.expm",
        near=1e-4,
    )
    yield f"Chosen: Kp = 100, Kd = 20, Ki = 150, 0.8 rad at 0.7 Hz. {FRICTION}"


def linearised() -> tuple[dict[str, Float64Array], float, float]:
    """Terms of a tick of ComputedTorque; the commanded acceleration and the torque, written out."""
    law = ComputedTorque(kp=100.0, kd=20.0, ki=150.0)
    ctrl = ticked(law, link(), [THETA], [V], STATE)
    a = -1.2 + 100.0 * (0.9 - THETA) + 150.0 * (0.9 - THETA) * 1e-3 + 20.0 * (0.5 - V)
    return dict(ctrl.terms), a, M * a + float(weight(THETA))


@entry("eq-10.18", "the commanded acceleration")
def eq_10_18() -> Shown:
    terms, a, _ = linearised()
    got = sum(terms[name][0] for name in ("feedforward", "P", "I", "D")) / M
    yield row("commanded acceleration", "rad/s^2", got, a, BY_HAND)
    yield "Chosen: Kp = 100, Kd = 20, Ki = 150, first tick of 1 ms."


@entry("eq-10.19", "feedback linearisation")
def eq_10_19() -> Shown:
    terms, _, tau = linearised()
    yield row("torque", "N m", total(terms)[0], tau, BY_HAND)
    yield "Numbers of equation 10.18; without friction."


@entry("fig-10.11", "block diagram of feedback linearisation")
def fig_10_11() -> Shown:
    terms, a, tau = linearised()
    yield row("acceleration fed forward", "rad/s^2", terms["feedforward"][0] / M, -1.2, "theta-ddot_d")
    yield row("acceleration of the feedback", "rad/s^2", sum(terms[name][0] for name in "PID") / M, a + 1.2, BY_HAND)
    yield row("all terms together", "N m", total(terms)[0], tau, BY_HAND)
    figure = law_diagram(list(terms), "feedback linearisation: the terms of taut.laws.ComputedTorque", inertia=True)
    yield figure
    yield "Numbers of equation 10.18; without friction."


@entry("fig-10.13", "pseudocode of feedback linearisation")
def fig_10_13() -> Shown:
    rate, angle = 100.0, angles(200, 0.01)
    law = ComputedTorque(kp=100.0, kd=20.0, ki=150.0) + FrictionCompensation(at="meas")
    ctrl = controller(law, link(r=WRONG_R), rate=rate, differenced=True)
    got = [ctrl.step([q], ref=WANTED.at(k / rate))[0] for k, q in enumerate(angle)]
    written, eint, qprev, w, dt = [], 0.0, float(angle[0]), 0.8 * math.pi, 1.0 / rate
    for k, q in enumerate(angle.tolist()):
        s, c = math.sin(w * k * dt), math.cos(w * k * dt)
        qd, qdotd, qdotdotd = 0.2 + 0.5 * s, 0.5 * w * c, -0.5 * w * w * s
        qdot = (q - qprev) / dt
        qprev = q
        e, edot = qd - q, qdotd - qdot
        eint = eint + e * dt
        written.append(model_torque(q, qdot, qdotdotd + 100.0 * e + 20.0 * edot + 150.0 * eint))
    worst = int(np.argmax(np.abs(np.subtract(got, written))))
    yield row("last torque of 200 ticks at 100 Hz", "N m", got[-1], written[-1], LINE_BY_LINE, rel=1e-10)
    yield row("the torque that differs most", "N m", got[worst], written[worst], LINE_BY_LINE, rel=1e-8)
    yield "Chosen: recorded angles, a sine as trajectory, Kp = 100, Kd = 20, Ki = 150."
