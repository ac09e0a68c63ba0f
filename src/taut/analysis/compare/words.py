"""A comparison as text: one line for each figure, one column for each law."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from taut.analysis.compare.numbers import FIGURES
from taut.base.result import cell_text

if TYPE_CHECKING:
    from taut.analysis.compare.compare import Comparison

__all__ = ["aligned", "comparison_rows", "comparison_text", "figure_text"]

NAME: Final = 22  # letters of a law's name on each line, where names are on several
WHOLE: Final = 120  # columns of a table with names on one line


def figure_text(value: float) -> str:
    """A figure in words: a dash where it has no meaning, "failed" where a run with another arm did."""
    return "failed" if math.isinf(value) else cell_text(value)


def comparison_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    """(figure, unit, one text per law); last how each run ended."""
    entries = list(comparison.entries.values())
    rows: list[tuple[str, ...]] = []
    for figure, measure in FIGURES.items():
        units = dict.fromkeys(unit for entry in entries for unit in entry.numbers.get(figure, {}))
        for unit in units:
            numbers = [entry.numbers.get(figure, {}).get(unit, math.nan) for entry in entries]
            rows.append((measure.title, unit, *map(figure_text, numbers)))
    rows.append(("outcome", "", *(entry.run.outcome.kind for entry in entries)))
    return rows


def comparison_text(comparison: Comparison) -> str:
    """The table, and what stands below it."""
    heads = [("", "", *comparison.entries)]
    lines = [comparison.title, "", *aligned([*heads, *comparison_rows(comparison)])]
    if comparison.ranking:
        by = ", then ".join(comparison.by)
        lines += ["", f"ranked by {by}: {', '.join(comparison.ranking)}"]
    lines += ["", *comparison.notes] if comparison.notes else []
    lines += [f"{name}: {entry.run.outcome}" for name, entry in comparison.entries.items() if entry.failed]
    return "\n".join(lines)


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table whose first row is the heads: whole where that is not too wide, else on several lines.

    Heads on several lines have a rule below them, which tells where one ends and the next begins.
    """
    whole = _set_out(rows)
    if max(map(len, whole)) <= WHOLE:
        return whole
    heads = [textwrap.wrap(head, NAME) or [""] for head in rows[0]]
    tall = max(len(head) for head in heads)
    above = [[([""] * (tall - len(head)) + head)[line] for head in heads] for line in range(tall)]
    widths = _widths([*above, *rows[1:]])
    rule = ["-" * width if head[0] else "" for head, width in zip(heads, widths, strict=True)]
    return _set_out([*above, rule, *rows[1:]])


def _widths(rows: Sequence[Sequence[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(*rows, strict=True)]


def _set_out(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = _widths(rows)
    return [
        "  ".join(_set(text, width, i) for i, (text, width) in enumerate(zip(row, widths, strict=True))).rstrip()
        for row in rows
    ]


def _set(text: str, width: int, column: int) -> str:
    return text.ljust(width) if column < 2 else text.rjust(width)
