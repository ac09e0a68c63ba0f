"""Chunks of task motions, and the fade from one motion to another: smooth on SE(3), with exact rates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.spatial.transform import Rotation, Slerp
from task_motion_tools import POSES, START, assert_exact_rates

import taut
from taut.base.types import Float64Array
from taut.control.tasks.feed import Fade
from taut.control.trajectories.reference import Sample, sample_rows
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.spatial import exp_rows, from_body_rates, log_rows, to_body_rates

ARM = taut.load_arm("planar2")
TIMES = np.array([0.0, 0.6, 1.1, 2.0])
INSIDE = np.linspace(0.013, 1.983, 23)
FIELDS = ("p", "R", "twist", "acceleration")
MOVING = taut.trajectories.Line(T0=START, T1=POSES["generic"], duration=2.0)
OTHER = taut.trajectories.Circle(
    T0=START,
    centre=START.p + np.array([0.0, 0.2, 0.0]),
    axis=[0.0, 0.6, 0.8][::-1] * np.array([1, 0, 1]),
    orientation="turn",
    duration=3.0,
)


def sampled(motion: Any, times: Float64Array) -> list[taut.TaskMotion]:
    return [motion.at(float(t)) for t in times]


class TestRotationRows:
    @pytest.mark.parametrize("size", [0.0, 1e-7, 1e-3, 0.03, 0.032, 1.0, np.pi - 1e-6, np.pi, 5.0])
    def test_body_rates_are_those_of_the_exponential_and_lead_back(self, size: float) -> None:
        rng = np.random.default_rng(1)
        r, r1, r2 = rng.standard_normal((3, 40, 3))
        r *= size / np.linalg.norm(r, axis=1)[:, np.newaxis]
        np.testing.assert_allclose(exp_rows(r), Rotation.from_rotvec(r).as_matrix(), atol=1e-14)

        def turned(t: float) -> Float64Array:
            return exp_rows(r + r1 * t + 0.5 * r2 * t * t)

        h = 1e-5
        omega, alpha = to_body_rates(r, r1, r2)
        steps = [log_rows(turned(-h).transpose(0, 2, 1) @ turned(h)) / (2 * h)]
        np.testing.assert_allclose(omega, steps[0], atol=1e-8)
        rates = [to_body_rates(r + r1 * t + 0.5 * r2 * t * t, r1 + r2 * t, r2)[0] for t in (-h, h)]
        np.testing.assert_allclose(alpha, (rates[1] - rates[0]) / (2 * h), atol=1e-8)
        for ours, given in zip(from_body_rates(r, omega, alpha), (r1, r2), strict=True):
            np.testing.assert_allclose(ours, given, atol=1e-11)

    def test_the_logarithm_leads_back(self) -> None:
        r = np.random.default_rng(2).standard_normal((50, 3))
        r *= np.minimum(1.0, 3.1 / np.linalg.norm(r, axis=1))[:, np.newaxis]
        np.testing.assert_allclose(log_rows(exp_rows(r)), r, atol=1e-13)


class TestChunks:
    @pytest.mark.parametrize("motion", [MOVING, OTHER], ids=["line", "circle"])
    def test_it_goes_through_its_samples_with_their_twists_and_accelerations(self, motion: Any) -> None:
        ahead = taut.chunk(TIMES, sampled(motion, TIMES))
        for t in TIMES[:-1]:
            for name in FIELDS:
                np.testing.assert_allclose(getattr(ahead.at(t), name), getattr(motion.at(t), name), atol=1e-13)
        assert_exact_rates(ahead, INSIDE)

    def test_it_nears_the_motion_that_it_was_sampled_from(self) -> None:
        """With the sixth power of the distance of the samples."""
        errors = []
        for count in (5, 9, 17):
            times = np.linspace(0.0, 2.0, count)
            rows = taut.chunk(times, sampled(OTHER, times)).rows(INSIDE)
            wanted = OTHER.rows(INSIDE)
            errors.append(np.abs(rows.p - wanted.p).max() + np.abs(rows.R - wanted.R).max())
        assert errors[0] < 1e-3
        assert errors[0] > 30.0 * errors[1] > 900.0 * errors[2]

    @pytest.mark.parametrize("T1", POSES.values(), ids=POSES)
    def test_two_poses_make_a_straight_line_with_slerp(self, T1: taut.Pose) -> None:
        ahead = taut.chunk([0.0, 2.0], [START, T1])
        rows = ahead.rows(INSIDE)
        np.testing.assert_allclose(rows.p, START.p + np.outer(0.5 * INSIDE, T1.p - START.p), atol=1e-14)
        slerp = Slerp([0.0, 2.0], Rotation.from_matrix([START.R, T1.R]))
        if not np.isclose(Rotation.from_matrix(START.R.T @ T1.R).magnitude(), np.pi):  # which has two ways
            np.testing.assert_allclose(rows.R, slerp(INSIDE).as_matrix(), atol=1e-13)
        assert_exact_rates(ahead, INSIDE)
        np.testing.assert_allclose(rows.acceleration, 0.0, atol=1e-12)

    def test_poses_get_the_twists_of_the_motion_that_they_come_from(self) -> None:
        times = np.linspace(0.0, 2.0, 201)
        ahead = taut.chunk(times, [MOVING.at(float(t)).pose for t in times])
        inner = INSIDE[1:-1]  # differences at the ends are one-sided
        rows, wanted = ahead.rows(inner), MOVING.rows(inner)
        np.testing.assert_allclose(rows.twist, wanted.twist, atol=2e-4)
        # Differences miss the velocity by h^2 / 6 times the jerk, which ripples the acceleration by about h times it.
        np.testing.assert_allclose(rows.acceleration, wanted.acceleration, atol=0.01 * 10.0)
        assert_exact_rates(ahead, INSIDE)

    def test_uneven_poses_get_the_differences_that_joints_get(self) -> None:
        p = np.array([[0.0, 0.0, 0.0], [0.3, 0.1, 0.0], [0.4, 0.4, 0.1], [0.4, 0.5, 0.3]])
        turns = [taut.Pose(row, R=Rotation.from_rotvec([0.0, 0.0, 2.0 * row[0]]).as_matrix()) for row in p]
        ahead, joints = taut.chunk(TIMES, turns), taut.chunk(TIMES, p)
        for t in TIMES[:-1]:
            np.testing.assert_allclose(ahead.at(t).twist[:3], joints.at(t).v, atol=1e-14)
            np.testing.assert_allclose(ahead.at(t).twist[5], 2.0 * joints.at(t).v[0], atol=1e-14)

    @pytest.mark.parametrize("targets", [[START], [START, POSES["generic"]], sampled(MOVING, np.array([0.5, 1.0]))])
    def test_before_and_after_its_ends_it_rests(self, targets: Any) -> None:
        ahead = taut.chunk([0.1, 0.2][: len(targets)], targets)
        for t, k in ((0.0, 0), (0.3, -1)):
            pose = targets[k] if isinstance(targets[k], taut.Pose) else targets[k].pose
            np.testing.assert_allclose(ahead.at(t).p, pose.p, atol=1e-15)
            np.testing.assert_allclose(ahead.at(t).R, pose.R, atol=1e-14)
            assert not ahead.at(t).twist.any()
            assert not ahead.at(t).acceleration.any()

    @pytest.mark.parametrize(
        "make",
        [
            lambda: taut.chunk([0.0], [START, START]),
            lambda: taut.chunk([0.0, 0.1], [START, taut.TaskMotion(pose=START)]),
            lambda: taut.chunk([0.0, 0.1], [taut.JointMotion(q=[0.0]), taut.TaskMotion(pose=START)]),
        ],
    )
    def test_targets_that_do_not_fit_are_refused(self, make: Any) -> None:
        with refused(taut.errors.ShapeError):
            make()


class TestFades:
    @pytest.mark.parametrize("duration", [0.05, 0.5])
    def test_task_motions_pass_without_a_jump_and_with_exact_rates(self, duration: float) -> None:
        class Passing:
            def rows(self, times: Float64Array) -> Sample:
                table = sample_rows(OTHER, times, TaskMotion, 2)
                return TaskMotion.of(fade.applied(table, times))

        t = np.array([0.7])
        old, new = (sample_rows(motion, t, TaskMotion, 2) for motion in (MOVING, OTHER))
        fade = Fade.of(TaskMotion, old, new, 0.7, duration, ARM)
        for name, value in fade.applied(new, t).items():
            np.testing.assert_allclose(value, old[name], atol=1e-12)
        inside = 0.7 + duration * np.linspace(0.02, 0.98, 13)
        # The third derivative, which a central difference misses, goes with duration^-3.
        assert_exact_rates(Passing(), inside, second=1e-7 / duration**4, first=1e-9 / duration**3)
        after = np.array([0.7 + duration, 2.0])
        for name, value in fade.applied(sample_rows(OTHER, after, TaskMotion, 2), after).items():
            np.testing.assert_allclose(value, getattr(OTHER.rows(after), name), atol=1e-11)

    def test_joints_pass_without_a_jump_the_short_way_round(self) -> None:
        arm = taut.load_arm("one_joint")
        old = {"q": np.array([[6.2]]), "v": np.array([[1.0]]), "a": np.array([[-2.0]])}
        new = {"q": np.array([[0.1]]), "v": np.array([[0.0]]), "a": np.array([[0.0]])}
        fade = Fade.of(taut.JointMotion, old, new, 0.0, 0.2, arm)
        first = fade.applied(new, np.array([0.0]))
        turn = 2.0 * np.pi if arm.continuous else 0.0
        np.testing.assert_allclose(first["q"], 6.2 - turn)
        np.testing.assert_allclose(first["v"], 1.0)
        np.testing.assert_allclose(first["a"], -2.0)
        h, t = 1e-5, np.linspace(0.01, 0.19, 7)
        near, now, far = (fade.applied(new, t + step) for step in (-h, 0.0, h))
        np.testing.assert_allclose(now["v"], (far["q"] - near["q"]) / (2 * h), atol=1e-6)
        np.testing.assert_allclose(now["a"], (far["v"] - near["v"]) / (2 * h), atol=1e-4)
        np.testing.assert_allclose(fade.applied(new, np.array([0.2]))["q"], 0.1)


def test_a_reference_of_ones_own_that_gives_no_rotation_is_refused() -> None:
    class Mine:
        def at(self, t: float) -> taut.TaskMotion:
            R = START.R * (1.0 + 0.1 * (t > 0.5))
            return TaskMotion.of({"p": START.p, "R": R, "twist": np.zeros(6), "acceleration": np.zeros(6)})

    class Broken:
        def at(self, t: float) -> taut.TaskMotion:
            R = START.R.copy()
            R[1, 2] = np.nan
            return TaskMotion.of({"p": START.p, "R": R, "twist": np.zeros(6), "acceleration": np.zeros(6)})

    times = np.linspace(0.0, 1.0, 5)
    with refused(taut.errors.RangeError):
        sample_rows(Mine(), times, TaskMotion, 7)
    with refused(taut.errors.RangeError):
        sample_rows(Broken(), times, TaskMotion, 7)


def test_chunks_for_laws_side_by_side_blend_each_part_as_it_is() -> None:
    way = sampled(MOVING, TIMES)
    both = [taut.together(left=sample, right=taut.JointMotion(q=[t])) for t, sample in zip(TIMES, way, strict=True)]
    ahead: Any = taut.chunk(TIMES, both).at(0.4)
    alone: Any = taut.chunk(TIMES, way).at(0.4)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(ahead.left, name), getattr(alone, name), atol=1e-15)
    np.testing.assert_allclose(ahead.right.q, [0.4])
