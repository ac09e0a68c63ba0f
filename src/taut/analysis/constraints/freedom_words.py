"""Natural and artificial constraints in the words of the chapter's table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.analysis.constraints.contact_modes import Contact, HeldRows, Mode
from taut.analysis.constraints.task_axes import TaskBasis
from taut.base.errors import count_of
from taut.base.types import Float64Array
from taut.linear.linear_words import written
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import Snapshot
from taut.trace.pose import Pose

__all__ = [
    "FreedomRow",
    "axis_words",
    "frame_words",
    "freedom_rows",
    "pose_words",
    "rubbed",
    "side_words",
    "table_text",
]

BOOK: Final = (3, 4, 5, 0, 1, 2)  # rotations first, as the chapter has them
OFF: Final = 1e-6  # [m, rad] from the constraint, that is told
REACH: Final = 1e-6  # of the Jacobian: below it joints cannot move the tool
TITLES: Final = {"stick": "sticking", "apart": "apart"}


@dataclass(frozen=True, kw_only=True)
class FreedomRow:
    """One axis: what the environment says of it, and what may be chosen.

    Args:
        axis: Its name, such as "phi_x".
        free: Whether its motion or its force may be chosen.
        natural: What the environment says, as "phi_x-dot = 0".
        artificial: What may be chosen, as "F_phi_x".
        index: Of the axis, linear part first.
    """

    axis: str
    free: Literal["motion", "force"]
    natural: str
    artificial: str
    index: int


def axis_words(names: Sequence[str], *, joints: bool) -> tuple[list[str], list[str]]:
    """What the motions and the forces along axes are called."""
    return [f"{name}-dot" for name in names], [f"{'tau' if joints else 'F'}_{name}" for name in names]


def rubbed(basis: TaskBasis, contacts: Sequence[Contact]) -> list[bool]:
    """Of each free axis, whether friction of sliding contacts acts along it."""
    along = [contact.along @ basis.from_task @ basis.N for contact in contacts]
    return (
        np.any([np.abs(each).max(axis=0) > 1e-9 for each in along], axis=0).tolist()
        if along
        else [False for _ in basis.free]
    )


def freedom_rows(names: Sequence[str], basis: TaskBasis, sliding: Sequence[Contact]) -> tuple[FreedomRow, ...]:
    """The rows of the table."""
    joints = basis.frame is None
    motions, forces = axis_words(names, joints=joints)
    N, friction = basis.N, rubbed(basis, sliding)
    found = []
    for axis in range(len(names)) if joints else BOOK:
        if axis in basis.held:
            i = basis.held.index(axis)
            natural = f"{written(basis.solved[i], motions)} = {_number(basis.right[i])}"
        else:
            j = basis.free.index(axis)
            natural = f"{written(N[:, j], forces)} = {'friction' if friction[j] else '0'}"
        held = axis in basis.held
        found.append(
            FreedomRow(
                axis=names[axis],
                free="force" if held else "motion",
                natural=natural,
                artificial=forces[axis] if held else motions[axis],
                index=axis,
            )
        )
    return tuple(found)


def table_text(
    rows: Sequence[FreedomRow],
    mode: Mode,
    touches: bool,
    motion: Float64Array | None,
    force: Float64Array | None,
    notes: Sequence[str],
) -> str:
    """The table, with numbers for what may be chosen where there are some, else k1, k2, ..."""
    right = []
    for i, row in enumerate(rows):
        values = motion if row.free == "motion" else force
        right.append(f"{row.artificial} = {f'k{i + 1}' if values is None else _number(values[row.index])}")
    width = max(len("natural"), *(len(row.natural) for row in rows)) + 2
    free = sum(row.free == "motion" for row in rows)
    what = TITLES.get(mode, "in contact" if touches else "held")
    freedoms = f"{count_of(free, 'motion')} and {count_of(len(rows) - free, 'force')}"
    title = f"{what}: {freedoms} may be chosen"
    lines = [f"{row.natural:<{width}}{text}" for row, text in zip(rows, right, strict=True)]
    return "\n".join([title, f"{'natural':<{width}}artificial", *lines, *notes])


def side_words(names: Sequence[str], basis: TaskBasis, held: HeldRows) -> list[str]:
    """A sentence for each contact, of the sign of its force."""
    _, forces = axis_words(names, joints=basis.frame is None)
    found = []
    for i in np.flatnonzero(held.one_sided):
        pulling = held.A[i] @ basis.from_task
        axes = np.flatnonzero(np.abs(pulling) > 1e-9 * np.abs(pulling).max())
        sign = "<=" if pulling[axes[0]] > 0.0 else ">="
        what = f"{forces[axes[0]]} {sign} 0" if len(axes) == 1 else f"lam[{held.given[i]}] <= 0"
        found.append(f"the contact can be pressed and not pulled: {what}")
    return found


def frame_words(basis: TaskBasis, T: Pose, constraint: Constraint) -> str:
    """Which axes the table has."""
    task, name = basis.frame, constraint.frame[0] if constraint.frame is not None else None
    assert task is not None
    whose = "the tool" if name is None else f"'{name}'"
    if np.allclose(task.R, np.eye(3), rtol=0.0, atol=1e-12):
        axes = "the world's axes"
    elif np.allclose(task.R, np.asarray(T.R), rtol=0.0, atol=1e-12):
        axes = f"the axes of {whose}"
    else:
        axes = ", ".join(f"{axis} = {_shown(task.R[:, i])}" for i, axis in enumerate("xyz"))
    there = np.allclose(task.p, np.asarray(T.p), rtol=0.0, atol=1e-12)
    place = f"the origin of {whose}" if name is not None else "the tool's origin"
    return f"task frame: {axes}, at {place if there else _shown(task.p) + ' m'}"


def pose_words(
    constraint: Constraint, at: Pose | Snapshot, held: HeldRows, phi: Float64Array, basis: TaskBasis
) -> list[str]:
    """What is to be said of this pose."""
    found = []
    kept = np.abs(phi[list(held.given)])
    if len(kept) and kept.max() > OFF:
        row = held.given[int(np.argmax(kept))]
        found.append(f"the pose is off the constraint: phi[{row}] = {phi[row]:.4g}")
    if len(basis.held) < len(held.A):
        found.append(f"of the {len(held.A)} rows {len(basis.held)} are independent")
    if isinstance(at, Snapshot) and constraint.frame is not None:
        found += _of_arm(at, held.A, np.asarray(at.J(constraint.frame[0]), dtype=np.float64), basis)
    return found


def _of_arm(x: Snapshot, A: Float64Array, J: Float64Array, basis: TaskBasis) -> list[str]:
    """How many of the freedoms the joints have, where they do not have all."""
    least = REACH * float(np.linalg.norm(J, 2))
    _, values, turned = np.linalg.svd(A @ J)
    forces = int(np.sum(values > least))
    motions = int(np.linalg.matrix_rank(J @ turned[forces:].T, tol=least))
    wanted_motions, wanted_forces = len(basis.free), len(basis.held)
    if (motions, forces) == (wanted_motions, wanted_forces):
        return []
    return [
        f"of these the joints of '{x.arm.name}' have {motions} of {wanted_motions} motions and {forces} of "
        f"{wanted_forces} forces here"
    ]


def _shown(numbers: Float64Array) -> str:
    return f"[{', '.join(f'{x + 0.0:.4g}' for x in np.round(np.asarray(numbers, dtype=np.float64), 9))}]"


def _number(value: float) -> str:
    return f"{round(float(value), 9) + 0.0:.6g}"
