"""Plots of a run, like the chapter's figures: positions, errors, the torque and what it is made of, the tool.

Figures are made without pyplot, so that no window, no display and no global state is involved.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import RangeError, UsageError, unknown_name
from taut.base.plot_style import (
    DASHED,
    DOTTED,
    INK,
    LETTER,
    SMALL,
    WIDTH,
    colour,
    dashes,
    legend_above,
    legend_rows,
    line,
    prepared,
    short,
    short_name,
)
from taut.base.types import Float64Array
from taut.control.trajectories.compound import PhaseSample
from taut.control.trajectories.force_reference import HybridMotion
from taut.control.trajectories.task_reference import TaskMotion
from taut.record.tool import true_normal, wanted_wrench

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.lines import Line2D

    from taut.record.run import Run

__all__ = ["is_task_run", "plot"]

MAX_JOINTS: Final = 8  # joints in one figure
PANELS_ACROSS: Final = 4  # small pictures side by side
NEAR_LIMIT: Final = 0.5  # of a limit: a joint that gets there has its limit drawn
LEGEND_LINE: Final = 0.19  # [in]
LETTERS: Final = 96  # in one line of the title
MAX_LINES: Final = 4  # of how the run ended, with how to fix it
TIME: Final = "t [s]"
_NUMBER: Final = re.compile(r"\b\d+\.\d+(e[+-]?\d+)?\b")
TERMS: Final = {
    "torque": "terms of the torque",
    "velocity": "terms of the velocity",
    "position": "terms of the position",
}


def plot(run: Run, *, joints: Iterable[str | int] | None = None) -> Figure:
    """Positions with the reference dashed, tracking error, torque with its limits, and the terms, over time.

    Where the reference is one of the task, the tool's position and both its errors stand above, and where something
    touched the tool, its force and moment.

    Args:
        run: The run.
        joints: Names or indices; by default all, of more than eight the eight with the largest error.

    Raises:
        UnknownNameError: The run has no such joint.
        UsageError: No joint, more than eight, or a run without ticks.
    """
    from matplotlib.figure import Figure

    shown = _chosen(run, joints)
    if not len(run):
        raise UsageError("there is nothing to plot: the run has no ticks", name="run")
    units = list(dict.fromkeys(run.units[i] for i in shown))
    overview_rows = 2 if len(shown) == 1 else len(units)
    term_rows = 0 if len(shown) == 1 or not run.terms else -(-len(shown) // PANELS_ACROSS)
    heights = [0.55 + 1.75 * overview_rows]
    if term_rows:
        lines = legend_rows([str(key.get_label()) for key in _headed_term_keys(run)])
        heights.append(0.25 + LEGEND_LINE * lines + 1.35 * term_rows)
    of_task = shows_tool(run)
    touched = is_touched(run)
    heights = [TASK_HEIGHT] * (of_task + touched) + heights
    figure = Figure(figsize=(WIDTH, 0.5 + sum(heights)), dpi=150, layout="constrained")
    figure.suptitle(_title(run, shown), fontsize=9.0, color=INK, x=0.01, ha="left")
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    if of_task:
        plot_task(run, parts[0])
        parts = parts[1:]
    if touched:
        plot_wrench(run, parts[0])
        parts = parts[1:]
    if len(shown) == 1:
        _one_joint(run, shown[0], parts[0])
    else:
        _overview(run, shown, units, parts[0])
    if term_rows:
        _small_pictures(run, shown, parts[1], term_rows)
    if run.info.phases:
        mark_phases(run, figure)
    return figure


def _chosen(run: Run, joints: Iterable[str | int] | None) -> list[int]:
    if joints is None:
        if run.n <= MAX_JOINTS:
            return list(range(run.n))
        size = run.q - run.q[:1] if run.error is None else run.error
        largest = np.argsort(-np.max(np.abs(size), axis=0, initial=0.0), kind="stable")
        return sorted(int(i) for i in largest[:MAX_JOINTS])
    if isinstance(joints, str):
        joints = [joints]
    shown: list[int] = []
    for joint in joints:
        if isinstance(joint, str):
            if joint not in run.joint_names:
                raise unknown_name("the run", "joint", joint, run.joint_names)
            shown.append(run.joint_names.index(joint))
        elif isinstance(joint, bool) or not isinstance(joint, (int, np.integer)):
            raise UsageError(f"joints must be names or indices; got {joint!r}", name="joints", value=joint)
        elif not 0 <= joint < run.n:
            raise RangeError(f"joints must be indices from 0 to {run.n - 1}; got {joint}", name="joints", value=joint)
        else:
            shown.append(int(joint))
    shown = list(dict.fromkeys(shown))
    if not 0 < len(shown) <= MAX_JOINTS:
        raise UsageError(f"joints must name 1 to {MAX_JOINTS} joints for one figure; got {len(shown)}", name="joints")
    return shown


def _title(run: Run, shown: Sequence[int]) -> str:
    arm, plant = run.info.arm, run.info.plant
    place = plant if arm and arm in plant else f"{arm}, {plant}".strip(", ")
    law = _NUMBER.sub(lambda number: f"{float(number[0]):.4g}", run.info.law or "run")
    if run.info.phases:  # the laws of all phases have no room
        law = ", ".join(run.info.phases)
    law = short(law, LETTERS - len(place) - 4)
    which = f"{len(shown)} of {run.n} joints; " if len(shown) < run.n else ""
    ended = textwrap.wrap(which + str(run.outcome), LETTERS, max_lines=MAX_LINES, placeholder="...")
    return "\n".join([f"{law}  on  {place}", *ended])


# -------------------------------------------------------------------- parts of the figure


def _one_joint(run: Run, joint: int, figure: SubFigure) -> None:
    """The four pictures of the chapter: position, error, torque, terms."""
    (ax_q, ax_e), (ax_tau, ax_terms) = figure.subplots(2, 2, sharex=True)
    _positions(run, [joint], run.units[joint], ax_q)
    _errors(run, [joint], run.units[joint], ax_e)
    _commands(run, [joint], run.command_units[joint], ax_tau)
    _terms(run, joint, prepared(ax_terms, TERMS[run.kind], f"[{run.command_units[joint]}]"), first=1)
    for ax in (ax_tau, ax_terms):
        ax.set_xlabel(TIME, fontsize=SMALL, color=INK)
    legend_above(figure, [*_keys(run, [joint], ax_tau), *_term_keys(run, first=1)])


def _overview(run: Run, shown: Sequence[int], units: Sequence[str], figure: SubFigure) -> None:
    """Position, error and torque of all joints, one row for those in rad and one for those in m."""
    axes = figure.subplots(len(units), 3, squeeze=False, sharex=True)
    for row, unit in zip(axes, units, strict=True):
        here = [joint for joint in shown if run.units[joint] == unit]
        places = [shown.index(joint) for joint in here]
        _positions(run, here, unit, row[0], places)
        _errors(run, here, unit, row[1], places)
        _commands(run, here, run.command_units[here[0]], row[2], places)
    for ax in axes[-1]:
        ax.set_xlabel(TIME, fontsize=SMALL, color=INK)
    legend_above(figure, _keys(run, shown, *axes[:, 2]))


def _small_pictures(run: Run, shown: Sequence[int], figure: SubFigure, rows: int) -> None:
    """The terms of the command, a small picture for each joint."""
    axes = figure.subplots(rows, PANELS_ACROSS if rows > 1 else len(shown), squeeze=False, sharex=True)
    for i, ax in enumerate(axes.flat):
        if i >= len(shown):
            ax.set_visible(False)
            continue
        unit = run.command_units[shown[i]]
        first = i % axes.shape[1] == 0 or unit != run.command_units[shown[i - 1]]
        _terms(run, shown[i], prepared(ax, short_name(run.joint_names[shown[i]], 18), f"[{unit}]" if first else ""))
        if i + axes.shape[1] >= len(shown):
            ax.tick_params(labelbottom=True)
    for ax in axes[-1]:
        ax.set_xlabel(TIME, fontsize=SMALL, color=INK)
    legend_above(figure, _headed_term_keys(run))


def _positions(run: Run, joints: Sequence[int], unit: str, ax: Axes, places: Sequence[int] = (0,)) -> None:
    wanted = getattr(run.reference, "q", None)
    prepared(ax, "position" if wanted is None else "position and reference", f"q [{unit}]")
    for place, joint in zip(places, joints, strict=True):
        line(ax, run.t, run.q[:, joint], colour(place))
        if wanted is not None:
            line(ax, run.t, wanted[:, joint], INK, reference=True)


def _errors(run: Run, joints: Sequence[int], unit: str, ax: Axes, places: Sequence[int] = (0,)) -> None:
    if run.error is None:
        prepared(ax, "velocity", f"v [{unit}/s]")
        values = run.v
    else:
        prepared(ax, "tracking error", f"wanted - true [{unit}]")
        values = run.error
    ax.axhline(0.0, color=INK, linewidth=0.6)
    for place, joint in zip(places, joints, strict=True):
        line(ax, run.t, values[:, joint], colour(place))


def _commands(run: Run, joints: Sequence[int], unit: str, ax: Axes, places: Sequence[int] = (0,)) -> None:
    """What acted, and the limits of the joints that come near to them."""
    torque = run.kind == "torque"
    values = run.tau if torque else run.command
    limits = _limits(run)
    near = 0
    for place, joint in zip(places, joints, strict=True):
        line(ax, run.t, values[:, joint], colour(place))
        peak = float(np.max(np.abs(values[:, joint])))
        if peak > NEAR_LIMIT * limits[joint]:
            near += 1
            for level in {limits[joint] * np.sign(x) for x in (values[:, joint].min(), values[:, joint].max()) if x}:
                ax.axhline(level, color=colour(place), linewidth=1.0, linestyle=DOTTED, label="limit")
    far = "" if near or np.isinf(limits[list(joints)]).any() else " (below half of limits)"
    name = ("force" if unit == "N" else "torque") + far if torque else f"{run.kind} command"
    prepared(ax, name, f"{'tau' if torque else 'command'} [{unit}]")


def _limits(run: Run) -> Float64Array:
    """(n,) largest torque that the controller lets through, else that the arm can give; inf where none is known."""
    known: Any = np.inf
    if run.kind == "torque":
        known = run.info.parameters.get("limits.tau", np.inf if run.arm is None else run.arm.effort)
    return np.broadcast_to(np.asarray(known, dtype=np.float64), (run.n,))


def _terms(run: Run, joint: int, ax: Axes, first: int = 0) -> None:
    for i, name in enumerate(_busy_terms(run), start=first):
        line(ax, run.t, run.terms[name][:, joint], colour(i), style=dashes(i))


def _busy_terms(run: Run) -> list[str]:
    """The terms that are not zero all the time."""
    return [name for name, values in run.terms.items() if values.any()]


def _keys(run: Run, joints: Sequence[int], *torque_axes: Axes) -> list[Line2D]:
    from matplotlib.lines import Line2D

    keys = [
        Line2D([], [], color=colour(i), linewidth=1.5, label=short_name(run.joint_names[joint], 30))
        for i, joint in enumerate(joints)
    ]
    if run.error is not None:
        keys.append(Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label="reference"))
    if any(artist.get_label() == "limit" for ax in torque_axes for artist in ax.lines):
        keys.append(Line2D([], [], color=INK, linewidth=1.0, linestyle=DOTTED, label="limit"))
    return keys


def _headed_term_keys(run: Run) -> list[Line2D]:
    """The keys of the terms, with what they are of before them."""
    from matplotlib.lines import Line2D

    return [Line2D([], [], linewidth=0.0, label=f"{TERMS[run.kind]}:"), *_term_keys(run)]


def _term_keys(run: Run, first: int = 0) -> list[Line2D]:
    """A key for each term, and one that names those that are zero all the time."""
    from matplotlib.lines import Line2D

    busy = _busy_terms(run)
    keys = [
        Line2D([], [], color=colour(i), linewidth=1.5, linestyle=dashes(i), label=name)
        for i, name in enumerate(busy, start=first)
    ]
    idle = [name for name in run.terms if name not in busy]
    return [*keys, Line2D([], [], linewidth=0.0, label=f"zero: {', '.join(idle)}")] if idle else keys


# -------------------------------------------------------------------- the tool

TASK_HEIGHT: Final = 2.3  # [in]
AXES: Final = ("x", "y", "z")


def is_task_run(run: Run) -> bool:
    """Whether a run has errors of the task."""
    return isinstance(run.reference.motion, TaskMotion) and run.info.tool is not None


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
    contact = true_normal(run)
    pressed = contact is not None and bool(np.any(contact[0]))
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
    pressing = pressed and contact is not None and _press(run, contact[0], axes[2])
    keys = [*_axis_keys("F_ext at the tool, world axes:")]
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
        if piece.info.tool is not None:
            frames[piece.task.frame] = None
            _piece_of_task(piece, ax_p, ax_e, ax_r)
    keys = _axis_keys(f"{short_name(', '.join(frames), 30)}, world axes:")
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


def _axis_keys(heading: str) -> list[Line2D]:
    from matplotlib.lines import Line2D

    axes = [Line2D([], [], color=colour(i), linewidth=1.5, label=name) for i, name in enumerate(AXES)]
    return [Line2D([], [], linewidth=0.0, label=heading), *axes]


def _dashed(label: str) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=INK, linewidth=0.9, linestyle=DASHED, label=label)


# -------------------------------------------------------------------- phases

PHASE_LETTERS: Final = 10  # of a name
PHASE_SIZE: Final = 7.5  # [pt] of the letters
MIN_HEIGHT: Final = 1.3  # [in] that a picture has at least
AXES_FRACTION: Final = 0.75  # of a picture's share of the page is between its axes


def mark_phases(run: Run, figure: Figure) -> None:
    """Draw where each phase of a task begins into every picture that shows the run over time."""
    found = run.phases
    axes = [ax for ax in figure.axes if ax.get_visible()]
    for ax in axes:
        for window in found[1:]:
            ax.axvline(window.start, color=INK, linewidth=0.7, linestyle=DOTTED, zorder=0.5)
    if not axes:
        return
    first = axes[0]
    place = first.get_subplotspec()
    across = 1 if place is None else place.get_gridspec().ncols
    letter = (
        1.3 * PHASE_SIZE / (72.0 * WIDTH * AXES_FRACTION / across) * float(run.t[-1] - run.t[0])
    )  # [s] that a name takes
    named = [window for window in found if window.end - window.start >= letter]  # the others have no room for it
    longest = max((len(short_name(window.name, PHASE_LETTERS)) for window in named), default=0)
    room = (LETTER * PHASE_SIZE * longest + 6.0) / (72.0 * MIN_HEIGHT)  # of the height, above the curves
    low, high = first.get_ylim()
    first.set_ylim(low, high + room / (1.0 - room) * (high - low))
    for window in named:
        first.annotate(
            short_name(window.name, PHASE_LETTERS),
            (window.start, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3.0, -2.0),
            textcoords="offset points",
            fontsize=PHASE_SIZE,
            color=INK,
            va="top",
            rotation=90,
        )
