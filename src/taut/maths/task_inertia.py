"""Inertia: at the tool, with the motion that a task leaves free, and the fraction of the rotors in that of joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of
from taut.base.types import ArrayLike, Float64Array, Matrix, Vector
from taut.maths.snapshot import snapshot
from taut.trace import math as tm
from taut.trace.linalg import LTDL, factor_spd

TINY = 1e-12  # [1/kg and its like] keeps the pivots of what is to be inverted from zero


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskInertia:
    """Lambda = (J M^-1 J^T)^-1 (k, k): Khatib (1987), IEEE Journal of Robotics and Automation 3 (1)."""

    J: Matrix  # (k, n)
    M_factors: LTDL
    half: Matrix  # (n, k) half of the way to M^-1 J^T
    Lambda: Matrix  # (k, k)

    @classmethod
    def of(cls, J: Matrix, M_factors: LTDL, damping: Any = 0.0) -> TaskInertia:
        """(J M^-1 J^T + damping I)^-1, unbounded near singularities without damping [1/kg, 1/(kg m^2)]."""
        half = M_factors.half(J.T)
        A = half.T @ M_factors.weighed(half)
        if not (isinstance(damping, float) and damping == 0.0):
            A = A + damping * tm.eye(len(A))
        return cls(J=J, M_factors=M_factors, half=half, Lambda=factor_spd(A).inverse())

    @classmethod
    def bounded(cls, J: Matrix, M_factors: LTDL, most: Any) -> TaskInertia:
        """That of a Jacobian (k, n), with at most about `most` [kg, kg m^2] along the direction u nearly lost.

        Lambda becomes (J M^-1 J^T + s u u^T)^-1 with an s that is zero where u . Lambda u < most / 2 and rises
        smoothly. It serves arms that lack a direction for good, too.
        """
        half = M_factors.half(J.T)
        rows = [i for i in range(len(J)) if not _is_zero(J[i])]  # a planar arm never moves along the others
        part = J[rows]
        A = half[:, rows].T @ M_factors.weighed(half[:, rows]) + TINY * tm.eye(len(rows))
        u, _ = least_direction(part)
        shown, knee = u @ factor_spd(A).solve(u), 0.5 * most
        over = tm.maximum(shown - knee, 0.0)
        wanted = knee + knee * over / (knee + over)  # tends to `most`, with the slope 1 at half of it
        s = 1.0 / wanted - 1.0 / tm.maximum(shown, knee)
        inverse = factor_spd(A + s * np.outer(u, u)).inverse()
        Lambda = most * tm.eye(len(J))
        for i, row in enumerate(rows):
            for j, column in enumerate(rows):
                Lambda[row, column] = inverse[i, j]
        return cls(J=J, M_factors=M_factors, half=half, Lambda=Lambda)

    @property
    def mobility(self) -> Matrix:
        """(k, k) J M^-1 J^T, without damping or bound."""
        return self.half.T @ self.M_factors.weighed(self.half)

    def joint_acceleration(self, F: Vector) -> Vector:
        """(n,) what a wrench of the task accelerates in the joints, M^-1 J^T F."""
        return self.M_factors.other_half(self.half @ F)

    def acceleration(self, tau: Vector) -> Vector:
        """(k,) what torques accelerate in the task, J M^-1 tau."""
        return self.half.T @ self.M_factors.weighed(self.M_factors.half(tau))

    def wrench(self, tau: Vector) -> Vector:
        """(k,) the wrench of torques, J_bar^T tau with the dynamically consistent inverse J_bar = M^-1 J^T Lambda."""
        out: Vector = self.Lambda @ self.acceleration(tau)
        return out

    def project(self, tau: Vector) -> Vector:
        """(n,) N^T tau, with N^T = I - J^T Lambda J M^-1: the part of torques that does not move the task."""
        out: Vector = tau - self.J.T @ self.wrench(tau)
        return out


def _is_zero(row: Vector) -> bool:
    """Whether numbers are zero in every pose: as constants of a trace, or exactly."""
    return all(isinstance(entry, float) and entry == 0.0 for entry in row.tolist())


def least_direction(J: Matrix) -> tuple[Vector, Any]:
    """(k,) the unit direction u in which J (k, n) moves least, and |J^T u|^2; exact where it is nearly lost."""
    u, square = factor_spd(J @ J.T + TINY * tm.eye(len(J))).least_direction()
    return u, square - TINY


def rotor_share(arm: Arm, q: ArrayLike | None = None) -> Float64Array:
    """(n,) the fraction of each joint's inertia that is its geared rotor, from 0 to 1; the rest is links and payload.

    Law:  G^2 I_motor / M_ii(q), with the mass matrix M, rotors included. One half is inertia matched. The nearer to
        1, the less load and other joints act on a joint: its dynamics are those of its own motor.

    Args:
        arm: The arm, its rotors from `with_gears`, a file, or `with_joints(rotor_inertia=...)`.
        q: (n,) positions [rad | m]; the home pose if left out.

    Raises:
        UsageError: Not an arm.
        ShapeError: Wrong number of entries.
        RangeError: NaN or infinite entries.

    Example:
        A link of 0.5 kg m^2 with a rotor of 1e-3 kg m^2 behind a gear of 100: 10 of 10.5 kg m^2 are the rotor.

        >>> import taut
        >>> rotor_share(taut.load_arm("one_joint").with_gears(100.0, 1e-3)).round(4).tolist()
        [0.9524]

    References:
        Chapter, section 10.2.1.5 the effect of gearing; 10.2.2.1 on decentralised control.
    """
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    M = snapshot(arm, arm.home if q is None else q).M
    share: Float64Array = arm.rotor_inertia / np.diag(M)
    return share
