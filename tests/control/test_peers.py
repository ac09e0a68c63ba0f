"""Our laws with the parameters of docs/coming_from.md against other libraries: their torques, or their formulas.

The torques of robosuite and newton are in peer_vectors.json, made by tests/control/make_peer_vectors.py from the libraries themselves.
"""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigvals
from scipy.spatial.transform import Rotation

import taut
from taut.base.types import Float64Array

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "coming_from.md"
TOLD = json.loads((HERE / "peer_vectors.json").read_text(encoding="utf-8"))
STATES = [{name: np.array(value) for name, value in state.items()} for state in TOLD["states"]]
EXACT = 1e-9  # [N m]
ROBUST = 1e-7  # [N m] what singularity="robust" changes away from singularities
SINGLE = 1e-3  # [N m] of torques up to 60 in single precision
every_state = pytest.mark.parametrize("k", range(len(STATES)))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    """The code of the page, as it stands."""
    folder = tmp_path_factory.mktemp("page")
    code = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (folder / "coming_from_page.py").write_text("\n".join(code), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        return importlib.import_module("coming_from_page")


class At:
    """One of the states, with what formulas need, written without taut's laws."""

    def __init__(self, k: int) -> None:
        s = STATES[k]
        self.k, self.q, self.v, self.q_rest = k, s["q"], s["v"], s["q_rest"]
        self.p, self.R, self.p_des, self.R_des = s["p"], s["R"], s["p_des"], s["R_des"]
        self.M, self.J, self.h, self.g = s["M"], s["J"], s["h"], s["g"]
        self.Cv = self.h - self.g
        self.W = np.linalg.inv(self.M)
        self.Lambda = np.linalg.inv(self.J @ self.W @ self.J.T)
        self.V = self.J @ self.v
        self.turn = Rotation.from_matrix(self.R_des @ self.R.T).as_rotvec()
        self.angle = float(np.linalg.norm(self.turn))
        self.X = np.append(self.p_des - self.p, self.turn)
        self.Jdot_v = np.asarray(taut.snapshot(taut.load_arm("panda"), self.q, self.v).Jdot_v())
        self.kinematic = np.eye(7) - np.linalg.pinv(self.J) @ self.J

    def turned(self, angle: float) -> Float64Array:
        """The desired rotation, with another angle about the same axis."""
        return Rotation.from_rotvec(self.turn / self.angle * angle).as_matrix() @ self.R

    def told(self, peer: str, name: str) -> Float64Array:
        return np.array(TOLD[peer]["rows"][self.k][name])

    def tau(self, law: taut.Law, R_des: Any = None, a: Any = None, adds: tuple[str, ...] = ()) -> Float64Array:
        """The torque of a law of ours."""
        ctrl = taut.compile(law, taut.load_arm("panda"), engine="float", adds=adds)
        pose = taut.Pose(self.p_des, R=self.R_des if R_des is None else R_des)
        return np.asarray(ctrl.step(self.q, self.v, taut.TaskMotion(pose=pose, acceleration=a)))


def off(a: Float64Array, b: Float64Array) -> float:
    return float(np.abs(a - b).max())


def without_bound(law: Any) -> taut.Law:
    """The law of the page without a bound on its error, where they do not clip yet."""
    kept = {name: getattr(law, name) for name in ("kp", "kd", "K", "B", "coriolis") if hasattr(law, name)}
    made: taut.Law = type(law)(
        **{name: getattr(v, "as_array", lambda v=v: v)() for name, v in kept.items()}, null=None
    )
    return made


@every_state
def test_the_states_are_those_of_the_arm(k: int) -> None:
    s = At(k)
    x = taut.snapshot(taut.load_arm("panda"), s.q, s.v)
    for name, value in (("M", x.M), ("J", x.J()), ("h", x.h), ("g", x.g), ("p", x.T().p), ("R", x.T().R)):
        assert off(getattr(s, name), np.asarray(value)) < 1e-10, name


# -------------------------------------------------------------------- robosuite


@pytest.mark.part(1)
@every_state
def test_robosuites_full_law_is_ours_with_its_sine_and_no_velocity_term(page: ModuleType, k: int) -> None:
    s = At(k)
    law, R_des = page.robosuite_full, s.turned(np.sin(s.angle))
    assert off(s.tau(law, R_des=R_des, a=s.Jdot_v), s.told("robosuite", "full")) < ROBUST
    plain = type(law)(kp=150.0, kd=2.0 * np.sqrt(150.0), null=law.null, singularity="plain")
    assert off(s.tau(plain, R_des=R_des, a=s.Jdot_v), s.told("robosuite", "full")) < EXACT


@pytest.mark.part(1)
@every_state
def test_robosuites_null_space_torque_is_that_of_our_posture(page: ModuleType, k: int) -> None:
    s = At(k)
    alone = type(page.robosuite_full)(kp=150.0, kd=2.0 * np.sqrt(150.0), null=None)
    assert off(s.tau(page.robosuite_full) - s.tau(alone), s.told("robosuite", "null")) < ROBUST


@every_state
def test_robosuites_orientation_error_is_the_sine(page: ModuleType, k: int) -> None:
    s = At(k)
    sine = s.turn / s.angle * np.sin(s.angle)
    assert off(s.told("robosuite", "orientation_error"), sine) < 1e-12


@every_state
def test_robosuites_default_is_the_law_on_the_page(page: ModuleType, k: int) -> None:
    s = At(k)
    assert off(s.tau(page.robosuite_default), s.told("robosuite", "uncoupled") - s.told("robosuite", "null")) < EXACT


def test_robosuites_default_does_not_make_the_acceleration_that_it_asks_for() -> None:
    linear, angular, asked, missed = [], [], [], {"full": 0.0, "uncoupled": 0.0}
    for k in range(len(STATES)):
        s = At(k)
        X = np.append(s.X[:3], s.told("robosuite", "orientation_error"))
        want = 150.0 * X - 2.0 * np.sqrt(150.0) * s.V
        asked.append([np.abs(want[:3]).max(), np.abs(want[3:]).max()])
        for name in missed:
            got = s.J @ s.W @ (s.told("robosuite", name) - s.told("robosuite", "null") - s.h)
            missed[name] = max(missed[name], off(got, want))
            if name == "uncoupled":
                linear.append(off(got[:3], want[:3]))
                angular.append(off(got[3:], want[3:]))
    assert missed["full"] < 1e-8
    # The page says 8 m/s^2 and 32 rad/s^2 past 10 and 38.
    assert max(linear) == pytest.approx(8.4, abs=0.1)
    assert max(angular) == pytest.approx(31.9, abs=0.1)
    assert np.max(asked, axis=0) == pytest.approx([10.2, 38.0], abs=0.1)


@pytest.mark.long
def test_what_robosuite_leaves_out_is_less_than_the_page_says(page: ModuleType) -> None:
    worst = max(off(s.tau(page.robosuite_full, a=s.Jdot_v), s.tau(page.robosuite_full)) for s in map(At, range(5)))
    assert worst == pytest.approx(0.29, abs=0.01)  # [N m]


# -------------------------------------------------------------------- libfranka


@pytest.mark.part(1)
@every_state
def test_libfrankas_cartesian_example_is_ours_with_half_the_rotational_stiffness(page: ModuleType, k: int) -> None:
    s = At(k)
    quaternion = Rotation.from_matrix(s.R.T @ s.R_des).as_quat()  # x, y, z, w
    vector = s.R @ quaternion[:3] * np.sign(quaternion[3])
    K, D = np.repeat([150.0, 10.0], 3), 2.0 * np.sqrt(np.repeat([150.0, 10.0], 3))
    theirs = s.J.T @ (K * np.append(s.X[:3], vector) - D * s.V) + s.Cv
    ours = s.tau(page.libfranka, R_des=s.turned(2.0 * np.sin(0.5 * s.angle)), adds=("gravity",))
    assert off(theirs - s.Cv, ours) < EXACT
    # As the page has it, with the angle for twice the sine of its half: the rest is of third order.
    assert off(theirs - s.Cv, s.tau(page.libfranka, adds=("gravity",))) < 5.0 * s.angle**3 / 24.0 * 2.0


@every_state
def test_libfrankas_joint_example_is_ours_less_the_coriolis_torque(page: ModuleType, k: int) -> None:
    s = At(k)
    theirs = np.array(page.K) * (s.q_rest - s.q) - np.array(page.D) * s.v + s.Cv
    ctrl = taut.compile(page.libfranka_joint, taut.load_arm("panda"), engine="float", adds=("gravity",))
    assert off(theirs - s.Cv, np.asarray(ctrl.step(s.q, s.v, taut.JointMotion(q=s.q_rest)))) < EXACT


# -------------------------------------------------------------------- franky and CRISP


@every_state
def test_frankys_law_is_ours_less_the_coriolis_torque(page: ModuleType, k: int) -> None:
    s = At(k)
    K, D = np.repeat([500.0, 50.0], 3), 2.0 * np.sqrt(np.repeat([500.0, 50.0], 3))
    a = np.array([1.0, -2.0, 0.5, 3.0, -1.0, 2.0])
    theirs = s.J.T @ (K * s.X - D * s.V + s.Lambda @ a) + s.Cv
    law = without_bound(page.franky)
    assert off(theirs - s.Cv, s.tau(law, a=a, adds=("gravity",))) < EXACT


def test_frankys_defaults_are_those_of_the_page(page: ModuleType) -> None:
    assert np.array_equal(np.diag(TOLD["franky"]["stiffness"]), np.repeat([500.0, 50.0], 3))
    assert np.array_equal(np.asarray(page.franky.K.as_array()).ravel()[[0, -1]], [500.0, 50.0])


@pytest.mark.part(1)
@every_state
def test_crisps_law_is_ours(page: ModuleType, k: int) -> None:
    s = At(k)
    K, D = np.repeat([500.0, 30.0], 3), 2.0 * np.sqrt(np.repeat([500.0, 30.0], 3))
    law = without_bound(page.crisp)
    assert off(s.J.T @ (K * s.X - D * s.V), s.tau(law, adds=("gravity",))) < EXACT
    operational = without_bound(page.crisp_operational)
    theirs = s.J.T @ (s.Lambda @ (K * s.X - D * s.V))
    assert off(theirs, s.tau(operational, a=s.Jdot_v) - s.h) < ROBUST


def test_the_smooth_bound_is_0_71_of_theirs_where_theirs_begins_and_nears_it_beyond(page: ModuleType) -> None:
    s = At(0)
    force = []
    for error in (0.1, 1.0):
        ctrl = taut.compile(page.crisp, taut.load_arm("panda"), engine="float", adds=("gravity",))
        pose = taut.Pose(s.p + np.array([error, 0.0, 0.0]), R=s.R)
        tau = np.asarray(ctrl.step(s.q, 0.0 * s.v, taut.TaskMotion(pose=pose)))
        force.append((s.Lambda @ s.J @ s.W @ tau)[0])
    assert force == pytest.approx([500.0 * 0.1 / np.sqrt(2.0), 500.0 * 0.1 / np.sqrt(1.01)], rel=1e-9)


def test_crisps_world_jacobian_put_a_moment_at_the_tool() -> None:
    s = At(0)
    f = np.array([10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    J_world = s.J.copy()
    J_world[:3] += np.cross(s.p, s.J[3:].T).T
    moment = np.append(f[:3], np.cross(f[:3], s.p))
    assert off(J_world.T @ f, s.J.T @ moment) < EXACT
    assert np.abs(moment[3:]).max() > 4.0


@pytest.mark.parametrize(
    ("projector", "moves"),
    [(lambda s: s.kinematic, True), (lambda s: np.eye(7) - s.J.T @ s.Lambda @ s.J @ s.W, False)],
    ids=["kinematic", "dynamically consistent"],
)
def test_a_projector_without_mass_moves_the_tool(projector: Callable[[At], Float64Array], moves: bool) -> None:
    worst = 0.0
    for s in map(At, range(1, 5)):
        spring = 10.0 * (s.q_rest - s.q) - 2.0 * np.sqrt(10.0) * s.v
        worst = max(worst, float(np.abs((s.J @ s.W @ projector(s) @ spring)[:3]).max()))
    assert worst > 1.0 if moves else worst < 1e-10  # [m/s^2]


# -------------------------------------------------------------------- Isaac Lab, whose law newton computes


@every_state
def test_isaac_labs_plain_law_is_ours(page: ModuleType, k: int) -> None:
    s = At(k)
    assert off(s.tau(page.isaac_lab), s.told("newton", "plain")) < SINGLE


@every_state
def test_isaac_labs_decoupled_law_is_ours_without_velocity_terms(page: ModuleType, k: int) -> None:
    s = At(k)
    ours = s.tau(page.isaac_lab_decoupled, a=s.Jdot_v) - s.Cv
    assert off(ours, s.told("newton", "decoupled")) < SINGLE


@every_state
def test_isaac_labs_partial_law_has_two_blocks(k: int) -> None:
    s = At(k)
    blocks = np.zeros((6, 6))
    for rows in (slice(0, 3), slice(3, 6)):
        blocks[rows, rows] = np.linalg.inv(s.J[rows] @ s.W @ s.J[rows].T)
    assert off(s.J.T @ (blocks @ (100.0 * s.X - 20.0 * s.V)) + s.g, s.told("newton", "partial")) < SINGLE


def test_isaac_labs_null_space_without_decoupling_moves_the_tool() -> None:
    worst = np.zeros(6)
    for s in map(At, range(5)):
        null = s.told("newton", "plain_null") - s.told("newton", "plain")
        assert off(null, s.kinematic @ (10.0 * (s.q_rest - s.q) - 2.0 * np.sqrt(10.0) * s.v)) < SINGLE
        worst = np.maximum(worst, np.abs(s.J @ s.W @ null))
    assert worst[3:].max() == pytest.approx(190.0, rel=0.02)  # [rad/s^2], as the page says


# -------------------------------------------------------------------- damping


@pytest.mark.parametrize(
    ("K", "D", "said"),
    [
        ((150.0, 5.0), (150.0, 10.0), 0.39),
        ((500.0, 50.0), (500.0, 50.0), 0.34),
        ((500.0, 30.0), (500.0, 30.0), 0.37),
        ((100.0, 100.0), (100.0, 100.0), 0.29),
    ],
    ids=["libfranka", "franky", "CRISP", "Isaac Lab"],
)
def test_twice_the_root_of_the_stiffness_is_not_critical(K: Any, D: Any, said: float) -> None:
    s = At(0)
    B = 2.0 * np.sqrt(np.repeat(D, 3))
    A = np.block(
        [
            [np.zeros((6, 6)), np.eye(6)],
            [-np.linalg.solve(s.Lambda, np.diag(np.repeat(K, 3))), -np.linalg.solve(s.Lambda, np.diag(B))],
        ]
    )
    poles = eigvals(A)
    assert float(np.min(-poles.real / np.abs(poles))) == pytest.approx(said, abs=0.005)
