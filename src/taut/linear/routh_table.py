"""Routh's table: the number of roots of a polynomial in the right half-plane, in exact arithmetic."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, count_of
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike

__all__ = ["RouthRow", "RouthTable", "routh"]


@dataclass(frozen=True, kw_only=True)
class RouthRow:
    """One row of the table.

    Args:
        power: Of s in its first entry.
        entries: Exact numbers.
        note: What was done where the usual rule has no answer; empty elsewhere.
    """

    power: int
    entries: tuple[Fraction, ...]
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class RouthTable(Result):
    """Routh's table of a polynomial.

    Args:
        rows: From the highest power to 0.
        right: Number of roots with a positive real part: the changes of sign in the first column.
        on_axis: Number of roots on the imaginary axis.
    """

    rows: tuple[RouthRow, ...]
    right: int
    on_axis: int

    @property
    def stable(self) -> bool:
        """Whether every root has a negative real part."""
        return self.right == 0 and self.on_axis == 0

    def content(self) -> Content:
        """The table, and the verdict."""
        places = ((self.right, "in the right half-plane"), (self.on_axis, "on the imaginary axis"))
        roots = [f"{count_of(count, 'root')} {place}" for count, place in places if count]
        width = len(self.rows[0].entries)
        rows: list[list[Cell]] = [
            [f"s^{row.power}", *map(float, row.entries), *[None] * (width - len(row.entries)), row.note]
            for row in self.rows
        ]
        columns = ("power", *(f"entry {k + 1}" for k in range(width)), "note")
        return Content(
            title=f"Routh's table of order {self.rows[0].power}",
            summary=("stable: no change of sign in the first column",) if self.stable else (),
            faults=() if self.stable else (f"not stable: {' and '.join(roots)}",),
            tables=(Table(columns=columns, rows=rows),),
        )


def routh(coefficients: ArrayLike) -> RouthTable:
    """Routh's table of a_n s^n + ... + a_1 s + a_0, any order, special cases included.

    The numbers are taken as exact fractions, so that no tolerance decides. A zero at the head of a row that has other
    numbers: the row is added to itself, shifted to the left by its k zeros, with the sign (-1)^k. A row of zeros: the
    derivative of the row above takes its place; that row's polynomial divides the whole, and has every pair of roots
    that lie opposite each other.

    Args:
        coefficients: (n + 1,) from the highest power down; the first is not zero.

    Raises:
        ShapeError: Not a list of two numbers or more.
        RangeError: NaN, infinite, or a leading zero.

    Example:
        >>> table = routh([0.5, 2.1, 2.205, 1.0])
        >>> table.stable, [round(float(row.entries[0]), 4) for row in table.rows]
        (True, [0.5, 2.1, 1.9669, 1.0])
        >>> routh([1.0, 1.0, 2.0, 2.0]).on_axis
        2

    References:
        Routh, A treatise on the stability of a given state of motion (1877). Benidir and Picinbono, Extended table
        for eliminating the singularities in Routh's array (1990). Chapter, section 10.2.1.1.
    """
    given = finite_array("coefficients", coefficients)
    if given.ndim != 1 or len(given) < 2:
        raise ShapeError(
            "coefficients must be a list of two numbers or more, from the highest power of s down; got shape "
            f"{given.shape}",
            name="coefficients",
        )
    if given[0] == 0.0:
        raise RangeError(
            "coefficients[0] must not be zero: it belongs to the highest power of s; leave it out",
            name="coefficients",
            value=0.0,
        )
    exact = [Fraction(float(a)) for a in given]
    order = len(exact) - 1
    rows = [RouthRow(power=order, entries=tuple(exact[0::2])), _mended(order - 1, exact[1::2], exact[0::2])]
    for power in range(order - 2, -1, -1):
        before, above = rows[-2].entries, rows[-1].entries
        ratio = before[0] / above[0]
        made = [before[k + 1] - ratio * (above[k + 1] if k + 1 < len(above) else 0) for k in range(power // 2 + 1)]
        rows.append(_mended(power, made, above))
    signs = np.array([row.entries[0] > 0 for row in rows])
    changes = signs[1:] != signs[:-1]
    opposite = next((k for k, row in enumerate(rows) if row.note.startswith("zeros")), None)
    on_axis = 0 if opposite is None else rows[opposite - 1].power - 2 * int(changes[opposite - 1 :].sum())
    return RouthTable(rows=tuple(rows), right=int(changes.sum()), on_axis=on_axis)


def _mended(power: int, entries: list[Fraction], above: list[Fraction] | tuple[Fraction, ...]) -> RouthRow:
    """A row as the table takes it, where it begins with a zero or is all zeros."""
    zeros = next((k for k, entry in enumerate(entries) if entry), len(entries))
    if zeros == 0:
        return RouthRow(power=power, entries=tuple(entries))
    if zeros == len(entries):
        slope = tuple((power + 1 - 2 * k) * above[k] for k in range(len(entries)))
        return RouthRow(power=power, entries=slope, note=f"zeros: the derivative of the row s^{power + 1}")
    sign = -1 if zeros % 2 else 1
    shifted = [*entries[zeros:], *[Fraction(0)] * zeros]
    mixed = tuple(entry + sign * other for entry, other in zip(entries, shifted, strict=True))
    return RouthRow(power=power, entries=mixed, note=f"it began with {count_of(zeros, 'zero')}")
