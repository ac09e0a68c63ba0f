"""Tables of samples: times that increase, and CSV files of them."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from taut.base.checks import finite_array, readable_file
from taut.base.errors import FileError, RangeError, ShapeError
from taut.base.types import ArrayLike, Float64Array

__all__ = ["read_rows", "require_moderate", "sample_times"]


LEAST_GAP: Final = 1e-12  # [s] between two samples
LARGEST: Final = 1e30  # of a number in a table, whose rates and their squares are taken
MAX_BYTES: Final = 32 * 2**20  # half a million samples of an arm
LONGEST: Final = 300  # letters of what a message quotes


def sample_times(times: ArrayLike) -> Float64Array:
    """(k,) times [s], one at least, increasing.

    Raises:
        ShapeError: No vector, or an empty one.
        RangeError: They do not increase.
    """
    t = finite_array("times", times, unit="s")
    if t.ndim != 1 or not t.size:
        raise ShapeError(f"times must be a vector (k,); got shape {t.shape}", name="times")
    require_moderate("times", t)
    wrong = np.diff(t) < LEAST_GAP
    if wrong.any():
        k = int(np.argmax(wrong))
        slowly = f", by less than {LEAST_GAP:g} s" if t[k + 1] > t[k] else ""
        raise RangeError(
            f"times must increase; times[{k + 1}] = {t[k + 1]:g} follows {t[k]:g}{slowly}",
            name="times",
            rule="increasing",
        )
    return t


def require_moderate(name: str, values: Float64Array) -> None:
    """Numbers of a table whose rates are finite.

    Raises:
        RangeError: One that is beyond any time or place.
    """
    if values.size and np.abs(values).max() > LARGEST:
        raise RangeError(f"{name} must be within +-{LARGEST:g}; got {np.abs(values).max():g}", name=name)


def read_rows(
    path: str | os.PathLike[str], example: str, columns: Callable[[Sequence[str]], Sequence[str]]
) -> tuple[list[str], Float64Array]:
    """Header and numbers (rows, columns) of a CSV file whose first column is t.

    Args:
        path: The file.
        example: The columns, as a message names them.
        columns: From the header, what it should be.

    Raises:
        FileError: No such file, no header, a column or a number that does not fit.
    """
    file = readable_file("CSV file", path)
    if file.stat().st_size > MAX_BYTES:
        raise FileError(
            f"CSV file '{file}' is larger than {MAX_BYTES // 2**20} MB, the most that is read; give longer tables as "
            "arrays: taut.trajectories.Samples(...)",
            name=str(file),
        )
    with file.open(encoding="utf-8-sig", errors="replace") as lines:
        header = [word.strip() for word in lines.readline().split(",")]
        if header[0] != "t":
            raise FileError(
                f"{file}: the first line must name the columns {example}; got {_shown(str(header))}", name=str(file)
            )
        expected = list(columns(header))
        if header != expected:
            raise FileError(
                f"{file}: the columns must be {_shown(', '.join(expected))}; got {_shown(', '.join(header))}",
                name=str(file),
            )
        numbers = array("d")  # a list of lists would be five times as large
        for number, line in enumerate(lines, start=2):
            if not line.strip():
                continue
            try:
                row = [float(word) for word in line.split(",")]
            except ValueError as cause:
                text = f"{file}, line {number}: not a number: {_shown(str(cause))}"
                raise FileError(text, name=str(file)) from cause
            if len(row) != len(header):
                raise FileError(
                    f"{file}, line {number}: {len(header)} numbers are needed; got {len(row)}", name=str(file)
                )
            numbers.extend(row)
    if not numbers:
        raise FileError(f"{file}: there are no samples below the header", name=str(file))
    return header, np.array(numbers).reshape(-1, len(header))


def _shown(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
