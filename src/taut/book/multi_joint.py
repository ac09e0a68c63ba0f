"""Section 10.2.2: several joints, decentralised and centralised control, and why PD with gravity converges."""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
from scipy.integrate import solve_ivp

from taut.analysis.joint_coupling import coupling
from taut.analysis.lyapunov_function import Lyapunov, lyapunov
from taut.arm.load import load_arm
from taut.base.plot_style import DASHED, INK, colour, prepared
from taut.base.types import Float64Array
from taut.book.models import TWO_LINKS, engine, looped, panda, simulated, ticked, total, two_links
from taut.book.page import MUJOCO, TWO_BY_HAND, Row, Shown, compared, entry, legend, panels, row
from taut.control.laws.joint import PID, ComputedTorque, FrictionCompensation, GravityPID
from taut.control.trajectories.joint import Sine
from taut.control.trajectories.reference import JointMotion
from taut.maths.snapshot import snapshot
from taut.record.run import Run

__all__ = ["Q", "V"]

Q: Final = np.array([0.3, -0.5, 0.4, -1.9, 0.2, 1.6, 0.7])  # [rad] of the Panda, chosen
V: Final = np.array([0.5, -0.3, 0.4, 0.2, -0.6, 0.7, -0.4])  # [rad/s]
A: Final = np.array([1.0, 0.5, -0.7, 0.9, -0.4, 0.3, 1.1])  # [rad/s^2]
B: Final = np.array([0.5, 0.5, 0.4, 0.4, 0.2, 0.2, 0.1])  # [N m s/rad]
REF: Final = JointMotion(q=Q + 0.05, v=V - 0.1, a=A)
DIFFER: Final = "the joint that differs most"


@entry("eq-10.20", "dynamics of several joints")
def eq_10_20() -> Shown:
    arm = panda().with_joints(viscous=B)
    tau = snapshot(arm, Q, V).inverse_dynamics(A)
    friction = ticked(FrictionCompensation(at="meas"), arm, Q, V, REF).terms["friction"]
    m = engine().at(Q, V)
    yield from compared(np.asarray(tau) + friction, m.M @ A + m.h + B * V, "N m", MUJOCO, "torque of the Panda")
    x = snapshot(two_links(), [0.3, 0.8], [1.0, -0.7])
    q, v = np.array([0.3, 0.8]), np.array([1.0, -0.7])
    yield from compared(np.asarray(x.Cv), TWO_LINKS.Cv(q, v), "N m", TWO_BY_HAND, "C v of two links")
    yield from compared(np.asarray(x.g), TWO_LINKS.g(q), "N m", TWO_BY_HAND, "g of two links")
    yield "Chosen: states, accelerations, and viscous friction of the Panda's joints."


@entry("eq-10.21", "computed torque")
def eq_10_21() -> Shown:
    ctrl = ticked(ComputedTorque(kp=100.0, kd=20.0, ki=50.0), panda(), Q, V, REF)
    got = total(ctrl.terms)
    m = engine().at(Q, V)
    e = REF.q - Q
    wanted = m.M @ (A + 100.0 * e + 50.0 * e * 1e-3 + 20.0 * (REF.v - V)) + m.h
    yield from compared(got, wanted, "N m", MUJOCO, "torque of the Panda")
    yield "Chosen: kp = 100, kd = 20, ki = 50."


@entry("eq-10.22", "PID with gravity compensation")
def eq_10_22() -> Shown:
    ctrl = ticked(GravityPID(kp=80.0, kd=12.0, ki=30.0), panda(), Q, V, REF)
    got = total(ctrl.terms)
    e = REF.q - Q
    wanted = 80.0 * e + 30.0 * e * 1e-3 + 12.0 * (REF.v - V) + engine().at(Q, np.zeros(7)).h
    yield from compared(got, wanted, "N m", MUJOCO, "torque of the Panda")
    yield "Chosen: kp = 80, kd = 12, ki = 30."


# -------------------------------------------------------------------- PD with gravity compensation

KP, KD = np.array([40.0, 20.0]), np.array([3.0, 1.0])  # [N m/rad], [N m s/rad] of two links, chosen
START, GOAL = np.array([1.2, -0.9]), np.array([-0.4, 0.8])  # [rad]
LYAPUNOV_DURATION: Final = 8.0  # [s]
FAST_RATE: Final = 20000.0  # [Hz]


@cache
def falling() -> Run:
    """Two links under PD control with gravity compensation, from afar."""
    law, goal = GravityPID(kp=KP, kd=KD), JointMotion(q=GOAL)
    return simulated(law, two_links(), goal, rate=FAST_RATE, duration=LYAPUNOV_DURATION, q0=START, integrator="rk4")


@cache
def written() -> tuple[Float64Array, Float64Array]:
    """(k,) times, and (5, k) q, v and the integral of v . Kd v, by SciPy."""
    times = np.linspace(0.0, LYAPUNOV_DURATION, 801)

    def rate(_: float, y: Float64Array) -> Float64Array:
        q, v = y[:2], y[2:4]
        a = np.linalg.solve(TWO_LINKS.M(q), KP * (GOAL - q) - KD * v - TWO_LINKS.Cv(q, v))
        return np.array([*v, *a, v @ (KD * v)])

    got = solve_ivp(rate, (0.0, LYAPUNOV_DURATION), [*START, 0.0, 0.0, 0.0], "DOP853", times, rtol=1e-11, atol=1e-12)
    return times, got.y


@cache
def found() -> Lyapunov:
    """V along that run, and its rate at each tick."""
    return lyapunov(falling())


def energy(q: Float64Array, v: Float64Array) -> float:
    """V of equation 10.24, written out [J]."""
    e = GOAL - q
    return float(0.5 * e @ (KP * e) + 0.5 * v @ TWO_LINKS.M(q) @ v)


@entry("eq-10.23", "its closed loop")
def eq_10_23() -> Shown:
    out, (times, y) = falling(), written()
    k, at = round(0.4 * FAST_RATE), int(np.searchsorted(times, 0.4 - 1e-9))
    yield from (
        row(
            f"joint {i + 1} after 0.4 s",
            "rad",
            out.q[k, i],
            y[i, at],
            "SciPy's DOP853 of 10.23, written out",
            rel=0.0,
            near=2e-4,
        )
        for i in (0, 1)
    )
    yield "Two links, from (1.2, -0.9) to (-0.4, 0.8) rad with kp = (40, 20), kd = (3, 1), without friction."


@entry("eq-10.24", "the error energy")
def eq_10_24() -> Shown:
    out, k = falling(), round(0.15 * FAST_RATE)
    wanted = energy(out.q[k], out.v[k])
    yield row("error energy V of two links, after 0.15 s", "J", found().V[k], wanted, TWO_BY_HAND)
    yield "By taut.analysis.lyapunov. The run of equation 10.23."


@entry("eq-10.25", "the error energy of a set-point")
def eq_10_25() -> Shown:
    times, y = written()
    at = int(np.searchsorted(times, 0.4 - 1e-9))
    ode = "SciPy's DOP853 of 10.23, written out"
    V, e = found().V, GOAL - START
    yield row("V at the start", "J", V[0], 0.5 * (e @ (KP * e)), TWO_BY_HAND)
    yield row("V after 0.4 s", "J", V[round(0.4 * FAST_RATE)], energy(y[:2, at], y[2:4, at]), ode, rel=0.0, near=5e-3)
    yield "Numbers of equation 10.23."


@entry("eq-10.26", "its rate")
def eq_10_26() -> Shown:
    out, k = falling(), round(0.15 * FAST_RATE)
    q, v = out.q[k], out.v[k]
    M, e = TWO_LINKS.M(q), GOAL - q
    a = np.linalg.solve(M, KP * e - KD * v - TWO_LINKS.Cv(q, v))
    wanted = -v @ (KP * e) + v @ M @ a + 0.5 * v @ TWO_LINKS.M_rate(q, v) @ v
    V = found().V
    yield row("rate of V at 0.15 s", "W", found().rate[k], wanted, TWO_BY_HAND)
    yield row(
        "the same by differences of V", "W", 0.5 * FAST_RATE * (V[k + 1] - V[k - 1]), wanted, TWO_BY_HAND, rel=2e-3
    )
    yield "Numbers of equation 10.23."


@entry("eq-10.27", "it only falls")
def eq_10_27() -> Shown:
    out, (times, y) = falling(), written()
    k, some = round(0.15 * FAST_RATE), slice(None, None, round(0.01 * FAST_RATE))
    V = found().V
    q, v = np.array([0.3, 0.8]), np.array([1.0, -0.7])
    C = np.asarray(snapshot(two_links(), q, v).C)
    skew = TWO_LINKS.M_rate(q, v) - 2.0 * C
    moved = simulated(GravityPID(kp=KP, kd=KD), two_links(), JointMotion(q=GOAL), duration=0.001, q0=START)
    a = moved.v[1] * moved.rate
    wanted = np.linalg.solve(TWO_LINKS.M(START), KP * (GOAL - START))
    yield row("rate of V at 0.15 s", "W", found().rate[k], -out.v[k] @ (KD * out.v[k]), "-v . Kd v", rel=1e-6)
    yield row("both at their worst, apart, over the largest rate", "", found().worst, 0.0, "-v . Kd v", near=1e-6)
    yield row(
        "V lost in 0.4 s", "J", V[0] - V[round(0.4 * FAST_RATE)], y[4, 40], "integral of v . Kd v by SciPy", rel=1e-3
    )
    yield row("ticks after which V is larger", "", int((np.diff(V) > 1e-9).sum()), 0, "the chapter: decreasing")
    yield row(
        "largest entry of M-dot - 2 C, less its skew part",
        "",
        np.abs(skew + skew.T).max(),
        0.0,
        "skew-symmetric, with M-dot written out",
        near=1e-12,
    )
    yield row(
        "where theta-dot = 0: acceleration of joint 1",
        "rad/s^2",
        a[0],
        wanted[0],
        "M^-1 Kp theta_e, written out",
        rel=1e-9,
        states="slip: ensures theta-dot != 0",
    )
    yield row("error in the end", "rad", np.abs(out.q[-1] - GOAL).max(), 0.0, "the chapter: converges", near=1e-3)
    figure, (left, right) = panels(2, 2.5)
    prepared(left, "error energy", "V [J]", "t [s]")
    left.plot(out.t[some], V[some], color=colour(0), linewidth=1.5, label="of the run")
    left.plot(
        times, V[0] - y[4], color=INK, linewidth=0.9, linestyle=DASHED, label="V(0) less the integral of v . Kd v"
    )
    legend(left)
    prepared(right, "errors", "error [rad]", "t [s]")
    for i in (0, 1):
        right.plot(out.t[some], GOAL[i] - out.q[some, i], color=colour(i), linewidth=1.3, label=f"joint {i + 1}")
    legend(right)

    yield figure
    yield (
        "Where theta-dot = 0 off the goal, the spring ensures that theta-ddot is not zero, so that theta-dot becomes "
        "so; the chapter writes that theta-dot is not zero. Numbers of equation 10.23."
    )


# -------------------------------------------------------------------- decentralised control


def crosstalk(M: Float64Array, kp: Float64Array, kd: Float64Array) -> float:
    """The largest response, over all frequencies, of one of two joints under PD control to the goal of the other."""
    P, D, worst = np.diag(kp), np.diag(kd), 0.0
    for s in 1j * np.geomspace(1.0, 500.0, 2000):
        worst = max(worst, np.abs((np.linalg.solve(M * s * s + D * s + P, P))[[0, 1], [1, 0]]).max())
    return worst


@entry("sec-10.2.2.1", "decentralised control")
def sec_10_2_2_1() -> Shown:
    gantry = load_arm("gantry3").with_joints(viscous=0.0)
    goal = np.array([0.2, -0.1, 0.15])
    law, duration = PID(kp=400.0, kd=60.0, ki=100.0), 1.0
    whole = simulated(law, gantry, JointMotion(q=goal), duration=duration, q0=np.zeros(3))
    for i, name in enumerate(gantry.joint_names):
        single = simulated(law, gantry.subset([name]), JointMotion(q=[goal[i]]), duration=duration, q0=[0.0])
        apart = np.abs(whole.q[:, i] - single.q[:, 0])
        worst = int(np.argmax(apart)) if apart.any() else -1
        yield row(
            f"axis {name} of the gantry, where it differs most from a single joint",
            "m",
            whole.q[worst, i],
            single.q[worst, 0],
            "the joint alone",
            rel=0.0,
            near=1e-12,
            states="equivalent to three single joints",
        )
    for G, rotor in ((1.0, 1e-3), (100.0, 1e-3)):
        arm = two_links().with_gears(G, rotor)
        q = np.array([0.3, 0.8])
        M, wanted = np.asarray(snapshot(arm, q).M), TWO_LINKS.M(q) + G**2 * rotor * np.eye(2)
        kp, kd = 400.0 * np.diag(M), 40.0 * np.diag(M)
        level = arm.with_gravity([0.0, 0.0, 0.0])
        found = coupling(looped(PID(kp=kp, kd=kd), level, JointMotion(q=q), rate=FAST_RATE), at=q)
        by_hand = abs(wanted[0, 1]) / math.sqrt(wanted[0, 0] * wanted[1, 1])
        name, claim = "coupling |M12| / sqrt(M11 M22) of two links", "nearly diagonal" if G > 1.0 else ""
        yield row(f"{name}, G = {G:g}", "", found.inertia, by_hand, TWO_BY_HAND, states=claim)
        yield row(
            f"what a joint follows of the goal of another, at most, G = {G:g}",
            "",
            found.worst[0],
            crosstalk(wanted, kp, kd),
            "(M s^2 + Kd s + Kp)^-1 Kp",
            rel=5e-3,
            states=claim,
        )
        stretched = np.array([0.3, 0.0])
        change = float(np.asarray(snapshot(arm, stretched).M)[0, 0] / M[0, 0] - 1.0)
        wanted_change = (TWO_LINKS.M(stretched)[0, 0] + G**2 * rotor) / wanted[0, 0] - 1.0
        yield row(
            f"M11 stretched over bent, less 1, G = {G:g}",
            "",
            change,
            wanted_change,
            TWO_BY_HAND,
            states="small" if G > 1.0 else "",
        )
    for law_name, control in (
        ("decentralised PD", PID(kp=KP * 10.0, kd=KD * 10.0)),
        ("computed torque", ComputedTorque(kp=100.0, kd=20.0)),
    ):
        yield _followed(law_name, control)

    yield (
        "A gantry is three single joints, to rounding; gears make the mass matrix nearly diagonal and nearly "
        "constant: by taut.analysis.coupling, for joints that PD control makes equally fast, without gravity. "
        "Chosen: PID "
        "with kp = 400, kd = 60, ki = 100; rotors of 1e-3 kg m^2."
    )


SINE: Final = Sine(center=GOAL, amplitude=0.5, frequency=0.5)


def _followed(name: str, law: PID | ComputedTorque) -> Row:
    """The largest error along a sine, beside SciPy's."""
    first = SINE.at(0.0)
    out = simulated(
        law, two_links(), SINE, rate=10000.0, duration=2.0, q0=first.q, v0=first.v, integrator="rk4"
    )  # fmt: skip

    def rate(t: float, y: Float64Array) -> Float64Array:
        q, v, ref = y[:2], y[2:], SINE.at(t)
        e, e_dot = ref.q - q, ref.v - v
        if isinstance(law, PID):
            tau = 10.0 * (KP * e + KD * e_dot)
        else:
            tau = TWO_LINKS.M(q) @ (ref.a + 100.0 * e + 20.0 * e_dot) + TWO_LINKS.h(q, v)
        return np.array([*v, *np.linalg.solve(TWO_LINKS.M(q), tau - TWO_LINKS.h(q, v))])

    times = np.linspace(0.0, 2.0, 401)
    got = solve_ivp(rate, (0.0, 2.0), [*first.q, *first.v], "DOP853", times, rtol=1e-9, atol=1e-11)
    wanted = np.abs(SINE.rows(times).q - got.y[:2].T).max()
    assert out.error is not None
    got, name = np.abs(out.error[::50]).max(), f"{name}: largest error along a sine in gravity"
    if isinstance(law, PID):
        claim = "no longer acceptable where gravity is coupled"
        return row(name, "rad", got, wanted, "SciPy's DOP853, written out", rel=2e-3, states=claim)
    assert wanted < 1e-8  # of SciPy's own solution
    return row(name, "rad", got, 0.0, "10.17: none with an exact model", near=1e-3)
