"""Friction over speed, drawn like figure 10.14 of the chapter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.friction import FRICTION_FIELDS, Friction
from taut.base.checks import positive_scalar
from taut.base.errors import ShapeError, UsageError
from taut.base.plot_style import INK, WIDTH, colour, legend_above, prepared, short_name
from taut.maths.friction import FrictionValues, dry_limit, friction_torque

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_PANELS: Final = 12
FRICTION_PANELS_ACROSS: Final = 3  # panels side by side
AXIS_MARGIN: Final = 1.12  # around the curves
REST: Final = colour(1)
SPEEDS: Final = np.concatenate([[1e-6], np.geomspace(1e-3, 1.0, 400)])  # of the largest


def plot_friction(friction: Mapping[str, Friction], *, speed: float = 1.0) -> Figure:
    """The torque that friction takes, over speed: what acts in motion, and at rest all that it can hold.

    The torque is drawn as the chapter draws it, with the sign of the speed that it opposes.

    Args:
        friction: Frictions of one joint each, without load, by their titles; all panels have one scale.
        speed: To either side [rad/s].

    Raises:
        UsageError: Not friction, none, or too many panels.
        RangeError: A speed that is not above zero.

    Example:
        >>> figure = plot_friction({"Coulomb": Friction(coulomb=0.5)})
        >>> len(figure.axes)
        1

    References:
        Chapter, figure 10.14.
    """
    from matplotlib.figure import Figure as NewFigure

    if not isinstance(friction, Mapping) or not all(isinstance(one, Friction) for one in friction.values()):
        raise UsageError("plot_friction takes a taut.Friction by each title", name="friction")
    for title, one in friction.items():
        if any(np.size(getattr(one, name)) != 1 for name in FRICTION_FIELDS):
            raise ShapeError(f"'{title}' must be the friction of one joint, each number a scalar", name=title)
    if not 0 < len(friction) <= MAX_PANELS:
        raise UsageError(
            f"a figure has 1 to {MAX_PANELS} panels of friction; got {len(friction)}; draw fewer", name="friction"
        )
    v = positive_scalar("speed", speed, unit="rad/s") * SPEEDS
    across = min(FRICTION_PANELS_ACROSS, len(friction))
    rows = -(-len(friction) // across)
    size = (WIDTH, 0.4 + (1.95 if across == FRICTION_PANELS_ACROSS else 2.3) * rows)
    figure = NewFigure(figsize=size, dpi=150, layout="constrained")
    axes = list(figure.subplots(rows, across, squeeze=False, sharex=True, sharey=True).flat)
    for ax in axes[len(friction) :]:
        ax.set_visible(False)
    largest = max(_draw(ax, title, one, v) for ax, (title, one) in zip(axes, friction.items(), strict=False)) or 1.0
    axes[0].set_xlim(-AXIS_MARGIN * v[-1], AXIS_MARGIN * v[-1])
    axes[0].set_ylim(-AXIS_MARGIN * largest, AXIS_MARGIN * largest)
    for ax in axes:
        ax.tick_params(labelbottom=True, labelleft=True)
        ax.locator_params(axis="x", nbins=5)
    drawn = {str(one.get_label()): one for ax in axes for one in ax.lines if not str(one.get_label()).startswith("_")}
    legend_above(figure, list(drawn.values()))
    return figure


def _draw(ax: Axes, title: str, friction: Friction, v: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    """The curves of one panel; the largest torque of them."""
    prepared(ax, short_name(title, 34), "friction [N m]", "v [rad/s]")
    ax.axhline(0.0, color=INK, linewidth=0.6)
    ax.axvline(0.0, color=INK, linewidth=0.6)
    scalars = {name: float(np.ravel(getattr(friction, name))[0]) for name in FRICTION_FIELDS}
    values = FrictionValues.fixed(Friction(**scalars))
    none = np.zeros(len(v))
    opposing = -friction_torque(values, v, none, none)
    hold = float(dry_limit(values, np.zeros(1), np.array([True]), none[:1], none[:1])[0])
    for sign in (-1.0, 1.0):
        ax.plot(sign * v, sign * opposing, color=colour(0), linewidth=1.8, solid_capstyle="butt", label="in motion")
    if hold > 0.0:
        ax.plot([0.0, 0.0], [-hold, hold], color=REST, linewidth=1.8, zorder=3, label="at rest: any value between")
        ax.plot([0.0, 0.0], [-hold, hold], "o", color=REST, markersize=3.6, zorder=4, label="break-away")
    return max(hold, float(np.abs(opposing).max()))
