"""Metrics against closed forms, and against arrays whose numbers one can see."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.optimize import brentq

import taut
from taut.base.errors import ShapeError, UsageError
from taut.record.metrics import METRICS, Metric
from taut.record.metrics.joints import step_response

STEP = 1e-4  # of the step: what MATHS.md, section 5, asks of exact second-order responses
ZETAS = [0.1, 0.3, 0.5, 0.78, 1.0, 1.5, 3.0]


def second_order(t: Any, zeta: float, omega: float) -> Any:
    """e of e'' + 2 zeta omega e' + omega^2 e = 0 with e(0) = 1, e'(0) = 0 (chapter, section 10.2.1.1)."""
    s = zeta * omega
    if zeta < 1.0:
        omega_d = omega * math.sqrt(1.0 - zeta**2)
        return np.exp(-s * t) * (np.cos(omega_d * t) + s / omega_d * np.sin(omega_d * t))
    if zeta == 1.0:
        return np.exp(-s * t) * (1.0 + s * t)
    root = omega * math.sqrt(zeta**2 - 1.0)
    s1, s2 = -s + root, -s - root
    return (s2 * np.exp(s1 * t) - s1 * np.exp(s2 * t)) / (s2 - s1)


def exact_settling_time(zeta: float, omega: float) -> float:
    """The last root of |e| = 0.02, found in the closed form."""
    coarse = np.linspace(0.0, 60.0 / (min(zeta, 1.0 / zeta) * omega), 400_001)
    k = int(np.flatnonzero(np.abs(second_order(coarse, zeta, omega)) > 0.02)[-1])
    return float(brentq(lambda t: abs(second_order(t, zeta, omega)) - 0.02, coarse[k], coarse[k + 1], xtol=1e-13))


# -------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("zeta", ZETAS)
@pytest.mark.parametrize("e_ss", [0.0, 0.1, -0.2])
def test_exact_second_order_responses_are_reproduced(make_run: Any, zeta: float, e_ss: float) -> None:
    omega, e0 = 7.0, -0.8
    slowest = omega * (zeta - math.sqrt(max(0.0, zeta**2 - 1.0)))
    t = np.arange(0.0, 14.0 / slowest, 0.001)
    error = e0 * (e_ss + (1.0 - e_ss) * second_order(t, zeta, omega))
    m = make_run(t, 0.3 - error, q_ref=0.3).metrics
    exact = 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)) if zeta < 1.0 else 0.0
    assert m.overshoot[0] == pytest.approx(exact, rel=1e-3, abs=100.0 * STEP)
    assert m.steady_state_error[0] == pytest.approx(100.0 * e_ss, abs=100.0 * STEP)
    assert m.settling_time[0] == pytest.approx(exact_settling_time(zeta, omega), rel=1e-3)


@pytest.mark.parametrize(("zeta", "rule"), [(1.0, 5.83), (0.78, 3.61)])
def test_settling_is_the_exact_one_not_four_time_constants(make_run: Any, zeta: float, rule: float) -> None:
    t = np.arange(0.0, 30.0, 0.001)
    m = make_run(t, 1.0 - second_order(t, zeta, 1.0), q_ref=1.0).metrics
    assert m.settling_time[0] == pytest.approx(rule, abs=0.006)  # as MATHS.md rounds it


@pytest.mark.parametrize("zeta", [0.5, 1.0, 1.5])
def test_the_one_joint_arm_under_pd_control_answers_as_designed(zeta: float) -> None:
    """M a + (b + kd) v + kp e without gravity, equation 10.8; a fine step, so that sampling does not show."""
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])
    omega, M, b = 8.0, 0.5, 0.1
    kp, kd = M * omega**2, 2.0 * zeta * omega * M - b
    rate = 200_000.0
    ctrl = taut.compile(taut.laws.PID(kp=kp, kd=kd), arm, rate=rate)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.7]), q0=[-0.3], duration=4.0)
    m = run.metrics
    exact = 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)) if zeta < 1.0 else 0.0
    assert m.overshoot[0] == pytest.approx(exact, rel=1e-3, abs=100.0 * STEP)
    assert m.settling_time[0] == pytest.approx(exact_settling_time(zeta, omega), rel=1e-3)
    assert abs(m.steady_state_error[0]) < 100.0 * STEP
    # What the motor puts in is lost in the joint's friction: b int v^2.
    lost = b * float(np.sum(run.v[:-1] ** 2) / rate)
    assert m.energy[0] == pytest.approx(lost, rel=1e-3)


def test_gravity_leaves_the_steady_state_error_of_the_chapter() -> None:
    """kp e = m g r cos(theta) at rest, equation 10.11."""
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.PID(kp=2.205, kd=2.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.0]), q0=[-math.pi / 2], duration=30.0)
    e = brentq(lambda e: 2.205 * e - 0.981 * math.cos(-e), 0.0, 1.0)
    assert run.metrics.final_error[0] == pytest.approx(e, abs=1e-6)
    assert run.metrics.steady_state_error[0] == pytest.approx(100.0 * e / (math.pi / 2), abs=1e-3)


# -------------------------------------------------------------------- numbers one can see


def test_tracking_errors_of_a_hand_made_run(make_run: Any) -> None:
    m = make_run([0.0, 1.0, 2.0, 3.0], [[0.0, 0.0], [1.0, 3.0], [2.0, 1.0], [0.0, 0.0]], q_ref=[0.0, 4.0]).metrics
    np.testing.assert_allclose(m.rms_error, [math.sqrt(5.0 / 4.0), math.sqrt((16 + 1 + 9 + 16) / 4.0)])
    np.testing.assert_allclose(m.peak_error, [2.0, 4.0])
    np.testing.assert_allclose(m.final_error, [0.0, 4.0])
    assert m.overall("rms_error") == pytest.approx(math.sqrt(np.sum(m.rms_error**2)))
    assert m.overall("peak_error") == 4.0
    assert m.overall("final_error") == 4.0
    assert m.duration == 3.0


def test_torque_numbers_of_a_hand_made_run(make_run: Any) -> None:
    # Row k's torque acts from t[k] to t[k + 1]; the last row's has not acted yet.
    m = make_run([0.0, 0.5, 1.0, 2.0], [0.0, 1.0, 1.0, 3.0], tau=np.array([[2.0], [-4.0], [1.0], [9.0]])).metrics
    assert m.effort[0] == 4.0 * 0.5 + 16.0 * 0.5 + 1.0 * 1.0
    assert m.peak_torque[0] == 9.0
    assert m.chatter[0] == (6.0 + 5.0 + 8.0) / 2.0
    assert m.energy[0] == 2.0 * 1.0 + 0.0 + 1.0 * 2.0
    assert math.isnan(m.saturation_time[0])


def test_what_the_limits_cut_is_counted(make_run: Any) -> None:
    cut = np.array([[0.0, -1.0], [0.5, 0.0], [0.0, 0.0], [2.0, 0.0]])
    m = make_run([0.0, 0.1, 0.3, 0.6], np.zeros((4, 2)), terms={"torque_limit": cut}).metrics
    np.testing.assert_allclose(m.saturation_time, [0.2, 0.1])
    assert m.overall("saturation_time") == pytest.approx(0.3)


def test_saturation_of_a_real_run_is_where_the_torque_stands_at_its_limit() -> None:
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.PID(kp=20.0, kd=4.0), arm, limits=taut.Limits(tau=2.0))
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[1.0]), duration=5.0)
    at_limit = np.abs(run.tau[:-1, 0]) == 2.0
    assert at_limit.any()
    assert run.metrics.saturation_time[0] == pytest.approx(at_limit.sum() * 0.001)
    assert run.metrics.peak_torque[0] == 2.0


def test_continuous_joints_take_the_short_way(make_run: Any) -> None:
    q, wanted = [[math.pi - 0.1], [-math.pi + 0.1]], -math.pi + 0.1
    run = make_run([0.0, 1.0], q, q_ref=wanted, tau=np.ones((2, 1)), continuous=(0,))
    np.testing.assert_allclose(run.error, [[0.2], [0.0]], atol=1e-12)
    assert run.metrics.energy[0] == pytest.approx(0.2)
    straight = make_run([0.0, 1.0], q, q_ref=wanted, tau=np.ones((2, 1)))
    np.testing.assert_allclose(straight.error, [[0.2 - 2.0 * math.pi], [0.0]], atol=1e-12)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_the_error_is_the_one_that_laws_see() -> None:
    arm = taut.load_arm("kinova")
    assert arm.continuous
    ctrl = taut.compile(taut.laws.GravityPID(kp=50.0, kd=10.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home + 3.0), q0=arm.home - 3.0, duration=0.05)
    expected = [arm.difference(run.reference.q[k], run.q[k]) for k in range(len(run))]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(run.error, expected)


# -------------------------------------------------------------------- where a number has no meaning


def test_a_run_that_follows_a_path_has_no_overshoot(panda_run: taut.Run) -> None:
    m = panda_run.metrics
    for name in ("overshoot", "settling_time", "steady_state_error"):
        assert np.isnan(getattr(m, name)).all()
        assert m.json()[name]["overall"] is None
    assert (m.rms_error > 0.0).all()
    assert panda_run.metrics is m  # worked out once


def test_a_joint_without_initial_error_has_no_overshoot(make_run: Any) -> None:
    t = np.arange(0.0, 20.0, 0.01)
    q = np.column_stack([1.0 - second_order(t, 0.5, 2.0), 1e-8 * np.sin(t)])
    m = make_run(t, q, q_ref=[1.0, 0.0]).metrics
    assert m.overshoot[0] == pytest.approx(16.3, abs=0.1)
    assert math.isnan(m.overshoot[1])
    assert m.overall("overshoot") == m.overshoot[0]


@pytest.mark.parametrize("left", [1.0, 3.0, 5.0])
def test_a_response_that_is_cut_off_counts_as_not_settled(make_run: Any, left: float) -> None:
    t = np.linspace(0.0, left, 2001)
    m = make_run(t, 1.0 - np.exp(-t), q_ref=1.0).metrics
    assert m.settling_time[0] == math.inf
    assert m.json()["settling_time"]["overall"] is None


def test_an_oscillation_that_never_ends_is_not_settled(make_run: Any) -> None:
    t = np.arange(0.0, 10.0, 0.001)
    m = make_run(t, 1.0 - np.cos(9.0 * t), q_ref=1.0).metrics
    assert m.settling_time[0] == math.inf


def test_a_joint_that_cannot_move_keeps_all_of_its_error(make_run: Any) -> None:
    m = make_run(np.arange(100) * 0.01, np.zeros((100, 1)), q_ref=1.0).metrics
    assert m.steady_state_error[0] == 100.0
    assert math.isnan(m.overshoot[0])
    assert math.isnan(m.settling_time[0])


def test_numbers_of_joints_with_different_units_are_not_added(make_run: Any) -> None:
    run = make_run([0.0, 1.0], np.zeros((2, 2)), tau=np.ones((2, 2)), q_ref=[1.0, 1.0], units=("rad", "m"))
    m = run.metrics
    assert m.unit("rms_error") == "rad | m"
    assert m.unit("effort") == "(N m)^2 s | N^2 s"
    assert m.unit("peak_torque") == "N m | N"
    for name in ("rms_error", "effort", "peak_torque", "chatter"):
        assert math.isnan(m.overall(name))
        assert np.isfinite(getattr(m, name)).all()
    assert m.overall("energy") == 0.0


class TestJointsOfEachUnitHaveNumbersOfTheirOwn:
    def run(self, make_run: Any) -> taut.Run:
        """Three joints in rad, m and rad, of which the second and third are cut."""
        q = np.array([[0.0, 0.0, 0.0], [0.6, 0.3, 0.8], [0.5, 0.1, 0.0]])
        tau = np.array([[1.0, 10.0, 2.0], [3.0, 20.0, -4.0], [0.0, 0.0, 0.0]])
        cut = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
        units = ("rad", "m", "rad")
        return make_run([0.0, 0.5, 1.0], q, tau=tau, terms={"torque_limit": cut}, units=units)  # type: ignore[no-any-return]

    def test_they_are_those_of_a_run_of_these_joints_alone(self, make_run: Any) -> None:
        run = self.run(make_run)
        for unit, joints in {"rad": [0, 2], "m": [1]}.items():
            alone = make_run(
                run.t,
                run.q[:, joints],
                tau=run.tau[:, joints],
                terms={"torque_limit": run.terms["torque_limit"][:, joints]},
                units=(unit,) * len(joints),
            ).metrics
            for name in ("rms_error", "peak_error", "final_error"):
                assert run.metrics.by_unit(name)[unit] == alone.overall(name)
        assert run.metrics.by_unit("peak_error")["rad"] == pytest.approx(1.0)
        assert run.metrics.by_unit("effort")["N^2 s"] == 250.0
        assert run.metrics.overall("saturation_time") == 1.0

    def test_a_metric_by_unit_is_overall_where_that_has_a_meaning(self, make_run: Any, panda_run: taut.Run) -> None:
        m = self.run(make_run).metrics
        assert m.by_unit("peak_torque") == {"N m": 4.0, "N": 20.0}
        assert m.by_unit("saturation_time") == {"s": 1.0}
        assert panda_run.metrics.by_unit("effort") == {"(N m)^2 s": panda_run.metrics.overall("effort")}

    def test_as_json(self, make_run: Any) -> None:
        out = json.loads(json.dumps(self.run(make_run).metrics.json(), allow_nan=False))["peak_torque"]
        assert out["overall"] is None
        assert out["by_unit"] == {"N m": 4.0, "N": 20.0}

    def test_as_tables(self, make_run: Any) -> None:
        whole, each = (table.rows for table in self.run(make_run).metrics.content().tables)
        assert [row[1:3] for row in whole if row[0] == "peak torque"] == [(4.0, "N m"), (20.0, "N")]
        assert [row[1:] for row in each if row[0] == "peak torque"] == [("N m | N", 3.0, 20.0, 4.0)]

    @pytest.mark.parametrize("ticks", [0, 1])
    def test_of_a_run_of_few_ticks(self, ticks: int, make_run: Any) -> None:
        m = make_run(np.arange(ticks) * 0.1, np.zeros((ticks, 2)), units=("rad", "m")).metrics
        assert list(m.by_unit("rms_error")) == ["rad", "m"]
        assert str(m)


def test_a_run_that_diverged_has_metrics_without_a_warning(make_run: Any) -> None:
    m = make_run([0.0, 0.1, 0.2], [0.0, 1e200, 1e308], tau=np.array([[0.0], [1e300], [-1e308]]), q_ref=1.0).metrics
    assert m.peak_error[0] == 1e308
    assert m.json()["effort"]["overall"] is None


@pytest.mark.parametrize("ticks", [0, 1, 2])
def test_a_run_of_few_ticks_has_metrics(make_run: Any, ticks: int) -> None:
    m = make_run(np.arange(ticks) * 0.1, np.zeros((ticks, 2)), q_ref=[1.0, 0.0]).metrics
    assert m.duration == max(0, ticks - 1) * 0.1
    json.dumps(m.json(), allow_nan=False)
    assert str(m)


def test_a_response_with_a_nan_gives_no_numbers() -> None:
    overshoot, _, _ = step_response(np.arange(3.0), np.array([1.0, math.nan, 0.0]))
    assert math.isnan(overshoot)


# -------------------------------------------------------------------- how they read


def test_metrics_as_json_name_units_and_joints(make_run: Any) -> None:
    m = make_run([0.0, 1.0], [[0.0], [1.0]], q_ref=2.0).metrics
    out = json.loads(json.dumps(m.json(), allow_nan=False))
    assert set(out) == {"duration", *METRICS}
    assert out["peak_error"] == {
        "unit": "rad",
        "overall": 2.0,
        "by_unit": {"rad": 2.0},
        "joints": {"joint1": 2.0},
    }
    assert out["saturation_time"]["overall"] is None
    assert out["saturation_time"]["joints"] == {"joint1": None}


def test_every_metric_has_a_unit_a_meaning_and_a_row_in_its_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text(encoding="utf-8")
    for name, one in METRICS.items():
        assert one.unit
        assert f"| `{name}` |" in page
        assert len(one.doc.split()) > 2, name
    assert METRICS["chatter"].meaning(joints=2) == "Total variation of tau per second; for all joints the sum"


def test_a_metric_of_a_user_is_one_function(panda_run: taut.Run, make_run: Any, tmp_path: Path) -> None:
    @taut.analysis.Metric(unit="{tau}", per_joint=True, together="sum")
    def mean_torque(run: taut.Run) -> Any:
        """Mean magnitude of tau."""
        return np.abs(run.tau).mean(axis=0)

    @taut.analysis.Metric(unit="m")
    def tool_travel(run: taut.Run) -> float | None:
        """Length of the path of the tool's origin."""
        if run.info.tool is None:
            return None
        return float(np.linalg.norm(np.diff(run.task.p, axis=0), axis=1).sum())

    run = taut.load_run(panda_run.save(tmp_path / "run.mcap"))
    m = run.metrics
    np.testing.assert_array_equal(m.mean_torque, np.abs(run.tau).mean(axis=0))
    assert m.overall("mean_torque") == pytest.approx(float(np.abs(run.tau).mean(axis=0).sum()))
    assert m["tool_travel"] > 0.01
    out = json.loads(json.dumps(m.json(), allow_nan=False))
    assert out["tool_travel"] == {"unit": "m", "overall": m.tool_travel}
    assert out["mean_torque"]["unit"] == "N m"
    assert "Length of the path of the tool" in taut.report(run, tmp_path / "run.html").read_text(encoding="utf-8")
    assert math.isnan(make_run([0.0, 1.0], [0.0, 1.0]).metrics.tool_travel)


def test_a_metric_that_cannot_be_is_refused(make_run: Any) -> None:
    for taken in ("rms_error", "overall"):
        with refused(UsageError):
            taut.analysis.Metric(unit="m", name=taken)(lambda _: 0.0)
    one = Metric(name="two", unit="m", doc="", compute=lambda _: np.zeros(2))
    with refused(ShapeError):
        one.of(make_run([0.0, 1.0], [0.0, 1.0]))
    with refused(AttributeError):
        make_run([0.0, 1.0], [0.0, 1.0]).metrics.rms_eror  # noqa: B018


def test_metrics_keep_their_numbers_from_being_changed(panda_run: taut.Run) -> None:
    with pytest.raises(ValueError, match="read-only"):
        panda_run.metrics.rms_error[0] = 0.0
