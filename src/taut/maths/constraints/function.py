"""What a user's function must be to make a constraint of: tried at a few poses, and refused in words."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError, ShapeError, TautError, UsageError, raised_location
from taut.base.types import Array, Float64Array, Vector
from taut.maths.constraints.rows import OfPoses, OfVelocity, Piece, each_moved
from taut.maths.constraints.shapes import Surface
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["arguments", "of_moments", "of_poses", "of_velocity", "rows_of", "sides"]

MOST_ROWS: Final = 6  # of one function of poses
STILL: Final = 1e-9  # of a gradient: below it that is rounding
SOMEWHERE: Final = (
    Pose([0.4, -0.3, 0.5], rpy=[0.3, -0.4, 0.5]),
    Pose([-0.7, 0.2, 0.9], rpy=[-1.2, 0.6, 2.0]),
    Pose([0.1, 0.8, -0.2], rpy=[2.1, 0.2, -0.8]),
)


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
    timed = arguments("function", function, len(frames))
    shapes, slopes = [], []
    for k in range(len(SOMEWHERE)):
        poses = [SOMEWHERE[(k + i) % len(SOMEWHERE)] for i in range(len(frames))]
        shapes.append(_count(_result(function, (*poses, 0.3) if timed else tuple(poses))))
        slopes.append(_slope(function, poses, timed))
    if len(set(shapes)) > 1:
        raise ShapeError(
            f"a constraint function must give as many numbers in every pose; got {shapes[0]} and {shapes[1]}",
            name="function",
        )
    for row in range(shapes[0]):
        if all(not np.any(slope[row]) for slope in slopes):
            which = "" if shapes[0] == 1 else f" in its row {row}"
            raise UsageError(
                f"a constraint function must change with the pose, and this one is constant{which}: write it of T.p "
                "and T.R, with taut.math",
                name="function",
            )
    return OfPoses(
        function=function,
        frames=tuple(frames),
        timed=timed,
        count=shapes[0],
        one_sided=sides(one_sided, shapes[0]),
        surface=surface,
    )


def of_velocity(function: Callable[[Pose], Any], frame: str | None) -> OfVelocity:
    """A(T) V = 0 of one frame.

    Raises:
        UsageError: No function of a pose, one that gives zeros only.
        ShapeError: One that gives something else than (6,) or (k, 6).
    """
    arguments("function", function, 1, may_be_timed=False)
    shapes = [np.shape(_result(function, (T,))) for T in SOMEWHERE]
    shape = shapes[0]
    if shape not in ((6,), *((k, 6) for k in range(1, MOST_ROWS + 1))) or len(set(shapes)) > 1:
        raise ShapeError(
            f"the function of a Constraint.pfaffian must give A, (6,) or (k, 6) per twist of the tool; got shape "
            f"{shape}",
            name="function",
        )
    count = 1 if len(shape) == 1 else shape[0]
    if all(not np.any(np.asarray(_result(function, (T,)), dtype=np.float64)) for T in SOMEWHERE):
        raise UsageError("the function of a Constraint.pfaffian gives A = 0, which forbids nothing", name="function")
    return OfVelocity(function=function, frames=(frame,), count=count)


def of_moments(piece: Piece) -> list[bool]:
    """Of each row of a piece, whether it holds rotations only; a row of joints counts as a force."""
    if not isinstance(piece, (OfPoses, OfVelocity)):
        return [False] * piece.count
    m, pulls = len(piece.frames), np.zeros(piece.count, dtype=np.bool_)
    for k in range(len(SOMEWHERE)):
        poses = [SOMEWHERE[(k + i) % len(SOMEWHERE)] for i in range(m)]
        A = np.nan_to_num(np.asarray(piece.slope(poses, 0.3), dtype=np.float64), nan=1.0)
        pulls |= np.any(np.abs(A.reshape(piece.count, m, 6)[:, :, :3]) > STILL, axis=(1, 2))
    return [not pull for pull in pulls]


def rows_of(rows: object) -> int:
    """A number of rows.

    Raises:
        RangeError: It is none.
    """
    if isinstance(rows, bool) or not isinstance(rows, int) or rows < 1:
        raise RangeError(f"rows must be a whole number >= 1; got {rows!r}", name="rows", rule=">= 1")
    return rows


def _slope(function: Callable[..., Any], poses: Sequence[Pose], timed: bool) -> Float64Array:
    def phi(step: Array) -> Vector:
        there = each_moved(poses, step)
        value = function(*there, 0.3) if timed else function(*there)
        out: Vector = tm.array([value]) if np.ndim(value) == 0 else tm.array(list(value))
        return out

    return np.nan_to_num(np.asarray(tm.jacobian(phi, np.zeros(6 * len(poses))), dtype=np.float64), nan=1.0)


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
    if given.dtype == np.bool_:
        raise UsageError(
            "a constraint function must give phi, a number that is zero on the constraint, and this one is a "
            "condition, True or False: for T.p[2] > 0.4 write lambda T: T.p[2] - 0.4, and one_sided=True",
            name="function",
        )
    return value


def _count(value: Any) -> int:
    """Rows of a result.

    Raises:
        ShapeError: It is no vector of 1 to 6.
    """
    shape = np.shape(value)
    if value is None or len(shape) > 1 or (shape and not 1 <= shape[0] <= MOST_ROWS):
        got = "None" if value is None else f"shape {shape}"
        raise ShapeError(
            f"a constraint function must give a number or up to {MOST_ROWS} of them, (k,); got {got}", name="function"
        )
    return shape[0] if shape else 1


def arguments(name: str, function: object, poses: int, *, may_be_timed: bool = True) -> bool:
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
        signature = inspect.signature(function)
    except ValueError:  # of some functions in C
        raise UsageError(
            f"{name} of this Constraint does not tell its arguments; write it as lambda T: ..., with taut.math",
            name=name,
        ) from None
    takes = [
        p
        for p in signature.parameters.values()
        if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty
    ]
    if len(takes) == poses:
        return False
    if len(takes) == poses + 1 and may_be_timed:
        return True
    more = ", and one more for the time" if may_be_timed else ""
    raise UsageError(
        f"{name} of this Constraint must take {poses} {'argument' if poses == 1 else 'arguments'}{more}; it takes "
        f"{len(takes)}",
        name=name,
    )


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
