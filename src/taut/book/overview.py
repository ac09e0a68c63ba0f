"""Section 10.1: the parts of a robot control system, and how fast its servo needs to be."""

from __future__ import annotations

import math
import textwrap
from typing import Final

import numpy as np
from scipy.signal import butter, lfilter

import taut
from taut import JointMotion, Sensing
from taut.book.models import REST, WRONG_R, B, M, controller, link, on_link, rms, ticked, total, weight
from taut.book.page import STRAIGHT, Shown, diagram, entry, panels, row, rows, words
from taut.laws import PID, ComputedTorque, FrictionCompensation
from taut.sensors import Difference
from taut.trajectories import Sine

RATES: Final = (100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)  # [Hz]
KP, KD = 400.0, 40.0  # [1/s^2], [1/s]
SIZE, PACE, LONG = 0.8, 4.0, math.pi  # [rad], [rad/s], [s] of the sine that is followed


@entry("fig-10.1", "a robot control system")
def fig_10_1() -> Shown:
    """The controller lists the terms of taut.laws.ComputedTorque."""
    terms = ticked(ComputedTorque(kp=KP, kd=KD, ki=1.0), link(), [0.1], [0.2], JointMotion(q=[0.3])).terms
    a = KP * 0.2 - KD * 0.2 + 0.2 * 1e-3
    name = "torque of the controller drawn, all terms together [N m]"
    yield row(name, total(terms)[0], M * a + weight(0.1), "equation 10.19, written out")
    figure, (ax,) = panels(None, height=3.4)
    words(ax, (0.0, 2.9), "(a) a robot control system", ha="left")
    words(ax, (0.0, -0.5), "(b) simplified: ideal sensors, and a controller that directly gives torques", ha="left")
    nodes = {
        "desired": (0.0, 1.5, 0.0, ""),
        "controller": (2.2, 1.5, 2.0, "controller:\n" + textwrap.fill(", ".join(terms), 24)),
        "amplifiers": (4.9, 1.5, 1.3, "amplifiers"),
        "actuators": (7.1, 1.5, 1.5, "actuators and\ntransmissions"),
        "arm": (9.4, 1.5, 1.5, "arm and\nenvironment"),
        "sensors": (5.8, 0.2, 1.3, "sensors"),
        "given": (0.0, -1.3, 0.0, ""),
        "simple": (2.2, -1.3, 2.0, "controller"),
        "dynamics": (8.3, -1.3, 3.6, "dynamics of arm and environment"),
    }
    edges = [
        ("desired", "controller", "desired\nmotion", STRAIGHT),
        ("controller", "amplifiers", "low\npower", STRAIGHT),
        ("amplifiers", "actuators", "high\npower", STRAIGHT),
        ("actuators", "amplifiers", "", "bar,fraction=0.4"),
        ("actuators", "arm", "torque", STRAIGHT),
        ("arm", "sensors", "", "angle,angleA=90,angleB=0"),
        ("sensors", "controller", "", "angle,angleA=0,angleB=90"),
        ("given", "simple", "desired\nmotion", STRAIGHT),
        ("simple", "dynamics", "forces and torques", STRAIGHT),
        ("dynamics", "simple", "", "bar,fraction=-0.12"),
    ]
    diagram(ax, nodes, edges)
    ax.set_ylim(-2.4, 3.1)
    words(ax, (7.9, 0.35), "motions and forces")
    words(ax, (5.7, -2.15), "motions and forces")
    words(ax, (6.0, 2.65), "local feedback: current, torque")
    yield figure


def written(rate: float) -> float:
    """RMS error of the loop tick by tick, with the link integrated by RK4."""
    h = 1.0 / rate
    theta, v, previous, errors = 0.0, SIZE * PACE, 0.0, []

    def acceleration(theta: float, v: float, tau: float) -> float:
        return (tau - B * v - float(weight(theta))) / M

    for k in range(round(LONG * rate) + 1):
        t = k * h
        q, qdot, a = SIZE * math.sin(PACE * t), SIZE * PACE * math.cos(PACE * t), -SIZE * PACE**2 * math.sin(PACE * t)
        measured = (theta - previous) / h if k else 0.0
        previous = theta
        errors.append(q - theta)
        tau = M * (a + KP * (q - theta) + KD * (qdot - measured)) + float(weight(theta, WRONG_R)) + B * measured
        k1v, k1a = v, acceleration(theta, v, tau)
        k2v, k2a = v + 0.5 * h * k1a, acceleration(theta + 0.5 * h * k1v, v + 0.5 * h * k1a, tau)
        k3v, k3a = v + 0.5 * h * k2a, acceleration(theta + 0.5 * h * k2v, v + 0.5 * h * k2a, tau)
        k4v, k4a = v + h * k3a, acceleration(theta + h * k3v, v + h * k3a, tau)
        theta += h / 6.0 * (k1v + 2.0 * k2v + 2.0 * k3v + k4v)
        v += h / 6.0 * (k1a + 2.0 * k2a + 2.0 * k3a + k4a)
    return rms(np.array(errors))


@entry("sec-10.1", "higher servo rates stop paying")
def sec_10_1() -> Shown:
    """The chapter: higher update rates are of limited benefit. At high rates the error of the model remains.

    Chosen: feedback linearisation and FrictionCompensation, Kp = 400, Kd = 40, differenced positions, r = 0.08 m
    in the model, 0.8 rad at 4 rad/s.
    """
    sine = Sine(center=[0.0], amplitude=SIZE, frequency=PACE / (2.0 * math.pi))
    law = ComputedTorque(kp=KP, kd=KD) + FrictionCompensation(at="meas")
    got = []
    for rate in RATES:
        ctrl = controller(law, link(r=WRONG_R), rate=rate, differenced=True)
        run = on_link(ctrl, sine, duration=LONG, v0=SIZE * PACE)
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
    """A joint that rotates slowly, measured by a coarse encoder, differenced with and without a low-pass filter.

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
