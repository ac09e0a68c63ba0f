"""Natural and artificial constraints: what a rigid contact leaves to be chosen, section 10.4.1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.analysis.constraints.admissible import Admissible, asked, judged
from taut.analysis.constraints.contact_modes import MODES, HeldRows, Mode, held_rows
from taut.analysis.constraints.freedom_words import (
    FreedomRow,
    frame_words,
    freedom_rows,
    pose_words,
    side_words,
    table_text,
)
from taut.analysis.constraints.task_axes import TaskBasis
from taut.base.checks import finite_array, finite_scalar, one_of, read_only
from taut.base.errors import RangeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.force_reference import HybridMotion
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import Snapshot
from taut.trace.pose import Pose

__all__ = ["Freedoms", "freedoms"]

AXES: Final = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
NO_GRADIENT: Final = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Freedoms:
    """Natural and artificial constraints at one pose; print it for the table.

    Args:
        constraint: The constraint.
        mode: Of its contacts.
        friction: Coefficient mu of them.
        names: (m,) of the axes: of the task frame, or the joints.
        held: The rows that hold in this mode.
        basis: Them along the axes.
        notes: Sentences about this pose.
    """

    constraint: Constraint
    mode: Mode
    friction: float
    names: tuple[str, ...]
    held: HeldRows
    basis: TaskBasis
    notes: tuple[str, ...]

    @property
    def motions(self) -> int:
        """How many motions may be chosen."""
        return len(self.basis.free)

    @property
    def forces(self) -> int:
        """How many forces may be chosen."""
        return len(self.basis.held)

    @property
    def frame(self) -> Pose | None:
        """The task frame in the world; None for constraints of joints or of several frames."""
        return self.basis.frame

    @property
    def A(self) -> Float64Array:
        """(k, m) natural constraints, A V + phi_t = 0: of the tool's twist in world axes, or of the joint speeds."""
        return read_only(self.held.A)

    @property
    def phi_t(self) -> Float64Array:
        """(k,) d phi / dt of a surface that moves."""
        return read_only(self.held.phi_t)

    @property
    def N(self) -> Float64Array:
        """(m, motions) a basis of ker A, per V as `A`; without friction N^T F_app = 0."""
        return read_only(self.basis.from_task @ self.basis.N)

    @property
    def rows(self) -> tuple[FreedomRow, ...]:
        """One for each axis, in the order of the chapter's table."""
        return freedom_rows(self.names, self.basis, self.held.contacts if self.mode == "slide" else ())

    def check(
        self,
        motion: TaskMotion | HybridMotion | ArrayLike | None = None,
        *,
        F_app: ArrayLike | None = None,
        lam: ArrayLike | None = None,
    ) -> Admissible:
        """Whether a motion and forces may be chosen together, in this mode.

        Args:
            motion: A sample for the tool, of which the twist counts; one of `taut.pressing(...)`, with its forces; or
                V, (6,) twist of the tool in world axes [m/s, rad/s], (n,) joint speeds for a constraint of joints.
            F_app: (6,) wrench of the arm on the environment at the tool, in world axes [N, N m].
            lam: In its place (k,) multipliers, F_app = A^T lam, one for each row of the constraint.

        Raises:
            UsageError: Forces twice; a sample of the tool for a constraint of joints.
            ShapeError: Other sizes.
            RangeError: Numbers that are not finite.

        Example:
            >>> import taut
            >>> board = taut.Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
            >>> chalk = taut.analysis.freedoms(board, at=taut.Pose([0.4, 0.1, 0.0]))
            >>> chalk.check([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], F_app=[0.0, 0.0, -5.0, 0.0, 0.0, 0.0]).ok
            True
            >>> print(chalk.check(F_app=[2.0, 0.0, -5.0, 0.0, 0.0, 0.0]))
            F_x = 2 may not be chosen, for the environment says F_x = 0; choose x-dot
        """
        V, wrench = asked(self.held.whole, motion, F_app, lam, joints=self.frame is None)
        return judged(self.names, self.basis, self.held, self.mode, self.friction, V, wrench)

    def table(self, V: ArrayLike | None = None, F_app: ArrayLike | None = None) -> str:
        """The table, with k1, k2, ... for what may be chosen, or with numbers.

        Args:
            V: (6,) twist of the tool in world axes [m/s, rad/s], whose free parts stand in the table.
            F_app: (6,) wrench of the arm on the environment at the tool, in world axes, likewise [N, N m].
        """
        m = len(self.names)
        motion = None if V is None else self.basis.to_task @ finite_array("V", V, shape=(m,))
        force = None if F_app is None else self.basis.from_task.T @ finite_array("F_app", F_app, shape=(m,))
        return table_text(self.rows, self.mode, any(self.held.one_sided), motion, force, self.notes)

    def __str__(self) -> str:
        return self.table()


def freedoms(
    constraint: Constraint,
    *,
    at: Pose | Snapshot,
    t: float | None = None,
    frame: Pose | Literal["world", "tool"] | None = None,
    mode: Mode = "slide",
    friction: float = 0.0,
    point: ArrayLike | None = None,
) -> Freedoms:
    """The natural constraints of a rigid contact, and what may be chosen beside them.

    Law:          natural:    A V + d phi/dt = 0, and without friction N^T F_app = 0, with N a basis of ker A
                  artificial: as many motions u, V = N u, and forces lam, F_app = A^T lam: n together  section 10.4.1

    The task frame is chosen such that each axis has either its motion or its force free: the world's axes if they do,
    else the tool's, else those nearest to the world's, at the tool's origin or where forces and moments part, as on
    the axis of a hinge. Where no frame does, as for a screw, a row has a sum of motions or of forces. A constraint of
    joints or of several frames has its rows along the joints.

    A contact (a one-sided row) has three modes. "slide" takes it for an equality, as the chapter does; its friction
    is a force that is not chosen. "stick" holds what touches along the surface too, while the force along it is
    inside the friction cone: 3 + 3 for a chalk. "apart" has none of what belongs to the contact: 6 + 0. Friction acts
    at one point, with no moment about the normal, and what something sticks to does not move sideways.

    Args:
        constraint: The constraint.
        at: A pose of the frame that it is of, or a snapshot of the arm.
        t: [s] for a constraint that moves, with a pose; a snapshot has its time.
        frame: The task frame in the world; or the axes of the "world" or the "tool", at the tool's origin.
        mode: "slide", "stick" or "apart".
        friction: Coefficient mu of the contacts, at least 0.
        point: (3,) where it touches [m], in world axes; the origin of the frame if left out.

    Raises:
        UsageError: No constraint, a pose for one of joints; a mode without a contact, sticking without friction.
        RangeError: A row without a gradient there; friction below 0; a point that is not on the contact.

    Example:
        >>> import taut
        >>> board = taut.Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], face=[0.0, 0.0, -1.0])
        >>> print(taut.analysis.freedoms(board, at=taut.Pose([0.4, 0.1, 0.0])))
        in contact: 3 motions and 3 forces may be chosen
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
        raise UsageError(f"freedoms takes a taut.Constraint; got {type(constraint).__name__}", name="constraint")
    one_of("mode", mode, MODES)
    mu = finite_scalar("friction", friction)
    if mu < 0.0:
        raise RangeError(f"friction must be >= 0; got {mu:g}", name="friction", value=mu, rule=">= 0")
    if mode == "stick" and not mu:
        raise UsageError("mode='stick' needs a coefficient of friction, such as friction=0.3", name="friction")
    if frame is not None and not isinstance(frame, Pose) and frame not in ("world", "tool"):
        raise UsageError(f"frame must be a taut.Pose, 'world' or 'tool'; got {frame!r}", name="frame")
    where = None if point is None else finite_array("point", point, shape=(3,), unit="m")
    A, phi_t, phi, T = _state(constraint, at, t)
    if T is None and frame is not None:
        raise UsageError(
            "frame is for a constraint of the tool; one of joints or of several frames has its rows along the joints",
            name="frame",
        )
    origin = None if T is None else np.asarray(T.p, dtype=np.float64)
    held = held_rows(constraint, A, phi_t, phi, mode=mode, friction=mu, origin=origin, point=where)
    basis = TaskBasis.of(held.A, held.phi_t, T, frame)
    names = at.arm.joint_names if T is None and isinstance(at, Snapshot) else AXES
    notes = [] if T is None else [frame_words(basis, T, constraint)]
    notes += side_words(names, basis, held)
    if held.contacts:
        notes.append(
            f"it sticks while the force along the surface is at most {mu:g} of that into it"
            if mode == "stick"
            else f"friction is {mu:g} of the force into the surface, along the motion on it; it is not chosen"
        )
    notes += pose_words(constraint, at, held, phi, basis)
    return Freedoms(
        constraint=constraint, mode=mode, friction=mu, names=tuple(names), held=held, basis=basis, notes=tuple(notes)
    )


def _state(
    constraint: Constraint, at: Pose | Snapshot, t: float | None
) -> tuple[Float64Array, Float64Array, Float64Array, Pose | None]:
    """A, phi_t and phi of a constraint, and the pose of the frame that it is of."""
    if isinstance(at, Snapshot):
        if t is not None:
            raise UsageError("t is for a pose; a snapshot has its time", name="t")
        single = constraint.frame is not None
        rows = constraint.at(at)
        A, phi_t, phi = (
            np.asarray(m, dtype=np.float64) for m in (rows.A if single else rows.A_q, rows.phi_t, rows.phi)
        )
        T = at.T(constraint.frame[0]) if constraint.frame is not None else None
    elif isinstance(at, Pose):
        if constraint.frame is None:
            raise UsageError(
                "a constraint of joints or of several frames needs the whole arm: at=taut.snapshot(arm, q)", name="at"
            )
        time = 0.0 if t is None else finite_scalar("t", t, unit="s")
        A, phi_t = constraint.of_twist(at, time)
        phi, T = constraint.of_pose(at, time), at
    else:
        raise UsageError(f"at must be a taut.Pose or a taut.snapshot(arm, q); got {type(at).__name__}", name="at")
    for row, size in enumerate(np.linalg.norm(A, axis=1)):
        if not np.isfinite(size) or size < NO_GRADIENT:
            got = "zero" if np.isfinite(size) else "not a number"
            raise RangeError(
                f"row {row} of the constraint must have a gradient, and it is {got} there; take another pose",
                name="constraint",
                value=float(size),
            )
    return A, phi_t, phi, T
