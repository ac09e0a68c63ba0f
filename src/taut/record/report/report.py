"""taut.report: one self-contained HTML file of a run, a comparison, a design, or anything that prints and plots."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, runtime_checkable

from taut.base.errors import UsageError
from taut.base.result import Content, Result, cell_text
from taut.record.log.files import checked_target, written_aside
from taut.record.plots.style import short
from taut.record.report.html import html_of
from taut.record.report.page import Page, Picture, Reportable, Table
from taut.record.report.run_report import page_of_run
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["page_of", "report"]

HEADING: Final = 100  # letters of a title
CLAUSE: Final = re.compile(r"[,;:] ")  # where a longer one may end


@runtime_checkable
class Told(Protocol):
    """What says in words what it is, such as a design."""

    def report(self) -> str:
        """The words."""
        ...


@runtime_checkable
class Drawn(Protocol):
    """What can be drawn."""

    def plot(self) -> Figure:
        """The figure."""
        ...


@runtime_checkable
class Tabled(Protocol):
    """What has tables by title, each a sequence of rows of which the first is the heads."""

    def tables(self) -> Mapping[str, Sequence[Sequence[object]]]:
        """The tables."""
        ...


def report(
    x: object, path: str | os.PathLike[str], *, title: str = "", repeat: str = "", log: str = "run.mcap"
) -> Path:
    """Write a report: numbers, pictures, settings, versions, and how to do it again, in one HTML file.

    The file needs no other file, no network and no script; it prints, and it reads on a phone. It names files without
    their folders, and no machine.

    Args:
        x: A `taut.Run`, a `taut.analysis.Comparison`, a `taut.analysis.Grade`, a `taut.analysis.Design`, a
        `taut.analysis.LinearLoop`; or anything with
            `plot()` or `report()`, or a dataclass with a print of its own, such as error dynamics, a map, a
            coupling: its words, its figure, and `tables()` if it has that; or a result that describes itself, such as
            the doctor's `taut.analysis.Diagnosis`.
        path: Where to, ending in .html, in a folder that exists. What is there stays until the new file is whole.
        title: A title, instead of the usual one.
        repeat: How to do it again, instead of what is known.
        log: Of a run, the name of its log, which the lines that repeat it read.

    Returns:
        The path.

    Raises:
        UsageError: Nothing that can be reported; a run without two ticks.
        FileError: Another suffix, no such folder, a disk that is full.

    Example:
        >>> import taut, tempfile
        >>> d = taut.analysis.second_order(M=0.5, b=0.1, kd=2.0, zeta=1.0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = report(d, f"{folder}/gains.html", title="Critical damping")
        ...     "<h1>Critical damping</h1>" in file.read_text(encoding="utf-8")
        True
    """
    target = checked_target("report", path, (".html", ".htm"))
    page = page_of(x, title=title, repeat=repeat, log=log)
    with written_aside("report", target) as aside:
        aside.write_text(html_of(page), encoding="utf-8", errors="replace")
    return target


def page_of(x: object, *, title: str = "", repeat: str = "", log: str = "run.mcap") -> Page:
    """What a report holds, before it is a file.

    Raises:
        UsageError: Nothing that can be reported.
    """
    if isinstance(x, Run):
        page = page_of_run(x, log=log)
    elif isinstance(x, Result):
        page = _of_result(x.content())
    elif isinstance(x, Reportable):
        page = x.report_page()
    elif isinstance(x, type) or not (isinstance(x, (Told, Drawn)) or _prints(x)):
        got = x.__name__ if isinstance(x, type) else type(x).__name__
        raise UsageError(
            f"a report is of a taut.Run, a taut.analysis.Comparison, a diagnosis, or what has plot() or "
            f"report(); got {got}",
            name="x",
        )
    else:
        page = _of_anything(x)
    changed = {name: text for name, text in (("title", title), ("repeat", repeat)) if text}
    return Page(**{**vars(page), **changed})


def _of_result(content: Content) -> Page:
    """The page of a result that describes itself."""
    tables = [
        Table(title=table.title, heads=table.columns, rows=[[cell_text(cell) for cell in row] for row in table.rows])
        for table in content.tables
    ]
    return Page(
        title=content.title,
        summary=[*content.summary, *content.notes],
        faults=content.faults,
        tables=tables,
        pictures=[Picture(title=title, figure=draw()) for title, draw in content.figures.items()],
        settings=content.settings,
        texts=content.texts,
        repeat=content.repeat,
    )


def _prints(x: object) -> bool:
    """Whether it says in words what it is: a result, whose class has its own print."""
    return is_dataclass(x) and "__str__" in vars(type(x))


def _kind(x: object) -> str:
    """What it is, in words: "Stability map" of a StabilityMap."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(x).__name__)
    return words[:1].upper() + words[1:].lower()


def _heading(kind: str, words: str) -> str:
    """A title: what it is and its first line, of a long one its first clauses; the head of a table is none."""
    first = words.partition("\n")[0].strip()
    if not first or "  " in first:
        return kind
    title = first[:1].upper() + first[1:] if kind.lower() in first.lower() else f"{kind}: {first}"
    while len(title) > HEADING and (ends := list(CLAUSE.finditer(title))):
        title = title[: ends[-1].start()]
    return short(title, HEADING)


def _of_anything(x: object) -> Page:
    """Words, a figure and tables, as far as they are there."""
    kind = _kind(x)
    words = x.report() if isinstance(x, Told) else str(x)
    tables = x.tables() if isinstance(x, Tabled) else {}
    return Page(
        title=_heading(kind, words),
        tables=tuple(
            Table(
                title=head,
                heads=[str(cell) for cell in rows[0]],
                rows=[[str(cell) for cell in row] for row in rows[1:]],
            )
            for head, rows in tables.items()
            if rows
        ),
        pictures=(Picture(title=kind, figure=x.plot()),) if isinstance(x, Drawn) else (),
        texts={"In words": words},
    )
