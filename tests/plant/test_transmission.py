"""Gears that lose power, have play, or give way: against closed forms, and against SciPy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.integrate import solve_ivp

import taut
from taut.base.types import Float64Array

FREE = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_joints(viscous=0.0)  # M = 0.5 kg m^2
GEARED = FREE.with_gears(ratio=50.0, motor_inertia=1e-4)  # rotor 0.25 kg m^2 at the joint
HANGING = taut.load_arm("one_joint").with_joints(viscous=0.0)
WEIGHT = 0.981  # [N m] of that link when it lies level


def idle(arm: taut.Arm, rate: float = 1000.0) -> taut.Controller:
    return taut.compile(taut.laws.PID(kp=0.0), arm, rate=rate)


def held(arm: taut.Arm, tau: float, duration: float = 0.2, **options: Any) -> taut.Run:
    """A constant torque on a joint that starts at rest at zero; a proportional law of a constant error."""
    law = taut.compile(taut.laws.PID(kp=1e-9), arm)
    return taut.run(
        law, taut.RigidPlant(arm, **options), taut.JointMotion(q=[1e9 * tau]), duration=duration, q0=[0.0]
    )


class TestEfficiency:
    def gears(self, efficiency: float) -> taut.drives.Actuation:
        return taut.drives.Actuation(transmission=taut.drives.Transmission(efficiency=efficiency))

    def test_a_motor_that_lifts_needs_more(self) -> None:
        """At 80 %, 0.981 N m of weight move up from 1.226 N m."""
        for share, moves in ((0.999, False), (1.001, True)):
            run = held(HANGING, share * WEIGHT / 0.8, actuation=self.gears(0.8))
            assert bool(run.v[-1, 0] > 0.0) is moves

    def test_a_load_that_drives_the_motor_is_held_with_less(self) -> None:
        for share, moves in ((1.001, False), (0.999, True)):
            run = held(HANGING, share * WEIGHT * 0.8, actuation=self.gears(0.8))
            assert bool(run.v[-1, 0] < 0.0) is moves

    def test_between_the_two_it_holds_without_the_motor_s_help(self) -> None:
        for share in (0.81, 1.0, 1.24):
            assert not held(HANGING, share * WEIGHT, duration=1.0, actuation=self.gears(0.8)).v[1:].any()

    def test_a_motor_that_is_off_is_driven_back_without_loss(self) -> None:
        """The loss is a share of the motor's torque; what a load alone holds is friction of the load."""
        fallen = [held(HANGING, 0.0, actuation=self.gears(efficiency)).q[-1, 0] for efficiency in (1.0, 0.4)]
        assert fallen[0] < -0.03
        assert fallen[1] == pytest.approx(fallen[0], abs=1e-9)
        worm = HANGING.with_friction(taut.Friction(load_external=1.01))
        assert held(worm, 0.0, duration=1.0).q[-1, 0] == 0.0

    @pytest.mark.parametrize(
        ("tau", "v0", "share"), [(2.0, 1.0, 0.8), (-2.0, -1.0, 0.8), (-2.0, 9.0, 1.25), (2.0, -9.0, 1.25)]
    )
    def test_what_arrives_is_the_share_of_the_power_that_is_left(self, tau: float, v0: float, share: float) -> None:
        """The motor drives: efficiency times its torque. The load drives: its torque is the motor's over efficiency."""
        law = taut.compile(taut.laws.PID(kp=1e-9), FREE)
        plant = taut.RigidPlant(FREE, actuation=self.gears(0.8), energy=True)
        run = taut.run(law, plant, taut.JointMotion(q=[1e9 * tau]), duration=0.1, q0=[0.0], v0=[v0])
        assert run.v[-1, 0] == pytest.approx(v0 + share * tau / 0.5 * 0.1, rel=1e-9)
        motor, gears, link = (run.extra[f"work.{part}"][-1, 0] for part in ("motor", "gears", "link"))
        assert motor == pytest.approx(gears + link, rel=1e-12)
        forward = tau * v0 > 0.0
        assert (
            link == pytest.approx(0.8 * motor, rel=1e-9) if forward else motor == pytest.approx(0.8 * link, rel=1e-9)
        )

    @pytest.mark.parametrize("efficiency", [0.8, 0.4])
    @pytest.mark.parametrize(
        ("tau", "v0", "drives"), [(2.0, 0.0, True), (2.0, 1.0, True), (-2.0, -1.0, True), (-2.0, 9.0, False)]
    )
    @pytest.mark.parametrize("kind", [taut.RigidPlant, taut.MujocoPlant])
    def test_the_gear_passes_its_share_of_what_the_rotor_s_acceleration_leaves(
        self, kind: Any, tau: float, v0: float, drives: bool, efficiency: float
    ) -> None:
        """M a = passed (tau - B a): with 80 % of 2 N m, 0.5 and 0.25 kg m^2, 2.2857 rad/s^2."""
        passed = efficiency if drives else 1.0 / efficiency
        law = taut.compile(taut.laws.PID(kp=1e-9), GEARED)
        plant = kind(GEARED, actuation=self.gears(efficiency))
        run = taut.run(law, plant, taut.JointMotion(q=[1e9 * tau]), duration=0.1, q0=[0.0], v0=[v0])
        a = np.diff(run.v[:, 0]) / np.diff(run.t)  # the first step, from rest, included
        assert a == pytest.approx(np.full(len(a), passed * tau / (0.5 + passed * 0.25)), rel=1e-9)

    @pytest.mark.parametrize("tau", [0.5, 0.0, -0.5])
    @pytest.mark.parametrize("kind", [taut.RigidPlant, taut.MujocoPlant])
    def test_a_load_that_sets_a_joint_at_rest_in_motion_drives_the_gear_at_once(self, kind: Any, tau: float) -> None:
        """It falls: where tau - B a lifts, the load drives, and where it pulls too, the motor does."""
        arm = HANGING.with_gears(ratio=50.0, motor_inertia=1e-4)
        law = taut.compile(taut.laws.PID(kp=1e-9), arm)
        run = taut.run(
            law, kind(arm, actuation=self.gears(0.8)), taut.JointMotion(q=[1e9 * tau]), duration=0.002, q0=[0.0]
        )
        M = float(taut.snapshot(HANGING, [0.0]).M[0, 0])
        passed = next(p for p in (0.8, 1.25) if (p < 1.0) == (tau - 0.25 * (p * tau - WEIGHT) / (M + p * 0.25) < 0.0))
        expected = (passed * tau - WEIGHT) / (M + passed * 0.25)
        assert run.v[1, 0] / 1e-3 == pytest.approx(expected, rel=1e-9)

    @pytest.mark.parametrize("kind", [taut.RigidPlant, taut.MujocoPlant])
    def test_a_load_that_accelerates_the_rotor_alone_loses_in_the_gear_too(self, kind: Any) -> None:
        """M a = -weight - B a / 0.4, from 2.2 rad/s^2 on without loss."""
        arm = HANGING.with_gears(ratio=50.0, motor_inertia=1e-4)
        run = held(arm, 0.0, duration=0.02, actuation=self.gears(0.4)) if kind is taut.RigidPlant else taut.run(
            idle(arm), kind(arm, actuation=self.gears(0.4)), duration=0.02, q0=[0.0]
        )  # fmt: skip
        M = float(taut.snapshot(HANGING, [0.0]).M[0, 0])
        a = (run.v[-1, 0] - run.v[1, 0]) / (run.t[-1] - run.t[1])
        assert a == pytest.approx(-WEIGHT / (M + 0.25 / 0.4), rel=1e-4)

    def test_of_coupled_joints_each_gear_loses_its_share_of_what_reaches_it(self) -> None:
        """Power into each gear, less that of its rotor; a step of stick-slip predicts which joints move."""
        arm = taut.load_arm("panda").with_gears(ratio=100.0, motor_inertia=2e-5)
        efficiency = np.array([0.8] * 4 + [0.5] * 3)
        gears = taut.drives.Actuation(transmission=taut.drives.Transmission(efficiency=efficiency))
        plant = taut.RigidPlant(arm, friction=None, actuation=gears, energy=True)
        law = taut.compile(taut.laws.GravityPID(kp=200.0, kd=20.0), arm)
        ref = taut.trajectories.Sine(center=arm.home, amplitude=0.2, frequency=0.7)
        run = taut.run(law, plant, ref, duration=2.0)
        motor, rotor, lost, step = (np.diff(run.extra[f"work.{x}"], axis=0) for x in ("motor", "rotor", "gears", "integration"))  # fmt: skip
        reaching = motor - rotor - step
        expected = np.where(reaching > 0.0, 1.0 - efficiency, 1.0 - 1.0 / efficiency) * reaching
        assert (lost >= -1e-15).all()
        assert np.abs(lost - expected).sum() < 1e-3 * expected.sum()

    def test_direct_drive_without_losses_is_power_in_is_power_out(self) -> None:
        run = held(FREE, 1.0, actuation=self.gears(1.0), energy=True)
        assert run.extra["work.motor"][-1, 0] == pytest.approx(run.extra["work.link"][-1, 0], rel=1e-12)

    def test_it_changes_in_a_run(self) -> None:
        law = taut.compile(taut.laws.PID(kp=1e-9), HANGING)
        plant = taut.RigidPlant(HANGING, actuation=self.gears(0.8))
        greased = [taut.Event(t=0.1, set={"actuation.transmission.efficiency": 0.99})]
        run = taut.run(law, plant, taut.JointMotion(q=[1.1e9 * WEIGHT]), duration=0.2, q0=[0.0], events=greased)
        assert not run.v[:100].any()
        assert run.v[-1, 0] > 0.0


class TestElasticity:
    K, D = 800.0, 0.6

    def swing(self, substeps: int) -> taut.Run:
        spring = taut.drives.Transmission(stiffness=self.K, damping=self.D)
        plant = taut.RigidPlant(GEARED, actuation=taut.drives.Actuation(transmission=spring), substeps=substeps)
        return taut.run(idle(GEARED), plant, duration=0.6, q0=[0.0], v0=[1.0])

    def test_motor_and_link_swing_against_each_other_as_two_masses_on_a_spring_do(self) -> None:
        """The motor starts with the link's speed, then stops: no; here both start together, so a push sets them off."""
        spring = taut.drives.Transmission(stiffness=self.K, damping=self.D)
        plant = taut.RigidPlant(GEARED, actuation=taut.drives.Actuation(transmission=spring), substeps=20)
        law = taut.compile(taut.laws.PID(kp=1e-9), GEARED)
        run = taut.run(law, plant, taut.JointMotion(q=[1e9]), duration=0.5, q0=[0.0])
        B, M = 0.25, 0.5

        def two_masses(t: float, y: Float64Array) -> list[float]:
            q, v, q_m, v_m = y
            pull = self.K * (q_m - q) + self.D * (v_m - v)
            return [v, pull / M, v_m, (1.0 - pull) / B]

        exact = solve_ivp(two_masses, (0.0, 0.5), np.zeros(4), t_eval=run.t, rtol=1e-11, atol=1e-13).y
        np.testing.assert_allclose(run.v[:, 0], exact[1], rtol=0.0, atol=2e-3 * np.abs(exact[1]).max())

    def test_it_converges_with_the_order_of_the_integrator(self) -> None:
        fine = self.swing(320).q[-1, 0]
        errors = [abs(self.swing(k).q[-1, 0] - fine) for k in (5, 10)]
        assert errors[0] < 1e-9 or 1.6 < errors[0] / errors[1] < 2.5

    def test_the_weight_of_the_link_winds_it_up_from_the_start(self) -> None:
        arm = HANGING.with_gears(ratio=50.0, motor_inertia=1e-4)
        spring = taut.drives.Transmission(stiffness=self.K)
        plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(transmission=spring), substeps=4)
        law = taut.compile(taut.laws.GravityPID(kp=0.0, kd=0.0), arm)
        run = taut.run(law, plant, duration=1.0, q0=[0.0])
        assert np.abs(run.v).max() < 1e-9

    def test_a_gear_that_loses_power_makes_the_rotor_light_and_asks_for_shorter_steps(self) -> None:
        """A motor that drives: 0.1 of the rotor on the spring, and so 10 times its K / B."""
        law, push = taut.compile(taut.laws.PID(kp=1e-9), GEARED), taut.JointMotion(q=[2e9])
        for efficiency, substeps, too_long in ((1.0, 1, False), (0.1, 1, True), (0.1, 20, False)):
            drives = taut.drives.Actuation(
                transmission=taut.drives.Transmission(efficiency=efficiency, stiffness=1.3e5)
            )
            plant = taut.RigidPlant(GEARED, actuation=drives, substeps=substeps)
            if too_long:
                with refused(taut.errors.RangeError):
                    taut.run(law, plant, push, duration=1.0, q0=[0.0], v0=[1.0])
                continue
            run = taut.run(law, plant, push, duration=1.0, q0=[0.0], v0=[1.0])
            a = efficiency * 2.0 / (0.5 + efficiency * 0.25)  # of both together
            assert run.v[-1, 0] == pytest.approx(1.0 + a, rel=0.01)

    def test_a_very_stiff_one_is_a_rigid_one(self) -> None:
        stiff = taut.drives.Transmission(stiffness=4e5, damping=50.0)
        law = taut.compile(taut.laws.PID(kp=20.0, kd=4.0), GEARED)
        ref, arm = taut.JointMotion(q=[0.5]), GEARED
        soft = taut.RigidPlant(arm, actuation=taut.drives.Actuation(transmission=stiff), substeps=20)
        a = taut.run(law, soft, ref, duration=1.0, q0=[0.0])
        b = taut.run(law, taut.RigidPlant(arm, substeps=20), ref, duration=1.0, q0=[0.0])
        np.testing.assert_allclose(a.q, b.q, rtol=0.0, atol=2e-4)

    def test_joints_of_infinite_stiffness_are_rigid(self) -> None:
        arm = taut.load_arm("planar2").with_gears(ratio=10.0, motor_inertia=1e-3)
        law = taut.compile(taut.laws.PID(kp=30.0, kd=5.0), arm)

        def run_of(transmission: taut.drives.Transmission | None) -> taut.Run:
            drives = taut.drives.Actuation(transmission=transmission)
            plant = taut.RigidPlant(arm, actuation=drives, substeps=10)
            return taut.run(law, plant, taut.JointMotion(q=arm.home + 0.1), duration=0.5)

        rigid, one = run_of(None), run_of(taut.drives.Transmission(stiffness=[np.inf, 200.0]))
        assert np.abs(rigid.q - one.q).max() > 1e-3
        np.testing.assert_array_equal(run_of(taut.drives.Transmission(stiffness=[np.inf, np.inf])).q, rigid.q)

    def test_steps_that_are_too_long_for_it_are_refused_with_how_many_are_enough(self) -> None:
        spring = taut.drives.Transmission(stiffness=1e6)
        plant = taut.RigidPlant(GEARED, actuation=taut.drives.Actuation(transmission=spring))
        with refused(taut.errors.RangeError):
            taut.run(idle(GEARED), plant, duration=0.1)
        plenty = taut.RigidPlant(GEARED, actuation=taut.drives.Actuation(transmission=spring), substeps=3)
        assert taut.run(idle(GEARED), plenty, duration=0.1).outcome.ok


class TestPlay:
    """Motor and link with a dead band between them."""

    K, D, PLAY = 2000.0, 0.5, 0.02
    TEETH = taut.drives.Transmission(stiffness=K, damping=D, backlash=PLAY)

    def cycle(self, kp: float, kd: float, rate: float = 5000.0) -> taut.Run:
        plant = taut.RigidPlant(GEARED, actuation=taut.drives.Actuation(transmission=self.TEETH), substeps=4)
        law = taut.compile(taut.laws.PID(kp=kp, kd=kd), GEARED, rate=rate)
        return taut.run(law, plant, taut.JointMotion(q=[0.0]), duration=12.0, q0=[0.2])

    @pytest.mark.long
    def test_the_limit_cycle_under_pd_is_that_of_event_accurate_integration(self) -> None:
        kp, kd, B, M, half = 40.0, 2.0, 0.25, 0.5, 0.5 * self.PLAY

        def motion(t: float, y: Float64Array) -> list[float]:
            q, v, q_m, v_m = y
            delta = q_m - q
            z = delta - min(max(delta, -half), half)
            pull = 0.0 if z == 0.0 else self.K * z + self.D * (v_m - v)
            pull = max(pull, 0.0) if z > 0.0 else min(pull, 0.0)
            return [v, pull / M, v_m, (-kp * q - kd * v - pull) / B]

        t = np.arange(0.0, 12.0, 2e-4)
        exact = solve_ivp(motion, (0.0, 12.0), [0.2, 0.0, 0.2, 0.0], t_eval=t, rtol=1e-9, atol=1e-11, max_step=1e-3)
        expected, ours = cycle_of(t, exact.y[0]), cycle_of(t, self.cycle(kp, kd).q[: len(t), 0])
        assert expected[0] > 0.01  # it does not die out
        assert ours == pytest.approx(expected, rel=0.02)

    def test_a_link_between_its_teeth_moves_freely(self) -> None:
        plant = taut.RigidPlant(
            GEARED, actuation=taut.drives.Actuation(transmission=self.TEETH), substeps=4, energy=True
        )
        run = taut.run(idle(GEARED), plant, duration=0.05, q0=[0.0], v0=[0.0])
        assert not run.v.any()
        push = [0.01]  # slower than the play is wide
        memory = plant.start(np.zeros(1), np.array(push), plant.parameters, 1e-3)
        memory["v_motor"] = np.zeros(1)
        for _ in range(100):
            memory = plant.advance(plant.command(np.zeros(1), memory, 0.0), plant.parameters, 1e-3)
            assert memory["tau_link"][0] == pytest.approx(0.0, abs=1e-12)
        assert memory["q"][0] == pytest.approx(0.001, rel=1e-9)
        assert memory["v_motor"][0] == 0.0

    def test_teeth_push_and_never_pull(self) -> None:
        run = self.cycle(40.0, 2.0)
        assert run.outcome.ok
        p = {name: np.asarray(value) for name, value in self.TEETH.parameters().items()}
        delta, rate = np.array([0.0101, 0.0101, -0.0101, 0.0]), np.array([0.0, -50.0, 50.0, 5.0])
        torque = self.TEETH.torque(delta, rate, p)
        np.testing.assert_allclose(torque, [0.2, 0.0, 0.0, 0.0], atol=1e-12)

    def test_the_load_lies_on_one_side_of_its_teeth_from_the_start(self) -> None:
        arm = HANGING.with_gears(ratio=50.0, motor_inertia=1e-4)
        plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(transmission=self.TEETH), substeps=4)
        law = taut.compile(taut.laws.GravityPID(kp=0.0, kd=0.0), arm)
        assert np.abs(taut.run(law, plant, duration=0.5, q0=[0.0]).v).max() < 1e-9

    def test_a_weight_of_rounding_does_not_choose_the_side(self) -> None:
        """The base of an upright arm carries one whose sign may be another in machine code."""
        panda = taut.load_arm("panda")
        gears = taut.drives.Transmission(stiffness=[2e4, *[math.inf] * 6], backlash=[0.01, *[0.0] * 6])
        arm, elsewhere = panda.with_joints(rotor_inertia=0.3), np.random.default_rng(0).uniform(-0.5, 0.5, (20, 7))
        plant = taut.RigidPlant(arm, actuation=taut.drives.Actuation(transmission=gears), substeps=8)
        weights = [taut.dynamics.gravity_torque(plant.model, arm.home + q)[0] for q in elsewhere]
        assert min(weights) < 0.0 < max(weights) < 1e-12
        for q in arm.home + elsewhere:
            wound = plant.start(q, 0.0 * q, plant.parameters, 1e-3)["q_motor"][0] - q[0]
            assert abs(wound - 0.005) < 1e-9


def cycle_of(t: Float64Array, q: Float64Array) -> tuple[float, float]:
    """Amplitude and period in the last quarter of a motion."""
    tail = q[3 * len(q) // 4 :]
    x = tail - tail.mean()
    ups = np.flatnonzero((x[1:] > 0.0) & (x[:-1] <= 0.0))
    return float(np.ptp(tail)) / 2.0, float(np.diff(ups).mean() * (t[1] - t[0])) if len(ups) > 2 else math.inf


class TestMessages:
    @pytest.mark.parametrize(
        ("make", "kind", "name"),
        [
            (lambda: taut.drives.Transmission(efficiency=1.2), taut.errors.RangeError, "efficiency"),
            (lambda: taut.drives.Transmission(efficiency=[0.8, 0.0]), taut.errors.RangeError, "efficiency"),
            (lambda: taut.drives.Transmission(stiffness=0.0), taut.errors.RangeError, "stiffness"),
            (lambda: taut.drives.Transmission(backlash=0.01), taut.errors.UsageError, "backlash"),
            (lambda: taut.drives.Transmission(stiffness=1e3, backlash=-0.01), taut.errors.RangeError, "backlash"),
            (lambda: taut.RigidPlant(FREE, actuation=taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=1e3))), taut.errors.UsageError, "stiffness"),
            (lambda: taut.RigidPlant(GEARED, integrator="rk4", actuation=taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=1e3))), taut.errors.UsageError, "integrator"),
            (lambda: taut.RigidPlant(GEARED, integrator="rk4", actuation=taut.drives.Actuation(transmission=taut.drives.Transmission(efficiency=0.9))), taut.errors.UsageError, "integrator"),
            (lambda: taut.RigidPlant(GEARED, integrator="rk4", energy=True), taut.errors.UsageError, "energy"),
            (lambda: taut.RigidPlant(GEARED, energy=1), taut.errors.UsageError, "energy"),  # type: ignore[arg-type]
            (lambda: taut.RigidPlant(GEARED, takes="velocity", actuation=taut.drives.Actuation(bandwidth=50.0, transmission=taut.drives.Transmission())), taut.errors.UsageError, "actuation.transmission"),
            (lambda: taut.drives.Actuation(transmission=0.8), taut.errors.UsageError, "transmission"),  # type: ignore[arg-type]
            (lambda: FREE.with_gears(ratio=0.0, motor_inertia=1e-4), taut.errors.RangeError, "ratio"),
        ],
    )  # fmt: skip
    def test_what_no_gear_is_is_refused_by_its_name(self, make: Any, kind: type[taut.TautError], name: str) -> None:
        with pytest.raises(kind) as caught:
            make()
        assert caught.value.name == name
