"""A command: its name, its help, the arguments that it declares and the function that runs it."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from taut.base.checks import readable_file
from taut.base.errors import FileError, TautError, UsageError, unknown_name

if TYPE_CHECKING:
    from taut.control.law import Law
    from taut.scenarios.scenario import Scenario

DONE, FAILED, WRONG = 0, 1, 2
STATUS: Final = """exit status:
  0  done
  1  the run failed, or missed a pass criterion
  2  the request was wrong
"""
NOT_FINITE: Final = re.compile(r"\s*[+-]?(nan|inf|infinity)\s*", re.IGNORECASE)
Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Answer of a command: text for people, data for `--json`, the exit status, and remarks on standard error."""

    text: str
    data: Any
    status: int = DONE
    remarks: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command of `taut`."""

    name: str
    help: str
    run: Callable[[argparse.Namespace, Say], Answer]  # the second argument takes lines of progress
    arguments: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # as of `add_argument`
    more: str = STATUS  # below its help: examples and exit statuses


class ByName(argparse.Action):
    """NAME=VALUE, once for each name; a value is a number or an array as JSON writes them, or a word."""

    def __call__(self, parser: object, namespace: argparse.Namespace, values: Any, option: object = None) -> None:  # noqa: ARG002
        found = dict(getattr(namespace, self.dest) or {})
        for text in [values] if isinstance(values, str) else values:
            head, equals, rest = text.partition("=")
            name, value = head.strip(), _value(rest)
            if not equals or not name or isinstance(value, (dict, type(None))):
                raise argparse.ArgumentError(self, f"takes NAME=VALUE such as kp=100 or kp=[100,50]; got {text!r}")
            if name in found:
                raise argparse.ArgumentError(self, f"must be given once for each name; got {name!r} twice")
            found[name] = value
        setattr(namespace, self.dest, found)


def _value(text: str) -> Any:
    """A number or an array, else the text. NaN and infinity are numbers: what refuses them names the parameter."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return float(text) if NOT_FINITE.fullmatch(text) else text


def numbers(text: str) -> float | list[float]:
    """A number, or numbers with commas between them, in brackets or not."""
    inside = text.strip().removeprefix("[").removesuffix("]")
    try:
        flat = [float(value) for value in inside.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be a number, or numbers with commas between them, such as 800,30; got {text!r}"
        ) from None
    return flat[0] if len(flat) == 1 else flat


GAIN: Final[Mapping[str, Any]] = {
    "action": ByName,
    "metavar": "NAME=VALUE",
    "help": "a gain of your own law, such as kp=100 or kp=[100,50]; once for each gain",
}


def load_law(place: str, gains: Mapping[str, Any] | None) -> Law:
    """The law of `FILE.py:CLASS`, made with these gains. Raises UsageError, FileError or UnknownNameError."""
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
    with _blamed(f"law '{name}' of '{file}' cannot be made", str(file)):
        return own[name](**(gains or {}))


OF_SCENARIO: Final[Mapping[str, Mapping[str, Any]]] = {
    "--set": {
        "action": ByName,
        "metavar": "NAME=VALUE",
        "help": "another value of a key, by its path in the file, or of a parameter: law.kp=5; once for each",
    },
    "--law": {
        "metavar": "FILE.py:CLASS",
        "help": "a law of your own instead of the scenario's laws, which all run without it; their pass criteria "
        "then do not count",
    },
    "--gain": GAIN,
}
"""Arguments of a command that runs a scenario with all its laws."""


def scenario_of(arguments: argparse.Namespace) -> Scenario:
    """The scenario of a command with --set, --law and --gain."""
    from taut.scenarios.scenario import load_scenario

    if arguments.gain and arguments.law is None:
        raise UsageError("--gain is for a law of your own: --law FILE.py:CLASS --gain kp=100")
    own = None if arguments.law is None else {arguments.law: load_law(arguments.law, arguments.gain)}
    return load_scenario(arguments.scenario, own, values=arguments.set)


def words_again(arguments: argparse.Namespace, *options: str) -> str:
    """Options as they were given, for another command line."""
    words = list[str]()
    for option in options:
        given = getattr(arguments, option) or {}
        for value in [given] if isinstance(given, str) else (f"{k}={json.dumps(x)}" for k, x in given.items()):
            words += [f"--{option}", value]
    return shlex.join(words)


@contextlib.contextmanager
def _blamed(what: str, file: str) -> Iterator[None]:
    """Errors of a user's code become a sentence, were it the end of the process; only Ctrl-C stays what it is."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as cause:
        words = cause if isinstance(cause, TautError) else f"{type(cause).__name__}: {cause}"
        raise FileError(f"{what}: {' '.join(str(words).split()).rstrip(':')}", name=file) from cause
