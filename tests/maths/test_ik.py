"""Damped Newton steps and resolved rates against Pinocchio, NumPy and differences, at the special points and at random."""

from __future__ import annotations

import numpy as np
import pytest
from maths_oracles import random_tree, torso
from scipy.spatial.transform import Rotation

import taut
from taut.maths import ik
from taut.maths.model import model_of

ROUNDING = 1e-12
DIFFERENCE = 1e-8  # what a central difference of step 1e-6 is worth


def arms() -> list[taut.Arm]:
    rng = np.random.default_rng(0)
    named = [taut.load_arm(name) for name in ("planar3", "gantry3", "panda", "ur10", "so101", "kinova")]
    return [*named, random_tree(rng, 6), random_tree(rng, 8, branches=False), torso(rng)]


@pytest.mark.parametrize("name", ["planar3", "gantry3", "ur10", "panda", "xarm7", "kinova", "z1"])
def test_newton_steps_converge_quadratically(name: str) -> None:
    """What is left of an error e is at most c e^2 (1 + trust / sigma^2)."""
    arm = taut.load_arm(name)
    task, rng = ik.task_of(arm, None, "all"), np.random.default_rng(2)
    for size in (1e-2, 1e-3, 1e-4):
        for _ in range(5):
            q = arm.home + 0.2 * rng.normal(size=arm.n)
            T_des = taut.snapshot(arm, q + size * rng.normal(size=arm.n)).T()
            J = task.seen(taut.snapshot(arm, q).T(), taut.snapshot(arm, q).J())
            smallest = np.linalg.svd(J)[1][: task.rank].min()
            e = task.error(taut.snapshot(arm, q).T(), T_des)
            q_new = q + ik.Resolved(J, np.ones(arm.n), np.linalg.norm(e))(e)
            left = np.linalg.norm(task.error(taut.snapshot(arm, q_new).T(), T_des))
            assert left <= 10.0 * (e @ e) / smallest**2 + ROUNDING


@pytest.mark.parametrize(("rows", "joints"), [(6, 7), (3, 7), (6, 6), (6, 5), (3, 2)])
def test_resolved_rates_are_numpys_least_squares(rows: int, joints: int) -> None:
    rng = np.random.default_rng(rows + joints)
    J, b, null = rng.normal(size=(rows, joints)), rng.normal(size=rows), rng.normal(size=joints)
    plus = np.linalg.pinv(J)
    solve = ik.Resolved(J, np.ones(joints), 0.0)
    assert np.abs(solve(b) - plus @ b).max() <= ROUNDING * np.linalg.cond(J) ** 2
    if rows < joints:
        wanted = plus @ b + null - plus @ (J @ null)
        assert np.abs(solve(b, null) - wanted).max() <= ROUNDING * np.linalg.cond(J) ** 2
        assert np.abs(J @ solve(b, null) - b).max() <= ROUNDING * np.linalg.cond(J) ** 2


@pytest.mark.parametrize(("rows", "joints"), [(6, 7), (6, 6), (6, 5)])
def test_held_joints_do_not_move_and_the_others_do_what_they_can(rows: int, joints: int) -> None:
    rng = np.random.default_rng(rows + joints)
    J, b = rng.normal(size=(rows, joints)), rng.normal(size=rows)
    free = np.ones(joints)
    free[2] = 0.0
    x = ik.Resolved(J, free, 1e-14)(b)
    assert x[2] == 0.0
    others = np.delete(J, 2, axis=1)
    assert np.abs(np.delete(x, 2) - np.linalg.pinv(others) @ b).max() <= 1e-9


def test_damping_is_all_at_a_singularity_and_nothing_away_from_one() -> None:
    rng = np.random.default_rng(3)
    for joints in (5, 6, 7):
        U, _, V = np.linalg.svd(rng.normal(size=(6, joints)), full_matrices=False)
        others, free = np.linspace(1.0, 2.0, len(V) - 1), np.ones(joints)
        found = []
        for smallest in (0.0, 1e-3, 0.05, 0.3):
            J = U @ np.diag([*others, smallest]) @ V
            found.append(float(ik.damping_near_singularity(J, free, 0.05)))
        assert found[0] == pytest.approx(0.05**2, rel=1e-6)
        assert 0.0 < found[2] < found[1] < found[0]
        assert found[3] == 0.0


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 0.3, 1.5, np.pi - 1e-6, np.pi])
def test_pointing_takes_the_shortest_turn_of_the_axis(angle: float) -> None:
    arm = taut.load_arm("ur10")
    task = ik.task_of(arm, None, "pointing")
    T = taut.snapshot(arm, arm.home).T()
    axis = T.R @ np.array([np.cos(0.4), np.sin(0.4), 0.0])
    turned = Rotation.from_rotvec(angle * axis).as_matrix() @ T.R @ Rotation.from_euler("z", 0.8).as_matrix()
    _, angular = task.parts(T, taut.Pose.of(turned, np.array(T.p)))
    assert np.linalg.norm(angular) == pytest.approx(angle, abs=1e-9)
    if angle < np.pi:
        assert np.abs(angular - angle * np.array([np.cos(0.4), np.sin(0.4)])).max() <= 1e-8


@pytest.mark.parametrize(
    ("name", "directions", "rows", "rank"),
    [("planar2", "all", 3, 2), ("planar3", "all", 3, 3), ("so101", "all", 6, 5), ("so101", "pointing", 5, 5),
     ("panda", "position", 3, 3), ("gantry3", "all", 3, 3)],
)  # fmt: skip
def test_a_task_knows_in_how_many_directions_the_arm_moves(
    name: str, directions: ik.Directions, rows: int, rank: int
) -> None:
    task = ik.task_of(taut.load_arm(name), None, directions)
    assert (task.size, task.rank) == (rows, rank)


def test_rows_of_pointing_change_at_the_rate_that_they_say() -> None:
    arm, h = taut.load_arm("ur10"), 1e-6
    model, task = model_of(arm), ik.task_of(arm, None, "pointing")
    rng = np.random.default_rng(4)
    q, v = arm.home + 0.3, rng.normal(size=6)
    x = taut.snapshot(arm, q, v)
    J_rate = taut.math.jacobian(lambda s: taut.dynamics.jacobian(model, q + s[0] * v), [0.0])[..., 0]
    rate = task.seen_rate(x.T(), x.twist()[3:], x.J(), J_rate)
    after, before = (
        task.seen(taut.snapshot(arm, q + s * h * v).T(), taut.snapshot(arm, q + s * h * v).J()) for s in (1.0, -1.0)
    )
    assert np.abs(rate - (after - before) / (2.0 * h)).max() <= DIFFERENCE


def test_every_outcome_has_a_number_of_its_own() -> None:
    assert [ik.IkOutcome.of(outcome.code) for outcome in ik.IkOutcome] == list(ik.IkOutcome)
