"""Marks of phases in plots: a line where each begins, and their names in the first picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from taut.record.style import DOTTED, INK, short_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.record.run import Run

__all__ = ["mark_phases"]

SHORT: Final = 0.04  # of the run: a phase that is shorter has no room for its name
LETTERS: Final = 12


def mark_phases(run: Run, figure: Figure) -> None:
    """Draw where each phase of a task begins into every picture that shows the run over time."""
    found = run.phases
    axes = [ax for ax in figure.axes if ax.get_visible()]
    for ax in axes:
        for window in found[1:]:
            ax.axvline(window.start, color=INK, linewidth=0.7, linestyle=DOTTED, zorder=0.5)
    span = float(run.t[-1] - run.t[0])
    for window in found:
        if axes and window.end - window.start >= SHORT * span:
            axes[0].annotate(
                short_name(window.name, LETTERS),
                (window.start, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(2.0, -2.0),
                textcoords="offset points",
                fontsize=5.5,
                color=INK,
                va="top",
                rotation=90,
            )
