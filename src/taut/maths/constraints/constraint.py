"""Constraint: what a contact, a hinge or a closed chain lets an arm do, from a function phi(T): section 10.4.1."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, Self

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, instance_of, positive_scalar, unit_vector
from taut.base.errors import ShapeError, UsageError
from taut.base.types import Array, ArrayLike, Float64Array
from taut.maths.constraints.rows import ConstraintRows, Piece, Surface, joined, of_joints, of_poses
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotation_log
from taut.trace import math as tm
from taut.trace.pose import Pose

MIN_SQUARE: Final = 1e-24  # [m^2] keeps a root from zero, where it has no slope


@dataclass(frozen=True, kw_only=True, init=False, eq=False)
class Constraint:
    """Constraint of the tool: phi(T) = 0, a function of its pose; natural constraints of section 10.4.1.

    Law:          phi(T, t) = 0;  A(T) V + d phi/dt = 0;  A V-dot + A-dot V + ... = 0            eqs. 10.39, 10.41
                  F_app = A^T lam is what the arm can apply against it: k forces, and n - k motions are free

    A one-sided row is a contact, phi >= 0: phi is positive on the free side, and lam < 0 presses. Two constraints add
    up: `Constraint.plane(...) + Constraint.plane(...)`.

    Args:
        function: Takes the Pose of the tool, or of each of `frames`, and if it has one more argument the time [s];
            gives a number or (k,) numbers, written with taut.math.
        frames: Frames whose poses it takes; the arm's tool alone if left out.
        one_sided: Whether the environment can only push; one for all rows, or one for each.

    Raises:
        UsageError: No function, a constant or a condition.
        ShapeError: Neither a number nor up to 6 of them.

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
    text: ClassVar[str] = ""  # the call that makes it, of a ready-made one

    def __init__(
        self,
        function: Callable[..., Any],
        *,
        frames: Sequence[str | None] = (None,),
        one_sided: bool | Sequence[bool] = False,
    ) -> None:
        object.__setattr__(self, "pieces", (of_poses(function, frames, one_sided),))

    @classmethod
    def of(cls, pieces: Sequence[Piece], text: str = "") -> Self:
        """A constraint of several functions at once; of constraints one writes `one + other`."""
        made = object.__new__(cls)
        made.__dict__.update(pieces=tuple(pieces), text=text)
        return made

    @property
    def count(self) -> int:
        """k, the number of rows."""
        return sum(piece.count for piece in self.pieces)

    @property
    def one_sided(self) -> tuple[bool, ...]:
        """(k,) true for rows phi >= 0."""
        return tuple(side for piece in self.pieces for side in piece.one_sided)

    @property
    def moments(self) -> tuple[bool, ...]:
        """(k,) true for rows that hold rotations only, whose multipliers are moments."""
        return tuple(moment for piece in self.pieces for moment in piece.moments)

    @property
    def surface(self) -> bool:
        """The first row can be pressed against: one-sided, or of poses alone, then positive on the free side."""
        first = self.pieces[0]
        return self.one_sided[0] or (bool(first.frames) and first.count == 1 and not first.pfaffian)

    @property
    def frame(self) -> tuple[str | None] | None:
        """The one frame that it is a function of, in a tuple; None where there are several, or joints.

        Parts of the arm's tool, which is not named, and of a named frame count as one: it must be the tool's.
        """
        if any(len(piece.frames) != 1 for piece in self.pieces):
            return None
        names = {piece.frames[0] for piece in self.pieces}
        if len(names) > 1:
            names.discard(None)
        return (names.pop(),) if len(names) == 1 else None

    def at(self, x: Snapshot) -> ConstraintRows:
        """Its rows at the state, and the time, of a snapshot.

        Raises:
            UsageError: Parts of the tool beside parts of another frame.
        """
        if self.frame not in (None, (None,)) and any(piece.frames == (None,) for piece in self.pieces):
            self._check_tool(x.arm)
        parts = [piece.at(x) for piece in self.pieces]
        if len(parts) == 1:
            return parts[0]
        single = self.frame is not None
        return ConstraintRows(
            phi=joined(part.phi for part in parts),
            A=tm.array([row for part in parts if part.A is not None for row in part.A]) if single else None,
            A_q=tm.array([row for part in parts for row in part.A_q]),
            phi_t=joined(part.phi_t for part in parts),
            bias=joined(part.bias for part in parts),
            curvature=joined(part.curvature for part in parts),
            one_sided=self.one_sided,
        )

    def _check_tool(self, arm: Arm) -> None:
        assert self.frame is not None
        if self.frame[0] != arm.tool:
            raise UsageError(
                f"a part of the constraint is of the arm's tool, which is '{arm.tool}', and another of "
                f"'{self.frame[0]}'; say frame='{arm.tool}' where the tool is meant",
                name="frame",
            )

    def of_pose(self, T: Pose, t: float = 0.0) -> Float64Array:
        """(k,) phi of a pose of the one frame that it is a function of; zero for constraints of velocities."""
        assert self.frame is not None
        return np.concatenate([np.asarray(piece.phi([T], t), dtype=np.float64) for piece in self.pieces])

    def of_twist(self, T: Pose, t: float = 0.0) -> tuple[Float64Array, Float64Array]:
        """A (k, 6) per world-aligned twist of the one frame that it is a function of, at a pose; and dphi/dt (k,)."""
        assert self.frame is not None
        A = [np.asarray(piece.slope([T], t), dtype=np.float64) for piece in self.pieces]
        return np.concatenate(A), np.concatenate([np.asarray(p.phi_t([T], t), dtype=np.float64) for p in self.pieces])

    def __add__(self, other: Constraint) -> Constraint:
        if not isinstance(other, Constraint):
            return NotImplemented
        text = f"{self.text} + {other.text}" if self.text and other.text else ""
        return Constraint.of((*self.pieces, *other.pieces), text)

    @classmethod
    def of_joints(
        cls, function: Callable[..., Any], *, rows: int = 1, one_sided: bool | Sequence[bool] = False
    ) -> Self:
        """phi(q) = 0, a function of the joints, or of joints and time: A(q) v = 0 by differentiation.

        Args:
            function: Takes (n,) joint positions, and if it has two arguments the time; gives `rows` numbers.
            rows: Number of rows.
            one_sided: As for a constraint of the pose.
        """
        return cls.of([of_joints(function, rows, one_sided)])

    @classmethod
    def pfaffian_of_joints(cls, function: Callable[..., Any], *, rows: int = 1) -> Self:
        """A(q) v = 0, a constraint of joint speeds that need not come from a phi.

        Args:
            function: Takes (n,) joint positions and gives A, (n,) or (rows, n), per joint speed.
            rows: Number of rows.

        Example:
            >>> import taut
            >>> geared = Constraint.pfaffian_of_joints(lambda q: [1.0, -2.0])  # v_1 = 2 v_2
            >>> geared.at(taut.snapshot(taut.load_arm("planar2"), [0.1, 0.2])).A_q.tolist()
            [[1.0, -2.0]]
        """
        return cls.of([of_joints(function, rows, pfaffian=True)])

    @classmethod
    def pfaffian(cls, function: Callable[[Pose], Any], *, frame: str | None = None) -> Self:
        """A(T) V = 0, a constraint of velocities that need not come from a phi: a wheel, a knife edge.

        Args:
            function: Takes the Pose of the tool and gives A, (6,) or (k, 6), per twist in world axes at its origin.
            frame: The frame; the arm's tool if left out.
        """
        return cls.of([of_poses(function, (frame,), pfaffian=True)])

    @classmethod
    def knife_edge(cls, *, sideways: ArrayLike, frame: str | None = None) -> Self:
        """A wheel or a knife edge at the tool's origin, which does not slip sideways: one row, of velocities.

        It goes anywhere by steering, and has no phi. On a plane it leaves two motions: ahead, and about the normal.

        Args:
            sideways: (3,) the wheel's axle, or the normal of the blade, in the tool's axes.
            frame: The frame; the arm's tool if left out.
        """
        side = unit_vector("sideways", sideways)
        return cls.of([of_poses(partial(_sideways, side), (frame,), pfaffian=True)], _call(cls.knife_edge, locals()))

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
            one_sided: Whether it only pushes; the rows of a face act both ways.
            velocity: (3,) of the plane [m/s].
            sway: (3,) amplitude of its oscillation, sway (1 - cos(2 pi t / period)) / 2 [m].
            period: Of that oscillation [s].
            frame: The frame; the arm's tool if left out.
        """
        p, n = _three("point", point, "m"), unit_vector("normal", normal)
        speed, half = float(n @ _three("velocity", velocity, "m/s")), 0.5 * float(n @ _three("sway", sway, "m"))
        omega = 2.0 * np.pi / positive_scalar("period", period, unit="s")
        flat = None if face is None else unit_vector("face", face)
        displacement = partial(_displacement, speed, half, omega) if speed or half else None
        surface = Surface(kind="plane", point=p, axis=n, displacement=displacement)
        each = one_sided if face is None else (one_sided, False, False)
        at_rest: dict[str, Any] = {} if displacement else {"t": 0.0}
        phi = partial(_on_plane, p, n, flat, displacement, **at_rest)
        return cls.of([of_poses(phi, (frame,), each, surface=surface)], _call(cls.plane, locals()))

    @classmethod
    def point(
        cls,
        *,
        point: ArrayLike,
        normal: ArrayLike = (0.0, 0.0, 1.0),
        one_sided: bool = True,
        frame: str | None = None,
    ) -> Self:
        """The tool's origin at a point of a surface, its rotation free: chalk that sticks.

        Three rows: the first is that of the surface, the other two are what friction holds, within its cone.

        Args:
            point: (3,) where it sticks [m], in world axes.
            normal: (3,) direction of the surface towards free space, of any length.
            one_sided: Whether the surface only pushes.
            frame: The frame; the arm's tool if left out.
        """
        c, n = _three("point", point, "m"), unit_vector("normal", normal)
        axes, surface = np.array([n, *_across(n)]), Surface(kind="plane", point=c, axis=n)
        phi, sides = partial(_apart, axes, Pose(c)), (one_sided, False, False)
        return cls.of([of_poses(phi, (frame,), sides, surface=surface)], _call(cls.point, locals()))

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
        c, r = _three("center", center, "m"), positive_scalar("radius", radius, unit="m")
        sign, surface = -1.0 if inside else 1.0, Surface(kind="sphere", point=c, radius=r, inside=inside)
        phi = partial(_from_axis, c, np.zeros(3), r, sign)
        return cls.of([of_poses(phi, (frame,), one_sided, surface=surface)], _call(cls.sphere, locals()))

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
        c, u, r = _three("point", point, "m"), unit_vector("axis", axis), positive_scalar("radius", radius, unit="m")
        sign, surface = -1.0 if inside else 1.0, Surface(kind="cylinder", point=c, axis=u, radius=r, inside=inside)
        phi = partial(_from_axis, c, u, r, sign)
        return cls.of([of_poses(phi, (frame,), one_sided, surface=surface)], _call(cls.cylinder, locals()))

    @classmethod
    def line(cls, *, point: ArrayLike, axis: ArrayLike, frame: str | None = None) -> Self:
        """The tool's origin on a straight line through a point, along an axis, its rotation free: two rows."""
        c, axes = _three("point", point, "m"), np.array(_across(unit_vector("axis", axis)))
        return cls.of([of_poses(partial(_apart, axes, Pose(c)), (frame,))], _call(cls.line, locals()))

    @classmethod
    def hinge(cls, *, point: ArrayLike, axis: ArrayLike, T: Pose, frame: str | None = None) -> Self:
        """The tool rotates about an axis only, as the handle of a door does: five rows.

        Args:
            point: (3,) any point of the axis [m], in world axes.
            axis: (3,) its direction.
            T: A pose of the tool that it can be in.
            frame: The frame; the arm's tool if left out.
        """
        instance_of("T", T, Pose, "a taut.Pose, one that the hinge allows")
        c, u, own = _three("point", point, "m"), unit_vector("axis", axis), T.inverse()
        phi = partial(_hinged, c, _across(u), own.R @ c + own.p, own.R @ u)
        return cls.of([of_poses(phi, (frame,))], _call(cls.hinge, locals()))

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
        instance_of("T", T, Pose | None, "a taut.Pose, of the second frame in the first")
        phi = partial(_grasped, Pose() if T is None else T)
        return cls.of([of_poses(phi, (first, second))], _call(cls.grasp, locals()))

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
        return cls.of([of_poses(partial(_apart, rows), (first, second))], _call(cls.pin, locals()))

    def __repr__(self) -> str:
        return self.text or f"Constraint({self.count} {'row' if self.count == 1 else 'rows'})"


def _call(make: Callable[..., Any], scope: Mapping[str, Any]) -> str:
    """The call of a ready-made constraint, with its arguments in the scope, by which it can be made again."""
    words = {name: repr(np.asarray(scope[name]).tolist()) for name in inspect.signature(make).parameters}
    if isinstance(T := scope.get("T"), Pose):
        words["T"] = f"Pose.of(R={T.R.tolist()}, p={T.p.tolist()})"
    return f"Constraint.{make.__name__}({', '.join(f'{name}={word}' for name, word in words.items())})"


def _three(name: str, value: ArrayLike, unit: str = "") -> Float64Array:
    return finite_array(name, value, shape=(3,), unit=unit)


# The functions of the ready-made constraints. Their data stand first, so that a partial of one can be pickled.


def _sideways(side: Float64Array, T: Pose) -> Array:
    return tm.array([*(T.R @ side), 0.0, 0.0, 0.0])


def _displacement(speed: float, half: float, omega: float, t: Any) -> Any:
    return speed * t + half * (1.0 - tm.cos(omega * t))


def _on_plane(p: Float64Array, n: Float64Array, flat: Any, displacement: Any, T: Pose, t: Any) -> Array:
    rows, (e1, e2) = [n @ (T.p - p) - (displacement(t) if displacement else 0.0)], _across(n)
    if flat is not None:
        looks = -(T.R @ flat)
        # The rates of these rows at phi = 0 are the two rotations that tilt the face.
        rows += [-(e2 @ looks), e1 @ looks]
    return tm.array(rows)


def _from_axis(c: Float64Array, u: Float64Array, r: float, sign: float, T: Pose) -> Any:
    d = T.p - c
    across = d - (u @ d) * u
    return sign * (tm.sqrt(across @ across + MIN_SQUARE) - r)


def _hinged(c: Float64Array, axes: Any, c_E: Float64Array, u_E: Float64Array, T: Pose) -> Array:
    u = T.R @ u_E
    return tm.array([*(T.R @ c_E + T.p - c), axes[0] @ u, axes[1] @ u])


def _grasped(own: Pose, a: Pose, b: Pose) -> Array:
    return tm.array([*(a.R.T @ (b.p - a.p) - own.p), *rotation_log(a.R.T @ b.R @ own.R.T)])


def _apart(rows: Float64Array, a: Pose, b: Pose) -> Array:
    return tm.array(list(rows @ (b.p - a.p)))


def _across(u: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Two directions that make a right-handed frame with u as its third: x and y where u is z."""
    start = np.eye(3)[int(np.argmin(np.abs(u)))] if abs(u[2]) < 1.0 - 1e-12 else np.array([1.0, 0.0, 0.0])
    e1 = start - (u @ start) * u
    e1 = e1 / np.linalg.norm(e1)
    return e1, np.cross(u, e1)
