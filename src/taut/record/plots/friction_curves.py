"""Friction over speed, drawn like figure 10.14 of the chapter."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.friction import FRICTION_FIELDS, Friction
from taut.base.checks import finite_array, finite_scalar, require_positive
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
ACROSS: Final = 3  # panels side by side
MARGIN: Final = 1.12  # around the curves
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
    friction: Arm | Friction | Mapping[str, Friction],
    *,
    speed: float | None = None,
    load: ArrayLike = 0.0,
    joints: Iterable[str] | None = None,
) -> Figure:
    """The torque that friction takes, over speed: what acts in motion, and at rest all that it can hold.

    The torque is drawn as the chapter draws it, with the sign of the speed that it opposes.

    Args:
        friction: An arm, a panel for each joint; a friction; or frictions of one joint each by their titles.
        speed: To either side [rad/s | m/s]; if left out, six Stribeck speeds, else the joint's own limit, else 1.
        load: Torques that the motor carries while the joint moves steadily or rests [N m | N], a curve for each.
        joints: Names of the arm's joints that are drawn; all by default.

    Raises:
        UsageError: Not friction, nothing to draw, or more panels or loads than a figure holds.
        UnknownNameError: The arm has no such joint.
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
    panels = _panels(friction, joints)
    if not 0 < len(panels) <= MAX_PANELS:
        raise UsageError(
            f"a figure has 1 to {MAX_PANELS} panels of friction; got {len(panels)}; draw fewer, joints=[...]",
            name="friction",
        )
    if speed is not None:
        reach = finite_scalar("speed", speed, unit="rad/s")
        require_positive("speed", np.asarray(reach), unit="rad/s")
        panels = [Panel(title=p.title, friction=p.friction, speed=reach, units=p.units) for p in panels]
    across = min(ACROSS, len(panels))
    rows = -(-len(panels) // across)
    size = (WIDTH, 0.4 + (1.95 if across == ACROSS else 2.3) * rows)
    figure = NewFigure(figsize=size, dpi=150, layout="constrained")
    compared = isinstance(friction, Mapping)  # one law beside another, on one scale
    axes = list(figure.subplots(rows, across, squeeze=False).flat)
    largest = [_draw(panel, loads, ax) for panel, ax in zip(panels, axes, strict=False)]
    for k, (panel, ax) in enumerate(zip(panels, axes, strict=False)):
        tallest = max(largest) if compared else largest[k]
        widest = max(each.speed for each in panels) if compared else panel.speed
        ax.set_xlim(-MARGIN * widest, MARGIN * widest)
        ax.set_ylim(-MARGIN * (tallest or 1.0), MARGIN * (tallest or 1.0))
    for ax in axes[len(panels) :]:
        ax.set_visible(False)
    legend_above(figure, _keys(panels, loads))
    return figure


# -------------------------------------------------------------------- what there is to draw


def _panels(friction: Arm | Friction | Mapping[str, Friction], joints: Iterable[str] | None) -> list[Panel]:
    if isinstance(friction, Arm):
        names = friction.joint_names if joints is None else ([joints] if isinstance(joints, str) else list(joints))
        return [_of_joint(friction, friction.joint_index(name)) for name in names]
    if joints is not None:
        raise UsageError("joints= names joints of an arm; leave it out where a friction is drawn", name="joints")
    if isinstance(friction, Friction):
        count = max(np.size(getattr(friction, name)) for name in FRICTION_FIELDS)
        titles = ["friction"] if count == 1 else [f"joint {i}" for i in range(count)]
        return [_panel(title, _entry(friction, i)) for i, title in enumerate(titles)]
    if not isinstance(friction, Mapping):  # callers without a type checker
        raise UsageError(
            f"plot_friction takes an Arm, a taut.Friction or frictions by title; got {type(friction).__name__}",
            name="friction",
        )
    panels = []
    for title, one in friction.items():
        if not isinstance(one, Friction):
            raise UsageError(f"'{title}' must be a taut.Friction; got {type(one).__name__}", name=str(title))
        for name in FRICTION_FIELDS:
            shape = np.shape(getattr(one, name))
            if shape not in ((), (1,)):
                raise ShapeError(
                    f"'{title}' must be the friction of one joint, each number a scalar; got {name} of shape "
                    f"{shape}; plot_friction(friction) draws each joint of it",
                    name=str(title),
                )
        panels.append(_panel(str(title), _entry(one, 0)))
    return panels


def _of_joint(arm: Arm, i: int) -> Panel:
    joint = arm.joints[i]
    limit = float(arm.velocity[i])
    return _panel(joint.name, _entry(arm.friction, i), limit, (f"{joint.unit}/s", joint.effort_unit))


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
