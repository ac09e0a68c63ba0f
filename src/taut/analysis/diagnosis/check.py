"""A check of the doctor: what it needs, its thresholds, and the finding that it gives."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from taut.base.errors import UsageError
from taut.base.plot_style import INK, WIDTH, colour, line, prepared
from taut.base.types import Array, Float64Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.analysis.diagnosis.examined_run import ExaminedRun

__all__ = ["NEEDS", "Check", "Finding", "Need", "Number", "Threshold"]

Need = Literal["length", "torque", "error", "effort", "model"]
NEEDS: Final[Mapping[Need, str]] = {
    "length": "the run is too short",
    "torque": "the law does not command torques",
    "error": "the error of the joints is not known from this law and its reference",
    "effort": "the effort limits of the arm are not known",
    "model": "the model of the arm, or a contact force on it, is not known",
}
"""What a check may need, and why it was left out where a run does not have it."""
TITLE_LETTERS: Final = 100  # of a line of a figure's title


class Number(NamedTuple):
    """A number with its unit."""

    value: float
    unit: str = ""

    def __str__(self) -> str:
        whole = 999.5 <= abs(self.value) < 1e6 or (abs(self.value) < 1e6 and float(self.value).is_integer())
        return f"{self.value:{'.0f' if whole else '.3g'}} {'' if self.unit == '1' else self.unit}".rstrip()


@dataclass(frozen=True, kw_only=True)
class Threshold:
    """A threshold of a check.

    Args:
        name: What is compared; a check reads it as `run.threshold[name]`.
        value: The number.
        unit: Its unit; "1" of a ratio.
        reason: Why it is this number.
    """

    name: str
    value: float
    unit: str
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """A fault that a check found in a run.

    A check's test gives the numbers; the check adds its name and its sentences.

    A check makes it by `run.finding(...)`.

    Args:
        term: The term of the command that is responsible, as in `run.terms`; "delay" for what is between command
            and torque, "friction" and "transmission" for the joint, "contact", "constraint", "period".
        joint: The joint where it is worst; None where it concerns the whole arm.
        fraction: 0 to 1: the part of the feedback effort that it explains, or of what `of` names.
        evidence: The numbers that it was found by.
        t: (k,) time of its figure [s].
        signals: (k,) by name with unit: what its figure shows.
        marked: (k,) the ticks that are shaded in it.
        follows: In a diagnosis, the name of the finding that it is a consequence of, or none.
        of: What `fraction` is a part of.
        name: The check.
        cause: What happened, in a sentence.
        remedy: What to do about it, in a sentence.
        note: What else is known of it.
        phase: Of a task, the phases in which it was found.
    """

    term: str
    joint: str | None
    fraction: float
    evidence: Mapping[str, Number]
    t: Float64Array
    signals: Mapping[str, Float64Array]
    marked: Array | None = None
    follows: tuple[str, ...] | None = None
    of: str = "the feedback effort"
    name: str = ""
    cause: str = ""
    remedy: str = ""
    note: str = ""
    phase: str | None = None

    def plot(self) -> Figure:
        """The signals over time as a matplotlib Figure."""
        from matplotlib.figure import Figure

        lines = textwrap.wrap(f"{self.name}: {self.cause}".replace("$", r"\$"), TITLE_LETTERS)
        figure = Figure(figsize=(WIDTH, 0.4 + 1.7 * len(self.signals)), dpi=150, layout="constrained")
        figure.suptitle("\n".join(lines), fontsize=9.0, color=INK, x=0.01, ha="left")
        marked = np.zeros(len(self.t), bool) if self.marked is None else self.marked
        edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.intp))).reshape(-1, 2)
        axes = figure.subplots(len(self.signals), 1, sharex=True, squeeze=False)[:, 0]
        for i, (name, y) in enumerate(self.signals.items()):
            ax = prepared(axes[i], "", name, "t [s]" if i == len(axes) - 1 else "")
            line(ax, self.t, y, colour(i))
            for first, end in edges:
                ax.axvspan(self.t[first], self.t[end - 1], color="#D9D9D9", alpha=0.5, linewidth=0.0)
            ax.margins(x=0.01)
        return figure

    def __str__(self) -> str:
        where = "" if self.joint is None else f" at '{self.joint}'"
        where += "" if self.phase is None else f" in {self.phase}"
        after = f", a consequence of '{self.follows[0]}'" if self.follows else ""
        return (
            f"{self.name}{where} (term {self.term}, {100.0 * self.fraction:.0f} % of {self.of}{after}): "
            f"{self.cause}; remedy: {self.remedy}{self.note}"
        )


@dataclass(frozen=True, kw_only=True)
class Check:
    """A check of the doctor.

    Args:
        name: What its finding is called.
        test: A function of the run that gives a `Finding` where the fault is there, else None.
        needs: What it needs to know of a run; where a run lacks it, the check is left out and a note says so.
        thresholds: The numbers that the test compares with.
        cause: What happened, in a sentence. {joint}, {term} and the names of the evidence are replaced.
        remedy: What to do about it, likewise; a mapping from the term to the sentence where it depends on that, with
            "" for all other terms.
        follows: Names of findings that bring this one about: it then stands behind them.

    Example:
        >>> import numpy as np, taut
        >>> from taut.analysis import CHECKS, Check, Threshold
        >>> def too_fast(run):
        ...     speed = np.abs(run.run.v).max(axis=0)
        ...     i = int(speed.argmax())
        ...     if speed[i] < run.threshold["joint speed"]:
        ...         return None
        ...     return run.finding("command", i, 1.0, {"speed": (speed[i], "rad/s")})
        >>> mine = Check(
        ...     name="too fast",
        ...     test=too_fast,
        ...     thresholds=(Threshold(name="joint speed", value=0.5, unit="rad/s", reason="a person stands near"),),
        ...     cause="'{joint}' moves at {speed}",
        ...     remedy="give the motion more time",
        ... )
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + [0.5, 0.0], duration=1.0)
        >>> run = taut.run(ctrl, taut.RigidPlant(arm), path, duration=1.5)
        >>> taut.doctor(run, checks=[*CHECKS, mine]).findings[0].cause
        "'joint1' moves at 0.935 rad/s"
    """

    name: str
    test: Callable[[ExaminedRun], Finding | None]
    cause: str
    remedy: str | Mapping[str, str]
    needs: tuple[Need, ...] = ()
    thresholds: tuple[Threshold, ...] = ()
    follows: tuple[str, ...] = ()

    def examine(self, run: ExaminedRun) -> Finding | None:
        """The finding of a run that has what the check needs, with its sentences; None where there is no fault."""
        found = self.test(run)
        if found is None:
            return None
        values = {"joint": found.joint, "term": found.term, **found.evidence}
        remedy = self.remedy if isinstance(self.remedy, str) else self.remedy.get(found.term, self.remedy.get("", ""))
        return dataclasses.replace(
            found,
            name=self.name,
            cause=_filled(self.cause, values),
            remedy=_filled(found.remedy or remedy, values),
            follows=self.follows if found.follows is None else found.follows,
        )


def _filled(text: str, values: Mapping[str, object]) -> str:
    """A sentence of a check with its numbers.

    Raises:
        UsageError: It names a number that the finding does not have.
    """
    try:
        return text.format_map(values)
    except KeyError as missing:
        known = ", ".join(f"{{{name}}}" for name in values)
        raise UsageError(f"the sentence '{text}' names {missing}; the finding has {known}", name="cause") from missing
