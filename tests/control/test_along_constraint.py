"""What a reference asks against a constraint does not become motion along it: of every constraint of the tool."""

from __future__ import annotations

import numpy as np
import pytest

import taut
from taut import Constraint, Pose
from taut import math as tm
from taut.base.types import Float64Array
from taut.control.laws.constraints import along_constraint, of_one_body
from taut.laws import HybridMotionForce, Impedance, TaskComputedTorque
from taut.maths.spatial import rotation_exp

Array = Float64Array
KP, KD = 100.0, 20.0
ARM = taut.load_arm("panda")
N = np.array([0.2, 0.9, 0.4]) / np.linalg.norm([0.2, 0.9, 0.4])


def constraints(T: Pose, V: Array) -> dict[str, Constraint]:
    """Constraints that a tool at a pose keeps to; V is its velocity."""
    p, n = T.p, N
    return {
        "plane": Constraint.plane(point=p, normal=n),
        "face": Constraint.plane(point=p, normal=T.R[:, 2], face=[0.0, 0.0, -1.0]),
        "line": Constraint.line(point=p, axis=n),
        "sphere": Constraint.sphere(center=p - 0.1 * n, radius=0.1),
        "moving": Constraint(lambda now, t: n @ (now.p - p) - 0.3 * t + 0.2 * t * t),
        "hinge": Constraint.hinge(point=p + np.array([0.1, 0.2, 0.0]), axis=[0.0, 0.0, 1.0], T=T),
        "wheel": Constraint.plane(point=p, normal=n) + Constraint.knife_edge(sideways=[0.0, 1.0, 0.0]),
        "of its own": Constraint(lambda now: tm.array([n @ (now.p - p) + 0.1 * (now.R[0, 2] - T.R[0, 2])])),
    }


SLANTED = np.diag([1000.0, 1000.0, 800.0, 50.0, 50.0, 50.0])  # a stiffness whose axes are not those of the board
SLANTED[0, 2] = SLANTED[2, 0] = 400.0
SLANTED[1, 2] = SLANTED[2, 1] = 300.0
KINDS = list(constraints(Pose([0.4, 0.0, 0.3]), np.zeros(6)))


def accelerated(arm: taut.Arm, constraint: Constraint, q: Array, v: Array, tau: Array, tool: str | None) -> Array:
    """(6,) of the tool, by the dynamics of an arm that the constraint really holds."""
    x = taut.snapshot(arm, q, v)
    rows = constraint.at(x)
    A = np.asarray(rows.A_q)
    n, k = arm.n, len(A)
    whole = np.block([[x.M, A.T], [A, np.zeros((k, k))]])
    a = np.linalg.solve(whole, np.concatenate([tau - x.h, -np.asarray(rows.bias)]))[:n]
    return np.asarray(x.J(tool) @ a + x.Jdot_v(tool))


def nearest(A: Array, six: Array, to: Array) -> Array:
    """What is nearest to six numbers with A six = to: by least squares of NumPy, in A's null space."""
    found: Array = np.asarray(six) - np.linalg.pinv(A) @ (A @ six - to)
    return found


@pytest.mark.part(2)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_the_tool_does_what_the_law_says_of_what_is_asked_along_the_constraint(name: str, kind: str) -> None:
    """A tool 10 mm off its reference, across and along, that turns and moves against it too."""
    arm = taut.load_arm(name).mounted(Pose([0.1, 0.2, 0.3], rpy=[0.2, -0.1, 0.4]))
    rng = np.random.default_rng(3)
    q, v = arm.home + 0.2 * rng.normal(size=arm.n), 0.3 * rng.normal(size=arm.n)
    x = taut.snapshot(arm, q, v)
    T, V = x.T(), x.twist()
    constraint = constraints(T, V)[kind]
    law = HybridMotionForce(
        constraint=constraint,
        motion=TaskComputedTorque(kp=KP, kd=KD, singularity="plain", null=None),
        tolerance=10.0,  # a wheel is asked to go sideways at metres a second, too
    )
    ctrl = taut.compile(law, arm, engine="float")
    e = np.array([0.006, -0.005, 0.007, 0.03, -0.02, 0.01])
    V_des, a_des, lam = rng.normal(size=6), rng.normal(size=6), -np.eye(constraint.count)[0]
    pose = Pose.of(rotation_exp(e[3:]) @ T.R, T.p + e[:3])
    ref = taut.pressing(taut.TaskMotion(pose=pose, twist=V_des, acceleration=a_des), lam=lam)
    tau = ctrl.step(q, v, ref)

    rows = constraint.at(x)
    A = np.asarray(rows.A)
    zero = np.zeros(len(A))
    wanted = nearest(A, a_des, -np.asarray(rows.curvature))
    wanted = wanted + KP * nearest(A, e, zero) + KD * nearest(A, V_des - V, zero)
    got = accelerated(arm, constraint, q, v, tau, None)
    rotates = bool(np.any(np.abs(A[:, 3:]) > 1e-12))  # rotations add up to second order
    assert np.abs(got - wanted).max() < (0.05 if rotates else 1e-8) * np.abs(wanted).max()
    assert np.abs(A @ got + rows.curvature).max() < 1e-8 * np.abs(got).max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_reference_that_keeps_to_the_constraint_is_followed_by_equation_10_45_as_it_stands(kind: str) -> None:
    rng = np.random.default_rng(4)
    q = ARM.home + 0.2 * rng.normal(size=7)
    constraint = constraints(taut.snapshot(ARM, q).T(), np.zeros(6))[kind]
    rows = constraint.at(taut.snapshot(ARM, q))
    v = 0.3 * rng.normal(size=7)
    v -= np.linalg.pinv(rows.A_q) @ (rows.A_q @ v + rows.phi_t)
    x = taut.snapshot(ARM, q, v)
    rows = constraint.at(x)
    A = np.asarray(rows.A)
    V_des = nearest(A, rng.normal(size=6), -np.asarray(rows.phi_t))
    a_des = nearest(A, rng.normal(size=6), -np.asarray(rows.curvature))
    ref = taut.TaskMotion(pose=x.T(), twist=V_des, acceleration=a_des)
    made = along_constraint(x, rows, None, ref, None)
    for field, given in (("p", ref.p), ("R", ref.R), ("twist", V_des), ("acceleration", a_des)):
        assert np.abs(getattr(made, field) - given).max() < 1e-9, field


def test_what_is_taken_out_is_told_where_the_constraint_is() -> None:
    """A constraint of a flange, a motion of the tool beyond it: the tool is moved by the flange's normal alone."""
    x = taut.snapshot(ARM, ARM.home, 0.2 * np.cos(np.arange(7.0)))
    flange, T = "panda_link8", x.T()
    constraint = Constraint(lambda now: N @ (now.p - x.T("panda_link8").p), frames=(flange,))
    assert of_one_body(constraint, x, None)
    pose = Pose.of(T.R, T.p + np.array([0.01, 0.02, -0.01]))
    made = along_constraint(
        x, constraint.at(x), flange, taut.TaskMotion(pose=pose, twist=[0.1, 0.2, 0.3, 1.0, -0.5, 0.2]), None
    )
    e = pose.p - T.p
    assert np.abs(made.p - T.p - (e - N * (N @ e))).max() < 1e-12
    assert np.abs(made.R - T.R).max() < 1e-12

    def normal_speed(V: Array, R: Array) -> float:
        r = R @ (T.R.T @ (x.T(flange).p - T.p))
        return float(N @ (V[:3] + np.cross(V[3:], r)))

    assert abs(normal_speed(made.twist, made.R) - normal_speed(x.twist(), T.R)) < 1e-12
    assert np.abs(made.twist[3:] - [1.0, -0.5, 0.2]).max() < 1e-12


def test_what_another_link_touches_is_no_constraint_of_the_tool() -> None:
    x = taut.snapshot(ARM, ARM.home)
    assert not of_one_body(Constraint(lambda T: T.p[2], frames=("panda_link4",)), x, None)
    assert not of_one_body(Constraint.of_joints(lambda q: q[0]), x, None)
    assert not of_one_body(Constraint.pin("panda_link4", "panda_link8"), x, None)
    assert of_one_body(Constraint(lambda T: T.p[2]), x, ARM.tool)
    assert of_one_body(Constraint(lambda T: T.p[2]), x, "panda_link7")


@pytest.mark.parametrize("frame", [None, "panda_link8"])
def test_an_impedance_with_inertia_answers_friction_and_a_push_and_not_the_force_of_the_contact(
    frame: str | None,
) -> None:
    """D V-dot = F_ext along the constraint, of a tool that rests at its reference."""
    q, D = ARM.home + 0.2 * np.cos(np.arange(7.0)), 6.0
    x = taut.snapshot(ARM, q)
    T, c = x.T(), x.T(frame).p
    constraint = Constraint(lambda now: N @ (now.p - c), frames=(frame,), one_sided=True)
    inertia = np.diag([D, D, D, 0.2, 0.2, 0.2])
    law = HybridMotionForce(
        constraint=constraint,
        motion=Impedance(D=inertia, K=(800.0, 30.0), B=(80.0, 4.0), null=None),
    )
    ctrl = taut.compile(law, ARM, engine="float")
    along = np.cross(N, [1.0, 0.0, 0.0])
    for push in (0.0, 3.0) if frame is None else (0.0,):
        lever = np.zeros(3) if frame is None else c - T.p
        contact = np.array([*(10.0 * N), *np.cross(lever, 10.0 * N)])  # at the tool's origin
        pushed = np.array([*(push * along), *np.cross(lever, push * along)])
        tau = ctrl.step(q, np.zeros(7), taut.pressing(taut.TaskMotion(pose=T), 10.0), F_ext=contact + pushed)
        got = accelerated(ARM, constraint, q, np.zeros(7), tau + x.J().T @ pushed, None)
        assert np.abs(got - np.linalg.solve(inertia, pushed)).max() < 1e-9, got


def on_soft_board(motion: taut.Law, depth: float) -> Array:
    """Where the tool rests on a board that gives way, with a reference so far below the board's face."""
    T = taut.snapshot(ARM, ARM.home).T()
    wall = taut.environments.StiffWall(point=T.p - [0.0, 0.0, depth], normal=[0, 0, 1], stiffness=5e3, damping=200.0)
    law = HybridMotionForce(
        constraint=Constraint.plane(point=T.p, normal=[0, 0, 1]), motion=motion, kfi=10.0, kdamp=100.0
    )
    plant = taut.RigidPlant(ARM, friction=None, environment=wall, substeps=2)
    run = taut.run(taut.compile(law, ARM), plant, taut.pressing(taut.TaskMotion(pose=T), 10.0), duration=0.8)
    assert run.outcome.ok
    assert abs(run.extra["F_ext"][-1, 2] - 10.0) < 0.2
    return np.asarray(run.task.p[-1, :2] - T.p[:2])


@pytest.mark.part(1)
@pytest.mark.parametrize(
    "motion",
    [
        TaskComputedTorque(kp=400.0, kd=40.0),
        TaskComputedTorque(kp=400.0, kd=40.0, error="body"),
        Impedance(K=SLANTED, zeta=1.0),
    ],
    ids=["decoupled", "body", "impedance"],
)
def test_on_a_board_that_is_8_mm_lower_the_tool_rests_where_it_was_asked_to(motion: taut.Law) -> None:
    assert np.abs(on_soft_board(motion, 0.008)).max() < 3e-5


def test_the_reference_of_a_law_of_joints_is_left_as_it_is() -> None:
    """What stands at right angles to a constraint among joints has no measure but that of P."""
    law = HybridMotionForce(
        constraint=Constraint.plane(point=taut.snapshot(ARM, ARM.home).T().p, normal=[0, 0, 1]),
        motion=taut.laws.ComputedTorque(kp=KP, kd=KD),
    )
    ctrl = taut.compile(law, ARM, engine="float")
    e = 0.01 * np.cos(np.arange(7.0))
    ctrl.step(ARM.home, np.zeros(7), taut.pressing(taut.JointMotion(q=ARM.home + e), 5.0))
    x = taut.snapshot(ARM, ARM.home)
    rows = law.constraint.at(x)
    A = np.asarray(rows.A_q)
    S = np.linalg.inv(A @ np.linalg.solve(x.M, A.T))
    along = x.M @ (KP * e) - A.T @ (S @ (A @ (KP * e)))
    assert np.abs(ctrl.terms["P"] - along).max() < 1e-9


def test_a_frame_that_is_turned_against_the_tool_changes_nothing_in_what_is_asked() -> None:
    """The flange stands at 45 degrees to the tool; a motion that keeps to its hinge stays as it is."""
    x = taut.snapshot(ARM, ARM.home)
    T, frame = x.T(), "panda_link8"
    assert np.abs(x.T(frame).R - T.R).max() > 0.2
    hinge = Constraint.hinge(point=T.p + np.array([0.0, 0.2, 0.1]), axis=[1.0, 0.0, 0.0], T=x.T(frame), frame=frame)
    made = along_constraint(x, hinge.at(x), frame, taut.TaskMotion(pose=T), None)
    np.testing.assert_allclose(made.p, T.p, atol=1e-9)
    np.testing.assert_allclose(made.R, T.R, atol=1e-9)
