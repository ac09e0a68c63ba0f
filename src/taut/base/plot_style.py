"""Style of figures: colours for colour-blind readers, legible letters; matplotlib's globals stay untouched."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

import numpy as np

from taut.base.types import Float64Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase
    from matplotlib.lines import Line2D

LineStyle: TypeAlias = Literal["-"] | tuple[float, tuple[float, ...]]

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#5B4A9E", "#7A7A7A")
"""After Okabe and Ito; their yellow, which a white page swallows, is a violet, and black is kept for references."""

INK: Final = "#222222"
WIDTH: Final = 7.5  # [inch] of a figure: a page's text
SMALL: Final = 8.0  # [pt] of all letters but titles
TITLE: Final = 8.5
DASHED: Final = (0.0, (4.0, 3.0))
DOTTED: Final = (0.0, (1.0, 1.5))
BROKEN: Final = (0.0, (6.0, 1.0, 1.0, 1.0))
LETTER: Final = 0.58  # width of a letter in parts of its size
MAX_LINE_POINTS: Final = 4000  # of a line; more than any page can show


def colour(i: int) -> str:
    """The i-th colour; they repeat after eight."""
    return COLOURS[i % len(COLOURS)]


def dashes(i: int) -> LineStyle:
    """The dashes of the i-th curve: none of the first eight, whose colours the next eight have again."""
    return BROKEN if i // len(COLOURS) % 2 else "-"


def short(text: str, most: int) -> str:
    """A text of at most so many characters, cut at its end."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def short_name(text: str, most: int) -> str:
    """A name of at most so many characters, cut in its middle: names of joints often differ at their end."""
    half = (most - 3) // 2
    return text if len(text) <= most else f"{text[: most - 3 - half]}...{text[-half:]}"


def wrapped(text: str, most: int) -> str:
    """A text on two lines of at most so many characters, if it is longer than one: broken at spaces and brackets.

    Example:
        >>> wrapped("GravityPID(kp=20, kd=6)", 16).splitlines()
        ['GravityPID(', 'kp=20, kd=6)']
    """
    if any(len(word) > most for word in text.split()):
        text = text.replace("(", "( ")
    lines = textwrap.wrap(text, most, max_lines=2, placeholder=" ...") or [text]
    return "\n".join(lines).replace("( ", "(")


def prepared(ax: Axes, title: str = "", ylabel: str = "", xlabel: str = "") -> Axes:
    """Axes with titles, a light grid and no box."""
    title, ylabel = title.replace("^2", "²"), ylabel.replace("^2", "²")
    ax.set_title(title, fontsize=TITLE, color=INK, loc="left", pad=4.0)
    ax.set_ylabel(ylabel, fontsize=SMALL, color=INK)
    ax.set_xlabel(xlabel, fontsize=SMALL, color=INK)
    ax.tick_params(labelsize=SMALL, colors=INK, width=0.6, length=3.0)
    ax.grid(True, color="#DDDDDD", linewidth=0.5)
    ax.set_axisbelow(True)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_linewidth(0.6)
    ax.yaxis.offsetText.set_fontsize(SMALL)
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4), useMathText=True)
    return ax


def line(
    ax: Axes, t: Float64Array, y: Float64Array, colour: str, *, reference: bool = False, style: LineStyle = "-"
) -> None:
    """One curve; a reference is thin, dark and dashed, so that the curve shows beneath it."""
    t, y = thinned(t, y)
    if reference:
        ax.plot(t, y, color=INK, linewidth=0.9, linestyle=DASHED, zorder=3)
    else:
        ax.plot(t, y, color=colour, linewidth=1.5, linestyle=style, solid_joinstyle="round")


def thinned(t: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array]:
    """At most a few thousand points of a curve: the least and the greatest of each stretch, in their order."""
    stretch = -(-2 * len(t) // MAX_LINE_POINTS)
    whole = len(t) // stretch * stretch if stretch > 2 else 0
    if not whole:
        return t, y
    rows = y[:whole].reshape(-1, stretch)
    ends = np.sort(np.stack([rows.argmin(axis=1), rows.argmax(axis=1)], axis=1), axis=1)
    picked = (ends + stretch * np.arange(len(rows))[:, np.newaxis]).ravel()
    picked = np.concatenate([[0], picked, np.arange(whole, len(t)), [len(t) - 1]])
    return t[picked], y[picked]


def legend_rows(labels: Sequence[str]) -> int:
    """Number of lines of a legend that is as wide as the page allows."""
    sizes = np.array([3.6 * SMALL + LETTER * SMALL * len(label) for label in labels])
    rows = 1
    while rows < len(sizes):
        columns = np.array_split(sizes, -(-len(sizes) // rows))  # as matplotlib fills them
        if sum(column.max() for column in columns) <= 72.0 * WIDTH:
            break
        rows += 1
    return rows


def legend_above(figure: FigureBase, handles: list[Line2D]) -> None:
    """A legend in the margin above the axes of a figure or a part of one, as wide as the page allows."""
    columns = -(-len(handles) // legend_rows([str(handle.get_label()) for handle in handles]))
    figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=columns,
        fontsize=SMALL,
        frameon=False,
        labelcolor=INK,
        handlelength=1.8,
        columnspacing=1.4,
        borderaxespad=0.2,
    )
