"""Dry friction as a complementarity problem: against every combination of sticking and slipping, tried one by one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import taut
from taut.base.types import Float64Array
from taut.maths.friction import FRICTION_SWEEPS, dry_friction
from taut.trace.linalg import factor_spd

DT = 1e-3
EXACT = 1e-9  # what a thousand sweeps leave, relative to the largest speed


def brute_force(
    M: Float64Array, v_free: Float64Array, limit: Float64Array, dt: float
) -> tuple[Float64Array, Float64Array]:
    """The one combination of slipping forwards, backwards and sticking that contradicts itself nowhere."""
    n, W = len(limit), dt * np.linalg.inv(M)
    for signs in itertools.product((1.0, -1.0, 0.0), repeat=n):
        sign = np.array(signs)
        f, stuck = -limit * sign, sign == 0.0
        if stuck.any():
            known = v_free + W @ f
            f = f.copy()
            f[stuck] = np.linalg.solve(W[np.ix_(stuck, stuck)], -known[stuck])
        v = v_free + W @ f
        fits = np.where(stuck, np.abs(f) <= limit * (1.0 + 1e-12), v * sign > 0.0)
        if fits.all():
            return np.where(stuck, 0.0, v), f
    raise AssertionError("no combination fits")


def random_problem(seed: int, n: int) -> tuple[Float64Array, Float64Array, Float64Array]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    M = A @ A.T + 0.2 * np.eye(n)
    return M, rng.normal(size=n) * 10.0 ** rng.uniform(-3.0, 0.5), rng.uniform(0.0, 3e2, n)


def solved(
    M: Float64Array, v_free: Float64Array, limit: Float64Array, guess: Float64Array, sweeps: int = FRICTION_SWEEPS
) -> tuple[Float64Array, Float64Array]:
    stop = -M @ v_free / DT
    done = dry_friction(
        factor_spd(M), v_free, limit, limit, guess, DT, joints=range(len(limit)), stop=stop, sweeps=sweeps
    )
    return done.v, done.f


class TestAgainstEveryCombination:
    @settings(max_examples=60, deadline=None, derandomize=True)
    @given(st.integers(0, 2**32 - 1), st.integers(1, 4))
    def test_many_sweeps_find_the_solution(self, seed: int, n: int) -> None:
        M, v_free, limit = random_problem(seed, n)
        expected, f_expected = brute_force(M, v_free, limit, DT)
        v, f = solved(M, v_free, limit, np.zeros(n), sweeps=1000)
        np.testing.assert_allclose(v, expected, rtol=0.0, atol=EXACT * np.abs(v_free).max())
        np.testing.assert_allclose(f, f_expected, rtol=0.0, atol=1e-6 * max(limit.max(), 1.0))

    @pytest.mark.long
    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(st.integers(0, 2**32 - 1))
    def test_the_sweeps_of_a_tick_get_there_when_the_load_rests(self, seed: int) -> None:
        """What the memory of the last step's torques is for."""
        M, v_free, limit = random_problem(seed, 3)
        expected, _ = brute_force(M, v_free, limit, DT)
        f = np.zeros(3)
        for _ in range(100):
            v, f = solved(M, v_free, limit, f)
        np.testing.assert_allclose(v, expected, rtol=0.0, atol=EXACT * np.abs(v_free).max())

    def test_one_joint_is_solved_in_closed_form(self) -> None:
        M, limit, none = np.array([[0.5]]), np.array([2.0]), np.zeros(1)
        v, f = solved(M, np.array([0.003]), limit, none, sweeps=1)  # 2 N m stop 0.004 rad/s of it in 1 ms
        assert (v[0], f[0]) == (0.0, pytest.approx(-1.5))
        v, f = solved(M, np.array([-0.03]), limit, none, sweeps=1)
        assert (v[0], f[0]) == (pytest.approx(-0.026), 2.0)

    def test_joints_that_can_all_be_held_are_held_without_any_sweep(self) -> None:
        M, _, _ = random_problem(3, 4)
        v_free = np.array([1e-3, -2e-3, 5e-4, 0.0])
        limit = np.abs(M @ v_free / DT) * 1.0001 + 1e-9
        v, f = solved(M, v_free, limit, np.full(4, 1e3), sweeps=0)
        np.testing.assert_allclose(v, 0.0, atol=1e-17)
        np.testing.assert_allclose(f, -M @ v_free / DT, rtol=1e-12)

    def test_no_friction_changes_nothing(self) -> None:
        M, v_free, _ = random_problem(4, 3)
        v, f = solved(M, v_free, np.zeros(3), np.ones(3))
        np.testing.assert_allclose(v, v_free, rtol=1e-14)
        assert not f.any()

    def test_limits_may_differ_with_the_direction(self) -> None:
        M, none = np.array([[0.5]]), np.zeros(1)
        for v_free, expected in ((0.03, -1.0), (-0.03, 4.0)):
            done = dry_friction(
                factor_spd(M), np.array([v_free]), np.array([1.0]), np.array([4.0]), none, DT, joints=[0]
            )
            assert done.f[0] == expected

    def test_only_the_joints_that_are_named_have_friction(self) -> None:
        M, v_free, limit = random_problem(6, 4)
        some = [1, 3]
        only = np.where(np.isin(range(4), some), limit, 0.0)
        expected, f_expected = brute_force(M, v_free, only, DT)
        done = dry_friction(factor_spd(M), v_free, limit, limit, np.zeros(4), DT, joints=some, sweeps=200)
        np.testing.assert_allclose(done.v, expected, rtol=0.0, atol=EXACT * np.abs(v_free).max())
        np.testing.assert_allclose(done.f, f_expected, rtol=0.0, atol=1e-6 * limit.max())

    def test_the_residual_says_how_far_from_the_solution_the_sweeps_ended(self) -> None:
        M, v_free, limit = random_problem(7, 4)
        _, exact = brute_force(M, v_free, limit, DT)

        def residual(sweeps: int) -> tuple[float, float]:
            done = dry_friction(factor_spd(M), v_free, limit, limit, np.zeros(4), DT, joints=range(4), sweeps=sweeps)
            return float(done.residual), float(np.abs(done.f - exact).max())

        (few, far), (many, near) = residual(2), residual(300)
        assert few > 1e-3 * far > 0.0
        assert many < 1e-9 * few
        assert near < 1e-6 * far


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_friction_never_exceeds_its_limit_and_only_takes_energy(seed: int, n: int) -> None:
    """Also from a bad guess."""
    M, v_free, limit = random_problem(seed, n)
    guess = np.random.default_rng(seed).normal(size=n) * 300.0
    v, f = solved(M, v_free, limit, guess, sweeps=100)
    assert (np.abs(f) <= limit).all()
    assert v @ M @ v <= v_free @ M @ v_free * (1.0 + 1e-9)


def test_the_traced_code_is_the_same() -> None:
    M, v_free, limit = random_problem(5, 4)

    def step(v_free: Float64Array, limit: Float64Array, guess: Float64Array) -> Float64Array:
        stop = -(M @ v_free) / DT
        done = dry_friction(factor_spd(M), v_free, limit, limit, guess, DT, joints=range(4), stop=stop)
        return taut.math.array([*done.v, *done.f, done.residual])

    compiled = taut.native(step, v_free=4, limit=4, guess=4)
    for scale in (1.0, 1e-3, 1e3):  # slipping, sticking, far away
        given_ = v_free * scale, limit, np.array([1.0, -1.0, 0.0, 5.0])
        np.testing.assert_allclose(compiled(*given_), step(*given_), rtol=1e-12, atol=1e-12)
