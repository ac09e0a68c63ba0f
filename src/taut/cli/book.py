"""The command `taut book`."""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from taut.base.errors import FileError
from taut.cli.command import DONE, FAILED, STATUS, Answer, Command, Say

if TYPE_CHECKING:
    from taut.book.page import Page

LINE_LETTERS: Final = 120  # letters of a line in a file or a pipe


def _book(arguments: argparse.Namespace, say: Say) -> Answer:
    from taut.book import contents

    entries = contents.chosen(arguments.ids)
    folder = contents.prepared_folder(arguments.out or Path("out") / "book")
    pages = []
    for entry in entries:
        say(f"{entry.id}: {entry.title}")
        pages.append(entry.page())
    rows = [(page.entry.id, each) for page in pages for each in page.rows]
    missed = [f"{name}: {each.quantity}" for name, each in rows if not each.ok]
    text, data = [_table(pages)], [each.json(name) for name, each in rows]
    try:
        written = contents.write(pages, folder)
    except FileError as wrong:
        return Answer(text=text[0], data=data, status=FAILED, remarks=[str(wrong)])
    text += [f"{page.entry.id}: {page.note}" for page in pages if page.note]
    text += [f"{name:20} {path}" for name, path in written.items()]
    text += [f"missed: {each}" for each in missed]
    text.append(f"{len(rows) - len(missed)} of {len(rows)} numbers are what they should be")
    return Answer(text="\n".join(text), data=data, status=FAILED if missed else DONE)


def _table(pages: Sequence[Page]) -> str:
    """The table as wide as the terminal, or as COLUMNS says."""
    from rich.console import Console

    from taut.book import contents

    asked = "COLUMNS" in os.environ or os.isatty(1)
    width = shutil.get_terminal_size((LINE_LETTERS, 0)).columns if asked else LINE_LETTERS
    console = Console(color_system=None, width=width)
    with console.capture() as text:
        console.print(contents.table(pages))
    return text.get().rstrip("\n")


BOOK: Final = Command(
    name="book",
    help="Compute the chapter's equations and figures, beside the expected values.",
    run=_book,
    arguments={
        "ids": {"nargs": "*", "metavar": "ID", "help": "eq-10.6, fig-10.6, sec-10.2.1.5; all if left out"},
        "--out": {"type": Path, "metavar": "DIR", "help": "folder for pictures and tables (default: out/book)"},
    },
    more=f"""examples:
  taut book
  taut book fig-10.6 eq-10.14 --out results

A row that is farther from what is expected than it may be is marked (!), and the exit status is 1.

{STATUS}""",
)
