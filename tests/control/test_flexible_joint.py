"""Laws of flexible joints against the plant's equations, closed forms, and the figures of section 10.6."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused, warned
from scipy.linalg import eigh

import taut
import taut.math as tm
from taut.base.types import Float64Array
from taut.control.laws.other_topics.flexible_joint import desired_motor, spring_torque
from taut.control.trajectories.reference import rows_of
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.trajectories import SmoothMotion

FREE = taut.Friction()
PLANAR2 = taut.load_arm("planar2").with_joints(rotor_inertia=[0.3, 0.1]).with_friction(FREE)
PANDA = taut.load_arm("panda").with_joints(rotor_inertia=[0.6] * 4 + [0.2] * 3).with_friction(FREE)
UR10 = taut.load_arm("ur10").with_joints(rotor_inertia=[1.0] * 3 + [0.3] * 3).with_friction(FREE)
ONE = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0]).with_joints(rotor_inertia=0.2).with_friction(FREE)
LOADED = {mass: PLANAR2.with_payload(mass) for mass in (0.1, 0.5)}
SENSORS = taut.sensors.Sensors(
    motor=taut.sensors.Encoder(), motor_velocity=taut.sensors.Tachometer(), torque=taut.sensors.TorqueSensor()
)
CT = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
MOTORS_ALONE, LINKS_ALONE = "motors alone", "links alone"  # what a law of rigid joints takes for q and v
ROW = 0.02  # of the figures of section 10.6
Figures = tuple[float, float]


def reference(arm: taut.Arm, A: list[float], f: list[float], speed: float = 1.0) -> taut.trajectories.Sine:
    """From rest at home: home + A/2 (1 - cos 2 pi f t)."""
    half = 0.5 * np.array(A)
    return taut.trajectories.Sine(
        center=arm.home + half, amplitude=half, frequency=speed * np.array(f), phase=-0.5 * np.pi
    )


def of_planar2(speed: float = 1.0) -> taut.trajectories.Sine:
    return reference(PLANAR2, [0.8, -0.6], [0.5, 0.7], speed)


def of_panda() -> taut.trajectories.Sine:
    A = 0.6 * np.array([0.5, 0.4, -0.5, 0.6, 0.5, -0.6, 0.8])
    return reference(PANDA, A.tolist(), [0.5, 0.4, 0.6, 0.5, 0.7, 0.6, 0.5])


@functools.lru_cache
def spring_period(arm: taut.Arm, h: float, substeps: int) -> Any:
    """Motion of links and motors in a period, of (q, v, q_motor, v_motor), tau, K, D and B: RK4, one code per arm."""
    n, model, payload = arm.n, model_of(arm.with_joints(rotor_inertia=0.0)), PayloadValues.of(arm.payload)

    def period(y: Float64Array, tau: Float64Array, K: Float64Array, D: Any, B: Float64Array) -> Float64Array:
        def rates(y: Float64Array) -> Float64Array:
            q, v, q_m, v_m = (y[k * n : (k + 1) * n] for k in range(4))
            spring = K * (q_m - q) + D * (v_m - v)
            a = dyn.forward_dynamics(model, q, v, spring, payload)
            return tm.array([*v, *a, *v_m, *((tau - spring) / B)])

        for _ in range(substeps):
            k1 = rates(y)
            k2 = rates(y + 0.5 * h * k1)
            k3 = rates(y + 0.5 * h * k2)
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(y + h * k3))
        return y

    return taut.native(period, y=4 * n, tau=n, K=n, D=(), B=n)


def followed(
    law: taut.Law,
    arm: taut.Arm,
    K: Any,
    ref: Any,
    *,
    D: float = 0.0,
    seen: str = "both",
    true: taut.Arm | None = None,
    duration: float = 4.0,
    rate: float = 1000.0,
    off: float = 0.0,
    substeps: int = 2,
) -> Float64Array:
    """(k, n) error of the links, of Spong's equations by RK4, all measured exactly at the tick; inf where it is lost.

    The motors start with the spring torque of the reference and its rate, in a law of rigid joints with gravity's.
    """
    n, B, K = arm.n, arm.rotor_inertia, K * np.ones(arm.n)
    links = (true or arm).with_joints(rotor_inertia=0.0)
    advance = spring_period(true or arm, 1.0 / (rate * substeps), substeps)
    k = taut.compile(law, arm, rate=rate).bind()
    ticks = round(duration * rate)
    table: Any = rows_of(ref, np.arange(ticks) / rate, SmoothMotion)
    rows = [taut.JointMotion.of({name: getattr(table, name)[i] for name in "qvajs"}) for i in range(ticks)]
    first = rows[0]
    q = first.q + off
    x = taut.snapshot(links, q, first.v)
    if seen == "both":
        tau, spring_rate, _ = spring_torque(x, q, first.v, first.a, first.j, first.s)
        y = np.concatenate([q, first.v, q + tau / K, first.v + spring_rate / K])
    else:
        y = np.concatenate([q, first.v, q + x.g / K, first.v])
    errors = np.full((ticks, n), np.inf)
    for i, row in enumerate(rows):
        q, v, q_m, v_m = y.reshape(4, n)
        if not np.abs(y).max() < 1e4:
            break
        k.q[:], motor = (q_m if seen == MOTORS_ALONE else q), (q_m, v_m)
        if len(k.v):
            k.v[:] = v_m if seen == MOTORS_ALONE else v
        for array, values in ((k.q_motor, motor[0]), (k.v_motor, motor[1])):
            if len(array):
                array[:] = values
        if len(k.tau_meas):
            k.tau_meas[:] = K * (q_m - q) + D * (v_m - v)
        for field in "qvajs":
            if (array := getattr(k.ref, field)) is not None and len(array):
                array[:] = getattr(row, field)
        k.tick()
        errors[i] = row.q - q
        y = advance(y, k.command, K, np.array(D), B)
    return errors


def figures(errors: Float64Array) -> Figures:
    """Largest error of a joint, and root of the mean square of |e| from 1 s on [mrad]."""
    tail = errors[len(errors) // 4 :]
    return 1e3 * float(np.abs(errors).max()), 1e3 * math.sqrt(float((tail**2).sum(axis=1).mean()))


K2, K7 = np.array([1000.0, 400.0]), np.array([4000.0] * 4 + [1500.0] * 3)


def motor_side(K: Any) -> taut.Law:
    return taut.laws.MotorSidePD(stiffness=K, kp=100.0, kd=20.0)


def fast(bandwidth: float, K: Any) -> taut.Law:
    return taut.laws.FastTorqueLoop(law=CT, stiffness=K, bandwidth=bandwidth)


def linearising(omega: float, K: Any) -> taut.Law:
    return taut.laws.FlexibleJointLinearisation(stiffness=K, omega=omega)


LONG = dict.fromkeys(("rigid", "fast 80", "fast 200", "linearised 15"), pytest.mark.long)


class TestFigures:
    """Acceptance 4b: two arms, 4 s of the reference, no friction [mrad]."""

    ROWS = (
        ("rigid", CT, (25.9, 16.5), (47.4, 28.7), 5.87),
        ("motor side", motor_side, (0.389, 0.268), (1.42, 0.80), 0.073),
        ("fast 80", lambda K: fast(80.0, K), (18.1, None), (68.9, None), 14.2),
        ("fast 200", lambda K: fast(200.0, K), (7.0, None), (24.2, None), 5.7),
        ("linearised 15", lambda K: linearising(15.0, K), (4.02, None), (15.1, None), 17.9),
        ("linearised 30", lambda K: linearising(30.0, K), (0.277, None), (1.34, None), 1.10),
    )

    @pytest.mark.part(1)
    @pytest.mark.parametrize("row", [pytest.param(row, id=row[0], marks=LONG.get(row[0], ())) for row in ROWS])
    def test_of_a_two_link_arm_and_of_a_panda(self, row: Any) -> None:
        _, law, slow, quick, panda = row
        made = law if isinstance(law, taut.Law) else None
        seen = "both" if made is None else MOTORS_ALONE
        for speed, expected in ((1.0, slow), (2.0, quick)):
            found = figures(followed(made or law(K2), PLANAR2, K2, of_planar2(speed), seen=seen))
            for number, figure in zip(found, expected, strict=True):
                assert figure is None or number == pytest.approx(figure, rel=ROW)
        found = figures(followed(made or law(K7), PANDA, K7, of_panda(), seen=seen))
        assert found[0] == pytest.approx(panda, rel=ROW)

    @pytest.mark.parametrize("stiffer", [1.0, 16.0])
    def test_computed_torque_on_link_measurements_is_lost(self, stiffer: float) -> None:
        for arm, K, ref in ((PLANAR2, K2, of_planar2()), (PANDA, K7, of_panda())):
            errors = followed(CT, arm, stiffer * K, ref, seen=LINKS_ALONE, duration=2.0)
            assert not np.isfinite(errors).all() or np.abs(errors).max() > 1.0

    @pytest.mark.long
    def test_a_payload_that_is_not_known(self) -> None:
        expected = {
            (0.1, 15.0): 454.0, (0.5, 15.0): math.inf, (0.1, 30.0): 7.2, (0.5, 30.0): 38.3, (0.1, None): 26.0,
            (0.5, None): 133.0,
        }  # fmt: skip
        for (mass, omega), figure in expected.items():
            law = motor_side(K2) if omega is None else linearising(omega, K2)
            found = figures(followed(law, PLANAR2, K2, of_planar2(), true=LOADED[mass]))[0]
            assert found == pytest.approx(figure, rel=ROW)

    @pytest.mark.long
    def test_the_error_of_the_fast_torque_loop_falls_with_its_bandwidth_on_a_ur10(self) -> None:
        arm, K, ref = (
            UR10.with_payload(3.0),
            np.array([4000.0] * 3 + [1000.0] * 3),
            reference(UR10, [0.4] * 6, [0.5] * 6),
        )
        errors = [figures(followed(fast(w, K), arm, K, ref, duration=2.0))[0] for w in (100.0, 200.0)]
        assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.05)

    def test_the_error_of_the_fast_torque_loop_falls_with_its_bandwidth(self) -> None:
        errors = [figures(followed(fast(w, K2), PLANAR2, K2, of_planar2(), duration=2.0))[0] for w in (100.0, 200.0)]
        assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.3)
        assert figures(followed(fast(400.0, K2), PLANAR2, K2, of_planar2()))[0] == pytest.approx(3.5, rel=ROW)


def elastic(arm: taut.Arm, K: Any, *, D: Any = 0.0, substeps: int = 10, **drives: Any) -> taut.RigidPlant:
    spring = taut.drives.Transmission(stiffness=K, damping=D)
    actuation = taut.drives.Actuation(transmission=spring, **drives)
    return taut.RigidPlant(arm, friction=None, actuation=actuation, substeps=substeps, sensors=SENSORS)


class TestResonance:
    """Acceptance 4a: poles and zeros of the torque of the motors to their positions."""

    @staticmethod
    def found(
        arm: taut.Arm, K: Any, law: taut.Law | None = None, at: Any = None
    ) -> tuple[Float64Array, Float64Array]:
        ctrl = taut.compile(law or taut.laws.PID(kp=0.0), arm)
        lin = taut.linearise(taut.Loop(ctrl, elastic(arm, K), duration=1.0), at=at)
        zeros = lin.s_zeros(input="disturbance.command", output="plant.q_motor")
        return lin.omega_n, np.sort(zeros.imag[(zeros.imag > 0.0) & (zeros.imag < 3000.0)])

    def test_of_one_joint(self) -> None:
        poles, zeros = self.found(ONE, 500.0)
        assert poles.max() == pytest.approx(59.1608, rel=1e-4)
        assert zeros == pytest.approx([31.6228], rel=1e-4)

    def test_of_two_joints(self) -> None:
        arm = taut.load_arm("planar2", gravity=[0.0, 0.0, 0.0]).with_joints(rotor_inertia=[0.3, 0.1])
        poles, zeros = self.found(arm.with_friction(FREE), K2)
        assert np.unique(poles[poles > 1.0].round(6)) == pytest.approx([66.197, 91.453], rel=2e-4)
        assert zeros == pytest.approx([31.919, 66.284], rel=2e-4)

    def test_feedback_moves_the_poles_and_not_the_zeros(self) -> None:
        free, held = self.found(ONE, 500.0), self.found(ONE, 500.0, taut.laws.PID(kp=50.0, kd=10.0))
        assert held[1] == pytest.approx(free[1], rel=1e-6)
        assert held[0].max() != pytest.approx(free[0].max(), rel=1e-3)

    @pytest.mark.part(1)
    @pytest.mark.parametrize("arm", [UR10, PANDA], ids=lambda arm: arm.name)
    def test_the_zeros_are_the_links_behind_locked_motors(self, arm: taut.Arm, share: Callable[[int], int]) -> None:
        rng = np.random.default_rng(1)
        bare = arm.with_gravity([0.0, 0.0, 0.0])
        for _ in range(share(20)):
            q, K = rng.uniform(-1.0, 1.0, arm.n), rng.uniform(500.0, 5000.0, arm.n)
            M = taut.snapshot(arm, q).M - np.diag(arm.rotor_inertia)
            expected = np.sqrt(eigh(np.diag(K), M, eigvals_only=True))
            slow = expected < 600.0  # the integrator's own frequencies differ above
            found = self.found(bare, K, taut.laws.PID(kp=50.0, kd=5.0), at=q)[1]
            assert found[: slow.sum()] == pytest.approx(expected[slow], rel=1e-3)

    def test_unequal_groups_are_refused(self) -> None:
        lin = taut.linearise(taut.Loop(taut.compile(taut.laws.PID(kp=0.0), ONE), elastic(ONE, 500.0), duration=1.0))
        with refused(taut.errors.UsageError):
            lin.s_zeros(input="disturbance.command", output="tip.p")


def upright(kp: float) -> taut.Run:
    """One joint with alpha = 20 N m/rad, K 100 and M + B = 0.7 at its steepest point, a little off."""
    arm = taut.load_arm("one_joint", gravity=[0.0, 0.0, -200.0]).with_joints(rotor_inertia=0.2).with_friction(FREE)
    law = taut.laws.MotorSidePD(stiffness=100.0, kp=kp / 0.7, kd=1.0)
    top = taut.JointMotion(q=[0.5 * np.pi])
    return taut.run(taut.compile(law, arm), elastic(arm, 100.0, D=0.2), top, duration=12.0, q0=[0.5 * np.pi - 1e-3])


class TestSetPoints:
    def test_of_one_joint_the_limit_is_that_of_the_proof(self) -> None:
        """Acceptance 4c: alpha 20, K 100: kp > 25 N m/rad."""
        with warned(taut.errors.StabilityWarning):
            leaves = upright(24.25)
        stays = upright(25.75)
        assert np.abs(leaves.q[-1] - 0.5 * np.pi) > 0.05
        assert np.abs(stays.q[-1000:] - 0.5 * np.pi).max() < 1e-3

    @pytest.mark.parametrize(("name", "alpha"), [("planar2", 24.30), ("panda", 68.2), ("ur5", 64.5)])
    def test_the_steepest_gravity_of_arms(self, name: str, alpha: float) -> None:
        arm = taut.load_arm(name).with_joints(rotor_inertia=0.3)
        law = taut.laws.MotorSidePD(stiffness=1000.0, kp=100.0, kd=20.0)
        found = taut.analysis.set_point_condition(law, arm)
        assert found.alpha == pytest.approx(alpha, rel=0.01)
        kp = np.diag(taut.snapshot(arm, arm.home).M) * 100.0
        a = found.alpha / found.margin  # at which the matrix of the proof would be singular
        matrix = np.block(
            [[np.diag(1000.0 - found.margin * found.alpha + 0.0 * kp), -1000.0 * np.eye(arm.n)],
             [-1000.0 * np.eye(arm.n), np.diag(1000.0 + kp)]]
        )  # fmt: skip
        assert a > 0.0
        assert np.linalg.eigvalsh(matrix)[0] == pytest.approx(0.0, abs=1e-9 * 1000.0)

    @pytest.mark.part(1)
    @pytest.mark.parametrize("arm", [UR10, PANDA], ids=lambda arm: arm.name)
    def test_where_the_condition_holds_every_start_ends_at_the_set_point(
        self, arm: taut.Arm, share: Callable[[int], int]
    ) -> None:
        rng = np.random.default_rng(2)
        M = np.diag(taut.snapshot(arm, arm.home).M)
        law = taut.laws.MotorSidePD(stiffness=3000.0, kp=300.0 / M, kd=60.0 / M)
        condition = taut.analysis.set_point_condition(law, arm)
        assert condition.ok, str(condition)
        ctrl, plant = taut.compile(law, arm), elastic(arm, 3000.0, D=3.0, substeps=20)
        for _ in range(share(20)):
            q0 = arm.home + rng.uniform(-0.8, 0.8, arm.n)
            run = taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=6.0, q0=q0)
            assert run.outcome.ok
            assert np.abs(run.q[-1] - arm.home).max() < 0.02

    def test_too_weak_gains_are_named(self) -> None:
        law = taut.laws.MotorSidePD(stiffness=[1000.0, 400.0], kp=10.0, kd=5.0)
        found = taut.analysis.set_point_condition(law, PLANAR2)
        assert not found.ok
        assert "joint2" in str(found)

    def test_without_weight_any_stiffness_will_do_but_none(self) -> None:
        arm = PLANAR2.with_gravity([0.0, 0.0, 0.0])
        for kp, ok in ((1e-3, True), (0.0, False)):
            law = taut.laws.MotorSidePD(stiffness=400.0, kp=kp, kd=5.0)
            assert taut.analysis.set_point_condition(law, arm).ok is ok
        with refused(taut.errors.ShapeError):
            taut.analysis.set_point_condition(dataclasses.replace(law, stiffness=[400.0] * 3), arm)


class TestClosedLoops:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("arm", [PLANAR2, UR10, PANDA], ids=lambda arm: arm.name)
    def test_linearised_joints_are_four_integrators_each(self, arm: taut.Arm, share: Callable[[int], int]) -> None:
        """(d/dt + w)^4 e = 0 from rest at a small error: e = e0 (1 + wt + (wt)^2/2 + (wt)^3/6) exp(-wt)."""
        rng = np.random.default_rng(3)
        for _ in range(share(10)):
            w, q = rng.uniform(15.0, 30.0), arm.home + rng.uniform(-0.3, 0.3, arm.n)
            M = np.diag(taut.snapshot(arm.with_joints(rotor_inertia=0.0), arm.home).M)
            K = M * rng.uniform(100.0, 250.0, arm.n) ** 2
            errors = followed(
                linearising(w, K), arm, K, at_rest(q), duration=0.3, rate=10_000.0, off=-0.02, substeps=1
            )
            t = w * np.arange(len(errors)) / 10_000.0
            form = 0.02 * (1.0 + t + t**2 / 2.0 + t**3 / 6.0) * np.exp(-t)
            np.testing.assert_allclose(errors, np.outer(form, np.ones(arm.n)), rtol=0.0, atol=0.05 * 0.02)

    @pytest.mark.parametrize(
        ("name", "mass", "limit"),
        [
            ("xarm7", 0.0, 138.0),
            pytest.param("xarm7", 2.0, 3230.0, marks=pytest.mark.long),
            pytest.param("ur10", 0.0, 526.0, marks=pytest.mark.long),
            pytest.param("ur10", 2.0, 3820.0, marks=pytest.mark.long),
        ],
    )
    def test_linearisation_needs_a_rate_above_the_frequency_of_a_link_on_its_spring(
        self, name: str, mass: float, limit: float
    ) -> None:
        """Of the last joint; the others oscillate at 600 rad/s at most."""
        arm = taut.load_arm(name).with_joints(rotor_inertia=0.1).with_friction(FREE)
        arm = arm.with_payload(mass, com=[0.0, 0.0, 0.05], inertia=[0.0033 * mass / 2.0] * 3 + [0.0] * 3)
        mobility = np.diag(np.linalg.inv(taut.snapshot(arm.with_joints(rotor_inertia=0.0), arm.home).M))
        assert 1000.0**2 / mobility[-1] == pytest.approx(limit, rel=0.005)
        for share, stable in ((0.95, True), (1.1, False)):
            K = np.append(np.minimum(5000.0, 600.0**2 / mobility[:-1]), share * limit)
            loop = taut.Loop(taut.compile(linearising(30.0, K), arm), elastic(arm, K, substeps=10), duration=1.0)
            assert taut.linearise(loop).stable is stable

    @pytest.mark.part(1)
    @pytest.mark.parametrize("arm", [UR10, PANDA], ids=lambda arm: arm.name)
    def test_motor_side_feedforward_is_exact_but_for_the_period(
        self, arm: taut.Arm, share: Callable[[int], int]
    ) -> None:
        rng = np.random.default_rng(4)
        for _ in range(share(10)):
            K, A = rng.uniform(2000.0, 6000.0, arm.n), rng.uniform(-0.4, 0.4, arm.n)
            ref = reference(arm, A.tolist(), rng.uniform(0.3, 0.8, arm.n).tolist())
            coarse, fine = (
                np.abs(followed(motor_side(K), arm, K, ref, duration=1.0, rate=rate)).max()
                for rate in (1000.0, 4000.0)
            )
            assert fine < 0.5 * coarse < 5e-4

    def test_full_state_feedback_has_its_poles_in_the_sampled_loop(self, share: Callable[[int], int]) -> None:
        rng = np.random.default_rng(5)
        for _ in range(share(50)):
            M, B, K, D = 0.5, rng.uniform(0.05, 0.5), rng.uniform(100.0, 2000.0), rng.uniform(0.0, 1.0)
            arm = ONE.with_joints(rotor_inertia=B)
            poles = -rng.uniform(8.0, 14.0) * np.array([1.0, 1.3, 1.6 + 0.8j, 1.6 - 0.8j])
            law = taut.laws.FullStateFeedback.placed(arm, stiffness=K, damping=D, poles=poles, rate=500.0)
            A = [[0, 1, 0, 0], [-K / M, -D / M, K / M, D / M], [0, 0, 0, 1], [K / B, D / B, -K / B, -D / B]]
            plant = taut.LinearSystem(A=A, B=[[0.0], [0.0], [0.0], [1.0 / B]]).zoh(1.0 / 500.0)
            closed = plant.A - plant.B @ law.feedback.as_array()[np.newaxis]
            assert np.sort_complex(np.linalg.eigvals(closed)) == pytest.approx(
                np.sort_complex(np.exp(poles / 500.0)), abs=1e-7
            )

    def test_full_state_feedback_follows_and_knows_gravity_s_slope(self) -> None:
        arm = taut.load_arm("one_joint").with_joints(rotor_inertia=0.2).with_friction(FREE)
        poles = [-20.0, -22.0, -24.0, -26.0]
        law = taut.laws.FullStateFeedback.placed(arm, stiffness=50.0, damping=0.5, poles=poles, rate=1000.0, at=[1.0])
        loop = taut.Loop(
            taut.compile(law, arm), elastic(arm, 50.0, D=0.5, substeps=40), taut.JointMotion(q=[1.0]), duration=1.0
        )
        lin = taut.linearise(loop, at=[1.0])
        assert np.poly(lin.s_poles[lin.omega_n < 2000.0]) == pytest.approx(np.poly(poles), rel=0.02)
        assert np.abs(lin.point.moved).max() < 1e-9
        ref = reference(arm, [0.8], [0.6])
        K = 500.0
        law = taut.laws.FullStateFeedback.placed(arm, stiffness=K, poles=poles, rate=1000.0)
        assert np.abs(followed(law, arm, K, ref)).max() < 2e-4

    @pytest.mark.part(1)
    @pytest.mark.parametrize(("K", "limit"), [(2000.0, 12.0), (5000.0, 9.5), (10000.0, 4.1)])
    def test_torque_feedback_has_the_limits_of_a_sampled_loop(self, K: float, limit: float) -> None:
        """Section 10.6's figures, found again within 5 %: M 0.5, B 0.2, D 1, one tick of delay, PD 70 and 14."""

        def stable(ratio: float) -> bool:
            law = taut.laws.JointTorqueFeedback(law=taut.laws.PID(kp=70.0, kd=14.0), inertia=0.2 / ratio)
            on_motor = taut.sensors.Sensors(
                position=taut.sensors.Encoder(side="motor"), velocity=taut.sensors.Tachometer(side="motor"),
                torque=taut.sensors.TorqueSensor(),
            )  # fmt: skip
            spring = taut.drives.Actuation(
                transmission=taut.drives.Transmission(stiffness=K, damping=1.0), delay=1e-3
            )
            plant = taut.RigidPlant(ONE, friction=None, actuation=spring, substeps=100, sensors=on_motor)
            loop = taut.Loop(taut.compile(law, ONE), plant, taut.JointMotion(q=[0.0]), duration=1.0)
            return bool(np.abs(taut.linearise(loop, at=[0.0]).poles).max() < 1.0)

        assert stable(0.95 * limit)
        assert not stable(1.05 * limit)

    @pytest.mark.long
    def test_a_law_of_the_tool_runs_inside_the_fast_torque_loop(self) -> None:
        K = K7.tolist()
        law = taut.laws.FastTorqueLoop(
            law=taut.laws.Impedance(K=(800.0, 30.0), zeta=1.0), stiffness=K, bandwidth=200.0
        )
        T = taut.snapshot(PANDA, PANDA.home).T()
        goal = taut.TaskMotion(pose=taut.Pose(T.p + np.array([0.0, 0.0, 0.03]), R=T.R))
        run = taut.run(taut.compile(law, PANDA), elastic(PANDA, K, D=1.0), goal, duration=1.5)
        assert np.abs(taut.snapshot(PANDA, run.q[-1]).T().p - goal.pose.p).max() < 1e-4

    def test_torque_feedback_shows_another_rotor(self) -> None:
        """The loop is that of the same law on an arm with rotors of B_des, as far as sampling goes."""
        poles = []
        for B, wrapped in ((0.2, True), (0.05, False)):
            arm = ONE.with_joints(rotor_inertia=B)
            law: taut.Law = motor_side(500.0)
            law = taut.laws.JointTorqueFeedback(law=law, inertia=0.05) if wrapped else law
            loop = taut.Loop(
                taut.compile(law, arm, rate=10_000.0),
                elastic(arm, 500.0, D=0.5),
                taut.JointMotion(q=[0.0]),
                duration=1.0,
            )
            lin = taut.linearise(loop, at=[0.0])
            poles.append(np.poly(lin.s_poles[lin.omega_n < 2000.0]))
        assert poles[0] == pytest.approx(poles[1], rel=0.02)


class TestSeriesElastic:
    M, B, WALL, SPEED, LOAD = 0.5, 1.0, 2000.0, 1.0, 5.0

    def measured(self, K: float) -> tuple[float, float]:
        """Largest torque of the first contact, and the error under a load [N m, rad]."""
        arm = ONE.with_joints(rotor_inertia=self.B)
        up = [0.0, 0.0, 1.0]
        wall = taut.environments.StiffWall(point=[0.0] * 3, normal=[0.0, 0.0, -1.0], stiffness=self.WALL / 0.1**2)
        push = taut.environments.Push(
            peak=[*(self.LOAD / 0.1 * np.array(up)), 0, 0, 0], t=0.0, duration=99.0, shape="rectangular"
        )
        plant = elastic(arm, K, D=0.04 * math.sqrt(K), substeps=20)
        free, loaded = (dataclasses.replace(plant, environment=touched) for touched in (wall, push))
        hit = taut.run(taut.compile(taut.laws.PID(kp=0.0), arm), free, duration=0.2, q0=[-1e-3], v0=[self.SPEED])
        torque = -0.1 * hit.extra["F_ext"][:, 2]
        since = torque[int(np.argmax(torque > 0.0)) :]
        law = taut.compile(motor_side(K), arm)
        held = taut.run(law, loaded, taut.JointMotion(q=[0.0]), duration=15.0, q0=[0.0])
        return float(since[: int(np.argmin(since > 0.0))].max()), float(held.q[-1, 0])

    @pytest.mark.part(1)
    @pytest.mark.parametrize(
        ("K", "impact", "inertia"),
        [(50.0, 31.7, 0.5), (430.0, 32.3, None), (2000.0, 38.4, None), (4300.0, 48.5, None), (2e4, 53.3, 1.5)],
    )
    def test_a_soft_joint_hides_its_rotor_and_gives_way_to_a_load(
        self, K: float, impact: float, inertia: float | None
    ) -> None:
        first, error = self.measured(K)
        assert first == pytest.approx(impact, rel=0.01)
        if inertia is not None:
            assert first == pytest.approx(self.SPEED * math.sqrt(self.WALL * inertia), rel=0.03)
        assert error == pytest.approx(self.LOAD / ((self.M + self.B) * 100.0) + self.LOAD / K, rel=0.02)


def at_rest(q: Float64Array) -> Any:
    """A set-point as a trajectory."""

    class Rest:
        def at(self, t: float) -> taut.JointMotion:
            return taut.JointMotion(q=q)

    return Rest()


class TestReferences:
    @pytest.mark.parametrize(
        "motion",
        [
            taut.trajectories.Sine(center=[0.1, 0.2], amplitude=[0.3, 0.5], frequency=[0.7, 1.1], phase=0.4),
            taut.trajectories.Septic(q0=[0.1, 0.2], q1=[1.0, -0.5], duration=1.3),
        ],
    )
    def test_jerk_and_snap_are_the_derivatives(self, motion: Any) -> None:
        h = 1e-4
        for t in (0.2, 0.61, 1.1):
            before, here, after = (motion.at(t + k * h) for k in (-1, 0, 1))
            for low, high in ("qv", "va", "aj", "js"):
                slope = (getattr(after, low) - getattr(before, low)) / (2.0 * h)
                assert slope == pytest.approx(getattr(here, high), rel=1e-5, abs=1e-4)

    def test_a_septic_starts_and_ends_without_jerk(self) -> None:
        motion = taut.trajectories.Septic(q0=[0.0], q1=[1.0], duration=2.0)
        for t, q in ((0.0, 0.0), (2.0, 1.0), (3.0, 1.0)):
            sample = motion.at(t)
            assert [*sample.q, *sample.v, *sample.a, *sample.j] == pytest.approx([q, 0.0, 0.0, 0.0], abs=1e-12)

    def test_a_motion_of_one_s_own_may_state_them(self) -> None:
        class Own:
            def at(self, t: float) -> taut.JointMotion:
                return taut.JointMotion(q=[t**4], v=[4 * t**3], a=[12 * t**2], j=[24 * t], s=[24.0])

        law, plant = taut.compile(motor_side(500.0), ONE), elastic(ONE, 500.0)
        run = taut.run(law, plant, Own(), duration=0.5)
        assert np.abs(run.reference.s - 24.0).max() == 0.0
        assert np.abs(run.reference.q - run.q).max() < 1e-3

    def test_one_without_them_is_refused_in_one_sentence(self) -> None:
        law, plant = taut.compile(motor_side(500.0), ONE), elastic(ONE, 500.0)
        quintic = taut.trajectories.Quintic(q0=[0.0], q1=[1.0], duration=1.0)
        with refused(taut.errors.UsageError):
            taut.run(law, plant, quintic, duration=1.0)
        with refused(taut.errors.UsageError):
            law.step(q=[0.0], q_motor=[0.0], v_motor=[0.0], ref=taut.JointMotion(q=[0.0], v=[1.0]))

    def test_set_points_and_holds_have_none_to_state(self) -> None:
        law, plant = taut.compile(motor_side(500.0), ONE), elastic(ONE, 500.0)
        for ref in (taut.JointMotion(q=[0.2]), taut.hold(), taut.hold(taut.JointMotion(q=[0.2]))):
            assert taut.run(law, plant, ref, duration=0.1).outcome.ok

    def test_laws_that_need_them_add_to_laws_that_do_not(self) -> None:
        arm = ONE.with_friction(taut.Friction(viscous=0.3))
        law = motor_side(500.0) + taut.laws.FrictionCompensation()
        ref = taut.trajectories.Sine(center=[0.0], amplitude=0.3, frequency=0.5)
        assert taut.run(taut.compile(law, arm), elastic(arm, 500.0), ref, duration=0.2).outcome.ok
        side = taut.SideBySide(a=(motor_side(K2[:1]), ["joint1"]), b=(CT, ["joint2"]))
        both = taut.together(a=ref, b=ref)
        assert taut.run(taut.compile(side, PLANAR2), elastic(PLANAR2, [1000.0, np.inf]), both, duration=0.01).outcome


class TestMessages:
    def test_what_does_not_fit_is_one_sentence(self) -> None:
        errors = taut.errors
        elsewhere = taut.load_arm("one_joint")
        with refused(errors.RangeError):
            taut.laws.MotorSidePD(stiffness=0.0, kp=1.0, kd=1.0)
        with refused(errors.MatchError):
            taut.run(
                taut.compile(linearising(20.0, 500.0), elsewhere),
                taut.RigidPlant(elsewhere, sensors=SENSORS),
                duration=0.1,
            )
        arm = elsewhere.with_joints(rotor_inertia=0.2)
        helped = taut.RigidPlant(arm, sensors=SENSORS, adds=("gravity",))
        with refused(errors.MatchError):
            taut.run(taut.compile(motor_side(500.0), arm, adds=helped.adds), helped, duration=0.1)
        with refused(errors.UsageError):
            taut.compile(taut.laws.JointTorqueFeedback(law=taut.laws.VelocityPI(kp=1.0), inertia=0.1), arm)
        with refused(errors.RangeError):
            taut.compile(fast(2000.0, 500.0), arm)
        wrong = (
            [-20.0] * 4,
            [-1.0, -2.0, -3.0, -4.0 + 1.0j],
            [np.nan] * 4,
            [-1.0, -2.0],
            [20.0, -11.0, -12.0, -13.0],
        )
        for poles in wrong:
            with refused(errors.RangeError):
                taut.laws.FullStateFeedback.placed(arm, stiffness=500.0, poles=poles, rate=1000.0)
        with refused(errors.MatchError):
            taut.laws.FullStateFeedback.placed(PLANAR2, stiffness=500.0, poles=[-1.0, -2.0, -3.0, -4.0], rate=1000.0)

    def test_a_growing_mode_is_named_by_its_joint(self) -> None:
        arm = taut.load_arm("ur10").with_joints(rotor_inertia=0.5)
        spring = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=2000.0))
        plant = taut.RigidPlant(arm.with_friction(taut.Friction()), actuation=spring, substeps=10)
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=400.0, kd=40.0), arm)
        found = taut.analysis.judge(taut.Loop(ctrl, plant, duration=1.0))
        assert not found.stable
        assert "joint '" in found.direction
        assert sum(found.joints.values()) == pytest.approx(1.0, abs=0.01)

    @pytest.mark.long
    def test_its_spring_is_no_gain_to_lower(self) -> None:
        """The spring's stiffness is what the joint has: a wrong one would hide the growth, and spoil the motion."""
        for rotor, stiffness, omega, gains in ((0.6, 4000.0, 30.0, []), (0.2, 2000.0, 600.0, ["law.omega"])):
            arm = taut.load_arm("one_joint" if gains else "ur10").with_joints(rotor_inertia=rotor)
            plant = elastic(arm, stiffness, D=1.0, substeps=4)
            ctrl = taut.compile(linearising(omega, stiffness), arm)
            found = taut.analysis.judge(taut.Loop(ctrl, plant, duration=1.0))
            assert not found.stable
            assert list(found.largest) == gains

    def test_the_desired_motor_holds_gravity(self) -> None:
        x = taut.snapshot(PLANAR2, PLANAR2.home)
        ref = SmoothMotion.at_rest(x, None)
        q, _, tau = desired_motor(x, ref, motor_side(K2).stiffness)  # type: ignore[attr-defined]
        assert q == pytest.approx(PLANAR2.home + x.g / K2)
        assert tau == pytest.approx(x.g)
