"""The error of a pose, desired minus actual, in the four ways of task space, in the axes of a law's gains.

All four vanish together, and differ where the error is large. The acceleration is in the same coordinates: of a law
that makes the rate of `V` follow, V-dot = J a + Jdot_v, the error obeys what its docstring says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from taut.base.errors import ShapeError
from taut.base.fields import Declared, Plain
from taut.base.types import Array, Matrix, Rotation, Twist, Vector, Wrench
from taut.control.closed_loop import ApparentImpedance
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import (
    adjoint,
    curve,
    moved,
    pose_log,
    pose_log_rate,
    rotated,
    rotated_matrix,
    rotation_log,
    turned_back,
)
from taut.trace import math as tm
from taut.trace.pose import Pose

ErrorKind = Literal["decoupled", "body", "space", "coordinates"]
ERRORS: Final[tuple[ErrorKind, ...]] = ("decoupled", "body", "space", "coordinates")
GainFrame = Literal["world", "task", "tool"]
FRAMES: Final[tuple[GainFrame, ...]] = ("world", "task", "tool")
NEVER: Final = 1e-24  # keeps a root from zero, where it has no slope
SOMEWHERE: Final = Pose([0.4, -0.3, 0.5], rpy=[0.3, -0.4, 0.5])


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskError:
    """An error of k entries; k is 6 but for coordinates. X and V are in the axes of the gains, the rest is not."""

    X: Vector  # (k,) the error, desired minus actual [m, rad]
    V: Vector  # (k,) desired minus actual velocity
    acceleration: Vector  # (k,) what the desired motion asks for, in the coordinates of the error
    J: Matrix  # (k, n) velocity in these coordinates per joint speed
    Jdot_v: Vector  # (k,)
    kind: ErrorKind = "decoupled"
    frame: GainFrame = "world"  # of the gains, for "decoupled"
    R: Rotation | None = None  # R_WC of the axes of the gains, None where they are the coordinates of the error

    def inwards(self, six: Array) -> Array:
        """What stands in the coordinates of the error, in the axes of the gains."""
        return inwards(self.R, six)

    def outwards(self, six: Array) -> Array:
        """The way back."""
        return outwards(self.R, six)

    def impedance(self, D: Matrix, B: Matrix, K: Matrix) -> ApparentImpedance:
        """The impedance in world axes of inertia, damping and stiffness in the axes of the gains."""
        D, B, K = (np.asarray(self.matrix_outwards(C), dtype=np.float64) for C in (D, B, K))
        return ApparentImpedance(D=D, B=B, K=K)

    def matrix_inwards(self, C: Matrix) -> Matrix:
        """(k, k) a symmetric matrix in the coordinates of the error, in the axes of the gains."""
        return C if self.R is None else rotated_matrix(self.R.T, C)

    def matrix_outwards(self, C: Matrix) -> Matrix:
        """(k, k) the way back."""
        return C if self.R is None else rotated_matrix(self.R, C)

    def wrench(self, force: Array) -> Wrench:
        """(k,) what pulls the tool where the potential X . force falls, in the axes of the gains."""
        if self.kind == "coordinates":
            return force
        if self.kind == "decoupled":
            return pulled(self.X, force, turning=self.frame == "tool")
        out: Wrench = pose_log_rate(self.X if self.kind == "body" else -self.X).T @ force
        return out


def inwards(R: Rotation | None, six: Array) -> Array:
    """(6,) what stands in world axes, in those of the gains."""
    return six if R is None else rotated(R.T, six)


def outwards(R: Rotation | None, six: Array) -> Array:
    """(6,) the way back."""
    return six if R is None else rotated(R, six)


def pulled(X: Vector, force: Vector, *, turning: bool) -> Wrench:
    """(6,) A^T force, the wrench of the potential X . force, X the decoupled error, axes of the gains, X-dot = -A V.

    It is the force itself along X; else the rest makes the spring conservative. `turning`: axes of the tool.
    """
    w = X[3:]
    moment = turned_back(w, curve(w), force[3:], -1.0 if turning else 1.0)
    if turning:
        moment = moment + tm.cross(X[:3], force[:3])
    return tm.array([*force[:3], *moment])


class Coordinates(Declared):
    """Minimal coordinates of a pose: y = function(T), k numbers, and which of them are angles.

    Args:
        function: Takes a Pose and gives (k,) numbers, written with taut.math; it is differentiated twice.
        angles: Entries that are angles [rad]: their errors are taken the short way round.

    Raises:
        UsageError, ShapeError: Not 1 to 6 numbers, or angles that are no entries of them.

    Example:
        >>> height = Coordinates(function=lambda T: T.p[2:])
        >>> len(height.function(Pose([0.0, 0.0, 0.5])))
        1
        >>> Coordinates.position_and_rpy().angles
        (3, 4, 5)
    """

    function: Plain[Callable[[Pose], Array]] = Plain(Callable)  # type: ignore[arg-type]  # an abstract class
    angles: tuple[int, ...] = ()

    def check(self) -> None:
        if not isinstance(self.angles, tuple) or not all(type(i) is int for i in self.angles):
            self.refuse("angles", f"must be a tuple of entries, such as (2,); got {self.angles!r}")
        try:
            shape = np.shape(self.function(SOMEWHERE))
        except ValueError:  # rows of different lengths
            shape = ()
        if len(shape) != 1 or not 1 <= shape[0] <= 6:
            self.refuse("function", f"must give 1 to 6 numbers, (k,); it gives shape {shape}", ShapeError)
        if not set(self.angles) <= set(range(shape[0])):
            self.refuse("angles", f"must be entries 0 to {shape[0] - 1}; got {self.angles}", ShapeError)

    @property
    def size(self) -> int:
        """k."""
        return len(self.function(SOMEWHERE))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Coordinates) and (self.function, self.angles) == (other.function, other.angles)

    def __hash__(self) -> int:
        return hash((self.function, self.angles))

    def __repr__(self) -> str:
        ready = self.function in (_position, _position_and_rpy)
        return f"Coordinates{self.function.__name__.replace('_', '.', 1)}()" if ready else super().__repr__()

    @classmethod
    def position(cls) -> Self:
        """x, y, z: the orientation is left free."""
        return cls(function=_position)

    @classmethod
    def position_and_rpy(cls) -> Self:
        """x, y, z, roll, pitch, yaw, as in Pose(rpy=). Singular at a pitch of a quarter turn."""
        return cls(function=_position_and_rpy, angles=(3, 4, 5))


def _position(T: Pose) -> Array:
    return T.p


def _position_and_rpy(T: Pose) -> Array:
    R = T.R
    upright = tm.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + NEVER)
    roll, pitch, yaw = tm.atan2(R[2, 1], R[2, 2]), tm.atan2(-R[2, 0], upright), tm.atan2(R[1, 0], R[0, 0])
    return tm.array([*T.p, roll, pitch, yaw])


def task_error(
    x: Snapshot,
    ref: TaskMotion,
    tool: str | None = None,
    *,
    kind: ErrorKind = "decoupled",
    coordinates: Coordinates | None = None,
    frame: GainFrame = "world",
) -> TaskError:
    """The error of the tool in the way that `kind` names, in the axes of a frame of the gains."""
    if kind == "body":
        return _body(x, ref, tool)
    if kind == "space":
        return _space(x, ref, tool)
    if coordinates is not None:
        return _in_coordinates(x, ref, tool, coordinates)
    T = x.T(tool)
    R = {"world": None, "task": ref.R, "tool": T.R}[frame]
    X, V = tm.array([*(ref.p - T.p), *rotation_log(ref.R @ T.R.T)]), ref.twist - x.twist(tool)
    return TaskError(
        X=inwards(R, X),
        V=inwards(R, V),
        acceleration=ref.acceleration,
        J=x.J(tool),
        Jdot_v=x.Jdot_v(tool),
        frame=frame,
        R=R,
    )


def _body(x: Snapshot, ref: TaskMotion, tool: str | None) -> TaskError:
    T_ED = x.T(tool).inverse() @ ref.pose
    V_D = rotated(ref.R.T, ref.twist)
    V_dot_D = rotated(ref.R.T, ref.acceleration) - _turning(V_D)
    Ad = adjoint(T_ED)
    V_des = Ad @ V_D
    V = V_des - x.twist(tool, axes="E")
    return TaskError(
        X=pose_log(T_ED),
        V=V,
        acceleration=Ad @ V_dot_D + _bracket(V, V_des),
        J=x.J(tool, axes="E"),
        Jdot_v=x.Jdot_v(tool, axes="E"),
        kind="body",
    )


def _turning(V: Twist) -> Twist:
    """What the turning of a body's axes adds to the rate of its twist: (w x v, 0)."""
    return tm.array([*tm.cross(V[3:], V[:3]), 0.0, 0.0, 0.0])


def _bracket(a: Twist, b: Twist) -> Twist:
    """(6,) ad_a b, linear part first."""
    return tm.array([*(tm.cross(a[3:], b[:3]) + tm.cross(a[:3], b[3:])), *tm.cross(a[3:], b[3:])])


def spatial(p: Array, V: Twist) -> Twist:
    """A twist, or an acceleration, at p as that of the point of the body that passes the origin."""
    return tm.array([*(V[:3] + tm.cross(p, V[3:])), *V[3:]])


def _spatial_rate(p: Array, V: Twist, rate: Twist) -> Twist:
    """The rate of `spatial` of a moving point."""
    return tm.array([*(rate[:3] + tm.cross(p, rate[3:]) + tm.cross(V[:3], V[3:])), *rate[3:]])


def _space(x: Snapshot, ref: TaskMotion, tool: str | None) -> TaskError:
    T, J, V = x.T(tool), x.J(tool), x.twist(tool)
    J_space = tm.zeros(np.shape(J))
    J_space[:3], J_space[3:] = J[:3] + tm.skew(T.p) @ J[3:], J[3:]
    return TaskError(
        X=pose_log(ref.pose @ T.inverse()),
        V=spatial(ref.p, ref.twist) - spatial(T.p, V),
        acceleration=_spatial_rate(ref.p, ref.twist, ref.acceleration),
        J=J_space,
        Jdot_v=_spatial_rate(T.p, V, x.Jdot_v(tool)),
        kind="space",
    )


def _in_coordinates(x: Snapshot, ref: TaskMotion, tool: str | None, coordinates: Coordinates) -> TaskError:
    T, V = x.T(tool), x.twist(tool)
    y, A = _with_rate(coordinates, T)
    y_des, A_des = _with_rate(coordinates, ref.pose)
    error = y_des - y
    entries = [_short_way(e) if i in coordinates.angles else e for i, e in enumerate(error)]
    return TaskError(
        X=tm.array(entries),
        V=A_des @ ref.twist - A @ V,
        acceleration=A_des @ ref.acceleration + _second(coordinates, ref.pose, ref.twist),
        J=A @ x.J(tool),
        Jdot_v=A @ x.Jdot_v(tool) + _second(coordinates, T, V),
        kind="coordinates",
    )


def _short_way(angle: Any) -> Any:
    return angle - 2.0 * np.pi * tm.floor(angle / (2.0 * np.pi) + 0.5)


def _with_rate(coordinates: Coordinates, T: Pose) -> tuple[Vector, Matrix]:
    """(k,) y and (k, 6) its rate per world-aligned twist."""
    A = tm.jacobian(lambda step: coordinates.function(moved(T, step)), np.zeros(6))
    return tm.array(list(coordinates.function(T))), A


def _second(coordinates: Coordinates, T: Pose, V: Twist) -> Vector:
    """(k,) A-dot V along V."""

    def rate(time: Array) -> Vector:
        def along(more: Array) -> Array:
            return tm.array(list(coordinates.function(moved(moved(T, time[0] * V), more[0] * V))))

        out: Vector = tm.jacobian(along, np.zeros(1))[:, 0]
        return out

    curved: Vector = tm.jacobian(rate, np.zeros(1))[:, 0]
    return curved
