"""Sums of named quantities, such as 2 V1 + V2: read from text, and written."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from taut.base.errors import UsageError, unknown_name
from taut.base.types import Float64Array

__all__ = ["and_list", "combination", "written"]

TERM: Final = re.compile(
    r"\s*([+-]?)\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)?\s*\*?\s*([A-Za-z_]\w*)\s*"
)
NOTHING: Final = 1e-12  # of the largest coefficient: not written


def combination(text: str, names: Sequence[str], owner: str, kind: str) -> Float64Array:
    """Coefficients of a sum of named quantities.

    Args:
        text: A name, or a sum with numbers before names, such as "2 V1 + V2" or "F1 - 0.5*F2".
        names: What may stand in it.
        owner: What has these names, for messages.
        kind: What they are names of, for messages.

    Raises:
        UsageError: No such sum.
        UnknownNameError: A name that is not among them.

    Example:
        >>> combination("2 V1 - F2", ["V1", "V2", "F1", "F2"], "the environment", "quantity").tolist()
        [2.0, 0.0, 0.0, -1.0]
    """
    row, place = np.zeros(len(names)), 0
    while place < len(text) or not text.strip():
        found = TERM.match(text, place)
        if found is None or (place and not found[1]):
            raise UsageError(
                f"a {kind} is a name or a sum such as '2 {names[0]} + {names[-1]}'; got {text!r}",
                name="given",
                value=text,
            )
        sign, number, name = found.groups()
        if name not in names:
            raise unknown_name(owner, kind, name, names)
        row[names.index(name)] += (-1.0 if sign == "-" else 1.0) * (1.0 if number is None else float(number))
        place = found.end()
    return row


def written(coefficients: Float64Array, names: Sequence[str], constant: float = 0.0) -> str:
    """A sum in words.

    Example:
        >>> written(np.array([2.0, 0.0, -1.0]), ["V1", "V2", "F1"], 0.5)
        '2 V1 - F1 + 0.5'
    """
    least = NOTHING * max(float(np.abs(coefficients).max(initial=0.0)), 1e-300)
    terms = [(c, name) for c, name in zip(coefficients, names, strict=True) if abs(c) > least]
    alone = not constant and len(terms) == 1 and terms[0][0] > 0.0
    text = ""
    for c, name in terms:
        size = f"{abs(c):.6g}"
        whole = f"({name})" if " " in name and not (alone and size == "1") else name
        term = whole if size == "1" else f"{size} {whole}"
        text += (f" {'-' if c < 0.0 else '+'} " if text else "-" if c < 0.0 else "") + term
    if constant or not text:
        size = f"{abs(constant):.6g}"
        text += (f" {'-' if constant < 0.0 else '+'} " if text else "-" if constant < 0.0 else "") + size
    return text


def and_list(words: Sequence[str]) -> str:
    """Words joined by commas and an "and"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
