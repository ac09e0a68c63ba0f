"""One figure for several runs: errors over time, and bars of their metrics."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from taut.base.errors import UsageError
from taut.base.plot_style import (
    DASHED,
    INK,
    SMALL,
    WIDTH,
    colour,
    legend_above,
    line,
    prepared,
    short_name,
    wrapped,
)
from taut.base.types import Float64Array
from taut.record.metrics import METRICS
from taut.record.run import Run
from taut.record.run_plot import is_task_run
from taut.record.tool import expected_deviation, force_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

JOINT_BARS: Final = ("rms_error", "peak_error", "effort", "chatter")
TASK_BARS: Final = ("task_rms", "task_rms_rotation", "effort", "chatter")
FORCE_BARS: Final = ("force_error_rms", "moment_error_rms", "effort", "chatter")
MAX_RUNS: Final = 8  # in one figure
BARS_IN_ROW: Final = 4
BAR_TITLE_LETTERS: Final = 96  # of all titles of bars in a row
NAME: Final = 18  # letters of a run's name beside its bars, on each of two lines


class Panel(NamedTuple):
    """Curves over time, one for each run that has it, by the run's number."""

    title: str
    unit: str
    curves: dict[int, Float64Array]
    references: dict[int, Float64Array] = {}  # noqa: RUF012  (nothing changes it)
    from_zero: bool = True  # show zero: errors, not positions


def compare(
    runs: Mapping[str, Run],
    *,
    title: str = "",
    measures: Sequence[str] | None = None,
    joint: str | None = None,
    window: tuple[float, float] | None = None,
    torques: bool = False,
    bars: Mapping[str, Sequence[float]] | None = None,
) -> Figure:
    """Error norm over time of at most eight runs, and bars of their metrics, as a matplotlib Figure.

    Joints in rad and joints in m have no norm together: each unit has its own axes and bars. With a reference of the
    task, the errors are those of the tool's position and rotation, and of the force and moment that the arm applies;
    where the peak force is the first measure asked for, the force of the environment is drawn in their place.
    `measures` are metrics to draw; `joint` is one to draw alone, `window` (start, end) [s] what the bars are about.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    if not 0 < len(runs) <= MAX_RUNS:
        raise UsageError(f"a figure compares 1 to {MAX_RUNS} runs; got {len(runs)}", name="runs")
    each, names = list(runs.values()), [name.replace("$", r"\$") for name in runs]
    drawn = _force if measures and measures[0] == "peak_force" else _errors
    columns = [list(_panels([drawn(run) for run in each], each) if joint is None else _of_joint(each, joint))]
    if torques:
        columns.append(list(_panels([_torques(run) for run in each], each)))
    if bars is None:
        within = [run if window is None else run.between(*window) for run in each]
        bars = dict(_bars(within, measures or _usual_bars(each), joint))
    rows, bar_rows = max(map(len, columns)), max(-(-len(bars) // BARS_IN_ROW), 1)
    across = max(-(-len(bars) // bar_rows), 1)
    titles = {words: wrapped(words, BAR_TITLE_LETTERS // across) for words in bars}
    labels = [wrapped(name, NAME) for name in names]
    bar = 0.36 if any("\n" in label for label in labels) else 0.22  # [inch]
    head = 0.45 if any("\n" in words for words in titles.values()) else 0.3  # [inch]
    heights = [0.5 + (2.1 if rows == 1 else 1.7 * rows), bar_rows * (head + bar * len(runs))]
    figure = Figure(figsize=(WIDTH, 0.3 + sum(heights)), dpi=150, layout="constrained")
    if title:
        figure.suptitle(short_name(title, 110), fontsize=9.5, color=INK, x=0.01, ha="left")
    top, bottom = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
    grid = top.subplots(max(rows, 1), len(columns), squeeze=False, sharex=True)
    for column, panels in zip(grid.T, columns, strict=True):
        for i, ax in enumerate(column):
            ax.set_visible(i < len(panels))
        for ax, panel in zip(column, panels, strict=False):
            _draw(ax, panel, each)
        column[max(len(panels) - 1, 0)].set_xlabel("t [s]", fontsize=SMALL, color=INK)
        column[max(len(panels) - 1, 0)].tick_params(labelbottom=True)
    handles = [
        Line2D([], [], color=colour(i), linewidth=2.0, label=short_name(name, 30)) for i, name in enumerate(names)
    ]
    if any(panel.references for panels in columns for panel in panels):
        label = "reference" if joint is not None else "eq. 10.48"
        handles.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label=label))
    legend_above(top, handles)
    if window is not None:
        bottom.suptitle(f"from {window[0]:g} to {window[1]:g} s", fontsize=SMALL, color=INK, x=0.01, ha="left")
    below = bottom.subplots(bar_rows, across, squeeze=False)
    for ax in below.flat[len(bars) :]:
        ax.set_visible(False)
    for ax, (words, numbers) in zip(below.flat, bars.items(), strict=False):
        _draw_bars(prepared(ax, titles[words]), numbers)
    for row in below:
        row[0].set_yticks(row[0].get_yticks(), labels)
    return figure


Curves = dict[tuple[str, str], Float64Array]  # by title and unit


def _panels(found: Sequence[Curves], runs: Sequence[Run]) -> Iterator[Panel]:
    """A panel for each title and unit; with the deviation that laws of impedance promise under the wrench."""
    for title, unit in dict.fromkeys(head for curves in found for head in curves):
        curves = {i: each[title, unit] for i, each in enumerate(found) if (title, unit) in each}
        promised = {i: expected_deviation(runs[i]) for i in curves} if title.endswith("position error") else {}
        references = {i: np.linalg.norm(x[:, :3], axis=1) for i, x in promised.items() if x is not None}
        yield Panel(title, unit, curves, references)


def _force(run: Run) -> Curves:
    """(k,) norm of the environment's force on the arm."""
    F_ext = run.extra.get("F_ext")
    return {} if F_ext is None else {("force of the environment", "N"): np.linalg.norm(F_ext[:, :3], axis=1)}


def _errors(run: Run) -> Curves:
    """(k,) norms of a run's errors; of an arm of one joint the error with its sign."""
    if not run.info.parts:
        return _errors_of_one(run)
    out: Curves = {}  # of laws side by side, the norms of all together
    for part in run.info.parts:
        for head, norm in _errors_of_one(run.part(part)).items():
            out[head] = np.hypot(out.get(head, 0.0), norm)
    return out


def _errors_of_one(run: Run) -> Curves:
    wrench = force_error(run) if len(run) else None
    if wrench is not None:
        out = {("norm of the force error", "N"): np.linalg.norm(wrench[:, :3], axis=1)}
        if np.any(wrench[:, 3:]):
            out["norm of the moment error", "N m"] = np.linalg.norm(wrench[:, 3:], axis=1)
        return out
    if run.error is not None:
        return _norms(run.error, run.units, "tracking error", "of the joints")
    if not is_task_run(run):
        return {}
    position, rotation = run.task.position_error, run.task.rotation_error
    assert position is not None
    assert rotation is not None
    return {
        ("norm of the tool's position error", "m"): np.linalg.norm(position, axis=1),
        ("angle of the tool's rotation error", "rad"): np.linalg.norm(rotation, axis=1),
    }


def _torques(run: Run) -> Curves:
    return _norms(run.tau, run.effort_units, "torques", "of the joints")


def _norms(rows: Float64Array, units: Sequence[str], what: str, whose: str) -> Curves:
    """(k,) norms of the columns (k, n) of each unit; a single column with its sign."""
    if len(units) == 1:
        return {(what.removesuffix("s"), units[0]): rows[:, 0]}
    out = {}
    for unit in dict.fromkeys(units):
        title = f"norm of the {what}" + (f" {whose} in {unit}" if len(set(units)) > 1 else "")
        out[title, unit] = np.linalg.norm(rows[:, [i for i, each in enumerate(units) if each == unit]], axis=1)
    return out


def _of_joint(runs: Sequence[Run], joint: str) -> Iterator[Panel]:
    """Motion of one joint, and its error below."""
    places = [run.joint_names.index(joint) for run in runs]
    unit = runs[0].units[places[0]]
    positions = {i: run.q[:, place] for i, (run, place) in enumerate(zip(runs, places, strict=True))}
    errors = {i: run.error[:, places[i]] for i, run in enumerate(runs) if run.error is not None}
    references = {i: positions[i] + error for i, error in errors.items()}
    yield Panel(f"position of {short_name(joint, 40)}", unit, positions, references, from_zero=False)
    if errors:
        yield Panel("tracking error", unit, errors)


def _draw(ax: Axes, panel: Panel, runs: Sequence[Run]) -> None:
    """Curves over time."""
    prepared(ax, panel.title, f"[{panel.unit}]")
    for i, curve in panel.curves.items():
        line(ax, runs[i].t, curve, colour(i))
    for i, curve in panel.references.items():
        line(ax, runs[i].t, curve, INK, reference=True)
    if panel.from_zero:
        ax.axhline(0.0, color=INK, linewidth=0.6)
        if not any(curve.min() < 0.0 for curve in panel.curves.values()):
            ax.set_ylim(bottom=0.0)
    ax.margins(x=0.01)


def _usual_bars(runs: Sequence[Run]) -> Sequence[str]:
    if any(len(run) and force_error(run) is not None for run in runs):
        return FORCE_BARS
    return TASK_BARS if any(map(is_task_run, runs)) else JOINT_BARS


def _bars(runs: Sequence[Run], measures: Sequence[str], joint: str | None) -> Iterator[tuple[str, list[float]]]:
    """Title and number of each run, for each metric and unit; NaN where no joint of a run has that unit."""
    for measure in measures:
        found = [run.metrics.by_unit(measure, joint) for run in runs]
        for unit in dict.fromkeys(unit for numbers in found for unit in numbers):
            values = [numbers.get(unit, math.nan) for numbers in found]
            if not np.isnan(values).all():
                yield f"{METRICS[measure].title} [{unit}]", values


def _draw_bars(ax: Axes, values: Sequence[float]) -> None:
    """A bar with its number for each run."""
    finite = [value if math.isfinite(value) else 0.0 for value in values]
    places = np.arange(len(values))[::-1]
    bars = ax.barh(places, finite, height=0.68, color=[colour(i) for i in range(len(values))])
    ax.bar_label(bars, [_number(value) for value in values], padding=3.0, fontsize=7.5, color=INK)
    ax.set_xlim(1.1 * min([0.0, *finite]), 1.55 * (max(map(abs, finite)) or 1.0))
    ax.set_yticks(places, [""] * len(places))
    ax.set_xticks([])
    ax.grid(False)
    ax.tick_params(axis="y", length=0.0)
    ax.spines["bottom"].set_visible(False)


def _number(value: float) -> str:
    """Three digits, without an exponent where that is as short."""
    if not math.isfinite(value):
        return "-" if math.isnan(value) else "inf"
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.2e}"
    return np.format_float_positional(float(f"{value:.3g}"), trim="-")
