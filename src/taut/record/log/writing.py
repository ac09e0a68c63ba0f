"""Logs: runs as MCAP files, written while they go on, read back exactly.

A file has a record `taut.run` at the start, and again at the end before `taut.outcome`, each a JSON text with its
checksum, and between them one ROS 2 message taut/msg/Tick per tick on the topic /run: t and all columns (q, v, tau,
command, terms_P, extra_F_ext, ...), numbers of fixed count, so that NumPy writes and reads thousands at a time.

References:
    OMG, DDS-XTypes 1.3, section 7.4 (plain CDR, version 1).
"""

from __future__ import annotations

import json
import os
import re
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, Final, Literal, Self, TypeAlias, cast

import numpy as np

from taut.base import __version__
from taut.base.errors import FileError, count_of
from taut.base.types import Array, Float64Array
from taut.control.trajectories.compound import Compound
from taut.record.info import Outcome, RunInfo, check_info
from taut.record.log.files import cannot_write, checked_target, written_aside
from taut.record.plain import plain
from taut.record.run import Run

if TYPE_CHECKING:
    from mcap.writer import Writer

FORMAT: Final = 2
CDR_HEAD: Final = b"\x00\x01\x00\x00"  # little-endian plain CDR
MAX_COLUMNS: Final = 2000
MAX_AXES: Final = 8
MAX_AXIS: Final = 2**31  # [-] size of an axis
MAX_PARTS: Final = 64  # of a reference of several

RULER: Final = "=" * 80
SUFFIXES: Final = (".mcap",)
TICKS: Final = "/run"  # the topic of the ticks
USUAL_RATE: Final = 1000.0  # [Hz] of a run that does not say
BLOCK_TICKS: Final = 4096  # that are turned into bytes at a time
CHUNK_SECONDS: Final = 0.1  # of a run, which is what a process that is killed can lose
CHUNK_BYTES: Final = 64 * 1024
MIN_CHUNK_TICKS: Final = 16

Shape: TypeAlias = tuple[int, ...]
Unit = Literal["rad", "m"]
Kind = Literal["torque", "velocity", "position"]


@dataclass(frozen=True, kw_only=True)
class PartKind:
    """One of the samples that a reference of several holds."""

    name: str
    kind: str
    joints: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Header:
    """The columns of a run, and what it was made with."""

    format: int = FORMAT
    joint_names: tuple[str, ...]
    units: tuple[Unit, ...]
    continuous: tuple[int, ...]
    kind: Kind
    terms: tuple[str, ...]
    reference: str  # name of the sample's class
    parts: tuple[PartKind, ...]  # of a sample of several
    fields: Mapping[str, Shape]  # of the reference
    extra: Mapping[str, Shape]
    info: RunInfo

    @classmethod
    def of(cls, run: Run) -> Header:
        """The header of a run, or of a piece of one."""
        sample = type(run.reference)
        parts = sample.parts if issubclass(sample, Compound) else ()
        return cls(
            joint_names=run.joint_names,
            units=cast("tuple[Unit, ...]", run.units),
            continuous=run.continuous,
            kind=cast("Kind", run.kind),
            terms=tuple(run.terms),
            reference=sample.__name__.partition("[")[0],
            parts=tuple(PartKind(name=part.name, kind=part.kind.__name__, joints=part.joints) for part in parts),
            fields={name: np.shape(getattr(run.reference, name))[1:] for name in sample.fields(run.n)},
            extra={name: np.shape(value)[1:] for name, value in run.extra.items()},
            info=run.info,
        )

    def check(self, max_numbers: int) -> None:
        """Require (ValueError) that the parts of a header that was read fit each other and the file."""
        n = len(self.joint_names)
        shapes = (*self.fields.values(), *self.extra.values())
        few = len(self.terms) + len(shapes) <= MAX_COLUMNS and len(self.parts) <= MAX_PARTS
        small = all(len(shape) <= MAX_AXES and all(0 <= size <= MAX_AXIS for size in shape) for shape in shapes)
        if not few or not small or sum(map(prod, self.shapes().values())) > max_numbers:
            raise ValueError("it has more numbers in a tick than the file has room for")
        unique = all(len(set(names)) == len(names) for names in (self.joint_names, self.terms))
        if not n or len(self.units) != n or not unique or not all(0 <= i < n for i in self.continuous):
            raise ValueError("its header does not fit its joints")
        check_info(self.info, self.joint_names)

    def shapes(self) -> dict[str, Shape]:
        """Shape of one row of every column."""
        n = (len(self.joint_names),)
        out: dict[str, Shape] = {"t": (), **dict.fromkeys(("q", "v", "tau", "command"), n)}
        out |= {f"terms.{name}": n for name in self.terms}
        out |= {f"reference.{name}": shape for name, shape in self.fields.items()}
        return out | {f"extra.{name}": shape for name, shape in self.extra.items()}


class TickLayout:
    """One tick as the message taut/msg/Tick: doubles, one behind the other."""

    def __init__(self, header: Header) -> None:
        self.shapes = header.shapes()
        self.joints = header.joint_names
        sized = [(name, "<f8", shape) for name, shape in self.shapes.items() if prod(shape)]
        self.dtype = np.dtype([("cdr", f"V{len(CDR_HEAD)}"), *sized])

    def schema(self) -> str:
        """The definition of the message. What has a number for each joint has them by the names of the joints."""
        lines = []
        names = _identifiers(self.shapes)
        for name, shape in self.shapes.items():
            if shape == (len(self.joints),):
                lines.append(f"taut/Joints {names[name]}")
            elif prod(shape):
                lines.append(f"float64{f'[{prod(shape)}]' if shape else ''} {names[name]}")
        joints = [f"float64 {name}" for name in _identifiers(self.joints).values()]
        return "\n".join([*lines, RULER, "MSG: taut/Joints", *joints, ""])

    def rows(self, columns: Mapping[str, Float64Array]) -> Array:
        """(k,) messages of the ticks with these columns (k, ...)."""
        out = np.zeros(len(columns["t"]), dtype=self.dtype)
        out["cdr"] = np.void(CDR_HEAD)
        for name in (self.dtype.names or ())[1:]:
            out[name] = columns[name]
        return out

    def columns(self, blocks: Sequence[Array]) -> dict[str, Float64Array]:
        """The inverse of `rows`, of several blocks, each (k,)."""
        ticks = sum(map(len, blocks))
        return {
            name: np.concatenate([np.zeros((0, *shape)), *(block[name] for block in blocks)])
            if prod(shape)
            else np.zeros((ticks, *shape))
            for name, shape in self.shapes.items()
        }


def _identifiers(names: Iterable[str]) -> dict[str, str]:
    """Names as ROS takes them for fields: small letters, digits and single underscores; equal ones get a number."""
    out: dict[str, str] = {}
    for name in names:
        word = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        word = word if word[:1].isalpha() else f"x{word}"
        out[name] = word if word not in out.values() else f"{word}_{len(out)}"
    return out


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

    def __init__(self, path: Path, mode: str) -> None:
        self._file: IO[bytes] = cast("IO[bytes]", path.open(mode, buffering=0))
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

    def sync(self) -> None:
        """What has been written is on the disk when this returns, where the file is on one."""
        with suppress(OSError):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()


class Log:
    """A log that takes pieces of a run, one after the other. A context manager.

    The file, `to` or `path`, appears with the first piece; an error of the run becomes the outcome. A refused write
    is an error if strict; else the log ends there, and `finish` reports it.
    """

    def __init__(self, path: Path, to: Path | None = None, *, strict: bool = True, mode: str = "wb") -> None:
        self.path, self._to, self._strict, self._mode = path, path if to is None else to, strict, mode
        self._refusal: FileError | None = None
        self._stream: _Stream | None = None
        self._writer: Writer | None = None
        self.ticks = 0
        """Ticks that it was given."""
        self.safe_ticks = 0
        """Ticks that are on the disk."""

    def write(self, rows: Run) -> None:
        """Append the ticks of a piece of the run."""
        columns = rows.arrays()
        for first in range(0, max(len(rows), 1), BLOCK_TICKS):
            block = {name: column[first : first + BLOCK_TICKS] for name, column in columns.items()}
            self.append(lambda: Header.of(rows), block["t"], lambda layout: layout.rows(block).tobytes())  # noqa: B023

    def append(self, header: Callable[[], Header], t: Float64Array, messages: Callable[[TickLayout], bytes]) -> None:
        """Append ticks as messages, one behind the other; the header is asked for where the file begins."""
        if self._refusal is not None:
            return
        if self._stream is not None and self._writer is None:
            raise FileError(f"log '{self.path}' is closed; open another one", name=str(self.path))
        try:
            if self._writer is None:
                self._writer = self._begin(header())
            self._append(self._writer, t, messages(self._layout))
        except OSError as cause:
            self._refuse(cause)

    def flush(self, *, to_disk: bool = False) -> None:
        """Close the chunk, so that every tick given is in the file; `to_disk` waits for the disk, too."""
        try:
            if self._writer is not None and self._stream is not None:
                self._writer.flush()  # type: ignore[no-untyped-call]
                self.safe_ticks = self.ticks
                if to_disk:
                    self._stream.sync()
        except OSError as cause:
            self._refuse(cause)

    def _refuse(self, cause: OSError) -> None:
        self._writer, self._refusal = None, cannot_write("log", self.path, cause)  # what has been written stays
        if self._strict:
            raise self._refusal from cause

    def _begin(self, header: Header) -> Writer:
        from mcap.writer import CompressionType, Writer

        self._description = sealed(json.dumps(plain(header)))
        rate = header.info.rate or USUAL_RATE
        self._layout = TickLayout(header)
        ticks = max(MIN_CHUNK_TICKS, min(CHUNK_BYTES // self._layout.dtype.itemsize, round(CHUNK_SECONDS * rate)))
        self._stream = _Stream(self._to, self._mode)
        stream: Any = self._stream  # which has what the writer needs of a file
        writer = Writer(stream, chunk_size=ticks * self._layout.dtype.itemsize, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library=f"taut {__version__}")
        writer.add_metadata("taut.run", self._description)
        schema = writer.register_schema("taut/msg/Tick", "ros2msg", self._layout.schema().encode())
        self._channel = writer.register_channel(TICKS, "cdr", schema)
        return writer

    def _append(self, writer: Writer, t: Float64Array, data: bytes) -> None:
        assert self._stream is not None
        size, times = self._layout.dtype.itemsize, np.round(t * 1e9).astype(np.int64).tolist()
        before = self._stream.position
        for k, time in enumerate(times):
            writer.add_message(self._channel, time, data[k * size : (k + 1) * size], time, self.ticks)
            self.ticks += 1
            if self._stream.position != before:  # a chunk is full
                before, self.safe_ticks = self._stream.position, self.ticks

    def finish(self, outcome: Outcome) -> Outcome:
        """Write how the run ended, and what readers need; the same outcome, with how many ticks the log lacks."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                ending = plain(Ending(outcome=outcome, ticks=self.ticks))
                writer.add_metadata("taut.run", self._description)
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
        self.close()

    def close(self) -> None:
        """Close the file as it is."""
        if self._stream is not None:
            with suppress(OSError):
                self._stream.close()


def open_log(path: str | os.PathLike[str]) -> Log:
    """A log file (.mcap) to write pieces of a run to while it goes on; where it cannot be written, it ends there."""
    return Log(checked_target("log", path, SUFFIXES), strict=False)


def save(run: Run, path: str | os.PathLike[str]) -> Path:
    """Write a whole run as a log; what was there before stays if anything goes wrong."""
    target = checked_target("log", path, SUFFIXES)
    with written_aside("log", target) as aside, Log(target, to=aside) as log:
        log.write(run)
        log.finish(run.outcome)
    return target
