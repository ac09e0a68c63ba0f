"""The rows of a constraint at one state, and what they come from: functions of poses, of joints, of velocities."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from taut.base.errors import ShapeError
from taut.base.types import Array, Matrix, Twist, Vector
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import moved
from taut.trace import math as tm
from taut.trace.linalg import LTDL, factor_spd
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.maths.constraints.functions import Surface

__all__ = [
    "MIN_INDEPENDENT_PART",
    "ConstraintRows",
    "OfJointVelocity",
    "OfJoints",
    "OfPoses",
    "OfVelocity",
    "Piece",
    "each_moved",
    "joined",
]


MIN_INDEPENDENT_PART: Final = (
    1e-7  # of a row's square, what it has that later rows have not: below it, it is left out
)


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
        """Number of rows."""
        return len(self.one_sided)

    @property
    def factors(self) -> LTDL:
        """Of A A^T, without rows that depend on later ones."""
        assert self.A is not None
        return factor_spd(self.A @ self.A.T, MIN_INDEPENDENT_PART)

    @property
    def rate(self) -> Callable[[Vector], Vector]:
        """d phi / dt of joint speeds."""
        return lambda v: self.A_q @ v + self.phi_t


class Piece(Protocol):
    """One function of a constraint."""

    @property
    def count(self) -> int:
        """Number of rows."""
        ...

    @property
    def one_sided(self) -> tuple[bool, ...]:
        """Of each row."""
        ...

    @property
    def frames(self) -> tuple[str | None, ...]:
        """What it is a function of; none for a function of joints."""
        ...

    def at(self, x: Snapshot) -> ConstraintRows:
        """Its rows at a state."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class OfPoses:
    """phi of the poses of frames, and of time."""

    function: Callable[..., Any]
    frames: tuple[str | None, ...]
    timed: bool
    count: int
    one_sided: tuple[bool, ...]
    surface: Surface | None = None  # that of the first row, where it is declared

    def phi(self, poses: Sequence[Pose], t: Any) -> Vector:
        """(k,)."""
        value = self.function(*poses, t) if self.timed else self.function(*poses)
        out: Vector = tm.array([value]) if np.ndim(value) == 0 else tm.array(list(value))
        if out.shape != (self.count,):
            raise ShapeError(
                f"a constraint function must give as many numbers in every pose; got {self.count} and {len(out)}",
                name="function",
            )
        return out

    def at(self, x: Snapshot) -> ConstraintRows:
        """Its rows at a state."""
        poses, t, m = [x.T(frame) for frame in self.frames], x.t, len(self.frames)
        A = self.slope(poses, t)
        twists = tm.array([entry for frame in self.frames for entry in x.twist(frame)])

        def along(times: Array) -> Vector:
            rate = 1.0 if self.timed else 0.0

            def again(more: Array) -> Vector:
                there = each_moved(each_moved(poses, times[0] * twists), more[0] * twists)
                return self.phi(there, t + rate * (times[0] + more[0]))

            out: Vector = tm.jacobian(again, np.zeros(1))[:, 0]
            return out

        curvature = tm.jacobian(along, np.zeros(1))[:, 0]
        A_q, falling = _through(A, [x.J(frame) for frame in self.frames], [x.Jdot_v(frame) for frame in self.frames])
        return ConstraintRows(
            phi=self.phi(poses, t),
            A=A if m == 1 else None,
            A_q=A_q,
            phi_t=self._phi_t(poses, t),
            bias=curvature + falling,
            curvature=curvature,
            one_sided=self.one_sided,
        )

    def slope(self, poses: Sequence[Pose], t: Any) -> Matrix:
        """(k, 6 m) A of the twists of all frames."""
        zero = np.zeros(6 * len(self.frames))
        out: Matrix = tm.jacobian(lambda step: self.phi(each_moved(poses, step), t), zero)
        return out

    def _phi_t(self, poses: Sequence[Pose], t: Any) -> Vector:
        out: Vector = np.zeros(self.count)
        if self.timed:
            out = tm.jacobian(lambda s: self.phi(poses, s[0]), tm.array([t]))[:, 0]
        return out

    def of_twist(self, T: Pose, t: Any) -> tuple[Matrix, Vector]:
        """A and dphi/dt at a pose of its one frame."""
        return self.slope([T], t), self._phi_t([T], t)


def each_moved(poses: Sequence[Pose], steps: Array) -> list[Pose]:
    """Poses after a small step of a world-aligned twist each, (6 m,), to first order."""
    return [moved(T, steps[6 * i : 6 * i + 6]) for i, T in enumerate(poses)]


def _through(A: Matrix, Js: Sequence[Matrix], rates: Sequence[Twist]) -> tuple[Matrix, Vector]:
    """A J and A J-dot v, summed over the frames."""
    A_q: Any = 0.0
    falling: Any = 0.0
    for i, (J, rate) in enumerate(zip(Js, rates, strict=True)):
        part = A[:, 6 * i : 6 * i + 6]
        A_q, falling = A_q + part @ J, falling + part @ rate
    return A_q, falling


@dataclass(frozen=True, kw_only=True, eq=False)
class OfJoints:
    """phi of the joints, and of time."""

    function: Callable[..., Any]
    timed: bool
    count: int
    one_sided: tuple[bool, ...]

    @property
    def frames(self) -> tuple[str | None, ...]:
        return ()

    def phi(self, q: Vector, t: Any) -> Vector:
        value = self.function(q, t) if self.timed else self.function(q)
        given = _numbers("the function of a Constraint.of_joints", value)
        out: Vector = tm.array([given[()]]) if given.ndim == 0 else given
        if out.ndim != 1:
            raise ShapeError(
                f"the function of a Constraint.of_joints must give a number or (k,) numbers; got shape {out.shape}",
                name="function",
            )
        if out.shape != (self.count,):
            raise ShapeError(
                f"the function of a Constraint.of_joints gives {len(out)} numbers, and it was made with "
                f"rows={self.count}; say rows={len(out)}",
                name="rows",
            )
        return out

    def at(self, x: Snapshot) -> ConstraintRows:
        q, v, t = x.q, x.v, x.t
        rate = 1.0 if self.timed else 0.0

        def along(times: Array) -> Vector:
            out: Vector = tm.jacobian(lambda s: self.phi(q + s[0] * v, t + rate * s[0]), tm.array([times[0]]))[:, 0]
            return out

        curvature = tm.jacobian(along, np.zeros(1))[:, 0]
        phi_t: Vector = np.zeros(self.count)
        if self.timed:
            phi_t = tm.jacobian(lambda s: self.phi(q, s[0]), tm.array([t]))[:, 0]
        return ConstraintRows(
            phi=self.phi(q, t),
            A=None,
            A_q=tm.jacobian(lambda y: self.phi(y, t), q),
            phi_t=phi_t,
            bias=curvature,
            curvature=curvature,
            one_sided=self.one_sided,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class OfVelocity:
    """A(T) V = 0 alone."""

    function: Callable[[Pose], Any]
    frames: tuple[str | None, ...]
    count: int

    @property
    def one_sided(self) -> tuple[bool, ...]:
        return (False,) * self.count

    def _A(self, T: Pose) -> Matrix:
        value = self.function(T)
        rows = [list(value)] if np.ndim(value) == 1 else [list(row) for row in value]
        out: Matrix = tm.array(rows)
        if out.shape != (self.count, 6):
            raise ShapeError(
                "the function of a Constraint.pfaffian must give A of one shape in every pose; got "
                f"{(self.count, 6)} and {out.shape}",
                name="function",
            )
        return out

    def slope(self, poses: Sequence[Pose], t: Any) -> Matrix:  # noqa: ARG002
        """(k, 6) A of the one frame."""
        return self._A(*poses)

    def of_twist(self, T: Pose, t: Any) -> tuple[Matrix, Vector]:  # noqa: ARG002
        return self._A(T), np.zeros(self.count)

    def at(self, x: Snapshot) -> ConstraintRows:
        (frame,) = self.frames
        T, V = x.T(frame), x.twist(frame)
        A = self._A(T)
        curvature = tm.jacobian(lambda s: self._A(moved(T, s[0] * V)) @ V, np.zeros(1))[:, 0]
        zero = np.zeros(self.count)
        return ConstraintRows(
            phi=zero,
            A=A,
            A_q=A @ x.J(frame),
            phi_t=zero,
            bias=curvature + A @ x.Jdot_v(frame),
            curvature=curvature,
            one_sided=self.one_sided,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class OfJointVelocity:
    """A(q) v = 0 alone."""

    function: Callable[[Vector], Any]
    count: int

    @property
    def one_sided(self) -> tuple[bool, ...]:
        return (False,) * self.count

    @property
    def frames(self) -> tuple[str | None, ...]:
        return ()

    def _A(self, q: Vector) -> Matrix:
        A = _numbers("the function of a Constraint.pfaffian_of_joints", self.function(q))
        out: Matrix = tm.array([A]) if A.ndim == 1 else A
        if out.shape != (self.count, len(q)):
            raise ShapeError(
                "the function of a Constraint.pfaffian_of_joints must give A per joint speed, of shape "
                f"{(self.count, len(q))} with rows={self.count}; got {A.shape}",
                name="function",
            )
        return out

    def at(self, x: Snapshot) -> ConstraintRows:
        q, v = x.q, x.v
        curvature = tm.jacobian(lambda s: self._A(q + s[0] * v) @ v, np.zeros(1))[:, 0]
        zero = np.zeros(self.count)
        return ConstraintRows(
            phi=zero,
            A=None,
            A_q=self._A(q),
            phi_t=zero,
            bias=curvature,
            curvature=curvature,
            one_sided=self.one_sided,
        )


def _numbers(who: str, value: Any) -> Array:
    """What a function gives, as an array of numbers or symbols.

    Raises:
        ShapeError: It is something else.
    """
    try:
        if value is None or isinstance(value, (str, dict, set)):
            raise TypeError
        return tm.array(list(value)) if np.ndim(value) else tm.array(value)
    except (TypeError, ValueError):
        raise ShapeError(f"{who} must give numbers; got {type(value).__name__}", name="function") from None


def joined(parts: Iterable[Vector]) -> Vector:
    """The entries of several vectors, one after the other."""
    return tm.array([entry for part in parts for entry in part])
