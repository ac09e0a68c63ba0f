"""Between which values of a number something is stable, from where it changes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

__all__ = ["quantity", "ranges_text", "stable_ranges"]


def stable_ranges(first: bool, cuts: Sequence[float], low: float, high: float) -> list[tuple[float, float]]:
    """The ranges in which it is stable.

    Args:
        first: Whether it is at the low end.
        cuts: Where that changes, increasing.
        low: Where values begin.
        high: Where they end.

    Example:
        >>> stable_ranges(False, [2.0, 3.0, 7.0], 1.0, 9.0)
        [(2.0, 3.0), (7.0, 9.0)]
    """
    ends = list(itertools.pairwise([low, *cuts, high]))
    return ends[0 if first else 1 :: 2]


def ranges_text(ranges: Sequence[tuple[float, float]], low: float, high: float) -> str:
    """Ranges in words: "everywhere", "nowhere", "10 to 50, 80 to 100"."""
    if not ranges:
        return "nowhere"
    return "everywhere" if list(ranges) == [(low, high)] else ", ".join(f"{a:.4g} to {b:.4g}" for a, b in ranges)


def quantity(name: str, unit: str) -> str:
    """A number with its unit, as heads of tables and axes have it."""
    return f"{name} [{unit}]" if unit else name
