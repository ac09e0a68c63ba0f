"""Hybrid motion-force control: the law against eq. 10.45 term by term, its closed loop, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import Constraint, Pose
from taut import math as tm
from taut.base.types import Float64Array
from taut.control.trajectories.reference import sample_rows
from taut.laws import ComputedTorque, HybridMotionForce, TaskComputedTorque, TaskVelocity

Array = Float64Array
ARM = taut.load_arm("panda")
FLOOR = Constraint.plane(point=[0.0, 0.0, 0.4], normal=[0.0, 0.0, 1.0])
BALL = Constraint.sphere(center=[0.4, 0.0, 0.1], radius=0.35)


def motion(**more: Any) -> TaskComputedTorque:
    """A motion law without what the chapter does not have."""
    return TaskComputedTorque(kp=100.0, kd=20.0, singularity="plain", null=None, **more)


def on(constraint: Constraint, arm: taut.Arm, seed: int = 0) -> tuple[Array, Array]:
    """A state on a constraint, that moves along it."""
    rng = np.random.default_rng(seed)
    q = taut.dynamics.onto(constraint, arm, arm.home + 0.1 * rng.normal(size=arm.n))
    x = taut.snapshot(arm, q)
    A = np.asarray(constraint.at(x).A_q)
    v = 0.5 * rng.normal(size=arm.n)
    return q, v - np.linalg.lstsq(A, A @ v, rcond=None)[0]


@pytest.mark.part(1)
@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_the_law_is_equation_10_45_with_the_curvature_term(name: str, engine: Any) -> None:
    arm = taut.load_arm(name)
    kfp, kfi, kdamp, dt = 0.4, 6.0, 5.0, 1e-3
    law = HybridMotionForce(constraint=BALL, motion=motion(), kfp=kfp, kfi=kfi, kdamp=kdamp)
    ctrl = taut.compile(law, arm, engine=engine)
    q, v = on(BALL, arm)
    x = taut.snapshot(arm, q, v)
    T = x.T()
    n = (T.p - [0.4, 0.0, 0.1]) / 0.35
    aside = np.cross(n, [0.0, 0.004, 0.003])  # what the reference asks is along the sphere
    twist = np.array([*np.cross(n, [0.2, 0.0, 0.1]), 0.0, 0.0, 0.3])
    V = x.twist()
    centripetal = -n * (V[:3] @ V[:3]) / 0.35
    a_des = np.array([*(centripetal + np.cross(n, [0.3, 0.1, -0.2])), 0.1, 0.2, 0.3])
    target = taut.TaskMotion(pose=Pose(T.p + aside, R=T.R), twist=twist, acceleration=a_des)
    F_ext = np.array([1.0, 2.0, 9.0, 0.1, -0.2, 0.3])
    tau = ctrl.step(q, v, taut.pressing(target, 10.0), F_ext=F_ext)

    J, M = x.J(), x.M
    Lambda = np.linalg.inv(J @ np.linalg.solve(M, J.T))
    A = np.array([[*n, 0.0, 0.0, 0.0]])
    Adot_V = np.array([(V[:3] @ V[:3] - (n @ V[:3]) ** 2) / 0.35])
    S = np.linalg.inv(A @ np.linalg.inv(Lambda) @ A.T)
    P = np.eye(6) - A.T @ S @ A @ np.linalg.inv(Lambda)
    error = np.append(target.p - T.p, np.zeros(3))
    wanted = a_des + 100.0 * error + 20.0 * (target.twist - V)
    F_motion = Lambda @ wanted
    F_d, F_app = A.T @ [-10.0], -F_ext
    lam_e = np.array([-10.0]) - A @ F_app
    F_force = F_d + A.T @ ((kfp + kfi * dt) * lam_e - kdamp * (A @ V))
    gamma = -Lambda @ x.Jdot_v()
    F = P @ F_motion + (np.eye(6) - P) @ F_force + gamma - A.T @ S @ Adot_V
    assert np.abs(tau - (J.T @ F + x.h)).max() < 1e-9 * np.abs(tau).max()
    assert sum(ctrl.terms.values()).tolist() == pytest.approx(tau.tolist(), abs=1e-9)
    assert np.abs(ctrl.terms["curvature"] + J.T @ A.T @ S @ Adot_V).max() < 1e-9
    # what 10.42 says of that torque, and the way that is left
    lam = S @ (A @ np.linalg.solve(Lambda, F - gamma) + Adot_V)
    assert ctrl.memory["law.lam"] == pytest.approx(lam, rel=1e-9)
    a = np.linalg.solve(Lambda, F - gamma - A.T @ lam)
    assert np.abs(A @ a + Adot_V).max() < 1e-9
    assert np.abs(a - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_without_the_curvature_term_3_kg_at_0_3_m_per_s_on_0_1_m_press_2_7_newton_less() -> None:
    """MATHS section 1: what eq. 10.45 leaves out, m v^2 / r, on a gantry that carries 3 kg."""
    arm = taut.load_arm("gantry3")
    assert taut.snapshot(arm, np.zeros(3)).M[2, 2] == pytest.approx(3.0)
    for inside, sign in ((False, -1.0), (True, 1.0)):
        start = taut.snapshot(arm, np.zeros(3)).T().p
        ball = Constraint.sphere(center=start - [0.0, 0.0, 0.1], radius=0.1, inside=inside)
        x = taut.snapshot(arm, np.zeros(3), [0.0, 0.3, 0.0])
        told = {}
        for curvature in (True, False):
            law = HybridMotionForce(
                constraint=ball,
                motion=motion(error="coordinates", coordinates=taut.Coordinates.position()),
                curvature=curvature,
            )
            ctrl = taut.compile(law, arm)
            ctrl.step(x.q, x.v, taut.pressing(taut.TaskMotion(pose=x.T(), twist=[0.0, 0.3, 0, 0, 0, 0]), 10.0))
            told[curvature] = float(ctrl.memory["law.lam"][0])
        assert told[True] == pytest.approx(-10.0)
        assert told[False] - told[True] == pytest.approx(-sign * 2.7, rel=1e-9)


def test_a_constraint_of_joints_goes_with_a_motion_of_joints() -> None:
    arm = taut.load_arm("planar3")
    slot = Constraint.of_joints(lambda q: q[0] + q[1] + q[2] - 1.2)
    law = HybridMotionForce(constraint=slot, motion=ComputedTorque(kp=100.0, kd=20.0))
    ctrl = taut.compile(law, arm)
    q, v = np.array([0.2, 0.4, 0.6]), np.array([0.5, -0.2, -0.3])
    x = taut.snapshot(arm, q, v)
    tau = ctrl.step(q, v, taut.pressing(taut.JointMotion(q=[0.3, 0.4, 0.5]), lam=[2.0]))
    A = np.ones((1, 3))
    S = np.linalg.inv(A @ np.linalg.solve(x.M, A.T))
    lam = S @ (A @ np.linalg.solve(x.M, tau - x.h))
    assert lam == pytest.approx([2.0])
    a = np.linalg.solve(x.M, tau - x.h - A.T @ lam)
    e, e_dot = np.array([0.1, 0.0, -0.1]), -v
    assert np.abs(a - (100.0 * e + 20.0 * e_dot)).max() < 1e-9  # which keep to the slot themselves
    assert abs(A @ a).max() < 1e-9


@pytest.mark.long
def test_a_closed_chain_is_moved_by_one_arm_and_squeezed_as_asked() -> None:
    arm = taut.load_arm("baxter").subset([name for name in taut.load_arm("baxter").joint_names if "head" not in name])
    x0 = taut.snapshot(arm, arm.home)
    bar = Constraint.grasp("left_gripper", "right_gripper", T=x0.T("left_gripper").inverse() @ x0.T("right_gripper"))
    law = HybridMotionForce(constraint=bar, motion=motion(tool="left_gripper"))
    ctrl = taut.compile(law, arm)
    squeeze = [0.0, 20.0, 0.0, 0.0, 0.0, 0.0]
    pose = x0.T("left_gripper")
    tau = ctrl.step(arm.home, np.zeros(arm.n), taut.pressing(taut.TaskMotion(pose=pose), lam=squeeze))
    rows = bar.at(x0)
    A = np.asarray(rows.A_q)
    S = np.linalg.inv(A @ np.linalg.solve(x0.M, A.T))
    lam = S @ (A @ np.linalg.solve(x0.M, tau - x0.h) + rows.bias)
    assert np.abs(lam - squeeze).max() < 1e-6
    a = np.linalg.solve(x0.M, tau - x0.h - A.T @ lam)
    assert np.abs(A @ a).max() < 1e-6
    assert np.abs(x0.J("left_gripper") @ a).max() < 1e-6
    wanted = np.array([0.5, -0.2, 0.3, 0.4, -0.6, 0.8])  # the right arm has to come along
    tau = ctrl.step(
        arm.home, np.zeros(arm.n), taut.pressing(taut.TaskMotion(pose=pose, acceleration=wanted), lam=squeeze)
    )
    a = np.linalg.solve(x0.M, tau - x0.h - A.T @ squeeze)
    assert np.abs(A @ a).max() < 1e-6
    assert np.abs(x0.J("left_gripper") @ a - wanted).max() < 1e-4


def test_the_measured_force_counts_what_is_along_the_normal_only() -> None:
    """Friction along the surface is no pressing, though P is oblique."""
    arm = taut.load_arm("panda")
    q, _ = on(BALL, arm)
    x = taut.snapshot(arm, q)
    n = (x.T().p - [0.4, 0.0, 0.1]) / 0.35
    along = np.cross(n, [0.3, 0.5, 0.1])
    ctrl = taut.compile(HybridMotionForce(constraint=BALL, motion=motion(), kfp=0.5), arm)
    ref = taut.pressing(taut.TaskMotion(pose=x.T()), 10.0)
    for friction in (0.0, 4.0):
        ctrl.reset()
        ctrl.step(q, np.zeros(7), ref, F_ext=np.array([*(10.0 * n + friction * along), 0.0, 0.0, 0.0]))
        assert np.abs(ctrl.terms["force_P"]).max() < 1e-9


def test_joint_torques_measure_the_multipliers_too() -> None:
    arm = taut.load_arm("panda")
    q, v = on(BALL, arm)
    x = taut.snapshot(arm, q, v)
    law = HybridMotionForce(constraint=BALL, motion=motion(), kfp=0.5, feedback="joint_torque")
    ctrl = taut.compile(law, arm)
    assert "tau_meas" in ctrl.needs
    ref = taut.pressing(taut.TaskMotion(pose=x.T()), 10.0)
    alone = taut.compile(HybridMotionForce(constraint=BALL, motion=motion()), arm)
    ctrl.step(q, v, ref, tau_meas=alone.step(q, v, ref))  # the torque that makes 10 N
    assert np.abs(ctrl.terms["force_P"]).max() < 1e-9


def test_the_integral_is_bounded_and_a_contact_is_never_pulled() -> None:
    arm = taut.load_arm("panda")
    q, _ = on(BALL, arm)
    x = taut.snapshot(arm, q)
    n = (x.T().p - [0.4, 0.0, 0.1]) / 0.35
    law = HybridMotionForce(constraint=BALL, motion=motion(), kfi=50.0, e_int_max=0.1, kdamp=10.0)
    ctrl = taut.compile(law, arm)
    ref = taut.pressing(taut.TaskMotion(pose=x.T()), 10.0)
    for _ in range(400):
        ctrl.step(q, np.zeros(7), ref, F_ext=np.zeros(6))
    assert ctrl.memory["law.e_int"] == pytest.approx([-0.1])
    ctrl.reset()
    for _ in range(400):
        ctrl.step(q, np.zeros(7), ref, F_ext=np.array([*(200.0 * n), 0.0, 0.0, 0.0]))
    assert ctrl.memory["law.e_int"] == pytest.approx([0.1])
    law = HybridMotionForce(constraint=BALL, motion=motion(), kfi=500.0)
    ctrl = taut.compile(law, arm)
    for _ in range(400):
        ctrl.step(q, np.zeros(7), ref, F_ext=np.array([*(200.0 * n), 0.0, 0.0, 0.0]))
    assert ctrl.memory["law.lam"] == pytest.approx([0.0], abs=1e-9)
    pull = ctrl.terms["one_sided"] + ctrl.terms["force"] + ctrl.terms["force_I"]
    assert np.abs(pull).max() < 1e-9


def test_the_integral_rests_where_it_would_pull_or_limits_cut_it() -> None:
    arm = taut.load_arm("panda")
    q, _ = on(BALL, arm)
    x = taut.snapshot(arm, q)
    n = (x.T().p - [0.4, 0.0, 0.1]) / 0.35
    law = HybridMotionForce(constraint=BALL, motion=motion(), kfi=50.0)
    ref = taut.pressing(taut.TaskMotion(pose=x.T()), 10.0)
    ctrl = taut.compile(law, arm)
    hit = np.array([*(200.0 * n), 0.0, 0.0, 0.0])  # an impact, which lam = 0 cannot answer
    for _ in range(400):
        ctrl.step(q, np.zeros(7), ref, F_ext=hit)
    assert 0.2 <= ctrl.memory["law.e_int"][0] < 0.2 + 190.0 * 1e-3 + 1e-9  # kfi e_int is 10 N, and no more
    for sign, other in ((1.0, -1.0), (-1.0, 1.0)):
        limited = taut.compile(law, arm, limits=taut.Limits(tau=arm.effort, tau_dot=0.5))
        limited.reset(tau_applied=taut.compile(law, arm).step(q, np.zeros(7), ref, F_ext=np.zeros(6)))
        felt = np.array([*((10.0 + sign * 5.0) * n), 0.0, 0.0, 0.0])
        back = np.array([*((10.0 + other * 5.0) * n), 0.0, 0.0, 0.0])
        for _ in range(300):
            limited.step(q, np.zeros(7), ref, F_ext=felt)
        held = limited.memory["law.e_int"][0]
        assert abs(held) < 0.3 * abs(sign * 5.0 * 0.3)  # 0.3 s of 5 N would be 1.5 N s
        limited.step(q, np.zeros(7), ref, F_ext=back)
        assert (limited.memory["law.e_int"][0] - held) * other > 0.0  # the way back is free


@pytest.mark.part(1)
@pytest.mark.parametrize("adds", [(), ("gravity",)])
def test_joint_torques_measure_the_contact_whatever_the_plant_adds_itself(adds: tuple[str, ...]) -> None:
    """Torque sensors have all that acts on the links: gravity that the plant compensates is in what they tell."""
    q = taut.dynamics.onto(FLOOR, ARM, ARM.home)
    law = HybridMotionForce(constraint=FLOOR, motion=motion(), kfp=0.3, kfi=5.0, feedback="joint_torque")
    plant = taut.RigidPlant(
        ARM,
        friction=None,
        contact=taut.RigidContact(constraint=FLOOR),
        adds=adds,
        sensors=taut.sensors.Sensors(torque=taut.sensors.TorqueSensor()),
    )
    ctrl = taut.compile(law, ARM, adds=plant.adds)
    run = taut.run(ctrl, plant, taut.pressing(taut.TaskMotion(pose=floor_pose()), 10.0), q0=q, duration=0.1)
    assert abs(run.extra["contact.lam"][-1, 0] + 10.0) < 0.1


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("kfp", "kfi", "settles"), [(0.95, 1.0, True), (1.05, 1.0, False), (0.5, 900.0, True), (0.5, 1100.0, False)]
)
def test_on_a_rigid_contact_the_force_settles_where_kfp_and_kfi_dt_over_2_are_below_1(
    kfp: float, kfi: float, settles: bool
) -> None:
    """The measured force is a tick old: e' = -kfp e - kfi int(e)."""
    q = taut.dynamics.onto(FLOOR, ARM, ARM.home)
    law = HybridMotionForce(constraint=FLOOR, motion=motion(), kfp=kfp, kfi=kfi)
    ctrl = taut.compile(law, ARM, engine="float")
    ref, lam, errors = taut.pressing(taut.TaskMotion(pose=floor_pose()), 10.0), -9.9, []
    for _ in range(120):  # small enough an error that the contact is never pulled at
        ctrl.step(q, np.zeros(7), ref, F_ext=np.array([0.0, 0.0, -lam, 0.0, 0.0, 0.0]))
        lam = float(ctrl.memory["law.lam"][0])
        errors.append(abs(-10.0 - lam))
        if errors[-1] > 5.0:
            break
    assert (max(errors[-10:]) < 0.5 * errors[0] + 1e-3) == settles


def test_what_is_asked_follows_in_time() -> None:
    pose = Pose([0.4, 0.0, 0.3])
    line = taut.trajectories.Line(T0=pose, T1=Pose([0.4, 0.2, 0.3]), duration=2.0)
    both = taut.pressing(line, lambda t: 5.0 * t)
    assert isinstance(both.at(1.0), taut.trajectories.HybridMotion)  # type: ignore[union-attr]
    assert both.at(1.0).press == 5.0  # type: ignore[union-attr]
    assert both.at(1.0).p.tolist() == [0.4, 0.1, 0.3]  # type: ignore[union-attr]
    assert both.duration == 2.0  # type: ignore[union-attr]
    assert repr(taut.pressing(taut.JointMotion(q=[0.1]), lam=[1.0, 2.0])).startswith("pressing(JointMotion(q=[0.1]")


@pytest.mark.parametrize(
    "force", [{"press": 4.0}, {"press": lambda t: 5.0 * t}, {"lam": [-1.0, 2.0]}, {"F_app": np.arange(6.0)}]
)
def test_samples_at_many_times_are_those_one_after_the_other(force: dict[str, Any]) -> None:
    pose = Pose([0.4, 0.0, 0.3])
    line = taut.trajectories.Line(T0=pose, T1=Pose([0.4, 0.2, 0.3], rpy=[0.0, 0.5, 0.0]), duration=2.0)
    times, kind = np.array([0.0, 0.3, 1.7]), taut.pressing(taut.TaskMotion(pose=pose)).__class__

    class OneByOne:
        at = staticmethod(line.at)

    fast, slow = (sample_rows(taut.pressing(way, **force), times, kind, 7) for way in (line, OneByOne()))  # type: ignore[arg-type]
    assert list(fast) == list(kind.fields(7))
    for name, rows in fast.items():
        np.testing.assert_allclose(rows, slow[name], atol=1e-14, err_msg=name)


def stepped(constraint: Any, ref: Any, q: Array | None = None, **more: Any) -> Array:
    ctrl = taut.compile(HybridMotionForce(constraint=constraint, motion=motion(), **more), ARM)
    given = {"F_ext": np.zeros(6)} if "F_ext" in ctrl.needs else {}
    return ctrl.step(taut.dynamics.onto(FLOOR, ARM, ARM.home) if q is None else q, np.zeros(7), ref, **given)


def checked(constraint: Any, ref: Any) -> None:
    """What a run looks at before it starts."""
    x = taut.snapshot(ARM, taut.dynamics.onto(FLOOR, ARM, ARM.home))
    HybridMotionForce(constraint=constraint, motion=motion()).check_reference(x, ref, 1000.0)


def floor_pose() -> Pose:
    return taut.snapshot(ARM, taut.dynamics.onto(FLOOR, ARM, ARM.home)).T()


FLOOR_REF = taut.pressing(taut.TaskMotion(pose=floor_pose()))


FLOOR_PRESS = taut.pressing(taut.TaskMotion(pose=floor_pose()), 10.0)


HINGE = Constraint.hinge(point=floor_pose().p + np.array([0.0, 0.3, 0.0]), axis=[0.0, 0.0, 1.0], T=floor_pose())


def squared(T: Pose) -> Any:
    """phi = d^2, whose gradient is zero where it is."""
    return (T.p[2] - 0.4) * (T.p[2] - 0.4)


@pytest.mark.part(2)
@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: HybridMotionForce(constraint=3, motion=motion()), taut.errors.UsageError),
        (lambda: HybridMotionForce(constraint=FLOOR, motion=3), taut.errors.UsageError),
        (lambda: HybridMotionForce(constraint=FLOOR), taut.errors.UsageError),
        (lambda: HybridMotionForce(constraint=FLOOR, motion=motion(), feedback="eye"), taut.errors.UsageError),
        (
            lambda: HybridMotionForce(
                constraint=Constraint.of_joints(lambda q: q[0]), motion=ComputedTorque(kp=1.0, kd=1.0), kfp=0.5
            ),
            taut.errors.UsageError,
        ),
        (
            lambda: taut.compile(HybridMotionForce(constraint=FLOOR, motion=TaskVelocity(kp=1.0)), ARM),
            taut.errors.UsageError,
        ),
        (
            lambda: taut.compile(HybridMotionForce(constraint=FLOOR + FLOOR, motion=motion()), ARM),
            taut.errors.RangeError,
        ),
        (lambda: stepped(squared, taut.pressing(taut.TaskMotion(pose=floor_pose()))), taut.errors.RangeError),
        (
            lambda: stepped(FLOOR, taut.pressing(taut.TaskMotion(pose=floor_pose())), np.array(ARM.home)),
            taut.errors.RangeError,
        ),
        (
            lambda: stepped(FLOOR, taut.pressing(taut.TaskMotion(pose=floor_pose()), F_app=[0, 3.0, -9.0, 0, 0, 0])),
            taut.errors.RangeError,
        ),
        (
            lambda: stepped(
                Constraint.plane(point=[0.0, 0.0, 0.4], normal=[1e-6, 0.0, 1.0]),
                taut.pressing(taut.TaskMotion(pose=floor_pose()), F_app=[0, 3.0, -9.0, 0, 0, 0]),
            ),
            taut.errors.RangeError,
        ),
        (
            lambda: stepped(FLOOR, taut.pressing(taut.TaskMotion(pose=floor_pose()), F_app=[0, 0, 9.0, 0, 0, 0])),
            taut.errors.RangeError,
        ),
        (
            lambda: stepped(FLOOR, taut.pressing(taut.TaskMotion(pose=floor_pose()), lam=[4.0])),
            taut.errors.RangeError,
        ),
        (
            lambda: stepped(FLOOR, taut.pressing(taut.TaskMotion(pose=floor_pose()), lam=[-4.0, 1.0])),
            taut.errors.UsageError,
        ),
        (
            lambda: stepped(HINGE, taut.pressing(taut.TaskMotion(pose=floor_pose()), lam=[0.0, 1.0, 2.0])),
            taut.errors.UsageError,
        ),
        (
            lambda: stepped(HINGE, taut.pressing(taut.TaskMotion(pose=floor_pose()), lam=[0.0, 0.0])),
            taut.errors.UsageError,
        ),
        (lambda: stepped(HINGE, FLOOR_PRESS), taut.errors.UsageError),
        (
            lambda: checked(HINGE, taut.pressing(taut.TaskMotion(pose=floor_pose()), lambda t: 5.0 * t)),
            taut.errors.UsageError,
        ),
        (lambda: checked(HINGE, taut.chunk([0.0, 1.0], [FLOOR_REF, FLOOR_PRESS])), taut.errors.UsageError),
        (
            lambda: stepped(FLOOR, taut.pressing(taut.TaskMotion(pose=Pose(floor_pose().p - [0, 0, 0.05])), 5.0)),
            taut.errors.RangeError,
        ),
        (lambda: stepped(FLOOR, taut.TaskMotion(pose=floor_pose())), taut.errors.UsageError),
        (
            lambda: HybridMotionForce(constraint=FLOOR, motion=motion(), tolerance=float("nan")),
            taut.errors.RangeError,
        ),
        (lambda: HybridMotionForce(constraint=FLOOR, motion=motion(), curvature="no"), taut.errors.UsageError),
        (
            lambda: HybridMotionForce(
                constraint=Constraint.of_joints(lambda q: q, rows=7) + Constraint.of_joints(lambda q: q, rows=7),
                motion=motion(),
            ),
            taut.errors.UsageError,
        ),
        (
            lambda: taut.compile(HybridMotionForce(constraint=FLOOR, motion=motion(), kfp=0.5, kfi=3300.0), ARM),
            taut.errors.RangeError,
        ),
        (
            lambda: stepped(lambda T: tm.array([T.p[2] - 0.4, T.p[2] - 0.4 + 1e-5 * T.p[0]]), FLOOR_REF),
            taut.errors.RangeError,
        ),
        (
            lambda: stepped(Constraint.knife_edge(sideways=[0.0, 1.0, 0.0]) + FLOOR, FLOOR_PRESS),
            taut.errors.UsageError,
        ),
        (lambda: taut.pressing(3.0), taut.errors.UsageError),  # type: ignore[arg-type]
        (lambda: taut.pressing(taut.JointMotion(q=[0.0]), -3.0), taut.errors.RangeError),
        (lambda: taut.pressing(taut.JointMotion(q=[0.0]), 3.0, lam=[1.0]), taut.errors.UsageError),
        (lambda: taut.pressing(taut.JointMotion(q=[0.0]), lam=np.ones((2, 2))), taut.errors.ShapeError),
    ],
)
def test_what_makes_no_sense_is_one_sentence(make: Callable[[], Any], error: type[Exception]) -> None:
    with refused(error):
        make()


def test_a_run_into_the_surface_is_refused_before_it_starts() -> None:
    law = HybridMotionForce(constraint=FLOOR, motion=motion())
    ctrl, q = taut.compile(law, ARM), taut.dynamics.onto(FLOOR, ARM, ARM.home)
    T = floor_pose()
    dive = taut.pressing(taut.trajectories.Line(T0=T, T1=Pose(T.p - [0.0, 0.0, 0.1], R=T.R), duration=1.0), 5.0)
    with refused(taut.errors.RangeError):
        taut.run(ctrl, taut.RigidPlant(ARM), dive, duration=1.0, q0=q)


def test_a_motion_is_looked_at_whichever_way_its_frame_is_named_and_of_a_chunk_each_sample() -> None:
    """A constraint of the tool, a motion of the same frame by its name; a constraint of the flange behind the tool."""
    T = floor_pose()
    x = taut.snapshot(ARM, taut.dynamics.onto(FLOOR, ARM, ARM.home))
    flange = Constraint.plane(point=x.T("panda_link8").p, normal=[0.0, 0.0, 1.0], frame="panda_link8")
    down = taut.pressing(taut.TaskMotion(pose=Pose.of(T.R, T.p - [0.0, 0.0, 0.05])), 5.0)
    tilt = taut.pressing(taut.TaskMotion(pose=Pose.of(Pose(rpy=[0.5, 0.0, 0.0]).R @ T.R, T.p)), 5.0)
    chunk = taut.chunk([0.1, 0.5], [taut.pressing(taut.TaskMotion(pose=T), 5.0), down])
    for constraint, ref in ((FLOOR, down), (FLOOR, chunk), (flange, tilt)):
        law = HybridMotionForce(constraint=constraint, motion=motion(tool="panda_hand_tcp"))
        with refused(taut.errors.RangeError):
            law.check_reference(x, ref, 1000.0)


def test_a_wrench_must_lie_in_the_range_of_a_all_the_way() -> None:
    """On a sphere what presses at the start is askew later."""
    q, _ = on(BALL, ARM)
    x = taut.snapshot(ARM, q)
    T, c = x.T(), np.array([0.4, 0.0, 0.1])
    n = (T.p - c) / 0.35

    class Arc:
        duration = 1.0

        def at(self, t: float) -> taut.TaskMotion:
            R = Pose(rpy=[0.0, 0.0, 0.3 * t]).R
            return taut.TaskMotion(pose=Pose.of(T.R, c + R @ (T.p - c)))

    law = HybridMotionForce(constraint=BALL, motion=motion())
    law.check_reference(x, taut.pressing(Arc(), 10.0), 1000.0)
    with refused(taut.errors.RangeError):
        law.check_reference(x, taut.pressing(Arc(), F_app=[*(-10.0 * n), 0.0, 0.0, 0.0]), 1000.0)


def test_a_user_writes_a_constraint_as_a_function() -> None:
    law = HybridMotionForce(constraint=Constraint(lambda T: T.p[2] - 0.4, one_sided=True), motion=motion())
    same = HybridMotionForce(constraint=FLOOR, motion=motion())
    q = taut.dynamics.onto(FLOOR, ARM, ARM.home)
    ref = taut.pressing(taut.TaskMotion(pose=floor_pose()), 7.0)
    one, other = (taut.compile(each, ARM).step(q, np.zeros(7), ref) for each in (law, same))
    assert np.abs(one - other).max() < 1e-12
