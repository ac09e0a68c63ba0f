"""Results of analyses: one description of each, from which text, JSON, HTML and plots are made.

An analysis gives a frozen dataclass that inherits `Result` and describes itself once, in `content()`; text, data and
pages are made of that here and in `taut.record.report`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from taut.base.errors import UsageError, printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = str | float | int | bool | None


class Uncertain(float):
    """A number known to +- an interval: a table shows its digits down to the second one of that, at most 12."""

    digits: int

    def __new__(cls, value: float, interval: float) -> Uncertain:
        number = float.__new__(cls, value)
        first, last = (math.floor(math.log10(max(abs(x), 1e-300))) for x in (value, interval))
        number.digits = min(max(2 + first - last, 1), 12)
        return number


@dataclass(frozen=True, kw_only=True)
class Table:
    """Numbers and words in rows.

    Args:
        title: What the rows are.
        columns: Heads, with units: "settling [s]".
        rows: A cell for each column; NaN and None have no meaning in their row. Columns of texts are aligned left.
        note: A sentence below it.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    note: str = ""

    def __str__(self) -> str:
        texts = [[cell_text(cell) for cell in row] for row in self.rows]
        widths = [max(map(len, column)) for column in zip(self.columns, *texts, strict=True)]
        sides = [str.ljust if words else str.rjust for words in self.text_columns]
        lines = [
            "  ".join(side(cell, width) for side, cell, width in zip(sides, line, widths, strict=True)).rstrip()
            for line in (list(self.columns), *texts)
        ]
        return "\n".join(([self.title] if self.title else []) + lines + ([self.note] if self.note else []))

    @property
    def text_columns(self) -> tuple[bool, ...]:
        """True for each column that holds texts alone."""
        return tuple(all(isinstance(row[i], str) for row in self.rows) for i in range(len(self.columns)))

    def json(self) -> list[dict[str, Any]]:
        """The rows as mappings from the heads; NaN and infinite numbers as texts."""
        return [{head: plain(cell) for head, cell in zip(self.columns, row, strict=True)} for row in self.rows]


@dataclass(frozen=True, kw_only=True, eq=False)
class Content:
    """The description of a result.

    Args:
        title: What was analysed, in a few words.
        summary: Sentences that say what was found.
        faults: Sentences on what was missed or went wrong; they stand first.
        tables: Numbers.
        notes: Sentences on what the numbers rely on.
        figures: Functions that draw, by title.
        settings: What the analysis was done with, as text by name.
        texts: Longer texts by title, such as a scenario.
        repeat: How to do it again: a command, or lines of Python.
        versions: Of the programs that it was done with; a report shows those that write it if left out.
    """

    title: str
    summary: Sequence[str] = ()
    faults: Sequence[str] = ()
    tables: Sequence[Table] = ()
    notes: Sequence[str] = ()
    figures: Mapping[str, Callable[[], Figure]] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)
    texts: Mapping[str, str] = field(default_factory=dict)
    repeat: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)


class Result(ABC):
    """Result of an analysis. A subclass is a frozen dataclass with the numbers as fields."""

    @abstractmethod
    def content(self) -> Content:
        """The description of the result."""

    def __str__(self) -> str:
        content = self.content()
        parts = [content.title, *content.faults, *content.summary, *map(str, content.tables), *content.notes]
        return printable("\n".join(part for part in parts if part), lines=True)

    def json(self) -> dict[str, Any]:
        """The result as plain data, for `--json` and for programs."""
        content = self.content()
        return {
            "title": content.title,
            "faults": list(content.faults),
            "summary": list(content.summary),
            "tables": {table.title: table.json() for table in content.tables},
            "notes": list(content.notes),
        }

    def plot(self) -> Figure:
        """The first figure of the result.

        Raises:
            UsageError: The result has no figure.
        """
        figures = self.content().figures
        if not figures:
            raise UsageError(f"{type(self).__name__} has nothing to plot; print it")
        return next(iter(figures.values()))()


def cell_text(cell: Cell) -> str:
    """A cell in a printed table: four digits of a number, a dash where it has no meaning."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, bool | np.bool_):
        return "yes" if cell else "no"
    if isinstance(cell, Uncertain):
        return f"{cell:#.{cell.digits}g}".rstrip(".")
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def plain(cell: Cell) -> Cell:
    """A cell in JSON, which has no NaN and no infinity."""
    value: Cell = cell.item() if isinstance(cell, np.generic) else cell
    if isinstance(value, float):
        return None if math.isnan(value) else str(value) if math.isinf(value) else value
    return value
