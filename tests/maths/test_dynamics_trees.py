"""Dynamics of arms nobody ships: oblique and reversed axes, slides, branches, one joint and thirty; and what must hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from maths_oracles import Array, oracle_of, random_state, random_tree, torso

import taut
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues, model_of

ROUNDING = 1e-11  # relative to the largest entry; sums of up to thirty joints' terms, of which some cancel
DIFFERENCED = 1e-7  # central differences with a step of 1e-6: its square, and rounding over it
STEP = 1e-6


def load_of(arm: taut.Arm) -> PayloadValues:
    return PayloadValues(mass=arm.payload.mass, com=arm.payload.com, inertia=arm.payload.inertia)


def assert_close(got: Array, expected: Array, tolerance: float = ROUNDING, scale: float = 0.0) -> None:
    assert np.abs(got - expected).max() <= tolerance * max(np.abs(expected).max(), scale)


def assert_same_as_pinocchio(arm: taut.Arm, rng: np.random.Generator) -> None:
    oracle, model, load = oracle_of(arm), model_of(arm), load_of(arm)
    q, v = random_state(arm, rng)
    a, tau = rng.normal(size=arm.n), rng.normal(size=arm.n)
    assert_close(dyn.mass_matrix(model, q, load), oracle.M(q))
    assert_close(dyn.bias(model, q, v, load), oracle.h(q, v))
    gravity = oracle.g(q)
    assert_close(dyn.gravity_torque(model, q, load), gravity)
    C = oracle.C(q, v)
    # An arm of slides alone has no Coriolis torques; then masses and speeds of about one give the scale.
    assert_close(dyn.coriolis_matrix(model, q, v, load), C, scale=1e-2)
    assert_close(dyn.bias(model, q, v, load, gravity=False), C @ v, scale=1e-2)
    assert_close(dyn.inverse_dynamics(model, q, v, a, load), oracle.inverse_dynamics(q, v, a))
    assert_close(dyn.forward_dynamics(model, q, v, tau, load), oracle.forward_dynamics(q, v, tau), 1e-9)  # cond(M)
    T, expected = dyn.pose(model, q), oracle.pose(q)
    assert_close(T.p, expected.translation)
    assert_close(T.R, expected.rotation)
    for axes in ("W", "E"):
        assert_close(dyn.jacobian(model, q, axes=axes), oracle.J(q, axes))
        assert_close(dyn.jacobian_rate_v(model, q, v, axes=axes), oracle.Jdot_v(q, v, axes), scale=1e-2)
    kinetic, _ = oracle.energies(q, v)
    assert abs(dyn.kinetic_energy(model, q, v, load) - kinetic) <= ROUNDING * kinetic


class TestAnyTreeAgreesWithPinocchio:
    @settings(max_examples=40, deadline=None, derandomize=True)
    @given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.booleans(), st.booleans())
    def test_random_trees_with_oblique_axes(self, seed: int, n: int, branches: bool, rotors: bool) -> None:
        rng = np.random.default_rng(seed)
        assert_same_as_pinocchio(random_tree(rng, n, branches=branches, rotors=rotors), rng)

    @settings(max_examples=40, deadline=None, derandomize=True)
    @given(st.integers(0, 2**32 - 1), st.integers(1, 7))
    def test_random_trees_with_axes_along_and_against_x_y_z(self, seed: int, n: int) -> None:
        """Exact zeros and ones, which take other paths through the model's constants."""
        rng = np.random.default_rng(seed)
        assert_same_as_pinocchio(random_tree(rng, n, aligned=True), rng)

    @pytest.mark.parametrize("seed", range(5))
    def test_two_arms_on_a_torso(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        assert_same_as_pinocchio(torso(rng), rng)

    @pytest.mark.part(1)
    @pytest.mark.parametrize("branches", [False, True])
    def test_thirty_joints(self, branches: bool) -> None:
        rng = np.random.default_rng(30)
        assert_same_as_pinocchio(random_tree(rng, 30, branches=branches), rng)

    def test_two_arms_on_a_torso_do_not_feel_each_other_but_through_it(self) -> None:
        rng = np.random.default_rng(1)
        arm = torso(rng)
        q, v = random_state(arm, rng)
        M, C = taut.snapshot(arm, q, v).M, taut.snapshot(arm, q, v).C
        assert not M[1:4, 4:].any()
        assert not C[1:4, 4:].any()
        assert not C[4:, 1:4].any()
        assert not taut.snapshot(arm, q).J()[:, 1:4].any()


# -------------------------------------------------------------------- what must hold


def moved(model: Model, q: Array, v: Array, load: PayloadValues, step: float) -> tuple[Array, float]:
    """Mass matrix and potential energy a little later, at constant velocity."""
    later = q + step * v
    return dyn.mass_matrix(model, later, load), float(dyn.potential_energy(model, later, load))


ARMS = {
    "panda": lambda: taut.load_arm("panda").with_payload(1.0, com=[0.0, 0.05, 0.1]),
    "kinova": lambda: taut.load_arm("kinova"),
    "gantry3": lambda: taut.load_arm("gantry3"),
    "one_joint": lambda: taut.load_arm("one_joint"),
    "torso": lambda: torso(np.random.default_rng(2)),
    "tree": lambda: random_tree(np.random.default_rng(3), 8, rotors=True),
    "thirty": lambda: random_tree(np.random.default_rng(4), 30, branches=False),
}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> taut.Arm:
    return ARMS[request.param]()


class TestWhatMustHoldOfEveryArm:
    def test_the_mass_matrix_is_symmetric_and_positive_definite(self, arm: taut.Arm) -> None:
        rng = np.random.default_rng(10)
        for _ in range(5):
            q, _ = random_state(arm, rng)
            M = dyn.mass_matrix(model_of(arm), q, load_of(arm))
            np.testing.assert_array_equal(M, M.T)
            assert np.linalg.eigvalsh(M)[0] > 0.0

    def test_m_dot_less_twice_c_is_skew(self, arm: taut.Arm) -> None:
        model, load, rng = model_of(arm), load_of(arm), np.random.default_rng(11)
        q, v = random_state(arm, rng)
        M_dot = (moved(model, q, v, load, STEP)[0] - moved(model, q, v, load, -STEP)[0]) / (2 * STEP)
        N = M_dot - 2.0 * dyn.coriolis_matrix(model, q, v, load)
        assert_close(N, -N.T, DIFFERENCED, scale=np.abs(M_dot).max() + 1.0)

    def test_c_is_the_matrix_of_christoffel_symbols(self, arm: taut.Arm) -> None:
        """C_ij = sum_k (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) v_k / 2, with derivatives by differences."""
        if arm.n > 8:
            arm = arm.subset(arm.joint_names[:5])
        model, load, rng = model_of(arm), load_of(arm), np.random.default_rng(12)
        q, v = random_state(arm, rng)
        steps = np.eye(arm.n) * STEP
        D = np.array([dyn.mass_matrix(model, q + d, load) - dyn.mass_matrix(model, q - d, load) for d in steps]) / (
            2 * STEP
        )  # D[k, i, j] = dM_ij/dq_k
        expected = 0.5 * np.einsum("kij,k->ij", D, v)
        expected += 0.5 * np.einsum("jik,k->ij", D, v) - 0.5 * np.einsum("ijk,k->ij", D, v)
        assert_close(dyn.coriolis_matrix(model, q, v, load), expected, DIFFERENCED, scale=1.0)

    @pytest.mark.part(1)
    def test_c_v_is_c_times_v_and_c_is_linear_in_v(self, arm: taut.Arm) -> None:
        model, load, rng = model_of(arm), load_of(arm), np.random.default_rng(13)
        q, v = random_state(arm, rng)
        w = rng.normal(size=arm.n)
        C_v, C_w = dyn.coriolis_matrix(model, q, v, load), dyn.coriolis_matrix(model, q, w, load)
        assert_close(C_v @ v, dyn.bias(model, q, v, load, gravity=False), scale=1e-2)
        assert_close(dyn.coriolis_matrix(model, q, 2.0 * v - 3.0 * w, load), 2.0 * C_v - 3.0 * C_w, scale=1e-2)
        assert_close(C_v @ w, C_w @ v, scale=1e-2)
        quadratic = dyn.bias(model, q, -3.0 * v, load, gravity=False)
        assert_close(quadratic, 9.0 * dyn.bias(model, q, v, load, gravity=False), scale=1e-2)

    def test_inverse_dynamics_is_m_a_plus_c_v_plus_g_and_forward_dynamics_its_inverse(self, arm: taut.Arm) -> None:
        model, load, rng = model_of(arm), load_of(arm), np.random.default_rng(14)
        q, v = random_state(arm, rng)
        a = rng.normal(size=arm.n)
        tau = dyn.inverse_dynamics(model, q, v, a, load)
        parts = dyn.mass_matrix(model, q, load) @ a + dyn.bias(model, q, v, load, gravity=False)
        assert_close(parts + dyn.gravity_torque(model, q, load), tau)
        # One joint's acceleration carries the error of all others: the condition of M, up to 1e4 here.
        assert_close(dyn.forward_dynamics(model, q, v, tau, load), a, 1e-8)

    def test_the_jacobian_is_the_derivative_of_the_pose(self, arm: taut.Arm) -> None:
        model, rng = model_of(arm), np.random.default_rng(15)
        q, _ = random_state(arm, rng)
        R = dyn.pose(model, q).R
        for i in range(arm.n):
            step = np.eye(arm.n)[i] * STEP
            after, before = dyn.pose(model, q + step), dyn.pose(model, q - step)
            linear, spin = (after.p - before.p) / (2 * STEP), (after.R - before.R) @ R.T / (2 * STEP)
            column = np.array([*linear, spin[2, 1], spin[0, 2], spin[1, 0]])
            np.testing.assert_allclose(dyn.jacobian(model, q)[:, i], column, rtol=0.0, atol=1e-8)
            in_tool_axes = np.array([*(R.T @ column[:3]), *(R.T @ column[3:])])
            np.testing.assert_allclose(dyn.jacobian(model, q, axes="E")[:, i], in_tool_axes, rtol=0.0, atol=1e-8)

    @pytest.mark.parametrize("axes", ["W", "E"])
    def test_j_dot_v_is_the_rate_of_the_twist_at_constant_joint_speed(self, arm: taut.Arm, axes: str) -> None:
        model, rng = model_of(arm), np.random.default_rng(16)
        q, v = random_state(arm, rng)
        after, before = (dyn.twist(model, q + s * STEP * v, v, axes=axes) for s in (1.0, -1.0))
        expected = (after - before) / (2 * STEP)
        assert_close(dyn.jacobian_rate_v(model, q, v, axes=axes), expected, DIFFERENCED, scale=1.0)

    def test_gravity_is_the_slope_of_potential_energy(self, arm: taut.Arm) -> None:
        model, load, rng = model_of(arm), load_of(arm), np.random.default_rng(17)
        q, _ = random_state(arm, rng)
        slope = [
            (dyn.potential_energy(model, q + d, load) - dyn.potential_energy(model, q - d, load)) / (2 * STEP)
            for d in np.eye(arm.n) * STEP
        ]
        assert_close(dyn.gravity_torque(model, q, load), np.array(slope), DIFFERENCED, scale=1.0)

    def test_the_rate_of_energy_is_the_power_of_the_torques(self, arm: taut.Arm) -> None:
        model, load, rng = model_of(arm), load_of(arm), np.random.default_rng(18)
        q, v = random_state(arm, rng)
        tau = rng.normal(size=arm.n)
        a = dyn.forward_dynamics(model, q, v, tau, load)

        def energy(s: float) -> float:
            at, speed = q + s * v + 0.5 * s * s * a, v + s * a
            return float(dyn.kinetic_energy(model, at, speed, load) + dyn.potential_energy(model, at, load))

        # Accelerations of a long random tree are thousands of rad/s^2, so the step is smaller for it.
        step = STEP / (1.0 + np.abs(a).max())
        rate = (energy(step) - energy(-step)) / (2 * step)
        assert rate == pytest.approx(tau @ v, abs=1e-5 * (1.0 + np.abs(a).max()))


class TestSingularAndExtremeArms:
    def test_a_stretched_arm_has_a_singular_jacobian_and_a_regular_mass_matrix(self) -> None:
        x = taut.snapshot(taut.load_arm("planar3"), [0.4, 0.0, 0.0])
        # Stretched out, the tip cannot move along the arm.
        along = np.array([np.cos(0.4), 0.0, np.sin(0.4)])
        np.testing.assert_allclose(along @ x.J()[:3], 0.0, atol=1e-15)
        assert np.linalg.cond(x.M) < 1e3

    def test_a_single_joint_of_each_kind_by_hand(self) -> None:
        rng = np.random.default_rng(20)
        for kind in ("revolute", "continuous", "prismatic"):
            arm = random_tree(rng, 1)
            while arm.joints[0].kind != kind:
                arm = random_tree(rng, 1)
            assert_same_as_pinocchio(arm, rng)

    def test_a_light_hand_on_a_heavy_arm_keeps_its_digits(self) -> None:
        """Regrouping moves mass towards the base; what is left at the hand must not be a difference of large numbers."""
        arm = taut.load_arm("panda")
        light = arm.with_body("panda_joint7", mass=1e-4, com=[0, 0, 0.05], inertia=np.eye(3) * 1e-8)
        heavy = light.with_body("panda_joint1", mass=5e3, com=[0, 0, -0.1], inertia=np.eye(3) * 1e2)
        q, v = random_state(arm, np.random.default_rng(21))
        M, expected = dyn.mass_matrix(model_of(heavy), q), oracle_of(heavy).M(q)
        assert M[6, 6] == pytest.approx(expected[6, 6], rel=1e-10)
        C, C_pin = dyn.coriolis_matrix(model_of(heavy), q, v), oracle_of(heavy).C(q, v)
        np.testing.assert_allclose(C[6], C_pin[6], rtol=0.0, atol=1e-10 * np.abs(C_pin[6]).max())
