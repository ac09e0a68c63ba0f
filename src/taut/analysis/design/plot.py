"""Picture of a design: steps in each direction over what was designed, and the torque that they take."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from taut.record.plots.style import DASHED, INK, SMALL, WIDTH, colour, prepared

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.analysis.design.design import Design

__all__ = ["plot"]

HEIGHT: Final = 3.2
MOST: Final = 8  # directions in one picture
POINTS: Final = 200  # of what was designed


def plot(d: Design) -> Figure:
    """Errors after steps over what was designed (dashed), and the command as a share of the limits, if any."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    left, right = figure.subplots(1, 2)
    title = f"{type(d.law).__name__} on {d.arm.name}"
    prepared(left, f"{title}: error after a step", "e / e(0)", "t [s]")
    limited = bool(np.isfinite(d.arm.effort).all())
    unit = "[% of the limits]" if limited else "[N m | N]"
    prepared(right, "what the stated steps add to the command", unit, "t [s]")
    for i, (response, each, size) in enumerate(zip(d.responses, d.achieved, d.step, strict=True)):
        if i == MOST:
            break
        left.plot(response.t, response.e, color=colour(i), linewidth=1.3, label=each.direction)
        t = np.linspace(0.0, response.t[-1], POINTS)
        designed = d.tried.directions[i].error(float(t[1]), POINTS - 1)
        label = "designed" if i == len(d.achieved[:MOST]) - 1 else None  # once, below the directions
        left.plot(t, designed, color=INK, linewidth=0.8, linestyle=DASHED, label=label)
        share = 100.0 / d.arm.effort if limited else np.ones(d.arm.n)
        right.plot(response.t, size * np.abs(response.command * share).max(axis=1), color=colour(i), linewidth=1.3)
    left.axhline(0.0, color=INK, linewidth=0.6)
    left.axhspan(-0.02, 0.02, color=INK, alpha=0.08, linewidth=0.0)
    if d.responses:
        left.legend(fontsize=SMALL, frameon=False, labelcolor=INK)
    return figure
