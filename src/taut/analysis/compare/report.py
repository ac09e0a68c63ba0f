"""The reports of comparisons and grades."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taut.analysis.compare.numbers import FIGURES
from taut.analysis.compare.words import comparison_rows
from taut.base.result import cell_text
from taut.record.report.page import Page, Picture, Table

if TYPE_CHECKING:
    from taut.analysis.compare.compare import Comparison
    from taut.analysis.compare.grading import Grade

__all__ = ["page_of_comparison", "page_of_grade"]


def page_of_comparison(comparison: Comparison) -> Page:
    """The table, what its figures are, the picture, each law with its gains."""
    entries = comparison.entries
    rows = comparison_rows(comparison)
    joints = max(entry.run.n for entry in entries.values())
    ranked = f"Ranked by {', then '.join(comparison.by)}, the best first: {', '.join(comparison.ranking)}."
    there = {figure for entry in entries.values() for figure in entry.numbers}
    meaning = [(FIGURES[figure].title, FIGURES[figure].meaning(joints)) for figure in FIGURES if figure in there]
    failed = [f"{name}: {entry.run.outcome}" for name, entry in entries.items() if entry.failed]
    first = next(iter(entries.values())).run.info
    drawn = any(len(entry.run) > 1 for entry in entries.values())
    return Page(
        title=f"Comparison on {comparison.title}",
        summary=[
            *([ranked] if comparison.ranking else []),
            *(f"{note[:1].upper()}{note[1:]}." for note in comparison.notes),
        ],
        faults=failed,
        tables=(
            Table(title="Figures of each law", heads=("figure", "unit", *entries), rows=rows, words=2),
            Table(title="What the figures are", heads=("figure", "what it is"), rows=meaning, words=2),
        ),
        pictures=(Picture(title="Errors, torques and figures of each law", figure=comparison.plot()),)
        if drawn
        else (),
        settings={**{f"law '{name}'": entry.law for name, entry in entries.items()}, **comparison.settings},
        texts=dict(comparison.texts),
        repeat=comparison.repeat,
        versions=dict(first.versions),
    )


def page_of_grade(grade: Grade) -> Page:
    """The marks, the commands in the same states, both laws."""
    marks = [
        (
            FIGURES[mark.figure].title,
            mark.unit,
            "pass" if mark.ok else "fail",
            cell_text(mark.law),
            cell_text(mark.reference),
            mark.off_text,
        )
        for mark in grade.marks
    ]
    parts = [("command", grade.same_command, grade.command)]
    parts += [(f"term '{one.what}'", one.within(grade.tolerance), one) for one in grade.terms]
    rows = [
        (
            what,
            "pass" if ok else "fail",
            one.joint,
            f"{one.t:g}",
            *map(cell_text, (one.law, one.reference, one.size)),
            one.unit,
        )
        for what, ok, one in parts
    ]
    verdict = f"{'Passed' if grade.ok else 'Failed'}, with a tolerance of {100.0 * grade.tolerance:g} %."
    return Page(
        title=grade.title,
        summary=(verdict,),
        faults=() if grade.run.outcome.ok else (f"{grade.name}: {grade.run.outcome}",),
        tables=(
            Table(
                title="Figures of both runs",
                heads=("figure", "unit", "verdict", grade.name, grade.reference, "off by"),
                rows=marks,
                words=3,
            ),
            Table(
                title=f"Commands in the states of {grade.reference}'s run, where they differ most",
                heads=("what", "verdict", "joint", "t [s]", grade.name, grade.reference, "difference", "unit"),
                rows=rows,
                words=3,
            ),
        ),
        pictures=(Picture(title="Errors and torques of both", figure=grade.plot()),),
        settings={
            f"law '{grade.name}'": grade.run.info.law,
            f"law '{grade.reference}'": grade.reference_run.info.law,
            **grade.settings,
        },
        texts=dict(grade.texts),
        repeat=grade.repeat,
        versions=dict(grade.run.info.versions),
    )
