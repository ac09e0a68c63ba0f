"""Section 10.2.2: several joints, decentralised and centralised control, and why PD with gravity converges."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

import taut
from taut import JointMotion, Run, snapshot
from taut.analysis import Lyapunov, coupling, lyapunov
from taut.base.types import Float64Array
from taut.book.models import FAST, in_mujoco, looped, panda, simulated, ticked, total, two, two_links
from taut.book.page import MUJOCO, Row, Shown, compared, entry, row, rows
from taut.laws import PID, ComputedTorque, FrictionCompensation, GravityPID
from taut.trajectories import Sine

Q: Final = np.array([0.3, -0.5, 0.4, -1.9, 0.2, 1.6, 0.7])  # [rad] of the Panda, chosen
V: Final = np.array([0.5, -0.3, 0.4, 0.2, -0.6, 0.7, -0.4])  # [rad/s]
A: Final = np.array([1.0, 0.5, -0.7, 0.9, -0.4, 0.3, 1.1])  # [rad/s^2]
B: Final = np.array([0.5, 0.5, 0.4, 0.4, 0.2, 0.2, 0.1])  # [N m s/rad]
REF: Final = JointMotion(q=Q + 0.05, v=V - 0.1, a=A)
BENT, MOVING = np.array([0.3, 0.8]), np.array([1.0, -0.7])  # [rad], [rad/s] of two links, chosen
TORQUE: Final = "torque of the Panda [N m]"


@entry("eq-10.20", "dynamics of several joints")
def eq_10_20() -> Shown:
    """Chosen: states, accelerations, and viscous friction of the Panda's joints."""
    arm = panda().with_joints(viscous=B)
    friction = ticked(FrictionCompensation(at="meas"), arm, Q, V, REF).terms["friction"]
    tau, m = snapshot(arm, Q, V).inverse_dynamics(A) + friction, in_mujoco(Q, V)
    yield from compared(TORQUE, tau, m.M @ A + m.h + B * V, MUJOCO)
    x, rest = snapshot(two_links(), BENT, MOVING), two(BENT)
    yield from compared("C v of two links [N m]", np.asarray(x.Cv), two(BENT, MOVING).h - rest.h, MUJOCO)
    yield from compared("g of two links [N m]", np.asarray(x.g), rest.h, MUJOCO)


@entry("eq-10.21", "computed torque")
def eq_10_21() -> Shown:
    """Chosen: kp = 100, kd = 20, ki = 50."""
    got = total(ticked(ComputedTorque(kp=100.0, kd=20.0, ki=50.0), panda(), Q, V, REF).terms)
    m, e = in_mujoco(Q, V), REF.q - Q
    wanted = m.M @ (A + 100.0 * e + 50.0 * e * 1e-3 + 20.0 * (REF.v - V)) + m.h
    yield from compared(TORQUE, got, wanted, MUJOCO)


@entry("eq-10.22", "PID with gravity compensation")
def eq_10_22() -> Shown:
    """Chosen: kp = 80, kd = 12, ki = 30."""
    got, e = total(ticked(GravityPID(kp=80.0, kd=12.0, ki=30.0), panda(), Q, V, REF).terms), REF.q - Q
    wanted = 80.0 * e + 30.0 * e * 1e-3 + 12.0 * (REF.v - V) + in_mujoco(Q).h
    yield from compared(TORQUE, got, wanted, MUJOCO)


KP, KD = np.array([40.0, 20.0]), np.array([3.0, 1.0])  # [N m/rad], [N m s/rad] of two links, chosen
START, GOAL = np.array([1.2, -0.9]), np.array([-0.4, 0.8])  # [rad]
LYAPUNOV_DURATION: Final = 8.0  # [s]
FAST_RATE: Final = 20000.0  # [Hz]
EARLY, LATER = round(0.15 * FAST_RATE), round(0.4 * FAST_RATE)  # ticks at 0.15 and 0.4 s
SOLVED: Final = "SciPy's DOP853 of 10.23, with MuJoCo's M and h"


@cache
def falling() -> tuple[Run, Lyapunov]:
    """A run of two links under PD control with gravity compensation; V along that run and its rate."""
    law, goal = GravityPID(kp=KP, kd=KD), JointMotion(q=GOAL)
    run = simulated(law, two_links(), goal, rate=FAST_RATE, duration=LYAPUNOV_DURATION, q0=START, integrator="rk4")
    return run, lyapunov(run)


def accelerated(q: Float64Array, v: Float64Array) -> Float64Array:
    """(2,) acceleration under PD control with gravity compensation, by MuJoCo [rad/s^2]."""
    m = two(q, v)
    return np.asarray(np.linalg.solve(m.M, KP * (GOAL - q) - KD * v + two(q).h - m.h), dtype=np.float64)


@cache
def written() -> tuple[Float64Array, Float64Array]:
    """(k,) times, each 10 ms, and (5, k) q, v and the integral of v . Kd v, by SciPy."""
    times = np.linspace(0.0, LYAPUNOV_DURATION, 801)

    def rate(_: float, y: Float64Array) -> Float64Array:
        q, v = y[:2], y[2:4]
        return np.array([*v, *accelerated(q, v), v @ (KD * v)])

    got = solve_ivp(rate, (0.0, LYAPUNOV_DURATION), [*START, 0.0, 0.0, 0.0], "DOP853", times, rtol=1e-9, atol=1e-11)
    return times, got.y


def energy(q: Float64Array, v: Float64Array) -> float:
    """V of equation 10.24, written out [J]."""
    e = GOAL - q
    return float(0.5 * e @ (KP * e) + 0.5 * v @ two(q).M @ v)


def M_rate(q: Float64Array, v: Float64Array) -> Float64Array:
    """(2, 2) M-dot by central differences of MuJoCo's M."""
    step = 1e-6 * v
    return (two(q + step).M - two(q - step).M) / 2e-6


@entry("eq-10.23", "its closed loop")
def eq_10_23() -> Shown:
    """Two links, from (1.2, -0.9) to (-0.4, 0.8) rad with kp = (40, 20), kd = (3, 1), without friction."""
    got, wanted = falling()[0].q[LATER], written()[1][:2, 40]
    yield from rows("joint {} after 0.4 s [rad]", (1, 2), got, wanted, SOLVED, rel=0.0, near=2e-4)


@entry("eq-10.24", "the error energy")
def eq_10_24() -> Shown:
    """By taut.analysis.lyapunov. The run of equation 10.23."""
    run, found = falling()
    wanted = energy(run.q[EARLY], run.v[EARLY])
    yield row("error energy V of two links, after 0.15 s [J]", found.V[EARLY], wanted, "10.24 with MuJoCo's M")


@entry("eq-10.25", "the error energy of a set-point")
def eq_10_25() -> Shown:
    """Numbers of equation 10.23."""
    y, V, e = written()[1], falling()[1].V, GOAL - START
    yield row("V at the start [J]", V[0], 0.5 * (e @ (KP * e)), "theta_e . Kp theta_e / 2")
    yield row("V after 0.4 s [J]", V[LATER], energy(y[:2, 40], y[2:4, 40]), SOLVED, rel=0.0, near=5e-3)


@entry("eq-10.26", "its rate")
def eq_10_26() -> Shown:
    """Numbers of equation 10.23."""
    run, found = falling()
    q, v, V = run.q[EARLY], run.v[EARLY], found.V
    wanted = -v @ (KP * (GOAL - q)) + v @ two(q).M @ accelerated(q, v) + 0.5 * v @ M_rate(q, v) @ v
    source, differences = "10.26 with MuJoCo's M and h", 0.5 * FAST_RATE * (V[EARLY + 1] - V[EARLY - 1])
    yield row("rate of V at 0.15 s [W]", found.rate[EARLY], wanted, source)
    yield row("the same by differences of V [W]", differences, wanted, source, rel=2e-3)


@entry("eq-10.27", "it only falls")
def eq_10_27() -> Shown:
    """Where theta-dot = 0 off the goal, the spring ensures that theta-ddot is not zero.

    So theta-dot becomes nonzero; the chapter writes that theta-dot is not zero. Numbers of equation 10.23.
    """
    (run, found), y = falling(), written()[1]
    V, v = found.V, run.v[EARLY]
    skew = M_rate(BENT, MOVING) - 2.0 * np.asarray(snapshot(two_links(), BENT, MOVING).C)
    moved = simulated(GravityPID(kp=KP, kd=KD), two_links(), JointMotion(q=GOAL), duration=0.001, q0=START)
    a, wanted = moved.v[1] * moved.rate, accelerated(START, np.zeros(2))
    lost, dissipated = V[0] - V[LATER], "integral of v . Kd v by SciPy"
    yield row("rate of V at 0.15 s [W]", found.rate[EARLY], -v @ (KD * v), "-v . Kd v", rel=1e-6)
    yield row("both at their worst, apart, over the largest rate", found.worst, 0.0, "-v . Kd v", near=1e-6)
    yield row("V lost in 0.4 s [J]", lost, y[4, 40], dissipated, rel=1e-3)
    yield row("ticks after which V is larger", int((np.diff(V) > 1e-9).sum()), 0, "the chapter: decreasing")
    name, source = "largest entry of M-dot - 2 C, less its skew part", "skew-symmetric, with MuJoCo's M-dot"
    yield row(name, np.abs(skew + skew.T).max(), 0.0, source, near=1e-8)
    name, source = "where theta-dot = 0: acceleration of joint 1 [rad/s^2]", "M^-1 Kp theta_e, with MuJoCo's M"
    yield row(name, a[0], wanted[0], source, states="slip: ensures theta-dot != 0")
    name = "error in the end [rad]"
    yield row(name, np.abs(run.q[-1] - GOAL).max(), 0.0, "the chapter: converges", near=1e-3)


def crosstalk(M: Float64Array, kp: Float64Array, kd: Float64Array) -> float:
    """The largest response, over all frequencies, of one of two joints under PD control to the goal of the other."""
    P, D, worst = np.diag(kp), np.diag(kd), 0.0
    for s in 1j * np.geomspace(1.0, 500.0, 2000):
        worst = max(worst, np.abs((np.linalg.solve(M * s * s + D * s + P, P))[[0, 1], [1, 0]]).max())
    return worst


@entry("sec-10.2.2.1", "decentralised control")
def sec_10_2_2_1() -> Shown:
    """A gantry is three single joints, to rounding; gears make the mass matrix nearly diagonal and nearly constant.

    By taut.analysis.coupling, for joints that PD control makes equally fast, without gravity. Chosen: PID with kp =
    400, kd = 60, ki = 100; rotors of 1e-3 kg m^2.
    """
    gantry, goal = taut.load_arm("gantry3").with_joints(viscous=0.0), np.array([0.2, -0.1, 0.15])
    law = PID(kp=400.0, kd=60.0, ki=100.0)
    whole = simulated(law, gantry, JointMotion(q=goal), duration=1.0, q0=np.zeros(3)).q.T
    for name, one, end in zip(gantry.joint_names, whole, goal, strict=True):
        alone = simulated(law, gantry.subset([name]), JointMotion(q=[end]), duration=1.0, q0=[0.0]).q[:, 0]
        apart = np.abs(one - alone)
        worst = int(np.argmax(apart)) if apart.any() else -1
        what, states = f"axis {name} of the gantry, where it differs most", "equivalent to three single joints"
        what = f"{what} from a single joint [m]"
        yield row(what, one[worst], alone[worst], "the joint alone", rel=0.0, near=1e-12, states=states)
    for G, near_diagonal, small in ((1.0, "", ""), (100.0, "nearly diagonal", "small")):
        arm, rotors = two_links().with_gears(G, 1e-3), G**2 * 1e-3 * np.eye(2)
        M, wanted = np.asarray(snapshot(arm, BENT).M), two(BENT).M + rotors
        kp, kd = 400.0 * np.diag(M), 40.0 * np.diag(M)
        level = arm.with_gravity([0.0, 0.0, 0.0])
        found = coupling(looped(PID(kp=kp, kd=kd), level, JointMotion(q=BENT), rate=FAST_RATE), at=BENT)
        apart = abs(wanted[0, 1]) / math.sqrt(wanted[0, 0] * wanted[1, 1])
        name = f"coupling |M12| / sqrt(M11 M22) of two links, G = {G:g}"
        yield row(name, found.inertia, apart, MUJOCO, states=near_diagonal)
        name = f"what a joint follows of the goal of another, at most, G = {G:g}"
        follows, source = crosstalk(wanted, kp, kd), "(M s^2 + Kd s + Kp)^-1 Kp"
        yield row(name, found.worst[0], follows, source, rel=5e-3, states=near_diagonal)
        stretched = np.array([0.3, 0.0])
        got = snapshot(arm, stretched).M[0, 0] / M[0, 0] - 1.0
        change = (two(stretched).M + rotors)[0, 0] / wanted[0, 0] - 1.0
        yield row(f"M11 stretched over bent, less 1, G = {G:g}", got, change, MUJOCO, states=small)
    pd, computed = PID(kp=KP * 10.0, kd=KD * 10.0), ComputedTorque(kp=100.0, kd=20.0)
    yield followed(
        "decentralised PD", pd, lambda e, e_dot, *_: 10.0 * (KP * e + KD * e_dot),
        "SciPy's DOP853 with MuJoCo's M and h",
        rel=2e-3, states="no longer acceptable where gravity is coupled",
    )  # fmt: skip
    yield followed(
        "computed torque", computed,
        lambda e, e_dot, m, a: m.M @ (a + 100.0 * e + 20.0 * e_dot) + m.h,
        "10.17: none with an exact model", rel=0.0, near=1e-3,
    )  # fmt: skip


SINE: Final = Sine(center=GOAL, amplitude=0.5, frequency=0.5)


def followed(name: str, law: PID | ComputedTorque, torque: Callable[..., Any], source: str, **options: Any) -> Row:
    """The largest error along a sine, beside SciPy's with the torque written out."""
    first = SINE.at(0.0)
    out = simulated(law, two_links(), SINE, rate=FAST, duration=2.0, q0=first.q, v0=first.v, integrator="rk4")

    def rate(t: float, y: Float64Array) -> Float64Array:
        q, v, ref = y[:2], y[2:], SINE.at(t)
        m = two(q, v)
        return np.array([*v, *np.linalg.solve(m.M, torque(ref.q - q, ref.v - v, m, ref.a) - m.h)])

    times = np.linspace(0.0, 2.0, 401)
    got = solve_ivp(rate, (0.0, 2.0), [*first.q, *first.v], "DOP853", times, rtol=1e-7, atol=1e-9)
    wanted = np.abs(SINE.rows(times).q - got.y[:2].T).max()
    assert out.error is not None
    name = f"{name}: largest error along a sine in gravity [rad]"
    return row(name, np.abs(out.error[::50]).max(), wanted if wanted > 1e-6 else 0.0, source, **options)
