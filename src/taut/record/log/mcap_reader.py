"""Reading an MCAP file that may be cut off or damaged: what is whole is found, what is not is located.

The standard readers raise at the first thing that is wrong. This one walks from record to record, and where the walk
breaks off it looks for the next record that agrees with itself.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Header, McapRecord, Metadata

__all__ = ["Chunk", "Contents", "contents_of", "messages", "read_chunk"]

HEAD: Final = struct.Struct("<BQ")
CHUNK_HEAD: Final = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
LONGEST_NAME: Final = 4  # of a compression
LARGEST_CHUNK: Final = 32 * 1024 * 1024
LARGEST_RECORD: Final = 8 * 1024 * 1024  # of those that are read whole
SHORT_RECORD: Final = 64  # bytes; a file whose records are shorter on the whole is no log
FEW_RECORDS: Final = 10_000  # that any file may have
FARTHEST: Final = 64 * 1024 * 1024  # bytes from a damaged place that are searched for the next record
MAX_LANDMARKS: Final = 100_000  # that may turn out to be none
WINDOW: Final = 4 * 1024 * 1024  # bytes that are searched at a time
IN_CHUNKS: Final = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
PARSED: Final[Mapping[int, type[McapRecord]]] = {
    Opcode.HEADER: Header,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}
_CHUNK = rb"\x06[\x00-\xff]{36}(?:\x00\x00\x00\x00|\x03\x00\x00\x00lz4|\x04\x00\x00\x00zstd)"
_METADATA = rb"\x0c[\x00-\xff]{8}[\x08-\x0c]\x00\x00\x00taut\."
_LANDMARK: Final = re.compile(_CHUNK + rb"|" + _METADATA)
"""The start of a record that is worth finding again behind a damaged one."""


@dataclass(frozen=True)
class Chunk:
    """Where the compressed records of a chunk stand."""

    at: int
    length: int
    compression: bytes
    size: int  # uncompressed
    crc: int


@dataclass
class Contents:
    """What was found in a file."""

    library: str = ""
    channels: dict[int, str] = field(default_factory=dict)  # topic by number
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    chunks: list[Chunk] = field(default_factory=list)
    damage: list[tuple[int, int]] = field(default_factory=list)  # first byte, and the byte after the last
    complete: bool = False  # whether the end is there


def contents_of(file: IO[bytes], size: int) -> Contents:
    """What a file holds, without its chunks' data.

    Args:
        file: The file; its first eight bytes have been looked at.
        size: Its length.
    """
    found = Contents()
    at, records, search = 8, FEW_RECORDS + size // SHORT_RECORD, _Search()
    while at < size:
        if size - at <= 8 and found.complete:
            break  # the last eight bytes are the same as the first
        records -= 1
        length = _record(file, at, size, found)
        if records < 0:
            found.damage.append((at, size))
            break
        if length is None:
            again = search.next_landmark(file, at + 1, size)
            found.damage.append((at, again))
            at = again
        else:
            at += length
    return found


def _record(file: IO[bytes], at: int, size: int, found: Contents) -> int | None:
    """Length of the record at a place, after its news are added to what was found; None if it is no record."""
    file.seek(at)
    head = file.read(HEAD.size + CHUNK_HEAD.size + LONGEST_NAME + 8)
    if len(head) < HEAD.size:
        return None
    opcode, length = HEAD.unpack_from(head)
    if at + HEAD.size + length > size:
        return None
    if opcode == Opcode.CHUNK:
        chunk = _chunk(head[HEAD.size : HEAD.size + length], at + HEAD.size, length)
        if chunk is None:
            return None
        found.chunks.append(chunk)
    elif opcode == Opcode.MESSAGE_INDEX:
        if length < 6 or struct.unpack_from("<I", head, HEAD.size + 2)[0] != length - 6:
            return None
    elif opcode == Opcode.FOOTER:
        if length != 20 or at + HEAD.size + length + 8 != size:
            return None
        found.complete = True
    elif not Opcode.HEADER <= opcode <= Opcode.DATA_END:
        return None
    elif opcode in PARSED:
        file.seek(at + HEAD.size)
        if length > LARGEST_RECORD or not _parsed(opcode, file.read(length), found):
            return None
    return int(HEAD.size + length)


def _parsed(opcode: int, body: bytes, found: Contents) -> bool:
    """Add a record that is read whole; False if it does not agree with itself."""
    stream = ReadDataStream(BytesIO(body))
    try:
        record = PARSED[opcode].read(stream)  # type: ignore[attr-defined]  # each of the three has it
    except Exception:  # whatever a parser of foreign bytes may raise
        return False
    if stream.count != len(body):
        return False
    if isinstance(record, Header):
        found.library = record.library
    elif isinstance(record, Channel):
        found.channels.setdefault(record.id, record.topic)
    else:
        found.metadata.append((record.name, record.metadata))
    return True


def _chunk(head: bytes, at: int, length: int) -> Chunk | None:
    """A chunk from the first bytes of its record, if its lengths agree."""
    if len(head) < CHUNK_HEAD.size:
        return None
    _, _, size, crc, letters = CHUNK_HEAD.unpack_from(head)
    start = CHUNK_HEAD.size + letters + 8
    if letters > LONGEST_NAME or len(head) < start:
        return None
    (packed,) = struct.unpack_from("<Q", head, start - 8)
    if packed != length - start:
        return None
    return Chunk(at + start, packed, head[CHUNK_HEAD.size : start - 8], size, crc)


class _Search:
    """Looks behind damaged places for what is whole, with an end to its patience."""

    def __init__(self) -> None:
        self._left = MAX_LANDMARKS

    def next_landmark(self, file: IO[bytes], at: int, size: int) -> int:
        """Where the next chunk or metadata that agrees with itself starts; the end of the file if there is none."""
        overlap = HEAD.size + CHUNK_HEAD.size + LONGEST_NAME + 8
        end = min(size, at + FARTHEST)
        while at < end:
            file.seek(at)
            window = file.read(WINDOW)
            here = 0
            while match := _LANDMARK.search(window, here):
                start = at + match.start()
                if _record(file, start, size, Contents()) is not None:
                    return start
                here = match.start() + 1
                self._left -= 1 + (file.tell() - start) // 1000  # metadata is read whole
                if self._left < 0:
                    return size
            if at + len(window) >= size:
                break
            at += max(1, len(window) - overlap)
        return size


def read_chunk(file: IO[bytes], chunk: Chunk) -> bytes | None:
    """The records of a chunk; None if they are not what was written."""
    if chunk.size > LARGEST_CHUNK:
        return None
    file.seek(chunk.at)
    packed = file.read(chunk.length)
    try:
        data = _unpacked(packed, chunk)
    except Exception:  # whatever a decompressor of foreign bytes may raise
        return None
    if len(data) != chunk.size or (chunk.crc and zlib.crc32(data) != chunk.crc):
        return None
    return data


def _unpacked(packed: bytes, chunk: Chunk) -> bytes:
    """The data of a chunk; never more than it says."""
    if chunk.compression == b"lz4":
        from lz4.frame import LZ4FrameDecompressor

        data: bytes = LZ4FrameDecompressor().decompress(packed, max_length=chunk.size + 1)
        return data
    if chunk.compression == b"zstd":
        from zstandard import ZstdDecompressor  # mcap brings it

        return ZstdDecompressor().stream_reader(BytesIO(packed)).read(chunk.size + 1)
    if chunk.compression == b"":
        return packed
    raise ValueError(f"unknown compression {chunk.compression!r}")


def messages(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Opcode, start and body of each record of a chunk; ends where the records do not agree."""
    at = 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        if opcode not in IN_CHUNKS:
            return
        body = data[at + HEAD.size : at + HEAD.size + length]
        if len(body) < length:
            return
        yield opcode, at, body
        at += HEAD.size + length
