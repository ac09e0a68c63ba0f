"""Numbers beside what they should be, and pictures, under the chapter's own numbers."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import NumericalError, StabilityWarning
from taut.base.plot_style import INK, SMALL, WIDTH, colour
from taut.base.types import Float64Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "BY_HAND",
    "CONTENTS",
    "Entry",
    "MUJOCO",
    "ODE",
    "Page",
    "ROOTS",
    "Row",
    "Shown",
    "TWO_BY_HAND",
    "arrow",
    "block",
    "box",
    "canvas",
    "compared",
    "entry",
    "frame",
    "junction",
    "law_diagram",
    "legend",
    "panels",
    "row",
    "words",
]

BY_HAND: Final = "the equation, written out"
TWO_BY_HAND: Final = "two links, written out"
ROOTS: Final = "numpy.roots"
ODE: Final = "SciPy's DOP853 of equation 10.3"
MUJOCO: Final = "MuJoCo: mj_fullM, qfrc_bias, mj_jacSite"
"""By which other way a number is expected, where several entries have the same."""


@dataclass(frozen=True)
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
        keys = ("quantity", "unit", "computed", "expected", "source")
        return {"id": name, **{key: getattr(self, key) for key in keys}}


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
    return Row(quantity, unit, float(computed), wanted, source, rel * abs(wanted) + near, states)


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
    """What an entry comes to: its numbers, its picture if it has one, and notes on what was chosen or is a slip."""

    entry: Entry
    rows: tuple[Row, ...]
    figure: Figure | None
    note: str


Shown = Iterator["Row | str | Figure"]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An equation, a figure or a section of the chapter, and how it is computed.

    Args:
        id: "eq-10.6", "fig-10.6", "sec-10.2.1.5"; a section may have several.
        title: In words.
        show: Yields its rows, its picture and its notes.
        part: Of a section, for the name of its picture.
    """

    id: str
    title: str
    show: Callable[[], Shown]
    part: str = ""

    @property
    def name(self) -> str:
        """Of its picture, without the suffix."""
        return f"{self.id}-{self.part}" if self.part else self.id

    def page(self) -> Page:
        """The entry, computed.

        Raises:
            NumericalError: A number is not finite.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)  # the chapter shows what lies beyond its bounds too
            shown = list(self.show())
        rows = tuple(each for each in shown if isinstance(each, Row))
        for each in rows:
            if not (math.isfinite(each.computed) and math.isfinite(each.expected)):
                raise NumericalError(f"{self.id}: {each.quantity} is {each.computed}, and should be {each.expected}")
        figures = [each for each in shown if not isinstance(each, Row | str)]
        note = " ".join(each for each in shown if isinstance(each, str))
        return Page(entry=self, rows=rows, figure=figures[0] if figures else None, note=note)


CONTENTS: Final[list[Entry]] = []
"""All entries, in the order of the chapter once `taut.book.contents` is imported."""


def entry(id: str, title: str, *, part: str = "") -> Callable[[Callable[[], Shown]], Callable[[], Shown]]:
    """Makes a function that yields rows, a picture and notes an entry of the book."""

    def listed(show: Callable[[], Shown]) -> Callable[[], Shown]:
        CONTENTS.append(Entry(id=id, title=title, show=show, part=part))
        return show

    return listed


PAPER: Final = "#F4F6F8"
BLOCK: Final = "#FFFFFF"
ROW: Final = 0.62  # between blocks that stand above each other


def panels(columns: int, height: float = 2.5, rows: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """A figure as wide as a page, and its axes row by row."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(WIDTH, height), dpi=150, layout="constrained", facecolor="white")
    return figure, list(figure.subplots(rows, columns, squeeze=False, **options).flat)


def canvas(width: float, height: float, scale: float = 1.0) -> tuple[Figure, Axes]:
    """A figure without axes, to draw on in units of its own."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(scale * width, scale * height), dpi=150, layout="constrained", facecolor="white")
    ax = figure.subplots()
    ax.set_xlim(0.0, width)
    ax.set_ylim(0.0, height)
    ax.set_aspect("equal")
    ax.axis("off")
    return figure, ax


def legend(ax: Axes, **options: Any) -> None:
    """What the lines of a panel are."""
    ax.legend(**{"fontsize": SMALL, "frameon": False, "labelcolor": INK, **options})


def words(ax: Axes, x: float, y: float, text: str, *, size: float = SMALL, **options: Any) -> None:
    """Letters in the middle of a point."""
    ax.text(x, y, text, **{"fontsize": size, "color": INK, "ha": "center", "va": "center", **options})


def arrow(ax: Axes, *points: tuple[float, float], ink: str = INK, width: float = 1.0) -> None:
    """A line through points, with a head at its end."""
    xs, ys = zip(*points, strict=True)
    ax.plot(xs[:-1], ys[:-1], color=ink, linewidth=width, solid_capstyle="butt")
    ax.annotate(
        "",
        xy=points[-1],
        xytext=points[-2],
        arrowprops={"arrowstyle": "-|>", "color": ink, "linewidth": width, "shrinkA": 0.0, "shrinkB": 0.0},
    )


def box(ax: Axes, x: float, y: float, width: float, height: float, *, fill: str = PAPER, edge: str = INK) -> None:
    """A rectangle about its middle."""
    from matplotlib.patches import Rectangle

    corner = (x - 0.5 * width, y - 0.5 * height)
    ax.add_patch(Rectangle(corner, width, height, facecolor=fill, edgecolor=edge, linewidth=1.0, zorder=2))


def block(ax: Axes, x: float, y: float, text: str, *, width: float = 1.1, height: float = 0.46) -> None:
    """A box with a word in it."""
    box(ax, x, y, width, height, fill=BLOCK)
    words(ax, x, y, text, zorder=3)


def junction(ax: Axes, x: float, y: float) -> None:
    """Where signals add up."""
    ax.plot([x], [y], "o", color=INK, markersize=11.0, markerfacecolor=BLOCK, zorder=3)
    words(ax, x, y - 0.015, "Σ", size=SMALL, zorder=4)


def frame(
    ax: Axes, origin: Float64Array, axes: Float64Array, name: str, *, aside: Float64Array, length: float = 0.1
) -> None:
    """The two axes of a frame that lie in the page, and its letter.

    Args:
        ax: Where to draw.
        origin: (2,) in the page.
        axes: (2, 2) its axes in the page, by columns.
        name: Its letter.
        aside: (2,) where that stands, from the origin.
        length: Of the arrows.
    """
    for k in (0, 1):
        end = origin + length * axes[:, k]
        arrow(ax, tuple(origin), tuple(end), ink=colour(k), width=1.6)
    x, y = (origin + aside).tolist()
    words(ax, x, y, f"{{{name}}}", zorder=6)


# -------------------------------------------------------------------- a law as blocks

LABELS: Final[Mapping[str, str]] = {
    "P": r"$K_p$",
    "I": r"$K_i \int dt$",
    "D": r"$K_d \, d/dt$",
    "feedforward": r"$\ddot{\theta}_d$",
    "nonlinear": r"$\hat{h}(\theta, \dot{\theta})$",
    "gravity": r"$\hat{g}(\theta)$",
}
"""How the terms of joint laws are drawn; a law with others has their names in its boxes."""
OF_ERROR: Final = ("P", "I", "D")
OF_STATE: Final = ("nonlinear", "gravity", "friction")


def law_diagram(terms: Sequence[str], title: str, *, inertia: bool) -> Figure:
    """A block diagram of a law's own terms, between the desired motion and the arm.

    Args:
        terms: Names of the law's terms, as `ctrl.terms` has them.
        title: Above it.
        inertia: Whether the terms that are no function of the state are accelerations that the mass matrix turns
            into torques.
    """
    of_error = [name for name in terms if name in OF_ERROR]
    of_state = [name for name in terms if name in OF_STATE]
    ahead = [name for name in terms if name not in (*of_error, *of_state)]
    sum_x, half = 3.85, 0.5 * ROW * max(len(of_error) - 1, 0) + 0.45
    torque_x = sum_x + len(ahead) + (2.0 if inertia else 0.0)
    arm_x = torque_x + 1.65
    middle = 0.15 + (max(half, 1.45) if of_state else half)
    figure, ax = canvas(max(arm_x + 1.05, 7.2), middle + (max(half, 1.45) if ahead else half) + 0.3, 0.78)
    words(ax, 0.1, ax.get_ylim()[1] - 0.15, title, ha="left", size=SMALL + 0.5)
    words(ax, 0.35, middle + 0.2, r"$\theta_d$")
    arrow(ax, (0.15, middle), (0.87, middle))
    junction(ax, 1.0, middle)
    words(ax, 1.35, middle + 0.2, r"$\theta_e$")
    ys = [middle + ROW * (0.5 * (len(of_error) - 1) - k) for k in range(len(of_error))]
    for name, y in zip(of_error, ys, strict=True):
        arrow(ax, (1.13, middle), (1.6, middle), (1.6, y), (1.95, y))
        block(ax, 2.55, y, LABELS[name], width=1.2)
        on = (sum_x - 0.13, y) if y == middle else (sum_x, middle + np.sign(y - middle) * 0.14)
        arrow(ax, (3.15, y), *(() if y == middle else ((sum_x, y),)), on)
    junction(ax, sum_x, middle)
    x = sum_x
    for name in ahead:
        arrow(ax, (x + 0.13, middle), (x + 0.87, middle))
        x += 1.0
        junction(ax, x, middle)
        arrow(ax, (x, middle + 1.0), (x, middle + 0.14))
        words(ax, x, middle + 1.15, LABELS.get(name, name))
    if inertia:
        arrow(ax, (x + 0.13, middle), (x + 0.6, middle))
        block(ax, x + 1.05, middle, r"$\hat{M}(\theta)$", width=0.9)
        arrow(ax, (x + 1.5, middle), (x + 1.87, middle))
        x += 2.0
        junction(ax, x, middle)
    for name in of_state:
        block(ax, x, middle - 0.95, LABELS.get(name, name), width=1.15)
        arrow(ax, (x, middle - 0.72), (x, middle - 0.14))
    arrow(ax, (x + 0.13, middle), (arm_x - 0.45, middle))
    words(ax, 0.5 * (x + arm_x - 0.32), middle + 0.18, r"$\tau$")
    block(ax, arm_x, middle, "arm", width=0.9, height=0.7)
    arrow(ax, (arm_x + 0.45, middle), (arm_x + 0.95, middle))
    words(ax, arm_x + 0.75, middle + 0.2, r"$\theta, \dot{\theta}$")
    arrow(ax, (arm_x + 0.65, middle), (arm_x + 0.65, 0.15), (1.0, 0.15), (1.0, middle - 0.14))
    for k in range(len(of_state)):
        arrow(ax, (x - 0.1 * k, 0.15), (x - 0.1 * k, middle - 1.18))
    words(ax, 0.86, middle - 0.24, "−")
    return figure
