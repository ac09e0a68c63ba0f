"""Task frame of a rigid contact: axes and an origin along each of which either the motion or the force is free."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import Final, Literal

import numpy as np

from taut.base.checks import read_only
from taut.base.types import Float64Array
from taut.trace.math import skew
from taut.trace.pose import Pose

__all__ = ["TaskBasis", "row_space"]

TOLERANCE: Final = 1e-9  # of rows of length 1: below it they are dependent, and entries are zero


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskBasis:
    """Rows of a constraint along the axes of a task frame, each solved for one axis.

    Args:
        frame: The task frame in the world; None where the axes are joints.
        to_task: (m, m) from V to the motion along the axes.
        solved: (r, m) A V = right along the axes, with a unit matrix in the columns `constrained`.
        right: (r,) velocities that the constraint prescribes.
        constrained: Axes whose motion is constrained and whose force is free.
    """

    frame: Pose | None
    to_task: Float64Array
    solved: Float64Array
    right: Float64Array
    constrained: tuple[int, ...]

    @classmethod
    def of(
        cls, A: Float64Array, phi_t: Float64Array, T: Pose | None, frame: Pose | Literal["world", "tool"] | None
    ) -> TaskBasis:
        """The basis of A V + phi_t = 0.

        Args:
            A: (k, m).
            phi_t: (k,).
            T: Pose of the constrained frame, with m = 6; None for a constraint of joints.
            frame: The task frame, or whose axes it has; one in which each row has a single axis if left out.
        """
        rows = row_space(A)
        right = rows @ np.linalg.lstsq(A, -phi_t, rcond=None)[0] if len(A) else np.zeros(0)
        if T is None:
            task, to_task = None, np.eye(A.shape[1])
        else:
            p = np.asarray(T.p, dtype=np.float64)
            if isinstance(frame, Pose):
                task = frame
            else:
                separating = _separating_frame(rows, T) if frame is None else None
                task = separating or Pose.of(np.asarray(T.R) if frame == "tool" else np.eye(3), p)
            to_task = _twist_at(task, p)
        solved, right, constrained = _reduced(rows @ np.linalg.inv(to_task), right)
        return cls(
            frame=task, to_task=read_only(to_task), solved=read_only(solved), right=read_only(right),
            constrained=tuple(constrained),
        )  # fmt: skip

    @property
    def free(self) -> tuple[int, ...]:
        """Axes whose motion is free."""
        return tuple(i for i in range(len(self.to_task)) if i not in self.constrained)

    @property
    def from_task(self) -> Float64Array:
        """(m, m) from the motion along the axes to V."""
        return np.asarray(np.linalg.inv(self.to_task))

    @property
    def N(self) -> Float64Array:
        """(m, m - r) along the axes: a basis of the free motions, whose coordinates are those of `free`."""
        N = np.zeros((len(self.to_task), len(self.free)))
        N[list(self.free)] = np.eye(len(self.free))
        N[list(self.constrained)] = -self.solved[:, list(self.free)]
        return N


def row_space(A: Float64Array) -> Float64Array:
    """(r, m) orthonormal rows that span those of A (k, m)."""
    if not len(A):
        return A
    _, values, rows = np.linalg.svd(A / np.linalg.norm(A, axis=1)[:, None], full_matrices=False)
    return np.asarray(rows[values > TOLERANCE * values[0]])


def _reduced(rows: Float64Array, right: Float64Array) -> tuple[Float64Array, Float64Array, list[int]]:
    """rows V = right solved for as many entries of V: (r, m) with a unit matrix in some columns, and those columns.

    The columns are those of the largest numbers, so that a constraint along an axis has that axis alone in its row.
    """
    A, c = rows.copy(), right.copy()
    pivots: list[int] = []
    for i in range(len(A)):
        away = np.abs(A[i:])
        row, column = divmod(int(np.argmax(np.round(away, 12))), away.shape[1])
        A[[i, i + row]], c[[i, i + row]] = A[[i + row, i]], c[[i + row, i]]
        c[i], A[i] = c[i] / A[i, column], A[i] / A[i, column]
        for other in range(len(A)):
            if other != i:
                c[other], A[other] = c[other] - A[other, column] * c[i], A[other] - A[other, column] * A[i]
        pivots.append(column)
    order = np.argsort(pivots)
    A = np.where(np.abs(A) < TOLERANCE, 0.0, A)
    return A[order], np.where(np.abs(c[order]) < TOLERANCE, 0.0, c[order]), sorted(pivots)


def _twist_at(frame: Pose, origin: Float64Array) -> Float64Array:
    """(6, 6) from a twist at a point, in world axes, to that of the same body at a frame's origin, in its axes."""
    rotation = np.kron(np.eye(2), np.asarray(frame.R, dtype=np.float64).T)
    shift = np.eye(6)
    shift[:3, 3:] = -skew(np.asarray(frame.p, dtype=np.float64) - origin)
    return np.asarray(rotation @ shift)


def _single_axes(rows: Float64Array) -> bool:
    """Orthonormal rows span coordinate axes alone."""
    projector = rows.T @ rows
    return bool(np.all(np.abs(projector - np.round(projector)) < TOLERANCE))


def _separating_frame(rows: Float64Array, T: Pose) -> Pose | None:
    """The frame nearest to the world's axes, then the tool's, in which each constraint row has a single axis.

    Args:
        rows: (r, 6) orthonormal, per twist of the tool in world axes.
        T: Its pose.

    Returns:
        The frame; None where there is none, as for a screw.
    """
    p = np.asarray(T.p, dtype=np.float64)
    away = _center(rows)
    if away is None:
        return None
    origin = p + away
    for R in (np.eye(3), np.asarray(T.R, dtype=np.float64)):
        frame = Pose.of(read_only(R), read_only(origin))
        if _single_axes(row_space(rows @ np.linalg.inv(_twist_at(frame, p)))):
            return frame
    axes = _axes(row_space(rows @ np.linalg.inv(_twist_at(Pose.of(np.eye(3), origin), p))))
    return None if axes is None else Pose.of(read_only(axes), read_only(origin))


def _forces_and_couples(rows: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(r1, 6) rows with independent forces, and (r2, 3) couples, that span the same."""
    left, values, _ = np.linalg.svd(rows[:, :3])
    rank = int(np.sum(values > TOLERANCE))
    return left[:, :rank].T @ rows, left[:, rank:].T @ rows[:, 3:]


def _center(rows: Float64Array) -> Float64Array | None:
    """(3,) from the tool to the nearest point at which forces and couples separate; None if there is none."""
    if not len(rows):
        return np.zeros(3)
    forces, couples = _forces_and_couples(rows)
    own = row_space(couples) if len(couples) else np.zeros((0, 3))
    rest = np.eye(3) - own.T @ own
    if not len(forces):
        return np.zeros(3)
    lever = np.vstack([rest @ skew(f[:3]) for f in forces])
    moments = np.concatenate([rest @ f[3:] for f in forces])
    d = np.linalg.lstsq(lever, -moments, rcond=1e-9)[0]
    exact = np.linalg.norm(lever @ d + moments) <= TOLERANCE * (1.0 + float(np.linalg.norm(moments)))
    return np.where(np.abs(d) < 1e-12, 0.0, d) if exact else None


def _axes(rows: Float64Array) -> Float64Array | None:
    """(3, 3) axes nearest to the world's along each of which there is a force, a couple, or neither."""
    forces, couples = _forces_and_couples(rows)
    lines = row_space(forces[:, :3])
    moments = row_space(couples) if len(couples) else couples
    kinds, vectors = np.linalg.eigh(lines.T @ lines + 2.0 * moments.T @ moments)
    kind = np.round(kinds)
    if np.any(np.abs(kinds - kind) > TOLERANCE):
        return None

    def fit(order: tuple[int, ...]) -> float:
        return float(sum(np.sum(vectors[i, kind == kind[k]] ** 2) for i, k in enumerate(order)))

    order = max(permutations(range(3)), key=lambda order: round(fit(order), 9))
    R = np.zeros((3, 3))
    for each in np.unique(kind):
        columns = [i for i, k in enumerate(order) if kind[k] == each]
        basis = vectors[:, kind == each]
        left, _, right = np.linalg.svd(basis.T[:, columns])
        R[:, columns] = basis @ left @ right
    if np.linalg.det(R) < 0.0:
        R[:, int(np.argmin(np.diag(R)))] *= -1.0
    return np.where(np.abs(R) < 1e-12, 0.0, R)
