"""What the book is made of: numbers beside what they should be, and pictures, under the chapter's own numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.types import Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["BY_HAND", "MUJOCO", "ODE", "ROOTS", "TWO_BY_HAND", "Entry", "Page", "Row", "compared", "row"]

BY_HAND: Final = "the equation, written out"
TWO_BY_HAND: Final = "two links, written out"
ROOTS: Final = "numpy.roots"
ODE: Final = "SciPy's DOP853 of equation 10.3"
MUJOCO: Final = "MuJoCo: mj_fullM, qfrc_bias, mj_jacSite"
"""By which other way a number is expected, where several entries have the same."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One number that this library computed, beside what it should be.

    Args:
        quantity: What it is.
        unit: Its unit; empty for a pure number.
        computed: By laws, arms and plants of this library.
        expected: By another way: a closed form, SciPy, MuJoCo, the chapter's own number.
        source: Which way.
        within: How far the two may be apart.
        states: What the chapter states, where that is a number or a slip.
    """

    quantity: str
    unit: str
    computed: float
    expected: float
    source: str
    within: float
    states: str = ""

    @property
    def difference(self) -> float:
        """Computed less expected."""
        return self.computed - self.expected

    @property
    def ok(self) -> bool:
        """Whether the two are as near as they should be."""
        return abs(self.difference) <= self.within

    def json(self, name: str) -> dict[str, Any]:
        """As plain values, under an id."""
        return {
            "id": name,
            "quantity": self.quantity,
            "unit": self.unit,
            "computed": self.computed,
            "expected": self.expected,
            "source": self.source,
        }


def row(
    quantity: str,
    unit: str,
    computed: Any,
    expected: Any,
    source: str,
    *,
    rel: float = 1e-9,
    near: float = 0.0,
    states: str = "",
) -> Row:
    """A row of anything that is a number.

    Args:
        quantity: What it is.
        unit: Of it.
        computed: By this library.
        expected: By another way.
        source: Which way.
        rel: How far they may be apart, of the expected number.
        near: And beyond that, in its unit.
        states: What the chapter states.
    """
    wanted = float(expected)
    return Row(
        quantity=quantity,
        unit=unit,
        computed=float(computed),
        expected=wanted,
        source=source,
        within=rel * abs(wanted) + near,
        states=states,
    )


def compared(
    got: Float64Array, wanted: Float64Array, unit: str, source: str, what: str, rel: float = 1e-9
) -> list[Row]:
    """Two rows for a vector: its length, and the entry that is farthest off, beside the largest."""
    worst = int(np.argmax(np.abs(got - wanted)))
    scale = float(np.abs(wanted).max())
    return [
        row(f"{what}: length", unit, np.linalg.norm(got), np.linalg.norm(wanted), source, rel=rel),
        row(
            f"{what}: entry {worst + 1}, which differs most",
            unit,
            got[worst],
            wanted[worst],
            source,
            rel=0.0,
            near=rel * scale,
        ),
    ]


@dataclass(frozen=True, kw_only=True)
class Page:
    """What one equation, figure or section comes to.

    Args:
        rows: Its numbers.
        figure: Its picture, if it has one.
        note: What was chosen where the chapter leaves it open, and what is a slip.
    """

    rows: tuple[Row, ...]
    figure: Figure | None = None
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An equation, a figure or a section of the chapter, and how it is computed.

    Args:
        id: "eq-10.6", "fig-10.6", "sec-10.2.1.5"; a section may have several.
        title: In words.
        make: Computes its page.
        part: Of a section, for the name of its picture.
    """

    id: str
    title: str
    make: Callable[[], Page]
    part: str = ""

    @property
    def name(self) -> str:
        """Of its picture, without the suffix."""
        return f"{self.id}-{self.part}" if self.part else self.id
