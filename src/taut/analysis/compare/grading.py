"""Grading a law against another: how far each figure is, and which term of the torque differs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.analysis.compare.compare import settings_of
from taut.analysis.compare.numbers import ERRORS, FIGURES, Numbers, of_run
from taut.analysis.compare.setting import Setting, blamed
from taut.analysis.compare.words import aligned
from taut.base.checks import positive_scalar
from taut.base.errors import RangeError, UsageError
from taut.base.paths import subtree
from taut.base.result import cell_text
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.controller import compile
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.record.report.page import Page

__all__ = ["Difference", "Grade", "Mark", "grade_law"]

TOLERANCE: Final = 0.05
NOTHING: Final = 1e-6  # of the peak error
MOST_SHOWN: Final = 1e4  # [%] beyond which how far off a figure is says no more
ROUNDING: Final = 1e-9  # in the unit of the figure: what arithmetic alone may leave


@dataclass(frozen=True, kw_only=True)
class Mark:
    """One figure of a law beside that of the reference."""

    figure: str
    unit: str
    law: float
    reference: float
    tolerance: float
    least: float = ROUNDING  # what differs by less is the same

    @property
    def off(self) -> float:
        """How far it is, as a share of the reference's."""
        gap = self.law - self.reference
        if abs(gap) <= self.least:
            return 0.0
        return gap / abs(self.reference) if self.reference else math.copysign(math.inf, gap)

    @property
    def off_text(self) -> str:
        """That in per cent."""
        if not math.isfinite(self.off):
            return "-"
        share = 100.0 * self.off
        return f"{share:+.2f} %" if abs(share) < MOST_SHOWN else f"over {math.copysign(MOST_SHOWN, share):+g} %"

    @property
    def ok(self) -> bool:
        """Whether it is within the tolerance, to either side."""
        return abs(self.off) <= self.tolerance  # a NaN is not


@dataclass(frozen=True, kw_only=True)
class Difference:
    """The largest difference between two commands, or two of their terms, in the same states."""

    what: str  # "command", or the name of a term
    size: float
    unit: str
    joint: str
    t: float  # [s]
    law: float  # the law's value there
    reference: float
    scale: float  # the reference's largest

    def within(self, tolerance: float) -> bool:
        """Whether it is no more than a share of the reference's largest value."""
        return self.size <= tolerance * self.scale + ROUNDING

    def text(self) -> str:
        """In words."""
        return (
            f"{cell_text(self.size)} {self.unit} at joint '{self.joint}', t = {self.t:g} s: "
            f"{cell_text(self.law)} where the reference has {cell_text(self.reference)}, at most "
            f"{cell_text(self.scale)}"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Grade:
    """A law beside a reference law; print it for the report.

    Args:
        name: Of the law.
        reference: Name of the reference law.
        marks: Each figure of the runs.
        command: The largest difference of the commands along the reference's own trajectory.
        terms: Of terms that both name, where they differ, the largest difference first.
        only_law: Terms that only the law has.
        only_reference: Terms that only the reference has.
        run: The law's run.
        reference_run: The reference's run.
        tolerance: A share.
        repeat: How to grade it again.
        settings: What is known of the experiment, as text by name.
        texts: Longer texts by their title, such as the scenario's.
    """

    name: str
    reference: str
    title: str
    marks: tuple[Mark, ...]
    command: Difference
    terms: tuple[Difference, ...]
    only_law: tuple[str, ...]
    only_reference: tuple[str, ...]
    run: Run
    reference_run: Run
    tolerance: float
    repeat: str
    settings: Mapping[str, str]
    texts: Mapping[str, str]

    @property
    def same_command(self) -> bool:
        """Whether the commands agree in the same states."""
        return self.command.within(self.tolerance)

    @property
    def ok(self) -> bool:
        """Whether the law passes: its run went to its end, and every figure and the command are within tolerance."""
        return self.run.outcome.ok and self.same_command and all(mark.ok for mark in self.marks)

    @property
    def wrong_term(self) -> str | None:
        """Of terms that both laws name, the one with the largest difference beyond the tolerance; None if none is."""
        return next((one.what for one in self.terms if not one.within(self.tolerance)), None)

    def report(self) -> str:
        """In words: figures, then the command, then its terms."""
        rows = [("", "", self.name, self.reference, "off by", "")]
        rows += [
            (
                FIGURES[mark.figure].title,
                mark.unit,
                cell_text(mark.law),
                cell_text(mark.reference),
                mark.off_text,
                "pass" if mark.ok else "fail",
            )
            for mark in self.marks
        ]
        lines = [self.title, "", *aligned(rows), ""]
        verdict = "pass" if self.same_command else "fail"
        if self.same_command and self.wrong_term is not None:
            verdict = f"pass as a whole, but not its term '{self.wrong_term}'"
        lines.append(f"command along the trajectory of {self.reference}: {verdict}")
        lines.append(f"  largest difference {self.command.text()}" if self.command.size > ROUNDING else "  the same")
        lines += [
            f"  term '{one.what}' differs by {one.text()}{'' if one.within(self.tolerance) else ': fail'}"
            for one in self.terms
        ]
        if self.only_law:
            lines.append(f"  only {self.name} has the terms {', '.join(self.only_law)}")
        if self.only_reference:
            lines.append(f"  only {self.reference} has the terms {', '.join(self.only_reference)}")
        if not self.run.outcome.ok:
            lines.append(f"{self.name}: {self.run.outcome}")
        lines += ["", f"{'passed' if self.ok else 'failed'}, with a tolerance of {100.0 * self.tolerance:g} %"]
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Errors and torques of both over time, as a matplotlib Figure."""
        from taut.analysis.compare.plot import plot_runs

        return plot_runs({self.name: self.run, self.reference: self.reference_run}, self.title)

    def report_page(self) -> Page:
        """What `taut.report` makes of it."""
        from taut.analysis.compare.report import page_of_grade

        return page_of_grade(self)

    def json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "law": self.name,
            "reference": self.reference,
            "on": self.title,
            "tolerance": self.tolerance,
            "marks": [
                {
                    "figure": mark.figure,
                    "unit": mark.unit,
                    "law": mark.law if math.isfinite(mark.law) else None,
                    "reference": mark.reference,
                    "off": mark.off if math.isfinite(mark.off) else None,
                    "ok": mark.ok,
                }
                for mark in self.marks
            ],
            "command": {**vars(self.command), "ok": self.same_command},
            "terms": [vars(one) for one in self.terms],
            "only_law": list(self.only_law),
            "only_reference": list(self.only_reference),
            "wrong_term": self.wrong_term,
            "outcome": self.run.outcome.json(),
            "ok": self.ok,
        }

    def __str__(self) -> str:
        return self.report()


def grade_law(
    law: tuple[str, Law],
    reference: tuple[str, Law],
    setting: Setting,
    *,
    tolerance: float = TOLERANCE,
    say: Callable[[str], None] = lambda _: None,
    repeat: str = "",
) -> Grade:
    """A law against a reference law on an experiment.

    Both run; then both are given, tick by tick, the states that the reference's run went through, without limits, so
    that a wrong term shows where it is wrong and not what it led to.

    Args:
        law: Its name, and the law.
        reference: Likewise.
        setting: The experiment.
        tolerance: A share: of the reference's figures, and of its largest command.
        say: Takes a line of progress.
        repeat: How to grade it again.

    Raises:
        UsageError: A law that cannot be compiled or does not fit; a reference law whose run fails.
        RangeError: A tolerance that is not positive, or above 1.
    """
    tolerance = positive_scalar("tolerance", tolerance)
    if tolerance > 1.0:
        raise RangeError(
            f"tolerance must be a fraction, <= 1 (100 %); got {tolerance:g}; {tolerance:g} % is {0.01 * tolerance:g}",
            name="tolerance",
            value=tolerance,
            rule="<= 1",
        )
    controllers = {name: setting.controller(name, one) for name, one in (law, reference)}
    runs = {}
    for name, ctrl in controllers.items():
        say(f"running {name} ...")
        with blamed(name):
            runs[name] = setting.run(ctrl)
    (mine, _), (other, _) = law, reference
    wanted = runs[other]
    if not wanted.outcome.ok:
        raise UsageError(f"law '{other}' cannot be a reference here: {wanted.outcome}", name=other)
    say("comparing their commands in the same states ...")
    tables = [_commands(name, one, setting, wanted) for name, one in (law, reference)]
    command = _difference("command", tables[0]["command"], tables[1]["command"], wanted)
    terms, theirs = ({term: rows for term, rows in table.items() if term != "command"} for table in tables)
    both = [_difference(name, terms[name], theirs[name], wanted) for name in terms if name in theirs]
    return Grade(
        name=mine,
        reference=other,
        title=f"{mine} against {other} on {setting.name}",
        marks=tuple(_marks(of_run(runs[mine]), of_run(wanted), tolerance)),
        command=command,
        terms=tuple(sorted((one for one in both if one.size > ROUNDING), key=lambda one: -one.size)),
        only_law=tuple(name for name in terms if name not in theirs and np.any(terms[name])),
        only_reference=tuple(name for name in theirs if name not in terms and np.any(theirs[name])),
        run=runs[mine],
        reference_run=wanted,
        tolerance=tolerance,
        repeat=repeat,
        settings=settings_of(setting),
        texts=setting.texts,
    )


def _marks(law: Numbers, reference: Numbers, tolerance: float) -> list[Mark]:
    """A mark for each figure of the reference; errors that differ by a millionth of their peak are the same."""
    peaks = {name: peak for error, (rms, peak) in ERRORS.items() for name in (rms, peak, f"steady_{error}")}
    return [
        Mark(
            figure=figure,
            unit=unit,
            law=law.get(figure, {}).get(unit, math.nan),
            reference=value,
            tolerance=tolerance,
            least=max(ROUNDING, NOTHING * reference.get(peaks.get(figure, ""), {}).get(unit, 0.0)),
        )
        for figure, values in reference.items()
        for unit, value in values.items()
    ]


def _commands(name: str, law: Law, setting: Setting, run: Run) -> dict[str, Float64Array]:
    """(k, n) each: the command and its terms in the true states of a run, each tick after the one before."""
    with blamed(name):
        ctrl = compile(law, setting.arm, rate=setting.rate, sensing=setting.sensing, adds=setting.plant.adds)
        kernel = ctrl.recording_kernel()
        inputs, outputs = (kernel.blocks.views(block) for block in ("inputs", "outputs"))
        given = {f"ref.{field}": getattr(run.reference, field) for field in type(run.reference).fields(run.n)}
        given |= {"t": run.t, "q": run.q, "v": run.v, "tau_meas": run.tau, **run.extra}
        rows = {path: np.empty((len(run), *view.shape)) for path, view in outputs.items()}
        taken = [(view, given[path]) for path, view in inputs.items() if path in given]
        for k in range(len(run)):
            for view, values in taken:
                view[...] = values[k]
            if k == 0:
                kernel.start()
            kernel.tick()
            for path, view in outputs.items():
                rows[path][k] = view
        bad = np.flatnonzero(~np.isfinite(rows["command"]).all(axis=1))
        if bad.size:
            raise UsageError(
                "its command is not finite in the states of the reference's run, from "
                f"t = {run.t[bad[0]]:g} s on; it must be finite there",
                name=name,
            )
    return {"command": rows["command"], **subtree(rows, "terms")}


def _difference(what: str, law: Float64Array, reference: Float64Array, run: Run) -> Difference:
    """Where two columns differ most."""
    k, i = np.unravel_index(int(np.argmax(np.abs(law - reference))), law.shape)
    return Difference(
        what=what,
        size=float(abs(law[k, i] - reference[k, i])),
        unit=run.command_units[i],
        joint=run.joint_names[i],
        t=float(run.t[k]),
        law=float(law[k, i]),
        reference=float(reference[k, i]),
        scale=float(np.max(np.abs(reference))),
    )
