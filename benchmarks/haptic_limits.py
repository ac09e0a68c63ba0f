"""Draw docs/images/haptic_limits.png and haptic_kinds.png, and print the tables of docs/haptics.md.

Run it in this folder: `python haptic_limits.py [FOLDER]`. Predictions and searches are those of the tests.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator
from rich.console import Console
from rich.table import Table

from taut.base.plot_style import COLOURS, DASHED, INK, SMALL, WIDTH, prepared

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "analysis"))
import haptic_borders as haptic  # noqa: E402
import haptic_kinds as kinds  # noqa: E402
from haptic_borders import Display  # noqa: E402

IMAGES = HERE.parent / "docs" / "images"
STABLE, FOUND, PASSIVE = COLOURS[0], COLOURS[1], COLOURS[2]


@dataclass(frozen=True, kw_only=True)
class Panel:
    """The limits along one number that they depend on."""

    title: str
    along: str
    scale: float  # of that number, in the picture
    at: tuple[float, ...]  # where it is simulated
    display: Callable[[float], Display]
    log: bool = True


BASE = Display(B=0.5, velocity="difference")
PANELS = (
    Panel(
        title="rate", along="rate [Hz]", scale=1.0, at=(100.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0),
        display=lambda x: replace(BASE, rate=x),
    ),
    Panel(
        title="delay", along="delay [ms]", scale=1.0, at=(0.0, 1.0, 2.0, 3.0, 5.0, 8.0),
        display=lambda x: replace(BASE, taps=round(x)), log=False,
    ),
    Panel(
        title="physical damping", along="b [N s/m]", scale=1.0, at=(0.6, 1.0, 2.0, 5.0, 10.0),
        display=lambda x: replace(BASE, damping=x),
    ),
    Panel(
        title="virtual damping", along="B [N s/m]", scale=1.0, at=(0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0),
        display=lambda x: replace(BASE, B=x),
    ),
    Panel(
        title="low-pass of the difference, B = 5", along="cut-off [Hz]", scale=1.0,
        at=(5.0, 10.0, 20.0, 50.0, 100.0, 300.0), display=lambda x: replace(BASE, B=5.0, damping=2.0, cutoff=x),
    ),
)  # fmt: skip


def main() -> None:
    """Search all borders, draw them, and print them."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    console = Console(width=130)
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained", facecolor="white")
    axes = list(figure.subplots(2, 3).flat)
    table = Table("along", "at", "stable", "runs", "(b + B)/(T/2 + delay)", "passive", "(b - |B|)/(T/2 + delay)")
    for ax, panel in zip(axes, PANELS, strict=False):
        drawn(ax, panel, table)
    steps(axes[5], console)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside upper left",
        ncols=5,
        columnspacing=1.0,
        handlelength=1.5,
        fontsize=SMALL,
        frameon=False,
        labelcolor=INK,
    )
    figure.savefig(folder / "haptic_limits.png", dpi=150)
    console.print(table)
    ranges(console).savefig(folder / "haptic_kinds.png", dpi=150)


def formula(display: Display, delay: float) -> tuple[float, float]:
    """Closed formulas of the maximum stable and passive stiffness [N/m]."""
    late = 0.5 / display.rate + delay
    return max(display.damping + display.B, 0.0) / late, max(display.damping - abs(display.B), 0.0) / late


def drawn(ax: Axes, panel: Panel, table: Table) -> None:
    """One panel: stable and passive limits as lines, formulas dashed, borders in runs as points."""
    prepared(ax, panel.title, "K [N/m]", panel.along)
    ends = min(panel.at), max(panel.at)
    x = np.geomspace(*ends, 40) if panel.log else np.linspace(*ends, 33)
    if panel.title == "delay":
        displays = [(BASE, 1e-3 * v) for v in x]
    else:
        displays = [(each, each.taps / each.rate) for each in map(panel.display, map(float, x))]
    walls = [replace(display.wall, delay=delay) for display, delay in displays]
    for label, colour, style, values in (
        ("stable, by eigenvalues", STABLE, "-", [wall.limit for wall in walls]),
        ("(b + B) / (T/2 + delay)", STABLE, DASHED, [formula(*each)[0] for each in displays]),
        ("passive", PASSIVE, "-", [wall.passive_limit for wall in walls]),
        ("(b − |B|) / (T/2 + delay)", PASSIVE, DASHED, [formula(*each)[1] for each in displays]),
    ):
        shown = np.where(np.array(values) > 0.0, values, np.nan)
        ax.plot(x, shown, color=colour, linestyle=style, linewidth=1.4 if style == "-" else 1.0, label=label)
    found = [haptic.simulated(panel.display(value)) for value in panel.at]
    ax.plot(panel.at, found, "o", color=FOUND, markersize=4.0, label="border in runs")
    for value, border in zip(panel.at, found, strict=True):
        display = panel.display(value)
        stable, passive = formula(display, display.taps / display.rate)
        numbers = (display.limit, border, stable, display.wall.passive_limit, passive)
        table.add_row(
            panel.title, f"{value:g} {panel.along.split('[')[1][:-1]}", *(f"{each:.5g}" for each in numbers)
        )
    scales(ax, panel)


def scales(ax: Axes, panel: Panel) -> None:
    """Logarithmic axes with plain numbers."""
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    if panel.log:
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(FixedLocator(panel.at[:: 1 if len(panel.at) < 6 else 2]))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.minorticks_off()


def steps(ax: Axes, console: Console) -> None:
    """Encoder resolution: how far a wall hunts, by the Coulomb friction that makes up for it."""
    prepared(ax, "encoder of 0.1 mm: hunting", "swing / step", "Coulomb friction / (K step / 2)")
    table = Table(
        "K [N/m]", *(f"{ratio:g}" for ratio in haptic.FRICTIONS), title="swing in the wall, in encoder steps"
    )
    for colour, K in zip(COLOURS, haptic.STEP_STIFFNESSES, strict=False):
        swings = [haptic.hunting(K, ratio) / haptic.STEP for ratio in haptic.FRICTIONS]
        ax.plot(haptic.FRICTIONS, swings, "o-", color=colour, markersize=3.5, linewidth=1.2, label=f"K = {K:g}")
        table.add_row(f"{K:g}", *(f"{swing:.3f}" for swing in swings))
    ax.axvline(1.0, color=INK, linestyle=DASHED, linewidth=0.9)
    ax.set_yscale("symlog", linthresh=1e-3)
    ax.set_ylim(-5e-4, 10.0)
    ax.legend(fontsize=SMALL, frameon=False, labelcolor=INK)
    console.print(table)


def ranges(console: Console) -> Figure:
    """What each kind of control displays on each joint: springs and masses, as bars."""
    figure = Figure(figsize=(WIDTH, 2.6), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2, sharey=True)
    prepared(left, "springs", "", "K [N m/rad]")
    prepared(right, "masses", "", "D [kg m²]")
    table = Table("joint", "control", "springs [N m/rad]", "masses [kg m^2]")
    for i, kind in enumerate(kinds.KINDS):
        found = kinds.springs(kind), kinds.masses(kind)
        colour = STABLE if kind.arm == "light" else FOUND
        for ax, stretch, grid in zip((left, right), found, (kinds.SPRINGS, kinds.MASSES), strict=True):
            if stretch is None:
                ax.text(grid[0], -i, "none", fontsize=SMALL, color=INK, va="center")
            elif stretch[0] == stretch[1]:
                ax.plot(stretch[:1], [-i], "D", color=colour, markersize=6.0)
            else:
                ax.barh(-i, stretch[1] - stretch[0], left=stretch[0], height=0.55, color=colour)
            ax.set_xscale("log")
            ax.set_xlim(0.7 * grid[0], 1.4 * grid[-1])
            ax.minorticks_off()
        table.add_row(kind.arm, kind.control, *(_words(stretch) for stretch in found))
    left.set_yticks([-i for i in range(len(kinds.KINDS))], [str(kind) for kind in kinds.KINDS], fontsize=SMALL)
    console.print(table)
    return figure


def _words(stretch: tuple[float, float] | None) -> str:
    if stretch is None:
        return "none"
    return f"{stretch[0]:.3g}" if stretch[0] == stretch[1] else f"{stretch[0]:.3g} to {stretch[1]:.3g}"


if __name__ == "__main__":
    main()
