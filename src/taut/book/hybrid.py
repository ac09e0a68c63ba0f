"""Section 10.4.2: constraints on velocity, multipliers, projections, and hybrid motion-force control."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np

import taut
from taut import Constraint, Coordinates, Pose, RigidContact, Run, TaskMotion, pressing, snapshot
from taut.base.types import Float64Array
from taut.book.force import eraser
from taut.book.models import MujocoState, in_mujoco, panda, simulated, ticked, total
from taut.book.multi_joint import TORQUE
from taut.book.page import Shown, compared, entry, row
from taut.laws import HybridMotionForce, TaskComputedTorque
from taut.maths.constraints.multipliers import force_projector
from taut.trajectories import Line

BOARD_HEIGHT: Final = 0.4  # [m] of the board
BY_HAND: Final = "the equation in NumPy, with MuJoCo's M, h and J"
V_JOINTS: Final = np.array([0.3, -0.2, 0.25, 0.1, -0.4, 0.3, 0.2])  # [rad/s] chosen, before the board is kept to
BOARD_A: Final = np.eye(6)[2:3]
ERASER_A: Final = np.eye(6)[2:5]  # z-dot, phi_x-dot, phi_y-dot


def board(*, one_sided: bool = False) -> Constraint:
    """The tool on the board."""
    return Constraint(lambda T: T.p[2] - BOARD_HEIGHT, one_sided=one_sided)


@cache
def state() -> tuple[Float64Array, Float64Array, MujocoState]:
    """A state of the Panda on the board, moving along it."""
    q = np.asarray(taut.dynamics.onto(board(), panda(), panda().home))
    A_q = in_mujoco(q).J[2:3]
    v = V_JOINTS - np.linalg.pinv(A_q) @ (A_q @ V_JOINTS)
    return q, v, in_mujoco(q, v)


@entry("eq-10.39", "constraints on velocity")
def eq_10_39() -> Shown:
    """A follows from phi(T) by differentiation. The velocity is chosen along the board."""
    q, v, m = state()
    A = np.asarray(eraser().at(snapshot(taut.load_arm("gantry3"), [0.0, 0.0, 0.2])).A)
    besides = np.linalg.svd(A @ np.linalg.pinv(ERASER_A) @ ERASER_A - A)[1].max()
    off = (np.asarray(board().at(snapshot(panda(), q, v)).A) @ m.J @ v)[0]
    yield row("eraser: rank of A", np.linalg.matrix_rank(A), 3, "the chapter: k = 3", states="k = 3")
    name = "eraser: what A has besides z-dot, phi_x-dot, phi_y-dot"
    yield row(name, besides, 0.0, "the chapter's three rows", near=1e-9)
    yield row("A V of a Panda that moves along a board [m/s]", off, 0.0, "10.39, with MuJoCo's J", near=1e-12)


@entry("eq-10.41", "the rate of the constraints")
def eq_10_41() -> Shown:
    """A-dot V on a ball is the centripetal acceleration v^2 / r of a point on a sphere.

    The rows of phi are distances, so that A-dot V is an acceleration. Velocity as in equation 10.39.
    """
    q, v, m = state()
    ball = Constraint.sphere(center=m.p - [0.0, 0.0, 0.1], radius=0.1)
    across = (m.J[:3] @ v) * np.array([1.0, 1.0, 0.0])
    got, wanted = ball.at(snapshot(panda(), q, v)).curvature[0], float(across @ across) / 0.1
    yield row("A-dot V of a tool that moves along a ball of 0.1 m [m/s^2]", got, wanted, "|V|^2 / r", rel=1e-6)


MIDDLE: Final = 250  # tick in the middle of the stroke


@cache
def pressed() -> tuple[Run, MujocoState]:
    """A Panda on the board that presses with 10 N and moves along it; its state in the middle of the stroke."""
    constraint, (q0, _, _) = board(one_sided=True), state()
    T0 = snapshot(panda(), q0).T()
    stroke = Line(T0=T0, T1=Pose(np.asarray(T0.p) + np.array([0.0, 0.1, 0.0]), R=T0.R), duration=0.5)
    motion = TaskComputedTorque(kp=400.0, kd=40.0, singularity="plain")
    law = HybridMotionForce(constraint=constraint, motion=motion, kfp=0.3, kfi=10.0)
    contact = RigidContact(constraint=constraint)
    out = simulated(law, panda(), pressing(stroke, 10.0), q0=q0, duration=0.6, contact=contact)
    return out, in_mujoco(out.q[MIDDLE], out.v[MIDDLE])


@entry("eq-10.40", "constrained dynamics")
def eq_10_40() -> Shown:
    """A Panda wipes a board, 0.1 m in 0.5 s, and presses with 10 N; the multiplier of a push is negative."""
    out, m = pressed()
    A_q, bias = BOARD_A @ m.J, BOARD_A @ m.Jdot_v
    free = np.linalg.solve(m.M, out.tau[MIDDLE] - m.h)
    wanted = np.linalg.solve(A_q @ np.linalg.solve(m.M, A_q.T), A_q @ free + bias)[0]
    name = "force on the board in the middle of a stroke [N]"
    yield row(name, out.extra["contact.lam"][MIDDLE, 0], wanted, "10.42 with MuJoCo's M, h and J", rel=1e-6)


@entry("eq-10.42", "the multipliers")
def eq_10_42() -> Shown:
    """The multiplier that a law estimates, beside equation 10.42 and the force of a rigid contact.

    On curved surfaces A^T (A Lambda^-1 A^T)^-1 A-dot V enters the force: 2.7 of 10 N for 3 kg at 0.3 m/s on a
    radius of 0.1 m. Equation 10.45 leaves it out; here it is the term `curvature`.
    """
    lam, taken = (float(pressed()[0].extra[column][MIDDLE, 0]) for column in ("law.lam", "contact.lam"))
    x = snapshot(taut.load_arm("gantry3"), np.zeros(3), [0.0, 0.3, 0.0])
    ball = Constraint.sphere(center=np.asarray(x.T().p) - [0.0, 0.0, 0.1], radius=0.1)
    ref: Any = pressing(TaskMotion(pose=x.T(), twist=[0.0, 0.3, 0.0, 0.0, 0.0, 0.0]), 10.0)
    motion = TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=Coordinates.position())
    with_it, without = (
        float(ticked(law, x.arm, x.q, x.v, ref).memory["law.lam"][0])
        for law in (HybridMotionForce(constraint=ball, motion=motion, curvature=each) for each in (True, False))
    )
    name, source = "multiplier of the law, in the middle of a stroke [N]", "what the contact takes"
    yield row(name, lam, taken, source, rel=1e-6)
    yield row("on a ball: multiplier with A-dot V compensated [N]", with_it, -10.0, "as asked: 10 N")
    name, slip = "on a ball: 10.45 as it stands presses less by [N]", "slip: error dynamics inherited, 10 N"
    yield row(name, without - with_it, 3.0 * 0.3**2 / 0.1, "m v^2 / r", states=slip)


@entry("eq-10.43", "the equations of motion that are left")
def eq_10_43() -> Shown:
    """Only P F moves the tool: a force in the range of A^T changes no acceleration.

    The stroke of equation 10.40; accelerations are differences over a tick of 1 ms.
    """
    out, m = pressed()
    P = np.asarray(force_projector(BOARD_A, np.linalg.inv(m.Lambda)))
    V_dot = m.J @ ((out.v[MIDDLE + 1] - out.v[MIDDLE]) * out.rate) + m.Jdot_v
    J_bar = np.linalg.solve(m.M, m.J.T) @ m.Lambda
    gamma_eta = J_bar.T @ m.h - m.Lambda @ m.Jdot_v
    left, right = P @ (J_bar.T @ out.tau[MIDDLE]), P @ (m.Lambda @ V_dot + gamma_eta)
    source = "P (Lambda V-dot + gamma + eta) of the run"
    yield row("P F: length [N]", np.linalg.norm(left[:3]), np.linalg.norm(right[:3]), source, rel=5e-3)
    yield row("P F along the stroke [N]", left[1], right[1], source, rel=5e-3, near=0.02)


def projection(A: Float64Array, m: MujocoState) -> Float64Array:
    """(6, 6) P of equation 10.44, written out."""
    mobility = np.linalg.inv(m.Lambda)
    made: Float64Array = np.eye(6) - A.T @ np.linalg.inv(A @ mobility @ A.T) @ A @ mobility
    return made


@entry("eq-10.44", "the projection")
def eq_10_44() -> Shown:
    """P is orthogonal in the product of Lambda^-1 only: P Lambda is symmetric, and P is not.

    A Panda with the three rows of the eraser.
    """
    q, v, m = state()
    x, A = snapshot(panda(), q, v), ERASER_A
    J = np.asarray(x.J())
    P, by_hand = np.asarray(force_projector(A, J @ np.linalg.solve(np.asarray(x.M), J.T))), projection(A, m)
    PL, size = P @ m.Lambda, 1.0 + float(np.linalg.norm(P)) ** 2
    yield from compared("P", P.ravel(), by_hand.ravel(), BY_HAND, 1e-9)
    yield row("rank of P", np.linalg.matrix_rank(P, tol=1e-6), 3, "n - k")
    yield row("P^2 - P", np.abs(P @ P - P).max(), 0.0, "a projection", near=1e-9 * size)
    yield row("P A^T", np.abs(P @ A.T).max(), 0.0, "forces against the constraints", near=1e-9)
    name, source = "P Lambda less its transpose [kg]", "symmetric in the product of Lambda^-1"
    yield row(name, np.abs(PL - PL.T).max(), 0.0, source, near=1e-9 * np.abs(PL).max())
    apart, wanted = (np.abs(each - each.T).max() for each in (P, by_hand))
    yield row("P less its transpose", apart, wanted, BY_HAND, states="slip: orthogonal projections, 0")


@entry("eq-10.45", "hybrid motion-force control")
def eq_10_45() -> Shown:
    """The stroke of equation 10.40; then a tick with kp = 100, kd = 20, Kfp = 0.3, Kfi = 10, and 8 N measured."""
    out, _ = pressed()
    force, stroke = out.extra["contact.lam"][-1, 0], out.task.p[-1, 1] - out.task.p[0, 1]
    yield row("force on the board in the end [N]", force, -10.0, "as asked: 10 N", near=0.02)
    yield row("largest error along the board [m]", out.metrics.task_peak, 0.0, "as asked", near=1e-3)
    yield row("stroke in the end [m]", stroke, 0.1, "as asked", near=1e-3)
    q, v, m = state()
    motion_law = TaskComputedTorque(kp=100.0, kd=20.0, null=None)
    law = HybridMotionForce(constraint=board(), motion=motion_law, kfp=0.3, kfi=10.0)
    twist = np.array([0.1, 0.05, 0.0, 0.0, 0.0, 0.0])
    X = np.array([0.01, -0.02, 0.0, 0.0, 0.0, 0.0])
    motion = TaskMotion(pose=Pose(m.p + X[:3], R=m.R), twist=twist)
    F_app, ref = np.array([0.5, 0.2, -8.0, 0.0, 0.0, 0.0]), pressing(motion, 10.0)
    got = total(ticked(law, panda(), q, v, ref, F_ext=-F_app).terms)  # type: ignore[arg-type]
    X[:3] = np.asarray(motion.p) - m.p
    F_motion = m.Lambda @ (100.0 * X + 20.0 * (twist - m.J @ v))
    lam_e = -10.0 - F_app[2]
    F_force = np.array([0.0, 0.0, -10.0 + 0.3 * lam_e + 10.0 * lam_e * 1e-3, 0.0, 0.0, 0.0])
    P, gamma = projection(BOARD_A, m), -m.Lambda @ m.Jdot_v
    wanted = m.J.T @ (P @ F_motion + (np.eye(6) - P) @ F_force + gamma) + m.h
    yield from compared(TORQUE, got, wanted, BY_HAND, 1e-6)
