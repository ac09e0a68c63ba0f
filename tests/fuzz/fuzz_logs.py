"""Logs whose parts are not those that a run would give, with good checksums."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import taut
from taut.record.log.container import MAGIC, McapWriter
from taut.record.log.description import described, sealed
from taut.record.log.messages import Description, TickLayout, columns_of


def write_log(
    run: taut.Run,
    path: Path,
    change: Callable[[dict[str, Any]], Any] = lambda values: None,
    ended: Callable[[dict[str, Any]], Any] = lambda values: None,
) -> Path:
    """The log of a run, with its description and its outcome changed in place, or replaced by what is returned."""
    layout = TickLayout(Description.of(run))
    values = json.loads(sealed(described(run, layout.description))["json"])
    outcome = {**run.outcome.json(), "ticks": len(run)}
    changed, end = change(values), ended(outcome)
    rows = np.tile(layout.template, len(run)).view(layout.dtype)
    times = np.round(run.t * 1e9).astype(np.uint64)
    layout.fill(rows, columns_of(run), 0, times)
    with path.open("wb") as file:
        writer = McapWriter(file, layout, 1000.0)
        writer.metadata("taut.run", sealed(values if changed is None else changed))
        writer.write(rows, times)
        writer.metadata("taut.outcome", sealed(outcome if end is None else end))
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
