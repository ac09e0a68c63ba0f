"""An arm under constraints: multipliers and the projection of forces, eqs. 10.40 to 10.44, and states on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of, vector
from taut.base.errors import RangeError
from taut.base.types import ArrayLike, Float64Array, Matrix, Vector
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.rows import MIN_INDEPENDENT_PART, ConstraintRows
from taut.maths.snapshot import Snapshot, snapshot
from taut.trace import math as tm
from taut.trace.linalg import LTDL, factor_spd

MULTIPLIER_STEPS: Final = 30
ON_CONSTRAINT: Final = 1e-12  # [m, rad] of phi
CHAIN: Final = 1e-4  # [1/kg, 1/(kg m^2)] of mobility: less of it is a direction that a chain does not have


@dataclass(frozen=True, kw_only=True, eq=False)
class Constrained:
    """M a + h + A_q^T lam = tau with A_q a + bias = 0, at one state.

    In torques P is I - A_q^T (A_q M^-1 A_q^T)^-1 A_q M^-1, and J^T P of eq. 10.44 is that times J^T: it needs no
    inverse of Lambda, and serves constraints of joints and of several frames alike.
    """

    rows: ConstraintRows
    Minv_AT: Matrix  # (n, k)
    mobility: LTDL  # factors of A_q M^-1 A_q^T, which is A Lambda^-1 A^T, without rows that depend on later ones

    @classmethod
    def of(cls, rows: ConstraintRows, M_factors: LTDL) -> Constrained:
        """Constrained dynamics of rows at a state whose mass matrix has these factors."""
        W = M_factors.solve(rows.A_q.T)
        return cls(rows=rows, Minv_AT=W, mobility=factor_spd(rows.A_q @ W, MIN_INDEPENDENT_PART))

    def against(self, tau: Vector) -> Vector:
        """(n,) the part of torques that pushes against the constraints, (I - P) tau."""
        out: Vector = self.rows.A_q.T @ self.mobility.solve(self.Minv_AT.T @ tau)
        return out

    def along(self, tau: Vector) -> Vector:
        """(n,) the part that moves the arm along them, P tau."""
        out: Vector = tau - self.against(tau)
        return out

    def pressing(self, lam: Vector) -> Vector:
        """(n,) the torques of multipliers, A_q^T lam = J^T F_app."""
        out: Vector = self.rows.A_q.T @ lam
        return out

    def of_bias(self, bias: Vector) -> Vector:
        """(k,) the multipliers that a second rate of phi makes, (A Lambda^-1 A^T)^-1 bias."""
        out: Vector = self.mobility.solve(bias)
        return out

    def brought_along(self, x: Snapshot, tool: str | None, tau: Vector) -> Vector:
        """(n,) torques with which a tool that is part of a closed chain moves as it would without the other part.

        They make up for the acceleration that the chain takes; by least squares where the tool cannot move so.
        """
        J = x.J(tool)
        lost = J @ (self.Minv_AT @ self.lam(tau - x.h))
        JW, Minv_JT = J @ self.Minv_AT, x.M_factors.solve(J.T)
        mobility = J @ Minv_JT - JW @ self.mobility.solve(JW.T)
        damped = mobility @ mobility + CHAIN**2 * tm.eye(len(mobility))
        out: Vector = J.T @ factor_spd(damped).solve(mobility @ lost)
        return out

    def lam(self, tau: Vector) -> Vector:
        """(k,) the multipliers under torques less h, eq. 10.42."""
        return self.of_bias(self.Minv_AT.T @ tau + self.rows.bias)


def force_projector(A: Matrix, mobility: Matrix) -> Matrix:
    """(6, 6) P of eq. 10.44, from A (k, 6) and Lambda^-1 = J M^-1 J^T (6, 6): P F moves the tool, (I - P) F presses.

    P^2 = P, P A^T = 0, and P Lambda is symmetric: orthogonal in the product of Lambda^-1 only, so P is not symmetric.
    """
    W = mobility @ A.T
    pressed = factor_spd(A @ W).solve(W.T)
    pressed = pressed + (tm.eye(len(A)) - pressed @ A.T) @ pressed  # a Newton step: of A^T nothing is left
    out: Matrix = tm.eye(len(mobility)) - A.T @ pressed
    return out


def onto(constraint: Constraint, arm: Arm, q: ArrayLike) -> Float64Array:
    """(n,) joint positions with phi = 0, near q: Newton's steps in the measure of the arm's kinetic energy.

    Args:
        constraint: The constraint.
        arm: The arm.
        q: (n,) where to begin [rad | m].

    Raises:
        RangeError: No such state of the arm near there.
        UsageError: No constraint, no arm.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("panda")
        >>> board = Constraint.plane(point=[0.0, 0.0, 0.4], normal=[0.0, 0.0, 1.0])
        >>> taut.snapshot(arm, onto(board, arm, arm.home)).T().p[2].round(9).item()
        0.4
    """
    instance_of("constraint", constraint, Constraint, "a taut.Constraint")
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    at = vector("q", q, arm.n, joints=arm.joint_names)
    for _ in range(MULTIPLIER_STEPS):
        x = snapshot(arm, at)
        rows = constraint.at(x)
        phi = np.asarray(rows.phi, dtype=np.float64)
        if np.abs(phi).max() < ON_CONSTRAINT:
            return at
        A = np.asarray(rows.A_q, dtype=np.float64)
        W = x.M_factors.solve(A.T)
        step = W @ np.linalg.lstsq(A @ W, phi, rcond=None)[0]
        at = at - step * min(1.0, 0.5 / max(1e-12, float(np.abs(step).max())))
    raise RangeError(
        f"no state of '{arm.name}' near q keeps to the constraint: after {MULTIPLIER_STEPS} steps phi is "
        f"[{', '.join(f'{value:.3g}' for value in phi)}]; begin elsewhere, or put the constraint within reach",
        name="constraint",
    )
