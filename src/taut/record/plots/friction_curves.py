"""Friction over speed, drawn like figure 10.14 of the chapter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.friction import FRICTION_FIELDS, Friction
from taut.base.checks import finite_array, positive_scalar
from taut.base.errors import ShapeError, UsageError
from taut.base.plot_style import INK, WIDTH, colour, legend_above, prepared, short_name
from taut.base.types import ArrayLike, Float64Array
from taut.maths.friction import FrictionValues, dry_limit, friction_torque

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

__all__ = ["plot_friction"]

MAX_PANELS: Final = 12
MAX_LOADS: Final = 8
FRICTION_PANELS_ACROSS: Final = 3  # panels side by side
AXIS_MARGIN: Final = 1.12  # around the curves
REST: Final = colour(1)
FALLS: Final = 6.0  # Stribeck speeds to either side, where nothing else says how far
SPEEDS: Final = np.concatenate([[1e-6], np.geomspace(1e-3, 1.0, 400)])  # of the largest


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One set of axes: the friction of one joint."""

    title: str
    friction: Friction  # each number a scalar
    speed: float  # [rad/s | m/s] to either side
    units: tuple[str, str] = ("rad/s", "N m")


def plot_friction(
    friction: Arm | Mapping[str, Friction], *, speed: float | None = None, load: ArrayLike = 0.0
) -> Figure:
    """The torque that friction takes, over speed: what acts in motion, and at rest all that it can hold.

    The torque is drawn as the chapter draws it, with the sign of the speed that it opposes.

    Args:
        friction: An arm, a panel for each joint; or frictions of one joint each by their titles.
        speed: To either side [rad/s | m/s]; if left out, six Stribeck speeds, else the joint's own limit, else 1.
        load: Torques that the motor carries while the joint moves steadily or rests [N m | N], a curve for each.

    Raises:
        UsageError: Not friction, nothing to draw, or more panels or loads than a figure holds.
        RangeError: A speed that is not above zero.

    Example:
        >>> figure = plot_friction({"Coulomb": Friction(coulomb=0.5)})
        >>> len(figure.axes)
        1

    References:
        Chapter, figure 10.14.
    """
    from matplotlib.figure import Figure as NewFigure

    loads = np.unique(finite_array("load", load, unit="N m"))
    if not 0 < len(loads) <= MAX_LOADS:
        raise UsageError(f"load must be 1 to {MAX_LOADS} torques for one figure; got {len(loads)}", name="load")
    panels = _panels(friction)
    if not 0 < len(panels) <= MAX_PANELS:
        raise UsageError(
            f"a figure has 1 to {MAX_PANELS} panels of friction; got {len(panels)}; draw fewer",
            name="friction",
        )
    if speed is not None:
        reach = positive_scalar("speed", speed, unit="rad/s")
        panels = [Panel(title=p.title, friction=p.friction, speed=reach, units=p.units) for p in panels]
    across = min(FRICTION_PANELS_ACROSS, len(panels))
    rows = -(-len(panels) // across)
    size = (WIDTH, 0.4 + (1.95 if across == FRICTION_PANELS_ACROSS else 2.3) * rows)
    figure = NewFigure(figsize=size, dpi=150, layout="constrained")
    compared = isinstance(friction, Mapping)  # one law beside another, on one scale
    axes = list(figure.subplots(rows, across, squeeze=False).flat)
    largest = [_draw(panel, loads, ax) for panel, ax in zip(panels, axes, strict=False)]
    for k, (panel, ax) in enumerate(zip(panels, axes, strict=False)):
        tallest = max(largest) if compared else largest[k]
        widest = max(each.speed for each in panels) if compared else panel.speed
        ax.set_xlim(-AXIS_MARGIN * widest, AXIS_MARGIN * widest)
        ax.set_ylim(-AXIS_MARGIN * (tallest or 1.0), AXIS_MARGIN * (tallest or 1.0))
    for ax in axes[len(panels) :]:
        ax.set_visible(False)
    legend_above(figure, _keys(panels, loads))
    return figure


# -------------------------------------------------------------------- what there is to draw


def _panels(friction: Arm | Mapping[str, Friction]) -> list[Panel]:
    if isinstance(friction, Arm):
        units = [(f"{joint.unit}/s", joint.effort_unit) for joint in friction.joints]
        rows = zip(friction.joint_names, friction.velocity, units, strict=True)
        return [_panel(name, _entry(friction.friction, i), limit, unit) for i, (name, limit, unit) in enumerate(rows)]
    if not isinstance(friction, Mapping) or not all(isinstance(one, Friction) for one in friction.values()):
        raise UsageError("plot_friction takes an Arm, or a taut.Friction by each title", name="friction")
    for title, one in friction.items():
        if any(np.size(getattr(one, name)) != 1 for name in FRICTION_FIELDS):
            raise ShapeError(f"'{title}' must be the friction of one joint, each number a scalar", name=title)
    return [_panel(title, _entry(one, 0)) for title, one in friction.items()]


def _panel(title: str, friction: Friction, limit: float = np.inf, units: tuple[str, str] = ("rad/s", "N m")) -> Panel:
    reach = FALLS * float(np.asarray(friction.stribeck)) if friction.falls else 0.0
    if not reach > 0.0:
        reach = limit if np.isfinite(limit) else 1.0
    return Panel(title=title, friction=friction, speed=min(reach, limit), units=units)


def _entry(friction: Friction, i: int) -> Friction:
    """The friction of one joint."""
    values: dict[str, Any] = {}
    for name in FRICTION_FIELDS:
        column = np.ravel(getattr(friction, name))
        values[name] = float(column[i if len(column) > 1 else 0])
    return Friction(**values)


# -------------------------------------------------------------------- drawing


def _draw(panel: Panel, loads: Float64Array, ax: Axes) -> float:
    """The curves of one panel; the largest torque of them."""
    v_unit, tau_unit = panel.units
    prepared(ax, short_name(panel.title, 34), f"friction [{tau_unit}]", f"v [{v_unit}]")
    ax.axhline(0.0, color=INK, linewidth=0.6)
    ax.axvline(0.0, color=INK, linewidth=0.6)
    values = FrictionValues.fixed(panel.friction)
    v = panel.speed * SPEEDS
    largest, several = 0.0, len(loads) > 1 and values.loaded
    for k, tau in enumerate(loads if several else loads[:1]):
        motor, carried = np.full(len(v), tau), np.full(len(v), -tau)
        opposing = -friction_torque(values, v, motor, carried)
        hold = float(dry_limit(values, np.zeros(1), np.array([True]), motor[:1], carried[:1])[0])
        for x, y in ((-v, -opposing), (v, opposing)):
            ax.plot(x, y, color=colour(k), linewidth=1.8, solid_capstyle="butt", label="motion")
        if hold > 0.0:
            rest, over = colour(k) if several else REST, 3.0 - 0.1 * k
            ax.plot([0.0, 0.0], [-hold, hold], color=rest, linewidth=1.8, zorder=over, label="rest")
            ax.plot([0.0, 0.0], [-hold, hold], "o", color=rest, markersize=3.6, zorder=4, label="break-away")
        largest = max(largest, hold, float(np.abs(opposing).max()))
    return largest


def _keys(panels: list[Panel], loads: Float64Array) -> list[Line2D]:
    from matplotlib.lines import Line2D

    units = panels[0].units[1]
    if len(loads) > 1 and any(panel.friction.loaded for panel in panels):
        keys = [
            Line2D([], [], color=colour(k), linewidth=1.8, label=f"carrying {tau:g} {units}")
            for k, tau in enumerate(loads)
        ]
        ink = INK
    else:
        keys = [Line2D([], [], color=colour(0), linewidth=1.8, label="in motion")]
        ink = REST
    if not any(panel.friction.dry for panel in panels):
        return keys
    rest = Line2D([], [], color=ink, linewidth=1.8, label="at rest: any value between")
    dot = Line2D([], [], color=ink, marker="o", markersize=3.6, linewidth=0.0, label="break-away")
    return [*keys, rest, dot]
