"""Break-away and stick-slip: against integration from event to event, and against the law's own torque."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from friction_oracle import Pulled, measured_events

import taut

FREE = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])  # M = 0.5 kg m^2
UNTIL = 12.0
WITHIN = 0.01  # of each time at rest and in motion

CASES = {
    "kinetic (d)": Pulled(M=0.5, kp=10.0, kd=0.1, speed=0.05, viscous=0.0, coulomb=0.5, static=1.0, stribeck=0.0),
    "kinetic and viscous (e)": Pulled(M=0.5, kp=10.0, kd=0.1, speed=0.05, viscous=0.1, coulomb=0.4, static=1.0, stribeck=0.0),
    "Stribeck (f)": Pulled(M=0.5, kp=20.0, kd=1.0, speed=0.1, viscous=0.1, coulomb=0.5, static=1.0, stribeck=0.05),
    "Stribeck, exponential": Pulled(M=0.5, kp=20.0, kd=0.2, speed=0.1, viscous=0.1, coulomb=0.5, static=1.0, stribeck=0.2, shape=1.0),
}  # fmt: skip


def pulled(case: Pulled, rate: float, substeps: int) -> taut.Run:
    friction = taut.Friction(
        viscous=case.viscous, coulomb=case.coulomb, static=case.static, stribeck=case.stribeck,
        stribeck_shape=case.shape,
    )  # fmt: skip
    arm = FREE.with_friction(friction)
    ctrl = taut.compile(taut.laws.PID(kp=case.kp, kd=case.kd), arm, rate=rate)
    ramp = taut.trajectories.Samples(times=[0.0, 20.0], q=[[0.0], [20.0 * case.speed]])
    return taut.run(ctrl, taut.RigidPlant(arm, substeps=substeps), ramp, duration=UNTIL, q0=[0.0])


@pytest.mark.part(2)
@pytest.mark.bars
@pytest.mark.parametrize("name", CASES)
def test_times_of_sticking_and_slipping_are_those_of_event_accurate_integration(name: str, bar: Any) -> None:
    case = CASES[name]
    slips, sticks = case.events(UNTIL)
    assert len(sticks) >= 3
    run = pulled(case, rate=4000.0, substeps=2)
    our_slips, our_sticks = measured_events(run)
    k = min(len(sticks), len(our_sticks))
    assert abs(len(our_sticks) - len(sticks)) <= 1
    slipping, sticking = sticks[:k] - slips[:k], slips[1:k] - sticks[: k - 1]
    ours = our_sticks[:k] - our_slips[:k], our_slips[1:k] - our_sticks[: k - 1]
    worst = max(np.abs(a / b - 1.0).max() for a, b in zip(ours, (slipping, sticking), strict=True))
    bar(f"stick-slip, {name}: largest relative error of a time in motion or at rest", float(worst))
    np.testing.assert_allclose(our_sticks[:k] - our_slips[:k], slipping, rtol=WITHIN)
    np.testing.assert_allclose(our_slips[1:k] - our_sticks[: k - 1], sticking, rtol=WITHIN)
    np.testing.assert_allclose(our_slips[:k], slips[:k], rtol=WITHIN)


def test_the_times_of_events_converge_with_the_step() -> None:
    case = CASES["kinetic (d)"]
    slips, sticks = case.events(UNTIL)
    errors = []
    for rate in (500.0, 4000.0):
        our_slips, our_sticks = measured_events(pulled(case, rate=rate, substeps=2))
        errors.append(np.abs((our_sticks - our_slips)[:3] - (sticks - slips)[:3]).max())
    assert errors[1] < 0.25 * errors[0]


def loaded(share: float, arm_of: Callable[[], taut.Arm] = lambda: taut.load_arm("panda")) -> taut.Run:
    """An arm at home that only friction holds, its break-away torque such that gravity takes this share of it."""
    arm = arm_of()
    weight = np.abs(taut.snapshot(arm, arm.home).g)
    static = np.maximum(weight / share, 0.01)
    arm = arm.with_friction(taut.Friction(coulomb=0.6 * static, static=static, stribeck=0.05, viscous=0.1))
    idle = taut.compile(taut.laws.PID(kp=0.0), arm)
    # A plant that starts on its brakes, and lets them go.
    return taut.run(idle, taut.RigidPlant(arm), duration=60.0 if share < 1.0 else 0.5)


@pytest.mark.part(1)
@pytest.mark.bars
@pytest.mark.parametrize("model", ["panda", "ur10", "so101"])
def test_an_arm_that_friction_can_hold_does_not_creep_in_a_minute(model: str, bar: Any) -> None:
    run = loaded(0.98, lambda: taut.load_arm(model))
    assert run.outcome.ok
    crept = float(np.abs(run.q - run.q[0]).max())
    bar(f"creep of {model} at 98 % of break-away, 60 s [rad]", crept)
    assert crept < 1e-9
    assert not run.v[1:].any()
    assert np.abs(run.extra["friction_residual"]).max() < 1e-9


@pytest.mark.part(1)
@pytest.mark.parametrize("model", ["panda", "ur10", "so101"])
def test_it_slips_when_gravity_is_a_hundredth_more_than_friction_holds(model: str) -> None:
    assert np.abs(loaded(0.99, lambda: taut.load_arm(model)).v).max() < 1e-12
    assert np.abs(loaded(1.01, lambda: taut.load_arm(model)).v[-1]).max() > 1e-3


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_joint_breaks_away_at_its_static_friction(direction: float) -> None:
    """The torque grows by 0.001 N m a tick; the joint moves in the tick in which it is more than 0.8 N m."""
    arm = FREE.with_friction(taut.Friction(coulomb=0.5, static=0.8))
    pull = taut.compile(taut.laws.PID(kp=1.0), arm)
    ramp = taut.trajectories.Samples(times=[0.0, 2.0], q=[[0.0], [2.0 * direction]])
    run = taut.run(pull, taut.RigidPlant(arm), ramp, duration=1.0, q0=[0.0])
    first = int(np.argmax(np.abs(run.v[:, 0]) > 0.0))
    assert abs(run.tau[first - 1, 0]) == pytest.approx(0.8, rel=0.002)
    assert np.sign(run.v[-1, 0]) == direction


class TestFrictionThatGrowsWithLoad:
    def test_of_the_motor_holds_a_share_of_its_torque(self) -> None:
        """Dry friction of 0.1 N m and a fifth of the motor's torque: 0.125 N m is what just moves the joint."""
        arm = FREE.with_friction(taut.Friction(coulomb=0.1, load_motor=0.2))
        for tau, moves in ((0.1249, False), (0.1251, True)):
            push = taut.compile(taut.laws.PID(kp=1.0), arm)
            run = taut.run(push, taut.RigidPlant(arm), taut.JointMotion(q=[tau]), duration=0.01, q0=[0.0])
            assert bool(run.v[-1, 0] > 0.0) is moves

    def test_of_the_load_holds_an_arm_whatever_it_carries(self) -> None:
        """Where friction per torque of the load is above one, no load moves it: a worm gear."""
        arm = taut.load_arm("one_joint").with_friction(taut.Friction(load_external=1.01))
        idle = taut.compile(taut.laws.PID(kp=0.0), arm)
        plant = taut.RigidPlant(arm)
        events = [taut.Event(t=0.1, set={"plant.payload.mass": 100.0})]
        assert not taut.run(idle, plant, duration=0.3, q0=[0.0], events=events).v.any()
        slips = [taut.Event(t=0.1, set={"plant.friction.load_external": 0.99})]
        assert taut.run(idle, plant, duration=0.3, q0=[0.0], events=slips).v[-1, 0] < -1e-3


def test_friction_is_changed_in_a_run_without_compiling() -> None:
    arm = FREE.with_friction(taut.Friction(viscous=0.1, coulomb=0.5, static=0.8, stribeck=0.1))
    ctrl = taut.compile(taut.laws.PID(kp=1.0), arm)
    plant = taut.RigidPlant(arm)
    less = taut.Event(t=0.5, set={"plant.friction.static": 0.5, "plant.friction.coulomb": 0.2})
    held = taut.run(ctrl, plant, taut.JointMotion(q=[0.7]), duration=1.0, q0=[0.0])
    freed = taut.run(ctrl, plant, taut.JointMotion(q=[0.7]), duration=1.0, q0=[0.0], events=[less])
    assert not held.v.any()
    assert freed.v[-1, 0] > 0.01
    assert not freed.v[:500].any()
