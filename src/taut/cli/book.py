"""The command `taut book`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from taut.cli.command import DONE, FAILED, STATUS, Answer, Command, Say


def _book(arguments: argparse.Namespace, say: Say) -> Answer:
    from taut.book import contents

    entries = contents.chosen(arguments.ids)
    folder = contents.prepared_folder(arguments.out or Path("out") / "book")
    pages = []
    for entry in entries:
        say(f"{entry.id}: {entry.title}")
        pages.append(entry.page())
    book = contents.Book(pages=pages)
    files = contents.write(book, folder)
    return Answer(
        text="\n".join([str(book), *map(str, files)]),
        data=[each.json(page.entry.id) for page in pages for each in page.rows],
        status=FAILED if book.missed else DONE,
    )


BOOK: Final = Command(
    name="book",
    help="Compute the chapter's equations and figures, beside the expected values.",
    run=_book,
    arguments={
        "ids": {"nargs": "*", "metavar": "ID", "help": "eq-10.6, fig-10.6, sec-10.2.1.5; all if left out"},
        "--out": {"type": Path, "metavar": "DIR", "help": "folder for book.html and pictures (default: out/book)"},
    },
    more=f"""examples:
  taut book
  taut book fig-10.6 eq-10.14 --out results

A row that is farther from what is expected than it may be is marked (!), and the exit status is 1.

{STATUS}""",
)
