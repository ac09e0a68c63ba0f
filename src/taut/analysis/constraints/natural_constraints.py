"""Natural and artificial constraints of a rigid contact: section 10.4.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.analysis.constraints.contact_modes import (
    MODES,
    Contact,
    ForceMotionCheck,
    FrictionMargin,
    Mode,
    Violation,
    acting_rows,
    contacts_of,
    rows_of,
)
from taut.analysis.constraints.specification import linear_sum
from taut.analysis.constraints.task_frame import TaskBasis
from taut.base.checks import finite_array, finite_scalar, one_of, read_only
from taut.base.errors import RangeError, UsageError, count_of
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import Snapshot
from taut.trace.pose import Pose

__all__ = ["ConstraintRow", "ConstraintTable", "natural_constraints"]

TITLES: Final = {"stick": "sticking", "apart": "apart"}
AXES: Final = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
ROTATIONS_FIRST: Final = (3, 4, 5, 0, 1, 2)  # as in the chapter's table
TOUCHING: Final = 1e-6  # [m, rad] of phi
NO_ENTRY: Final = 1e-9  # of the largest entry of a row
REACH: Final = 1e-6  # of the Jacobian: below it the joints cannot move the tool
SMALL: Final = 1e-6  # of the largest number of the motion, or of the forces


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


@dataclass(frozen=True, kw_only=True, eq=False)
class ConstraintTable(Result):
    """Natural and artificial constraints at one pose.

    Args:
        mode: Of its contacts: "slide", "stick" or "apart".
        friction: Coefficient mu of them.
        names: (m,) of the axes: of the task frame, or the joints.
        A: (k, m) natural constraints A V + phi_t = 0, of the tool's twist in world axes, or of the joint velocities;
            those of sticking below those of the constraint.
        phi_t: (k,) d phi / dt of a surface that moves.
        unilateral: (k,) whether a row is that of a contact, which can be pressed and not pulled.
        numbers: Of the constraint's rows, those that are in A, in that order.
        contacts: Contacts with friction.
        approach: (j, m + 1) A and phi_t of contacts that the tool touches while it is "apart" from them.
        basis: A V + phi_t = 0 along the axes of the task frame.
        notes: Sentences about this pose.
    """

    mode: Mode
    friction: float
    names: tuple[str, ...]
    A: Float64Array
    phi_t: Float64Array
    unilateral: tuple[bool, ...]
    numbers: tuple[int, ...]
    contacts: tuple[Contact, ...]
    approach: Float64Array
    basis: TaskBasis
    notes: tuple[str, ...] = ()

    @property
    def motions(self) -> int:
        """Number of free motions."""
        return len(self.basis.free)

    @property
    def forces(self) -> int:
        """Number of free forces."""
        return len(self.basis.constrained)

    @property
    def frame(self) -> Pose | None:
        """The task frame in the world; None for constraints of joints or of several frames."""
        return self.basis.frame

    @property
    def N(self) -> Float64Array:
        """(m, motions) a basis of ker A, per V as `A`; without friction N^T F_app = 0."""
        return read_only(self.basis.from_task @ self.basis.N)

    @property
    def rows(self) -> tuple[ConstraintRow, ...]:
        """One for each axis, in the order of the chapter's table."""
        basis, friction = self.basis, self._friction_along_free_axes()
        rows = []
        for axis in range(len(self.names)) if self.frame is None else ROTATIONS_FIRST:
            constrained = axis in basis.constrained
            if constrained:
                i = basis.constrained.index(axis)
                natural = f"{linear_sum(basis.solved[i], self._motions)} = {_six_digits(basis.right[i])}"
            else:
                j = basis.free.index(axis)
                natural = f"{linear_sum(basis.N[:, j], self._forces)} = {'friction' if friction[j] else '0'}"
            rows.append(
                ConstraintRow(
                    axis=self.names[axis], index=axis, free="force" if constrained else "motion", natural=natural,
                    artificial=(self._forces if constrained else self._motions)[axis],
                )
            )  # fmt: skip
        return tuple(rows)

    def table(self, V: ArrayLike | None = None, F_app: ArrayLike | None = None) -> Table:
        """The chapter's table, with k1, k2, ... for the values of the artificial constraints, or with numbers.

        Args:
            V: (6,) twist of the tool in world axes [m/s, rad/s], whose free parts stand in the table.
            F_app: (6,) wrench of the arm on the environment at the tool, in world axes, likewise [N, N m].
        """
        m = len(self.names)
        motion = None if V is None else self.basis.to_task @ finite_array("V", V, shape=(m,))
        force = None if F_app is None else self.basis.from_task.T @ finite_array("F_app", F_app, shape=(m,))
        cells = []
        for i, row in enumerate(self.rows):
            values = motion if row.free == "motion" else force
            number = f"k{i + 1}" if values is None else _six_digits(values[row.index])
            cells.append((row.natural, f"{row.artificial} = {number}"))
        return Table(columns=("natural", "artificial"), rows=cells)

    def content(self) -> Content:
        """The numbers of free motions and forces, the table, and notes on the pose."""
        state = TITLES.get(self.mode, "in contact" if any(self.unilateral) else "constrained")
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
            violations += self._of_forces(wrench)
            multipliers = np.asarray(np.linalg.pinv(self.A.T) @ wrench)
            cones = self._cones(multipliers) if self.mode == "stick" else ()
            violations += self._of_contacts(multipliers, cones, SMALL * float(np.abs(wrench).max()))
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
        if self.mode != "slide" or not self.contacts:
            return [False] * self.motions
        along = [contact.along @ self.N for contact in self.contacts]
        return [bool(each) for each in np.any([np.abs(rows).max(axis=0) > NO_ENTRY for rows in along], axis=0)]

    def _of_motion(self, V: Float64Array) -> list[Violation]:
        basis = self.basis
        along = basis.to_task @ V
        tolerance = SMALL * max(float(np.abs(along).max()), float(np.abs(basis.right).max(initial=0.0)))
        violations = [
            Violation(
                quantity=linear_sum(row, self._motions),
                value=float(row @ along),
                rule=f"= {_six_digits(right)}",
                reason=f"natural constraint, {self._forces[axis]} is free",
            )
            for row, right, axis in zip(basis.solved, basis.right, basis.constrained, strict=True)
            if abs(float(row @ along) - right) > tolerance
        ]
        rates = self.approach[:, :-1] @ V + self.approach[:, -1]
        reason = "the motion goes into the surface that the tool touches"
        violations += [
            Violation(quantity="d phi / dt", value=float(rate), rule=">= 0", reason=reason)
            for rate in rates
            if rate < -tolerance
        ]
        return violations

    def _of_forces(self, F_app: Float64Array) -> list[Violation]:
        along = self.basis.from_task.T @ F_app
        tolerance = SMALL * float(np.abs(along).max())
        violations = []
        for column, axis, friction in zip(
            self.basis.N.T, self.basis.free, self._friction_along_free_axes(), strict=True
        ):
            value = float(column @ along)
            if abs(value) <= tolerance:
                continue
            rule = "= friction" if friction else "= 0"
            why = "the contact slides" if friction else "natural constraint"
            violations.append(
                Violation(
                    quantity=linear_sum(column, self._forces), value=value, rule=rule,
                    reason=f"{why}, {self._motions[axis]} is free",
                )
            )  # fmt: skip
        return violations

    def _of_contacts(self, lam: Float64Array, cones: Sequence[FrictionMargin], tolerance: float) -> list[Violation]:
        pulls = [
            Violation(
                quantity=f"lam[{self.numbers[i]}]", value=float(lam[i]), rule="<= 0",
                reason="a contact can be pressed and not pulled",
            )
            for i, unilateral in enumerate(self.unilateral)
            if unilateral and lam[i] > tolerance
        ]  # fmt: skip
        return pulls + [
            Violation(
                quantity="tangential force", value=cone.tangential, rule=f"<= {cone.max_tangential:.4g}",
                reason=f"outside the friction cone of {cone.friction:g} * {cone.pressing:.4g} N",
            )
            for cone in cones
            if not cone.inside
        ]  # fmt: skip

    def _cones(self, lam: Float64Array) -> tuple[FrictionMargin, ...]:
        first = len(self.numbers)
        return tuple(
            FrictionMargin(
                pressing=float(-lam[contact.row] * contact.size),
                tangential=float(np.linalg.norm(lam[first + 2 * i : first + 2 * i + 2])),
                friction=self.friction,
            )
            for i, contact in enumerate(self.contacts)
        )


def natural_constraints(
    constraint: Constraint,
    *,
    at: Pose | Snapshot,
    t: float | None = None,
    frame: Pose | Literal["world", "tool"] | None = None,
    mode: Mode = "slide",
    friction: float = 0.0,
    point: ArrayLike | None = None,
) -> ConstraintTable:
    """Natural constraints of a rigid contact, and the artificial constraints that may be added to them.

    Law:          natural:    A V + d phi/dt = 0, and without friction N^T F_app = 0, with N a basis of ker A
                  artificial: as many motions u, V = N u, and forces lam, F_app = A^T lam: n together  section 10.4.1

    The task frame is chosen such that along each axis either the motion or the force is free: the world's axes if
    possible, else the tool's, else those nearest to the world's, at the tool's origin or where forces and moments
    separate, as on the axis of a hinge. Where no such frame exists, as for a screw, a row has a sum of motions or of
    forces. A constraint of joints or of several frames has its rows along the joints.

    A contact (a unilateral row) has three modes. "slide" takes it for an equality, as the chapter does; its friction
    is not free. "stick" constrains the contact point along the surface too, while the force along it is inside the
    friction cone: 3 + 3 for a chalk. "apart" has no row of the contact: 6 + 0. Friction acts at one point, with no
    moment about the normal, and the surface does not move sideways.

    Args:
        constraint: The constraint.
        at: A pose of the constrained frame, or a snapshot of the arm.
        t: [s] for a constraint that moves, with a pose; a snapshot has its time.
        frame: The task frame in the world; or the axes of the "world" or the "tool", at the tool's origin.
        mode: "slide", "stick" or "apart".
        friction: Coefficient mu of the contacts, at least 0.
        point: (3,) of contact [m], in world axes; the origin of the frame if left out.

    Raises:
        UsageError: No constraint, a pose for one of joints; a mode without a contact, sticking without friction.
        RangeError: A row without a gradient there; friction below 0; a point that is not on the contact.

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
    mu = finite_scalar("friction", friction)
    if mu < 0.0:
        raise RangeError(f"friction must be >= 0; got {mu:g}", name="friction", value=mu, rule=">= 0")
    if mode == "stick" and not mu:
        raise UsageError("mode='stick' needs a coefficient of friction, such as friction=0.3", name="friction")
    if mode != "slide" and not any(constraint.one_sided):
        raise UsageError(
            f"mode='{mode}' is for a contact, and no row of this constraint is one: say one_sided=True", name="mode"
        )
    if frame is not None and not isinstance(frame, Pose) and frame not in ("world", "tool"):
        raise UsageError(f"frame must be a taut.Pose, 'world' or 'tool'; got {frame!r}", name="frame")
    A, phi_t, phi, T = rows_of(constraint, at, t)
    if T is None and (frame is not None or mu):
        raise UsageError(
            f"{'friction' if frame is None else 'frame'} is for a constraint of the tool, and this one is of "
            "joints or of several frames; leave it out",
            name="friction" if frame is None else "frame",
        )
    acting = acting_rows(mode, constraint)
    touched = [i for i, one in enumerate(constraint.one_sided) if i not in acting and one and phi[i] <= TOUCHING]
    contacts: tuple[Contact, ...] = ()
    if mu and T is not None:
        offset = None if point is None else finite_array("point", point, shape=(3,), unit="m") - np.asarray(T.p)
        contacts = contacts_of(A[acting], [constraint.one_sided[i] for i in acting], offset)
        if mode != "apart" and not contacts:
            raise UsageError(
                "friction is for a contact with a force, and no row of this constraint is one: say one_sided=True, "
                "or leave it out",
                name="friction",
            )
    sticking = [contact.along for contact in contacts] if mode == "stick" else []
    rows = np.vstack([A[acting], *sticking])
    rates = np.append(phi_t[acting], np.zeros(len(rows) - len(acting)))
    basis = TaskBasis.of(rows, rates, T, frame)
    table = ConstraintTable(
        mode=mode, friction=mu, names=at.arm.joint_names if T is None and isinstance(at, Snapshot) else AXES,
        A=read_only(rows), phi_t=read_only(rates), numbers=tuple(acting),
        unilateral=tuple(i < len(acting) and constraint.one_sided[acting[i]] for i in range(len(rows))),
        contacts=contacts, approach=np.column_stack([A[touched], phi_t[touched]]), basis=basis,
    )  # fmt: skip
    return ConstraintTable(**{**vars(table), "notes": tuple(_notes(table, constraint, at, T, phi))})


# -------------------------------------------------------------------- notes


def _notes(
    table: ConstraintTable, constraint: Constraint, at: Pose | Snapshot, T: Pose | None, phi: Float64Array
) -> list[str]:
    """The task frame, the signs of contact forces, friction, and peculiarities of the pose."""
    notes = [] if T is None else [_frame_note(table.basis, T, constraint)]
    for i in np.flatnonzero(table.unilateral):
        pulling = table.A[i] @ table.basis.from_task
        axes = np.flatnonzero(np.abs(pulling) > NO_ENTRY * np.abs(pulling).max())
        sign = "<=" if pulling[axes[0]] > 0.0 else ">="
        force = f"{table._forces[axes[0]]} {sign} 0" if len(axes) == 1 else f"lam[{table.numbers[i]}] <= 0"
        notes.append(f"the contact can be pressed and not pulled: {force}")
    if table.contacts:
        notes.append(
            f"it sticks while the force along the surface is at most {table.friction:g} of that into it"
            if table.mode == "stick"
            else f"friction is {table.friction:g} of the force into the surface, against the motion along it"
        )
    off = np.abs(phi[list(table.numbers)])
    if len(off) and off.max() > TOUCHING:
        row = table.numbers[int(np.argmax(off))]
        notes.append(f"the pose is off the constraint: phi[{row}] = {phi[row]:.4g}")
    if table.forces < len(table.A):
        notes.append(f"of the {len(table.A)} rows {table.forces} are independent")
    if isinstance(at, Snapshot) and constraint.frame is not None:
        motions, forces = _of_joints(table.A, np.asarray(at.J(constraint.frame[0]), dtype=np.float64))
        if (motions, forces) != (table.motions, table.forces):
            notes.append(
                f"of these the joints of '{at.arm.name}' have {motions} of {table.motions} motions and {forces} of "
                f"{table.forces} forces here"
            )
    return notes


def _frame_note(basis: TaskBasis, T: Pose, constraint: Constraint) -> str:
    task, name = basis.frame, None if constraint.frame is None else constraint.frame[0]
    assert task is not None
    if np.allclose(task.R, np.eye(3), rtol=0.0, atol=1e-12):
        axes = "the world's axes"
    elif np.allclose(task.R, np.asarray(T.R), rtol=0.0, atol=1e-12):
        axes = "the axes of the tool" if name is None else f"the axes of '{name}'"
    else:
        axes = ", ".join(f"{axis} = {_four_digits(task.R[:, i])}" for i, axis in enumerate("xyz"))
    there = np.allclose(task.p, np.asarray(T.p), rtol=0.0, atol=1e-12)
    origin = "the tool's origin" if name is None else f"the origin of '{name}'"
    return f"task frame: {axes}, at {origin if there else _four_digits(task.p) + ' m'}"


def _of_joints(A: Float64Array, J: Float64Array) -> tuple[int, int]:
    """Numbers of free motions and of free forces that joints have."""
    smallest = REACH * float(np.linalg.norm(J, 2))
    _, values, directions = np.linalg.svd(A @ J)
    forces = int(np.sum(values > smallest))
    return int(np.linalg.matrix_rank(J @ directions[forces:].T, tol=smallest)), forces


def _four_digits(numbers: Float64Array) -> str:
    return f"[{', '.join(f'{x + 0.0:.4g}' for x in np.round(np.asarray(numbers, dtype=np.float64), 9))}]"


def _six_digits(value: float) -> str:
    return f"{round(float(value), 9) + 0.0:.6g}"
