"""The four arms of our own, against what can be written down by hand."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arm_oracles import pinocchio_of
from refusals import refused

from taut.arm.builtin import BUILT_IN, one_joint
from taut.arm.description import Arm
from taut.arm.load import load_arm
from taut.base.errors import RangeError, TautError


def torque(arm: Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    model = pinocchio_of(arm)
    return pin.rnea(model, model.createData(), np.asarray(q), np.asarray(v), np.asarray(a)) + arm.viscous * v


@pytest.mark.parametrize("theta", [0.0, 0.7, np.pi / 2, -2.0])
def test_the_chapters_link_obeys_equation_10_4(theta: float) -> None:
    arm = load_arm("one_joint")
    q, v, a = np.array([theta]), np.array([1.3]), np.array([-0.4])
    expected = 0.5 * a + 1.0 * 9.81 * 0.1 * np.cos(theta) + 0.1 * v
    np.testing.assert_allclose(torque(arm, q, v, a), expected, atol=1e-12)
    flat = load_arm("one_joint", gravity=(0, 0, 0))
    np.testing.assert_allclose(torque(flat, q, v, a), 0.5 * a + 0.1 * v, atol=1e-12)


def test_the_chapters_wrong_model_is_one_call() -> None:
    arm = one_joint(r=0.08)
    q, zero = np.array([0.3]), np.zeros(1)
    np.testing.assert_allclose(torque(arm, q, zero, zero), 9.81 * 0.08 * np.cos(0.3), atol=1e-12)
    np.testing.assert_allclose(torque(arm, q, zero, np.ones(1)) - torque(arm, q, zero, zero), 0.5, atol=1e-12)


def test_a_positive_angle_raises_the_link() -> None:
    model = pinocchio_of(load_arm("one_joint"))
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array([0.5]))
    np.testing.assert_allclose(
        data.oMf[model.getFrameId("tool")].translation, (0.1 * np.cos(0.5), 0, 0.1 * np.sin(0.5)), atol=1e-15
    )


@pytest.mark.parametrize(("name", "lengths"), [("planar2", [0.5, 0.4]), ("planar3", [0.4, 0.3, 0.2])])
def test_planar_arms_reach_along_their_angles(name: str, lengths: list[float]) -> None:
    arm = load_arm(name)
    model = pinocchio_of(arm)
    data, q = model.createData(), np.linspace(0.3, 0.9, arm.n)
    pin.framesForwardKinematics(model, data, q)
    turned = np.cumsum(q)
    expected = (np.sum(lengths * np.cos(turned)), 0.0, np.sum(lengths * np.sin(turned)))
    np.testing.assert_allclose(data.oMf[model.getFrameId("tool")].translation, expected, atol=1e-15)


def test_planar2s_mass_matrix_is_the_textbooks_in_closed_form() -> None:
    arm = load_arm("planar2")
    (m1, m2), (L1, c1, c2) = (4.0, 2.0), (0.5, 0.25, 0.2)
    I1, I2 = (body.inertia[1, 1] for body in arm.bodies)
    q = np.array([0.4, 1.1])
    coupling = m2 * L1 * c2 * np.cos(q[1])
    M = np.array(
        [
            [I1 + m1 * c1**2 + I2 + m2 * (L1**2 + c2**2) + 2 * coupling, I2 + m2 * c2**2 + coupling],
            [I2 + m2 * c2**2 + coupling, I2 + m2 * c2**2],
        ]
    )
    model = pinocchio_of(arm)
    np.testing.assert_allclose(pin.crba(model, model.createData(), q), M, atol=1e-14)


def test_the_gantrys_slides_carry_what_hangs_on_them() -> None:
    arm = load_arm("gantry3")
    model = pinocchio_of(arm)
    np.testing.assert_allclose(
        pin.crba(model, model.createData(), np.zeros(3)), np.diag([21.0, 9.0, 3.0]), atol=1e-12
    )
    np.testing.assert_allclose(torque(arm, np.zeros(3), np.zeros(3), np.zeros(3)), (0, 0, 3 * 9.81), atol=1e-12)
    assert arm.units == ("m", "m", "m")


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_home_is_no_singularity(name: str) -> None:
    arm = load_arm(name)
    model = pinocchio_of(arm)
    J = pin.computeFrameJacobian(model, model.createData(), arm.home, model.getFrameId("tool"))
    assert np.linalg.svd(np.reshape(J, (6, arm.n)), compute_uv=False)[-1] > 0.05
    assert arm.commands == ("torque", "velocity", "position")
    assert arm.visuals


@pytest.mark.parametrize(
    "values",
    [
        {"M": 0.01},
        {"M": -1.0},
        {"m": 0.0},
        {"m": float("nan")},
        {"r": float("inf")},
        {"b": -0.1},
    ],
)
def test_a_link_that_cannot_be_is_refused(values: dict[str, float]) -> None:
    with refused(RangeError):
        one_joint(**values)


def test_words_for_numbers_are_refused() -> None:
    with refused(TautError):
        one_joint(m="heavy")
