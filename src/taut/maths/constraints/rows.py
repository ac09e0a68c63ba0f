"""The rows of a constraint at one state, and the functions of poses and joints that they come from."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np

from taut.base.errors import RangeError, ShapeError, TautError, UsageError, count_of, raised_location
from taut.base.types import Array, Float64Array, Matrix, Vector
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import moved
from taut.trace import math as tm
from taut.trace.linalg import LTDL, factor_spd
from taut.trace.pose import Pose

MIN_INDEPENDENT_PART: Final = 1e-7  # of a row's square, what it has that later rows have not: below, it is left out
MAX_ROWS: Final = 6  # of one function of poses
NO_FORCE: Final = 1e-9  # of a gradient: below it that is rounding
SOMEWHERE: Final = (  # where functions are tried
    Pose([0.4, -0.3, 0.5], rpy=[0.3, -0.4, 0.5]),
    Pose([-0.7, 0.2, 0.9], rpy=[-1.2, 0.6, 2.0]),
    Pose([0.1, 0.8, -0.2], rpy=[2.1, 0.2, -0.8]),
)
TRIED_AT: Final = 0.3  # [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstraintRows:
    """A constraint of k rows at one state: phi = 0, A_q v + phi_t = 0, A_q a + bias = 0."""

    phi: Vector  # (k,) zero where the constraint is one of velocities
    A: Matrix | None  # (k, 6) rate of phi per world-aligned twist of the one frame that it is of; else None
    A_q: Matrix  # (k, n) rate of phi per joint speed
    phi_t: Vector  # (k,) rate of phi while the arm rests
    bias: Vector  # (k,) second rate of phi, less A_q a
    curvature: Vector  # (k,) of it, what is not A J-dot v: A-dot V and what moves by itself
    one_sided: tuple[bool, ...]  # (k,) whether a row is phi >= 0

    @property
    def count(self) -> int:
        return len(self.one_sided)

    @property
    def factors(self) -> LTDL:
        """Factors of A A^T, without rows that depend on later ones."""
        assert self.A is not None
        return factor_spd(self.A @ self.A.T, MIN_INDEPENDENT_PART)

    def rate(self, v: Vector) -> Vector:
        """(k,) d phi / dt of joint speeds."""
        out: Vector = self.A_q @ v + self.phi_t
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The surface on which the first row of a ready-made constraint is zero, for films."""

    kind: Literal["plane", "sphere", "cylinder"]
    point: Float64Array  # (3,) [m] of the plane, at time 0; the centre; a point of the axis
    axis: Float64Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))  # (3,) normal or axis
    radius: float = 0.0  # [m]
    inside: bool = False  # whether the tool is in its hollow
    displacement: Callable[[float], float] | None = None  # [m] of the plane along its normal, by time


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """One function of a constraint: phi of the poses of frames, or of joints, and time; A itself if Pfaffian."""

    function: Callable[..., Any]
    frames: tuple[str | None, ...]  # none for a function of joints
    pfaffian: bool
    timed: bool
    count: int
    one_sided: tuple[bool, ...]
    moments: tuple[bool, ...]  # (k,) whether a row holds rotations only; one of joints counts as a force
    surface: Surface | None = None  # that of the first row, where it is declared

    def value(self, place: Sequence[Any], t: Any) -> Array:
        """Phi (k,), or A of a Pfaffian one, at the poses of its frames, or at the joints. Raises ShapeError."""
        out = _numbers(self.function(*place, t) if self.timed else self.function(*place))
        shape: tuple[int, ...] = (self.count,)
        if self.pfaffian:
            shape, out = (self.count, 6 if self.frames else len(place[0])), out if out.ndim == 2 else tm.array([out])
        if out.shape != shape:
            hint = "" if self.frames or len(out) == self.count else f"; say rows={len(out)}"
            raise ShapeError(
                f"the function of a constraint of {count_of(self.count, 'row')} must give numbers of shape {shape} "
                f"everywhere; got {out.shape}{hint}",
                name="function",
            )
        return out

    def slope(self, place: Sequence[Any], t: Any) -> Matrix:
        """A, per twists of all its frames (k, 6 m), or per joint speed (k, n)."""
        if self.pfaffian:
            return self.value(place, t)
        zero = np.zeros(6 * len(self.frames) if self.frames else len(place[0]))
        out: Matrix = tm.jacobian(lambda step: self.value(self._moved(place, step), t), zero)
        return out

    def phi(self, place: Sequence[Any], t: Any) -> Vector:
        """(k,) zero for a Pfaffian one."""
        return np.zeros(self.count) if self.pfaffian else self.value(place, t)

    def phi_t(self, place: Sequence[Any], t: Any) -> Vector:
        """(k,) d phi / dt while nothing moves."""
        if not self.timed:
            return np.zeros(self.count)
        out: Vector = tm.jacobian(lambda s: self.value(place, s[0]), tm.array([t]))[:, 0]
        return out

    def at(self, x: Snapshot) -> ConstraintRows:
        t = x.t
        place: list[Any] = [x.T(frame) for frame in self.frames] or [x.q]
        motion = tm.array([entry for frame in self.frames for entry in x.twist(frame)]) if self.frames else x.v
        A = self.slope(place, t)

        def rate(times: Array) -> Vector:
            """(k,) of phi after a time, along the motion."""
            later = self._moved(place, times[0] * motion)
            if self.pfaffian:
                out: Vector = self.value(later, t) @ motion
                return out

            def again(more: Array) -> Vector:
                return self.value(
                    self._moved(later, more[0] * motion), t + (times[0] + more[0] if self.timed else 0.0)
                )

            found: Vector = tm.jacobian(again, np.zeros(1))[:, 0]
            return found

        curvature = tm.jacobian(rate, np.zeros(1))[:, 0]
        A_q: Any = 0.0 if self.frames else A
        falling: Any = 0.0 if self.frames else np.zeros(self.count)
        for i, frame in enumerate(self.frames):
            part = A[:, 6 * i : 6 * i + 6]
            A_q, falling = A_q + part @ x.J(frame), falling + part @ x.Jdot_v(frame)
        return ConstraintRows(
            phi=self.phi(place, t),
            A=A if len(self.frames) == 1 else None,
            A_q=A_q,
            phi_t=self.phi_t(place, t),
            bias=curvature + falling,
            curvature=curvature,
            one_sided=self.one_sided,
        )

    def _moved(self, place: Sequence[Any], step: Array) -> list[Any]:
        """Poses after a small world-aligned twist each, (6 m,), to first order; joints after a step."""
        if not self.frames:
            return [place[0] + step]
        return [moved(T, step[6 * i : 6 * i + 6]) for i, T in enumerate(place)]


def joined(parts: Iterable[Vector]) -> Vector:
    """The entries of several vectors, one after the other."""
    return tm.array([entry for part in parts for entry in part])


def of_poses(
    function: Callable[..., Any],
    frames: Sequence[str | None],
    one_sided: bool | Sequence[bool] = False,
    *,
    surface: Surface | None = None,
    pfaffian: bool = False,
) -> Piece:
    """One function of the poses of frames. Raises UsageError or ShapeError for what is no such function."""
    if isinstance(frames, str) or not frames or not all(f is None or isinstance(f, str) for f in frames):
        raise UsageError(
            f"frames must be names of frames, such as frames=('left_hand', 'right_hand'); got {frames!r}",
            name="frames",
        )
    timed, m = _is_timed(function, len(frames), may_be=not pfaffian), len(frames)
    places = [[SOMEWHERE[(k + i) % len(SOMEWHERE)] for i in range(m)] for k in range(len(SOMEWHERE))]
    shape, *_ = [_shape(function, (*place, TRIED_AT) if timed else place) for place in places]
    row: tuple[int, ...] = (6,) if pfaffian else ()
    count = 1 if shape == row else shape[0]
    if shape not in (row, (count, *row)) or not 1 <= count <= MAX_ROWS:
        what = "A, (6,) or (k, 6) per twist" if pfaffian else f"a number or up to {MAX_ROWS} of them, (k,)"
        raise ShapeError(f"a constraint function must give {what}; got shape {shape}", name="function")
    piece = Piece(
        function=function, frames=tuple(frames), pfaffian=pfaffian, timed=timed, count=count,
        one_sided=_sides(one_sided, count), moments=(), surface=surface,
    )  # fmt: skip
    slopes = np.array([np.asarray(piece.slope(place, TRIED_AT), dtype=np.float64) for place in places])
    slopes = np.nan_to_num(slopes, nan=1.0).reshape(len(places), count, m, 6)
    for k, changes in enumerate(np.any(slopes, axis=(0, 2, 3))):
        if not changes:
            which = "" if count == 1 else f" in its row {k}"
            raise UsageError(
                f"the function of a Constraint.pfaffian gives A = 0{which}, which forbids nothing"
                if pfaffian
                else f"a constraint function must change with the pose, and this one is constant{which}: write it of "
                "T.p and T.R, with taut.math",
                name="function",
            )
    pulls = np.any(np.abs(slopes[..., :3]) > NO_FORCE, axis=(0, 2, 3))
    return replace(piece, moments=tuple(not pull for pull in pulls))


def of_joints(
    function: Callable[..., Any], rows: int, one_sided: bool | Sequence[bool] = False, *, pfaffian: bool = False
) -> Piece:
    """One function of the joints. Raises UsageError or RangeError."""
    timed = _is_timed(function, 1, may_be=not pfaffian)
    if isinstance(rows, bool) or not isinstance(rows, int) or rows < 1:
        raise RangeError(f"rows must be a whole number >= 1; got {rows!r}", name="rows", rule=">= 1")
    return Piece(
        function=function, frames=(), pfaffian=pfaffian, timed=timed, count=rows, one_sided=_sides(one_sided, rows),
        moments=(False,) * rows,
    )  # fmt: skip


def _shape(function: Callable[..., Any], arguments: Sequence[Any]) -> tuple[int, ...]:
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
    shape = _numbers(value).shape
    if np.asarray(value).dtype == np.bool_:
        raise UsageError(
            "a constraint function must give phi, a number that is zero on the constraint, and this one is a "
            "condition, True or False: for T.p[2] > 0.4 write lambda T: T.p[2] - 0.4, and one_sided=True",
            name="function",
        )
    return shape


def _numbers(given: Any) -> Array:
    """(k,) or (k, m) what the function of a constraint gives. Raises ShapeError."""
    try:
        if given is None or isinstance(given, (str, dict, set)):
            raise TypeError
        out: Array = tm.array(list(given)) if np.ndim(given) else tm.array([given])
    except (TypeError, ValueError):
        raise ShapeError(
            f"the function of a constraint must give a number or (k,) numbers; got {type(given).__name__}",
            name="function",
        ) from None
    return out


def _is_timed(function: object, places: int, *, may_be: bool) -> bool:
    """Whether a function of so many poses, or of joints, takes the time as well. Raises UsageError."""
    if not callable(function):  # callers without a type checker
        raise UsageError(
            "function of a Constraint must be a function, such as lambda T: T.p[2] - 0.1; got "
            f"{type(function).__name__}",
            name="function",
        )
    try:
        parameters = inspect.signature(function).parameters.values()
    except ValueError:  # of some functions in C
        raise UsageError(
            "function of this Constraint does not tell its arguments; write it as lambda T: ..., with taut.math",
            name="function",
        ) from None
    takes = sum(p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty for p in parameters)
    if takes != places and not (may_be and takes == places + 1):
        more = ", and one more for the time" if may_be else ""
        raise UsageError(
            f"function of this Constraint must take {count_of(places, 'argument')}{more}; it takes {takes}",
            name="function",
        )
    return takes > places


def _sides(one_sided: bool | Sequence[bool], count: int) -> tuple[bool, ...]:
    """(count,) true for rows at which the environment can only push. Raises ShapeError."""
    each = tuple(one_sided) if isinstance(one_sided, (list, tuple)) else (one_sided,) * count
    if len(each) != count or not all(isinstance(side, bool) for side in each):
        raise ShapeError(
            f"one_sided must be True or False, or one for each of the {count} rows; got {one_sided!r}",
            name="one_sided",
        )
    return tuple(bool(side) for side in each)
