"""Section 10.1: the parts of a robot control system, and how fast its servo needs to be."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.signal import butter, lfilter

import taut
from taut import JointMotion, Sensing
from taut.base.plot_style import COLOURS, SMALL
from taut.book.models import REST, WRONG_R, B, M, controller, link, on_link, rms, ticked, total, weight
from taut.book.page import Shown, arrow, block, canvas, entry, row, rows, words
from taut.laws import PID, ComputedTorque, FrictionCompensation
from taut.sensors import Difference
from taut.trajectories import Sine

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RATES: Final = (100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)  # [Hz]
KP, KD = 400.0, 40.0  # [1/s^2], [1/s]
SIZE, PACE, LONG = 0.8, 4.0, math.pi  # [rad], [rad/s], [s] of the sine that is followed


@entry("fig-10.1", "a robot control system")
def fig_10_1() -> Shown:
    """In the controller stand the terms of taut.laws.ComputedTorque."""
    terms = ticked(ComputedTorque(kp=KP, kd=KD, ki=1.0), link(), [0.1], [0.2], JointMotion(q=[0.3])).terms
    a = KP * 0.2 - KD * 0.2 + 0.2 * 1e-3
    name = "torque of the controller drawn, all terms together [N m]"
    yield row(name, total(terms)[0], M * a + weight(0.1), "equation 10.19, written out")
    figure, ax = canvas(9.6, 4.3, 0.78)
    _whole(ax, 3.2, list(terms))
    _simplified(ax, 1.0)
    yield figure


def _label(ax: Axes, x: float, y: float, text: str) -> None:
    words(ax, (x, y), text, size=SMALL - 1.0)


def _whole(ax: Axes, y: float, terms: list[str]) -> None:
    words(ax, (0.1, 4.15), "(a) a robot control system", ha="left")
    block(ax, 2.35, y, width=2.3, height=1.3, fill="#F4F6F8")
    words(ax, (2.35, y + 0.48), "controller", zorder=3)
    for k, name in enumerate(terms):
        at = (1.8 + 1.1 * (k % 2), y + 0.22 - 0.27 * (k // 2))
        words(ax, at, name, size=SMALL - 1.0, zorder=3, color=COLOURS[0])
    arrow(ax, (0.2, y), (1.2, y))
    _label(ax, 0.68, y + 0.25, "desired\nmotion")
    for k, name in enumerate(("amplifiers", "actuators and\ntransmissions", "arm and\nenvironment")):
        x = 4.75 + 1.9 * k
        block(ax, x, y, name, width=1.35, height=0.8)
        arrow(ax, (3.5 if not k else x - 1.225, y), (x - 0.675, y))
    _label(ax, 3.78, y + 0.25, "low\npower")
    _label(ax, 5.7, y - 0.25, "high\npower")
    _label(ax, 7.6, y + 0.25, "torque")
    arrow(ax, (9.22, y), (9.55, y))
    arrow(ax, (6.65, y + 0.4), (6.65, y + 0.72), (4.75, y + 0.72), (4.75, y + 0.4))
    _label(ax, 5.7, y + 0.84, "local feedback: current, torque")
    block(ax, 5.7, y - 0.9, "sensors", width=1.2, height=0.4)
    arrow(ax, (9.38, y), (9.38, y - 0.9), (6.3, y - 0.9))
    arrow(ax, (5.1, y - 0.9), (2.35, y - 0.9), (2.35, y - 0.65))
    _label(ax, 7.9, y - 0.76, "motions and forces")


def _simplified(ax: Axes, y: float) -> None:
    title = "(b) simplified: ideal sensors, and a controller that directly gives torques"
    words(ax, (0.1, 1.75), title, ha="left")
    block(ax, 2.35, y, "controller", width=2.3, height=0.7)
    block(ax, 7.0, y, "dynamics of arm and environment", width=2.9, height=0.7)
    arrow(ax, (0.2, y), (1.2, y))
    _label(ax, 0.68, y + 0.25, "desired\nmotion")
    arrow(ax, (3.5, y), (5.55, y))
    _label(ax, 4.5, y + 0.15, "forces and torques")
    arrow(ax, (8.45, y), (9.55, y))
    arrow(ax, (9.2, y), (9.2, y - 0.6), (2.35, y - 0.6), (2.35, y - 0.35))
    _label(ax, 5.7, y - 0.48, "motions and forces")


def written(rate: float) -> float:
    """RMS error of the loop tick by tick, with the link integrated by RK4 of four steps a tick."""
    dt, steps = 1.0 / rate, 4
    h = dt / steps
    theta, v, previous, errors = 0.0, SIZE * PACE, 0.0, []

    def acceleration(theta: float, v: float, tau: float) -> float:
        return (tau - B * v - float(weight(theta))) / M

    for k in range(round(LONG * rate) + 1):
        t = k * dt
        q, qdot, a = SIZE * math.sin(PACE * t), SIZE * PACE * math.cos(PACE * t), -SIZE * PACE**2 * math.sin(PACE * t)
        measured = (theta - previous) / dt if k else 0.0
        previous = theta
        errors.append(q - theta)
        tau = M * (a + KP * (q - theta) + KD * (qdot - measured)) + float(weight(theta, WRONG_R)) + B * measured
        for _ in range(steps):
            k1v, k1a = v, acceleration(theta, v, tau)
            k2v, k2a = v + 0.5 * h * k1a, acceleration(theta + 0.5 * h * k1v, v + 0.5 * h * k1a, tau)
            k3v, k3a = v + 0.5 * h * k2a, acceleration(theta + 0.5 * h * k2v, v + 0.5 * h * k2a, tau)
            k4v, k4a = v + h * k3a, acceleration(theta + h * k3v, v + h * k3a, tau)
            theta += h / 6.0 * (k1v + 2.0 * k2v + 2.0 * k3v + k4v)
            v += h / 6.0 * (k1a + 2.0 * k2a + 2.0 * k3a + k4a)
    return rms(np.array(errors))


@entry("sec-10.1", "higher servo rates stop paying")
def sec_10_1() -> Shown:
    """The chapter: higher update rates are of limited benefit. What is left at high rates is the error of the model.

    Chosen: feedback linearisation and FrictionCompensation, Kp = 400, Kd = 40, differenced positions, r = 0.08 m
    in the model, 0.8 rad at 4 rad/s.
    """
    sine = Sine(center=[0.0], amplitude=SIZE, frequency=PACE / (2.0 * math.pi))
    law = ComputedTorque(kp=KP, kd=KD) + FrictionCompensation(at="meas")
    got = []
    for rate in RATES:
        ctrl = controller(law, link(r=WRONG_R), rate=rate, differenced=True)
        run = on_link(ctrl, sine, duration=LONG, v0=SIZE * PACE, substeps=4)
        assert run.error is not None
        got.append(rms(run.error[:, 0]))
    wanted = [written(rate) for rate in RATES]
    source = "the loop tick by tick, the link by RK4"
    yield from rows("RMS error at {:g} Hz [rad]", RATES, got, wanted, source, rel=1e-6)
    for low, high, states in (
        (0, 3, "hundreds to a few thousands of Hz"), (3, 5, "of limited benefit"), (4, 5, "of limited benefit"),
    ):  # fmt: skip
        name = f"error at {RATES[high]:g} Hz over that at {RATES[low]:g} Hz"
        yield row(name, got[high] / got[low], wanted[high] / wanted[low], source, rel=1e-6, states=states)


STEP, PACE_SLOW, CUTOFF, TICKS = 1e-3, 0.05, 20.0, 2000  # [rad] of an encoder, [rad/s], [Hz], of 1 ms


@entry("sec-10.1", "jitter of differenced positions")
def jitter() -> Shown:
    """A joint that turns slowly, seen by a coarse encoder, differenced with and without a low-pass.

    Chosen: 0.05 rad/s, an encoder of 1 mrad, 1 kHz, a low-pass of 20 Hz.
    """
    seen, half = STEP * np.round(PACE_SLOW * 1e-3 * np.arange(TICKS) / STEP), TICKS // 2
    raw = np.diff(seen, prepend=seen[0]) * 1e3
    smooth = lfilter(*butter(1, CUTOFF, fs=1e3), raw)
    for name, velocity, wanted, source, claim in (
        ("differenced", Difference(), raw, "NumPy's diff", "high frequency jitter due to quantization"),
        ("with a low-pass", Difference(cutoff=CUTOFF), smooth, "SciPy's butter and lfilter", "to reduce it"),
    ):
        ctrl = taut.compile(PID(kp=0.0, kd=1.0), link(), rate=1e3, sensing=Sensing(velocity=velocity))
        got = -np.array([ctrl.step([q], ref=REST)[0] for q in seen])
        what = f"RMS of the velocity's jitter, {name} [rad/s]"
        yield row(what, got[half:].std(), wanted[half:].std(), source, rel=1e-6, states=claim)
