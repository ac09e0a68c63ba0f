"""Draw docs/images/gain_bounds.png and backlash_cycle.png, and print the table of docs/gain_bounds.md.

Run it in this folder: `python gain_bounds.py [FOLDER]`. Predictions and searches are those of the tests.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
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
sys.path.insert(0, str(HERE.parent / "tests" / "plant"))
import gain_borders as bounds  # noqa: E402

IMAGES = HERE.parent / "docs" / "images"
FORMULA, FOUND = COLOURS[0], COLOURS[1]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One of the six, along a number that it depends on."""

    title: str
    gain: str
    along: str
    scale: float  # of that number, in the picture
    at: tuple[float, ...]
    ticks: tuple[float, ...]
    law: str  # the formula in letters
    formula: Callable[[float], float]
    simulated: Callable[[float], float]
    predicted: Callable[[float], float] | None = None  # by eigenvalues
    shown: float = 0.0  # in the table


EFFECTS = (
    Effect(
        title="saturation",
        gain="ki [N m/(rad s)]",
        along="step [rad]",
        scale=1.0,
        at=(0.25, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 2.0),
        ticks=(0.25, 0.5, 1.0, 2.0),
        law="kp (b + N kd) / M",
        formula=bounds.saturation_formula,
        simulated=bounds.saturation_simulated,
        shown=0.5,
    ),
    Effect(
        title="encoder resolution",
        gain="kd [N m s/rad]",
        along="resolution [mrad]",
        scale=1e3,
        at=(1e-4, 2e-4, 4e-4, 7e-4, 1e-3, 2e-3),
        ticks=(1e-4, 3e-4, 1e-3, 2e-3),
        law="peak dt / resolution",
        formula=bounds.resolution_formula,
        simulated=bounds.resolution_simulated,
        shown=1e-3,
    ),
    Effect(
        title="delay",
        gain="kd [N m s/rad]",
        along="delay [ms]",
        scale=1e3,
        at=(0.001, 0.002, 0.003, 0.005, 0.01, 0.02),
        ticks=(0.001, 0.003, 0.01, 0.02),
        law="1.295 M / (delay + dt/2)",
        formula=bounds.delay_formula,
        predicted=lambda delay: bounds.delay_predicted(round(delay * bounds.RATE)),
        simulated=lambda delay: bounds.delay_simulated(round(delay * bounds.RATE)),
        shown=0.005,
    ),
    Effect(
        title="servo rate",
        gain="kd [N m s/rad]",
        along="rate [Hz]",
        scale=1.0,
        at=(20.0, 50.0, 100.0, 200.0, 500.0, 1000.0),
        ticks=(20.0, 100.0, 300.0, 1000.0),
        law="2 M / dt",
        formula=bounds.rate_formula,
        predicted=bounds.rate_predicted,
        simulated=bounds.rate_simulated,
        shown=100.0,
    ),
    Effect(
        title="backlash",
        gain="kp [N m/rad]",
        along="motor's friction [N m]",
        scale=1.0,
        at=(0.05, 0.1, 0.2, 0.4, 0.8),
        ticks=(0.05, 0.1, 0.2, 0.4, 0.8),
        law="2 friction / backlash",
        formula=bounds.backlash_formula,
        simulated=bounds.backlash_simulated,
        shown=0.2,
    ),
    Effect(
        title="joint elasticity",
        gain="kd [N m s/rad]",
        along="spring's damping D [N m s/rad]",
        scale=1.0,
        at=(1.0, 1.5, 2.0, 3.0, 5.0, 8.0),
        ticks=(1.0, 2.0, 4.0, 8.0),
        law="D (M + B)² / (M B) + b M / B",
        formula=bounds.elasticity_formula,
        predicted=bounds.elasticity_predicted,
        simulated=bounds.elasticity_simulated,
        shown=3.0,
    ),
)


def main() -> None:
    """Search all borders, draw them, and print one of each effect."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    figure = Figure(figsize=(WIDTH, 4.4), layout="constrained", facecolor="white")
    table = Table("effect", "gain", "at", "formula", "eigenvalues", "simulated")
    for ax, effect in zip(figure.subplots(2, 3).flat, EFFECTS, strict=True):
        found = {x: effect.simulated(x) for x in effect.at}
        panel(ax, effect, found)
        x = effect.shown
        sampled = f"{effect.predicted(x):.4g}" if effect.predicted else ""
        what, _, unit = effect.along.rstrip("]").partition(" [")
        where = f"{what} {effect.scale * x:g} {unit}"
        table.add_row(effect.title, effect.gain, where, f"{effect.formula(x):.4g}", sampled, f"{found[x]:.4g}")
    legend(figure, figure.axes[0])
    figure.savefig(folder / "gain_bounds.png", dpi=150)
    Console(width=130).print(table)
    cycle().savefig(folder / "backlash_cycle.png", dpi=150)


def cycle() -> Figure:
    """The scenario backlash_cycle: both gains over time, and the cycle of the high one beside harmonic balance."""
    high, low = 100.0, 15.0
    runs = {kp: bounds.hunting(kp) for kp in (high, low)}
    amplitude, period = bounds.cycle_predicted(high) or (np.nan, np.nan)
    figure = Figure(figsize=(WIDTH, 2.6), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2, width_ratios=[1.7, 1.0])
    prepared(left, "link over time", "q [rad]", "t [s]")
    for colour, (kp, run) in zip((FOUND, COLOURS[2]), runs.items(), strict=True):
        seen = run.t <= 8.0
        left.plot(run.t[seen], run.q[seen, 0], color=colour, linewidth=1.3, label=f"kp = {kp:g}")
    prepared(right, f"kp = {high:g}: the cycle", "v [rad/s]", "q [rad]")
    last = runs[high].t >= runs[high].t[-1] - 3.0 * period
    right.plot(runs[high].q[last, 0], runs[high].v[last, 0], color=FOUND, linewidth=1.3)
    phase = np.linspace(0.0, 2.0 * np.pi, 200)
    speed = 2.0 * np.pi / period * amplitude
    right.plot(amplitude * np.cos(phase), speed * np.sin(phase), color=INK, linewidth=0.9, linestyle=DASHED)
    left.plot([], [], color=INK, linewidth=0.9, linestyle=DASHED, label="harmonic balance")
    legend(figure, left)
    return figure


def legend(figure: Figure, ax: Axes) -> None:
    """The legend of one of its axes for the whole figure."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, fontsize=SMALL, frameon=False, labelcolor=INK)


def panel(ax: Axes, effect: Effect, found: dict[float, float]) -> None:
    """One effect: the formula as a line, what simulation found as points, and the side of too large gains."""
    prepared(ax, effect.title, effect.gain, effect.along)
    x = np.geomspace(min(effect.at) / 1.15, max(effect.at) * 1.15, 200)
    line = np.array([effect.formula(each) for each in x])
    top = 2.5 * max(line.max(), *found.values())
    ax.fill_between(effect.scale * x, line, top, color=FOUND, alpha=0.10, linewidth=0.0, label="too large")
    ax.plot(effect.scale * x, line, color=FORMULA, linewidth=1.5, label="formula")
    xs, ys = effect.scale * np.array(list(found)), list(found.values())
    ax.plot(xs, ys, "o", color=FOUND, markersize=4.0, label="border in simulation")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(effect.scale * x[0], effect.scale * x[-1])
    ax.set_ylim(0.5 * min(line.min(), *found.values()), top)
    ax.xaxis.set_major_locator(FixedLocator(effect.scale * np.array(effect.ticks)))
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.minorticks_off()
    left = line[0] < line[-1]  # the corner that the line leaves free
    place = {"x": 0.04 if left else 0.96, "ha": "left" if left else "right", "y": 0.95, "va": "top"}
    ax.text(s=effect.law, transform=ax.transAxes, fontsize=SMALL, color=FORMULA, **place)


if __name__ == "__main__":
    main()
