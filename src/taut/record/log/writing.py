"""Logs: runs as MCAP files, written while they go on, read back exactly.

An MCAP file has ROS 2 messages (see `messages`), and what messages cannot say as metadata: a record `taut.run` at the
start, a record `taut.outcome` at the end, each a JSON text with its checksum.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Final, Self

import numpy as np

from taut.base.errors import FileError, UsageError, count_of
from taut.base.types import Float64Array
from taut.record.log.description import described, sealed, wrong_entry
from taut.record.log.files import cannot_write, checked_target, written_aside
from taut.record.log.messages import Description, TickLayout, columns_of
from taut.record.outcome import Outcome
from taut.record.progress import Progress
from taut.record.run import Run

if TYPE_CHECKING:
    from taut.record.log.container import McapWriter

__all__ = ["Log", "RunLog", "open_log", "save"]

SUFFIXES: Final = (".mcap",)
USUAL_RATE: Final = 1000.0  # [Hz] of a run that does not say
BLOCK_BYTES: Final = 4 * 1024 * 1024  # of ticks that are turned into bytes at a time


class Log:
    """A log that takes pieces of a run, one after the other. A context manager.

    The file appears with the first piece. If the run breaks off with an error, the log is closed properly, with
    that error as outcome.

    Args:
        path: The file; one that is there is replaced.
        to: Where to write, if not to the path itself.
    """

    def __init__(self, path: Path, to: Path | None = None) -> None:
        self._path, self._to = path, path if to is None else to
        self._file: IO[bytes] | None = None
        self._writer: McapWriter | None = None
        self.ticks = 0
        """Ticks that have been written."""

    def write(self, rows: Run, advance: Callable[[int], None] | None = None) -> None:
        """Append the ticks of a piece of the run.

        Args:
            rows: The piece.
            advance: Called with how many more ticks are written, block by block.

        Raises:
            FileError: The system refuses a write, or the log is closed.
        """
        if self._file is not None and self._writer is None:
            raise FileError(f"log '{self._path}' is closed; open another one", name=str(self._path))
        try:
            if self._writer is None:
                self._writer = self._begin(rows)
            columns = columns_of(rows)
            for first in range(0, len(rows), self._block):
                block = {name: column[first : first + self._block] for name, column in columns.items()}
                self._append(self._writer, block)
                if advance is not None:
                    advance(len(block["t"]))
        except OSError as cause:
            self._writer = None  # what has been written stays as it is
            raise cannot_write("log", self._path, cause) from cause

    def _begin(self, rows: Run) -> McapWriter:
        from taut.record.log.container import McapWriter

        self._layout = TickLayout(Description.of(rows))
        description = sealed(described(rows, self._layout.description))
        wrong = wrong_entry(rows)
        if wrong is not None:  # nobody could read the log
            raise UsageError(
                f"run.info['{wrong}'] is not what taut.run records under that name; give it another name", name="info"
            )
        self._block = max(16, BLOCK_BYTES // self._layout.size)
        self._rows = np.tile(self._layout.template, self._block).view(self._layout.dtype)
        self._file = self._to.open("wb", buffering=0)
        writer = McapWriter(self._file, self._layout, float(rows.info.get("rate", USUAL_RATE)))
        writer.metadata("taut.run", description)
        return writer

    def _append(self, writer: McapWriter, columns: dict[str, Float64Array]) -> None:
        times = np.round(columns["t"] * 1e9).astype(np.uint64)
        rows = self._rows[: len(times)]
        self._layout.fill(rows, columns, self.ticks, times)
        writer.write(rows, times)
        self.ticks += len(times)

    def finish(self, outcome: Outcome) -> None:
        """Write how the run ended, and what readers need.

        Raises:
            FileError: The system refuses a write.
        """
        if self._writer is None:
            return
        writer, self._writer = self._writer, None
        try:
            writer.metadata("taut.outcome", sealed({**outcome.json(), "ticks": self.ticks}))
            writer.finish()
        except OSError as cause:
            raise cannot_write("log", self._path, cause) from cause

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        words = "" if error is None else f": {type(error).__name__}: {error}".rstrip(": ")
        outcome = Outcome(kind="stopped", message=f"the run broke off{words}", tick=max(0, self.ticks - 1))
        with suppress(FileError):  # the first error is the one to hear about
            self.finish(outcome)
        if self._file is not None:
            self._file.close()


class RunLog:
    """The log of a run that is going on. Where it cannot be written any more it ends, and the run does not.

    A context manager around the log's own.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._refusal: FileError | None = None

    def write(self, rows: Run) -> None:
        """Append the ticks of a piece of the run, as long as that works."""
        if self._refusal is None:
            try:
                self._log.write(rows)
            except FileError as refusal:
                self._refusal = refusal

    def finish(self, outcome: Outcome) -> Outcome:
        """Write how the run ended; the same outcome, with how many ticks the log lacks."""
        if self._refusal is None:
            try:
                self._log.finish(outcome)
            except FileError as refusal:
                self._refusal = refusal
        if self._refusal is None:
            return outcome
        ticks = outcome.tick + 1
        dropped = ticks - self._log.ticks
        message = f"{outcome.message}; {self._refusal} ({dropped} of {count_of(ticks, 'tick')} are not in it)"
        return replace(outcome, message=message, dropped=dropped)

    def __enter__(self) -> Self:
        self._log.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(OSError):  # of a file that is closed: what it lacks has been counted
            self._log.__exit__(kind, error, trace)


def open_log(path: str | os.PathLike[str]) -> Log:
    """A log file (.mcap) to write pieces of a run to while it goes on.

    Raises:
        FileError: Another suffix, a folder, a folder that does not exist.
    """
    return Log(checked_target("log", path, SUFFIXES))


def save(run: Run, path: str | os.PathLike[str], *, progress: bool | None = None) -> Path:
    """Write a whole run as a log; what was there before stays if anything goes wrong."""
    target = checked_target("log", path, SUFFIXES)
    with written_aside("log", target) as aside, Log(target, to=aside) as log:
        with Progress(len(run), progress, "writing") as bar:
            log.write(run, bar.advance)
        log.finish(run.outcome)
    return target
