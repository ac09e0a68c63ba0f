"""Marks of phases in plots: a line where each begins, and their names in the first picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from taut.record.plots.style import DOTTED, INK, LETTER, WIDTH, short_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.record.run import Run

__all__ = ["mark_phases"]

LETTERS: Final = 10  # of a name
SIZE: Final = 7.5  # [pt] of the letters
HIGH: Final = 1.3  # [in] that a picture has at least
INNER: Final = 0.75  # of a picture's share of the page is between its axes


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
    letter = 1.3 * SIZE / (72.0 * WIDTH * INNER / across) * float(run.t[-1] - run.t[0])  # [s] that a name takes
    named = [window for window in found if window.end - window.start >= letter]  # the others have no room for it
    longest = max((len(short_name(window.name, LETTERS)) for window in named), default=0)
    room = (LETTER * SIZE * longest + 6.0) / (72.0 * HIGH)  # of the height, above the curves
    low, high = first.get_ylim()
    first.set_ylim(low, high + room / (1.0 - room) * (high - low))
    for window in named:
        first.annotate(
            short_name(window.name, LETTERS),
            (window.start, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3.0, -2.0),
            textcoords="offset points",
            fontsize=SIZE,
            color=INK,
            va="top",
            rotation=90,
        )
