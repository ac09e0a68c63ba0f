"""Plots of a run, like the chapter's figures, without pyplot: no window, no display, no global state."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import UsageError, unknown_name
from taut.base.plot_style import (
    DASHED,
    DOTTED,
    INK,
    SMALL,
    WIDTH,
    LineStyle,
    colour,
    dashes,
    legend_above,
    legend_rows,
    line,
    prepared,
    short,
    short_name,
)
from taut.control.trajectories.compound import PhaseSample
from taut.control.trajectories.force_reference import HybridMotion
from taut.control.trajectories.task_reference import TaskMotion
from taut.record.tool import true_normal, wanted_wrench

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.lines import Line2D

    from taut.record.run import Run

MAX_JOINTS: Final = 8  # joints in one figure
PANELS_ACROSS: Final = 4  # small pictures side by side
NEAR_LIMIT: Final = 0.5  # of a limit: a joint that gets there has its limit drawn
TOOL_HEIGHT: Final = 2.3  # [in]
LEGEND_LINE: Final = 0.19  # [in]
LETTERS: Final = 96  # in one line of the title
MAX_LINES: Final = 4  # of how the run ended, with how to fix it
PHASE_LETTERS: Final = 10  # of a name
PHASE_ROOM: Final = 0.6  # of the first picture's height, added above its curves for the names
PHASE_SIZE: Final = 7.5  # [pt] of the letters
MIN_PHASE: Final = 0.09  # of the run: a shorter phase has no room for its name
TIME: Final = "t [s]"
AXES: Final = ("x", "y", "z")
_NUMBER: Final = re.compile(r"\b\d+\.\d+(e[+-]?\d+)?\b")


def plot(run: Run, *, joints: Iterable[str] | None = None) -> Figure:
    """Positions with the reference dashed, tracking error, torque with its limits, and the terms, over time.

    With a reference of the task, the tool's position and both its errors stand above, and where something touched the
    tool, its force and moment. By default all joints, of more than eight those with the largest error.
    """
    from matplotlib.figure import Figure

    shown = _chosen(run, joints)
    if not len(run):
        raise UsageError("there is nothing to plot: the run has no ticks", name="run")
    parts: list[tuple[float, Callable[[SubFigure], None]]] = []  # height [in] and what draws it
    if any(is_task_run(piece) for piece in _pieces(run)):
        parts.append((TOOL_HEIGHT, lambda figure: _tool(run, figure)))
    if run.first_contact is not None:
        parts.append((TOOL_HEIGHT, lambda figure: _wrench(run, figure)))
    units = list(dict.fromkeys(run.units[i] for i in shown))
    parts.append((0.55 + 1.75 * len(units), lambda figure: _joints(run, shown, units, figure)))
    if run.terms:
        rows, lines = -(-len(shown) // PANELS_ACROSS), legend_rows([str(key.get_label()) for key in _term_keys(run)])
        height = 0.25 + LEGEND_LINE * lines + 1.35 * rows
        parts.append((height, lambda figure: _terms(run, shown, figure, rows)))
    heights = [height for height, _ in parts]
    figure = Figure(figsize=(WIDTH, 0.5 + sum(heights)), dpi=150, layout="constrained")
    figure.suptitle(_title(run, shown), fontsize=9.0, color=INK, x=0.01, ha="left")
    places = figure.subfigures(len(parts), 1, height_ratios=heights, squeeze=False)[:, 0]
    for (_, draw), place in zip(parts, places, strict=True):
        draw(place)
    if run.info.phases:
        _mark_phases(run, figure)
    return figure


def _chosen(run: Run, joints: Iterable[str] | None) -> list[int]:
    if joints is None:
        size = run.q - run.q[:1] if run.error is None else run.error
        largest = np.argsort(-np.max(np.abs(size), axis=0, initial=0.0), kind="stable")
        return sorted(int(i) for i in largest[:MAX_JOINTS])
    names = dict.fromkeys([joints] if isinstance(joints, str) else joints)
    for name in names:
        if name not in run.joint_names:
            raise unknown_name("the run", "joint", str(name), run.joint_names)
    shown = [run.joint_names.index(name) for name in names]
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


def _key(label: str, colour: str = INK, style: LineStyle = "-", width: float = 1.5) -> Line2D:
    """An entry of a legend; of width 0 a heading."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, linewidth=width, linestyle=style, label=label)


def _dashed(label: str) -> Line2D:
    return _key(label, style=DASHED, width=0.9)


def _joints(run: Run, shown: Sequence[int], units: Sequence[str], figure: SubFigure) -> None:
    """Position, error and torque of all joints, one row for those in rad and one for those in m."""
    axes = figure.subplots(len(units), 3, squeeze=False, sharex=True)
    wanted, limited = getattr(run.reference, "q", None), False
    for (ax_q, ax_e, ax_tau), unit in zip(axes, units, strict=True):
        here = {place: joint for place, joint in enumerate(shown) if run.units[joint] == unit}
        command_unit = run.command_units[next(iter(here.values()))]
        prepared(ax_q, "position" if wanted is None else "position and reference", f"q [{unit}]")
        if run.error is None:
            prepared(ax_e, "velocity", f"v [{unit}/s]")
        else:
            prepared(ax_e, "tracking error", f"wanted - true [{unit}]")
        if run.kind == "torque":
            prepared(ax_tau, "force" if command_unit == "N" else "torque", f"tau [{command_unit}]")
        else:
            prepared(ax_tau, f"{run.kind} command", f"command [{command_unit}]")
        ax_e.axhline(0.0, color=INK, linewidth=0.6)
        for place, joint in here.items():
            line(ax_q, run.t, run.q[:, joint], colour(place))
            if wanted is not None:
                line(ax_q, run.t, wanted[:, joint], INK, reference=True)
            line(ax_e, run.t, (run.v if run.error is None else run.error)[:, joint], colour(place))
            limited |= _command(run, joint, place, ax_tau)
    for ax in axes[-1]:
        ax.set_xlabel(TIME, fontsize=SMALL, color=INK)
    keys = [_key(short_name(run.joint_names[joint], 30), colour(i)) for i, joint in enumerate(shown)]
    keys += [_dashed("reference")] if run.error is not None else []
    legend_above(figure, [*keys, _key("limit", style=DOTTED, width=1.0)] if limited else keys)


def _command(run: Run, joint: int, place: int, ax: Axes) -> bool:
    """What acted on a joint, with its limit (the controller's, else the arm's) if it comes near; whether it does."""
    values, limit = (run.tau if run.kind == "torque" else run.command)[:, joint], np.inf
    line(ax, run.t, values, colour(place))
    if run.kind == "torque":
        known: Any = run.info.parameters.get("limits.tau", np.inf if run.arm is None else run.arm.effort)
        limit = float(np.broadcast_to(np.asarray(known, dtype=np.float64), (run.n,))[joint])
    if not float(np.max(np.abs(values))) > NEAR_LIMIT * limit:
        return False
    for level in {limit * np.sign(x) for x in (values.min(), values.max()) if x}:
        ax.axhline(level, color=colour(place), linewidth=1.0, linestyle=DOTTED, label="limit")
    return True


def _terms(run: Run, shown: Sequence[int], figure: SubFigure, rows: int) -> None:
    """The terms of the command, a small picture for each joint."""
    axes = figure.subplots(rows, PANELS_ACROSS if rows > 1 else len(shown), squeeze=False, sharex=True)
    for i, ax in enumerate(axes.flat):
        if i >= len(shown):
            ax.set_visible(False)
            continue
        unit = run.command_units[shown[i]]
        first = i % axes.shape[1] == 0 or unit != run.command_units[shown[i - 1]]
        prepared(ax, short_name(run.joint_names[shown[i]], 18), f"[{unit}]" if first else "")
        for k, name in enumerate(_busy_terms(run)):
            line(ax, run.t, run.terms[name][:, shown[i]], colour(k), style=dashes(k))
        if i + axes.shape[1] >= len(shown):
            ax.tick_params(labelbottom=True)
    for ax in axes[-1]:
        ax.set_xlabel(TIME, fontsize=SMALL, color=INK)
    legend_above(figure, _term_keys(run))


def _busy_terms(run: Run) -> list[str]:
    """The terms that are not zero all the time."""
    return [name for name, values in run.terms.items() if values.any()]


def _term_keys(run: Run) -> list[Line2D]:
    """A key for each term, and one that names those that are zero all the time."""
    busy = _busy_terms(run)
    idle = [name for name in run.terms if name not in busy]
    keys = [_key(f"terms of the {run.kind}:", width=0.0)]
    keys += [_key(name, colour(i), dashes(i)) for i, name in enumerate(busy)]
    return [*keys, _key(f"zero: {', '.join(idle)}", width=0.0)] if idle else keys


def is_task_run(run: Run) -> bool:
    """Whether a run has errors of the task."""
    return isinstance(run.reference.motion, TaskMotion) and run.info.tool is not None


def _pieces(run: Run) -> list[Run]:
    """A run; one of a task whose phases follow different kinds of reference, phase by phase."""
    if not isinstance(run.reference, PhaseSample):
        return [run]
    return [run.phase(window.name, window.visit) for window in run.phases]


def _axis_keys(heading: str) -> list[Line2D]:
    return [_key(heading, width=0.0), *(_key(name, colour(i)) for i, name in enumerate(AXES))]


def _wrench(run: Run, figure: SubFigure) -> None:
    """Force and moment of the environment on the arm at the tool, world axes, with what was wanted dashed.

    Where the contacts of a scene report their normals, the force along them stands beside, with the one asked for.
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
    if pressed and contact is not None:
        prepared(axes[2], "force along the normal", "force [N]")
        line(axes[2], run.t, contact[0], colour(3))
        for piece in _pieces(run):
            if isinstance(piece.reference, HybridMotion) and np.any(piece.reference.press):
                asked = True
                line(axes[2], piece.t, np.asarray(piece.reference.press)[:, 0], INK, reference=True)
    keys = _axis_keys("F_ext at the tool, world axes:")
    legend_above(figure, [*keys, _dashed("wanted")] if asked else keys)


def _tool(run: Run, figure: SubFigure) -> None:
    """Position with the reference dashed, position error and rotation error, in world axes."""
    ax_p, ax_e, ax_r = figure.subplots(1, 3, sharex=True)
    prepared(ax_p, "tool and reference", "p [m]")
    prepared(ax_e, "position error", "wanted - true [m]")
    prepared(ax_r, "rotation error", "log(R_des R^T) [rad]")
    for ax in (ax_e, ax_r):
        ax.axhline(0.0, color=INK, linewidth=0.6)
    frames: dict[str, None] = {}
    for piece in _pieces(run):
        if piece.info.tool is None:
            continue
        task = piece.task
        frames[task.frame] = None
        for ax, values in ((ax_p, task.p), (ax_e, task.position_error), (ax_r, task.rotation_error)):
            for i, column in enumerate(() if values is None else values.T):
                line(ax, piece.t, column, colour(i))
        for column in () if task.wanted is None else np.asarray(task.wanted.p).T:
            line(ax_p, piece.t, column, INK, reference=True)
    keys = _axis_keys(f"{short_name(', '.join(frames), 30)}, world axes:")
    legend_above(figure, [*keys, _dashed("reference")])


def _mark_phases(run: Run, figure: Figure) -> None:
    """Draw where each phase of a task begins into every picture, with its name in the first."""
    axes = [ax for ax in figure.axes if ax.get_visible()]
    low, high = axes[0].get_ylim()
    axes[0].set_ylim(low, high + PHASE_ROOM * (high - low))
    for window in run.phases:
        for ax in axes if window.first else ():
            ax.axvline(window.start, color=INK, linewidth=0.7, linestyle=DOTTED, zorder=0.5)
        if window.end - window.start >= MIN_PHASE * float(run.t[-1] - run.t[0]):
            letters: Any = {"fontsize": PHASE_SIZE, "color": INK, "va": "top", "rotation": 90}
            label, place = short_name(window.name, PHASE_LETTERS), axes[0].get_xaxis_transform()
            beside: Any = {"xytext": (1.5, 0.0), "textcoords": "offset points"}  # the line
            axes[0].annotate(label, (window.start, 0.98), xycoords=place, **beside, **letters)
