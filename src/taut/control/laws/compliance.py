"""What laws of impedance share: the axes of K, B and D, the spring as the gradient of its energy, designed damping.

Everything is in the axes C of the gains: those of the world, of the reference ("task") or of the tool; with another
error than "decoupled", in the coordinates of that error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from taut.base.errors import MatchError, RangeError, UsageError
from taut.base.types import Array, Matrix, Rotation, Vector, Vector3, Wrench
from taut.control.command import Terms
from taut.control.gains import GainValue
from taut.control.law import Law
from taut.control.laws.spring import Bound, pulled
from taut.control.laws.task_error import Coordinates, ErrorKind, TaskError, task_error
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import pose_log_rate, rotated, rotated_matrix
from taut.trace import math as tm
from taut.trace.linalg import LTDL, times_square_root

__all__ = [
    "FRAMES",
    "Compliance",
    "GainFrame",
    "check_damping",
    "check_frame",
    "check_inertia",
    "check_sensor",
    "modal_damping",
    "six_gains",
    "spring",
    "wrench_at",
    "wrench_moved",
]

GainFrame = Literal["world", "task", "tool"]
FRAMES: Final[tuple[GainFrame, ...]] = ("world", "task", "tool")


@dataclass(frozen=True, kw_only=True, eq=False)
class Compliance:
    """The error of a pose in the axes of the gains, and the way back of wrenches."""

    error: TaskError
    kind: ErrorKind
    frame: GainFrame
    R: Rotation | None  # R_WC, None for the world and for other errors
    X: Vector  # (k,) desired minus actual
    V: Vector  # (k,)

    @classmethod
    def of(
        cls,
        kind: ErrorKind,
        frame: GainFrame,
        x: Snapshot,
        ref: TaskMotion,
        tool: str | None,
        coordinates: Coordinates | None,
    ) -> Compliance:
        """That of a tool and its reference."""
        error = task_error(kind, x, ref, tool, coordinates)
        R = {"world": None, "task": ref.R, "tool": x.T(tool).R}[frame] if kind == "decoupled" else None
        X, V = (error.X, error.V) if R is None else (rotated(R.T, error.X), rotated(R.T, error.V))
        return cls(error=error, kind=kind, frame=frame, R=R, X=X, V=V)

    def inwards(self, six: Array) -> Array:
        """What the law computes in the coordinates of the error, in the axes of the gains."""
        return six if self.R is None else rotated(self.R.T, six)

    def outwards(self, six: Array) -> Array:
        """The way back."""
        return six if self.R is None else rotated(self.R, six)

    def matrix_outwards(self, C: Matrix) -> Matrix:
        """(k, k) a symmetric matrix of the gains' axes in the coordinates of the error."""
        return C if self.R is None else rotated_matrix(self.R, C)

    def matrix_inwards(self, C: Matrix) -> Matrix:
        """(k, k) the way back."""
        return C if self.R is None else rotated_matrix(self.R.T, C)

    def wrench(self, force: Array) -> Wrench:
        """(k,) what pulls the tool where the potential X . force falls, in the axes of the gains."""
        if self.kind == "coordinates":
            return force
        if self.kind in ("body", "space"):
            out: Wrench = pose_log_rate(self.X if self.kind == "body" else -self.X).T @ force
            return out
        return pulled(self.X, force, turning=self.frame == "tool")


def spring(felt: Compliance, K: GainValue, bound: Bound | None) -> Terms:
    """The force of the spring in the axes of the gains, and what its bound takes of it."""
    whole = Terms(P=K @ felt.X)
    return whole if bound is None else whole + Terms(bound=bound.force(K, felt.X) - K @ felt.X)


def modal_damping(inertia: LTDL, K: Matrix, zeta: Any, V: Vector) -> Vector:
    """(k,) B V with the damping ratio zeta in each mode of inertia and stiffness.

    With inertia = U U^T, B = 2 zeta U (U^-1 K U^-T)^(1/2) U^T:
    each generalised eigenvector of K and the inertia has 2 zeta omega_n, exactly.

    References:
        Albu-Schaffer, Ott and Hirzinger (2003), IEEE ICRA, double diagonalisation.
    """
    mapped = times_square_root(inertia.between_roots(K), inertia.times_root_transposed(V))
    out: Vector = 2.0 * zeta * inertia.times_root(mapped)
    return out


def wrench_at(x: Snapshot, tool: str | None) -> Wrench:
    """(6,) the measured wrench at the origin of a frame of the link that carries the sensor, world axes [N, N m]."""
    F = x.F_ext
    if tool is None or tool == x.arm.tool:
        return F
    return wrench_moved(F, x.T().p - x.T(tool).p)


def wrench_moved(F: Wrench, r: Vector3) -> Wrench:
    """(6,) the same wrench at another point, from which r leads to where it stands, in its axes."""
    return tm.array([*F[:3], *(F[3:] + tm.cross(r, F[:3]))])


def check_sensor(x: Snapshot, tool: str | None) -> None:
    """A wrist sensor tells what acts on the link of the arm's tool, and nothing of other links.

    Raises:
        MatchError: The frame that is controlled is on another one.
    """
    if x.model.placement(tool)[0] != x.model.placement(None)[0]:
        raise MatchError(
            f"the wrist sensor of '{x.arm.name}' is at its tool '{x.arm.tool}', and '{tool}' is on another link, of "
            "which it knows nothing; control a frame of the tool's link, or load the arm with that tool",
            name="tool",
        )


def six_gains(value: Any, size: int, name: str) -> GainValue:
    """What a function of the pose gives as a gain: a pair, one per direction, or a matrix.

    Raises:
        UsageError: It gives something else.
    """
    array = tm.array(value) if not isinstance(value, np.ndarray) else value
    if size == 6 and array.shape == (2,):
        array = tm.array([array[0]] * 3 + [array[1]] * 3)
    if array.shape not in ((size,), (size, size)):
        raise UsageError(
            f"{name} as a function of the pose must give (linear, angular), ({size},) or ({size}, {size}); got shape "
            f"{array.shape}",
            name=name,
        )
    return GainValue(array, name)


def check_frame(frame: str, kind: str) -> None:
    """Axes are chosen for the decoupled error; the others bring their own.

    Raises:
        UsageError: Both.
    """
    if frame != "world" and kind != "decoupled":
        raise UsageError(
            f"frame='{frame}' is for error='decoupled'; error='{kind}' has coordinates of its own; leave frame out",
            name="frame",
        )


def check_damping(law: Law) -> None:
    """A law with the fields K, B and zeta has one of the latter two, and zeta has a swing to damp.

    Raises:
        UsageError: Both, or none.
        RangeError: zeta with a K that leaves a direction without stiffness.
    """
    who, B, zeta = type(law).__name__, vars(law)["B"] is not None, law.gives("zeta")
    if B and zeta:
        raise UsageError(
            f"{who} takes B or zeta, not both: zeta designs B from K and the inertia; leave one of them out",
            name="zeta",
        )
    if not B and not zeta:
        raise UsageError(
            f"{who} needs its damping: B=(linear, angular) [N s/m, N m s/rad], or zeta=0.7 for the damping ratio of "
            "every mode",
            name="B",
        )
    if zeta and law.gives("K") and _least(vars(law)["K"]) <= 0.0:
        raise RangeError(
            "zeta damps the swing on K, and K has a direction without stiffness, which would have no damping; give B "
            "instead",
            name="zeta",
        )


def check_inertia(D: GainValue, way_out: str = "") -> None:
    """An inertia is inverted, so that none of its directions may be zero.

    Raises:
        RangeError: One is.
    """
    least = _least(D)
    if least <= 0.0:
        raise RangeError(
            f"D must be > 0 [kg, kg m^2] in every direction, for wrenches are divided by it; its least is {least:g}"
            f"{way_out}",
            name="D",
            value=least,
            rule="> 0",
        )


def _least(gain: GainValue) -> float:
    values = np.asarray(gain.as_array(), dtype=np.float64)
    return float(np.linalg.eigvalsh(values)[0]) if values.ndim == 2 else float(values.min())
