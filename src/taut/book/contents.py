"""The book as a whole: what is in it, its text, and the files that it leaves."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from taut.base.errors import FileError, unknown_name
from taut.base.result import Content, Result
from taut.book.page import CONTENTS, Entry, Page
from taut.record.log.files import written_aside
from taut.record.report import report

__all__ = ["CONTENTS", "Book", "chosen", "prepared_folder", "write"]

for _chapter in (
    "overview", "single_joint", "integral", "feedforward", "friction", "multi_joint", "task_space", "force", "hybrid",
    "impedance",
):  # fmt: skip
    import_module(f"taut.book.{_chapter}")  # each lists its entries in CONTENTS, here in the order of the chapter


def chosen(ids: Sequence[str]) -> list[Entry]:
    """The entries of these ids, in the order of the chapter; all if there are none. Raises UnknownNameError."""
    known = list(dict.fromkeys(entry.id for entry in CONTENTS))
    for name in ids:
        if name not in known:
            raise unknown_name("the book", "entry", name, difflib.get_close_matches(name, known, 8, 0.4) or known[:8])
    return [entry for entry in CONTENTS if not ids or entry.id in ids]


@dataclass(frozen=True, kw_only=True)
class Book(Result):
    """Entries of the book, computed."""

    pages: Sequence[Page]

    @property
    def missed(self) -> list[str]:
        """Numbers that differ from what is expected by more than their tolerance."""
        return [f"{page.entry.id}: {each.quantity}" for page in self.pages for each in page.rows if not each.ok]

    def content(self) -> Content:
        missed, count = self.missed, sum(len(page.rows) for page in self.pages)
        return Content(
            title="The chapter, computed",
            summary=[f"{count - len(missed)} of {count} numbers are what they should be"],
            faults=[f"missed: {each}" for each in missed],
            tables=[page.table() for page in self.pages],
            figures={page.title: page.drawn for page in self.pages if page.figure is not None},
        )


def prepared_folder(folder: Path) -> Path:
    """The folder, made if it was not there. Raises FileError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as wrong:
        raise FileError(f"folder '{folder}' cannot be made: {wrong.strerror or wrong}; give another --out") from wrong
    return folder


def write(book: Book, folder: Path) -> list[Path]:
    """The files of the book: book.html, and a picture of each figure of the chapter. Raises FileError."""
    written = [report(book, folder / "book.html")]
    for page in book.pages:
        if page.figure is not None:
            written.append(folder / f"{page.entry.id}.png")
            with written_aside("picture", written[-1]) as aside:
                page.figure.savefig(aside)
    return written
