"""Natural and artificial constraints, and what may be specified against a linear environment: section 10.4."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.base.checks import finite_array, finite_scalar, instance_of, one_of, read_only
from taut.base.errors import RangeError, ShapeError, UsageError, count_of, unknown_name
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import Snapshot
from taut.trace.math import skew
from taut.trace.pose import Pose

MIN_SINGULAR_VALUE: Final = 1e-9  # smallest singular value of the specified rows, each scaled to length 1
SPECIFICATION_ROUNDING: Final = 1e-12  # of the largest number: less is zero
TERM: Final = re.compile(
    r"\s*([+-]?)\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)?\s*\*?\s*([A-Za-z_]\w*)\s*"
)
Mode = Literal["slide", "stick", "apart"]
MODES: Final[tuple[Mode, ...]] = ("slide", "stick", "apart")
AXES: Final = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
ROTATIONS_FIRST: Final = (3, 4, 5, 0, 1, 2)  # as in the chapter's table
ON_LINE: Final = 1e-6  # [m] from the frame's origin to the line of a contact force
ROUNDING: Final = 1e-9  # of rows of length 1: less is zero, and such rows are dependent


@dataclass(frozen=True, kw_only=True, eq=False)
class Specification(Result):
    """Check of a specification against the environment F = B V.

    Args:
        names: (2n,) of the motions, then of the forces.
        given: (m,) the specified quantities, as text.
        values: (m,) of them; None where names came without.
        reason: Why the specification is not admissible; empty where it is.
        map: (2n, n) from the specified values to all motions and forces; zeros if not admissible.
    """

    names: tuple[str, ...]
    given: tuple[str, ...]
    values: Float64Array | None
    reason: str
    map: Float64Array

    @property
    def ok(self) -> bool:
        """The specification is admissible."""
        return not self.reason

    @property
    def determined(self) -> dict[str, str]:
        """The quantities that the environment determines, each as a sum of the specified ones."""
        return {
            name: linear_sum(row, self.given)
            for name, row in zip(self.names, self.map, strict=True)
            if self.ok and name not in self.given
        }

    @property
    def quantities(self) -> dict[str, float]:
        """The values of all motions and forces, by name; none where the specification has no values."""
        if self.values is None or not self.ok:
            return {}
        return dict(zip(self.names, (self.map @ self.values).tolist(), strict=True))

    def content(self) -> Content:
        """The verdict, and the quantities that the environment determines."""
        title = "specification against a linear environment"
        if not self.ok:
            return Content(title=title, faults=[f"not admissible: {self.reason}"])
        rows = [(name, text, self.quantities.get(name)) for name, text in self.determined.items()]
        return Content(
            title=title,
            summary=[f"{', '.join(self.given)}: admissible"],
            tables=[Table(columns=("determined by the environment", "sum", "value"), rows=rows)],
        )


def check_specification(given: Mapping[str, float] | Sequence[str], *, B: ArrayLike) -> Specification:
    """Check of motions and forces that are specified together against a passive linear environment.

    Law:          F = B V: n directions have n freedoms among their 2n motions and forces. A specification
                  S (V, F) = s is admissible where S (I; B) has rank n                                   section 10.4

    Quantities are called V1, V2, ..., F1, F2, ...; F is the force on the environment, F_app, less a force that is
    known at that instant. Of springs alone, F = K X, the same holds with K in the place of B, and X in that of V.

    Args:
        given: Names and values, or names alone. A name may be a sum, such as "2 V1 + V2".
        B: Damping, (n,) or (n, n), symmetric or not.

    Raises:
        UsageError: A sum that cannot be read.
        UnknownNameError: A quantity that does not exist.
        ShapeError, RangeError: Arrays of other sizes, numbers that are not finite.

    Example:
        >>> import taut
        >>> check = taut.analysis.check_specification({"V1": 0.1, "F1": 3.0}, B=[[2, 1], [1, 1]])
        >>> check.ok, check.determined
        (True, {'V2': '-2 V1 + F1', 'F2': '-V1 + F1'})
        >>> taut.analysis.check_specification(["F1", "2 V1 + V2"], B=[[2, 1], [1, 1]]).ok
        False

    References:
        Hogan, Impedance control, J. Dynamic Systems, Measurement and Control 107 (1985), on causality at a port.
    """
    G = finite_array("B", B)
    G = np.diag(G) if G.ndim == 1 else G
    n = len(G) if G.ndim else 0
    if not n or G.shape != (n, n):
        raise ShapeError(f"B must be (n,) or (n, n); got shape {G.shape}", name="B")
    names = tuple(f"{symbol}{i + 1}" for symbol in "VF" for i in range(n))
    if isinstance(given, str) or not all(isinstance(text, str) for text in given):
        raise UsageError(f"given must be names, or names with values as {{'V1': 0.1}}; got {given!r}", name="given")
    texts = tuple(" ".join(text.split()) for text in given)
    values = None
    if isinstance(given, Mapping):
        values = read_only(np.array([finite_scalar(f"given[{text!r}]", value) for text, value in given.items()]))
    rows = np.array([coefficients_of(text, names) for text in texts]).reshape(-1, 2 * n)
    of_motion = np.vstack([np.eye(n), G])
    S, reason = rows @ of_motion, ""
    if len(rows) != n:
        reason = f"n = {count_of(n, 'freedom')}, got {len(rows)}"
    elif _dependent(rows, S, G):
        reason = f"{', '.join(texts)} are dependent in this environment"
    map_ = np.zeros((2 * n, len(rows))) if reason else of_motion @ np.linalg.inv(S)
    return Specification(names=names, given=texts, values=values, reason=reason, map=read_only(map_))


def _dependent(rows: Float64Array, S: Float64Array, G: Float64Array) -> bool:
    """Rows S (n, n) over the motion are dependent, or one is zero but for rounding."""
    n, sizes = len(G), np.linalg.norm(S, axis=1)
    terms = np.abs(rows[:, :n]).sum(axis=1) + np.abs(G).max() * np.abs(rows[:, n:]).sum(axis=1)
    if (sizes <= SPECIFICATION_ROUNDING * terms).any():
        return True
    return float(np.linalg.svd(S / sizes[:, np.newaxis], compute_uv=False)[-1]) <= MIN_SINGULAR_VALUE


def coefficients_of(text: str, names: Sequence[str]) -> Float64Array:
    """Coefficients of a linear combination of named quantities.

    Example:
        >>> coefficients_of("2 V1 - F2", ["V1", "V2", "F1", "F2"]).tolist()
        [2.0, 0.0, 0.0, -1.0]
    """
    row, place = np.zeros(len(names)), 0
    while place < len(text) or not text.strip():
        match = TERM.match(text, place)
        if match is None or (place and not match[1]):
            example = f"2 {names[0]} + {names[-1]}"
            raise UsageError(
                f"a quantity is a name or a sum such as '{example}'; got {text!r}", name="given", value=text
            )
        sign, number, name = match.groups()
        if name not in names:
            raise unknown_name("the environment", "quantity", name, names)
        row[names.index(name)] += (-1.0 if sign == "-" else 1.0) * (1.0 if number is None else float(number))
        place = match.end()
    return row


def linear_sum(coefficients: Float64Array, names: Sequence[str]) -> str:
    """A linear combination as text.

    Example:
        >>> linear_sum(np.array([2.0, 0.0, -1.0]), ["V1", "V2", "F1"])
        '2 V1 - F1'
    """
    smallest = SPECIFICATION_ROUNDING * float(np.abs(coefficients).max(initial=0.0))
    text = ""
    for c, name in zip(coefficients, names, strict=True):
        if abs(c) <= smallest:
            continue
        size, factor = f"{abs(c):.6g}", f"({name})" if " " in name else name
        sign = f" {'-' if c < 0.0 else '+'} " if text else "-" if c < 0.0 else ""
        text += sign + (factor if size == "1" else f"{size} {factor}")
    return text or "0"


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
        title: Whether the tool is in contact, constrained, sticking or apart.
        frame: The task frame in the world; None for constraints of joints or of several frames.
        A: (k, m) of A V + phi_t = 0, of the tool's twist in world axes or joint velocities; those of sticking last.
        phi_t: (k,) d phi / dt of a surface that moves.
        N: (m, motions) a basis of ker A, with the free motions as coordinates; without friction N^T F_app = 0.
        rows: (m,) one for each axis, in the order of the chapter's table.
        notes: Sentences about this pose.
    """

    title: str
    frame: Pose | None
    A: Float64Array
    phi_t: Float64Array
    N: Float64Array
    rows: tuple[ConstraintRow, ...]
    notes: tuple[str, ...]

    @property
    def motions(self) -> int:
        """Number of free motions."""
        return int(self.N.shape[1])

    @property
    def forces(self) -> int:
        """Number of free forces."""
        return len(self.rows) - self.motions

    def content(self) -> Content:
        """The numbers of free motions and forces, the chapter's table with k1, k2, ..., and notes on the pose."""
        freedoms = f"{count_of(self.motions, 'free motion')} and {count_of(self.forces, 'free force')}"
        cells = [(row.natural, f"{row.artificial} = k{i + 1}") for i, row in enumerate(self.rows)]
        table = Table(columns=("natural", "artificial"), rows=cells)
        return Content(title=f"{self.title}: {freedoms}", tables=[table], notes=self.notes)


def natural_constraints(
    constraint: Constraint, *, at: Pose | Snapshot, frame: Pose | None = None, mode: Mode = "slide"
) -> ConstraintTable:
    """Natural constraints of a rigid contact, and the artificial constraints that may be added to them.

    Law:          natural:    A V + d phi/dt = 0, and without friction N^T F_app = 0, with N a basis of ker A
                  artificial: as many motions u, V = N u, and forces lam, F_app = A^T lam: n together  section 10.4.1

    Along well-chosen axes of the task frame either the motion or the force is free: for a door with its origin on the
    hinge. Else a row is a sum of motions or of forces, as for a screw in every frame. A constraint of joints or of
    several frames has its rows along the joints.

    A contact (a unilateral row) has three modes. "slide" takes it for an equality, as the chapter does. "stick"
    constrains the origin of the constrained frame along the surface too, as friction does inside its cone: 3 + 3 for
    a chalk. "apart" has no row of the contact: 6 + 0.

    Args:
        constraint: The constraint.
        at: A pose of the constrained frame, or a snapshot of the arm.
        frame: The task frame in the world; at the tool's origin along the world's axes if left out.
        mode: "slide", "stick" or "apart".

    Raises:
        UsageError: No constraint, a pose for one of joints; a mode without a contact.
        RangeError: A row without a gradient there; a contact that sticks away from the origin.

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
    instance_of("constraint", constraint, Constraint, "a taut.Constraint")
    one_of("mode", mode, MODES)
    if mode != "slide" and not any(constraint.one_sided):
        raise UsageError(
            f"mode='{mode}' is for a contact, and no row of this constraint is one: say one_sided=True", name="mode"
        )
    A, phi_t, T = _rows_of(constraint, at)
    if frame is not None and (T is None or not isinstance(frame, Pose)):
        raise UsageError(f"frame must be a taut.Pose, for a constraint of the tool; got {frame!r}", name="frame")
    of_contact = [any(piece.one_sided) for piece in constraint.pieces for _ in range(piece.count)]
    acting = [i for i, contact in enumerate(of_contact) if mode != "apart" or not contact]
    contacts = [i for i in acting if constraint.one_sided[i]]
    sticking = [_tangents(A[i]) for i in contacts] if mode == "stick" else []
    pulling = A[contacts]
    A, phi_t = np.vstack([A[acting], *sticking]), np.append(phi_t[acting], np.zeros(2 * len(sticking)))
    rows, notes = _row_space(A), []
    if T is not None and frame is None:
        frame, notes = Pose(T.p), ["task frame: the world's axes, at the tool's origin"]
    to_task = np.eye(A.shape[1]) if T is None or frame is None else _twist_to(frame, T)
    prescribed = rows @ np.linalg.lstsq(A, -phi_t, rcond=None)[0] if len(A) else np.zeros(0)
    names = at.arm.joint_names if frame is None and isinstance(at, Snapshot) else AXES
    N, described = _described(rows @ np.linalg.inv(to_task), prescribed, names, tool=frame is not None)
    for i, row in zip(contacts, pulling @ np.linalg.inv(to_task), strict=True):
        axes = np.flatnonzero(np.abs(row) > ROUNDING * np.abs(row).max())
        sign = "<=" if row[axes[0]] > 0.0 else ">="
        force = f"F_{names[axes[0]]} {sign} 0" if len(axes) == 1 and frame is not None else f"lam[{i}] <= 0"
        notes.append(f"the contact can be pressed and not pulled: {force}")
    return ConstraintTable(
        title={"stick": "sticking", "apart": "apart"}.get(mode, "in contact" if contacts else "constrained"),
        frame=frame,
        A=read_only(A),
        phi_t=read_only(phi_t),
        N=read_only(np.linalg.solve(to_task, N)),
        rows=described,
        notes=tuple(notes),
    )


def _rows_of(constraint: Constraint, at: Pose | Snapshot) -> tuple[Float64Array, Float64Array, Pose | None]:
    """A and phi_t of a constraint, and the pose of its frame."""
    T: Pose | None
    if isinstance(at, Snapshot):
        rows = constraint.at(at)
        T = None if constraint.frame is None else at.T(constraint.frame[0])
        A, phi_t = (np.asarray(each, dtype=np.float64) for each in (rows.A_q if T is None else rows.A, rows.phi_t))
    elif isinstance(at, Pose):
        if constraint.frame is None:
            raise UsageError(
                "a constraint of joints or of several frames needs the whole arm: at=taut.snapshot(arm, q)", name="at"
            )
        (A, phi_t), T = constraint.of_twist(at, 0.0), at
    else:
        raise UsageError(f"at must be a taut.Pose or a taut.snapshot(arm, q); got {type(at).__name__}", name="at")
    for row, size in enumerate(np.linalg.norm(A, axis=1)):
        if not size > ROUNDING:  # zero, or not a number
            raise RangeError(
                f"row {row} of the constraint must have a gradient; it is {size:g} there; take another pose",
                name="constraint",
                value=float(size),
            )
    return A, phi_t, T


def _tangents(row: Float64Array) -> Float64Array:
    """(2, 6) rows of the origin's velocity along a surface, from its row of A; the force must pass the origin."""
    if len(row) != len(AXES) or np.linalg.norm(row[3:]) > ON_LINE * np.linalg.norm(row[:3]):
        raise RangeError(
            "mode='stick' needs the contact at the origin of the constrained frame, and the line of its force does "
            "not pass there; give the constraint the frame that touches",
            name="mode",
        )
    left, _, _ = np.linalg.svd(row[:3, np.newaxis])
    return np.concatenate([left[:, 1:].T, np.zeros((2, 3))], axis=1)


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


def _described(
    rows: Float64Array, right: Float64Array, names: Sequence[str], *, tool: bool
) -> tuple[Float64Array, tuple[ConstraintRow, ...]]:
    """(m, motions) a basis of the free motions, and in words what rows V = right mean along the axes."""
    solved, right, constrained = _solved(rows, right)
    m = len(names)
    free = [i for i in range(m) if i not in constrained]
    N = np.zeros((m, len(free)))
    N[free] = np.eye(len(free))
    N[constrained] = -solved[:, free]
    motion, force = [f"{name}-dot" for name in names], [f"{'F' if tool else 'tau'}_{name}" for name in names]
    described = {}
    for i, row, value in zip(constrained, solved, right, strict=True):
        natural = f"{linear_sum(row, motion)} = {round(float(value), 9) + 0.0:.6g}"
        described[i] = ConstraintRow(axis=names[i], index=i, free="force", natural=natural, artificial=force[i])
    for i, column in zip(free, N.T, strict=True):
        natural = f"{linear_sum(column, force)} = 0"
        described[i] = ConstraintRow(axis=names[i], index=i, free="motion", natural=natural, artificial=motion[i])
    return N, tuple(described[i] for i in (ROTATIONS_FIRST if tool else range(m)))


def _solved(rows: Float64Array, right: Float64Array) -> tuple[Float64Array, Float64Array, list[int]]:
    """rows V = right solved for as many entries of V: (r, m) with a unit matrix in some columns, and those columns.

    They have the largest numbers, so that a constraint along an axis has that axis alone in its row.
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
    return A, c, sorted(pivots)
