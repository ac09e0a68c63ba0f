"""Section 10.2.2: the closed loops of whole arms, as their laws' docstrings state them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from runtime_laws import Array

import taut

PANDA = taut.load_arm("panda").with_joints(viscous=0.0)
HOME = taut.JointMotion(q=PANDA.home)
# The wrist's inertia is a thousandth of the shoulder's: what damps the one would drive the other wild at a millisecond.
KP = np.array([50.0, 50.0, 50.0, 50.0, 5.0, 5.0, 2.0])
KD = np.array([15.0, 15.0, 15.0, 15.0, 0.6, 0.6, 0.2])
START = PANDA.home + np.array([0.05, -0.04, 0.03, 0.05, -0.02, 0.04, -0.05])


def run(
    law: taut.Law,
    arm: taut.Arm,
    ref: object,
    *,
    rate: float = 1000.0,
    duration: float = 1.0,
    model: taut.Arm | None = None,
    q0: object = None,
    v0: object = None,
    **plant: object,
) -> taut.Run:
    made = taut.RigidPlant(arm, **plant)  # type: ignore[arg-type]
    ctrl = taut.compile(law, model or arm, rate=rate, adds=made.adds)
    out = taut.run(ctrl, made, ref, duration=duration, q0=q0, v0=v0)
    assert out.outcome.ok, out.outcome
    return out


class TestComputedTorqueOnThePanda:
    """Equation 10.17: e_ddot + kd e_dot + kp e = 0 for each joint, whatever the others do."""

    KP, KD = 100.0, 20.0

    def tick(self, dt: float) -> Array:
        """Semi-implicit Euler of q_ddot = -kp q - kd v, exactly what an exact model leaves of the arm."""
        v = np.array([-dt * self.KP, 1.0 - dt * self.KD])
        return np.array([np.array([1.0, 0.0]) + dt * v, v])

    @pytest.mark.parametrize("rate", [1000.0, 200.0])
    def test_every_joints_error_is_the_designed_response_of_the_sampled_loop(self, rate: float) -> None:
        out = run(taut.laws.ComputedTorque(kp=self.KP, kd=self.KD), PANDA, HOME, rate=rate, q0=START)
        A = self.tick(1.0 / rate)
        for joint in range(7):
            x = np.array([START[joint] - PANDA.home[joint], 0.0])
            expected = np.empty(len(out))
            for k in range(len(out)):
                expected[k], x = x[0], A @ x
            # Rounding of the arm's torques, a tenth of a billionth of the start.
            np.testing.assert_allclose(-out.error[:, joint], expected, rtol=0.0, atol=1e-11)

    def test_the_response_tends_to_the_design_as_the_tick_falls(self) -> None:
        """A critically damped response: e0 (1 + 10 t) exp(-10 t)."""
        errors = []
        for rate in (1e3, 1e4):
            out = run(taut.laws.ComputedTorque(kp=self.KP, kd=self.KD), PANDA, HOME, rate=rate, q0=START)
            design = np.outer((1.0 + 10.0 * out.t) * np.exp(-10.0 * out.t), PANDA.home - START)
            errors.append(np.abs(out.error - design).max())
        assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.05)
        assert errors[1] < 1e-4

    def test_a_joint_that_is_pushed_leaves_the_others_where_they_are(self) -> None:
        start = PANDA.home + 0.5 * np.eye(7)[3]
        out = run(taut.laws.ComputedTorque(kp=self.KP, kd=self.KD), PANDA, HOME, q0=start)
        others = np.delete(out.error, 3, axis=1)
        assert np.abs(out.error[:, 3]).max() == 0.5
        assert np.abs(others).max() < 1e-12
        pid = run(taut.laws.GravityPID(kp=KP, kd=KD), PANDA, HOME, q0=start)
        assert np.abs(np.delete(pid.error, 3, axis=1)).max() > 1e-3  # which PD and gravity alone do not

    def test_it_follows_a_fast_motion_as_well_as_a_set_point(self) -> None:
        wave = taut.trajectories.Sine(center=PANDA.home, amplitude=0.3, frequency=np.linspace(0.3, 1.0, 7))
        start = wave.at(0.0)
        out = run(taut.laws.ComputedTorque(kp=self.KP, kd=self.KD), PANDA, wave, rate=5000.0, q0=start.q, v0=start.v)
        assert np.abs(out.v).max() > 1.0
        assert np.abs(out.error).max() < 5e-4  # half a tick of velocity, over what kp and kd leave of it

    def test_joints_that_wrap_go_the_short_way_round(self) -> None:
        kinova = taut.load_arm("kinova").with_joints(viscous=0.0)
        wraps = np.isin(np.arange(6), kinova.continuous)
        goal = np.array(kinova.home) + wraps * (2.0 * np.pi - 0.3)
        out = run(taut.laws.ComputedTorque(kp=100.0, kd=20.0), kinova, taut.JointMotion(q=goal), duration=3.0)
        np.testing.assert_allclose(out.q[-1] - out.q[0], -0.3 * wraps, rtol=0.0, atol=1e-6)

    def test_per_joint_and_matrix_gains_are_each_joints_own_loop(self) -> None:
        kp, kd = np.linspace(50.0, 200.0, 7), 2.0 * np.sqrt(np.linspace(50.0, 200.0, 7))
        vector = run(taut.laws.ComputedTorque(kp=kp, kd=kd), PANDA, HOME, q0=START)
        matrix = run(taut.laws.ComputedTorque(kp=np.diag(kp), kd=np.diag(kd)), PANDA, HOME, q0=START)
        np.testing.assert_allclose(vector.q, matrix.q, rtol=0.0, atol=1e-12)
        for joint in range(7):
            omega = np.sqrt(kp[joint])
            design = (PANDA.home - START)[joint] * (1.0 + omega * vector.t) * np.exp(-omega * vector.t)
            assert np.abs(vector.error[:, joint] - design).max() < 1e-3

    def test_an_inexact_model_leaves_an_error_that_the_integral_takes_away(self) -> None:
        model = PANDA.perturbed(seed=3, mass=0.2)
        errors = []
        for ki in (0.0, 200.0):
            law = taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=ki)
            out = run(law, PANDA, HOME, model=model, duration=6.0, q0=START)
            errors.append(np.abs(out.error[-1]).max())
        assert errors[0] > 1e-2
        assert errors[1] < 1e-5


class TestGravityPIDAtASetPoint:
    """Equations 10.23 to 10.27: V = e kp e / 2 + v M v / 2 falls by v kd v; the arm comes to rest at the goal."""

    def V(self, out: taut.Run) -> Array:
        kinetic = [0.5 * v @ taut.snapshot(PANDA, q).M @ v for q, v in zip(out.q, out.v, strict=True)]
        return 0.5 * np.sum(KP * out.error**2, axis=1) + np.array(kinetic)

    @pytest.mark.part(1)
    @pytest.mark.parametrize("seed", [0, 1])
    def test_the_error_energy_never_increases(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        q0, v0 = PANDA.home + 0.5 * rng.normal(size=7), rng.normal(size=7)
        law = taut.laws.GravityPID(kp=KP, kd=KD)
        # A tight tick, rk4: the torque is held for 0.1 ms, which the damping has to spare.
        out = run(law, PANDA, HOME, rate=10000.0, duration=0.4, q0=q0, v0=v0, integrator="rk4")
        every = slice(None, None, 4)
        V = self.V(run_rows(out, every))
        assert (np.diff(V) <= 0.0).all()
        # It falls by the work of the damper.
        power = np.sum(KD * out.v**2, axis=1)
        lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]))])[every] * 1e-4
        np.testing.assert_allclose(V[0] - V, lost, rtol=0.0, atol=0.02 * V[0])

    def test_the_arm_comes_to_rest_at_the_goal_from_far_away(self) -> None:
        q0 = PANDA.home + np.array([1.5, 0.8, -1.0, 1.2, 0.9, 1.1, -2.0])
        out = run(taut.laws.GravityPID(kp=KP, kd=KD), PANDA, HOME, duration=15.0, q0=q0)
        assert np.abs(out.error[-1]).max() < 1e-6
        assert np.abs(out.v[-1]).max() < 1e-6

    def test_gravity_that_is_not_compensated_keeps_it_from_the_goal(self) -> None:
        out = run(taut.laws.PID(kp=KP, kd=KD), PANDA, HOME, duration=15.0, q0=START)
        sag = np.linalg.norm(out.error[-1])
        assert sag > 0.1
        # Where it rests the springs carry the weight.
        np.testing.assert_allclose(KP * out.error[-1], taut.snapshot(PANDA, out.q[-1]).g, rtol=0.0, atol=1e-4)


def run_rows(out: taut.Run, rows: slice) -> taut.Run:
    """Some rows of a run: true states and reference."""
    ref = taut.JointMotion.of({name: getattr(out.reference, name)[rows] for name in ("q", "v", "a")})
    return dataclasses.replace(out, t=out.t[rows], q=out.q[rows], v=out.v[rows], reference=ref)


class TestDecentralisedControl:
    """Section 10.2.2.1: where the dynamics are decoupled, one controller per joint is all there is."""

    def test_a_gantry_is_three_single_joints(self) -> None:
        gantry = taut.load_arm("gantry3")
        kp, kd, ki = np.array([900.0, 500.0, 300.0]), np.array([200.0, 100.0, 60.0]), np.array([300.0, 100.0, 50.0])
        goal = np.array([0.2, -0.1, 0.15])
        law = taut.laws.PID(kp=kp, kd=kd, ki=ki)
        whole = run(law, gantry, taut.JointMotion(q=goal), duration=2.0)
        for i, name in enumerate(gantry.joint_names):
            single = gantry.subset([name])
            alone = taut.laws.PID(kp=kp[i], kd=kd[i], ki=ki[i])
            part = run(alone, single, taut.JointMotion(q=goal[i : i + 1]), duration=2.0)
            assert np.abs(whole.q[:, i] - part.q[:, 0]).max() < 1e-12
            assert np.abs(whole.tau[:, i] - part.tau[:, 0]).max() < 1e-12 * np.abs(part.tau).max()

    def test_gearing_decouples_an_arm(self) -> None:
        """Large reflected inertia makes M nearly diagonal: section 10.2.2.1's approximate decoupling."""
        plain = taut.load_arm("planar3", gravity=[0.0, 0.0, 0.0]).with_joints(viscous=0.0)
        geared = plain.with_joints(rotor_inertia=100.0)
        start = np.array(plain.home) + np.array([0.3, 0.0, 0.0])
        goal = taut.JointMotion(q=plain.home)
        crosstalk = []
        for arm, scale in ((plain, 1.0), (geared, 50.0)):
            law = taut.laws.PID(kp=40.0 * scale, kd=np.array([20.0, 10.0, 1.0]) * scale)
            out = run(law, arm, goal, duration=2.0, q0=start)
            crosstalk.append(np.abs(out.error[:, 1:]).max() / 0.3)
        assert crosstalk[0] > 0.03
        assert crosstalk[1] < 0.1 * crosstalk[0]


class TestTheTorqueRateLimit:
    """It starts from the torque that holds the arm, so that nothing drops when it is switched on."""

    LIMITS = taut.Limits(tau_dot=2000.0)
    LAW = taut.laws.GravityPID(kp=[500.0] * 3 + [50.0] * 3, kd=[50.0] * 3 + [2.0, 2.0, 0.5])

    def test_does_not_let_a_heavy_arm_drop_at_the_start(self) -> None:
        arm = taut.load_arm("ur10").with_payload(5.0)
        ctrl = taut.compile(self.LAW, arm, limits=self.LIMITS)
        out = taut.run(ctrl, taut.RigidPlant(arm), duration=0.5)
        np.testing.assert_allclose(out.tau[0], taut.snapshot(arm, arm.home).g, rtol=1e-12, atol=1e-12)
        assert np.abs(out.error).max() < 1e-9

    def test_keeps_every_step_within_its_rate(self) -> None:
        arm = taut.load_arm("ur10")
        ctrl = taut.compile(self.LAW, arm, limits=self.LIMITS)
        goal = taut.JointMotion(q=arm.home + 0.3)
        out = taut.run(ctrl, taut.RigidPlant(arm), goal, duration=1.0)
        assert np.abs(np.diff(out.tau, axis=0)).max() <= 2.0 * (1.0 + 1e-9)
        assert np.abs(out.terms["rate_limit"]).max() > 10.0
        assert np.abs(out.tau[0] - taut.snapshot(arm, arm.home).g).max() <= 2.0 * (1.0 + 1e-9)

    def test_told_that_the_plant_holds_nothing_it_starts_from_nothing_and_the_arm_drops(self) -> None:
        """What reset(tau_applied=) is for, and what happens when it is told wrong."""
        arm = taut.load_arm("ur10").with_payload(5.0)
        plant, limits = taut.RigidPlant(arm), taut.Limits(tau_dot=300.0)
        dropped = {}
        for name, held in (("gravity", None), ("nothing", np.zeros(6))):
            ctrl = taut.compile(self.LAW, arm, limits=limits)
            ctrl.reset(tau_applied=held)
            own, lowest = plant.parameters, 0.0
            memory = plant.start(np.array(arm.home), np.zeros(6), own, ctrl.dt)
            height = taut.snapshot(arm, arm.home).T().p[2]
            for k in range(400):
                measured = plant.measure(memory, {}, own)
                tau = ctrl.step(measured["q"], measured["v"], taut.JointMotion(q=arm.home))
                if k == 0:
                    first = np.zeros(6) if held is not None else taut.snapshot(arm, arm.home).g
                    assert np.abs(tau - first).max() <= 0.3 * (1.0 + 1e-9)
                memory = plant.advance(plant.command(tau, memory, k * ctrl.dt), own, ctrl.dt)
                if k % 20 == 0:
                    lowest = min(lowest, taut.snapshot(arm, memory["q"]).T().p[2] - height)
            dropped[name] = -lowest
        assert dropped["gravity"] < 1e-9
        assert dropped["nothing"] > 0.05
