"""Draw the pictures of docs/error_dynamics.md and print its table.

Run it in this folder: `python error_dynamics.py [FOLDER]`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

import taut
from taut.analysis.stability.loci import bisected
from taut.base.plot_style import COLOURS, DASHED, INK, SMALL, WIDTH, prepared
from taut.linear.performance import powers

IMAGES = Path(__file__).parent.parent / "docs" / "images"
CHAPTER = {"M": 0.5, "b": 0.1}
RATES = (50.0, 100.0, 200.0, 500.0, 1000.0, 5000.0)


def main() -> None:
    """Draw, and print."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    taut.error_dynamics(**CHAPTER, kp=2.205, kd=2.0, ki=1.0).plot().savefig(folder / "error_dynamics.png")
    loci().savefig(folder / "root_loci.png", dpi=150)
    maps().savefig(folder / "stability_maps.png", dpi=150)
    Console(width=110).print(rates())


def joint(**gains: float) -> taut.LinearSystem:
    """The chapter's link."""
    return taut.error_dynamics(**CHAPTER, **gains)


def loci() -> Figure:
    """Figure 10.5 with its responses, and figure 10.7."""
    figure = Figure(figsize=(WIDTH, 2.9), layout="constrained", facecolor="white")
    left, middle, right = figure.subplots(1, 3)
    points = [10.1**2 / (4.0 * 0.5 * zeta**2) for zeta in (1.5, 1.0, 0.5)]
    values = np.unique([*np.linspace(0.0, 230.0, 200), *points])
    taut.analysis.root_locus(lambda kp: joint(kp=kp, kd=10.0), values, label="kp").draw(left, mark=points)
    responses(middle, points)
    values = 12.0 * np.linspace(0.0, 1.0, 200) ** 2
    taut.analysis.root_locus(lambda ki: joint(kp=2.205, kd=2.0, ki=ki), values, label="ki").draw(right)
    return figure


def responses(ax: Axes, points: list[float]) -> None:
    """The right half of figure 10.5."""
    prepared(ax, "error from 1", "e", "t [s]")
    dt = 4e-3
    for k, kp in enumerate(points):
        d = joint(kp=kp, kd=10.0)
        e = powers(d.C[d.rows("q[0]")[0]], d.zoh(dt).A, 400) @ np.array([1.0, 0.0])
        ax.plot(dt * np.arange(400), e, color=COLOURS[k], linewidth=1.5, label=f"{k + 1}: kp = {kp:.3g}")
    ax.axhline(0.0, color=INK, linewidth=0.6)
    ax.legend(fontsize=SMALL, frameon=False, labelcolor=INK)


def maps() -> Figure:
    """Damping against rate, and delay against rate for one design."""
    figure = Figure(figsize=(WIDTH, 2.9), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2)
    found = taut.analysis.stability_map(
        lambda rate, kd: joint(kd=kd, zeta=1.0, rate=rate, velocity="difference"),
        np.geomspace(20.0, 1000.0, 13),
        np.geomspace(5.0, 1000.0, 13),
        labels=("rate [Hz]", "kd [N m s/rad]"),
    )
    found.draw(left)
    log_axes(left, [20, 50, 100, 200, 500, 1000])
    rate = np.array([20.0, 1000.0])
    left.plot(rate, rate, color=COLOURS[1], linewidth=1.0, linestyle=DASHED, label="2 M / dt, measured velocity")
    left.set_title("differenced velocity, zeta = 1", fontsize=SMALL, loc="left", color=INK)
    left.legend(fontsize=SMALL, frameon=False, labelcolor=INK, loc="upper left")
    found = taut.analysis.stability_map(
        lambda delay, kd: joint(kd=kd, zeta=1.0, rate=1000.0, delay=1e-3 * delay),
        np.geomspace(1.0, 20.0, 11),
        np.geomspace(10.0, 1000.0, 13),
        labels=("delay [ms]", "kd [N m s/rad]"),
    )
    found.draw(right)
    log_axes(right, [1, 2, 5, 10, 20])
    right.set_title("1 kHz, delayed, zeta = 1", fontsize=SMALL, loc="left", color=INK)
    return figure


def log_axes(ax: Axes, ticks: list[int]) -> None:
    """Logarithmic scales, and the ticks of the first."""
    ax.set(xscale="log", yscale="log")
    ax.set_xticks(ticks, [str(tick) for tick in ticks])
    ax.set_xticks([], minor=True)


def delay_limit(rate: float) -> float:
    """The delay [s] up to which the design is stable, parts of a period included; 0 if it is not without delay."""

    def stable(delay: float) -> bool:
        return joint(kd=120.0, zeta=1.0, rate=rate, delay=delay).stable

    return bisected(stable, 0.0, 0.02) if stable(0.0) else 0.0


def rates() -> Table:
    """One design at six rates."""
    table = Table("rate [Hz]", "spectral radius", "slowest pole as s", "overshoot [%]", "settling [s]", "delay [ms]")
    for rate in RATES:
        d = joint(kd=120.0, zeta=1.0, rate=rate)
        step = d.step()
        table.add_row(
            f"{rate:g}",
            f"{d.radius:.4g}",
            f"{complex(d.s_poles[0]):.4g}",
            f"{step.overshoot:.3g}",
            f"{step.settling_time:.4g}",
            f"{1e3 * delay_limit(rate):.4g}",
        )
    return table


if __name__ == "__main__":
    main()
