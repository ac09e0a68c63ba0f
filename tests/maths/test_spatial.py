"""Rotations and rigid motions against SciPy, Pinocchio and differences, at the special points and at random."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import taut
from taut.maths import spatial
from taut.trace import math as tm

ANGLES = [0.0, 1e-12, 1e-8, 1e-5, 1e-3, 0.00999, 0.01001, 0.5, 2.0, 3.0]
NEAR_PI = [np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12, np.pi]
DIFFERENCE = 1e-8  # what a central difference of step 1e-6 is worth
ROUNDING = 5e-15


def axes() -> list[np.ndarray]:
    random = np.random.default_rng(1).normal(size=(12, 3))
    return [*np.eye(3), *-np.eye(3), *(random / np.linalg.norm(random, axis=1, keepdims=True))]


def turned(axis: np.ndarray, angle: float) -> np.ndarray:
    return Rotation.from_rotvec(axis * angle).as_matrix()


def pose_exp(xi: np.ndarray) -> taut.Pose:
    """The pose after one second of a constant twist, by Pinocchio."""
    T = pin.exp6(pin.Motion(xi))
    return taut.Pose.of(T.rotation, T.translation)


@pytest.mark.parametrize("angle", [*ANGLES, *NEAR_PI])
def test_the_logarithm_is_the_rotation_vector(angle: float) -> None:
    for axis in axes():
        w = spatial.rotation_log(turned(axis, angle))
        error = np.abs(w - axis * angle).max()
        if angle == np.pi:  # both axes are right
            error = min(error, np.abs(w + axis * angle).max())
        assert error <= ROUNDING * max(1.0, angle)
        assert np.abs(spatial.rotation_exp(w) - turned(axis, angle)).max() <= ROUNDING


def test_a_small_rotation_keeps_all_its_digits() -> None:
    w = np.array([1.0e-9, -2.0e-9, 3.0e-9])
    got = spatial.rotation_log(spatial.rotation_exp(w))
    assert np.abs(got - w).max() <= 1e-24


@pytest.mark.parametrize("angle", [*ANGLES, *NEAR_PI])
def test_a_pose_is_the_exponential_of_its_logarithm(angle: float) -> None:
    rng = np.random.default_rng(2)
    for axis in axes():
        p = rng.normal(size=3)
        T = taut.Pose.of(turned(axis, angle), p)
        back = pose_exp(spatial.pose_log(T))
        assert np.abs(back.p - p).max() <= 1e-13
        assert np.abs(back.R - T.R).max() <= 1e-13


@pytest.mark.parametrize("angle", ANGLES)
def test_the_logarithm_of_a_pose_is_pinocchios(angle: float) -> None:
    rng = np.random.default_rng(3)
    for axis in axes():
        p = rng.normal(size=3)
        R = turned(axis, angle)
        theirs = pin.log6(pin.SE3(R, p)).vector
        assert np.abs(spatial.pose_log(taut.Pose.of(R, p)) - theirs).max() <= 2e-13


@pytest.mark.parametrize("angle", ANGLES)
def test_the_rate_of_the_logarithm_is_that_of_differences(angle: float) -> None:
    rng = np.random.default_rng(4)
    h = 1e-6
    for axis in axes():
        T = taut.Pose.of(turned(axis, angle), rng.normal(size=3))
        V = rng.normal(size=6)
        xi = spatial.pose_log(T)
        after, before = (spatial.pose_log(pose_exp(sign * h * V) @ T) for sign in (1.0, -1.0))
        assert np.abs(spatial.pose_log_rate(xi) @ V - (after - before) / (2.0 * h)).max() <= DIFFERENCE


def test_the_rate_at_a_pure_translation_is_half_a_bracket() -> None:
    v = np.array([0.3, -0.2, 0.5])
    expected = np.eye(6)
    expected[:3, 3:] = -0.5 * tm.skew(v)
    assert np.abs(spatial.pose_log_rate(np.array([*v, 0.0, 0.0, 0.0])) - expected).max() <= 1e-16


@pytest.mark.parametrize("angle", [*ANGLES, np.pi - 1e-3])
def test_the_inverse_jacobian_of_a_rotation_is_that_of_pinocchios(angle: float) -> None:
    for axis in axes():
        J = pin.Jexp3(axis * angle).T
        assert np.abs(spatial.left_jacobian_inverse(axis * angle) @ J - np.eye(3)).max() <= 1e-13


def test_the_adjoint_moves_twists_as_poses_move_points() -> None:
    rng = np.random.default_rng(5)
    T = taut.Pose.of(turned(axes()[7], 1.1), rng.normal(size=3))
    xi = rng.normal(size=6)
    left = pose_exp(spatial.adjoint(T) @ xi)
    right = T @ pose_exp(xi) @ T.inverse()
    assert np.abs(left.matrix - right.matrix).max() <= 1e-14


def test_derivatives_through_a_traced_logarithm_are_finite_at_the_identity() -> None:
    J = tm.jacobian(lambda xi: spatial.pose_log(spatial.moved(taut.Pose(), xi)), np.zeros(6))
    assert np.abs(J - np.eye(6)).max() <= 1e-15


def test_six_numbers_are_turned_part_by_part() -> None:
    R = turned(axes()[8], 0.7)
    assert spatial.rotated(R, np.arange(6.0)) == pytest.approx([*(R @ [0.0, 1.0, 2.0]), *(R @ [3.0, 4.0, 5.0])])
