"""The arms of the book: runs of them, and the same by SciPy and MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import taut
from taut import Arm, Controller, JointMotion, Law, Loop, RigidPlant, Run, Sensing
from taut.arm.builtin import one_joint
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.reference import Sample

M, MASS, R, B, G = 0.5, 1.0, 0.1, 0.1, 9.81  # section 10.2.1: [kg m^2], [kg], [m], [N m s/rad], [m/s^2]
KP, KD, KI = 2.205, 2.0, 1.0  # figure 10.6: [N m/rad], [N m s/rad], [N m/(rad s)]
WRONG_R: Final = 0.08  # [m] figure 10.10: what the controller believes
FAST: Final = 10000.0  # [Hz] of runs that stand for continuous time
REST: Final = JointMotion(q=[0.0])
SAMPLED: Final = 1e-3  # of a number: what a tick of 0.1 ms leaves between a run and continuous time


@cache
def link(*, gravity: bool = True, r: float = R, b: float = B) -> Arm:
    """The link, in a vertical or a horizontal plane."""
    arm = one_joint(M=M, m=MASS, r=r, b=b)
    return arm if gravity else arm.with_gravity([0.0, 0.0, 0.0])


def weight(theta: Any, r: float = R) -> Any:
    """m g r cos(theta) [N m]."""
    return MASS * G * r * np.cos(theta)


def controller(law: Law, arm: Arm, *, rate: float = FAST, differenced: bool = False) -> Controller:
    """A law compiled for the link, which measures its velocity or differences positions as figure 10.8 does."""
    return taut.compile(law, arm, rate=rate, sensing=Sensing(velocity="difference") if differenced else None)


def looped(
    law: Law | Controller,
    arm: Arm,
    ref: object = None,
    *,
    rate: float = 1000.0,
    plant: Arm | None = None,
    duration: float = 1.0,
    **options: Any,
) -> Loop:
    """A law for an arm on a rigid plant of the same arm or another, without friction by default."""
    ctrl = law if isinstance(law, Controller) else taut.compile(law, arm, rate=rate)
    return Loop(ctrl, RigidPlant(plant or arm, **{"friction": None, **options}), ref, duration=duration)


def simulated(
    law: Law | Controller,
    arm: Arm,
    ref: object = None,
    *,
    duration: float,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    **options: Any,
) -> Run:
    """A run of such a loop, which begins at home and at rest by default."""
    return taut.run(looped(law, arm, ref, duration=duration, **options), q0=q0, v0=v0, progress=False)


def on_link(
    law: Law | Controller,
    ref: object = REST,
    *,
    plant: Arm | None = None,
    model: Arm | None = None,
    duration: float,
    q0: float = 0.0,
    v0: float = 0.0,
    **options: Any,
) -> Run:
    """A run of a law on the link, or on another arm of one joint, that approximates continuous time.

    Ticks are 0.1 ms long, the velocity is measured, the plant has its friction and is integrated to fourth order.
    """
    real = plant or link()
    options = {"friction": "arm", "integrator": "rk4", "rate": FAST, **options}
    return simulated(law, model or real, ref, plant=real, duration=duration, q0=[q0], v0=[v0], **options)


def ticked(law: Law, arm: Arm, q: ArrayLike, v: ArrayLike, ref: Sample, **measured: ArrayLike) -> Controller:
    """A controller after one tick at 1 kHz, on floats, with its `terms` and its `memory`."""
    ctrl = taut.compile(law, arm, rate=1000.0, engine="float")
    ctrl.step(q, v, ref, **measured)
    return ctrl


def total(terms: Mapping[str, Float64Array]) -> Float64Array:
    """(n,) sum of the terms of a law [N m | N]."""
    added: Float64Array = np.sum(list(terms.values()), axis=0)
    return added


@dataclass(frozen=True, kw_only=True)
class Solved:
    """A solution at each time."""

    theta: Float64Array  # [rad]
    v: Float64Array  # [rad/s]
    e: Float64Array  # [rad] desired less actual
    effort: Float64Array  # [(N m)^2 s] integral of tau^2


def solved(
    tau: Callable[..., Any],
    times: Float64Array,  # (k,) [s]
    *,
    desired: Callable[[Any], Any] = np.zeros_like,  # angle over time
    q0: float,  # [rad]
    v0: float = 0.0,  # [rad/s]
    gravity: bool = True,
) -> Solved:
    """M a + m g r cos(theta) + b v = tau(t, theta, v, e_int) by SciPy's DOP853, with tau written out by hand."""

    def rate(t: float, y: Float64Array) -> list[float]:
        theta, v, e_int, _ = y
        torque = float(tau(t, theta, v, e_int))
        a = (torque - B * v - (weight(theta) if gravity else 0.0)) / M
        return [v, a, float(desired(t)) - theta, torque**2]

    span = (0.0, float(times[-1]))
    theta, v, _, effort = solve_ivp(rate, span, [q0, v0, 0.0, 0.0], "DOP853", times, rtol=1e-10, atol=1e-12).y
    return Solved(theta=theta, v=v, e=desired(times) - theta, effort=effort)


def one_pole(t: Float64Array, y: Float64Array) -> float:
    """Decay rate by a straight line through the logarithm [1/s]."""
    return float(np.polyfit(t, np.log(np.abs(y)), 1)[0])


def two_poles(y: Any, dt: float) -> Any:
    """(2,) the poles [1/s] of y[k + 1] = a y[k] + b y[k - 1], by least squares; y (m,) may be complex."""
    a, b = np.linalg.lstsq(np.column_stack([y[1:-1], y[:-2]]), y[2:], rcond=None)[0]
    return np.log(np.roots([1.0, -a, -b]).astype(complex)) / dt


def rms(y: Float64Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(y))))


@cache
def two_links() -> Arm:
    """`planar2` without friction."""
    return taut.load_arm("planar2").with_joints(viscous=0.0)


@cache
def panda() -> Arm:
    """The Panda of the catalogue without friction."""
    return taut.load_arm("panda").with_joints(viscous=0.0, coulomb=0.0)


def held_radius(mass: float, damping: float, K: float, B: float, rate: float) -> float:
    """Largest modulus of the poles of a mass under u = -K x - B v, held over a tick, with v differenced."""
    T = 1.0 / rate
    held = expm(np.array([[0.0, 1.0, 0.0], [0.0, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]]) * T)
    loop = np.zeros((3, 3))  # of x, v and the x before
    loop[:2, :2], loop[2, 0] = held[:2, :2], 1.0
    loop[:2] -= np.outer(held[:2, 2], [K + B / T, 0.0, -B / T])
    return float(np.abs(np.linalg.eigvals(loop)).max())


@dataclass(frozen=True, kw_only=True)
class MujocoState:
    """An arm in MuJoCo at one state; of the tool linear parts first, world axes."""

    M: Float64Array  # (n, n) mass matrix
    h: Float64Array  # (n,) C v + g
    p: Float64Array  # (3,) of the tool
    R: Float64Array  # (3, 3)
    J: Float64Array  # (6, n)
    Jdot_v: Float64Array  # (6,)

    @property
    def Lambda(self) -> Float64Array:
        """(6, 6) inertia at the tool."""
        made: Float64Array = np.linalg.inv(self.J @ np.linalg.solve(self.M, self.J.T))
        return made


@cache
def _mujoco(arm: Arm) -> tuple[Any, Any]:
    """Model and state of an arm in MuJoCo."""
    import mujoco

    model = taut.MujocoPlant(arm).model
    return model, mujoco.MjData(model)


def in_mujoco(q: ArrayLike, v: ArrayLike = 0.0, *, arm: Arm | None = None) -> MujocoState:
    """The Panda or another arm at a state, at rest if no speeds are given."""
    import mujoco

    model, data = _mujoco(arm or panda())
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    M, J, rate = np.zeros((model.nv, model.nv)), np.zeros((6, model.nv)), np.zeros((6, model.nv))
    mujoco.mj_fullM(model, data, M)
    mujoco.mj_jacSite(model, data, J[:3], J[3:], model.nsite - 1)
    mujoco.mj_jacDot(model, data, rate[:3], rate[3:], data.site_xpos[-1], model.site_bodyid[-1])
    return MujocoState(
        M=M, h=np.array(data.qfrc_bias), p=np.array(data.site_xpos[-1]), R=np.array(data.site_xmat[-1]).reshape(3, 3),
        J=J, Jdot_v=rate @ data.qvel,
    )  # fmt: skip


def two(q: ArrayLike, v: ArrayLike = 0.0) -> MujocoState:
    """The two links in MuJoCo at a state, at rest if no speeds are given."""
    return in_mujoco(q, v, arm=two_links())
