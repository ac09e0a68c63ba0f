"""The report of a diagnosis: what was found, its evidence, a picture of each finding."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taut.record.report.page import Page, Picture, Table

if TYPE_CHECKING:
    from taut.analysis.diagnosis.diagnosis import Diagnosis

__all__ = ["page_of_diagnosis"]


def page_of_diagnosis(told: Diagnosis) -> Page:
    """Findings with remedies, their numbers, their pictures, and what was looked at."""
    heads = ("finding", "where", "what was seen", "remedy", "explains [%]")
    rows = [
        (
            f"{i}. {each.name}" + ("" if each.follows is None else f", follows from '{each.follows}'"),
            ", ".join(where for where in (each.joint, each.phase, f"term {each.term}") if where),
            each.text,
            each.remedy,
            f"{100.0 * each.share:.0f}",
        )
        for i, each in enumerate(told.findings, start=1)
    ]
    evidence = [
        (f"{i}. {each.name}", name, str(number))
        for i, each in enumerate(told.findings, start=1)
        for name, number in each.evidence.items()
    ]
    tables = (
        Table(
            title="Findings, causes first",
            heads=heads,
            rows=rows,
            words=4,
            note="Of the feedback's effort; of runs that are late, of the periods.",
        ),
        Table(title="Evidence", heads=("finding", "figure", "value"), rows=evidence, words=2),
        Table(
            title="What was looked at",
            heads=("figure", "value"),
            rows=[(name, str(number)) for name, number in told.looked_at.items()],
        ),
    )
    first = ", ".join(each.name for each in told.findings) or ("no cause found" if told.problems else "nothing found")
    return Page(
        title=f"Diagnosis: {first}",
        summary=tuple(f"Not looked for: {note}." for note in told.notes),
        faults=told.problems,
        tables=tuple(table for table in tables if table.rows),
        pictures=tuple(Picture(title=f"{each.name}: {each.text}", figure=each.plot()) for each in told.findings),
        settings={"model": told.model},
        texts={"In words": str(told)},
        repeat='import taut\n\nprint(taut.doctor(taut.load_run("run.mcap")))   # the log of the run',
    )
