"""Writing an MCAP file whose chunks come ready as arrays of bytes.

The records are those of the `mcap` package; only what stands between ticks and chunks is our own, because a Python
call per message would take minutes where this takes seconds.

References:
    MCAP format specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import IO, Final

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from taut import __version__
from taut.base.types import Array
from taut.record.log.cdr import SCHEMAS
from taut.record.log.topics import TickLayout

__all__ = ["MAGIC", "McapWriter"]

MAGIC: Final = b"\x89MCAP0\r\n"
COMPRESSION: Final = b"lz4"
CHUNK_BYTES: Final = 64 * 1024
CHUNK_SECONDS: Final = 0.1
LEAST_TICKS: Final = 16  # of a chunk, however many joints there are
_CHUNK: Final = struct.Struct("<BQ QQQI I3s Q")
_INDEX_HEAD: Final = struct.Struct("<BQ QQQQ I")


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
        self._chunks: list[tuple[int, int, int, int, int, int, int]] = []  # see _chunk
        self._metadata: list[MetadataIndex] = []
        self._ticks = 0
        self._span: tuple[int, int] | None = None  # first and last stamp [ns]
        most = min(CHUNK_BYTES // layout.size, round(CHUNK_SECONDS * rate))
        self._step = max(LEAST_TICKS, most)
        self._index = self._index_template(self._step)
        self._put(MAGIC + _records(Header(profile="ros2", library=f"taut {__version__}"), *self._declarations()))

    def _declarations(self) -> list[McapRecord]:
        """Schemas and channels."""
        used = dict.fromkeys(topic.schema for topic in self._layout.topics)
        ids = {name: i for i, name in enumerate(used, start=1)}
        schemas = [
            Schema(id=i, name=name, encoding="ros2msg", data=SCHEMAS[name].encode()) for name, i in ids.items()
        ]
        channels = [
            Channel(id=i, topic=topic.name, message_encoding="cdr", metadata={}, schema_id=ids[topic.schema])
            for i, topic in enumerate(self._layout.topics, start=1)
        ]
        return [*schemas, *channels]

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
        if len(times):
            self._span = (self._span[0] if self._span else int(times[0]), int(times[-1]))
        self._ticks += len(rows)
        self._put(b"".join(out))

    def _chunk(self, data: bytes, times: Array, at: int) -> list[bytes]:
        """A chunk of ticks that starts at byte `at` of the file, and the index of its messages."""
        packed = self._compress(data)
        first, last = int(times[0]), int(times[-1])
        length = _CHUNK.size - 9 + len(packed)
        head = _CHUNK.pack(
            Opcode.CHUNK, length, first, last, len(data), zlib.crc32(data), len(COMPRESSION), COMPRESSION, len(packed)
        )
        index = self._index if len(times) == self._step else self._index_template(len(times))
        index["entries"]["time"] = times
        self._chunks.append((first, last, at, 9 + length, len(times), len(packed), len(data)))
        return [head, packed, index.tobytes()]

    def _index_template(self, ticks: int) -> Array:
        """The message index of a chunk: one record per channel, complete but for the stamps."""
        entry = np.dtype([("time", "<u8"), ("offset", "<u8")])
        record = np.dtype(
            [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("size", "<u4"), ("entries", entry, (ticks,))]
        )
        index = np.zeros(len(self._layout.topics), dtype=record)
        index["opcode"], index["length"] = Opcode.MESSAGE_INDEX, record.itemsize - 9
        index["channel"], index["size"] = np.arange(1, len(index) + 1), 16 * ticks
        starts = np.arange(ticks) * self._layout.size
        index["entries"]["offset"] = np.add.outer(self._layout.offsets, starts)
        return index

    def finish(self) -> None:
        """Close the data section and write the summary."""
        self._put(struct.pack("<BQI", Opcode.DATA_END, 4, 0))
        start = self._position
        groups = {
            Opcode.SCHEMA: _records(*(r for r in self._declarations() if isinstance(r, Schema))),
            Opcode.CHANNEL: _records(*(r for r in self._declarations() if isinstance(r, Channel))),
            Opcode.STATISTICS: _records(self._statistics()),
            Opcode.CHUNK_INDEX: b"".join(map(self._chunk_index, self._chunks)),
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
        topics = len(self._layout.topics)
        first, last = self._span or (0, 0)
        return Statistics(
            attachment_count=0,
            channel_count=topics,
            channel_message_counts=dict.fromkeys(range(1, topics + 1), self._ticks),
            chunk_count=len(self._chunks),
            message_count=self._ticks * topics,
            message_start_time=first,
            message_end_time=last,
            metadata_count=len(self._metadata),
            schema_count=len({topic.schema for topic in self._layout.topics}),
        )

    def _chunk_index(self, chunk: tuple[int, int, int, int, int, int, int]) -> bytes:
        first, last, at, length, ticks, packed, size = chunk
        one = 15 + 16 * ticks  # bytes of the message index of one channel
        channels = len(self._layout.topics)
        offsets = b"".join(struct.pack("<HQ", i + 1, at + length + i * one) for i in range(channels))
        tail = struct.pack("<QI3sQQ", one * channels, len(COMPRESSION), COMPRESSION, packed, size)
        body = len(offsets) + len(tail) + _INDEX_HEAD.size - 9
        return _INDEX_HEAD.pack(Opcode.CHUNK_INDEX, body, first, last, at, length, len(offsets)) + offsets + tail

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
