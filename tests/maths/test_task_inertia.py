"""Inertia at the tool, and joint accelerations for a task: away from singularities, at them, and between."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import taut
from taut.maths.singularity import ResolvedMotion, resolve, sizes_of
from taut.maths.task_inertia import TaskInertia, least_direction
from taut.trace.linalg import factor_spd

ARMS = ["panda", "ur10", "xarm7"]
CANDLE = np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0])


def states(name: str, count: int, seed: int = 0) -> list[taut.Snapshot]:
    """An arm somewhere about its home, in motion."""
    arm, rng = taut.load_arm(name), np.random.default_rng(seed)
    spread = [(arm.home + rng.uniform(-0.6, 0.6, arm.n), rng.uniform(-0.3, 0.3, arm.n)) for _ in range(count)]
    return [taut.snapshot(arm, q, v) for q, v in spread]


def stretched(bend: float) -> taut.Snapshot:
    """A UR10 whose elbow is almost straight, and nothing else is special."""
    arm = taut.load_arm("ur10")
    return taut.snapshot(arm, [0.3, -0.9, bend, -1.2, -1.4, 0.2], [0.1, -0.2, 0.1, 0.2, 0.1, -0.1])


def resolved(x: taut.Snapshot, a: Any, held: float = 0.0) -> ResolvedMotion:
    return resolve(x, x.J(), a, rate=20.0, held=held)


@pytest.mark.parametrize("name", ARMS)
def test_the_inertia_is_that_of_the_formula(name: str) -> None:
    for x in states(name, 5):
        J, Minv = x.J(), np.linalg.inv(x.M)
        found = TaskInertia.of(J, x.M_factors)
        wanted = np.linalg.inv(J @ Minv @ J.T)
        assert np.abs(found.Lambda - wanted).max() < 1e-9 * np.abs(wanted).max()
        J_bar = Minv @ J.T @ wanted
        felt = np.column_stack([found.wrench(tau) for tau in np.eye(x.n)])
        assert np.abs(felt - J_bar.T).max() < 1e-9 * np.abs(J_bar).max()
        F = np.arange(1.0, 7.0)
        assert np.abs(found.wrench(J.T @ F) - F).max() < 1e-8
        assert np.abs(found.joint_acceleration(F) - Minv @ J.T @ F).max() < 1e-9 * np.abs(Minv).max()
        assert np.abs(found.mobility - J @ Minv @ J.T).max() < 1e-12 * np.abs(Minv).max()
        damped = TaskInertia.of(J, x.M_factors, 0.05)
        assert np.abs(damped.Lambda - np.linalg.inv(J @ Minv @ J.T + 0.05 * np.eye(6))).max() < 1e-9


@pytest.mark.parametrize("name", ["panda", "xarm7"])
def test_projected_torques_do_not_move_the_task(name: str) -> None:
    for x in states(name, 5):
        tau = np.arange(1.0, x.n + 1.0)
        for inertia in (TaskInertia.of(x.J(), x.M_factors), resolved(x, np.zeros(6))):
            once = inertia.project(tau)
            assert np.abs(x.J() @ np.linalg.solve(x.M, once)).max() < 1e-6
            assert np.abs(inertia.project(once) - once).max() < 1e-6
            assert np.abs(once).max() > 0.05


def test_a_bounded_inertia_is_the_inertia_until_it_is_large_along_the_lost_direction() -> None:
    for bend in (1.0, 0.3, 0.1, 1e-2, 1e-4, 0.0):
        x = stretched(bend)
        u, _ = least_direction(x.J())
        found = TaskInertia.bounded(x.J(), x.M_factors, 200.0).Lambda
        assert np.abs(found - found.T).max() < 1e-3  # of numbers of 1e12 that cancel
        assert np.linalg.eigvalsh(found).min() > 0.0
        assert u @ found @ u <= 200.0 * (1.0 + 1e-6)
        if bend > 0.0:
            plain = TaskInertia.of(x.J(), x.M_factors).Lambda
            same = np.abs(found - plain).max() < 1e-6 * np.abs(plain).max()
            assert same == (u @ plain @ u < 100.0)


@pytest.mark.parametrize("name", ["planar2", "planar3", "gantry3", "so101", "one_joint"])
def test_a_bounded_inertia_serves_arms_that_lack_directions(name: str) -> None:
    x = states(name, 1)[0]
    Lambda = TaskInertia.bounded(x.J(), x.M_factors, 100.0).Lambda
    assert np.isfinite(Lambda).all()


def test_the_least_direction_is_the_last_singular_vector_where_it_is_nearly_lost() -> None:
    for bend in (0.1, 0.03, 0.01, 1e-3, 1e-6):
        J = stretched(bend).J()
        U, sizes, _ = np.linalg.svd(J)
        u, square = least_direction(J)
        off = 1.0 - abs(U[:, -1] @ u)
        assert abs(square - (J.T @ u) @ (J.T @ u)) < 1e-9 * sizes[-1] ** 2 + 1e-14
        assert off < 3.0 * (sizes[-1] / sizes[-2]) ** 4 + 1e-12
    assert least_direction(np.diag([2.0, 1e-9, 3.0]))[0].round(6).tolist() == [0.0, 1.0, 0.0]


def test_inverse_iteration_finds_the_least_eigenvector_of_random_matrices() -> None:
    rng = np.random.default_rng(0)
    for n in (1, 2, 4, 7):
        for _ in range(20):
            Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
            A = Q @ np.diag(np.append(1e-4, rng.uniform(0.5, 2.0, n - 1))) @ Q.T
            assert abs(factor_spd(A).least_direction()[0] @ Q[:, 0]) > 1.0 - 1e-6


@pytest.mark.part(2)
@pytest.mark.parametrize("name", ARMS)
def test_away_from_singularities_the_torque_is_that_of_the_plain_law(name: str) -> None:
    tried = 0
    for x in states(name, 40):
        if np.linalg.svd(x.J(), compute_uv=False)[-1] < 0.1:
            continue
        a = np.array([1.0, -2.0, 0.5, 3.0, 1.0, -1.0])
        way = resolved(x, a)
        wanted = x.J().T @ (TaskInertia.of(x.J(), x.M_factors).Lambda @ a)
        assert np.abs(way.scale * (x.M @ way.accelerations) - wanted).max() < 1e-6 * np.abs(wanted).max()
        assert np.abs(way.of(a) - way.accelerations).max() < 1e-6 * np.abs(way.accelerations).max()
        assert (way.scale, way.lost, way.held) == (1.0, 0.0, 0.0)
        tried += 1
    assert tried >= 10


@pytest.mark.parametrize("at", [CANDLE, np.zeros(6), stretched(0.0).q], ids=["candle", "stretched", "elbow"])
def test_at_a_singular_pose_what_is_left_is_followed_and_nothing_is_large(at: np.ndarray) -> None:
    arm = taut.load_arm("ur10")
    x = taut.snapshot(arm, at, np.zeros(6))
    U, sizes, _ = np.linalg.svd(x.J())
    lost = U[:, sizes < 1e-9]
    assert lost.shape[1] >= 1
    assert np.abs(resolved(x, lost[:, 0]).accelerations).max() < 100.0
    for torque in (resolved(x, 1e3 * a) for a in np.eye(6)):
        tau = torque.scale * (x.M @ torque.accelerations)
        assert (np.abs(tau) <= 0.1 * arm.effort * (1.0 + 1e-9)).all()
        assert (np.abs(torque.accelerations) <= 20.0 * arm.velocity).all()


def test_motion_in_the_lost_direction_dies_out_at_the_rate_of_the_task() -> None:
    arm, q = taut.load_arm("ur10"), stretched(0.0).q
    w = np.linalg.svd(taut.snapshot(arm, q).J())[2][-1]
    x = taut.snapshot(arm, q, 0.01 * w)
    assert np.abs(resolved(x, np.zeros(6)).accelerations + 20.0 * x.v).max() < 1e-6


def test_limits_of_a_singularity_act_on_outside_it_until_nothing_is_left_to_cut() -> None:
    x = states("ur10", 1)[0]
    assert np.linalg.svd(x.J(), compute_uv=False)[-1] > 0.1
    for a, held, kept in ((1.0, 0.0, 0.0), (1e3, 0.0, 0.0), (1e3, 1.0, 1.0), (1e3, 0.5, 0.5), (0.01, 1.0, 0.0)):
        way = resolved(x, np.full(6, a), held)
        assert way.held == kept
        assert (way.scale < 1.0) == (kept > 0.0)


def test_the_border_is_a_tenth_for_arms_of_human_size_and_less_for_small_ones() -> None:
    assert sizes_of(taut.load_arm("ur10")).border == 0.1
    assert sizes_of(taut.load_arm("panda")).border == 0.1
    assert sizes_of(taut.load_arm("so101")).border < 0.06
    assert sizes_of(taut.load_arm("gantry3")).border > 0.0


def test_terms_add_up_to_the_torque_near_a_singularity() -> None:
    arm = taut.load_arm("ur10")
    ctrl = taut.compile(taut.laws.TaskComputedTorque(kp=100.0, kd=20.0), arm)
    x = stretched(0.05)
    T = x.T()
    tau = ctrl.step(x.q, x.v, taut.TaskMotion(pose=taut.Pose(np.add(T.p, [0.1, 0.0, 0.05]), R=T.R)))
    assert np.abs(sum(ctrl.terms.values()) - tau).max() < 1e-9
    assert np.abs(ctrl.terms["singularity"]).max() > 0.1


@pytest.mark.part(2)
@pytest.mark.parametrize("kd", [20.0, (20.0, 15.0), np.diag([20.0, 20.0, 20.0, 12.0, 12.0, 12.0])])
def test_any_shape_of_kd_tells_how_fast_joints_settle(kd: Any) -> None:
    arm = taut.load_arm("ur10")
    x = stretched(0.05)
    taus = []
    for engine in ("native", "float"):
        ctrl = taut.compile(taut.laws.TaskComputedTorque(kp=100.0, kd=kd), arm, engine=engine)
        taus.append(ctrl.step(x.q, x.v, taut.TaskMotion(pose=x.T())))
    assert np.abs(taus[0] - taus[1]).max() < 1e-9
    assert np.isfinite(taus[0]).all()
