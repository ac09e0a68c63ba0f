"""Arms in the textbook's notation, against the textbook's own numbers and its own algorithm."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arm_oracles import pinocchio_of
from refusals import refused

from taut.arm.description import Arm
from taut.base.errors import ModelError, RangeError, ShapeError, TautError

# The three joints that the library modern_robotics uses in all its examples of chapter 8.
M01 = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.089159], [0, 0, 0, 1]]
M12 = [[0, 0, 1, 0.28], [0, 1, 0, 0.13585], [-1, 0, 0, 0], [0, 0, 0, 1]]
M23 = [[1, 0, 0, 0], [0, 1, 0, -0.1197], [0, 0, 1, 0.395], [0, 0, 0, 1]]
M34 = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.14225], [0, 0, 0, 1]]
MLIST = np.array([M01, M12, M23, M34], dtype=float)
GLIST = np.array(
    [
        np.diag([0.010267, 0.010267, 0.00666, 3.7, 3.7, 3.7]),
        np.diag([0.22689, 0.22689, 0.0151074, 8.393, 8.393, 8.393]),
        np.diag([0.0494433, 0.0494433, 0.004095, 2.275, 2.275, 2.275]),
    ]
)
DOCS_SLIST = np.array([[1, 0, 1, 0, 1, 0], [0, 1, 0, -0.089, 0, 0], [0, 1, 0, -0.089, 0, 0.425]], dtype=float).T
ROOT2 = np.sqrt(2.0)
SLIST = DOCS_SLIST / [ROOT2, 1, 1]  # the first screw of those examples is not of unit length
G = [0.0, 0.0, -9.8]


def expm6(S: np.ndarray, theta: float) -> np.ndarray:
    """The matrix exponential of a twist, by its series: slow and plain."""
    w, v = S[:3], S[3:]
    X = np.zeros((4, 4))
    X[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
    X[:3, 3] = v
    total, term = np.eye(4), np.eye(4)
    for k in range(1, 40):
        term = term @ X * theta / k
        total = total + term
    return total


def Ad(T: np.ndarray) -> np.ndarray:
    R, p = T[:3, :3], T[:3, 3]
    hat = np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
    return np.block([[R, np.zeros((3, 3))], [hat @ R, R]])


def ad(V: np.ndarray) -> np.ndarray:
    w, v = V[:3], V[3:]
    hw = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    hv = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.block([[hw, np.zeros((3, 3))], [hv, hw]])


def inverse_dynamics(theta, dtheta, ddtheta, g, F_tip, M_list, G_list, S_list) -> np.ndarray:
    """Lynch and Park, Modern Robotics (2017), section 8.3.2, as it stands there."""
    n = len(theta)
    T_0, A, AdT = np.eye(4), np.zeros((6, n)), [np.zeros((6, 6))] * (n + 1)
    V, Vd = [np.zeros(6)] * (n + 1), [np.zeros(6)] * (n + 1)
    Vd[0] = np.concatenate([np.zeros(3), -np.asarray(g, dtype=float)])
    AdT[n] = Ad(np.linalg.inv(M_list[n]))
    F, tau = np.array(F_tip, dtype=float), np.zeros(n)
    for i in range(n):
        T_0 = T_0 @ M_list[i]
        A[:, i] = Ad(np.linalg.inv(T_0)) @ S_list[:, i]
        AdT[i] = Ad(expm6(A[:, i], -theta[i]) @ np.linalg.inv(M_list[i]))
        V[i + 1] = AdT[i] @ V[i] + A[:, i] * dtheta[i]
        Vd[i + 1] = AdT[i] @ Vd[i] + A[:, i] * ddtheta[i] + ad(V[i + 1]) @ A[:, i] * dtheta[i]
    for i in reversed(range(n)):
        F = AdT[i + 1].T @ F + G_list[i] @ Vd[i + 1] - ad(V[i + 1]).T @ (G_list[i] @ V[i + 1])
        tau[i] = F @ A[:, i]
    return tau


def torques(arm: Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray, F_tip: np.ndarray) -> np.ndarray:
    """The same through the Arm and Pinocchio; F_tip is the tool on the environment, angular first, tool axes."""
    model = pinocchio_of(arm)
    tau = pin.rnea(model, model.createData(), q, v, a)
    J = pin.computeFrameJacobian(model, model.createData(), q, model.getFrameId("tool"))  # linear first
    return tau + J.T @ np.concatenate([F_tip[3:], F_tip[:3]])


def test_the_numbers_printed_in_the_textbooks_library_come_out() -> None:
    arm = Arm.from_screws(MLIST, GLIST, SLIST, G)
    scale = np.array([ROOT2, 1.0, 1.0])  # a screw of length sqrt 2 is a joint whose angle counts sqrt 2 as fast
    theta, dtheta, ddtheta = np.array([0.1, 0.1, 0.1]), np.array([0.1, 0.2, 0.3]), np.array([2.0, 1.5, 1.0])
    tau = scale * torques(arm, scale * theta, scale * dtheta, scale * ddtheta, np.ones(6))
    np.testing.assert_allclose(tau, [74.69616155, -33.06766016, -3.23057314], atol=5e-9)


def test_the_arm_moves_as_the_textbooks_algorithm_says() -> None:
    rng = np.random.default_rng(0)
    arm = Arm.from_screws(MLIST, GLIST, SLIST, G, name="ur")
    for _ in range(5):
        q, v, a, F = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3), rng.normal(size=6)
        expected = inverse_dynamics(q, v, a, G, F, MLIST, GLIST, SLIST)
        np.testing.assert_allclose(torques(arm, q, v, a, F), expected, atol=1e-10)
    assert arm.name == "ur"
    assert arm.frame_names == ("base", "link1", "link2", "link3", "tool")
    assert arm.notes[0] == "no position limit on 'joint1', 'joint2', 'joint3'"


def test_prismatic_screws_and_masses_off_the_frame_are_read_too() -> None:
    rng = np.random.default_rng(1)
    S = SLIST.copy()
    S[:, 1] = [0, 0, 0, 0.6, 0.0, 0.8]
    general = []
    for G_i in GLIST:
        c = rng.normal(size=3) * 0.1
        T = np.eye(4)
        T[:3, 3] = c
        general.append(Ad(np.linalg.inv(T)).T @ G_i @ Ad(np.linalg.inv(T)))
    arm = Arm.from_screws(MLIST, general, S, [1.0, -2.0, 3.0])
    assert [joint.kind for joint in arm.joints] == ["revolute", "prismatic", "revolute"]
    for _ in range(5):
        q, v, a, F = rng.normal(size=3), rng.normal(size=3), rng.normal(size=3), rng.normal(size=6)
        expected = inverse_dynamics(q, v, a, [1.0, -2.0, 3.0], F, MLIST, np.array(general), S)
        np.testing.assert_allclose(torques(arm, q, v, a, F), expected, atol=1e-10)


def test_one_link_gives_the_pendulum_in_closed_form() -> None:
    m, r, I = 1.3, 0.4, 0.02
    at_com, tip = np.eye(4), np.eye(4)
    at_com[0, 3], tip[0, 3] = r, 0.2
    arm = Arm.from_screws(
        [at_com, tip], [np.diag([I, I, I, m, m, m])], np.array([[0, -1, 0, 0, 0, 0]]).T, [0, 0, -9.81]
    )
    model = pinocchio_of(arm)
    theta, a = 0.7, 0.3
    tau = pin.rnea(model, model.createData(), np.array([theta]), np.array([5.0]), np.array([a]))
    assert tau[0] == pytest.approx((I + m * r * r) * a + m * 9.81 * r * np.cos(theta), abs=1e-12)


def swapped_blocks(G_i: np.ndarray) -> np.ndarray:
    return np.roll(np.roll(G_i, 3, axis=0), 3, axis=1)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"Slist": DOCS_SLIST}, ModelError),
        ({"Slist": np.array([[0, 0, 1, 0, 0, 0.1], *SLIST.T[1:]]).T}, ModelError),
        ({"Slist": np.array([[0, 0, 0, 0, 0, 2.0], *SLIST.T[1:]]).T}, ModelError),
        ({"Slist": SLIST.T}, ShapeError),
        ({"Mlist": MLIST[:3]}, ShapeError),
        ({"Glist": GLIST[:2]}, ShapeError),
        ({"Slist": SLIST * np.nan}, RangeError),
        ({"Mlist": MLIST * [[[-1.0], [1], [1], [1]]]}, RangeError),
        ({"Glist": [swapped_blocks(G_i) for G_i in GLIST]}, RangeError),
        ({"Glist": -GLIST}, ModelError),
        ({"Glist": GLIST * np.diag([9.0, 1, 1, 1, 1, 1])}, ModelError),
        ({"gravity": [0, 0]}, ShapeError),
    ],
)
def test_lists_that_no_arm_has_are_refused_in_words(change: dict[str, np.ndarray], error: type[TautError]) -> None:
    given = {"Mlist": MLIST, "Glist": GLIST, "Slist": SLIST, "gravity": np.array(G)} | change
    with refused(error):
        Arm.from_screws(**given)
