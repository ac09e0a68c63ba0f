"""The chapter's pseudocode, line by line, against the laws: the same torques tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

import taut
from taut.base.types import Float64Array

TICKS = 200
DT = 0.01
SAME = 1e-12  # relative to the largest torque: only the order of additions may differ

PLANAR = taut.load_arm("planar3")
CHAPTER = taut.load_arm("one_joint")


def recorded_angles(n: int) -> Iterator[tuple[float, Float64Array]]:
    """What senseAngle gives: some motion that is not the wanted one."""
    rng = np.random.default_rng(7)
    phase, rate = rng.uniform(0.0, 3.0, n), rng.uniform(0.5, 2.0, n)
    for k in range(TICKS):
        t = k * DT
        yield t, 0.4 * np.sin(rate * t + phase) + 0.001 * rng.standard_normal(n)


def trajectory(n: int) -> taut.trajectories.Sine:
    return taut.trajectories.Sine(
        center=np.full(n, 0.2), amplitude=0.5, frequency=0.4, phase=np.linspace(0.0, 1.0, n)
    )


def torques_of(law: taut.Law, arm: taut.Arm, engine: str) -> Float64Array:
    """The law's torques for the recorded angles; velocity is differenced as in the pseudocode."""
    ctrl = taut.compile(law, arm, rate=1.0 / DT, sensing=taut.Sensing(velocity="difference"), engine=engine)
    wanted = trajectory(arm.n)
    return np.array([ctrl.step(q, ref=wanted.at(t)) for t, q in recorded_angles(arm.n)])


def pseudocode_10_8(n: int, Kp: float, Ki: float, Kd: float) -> Float64Array:
    """Figure 10.8: PID control."""
    dt = DT
    trajectory_ = trajectory(n)
    sensor = recorded_angles(n)
    commands = []
    time = 0.0  # time = 0                // dt = cycle time
    eint = np.zeros(n)  # eint = 0                // error integral
    first = next(sensor)[1]
    qprev = first  # qprev = senseAngle     // initial joint angle q
    for k in range(TICKS):  # loop
        ref = trajectory_.at(time)  # [qd,qdotd] = trajectory(time)
        qd, qdotd = ref.q, ref.v
        q = first if k == 0 else next(sensor)[1]  # q = senseAngle
        qdot = (q - qprev) / dt  # qdot = (q - qprev)/dt
        qprev = q  # qprev = q
        e = qd - q  # e = qd - q
        edot = qdotd - qdot  # edot = qdotd - qdot
        eint = eint + e * dt  # eint = eint + e*dt
        tau = Kp * e + Kd * edot + Ki * eint  # tau = Kp*e + Kd*edot + Ki*eint
        commands.append(tau)  # commandTorque(tau)
        time = time + dt  # time = time + dt
    return np.array(commands)


def pseudocode_10_9(n: int, Mhat: Callable[..., Float64Array], hhat: Callable[..., Float64Array]) -> Float64Array:
    """Figure 10.9: feedforward control."""
    dt = DT
    trajectory_ = trajectory(n)
    commands = []
    time = 0.0  # time = 0                // dt = cycle time
    for _ in range(TICKS):  # loop
        ref = trajectory_.at(time)  # [qd,qdotd,qdotdotd] = trajectory(time)
        qd, qdotd, qdotdotd = ref.q, ref.v, ref.a
        tau = Mhat(qd) @ qdotdotd + hhat(qd, qdotd)  # tau = Mhat(qd)*qdotdotd + hhat(qd,qdotd)
        commands.append(tau)  # commandTorque(tau)
        time = time + dt  # time = time + dt
    return np.array(commands)


def pseudocode_10_13(
    n: int,
    Kp: float,
    Ki: float,
    Kd: float,
    Mhat: Callable[..., Float64Array],
    hhat: Callable[..., Float64Array],
) -> Float64Array:
    """Figure 10.13: the feedback linearising controller."""
    dt = DT
    trajectory_ = trajectory(n)
    sensor = recorded_angles(n)
    commands = []
    time = 0.0  # time = 0                // dt = cycle time
    eint = np.zeros(n)  # eint = 0                // error integral
    first = next(sensor)[1]
    qprev = first  # qprev = senseAngle     // initial joint angle q
    for k in range(TICKS):  # loop
        ref = trajectory_.at(time)  # [qd,qdotd,qdotdotd] = trajectory(time)
        qd, qdotd, qdotdotd = ref.q, ref.v, ref.a
        q = first if k == 0 else next(sensor)[1]  # q = senseAngle
        qdot = (q - qprev) / dt  # qdot = (q - qprev)/dt
        qprev = q  # qprev = q
        e = qd - q  # e = qd - q
        edot = qdotd - qdot  # edot = qdotd - qdot
        eint = eint + e * dt  # eint = eint + e*dt
        # tau = Mhat(q)*(qdotdotd + Kp*e + Kd*edot + Ki*eint) + hhat(q,qdot)
        tau = Mhat(q) @ (qdotdotd + Kp * e + Kd * edot + Ki * eint) + hhat(q, qdot)
        commands.append(tau)  # commandTorque(tau)
        time = time + dt  # time = time + dt
    return np.array(commands)


def Mhat_of(arm: taut.Arm) -> Callable[[Float64Array], Float64Array]:
    return lambda q: taut.snapshot(arm, q).M


def hhat_of(arm: taut.Arm) -> Callable[[Float64Array, Float64Array], Float64Array]:
    return lambda q, v: taut.snapshot(arm, q, v).h


def assert_same(got: Float64Array, expected: Float64Array) -> None:
    assert np.abs(got - expected).max() <= SAME * np.abs(expected).max()


@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("arm", [CHAPTER, PLANAR], ids=lambda arm: arm.name)
class TestLawsGiveThePseudocodesTorquesTickByTick:
    def test_pid_control_of_figure_10_8(self, arm: taut.Arm, engine: str) -> None:
        got = torques_of(taut.laws.PID(kp=20.0, ki=3.0, kd=2.0), arm, engine)
        assert_same(got, pseudocode_10_8(arm.n, 20.0, 3.0, 2.0))

    @pytest.mark.part(1)
    def test_feedforward_control_of_figure_10_9(self, arm: taut.Arm, engine: str) -> None:
        got = torques_of(taut.laws.FeedForward(), arm, engine)
        assert_same(got, pseudocode_10_9(arm.n, Mhat_of(arm), hhat_of(arm)))

    @pytest.mark.part(1)
    def test_feedback_linearisation_of_figure_10_13(self, arm: taut.Arm, engine: str) -> None:
        got = torques_of(taut.laws.ComputedTorque(kp=20.0, ki=3.0, kd=2.0), arm, engine)
        assert_same(got, pseudocode_10_13(arm.n, 20.0, 3.0, 2.0, Mhat_of(arm), hhat_of(arm)))


def test_the_textbooks_library_integrates_without_dt_and_we_do_not() -> None:
    """modern_robotics.ComputedTorque uses Ki * (eint + e); equation 10.21 integrates e dt."""
    arm, dt = PLANAR, 0.01
    law = taut.laws.ComputedTorque(kp=1.3, ki=1.2, kd=1.1)
    ctrl = taut.compile(law, arm, rate=1.0 / dt)
    q, v = np.full(3, 0.1), np.array([0.1, 0.2, 0.3])
    ref = taut.JointMotion(q=[1.0, 1.0, 1.0], v=[2.0, 1.2, 2.0], a=[0.1, 0.1, 0.1])
    x = taut.snapshot(arm, q, v)
    e, e_dot = ref.q - q, ref.v - v
    expected = x.M @ (ref.a + 1.3 * e + 1.2 * e * dt + 1.1 * e_dot) + x.h
    assert np.abs(ctrl.step(q, v, ref) - expected).max() < SAME * np.abs(expected).max()
