"""Designs on a plant of the user's own: limits of springs, play and delay are what the loop does there."""

from __future__ import annotations

import numpy as np
import pytest

import taut

laws = taut.laws
ARM = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_gears({"joint1": 100.0}, 2.5e-5)
STEPS = 10


def elastic(damping: float) -> taut.RigidPlant:
    gear = taut.drives.Transmission(stiffness=2000.0, damping=damping)
    return taut.RigidPlant(ARM, friction=None, actuation=taut.drives.Actuation(transmission=gear), substeps=STEPS)


@pytest.mark.parametrize(("damping", "stable"), [(0.5, False), (4.0, True)])
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_spring_that_kd_sets_off_is_told(damping: float, stable: bool) -> None:
    """A design of a twelfth of its frequency was told not to feel it, and overshot by 10 830 %."""
    plant = elastic(damping)
    d = taut.design(laws.PID, ARM, zeta=1.0, omega_n=5.0, plant=plant)
    assert d.limit("elastic joint").ok
    assert d.limit("on plant").ok is stable
    run = taut.run(
        taut.compile(d.law, ARM),
        plant,
        taut.JointMotion(q=ARM.home),
        duration=6.0,
        q0=ARM.home + 1e-3,
        progress=False,
    )
    first, last = np.abs(run.v[1000:2000]).max(), np.abs(run.v[-1000:]).max()
    assert bool(last < first) is stable
    if not stable:
        assert d.limit("on plant").value == pytest.approx((last / first) ** (1.0 / (len(run.t) - 2000)), abs=2e-4)
        assert "on plant= the loop grows by the factor 1.004" in d.report()


@pytest.mark.filterwarnings("ignore:the rotor inertia of joint")
def test_the_slowest_swing_of_elastic_joints_is_that_of_all_of_them() -> None:
    """That of each joint with the others held is higher."""
    arm = taut.load_arm("planar2").with_gravity([0.0, 0.0, 0.0])
    gear = taut.drives.Transmission(stiffness=500.0, damping=0.5)
    held = arm.with_gears(100.0, 1e4)  # rotors that nothing moves
    q = np.array([0.3, 0.4])
    plant = taut.RigidPlant(held, friction=None, actuation=taut.drives.Actuation(transmission=gear), substeps=STEPS)
    ctrl = taut.compile(laws.PID(kp=1e-6, kd=1e-6), held, rate=4000.0)
    lin = taut.linearise(taut.Loop(ctrl, plant, duration=1.0), at=q)
    slowest = min(mode.omega_n for mode in lin.modes if mode.omega_n > 1.0)
    light = arm.with_gears(100.0, 1e-5)
    own = taut.RigidPlant(light, friction=None, actuation=taut.drives.Actuation(transmission=gear), substeps=STEPS)
    d = taut.design(laws.ComputedTorque, light, at=q, zeta=1.0, omega_n=2.0, plant=own)
    assert d.limit("elastic joint").limit == pytest.approx(0.5 * slowest, rel=2e-3)


@pytest.mark.parametrize(("omega_n", "quiet"), [(4.5, True), (9.0, False)])
def test_play_is_held_by_friction_up_to_the_gain_that_is_told(omega_n: float, quiet: bool) -> None:
    """kp = 2 friction / play is 20: 15.2 rolls to rest, 60.8 swings. No gain was told to hold it."""
    arm = ARM.with_friction(taut.Friction(viscous=0.1, coulomb=0.2))
    gear = taut.drives.Transmission(stiffness=2e4, damping=20.0, backlash=0.02)
    sensors = taut.sensors.Sensors(velocity=taut.sensors.Tachometer(side="motor"))
    plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(transmission=gear), sensors=sensors, substeps=STEPS)
    d = taut.design(laws.PID, arm, zeta=1.0, omega_n=omega_n, plant=plant)
    limit = d.limit("backlash")
    assert limit.ok is quiet
    assert limit.limit == pytest.approx(2.0 * 0.2 / float(np.ravel(d.law.parameters()["kp"])[0]))
    ctrl = taut.compile(d.law, arm)
    run = taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=30.0, q0=arm.home + 0.05, progress=False)
    assert bool(np.abs(run.v[-4000:]).max() < 5e-3) is quiet


def test_play_that_an_encoder_at_the_motor_does_not_see_stays() -> None:
    gear = taut.drives.Transmission(stiffness=2e4, damping=20.0, backlash=0.02)
    sensors = taut.sensors.Sensors(
        position=taut.sensors.Encoder(side="motor"), velocity=taut.sensors.Tachometer(side="motor")
    )
    plant = taut.RigidPlant(ARM, actuation=taut.drives.Actuation(transmission=gear), sensors=sensors, substeps=STEPS)
    d = taut.design(laws.PID, ARM, zeta=1.0, omega_n=4.0, plant=plant)
    assert not d.limit("backlash").ok
    assert "stays off by up to half of it" in d.limit("backlash").sentence


def test_a_step_that_does_not_settle_on_a_late_plant_is_told() -> None:
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])
    late = taut.RigidPlant(arm, friction=None, actuation=taut.drives.Actuation(delay=0.01), integrator="rk4")
    slow, fast = (taut.design(laws.PID, arm, zeta=1.0, omega_n=w, plant=late) for w in (20.0, 60.0))
    assert slow.limit("on plant").ok
    assert slow.limit("on plant").value == slow.achieved[0].on_plant.settling  # type: ignore[union-attr]
    assert not fast.limit("on plant").ok
    assert "is not within 2 % for good after" in fast.limit("on plant").sentence
    assert all(each.name != "on plant" for each in taut.design(laws.PID, arm, zeta=1.0, omega_n=20.0).limits)
