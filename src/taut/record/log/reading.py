"""Reading a log back: every array exactly, and of a cut or damaged file what comes before.

A file that somebody else wrote may ask for any amount of memory and time; what is read of it is bounded here.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import IO, Any, Final

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata

from taut.base.checks import readable_file
from taut.base.errors import FileError, TautError, UsageError, printable
from taut.base.paths import subtree
from taut.base.types import Array
from taut.control.trajectories.compound import phase_sample, together_kind
from taut.control.trajectories.reference import Sample
from taut.record.info import POSES, Outcome, check_info, with_parameters
from taut.record.log.writing import FORMAT, TICKS, Ending, Header, Shape, TickLayout
from taut.record.plain import restored
from taut.record.run import Run

MAGIC: Final = b"\x89MCAP0\r\n"
RECORD_HEAD: Final = struct.Struct("<BQ")  # opcode and length of a record
MESSAGE_HEAD: Final = 22  # bytes of a message record before its data
MAX_CHUNK: Final = 32 * 1024 * 1024  # bytes of its records
MAX_RECORD: Final = 8 * 1024 * 1024  # bytes of another record that is read
CHUNK_HEAD: Final = 64  # bytes of a chunk's content in which its times, sizes and compression stand
CHUNK_MARK: Final = b"\x03\x00\x00\x00lz4"  # in every chunk that taut writes, so many bytes from its start:
CHUNK_MARK_AT: Final = RECORD_HEAD.size + 28
MAX_SEARCH: Final = 2 * MAX_CHUNK  # bytes behind a damage in which a chunk is looked for
MIN_RECORD: Final = 64  # bytes; a file whose records are shorter on the whole is no log
FEW_RECORDS: Final = 10_000  # that any file may have
FEW_BYTES: Final = 64 * 1024 * 1024  # that any file may unpack to
MAX_UNPACKED: Final = 128  # bytes that a byte of the file may unpack to; our own logs have 6
MAX_NUMBERS: Final = 1_000_000  # in a tick
MAX_VALUES: Final = 1_000_000  # of a JSON text


def load_run(path: str | os.PathLike[str]) -> Run:
    """Read a log that `run.save` or `taut.run(..., log=)` wrote.

    Every array, the outcome and the info are exactly what was recorded, `run.arms` among it; only what is drawn of an
    arm is not in the file (`run.arm` is None). Of a file that was cut off or damaged, the ticks before that are
    returned, and the outcome says so; `taut repair` finds those behind it, too.

    Args:
        path: A .mcap file.


    Raises:
        FileError: No such file, a folder, an empty file, no log, or one without a whole description of the run.

    Example:
        >>> import taut, tempfile
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.PID(kp=2.205, kd=2.0), arm)
        >>> run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.5]), duration=1.0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     again = taut.load_run(run.save(f"{folder}/run.mcap"))
        >>> bool((again.q == run.q).all()), again.outcome == run.outcome
        (True, True)
    """
    if not isinstance(path, (str, os.PathLike)):
        raise UsageError(f"load_run takes the path of a .mcap file; got {type(path).__name__}", name="path")
    return next(intact_parts(path))


def intact_parts(path: str | os.PathLike[str]) -> Iterator[Run]:
    """The ticks of a log that are whole, as runs: those from its start on, and what stands behind each damage.

    Raises FileError as `load_run` does.
    """
    try:
        target = readable_file("log", path)
        with target.open("rb") as file:
            yield from _read(file, target.stat().st_size)
    except FileError:
        raise
    except (
        OSError,
        ValueError,
        ArithmeticError,
        RecursionError,
        TautError,
    ) as cause:  # a bad disk, or no log of ours
        raise FileError(f"log {str(path)!r} cannot be read: {printable(str(cause))}", name=str(path)) from cause


def _read(file: IO[bytes], size: int) -> Iterator[Run]:
    first = file.read(len(MAGIC))
    if first != MAGIC:
        raise ValueError(f"it is no MCAP file, as it starts with {first!r}")
    found = _contents(file, size)
    if found.unpacked > FEW_BYTES + MAX_UNPACKED * size:
        raise ValueError(f"it has {size} bytes and would unpack to {found.unpacked}, more than a log does")
    if "taut.run" not in found.metadata:
        raise ValueError("it has no description of a run; it is cut off or damaged, or taut did not write it")
    values = _unsealed(found.metadata["taut.run"])
    if not isinstance(values, dict) or values.get("format", FORMAT) != FORMAT:
        raise ValueError(f"this version of taut reads logs of format {FORMAT}")
    header = restored(Header, values, "header")
    header.check(min(max(size, 4096), MAX_NUMBERS))
    reference, layout = _sample_class(header), TickLayout(header)
    for begin, blocks in _stretches(_blocks(file, found, layout)):
        columns = layout.columns(blocks)
        run = Run(
            t=columns["t"],
            q=columns["q"],
            v=columns["v"],
            tau=columns["tau"],
            command=columns["command"],
            terms=subtree(columns, "terms"),
            reference=reference.of(subtree(columns, "reference")),
            outcome=_outcome(found, columns["t"], begin),
            joint_names=header.joint_names,
            units=header.units,
            continuous=header.continuous,
            kind=header.kind,
            extra=subtree(columns, "extra"),
            info=header.info,
        )
        if header.info.servo is not None:
            run = replace(run, info=with_parameters(header.info, run.extra, run.t))
            check_info(run.info, run.joint_names)
        _check_columns(run)
        yield run


def _stretches(blocks: Iterator[tuple[int, Array]]) -> Iterator[tuple[int, list[Array]]]:
    """Number of the first tick, and blocks, of each stretch without a gap; the first one may be empty."""
    begin, following, kept = 0, 0, list[Array]()
    for first, block in blocks:
        if first != following:
            yield begin, kept
            begin, kept = first, []
        kept.append(block)
        following = first + len(block)
    yield begin, kept


def _check_columns(run: Run) -> None:
    """Require (ValueError) that the columns that an info is about are there, in their shapes."""
    shapes: dict[str, Shape] = {"F_ext": (6,)}
    if run.info.phases:
        shapes |= {"phase": (), "phase_ended": ()}
    rows = [thing.row for thing in run.info.around.things if thing.row is not None]
    if rows:
        shapes[POSES] = (max(rows) + 1, 7)
    for name, shape in shapes.items():
        if (name in run.extra or name != "F_ext") and run.extra[name].shape[1:] != shape:
            raise ValueError(f"its column '{name}' is not what taut.run records")
    if run.info.phases:
        _ = run.phases


@dataclass
class Contents:
    """What stands in a file."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name; of several the first that is whole
    topics: dict[int, str] = field(default_factory=dict)  # by channel
    chunks: list[tuple[int, int]] = field(default_factory=list)  # where the record's content starts, and its length
    unpacked: int = 0  # bytes that the chunks say they have
    damage: int | None = None  # first byte at which something is not what was written

    def damaged(self, at: int) -> None:
        """Something is wrong at a byte."""
        self.damage = at if self.damage is None else min(at, self.damage)


def _contents(file: IO[bytes], size: int) -> Contents:
    """What a file holds, without its chunks' data; its first eight bytes have been read."""
    found = Contents()
    at, records = len(MAGIC), FEW_RECORDS + size // MIN_RECORD
    while at + RECORD_HEAD.size <= size and records > 0:
        file.seek(at)
        start, records = at, records - 1
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        at += RECORD_HEAD.size
        if opcode == Opcode.FOOTER:
            return found
        sound = Opcode.HEADER <= opcode <= Opcode.DATA_END and at + length <= size
        if sound and opcode == Opcode.CHUNK:
            head = file.read(min(length, CHUNK_HEAD))
            sound = length == _chunk_length(head)
            if sound:
                found.chunks.append((at, length))
                found.unpacked += int.from_bytes(head[16:24], "little")  # behind two times
        elif sound and opcode in (Opcode.CHANNEL, Opcode.METADATA):
            sound = length <= MAX_RECORD and _take(opcode, file.read(length), found)
        at += length
        if not sound:
            further = _next_chunk(file, start + 1)
            if further is not None or start + RECORD_HEAD.size + length <= size:  # else it was cut off here
                found.damaged(start)
            if further is None:
                return found
            at = further
    if records == 0:
        found.damaged(at)
    return found


def _chunk_length(head: bytes) -> int:
    """Length of the content of a chunk by its own fields; 0 where they are none."""
    name = int.from_bytes(head[28:32], "little")  # length of the compression's, behind times, size and checksum
    if name > CHUNK_HEAD - 40 or len(head) < 40 + name:
        return 0
    return 40 + name + int.from_bytes(head[32 + name : 40 + name], "little")


def _next_chunk(file: IO[bytes], at: int) -> int | None:
    """Where a chunk of ours begins behind a byte, before which something is no record."""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        place, end = at + CHUNK_MARK_AT, min(at + MAX_SEARCH, len(data))
        while (place := data.find(CHUNK_MARK, place, end)) >= 0:
            start = place - CHUNK_MARK_AT
            opcode, length = RECORD_HEAD.unpack(data[start : start + RECORD_HEAD.size])
            first = start + RECORD_HEAD.size
            if opcode == Opcode.CHUNK and length == _chunk_length(data[first : first + CHUNK_HEAD]):
                return start
            place += 1
    return None


def _take(opcode: int, body: bytes, found: Contents) -> bool:
    """Add a record; False if it is none."""
    try:
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(body)))
            found.topics.setdefault(channel.id, channel.topic)
        else:
            record = Metadata.read(ReadDataStream(BytesIO(body)))
            if not _is_whole(found.metadata.get(record.name, {})):
                found.metadata[record.name] = record.metadata
    except Exception:  # whatever a parser of foreign bytes may raise
        return False
    return True


def _chunk_data(body: bytes) -> bytes | None:
    """The records of a chunk, never more than it says and than a log has; None if they are not what was written."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        data = _unpacked(chunk) if chunk.uncompressed_size <= MAX_CHUNK else b""
    except Exception:  # whatever a decompressor of foreign bytes may raise
        return None
    whole = len(data) == chunk.uncompressed_size and chunk.uncompressed_crc in (0, zlib.crc32(data))
    return data if whole else None


def _unpacked(chunk: Chunk) -> bytes:
    most = chunk.uncompressed_size + 1
    data: bytes = chunk.data
    if chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    elif chunk.compression == "zstd":
        from zstandard import ZstdDecompressor  # mcap brings it

        data = ZstdDecompressor().stream_reader(BytesIO(chunk.data)).read(most)
    return data


def _blocks(file: IO[bytes], found: Contents, layout: TickLayout) -> Iterator[tuple[int, Array]]:
    """Number of the first tick, and ticks, of each chunk that is whole and goes on behind the one before it."""
    following = 0
    for at, length in found.chunks:
        file.seek(at)
        data = _chunk_data(file.read(length)) if length <= MAX_CHUNK else None
        first, messages = (-1, []) if data is None else _ticks_in(data, found, layout.dtype.itemsize)
        if first != following:
            found.damaged(at)
        if first >= following and messages:
            yield first, np.frombuffer(b"".join(messages), dtype=layout.dtype)
            following = first + len(messages)


def _ticks_in(data: bytes, found: Contents, size: int) -> tuple[int, list[bytes]]:
    """Number of the first tick in a chunk, and the messages of its ticks; -1 where they do not follow each other."""
    out: list[bytes] = []
    at, others, first = 0, FEW_RECORDS, 0
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        at, start = at + RECORD_HEAD.size + length, at + RECORD_HEAD.size
        channel = int.from_bytes(data[start : start + 2], "little")
        if opcode == Opcode.MESSAGE and found.topics.get(channel, "" if found.topics else TICKS) == TICKS:
            number = int.from_bytes(data[start + 2 : start + 6], "little")
            first = first if out else number
            if length != MESSAGE_HEAD + size or at > len(data) or number != first + len(out):
                return -1, []
            out.append(data[start + MESSAGE_HEAD : at])
            continue
        others -= 1
        if others < 0 or (opcode == Opcode.CHANNEL and not _take(opcode, data[start:at], found)):
            return -1, []
    return first, out


def _is_whole(record: Mapping[str, str]) -> bool:
    return f"{zlib.crc32(record.get('json', '').encode()):08x}" == record.get("crc32")


def _unsealed(record: Mapping[str, str]) -> Any:
    """The values of a JSON text with its checksum, with texts that may be shown on a terminal."""
    text = record.get("json", "")
    if not _is_whole(record):
        raise ValueError("the checksum is another")
    if sum(map(text.count, ",[{")) > MAX_VALUES:
        raise ValueError(f"its description has more than {MAX_VALUES} values")
    return _shown(json.loads(text))


def _shown(values: Any, *, lines: bool = False) -> Any:
    if isinstance(values, dict):
        return {printable(key): _shown(value, lines=key == "text") for key, value in values.items()}
    if isinstance(values, list):
        return [_shown(value) for value in values]
    return printable(values, lines=lines) if isinstance(values, str) else values


def _sample_class(header: Header) -> type[Sample]:
    """The class of the reference, among those that are known here; a file never makes us import anything."""
    from taut import laws, trajectories

    for door in (laws, trajectories):  # so that all of ours are known
        for name in door.__all__:
            getattr(door, name)
    n = len(header.joint_names)
    kinds = [_kind(part.kind, header.fields, part.joints or n, f"{part.name}_") for part in header.parts]
    if header.reference == "PhaseSample":
        made: type[Sample] = phase_sample(tuple(kinds))
    elif header.parts:
        parts = zip(header.parts, kinds, strict=True)
        made = together_kind(tuple((part.name, kind, part.joints) for part, kind in parts))
    else:
        made = _kind(header.reference, header.fields, n)
    if made.fields(n) != header.fields:
        raise ValueError(f"its reference has other fields than a {made.__name__[:100]} of {n} joints")
    return made


def _kind(name: str, fields: Mapping[str, Shape], n: int, prefix: str = "") -> type[Sample]:
    """The class of that name with these fields, as a part has them under its prefix."""
    named = [kind for kind in _subclasses(Sample) if kind.__name__ == name]
    for kind in reversed(named):  # a dataclass with slots leaves its first draft behind, which came before it
        if all(fields.get(prefix + field) == shape for field, shape in kind.fields(n).items()):
            return kind
    raise ValueError(
        f"its reference of type '{name[:100]}' is not known here; import the module that defines it first"
    )


def _subclasses(kind: type[Any]) -> Iterator[type[Sample]]:
    for child in kind.__subclasses__():
        yield child
        yield from _subclasses(child)


def _outcome(found: Contents, t: Array, begin: int) -> Outcome:
    """How the run ended, as far as the file says; `begin` is the number of its first tick."""
    last = begin + len(t) - 1
    end = f"t = {t[-1]:.6g} s (tick {last})" if len(t) else "the start"
    damaged = "" if found.damage is None else f"; the file is damaged at byte {found.damage}"
    behind = f"; it begins at tick {begin}, behind a damage" if begin else ""
    try:
        ending = restored(Ending, _unsealed(found.metadata["taut.outcome"]), "outcome")
    except (LookupError, ValueError, ArithmeticError, RecursionError) as cause:
        damaged = damaged if isinstance(cause, LookupError) else "; its outcome is damaged"
        message = f"the log ends at {end} without an outcome: its writer was stopped, or the file was cut off"
        return Outcome(kind="stopped", message=f"{message}{damaged}{behind}", tick=max(0, len(t) - 1))
    outcome, ticks = ending.outcome, ending.ticks
    if len(t) == ticks:
        missing = f"{damaged}, but no tick is missing" if damaged else ""
        return replace(outcome, message=f"{outcome.message}{missing}")
    missing = f": {ticks - last - 1} of {ticks} ticks are missing, those after {end}" if last + 1 < ticks else ""
    damaged = f"{damaged or '; the file is damaged'}{missing}{behind}"
    return replace(outcome, kind="stopped", message=f"{outcome.message}{damaged}", tick=max(0, len(t) - 1))
