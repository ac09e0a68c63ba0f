"""Natural and artificial constraints of a rigid contact: section 10.4.1."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.analysis.constraints.specification import linear_sum
from taut.base.checks import finite_array, finite_scalar, one_of, read_only
from taut.base.errors import RangeError, UsageError, count_of
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import Snapshot
from taut.trace.math import skew
from taut.trace.pose import Pose

__all__ = [
    "ConstraintRow", "ConstraintTable", "ForceMotionCheck", "FrictionMargin", "Violation", "natural_constraints",
]  # fmt: skip

Mode = Literal["slide", "stick", "apart"]
MODES: Final[tuple[Mode, ...]] = ("slide", "stick", "apart")
AXES: Final = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
ROTATIONS_FIRST: Final = (3, 4, 5, 0, 1, 2)  # as in the chapter's table
ON_SURFACE: Final = 1e-6  # [m, rad] of phi
ON_LINE: Final = 1e-6  # [m] from the frame's origin to the line of a contact force
ROUNDING: Final = 1e-9  # of rows of length 1: less is zero, and such rows are dependent
VIOLATION: Final = 1e-6  # of the largest number of the motion, or of the forces
REACH: Final = 1e-6  # of the Jacobian: below it the joints cannot move the tool


@dataclass(frozen=True, kw_only=True)
class ConstraintRow:
    """One axis of the task frame.

    Args:
        axis: Its name, such as "phi_x".
        index: Of the axis, linear part first.
        free: Whether its motion or its force is free.
        natural: The natural constraint, as "phi_x-dot = 0".
        artificial: The free quantity, of which an artificial constraint gives the value, as "F_phi_x".
    """

    axis: str
    index: int
    free: Literal["motion", "force"]
    natural: str
    artificial: str


@dataclass(frozen=True, kw_only=True)
class FrictionMargin:
    """Distance of a wrench to the friction cone of a contact.

    Args:
        pressing: Force into the surface [N].
        tangential: Force along it [N].
        friction: Coefficient mu.
    """

    pressing: float
    tangential: float
    friction: float

    @property
    def max_tangential(self) -> float:
        """Largest tangential force at which the contact sticks [N]."""
        return self.friction * max(self.pressing, 0.0)

    @property
    def margin(self) -> float:
        """`max_tangential` less the tangential force [N]: below 0 outside the cone."""
        return self.max_tangential - self.tangential


@dataclass(frozen=True, kw_only=True)
class Violation:
    """A motion or a force that violates a constraint.

    Args:
        quantity: A motion or a force along an axis, or a sum of them.
        value: Its specified value.
        rule: What the constraint says of it, as "= 0".
        reason: Where the rule comes from.
    """

    quantity: str
    value: float
    rule: str
    reason: str

    def __str__(self) -> str:
        return f"{self.quantity} = {self.value:.4g} violates {self.quantity} {self.rule}: {self.reason}"


@dataclass(frozen=True, kw_only=True)
class ForceMotionCheck(Result):
    """Check of a motion and of forces that are specified together against a rigid contact.

    Args:
        violations: The constraints that are violated; none where the specification is admissible.
        cones: Of each contact that sticks: the distance of the forces to its friction cone.
    """

    violations: tuple[Violation, ...]
    cones: tuple[FrictionMargin, ...]

    @property
    def ok(self) -> bool:
        """The motion and the forces are admissible together."""
        return not self.violations

    def content(self) -> Content:
        """The violations, and the margins of the friction cones."""
        heads = ("into the surface [N]", "along it [N]", "friction", "margin [N]")
        rows = [(cone.pressing, cone.tangential, cone.friction, cone.margin) for cone in self.cones]
        return Content(
            title="motion and forces against the contact",
            faults=[str(each) for each in self.violations],
            summary=["admissible"] if self.ok else [],
            tables=[Table(title="friction cones", columns=heads, rows=rows)] if rows else [],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstraintTable(Result):
    """Natural and artificial constraints at one pose.

    Args:
        mode: Of its contacts: "slide", "stick" or "apart".
        friction: Coefficient mu of them.
        frame: The task frame in the world; None for constraints of joints or of several frames.
        names: (m,) of the axes: of the task frame, or the joints.
        A: (k, m) natural constraints A V + phi_t = 0, of the tool's twist in world axes, or of the joint velocities;
            those of sticking, two for each contact, below those of the constraint.
        phi_t: (k,) d phi / dt of a surface that moves.
        numbers: Of the constraint's rows, those that are in A, in that order.
        unilateral: (k,) whether a row is that of a contact, which can be pressed and not pulled.
        contacts: Rows of the contacts with friction.
        to_task: (m, m) from V to the motion along the axes.
        solved: (r, m) A V = right along the axes, with a unit matrix in the columns `constrained`.
        right: (r,) velocities that the constraint prescribes.
        constrained: (r,) axes whose motion is constrained and whose force is free.
        notes: Sentences about this pose.
    """

    mode: Mode
    friction: float
    frame: Pose | None
    names: tuple[str, ...]
    A: Float64Array
    phi_t: Float64Array
    numbers: tuple[int, ...]
    unilateral: tuple[bool, ...]
    contacts: tuple[int, ...]
    to_task: Float64Array
    solved: Float64Array
    right: Float64Array
    constrained: tuple[int, ...]
    notes: tuple[str, ...] = ()

    @property
    def free(self) -> tuple[int, ...]:
        """Axes whose motion is free."""
        return tuple(i for i in range(len(self.names)) if i not in self.constrained)

    @property
    def motions(self) -> int:
        """Number of free motions."""
        return len(self.free)

    @property
    def forces(self) -> int:
        """Number of free forces."""
        return len(self.constrained)

    @property
    def N(self) -> Float64Array:
        """(m, motions) a basis of ker A, per V as `A`; without friction N^T F_app = 0."""
        return read_only(np.linalg.solve(self.to_task, self._N))

    @property
    def _N(self) -> Float64Array:
        """(m, motions) the same along the axes, with the motions along `free` as coordinates."""
        N = np.zeros((len(self.names), self.motions))
        N[list(self.free)] = np.eye(self.motions)
        N[list(self.constrained)] = -self.solved[:, list(self.free)]
        return N

    @property
    def rows(self) -> tuple[ConstraintRow, ...]:
        """One for each axis, in the order of the chapter's table."""
        rows = {}
        for axis, row, right in zip(self.constrained, self.solved, self.right, strict=True):
            rows[axis] = f"{linear_sum(row, self._motions)} = {_digits(right)}", self._forces[axis]
        for axis, column, friction in zip(self.free, self._N.T, self._friction_along_free_axes(), strict=True):
            right_side = "friction" if friction else "0"
            rows[axis] = f"{linear_sum(column, self._forces)} = {right_side}", self._motions[axis]
        return tuple(
            ConstraintRow(
                axis=self.names[axis], index=axis, free="force" if axis in self.constrained else "motion",
                natural=rows[axis][0], artificial=rows[axis][1],
            )
            for axis in (range(len(self.names)) if self.frame is None else ROTATIONS_FIRST)
        )  # fmt: skip

    def table(self, V: ArrayLike | None = None, F_app: ArrayLike | None = None) -> Table:
        """The chapter's table, with k1, k2, ... for the values of the artificial constraints, or with numbers.

        Args:
            V: (6,) twist of the tool in world axes [m/s, rad/s], whose free parts stand in the table.
            F_app: (6,) wrench of the arm on the environment at the tool, in world axes, likewise [N, N m].
        """
        m = len(self.names)
        motion = None if V is None else self.to_task @ finite_array("V", V, shape=(m,))
        force = None if F_app is None else np.linalg.solve(self.to_task.T, finite_array("F_app", F_app, shape=(m,)))
        cells = []
        for i, row in enumerate(self.rows):
            values = motion if row.free == "motion" else force
            number = f"k{i + 1}" if values is None else _digits(values[row.index])
            cells.append((row.natural, f"{row.artificial} = {number}"))
        return Table(columns=("natural", "artificial"), rows=cells)

    def content(self) -> Content:
        """The numbers of free motions and forces, the table, and notes on the pose."""
        state = {"stick": "sticking", "apart": "apart"}.get(
            self.mode, "in contact" if any(self.unilateral) else "constrained"
        )
        freedoms = f"{count_of(self.motions, 'free motion')} and {count_of(self.forces, 'free force')}"
        return Content(title=f"{state}: {freedoms}", tables=[self.table()], notes=self.notes)

    def check(
        self, motion: TaskMotion | ArrayLike | None = None, *, F_app: ArrayLike | None = None
    ) -> ForceMotionCheck:
        """Check of a motion and of forces that are specified together, in this mode.

        Args:
            motion: A sample for the tool, of which the twist counts; or V, (6,) twist of the tool in world axes
                [m/s, rad/s], (n,) joint velocities for a constraint of joints.
            F_app: (6,) wrench of the arm on the environment at the tool, in world axes [N, N m]: A^T lam of
                multipliers lam; (n,) torques for a constraint of joints.

        Raises:
            UsageError: Neither a motion nor forces.
            ShapeError, RangeError: Other sizes, numbers that are not finite.

        Example:
            >>> import taut
            >>> board = taut.Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
            >>> chalk = taut.analysis.natural_constraints(board, at=taut.Pose([0.4, 0.1, 0.0]))
            >>> chalk.check([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], F_app=[0.0, 0.0, -5.0, 0.0, 0.0, 0.0]).ok
            True
            >>> print(chalk.check(F_app=[2.0, 0.0, -5.0, 0.0, 0.0, 0.0]).violations[0])
            F_x = 2 violates F_x = 0: natural constraint, x-dot is free
        """
        m = len(self.names)
        if motion is None and F_app is None:
            raise UsageError("check takes a motion, forces, or both; got none", name="motion")
        violations: list[Violation] = []
        if motion is not None:
            twist = motion.twist if isinstance(motion, TaskMotion) else motion
            violations += self._of_motion(finite_array("motion", twist, shape=(m,)))
        cones: tuple[FrictionMargin, ...] = ()
        if F_app is not None:
            wrench = finite_array("F_app", F_app, shape=(m,), unit="N, N m")
            lam = np.asarray(np.linalg.pinv(self.A.T) @ wrench)
            cones = self._cones(lam) if self.mode == "stick" else ()
            violations += [*self._of_forces(wrench), *self._of_contacts(lam, cones, float(np.abs(wrench).max()))]
        return ForceMotionCheck(violations=tuple(violations), cones=cones)

    # ---------------------------------------------------------------- its parts

    @property
    def _motions(self) -> list[str]:
        return [f"{name}-dot" for name in self.names]

    @property
    def _forces(self) -> list[str]:
        return [f"{'tau' if self.frame is None else 'F'}_{name}" for name in self.names]

    def _friction_along_free_axes(self) -> list[bool]:
        """Whether friction of sliding contacts acts along each free axis."""
        sliding = self.contacts if self.mode == "slide" else ()
        along = [np.abs(_tangents(self.A[i]) @ self.N).max(axis=0) for i in sliding]
        return [bool(x > ROUNDING) for x in np.max(along, axis=0)] if along else [False] * self.motions

    def _of_motion(self, V: Float64Array) -> Iterator[Violation]:
        along = self.to_task @ V
        values = self.solved @ along
        largest = max(float(np.abs(along).max()), float(np.abs(self.right).max(initial=0.0)))
        for row, value, right, axis in zip(self.solved, values, self.right, self.constrained, strict=True):
            if abs(value - right) > VIOLATION * largest:
                yield Violation(
                    quantity=linear_sum(row, self._motions), value=float(value), rule=f"= {_digits(right)}",
                    reason=f"natural constraint, {self._forces[axis]} is free",
                )  # fmt: skip

    def _of_forces(self, F_app: Float64Array) -> Iterator[Violation]:
        along = np.linalg.solve(self.to_task.T, F_app)
        values, largest = self._N.T @ along, float(np.abs(along).max())
        for column, value, axis, friction in zip(
            self._N.T, values, self.free, self._friction_along_free_axes(), strict=True
        ):
            if abs(value) > VIOLATION * largest:
                reason = "the contact slides" if friction else "natural constraint"
                yield Violation(
                    quantity=linear_sum(column, self._forces), value=float(value),
                    rule="= friction" if friction else "= 0", reason=f"{reason}, {self._motions[axis]} is free",
                )  # fmt: skip

    def _of_contacts(
        self, lam: Float64Array, cones: tuple[FrictionMargin, ...], largest: float
    ) -> Iterator[Violation]:
        for i in np.flatnonzero(self.unilateral):
            if lam[i] > VIOLATION * largest:
                yield Violation(
                    quantity=f"lam[{self.numbers[i]}]", value=float(lam[i]), rule="<= 0",
                    reason="a contact can be pressed and not pulled",
                )  # fmt: skip
        for cone in cones:
            if cone.margin < -VIOLATION * largest:
                yield Violation(
                    quantity="tangential force", value=cone.tangential, rule=f"<= {cone.max_tangential:.4g}",
                    reason=f"outside the friction cone of {cone.friction:g} * {cone.pressing:.4g} N",
                )  # fmt: skip

    def _cones(self, lam: Float64Array) -> tuple[FrictionMargin, ...]:
        tangential = np.linalg.norm(lam[len(self.numbers) :].reshape(-1, 2), axis=1)
        return tuple(
            FrictionMargin(
                pressing=float(-lam[i] * np.linalg.norm(self.A[i, :3])), tangential=float(t), friction=self.friction
            )
            for i, t in zip(self.contacts, tangential, strict=True)
        )


def natural_constraints(
    constraint: Constraint,
    *,
    at: Pose | Snapshot,
    frame: Pose | None = None,
    mode: Mode = "slide",
    friction: float = 0.0,
) -> ConstraintTable:
    """Natural constraints of a rigid contact, and the artificial constraints that may be added to them.

    Law:          natural:    A V + d phi/dt = 0, and without friction N^T F_app = 0, with N a basis of ker A
                  artificial: as many motions u, V = N u, and forces lam, F_app = A^T lam: n together  section 10.4.1

    Where the axes of the task frame are well chosen, either the motion or the force is free along each of them: for a
    door with its origin on the hinge. Else a row has a sum of motions or of forces, as for a screw in every frame. A
    constraint of joints or of several frames has its rows along the joints.

    A contact (a unilateral row) has three modes. "slide" takes it for an equality, as the chapter does; its friction
    is not free. "stick" constrains the contact point along the surface too, while the force along it is inside the
    friction cone: 3 + 3 for a chalk. "apart" has no row of the contact: 6 + 0. Friction acts at the origin of the
    constrained frame, with no moment about the normal, and the surface does not move sideways.

    Args:
        constraint: The constraint.
        at: A pose of the constrained frame, or a snapshot of the arm.
        frame: The task frame in the world; at the tool's origin if left out, with the world's axes, or the tool's
            where each constraint is along one of these.
        mode: "slide", "stick" or "apart".
        friction: Coefficient mu of the contacts, at least 0.

    Raises:
        UsageError: No constraint, a pose for one of joints; a mode without a contact, sticking without friction.
        RangeError: A row without a gradient there; friction below 0; a contact that does not press on the origin.

    Example:
        >>> import taut
        >>> board = taut.Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], face=[0.0, 0.0, -1.0])
        >>> print(taut.analysis.natural_constraints(board, at=taut.Pose([0.4, 0.1, 0.0])))
        in contact: 3 free motions and 3 free forces
        natural        artificial
        phi_x-dot = 0  F_phi_x = k1
        phi_y-dot = 0  F_phi_y = k2
        F_phi_z = 0    phi_z-dot = k3
        F_x = 0        x-dot = k4
        F_y = 0        y-dot = k5
        z-dot = 0      F_z = k6
        task frame: the world's axes, at the tool's origin
        the contact can be pressed and not pulled: F_z <= 0

    References:
        Section 10.4.1 natural and artificial constraints. Mason (1981), IEEE Transactions on Systems, Man, and
        Cybernetics 11 (6).
    """
    if not isinstance(constraint, Constraint):  # callers without a type checker
        raise UsageError(
            f"natural_constraints takes a taut.Constraint; got {type(constraint).__name__}", name="constraint"
        )
    one_of("mode", mode, MODES)
    mu = finite_scalar("friction", friction, minimum=0.0)
    if mode == "stick" and not mu:
        raise UsageError("mode='stick' needs a coefficient of friction, such as friction=0.3", name="friction")
    if mode != "slide" and not any(constraint.one_sided):
        raise UsageError(
            f"mode='{mode}' is for a contact, and no row of this constraint is one: say one_sided=True", name="mode"
        )
    if frame is not None and not isinstance(frame, Pose):
        raise UsageError(f"frame must be a taut.Pose; got {frame!r}", name="frame")
    A, phi_t, phi, T = _rows_of(constraint, at)
    if T is None and (frame is not None or mu):
        name = "friction" if frame is None else "frame"
        raise UsageError(
            f"{name} is for a constraint of the tool, and this one is of joints or of several frames", name=name
        )
    numbers = _acting_rows(mode, constraint)
    A, unilateral = A[numbers], [constraint.one_sided[i] for i in numbers]
    contacts = tuple(i for i, row in enumerate(A) if unilateral[i] and _pushes(row)) if mu else ()
    if mu and mode != "apart" and not contacts:
        raise UsageError(
            "friction is for a contact with a force, and no row of this constraint is one: say one_sided=True, or "
            "leave it out",
            name="friction",
        )
    sticking = [_tangents(A[i]) for i in contacts] if mode == "stick" else []
    A = np.vstack([A, *sticking])
    phi_t = np.append(phi_t[numbers], np.zeros(2 * len(sticking)))
    rows = _row_space(A)
    axes = []
    if T is not None and frame is None:
        world, tool = Pose(T.p), Pose.of(T.R, T.p)
        of_tool = not _has_single_axes(rows, world, T) and _has_single_axes(rows, tool, T)
        frame, whose = (tool, "tool") if of_tool else (world, "world")
        axes = [f"task frame: the {whose}'s axes, at the tool's origin"]
    to_task = np.eye(A.shape[1]) if T is None or frame is None else _twist_to(frame, T)
    prescribed = rows @ np.linalg.lstsq(A, -phi_t, rcond=None)[0] if len(A) else np.zeros(0)
    solved, right, constrained = _solved(rows @ np.linalg.inv(to_task), prescribed)
    table = ConstraintTable(
        mode=mode,
        friction=mu,
        frame=frame,
        names=at.arm.joint_names if T is None and isinstance(at, Snapshot) else AXES,
        A=read_only(A),
        phi_t=read_only(phi_t),
        numbers=tuple(numbers),
        unilateral=(*unilateral, *[False] * (len(A) - len(numbers))),
        contacts=contacts,
        to_task=read_only(to_task),
        solved=read_only(solved),
        right=read_only(right),
        constrained=constrained,
    )
    return dataclasses.replace(table, notes=(*axes, *_notes(table, constraint, at, phi)))


# -------------------------------------------------------------------- rows and contacts


def _rows_of(
    constraint: Constraint, at: Pose | Snapshot
) -> tuple[Float64Array, Float64Array, Float64Array, Pose | None]:
    """A, phi_t and phi of a constraint, and the pose of its frame."""
    T: Pose | None
    if isinstance(at, Snapshot):
        rows = constraint.at(at)
        T = None if constraint.frame is None else at.T(constraint.frame[0])
        matrices = (rows.A_q if T is None else rows.A, rows.phi_t, rows.phi)
        A, phi_t, phi = (np.asarray(each, dtype=np.float64) for each in matrices)
    elif isinstance(at, Pose):
        if constraint.frame is None:
            raise UsageError(
                "a constraint of joints or of several frames needs the whole arm: at=taut.snapshot(arm, q)", name="at"
            )
        A, phi_t = constraint.of_twist(at, 0.0)
        phi, T = constraint.of_pose(at, 0.0), at
    else:
        raise UsageError(f"at must be a taut.Pose or a taut.snapshot(arm, q); got {type(at).__name__}", name="at")
    for row, size in enumerate(np.linalg.norm(A, axis=1)):
        if not size > ROUNDING:  # zero, or not a number
            raise RangeError(
                f"row {row} of the constraint must have a gradient; it is {size:g} there; take another pose",
                name="constraint",
                value=float(size),
            )
    return A, phi_t, phi, T


def _acting_rows(mode: Mode, constraint: Constraint) -> list[int]:
    """The rows that act: apart, none of what belongs to a contact."""
    of_contact = [any(piece.one_sided) for piece in constraint.pieces for _ in range(piece.count)]
    return [i for i, contact in enumerate(of_contact) if mode != "apart" or not contact]


def _pushes(row: Float64Array) -> bool:
    """Whether a row of A (6,) has a force.

    Raises:
        RangeError: Its line does not pass through the origin of the frame.
    """
    size = float(np.linalg.norm(row[:3]))
    if size < ROUNDING:
        return False
    off = float(np.linalg.norm(row[3:])) / size
    if off > ON_LINE:
        raise RangeError(
            "friction needs the contact at the origin of the constrained frame; the line of its force passes it at "
            f"{off:.4g} m; give the constraint the frame that touches",
            name="friction",
            value=off,
        )
    return True


def _tangents(row: Float64Array) -> Float64Array:
    """(2, 6) rows of the velocity of the origin along a surface, from its row of A."""
    left, _, _ = np.linalg.svd(row[:3, np.newaxis])
    return np.concatenate([left[:, 1:].T, np.zeros((2, 3))], axis=1)


# -------------------------------------------------------------------- along the axes of the task frame


def _twist_to(frame: Pose, T: Pose) -> Float64Array:
    """(6, 6) from the twist of a body at T, in world axes, to its twist at the origin of a frame, in its axes."""
    shift = np.eye(6)
    shift[:3, 3:] = -skew(np.asarray(frame.p, dtype=np.float64) - np.asarray(T.p))
    return np.asarray(np.kron(np.eye(2), np.asarray(frame.R, dtype=np.float64).T) @ shift)


def _row_space(A: Float64Array) -> Float64Array:
    """(r, m) orthonormal rows that span those of A (k, m)."""
    if not len(A):
        return A
    _, values, rows = np.linalg.svd(A / np.linalg.norm(A, axis=1)[:, np.newaxis], full_matrices=False)
    return np.asarray(rows[values > ROUNDING * values[0]])


def _has_single_axes(rows: Float64Array, frame: Pose, T: Pose) -> bool:
    """Whether rows constrain axes of a frame one by one."""
    along = _row_space(rows @ np.linalg.inv(_twist_to(frame, T)))
    projector = along.T @ along
    return bool(np.all(np.abs(projector - np.round(projector)) < ROUNDING))


def _solved(rows: Float64Array, right: Float64Array) -> tuple[Float64Array, Float64Array, tuple[int, ...]]:
    """rows V = right solved for as many entries of V: (r, m) with a unit matrix in some columns, and those columns.

    The columns are those of the largest numbers, so that a constraint along an axis has that axis alone in its row.
    """
    A, c = rows.copy(), right.copy()
    pivots: list[int] = []
    for i in range(len(A)):
        row, column = divmod(int(np.argmax(np.round(np.abs(A[i:]), 12))), A.shape[1])
        A[[i, i + row]], c[[i, i + row]] = A[[i + row, i]], c[[i + row, i]]
        c[i], A[i] = c[i] / A[i, column], A[i] / A[i, column]
        others = np.arange(len(A)) != i
        factors = A[others, column]
        A[others] -= np.outer(factors, A[i])
        c[others] -= factors * c[i]
        pivots.append(column)
    order = np.argsort(pivots)
    A, c = (np.where(np.abs(x) < ROUNDING, 0.0, x) for x in (A[order], c[order]))
    return A, c, tuple(sorted(pivots))


# -------------------------------------------------------------------- notes


def _notes(table: ConstraintTable, constraint: Constraint, at: Pose | Snapshot, phi: Float64Array) -> Iterator[str]:
    """The signs of contact forces, and peculiarities of the pose."""
    for i in np.flatnonzero(table.unilateral):
        pulling = np.linalg.solve(table.to_task.T, table.A[i])
        axes = np.flatnonzero(np.abs(pulling) > ROUNDING * np.abs(pulling).max())
        sign = "<=" if pulling[axes[0]] > 0.0 else ">="
        force = f"{table._forces[axes[0]]} {sign} 0" if len(axes) == 1 else f"lam[{table.numbers[i]}] <= 0"
        yield f"the contact can be pressed and not pulled: {force}"
    row = max(table.numbers, key=lambda i: abs(phi[i]), default=None)
    if row is not None and abs(phi[row]) > ON_SURFACE:
        yield f"the pose is off the constraint: phi[{row}] = {phi[row]:.4g}"
    if isinstance(at, Snapshot) and constraint.frame is not None:
        motions, forces = _of_joints(table.A, np.asarray(at.J(constraint.frame[0]), dtype=np.float64))
        if (motions, forces) != (table.motions, table.forces):
            yield (
                f"of these the joints of '{at.arm.name}' have {motions} of {table.motions} motions and {forces} of "
                f"{table.forces} forces here"
            )


def _of_joints(A: Float64Array, J: Float64Array) -> tuple[int, int]:
    """Numbers of free motions and of free forces that joints have."""
    smallest = REACH * float(np.linalg.norm(J, 2))
    _, values, directions = np.linalg.svd(A @ J)
    forces = int(np.sum(values > smallest))
    return int(np.linalg.matrix_rank(J @ directions[forces:].T, tol=smallest)), forces


def _digits(value: float) -> str:
    return f"{round(float(value), 9) + 0.0:.6g}"
