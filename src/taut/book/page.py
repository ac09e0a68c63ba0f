"""Entries of the book: computed numbers beside expected ones, and pictures."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import NumericalError, StabilityWarning
from taut.base.plot_style import INK, SMALL, WIDTH, colour, prepared
from taut.base.result import Cell, Table
from taut.base.types import ArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

BY_HAND: Final = "the equation, written out"
ROOTS: Final = "numpy.roots"
ODE: Final = "SciPy's DOP853 of equation 10.3"
MUJOCO: Final = "MuJoCo: mj_fullM, qfrc_bias, mj_jacSite"
"""Sources of expected numbers that several entries have."""

COLUMNS: Final = ("quantity", "unit", "computed", "expected", "difference", "expected is", "the chapter")
ROUNDING_DIFFERENCE: Final = 1e-13  # relative difference that is none
EXPECTED_ZERO: Final = 1e-9  # expected number to which a difference is not relative


@dataclass(frozen=True)
class Row:
    """One number that this library computed, beside the expected one."""

    quantity: str
    unit: str  # empty for a pure number
    computed: float  # by laws, arms and plants of this library
    expected: float  # by another way: a closed form, SciPy, MuJoCo, the chapter's own number
    source: str  # of the expected number
    within: float  # absolute tolerance
    states: str = ""  # what the chapter states, where that is a number or a slip

    @property
    def difference(self) -> float:
        return self.computed - self.expected

    @property
    def ok(self) -> bool:
        """The difference is within the tolerance."""
        return abs(self.difference) <= self.within

    def json(self, name: str) -> dict[str, Any]:
        keys = ("quantity", "unit", "computed", "expected", "source")
        return {"id": name, **{key: getattr(self, key) for key in keys}}

    def cells(self) -> tuple[Cell, ...]:
        """The row in a table, by COLUMNS; (!) where the difference is too large."""
        apart = self.difference
        if abs(apart) <= ROUNDING_DIFFERENCE * max(abs(self.expected), 1.0):
            difference = "0"
        else:
            relative = abs(self.expected) > EXPECTED_ZERO
            difference = f"{100.0 * apart / abs(self.expected):+.2g} %" if relative else f"{apart:+.2g}"
        if not self.ok:
            difference += " (!)"
        return self.quantity, self.unit, self.computed, self.expected, difference, self.source, self.states


def row(
    quantity: str,  # with its unit in brackets, as "angle [rad]"; without for a pure number
    computed: Any,
    expected: Any,
    source: str,
    *,
    rel: float = 1e-9,  # tolerance relative to the expected number
    near: float = 0.0,  # absolute tolerance added to it
    states: str = "",
) -> Row:
    """A row of a computed and an expected number."""
    name, _, unit = quantity.removesuffix("]").partition(" [")
    wanted = float(expected)
    return Row(name, unit, float(computed), wanted, source, rel * abs(wanted) + near, states)


def rows(
    quantity: str,
    keys: Iterable[object],
    computed: Iterable[Any],
    expected: Iterable[Any],
    source: str,
    *,
    rel: float = 1e-9,
    near: float = 0.0,
    states: str = "",
) -> Iterator[Row]:
    """A row for each key, which the quantity has in the place of {}."""
    for key, got, wanted in zip(keys, computed, expected, strict=True):
        yield row(quantity.format(key), got, wanted, source, rel=rel, near=near, states=states)


def pole(
    quantity: str,
    got: complex,
    wanted: complex,
    source: str,
    *,
    rel: float = 1e-9,
    near: float = 0.0,
    real: str = "",
    imaginary: str = "",
) -> Iterator[Row]:
    """Two rows for a pole, its real and its imaginary part, with what the chapter states of either."""
    yield row(f"{quantity.format('real part')} [1/s]", got.real, wanted.real, source, rel=rel, near=near, states=real)
    name = f"{quantity.format('imaginary part')} [1/s]"
    yield row(name, got.imag, wanted.imag, source, rel=rel, near=near, states=imaginary)


def compared(quantity: str, got: Any, wanted: Any, source: str, rel: float = 1e-9) -> Iterator[Row]:
    """Two rows for a vector: its length, and the largest difference of an entry."""
    name, _, unit = quantity.partition(" [")
    unit = f" [{unit}" if unit else ""
    yield row(f"{name}: length{unit}", np.linalg.norm(got), np.linalg.norm(wanted), source, rel=rel)
    worst, near = np.abs(got - wanted).max(), rel * float(np.abs(wanted).max())
    yield row(f"{name}: largest difference of an entry{unit}", worst, 0.0, source, near=near)


@dataclass(frozen=True, kw_only=True)
class Page:
    """An entry, computed: its numbers, and its picture if it is a figure of the chapter."""

    entry: Entry
    rows: tuple[Row, ...]
    figure: Figure | None

    @property
    def title(self) -> str:
        return f"{self.entry.id}: {self.entry.title}"

    def drawn(self) -> Figure:
        """The picture of a figure of the chapter."""
        assert self.figure is not None
        return self.figure

    def table(self) -> Table:
        """All rows, with the note of the entry."""
        return Table(
            title=self.title, columns=COLUMNS, rows=[each.cells() for each in self.rows], note=self.entry.note
        )


Shown = Iterator["Row | Figure"]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An equation, a figure or a section of the chapter, and how it is computed."""

    id: str  # "eq-10.6", "fig-10.6", "sec-10.2.1.5"; a section may have several
    title: str
    show: Callable[[], Shown]  # yields its rows and its picture

    @property
    def note(self) -> str:
        """Note on what was chosen and on slips of the chapter: the docstring of the function."""
        return " ".join((inspect.getdoc(self.show) or "").split())

    def page(self) -> Page:
        """The entry, computed. Raises NumericalError."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)  # the chapter shows what lies beyond its bounds too
            shown = list(self.show())
        rows = tuple(each for each in shown if isinstance(each, Row))
        for each in rows:
            if not (math.isfinite(each.computed) and math.isfinite(each.expected)):
                raise NumericalError(f"{self.id}: {each.quantity} is {each.computed}, and should be {each.expected}")
        return Page(entry=self, rows=rows, figure=next((each for each in shown if not isinstance(each, Row)), None))


CONTENTS: Final[list[Entry]] = []
"""All entries, in the order of the chapter once `taut.book.contents` is imported."""


def entry(id: str, title: str) -> Callable[[Callable[[], Shown]], Callable[[], Shown]]:
    """Makes a function that yields rows and a picture an entry of the book, with its docstring as note."""

    def listed(show: Callable[[], Shown]) -> Callable[[], Shown]:
        CONTENTS.append(Entry(id=id, title=title, show=show))
        return show

    return listed


def panels(*titles: tuple[str, str, str] | None, height: float = 2.5, **options: Any) -> tuple[Figure, list[Axes]]:
    """A figure as wide as a page, with a panel for each title, label of y and label of x; None for one to draw on."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(WIDTH, height), dpi=150, layout="constrained", facecolor="white")
    axes = list(figure.subplots(1, len(titles), squeeze=False, **options).flat)
    for ax, title in zip(axes, titles, strict=True):
        if title is None:
            ax.axis("off")
            ax.set_aspect("equal")
        else:
            prepared(ax, *title)
    return figure, axes


def curve(ax: Axes, x: Any, y: Any, label: str = "", k: int | None = None, **options: Any) -> None:
    """A curve in the k-th colour; a thin dark one where it is a reference; dots with `marker`."""
    style = {"color": INK, "linewidth": 0.9} if k is None else {"color": colour(k), "linewidth": 1.4}
    if "marker" in options:
        style |= {"linestyle": "none", "markersize": 4.0}
    ax.plot(x, y, label=label or None, **{**style, **options})


def legend(ax: Axes, **options: Any) -> None:
    """A legend of the lines of a panel."""
    ax.legend(**{"fontsize": SMALL, "frameon": False, "labelcolor": INK, **options})


def words(ax: Axes, at: ArrayLike, text: str, *, size: float = SMALL, **options: Any) -> None:
    """Letters centred at a point."""
    x, y = np.asarray(at).tolist()
    ax.text(x, y, text, **{"fontsize": size, "color": INK, "ha": "center", "va": "center", **options})


def arrow(ax: Axes, *points: ArrayLike, ink: str = INK, width: float = 1.0) -> None:
    """A line through points, with a head at its end."""
    path = np.array([np.asarray(each) for each in points])
    ax.plot(*path[:-1].T, color=ink, linewidth=width, solid_capstyle="butt")
    style = {"arrowstyle": "-|>", "color": ink, "linewidth": width, "shrinkA": 0.0, "shrinkB": 0.0}
    ax.annotate("", xy=tuple(path[-1]), xytext=tuple(path[-2]), arrowprops=style)


def block(
    ax: Axes, x: float, y: float, text: str = "", *, width: float = 1.1, height: float = 0.46, fill: str = "#FFFFFF"
) -> Rectangle:
    """A box about its middle, with letters in it."""
    from matplotlib.patches import Rectangle as Box

    corner = (x - 0.5 * width, y - 0.5 * height)
    box = Box(corner, width, height, facecolor=fill, edgecolor=INK, linewidth=1.0, zorder=2)
    words(ax, (x, y), text, zorder=3)
    ax.add_patch(box)
    return box


def diagram(
    ax: Axes,
    nodes: Mapping[str, tuple[float, float, float, str]],  # middle, width and letters; a point where the width is 0
    edges: Iterable[tuple[str, str, str, str]],  # from, to, letters, Matplotlib's connection style
) -> None:
    """A block diagram: boxes, and arrows between them."""
    boxes = {
        name: block(ax, x, y, text, width=width, height=0.42 + 0.2 * text.count("\n")) if width else None
        for name, (x, y, width, text) in nodes.items()
    }
    for start, end, text, way in edges:
        style = {"arrowstyle": "-|>", "color": INK, "connectionstyle": way, "shrinkA": 0.0, "shrinkB": 0.0}
        (x0, y0, w0, _), (x1, y1, w1, _) = nodes[start], nodes[end]
        style |= {"patchA": boxes[start], "patchB": boxes[end]}
        ax.annotate("", xy=(x1, y1), xytext=(x0, y0), arrowprops=style)
        words(ax, (0.5 * (x0 + x1) + 0.25 * (w0 - w1), 0.5 * (y0 + y1) + 0.12), text, va="bottom")
    x, y, width = np.array([node[:3] for node in nodes.values()]).T
    ax.set(xlim=(x.min() - 0.1, (x + 0.5 * width).max() + 0.1), ylim=(y.min() - 1.0, y.max() + 0.5))


def frame(ax: Axes, origin: Any, axes: Any, name: str, *, aside: Any) -> None:
    """The axes (2, k) of a frame, by columns, with their letters; its name stands at `aside` (2,) from the origin."""
    for k in range(axes.shape[1]):
        arrow(ax, origin, origin + axes[:, k], ink=colour(k), width=1.6)
    words(ax, origin + aside, f"{{{name}}}", zorder=6)


LABELS: Final[Mapping[str, str]] = {
    "P": r"$K_p$",
    "I": r"$K_i \int dt$",
    "D": r"$K_d \, d/dt$",
    "feedforward": r"$\ddot{\theta}_d$",
    "nonlinear": r"$\hat{h}(\theta, \dot{\theta})$",
}
"""Symbols of the terms of joint laws."""
STRAIGHT: Final = "arc3"


def law_diagram(terms: Sequence[str], title: str) -> Figure:
    """A block diagram of the terms of PID control, or of feedback linearisation, between desired motion and arm."""
    model = "nonlinear" in terms  # then M turns what is fed forward and back into a torque
    nodes = {"desired": (0.0, 0.0, 0.0, ""), "error": (1.0, 0.0, 0.3, "Σ"), "sum": (4.0, 0.0, 0.3, "Σ")}
    added = [name for name in terms if name != "nonlinear"]
    for k, name in enumerate(added):
        nodes[name] = (2.5, 0.6 * (0.5 * (len(added) - 1) - k), 1.2, LABELS[name])
    last = "sum"
    if model:
        nodes |= {"M": (5.2, 0.0, 0.9, r"$\hat{M}(\theta)$"), "nonlinear": (6.4, 0.9, 1.2, LABELS["nonlinear"])}
        nodes["torque"] = (6.4, 0.0, 0.3, "Σ")
        last = "torque"
    x = nodes[last][0]
    nodes |= {"arm": (x + 1.6, 0.0, 0.9, "arm"), "angle": (x + 2.9, 0.0, 0.0, "")}
    edges = [("desired", "error", r"$\theta_d$", STRAIGHT), ("arm", "error", "", f"bar,fraction={-1.3 / (x + 0.6)}")]
    edges += [("error", name, "", STRAIGHT) for name in added if name != "feedforward"]
    edges += [(name, "sum", "", STRAIGHT) for name in added]
    if model:
        edges += [("sum", "M", "", STRAIGHT), ("M", "torque", "", STRAIGHT), ("nonlinear", "torque", "", STRAIGHT)]
    edges += [(last, "arm", r"$\tau$", STRAIGHT), ("arm", "angle", r"$\theta, \dot{\theta}$", STRAIGHT)]
    figure, (ax,) = panels(None)
    diagram(ax, nodes, edges)
    words(ax, (0.85, -0.4), "−")
    ax.set_title(title, fontsize=SMALL, color=INK, loc="left")
    return figure
