"""The apparent impedance of the tool in a run, against closed forms; jumps of torque; shares of limits."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import taut
from taut.control.closed_loop import ApparentImpedance
from taut.record.info import Change
from taut.record.tool import expected_deviation

PANDA = taut.load_arm("panda")
HOME = taut.snapshot(PANDA, PANDA.home)


def test_the_response_is_that_of_equation_10_48() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 6, 6))
    D, B, K = (r @ r.T + scale * np.eye(6) for r, scale in zip(root, (4.0, 20.0, 300.0), strict=True))
    t = np.linspace(0.0, 1.0, 1001)
    peak = np.array([10.0, -5.0, 3.0, 1.0, 0.5, 0.0])
    x0, v0 = 0.01 * rng.normal(size=(2, 6))
    x, v = ApparentImpedance(D=D, B=B, K=K).response(t, np.sin(6.0 * t)[:, np.newaxis] * peak, x0, v0)

    def rates(time: float, y: Any) -> Any:
        return np.hstack([y[6:], np.linalg.solve(D, np.sin(6.0 * time) * peak - B @ y[6:] - K @ y[:6])])

    exact = solve_ivp(rates, (0.0, 1.0), np.hstack([x0, v0]), t_eval=t, rtol=1e-10, atol=1e-12).y.T
    assert np.abs(np.hstack([x, v]) - exact).max() < 1e-4 * np.abs(exact).max()  # the midpoint rule at 1 ms


def test_what_is_promised_has_the_axes_of_the_tool_and_the_asked_damping() -> None:
    law = taut.laws.Impedance(K=[100.0, 200.0, 300.0, 10.0, 20.0, 30.0], zeta=0.5, frame="tool")
    felt = law.apparent_impedance(HOME)
    assert felt is not None
    R = HOME.T().R
    turned = R.T @ felt.K[:3, :3] @ R
    assert np.abs(turned - np.diag([100.0, 200.0, 300.0])).max() < 1e-9
    J = HOME.J()
    Lambda = np.linalg.inv(J @ np.linalg.solve(HOME.M, J.T))
    assert np.abs(felt.D - Lambda).max() < 1e-9
    poles = np.linalg.eigvals(
        np.block(
            [[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(felt.D, felt.K), -np.linalg.solve(felt.D, felt.B)]]
        )
    )
    assert -poles.real / np.abs(poles) == pytest.approx(np.full(12, 0.5))


@pytest.mark.parametrize(
    "law",
    [
        taut.laws.TaskComputedTorque(kp=100.0, kd=20.0),
        taut.laws.Impedance(K=(100.0, 10.0), zeta=1.0, error="body"),
        taut.laws.EnergyTank(
            law=taut.laws.Impedance(K=(1.0, 1.0), zeta=1.0), stiffness=lambda T: [100.0, 10.0], capacity=1.0
        ),
    ],
    ids=["no impedance", "another error", "K of the pose"],
)
def test_a_law_that_promises_nothing_is_compared_with_nothing(law: taut.Law) -> None:
    assert law.apparent_impedance(HOME) is None


@pytest.fixture(scope="module")
def led() -> taut.Run:
    law = taut.laws.Admittance(
        D=(8.0, 1.0), B=(20.0, 2.0), K=(50.0, 5.0), inner=taut.laws.TaskComputedTorque(kp=1600.0, kd=80.0)
    )
    wave = taut.environments.Oscillation(amplitude=[5.0, 3.0, 0.0], frequency=0.8)
    hand = taut.environments.Hand(mass=1.0, damping=5.0, stiffness=0.0, force=wave)
    plant = taut.RigidPlant(PANDA, friction=None, environment=hand)
    return taut.run(taut.compile(law, PANDA), plant, duration=2.0)


def test_the_apparent_mass_is_the_one_that_was_asked_for(led: taut.Run) -> None:
    assert led.metrics.apparent_mass == pytest.approx(8.0, rel=0.03)
    assert led.metrics.impedance_error < 3.0
    assert led.metrics.task_final == pytest.approx(float(np.linalg.norm(led.task.position_error[-1])))


def test_another_mass_is_told_apart(led: taut.Run) -> None:
    wrong = led.info.impedance
    assert wrong is not None
    half = dataclasses.replace(wrong, D=0.5 * wrong.D)
    other = dataclasses.replace(led, info=dataclasses.replace(led.info, impedance=half))
    assert other.metrics.impedance_error > 10.0


def test_what_changes_in_the_run_or_is_not_pushed_has_no_meaning(led: taut.Run) -> None:
    event = Change(t=1.0, set={"law.K": np.ones(2)})
    changed = dataclasses.replace(led, info=dataclasses.replace(led.info, events=(event,)))
    still = dataclasses.replace(led, extra={"F_ext": np.zeros_like(led.extra["F_ext"])})
    for run in (changed, still):
        assert expected_deviation(run) is None
        assert np.isnan(run.metrics.impedance_error)
        assert np.isnan(run.metrics.apparent_mass)


def test_a_jump_of_torque_is_told_from_a_slope(led: taut.Run) -> None:
    t = led.t[:, np.newaxis]
    ramp = np.where(t < 0.5, 0.0, 100.0 * (t - 0.5)) * np.ones(7)  # a kink, and 0.1 N m in each tick
    step = ramp + np.where(t < 1.0, 0.0, 3.0) * np.eye(7)[2]
    assert dataclasses.replace(led, tau=ramp).metrics.torque_jump.max() < 1e-9
    assert dataclasses.replace(led, tau=step).metrics.torque_jump == pytest.approx([0, 0, 3.0, 0, 0, 0, 0], abs=1e-9)


def test_shares_of_limits_are_those_of_the_arm(led: taut.Run) -> None:
    assert led.metrics.torque_use == pytest.approx(100.0 * np.abs(led.tau).max(axis=0) / PANDA.effort)
    assert led.metrics.speed_use == pytest.approx(100.0 * np.abs(led.v).max(axis=0) / PANDA.velocity)
    bare = dataclasses.replace(led, info=dataclasses.replace(led.info, limits={}))
    assert np.isnan(bare.metrics.torque_use).all()
