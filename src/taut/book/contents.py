"""The book as a whole: what is in it, the table on a terminal, and the files that it leaves."""

from __future__ import annotations

import csv
import difflib
import io
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from taut.base.errors import FileError, NumericalError, StabilityWarning, unknown_name
from taut.book import (
    claims,
    constraints,
    display,
    dither,
    error_dynamics,
    feedforward,
    force,
    friction,
    gearing,
    high_low,
    hybrid,
    impedance,
    integral,
    multi_joint,
    other_topics,
    overview,
    single_joint,
    task_errors,
    task_space,
)
from taut.book.page import Entry, Page, Row

__all__ = ["CONTENTS", "Made", "chosen", "made", "prepared_folder", "table", "write"]

CONTENTS: Final[tuple[Entry, ...]] = (
    *overview.ENTRIES,
    *single_joint.ENTRIES,
    *error_dynamics.ENTRIES,
    *integral.ENTRIES,
    *claims.ENTRIES,
    *feedforward.ENTRIES,
    *friction.ENTRIES,
    *dither.ENTRIES,
    *gearing.ENTRIES,
    *multi_joint.ENTRIES,
    *task_space.ENTRIES,
    *task_errors.ENTRIES,
    *force.ENTRIES,
    *constraints.ENTRIES,
    *hybrid.ENTRIES,
    *display.ENTRIES,
    *impedance.ENTRIES,
    *high_low.ENTRIES,
    *other_topics.ENTRIES,
)
"""In the order of the chapter."""
DPI: Final = 150
WIDE: Final = 130  # columns of a terminal that shows the whole table
HEAD: Final = ("id", "quantity", "unit", "states", "computed", "expected", "difference", "within", "source")


@dataclass(frozen=True, kw_only=True)
class Made:
    """An entry, computed."""

    entry: Entry
    page: Page

    @property
    def rows(self) -> Iterator[tuple[str, Row]]:
        """Its rows, with its id."""
        return ((self.entry.id, each) for each in self.page.rows)


def chosen(ids: Sequence[str]) -> list[Entry]:
    """The entries of these ids, in the order of the chapter; all if there are none.

    Raises:
        UnknownNameError: The book has no such entry.
    """
    known = list(dict.fromkeys(entry.id for entry in CONTENTS))
    for name in ids:
        if name not in known:
            raise unknown_name("the book", "entry", name, difflib.get_close_matches(name, known, 8, 0.4) or known[:8])
    return [entry for entry in CONTENTS if not ids or entry.id in ids]


def made(entries: Iterable[Entry], say: Callable[[str], None] = lambda _: None) -> list[Made]:
    """The pages of entries, one after the other.

    Args:
        entries: Which.
        say: Takes a line of progress.

    Raises:
        NumericalError: A number that is none.
    """
    pages = []
    for entry in entries:
        say(f"{entry.id}: {entry.title}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)  # the chapter shows what lies beyond its bounds too
            page = entry.make()
        for each in page.rows:
            if not (abs(each.computed) < float("inf") and abs(each.expected) < float("inf")):
                raise NumericalError(f"{entry.id}: {each.quantity} is {each.computed}, and should be {each.expected}")
        pages.append(Made(entry=entry, page=page))
    return pages


# -------------------------------------------------------------------- to look at


def table(pages: Iterable[Made], width: int = WIDE) -> Table:
    """All rows, for a terminal of so many columns; a narrow one does not say by which way it is expected."""
    wide = width >= WIDE
    out = Table("id", "quantity", "unit", title="the chapter, computed")
    if wide:
        out.add_column("chapter")
    for head in ("computed", "expected", "difference"):
        out.add_column(head, justify="right", no_wrap=True)
    if wide:
        out.add_column("expected is")
    for page in pages:
        for k, (name, each) in enumerate(page.rows):
            quantity = each.quantity if wide or not each.states else f"{each.quantity}\n(chapter: {each.states})"
            cells = [name if not k else "", quantity, each.unit, *([each.states] if wide else [])]
            cells += [number(each.computed), number(each.expected), difference(each)]
            out.add_row(*cells, *([each.source] if wide else []))
        out.add_section()
    return out


def number(value: float) -> str:
    """Of at most six digits."""
    return f"{value:.6g}" if abs(value) >= 1e-13 or value == 0.0 else "0"


def difference(each: Row) -> str:
    """How far apart the two are: of the expected number where that says something, and that it is too far."""
    apart = each.difference
    if abs(apart) <= 1e-13 * max(abs(each.expected), 1.0):
        said = "none"
    elif abs(each.expected) > 1e-9:
        said = f"{100.0 * apart / abs(each.expected):+.2g} %"
    else:
        said = f"{apart:+.2g}"
    return said if each.ok else f"{said} (!)"


# -------------------------------------------------------------------- to keep


def prepared_folder(folder: Path) -> Path:
    """The folder, made if it was not there.

    Raises:
        FileError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as wrong:
        raise FileError(f"folder '{folder}' cannot be made: {wrong.strerror or wrong}; give another --out") from wrong
    return folder


def write(pages: Sequence[Made], folder: Path) -> dict[str, Path]:
    """The files of the book: a picture for each figure, book.csv and book.md; what each is, and where.

    Raises:
        FileError: A file cannot be written.
    """
    written = {}
    try:
        for each in pages:
            if each.page.figure is not None:
                path = folder / f"{each.entry.name}.png"
                each.page.figure.savefig(path, dpi=DPI)
                written[each.entry.name] = path
        for name, text in (("book.csv", _csv(pages)), ("book.md", _markdown(pages))):
            (folder / name).write_text(text, encoding="utf-8")
            written[name] = folder / name
    except OSError as wrong:
        raise FileError(f"the book cannot be written to '{folder}': {wrong.strerror or wrong}") from wrong
    return written


def _csv(pages: Iterable[Made]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEAD)
    for page in pages:
        for name, each in page.rows:
            values: dict[str, Any] = {head: getattr(each, head) for head in HEAD if head != "id"}
            writer.writerow([name, *(values[head] for head in HEAD[1:])])
    return out.getvalue()


def _markdown(pages: Iterable[Made]) -> str:
    lines = ["# The chapter, computed", ""]
    for page in pages:
        entry, made_page = page.entry, page.page
        lines += [f"## {entry.id}: {entry.title}", ""]
        if made_page.note:
            lines += [made_page.note, ""]
        if made_page.figure is not None:
            lines += [f"![{entry.title}]({entry.name}.png)", ""]
        lines += ["| quantity | unit | chapter | computed | expected | difference | expected is |"]
        lines += ["|---|---|---|--:|--:|--:|---|"]
        for _, each in page.rows:
            cells = (
                each.quantity, each.unit, each.states, number(each.computed), number(each.expected),
                difference(each), each.source,
            )  # fmt: skip
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        lines.append("")
    return "\n".join(lines)
