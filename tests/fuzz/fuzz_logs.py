"""Logs whose parts are not those that a run would give, with good checksums."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

import taut
from taut.record.log.reading import MAGIC
from taut.record.log.writing import CHUNK_BYTES, TICKS, Ending, Header, TickLayout, sealed
from taut.record.plain import plain


def write_log(
    run: taut.Run,
    path: Path,
    change: Callable[[dict[str, Any]], Any] = lambda values: None,
    ended: Callable[[dict[str, Any]], Any] = lambda values: None,
) -> Path:
    """The log of a run, with its description and its outcome changed in place, or replaced by what is returned."""
    header = Header.of(run)
    layout, values = TickLayout(header), plain(header)
    ending = plain(Ending(outcome=run.outcome, ticks=len(run)))
    changed, end = change(values), ended(ending)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        writer.start()
        writer.add_metadata("taut.run", sealed(json.dumps(values if changed is None else changed)))
        schema = writer.register_schema("taut/msg/Tick", "ros2msg", layout.schema().encode())
        channel = writer.register_channel(TICKS, "cdr", schema)
        for k, row in enumerate(layout.rows(run.arrays())):
            writer.add_message(channel, k, row.tobytes(), k, k)
        writer.add_metadata("taut.outcome", sealed(json.dumps(ending if end is None else end)))
        writer.finish()
    return path


def record(opcode: int, body: bytes) -> bytes:
    """One record of an MCAP file."""
    return struct.pack("<BQ", opcode, len(body)) + body


def chunk(data: bytes, size: int | None = None, compression: bytes = b"lz4") -> bytes:
    """A chunk of records, compressed."""
    import lz4.frame

    packed = lz4.frame.compress(data) if compression == b"lz4" else data
    head = struct.pack("<QQQI", 0, 0, len(data) if size is None else size, zlib.crc32(data))
    name = struct.pack("<I", len(compression)) + compression
    return record(6, head + name + struct.pack("<Q", len(packed)) + packed)


def with_chunks(log: Path, chunks: bytes) -> Path:
    """A log with some chunks more before its own."""
    log.write_bytes(MAGIC + chunks + log.read_bytes()[len(MAGIC) :])
    return log
