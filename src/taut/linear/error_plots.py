"""Pictures of error dynamics: the response to a step, and the poles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array
from taut.linear.poles import GONE
from taut.record.plots.style import DASHED, INK, SMALL, WIDTH, colour, prepared
from taut.record.step import BAND

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from taut.linear.error_dynamics import ErrorDynamics
    from taut.linear.sampled_errors import SampledErrorDynamics

__all__ = ["of_continuous", "of_sampled", "pole_axes"]

POINTS: Final = 600
TICKS: Final = 400  # of a sampled response
ROUND: Final = 1.15  # what is shown around what matters
BOUNDED: Final = 3.0  # of the step: what is shown of a response that grows


def of_continuous(d: ErrorDynamics) -> Figure:
    """Response with exact settling and the rule's beside it, and the poles in s."""
    figure, left, right = _panels()
    span = _span(d)
    t = np.linspace(0.0, span, POINTS)
    prepared(left, "error after a step", "e / e(0)", "t [s]")
    _band(left)
    left.plot(t, d.response(t)[0], color=colour(0), linewidth=1.5)
    if d.stable:
        exact, rule = d.settling_time, d.settling_by_rule
        if math.isfinite(exact):
            _moment(left, exact, f"settled, {exact:.3g} s", colour(1), "solid")
        _moment(left, rule, f"4 tau, {rule:.3g} s", INK, DASHED)
        _legend(left, "upper right")
    _limited(left)
    pole_axes(right, d.poles, None)
    right.plot(d.poles.real, d.poles.imag, "x", color=colour(0), markersize=6.0, markeredgewidth=1.5)
    return figure


def of_sampled(d: SampledErrorDynamics) -> Figure:
    """Response at the ticks over that of the book, and the poles in z."""
    figure, left, right = _panels()
    book = d.continuous
    span = max(_span(book), ROUND * d.settling_time if d.stable and math.isfinite(d.settling_time) else 0.0)
    count = max(2, min(int(span * d.rate) + 1, TICKS))
    ticks = d.dt * np.arange(count)
    t = np.linspace(0.0, ticks[-1], POINTS)
    prepared(left, f"error after a step, at {d.rate:g} Hz", "e / e(0)", "t [s]")
    _band(left)
    left.plot(t, book.response(t)[0], color=INK, linewidth=0.9, linestyle=DASHED, label="in the book")
    left.plot(ticks, d.response(count), ".", color=colour(0), markersize=4.0, label="at the ticks")
    if d.stable and d.settling_time <= ticks[-1]:
        _moment(left, d.settling_time, f"settled, {d.settling_time:.3g} s", colour(1), "solid")
    _legend(left, "best")
    _limited(left)
    some = d.poles[np.abs(d.poles) > GONE]
    pole_axes(right, some, d.dt)
    right.plot(some.real, some.imag, "x", color=colour(0), markersize=6.0, markeredgewidth=1.5)
    return figure


def pole_axes(ax: Axes, poles: NDArray[np.complex128], dt: float | None) -> None:
    """Axes for poles, with what is unstable tinted, their scales equal."""
    name = "s [1/s]" if dt is None else "z"
    prepared(ax, f"poles in {name[0]}", f"Im {name}", f"Re {name}")
    ax.axhline(0.0, color=INK, linewidth=0.6)
    ax.axvline(0.0, color=INK, linewidth=0.6)
    if dt is None:
        size = ROUND * max(float(np.abs(poles).max(initial=0.0)), 1e-9)
        right = max(0.25 * size, ROUND * float(poles.real.max(initial=0.0)))
        tall = max(0.6 * size, ROUND * float(np.abs(poles.imag).max(initial=0.0)))
        ax.axvspan(0.0, right, color=colour(1), alpha=0.10, linewidth=0.0)
        ax.set_xlim(min(-size, -right), right)
        ax.set_ylim(-tall, tall)
    else:
        turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 200))
        ax.plot(turn.real, turn.imag, color=INK, linewidth=0.9)
        size = max(ROUND, ROUND * float(np.abs(poles).max(initial=0.0)))
        ax.set_xlim(-size, size)
        ax.set_ylim(-size, size)
    ax.set_aspect("equal", adjustable="box")


def _panels() -> tuple[Figure, Axes, Axes]:
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(WIDTH, 2.7), dpi=150, layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2, width_ratios=[1.6, 1.0])
    return figure, left, right


def _span(d: ErrorDynamics) -> float:
    """Of time that shows what happens [s]."""
    if d.stable:
        settled = d.settling_time if math.isfinite(d.settling_time) else d.settling_by_rule
        return 1.3 * max(settled, d.settling_by_rule)
    rates: Float64Array = np.abs(d.poles.real)
    sizes = np.abs(d.poles)
    growing = float(d.poles.real.max())
    if growing > 0.0:
        return 3.0 / growing
    return 20.0 / float(max(sizes.max(initial=0.0), rates.max(initial=0.0), 1e-9))


def _band(ax: Axes) -> None:
    ax.axhline(0.0, color=INK, linewidth=0.6)
    ax.axhspan(-BAND, BAND, color=colour(2), alpha=0.25, linewidth=0.0)


def _moment(ax: Axes, t: float, label: str, colour: str, style: str | tuple[float, tuple[float, float]]) -> None:
    ax.axvline(t, color=colour, linewidth=1.0, linestyle=style, label=label)


def _legend(ax: Axes, place: Literal["best", "upper right"]) -> None:
    """What the moments are, on a ground that hides their lines."""
    shown = ax.legend(fontsize=SMALL, labelcolor=INK, loc=place, facecolor="white", edgecolor="none", framealpha=1.0)
    shown.set_zorder(5.0)


def _limited(ax: Axes) -> None:
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, -BOUNDED), min(high, BOUNDED))
