"""The JSON texts of a log: what the run is, and how it ended, each with a checksum; and whether its info is right."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias, get_args

import numpy as np

from taut.arm.description import Arm
from taut.arm.rules import indefinite
from taut.base.errors import UsageError, printable
from taut.base.types import Float64Array
from taut.control.tasks.task import ENDED
from taut.control.trajectories.compound import PhaseSample
from taut.record.film.surroundings import Around
from taut.record.info import (
    AROUND,
    DYNAMICS,
    IMPEDANCE,
    LIMITS,
    OPTIONS,
    PARTS,
    PHASES,
    SCENARIO,
    TOOL,
    VERSIONS,
    arm_from_json,
)
from taut.record.log.messages import PLACE, Description
from taut.record.outcome import Kind, Outcome
from taut.record.run import Run

__all__ = ["described", "description_from", "outcome_from", "sealed", "unsealed", "wrong_entry"]

Check: TypeAlias = Callable[[Any], bool]

FORMAT: Final = 1
UNITS: Final = ("rad", "m")
MAX_VALUES: Final = 1_000_000  # of a description; the text of a scenario has half as many letters
MAX_COLUMNS: Final = 2000
MAX_LETTERS: Final = 10_000_000  # of the names of joints in all messages of a tick
MAX_AXES: Final = 8
MAX_SIZE: Final = 2**31  # of an axis

COLUMNS: Final[Mapping[str, tuple[int, ...]]] = {"F_ext": (6,), "phase": (), "phase_ended": ()}
PAYLOAD: Final[Mapping[str, tuple[int, ...]]] = {"mass": (), "com": (3,), "inertia": (6,)}
LARGEST: Final = 1e12  # of a length, mass or gain, in SI units
ROTATION: Final = 1e-6  # how far R R^T may be from 1


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


# -------------------------------------------------------------------- the entries of run.info


def wrong_entry(run: Run) -> str | None:
    """The first entry of a run's info, or further column, that is not what `taut.run` records; None if all are."""
    for name, shape in COLUMNS.items():
        if name in run.extra and run.extra[name].shape[1:] != shape:
            return name
    for name, check in _entries(run).items():
        try:
            if name in run.info and not check(run.info[name]):
                return name
        except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError):
            return name
    return None


def _entries(run: Run) -> dict[str, Check]:
    values = _each_value(_array)
    return {
        "rate": lambda value: _array(value, ()) and 0.0 < value < math.inf,
        "duration": lambda value: _array(value, ()),
        "seed": lambda value: type(value) is int and value >= 0,
        "law": _text,
        "arm": _text,
        "plant": _text,
        "parameters": lambda value: values(value) and _payload(value),
        "events": lambda value: (
            type(value) is list and all(_array(e["t"], ()) and values(e["set"]) and _payload(e["set"]) for e in value)
        ),
        LIMITS: _each_value(_each_value(lambda value: _array(value, ()))),
        VERSIONS: _each_value(_text),
        SCENARIO: lambda value: not value or all(_text(value[key]) for key in ("name", "law", "case", "text")),
        DYNAMICS: lambda value: _dynamics(value, run.n),
        OPTIONS: _options,
        "stability": _stability,
        AROUND: lambda value: bool(Around.of_json(value)),
        PARTS: _each_value(lambda value: _of_law(value, len(value["joints"])) and _joints(value["joints"], run)),
        PHASES: lambda value: _phases(value, run),
        TOOL: lambda value: _chain(value, run.n),
        IMPEDANCE: _impedance,
    }


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _each_value(check: Check) -> Check:
    return lambda value: isinstance(value, dict) and all(map(check, value.values()))


def _array(value: Any, shape: tuple[int, ...] | None = None, *, finite: bool = False) -> bool:
    """Numbers in a rectangular array, of a shape where one is given."""
    array = np.asarray(value)
    fits = array.dtype.kind in "iuf" and (shape is None or array.shape == shape)
    return fits and (not finite or bool((np.abs(array) < LARGEST).all()))


def _rotation(value: Any) -> bool:
    if not _array(value, (3, 3), finite=True):
        return False
    R: Float64Array = np.asarray(value, dtype=np.float64)
    return bool(np.abs(R @ R.T - np.eye(3)).max() < ROTATION and np.linalg.det(R) > 0.0)


def _place(value: Mapping[str, Any], R: str = "R", p: str = "p") -> bool:
    return _rotation(value[R]) and _array(value[p], (3,), finite=True)


def _chain(value: Mapping[str, Any], n: int) -> bool:
    links = all(
        type(link["joint"]) is int and 0 <= link["joint"] < n and type(link["prismatic"]) is bool and _place(link)
        for link in value["links"]
    )
    return links and _text(value["frame"]) and value["n"] == n and _place(value) and _place(value, "R_WB", "p_WB")


def _impedance(value: Mapping[str, Any]) -> bool:
    square = all(_array(value[name], (6, 6), finite=True) for name in ("D", "B", "K"))
    return square and bool(np.linalg.eigvalsh(value["D"])[0] > 0.0)


def _of_law(value: Mapping[str, Any], n: int) -> bool:
    return _chain(value[TOOL], n) and (IMPEDANCE not in value or _impedance(value[IMPEDANCE]))


def _joints(names: Any, run: Run) -> bool:
    return bool(names) and all(name in run.joint_names for name in names) and len(set(names)) == len(names)


def _payload(value: Mapping[str, Any]) -> bool:
    paths = ((f"model.payload.{name}", shape) for name, shape in PAYLOAD.items())
    return all(path not in value or _array(value[path], shape, finite=True) for path, shape in paths)


def _dynamics(value: Mapping[str, Any], n: int) -> bool:
    arms = [arm_from_json(value[name]) for name in ("controller", "plant")]
    return all(arm is not None and arm.n == n and _possible(arm) for arm in arms)


def _possible(arm: Arm) -> bool:
    """Bodies whose mass matrix is positive definite."""
    numbers = [np.r_[body.mass, body.com, body.inertia.ravel()] for body in arm.bodies]
    return _array(numbers, finite=True) and indefinite(arm) is None


def _options(value: Mapping[str, Any]) -> bool:
    others, options = value["others"], value["options"]
    return (others is None or all(map(_text, others))) and (options is None or isinstance(options, dict))


def _stability(value: Mapping[str, Any]) -> bool:
    return value["stable"] in (None, True, False) and _text(value["message"])


def _phases(value: Mapping[str, Any], run: Run) -> bool:
    followed: set[str | None] | None = None
    if isinstance(run.reference, PhaseSample):
        followed = {None, *(part.name for part in run.reference.parts)}
    phases = all(
        _of_law(phase, run.n) and (followed is None or phase["follows"] in followed) for phase in value.values()
    )
    codes = set(np.unique(run.extra["phase"]).tolist()), set(np.unique(run.extra["phase_ended"]).tolist())
    return phases and codes[0] <= set(range(len(value) + 1)) and codes[1] <= {0, *ENDED}
