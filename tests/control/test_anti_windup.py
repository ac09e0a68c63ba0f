"""Anti-windup: what keeps the integral in bounds while limits cut, scheme by scheme."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.control.gains import GainValue, solved

L = taut.laws
LINK = taut.load_arm("one_joint").with_joints(viscous=[0.1])
ARM = taut.load_arm("planar2")
SCHEMES = ("none", "clamping", "back-calculation")
engines = pytest.mark.parametrize("engine", ["native", "float"])


def integral(scheme: Any, tracking: float = 10.0) -> taut.laws.Integral:
    rate = {"tracking": tracking} if scheme == "back-calculation" else {}
    return L.Integral(anti_windup=scheme, **rate)


def step_that_saturates(scheme: Any, **more: Any) -> taut.Run:
    """The chapter's link from hanging to 1.5 rad on 1.5 N m, of which its weight takes up to 0.98."""
    law = L.PID(kp=20.0, kd=5.0, ki=20.0, integral=integral(scheme, **more))
    ctrl = taut.compile(law, LINK, limits=taut.Limits(tau=1.5))
    goal = taut.JointMotion(q=[1.5])
    return taut.run(ctrl, taut.RigidPlant(LINK), goal, q0=[-np.pi / 2], duration=15.0)


def test_the_table_of_the_docs() -> None:
    """Overshoot [%] and settling time [s] of the step that saturates."""
    runs = {scheme: step_that_saturates(scheme) for scheme in SCHEMES}
    highest = {scheme: 100.0 * (run.q[:, 0].max() - 1.5) / (1.5 + np.pi / 2) for scheme, run in runs.items()}
    assert highest["none"] > 100.0  # it goes over the top
    assert 2.0 < highest["clamping"] < 12.0
    assert highest["back-calculation"] < 0.1
    for scheme in ("clamping", "back-calculation"):
        assert abs(runs[scheme].error[-1, 0]) < 1e-6
        assert runs[scheme].metrics.settling_time[0] < 4.0


def test_a_slower_tracking_rate_lets_it_wind_up_more() -> None:
    highest = [step_that_saturates("back-calculation", tracking=rate).q.max() for rate in (0.3, 1.0, 10.0)]
    assert highest[0] > highest[1] > highest[2]


CUT = taut.Limits(tau=1.0)
FAR = taut.JointMotion(q=[2.0, -1.5])
REST = np.zeros(2)


@pytest.mark.part(2)
@engines
@pytest.mark.parametrize(
    "ki", [5.0, [5.0, 8.0], np.array([[5.0, 1.0], [1.0, 8.0]])], ids=["scalar", "vector", "matrix"]
)
def test_held_at_the_limit_the_integral_comes_to_rest_where_the_docstring_says(engine: Any, ki: Any) -> None:
    law = L.PID(kp=3.0, ki=ki, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=50.0))
    ctrl = taut.compile(law, ARM, limits=CUT, engine=engine)
    for _ in range(1500):
        ctrl.step(REST, REST, FAR)
    asked = ctrl.terms["P"] + ctrl.terms["I"]
    cut = asked - np.clip(asked, -1.0, 1.0)
    np.testing.assert_allclose(GainValue(np.asarray(ki), "ki") @ FAR.q, 50.0 * cut, rtol=1e-6)


def test_in_computed_torque_the_cut_counts_as_an_acceleration() -> None:
    law = L.ComputedTorque(
        kp=3.0, kd=1.0, ki=5.0, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=50.0)
    )
    q = np.array([0.2, 0.4])
    ctrl = taut.compile(law, ARM, limits=CUT)
    for _ in range(1500):
        ctrl.step(q, REST, FAR)
    asked = sum(value for name, value in ctrl.terms.items() if name != "torque_limit")
    x = taut.snapshot(ARM, q)
    np.testing.assert_allclose(
        5.0 * x.difference(FAR.q), 50.0 * np.linalg.solve(x.M, -ctrl.terms["torque_limit"]), rtol=1e-6
    )
    assert np.abs(asked).max() > 1.0


@engines
@pytest.mark.parametrize("law", [L.PID, L.GravityPID, L.ComputedTorque])
@pytest.mark.parametrize(
    "ki", [0.0, [0.0, 4.0], np.diag([0.0, 4.0]), np.array([[1.0, 1.0], [1.0, 1.0]])], ids=range(4)
)
def test_joints_and_directions_without_an_integral_do_no_harm(engine: Any, law: Any, ki: Any) -> None:
    ctrl = taut.compile(
        law(kp=3.0, kd=1.0, ki=ki, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=10.0)),
        ARM,
        limits=CUT,
        engine=engine,
    )
    for _ in range(50):
        tau = ctrl.step(REST, REST, FAR)
    assert np.isfinite(tau).all()
    assert np.abs(ctrl.terms["I"]).max() < 1e3


@pytest.mark.parametrize("seed", range(3))
def test_a_matrix_is_inverted_where_it_can_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((4, 4))
    whole, cut = root @ root.T + 0.1 * np.eye(4), rng.standard_normal(4)
    np.testing.assert_allclose(solved(GainValue(whole, "ki"), cut), np.linalg.solve(whole, cut), rtol=1e-5)
    flat = root[:, :2] @ root[:, :2].T
    np.testing.assert_allclose(
        solved(GainValue(flat, "ki"), cut), np.linalg.pinv(flat, rcond=1e-9) @ cut, rtol=1e-4, atol=1e-6
    )
    np.testing.assert_array_equal(solved(GainValue(np.zeros((4, 4)), "ki"), cut), np.zeros(4))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_without_limits_all_schemes_are_the_same(scheme: Any) -> None:
    first = taut.compile(L.PID(kp=3.0, ki=2.0), ARM)
    other = taut.compile(L.PID(kp=3.0, ki=2.0, integral=integral(scheme)), ARM)
    for _ in range(20):
        np.testing.assert_array_equal(first.step(REST, REST, FAR), other.step(REST, REST, FAR))


def test_a_blend_is_no_windup() -> None:
    """What is blended in goes out in full in the end: it does not drive the integral back."""
    law = L.PID(kp=3.0, ki=2.0, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=10.0))
    soft, plain = taut.compile(law, ARM, limits=taut.Limits(tau=100.0, blend=0.2)), taut.compile(law, ARM)
    for _ in range(100):
        soft.step(REST, REST, FAR)
        plain.step(REST, REST, FAR)
    np.testing.assert_allclose(soft.terms["I"], plain.terms["I"], rtol=1e-12)


class TestTheTrackingRate:
    def test_is_a_parameter_where_it_has_a_meaning(self) -> None:
        ctrl = taut.compile(
            L.PID(kp=1.0, ki=1.0, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=10.0)),
            ARM,
            limits=CUT,
        )
        assert ctrl.parameters["law.integral.tracking"] == 10.0
        ctrl.parameters["law.integral.tracking"] = (
            [20.0, 5.0] if ctrl.parameters["law.integral.tracking"].ndim else 20.0
        )
        assert "law.integral.tracking" not in taut.compile(L.PID(kp=1.0), ARM).parameters
        assert "tracking" not in repr(L.PID(kp=1.0))
        assert "tracking=10.0" in repr(
            L.PID(kp=1.0, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=10.0))
        )

    def test_cannot_be_faster_than_the_rate(self) -> None:
        law = L.PID(kp=1.0, integral=taut.laws.Integral(anti_windup="back-calculation", tracking=300.0))
        with refused(taut.errors.RangeError):
            taut.compile(law, ARM, rate=200.0)
        ctrl = taut.compile(law, ARM, rate=1000.0)
        with refused(taut.errors.RangeError):
            ctrl.parameters["law.integral.tracking"] = 2000.0
        assert ctrl.parameters["law.integral.tracking"] == 300.0

    def test_and_schemes_that_are_unknown_are_told(self) -> None:
        with refused(taut.errors.UsageError):
            L.VelocityPI(kp=1.0, integral=taut.laws.Integral(anti_windup="back"))  # type: ignore[arg-type]
