"""The modes of a contact, stick, slide and apart, and the cone of its friction: section 10.4.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from taut.base.errors import RangeError, UsageError
from taut.base.types import Float64Array
from taut.maths.constraints.constraint import Constraint

__all__ = ["MODES", "Contact", "FrictionMargin", "HeldRows", "Mode", "held_rows"]

Mode = Literal["slide", "stick", "apart"]
MODES: Final[tuple[Mode, ...]] = ("slide", "stick", "apart")
ON_LINE: Final = 1e-6  # [m]
TOUCHING: Final = 1e-6  # [m, rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class FrictionMargin:
    """How far a wrench is inside the friction cone of a contact; print it for a sentence.

    Args:
        pressing: [N] into the surface.
        tangential: [N] along it.
        friction: Coefficient mu.
    """

    pressing: float
    tangential: float
    friction: float

    @property
    def most(self) -> float:
        """[N] that friction bears."""
        return self.friction * max(self.pressing, 0.0)

    @property
    def margin(self) -> float:
        """[N] of tangential force to spare; below 0 outside the cone."""
        return self.most - self.tangential

    @property
    def inside(self) -> bool:
        """Whether the contact sticks under it."""
        return self.margin >= -1e-9 * max(1.0, self.tangential)

    def __str__(self) -> str:
        asked = f"{self.tangential:.4g} N along the surface"
        cone = f"the friction cone of {self.friction:g} * {self.pressing:.4g} N"
        if self.inside:
            return f"{asked} is inside {cone}, with {max(self.margin, 0.0):.4g} N to spare"
        return f"{asked} is outside {cone}; ask for less, or press with {self.tangential / self.friction:.4g} N"


@dataclass(frozen=True, kw_only=True, eq=False)
class Contact:
    """One contact: which row of A it is, and the two rows along its surface.

    Args:
        row: Of A.
        size: Length of the gradient of its phi.
        along: (2, 6) per twist of the tool in world axes: the velocity of the point that touches, along the surface.
    """

    row: int
    size: float
    along: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldRows:
    """What holds in a mode: A V + phi_t = 0.

    Args:
        A: (k, m) rows of the constraint that hold, and under them those of sticking.
        phi_t: (k,) d phi / dt of a surface that moves.
        one_sided: (k,) whether a row is that of a contact.
        given: Which rows of the constraint the first rows are.
        contacts: Where friction acts.
        lifted: (j, m + 1) A and phi_t of contacts that do not hold apart, where the tool still touches.
        whole: (c, m) all rows of the constraint.
    """

    A: Float64Array
    phi_t: Float64Array
    one_sided: tuple[bool, ...]
    given: tuple[int, ...]
    contacts: tuple[Contact, ...]
    lifted: Float64Array
    whole: Float64Array


def held_rows(
    constraint: Constraint,
    A: Float64Array,
    phi_t: Float64Array,
    phi: Float64Array,
    *,
    mode: Mode,
    friction: float,
    origin: Float64Array | None,
    point: Float64Array | None,
) -> HeldRows:
    """The rows that hold in a mode: apart, what belongs to a contact does not; sticking, friction holds two more.

    Args:
        constraint: The constraint.
        A: (k, m) its rows.
        phi_t: (k,) d phi / dt.
        phi: (k,).
        mode: The mode.
        friction: Coefficient mu.
        origin: (3,) of the frame that it is of; None for one of joints or of several frames.
        point: (3,) where it touches, if not there.

    Raises:
        UsageError: No contact, and so no such mode; sticking or friction where no point is known.
        RangeError: A point that is not on the contact.
    """
    sides = constraint.one_sided
    if mode != "slide" and not any(sides):
        raise UsageError(
            f"mode='{mode}' is for a contact, and no row of this constraint is one: say one_sided=True", name="mode"
        )
    if friction and origin is None:
        raise UsageError(
            "friction is for contacts of the tool; this constraint is of joints or of several frames: leave it out",
            name="friction",
        )
    kept = _kept_in(mode, constraint)
    gone = [i for i in range(len(A)) if i not in kept and sides[i] and phi[i] <= TOUCHING]
    whole, lifted = A, np.column_stack([A[gone], phi_t[gone]])
    A, phi_t, own = A[kept], phi_t[kept], tuple(sides[i] for i in kept)
    contacts = _contacts(A, own, origin, point) if friction and origin is not None else ()
    if friction and mode != "apart" and not contacts:
        raise UsageError(
            "friction is for a contact that bears a force, and no row of this constraint is one: say one_sided=True, "
            "or leave it out",
            name="friction",
        )
    if mode == "stick":
        A = np.vstack([A, *(contact.along for contact in contacts)])
        more = len(A) - len(phi_t)
        phi_t, own = np.append(phi_t, np.zeros(more)), (*own, *(False,) * more)
    return HeldRows(A=A, phi_t=phi_t, one_sided=own, given=tuple(kept), contacts=contacts, lifted=lifted, whole=whole)


def _kept_in(mode: Mode, constraint: Constraint) -> list[int]:
    kept: list[int] = []
    first = 0
    for piece in constraint.pieces:
        if mode != "apart" or not any(piece.one_sided):
            kept += range(first, first + piece.count)
        first += piece.count
    return kept


def _contacts(
    A: Float64Array, one_sided: Sequence[bool], origin: Float64Array, point: Float64Array | None
) -> tuple[Contact, ...]:
    """The contacts among rows, each with a force along a line through a point: the tool's origin, or `point`.

    Raises:
        UsageError: The line does not pass through the tool's origin, and no point is given.
        RangeError: It does not pass through the point.
    """
    found = []
    for i, row in enumerate(A):
        size = float(np.linalg.norm(row[:3]))
        if not one_sided[i] or size < 1e-9:
            continue
        n, moment = row[:3] / size, row[3:] / size
        d = np.zeros(3) if point is None else point - origin
        off = float(np.linalg.norm(moment - np.cross(d, n)))
        if off > ON_LINE:
            if point is None:
                raise UsageError(
                    f"friction acts where the contact is, and the force of row {i} passes the frame's origin at "
                    f"{off:.4g} m; give point=, where it touches",
                    name="point",
                )
            raise RangeError(
                f"point must lie on the line of the contact force of row {i}; it is {off:.4g} m off [m]",
                name="point",
                value=off,
            )
        left, _, _ = np.linalg.svd(n[:, None])
        along = np.array([[*t, *np.cross(d, t)] for t in left[:, 1:].T])
        found.append(Contact(row=i, size=size, along=along))
    return tuple(found)
