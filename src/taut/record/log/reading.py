"""Reading a log back: every array exactly, and of a cut or damaged file what comes before."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from mcap.opcode import Opcode

from taut.base.checks import readable_file
from taut.base.errors import FileError, UsageError, printable
from taut.base.paths import subtree
from taut.base.types import Array, Float64Array
from taut.control.trajectories.compound import TOGETHER, PhaseSample, phase_sample, together_kind
from taut.control.trajectories.reference import Sample
from taut.record.log.container import MAGIC, MAX_CHUNK, Contents, chunk_data, contents_of, records_in
from taut.record.log.description import description_from, outcome_from, unsealed, wrong_entry
from taut.record.log.messages import Description, TickLayout
from taut.record.outcome import Outcome
from taut.record.run import Run

__all__ = ["load_run"]

BLOCK_BYTES: Final = 4 * 1024 * 1024  # of ticks that are taken apart at a time
MAX_KINDS: Final = 64  # of a reference of several
MAX_NUMBERS: Final = 1_000_000  # in a tick
MAX_UNPACKED: Final = 128  # bytes that a byte of the file may unpack to; our own logs have 6
PACKED_MESSAGE: Final = 4  # bytes of the file that a message takes at least
FEW_MESSAGES: Final = 1_000_000  # that any file may have
FEW_BYTES: Final = 64 * 1024 * 1024  # that any file may unpack to
LONGEST: Final = 300  # letters of what a message quotes

Block = tuple[Array, dict[str, Float64Array]]  # numbers of the ticks (k,), and each column (k, ...)


def load_run(path: str | os.PathLike[str]) -> Run:
    """Read a log that `run.save` or `taut.run(..., log=)` wrote.

    Every array, the outcome and the info are exactly what was recorded, the arms (`run.arms`) among it; only what is
    drawn of an arm is not in the file. Of a file that was cut off or damaged, the ticks before that are returned, and
    the outcome says so.

    Args:
        path: A .mcap file.

    Returns:
        The run, with `run.arm` None.

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
    try:
        target = readable_file("log", path)
        with target.open("rb") as file:
            return _read(file, target)
    except FileError:
        raise
    except (OSError, ValueError) as cause:  # a name that is none, a disk that fails
        raise FileError(f"log {str(path)!r} cannot be read: {cause}", name=str(path)) from cause


def _read(file: IO[bytes], path: Path) -> Run:
    size = path.stat().st_size
    first = file.read(len(MAGIC))
    if first.startswith(b"PK") and path.suffix == ".npz":
        raise FileError(
            f"'{path}' is a NumPy archive of a run's arrays, without its settings; give the log that "
            "run.save('run.mcap') writes, or taut.run(..., log=)",
            name=str(path),
        )
    if first != MAGIC:
        raise FileError(f"log '{path}' is no MCAP file: it starts with {first!r}", name=str(path))
    found = contents_of(file, size)
    if found.unpacked > FEW_BYTES + MAX_UNPACKED * size:
        raise FileError(
            f"log '{path}' has {size} bytes and would unpack to {found.unpacked}, more than a log does",
            name=str(path),
        )
    description, info = _description(found, size, path)
    kind = _sample_class(description, path)
    columns = _columns(file, found, TickLayout(description))
    outcome = _outcome(found, columns["t"])
    run = Run(
        t=columns["t"],
        q=columns["q"],
        v=columns["v"],
        tau=columns["tau"],
        command=columns["command"],
        terms=_named(subtree(columns, "terms")),
        reference=kind.of(subtree(columns, "reference")),
        outcome=outcome,
        joint_names=tuple(map(printable, description.joint_names)),
        units=description.units,
        continuous=description.continuous,
        kind=description.kind,
        extra=_named(subtree(columns, "extra")),
        info=info,
    )
    wrong = wrong_entry(run)
    if wrong is not None:
        raise FileError(
            f"log '{path}' cannot be read: its entry '{wrong}' is not what this version of taut records",
            name=str(path),
        )
    return run


def _named(columns: Mapping[str, Float64Array]) -> dict[str, Float64Array]:
    """Columns under names that may be shown on a terminal."""
    return {printable(name): column for name, column in columns.items()}


# -------------------------------------------------------------------- what it is


def _description(found: Contents, size: int, path: Path) -> tuple[Description, dict[str, Any]]:
    record = found.metadata.get("taut.run")
    if record is not None:
        try:
            return description_from(unsealed(record), most=min(max(size, 4096), MAX_NUMBERS))
        except (ValueError, RecursionError) as cause:
            raise FileError(f"log '{path}' cannot be read: {cause}", name=str(path)) from cause
    if not found.complete:
        at = size if found.damage is None else found.damage
        raise FileError(
            f"log '{path}' is cut off or damaged before its description ends (byte {at} of {size}); "
            "nothing of the run can be read",
            name=str(path),
        )
    writer = f" by '{found.library}'" if found.library else ""
    raise FileError(
        f"log '{path}' is an MCAP file{writer}, but no run of taut: it has no record 'taut.run'", name=str(path)
    )


def _sample_class(description: Description, path: Path) -> type[Sample]:
    """The class of the reference, among those that are known here; a file never makes us import anything."""
    from taut import laws, trajectories

    for door in (laws, trajectories):  # so that all of ours are known
        for name in door.__all__:
            getattr(door, name)
    kind = _fitting(description.reference, description.fields, len(description.joint_names))
    if kind is not None:
        return kind
    raise FileError(
        f"log '{path}' has a reference of type '{description.reference[:LONGEST]}' with fields "
        f"{', '.join(description.fields)[:LONGEST]}, which is not known here; import the module that defines "
        "it first",
        name=str(path),
    )


def _fitting(name: str, fields: Mapping[str, tuple[int, ...]], n: int) -> type[Sample] | None:
    """The class of that name with those fields; those of tasks and of laws side by side are made of others."""
    words = name.partition("[")[2].removesuffix("]").split(",")
    if len(words) > min(len(fields), MAX_KINDS):  # each has a field at least
        return None
    made: type[Sample] | None = None
    if name.startswith(f"{PhaseSample.__name__}["):
        seen: Counter[str] = Counter()
        kinds = []
        for word in words:
            seen[word] += 1
            kinds.append(_named_kind(word, fields, n, f"{word}{seen[word] if seen[word] > 1 else ''}_"))
        made = phase_sample(tuple(kind for kind in kinds if kind is not None)) if None not in kinds else None
    elif name.startswith(TOGETHER):
        parts = []
        for word in words:
            part, kind, size = [*word.rsplit(":", 2), "", ""][:3]
            if size.isdecimal():
                parts.append((part, _named_kind(kind, fields, int(size), f"{part}_"), int(size)))
        found = tuple((part, kind, size) for part, kind, size in parts if kind is not None)
        made = together_kind(found) if len(found) == len(words) else None
    else:
        made = _named_kind(name, fields, n)
    return made if made is not None and made.fields(n) == fields else None


def _named_kind(name: str, fields: Mapping[str, tuple[int, ...]], n: int, prefix: str = "") -> type[Sample] | None:
    """The class of that name with most of those fields, as a part has them under its prefix, and no others."""
    named = [kind for kind in _subclasses(Sample) if kind.__name__ == name]
    fitting = [
        kind
        for kind in reversed(named)  # a dataclass with slots leaves its first draft behind, which came before it
        if all(fields.get(prefix + field) == shape for field, shape in kind.fields(n).items())
    ]
    return max(fitting, key=lambda kind: len(kind.fields(n)), default=None)


def _subclasses(kind: type[Any]) -> Iterator[type[Sample]]:
    for child in kind.__subclasses__():
        yield child
        yield from _subclasses(child)


def _outcome(found: Contents, t: Float64Array) -> Outcome:
    """How the run ended, as far as the file says."""
    end = f"t = {t[-1]:.6g} s (tick {len(t) - 1})" if len(t) else "the start"
    damaged = "" if found.damage is None else f"; the file is damaged at byte {found.damage}"
    record, ticks = found.metadata.get("taut.outcome"), len(t)
    if record is not None:
        try:
            outcome, ticks = outcome_from(unsealed(record))
        except (ValueError, RecursionError):
            record, damaged = None, "; its outcome is damaged"
    if record is None:
        message = f"the log ends at {end} without an outcome: its writer was stopped, or the file was cut off"
        return Outcome(kind="stopped", message=f"{message}{damaged}", tick=max(0, len(t) - 1))
    if not damaged and len(t) == ticks:
        return outcome
    if len(t) == ticks:
        return replace(outcome, message=f"{outcome.message}{damaged}, but no tick is missing")
    missing = f": {ticks - len(t)} of {ticks} ticks are missing, those after {end}"
    return replace(outcome, kind="stopped", message=f"{outcome.message}{damaged or '; the file is damaged'}{missing}")


# -------------------------------------------------------------------- the ticks


def _columns(file: IO[bytes], found: Contents, layout: TickLayout) -> dict[str, Float64Array]:
    """All columns, of the ticks that are whole and follow each other from the first on."""
    shapes = layout.description.shapes()
    blocks = list(_blocks(file, found, layout))
    number = np.concatenate([np.zeros(0, dtype=np.uint32), *(ticks for ticks, _ in blocks)])
    wrong = np.flatnonzero(number != np.arange(len(number)))
    if wrong.size and found.damage is None:
        found.damage = found.chunks[0][0]
    whole = int(wrong[0]) if wrong.size else len(number)
    columns = {}
    for name, shape in shapes.items():  # one after the other, so that at most one is there twice
        parts = [block.pop(name) for _, block in blocks]
        columns[name] = np.concatenate([np.zeros((0, *shape)), *parts])[:whole]
    return columns


def _blocks(file: IO[bytes], found: Contents, layout: TickLayout) -> Iterator[Block]:
    """The ticks of all whole chunks, some megabytes at a time."""
    as_written = all(found.channels.get(i) == topic.name for i, topic in enumerate(layout.topics, start=1))
    loose = _Loose(layout, found.channels, sum(length for _, length in found.chunks))
    for chunks in _gathered(file, found):
        rows = _rows(chunks, layout) if as_written else None
        if rows is not None:
            yield rows["1.sequence"].copy(), _parts(rows, layout.description.shapes())
        else:  # another program has written the file anew
            for data in chunks:
                loose.take(data)
    yield from loose.blocks()


def _gathered(file: IO[bytes], found: Contents) -> Iterator[list[bytes]]:
    """The data of the chunks up to the first that is damaged, some megabytes at a time."""
    waiting: list[bytes] = []
    size = 0
    for at, length in found.chunks:
        file.seek(at)
        data = chunk_data(file.read(length)) if length <= MAX_CHUNK else None
        if data is None:
            found.damage = at
            break
        waiting.append(data)
        size += len(data)
        if size > BLOCK_BYTES:
            yield waiting
            waiting, size = [], 0
    yield waiting


def _rows(chunks: list[bytes], layout: TickLayout) -> Array | None:
    """The ticks of some chunks, if every chunk is made of whole ticks as we write them."""
    if any(len(data) % layout.size for data in chunks):
        return None
    rows = np.frombuffer(b"".join(chunks), dtype=layout.dtype)
    return rows if layout.fits(rows) else None


def _parts(rows: Array, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Float64Array]:
    names = set(rows.dtype.names or ())
    return {
        name: rows[name].reshape(len(rows), *shape).astype(np.float64)
        if name in names
        else np.zeros((len(rows), *shape))
        for name, shape in shapes.items()
    }


class _Loose:
    """Messages of a file whose chunks are not ours, topic by topic."""

    def __init__(self, layout: TickLayout, channels: Mapping[int, str], size: int) -> None:
        self._most = FEW_MESSAGES + size // PACKED_MESSAGE
        self._layout = layout
        self._topics = {topic.name: topic for topic in layout.topics}
        self._channels = dict(channels)
        self._found: dict[str, dict[int, bytes]] = {topic.name: {} for topic in layout.topics}

    def take(self, data: bytes) -> None:
        """The messages of a chunk, by topic and number."""
        for opcode, body in records_in(data):
            self._most -= 1
            if self._most < 0:
                raise ValueError("it has more messages than its size explains")
            if opcode == Opcode.CHANNEL and len(body) >= 8:  # declared inside the chunk
                length = int.from_bytes(body[4:8], "little")
                self._channels[int.from_bytes(body[:2], "little")] = body[8 : 8 + length].decode(errors="replace")
            if opcode != Opcode.MESSAGE or len(body) < 22:
                continue
            name = self._channels.get(int.from_bytes(body[:2], "little"), "")
            if name in self._topics and len(body) == 22 + len(self._topics[name].message.data):
                self._found[name][int.from_bytes(body[2:6], "little")] = body[22:]

    def blocks(self) -> Iterator[Block]:
        """The ticks of which every message is there."""
        common = sorted(set.intersection(*(set(messages) for messages in self._found.values())))
        if not common:
            return
        shapes = self._layout.description.shapes()
        columns: dict[str, Float64Array] = {name: np.zeros((len(common), *shape)) for name, shape in shapes.items()}
        for name, topic in self._topics.items():
            rows = np.frombuffer(b"".join(self._found[name][i] for i in common), dtype=topic.dtype)
            columns |= _parts(rows, {column: shapes[column] for column in topic.columns})
        yield np.array(common, dtype=np.uint32), columns
