"""TaskInertia: the inertia that the arm shows at its tool, and the motion that a task leaves free."""

from __future__ import annotations

from dataclasses import dataclass

from taut.base.linalg import LTDL, factor_spd
from taut.base.types import Matrix, Vector

__all__ = ["TaskInertia"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskInertia:
    """Lambda = (J M^-1 J^T)^-1 (k, k), and what goes with it."""

    J: Matrix  # (k, n)
    Minv_JT: Matrix  # (n, k)
    Lambda: Matrix  # (k, k)

    @classmethod
    def of(cls, J: Matrix, M_factors: LTDL) -> TaskInertia:
        """That of a Jacobian (k, n)."""
        W = M_factors.solve(J.T)
        return cls(J=J, Minv_JT=W, Lambda=factor_spd(J @ W).inverse())

    def acceleration(self, tau: Vector) -> Vector:
        """(k,) what torques accelerate in the task, J M^-1 tau."""
        out: Vector = self.Minv_JT.T @ tau
        return out

    def project(self, tau: Vector) -> Vector:
        """(n,) N^T tau, with N^T = I - J^T Lambda J M^-1: the part of torques that does not move the task."""
        out: Vector = tau - self.J.T @ (self.Lambda @ self.acceleration(tau))
        return out
