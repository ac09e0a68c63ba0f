"""The MCAP file around a log: its records are those of the `mcap` package.

Only what stands between ticks and chunks is our own, because a Python call per message would take minutes where this
takes seconds, and a file that somebody else wrote may ask for any amount of memory.

References:
    MCAP format specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, Final

import numpy as np
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from taut.base.types import Array
from taut.base.version import __version__
from taut.record.log.messages import SCHEMAS, TickLayout

__all__ = ["MAGIC", "Contents", "McapWriter", "chunk_data", "contents_of", "records_in"]

MAGIC: Final = b"\x89MCAP0\r\n"
CHUNK_BYTES: Final = 64 * 1024
CHUNK_SECONDS: Final = 0.1
MIN_TICKS: Final = 16  # of a chunk, however many joints there are
HEAD: Final = struct.Struct("<BQ")  # opcode and length of a record
MAX_CHUNK: Final = 32 * 1024 * 1024  # bytes of its records
MAX_RECORD: Final = 8 * 1024 * 1024  # bytes of a record that is read whole, but for chunks
MIN_RECORD: Final = 64  # bytes; a file whose records are shorter on the whole is no log
FEW_RECORDS: Final = 10_000  # that any file may have
READ: Final[Mapping[int, type[McapRecord]]] = {
    Opcode.HEADER: Header,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}


# -------------------------------------------------------------------- writing


class McapWriter:
    """Writes one file: head, then blocks of ticks, then the end with everything a reader wants to find quickly.

    Args:
        file: Where to, unbuffered: each block is on its way to the disk when `write` returns.
        layout: How a tick looks.
        rate: Ticks per second [Hz].
    """

    def __init__(self, file: IO[bytes], layout: TickLayout, rate: float) -> None:
        from lz4.frame import compress

        self._file, self._layout, self._compress = file, layout, compress
        self._position = 0
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._ticks = 0
        self._step = max(MIN_TICKS, min(CHUNK_BYTES // layout.size, round(CHUNK_SECONDS * rate)))
        self._index = self._index_template(self._step)
        names = dict.fromkeys(topic.schema for topic in layout.topics)
        ids = {name: i for i, name in enumerate(names, start=1)}
        self._schemas = [
            Schema(id=i, name=name, encoding="ros2msg", data=SCHEMAS[name].encode()) for name, i in ids.items()
        ]
        self._channels = [
            Channel(id=i, topic=topic.name, message_encoding="cdr", metadata={}, schema_id=ids[topic.schema])
            for i, topic in enumerate(layout.topics, start=1)
        ]
        head = Header(profile="ros2", library=f"taut {__version__}")
        self._put(MAGIC + _records(head, *self._schemas, *self._channels))

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """A record of words under a name."""
        record = _records(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=self._position, length=len(record), name=name))
        self._put(record)

    def write(self, rows: Array, times: Array) -> None:
        """Ticks as the layout's structures (k,), and their stamps (k,) [ns]."""
        out: list[bytes] = []
        at = self._position
        for first in range(0, len(rows), self._step):
            records = self._chunk(rows[first : first + self._step].tobytes(), times[first : first + self._step], at)
            out += records
            at += sum(map(len, records))
        self._ticks += len(rows)
        self._put(b"".join(out))

    def _chunk(self, data: bytes, times: Array, at: int) -> tuple[bytes, bytes]:
        """A chunk of ticks that starts at byte `at` of the file, and the index of its messages."""
        packed = self._compress(data)
        first, last = int(times[0]), int(times[-1])
        chunk = _records(
            Chunk(
                compression="lz4",
                data=packed,
                message_start_time=first,
                message_end_time=last,
                uncompressed_crc=zlib.crc32(data),
                uncompressed_size=len(data),
            )
        )
        index = self._index if len(times) == self._step else self._index_template(len(times))
        index["entries"]["time"] = times
        behind = at + len(chunk)
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=at,
                chunk_length=len(chunk),
                compression="lz4",
                compressed_size=len(packed),
                uncompressed_size=len(data),
                message_start_time=first,
                message_end_time=last,
                message_index_offsets={i + 1: behind + i * index.itemsize for i in range(len(index))},
                message_index_length=index.nbytes,
            )
        )
        return chunk, index.tobytes()

    def _index_template(self, ticks: int) -> Array:
        """The message index of a chunk: one record per channel, complete but for the stamps."""
        entry = np.dtype([("time", "<u8"), ("offset", "<u8")])
        record = np.dtype(
            [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4"), ("entries", entry, (ticks,))]
        )
        index = np.zeros(len(self._layout.topics), dtype=record)
        index["opcode"], index["length"] = Opcode.MESSAGE_INDEX, record.itemsize - HEAD.size
        index["channel"], index["size"] = np.arange(1, len(index) + 1), 16 * ticks
        starts = np.arange(ticks) * self._layout.size
        index["entries"]["offset"] = np.add.outer(self._layout.offsets, starts)
        return index

    def finish(self) -> None:
        """Close the data section and write the summary."""
        self._put(_records(DataEnd(0)))
        start = self._position
        groups: dict[Opcode, bytes] = {
            Opcode.SCHEMA: _records(*self._schemas),
            Opcode.CHANNEL: _records(*self._channels),
            Opcode.STATISTICS: _records(self._statistics()),
            Opcode.CHUNK_INDEX: _records(*self._chunks),
            Opcode.METADATA_INDEX: _records(*self._metadata),
        }
        offsets, at = [], start
        for opcode, group in groups.items():
            if group:
                offsets.append(SummaryOffset(group_opcode=opcode, group_start=at, group_length=len(group)))
            at += len(group)
        summary = b"".join(groups.values()) + _records(*offsets)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, at)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        self._put(summary + _records(Footer(summary_start=start, summary_offset_start=at, summary_crc=crc)) + MAGIC)

    def _statistics(self) -> Statistics:
        topics = len(self._channels)
        return Statistics(
            attachment_count=0,
            channel_count=topics,
            channel_message_counts=dict.fromkeys(range(1, topics + 1), self._ticks),
            chunk_count=len(self._chunks),
            message_count=self._ticks * topics,
            message_start_time=self._chunks[0].message_start_time if self._chunks else 0,
            message_end_time=self._chunks[-1].message_end_time if self._chunks else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put(self, data: bytes) -> None:
        view = memoryview(data)
        while view:  # an unbuffered file may take a part only
            view = view[self._file.write(view) :]
        self._position += len(data)


def _records(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


# -------------------------------------------------------------------- reading


@dataclass
class Contents:
    """What stands in a file, up to its end or to the first damage."""

    library: str = ""
    channels: dict[int, str] = field(default_factory=dict)  # topic by number
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name; of several the first
    chunks: list[tuple[int, int]] = field(default_factory=list)  # where the record's content starts, and its length
    unpacked: int = 0  # bytes that the chunks say they have
    complete: bool = False  # whether the end is there
    damage: int | None = None  # byte at which something is no record


def contents_of(file: IO[bytes], size: int) -> Contents:
    """What a file holds, without its chunks' data, up to its end or the first damage.

    Args:
        file: The file; its first eight bytes have been looked at.
        size: Its length.
    """
    found = Contents()
    at, records = len(MAGIC), FEW_RECORDS + size // MIN_RECORD
    while at + HEAD.size <= size and not found.complete:
        file.seek(at)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        records -= 1
        if not Opcode.HEADER <= opcode <= Opcode.DATA_END or records < 0:
            found.damage = at
            break
        end = at + HEAD.size + length
        if end > size:
            break  # cut off
        if opcode == Opcode.CHUNK:
            found.chunks.append((at + HEAD.size, length))
            found.unpacked += int.from_bytes(file.read(min(length, 24))[16:], "little")  # behind two times
        elif opcode in READ and not (length <= MAX_RECORD and _take(opcode, file.read(length), found)):
            found.damage = at
            break
        found.complete = opcode == Opcode.FOOTER
        at = end
    return found


def _take(opcode: int, body: bytes, found: Contents) -> bool:
    """Add a record that is read whole; False if it is none."""
    try:
        record = READ[opcode].read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]  # each of them has it
    except Exception:  # whatever a parser of foreign bytes may raise
        return False
    if isinstance(record, Header):
        found.library = record.library
    elif isinstance(record, Channel):
        found.channels.setdefault(record.id, record.topic)
    elif isinstance(record, Metadata):
        found.metadata.setdefault(record.name, record.metadata)
    return True


def chunk_data(body: bytes) -> bytes | None:
    """The records of a chunk, never more than it says and than a log has; None if they are not what was written."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        data = _unpacked(chunk) if chunk.uncompressed_size <= MAX_CHUNK else None
    except Exception:  # whatever a decompressor of foreign bytes may raise
        return None
    whole = data is not None and len(data) == chunk.uncompressed_size
    return data if data is not None and whole and chunk.uncompressed_crc in (0, zlib.crc32(data)) else None


def _unpacked(chunk: Chunk) -> bytes:
    most = chunk.uncompressed_size + 1
    if chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        data: bytes = LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
        return data
    if chunk.compression == "zstd":
        from zstandard import ZstdDecompressor  # mcap brings it

        return ZstdDecompressor().stream_reader(BytesIO(chunk.data)).read(most)
    if chunk.compression == "":
        return chunk.data
    raise ValueError(f"unknown compression {chunk.compression!r}")


def records_in(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record of a chunk; it ends where the records do not agree."""
    at = 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        body = data[at + HEAD.size : at + HEAD.size + length]
        if len(body) < length:
            return
        yield opcode, body
        at += HEAD.size + length
