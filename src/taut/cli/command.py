"""A command: its name and help, what it takes, and the function that runs it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

__all__ = ["DONE", "ENGINES", "FAILED", "STATUS", "WRONG", "Answer", "Command", "Say"]

DONE, FAILED, WRONG = 0, 1, 2
ENGINES: Final = ("auto", "native", "float")
STATUS: Final = """exit status:
  0  done
  1  the run failed, or missed a pass figure
  2  the request was wrong
"""
Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a command found: text for people, data for `--json`, the exit status, and remarks on standard error."""

    text: str
    data: Any
    status: int = DONE
    remarks: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command of `taut`.

    Args:
        name: Its word.
        help: One sentence.
        arguments: Adds what it takes to a parser.
        run: Runs it; the second argument takes lines of progress.
        more: What stands below its help: examples and exit statuses.
    """

    name: str
    help: str
    run: Callable[[argparse.Namespace, Say], Answer]
    arguments: Callable[[argparse.ArgumentParser], None] | None = None
    more: str = STATUS
