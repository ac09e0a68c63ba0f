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
    "impedance",
):  # fmt: skip
    import_module(f"taut.book.{_chapter}")  # each lists its entries in CONTENTS, here in the order of the chapter
DPI: Final = 150
COLUMNS: Final = ("quantity", "unit", "chapter", "computed", "expected", "difference", "expected is")


def chosen(ids: Sequence[str]) -> list[Entry]:
    """The entries of these ids, in the order of the chapter; all if there are none. Raises UnknownNameError."""
    known = list(dict.fromkeys(entry.id for entry in CONTENTS))
    for name in ids:
        if name not in known:
            raise unknown_name("the book", "entry", name, difflib.get_close_matches(name, known, 8, 0.4) or known[:8])
    return [entry for entry in CONTENTS if not ids or entry.id in ids]


def cells(each: Row) -> tuple[str, ...]:
    """A row as text, by COLUMNS."""
    numbers = (_number(each.computed), _number(each.expected), _difference(each))
    return each.quantity, each.unit, each.states, *numbers, each.source


def table(pages: Iterable[Page]) -> Table:
    """All rows, for a terminal: what the chapter states stands below the quantity, the sources are in the files."""
    out = Table("id", "quantity", "unit", title="the chapter, computed")
    for head in COLUMNS[3:6]:
        out.add_column(head, justify="right", no_wrap=True)
    for page in pages:
        for k, each in enumerate(page.rows):
            quantity, unit, states, *numbers, _ = cells(each)
            quantity = f"{quantity}\n(chapter: {states})" if states else quantity
            out.add_row(page.entry.id if not k else "", quantity, unit, *numbers)
        out.add_section()
    return out


def _number(value: float) -> str:
    return f"{value:.6g}" if abs(value) >= 1e-13 or value == 0.0 else "0"


def _difference(each: Row) -> str:
    """The difference, relative to the expected number where that is not zero; (!) where it is too large."""
    apart = each.difference
    if abs(apart) <= 1e-13 * max(abs(each.expected), 1.0):
        text = "none"
    elif abs(each.expected) > 1e-9:
        text = f"{100.0 * apart / abs(each.expected):+.2g} %"
    else:
        text = f"{apart:+.2g}"
    return text if each.ok else f"{text} (!)"


def prepared_folder(folder: Path) -> Path:
    """The folder, made if it was not there. Raises FileError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as wrong:
        raise FileError(f"folder '{folder}' cannot be made: {wrong.strerror or wrong}; give another --out") from wrong
    return folder


def write(pages: Sequence[Page], folder: Path) -> dict[str, Path]:
    """The files of the book by their kind: a picture for each figure, book.csv and book.md. Raises FileError."""
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
    out, keys = (
        io.StringIO(),
        ("quantity", "unit", "states", "computed", "expected", "difference", "within", "source"),
    )
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["id", *keys])
    writer.writerows([page.entry.id, *(getattr(each, key) for key in keys)] for page in pages for each in page.rows)
    return out.getvalue()


def _markdown(pages: Iterable[Page]) -> str:
    lines = ["# The chapter, computed", ""]
    for page in pages:
        picture = f"![{page.entry.title}]({page.entry.name}.png)" if page.figure is not None else ""
        for text in (f"## {page.entry.id}: {page.entry.title}", page.note, picture):
            lines += [text, ""] if text else []
        lines += [f"| {' | '.join(COLUMNS)} |", "|---|---|---|--:|--:|--:|---|"]
        for each in page.rows:
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells(each))} |")
        lines.append("")
    return "\n".join(lines)
