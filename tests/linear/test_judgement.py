"""The sampled loop is judged at the start of a run: stable or not, in which direction, which gain is the largest."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from refusals import refused, warned

import taut
from taut.linear.judgement import Judgement, judge_start

WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`
LAWS = taut.laws
STIFF = LAWS.Stiffness(K=(800.0, 30.0), kd=2.0)
DAMPED = LAWS.Impedance(K=(800.0, 30.0), B=(60.0, 4.0))


def verdict_of(
    law: taut.Law,
    arm: taut.Arm,
    *,
    rate: float = 1000.0,
    sensing: taut.Sensing | None = None,
    q: Any = None,
    **plant: Any,
) -> tuple[Judgement | str, taut.Loop]:
    ctrl = taut.compile(law, arm, rate=rate, sensing=sensing)
    loop = taut.Loop(ctrl, taut.RigidPlant(arm, **plant), duration=1.0)
    start = arm.home if q is None else np.asarray(q)
    return judge_start(loop, loop.plant, start), loop


def without_friction(name: str) -> taut.Arm:
    return taut.load_arm(name).with_friction(taut.Friction())


class TestGainsThatAreTooLarge:
    """From outside: radius 2.81 (UR10), 1.61 (Kinova), 13.6 (xArm7) under STIFF with an exact zero-order hold."""

    CASES = (
        ("ur10", STIFF, "law.kd", "wrist_3_joint"),
        ("kinova", STIFF, "law.kd", "j2s6s200_joint_6"),
        ("ur3", DAMPED, "law.B", "wrist_3_joint"),
        ("xarm7", DAMPED, "law.B", "joint7"),
        ("fr3", DAMPED, "law.B", "fr3_joint7"),
    )

    @pytest.mark.part(1)
    @pytest.mark.parametrize(("name", "law", "gain", "joint"), CASES)
    def test_are_named_with_the_largest_that_is_stable(self, name: str, law: taut.Law, gain: str, joint: str) -> None:
        arm = without_friction(name)
        found, loop = verdict_of(law, arm)
        assert isinstance(found, Judgement)
        assert not found.stable
        assert list(found.largest) == [gain]
        assert next(iter(found.joints)) == joint
        factor, value = found.largest[gain], loop.parameters[gain]
        for more, unstable in ((1.0, False), (1.02, True)):
            loop.parameters[gain] = more * factor * value
            assert taut.linearise(loop).radius > 1.0 + 1e-9 if unstable else taut.linearise(loop).radius < 1.0 + 1e-9

    @pytest.mark.part(1)
    @pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
    def test_are_warned_of_and_named_in_the_outcome(self, plant: Any) -> None:
        arm = taut.load_arm("ur10")
        push = taut.environments.Push(peak=[1.0, 1.0, 1.0, 0.1, 0.1, 0.1], t=0.0, duration=0.01)
        with warned(taut.StabilityWarning):
            run = taut.run(taut.compile(DAMPED, arm), plant(arm, environment=push), duration=0.3)
        assert run.outcome.kind == "diverged"
        assert "law.B = (15" in run.outcome.message
        stability = run.info.stability
        assert stability.stable is False
        assert stability.radius > 2.0
        assert stability.largest["law.B"] < 0.3
        assert ("in place of MujocoPlant" in stability.plant) == (plant is taut.MujocoPlant)

    def test_are_refused_where_the_plant_is_a_real_arm(self) -> None:
        class RealUR10(taut.MujocoPlant):
            real = True

        arm = taut.load_arm("ur10")
        with refused(taut.errors.RangeError):
            taut.run(taut.compile(DAMPED, arm), RealUR10(arm), duration=0.1)
        calm = LAWS.Impedance(K=(800.0, 30.0), zeta=0.7)
        assert taut.run(taut.compile(calm, arm), RealUR10(arm), duration=0.05).outcome.ok

    def test_a_larger_gain_is_not_advised(self) -> None:
        """An arm that stands upright falls over under little stiffness: no smaller gain helps."""
        arm = taut.load_arm("one_joint")
        up = np.array([0.5 * np.pi])
        found, _ = verdict_of(LAWS.PID(kp=0.05, kd=0.1), arm, q=up)
        lin = taut.linearise(
            taut.Loop(taut.compile(LAWS.PID(kp=0.05, kd=0.1), arm), taut.RigidPlant(arm), duration=1.0), at=up
        )
        assert isinstance(found, Judgement)
        assert found.stable is lin.stable
        assert found.largest == {}


class TestAgreement:
    """With the exact derivative of `taut.linearise`, which knows neither."""

    ARMS = ("ur10", "ur3", "kinova", "xarm7", "panda", "fr3", "z1", "planar2", "gantry3", "one_joint", "so101")

    @pytest.mark.part(1)
    @pytest.mark.bars
    @pytest.mark.parametrize("seed", range(120) if WHOLE else (1, 3, 6, 7, 8, 9))
    def test_with_linearise_over_random_arms_laws_gains_and_poses(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        arm = without_friction(self.ARMS[seed % len(self.ARMS)])
        f = 10.0 ** rng.uniform(-1.0, 1.5)
        laws = [
            LAWS.PID(kp=100.0 * f, kd=10.0 * f, ki=50.0 * f),
            LAWS.GravityPID(kp=100.0 * f, kd=5.0 * f, ki=20.0 * f),
            LAWS.ComputedTorque(kp=400.0 * f, kd=200.0 * f),
        ]
        if arm.n >= 6:
            laws += [
                LAWS.Impedance(K=(500.0 * f, 20.0 * f), B=(30.0 * f, 2.0 * f)),
                LAWS.Stiffness(K=(500.0 * f, 20.0 * f), kd=f),
                LAWS.TaskComputedTorque(kp=100.0 * f, kd=100.0 * f),
            ]
        law, rate = laws[rng.integers(len(laws))], float(rng.choice([250.0, 1000.0]))
        sensing = [
            None,
            taut.Sensing(velocity="difference"),
            taut.Sensing(velocity=taut.sensors.LowPass(cutoff=80.0)),
        ]
        drives = taut.drives.Actuation(delay=1.0 / rate) if rng.random() < 0.3 else taut.drives.Actuation()
        q = arm.home + rng.uniform(-0.2, 0.2, arm.n)
        found, loop = verdict_of(
            law,
            arm,
            rate=rate,
            sensing=sensing[rng.integers(3)],
            q=q,
            actuation=drives,
            substeps=int(rng.choice([1, 5])),
        )
        try:
            lin = taut.linearise(loop, at=q)
        except taut.errors.RangeError:  # no equilibrium near
            assert isinstance(found, str)
            return
        assert isinstance(found, Judgement)
        assert found.radius == pytest.approx(lin.radius, rel=1e-5)
        assert found.stable == (lin.radius <= 1.0 + 1e-8)

    def test_what_drifts_is_not_unstable(self) -> None:
        for name in ("ur10", "xarm7", "panda"):
            found, _ = verdict_of(LAWS.GravityCompensation(), without_friction(name))
            assert isinstance(found, Judgement)
            assert found.stable

    def test_one_joint_in_its_backlash_does_not_hide_another_that_grows(self) -> None:
        """A joint without load has no derivative in its gap; the wrist grows all the same, until the run diverges."""
        arm = taut.load_arm("panda").with_gears(ratio=[100.0] * 4 + [50.0] * 3, motor_inertia=2e-5)
        drives = taut.drives.Actuation(
            transmission=taut.drives.Transmission(stiffness=5e3, damping=1.0, backlash=0.002, efficiency=0.9)
        )
        found, loop = verdict_of(LAWS.PID(kp=60.0, kd=8.0), arm, actuation=drives, substeps=10)
        assert isinstance(found, Judgement)
        assert not found.stable
        assert found.radius == pytest.approx(1.0226, abs=1e-3)
        with pytest.warns(taut.StabilityWarning):
            run = taut.run(taut.compile(LAWS.PID(kp=60.0, kd=8.0), arm), loop.plant, taut.hold(), duration=2.5)
        assert "diverged" in run.outcome.message

    def test_ripple_is_left_out(self) -> None:
        """At every other equilibrium along a turn of the motor its slope is above kp; motion passes them."""
        arm = taut.load_arm("panda").with_gears(ratio=100.0, motor_inertia=2e-5)
        law = LAWS.PID(kp=60.0, kd=8.0)
        plain, _ = verdict_of(law, arm)
        rippled, _ = verdict_of(
            law, arm, actuation=taut.drives.Actuation(ripple=taut.drives.Ripple(amplitude=0.05, periods=6))
        )
        assert isinstance(plain, Judgement)
        assert isinstance(rippled, Judgement)
        assert rippled.stable
        assert rippled.radius == pytest.approx(plain.radius, rel=1e-6)

    def test_steps_of_sensors_and_amplifiers_are_left_out(self) -> None:
        arm = without_friction("panda")
        encoder = taut.sensors.Encoder(resolution=1e-4)
        found, _ = verdict_of(
            DAMPED, arm, sensing=taut.Sensing(velocity="difference"),
            sensors=taut.sensors.Sensors(position=encoder, velocity=None), actuation=taut.drives.Actuation(resolution=0.1),
        )  # fmt: skip
        smooth, _ = verdict_of(
            DAMPED, arm, sensing=taut.Sensing(velocity="difference"), sensors=taut.sensors.Sensors(velocity=None)
        )
        assert isinstance(found, Judgement)
        assert isinstance(smooth, Judgement)
        assert found.radius == pytest.approx(smooth.radius, rel=1e-9)


class TestFriction:
    """A verdict names the friction that it relies on; dry friction is left out."""

    def test_that_hides_an_unstable_loop_is_named(self) -> None:
        arm = taut.load_arm("xarm7")
        found, loop = verdict_of(DAMPED, arm)
        assert isinstance(found, Judgement)
        assert not found.stable
        assert found.relies_on == ("dry friction",)
        assert taut.linearise(loop).stable  # it sticks
        with warned(taut.StabilityWarning):
            slow = taut.run(loop, v0=np.full(7, 0.1))
        with pytest.warns(taut.StabilityWarning):
            fast = taut.run(loop, v0=np.full(7, 0.5))
        assert (slow.outcome.kind, fast.outcome.kind) == ("completed", "diverged")

    def test_that_a_stable_loop_needs_is_named(self) -> None:
        found, _ = verdict_of(STIFF, taut.load_arm("xarm7"))
        bare, _ = verdict_of(STIFF, taut.load_arm("xarm7"), friction=None)
        assert isinstance(found, Judgement)
        assert isinstance(bare, Judgement)
        assert found.stable
        assert not bare.stable
        assert found.relies_on == ("the viscous friction of the joints",)

    def test_compensated_dry_friction_is_left_out_on_both_sides(self) -> None:
        arm = without_friction("panda").with_friction(taut.Friction(viscous=0.5, coulomb=2.0))
        law = LAWS.GravityPID(kp=20.0, kd=2.0) + LAWS.FrictionCompensation(at="meas", share=0.9)
        found, _ = verdict_of(law, arm)
        assert isinstance(found, Judgement)
        assert found.stable


class TestWhatIsNotJudged:
    def test_plain_python(self) -> None:
        arm = taut.load_arm("planar2")
        run = taut.run(taut.compile(LAWS.PID(kp=1.0), arm, engine="float"), taut.RigidPlant(arm), duration=0.01)
        assert run.info.stability.stable is None

    def test_a_command_that_depends_on_nothing_measured(self) -> None:
        arm = taut.load_arm("one_joint")
        found, _ = verdict_of(LAWS.FeedForward(), arm)
        assert isinstance(found, str)

    def test_a_loop_that_rests_nowhere_near(self) -> None:
        arm = without_friction("panda")
        found, _ = verdict_of(LAWS.PID(kp=0.1, kd=0.1), arm)
        assert isinstance(found, str)
        assert "not an equilibrium" in found


def test_a_changed_gain_and_payload_are_those_that_are_judged() -> None:
    arm = taut.load_arm("ur10")
    ctrl = taut.compile(STIFF, arm)
    plant = taut.RigidPlant(arm)
    ctrl.parameters["law.kd"] = 0.5
    assert taut.run(ctrl, plant, duration=0.01).info.stability.stable is True
    with pytest.warns(taut.StabilityWarning):
        early = taut.run(ctrl, plant, duration=0.01, events=[taut.Event(t=0.0, set={"law.kd": 2.0})])
    assert early.info.stability.stable is False


def test_noise_and_the_phase_of_the_start_change_nothing() -> None:
    arm = without_friction("panda")
    noisy = taut.sensors.Sensors(
        position=taut.sensors.Encoder(noise=1e-3), velocity=taut.sensors.Tachometer(noise=1e-2)
    )
    a, _ = verdict_of(DAMPED, arm, sensors=noisy)
    b, _ = verdict_of(DAMPED, arm)
    assert isinstance(a, Judgement)
    assert isinstance(b, Judgement)
    assert a.stable == b.stable
    assert a.radius == pytest.approx(b.radius, rel=1e-9)
