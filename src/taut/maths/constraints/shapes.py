"""The functions phi of ready-made constraints: plane, point, sphere, cylinder, line, hinge, grasp, pin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from taut.base.checks import finite_array, positive_scalar, read_only
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.maths.spatial import rotation_log
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = [
    "Surface",
    "cylinder",
    "grasp",
    "hinge",
    "line",
    "pin",
    "plane",
    "plane_surface",
    "point",
    "sphere",
    "unit",
]

NEVER: Final = 1e-24  # keeps a root from zero, where it has no slope


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The surface on which the first row of a ready-made constraint is zero, for films."""

    kind: Literal["plane", "sphere", "cylinder"]
    point: Float64Array  # (3,) [m] of the plane, at time 0; the centre; a point of the axis
    axis: Float64Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))  # (3,) normal or axis
    radius: float = 0.0  # [m]
    inside: bool = False  # whether the tool is in its hollow
    displacement: Callable[[float], float] | None = None  # [m] of the plane along its normal, by time


def plane_surface(
    point: ArrayLike, normal: ArrayLike, velocity: ArrayLike, sway: ArrayLike, period: float
) -> Surface:
    """That of `plane`."""
    n = unit("normal", normal)
    speed, half = float(n @ np.asarray(velocity, dtype=float)), 0.5 * float(n @ np.asarray(sway, dtype=float))

    def displacement(t: float) -> float:
        return speed * t + half * (1.0 - float(np.cos(2.0 * np.pi * t / period)))

    moves = displacement if speed or half else None
    return Surface(kind="plane", point=_three("point", point), axis=n, displacement=moves)


def plane(
    point: ArrayLike,
    normal: ArrayLike,
    face: ArrayLike | None,
    velocity: ArrayLike,
    sway: ArrayLike,
    period: float,
) -> Callable[..., Array]:
    """The distance from a plane, and with a face its two tilts: of a pose, and of time where it moves."""
    p, n = _three("point", point, "m"), unit("normal", normal)
    speed = float(n @ _three("velocity", velocity, "m/s"))
    half = 0.5 * float(n @ _three("sway", sway, "m"))
    omega = 2.0 * np.pi / positive_scalar("period", period, unit="s")
    flat = None if face is None else unit("face", face)
    e1, e2 = _across(n)

    def phi(T: Pose, t: Any) -> Array:
        rows = [n @ (T.p - p) - speed * t - half * (1.0 - tm.cos(omega * t))]
        if flat is not None:
            looks = -(T.R @ flat)
            # The rates of these rows at phi = 0 are the two rotations that tilt the face.
            rows += [-(e2 @ looks), e1 @ looks]
        return tm.array(rows)

    return phi if speed or half else (lambda T: phi(T, 0.0))


def point(point: ArrayLike, normal: ArrayLike) -> Callable[[Pose], Array]:
    """The way from a point of a surface: along its normal, and along the surface."""
    c, n = _three("point", point, "m"), unit("normal", normal)
    axes = np.array([n, *_across(n)])
    return lambda T: tm.array(list(axes @ (T.p - c)))


def sphere(center: ArrayLike, radius: float, *, inside: bool) -> Callable[[Pose], Any]:
    """The distance from a sphere, on the free side."""
    c, r, sign = _three("center", center, "m"), _length("radius", radius), -1.0 if inside else 1.0
    return lambda T: sign * (_size(T.p - c) - r)


def cylinder(point: ArrayLike, axis: ArrayLike, radius: float, *, inside: bool) -> Callable[[Pose], Any]:
    """The distance from a cylinder, on the free side."""
    c, u = _three("point", point, "m"), unit("axis", axis)
    r, sign = _length("radius", radius), -1.0 if inside else 1.0

    def phi(T: Pose) -> Any:
        d = T.p - c
        return sign * (_size(d - (u @ d) * u) - r)

    return phi


def line(point: ArrayLike, axis: ArrayLike) -> Callable[[Pose], Array]:
    """The way from a straight line, in two directions across it."""
    c = _three("point", point, "m")
    e1, e2 = _across(unit("axis", axis))
    return lambda T: tm.array([e1 @ (T.p - c), e2 @ (T.p - c)])


def hinge(point: ArrayLike, axis: ArrayLike, T: Pose) -> Callable[[Pose], Array]:
    """The way of a point of the tool from the axis, and the tilts of a direction of the tool against it."""
    if not isinstance(T, Pose):  # callers without a type checker
        raise UsageError(f"T must be a taut.Pose, one that the hinge allows; got {type(T).__name__}", name="T")
    c, u = _three("point", point, "m"), unit("axis", axis)
    own = T.inverse()
    c_E, u_E = own.R @ c + own.p, own.R @ u
    e1, e2 = _across(u)

    def phi(now: Pose) -> Array:
        turned = now.R @ u_E
        return tm.array([*(now.R @ c_E + now.p - c), e1 @ turned, e2 @ turned])

    return phi


def grasp(T: Pose | None) -> Callable[[Pose, Pose], Array]:
    """The way and the rotation of a second frame from where T has it in the first."""
    if not isinstance(T, Pose | None):  # callers without a type checker
        raise UsageError(f"T must be a taut.Pose, of the second frame in the first; got {type(T).__name__}", name="T")
    own = Pose() if T is None else T

    def phi(a: Pose, b: Pose) -> Array:
        seen = a.R.T @ b.R
        return tm.array([*(a.R.T @ (b.p - a.p) - own.p), *rotation_log(seen @ own.R.T)])

    return phi


def pin(directions: ArrayLike) -> Callable[[Pose, Pose], Array]:
    """The way between the origins of two frames."""
    rows = finite_array("directions", directions)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ShapeError(f"directions must be (k, 3); got shape {rows.shape}", name="directions")
    return lambda a, b: tm.array(list(rows @ (b.p - a.p)))


# -------------------------------------------------------------------- small ones


def unit(name: str, value: ArrayLike) -> Float64Array:
    """(3,) a direction, of length 1.

    Raises:
        RangeError: It has no length.
    """
    vector = _three(name, value)
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise RangeError(f"{name} must have a length, as [0, 0, 1]; got {vector.tolist()}", name=name)
    return read_only(vector / length)


def _size(d: Vector) -> Any:
    return tm.sqrt(d @ d + NEVER)


def _three(name: str, value: ArrayLike, unit: str = "") -> Float64Array:
    return finite_array(name, value, shape=(3,), unit=unit)


def _length(name: str, value: float) -> float:
    number = float(finite_array(name, value, shape=(), unit="m"))
    if number <= 0.0:
        raise RangeError(f"{name} must be > 0 [m]; got {number:g}", name=name, value=number, rule="> 0")
    return number


def _across(u: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Two directions that make a right-handed frame with u as its third: x and y where u is z."""
    start = np.eye(3)[int(np.argmin(np.abs(u)))] if abs(u[2]) < 1.0 - 1e-12 else np.array([1.0, 0.0, 0.0])
    e1 = start - (u @ start) * u
    e1 = e1 / np.linalg.norm(e1)
    return e1, np.cross(u, e1)
