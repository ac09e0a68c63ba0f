"""Style of figures, under the name by which the modules of `record` import it: see `taut.base.plot_style`."""

from __future__ import annotations

from taut.base.plot_style import (
    COLOURS,
    DASHED,
    DOTTED,
    INK,
    LETTER,
    SMALL,
    WIDTH,
    colour,
    dashes,
    legend_above,
    legend_rows,
    line,
    prepared,
    short,
    short_name,
    thinned,
    wrapped,
)

__all__ = [
    "COLOURS",
    "DASHED",
    "DOTTED",
    "INK",
    "LETTER",
    "SMALL",
    "WIDTH",
    "colour",
    "dashes",
    "legend_above",
    "legend_rows",
    "line",
    "prepared",
    "short",
    "short_name",
    "thinned",
    "wrapped",
]
