"""Values on the command line: NAME=VALUE, numbers that begin with a minus, and a law from a user's file."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import re
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

from taut.base.checks import readable_file
from taut.base.errors import FileError, TautError, UsageError, unknown_name

if TYPE_CHECKING:
    from taut.control.law import Law

__all__ = ["load_law", "named_values", "with_negative_values"]

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


def load_law(place: str, gains: Sequence[str]) -> Law:
    """The law of `FILE.py:CLASS`, made with gains given as `name=value`.

    Args:
        place: File and class.
        gains: Values as numbers or JSON arrays: kp=100, kd=[10, 5].

    Raises:
        UsageError: No such form, a gain that is no number or is given twice.
        FileError: The file cannot be read, fails when it is imported, or makes no law of these gains.
        UnknownNameError: The file has no such law.
    """
    from taut.control.law import Law

    path, colon, name = place.rpartition(":")
    if not colon or not path.endswith(".py") or not name.isidentifier():
        raise UsageError(f"--law takes FILE.py:CLASS; got {place!r}", name="law")
    file = readable_file("law file", path)
    module_name = f"taut_user_{file.stem}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # so that units can be read from the class's source
    with _blamed(f"law file '{file}' fails", str(file)):
        spec.loader.exec_module(module)
    found = {key: value for key, value in vars(module).items() if isinstance(value, type) and issubclass(value, Law)}
    own = {key: value for key, value in found.items() if value.__module__ == module_name}
    if name not in own:
        raise unknown_name(f"law file '{file}'", "law", name, own)
    given = named_values(gains, "--gain", "kp=100 or kp=[100,50]", of="gain", words=True)
    with _blamed(f"law '{name}' of '{file}' cannot be made", str(file)):
        return own[name](**given)


@contextlib.contextmanager
def _blamed(what: str, file: str) -> Iterator[None]:
    """What a user's code raises, were it the end of the process, becomes a sentence; only Ctrl-C stays what it is."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except TautError as cause:
        raise FileError(f"{what}: {cause}", name=file) from cause
    except BaseException as cause:
        words = " ".join(f"{type(cause).__name__}: {cause}".split()).rstrip(":")
        raise FileError(f"{what}: {words}", name=file) from cause
