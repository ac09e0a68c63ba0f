"""Draw docs/images/singularities.png, and print the table of docs/singularities.md.

Run it in this folder: `python singularities.py [FOLDER]`. Lines and measures are those of the tests.
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
from taut.base.plot_style import COLOURS, DASHED, INK, SMALL, WIDTH, prepared

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "runtime"))
from singular_lines import Line, Measured, OneLoop, errors, lines, measured  # noqa: E402

IMAGES = HERE.parent / "docs" / "images"
GAINS = {"kp": 100.0, "kd": 20.0}
WAYS = {
    "plain inverse": taut.laws.TaskComputedTorque(**GAINS, singularity="plain", null=None),
    "constant damping 0.05": taut.laws.TaskComputedTorque(**GAINS, singularity="plain", damping=0.05, null=None),
    "robust": taut.laws.TaskComputedTorque(**GAINS, null=None),
}
TITLES = {
    "wrist": "wrist aligned",
    "shoulder": "over the shoulder axis",
    "beyond": "beyond reach and back",
    "elbow": "elbow straight and back",
}
COLOUR = dict(zip(WAYS, (COLOURS[7], COLOURS[0], COLOURS[1]), strict=True))
SHOWN = {"wrist": 1, "shoulder": 0, "beyond": 0, "elbow": 0}  # of the sixteen


def main() -> None:
    """Run everything, draw one line of each kind, and print the worst of all sixteen."""
    mpl.use("Agg")
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    arm = taut.load_arm("ur10")
    loops = {way: OneLoop(law, arm) for way, law in WAYS.items()}
    figure = Figure(figsize=(WIDTH, 5.4), layout="constrained", facecolor="white")
    axes = figure.subplots(3, 4, sharex="col", sharey="row")
    table = Table("line", "way", "torque / effort", "speed / limit", "RMS error [mm]", "turn [mrad]", "back [s]")
    for column, kind in enumerate(TITLES):
        prepare(axes[:, column], kind, first=column == 0)
    for column, kind in enumerate(TITLES):
        found = lines(arm, kind)
        for way, one in loops.items():
            runs = [one.run(line) for line in found]
            row(table, kind, way, [measured(run, arm, line) for run, line in zip(runs, found, strict=True)])
            panels(axes[:, column], way, arm, runs[SHOWN[kind]], found[SHOWN[kind]])
        finish(axes[:, column], found[SHOWN[kind]])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4, fontsize=SMALL, frameon=False, labelcolor=INK)
    figure.savefig(folder / "singularities.png", dpi=150)
    Console(width=130).print(table)


def row(table: Table, kind: str, way: str, all_of: list[Measured]) -> None:
    """The worst of the sixteen."""
    done = all(one.finished for one in all_of)
    torque, speed, rms, turn, back = (
        max(getattr(one, name) for one in all_of) for name in ("torque", "speed", "rms", "turn", "recovery")
    )
    cells = [f"{torque:.3g}", f"{speed:.3g}"]
    if done:
        cells += [f"{1e3 * rms:.3g}", f"{1e3 * turn:.3g}", f"{max(back, 0.0):.2f}"]
    else:
        cells += [f"{sum(not one.finished for one in all_of)} of {len(all_of)} diverge"]
    table.add_row(TITLES[kind], way, *cells)


def panels(axes: list[Axes], way: str, arm: taut.Arm, run: taut.Run, line: Line) -> None:
    """Error, largest torque and largest speed over time."""
    error, _, _ = errors(run, arm, line)
    torque = (np.abs(run.tau) / arm.effort).max(axis=1)
    speed = (np.abs(run.v) / arm.velocity).max(axis=1)
    style = {"color": COLOUR[way], "linewidth": 1.3 if way == "robust" else 0.9}
    for ax, values in zip(axes, (np.maximum(1e3 * error, 1e-3), torque, speed), strict=True):
        ax.plot(run.t, np.clip(values, 0.0, 1e6), label=way, **style)


def prepare(axes: list[Axes], kind: str, *, first: bool) -> None:
    """Titles of one column."""
    for ax, name in zip(axes, ("error [mm]", "torque / effort", "speed / limit"), strict=True):
        prepared(ax, TITLES[kind] if ax is axes[0] else "", name if first else "", "t [s]" if ax is axes[-1] else "")


def finish(axes: list[Axes], line: Line) -> None:
    """Scales and limits of one column."""
    for ax, top in zip(axes, (1e3, 2.0, 3.0), strict=True):
        if ax is axes[0]:
            ax.set_yscale("log")
            ax.set_ylim(1e-3, top)
        else:
            ax.set_ylim(0.0, top)
            ax.axhline(1.0, color=INK, linewidth=0.8, linestyle=DASHED)
        ax.axvline(line.again, color=INK, linewidth=0.8, alpha=0.5)
        ax.set_xlim(0.0, line.duration)


if __name__ == "__main__":
    main()
