"""What a diagnosis is made of: findings, each with its numbers, its remedy, and the one picture that shows it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.record.plots.style import INK, SMALL, WIDTH, colour, legend_above, line, prepared, short_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FAULTS", "Finding", "Number", "Picture", "in_parts"]

LETTERS: Final = 100  # of a line of a picture's title
FAULTS: Final = {
    "wrong sign": "a term pushes away from the target, or a joint turns against its torque",
    "oscillates": "a line in the feedback that dies out slowly, lasts or grows",
    "stick-slip": "a limit cycle in which the joint rests between jumps: dry friction and an integral",
    "backlash": "a limit cycle in which the link is free between two teeth",
    "chatters": "broad-band jitter of the torque, faster than a drive's rate",
    "gravity twice": "gravity is compensated by the law and by the plant",
    "gravity not compensated": "nobody compensates gravity, and feedback carries it",
    "wrong payload": "the model's payload is another than the true one",
    "sticks": "a joint rests short of where it should be, held by dry friction",
    "sags": "a steady error that feedback holds against a constant load",
    "winds up": "the integral grows while the command is cut, and the joint overshoots",
    "saturates": "the command is cut at a limit while the error is there",
    "beyond limits": "joint torques above the arm's effort limit, which a simulation without limits gives",
    "loses rank": "the task asks for a direction that the Jacobian has lost",
    "wrong surface": "the surface is not where a hybrid law states its constraint",
    "bounces": "a pressed contact opens and closes all the time",
    "jumps at start": "the first torque is far from the one that held the arm",
    "runs late": "periods are longer than the controller was made for",
}
"""Every name that a finding can have, and what it means."""


@dataclass(frozen=True)
class Number:
    """A number with its unit."""

    value: float
    unit: str = ""

    def __str__(self) -> str:
        whole = 999.5 <= abs(self.value) < 1e6 or (self.value.is_integer() and abs(self.value) < 1e6)
        return f"{self.value:{'.0f' if whole else '.3g'}} {self.unit}".rstrip()

    def json(self) -> dict[str, Any]:
        """As plain values; a number that is none is null."""
        return {"value": float(self.value) if math.isfinite(self.value) else None, "unit": self.unit}


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """The curves that show a finding."""

    title: str
    ylabel: str
    t: Float64Array  # (k,) [s]
    curves: Mapping[str, Float64Array]  # (k,) each
    marked: Float64Array | None = None  # (k,) where it is so: these times are shaded
    levels: Mapping[str, float] = field(default_factory=dict)  # horizontal lines

    def figure(self, title: str) -> Figure:
        """Drawn, as a matplotlib Figure."""
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D

        lines = textwrap.wrap(title.replace("$", r"\$"), LETTERS)
        figure = Figure(figsize=(WIDTH, 2.6 + 0.17 * len(lines)), dpi=150, layout="constrained")
        figure.suptitle("\n".join(lines), fontsize=9.0, color=INK, x=0.01, ha="left")
        (body,) = figure.subfigures(1, 1, squeeze=False)[:, 0]  # whose legend keeps off the title
        ax = prepared(body.subplots(), self.title, self.ylabel, "t [s]")
        handles = []
        for i, (name, y) in enumerate(self.curves.items()):
            line(ax, self.t, y, colour(i))
            handles.append(Line2D([], [], color=colour(i), linewidth=2.0, label=short_name(name, 40)))
        for name, level in self.levels.items():
            ax.axhline(level, color=INK, linewidth=0.8, linestyle=(0.0, (4.0, 3.0)))
            ax.annotate(
                name, (1.0, level), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=SMALL
            )
        if self.marked is not None:
            for first, last in _stretches(self.marked):
                ax.axvspan(self.t[first], self.t[last], color="#D9D9D9", alpha=0.5, linewidth=0.0)
        legend_above(body, handles)
        ax.margins(x=0.01)
        return figure


def in_parts(y: Float64Array) -> Float64Array:
    """(k,) in parts of its largest, for curves of several units in one picture."""
    return np.asarray(y / max(float(np.abs(y).max()), np.finfo(np.float64).tiny))


def _stretches(marked: Float64Array) -> list[tuple[int, int]]:
    """First and last tick of each stretch in which something is so."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0.0], (marked != 0.0).astype(np.float64), [0.0]])))
    return [(int(first), min(int(end), len(marked) - 1)) for first, end in edges.reshape(-1, 2)]


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """One reason why a run is as it is.

    Attributes:
        name: One of `FAULTS`.
        term: The term of the command that is responsible, as `run.terms` calls it; "delay" for what is between the
            command and the torque, "friction" and "transmission" for what is in the joint, "period" for the clock.
        joint: The joint where it is worst; None where it is about the whole arm.
        share: 0 to 1, of the feedback's effort in the run, or of what `of` says: how much of it this explains.
        evidence: The numbers that it was found by.
        text: What was seen, in a sentence.
        remedy: What to do about it, in a sentence.
        follows: The name of the finding that this one follows from, where there is one.
        phase: Of a task, the phases in which it was found.
        of: What the share is a part of.
        apart: The names of findings that it does not follow from, though such a one may.
    """

    name: str
    term: str
    joint: str | None
    share: float
    evidence: Mapping[str, Number]
    text: str
    remedy: str
    picture: Picture
    follows: str | None = None
    phase: str | None = None
    of: str = "the feedback's effort"
    apart: frozenset[str] = frozenset()

    def plot(self) -> Figure:
        """The evidence, as a matplotlib Figure."""
        return self.picture.figure(f"{self.name}: {self.text}")

    def json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "name": self.name,
            "term": self.term,
            "joint": self.joint,
            "share": float(self.share),
            "evidence": {name: number.json() for name, number in self.evidence.items()},
            "text": self.text,
            "remedy": self.remedy,
            "follows": self.follows,
            "phase": self.phase,
        }

    def __str__(self) -> str:
        where = "" if self.joint is None else f" at '{self.joint}'"
        where += "" if self.phase is None else f" in {self.phase}"
        numbers = ", ".join(f"{name} {number}" for name, number in self.evidence.items())
        after = "" if self.follows is None else f"; it follows from '{self.follows}'"
        return (
            f"{self.name}{where} (term {self.term}, {100.0 * self.share:.0f} % of {self.of}){after}\n"
            f"  {self.text}\n  {numbers}\n  remedy: {self.remedy}"
        )
