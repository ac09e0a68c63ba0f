"""The nearest state of an arm that keeps to a constraint."""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import vector
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import snapshot

__all__ = ["onto"]

STEPS: Final = 30
CLOSE: Final = 1e-12  # [m, rad]


def onto(constraint: Constraint, arm: Arm, q: ArrayLike) -> Float64Array:
    """(n,) joint positions with phi = 0, near q: Newton's steps in the measure of the arm's kinetic energy.

    Args:
        constraint: The constraint.
        arm: The arm.
        q: (n,) where to begin [rad | m].

    Raises:
        RangeError: No state of the arm near there keeps to it.
        UsageError: No constraint, no arm.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("panda")
        >>> board = Constraint.plane(point=[0.0, 0.0, 0.4], normal=[0.0, 0.0, 1.0])
        >>> taut.snapshot(arm, onto(board, arm, arm.home)).T().p[2].round(9).item()
        0.4
    """
    if not isinstance(constraint, Constraint):  # callers without a type checker
        raise UsageError(f"onto takes a taut.Constraint; got {type(constraint).__name__}", name="constraint")
    if not isinstance(arm, Arm):
        raise UsageError(f"onto takes an arm from taut.load_arm; got {type(arm).__name__}", name="arm")
    at = vector("q", q, arm.n, joints=arm.joint_names)
    for _ in range(STEPS):
        x = snapshot(arm, at)
        rows = constraint.at(x)
        phi = np.asarray(rows.phi, dtype=np.float64)
        if np.abs(phi).max() < CLOSE:
            return at
        A = np.asarray(rows.A_q, dtype=np.float64)
        W = x.M_factors.solve(A.T)
        step = W @ np.linalg.lstsq(A @ W, phi, rcond=None)[0]
        at = at - step * min(1.0, 0.5 / max(1e-12, float(np.abs(step).max())))
    raise RangeError(
        f"no state of '{arm.name}' near q keeps to the constraint: after {STEPS} steps phi is "
        f"[{', '.join(f'{value:.3g}' for value in phi)}]; begin elsewhere, or put the constraint within reach",
        name="constraint",
    )
