"""NAME=VALUE on the command line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from taut.base.errors import UsageError

__all__ = ["named_values"]


def named_values(
    texts: Sequence[str], option: str, example: str, *, of: str = "name", words: bool = False
) -> dict[str, Any]:
    """Values by name, numbers or arrays as JSON writes them.

    Args:
        texts: What was given, NAME=VALUE each.
        option: What messages call it, such as "--gain".
        example: A good one.
        of: What there is one of for each option.
        words: Whether a value may be a word.

    Raises:
        UsageError: No such form, a value that is none of these, a name that is given twice.

    Example:
        >>> named_values(["kp=100", "kd=[10, 5]"], "--gain", "kp=100")
        {'kp': 100, 'kd': [10, 5]}
    """
    out: dict[str, Any] = {}
    for text in texts:
        head, equals, rest = text.partition("=")
        name, value = head.strip(), _number(rest)
        bad = isinstance(value, (bool, dict, type(None))) or (isinstance(value, str) and not words)
        if not equals or not name or bad:
            raise UsageError(f"{option} takes NAME=VALUE such as {example}; got {text!r}", name=option.strip("-"))
        if name in out:
            raise UsageError(f"{option} must be given once for each {of}; got {name!r} twice", name=option.strip("-"))
        out[name] = value
    return out


def _number(text: str) -> Any:
    """A number or an array, else the text: no JSON, or a number with thousands of digits."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
