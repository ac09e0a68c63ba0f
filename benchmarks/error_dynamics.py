"""Draw the pictures of docs/error_dynamics.md and print its tables.

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
from taut.analysis.stability_plots import draw_locus, draw_map

import taut
from taut.record.plots.style import COLOURS, DASHED, INK, SMALL, WIDTH, prepared

IMAGES = Path(__file__).parent.parent / "docs" / "images"
CHAPTER = {"M": 0.5, "b": 0.1}
RATES = (50.0, 100.0, 200.0, 500.0, 1000.0, 5000.0)


def main() -> None:
    """Draw, and print."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0, ki=1.0).plot().savefig(folder / "error_dynamics.png")
    loci().savefig(folder / "root_loci.png", dpi=150)
    maps().savefig(folder / "stability_maps.png", dpi=150)
    Console(width=110).print(rates())


def loci() -> Figure:
    """Figure 10.5 with its responses, and figure 10.7."""
    figure = Figure(figsize=(WIDTH, 2.9), layout="constrained", facecolor="white")
    left, middle, right = figure.subplots(1, 3)
    points = [10.1**2 / (4.0 * 0.5 * zeta**2) for zeta in (1.5, 1.0, 0.5)]
    over_kp = taut.analysis.locus(
        lambda kp: taut.analysis.second_order(**CHAPTER, kp=kp, kd=10.0), [0.0, 230.0], name="kp"
    )
    draw_locus(left, over_kp, np.array(points))
    responses(middle, points)
    pd = taut.analysis.second_order(**CHAPTER, kp=2.205, kd=2.0)
    draw_locus(right, taut.analysis.locus("ki", [0.0, 12.0], of=pd), np.zeros(0))
    return figure


def responses(ax: Axes, points: list[float]) -> None:
    """The right half of figure 10.5."""
    prepared(ax, "error from 1", "e", "t [s]")
    t = np.linspace(0.0, 1.6, 400)
    for k, kp in enumerate(points):
        d = taut.analysis.second_order(**CHAPTER, kp=kp, kd=10.0)
        ax.plot(t, d.response(t)[0], color=COLOURS[k], linewidth=1.5, label=f"{k + 1}: zeta = {d.zeta:.2g}")
    ax.axhline(0.0, color=INK, linewidth=0.6)
    ax.legend(fontsize=SMALL, frameon=False, labelcolor=INK)


def maps() -> Figure:
    """Damping against rate, and delay against rate for one design."""
    figure = Figure(figsize=(WIDTH, 2.9), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2)

    def damped(rate: float, kd: float) -> taut.analysis.SampledErrorDynamics:
        return taut.analysis.second_order(M=0.5, b=0.1, kd=kd, zeta=1.0).sampled(rate=rate, velocity="difference")

    found = taut.analysis.stability_map(
        damped, {"rate": np.geomspace(20.0, 1000.0, 13), "kd": np.geomspace(5.0, 1000.0, 13)}
    )
    draw_map(left, found, ("Hz", "N m s/rad"), log=True)
    rate = np.array([20.0, 1000.0])
    left.plot(rate, rate, color=COLOURS[1], linewidth=1.0, linestyle=DASHED, label="2 M / dt, measured velocity")
    left.set_title("differenced velocity, zeta = 1", fontsize=SMALL, loc="left", color=INK)
    left.legend(fontsize=SMALL, frameon=False, labelcolor=INK, loc="upper left")

    def late(delay: float, kd: float) -> taut.analysis.SampledErrorDynamics:
        return taut.analysis.second_order(M=0.5, b=0.1, kd=kd, zeta=1.0).sampled(rate=1000.0, delay=1e-3 * delay)

    found = taut.analysis.stability_map(
        late, {"delay": np.geomspace(1.0, 20.0, 11), "kd": np.geomspace(10.0, 1000.0, 13)}
    )
    draw_map(right, found, ("ms", "N m s/rad"), log=True)
    right.set_title("1 kHz, late, zeta = 1", fontsize=SMALL, loc="left", color=INK)
    return figure


def rates() -> Table:
    """One design at six rates."""
    table = Table("rate [Hz]", "largest pole", "poles as s", "overshoot [%]", "settling [s]", "most delay [ms]")
    d = taut.analysis.second_order(**CHAPTER, kd=120.0, zeta=1.0)
    for rate in RATES:
        at = d.sampled(rate=rate)
        slow = complex(at.s_poles[0])
        settling = f"{at.settling_time:.4g}" if at.stable else "none"
        overshoot = f"{at.overshoot:.3g}" if at.stable else "none"
        table.add_row(
            f"{rate:g}",
            f"{at.radius:.4g}",
            f"{slow:.4g}",
            overshoot,
            settling,
            f"{1e3 * at.largest_stable_delay:.4g}",
        )
    return table


if __name__ == "__main__":
    main()
