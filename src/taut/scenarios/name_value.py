"""Values on the command line: NAME=VALUE, and numbers that begin with a minus."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any, Final

from taut.base.errors import UsageError

__all__ = ["named_values", "with_negative_values"]

NEGATIVE: Final = re.compile(r"-(\d|\.\d|inf|nan)", re.IGNORECASE)
NOT_FINITE: Final = re.compile(r"\s*[+-]?(nan|inf|infinity)\s*", re.IGNORECASE)


def with_negative_values(words: Sequence[str]) -> list[str]:
    """Words of a command line in which a negative value is part of its option, which argparse takes for another one.

    Example:
        >>> with_negative_values(["design", "PID", "--at", "-0.3,0.8", "--rate", "500"])
        ['design', 'PID', '--at=-0.3,0.8', '--rate', '500']
    """
    out: list[str] = []
    for i, word in enumerate(words):
        option = out[-1] if out else ""
        if option == "--":
            return [*out, *words[i:]]
        if option.startswith("--") and "=" not in option and NEGATIVE.match(word):
            out[-1] = f"{option}={word}"
        else:
            out.append(word)
    return out


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
    """A number or an array, else the text: no JSON, or a number with thousands of digits.

    NaN and infinity are numbers however they are written: what takes them says by its own name that it does not.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return float(text) if NOT_FINITE.fullmatch(text) else text
