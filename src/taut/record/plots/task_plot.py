"""Plots of the task side of a run: where the tool was, how far from where it should have been, what touched it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.base.types import Float64Array
from taut.control.tasks.phase_sample import PhaseSample
from taut.control.trajectories.hybrid_motion import HybridMotion
from taut.control.trajectories.task_reference import TaskMotion
from taut.record.info import TOOL
from taut.record.plots.style import DASHED, INK, colour, legend_above, line, prepared, short_name
from taut.record.tool import true_normal, wanted_wrench

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import SubFigure
    from matplotlib.lines import Line2D

    from taut.record.run import Run

__all__ = ["TASK_HEIGHT", "is_task_run", "is_touched", "plot_task", "plot_wrench", "shows_tool"]

TASK_HEIGHT: Final = 2.3  # [in]
AXES: Final = ("x", "y", "z")


def is_task_run(run: Run) -> bool:
    """Whether a run has errors of the task."""
    return isinstance(run.reference.motion, TaskMotion) and TOOL in run.info


def shows_tool(run: Run) -> bool:
    """Whether a run has errors of the task, in one of its phases at least."""
    return any(is_task_run(piece) for piece in _pieces(run))


def is_touched(run: Run) -> bool:
    """Whether something touched the tool in a run."""
    return "F_ext" in run.extra and bool(np.any(run.extra["F_ext"] != 0.0))


def _pieces(run: Run) -> list[Run]:
    """A run; one of a task whose phases follow different kinds of reference, phase by phase."""
    if not isinstance(run.reference, PhaseSample):
        return [run]
    visits: dict[str, int] = {}
    out = []
    for window in run.phases:
        visit = visits.get(window.name, 0)
        visits[window.name] = visit + 1
        out.append(run.phase(window.name, visit))
    return out


def plot_wrench(run: Run, figure: SubFigure) -> None:
    """Force and moment of the environment on the arm at the tool, in world axes, with what was wanted dashed.

    Where the contacts of a scene tell their normals, the force along them stands beside, with the one asked for.
    """
    told = true_normal(run)
    pressed = told is not None and bool(np.any(told[0]))
    axes = figure.subplots(1, 3 if pressed else 2, sharex=True)
    asked = False
    for ax, first, what in zip(axes, (0, 3), ("force [N]", "moment [N m]"), strict=False):
        prepared(ax, what.partition(" [")[0] + " on the arm", what)
        ax.axhline(0.0, color=INK, linewidth=0.6)
        for i in range(3):
            line(ax, run.t, run.extra["F_ext"][:, first + i], colour(i))
        for piece in _pieces(run):
            wanted = wanted_wrench(piece)
            for i in range(3) if wanted is not None else ():
                asked = True
                line(ax, piece.t, -np.asarray(wanted)[:, first + i], INK, reference=True)
    pressing = pressed and told is not None and _press(run, told[0], axes[2])
    keys = [*_keys("F_ext at the tool, world axes:")]
    if asked or pressing:
        keys.append(_dashed("wanted, -F_app" if asked and not pressing else "wanted"))
    legend_above(figure, keys)


def _press(run: Run, force: Float64Array, ax: Axes) -> bool:
    """The force along the normals of the contacts; whether there was one that was asked for."""
    prepared(ax, "force along the normal", "force [N]")
    line(ax, run.t, force, colour(3))
    asked = False
    for piece in _pieces(run):
        if isinstance(piece.reference, HybridMotion) and np.any(piece.reference.press):
            asked = True
            line(ax, piece.t, np.asarray(piece.reference.press)[:, 0], INK, reference=True)
    return asked


def plot_task(run: Run, figure: SubFigure) -> None:
    """Position with the reference dashed, position error and rotation error, in world axes."""
    ax_p, ax_e, ax_r = figure.subplots(1, 3, sharex=True)
    prepared(ax_p, "tool and reference", "p [m]")
    prepared(ax_e, "position error", "wanted - true [m]")
    prepared(ax_r, "rotation error", "log(R_des R^T) [rad]")
    for ax in (ax_e, ax_r):
        ax.axhline(0.0, color=INK, linewidth=0.6)
    frames: dict[str, None] = {}
    for piece in _pieces(run):
        if TOOL in piece.info:
            frames[piece.task.frame] = None
            _piece_of_task(piece, ax_p, ax_e, ax_r)
    keys = _keys(f"{short_name(', '.join(frames), 30)}, world axes:")
    legend_above(figure, [*keys, _dashed("reference")])


def _piece_of_task(run: Run, ax_p: Axes, ax_e: Axes, ax_r: Axes) -> None:
    """One stretch of it; of one that follows nothing of the task the tool's position alone."""
    task = run.task
    for i in range(3):
        line(ax_p, run.t, task.p[:, i], colour(i))
    wanted, position, rotation = task.wanted, task.position_error, task.rotation_error
    if wanted is None or position is None or rotation is None:
        return
    for i in range(3):
        line(ax_p, run.t, wanted.p[:, i], INK, reference=True)
        line(ax_e, run.t, position[:, i], colour(i))
        line(ax_r, run.t, rotation[:, i], colour(i))


def _keys(heading: str) -> list[Line2D]:
    from matplotlib.lines import Line2D

    axes = [Line2D([], [], color=colour(i), linewidth=1.5, label=name) for i, name in enumerate(AXES)]
    return [Line2D([], [], linewidth=0.0, label=heading), *axes]


def _dashed(label: str) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label=label)
