"""Limits and sensing on the controller's side."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

import taut
from taut.control.limits import limited

ARM = taut.load_arm("planar2")
REF = taut.JointMotion(q=[0.0, 0.0])
REST = np.zeros(2)


class TestLimits:
    @settings(max_examples=200, deadline=None, derandomize=True)
    @given(
        st.tuples(*[st.floats(-1e6, 1e6)] * 2),
        st.tuples(*[st.floats(-1e3, 1e3)] * 2),
        st.floats(0.1, 100.0),
        st.floats(1.0, 1e5),
    )
    def test_the_magnitude_always_holds_and_the_rate_wherever_it_can(
        self, command: tuple[float, float], held: tuple[float, float], most: float, rate: float
    ) -> None:
        dt = 1e-3
        parameters = {"tau": np.asarray(most), "tau_dot": np.asarray(rate)}
        out = limited(np.array(command), {"tau_applied": np.array(held)}, parameters, dt).command
        assert (np.abs(out) <= most).all()
        inside = np.abs(np.array(held)) <= most
        change = np.abs(out - np.array(held))
        assert (change[inside] <= rate * dt * (1.0 + 1e-12) + 1e-12).all()

    def test_what_limits_take_is_a_named_term(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=100.0), ARM, limits=taut.Limits(tau=5.0))
        tau = ctrl.step(np.array([0.5, 0.01]), REST, REF)
        np.testing.assert_allclose(tau, [-5.0, -1.0])
        np.testing.assert_allclose(ctrl.terms["torque_limit"], [45.0, 0.0])
        np.testing.assert_allclose(sum(ctrl.terms.values()), tau)

    def test_a_rate_limit_starts_from_the_gravity_torque(self) -> None:
        q = np.array([0.4, -0.2])
        ctrl = taut.compile(taut.laws.PID(kp=1e4), ARM, limits=taut.Limits(tau_dot=100.0))
        step = np.abs(ctrl.step(q, REST, REF) - taut.snapshot(ARM, q).g)
        assert (step <= 0.1 + 1e-12).all()

    def test_where_the_plant_adds_gravity_it_starts_from_zero(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=1e4), ARM, limits=taut.Limits(tau_dot=100.0), adds=("gravity",))
        assert (np.abs(ctrl.step(np.array([0.4, -0.2]), REST, REF)) <= 0.1 + 1e-12).all()

    def test_a_torque_that_the_plant_holds_can_be_told(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=0.0), ARM, limits=taut.Limits(tau_dot=100.0))
        ctrl.reset(tau_applied=[7.0, -3.0])
        np.testing.assert_allclose(ctrl.step(REST, REST, REF), [6.9, -2.9])
        plain = taut.compile(taut.laws.PID(kp=0.0), ARM)
        with refused(taut.errors.UsageError):
            plain.reset(tau_applied=[1.0, 1.0])

    def test_limits_are_parameters(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=100.0), ARM, limits=taut.Limits(tau=[5.0, 5.0]))
        ctrl.parameters["limits.tau"] = [1.0, 2.0]
        np.testing.assert_allclose(ctrl.step(np.array([1.0, 1.0]), REST, REF), [-1.0, -2.0])
        with refused(taut.errors.RangeError):
            ctrl.parameters["limits.tau"] = [1.0, 0.0]

    @pytest.mark.parametrize(
        "make",
        [
            lambda: taut.Limits(),
            lambda: taut.Limits(tau=0.0),
            lambda: taut.Limits(tau=[1.0, np.nan]),
            lambda: taut.Limits(tau_dot=-1.0),
            lambda: taut.Limits.of(ARM),
            lambda: taut.compile(taut.laws.PID(kp=1.0), ARM, limits=taut.Limits(tau=[1.0, 2.0, 3.0])),
            lambda: taut.compile(taut.laws.VelocityPI(kp=1.0), ARM, limits=taut.Limits(tau=1.0)),
        ],
        ids=range(7),
    )
    def test_what_is_no_limit_is_refused_in_words(self, make: object) -> None:
        with refused(taut.TautError):
            make()  # type: ignore[operator]

    def test_the_arms_own_limits_with_and_without_rate(self) -> None:
        panda = taut.load_arm("panda")
        np.testing.assert_array_equal(taut.Limits.of(panda).tau, panda.effort)
        np.testing.assert_array_equal(taut.Limits.of(panda, rate=True).tau_dot, 10.0 * panda.effort)


class TestSensing:
    def test_differencing_starts_at_zero_velocity_and_then_differences(self) -> None:
        ctrl = taut.compile(
            taut.laws.PID(kp=0.0, kd=1.0), ARM, rate=100.0, sensing=taut.Sensing(velocity="difference")
        )
        np.testing.assert_array_equal(ctrl.step(np.array([0.1, 0.2]), ref=REF), [0.0, 0.0])
        np.testing.assert_allclose(ctrl.step(np.array([0.12, 0.19]), ref=REF), [-2.0, 1.0])
        ctrl.reset()
        np.testing.assert_array_equal(ctrl.step(np.array([5.0, 5.0]), ref=REF), [0.0, 0.0])

    def test_differencing_wraps_continuous_joints(self) -> None:
        kinova = taut.load_arm("kinova")
        wraps = kinova.continuous[0]
        ctrl = taut.compile(taut.laws.PID(kp=0.0, kd=1.0), kinova, sensing=taut.Sensing(velocity="difference"))
        ref, q = taut.JointMotion(q=kinova.home), kinova.home.copy()
        q[wraps] = np.pi - 0.001
        ctrl.step(q, ref=ref)
        q[wraps] = -np.pi + 0.001
        np.testing.assert_allclose(ctrl.step(q, ref=ref)[wraps], -2.0, rtol=1e-9)

    def test_a_velocity_that_is_not_used_is_refused_and_one_that_is_missing_too(self) -> None:
        ctrl = taut.compile(taut.laws.PID(kp=1.0), ARM, sensing=taut.Sensing(velocity="difference"))
        with refused(taut.errors.UsageError):
            ctrl.step(REST, REST, REF)
        with refused(taut.errors.UsageError):
            taut.Sensing(velocity="tacho")  # type: ignore[arg-type]


def test_clamping_holds_the_integral_while_limits_cut_and_the_error_pushes_on() -> None:
    limits = taut.Limits(tau=1.0)
    clamped = taut.compile(taut.laws.PID(kp=10.0, ki=100.0), ARM, limits=limits)
    winding = taut.compile(
        taut.laws.PID(kp=10.0, ki=100.0, integral=taut.laws.Integral(anti_windup="none")), ARM, limits=limits
    )
    for _ in range(500):
        for ctrl in (clamped, winding):
            ctrl.step(np.array([-1.0, 0.0]), REST, REF)
    assert clamped.terms["I"][0] < 0.2
    assert winding.terms["I"][0] == pytest.approx(100.0 * 0.5, rel=0.01)


def test_the_limits_of_something_else_are_refused() -> None:
    with refused(taut.errors.UsageError):
        taut.Limits.of("panda")  # type: ignore[arg-type]
