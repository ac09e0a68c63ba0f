"""The error of a pose, desired minus actual, in the four ways of task space; and what a law needs beside it.

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
from taut.base.types import Array, Matrix, Twist, Vector
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import adjoint, moved, pose_log, rotated, rotation_log
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["ERRORS", "Coordinates", "ErrorKind", "TaskError", "check_coordinates", "dimensions", "task_error"]

ErrorKind = Literal["decoupled", "body", "space", "coordinates"]
ERRORS: Final[tuple[ErrorKind, ...]] = ("decoupled", "body", "space", "coordinates")


@dataclass(frozen=True, kw_only=True, eq=False)
class TaskError:
    """An error of k entries; k is 6 but for coordinates."""

    X: Vector  # (k,) the error [m, rad]
    V: Vector  # (k,) desired minus actual velocity, in the coordinates of the error
    acceleration: Vector  # (k,) what the desired motion asks for
    J: Matrix  # (k, n) velocity in these coordinates per joint speed
    Jdot_v: Vector  # (k,)


class Coordinates(Declared):
    """Minimal coordinates of a pose: y = function(T), k numbers, and which of them are angles.

    Args:
        function: Takes a Pose and gives (k,) numbers, written with taut.math; it is differentiated twice.
        angles: Entries that are angles [rad]: their errors are taken the short way round.

    Raises:
        UsageError: No function, or angles that are no tuple of entries.

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

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Coordinates) and (self.function, self.angles) == (other.function, other.angles)

    def __hash__(self) -> int:
        return hash((self.function, self.angles))

    @classmethod
    def position(cls) -> Self:
        """x, y, z: the orientation is left free."""
        return cls(function=_position)

    @classmethod
    def planar(cls) -> Self:
        """x, y and yaw, for arms that move in a plane. Singular where the tool's x axis is upright."""
        return cls(function=_planar, angles=(2,))

    @classmethod
    def position_and_rpy(cls) -> Self:
        """x, y, z, roll, pitch, yaw, as in Pose(rpy=). Singular at a pitch of a quarter turn."""
        return cls(function=_position_and_rpy, angles=(3, 4, 5))

    @classmethod
    def cylindrical(cls) -> Self:
        """Distance from the world's z axis, angle about it, height. Singular on the axis."""
        return cls(function=_cylindrical, angles=(1,))


NEVER: Final = 1e-24  # keeps a root from zero, where it has no slope


def _position(T: Pose) -> Array:
    return T.p


def _planar(T: Pose) -> Array:
    return tm.array([T.p[0], T.p[1], tm.atan2(T.R[1, 0], T.R[0, 0])])


def _position_and_rpy(T: Pose) -> Array:
    R = T.R
    upright = tm.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + NEVER)
    roll, pitch, yaw = tm.atan2(R[2, 1], R[2, 2]), tm.atan2(-R[2, 0], upright), tm.atan2(R[1, 0], R[0, 0])
    return tm.array([*T.p, roll, pitch, yaw])


def _cylindrical(T: Pose) -> Array:
    x, y, z = T.p
    return tm.array([tm.sqrt(x * x + y * y + NEVER), tm.atan2(y, x), z])


def task_error(
    kind: ErrorKind, x: Snapshot, ref: TaskMotion, tool: str | None, coordinates: Coordinates | None
) -> TaskError:
    """The error of the tool in the way that `kind` names."""
    if kind == "body":
        return _body(x, ref, tool)
    if kind == "space":
        return _space(x, ref, tool)
    if kind == "coordinates":
        assert coordinates is not None
        return _in_coordinates(x, ref, tool, coordinates)
    T = x.T(tool)
    return TaskError(
        X=tm.array([*(ref.p - T.p), *rotation_log(ref.R @ T.R.T)]),
        V=ref.twist - x.twist(tool),
        acceleration=ref.acceleration,
        J=x.J(tool),
        Jdot_v=x.Jdot_v(tool),
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
    )


def _turning(V: Twist) -> Twist:
    """What the turning of a body's axes adds to the rate of its twist: (w x v, 0)."""
    return tm.array([*tm.cross(V[3:], V[:3]), 0.0, 0.0, 0.0])


def _bracket(a: Twist, b: Twist) -> Twist:
    """(6,) ad_a b, linear part first."""
    return tm.array([*(tm.cross(a[3:], b[:3]) + tm.cross(a[:3], b[3:])), *tm.cross(a[3:], b[3:])])


def _spatial(p: Array, V: Twist) -> Twist:
    """A twist at p as one of the point of the body that passes the origin."""
    return tm.array([*(V[:3] + tm.cross(p, V[3:])), *V[3:]])


def _spatial_rate(p: Array, V: Twist, rate: Twist) -> Twist:
    """The rate of `_spatial` of a moving point."""
    return tm.array([*(rate[:3] + tm.cross(p, rate[3:]) + tm.cross(V[:3], V[3:])), *rate[3:]])


def _space(x: Snapshot, ref: TaskMotion, tool: str | None) -> TaskError:
    T, J, V = x.T(tool), x.J(tool), x.twist(tool)
    J_space = tm.zeros(np.shape(J))
    J_space[:3], J_space[3:] = J[:3] + tm.skew(T.p) @ J[3:], J[3:]
    return TaskError(
        X=pose_log(ref.pose @ T.inverse()),
        V=_spatial(ref.p, ref.twist) - _spatial(T.p, V),
        acceleration=_spatial_rate(ref.p, ref.twist, ref.acceleration),
        J=J_space,
        Jdot_v=_spatial_rate(T.p, V, x.Jdot_v(tool)),
    )


# -------------------------------------------------------------------- minimal coordinates


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


def dimensions(kind: ErrorKind, coordinates: Coordinates | None) -> int:
    """Entries of the error."""
    if kind != "coordinates" or coordinates is None:
        return 6
    try:
        return len(coordinates.function(SOMEWHERE))
    except (TypeError, ValueError):  # no vector, which `check_coordinates` refuses
        return 6


SOMEWHERE: Final = Pose([0.4, -0.3, 0.5], rpy=[0.3, -0.4, 0.5])


def check_coordinates(law: Declared, kind: ErrorKind, coordinates: Coordinates | None) -> None:
    """Coordinates go with the error of that name, and give 1 to 6 numbers. Raises TautError."""
    if (kind == "coordinates") != (coordinates is not None):
        law.refuse("coordinates", "is for error 'coordinates', which needs it; give both or neither")
    if coordinates is None:
        return
    try:
        shape = np.shape(coordinates.function(SOMEWHERE))
    except ValueError:  # rows of different lengths
        law.refuse(
            "coordinates", "must be 1 to 6 numbers, (k,); the function gives rows of different lengths", ShapeError
        )
    if len(shape) != 1 or not 1 <= shape[0] <= 6:
        law.refuse("coordinates", f"must be 1 to 6 numbers, (k,); it gives shape {shape}", ShapeError)
    wrong = [i for i in coordinates.angles if not 0 <= i < shape[0]]
    if wrong:
        law.refuse("coordinates", f"has angles that are no entries 0 to {shape[0] - 1}; got {wrong[0]}", ShapeError)
