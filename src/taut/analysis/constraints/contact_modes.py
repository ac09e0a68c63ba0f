"""Contact modes (slide, stick, apart), the friction cone, and checks of motions and forces against a contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.base.checks import finite_scalar
from taut.base.errors import RangeError, UsageError
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import Snapshot
from taut.trace.pose import Pose

__all__ = [
    "MODES", "Contact", "ForceMotionCheck", "FrictionMargin", "Mode", "Violation", "acting_rows", "contacts_of",
    "rows_of",
]  # fmt: skip

Mode = Literal["slide", "stick", "apart"]
MODES: Final[tuple[Mode, ...]] = ("slide", "stick", "apart")
NO_GRADIENT: Final = 1e-12
NO_FORCE: Final = 1e-9  # of a row: it has a moment alone
ON_LINE: Final = 1e-6  # [m] of the contact force's line


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

    @property
    def inside(self) -> bool:
        """The contact sticks under this wrench."""
        return self.margin >= -1e-9 * max(1.0, self.tangential)


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
class Contact:
    """One contact with friction.

    Args:
        row: Of A.
        size: Length of the gradient of its phi.
        along: (2, 6) per twist of the tool in world axes: velocity of the contact point along the surface.
    """

    row: int
    size: float
    along: Float64Array


def rows_of(
    constraint: Constraint, at: Pose | Snapshot, t: float | None
) -> tuple[Float64Array, Float64Array, Float64Array, Pose | None]:
    """A, phi_t and phi of a constraint, and the pose of its frame."""
    T: Pose | None
    if isinstance(at, Snapshot):
        if t is not None:
            raise UsageError("t is for a pose; a snapshot has its time", name="t")
        rows = constraint.at(at)
        T = None if constraint.frame is None else at.T(constraint.frame[0])
        matrices = (rows.A_q if T is None else rows.A, rows.phi_t, rows.phi)
        A, phi_t, phi = (np.asarray(each, dtype=np.float64) for each in matrices)
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


def acting_rows(mode: Mode, constraint: Constraint) -> list[int]:
    """The rows that act: apart, none of what belongs to a contact."""
    rows: list[int] = []
    first = 0
    for piece in constraint.pieces:
        if mode != "apart" or not any(piece.one_sided):
            rows += range(first, first + piece.count)
        first += piece.count
    return rows


def contacts_of(A: Float64Array, unilateral: Sequence[bool], offset: Float64Array | None) -> tuple[Contact, ...]:
    """The contacts among rows, each with a force along a line through a point.

    Args:
        A: (k, 6) rows.
        unilateral: (k,) which of them are contacts.
        offset: (3,) from the tool's origin to the point [m]; None for the origin.

    Raises:
        RangeError: The line does not pass through the point.
    """
    contacts = []
    for i, row in enumerate(A):
        size = float(np.linalg.norm(row[:3]))
        if not unilateral[i] or size < NO_FORCE:
            continue
        n, moment = row[:3] / size, row[3:] / size
        d = np.zeros(3) if offset is None else offset
        off = float(np.linalg.norm(moment - np.cross(d, n)))
        if off > ON_LINE:
            raise RangeError(
                f"point must lie on the line of the contact force of row {i}; the "
                f"{'origin of the frame' if offset is None else 'given one'} is {off:.4g} m off [m]",
                name="point",
                value=off,
            )
        left, _, _ = np.linalg.svd(n[:, None])
        contacts.append(Contact(row=i, size=size, along=np.array([[*t, *np.cross(d, t)] for t in left[:, 1:].T])))
    return tuple(contacts)
