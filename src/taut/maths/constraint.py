"""Constraint: what a contact, a hinge or a closed chain lets an arm do, from a function of the pose: section 10.4.1.

A and its rate come from differentiation, so that a constraint is stated once, as phi(T) = 0.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, Self

import numpy as np

from taut.base import math as tm
from taut.base.checks import finite_array, positive_scalar, read_only
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.pose import Pose
from taut.base.types import Array, ArrayLike, Float64Array, Matrix, Twist, Vector
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_log

__all__ = ["Constraint", "ConstraintRows", "moved"]

MOST_ROWS: Final = 6  # of one function of poses
NEVER: Final = 1e-24  # keeps a root from zero, where it has no slope
SOMEWHERE: Final = (
    Pose([0.4, -0.3, 0.5], rpy=[0.3, -0.4, 0.5]),
    Pose([-0.7, 0.2, 0.9], rpy=[-1.2, 0.6, 2.0]),
    Pose([0.1, 0.8, -0.2], rpy=[2.1, 0.2, -0.8]),
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


@dataclass(frozen=True, kw_only=True, init=False, eq=False)
class Constraint:
    """What holds the tool: phi(T) = 0, a function of its pose; natural constraints of section 10.4.1.

    Law:          phi(T, t) = 0;  A(T) V + d phi/dt = 0;  A V-dot + A-dot V + ... = 0            eqs. 10.39, 10.41
                  F_app = A^T lam is what the arm can apply against it: k forces, and n - k motions are free

    A one-sided row is a contact, phi >= 0: phi is positive on the free side, and lam < 0 presses.

    Two constraints add up: `Constraint.plane(...) + Constraint.plane(...)`.

    Args:
        function: Takes the Pose of the tool, or of each of `frames`, and if it has one more argument the time [s];
            gives a number or (k,) numbers, written with taut.math.
        frames: Frames whose poses it takes; the arm's tool alone if left out.
        one_sided: Whether the environment can only push; one for all rows, or one for each.

    Raises:
        UsageError: No function; one that is constant.
        ShapeError: One that gives something else than a number or up to 6 of them.

    Example:
        >>> board = Constraint(lambda T: T.p[2] - 0.1, one_sided=True)
        >>> import taut
        >>> rows = board.at(taut.snapshot(taut.load_arm("planar2"), [0.3, 0.4]))
        >>> rows.A.round(6).tolist()
        [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]

    References:
        Section 10.4.1 natural and artificial constraints; eqs. 10.39 to 10.41.
    """

    pieces: tuple[Piece, ...]

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        frames: Sequence[str | None] = (None,),
        one_sided: bool | Sequence[bool] = False,
    ) -> None:
        object.__setattr__(self, "pieces", (_of_poses(function, frames, one_sided),))

    @classmethod
    def of(cls, pieces: Sequence[Piece]) -> Self:
        """That of several functions at once."""
        made = object.__new__(cls)
        object.__setattr__(made, "pieces", tuple(pieces))
        return made

    @property
    def count(self) -> int:
        """k, the number of rows."""
        return sum(piece.count for piece in self.pieces)

    @property
    def one_sided(self) -> tuple[bool, ...]:
        """(k,) whether each row is phi >= 0."""
        return tuple(side for piece in self.pieces for side in piece.one_sided)

    @property
    def frame(self) -> tuple[str | None] | None:
        """The one frame that it is a function of, in a tuple; None where there are several, or joints."""
        frames = {piece.frames for piece in self.pieces}
        only = frames.pop() if len(frames) == 1 else ()
        return (only[0],) if len(only) == 1 else None

    def at(self, x: Snapshot) -> ConstraintRows:
        """Its rows at the state, and the time, of a snapshot."""
        parts = [piece.at(x) for piece in self.pieces]
        if len(parts) == 1:
            return parts[0]
        single = self.frame is not None
        return ConstraintRows(
            phi=_joined(part.phi for part in parts),
            A=tm.array([row for part in parts if part.A is not None for row in part.A]) if single else None,
            A_q=tm.array([row for part in parts for row in part.A_q]),
            phi_t=_joined(part.phi_t for part in parts),
            bias=_joined(part.bias for part in parts),
            curvature=_joined(part.curvature for part in parts),
            one_sided=self.one_sided,
        )

    def of_pose(self, T: Pose, t: float = 0.0) -> Float64Array:
        """(k,) phi of a pose of the one frame that it is a function of; zero for constraints of velocities.

        Raises:
            UsageError: It is one of joints or of several frames.
        """
        if self.frame is None:
            raise UsageError("a constraint of joints or of several frames has no phi of one pose", name="constraint")
        rows = [p.phi([T], t) if isinstance(p, _OfPoses) else np.zeros(p.count) for p in self.pieces]
        return np.asarray(np.concatenate(rows), dtype=np.float64)

    def of_twist(self, T: Pose, t: float = 0.0) -> tuple[Float64Array, Float64Array]:
        """A (k, 6) per world-aligned twist of the one frame that it is a function of, at a pose; and dphi/dt (k,).

        Raises:
            UsageError: It is one of joints or of several frames.
        """
        if self.frame is None:
            raise UsageError("a constraint of joints or of several frames has no A of one twist", name="constraint")
        rows = [p.of_twist(T, t) for p in self.pieces if isinstance(p, (_OfPoses, _OfVelocity))]
        A = np.concatenate([np.asarray(A, dtype=np.float64) for A, _ in rows])
        return A, np.concatenate([np.asarray(phi_t, dtype=np.float64) for _, phi_t in rows])

    def __add__(self, other: Constraint) -> Constraint:
        if not isinstance(other, Constraint):
            return NotImplemented
        return Constraint.of((*self.pieces, *other.pieces))

    # ---------------------------------------------------------------- ready-made

    @classmethod
    def of_joints(
        cls, function: Callable[..., Any], *, rows: int = 1, one_sided: bool | Sequence[bool] = False
    ) -> Self:
        """phi(q) = 0, a function of the joints, or of joints and time: A(q) v = 0.

        Args:
            function: Takes (n,) joint positions, and if it has two arguments the time; gives `rows` numbers.
            rows: How many.
            one_sided: As for a constraint of the pose.
        """
        timed = _arguments("function", function, 1)
        return cls.of([_OfJoints(function=function, timed=timed, count=rows, one_sided=_sides(one_sided, rows))])

    @classmethod
    def pfaffian(cls, function: Callable[[Pose], Any], *, frame: str | None = None) -> Self:
        """A(T) V = 0, a constraint of velocities that need not come from a phi: a wheel, a knife edge.

        Args:
            function: Takes the Pose of the tool and gives A, (6,) or (k, 6), per twist in world axes at its origin.
            frame: The frame; the arm's tool if left out.
        """
        _arguments("function", function, 1, may_be_timed=False)
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
            raise UsageError(
                "the function of a Constraint.pfaffian gives A = 0, which forbids nothing", name="function"
            )
        return cls.of([_OfVelocity(function=function, frames=(frame,), count=count)])

    @classmethod
    def knife_edge(cls, *, sideways: ArrayLike, frame: str | None = None) -> Self:
        """A wheel or a knife edge at the tool's origin, which does not slip sideways: one row, of velocities.

        It goes anywhere by steering, and has no phi. On a plane it leaves two motions: ahead, and about the normal.

        Args:
            sideways: (3,) the wheel's axle, or the normal of the blade, in the tool's axes.
            frame: The frame; the arm's tool if left out.
        """
        side = _unit("sideways", sideways)
        return cls.pfaffian(lambda T: tm.array([*(T.R @ side), 0.0, 0.0, 0.0]), frame=frame)

    @classmethod
    def plane(
        cls,
        *,
        point: ArrayLike,
        normal: ArrayLike,
        face: ArrayLike | None = None,
        one_sided: bool = True,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        sway: ArrayLike = (0.0, 0.0, 0.0),
        period: float = 1.0,
        frame: str | None = None,
    ) -> Self:
        """The tool's origin on a plane; with `face`, which lies flat on it: the board and the eraser of figure 10.16.

        Args:
            point: (3,) any point of it [m], in world axes, at time 0.
            normal: (3,) its direction towards free space, of any length.
            face: (3,) direction in the tool's axes that looks along -normal, into the plane: two more rows.
            one_sided: Whether it only pushes; the rows of a face hold both ways.
            velocity: (3,) at which the plane moves [m/s].
            sway: (3,) how far it goes and comes back, by (1 - cos(2 pi t / period)) / 2 of it [m].
            period: Of that [s].
            frame: The frame; the arm's tool if left out.
        """
        p, n = _three("point", point, "m"), _unit("normal", normal)
        speed = float(n @ _three("velocity", velocity, "m/s"))
        half = 0.5 * float(n @ _three("sway", sway, "m"))
        omega = 2.0 * np.pi / positive_scalar("period", period, unit="s")
        flat = None if face is None else _unit("face", face)
        e1, e2 = _across(n)

        def phi(T: Pose, t: Any) -> Array:
            rows = [n @ (T.p - p) - speed * t - half * (1.0 - tm.cos(omega * t))]
            if flat is not None:
                looks = -(T.R @ flat)
                # The rates of these rows at phi = 0 are the two rotations that tilt the face.
                rows += [-(e2 @ looks), e1 @ looks]
            return tm.array(rows)

        sides = (one_sided, False, False) if flat is not None else (one_sided,)
        return cls.of([_of_poses(phi if speed or half else (lambda T: phi(T, 0.0)), (frame,), sides)])

    @classmethod
    def point(
        cls,
        *,
        point: ArrayLike,
        normal: ArrayLike = (0.0, 0.0, 1.0),
        one_sided: bool = True,
        frame: str | None = None,
    ) -> Self:
        """The tool's origin at a point of a surface, its rotation free: chalk that sticks; three rows.

        The first row is that of the surface, and the other two are what friction holds, within its cone.

        Args:
            point: (3,) where it sticks [m], in world axes.
            normal: (3,) direction of the surface towards free space, of any length.
            one_sided: Whether the surface only pushes.
            frame: The frame; the arm's tool if left out.
        """
        c, n = _three("point", point, "m"), _unit("normal", normal)
        axes = np.array([n, *_across(n)])
        return cls.of([_of_poses(lambda T: tm.array(list(axes @ (T.p - c))), (frame,), (one_sided, False, False))])

    @classmethod
    def sphere(
        cls,
        *,
        center: ArrayLike,
        radius: float,
        inside: bool = False,
        one_sided: bool = True,
        frame: str | None = None,
    ) -> Self:
        """The tool's origin on a sphere: outside of it, or in its hollow."""
        c, r, sign = _three("center", center, "m"), _length("radius", radius), -1.0 if inside else 1.0
        return cls.of([_of_poses(lambda T: sign * (_size(T.p - c) - r), (frame,), one_sided)])

    @classmethod
    def cylinder(
        cls,
        *,
        point: ArrayLike,
        axis: ArrayLike,
        radius: float,
        inside: bool = False,
        one_sided: bool = True,
        frame: str | None = None,
    ) -> Self:
        """The tool's origin on a cylinder about an axis through a point: outside of it, or in its hollow."""
        c, u = _three("point", point, "m"), _unit("axis", axis)
        r, sign = _length("radius", radius), -1.0 if inside else 1.0

        def phi(T: Pose) -> Any:
            d = T.p - c
            return sign * (_size(d - (u @ d) * u) - r)

        return cls.of([_of_poses(phi, (frame,), one_sided)])

    @classmethod
    def line(cls, *, point: ArrayLike, direction: ArrayLike, frame: str | None = None) -> Self:
        """The tool's origin on a straight line, its rotation free: two rows."""
        c = _three("point", point, "m")
        e1, e2 = _across(_unit("direction", direction))
        return cls.of([_of_poses(lambda T: tm.array([e1 @ (T.p - c), e2 @ (T.p - c)]), (frame,), False)])

    @classmethod
    def hinge(cls, *, point: ArrayLike, axis: ArrayLike, T: Pose, frame: str | None = None) -> Self:
        """The tool turns about an axis only, as what holds the handle of a door does: five rows.

        Args:
            point: (3,) any point of the axis [m], in world axes.
            axis: (3,) its direction.
            T: A pose of the tool that it can be in.
            frame: The frame; the arm's tool if left out.
        """
        if not isinstance(T, Pose):  # callers without a type checker
            raise UsageError(f"T must be a taut.Pose, one that the hinge allows; got {type(T).__name__}", name="T")
        c, u = _three("point", point, "m"), _unit("axis", axis)
        own = T.inverse()
        c_E, u_E = own.R @ c + own.p, own.R @ u
        e1, e2 = _across(u)

        def phi(now: Pose) -> Array:
            turned = now.R @ u_E
            return tm.array([*(now.R @ c_E + now.p - c), e1 @ turned, e2 @ turned])

        return cls.of([_of_poses(phi, (frame,), False)])

    @classmethod
    def grasp(cls, first: str, second: str, *, T: Pose | None = None) -> Self:
        """Two frames hold one rigid body: a closed chain, cut open into the tree of the arm; six rows.

        Rows are along the axes of the first frame, so that lam stays what the body feels as it turns: the second hand
        applies the force and moment lam to it there, and the first one the opposite.

        Args:
            first: A frame.
            second: Another, on another branch.
            T: Pose of the second in the first; the two coincide if left out.
        """
        own = Pose() if T is None else T

        def phi(a: Pose, b: Pose) -> Array:
            seen = a.R.T @ b.R
            return tm.array([*(a.R.T @ (b.p - a.p) - own.p), *rotation_log(seen @ own.R.T)])

        return cls.of([_of_poses(phi, (first, second), False)])

    @classmethod
    def pin(
        cls, first: str, second: str, *, directions: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ) -> Self:
        """The origins of two frames coincide: the cut joint of a five-bar; one row for each direction.

        Args:
            first: A frame.
            second: Another, on another branch.
            directions: (k, 3) in which they coincide, in world axes; all three if left out, two for a planar chain.
        """
        rows = finite_array("directions", directions)
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise ShapeError(f"directions must be (k, 3); got shape {rows.shape}", name="directions")
        return cls.of([_of_poses(lambda a, b: tm.array(list(rows @ (b.p - a.p))), (first, second), False)])

    def __repr__(self) -> str:
        return f"Constraint({self.count} {'row' if self.count == 1 else 'rows'})"


# -------------------------------------------------------------------- of poses


def moved(T: Pose, step: Twist) -> Pose:
    """T after a small step of a world-aligned twist, to first order."""
    return Pose.of(T.R + tm.skew(step[3:]) @ T.R, T.p + step[:3])


@dataclass(frozen=True, kw_only=True, eq=False)
class _OfPoses:
    """phi of the poses of frames, and of time."""

    function: Callable[..., Any]
    frames: tuple[str | None, ...]
    timed: bool
    count: int
    one_sided: tuple[bool, ...]

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
        A = self._A(poses, t)
        twists = tm.array([entry for frame in self.frames for entry in x.twist(frame)])

        def along(times: Array) -> Vector:
            rate = 1.0 if self.timed else 0.0

            def again(more: Array) -> Vector:
                there = _each_moved(_each_moved(poses, times[0] * twists), more[0] * twists)
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

    def _A(self, poses: Sequence[Pose], t: Any) -> Matrix:
        zero = np.zeros(6 * len(self.frames))
        out: Matrix = tm.jacobian(lambda step: self.phi(_each_moved(poses, step), t), zero)
        return out

    def _phi_t(self, poses: Sequence[Pose], t: Any) -> Vector:
        out: Vector = np.zeros(self.count)
        if self.timed:
            out = tm.jacobian(lambda s: self.phi(poses, s[0]), tm.array([t]))[:, 0]
        return out

    def of_twist(self, T: Pose, t: Any) -> tuple[Matrix, Vector]:
        """A and dphi/dt at a pose of its one frame."""
        return self._A([T], t), self._phi_t([T], t)


def _each_moved(poses: Sequence[Pose], steps: Array) -> list[Pose]:
    return [moved(T, steps[6 * i : 6 * i + 6]) for i, T in enumerate(poses)]


def _through(A: Matrix, Js: Sequence[Matrix], rates: Sequence[Twist]) -> tuple[Matrix, Vector]:
    """A J and A J-dot v, summed over the frames."""
    A_q: Any = 0.0
    falling: Any = 0.0
    for i, (J, rate) in enumerate(zip(Js, rates, strict=True)):
        part = A[:, 6 * i : 6 * i + 6]
        A_q, falling = A_q + part @ J, falling + part @ rate
    return A_q, falling


def _of_poses(
    function: Callable[..., Any], frames: Sequence[str | None], one_sided: bool | Sequence[bool]
) -> _OfPoses:
    if isinstance(frames, str) or not frames or not all(f is None or isinstance(f, str) for f in frames):
        raise UsageError(
            f"frames must be names of frames, such as frames=('left_hand', 'right_hand'); got {frames!r}",
            name="frames",
        )
    timed = _arguments("function", function, len(frames))
    shapes, slopes = [], []
    for k in range(len(SOMEWHERE)):
        poses = [SOMEWHERE[(k + i) % len(SOMEWHERE)] for i in range(len(frames))]
        shapes.append(_shape(_result(function, (*poses, 0.3) if timed else tuple(poses))))
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
    return _OfPoses(
        function=function, frames=tuple(frames), timed=timed, count=shapes[0], one_sided=_sides(one_sided, shapes[0])
    )


def _slope(function: Callable[..., Any], poses: Sequence[Pose], timed: bool) -> Float64Array:
    def phi(step: Array) -> Vector:
        there = _each_moved(poses, step)
        value = function(*there, 0.3) if timed else function(*there)
        out: Vector = tm.array([value]) if np.ndim(value) == 0 else tm.array(list(value))
        return out

    return np.nan_to_num(np.asarray(tm.jacobian(phi, np.zeros(6 * len(poses))), dtype=np.float64), nan=1.0)


def _result(function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    value = function(*arguments)
    try:
        np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ShapeError(
            f"a constraint function must give a number or (k,) numbers; got {type(value).__name__}", name="function"
        ) from None
    return value


def _shape(value: Any) -> int:
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


def _arguments(name: str, function: object, poses: int, *, may_be_timed: bool = True) -> bool:
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
    takes = [
        p
        for p in inspect.signature(function).parameters.values()
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


def _sides(one_sided: bool | Sequence[bool], count: int) -> tuple[bool, ...]:
    sides = (one_sided,) * count if isinstance(one_sided, bool) else tuple(one_sided)
    if len(sides) != count or not all(isinstance(side, bool) for side in sides):
        raise ShapeError(
            f"one_sided must be True or False, or one for each of the {count} rows; got {one_sided!r}",
            name="one_sided",
        )
    return sides


# -------------------------------------------------------------------- of joints, and of velocities


@dataclass(frozen=True, kw_only=True, eq=False)
class _OfJoints:
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
        out: Vector = tm.array([value]) if np.ndim(value) == 0 else tm.array(list(value))
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
class _OfVelocity:
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
        return tm.array(rows)

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


# -------------------------------------------------------------------- small ones


def _joined(parts: Any) -> Vector:
    return tm.array([entry for part in parts for entry in part])


def _size(d: Vector) -> Any:
    return tm.sqrt(d @ d + NEVER)


def _three(name: str, value: ArrayLike, unit: str = "") -> Float64Array:
    return finite_array(name, value, shape=(3,), unit=unit)


def _length(name: str, value: float) -> float:
    number = float(finite_array(name, value, shape=(), unit="m"))
    if number <= 0.0:
        raise RangeError(f"{name} must be > 0 [m]; got {number:g}", name=name, value=number, rule="> 0")
    return number


def _unit(name: str, value: ArrayLike) -> Float64Array:
    vector = _three(name, value)
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise RangeError(f"{name} must have a length, as [0, 0, 1]; got {vector.tolist()}", name=name)
    return read_only(vector / length)


def _across(u: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Two directions that make a right-handed frame with u as its third: x and y where u is z."""
    start = np.eye(3)[int(np.argmin(np.abs(u)))] if abs(u[2]) < 1.0 - 1e-12 else np.array([1.0, 0.0, 0.0])
    e1 = start - (u @ start) * u
    e1 = e1 / np.linalg.norm(e1)
    return e1, np.cross(u, e1)
