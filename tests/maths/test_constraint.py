"""Constraints: A, its rate, projections and multipliers against Pinocchio and closed forms; and what is refused."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from maths_oracles import Array, Oracle, oracle_of
from refusals import refused

import taut
from taut import Constraint, Pose
from taut import math as tm
from taut.maths.constraints.multipliers import Constrained, force_projector
from taut.maths.model import model_of
from taut.maths.snapshot import Snapshot
from taut.trace.linalg import factor_spd

NEAR = 0.1
ARMS = ["xarm7", *(pytest.param(name, marks=pytest.mark.long) for name in ("panda", "ur10"))]
CENTER, U = np.array([0.3, -0.2, 0.1]), np.array([0.48, 0.6, 0.64])
T0 = Pose([0.5, 0.1, 0.4], rpy=[0.4, 2.6, -0.3])


def tilted_ellipsoid(T: Pose) -> Any:
    """One of a user: a surface that has no simple form, of the tool's z axis as well."""
    d = T.p - CENTER
    return tm.array([d[0] * d[0] + 2.0 * d[1] * d[1] + 0.5 * d[2] * d[2] - 0.2, T.R[2, 2] + tm.sin(T.p[0])])


CONSTRAINTS: dict[str, Constraint] = {
    "plane": Constraint.plane(point=CENTER, normal=U),
    "face": Constraint.plane(point=CENTER, normal=U, face=[0.0, 0.0, 1.0]),
    "cylinder": Constraint.cylinder(point=CENTER, axis=U, radius=0.15),
    "sphere": Constraint.sphere(center=CENTER, radius=0.3),
    "hinge": Constraint.hinge(point=CENTER, axis=U, T=T0),
    "line": Constraint.line(point=CENTER, axis=U),
    "user": Constraint(tilted_ellipsoid),
}


def evaluated(arm: taut.Arm, constraint: Constraint) -> Callable[[Array, Array, Array], dict[str, Array]]:
    """All that is asked of a constraint, in native code: phi, A_q, bias, lam, P and the mobility of the tool.

    Told by the way from a regular pose, near which native code is compared with Python once.
    """
    k, n = constraint.count, arm.n
    blank, regular = taut.snapshot(arm, arm.home), arm.home + 0.6 * np.cos(1.7 * np.arange(n) + 0.3)

    def function(away: Any, v: Any, tau: Any) -> Any:
        x = blank.at(regular + NEAR * away, v)
        rows = constraint.at(x)
        held = Constrained.of(rows, x.M_factors)
        mobility = x.J() @ x.M_factors.solve(x.J().T)
        assert rows.A is not None
        P = force_projector(rows.A, mobility)
        parts = [rows.phi, rows.A, rows.A_q, rows.bias, held.lam(tau - x.h), P, mobility, held.along(tau)]
        return tm.array([entry for part in parts for entry in part.ravel()])

    compiled = taut.native(function, away=n, v=n, tau=n)
    shapes = {
        "phi": (k,),
        "A": (k, 6),
        "A_q": (k, n),
        "bias": (k,),
        "lam": (k,),
        "P": (6, 6),
        "Minv": (6, 6),
        "Pt": (n,),
    }

    def call(q: Array, v: Array, tau: Array) -> dict[str, Array]:
        values, out, at = compiled((q - regular) / NEAR, v, tau), {}, 0
        for name, shape in shapes.items():
            size = int(np.prod(shape))
            out[name] = values[at : at + size].reshape(shape)
            at += size
        return out

    return call


def lam_of_pinocchio(oracle: Oracle, constraint: Constraint, q: Array, v: Array, tau: Array) -> tuple[Array, Array]:
    """Multipliers (10.42) and A_q from Pinocchio's M, h and poses alone; both rates of phi are differences."""

    def phi(at: Array) -> Array:
        T = oracle.pose(at)
        return constraint.of_pose(Pose.of(T.rotation, T.translation))

    n, h = len(q), 1e-5
    A = np.stack([(phi(q + h * e) - phi(q - h * e)) / (2 * h) for e in np.eye(n)], axis=1)
    s = 2e-3 / max(1.0, float(np.linalg.norm(v)))
    f = [phi(q + j * s * v) for j in range(-3, 4)]
    # d2 phi / ds2 along q + s v, with A_q a = 0 there: six neighbours leave an error of s^6
    bias = (2 * f[0] - 27 * f[1] + 270 * f[2] - 490 * f[3] + 270 * f[4] - 27 * f[5] + 2 * f[6]) / (180 * s * s)
    W = np.linalg.solve(oracle.M(q), A.T)
    return np.linalg.solve(A @ W, W.T @ (tau - oracle.h(q, v)) + bias), A


@pytest.mark.bars
@pytest.mark.parametrize("name", ARMS)
def test_projections_and_multipliers_are_those_of_the_formulas(
    name: str, share: Callable[[int], int], bar: Any
) -> None:
    arm = taut.load_arm(name)
    oracle, worst = oracle_of(arm), dict[str, float]()

    def record(what: str, figure: float) -> None:
        worst[what] = max(worst.get(what, 0.0), float(figure))

    wanted = share(1000)
    for seed, (kind, constraint) in enumerate(CONSTRAINTS.items()):
        at, count, rng = evaluated(arm, constraint), 0, np.random.default_rng(seed)
        while count < wanted:
            q, v, tau = rng.uniform(-2.0, 2.0, arm.n), rng.normal(size=arm.n), 20.0 * rng.normal(size=arm.n)
            found = at(q, v, tau)
            A, P, Minv = found["A"], found["P"], found["Minv"]
            least = [np.linalg.svd(found[what], compute_uv=False)[-1] for what in ("A", "A_q")]
            if least[0] < 0.2 or least[1] < 0.05:
                continue  # far off a face or a hinge, whose rows lose their rank there; an arm that cannot press
            count += 1
            size = max(1.0, float(np.linalg.norm(P, 2)) ** 2)
            record("P^2 - P", np.abs(P @ P - P).max() / size)
            record("P A^T", np.abs(P @ A.T).max() / (np.abs(A).max() * size))
            values = np.linalg.svd(P, compute_uv=False)
            assert (values[: 6 - len(A)] > 1.0 - 1e-9).all(), (kind, values)
            record("what P keeps of the rank that it loses", values[6 - len(A) :].max() / size)
            if np.linalg.cond(Minv) < 1e6:
                Lambda = np.linalg.inv(Minv)
                slant = np.abs(P @ Lambda - Lambda @ P.T).max() / (np.abs(Lambda).max() * np.sqrt(size))
                record("P Lambda, symmetric", slant)
            lam, A_q = lam_of_pinocchio(oracle, constraint, q, v, tau)
            record("lam", np.abs(lam - found["lam"]).max() / max(1.0, float(np.linalg.norm(lam))))
            along = tau - A_q.T @ np.linalg.solve(
                A_q @ np.linalg.solve(oracle.M(q), A_q.T), A_q @ np.linalg.solve(oracle.M(q), tau)
            )
            record("P tau", np.abs(along - found["Pt"]).max() / (np.linalg.norm(tau) * np.sqrt(size)))
    bar(f"hybrid, {name}: poses at each of {len(CONSTRAINTS)} constraints", wanted)
    for what, figure in worst.items():
        bar(f"hybrid, {name}: {what}", f"{figure:.1e}")
    assert worst["P^2 - P"] < 1e-12
    assert worst["P A^T"] < 1e-12
    assert worst["what P keeps of the rank that it loses"] < 1e-12
    assert worst["P Lambda, symmetric"] < 1e-9
    assert worst["lam"] < 1e-6
    assert worst["P tau"] < 1e-6


def rows_at(constraint: Constraint, V: Array, T: Pose = T0) -> taut.dynamics.ConstraintRows:
    """The rows of a constraint for a free body that moves with a twist: an arm of six joints is put there."""
    arm = taut.load_arm("ur10")
    q = taut.inverse_kinematics(arm, T).q
    x = taut.snapshot(arm, q)
    return constraint.at(taut.snapshot(arm, q, np.linalg.solve(x.J(), V)))


def test_what_a_sphere_and_a_cylinder_ask_is_the_centripetal_acceleration() -> None:
    V = np.array([0.3, -0.2, 0.5, 0.4, 0.1, -0.3])
    T = taut.snapshot(taut.load_arm("ur10"), taut.inverse_kinematics(taut.load_arm("ur10"), T0).q).T()
    d = T.p - CENTER
    for constraint, across in (
        (CONSTRAINTS["sphere"], d),
        (CONSTRAINTS["cylinder"], d - (U / np.linalg.norm(U)) * (U @ d) / np.linalg.norm(U)),
    ):
        rows = rows_at(constraint, V)
        r = np.linalg.norm(across)
        n = across / r
        along = V[:3] - n * (n @ V[:3])
        if constraint is CONSTRAINTS["cylinder"]:
            along = along - (U / np.linalg.norm(U)) * (U @ along) / np.linalg.norm(U)
        assert rows.A is not None
        assert np.abs(rows.A[0] - [*n, 0, 0, 0]).max() < 1e-12
        assert abs(rows.curvature[0] - along @ along / r) < 1e-10


def test_the_rows_of_an_eraser_are_those_of_figure_10_16() -> None:
    rows = rows_at(Constraint.plane(point=[0.5, 0.1, 0.4], normal=[0, 0, 1], face=[0, 0, -1]), np.ones(6), Pose(T0.p))
    assert rows.A is not None
    assert np.abs(rows.A - np.eye(6)[[2, 3, 4]]).max() < 1e-6
    assert rows.one_sided == (True, False, False)


def test_a_hinge_lets_turn_about_its_axis_and_nothing_else() -> None:
    u = U / np.linalg.norm(U)
    turn = np.array([*np.cross(u, T0.p - CENTER), *u])
    rows = rows_at(CONSTRAINTS["hinge"], turn)
    assert rows.A is not None
    assert np.abs(rows.A @ turn).max() < 1e-6
    assert np.linalg.matrix_rank(rows.A, tol=1e-6) == 5


def test_a_moving_plane_asks_for_its_own_speed() -> None:
    lift = Constraint(lambda T, t: T.p[2] - 0.4 - 0.1 * tm.sin(2.0 * t))
    rows = rows_at(lift, np.zeros(6))
    assert rows.phi_t.tolist() == pytest.approx([-0.2])  # at t = 0
    assert rows.bias.tolist() == pytest.approx([0.0])
    assert rows_at(Constraint.plane(point=T0.p, normal=[0, 0, 1], velocity=[5.0, 0.0, 0.3]), np.zeros(6)).phi_t == (
        pytest.approx([-0.3])
    )


def test_a_plane_that_sways_goes_where_it_says_and_comes_back() -> None:
    swaying = Constraint.plane(point=T0.p, normal=[0, 0, 1], sway=[0.0, 0.3, 0.06], period=2.0)
    for t, way in ((0.0, 0.0), (0.5, 0.03), (1.0, 0.06), (2.0, 0.0)):
        assert swaying.of_pose(Pose(T0.p + np.array([0.0, 0.0, way]), R=T0.R), t) == pytest.approx([0.0], abs=1e-12)
    assert swaying.of_twist(T0, 0.5)[1] == pytest.approx([-np.pi * 0.06 / 2.0])  # its fastest
    assert rows_at(swaying, np.zeros(6)).bias == pytest.approx([-0.5 * 0.06 * np.pi**2])
    with refused(taut.errors.RangeError):
        Constraint.plane(point=T0.p, normal=[0, 0, 1], sway=[0, 0, 0.1], period=0.0)


def test_chalk_that_sticks_bears_forces_and_turns() -> None:
    stuck = Constraint.point(point=T0.p, normal=U)
    assert stuck.one_sided == (True, False, False)
    rows = rows_at(stuck, np.ones(6))
    assert rows.phi == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert rows.A is not None
    assert rows.A[0] == pytest.approx([*U, 0.0, 0.0, 0.0])
    assert rows.A[:, :3] @ rows.A[:, :3].T == pytest.approx(np.eye(3))
    assert not np.any(rows.A[:, 3:])


def test_a_rolling_wheel_is_a_constraint_of_velocities() -> None:
    """A-dot V of a knife edge that turns: the sideways direction turns with the tool."""
    edge = Constraint.pfaffian(lambda T: tm.array([*T.R[:, 1], 0.0, 0.0, 0.0]))
    V = np.array([0.3, 0.1, 0.0, 0.0, 0.0, 2.0])
    rows = rows_at(edge, V, Pose([0.5, 0.1, 0.4]))
    assert rows.A is not None
    assert np.abs(rows.A - [[0, 1, 0, 0, 0, 0]]).max() < 1e-6
    assert rows.curvature[0] == pytest.approx(-2.0 * 0.3, abs=1e-6)  # (w x e_y) . V
    assert rows.phi.tolist() == [0.0]


def test_several_constraints_are_stacked() -> None:
    both = CONSTRAINTS["plane"] + CONSTRAINTS["line"]
    rows = rows_at(both, np.ones(6))
    assert rows.count == both.count == 3
    parts = [rows_at(CONSTRAINTS[name], np.ones(6)) for name in ("plane", "line")]
    assert np.array_equal(rows.A_q, np.concatenate([part.A_q for part in parts]))
    assert both.one_sided == (True, False, False)


def test_the_tool_and_its_name_are_one_frame() -> None:
    arm = taut.load_arm("panda")
    named = Constraint.line(point=CENTER, axis=U, frame="panda_hand_tcp")
    for both in (CONSTRAINTS["plane"] + named, named + CONSTRAINTS["plane"]):
        assert both.frame == ("panda_hand_tcp",)
        x = taut.snapshot(arm, arm.home)
        rows = both.at(x)
        assert rows.A is not None
        np.testing.assert_allclose(rows.A @ x.J(), rows.A_q, atol=1e-12)
        assert both.of_pose(x.T()).tolist() == pytest.approx(list(rows.phi))
    elsewhere = CONSTRAINTS["plane"] + Constraint.line(point=CENTER, axis=U, frame="panda_link5")
    with refused(taut.errors.UsageError):
        elsewhere.at(taut.snapshot(arm, arm.home))
    several = Constraint.line(point=CENTER, axis=U, frame="panda_hand_tcp") + Constraint.line(
        point=CENTER, axis=U, frame="panda_link5"
    )
    assert several.frame is None
    assert several.at(taut.snapshot(arm, arm.home)).A is None


def test_a_constraint_of_joints_is_differentiated_along_the_joints() -> None:
    arm = taut.load_arm("planar2")
    constraint = Constraint.of_joints(lambda q: q[0] * q[1] - 0.5)
    rows = constraint.at(taut.snapshot(arm, [0.5, 1.0], [2.0, 3.0]))
    assert rows.A is None
    assert rows.A_q.tolist() == [[1.0, 0.5]]
    assert rows.bias.tolist() == pytest.approx([12.0])
    assert rows.phi.tolist() == [0.0]


def test_a_constraint_of_joint_speeds_needs_no_phi() -> None:
    """A(q) v = 0 of a mechanism that is not integrable; its rate by differences."""
    arm = taut.load_arm("planar3")
    constraint = Constraint.pfaffian_of_joints(lambda q: [tm.cos(q[1]), q[0], 0.0])
    q, v, h = np.array([0.3, -0.4, 0.5]), np.array([1.0, -2.0, 0.7]), 1e-6
    rows = constraint.at(taut.snapshot(arm, q, v))
    assert rows.A is None
    assert rows.phi.tolist() == rows.phi_t.tolist() == [0.0]
    np.testing.assert_allclose(rows.A_q, [[np.cos(-0.4), 0.3, 0.0]], atol=1e-15)
    ahead, behind = (constraint.at(taut.snapshot(arm, q + s * v, v)).A_q @ v for s in (h, -h))
    assert (ahead - behind) / (2.0 * h) == pytest.approx(rows.bias, abs=1e-8)
    law = taut.laws.HybridMotionForce(constraint=constraint, motion=taut.laws.ComputedTorque(kp=100.0, kd=20.0))
    v -= np.linalg.pinv(rows.A_q) @ (rows.A_q @ v)
    x = taut.snapshot(arm, q, v)
    tau = taut.compile(law, arm).step(q, v, taut.pressing(taut.JointMotion(q=q + 0.1), lam=[3.0]))
    rows = constraint.at(x)
    A = np.asarray(rows.A_q)
    whole = np.block([[x.M, A.T], [A, np.zeros((1, 1))]])
    a = np.linalg.solve(whole, np.concatenate([tau - x.h, -rows.bias]))
    assert a[3:] == pytest.approx([3.0])  # what is asked for is what the mechanism feels
    two = Constraint.pfaffian_of_joints(lambda q: np.eye(3)[:2], rows=2)
    assert two.at(x).A_q.tolist() == np.eye(3)[:2].tolist()


WRONG_OF_JOINTS: dict[str, tuple[Callable[[], Constraint], type[Exception]]] = {
    "nothing": (lambda: Constraint.of_joints(lambda q: None), taut.errors.ShapeError),
    "a matrix": (lambda: Constraint.of_joints(lambda q: np.eye(2)), taut.errors.ShapeError),
    "no rows": (lambda: Constraint.of_joints(lambda q: q[0], rows=0), taut.errors.RangeError),
    "a row and a half": (lambda: Constraint.of_joints(lambda q: q[0], rows=1.5), taut.errors.RangeError),  # type: ignore[arg-type]
    "no function": (lambda: Constraint.of_joints(3), taut.errors.UsageError),  # type: ignore[arg-type]
    "a timed A": (lambda: Constraint.pfaffian_of_joints(lambda q, t: q), taut.errors.UsageError),
    "a short A": (lambda: Constraint.pfaffian_of_joints(lambda q: [1.0]), taut.errors.ShapeError),
}


@pytest.mark.parametrize("case", WRONG_OF_JOINTS)
def test_a_wrong_constraint_of_joints_is_refused(case: str) -> None:
    make, error = WRONG_OF_JOINTS[case]
    with pytest.raises(error):
        make().at(taut.snapshot(taut.load_arm("planar2"), [0.1, 0.2]))


def test_a_closed_chain_is_a_constraint_of_two_frames() -> None:
    arm = taut.load_arm("baxter")
    rng = np.random.default_rng(4)
    q, v = arm.home + 0.1 * rng.normal(size=arm.n), rng.normal(size=arm.n)
    grasp = Constraint.grasp("left_gripper", "right_gripper")
    pin = Constraint.pin("left_gripper", "right_gripper")
    x = taut.snapshot(arm, q, v)
    rows = grasp.at(x)
    assert rows.count == 6
    left, right = x.T("left_gripper"), x.T("right_gripper")
    assert np.allclose(rows.phi[:3], left.R.T @ (right.p - left.p))
    assert np.allclose(pin.at(x).A_q, x.J("right_gripper")[:3] - x.J("left_gripper")[:3])
    h = 1e-5
    ahead, behind = grasp.at(taut.snapshot(arm, q + h * v, v)), grasp.at(taut.snapshot(arm, q - h * v, v))
    assert np.abs((ahead.phi - behind.phi) / (2 * h) - rows.A_q @ v).max() < 1e-6
    assert np.abs((ahead.A_q - behind.A_q) @ v / (2 * h) - rows.bias).max() < 1e-5


def test_a_knife_edge_goes_ahead_and_turns_and_does_not_slip_sideways() -> None:
    arm = taut.load_arm("panda")
    rng = np.random.default_rng(8)
    q, v = arm.home + 0.2 * rng.normal(size=arm.n), rng.normal(size=arm.n)
    edge, x = Constraint.knife_edge(sideways=[0.0, 2.0, 0.0]), taut.snapshot(arm, q, v)
    rows, T = edge.at(x), x.T()
    assert rows.A is not None
    np.testing.assert_allclose(rows.A, [[*T.R[:, 1], 0.0, 0.0, 0.0]], atol=1e-15)
    for twist, slips in (([*T.R[:, 0], 0, 0, 3.0], 0.0), ([*T.R[:, 1], 0, 0, 0], 1.0)):
        assert rows.A @ np.array(twist) == pytest.approx([slips], abs=1e-12)
    assert rows.phi.tolist() == [0.0]
    h = 1e-6  # turning while it goes ahead needs a force
    ahead, behind = (edge.at(taut.snapshot(arm, q + s * v, v)).A_q @ v for s in (h, -h))
    assert (ahead - behind) / (2.0 * h) == pytest.approx(rows.bias, abs=1e-6)
    with refused(taut.errors.RangeError):
        Constraint.knife_edge(sideways=[0.0, 0.0, 0.0])


def test_onto_finds_the_nearest_state_and_says_when_there_is_none() -> None:
    arm = taut.load_arm("panda")
    for constraint in (CONSTRAINTS["sphere"], CONSTRAINTS["cylinder"], CONSTRAINTS["face"]):
        q = taut.dynamics.onto(constraint, arm, arm.home)
        assert np.abs(constraint.at(taut.snapshot(arm, q)).phi).max() < 1e-11
    near = taut.dynamics.onto(
        Constraint.plane(point=taut.snapshot(arm, arm.home).T().p, normal=[0, 0, 1]), arm, arm.home
    )
    assert np.abs(near - arm.home).max() < 1e-12
    with refused(taut.errors.RangeError):
        taut.dynamics.onto(Constraint.plane(point=[0, 0, 9.0], normal=[0, 0, 1]), arm, arm.home)
    with refused(taut.errors.UsageError):
        taut.dynamics.onto(lambda T: T.p[2], arm, arm.home)  # type: ignore[arg-type]
    with refused(taut.errors.UsageError):
        taut.dynamics.onto(CONSTRAINTS["plane"], "panda", arm.home)  # type: ignore[arg-type]


WRONG: dict[str, tuple[Callable[[], Constraint], type[Exception]]] = {
    "no function": (lambda: Constraint(0.3), taut.errors.UsageError),  # type: ignore[arg-type]
    "a constant": (lambda: Constraint(lambda T: 0.3), taut.errors.UsageError),
    "a constant row": (lambda: Constraint(lambda T: [T.p[2], 1.0]), taut.errors.UsageError),
    "a condition": (lambda: Constraint(lambda T: T.p[2] > 0.4), taut.errors.UsageError),
    "nothing": (lambda: Constraint(lambda T: None), taut.errors.ShapeError),
    "a pose": (lambda: Constraint(lambda T: T), taut.errors.ShapeError),
    "a matrix": (lambda: Constraint(lambda T: T.R), taut.errors.ShapeError),
    "too many arguments": (lambda: Constraint(lambda T, a, b: T.p[2]), taut.errors.UsageError),
    "no names": (lambda: Constraint(lambda T: T.p[2], frames="hand"), taut.errors.UsageError),
    "few sides": (lambda: Constraint(lambda T: T.p, one_sided=[True]), taut.errors.ShapeError),
    "no bool": (lambda: Constraint(lambda T: T.p[2], one_sided=np.True_), taut.errors.ShapeError),  # type: ignore[arg-type]
    "no length": (lambda: Constraint.plane(point=U, normal=[0, 0, 0]), taut.errors.RangeError),
    "no radius": (lambda: Constraint.sphere(center=U, radius=-1.0), taut.errors.RangeError),
    "no pose": (lambda: Constraint.hinge(point=U, axis=U, T=3), taut.errors.UsageError),  # type: ignore[arg-type]
    "no A": (lambda: Constraint.pfaffian(lambda T: T.p), taut.errors.ShapeError),
    "A = 0": (lambda: Constraint.pfaffian(lambda T: np.zeros(6)), taut.errors.UsageError),
    "no directions": (lambda: Constraint.pin("a", "b", directions=[1.0, 0.0]), taut.errors.ShapeError),
    "no signature": (lambda: Constraint(max), taut.errors.UsageError),
    "it raises": (lambda: Constraint(lambda T: {}["x"]), taut.errors.UsageError),
    "no grasp": (lambda: Constraint.grasp("a", "b", T=3), taut.errors.UsageError),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_constraint_is_one_sentence(case: str) -> None:
    make, error = WRONG[case]
    with refused(error):
        make()


READY_MADE = {
    "plane": Constraint.plane(point=U, normal=[0.0, 1.0, 1.0]),
    "moving plane": Constraint.plane(point=U, normal=[0.0, 0.0, 1.0], face=[1.0, 0.0, 0.0], sway=[0.0, 0.0, 0.1]),
    "point": Constraint.point(point=U),
    "sphere": Constraint.sphere(center=U, radius=0.3, inside=True),
    "cylinder": Constraint.cylinder(point=U, axis=[1.0, 0.0, 0.0], radius=0.3),
    "line": Constraint.line(point=U, axis=[1.0, 0.0, 0.0]),
    "hinge": Constraint.hinge(point=U, axis=[0.0, 0.0, 1.0], T=Pose([0.1, 0.2, 0.3])),
    "knife edge": Constraint.knife_edge(sideways=[0.0, 1.0, 0.0]),
    "grasp": Constraint.grasp("panda_link4", "panda_hand_tcp"),
    "pin": Constraint.pin("panda_link4", "panda_hand_tcp"),
    "two": Constraint.plane(point=U, normal=[0.0, 0.0, 1.0]) + Constraint.line(point=U, axis=[1.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("name", READY_MADE)
def test_a_ready_made_constraint_and_what_holds_it_are_pickled(name: str) -> None:
    constraint, arm = READY_MADE[name], taut.load_arm("panda")
    x = Snapshot(model_of(arm), q=arm.home, v=np.full(arm.n, 0.1), t=0.2)
    contact = taut.RigidContact(constraint=constraint)
    for twin in (pickle.loads(pickle.dumps(constraint)), pickle.loads(pickle.dumps(contact)).constraint):
        rows, again = constraint.at(x), twin.at(x)
        for part in ("phi", "A_q", "phi_t", "bias"):
            np.testing.assert_array_equal(getattr(rows, part), getattr(again, part))


@pytest.mark.parametrize("motion", [taut.laws.TaskComputedTorque, taut.laws.ComputedTorque])
def test_a_law_that_holds_a_constraint_is_pickled(motion: Any) -> None:
    law = taut.laws.HybridMotionForce(constraint=READY_MADE["plane"], motion=motion(kp=1.0, kd=1.0), kfp=0.3)
    twin = pickle.loads(pickle.dumps(law))
    assert (repr(twin), twin.reference) == (repr(law), law.reference)


def test_a_number_is_no_constraint_to_add() -> None:
    with pytest.raises(TypeError):
        CONSTRAINTS["plane"] + 3  # type: ignore[operator]


def test_rows_of_joints_that_are_not_as_many_as_said_are_told() -> None:
    constraint = Constraint.of_joints(lambda q: tm.array([q[0], q[1]]))
    with refused(taut.errors.ShapeError):
        constraint.at(taut.snapshot(taut.load_arm("planar2"), [0.1, 0.2]))


def test_the_projector_of_a_plane_is_not_symmetric() -> None:
    arm = taut.load_arm("panda")
    x = taut.snapshot(arm, arm.home)
    mobility = x.J() @ np.linalg.solve(x.M, x.J().T)
    P = force_projector(np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]), mobility)
    assert np.abs(P - P.T).max() > 0.01
    Lambda = factor_spd(mobility).inverse()
    assert np.abs(P @ Lambda - Lambda @ P.T).max() < 1e-9
