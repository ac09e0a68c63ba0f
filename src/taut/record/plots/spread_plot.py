"""One figure for runs that differ by chance: where the tool went in each, and what pushed it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.record.info import TOOL
from taut.record.plots.style import INK, SMALL, WIDTH, colour, line, prepared
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["spread_figure"]

HEIGHT: Final = 4.6  # [in]
WHILE: Final = 0.02  # [s]


def spread_figure(runs: Mapping[str, Run]) -> Figure:
    """The tool's path from above, its height and the environment's force over time, one line for each run.

    Raises:
        UsageError: A run that does not say where its tool is.
    """
    from matplotlib.figure import Figure

    for name, run in runs.items():
        if TOOL not in run.info:
            raise UsageError(f"run '{name}' does not say where its tool is", name="runs")
    figure = Figure(figsize=(WIDTH, HEIGHT), dpi=150, layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=[1.0, 1.35])
    above, height, force = (figure.add_subplot(place) for place in (grid[:, 0], grid[0, 1], grid[1, 1]))
    prepared(above, f"the tool from above, {len(runs)} runs", "y [m]")
    prepared(height, "the tool's height", "z [m]")
    prepared(force, "force: mean of 20 ms, and each run's peak", "|F| [N]")
    for i, run in enumerate(runs.values()):
        p = run.task.p
        line(above, p[:, 0], p[:, 1], colour(i))
        above.plot(p[-1:, 0], p[-1:, 1], "o", color=colour(i), markersize=3.0)
        line(height, run.t, p[:, 2], colour(i))
        if "F_ext" in run.extra:
            size = np.linalg.norm(run.extra["F_ext"][:, :3], axis=1)
            peak = int(size.argmax())
            line(force, run.t, _mean(run.t, size), colour(i))
            force.plot(run.t[peak], size[peak], "o", color=colour(i), markersize=3.0)
    wanted = next(iter(runs.values())).task.wanted
    if wanted is not None:
        p_des = np.asarray(wanted.p)
        line(above, p_des[:, 0], p_des[:, 1], INK, reference=True)
        line(height, next(iter(runs.values())).t, p_des[:, 2], INK, reference=True)
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel("x [m]", fontsize=SMALL, color=INK)
    above.locator_params(nbins=4)
    force.set_xlabel("t [s]", fontsize=SMALL, color=INK)
    for ax in (height, force):
        ax.margins(x=0.01)
    return figure


def _mean(t: Float64Array, x: Float64Array) -> Float64Array:
    """(k,) mean of the last while: contacts that slide open and close from tick to tick."""
    ticks = min(len(t), max(1, round(WHILE / float(t[1] - t[0])))) if len(t) > 1 else 1
    sums = np.cumsum(np.concatenate([np.zeros(ticks), x]))
    mean: Float64Array = (sums[ticks:] - sums[:-ticks]) / ticks
    return mean
