"""The book as a whole: what is in it, the table on a terminal, and the files that it leaves."""

from __future__ import annotations

import csv
import difflib
import io
from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Final

from rich.table import Table

from taut.base.errors import FileError, unknown_name
from taut.book.page import CONTENTS, Entry, Page, Row

__all__ = ["CONTENTS", "chosen", "prepared_folder", "table", "write"]

for _chapter in (
    "overview", "single_joint", "integral", "feedforward", "friction", "multi_joint", "task_space", "force", "hybrid",
    "impedance", "display", "other_topics",
):  # fmt: skip
    import_module(f"taut.book.{_chapter}")  # each lists its entries in CONTENTS, here in the order of the chapter
DPI: Final = 150
WIDE: Final = 130  # columns of a terminal that shows the whole table
HEAD: Final = ("id", "quantity", "unit", "states", "computed", "expected", "difference", "within", "source")


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


# -------------------------------------------------------------------- to look at


def table(pages: Iterable[Page], width: int = WIDE) -> Table:
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
        for k, each in enumerate(page.rows):
            quantity = each.quantity if wide or not each.states else f"{each.quantity}\n(chapter: {each.states})"
            cells = [page.entry.id if not k else "", quantity, each.unit, *([each.states] if wide else [])]
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


def write(pages: Sequence[Page], folder: Path) -> dict[str, Path]:
    """The files of the book: a picture for each figure, book.csv and book.md; what each is, and where.

    Raises:
        FileError: A file cannot be written.
    """
    written = {}
    try:
        for each in pages:
            if each.figure is not None:
                path = folder / f"{each.entry.name}.png"
                each.figure.savefig(path, dpi=DPI)
                written[each.entry.name] = path
        for name, text in (("book.csv", _csv(pages)), ("book.md", _markdown(pages))):
            (folder / name).write_text(text, encoding="utf-8")
            written[name] = folder / name
    except OSError as wrong:
        raise FileError(f"the book cannot be written to '{folder}': {wrong.strerror or wrong}") from wrong
    return written


def _csv(pages: Iterable[Page]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEAD)
    for page in pages:
        for each in page.rows:
            writer.writerow([page.entry.id, *(getattr(each, head) for head in HEAD[1:])])
    return out.getvalue()


def _markdown(pages: Iterable[Page]) -> str:
    lines = ["# The chapter, computed", ""]
    for page in pages:
        lines += [f"## {page.entry.id}: {page.entry.title}", ""]
        if page.note:
            lines += [page.note, ""]
        if page.figure is not None:
            lines += [f"![{page.entry.title}]({page.entry.name}.png)", ""]
        lines += ["| quantity | unit | chapter | computed | expected | difference | expected is |"]
        lines += ["|---|---|---|--:|--:|--:|---|"]
        for each in page.rows:
            cells = (
                each.quantity, each.unit, each.states, number(each.computed), number(each.expected),
                difference(each), each.source,
            )  # fmt: skip
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        lines.append("")
    return "\n".join(lines)
