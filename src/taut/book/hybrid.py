"""Section 10.4.2: constraints on velocity, multipliers, projections, and hybrid motion-force control."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np

from taut.arm.load import load_arm
from taut.base.types import Float64Array
from taut.book.force import eraser
from taut.book.models import EngineState, engine, panda, simulated, ticked, total
from taut.book.page import Shown, compared, entry, row
from taut.control.laws.hybrid import HybridMotionForce
from taut.control.laws.task import TaskComputedTorque
from taut.control.laws.task_error import Coordinates
from taut.control.trajectories.force_reference import pressing
from taut.control.trajectories.task import Line
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.multipliers import force_projector, onto
from taut.maths.snapshot import snapshot
from taut.plant.contact import RigidContact
from taut.record.run import Run
from taut.trace.pose import Pose

__all__: list[str] = []

BOARD_HEIGHT: Final = 0.4  # [m] of the board
BY_HAND: Final = "the equation in NumPy, with MuJoCo's M, h and J"
# -------------------------------------------------------------------- the Panda on a board


@cache
def on_board() -> Float64Array:
    """(7,) joints of a Panda whose tool is on the board."""
    return np.asarray(onto(Constraint(lambda T: T.p[2] - BOARD_HEIGHT), panda(), panda().home))


V_JOINTS: Final = np.array([0.3, -0.2, 0.25, 0.1, -0.4, 0.3, 0.2])  # [rad/s] chosen, before the board is kept to


@cache
def state() -> tuple[Float64Array, Float64Array, EngineState]:
    """A state of the Panda on the board, moving along it."""
    q = on_board()
    A_q = engine().at(q, np.zeros(7)).J[2:3]
    v = V_JOINTS - np.linalg.pinv(A_q) @ (A_q @ V_JOINTS)
    return q, v, engine().at(q, v)


def turned() -> Constraint:
    """A ball of 0.1 m, so that A changes along the way."""
    p = engine().at(on_board(), np.zeros(7)).p
    return Constraint.sphere(center=p - [0.0, 0.0, 0.1], radius=0.1)


A_ROW: Final = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])


@entry("eq-10.39", "constraints on velocity")
def eq_10_39() -> Shown:
    q, v, m = state()
    A = np.asarray(eraser().at(snapshot(load_arm("gantry3"), [0.0, 0.0, 0.2])).A)
    wanted = np.array([[0.0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0]])
    got = np.linalg.svd(A @ np.linalg.pinv(wanted) @ wanted - A)[1].max()
    board_A = np.asarray(Constraint(lambda T: T.p[2] - BOARD_HEIGHT).at(snapshot(panda(), q, v)).A)
    yield row("eraser: rank of A", "", np.linalg.matrix_rank(A), 3, "the chapter: k = 3", states="k = 3")
    yield row(
        "eraser: what A has besides z-dot, phi_x-dot, phi_y-dot", "", got, 0.0, "the chapter's three rows", near=1e-9
    )
    yield row(
        "A V of a Panda that moves along a board",
        "m/s",
        (board_A @ m.J @ v)[0],
        0.0,
        "10.39, with MuJoCo's J",
        near=1e-12,
    )
    yield "A follows from phi(T) by differentiation. The velocity is chosen along the board."


@entry("eq-10.41", "the rate of the constraints")
def eq_10_41() -> Shown:
    """A-dot V on a ball: m v^2 / r without the mass, by the motion of a point on a sphere."""
    q, v, m = state()
    rows_at = turned().at(snapshot(panda(), q, v))
    speed = m.J[:3] @ v
    across = speed - speed[2] * np.array([0.0, 0.0, 1.0])
    wanted = float(across @ across) / 0.1
    yield row(
        "A-dot V of a tool that moves along a ball of 0.1 m",
        "m/s^2",
        rows_at.curvature[0],
        wanted,
        "|V|^2 / r",
        rel=1e-6,
    )
    yield "The rows of phi are distances, so that A-dot V is an acceleration. Velocity as in equation 10.39."


def lam_by_hand(m: EngineState, tau: Float64Array, A: Float64Array, Adot_V: Any) -> Float64Array:
    """(k,) equation 10.42 in joints: the multipliers under a torque."""
    A_q = A @ m.J
    free = np.linalg.solve(m.M, tau - m.h)
    bias = A @ m.Jdot_v + Adot_V
    made: Float64Array = np.linalg.solve(A_q @ np.linalg.solve(m.M, A_q.T), A_q @ free + bias)
    return made


@cache
def pressed() -> tuple[Run, Float64Array]:
    """A Panda on the board that presses with 10 N and moves along it; and the state at its start."""
    constraint = Constraint(lambda T: T.p[2] - BOARD_HEIGHT, one_sided=True)
    q0 = on_board()
    T0 = snapshot(panda(), q0).T()
    stroke = Line(T0=T0, T1=Pose(np.asarray(T0.p) + np.array([0.0, 0.1, 0.0]), R=T0.R), duration=0.5)
    law = HybridMotionForce(
        constraint=constraint, motion=TaskComputedTorque(kp=400.0, kd=40.0, singularity="plain"), kfp=0.3, kfi=10.0
    )
    contact = RigidContact(constraint=constraint)
    return simulated(law, panda(), pressing(stroke, 10.0), q0=q0, duration=0.6, contact=contact), q0


@entry("eq-10.40", "constrained dynamics")
def eq_10_40() -> Shown:
    out, _ = pressed()
    k = 250
    m = engine().at(out.q[k], out.v[k])
    wanted = lam_by_hand(m, out.tau[k], A_ROW, 0.0)
    yield row(
        "force on the board in the middle of a stroke",
        "N",
        out.extra["contact.lam"][k, 0],
        wanted[0],
        "10.42 with MuJoCo's M, h and J",
        rel=1e-6,
    )
    yield "A Panda that strokes a board, 0.1 m in 0.5 s, and presses with 10 N; negative presses."


@entry("eq-10.42", "the multipliers")
def eq_10_42() -> Shown:
    """A law's own estimate, beside equation 10.42 and what a rigid contact takes."""
    out, _ = pressed()
    gantry = load_arm("gantry3")
    start = np.asarray(snapshot(gantry, np.zeros(3)).T().p)
    ball = Constraint.sphere(center=start - [0.0, 0.0, 0.1], radius=0.1)
    x = snapshot(gantry, np.zeros(3), [0.0, 0.3, 0.0])
    ref = pressing(TaskMotion(pose=x.T(), twist=[0.0, 0.3, 0.0, 0.0, 0.0, 0.0]), 10.0)
    got = {}
    for curvature in (True, False):
        motion = TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=Coordinates.position())
        law = HybridMotionForce(constraint=ball, motion=motion, curvature=curvature)
        got[curvature] = float(ticked(law, gantry, x.q, x.v, ref).memory["law.lam"][0])  # type: ignore[arg-type]
    lam, taken = (float(out.extra[column][250, 0]) for column in ("law.lam", "contact.lam"))
    yield row("multiplier of the law, in the middle of a stroke", "N", lam, taken, "what the contact takes", rel=1e-6)
    yield row("on a ball: multiplier with A-dot V compensated", "N", got[True], -10.0, "as asked: 10 N", rel=1e-9)
    yield row(
        "on a ball: 10.45 as it stands presses less by",
        "N",
        got[False] - got[True],
        3.0 * 0.3**2 / 0.1,
        "m v^2 / r",
        rel=1e-9,
        states="slip: error dynamics inherited, 10 N",
    )

    yield (
        "On curved surfaces A^T (A Lambda^-1 A^T)^-1 A-dot V enters the force: 2.7 of 10 N for 3 kg at 0.3 m/s on a "
        "radius of 0.1 m. Equation 10.45 leaves it out; here it is the term `curvature`."
    )


def projected() -> tuple[Float64Array, Float64Array, EngineState]:
    """P of the eraser's rows, and these, for the Panda on the board."""
    q, v, m = state()
    x = snapshot(panda(), q, v)
    J = np.asarray(x.J())
    A = np.array([[0.0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0]])
    P = np.asarray(force_projector(A, J @ np.linalg.solve(np.asarray(x.M), J.T)))
    return P, A, m


@entry("eq-10.43", "the equations of motion that are left")
def eq_10_43() -> Shown:
    """Only P F moves the tool: what is added in the range of A^T changes no acceleration."""
    out, _ = pressed()
    k = 250
    m = engine().at(out.q[k], out.v[k])
    P = np.asarray(force_projector(A_ROW, np.linalg.inv(m.Lambda)))
    a = (out.v[k + 1] - out.v[k]) * out.rate
    V_dot = m.J @ a + m.Jdot_v
    J_bar = np.linalg.solve(m.M, m.J.T) @ m.Lambda
    F_all = J_bar.T @ out.tau[k]
    gamma_eta = J_bar.T @ m.h - m.Lambda @ m.Jdot_v
    left, right = P @ F_all, P @ (m.Lambda @ V_dot + gamma_eta)
    yield row(
        "P F: length",
        "N",
        np.linalg.norm(left[:3]),
        np.linalg.norm(right[:3]),
        "P (Lambda V-dot + gamma + eta) of the run",
        rel=5e-3,
    )
    yield row(
        "P F along the stroke",
        "N",
        left[1],
        right[1],
        "P (Lambda V-dot + gamma + eta) of the run",
        rel=5e-3,
        near=0.02,
    )
    yield "The stroke of equation 10.40; accelerations are differences over a tick of 1 ms."


@entry("eq-10.44", "the projection")
def eq_10_44() -> Shown:
    P, A, m = projected()
    S = np.linalg.inv(A @ np.linalg.inv(m.Lambda) @ A.T)
    by_hand = np.eye(6) - A.T @ S @ A @ np.linalg.inv(m.Lambda)
    PL = P @ m.Lambda
    apart = np.abs(P - P.T).max()
    yield from compared(P.ravel(), by_hand.ravel(), "", BY_HAND, "P", 1e-9)
    yield row("rank of P", "", np.linalg.matrix_rank(P, tol=1e-6), 3, "n - k")
    yield row(
        "P^2 - P", "", np.abs(P @ P - P).max(), 0.0, "a projection", near=1e-9 * (1.0 + float(np.linalg.norm(P)) ** 2)
    )
    yield row("P A^T", "", np.abs(P @ A.T).max(), 0.0, "forces against the constraints", near=1e-9)
    yield row(
        "P Lambda less its transpose",
        "kg",
        np.abs(PL - PL.T).max(),
        0.0,
        "symmetric in the product of Lambda^-1",
        near=1e-9 * np.abs(PL).max(),
    )
    yield row(
        "P less its transpose",
        "",
        apart,
        np.abs(by_hand - by_hand.T).max(),
        BY_HAND,
        states="slip: orthogonal projections, 0",
    )

    yield (
        "P is orthogonal in the product of Lambda^-1 only: P Lambda is symmetric, and P is not. A Panda with the "
        "three rows of the eraser."
    )


@entry("eq-10.45", "hybrid motion-force control")
def eq_10_45() -> Shown:
    out, _ = pressed()
    yield row(
        "force on the board in the end", "N", out.extra["contact.lam"][-1, 0], -10.0, "as asked: 10 N", near=0.02
    )
    yield row("largest error along the board", "m", out.metrics.task_peak, 0.0, "as asked", near=1e-3)
    yield row("stroke in the end", "m", out.task.p[-1, 1] - out.task.p[0, 1], 0.1, "as asked", near=1e-3)
    q, v, m = state()
    law = HybridMotionForce(
        constraint=Constraint(lambda T: T.p[2] - BOARD_HEIGHT),
        motion=TaskComputedTorque(kp=100.0, kd=20.0, null=None), kfp=0.3, kfi=10.0,
    )  # fmt: skip
    motion = TaskMotion(pose=Pose(m.p + np.array([0.01, -0.02, 0.0]), R=m.R), twist=[0.1, 0.05, 0.0, 0.0, 0.0, 0.0])
    F_app = np.array([0.5, 0.2, -8.0, 0.0, 0.0, 0.0])
    ctrl = ticked(law, panda(), q, v, pressing(motion, 10.0), F_ext=-F_app)  # type: ignore[arg-type]
    got = total(ctrl.terms)
    X = np.concatenate([np.asarray(motion.p) - m.p, np.zeros(3)])
    F_motion = m.Lambda @ (100.0 * X + 20.0 * (motion.twist - m.J @ v))
    lam_e = -10.0 - F_app[2]
    F_force = np.array([0.0, 0.0, -10.0 + 0.3 * lam_e + 10.0 * lam_e * 1e-3, 0.0, 0.0, 0.0])
    P = np.eye(6) - A_ROW.T @ np.linalg.inv(A_ROW @ np.linalg.inv(m.Lambda) @ A_ROW.T) @ A_ROW @ np.linalg.inv(
        m.Lambda
    )
    gamma = -m.Lambda @ m.Jdot_v
    wanted = m.J.T @ (P @ F_motion + (np.eye(6) - P) @ F_force + gamma) + m.h
    yield from compared(got, wanted, "N m", BY_HAND, "torque of the Panda", 1e-6)

    yield "The stroke of equation 10.40; then a tick with kp = 100, kd = 20, Kfp = 0.3, Kfi = 10, and 8 N measured."
