"""What a motion asks along a constraint: a reference of the tool without what it asks against its rows."""

from __future__ import annotations

import numpy as np

from taut.base.types import Vector, Vector3, Wrench
from taut.control.laws.task_space import wrench_moved
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.rows import ConstraintRows
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_exp, rotation_log
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["along_constraint", "asked_pose", "felt_along", "of_one_body"]


def of_one_body(constraint: Constraint, x: Snapshot, tool: str | None) -> bool:
    """Whether a constraint is one of a frame that moves as one body with the tool."""
    return constraint.frame is not None and x.model.placement(*constraint.frame)[0] == x.model.placement(tool)[0]


def along_constraint(
    x: Snapshot, rows: ConstraintRows, frame: str | None, ref: TaskMotion, tool: str | None
) -> TaskMotion:
    """The same motion through where the tool is: what it asks for against the rows is taken out, and no more.

    Law:          A e' = 0, A (V_des' - V) = 0, A V_des-dot' + curvature = 0
                  (e', V_des', V_des-dot') the nearest to what was asked, a metre counting as much as a radian
    Closed loop:  V-dot = a, the acceleration that the law of motion asks for: A a is what the constraint asks
                    already, so that P changes nothing in it, whatever Lambda is
                  to first order where rotations are among the rows, and where gains are the same in all directions
                    that a row mixes

    P is orthogonal in the product of Lambda^-1 only. Of an acceleration a it leaves a - Lambda^-1 A^T S (A a + ...):
    what the reference asks against a surface, such as when it is on the stated one and the tool on the true one,
    would move the tool along it and turn it. Of a force, such as the spring of an Impedance, P takes A^T c out
    exactly; there it is a stiffness whose axes are not those of the surface that would.

    Frames:
        Errors are those of the frame that the constraint is of, in world axes.

    Args:
        x: The arm.
        rows: The constraint there, with A.
        frame: The frame that it is of.
        ref: Of the tool.
        tool: A frame of the same body.
    """
    A, T = rows.A, x.T(frame)
    assert A is not None
    d, asked = _lever(x, frame, tool), at_frame(x, frame, ref, tool)
    factors = rows.factors

    def against(six: Vector) -> Vector:
        out: Vector = A.T @ factors.solve(A @ six)
        return out

    off = against(tm.array([*(asked.p - T.p), *rotation_log(asked.R @ x.T(tool).R.T)]))
    made = TaskMotion.of(
        {
            "p": asked.p - off[:3],
            "R": rotation_exp(-off[3:]) @ asked.R,
            "twist": asked.twist - against(asked.twist - x.twist(frame)),
            "acceleration": asked.acceleration - A.T @ factors.solve(A @ asked.acceleration + rows.curvature),
        }
    )
    return made if d is None else _at_point(made, -d)


def at_frame(x: Snapshot, frame: str | None, ref: TaskMotion, tool: str | None) -> TaskMotion:
    """What a motion of the tool asks of the origin of another frame of the same body; R stays that of the tool."""
    d = _lever(x, frame, tool)
    return ref if d is None else _at_point(ref, d)


def asked_pose(x: Snapshot, frame: str | None, ref: TaskMotion, tool: str | None) -> Pose:
    """The pose that it asks of that frame."""
    turn = x.model.placement(tool)[1].T @ x.model.placement(frame)[1]
    R = ref.R if np.array_equal(turn, np.eye(3)) else ref.R @ turn
    return Pose.of(R, at_frame(x, frame, ref, tool).p)


def felt_along(x: Snapshot, rows: ConstraintRows, frame: str | None) -> Snapshot:
    """The same snapshot, whose F_ext is without what the constraint bears: friction along it, and a hand that pushes.

    A law that answers F_ext with an acceleration, such as an `Impedance` with an inertia D, would answer the force of
    the contact as well, and P would make of that a motion along the contact.

    Args:
        x: The arm, whose tool is on the link of the frame.
        rows: The constraint there, with A.
        frame: The frame that it is of.
    """
    A = rows.A
    assert A is not None
    factors = rows.factors

    def along(F: Wrench) -> Wrench:
        r = x.T().p - x.T(frame).p
        there = wrench_moved(F, r)
        return wrench_moved(there - A.T @ factors.solve(A @ there), -r)

    return x.feeling(along)


def _lever(x: Snapshot, frame: str | None, tool: str | None) -> Vector3 | None:
    """(3,) from the tool to the origin of the frame, in the tool's axes; None where they are one point."""
    _, R, p = x.model.placement(tool)
    d: Vector3 = R.T @ (x.model.placement(frame)[2] - p)
    return d if np.any(d) else None


def _at_point(ref: TaskMotion, d: Vector3) -> TaskMotion:
    """The motion of another point of the same body, d from its origin in its own axes."""
    r, omega, alpha = ref.R @ d, ref.twist[3:], ref.acceleration[3:]
    v = tm.cross(omega, r)
    return TaskMotion.of(
        {
            "p": ref.p + r,
            "R": ref.R,
            "twist": tm.array([*(ref.twist[:3] + v), *omega]),
            "acceleration": tm.array([*(ref.acceleration[:3] + tm.cross(alpha, r) + tm.cross(omega, v)), *alpha]),
        }
    )
