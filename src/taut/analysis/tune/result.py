"""Tuned: the parameters that were found, how, and what they change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import count_of
from taut.base.types import Float64Array
from taut.control.law import Law

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Measured", "Trial", "Tuned"]

WIDTH: Final = 13
UNITS: Final = ("", "rad | m", "(N m)^2 s", "of limit", "of limit", "N m/s")
WORST: Final = 100.0  # times the start's cost: what a picture shows of what is worse


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One evaluation.

    Args:
        parameters: By path.
        cost: Mean over all runs of the cost over that at the start; NaN or infinite where there is none.
        slack: The least of what is left of the constraints: 0 at one, negative beyond.
    """

    parameters: Mapping[str, Float64Array]
    cost: float
    slack: float

    @property
    def ok(self) -> bool:
        """Whether it has a cost and keeps to the constraints."""
        return math.isfinite(self.cost) and self.slack >= -KEPT


KEPT: Final = 1e-6  # of a constraint: what optimisers leave


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """What a loop does, over all seeds: a line of the table.

    Args:
        name: Of the loop.
        held_out: Whether it was not tuned for.
        cost: By the cost that was asked for.
        rms_error: Of the joints or of the tool [rad | m]; NaN where nothing of the kind is followed.
        effort: Integral of tau^2 [(N m)^2 s].
        torque: Largest share of the torque limits; NaN without.
        rate: Largest share of the limits of the torque rate.
        chatter: Total variation of the torques per second [N m/s].
    """

    name: str
    held_out: bool
    cost: float
    rms_error: float
    effort: float
    torque: float
    rate: float
    chatter: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Tuned:
    """What `taut.tune` found. Print it for the parameters, the table before and after, and what was noticed.

    Args:
        law: The law with its new gains.
        parameters: The best that keep to the constraints, by path; those of the start if none is better.
        start: What they were.
        cost: Of the best, over that of the start: 1 where nothing was gained.
        history: Every trial in order.
        before: Each loop with the parameters of the start, those held out last.
        after: Each loop with the best ones.
        notices: What happened on the way, in sentences: a cost of NaN and where, runs that diverged, an end too soon.
        method: "search" or "gradient".
    """

    law: Law
    parameters: Mapping[str, Float64Array]
    start: Mapping[str, Float64Array]
    cost: float
    history: tuple[Trial, ...]
    before: tuple[Measured, ...]
    after: tuple[Measured, ...]
    notices: tuple[str, ...]
    method: str

    @property
    def ratios(self) -> dict[str, float]:
        """Cost after over cost before, of each loop by name."""
        return {b.name: a.cost / b.cost for b, a in zip(self.before, self.after, strict=True)}

    def report(self) -> str:
        """All of it in words; `print(tuned)` is the same."""
        count = count_of(len(self.history), "trial")
        lines = [f"{self.method}: cost {self.cost:.4g} of what it was, after {count}", ""]
        for path, value in self.parameters.items():
            lines.append(f"   {path}: {_numbers(self.start[path])} -> {_numbers(value)}")
        names = ("cost", "rms_error", "effort", "torque", "rate", "chatter")
        width = max(len(_title(each)) for each in self.before)
        lines += ["", "   " + " " * width + "".join(f"{name:>{WIDTH}}" for name in names)]
        lines += ["   " + " " * width + "".join(f"{unit:>{WIDTH}}" for unit in UNITS)]
        for before, after in zip(self.before, self.after, strict=True):
            for when, each in (("before", before), ("after", after)):
                title = _title(before) if when == "before" else ""
                cells = "".join(f"{_number(getattr(each, name)):>{WIDTH}}" for name in names)
                lines.append(f"   {title:<{width}}{cells}  {when}")
        lines += [f"* {sentence}" for sentence in self.notices]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.report()

    def json(self) -> dict[str, Any]:
        """As plain values; null for what has no meaning."""
        return {
            "method": self.method,
            "cost": _finite(self.cost),
            "parameters": {path: value.tolist() for path, value in self.parameters.items()},
            "start": {path: value.tolist() for path, value in self.start.items()},
            "trials": len(self.history),
            "table": [
                {"name": b.name, "held_out": b.held_out, "before": _row(b), "after": _row(a)}
                for b, a in zip(self.before, self.after, strict=True)
            ],
            "notices": list(self.notices),
        }

    def plot(self) -> Figure:
        """The cost of each trial, and the best so far."""
        from matplotlib.figure import Figure as NewFigure

        from taut.base.plot_style import DASHED, INK, WIDTH, colour, legend_above, prepared

        figure = NewFigure(figsize=(WIDTH, 3.0), layout="constrained")
        ax = prepared(figure.subplots(), "tuning: cost over that of the start", "", "trial")
        costs = np.array([trial.cost for trial in self.history])
        kept = np.array([trial.ok for trial in self.history])
        k = np.arange(len(costs))
        ax.plot(k[kept], costs[kept], ".", color=colour(0), markersize=4.0, label="keeps to the constraints")
        if np.any(~kept & np.isfinite(costs)):
            out = ~kept & np.isfinite(costs)
            ax.plot(k[out], costs[out], "x", color=colour(1), markersize=4.0, label="does not")
        best = np.minimum.accumulate(np.where(kept, costs, np.inf))
        ax.plot(k, best, color=INK, linewidth=1.2, label="best so far")
        ax.set_yscale("log")
        ax.set_ylim(0.5 * float(np.nanmin(np.append(best, 1.0))), WORST)
        ax.axhline(1.0, color=INK, linewidth=0.8, linestyle=DASHED)
        legend_above(figure, ax.get_lines()[: 2 + int(np.any(~kept & np.isfinite(costs)))])
        return figure


def _title(each: Measured) -> str:
    return f"{each.name} (held out)" if each.held_out else each.name


def _numbers(value: Float64Array) -> str:
    return f"{float(value):.6g}" if value.ndim == 0 else f"({', '.join(f'{x:.5g}' for x in value)})"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _row(each: Measured) -> dict[str, float | None]:
    names = ("cost", "rms_error", "effort", "torque", "rate", "chatter")
    return {name: _finite(getattr(each, name)) for name in names}
