"""A comparison as a picture: errors and torques side by side over time, figures as bars, wrong models as points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.analysis.compare.numbers import FIGURES, main_error, of_run
from taut.base.errors import UsageError
from taut.base.plot_style import INK, SMALL, WIDTH, colour, legend_above, prepared, short_name, wrapped
from taut.base.types import Array, Float64Array
from taut.record.plots.comparison import draw_bars, draw_norms, error_norms
from taut.record.plots.run_plot import is_task_run
from taut.record.run import Run
from taut.record.tool import force_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taut.analysis.compare.compare import Comparison, Entry

__all__ = ["plot", "plot_runs"]

NAME: Final = 18  # letters of a name beside its bars, on each of two lines
BARS: Final = ("effort", "chatter", "noise_chatter")
Head = tuple[str, str]


def plot(comparison: Comparison) -> Figure:
    """Errors on the left and torques on the right, a row for each kind of error and each unit of torque."""
    entries = {name.replace("$", r"\$"): entry for name, entry in comparison.entries.items() if len(entry.run)}
    runs = {name: entry.run for name, entry in entries.items()}
    if not runs:
        raise UsageError("there is nothing to plot: no law got through its first tick", name="plot")
    return _figure(runs, entries, comparison.title)


def plot_runs(runs: Mapping[str, Run], title: str) -> Figure:
    """Errors on the left and torques on the right of runs alone, with the first error and what they spend as bars."""
    from taut.analysis.compare.compare import Entry

    shown = {name.replace("$", r"\$"): run for name, run in runs.items() if len(run)}
    entries = {name: Entry(name=name, law="", run=run, numbers=of_run(run)) for name, run in shown.items()}
    return _figure(shown, entries, title)


def _figure(runs: Mapping[str, Run], entries: Mapping[str, Entry], title: str) -> Figure:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    errors = [_error_norms(run) for run in runs.values()]
    torques = [_torque_norms(run) for run in runs.values()]
    left, right = _heads(errors), _heads(torques)
    bars = _bars(entries)
    rows, below = max(len(left), len(right)), math.ceil(len(bars) / 3)
    heights = [0.5 + 1.9 * rows, below * (0.4 + 0.36 * len(runs))]
    figure = Figure(figsize=(WIDTH, 0.3 + sum(heights)), dpi=150, layout="constrained")
    figure.suptitle(short_name(title, 110), fontsize=9.0, color=INK, x=0.01, ha="left")
    top, bottom = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
    grid = top.subplots(rows, 2, squeeze=False, sharex=True)
    for column, heads, parts in ((0, left, errors), (1, right, torques)):
        for row in range(rows):
            ax = grid[row, column]
            ax.set_visible(row < len(heads))
            if row < len(heads):
                words, unit = heads[row]
                if len(heads) == 1 and words.endswith(f"joints in {unit}"):
                    words = "norm of the tracking error"
                shown = [part.get(heads[row]) for part in parts]
                draw_norms(runs, shown, ax, (words, unit))
                if row == len(heads) - 1:
                    ax.set_xlabel("t [s]", fontsize=SMALL, color=INK)
                    ax.tick_params(labelbottom=True)
    names = [
        Line2D([], [], color=colour(i), linewidth=2.0, label=short_name(name, 30)) for i, name in enumerate(runs)
    ]
    legend_above(top, names)
    _draw_bars(bottom.subplots(below, 3, squeeze=False), bars, entries)
    return figure


def _error_norms(run: Run) -> dict[Head, Float64Array]:
    """(k,) norms of the errors that a run has; of laws side by side those of all of them together."""
    out: dict[Head, Float64Array] = {}
    parts = [run.part(part) for part in run.info.parts]
    for one in parts or [run]:
        if one.error is not None or is_task_run(one) or force_error(one) is not None:
            for head, norm in error_norms(one, signed=not parts).items():
                out[head] = np.hypot(out[head], norm) if head in out else norm
    return out


def _heads(parts: Sequence[Mapping[Head, Float64Array]]) -> list[Head]:
    return list(dict.fromkeys(head for part in parts for head in part))


def _torque_norms(run: Run) -> dict[Head, Float64Array]:
    """(k,) norms of the torques of the joints of each unit; of one joint its torque."""
    if run.n == 1:
        return {("torque" if run.effort_units[0] == "N m" else "force", run.effort_units[0]): run.tau[:, 0]}
    out = {}
    for unit in dict.fromkeys(run.effort_units):
        joints = [joint for joint in range(run.n) if run.effort_units[joint] == unit]
        words = "norm of the torques" if unit == "N m" else "norm of the forces of joints"
        out[words, unit] = np.linalg.norm(run.tau[:, joints], axis=1)
    return out


def _bars(entries: Mapping[str, Entry]) -> list[tuple[str, str]]:
    """Figure and unit of each panel below: the first error, what the laws spend, and the error with a wrong model."""
    found = [main_error(entry.numbers) for entry in entries.values()]
    figures = [*dict.fromkeys(error for error in found if error is not None), *BARS, "noise_error", "model_worst"]
    out = []
    for figure in figures:
        units = dict.fromkeys(unit for entry in entries.values() for unit in entry.numbers.get(figure, {}))
        out += [(figure, unit) for unit in units]
    return out


def _draw_bars(grid: Array, bars: Sequence[tuple[str, str]], entries: Mapping[str, Entry]) -> None:
    """A panel for each figure; the error with a wrong model has a point for each arm."""
    for i, ax in enumerate(grid.ravel()):
        ax.set_visible(i < len(bars))
        if i >= len(bars):
            continue
        figure, unit = bars[i]
        numbers = [entry.numbers.get(figure, {}).get(unit, math.nan) for entry in entries.values()]
        prepared(ax, f"{FIGURES[figure].title} [{unit}]")
        if figure == "model_worst":
            _draw_trials(ax, list(entries.values()), unit)
        else:
            draw_bars(ax, numbers)
        if i % grid.shape[1] == 0:
            places = np.arange(len(entries))[::-1]
            ax.set_yticks(places, [wrapped(name, NAME) for name in entries])


def _draw_trials(ax: Axes, entries: Sequence[Entry], unit: str) -> None:
    """The error with each arm as a point, with the arm of the experiment as a line."""
    ax.set_title("error, each wrong model " + f"[{unit}]", fontsize=8.5, color=INK, loc="left", pad=4.0)
    for i, entry in enumerate(entries):
        error, place = main_error(entry.numbers), len(entries) - 1 - i
        if error is None:
            continue
        values = [of_run(run).get(error, {}).get(unit, math.nan) for run in entry.trials]
        ax.plot(values, [place] * len(values), "o", color=colour(i), markersize=3.5, alpha=0.8)
        nominal = entry.numbers[error].get(unit, math.nan)
        ax.plot([nominal, nominal], [place - 0.35, place + 0.35], color=INK, linewidth=1.2)
    ax.set_ylim(-0.6, len(entries) - 0.4)
    ax.set_xlim(left=0.0)
    ax.set_yticks([])
