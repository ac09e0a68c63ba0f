"""Functions phi of constraints: those of ready-made ones, and a user's, tried at a few poses and refused in words."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from taut.base.checks import finite_array, positive_scalar, read_only
from taut.base.errors import RangeError, ShapeError, TautError, UsageError, count_of, raised_location
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.maths.constraints.rows import OfPoses, OfVelocity, Piece
from taut.maths.spatial import rotation_log
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = [
    "Surface",
    "cylinder",
    "grasp",
    "hinge",
    "is_timed",
    "line",
    "of_moments",
    "of_poses",
    "of_velocity",
    "pin",
    "plane",
    "point",
    "rows_of",
    "sides",
    "sphere",
    "unit",
]

MAX_ROWS: Final = 6  # of one function of poses
NO_FORCE: Final = 1e-9  # of a gradient: below it that is rounding
NO_LENGTH: Final = 1e-9  # of a direction
MIN_SQUARE: Final = 1e-24  # [m^2] keeps a root from zero, where it has no slope
SOMEWHERE: Final = (
    Pose([0.4, -0.3, 0.5], rpy=[0.3, -0.4, 0.5]),
    Pose([-0.7, 0.2, 0.9], rpy=[-1.2, 0.6, 2.0]),
    Pose([0.1, 0.8, -0.2], rpy=[2.1, 0.2, -0.8]),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The surface on which the first row of a ready-made constraint is zero, for films."""

    kind: Literal["plane", "sphere", "cylinder"]
    point: Float64Array  # (3,) [m] of the plane, at time 0; the centre; a point of the axis
    axis: Float64Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))  # (3,) normal or axis
    radius: float = 0.0  # [m]
    inside: bool = False  # whether the tool is in its hollow
    displacement: Callable[[float], float] | None = None  # [m] of the plane along its normal, by time


# -------------------------------------------------------------------- a user's function


def of_poses(
    function: Callable[..., Any],
    frames: Sequence[str | None],
    one_sided: bool | Sequence[bool],
    surface: Surface | None = None,
) -> OfPoses:
    """phi of the poses of frames, and of time.

    Raises:
        UsageError: No function, other arguments, one that is constant.
        ShapeError: One that gives something else than a number or up to 6 of them.
    """
    if isinstance(frames, str) or not frames or not all(f is None or isinstance(f, str) for f in frames):
        raise UsageError(
            f"frames must be names of frames, such as frames=('left_hand', 'right_hand'); got {frames!r}",
            name="frames",
        )
    timed = is_timed("function", function, len(frames))
    shape, *_ = [np.shape(_result(function, (*T, 0.3) if timed else T)) for T in _somewhere(len(frames))]
    if len(shape) > 1 or (shape and not 1 <= shape[0] <= MAX_ROWS):
        raise ShapeError(
            f"a constraint function must give a number or up to {MAX_ROWS} of them, (k,); got shape {shape}",
            name="function",
        )
    count = shape[0] if shape else 1
    piece = OfPoses(
        function=function,
        frames=tuple(frames),
        timed=timed,
        count=count,
        one_sided=sides(one_sided, count),
        surface=surface,
    )
    for row, slope in enumerate(np.any(_slopes(piece), axis=(0, 2, 3))):
        if not slope:
            which = "" if count == 1 else f" in its row {row}"
            raise UsageError(
                f"a constraint function must change with the pose, and this one is constant{which}: write it of T.p "
                "and T.R, with taut.math",
                name="function",
            )
    return piece


def of_velocity(function: Callable[[Pose], Any], frame: str | None) -> OfVelocity:
    """A(T) V = 0 of one frame.

    Raises:
        UsageError: No function of a pose, one that gives zeros only.
        ShapeError: One that gives something else than (6,) or (k, 6).
    """
    is_timed("function", function, 1, may_be=False)
    shape, *_ = [np.shape(_result(function, T)) for T in _somewhere(1)]
    if shape not in ((6,), *((k, 6) for k in range(1, MAX_ROWS + 1))):
        raise ShapeError(
            f"the function of a Constraint.pfaffian must give A, (6,) or (k, 6) per twist of the tool; got shape "
            f"{shape}",
            name="function",
        )
    piece = OfVelocity(function=function, frames=(frame,), count=1 if len(shape) == 1 else shape[0])
    if not np.any(_slopes(piece)):
        raise UsageError("the function of a Constraint.pfaffian gives A = 0, which forbids nothing", name="function")
    return piece


def of_moments(piece: Piece) -> list[bool]:
    """Of each row of a piece, whether it holds rotations only; a row of joints counts as a force."""
    if not isinstance(piece, (OfPoses, OfVelocity)):
        return [False] * piece.count
    pulls = np.any(np.abs(_slopes(piece)[..., :3]) > NO_FORCE, axis=(0, 2, 3))
    return [not pull for pull in pulls]


def _somewhere(frames: int) -> list[tuple[Pose, ...]]:
    """Poses of so many frames at which functions are tried."""
    return [tuple(SOMEWHERE[(k + i) % len(SOMEWHERE)] for i in range(frames)) for k in range(len(SOMEWHERE))]


def _slopes(piece: OfPoses | OfVelocity) -> Float64Array:
    """(poses, k, frames, 6) A of a piece at some poses; 1 where it has no number."""
    m = len(piece.frames)
    found = [np.asarray(piece.slope(poses, 0.3), dtype=np.float64) for poses in _somewhere(m)]
    return np.nan_to_num(np.array(found), nan=1.0).reshape(len(found), piece.count, m, 6)


def rows_of(rows: object) -> int:
    """A number of rows.

    Raises:
        RangeError: It is none.
    """
    if isinstance(rows, bool) or not isinstance(rows, int) or rows < 1:
        raise RangeError(f"rows must be a whole number >= 1; got {rows!r}", name="rows", rule=">= 1")
    return rows


def _result(function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    try:
        value = function(*arguments)
    except TautError:
        raise
    except Exception as cause:
        raise UsageError(
            f"a constraint function must work in every pose, and this one raises {type(cause).__name__}: {cause} at "
            f"{raised_location(cause)}",
            name="function",
        ) from cause
    try:
        given = np.asarray(value)
        np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise ShapeError(
            f"a constraint function must give a number or (k,) numbers; got {type(value).__name__}", name="function"
        ) from None
    if value is None:
        raise ShapeError("a constraint function must give a number or (k,) numbers; got None", name="function")
    if given.dtype == np.bool_:
        raise UsageError(
            "a constraint function must give phi, a number that is zero on the constraint, and this one is a "
            "condition, True or False: for T.p[2] > 0.4 write lambda T: T.p[2] - 0.4, and one_sided=True",
            name="function",
        )
    return value


def is_timed(name: str, function: object, poses: int, *, may_be: bool = True) -> bool:
    """Whether a function of so many arguments takes the time as well.

    Raises:
        UsageError: It is no function, or takes another number of arguments.
    """
    if not callable(function):  # callers without a type checker
        raise UsageError(
            f"{name} of a Constraint must be a function, such as lambda T: T.p[2] - 0.1; got "
            f"{type(function).__name__}",
            name=name,
        )
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # of some functions in C
        raise UsageError(
            f"{name} of this Constraint does not tell its arguments; write it as lambda T: ..., with taut.math",
            name=name,
        ) from None
    takes = sum(p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty for p in parameters)
    if takes != poses and not (may_be and takes == poses + 1):
        more = ", and one more for the time" if may_be else ""
        raise UsageError(
            f"{name} of this Constraint must take {count_of(poses, 'argument')}{more}; it takes {takes}", name=name
        )
    return takes > poses


def sides(one_sided: bool | Sequence[bool], count: int) -> tuple[bool, ...]:
    """Of each row, whether the environment can only push.

    Raises:
        ShapeError: Not one for all rows, or one for each.
    """
    each = tuple(one_sided) if isinstance(one_sided, (list, tuple)) else (one_sided,) * count
    if len(each) != count or not all(isinstance(side, bool) for side in each):
        raise ShapeError(
            f"one_sided must be True or False, or one for each of the {count} rows; got {one_sided!r}",
            name="one_sided",
        )
    return tuple(bool(side) for side in each)


# -------------------------------------------------------------------- ready-made


def plane(
    point: ArrayLike,
    normal: ArrayLike,
    face: ArrayLike | None,
    velocity: ArrayLike,
    sway: ArrayLike,
    period: float,
) -> tuple[Callable[..., Array], Surface]:
    """The distance from a plane, and with a face its two tilts: of a pose, and of time where it moves."""
    p, n = _three("point", point, "m"), unit("normal", normal)
    speed = float(n @ _three("velocity", velocity, "m/s"))
    half = 0.5 * float(n @ _three("sway", sway, "m"))
    omega = 2.0 * np.pi / positive_scalar("period", period, unit="s")
    flat = None if face is None else unit("face", face)
    e1, e2 = _across(n)

    def displacement(t: Any) -> Any:
        return speed * t + half * (1.0 - tm.cos(omega * t))

    def phi(T: Pose, t: Any) -> Array:
        rows = [n @ (T.p - p) - displacement(t)]
        if flat is not None:
            looks = -(T.R @ flat)
            # The rates of these rows at phi = 0 are the two rotations that tilt the face.
            rows += [-(e2 @ looks), e1 @ looks]
        return tm.array(rows)

    moves = bool(speed or half)
    surface = Surface(kind="plane", point=p, axis=n, displacement=displacement if moves else None)
    return (phi if moves else lambda T: phi(T, 0.0)), surface


def point(point: ArrayLike, normal: ArrayLike) -> tuple[Callable[[Pose], Array], Surface]:
    """The displacement from a point of a surface: along its normal, and along the surface."""
    c, n = _three("point", point, "m"), unit("normal", normal)
    axes = np.array([n, *_across(n)])
    return lambda T: tm.array(list(axes @ (T.p - c))), Surface(kind="plane", point=c, axis=n)


def sphere(center: ArrayLike, radius: float, *, inside: bool) -> tuple[Callable[[Pose], Any], Surface]:
    """The distance from a sphere, on the free side."""
    c, r, sign = _three("center", center, "m"), positive_scalar("radius", radius, unit="m"), -1.0 if inside else 1.0
    surface = Surface(kind="sphere", point=c, radius=r, inside=inside)
    return lambda T: sign * (_size(T.p - c) - r), surface


def cylinder(
    point: ArrayLike, axis: ArrayLike, radius: float, *, inside: bool
) -> tuple[Callable[[Pose], Any], Surface]:
    """The distance from a cylinder, on the free side."""
    c, u = _three("point", point, "m"), unit("axis", axis)
    r, sign = positive_scalar("radius", radius, unit="m"), -1.0 if inside else 1.0

    def phi(T: Pose) -> Any:
        d = T.p - c
        return sign * (_size(d - (u @ d) * u) - r)

    return phi, Surface(kind="cylinder", point=c, axis=u, radius=r, inside=inside)


def line(point: ArrayLike, axis: ArrayLike) -> Callable[[Pose], Array]:
    """The displacement from a straight line, in two directions across it."""
    c = _three("point", point, "m")
    e1, e2 = _across(unit("axis", axis))
    return lambda T: tm.array([e1 @ (T.p - c), e2 @ (T.p - c)])


def hinge(point: ArrayLike, axis: ArrayLike, T: Pose) -> Callable[[Pose], Array]:
    """The displacement of a point of the tool from the axis, and the tilts of a direction of the tool against it."""
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
    """The displacement and the rotation of a second frame from where T has it in the first."""
    if not isinstance(T, Pose | None):  # callers without a type checker
        raise UsageError(f"T must be a taut.Pose, of the second frame in the first; got {type(T).__name__}", name="T")
    own = Pose() if T is None else T

    def phi(a: Pose, b: Pose) -> Array:
        seen = a.R.T @ b.R
        return tm.array([*(a.R.T @ (b.p - a.p) - own.p), *rotation_log(seen @ own.R.T)])

    return phi


def pin(directions: ArrayLike) -> Callable[[Pose, Pose], Array]:
    """The displacement between the origins of two frames."""
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
    if length < NO_LENGTH:
        raise RangeError(f"{name} must have a length, as [0, 0, 1]; got {vector.tolist()}", name=name)
    return read_only(vector / length)


def _size(d: Vector) -> Any:
    return tm.sqrt(d @ d + MIN_SQUARE)


def _three(name: str, value: ArrayLike, unit: str = "") -> Float64Array:
    return finite_array(name, value, shape=(3,), unit=unit)


def _across(u: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Two directions that make a right-handed frame with u as its third: x and y where u is z."""
    start = np.eye(3)[int(np.argmin(np.abs(u)))] if abs(u[2]) < 1.0 - 1e-12 else np.array([1.0, 0.0, 0.0])
    e1 = start - (u @ start) * u
    e1 = e1 / np.linalg.norm(e1)
    return e1, np.cross(u, e1)
