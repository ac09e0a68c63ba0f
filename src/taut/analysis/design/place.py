"""Where a design is made: the arm at a pose, checked, its inertia at the joints and at the tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.angles import require_radians
from taut.arm.description import Arm
from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.laws.task_error import ErrorKind
from taut.control.laws.task_space import Compliance, GainFrame
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot, snapshot

__all__ = ["AtTool", "at_tool", "poses_of"]

LOST: Final = 1e-9  # of the largest singular value: a direction that the arm never moves in
NEARLY: Final = 1e-2  # of the largest: a direction that is lost, or nearly so, at a pose
ROUNDING: Final = 1e-12  # of the largest entry
GENERIC: Final = 1.7  # [rad] between joints of a pose that is nowhere special
NAMES: Final = ("x", "y", "z", "about x", "about y", "about z")


def poses_of(arm: Arm, at: ArrayLike | None) -> Float64Array:
    """(k, n) the poses to design for: one, or one in each row; home if left out.

    Raises:
        UsageError: Not an arm.
        ShapeError: Not (n,) or (k, n).
        RangeError: Not finite, in degrees, or outside of the limits; the message names the joint.
    """
    if not isinstance(arm, Arm):  # callers without a type checker
        raise UsageError(f"design takes an Arm from taut.load_arm; got {type(arm).__name__}", name="arm")
    given = arm.home if at is None else finite_array("at", at, unit="rad | m")
    if given.shape[-1:] != (arm.n,) or given.ndim > 2 or not given.size:
        raise ShapeError(
            f"at must be one pose ({arm.n},) or several (k, {arm.n}), for '{arm.name}' has {arm.n} joints; got shape "
            f"{given.shape}",
            name="at",
        )
    rows = np.atleast_2d(given)
    for k, q in enumerate(rows):
        name = "at" if given.ndim == 1 else f"at[{k}]"
        require_radians(name, q, arm)
        outside = np.flatnonzero((q < arm.lower) | (q > arm.upper))
        if outside.size:
            i = int(outside[0])
            joint = arm.joint_names[i]
            raise RangeError(
                f"{name} must be within the limits of the joints; got {q[i]:g} for '{joint}', which goes from "
                f"{arm.lower[i]:g} to {arm.upper[i]:g} {arm.units[i]}",
                name="at",
                joint=joint,
                value=float(q[i]),
                rule="within the limits",
            )
    return np.array(rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class AtTool:
    """The tool of an arm at rest at a pose, in the coordinates of a law's error and the axes of its gains.

    Args:
        J: (k, n) how the coordinates move with the joints.
        U: (k, r) an orthonormal basis of the motions that the arm can make there.
        Lambda: (r, r) the inertia in them.
        back: (n, r) joint motions that make them, without motion of what the task leaves free.
        names: (k,) of the coordinates.
    """

    J: Float64Array
    U: Float64Array
    Lambda: Float64Array
    back: Float64Array
    names: tuple[str, ...]

    @property
    def rows(self) -> Float64Array:
        """(r, n) the motions of the tool per joint motion."""
        return np.asarray(self.U.T @ self.J)

    def inside(self, C: ArrayLike) -> Float64Array:
        """(r, r) a symmetric matrix of the axes of the gains, in the motions that the arm can make."""
        X = self.U.T @ np.asarray(C, dtype=np.float64) @ self.U
        return np.asarray(0.5 * (X + X.T))

    def outside(self, C: Float64Array) -> Float64Array:
        """(k, k) the way back; in directions that the arm never moves in, the mean of the others."""
        k, r = self.U.shape
        rest = np.eye(k) - self.U @ self.U.T
        X = self.U @ C @ self.U.T + (float(np.trace(C)) / r) * rest
        X = np.where(np.abs(X) < ROUNDING * np.abs(X).max(), 0.0, X)
        return np.asarray(0.5 * (X + X.T))

    def name(self, way: Float64Array) -> str:
        """The coordinate that a motion (r,) moves most."""
        return self.names[int(np.argmax(np.abs(self.U @ way)))]


def at_tool(law: Any, x: Snapshot) -> AtTool:
    """That of a law with the fields tool, error, frame and coordinates, at the state of a snapshot.

    Raises:
        RangeError: The arm is singular there, or nearly so.
    """
    J = _jacobian(law, x)
    sizes = np.linalg.svd(J, compute_uv=False)
    rank = _generic_rank(law, x)
    left, values, _ = np.linalg.svd(J)
    names = NAMES if len(J) == len(NAMES) else tuple(f"y{i}" for i in range(len(J)))
    if values[rank - 1] < NEARLY * sizes[0]:
        way = left[:, rank - 1]
        raise RangeError(
            f"'{x.arm.name}' is singular at q = {np.round(x.q, 4).tolist()}, or nearly so: its tool can hardly move "
            f"along {names[int(np.argmax(np.abs(way)))]}, with {values[rank - 1] / sizes[0]:.2g} of the largest "
            "singular value; choose another pose",
            name="at",
            value=float(values[rank - 1] / sizes[0]),
            rule=f">= {NEARLY:g} of the largest singular value",
        )
    U = np.eye(len(J)) if rank == len(J) else left[:, :rank]
    rows = U.T @ J
    Minv_JT = np.linalg.solve(np.asarray(x.M), rows.T)
    Lambda = np.linalg.inv(rows @ Minv_JT)
    return AtTool(J=J, U=U, Lambda=0.5 * (Lambda + Lambda.T), back=Minv_JT @ Lambda, names=names)


def _jacobian(law: Any, x: Snapshot) -> Float64Array:
    """(k, n) in the axes of the gains."""
    ref = TaskMotion.at_rest(x, law.tool)
    kind: ErrorKind = getattr(law, "error", "decoupled")
    frame: GainFrame = getattr(law, "frame", "world")
    felt = Compliance.of(kind, frame, x, ref, law.tool, getattr(law, "coordinates", None))
    return np.asarray(felt.inwards(felt.error.J), dtype=np.float64)


def _generic_rank(law: Any, x: Snapshot) -> int:
    """How many directions the arm moves its tool in at a pose that is nowhere special."""
    q = np.cos(GENERIC * np.arange(x.n) + 0.3)
    sizes = np.linalg.svd(_jacobian(law, snapshot(x.arm, q)), compute_uv=False)
    return int((sizes > LOST * sizes[0]).sum())
