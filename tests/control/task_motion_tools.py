"""Central differences of motions on SE(3), and special poses."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import taut
from taut.base.types import Float64Array

STEP = 1e-5  # [s]
CENTRAL = 2e-7  # error of a central difference of these motions at STEP, with their rounding over 2 STEP
SECOND = 1e-5  # the same of accelerations, from twists that are right to rounding

START = taut.Pose([0.4, -0.1, 0.3], rpy=[3.0, 0.2, -0.4])


def away(rotvec: Any, p: Any = (0.2, 0.1, -0.15)) -> taut.Pose:
    """START moved by p and turned by a rotation vector in its own axes."""
    return taut.Pose(START.p + np.asarray(p), R=START.R @ Rotation.from_rotvec(rotvec).as_matrix())


AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
POSES = {
    "identity": START,
    "pure translation": away([0.0, 0.0, 0.0]),
    "pure rotation": away([0.3, -0.5, 0.2], [0.0, 0.0, 0.0]),
    "rotation 1e-7": away(1e-7 * AXIS),
    "generic": away([0.7, -1.1, 0.4]),
    "near pi": away((np.pi - 1e-4) * AXIS),
    "pi": away(np.pi * AXIS),
    "pi about z": away([0.0, 0.0, np.pi]),
}


def rates_by_differences(motion: Any, times: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Twist and acceleration (k, 6) in world axes, by central differences of the pose and of the twist."""
    before, after = motion.rows(times - STEP), motion.rows(times + STEP)
    v = (after.p - before.p) / (2.0 * STEP)
    turned = Rotation.from_matrix(after.R @ before.R.transpose(0, 2, 1)).as_rotvec()
    return np.hstack([v, turned / (2.0 * STEP)]), (after.twist - before.twist) / (2.0 * STEP)


def assert_exact_rates(motion: Any, times: Float64Array, second: float = SECOND, first: float = CENTRAL) -> None:
    """Twist and acceleration of a motion are the rates of its pose."""
    rows = motion.rows(times)
    twist, acceleration = rates_by_differences(motion, times)
    np.testing.assert_allclose(rows.twist, twist, atol=first)
    np.testing.assert_allclose(rows.acceleration, acceleration, atol=second)
    np.testing.assert_allclose(
        rows.R @ rows.R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), rows.R.shape), atol=1e-14
    )
