"""One figure for several runs: how the error goes, and what it costs; and of runs that differ by chance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

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
from taut.record.plots.run_plot import is_task_run
from taut.record.run import Run
from taut.record.tool import expected_deviation, force_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["compare", "draw_bars", "draw_norms", "error_norms", "spread_figure"]

BARS: Final = ("rms_error", "peak_error", "effort", "chatter")
TASK_BARS: Final = ("task_rms", "task_rms_rotation", "effort", "chatter")
FORCE_BARS: Final = ("force_error_rms", "moment_error_rms", "effort", "chatter")
MAX_RUNS: Final = 8  # runs in one figure
NAME: Final = 18  # letters of a run's name beside its bars, on each of two lines
ROUNDING: Final = 1e-12  # below which an error is none
FAR_APART: Final = 30.0  # ratio of errors above which their axis is logarithmic


def compare(
    runs: Mapping[str, Run],
    *,
    title: str = "",
    measures: Sequence[str] | None = None,
    joint: str | None = None,
    window: tuple[float, float] | None = None,
) -> Figure:
    """Error norm over time of several runs, and bars of their metrics, as a matplotlib Figure.

    Joints in rad and joints in m have no norm together: each unit has its own axes, and bars of its own. Of runs
    whose reference is one of the task, the errors are those of the tool's position and rotation, and of force those
    of the force and moment that the arm applies.

    Args:
        runs: The runs by the name that each gets in the figure.
        title: A title for the figure.
        measures: Names of the metrics to draw as bars; by default two of the error, effort and chatter.
        window: (start, end) of what the bars are about [s]; of all if left out.
        joint: The joint whose motion, error and metrics are drawn, instead of those of all together.

    Raises:
        UsageError: No runs, more than eight, one without an error, or errors of different kinds.
        UnknownNameError: There is no such metric, or a run has no such joint.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    measures = _check(runs, measures, joint)
    errors = {name: error_norms(run) for name, run in runs.items()}
    heads = list(dict.fromkeys(head for parts in errors.values() for head in parts)) if joint is None else [("", "")]
    within = {name: run if window is None else run.between(*window) for name, run in runs.items()}
    bars = {measure: _by_unit(within, measure, joint) for measure in measures}
    rows = max(len(values) for values in bars.values())
    over_time = [2.1] if len(heads) == 1 else [1.6] * len(heads)
    over_time = over_time if joint is None else [1.9, 1.7]
    labels = [wrapped(name, NAME) for name in runs]
    bar = 0.36 if any("\n" in label for label in labels) else 0.22  # [in]
    heights = [0.5 + sum(over_time), rows * (0.3 + bar * len(runs))]
    figure = Figure(figsize=(WIDTH, 0.3 + sum(heights)), dpi=150, layout="constrained")
    if title:
        figure.suptitle(title, fontsize=9.5, color=INK, x=0.01, ha="left")
    top, bottom = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
    norms = top.subplots(len(over_time), 1, squeeze=False, sharex=True)[:, 0]
    if joint is not None:
        _one_joint(runs, joint, *norms)
    for ax, (words, unit) in zip(norms, heads, strict=True) if joint is None else ():
        shown = "norm of the tracking error" if len(heads) == 1 and words.endswith(f"joints in {unit}") else words
        shown_errors = [parts.get((words, unit)) for parts in errors.values()]
        draw_norms(runs, shown_errors, ax, (shown, unit))
    promised = joint is None and _promised(runs, norms[0])
    norms[-1].set_xlabel("t [s]", fontsize=SMALL, color=INK)
    names = [
        Line2D([], [], color=colour(i), linewidth=2.0, label=short_name(name, 30)) for i, name in enumerate(runs)
    ]
    if joint is not None and not any(is_task_run(run) for run in runs.values()):
        names.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label="reference"))
    if promised:
        names.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label="eq. 10.48"))
    legend_above(top, names)
    if window is not None:
        bottom.suptitle(f"from {window[0]:g} to {window[1]:g} s", fontsize=SMALL, color=INK, x=0.01, ha="left")
    grid = bottom.subplots(rows, len(bars), squeeze=False)
    for column, (measure, values) in zip(grid.T, bars.items(), strict=True):
        for i, ax in enumerate(column):
            ax.set_visible(i < len(values))
        for ax, (unit, numbers) in zip(column, values.items(), strict=False):
            draw_bars(prepared(ax, f"{METRICS[measure].title} [{unit}]"), numbers)
    for row in grid:
        first = next(ax for ax in row if ax.get_visible())
        first.set_yticks(first.get_yticks(), labels)
    return figure


def _check(runs: Mapping[str, Run], measures: Sequence[str] | None, joint: str | None) -> Sequence[str]:
    """The metrics to draw."""
    from taut.base.errors import unknown_name

    if not isinstance(runs, Mapping) or not all(isinstance(run, Run) for run in runs.values()):
        raise UsageError("compare takes runs by name: compare({'PID': run1, 'computed torque': run2})", name="runs")
    if not 0 < len(runs) <= MAX_RUNS:
        raise UsageError(f"compare draws 1 to {MAX_RUNS} runs in one figure; got {len(runs)}", name="runs")
    for measure in measures or ():
        if measure not in METRICS:
            raise unknown_name("a run", "metric", measure, METRICS)
    if measures is not None and not measures:
        raise UsageError("compare needs one metric at least; got measures=()", name="measures")
    of_task = [name for name, run in runs.items() if is_task_run(run)]
    of_force = [name for name, run in runs.items() if len(run) and force_error(run) is not None]
    for name, run in runs.items():
        if not len(run) or (run.error is None and name not in (*of_task, *of_force)):
            raise UsageError(f"run '{name}' has no tracking error to compare", name="runs")
        if of_force and name not in of_force:
            raise UsageError(
                f"run '{of_force[0]}' has errors of force and run '{name}' of motion; compare them apart", name="runs"
            )
        if of_task and name not in of_task:
            raise UsageError(
                f"run '{of_task[0]}' has errors of the task and run '{name}' of joints; compare them apart",
                name="runs",
            )
        if joint is not None and joint not in run.joint_names:
            raise unknown_name(f"run '{name}'", "joint", joint, run.joint_names)
    return measures or (FORCE_BARS if of_force else TASK_BARS if of_task else BARS)


Head = tuple[str, str]  # title and unit of an error


def error_norms(run: Run, *, signed: bool = True) -> dict[Head, Float64Array]:
    """(k,) norms of a run's errors; of an arm of one joint the error with its sign, if `signed`."""
    wrench = force_error(run)
    if wrench is not None:
        parts = {("norm of the force's error", "N"): np.linalg.norm(wrench[:, :3], axis=1)}
        if np.any(wrench[:, 3:]):
            parts["norm of the moment's error", "N m"] = np.linalg.norm(wrench[:, 3:], axis=1)
        return parts
    if run.error is None:
        position, rotation = run.task.position_error, run.task.rotation_error
        assert position is not None
        assert rotation is not None
        return {
            ("norm of the tool's position error", "m"): np.linalg.norm(position, axis=1),
            ("angle of the tool's rotation error", "rad"): np.linalg.norm(rotation, axis=1),
        }
    if signed and run.n == 1:
        return {("tracking error", run.units[0]): run.error[:, 0]}
    out = {}
    for unit in dict.fromkeys(run.units):
        joints = [joint for joint in range(run.n) if run.units[joint] == unit]
        head = f"norm of the tracking error of the joints in {unit}", unit
        out[head] = np.sqrt(np.sum(run.error[:, joints] ** 2, axis=1))
    return out


def _by_unit(runs: Mapping[str, Run], measure: str, joint: str | None) -> dict[str, list[float]]:
    """By the metric's unit: its number in each run, NaN where no joint of a run has that unit."""
    found = [run.metrics.by_unit(measure, joint) for run in runs.values()]
    units = dict.fromkeys(unit for numbers in found for unit in numbers)
    return {unit: [numbers.get(unit, math.nan) for numbers in found] for unit in units}


def _one_joint(runs: Mapping[str, Run], joint: str, above: Axes, below: Axes) -> None:
    """Motion of one joint, and its error below."""
    unit = ""
    for i, run in enumerate(runs.values()):
        place = run.joint_names.index(joint)
        unit = run.units[place]
        line(above, run.t, run.q[:, place], colour(i))
        if run.error is None:
            line(below, run.t, run.v[:, place], colour(i))
            continue
        line(below, run.t, run.error[:, place], colour(i))
        line(above, run.t, getattr(run.reference, "q")[:, place], INK, reference=True)  # noqa: B009  (any reference)
    prepared(above, f"position of {short_name(joint, 40)}", f"q [{unit}]")
    if any(run.error is None for run in runs.values()):
        prepared(below, "velocity", f"v [{unit}/s]")
    else:
        prepared(below, "tracking error", f"wanted - true [{unit}]")
    below.axhline(0.0, color=INK, linewidth=0.6)
    for ax in (above, below):
        ax.margins(x=0.01)


def draw_norms(runs: Mapping[str, Run], norms: Sequence[Float64Array | None], ax: Axes, head: Head) -> None:
    """Norms over time, or what has a sign, one line for each run that has it; sizes where they are far apart."""
    shown = {i: norm for i, norm in enumerate(norms) if norm is not None}
    rms = [float(np.sqrt(np.mean(norm**2))) for norm in shown.values()]
    far = min(rms) > ROUNDING and max(rms) / min(rms) > FAR_APART
    signed = any(norm.min() < 0.0 for norm in shown.values())
    prepared(ax, f"size of the {head[0]}" if far and signed else head[0], f"[{head[1]}]")
    for i, run in enumerate(runs.values()):
        if i in shown:
            line(ax, run.t, np.abs(shown[i]) if far else shown[i], colour(i))
    if far:
        ax.set_yscale("log")
        ax.set_ylim(bottom=1e-2 * min(rms))
        ax.yaxis.set_tick_params(which="minor", length=1.5, width=0.4)
    elif signed:
        ax.axhline(0.0, color=INK, linewidth=0.6)
    else:
        ax.set_ylim(bottom=0.0)
    ax.margins(x=0.01)


def _promised(runs: Mapping[str, Run], ax: Axes) -> bool:
    """Where laws of impedance promise that their tools go under the recorded wrench, where they do."""
    found = [(run.t, expected_deviation(run)) for run in runs.values() if is_task_run(run)]
    for t, x in found:
        if x is not None:
            line(ax, t, np.linalg.norm(x[:, :3], axis=1), INK, reference=True)
    return any(x is not None for _, x in found)


def draw_bars(ax: Axes, values: Sequence[float]) -> None:
    """One metric of each run, as a bar with its number."""
    finite = [value if math.isfinite(value) else 0.0 for value in values]
    places = np.arange(len(values))[::-1]
    ax.barh(places, finite, height=0.68, color=[colour(i) for i in range(len(values))])
    edge = max([abs(value) for value in finite] or [0.0]) or 1.0
    for place, value, size in zip(places, values, finite, strict=True):
        ax.text(max(size, 0.0) + 0.03 * edge, place, _number(value), fontsize=7.5, color=INK, va="center", ha="left")
    ax.set_xlim(1.1 * min([0.0, *finite]), 1.55 * edge)
    ax.set_yticks(places, [""] * len(places))
    ax.set_xticks([])
    ax.grid(False)
    ax.tick_params(axis="y", length=0.0)
    ax.spines["bottom"].set_visible(False)


def _number(value: float) -> str:
    """Three digits, without an exponent where that is as short."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "not settled"
    if value and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.2e}"
    return np.format_float_positional(float(f"{value:.3g}"), trim="-")


# -------------------------------------------------------------------- runs that differ by chance

SPREAD_HEIGHT: Final = 4.6  # [in]
WINDOW: Final = 0.02  # [s]


def spread_figure(runs: Mapping[str, Run]) -> Figure:
    """The tool's path from above, its height and the environment's force over time, one line for each run.

    Raises:
        UsageError: A run that does not say where its tool is.
    """
    from matplotlib.figure import Figure

    for name, run in runs.items():
        if run.info.tool is None:
            raise UsageError(f"run '{name}' does not say where its tool is", name="runs")
    figure = Figure(figsize=(WIDTH, SPREAD_HEIGHT), dpi=150, layout="constrained")
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
            line(force, run.t, _moving_mean(run.t, size), colour(i))
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


def _moving_mean(t: Float64Array, x: Float64Array) -> Float64Array:
    """(k,) mean of the last while: contacts that slide open and close from tick to tick."""
    ticks = min(len(t), max(1, round(WINDOW / float(t[1] - t[0])))) if len(t) > 1 else 1
    sums = np.cumsum(np.concatenate([np.zeros(ticks), x]))
    mean: Float64Array = (sums[ticks:] - sums[:-ticks]) / ticks
    return mean
