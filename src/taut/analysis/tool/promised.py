"""What a law promises a force at the tool: the admittance of its closed loop in continuous time, at a pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.control.combine import Sum, bare
from taut.control.gains import GainValue
from taut.control.law import Law
from taut.control.laws.apparent import felt_impedance
from taut.control.laws.force import ForceControl
from taut.control.laws.friction import FrictionCompensation
from taut.control.laws.impedance import Stiffness
from taut.control.laws.joint import PID, ComputedTorque, FeedForward, GravityCompensation, GravityPID
from taut.control.laws.task import TaskComputedTorque
from taut.control.laws.task_space import Compliance
from taut.control.laws.via_joint_space import ViaJointSpace
from taut.control.trajectories.task_reference import TaskMotion
from taut.linear.frequency import Complex
from taut.maths.snapshot import Snapshot
from taut.trace.derivative import jacobian

__all__ = ["AskedAdmittance", "asked_admittance"]

INSIDE: Final = 1e-9  # of the largest entry

AskedAdmittance = Callable[[Complex], Complex]
"""(k, 6, 6) the tool's response X / F in world axes at s (k,) [1/s]."""


def asked_admittance(law: Law, x: Snapshot, reach: Float64Array) -> AskedAdmittance | None:
    """The admittance at the arm's tool that a law promises about a state, its reference at rest there.

    Law:          Y = J (M s^2 + kd s + kp + ki / s)^-1 J^T of GravityPID, with dg/dq beside kp of PID,
                  Y = J (M (s^2 + kd s + kp + ki / s))^-1 J^T of ComputedTorque,
                  Y = J (M s^2 + kd s + J^T K J)^-1 J^T of Stiffness,
                  Y = (s^2 + kd s + kp + ki / s)^-1 Lambda^-1 of TaskComputedTorque,
                  Y = (Lambda s^2 + kdamp s)^-1 (1 + kfp + kfi / s) of ForceControl,
                  Y = (D s^2 + B s + K)^-1 of Impedance and Admittance, in the directions that the tool can move in

    None where a law has none in closed form: laws for drives that do not give way, hybrid control, gains that are
    functions, sums with anything but friction compensation or feedforward, another tool than the arm's, an inertia D
    of its own for a tool that would have to leave the motions it can make.

    Args:
        law: The law, with its gains as they are.
        x: The state, of the arm as the law knows it, in plain numbers.
        reach: (6, r) an orthonormal basis of the motions that the tool can make.
    """
    while isinstance(law, ViaJointSpace):  # what it gives the law it holds rests, wherever the arm is
        if law.tool not in (None, x.arm.tool):
            return None
        law = law.inner
    if isinstance(law, Sum):
        parts = [part for part in law.parts.values() if not isinstance(part, (FrictionCompensation, FeedForward))]
        return asked_admittance(parts[0], x, reach) if len(parts) == 1 else None
    if getattr(law, "tool", None) not in (None, x.arm.tool):
        return None
    if isinstance(law, (PID, GravityPID, GravityCompensation, ComputedTorque)):
        return _of_joints(law, x)
    if isinstance(law, TaskComputedTorque):
        return _of_task(law, x, reach)
    if isinstance(law, ForceControl):
        return _of_force(law, x, reach)
    if isinstance(law, Stiffness):
        return _of_stiffness(law, x)
    felt, D = felt_impedance(law, x), vars(bare(law)).get("D")
    if felt is None or (D is not None and not all(_stays(C, reach) for C in (felt.D, felt.B, felt.K))):
        return None
    D, B, K = (reach.T @ matrix @ reach for matrix in (felt.D, felt.B, felt.K))
    return lambda s: np.asarray(reach @ _over(_polynomial(s, D, B, K), reach.T), dtype=np.complex128)


def _stays(gain: Float64Array, reach: Float64Array) -> bool:
    """Whether a gain answers each motion that the tool can make with one of those."""
    out = gain @ reach
    return bool(np.abs(out - reach @ (reach.T @ out)).max() <= INSIDE * np.abs(gain).max())


def _polynomial(
    s: Complex, D: Float64Array, B: Float64Array, K: Float64Array, I: Float64Array | None = None
) -> Complex:
    """(k, n, n) D s^2 + B s + K + I / s."""
    s = s[:, np.newaxis, np.newaxis]
    out: Complex = D * s * s + B * s + K
    return out if I is None or not I.any() else out + I / s


def _over(polynomial: Complex, right: Float64Array) -> Complex:
    """(k, n, m) polynomial^-1 right."""
    return np.asarray(np.linalg.solve(polynomial, right.astype(np.complex128)), dtype=np.complex128)


def _matrix(law: Law, name: str, n: int) -> Float64Array:
    """(n, n) a gain, zero where a law has none."""
    gain = getattr(law, name, None)
    if not isinstance(gain, GainValue):
        return np.zeros((n, n))
    return np.asarray(gain.matrix(n), dtype=np.float64)


def _of_joints(law: Law, x: Snapshot) -> AskedAdmittance:
    n, J, M = x.n, np.asarray(x.J(), dtype=np.float64), np.asarray(x.M, dtype=np.float64)
    kp, kd, ki = (_matrix(law, name, n) for name in ("kp", "kd", "ki"))
    if isinstance(law, ComputedTorque):
        kp, kd, ki = M @ kp, M @ kd, M @ ki
    if isinstance(law, PID):
        kp = kp + jacobian(lambda q: x.at(q, np.zeros(n)).g, x.q)
    return lambda s: np.asarray(J @ _over(_polynomial(s, M, kd, kp, ki), J.T), dtype=np.complex128)


def _of_stiffness(law: Stiffness, x: Snapshot) -> AskedAdmittance | None:
    """Its damping is of joints, so that no damping of the tool alone says the same."""
    if law.error != "decoupled" or callable(law.K):
        return None
    axes = Compliance.of(law.error, law.frame, x, TaskMotion.at_rest(x, law.tool), law.tool, None)
    J, M = np.asarray(x.J(), dtype=np.float64), np.asarray(x.M, dtype=np.float64)
    K = J.T @ np.asarray(axes.matrix_outwards(law.K.matrix(6)), dtype=np.float64) @ J
    kd = _matrix(law, "kd", x.n)
    return lambda s: np.asarray(J @ _over(_polynomial(s, M, kd, K), J.T), dtype=np.complex128)


def _mobility(x: Snapshot) -> Float64Array:
    """(6, 6) J M^-1 J^T: Lambda^-1, of less rank where the tool cannot move in all directions."""
    J = np.asarray(x.J(), dtype=np.float64)
    return np.asarray(J @ np.linalg.solve(np.asarray(x.M, dtype=np.float64), J.T))


def _of_task(law: TaskComputedTorque, x: Snapshot, reach: Float64Array) -> AskedAdmittance | None:
    """Only where the errors are the tool's deviation: of all six directions, or with one number for all of them."""
    if law.dimensions != 6:
        return None
    gains = [_matrix(law, name, 6) for name in ("kp", "kd", "ki")]
    alike = all(np.array_equal(gain, gain[0, 0] * np.eye(6)) for gain in gains)
    if not alike and (law.error != "decoupled" or reach.shape[1] < 6):
        return None
    (kp, kd, ki), mobility = gains, _mobility(x)
    return lambda s: _over(_polynomial(s, np.eye(6), kd, kp, ki), mobility)


def _of_force(law: ForceControl, x: Snapshot, reach: Float64Array) -> AskedAdmittance | None:
    if law.frame != "world" or law.feedback == "joint_torque":
        return None
    Lambda = np.asarray(np.linalg.inv(reach.T @ _mobility(x) @ reach), dtype=np.float64)
    damping = reach.T @ _matrix(law, "kdamp", 6) @ reach
    kfp, kfi = (_matrix(law, name, 6) if law.measures else np.zeros((6, 6)) for name in ("kfp", "kfi"))
    zero = np.zeros((6, 6))

    def admittance(s: Complex) -> Complex:
        moved = _over(_polynomial(s, Lambda, damping, np.zeros_like(Lambda)), reach.T)
        return np.asarray(reach @ moved @ _polynomial(s, zero, zero, np.eye(6) + kfp, kfi), dtype=np.complex128)

    return admittance
