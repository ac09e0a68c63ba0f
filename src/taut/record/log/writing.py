"""Logs: runs as MCAP files, written while they go on, read back exactly.

Beside the messages of `layout` a file has a record `taut.run` at the start and a record `taut.outcome` at the end,
each a JSON text with its checksum.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, Final, Self

import numpy as np

from taut.base import __version__
from taut.base.errors import FileError, count_of
from taut.record.info import Outcome
from taut.record.log.files import cannot_write, checked_target, written_aside
from taut.record.log.layout import Header, TickLayout, columns_of
from taut.record.plain import plain
from taut.record.progress import Progress
from taut.record.run import Run

if TYPE_CHECKING:
    from mcap.writer import Writer

__all__ = ["TICKS", "Ending", "Log", "open_log", "save", "sealed"]

SUFFIXES: Final = (".mcap",)
TICKS: Final = "/run"  # the topic of the ticks
USUAL_RATE: Final = 1000.0  # [Hz] of a run that does not say
BLOCK_TICKS: Final = 4096  # that are turned into bytes at a time
CHUNK_SECONDS: Final = 0.1  # of a run, which is what a process that is killed can lose
CHUNK_BYTES: Final = 64 * 1024
MIN_CHUNK_TICKS: Final = 16


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How a run ended, and how many ticks were written."""

    outcome: Outcome
    ticks: int


def sealed(text: str) -> dict[str, str]:
    """A text and its checksum."""
    return {"json": text, "crc32": f"{zlib.crc32(text.encode()):08x}"}


class _Stream:
    """A file whose every write is on its way to the disk when it returns, and that knows its length: a pipe too."""

    def __init__(self, path: Path) -> None:
        self._file: IO[bytes] = path.open("wb", buffering=0)
        self.position = 0

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:  # an unbuffered file may take a part only
            view = view[self._file.write(view) :]
        self.position += len(data)
        return len(data)

    def tell(self) -> int:
        return self.position

    def flush(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        self._file.close()


class Log:
    """A log that takes pieces of a run, one after the other. A context manager.

    The file appears with the first piece. If the run breaks off with an error, the log is closed properly, with
    that error as outcome.

    Args:
        path: The file; one that is there is replaced.
        to: Where to write, if not to the path itself.
        strict: Whether a write that the system refuses is an error; else the log ends there, and `finish` reports it.
    """

    def __init__(self, path: Path, to: Path | None = None, *, strict: bool = True) -> None:
        self._path, self._to, self._strict = path, path if to is None else to, strict
        self._refusal: FileError | None = None
        self._stream: _Stream | None = None
        self._writer: Writer | None = None
        self.ticks = 0
        """Ticks that it was given."""
        self.safe_ticks = 0
        """Ticks that are on the disk."""

    def write(self, rows: Run, advance: Callable[[int], None] | None = None) -> None:
        """Append the ticks of a piece of the run.

        Args:
            rows: The piece.
            advance: Called with how many more ticks are written, block by block.

        Raises:
            FileError: The system refuses a write, or the log is closed.
        """
        if self._refusal is not None:
            return
        if self._stream is not None and self._writer is None:
            raise FileError(f"log '{self._path}' is closed; open another one", name=str(self._path))
        try:
            if self._writer is None:
                self._writer = self._begin(rows)
            columns = columns_of(rows)
            for first in range(0, len(rows), BLOCK_TICKS):
                block = {name: column[first : first + BLOCK_TICKS] for name, column in columns.items()}
                self._append(self._writer, block)
                if advance is not None:
                    advance(len(block["t"]))
        except OSError as cause:
            self._refuse(cause)

    def _refuse(self, cause: OSError) -> None:
        self._writer, self._refusal = None, cannot_write("log", self._path, cause)  # what has been written stays
        if self._strict:
            raise self._refusal from cause

    def _begin(self, rows: Run) -> Writer:
        from mcap.writer import CompressionType, Writer

        header = Header.of(rows)
        description = sealed(json.dumps(plain(header)))
        rate = rows.info.rate or USUAL_RATE
        self._layout = TickLayout(header)
        ticks = max(MIN_CHUNK_TICKS, min(CHUNK_BYTES // self._layout.dtype.itemsize, round(CHUNK_SECONDS * rate)))
        self._stream = _Stream(self._to)
        stream: Any = self._stream  # which has what the writer needs of a file
        writer = Writer(stream, chunk_size=ticks * self._layout.dtype.itemsize, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library=f"taut {__version__}")
        writer.add_metadata("taut.run", description)
        schema = writer.register_schema("taut/msg/Tick", "ros2msg", self._layout.schema().encode())
        self._channel = writer.register_channel(TICKS, "cdr", schema)
        return writer

    def _append(self, writer: Writer, columns: dict[str, Any]) -> None:
        assert self._stream is not None
        data, size = self._layout.rows(columns).tobytes(), self._layout.dtype.itemsize
        times = np.round(columns["t"] * 1e9).astype(np.int64).tolist()
        before = self._stream.position
        for k, time in enumerate(times):
            writer.add_message(self._channel, time, data[k * size : (k + 1) * size], time, self.ticks)
            self.ticks += 1
            if self._stream.position != before:  # a chunk is full
                before, self.safe_ticks = self._stream.position, self.ticks

    def finish(self, outcome: Outcome) -> Outcome:
        """Write how the run ended, and what readers need; the same outcome, with how many ticks the log lacks.

        Raises:
            FileError: The system refuses a write.
        """
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                ending = plain(Ending(outcome=outcome, ticks=self.ticks))
                writer.add_metadata("taut.outcome", sealed(json.dumps(ending)))
                writer.finish()  # type: ignore[no-untyped-call]
                self.safe_ticks = self.ticks
            except OSError as cause:
                self._refuse(cause)
        if self._refusal is None:
            return outcome
        ticks = outcome.tick + 1
        dropped = ticks - self.safe_ticks
        message = f"{outcome.message}; {self._refusal} ({dropped} of {count_of(ticks, 'tick')} are not in it)"
        return replace(outcome, message=message, dropped=dropped)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        words = "" if error is None else f": {type(error).__name__}: {error}".rstrip(": ")
        outcome = Outcome(kind="stopped", message=f"the run broke off{words}", tick=max(0, self.ticks - 1))
        with suppress(OSError):  # the first error is the one to hear about
            self.finish(outcome)
        if self._stream is not None:
            with suppress(OSError):
                self._stream.close()


def open_log(path: str | os.PathLike[str]) -> Log:
    """A log file (.mcap) to write pieces of a run to while it goes on; where it cannot be written, it ends there.

    Raises:
        FileError: Another suffix, a folder, a folder that does not exist.
    """
    return Log(checked_target("log", path, SUFFIXES), strict=False)


def save(run: Run, path: str | os.PathLike[str], *, progress: bool | None = None) -> Path:
    """Write a whole run as a log; what was there before stays if anything goes wrong."""
    target = checked_target("log", path, SUFFIXES)
    with written_aside("log", target) as aside, Log(target, to=aside) as log:
        with Progress(len(run), progress, "writing") as bar:
            log.write(run, bar.advance)
        log.finish(run.outcome)
    return target
