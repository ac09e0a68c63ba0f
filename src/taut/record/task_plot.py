"""Plots of the task side of a run: where the tool was, and how far from where it should have been."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.control.task_reference import TaskMotion
from taut.record.force import wanted_wrench
from taut.record.style import DASHED, INK, colour, legend_above, line, prepared, short_name
from taut.record.task import TOOL

if TYPE_CHECKING:
    from matplotlib.figure import SubFigure

    from taut.record.run import Run

__all__ = ["TASK_HEIGHT", "is_task_run", "is_touched", "plot_task", "plot_wrench"]

TASK_HEIGHT: Final = 2.3  # [in]
AXES: Final = ("x", "y", "z")


def is_task_run(run: Run) -> bool:
    """Whether a run has errors of the task."""
    return isinstance(run.reference.motion, TaskMotion) and TOOL in run.info


def is_touched(run: Run) -> bool:
    """Whether something touched the tool in a run."""
    return "F_ext" in run.extra and bool(np.any(run.extra["F_ext"] != 0.0))


def plot_wrench(run: Run, figure: SubFigure) -> None:
    """Force and moment of the environment on the arm at the tool, in world axes, with what was wanted dashed."""
    from matplotlib.lines import Line2D

    F, wanted = run.extra["F_ext"], wanted_wrench(run)
    for ax, first, what in zip(
        figure.subplots(1, 2, sharex=True), (0, 3), ("force [N]", "moment [N m]"), strict=True
    ):
        prepared(ax, what.partition(" [")[0] + " on the arm", what)
        ax.axhline(0.0, color=INK, linewidth=0.6)
        for i in range(3):
            line(ax, run.t, F[:, first + i], colour(i))
            if wanted is not None:
                line(ax, run.t, -wanted[:, first + i], INK, reference=True)
    heading = Line2D([], [], linewidth=0.0, label="F_ext at the tool, world axes:")
    keys = [Line2D([], [], color=colour(i), linewidth=1.5, label=name) for i, name in enumerate(AXES)]
    if wanted is not None:
        keys.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label="wanted, -F_app"))
    legend_above(figure, [heading, *keys])


def plot_task(run: Run, figure: SubFigure) -> None:
    """Position with the reference dashed, position error and rotation error, in world axes."""
    from matplotlib.lines import Line2D

    task = run.task
    wanted, position, rotation = task.wanted, task.position_error, task.rotation_error
    assert wanted is not None
    assert position is not None
    assert rotation is not None
    ax_p, ax_e, ax_r = figure.subplots(1, 3, sharex=True)
    prepared(ax_p, "tool and reference", "p [m]")
    prepared(ax_e, "position error", "wanted - true [m]")
    prepared(ax_r, "rotation error", "log(R_des R^T) [rad]")
    for ax in (ax_e, ax_r):
        ax.axhline(0.0, color=INK, linewidth=0.6)
    for i in range(3):
        line(ax_p, run.t, task.p[:, i], colour(i))
        line(ax_p, run.t, wanted.p[:, i], INK, reference=True)
        line(ax_e, run.t, position[:, i], colour(i))
        line(ax_r, run.t, rotation[:, i], colour(i))
    heading = Line2D([], [], linewidth=0.0, label=f"{short_name(task.frame, 30)}, world axes:")
    keys = [Line2D([], [], color=colour(i), linewidth=1.5, label=name) for i, name in enumerate(AXES)]
    wanted_key = Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label="reference")
    legend_above(figure, [heading, *keys, wanted_key])
