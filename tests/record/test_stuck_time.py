"""Stuck time and reversal error against motions whose numbers one can see."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import taut

T = np.arange(0.0, 4.0005, 0.001)


def test_a_joint_is_stuck_while_it_rests_and_its_reference_moves(make_run: Any) -> None:
    v = np.where((T >= 1.0) & (T < 1.25), 0.0, 0.3)[:, np.newaxis]
    run = make_run(T, 0.3 * T, v=v, v_ref=0.3)
    assert run.metrics.stuck_time[0] == pytest.approx(0.25, abs=1e-9)


def test_a_joint_that_rests_with_its_reference_is_not_stuck(make_run: Any) -> None:
    moving = (T < 2.0).astype(float)[:, np.newaxis]
    assert make_run(T, 0.0 * T, v=0.3 * moving, v_ref=0.3 * moving).metrics.stuck_time[0] == 0.0


@pytest.mark.parametrize(("v", "v_ref", "stuck"), [(0.9e-4, 1.1e-3, 4.0), (1.1e-4, 1.1e-3, 0.0)])
def test_the_speed_below_which_a_joint_rests_is_the_stated_one(
    make_run: Any, v: float, v_ref: float, stuck: float
) -> None:
    run = make_run(T, 0.0 * T, v=np.full((len(T), 1), v), v_ref=v_ref)
    assert run.metrics.stuck_time[0] == pytest.approx(stuck)


def test_a_reference_that_never_moves_leaves_nothing_to_be_stuck(make_run: Any) -> None:
    m = make_run(T, np.zeros((len(T), 2)), v_ref=np.array([0.9e-3, 0.3])).metrics
    assert np.isnan(m.stuck_time[0])
    assert m.stuck_time[1] == pytest.approx(4.0)
    assert m.overall("stuck_time") == pytest.approx(4.0)
    assert np.isnan(make_run(T, 0.0 * T, q_ref=1.0).metrics.overall("stuck_time"))


def test_all_joints_together_are_stuck_while_any_is(make_run: Any) -> None:
    v = np.full((len(T), 2), 0.3)
    v[(T >= 1.0) & (T < 1.5), 0] = 0.0
    v[(T >= 1.2) & (T < 2.0), 1] = 0.0
    m = make_run(T, np.zeros((len(T), 2)), v=v, v_ref=0.3).metrics
    assert m.stuck_time == pytest.approx([0.5, 0.8])
    assert m.overall("stuck_time") == pytest.approx(1.0)


def test_reversal_error_is_the_largest_until_halfway_to_the_next_turn(make_run: Any) -> None:
    v_ref = np.where((T < 1.0) | (T >= 3.0), 0.2, -0.2)
    error = np.full_like(T, 0.01)
    error[T == 0.5] = 9.0  # before the first turn
    error[np.isclose(T, 1.9)] = -0.3
    error[np.isclose(T, 2.2)] = 8.0  # nearer to the next turn
    error[np.isclose(T, 3.5)] = 0.2
    run = make_run(T, -error, v_ref=v_ref[:, np.newaxis])
    assert run.metrics.reversal_error[0] == pytest.approx(0.3)
    assert run.metrics.overall("reversal_error") == pytest.approx(0.3)
    error[-1] = 0.5  # after the last turn all that is left counts
    assert make_run(T, -error, v_ref=v_ref[:, np.newaxis]).metrics.reversal_error[0] == pytest.approx(0.5)


def test_a_turn_after_a_rest_counts_when_the_reference_moves_again(make_run: Any) -> None:
    v_ref = np.where(T < 1.0, 0.2, np.where(T < 2.0, 0.0, -0.2))
    error = np.full_like(T, 0.01)
    error[np.isclose(T, 1.2)] = 7.0
    error[np.isclose(T, 2.2)] = 0.4
    assert make_run(T, -error, v_ref=v_ref[:, np.newaxis]).metrics.reversal_error[0] == pytest.approx(0.4)


def test_without_a_turn_there_is_no_reversal_error(make_run: Any) -> None:
    stop_and_go = np.where((T > 1.0) & (T < 2.0), 0.0, 0.2)[:, np.newaxis]
    for v_ref in (0.0, 0.2, stop_and_go):
        assert np.isnan(make_run(T, 1.0 + T, v_ref=v_ref).metrics.reversal_error[0])


def test_dry_friction_holds_a_pd_joint_for_as_long_as_theory_says() -> None:
    """At a turn the joint rests, kp e = mu, until kp e + kd v_ref = -mu; the reference turns as A cos(omega t)."""
    mu, kp, kd, A, omega = 0.5, 20.0, 6.0, 0.5, 0.5
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0]).with_friction(taut.Friction(coulomb=mu))
    ctrl = taut.compile(taut.laws.PID(kp=kp, kd=kd), arm)
    ref = taut.trajectories.Sine(center=[0.0], amplitude=[A], frequency=omega / (2.0 * np.pi))
    run = taut.run(ctrl, taut.RigidPlant(arm), ref, duration=2.0 * np.pi / omega).between(1.0, 12.0)
    each = brentq(
        lambda t: kp * A * (1.0 - np.cos(omega * t)) + kd * A * omega * np.sin(omega * t) - 2.0 * mu, 0.0, 2.0
    )
    assert run.metrics.stuck_time[0] == pytest.approx(2.0 * each, rel=0.06)  # inertia carries it on a little
