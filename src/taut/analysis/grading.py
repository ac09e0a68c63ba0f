"""Grading of a law against a reference law: the figures of both runs, and the terms of their commands."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.analysis.comparison import Comparison, Experiment, Numbers, blamed, compare_laws, title_of
from taut.base.checks import positive_scalar
from taut.base.errors import RangeError, UsageError
from taut.base.paths import subtree
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.controller import compile
from taut.record.run import Run

GRADE_TOLERANCE: Final = 0.05
COMMAND_ROUNDING: Final = 1e-9  # in the unit of a command: what arithmetic alone may leave
EQUAL: Final = 1e-6  # of the largest figure of a unit: figures that differ by less are equal


@dataclass(frozen=True, kw_only=True)
class Mark:
    """One figure of a law beside that of the reference; `ok` if it is within the tolerance, to either side."""

    figure: str
    unit: str
    law: float
    reference: float
    ok: bool

    @property
    def off(self) -> float:
        """Difference to the reference, relative."""
        return (self.law - self.reference) / abs(self.reference) if self.reference else math.nan


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
    ok: bool  # within the tolerance of that


@dataclass(frozen=True, kw_only=True, eq=False)
class Grade(Result):
    """A law beside a reference law; print it for the report.

    Args:
        comparison: Of the law and the reference, in this order.
        marks: Each figure of the runs.
        command: The largest difference of the commands along the reference's own trajectory.
        terms: Of terms that both name, where they differ, the largest difference first.
        tolerance: Relative.
    """

    comparison: Comparison
    marks: tuple[Mark, ...]
    command: Difference
    terms: tuple[Difference, ...]
    tolerance: float

    @property
    def ok(self) -> bool:
        """Whether the run went to its end, and every figure and the command are within the tolerance."""
        return self.comparison.ok and self.command.ok and all(mark.ok for mark in self.marks)

    @property
    def wrong_term(self) -> str | None:
        """Of terms that both laws name, the one with the largest difference beyond the tolerance; None if none is."""
        return next((each.what for each in self.terms if not each.ok), None)

    def content(self) -> Content:
        """The verdict, the figures, and the commands in the same states with their terms."""
        verdict = f"{'passed' if self.ok else 'failed'}, with a tolerance of {100.0 * self.tolerance:g} %"
        marks = [(title_of(m.figure), m.unit, m.law, m.reference, 100.0 * m.off, _word(m.ok)) for m in self.marks]
        commands = [
            (d.what, d.joint, d.t, d.law, d.reference, d.size, d.scale, d.unit, _word(d.ok))
            for d in (self.command, *self.terms)
        ]
        law, reference = laws = tuple(self.comparison.entries)
        columns = ("command or term", "joint", "t [s]", *laws, "difference", "largest", "unit", "verdict")
        title = f"largest differences of the commands in the states of the run of {reference}"
        return dataclasses.replace(
            self.comparison.content(),
            title=f"{law} against {reference} on {self.comparison.title}",
            summary=[verdict],
            tables=[
                Table(title="figures", columns=("figure", "unit", *laws, "off by [%]", "verdict"), rows=marks),
                Table(title=title, columns=columns, rows=commands),
            ],
        )


def _word(ok: bool) -> str:
    return "pass" if ok else "fail"


def grade_law(
    law: tuple[str, Law], reference: tuple[str, Law], experiment: Experiment, *, tolerance: float = GRADE_TOLERANCE
) -> Grade:
    """A named law against a reference law on an experiment, tolerance relative to the reference's figures.

    Both run; then both are given, tick by tick, the states of the reference's run, without limits, so that a wrong
    term shows where it is wrong and not in its consequences.
    """
    tolerance = positive_scalar("tolerance", tolerance)
    if tolerance > 1.0:
        raise RangeError(
            f"tolerance must be a fraction, <= 1 (100 %); got {tolerance:g}; {tolerance:g} % is {0.01 * tolerance:g}",
            name="tolerance",
            value=tolerance,
            rule="<= 1",
        )
    comparison = compare_laws(dict((law, reference)), experiment, runs={}, noise=False, model=None)
    graded, other = comparison.entries.values()
    if not other.run.outcome.ok:
        raise UsageError(f"law '{other.name}' cannot be a reference here: {other.run.outcome}", name=other.name)
    ours, theirs = (_commands(name, one, experiment, other.run) for name, one in (law, reference))
    differences = {
        name: _difference(name, ours[name], theirs[name], other.run, tolerance) for name in ours if name in theirs
    }
    command = differences.pop("command")
    return Grade(
        comparison=comparison,
        marks=tuple(_marks(graded.numbers, other.numbers, tolerance)),
        command=command,
        terms=tuple(sorted((d for d in differences.values() if d.size > COMMAND_ROUNDING), key=lambda d: -d.size)),
        tolerance=tolerance,
    )


def _marks(law: Numbers, reference: Numbers, tolerance: float) -> list[Mark]:
    """A mark for each figure of the reference; errors that differ by a millionth of the peak are equal."""
    largest: dict[str, float] = {}
    for values in reference.values():
        for unit, value in values.items():
            largest[unit] = max(largest.get(unit, 0.0), abs(value))
    marks = []
    for figure, values in reference.items():
        for unit, value in values.items():
            ours = law.get(figure, {}).get(unit, math.nan)
            ok = abs(ours - value) <= tolerance * abs(value) + EQUAL * largest[unit]  # which no NaN is
            marks.append(Mark(figure=figure, unit=unit, law=ours, reference=value, ok=ok))
    return marks


def _commands(name: str, law: Law, experiment: Experiment, run: Run) -> dict[str, Float64Array]:
    """(k, n) each: the command and its terms in the true states of a run, each tick after the one before."""
    with blamed(name):
        ctrl = compile(
            law,
            experiment.prepared(law).arm,
            rate=experiment.rate,
            sensing=experiment.sensing,
            adds=experiment.plant.adds,
        )
        kernel = ctrl.recording_kernel()
        inputs, outputs = (kernel.blocks.views(block) for block in ("inputs", "outputs"))
        columns = {f"ref.{field}": getattr(run.reference, field) for field in type(run.reference).fields(run.n)}
        columns |= {"t": run.t, "q": run.q, "v": run.v, "tau_meas": run.tau, **run.extra}
        rows = {path: np.empty((len(run), *view.shape)) for path, view in outputs.items()}
        for k in range(len(run)):
            for path, view in inputs.items():
                if path in columns:
                    view[...] = columns[path][k]
            if k == 0:
                kernel.start()
            kernel.tick()
            for path, view in outputs.items():
                rows[path][k] = view
        if not np.isfinite(rows["command"]).all():
            raise UsageError("its command must be finite in the states of the reference's run", name=name)
    return {"command": rows["command"], **subtree(rows, "terms")}


def _difference(what: str, law: Float64Array, reference: Float64Array, run: Run, tolerance: float) -> Difference:
    """Where two columns differ most."""
    k, i = np.unravel_index(int(np.argmax(np.abs(law - reference))), law.shape)
    size, scale = float(abs(law[k, i] - reference[k, i])), float(np.max(np.abs(reference)))
    return Difference(
        what=what,
        size=size,
        unit=run.command_units[i],
        joint=run.joint_names[i],
        t=float(run.t[k]),
        law=float(law[k, i]),
        reference=float(reference[k, i]),
        scale=scale,
        ok=size <= tolerance * scale + COMMAND_ROUNDING,
    )
