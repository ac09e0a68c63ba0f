"""The chapter's link, figure 10.2: its numbers, runs of it, and its differential equation solved by SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from taut.arm.builtin import one_joint
from taut.arm.description import Arm
from taut.base.types import ArrayLike, Float64Array
from taut.book.simulation import simulated
from taut.control.law import Law
from taut.control.sensing.sensing import Sensing
from taut.control.trajectories.joint import Sine
from taut.controller import Controller, compile
from taut.record.run import Run

__all__ = [
    "B",
    "FAST",
    "G",
    "KD",
    "KI",
    "KP",
    "M",
    "MASS",
    "R",
    "SAMPLED",
    "Solved",
    "WRONG_R",
    "controller",
    "link",
    "on_link",
    "solved",
    "task",
    "weight",
]

M, MASS, R, B, G = 0.5, 1.0, 0.1, 0.1, 9.81  # section 10.2.1: [kg m^2], [kg], [m], [N m s/rad], [m/s^2]
KP, KD, KI = 2.205, 2.0, 1.0  # figure 10.6: [N m/rad], [N m s/rad], [N m/(rad s)]
WRONG_R: Final = 0.08  # [m] figure 10.10: what the controller believes
FAST: Final = 10000.0  # [Hz] of runs that stand for continuous time
SAMPLED: Final = 1e-3  # of a number: what a tick of 0.1 ms leaves between a run and continuous time


@cache
def link(*, gravity: bool = True, r: float = R, b: float = B) -> Arm:
    """The link, in a vertical or a horizontal plane."""
    arm = one_joint(M=M, m=MASS, r=r, b=b)
    return arm if gravity else arm.with_gravity([0.0, 0.0, 0.0])


def weight(theta: Any, r: float = R) -> Any:
    """m g r cos(theta) [N m]."""
    return MASS * G * r * np.cos(theta)


def task(number: int) -> Sine:
    """The desired motions of figure 10.10: theta(t) = -+ pi/2 - cos(t), from 0 to pi."""
    sign = {1: -1.0, 2: 1.0}[number]
    return Sine(center=[sign * math.pi / 2.0], amplitude=-1.0, frequency=0.5 / math.pi, phase=math.pi / 2.0)


def controller(law: Law, arm: Arm, *, rate: float = FAST, differenced: bool = False) -> Controller:
    """A law compiled for the link, which measures its velocity or differences positions as figure 10.8 does."""
    return compile(law, arm, rate=rate, sensing=Sensing(velocity="difference") if differenced else None)


def on_link(
    law: Law | Controller,
    *,
    model: Arm | None = None,
    plant: Arm | None = None,
    ref: object,
    duration: float,
    q0: ArrayLike,
    v0: ArrayLike | None = None,
    **options: Any,
) -> Run:
    """A run of a law on the link, or on another arm of one joint, that stands for continuous time.

    Ticks are 0.1 ms long, the velocity is measured, the plant has its friction and is integrated to fourth order.
    """
    real = plant or link()
    options = {"friction": "arm", "integrator": "rk4", **options}
    return simulated(law, model or real, ref, plant=real, rate=FAST, duration=duration, q0=q0, v0=v0, **options)


# -------------------------------------------------------------------- the same by SciPy


@dataclass(frozen=True, kw_only=True)
class Solved:
    """A solution: at each time the angle, its rate, the integral of the error and that of tau^2."""

    t: Float64Array  # [s]
    theta: Float64Array  # [rad]
    v: Float64Array  # [rad/s]
    e: Float64Array  # [rad] desired less actual
    e_int: Float64Array  # [rad s]
    effort: Float64Array  # [(N m)^2 s]


def solved(
    tau: Callable[..., Any],
    desired: Callable[[Any], Any],
    *,
    times: Float64Array,
    q0: float,
    v0: float = 0.0,
    gravity: bool = True,
) -> Solved:
    """M a + m g r cos(theta) + b v = tau(t, theta, v, e_int) by SciPy's DOP853.

    Args:
        tau: The torque of a law, written out by hand.
        desired: The desired angle over time.
        times: (k,) where the solution is wanted [s].
        q0: Angle at the start [rad].
        v0: Its rate [rad/s].
        gravity: Whether there is any.
    """

    def rate(t: float, y: Float64Array) -> list[float]:
        theta, v, e_int, _ = y
        torque = float(tau(t, theta, v, e_int))
        a = (torque - B * v - (weight(theta) if gravity else 0.0)) / M
        return [v, a, float(desired(t)) - theta, torque**2]

    span = (0.0, float(times[-1]))
    got = solve_ivp(rate, span, [q0, v0, 0.0, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12)
    theta, v, e_int, effort = got.y
    return Solved(t=times, theta=theta, v=v, e=desired(times) - theta, e_int=e_int, effort=effort)
