"""The JSON texts of a log: what the run is, and how it ended, each with a checksum."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from taut.base.errors import UsageError, printable
from taut.record.log.topics import PLACE, Description
from taut.record.outcome import Kind, Outcome
from taut.record.run import Run

__all__ = ["described", "description_from", "outcome_from", "sealed", "unsealed"]

FORMAT: Final = 1
UNITS: Final = ("rad", "m")
MAX_VALUES: Final = 1_000_000  # of a description; the text of a scenario has half as many letters
MAX_COLUMNS: Final = 2000
MAX_LETTERS: Final = 10_000_000  # of the names of joints in all messages of a tick
MAX_AXES: Final = 8
MAX_SIZE: Final = 2**31  # of an axis


def described(run: Run, description: Description) -> dict[str, Any]:
    """What load_run needs, as plain values."""
    return {
        "format": FORMAT,
        "joint_names": list(description.joint_names),
        "units": list(description.units),
        "continuous": list(description.continuous),
        "kind": description.kind,
        "terms": list(description.terms),
        "reference": {"class": description.reference, "fields": _lists(description.fields)},
        "extra": _lists(description.extra),
        "info": run.info,
    }


def _lists(shapes: Mapping[str, tuple[int, ...]]) -> dict[str, list[int]]:
    return {name: list(shape) for name, shape in shapes.items()}


def sealed(values: Mapping[str, Any]) -> dict[str, str]:
    """Plain values as a JSON text and its checksum.

    Raises:
        UsageError: Something in them is no plain value.
    """
    text = json.dumps(values, default=_plain, ensure_ascii=True, separators=(",", ":"))
    return {"json": text, "crc32": f"{zlib.crc32(text.encode()):08x}"}


def _plain(value: object) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise UsageError(
        f"run.info must hold plain values (numbers, words, lists, dicts) to be saved; got {type(value).__name__}",
        name="info",
        value=value,
    )


def unsealed(record: Mapping[str, str]) -> Any:
    """The inverse of `sealed`.

    Raises:
        ValueError: The text is not what was written.
    """
    text = record.get("json", "")
    if f"{zlib.crc32(text.encode()):08x}" != record.get("crc32"):
        raise ValueError("the checksum is another")
    if sum(map(text.count, ",[{")) > MAX_VALUES:
        raise ValueError(f"its description has more than {MAX_VALUES} values")
    return json.loads(text)


def _shown(values: Any) -> Any:
    """Plain values whose texts may be shown on a terminal, tabs and line breaks as they are."""
    if isinstance(values, dict):
        return {printable(key): _shown(value) for key, value in values.items()}
    if isinstance(values, list):
        return [_shown(value) for value in values]
    return printable(values, lines=True) if isinstance(values, str) else values


def description_from(values: Any, most: int) -> tuple[Description, dict[str, Any]]:
    """The description and the info of a run.

    Args:
        values: What `described` gave.
        most: More numbers than this in one tick are refused: the file has no room for them.

    Raises:
        ValueError: It is not what `described` gives; the text says what.
    """
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        got = values.get("format") if isinstance(values, dict) else values
        raise ValueError(f"it has format {got!r}, and this version of taut reads format {FORMAT}")
    try:
        reference = values["reference"]
        description = Description(
            joint_names=_words(values["joint_names"]),
            units=_words(values["units"]),
            continuous=tuple(_indices(values["continuous"])),
            kind=str(values["kind"]),
            terms=_words(values["terms"]),
            reference=str(reference["class"]),
            fields=_shapes(reference["fields"]),
            extra=_shapes(values["extra"]),
        )
        info = dict(_shown(values["info"]))
        columns = len(description.terms) + len(description.fields) + len(description.extra)
        letters = sum(map(len, description.joint_names)) * (3 + len(description.terms))
    except (LookupError, TypeError, ValueError, AttributeError) as cause:
        raise ValueError(f"its description lacks {cause}") from cause
    if columns > MAX_COLUMNS or letters > MAX_LETTERS:
        raise ValueError(f"it has {columns} columns of numbers, or names of {letters} letters in a tick")
    n = len(description.joint_names)
    numbers = sum(int(np.prod(shape, dtype=object)) for shape in description.shapes().values())
    fitting = len(description.units) == n and all(i < n for i in description.continuous)
    different = all(len(set(names)) == len(names) for names in (description.joint_names, description.terms))
    if not n or not fitting or not different or numbers > most or description.kind not in PLACE:
        raise ValueError("its description does not fit its joints")
    if any(unit not in UNITS for unit in description.units):
        raise ValueError(f"its units are {', '.join(description.units)}, not rad or m")
    return description, info


def _words(values: Any) -> tuple[str, ...]:
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise TypeError("a list of names")
    return tuple(values)


def _indices(values: Any) -> list[int]:
    if not isinstance(values, list) or not all(type(value) is int and value >= 0 for value in values):
        raise TypeError("a list of whole numbers")
    return values


def _shapes(values: Any) -> dict[str, tuple[int, ...]]:
    if any(len(_indices(shape)) > MAX_AXES or any(size > MAX_SIZE for size in shape) for shape in values.values()):
        raise TypeError(f"shapes of at most {MAX_AXES} axes")
    return {name: tuple(shape) for name, shape in values.items()}


def outcome_from(values: Any) -> tuple[Outcome, int]:
    """How a run ended, and how many ticks were written.

    Raises:
        ValueError: It is not what was written.
    """
    try:
        values = _shown(values)
        outcome = Outcome(
            kind=values["kind"],
            message=values["message"],
            tick=values["tick"],
            joint=values["joint"],
            dropped=values.get("dropped", 0),
        )
        texts = all(isinstance(text, str) for text in (outcome.message, outcome.joint or ""))
        if not texts or outcome.kind not in get_args(Kind):
            raise TypeError("its words")
        _indices([outcome.tick, values["ticks"]])
        if isinstance(outcome.dropped, bool) or not isinstance(outcome.dropped, int) or outcome.dropped < 0:
            raise TypeError("its count of dropped ticks")
        return outcome, values["ticks"]
    except (KeyError, TypeError) as cause:
        raise ValueError(f"its outcome lacks {cause}") from cause
