"""Pictures of root loci and stability maps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.analysis.stable_ranges import quantity
from taut.base.types import Float64Array
from taut.linear.error_plots import pole_axes
from taut.record.plots.style import INK, SMALL, WIDTH, colour, prepared

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taut.analysis.root_locus import Locus
    from taut.analysis.stability_regions import StabilityMap

__all__ = ["draw_locus", "draw_map", "of_locus", "of_map"]

STABLE: Final = "#C4E7DC"  # a light shade of colour(2), opaque: neighbouring cells show no seam
APART: Final = 0.05  # of the farthest pole that is shown: nearer poles have one number
FAR: Final = 0.98  # quantile of the poles that are shown


def of_locus(locus: Locus, mark: Float64Array, unit: str) -> Figure:
    """A root locus as a figure."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(0.7 * WIDTH, 3.4), dpi=150, layout="constrained", facecolor="white")
    draw_locus(figure.subplots(), locus, mark, unit)
    return figure


def draw_locus(ax: Axes, locus: Locus, mark: Float64Array, unit: str = "") -> None:
    """A root locus on axes: a colour for each branch, crosses at the first value, circles at the last."""
    poles = locus.poles[np.isfinite(locus.poles)]
    near = poles[np.abs(poles) <= np.quantile(np.abs(poles), FAR)]
    pole_axes(ax, near if locus.dt is None else poles, locus.dt)
    unit = f" {unit}" if unit else ""
    low, high = locus.values[0], locus.values[-1]
    ax.set_title(
        f"{locus.name} from {written(low)} (x) to {written(high)}{unit} (o)", fontsize=SMALL, color=INK, loc="left"
    )
    for k, branch in enumerate(locus.poles.T):
        there = branch[np.isfinite(branch)]
        ax.plot(there.real, there.imag, color=colour(k), linewidth=1.5, solid_joinstyle="round")
        ax.plot(there.real[:1], there.imag[:1], "x", color=colour(k), markersize=6.0, markeredgewidth=1.5)
        ax.plot(there.real[-1:], there.imag[-1:], "o", color=colour(k), markersize=4.5, markerfacecolor="white")
    apart = APART * float(np.abs(near).max(initial=0.0))
    for k, value in enumerate(mark.tolist()):
        named: list[complex] = []
        for s in locus.at(value):
            ax.plot(s.real, s.imag, "o", color=INK, markersize=3.5, zorder=4)
            if s.imag < -apart or any(abs(s - other) < apart for other in named):
                continue  # the number stands at the upper one of a pair, and once where two meet
            named.append(s)
            ax.annotate(
                str(k + 1), (s.real, s.imag), xytext=(3.0, 3.0), textcoords="offset points", fontsize=SMALL, color=INK
            )
    for crossing in locus.borders:
        if crossing.value in (low, high):
            continue
        s = crossing.pole
        ax.plot(s.real, s.imag, "D", color=INK, markersize=3.5, zorder=4)
        ax.annotate(
            f"{locus.name} = {written(crossing.value)}{unit}", (s.real, s.imag), xytext=(-6.0, 3.0), ha="right",
            textcoords="offset points", fontsize=SMALL, color=INK, zorder=5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
        )  # fmt: skip


def written(value: float) -> str:
    """A number of a title: four digits, and thousands in full.

    Example:
        >>> written(30000.0), written(18974.3), written(0.918182)
        ('30000', '18970', '0.9182')
    """
    return f"{float(f'{value:.4g}'):.6g}"


def of_map(found: StabilityMap, units: tuple[str, str], *, log: bool) -> Figure:
    """A stability map as a figure."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(0.7 * WIDTH, 3.2), dpi=150, layout="constrained", facecolor="white")
    ax = figure.subplots()
    draw_map(ax, found, units, log=log)
    ax.legend(fontsize=SMALL, frameon=False, labelcolor=INK, loc="best")
    return figure


def draw_map(ax: Axes, found: StabilityMap, units: tuple[str, str] = ("", ""), *, log: bool = False) -> None:
    """A stability map on axes: what is stable filled, the border as it was bisected."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.ticker import FuncFormatter, LogLocator

    labels = [quantity(name, unit) for name, unit in zip(found.names, units, strict=True)]
    prepared(ax, "", labels[1], labels[0])
    areas, lines = _cells(found)
    ax.add_collection(PolyCollection(areas, facecolor=STABLE, edgecolor=STABLE, linewidth=0.5, zorder=0.4))
    ax.add_collection(LineCollection(lines, color=INK, linewidth=1.2))
    ax.fill_between([], [], color=STABLE, label="stable")
    ax.plot([], [], color=INK, linewidth=1.2, label="border")
    x, y = found.values
    if log:
        ax.set_xscale("log")
        ax.set_yscale("log")
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.minorticks_off()
    ax.set_xlim(x[0], x[-1])
    ax.set_ylim(y[0], y[-1])


Points = list[tuple[float, float]]


def _cells(found: StabilityMap) -> tuple[list[Points], list[Points]]:
    """What is stable of each cell of the grid, and the border in it."""
    x, y = (values.tolist() for values in found.values)
    cuts = {}
    for (one, other), along in zip(found.border.tolist(), found.along.tolist(), strict=True):
        i = int(np.searchsorted(x, one, side="right")) - 1
        j = int(np.searchsorted(y, other, side="right")) - 1
        cuts[along, i, j] = (one, other)
    areas, lines = [], []
    for i in range(len(x) - 1):
        for j in range(len(y) - 1):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            edges = [(0, i, j), (1, i + 1, j), (0, i, j + 1), (1, i, j)]
            area: Points = []
            border: Points = []
            for (a, b), edge in zip(corners, edges, strict=True):
                if found.stable[a, b]:
                    area.append((x[a], y[b]))
                if edge in cuts:
                    area.append(cuts[edge])
                    border.append(cuts[edge])
            if len(area) > 2:
                areas.append(area)
            lines += [border[k : k + 2] for k in range(0, len(border), 2)]
    return areas, lines
