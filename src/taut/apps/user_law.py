"""A law of the user's own, from a file that the user names on the command line."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Sequence
from typing import Any

from taut.base.checks import readable_file
from taut.base.errors import FileError, TautError, UsageError, unknown_name
from taut.control.law import Law

__all__ = ["load_law"]


def load_law(place: str, gains: Sequence[str]) -> Law:
    """The law of `FILE.py:CLASS`, made with gains given as `name=value`.

    Args:
        place: File and class.
        gains: Values as numbers or JSON arrays: kp=100, kd=[10, 5].

    Raises:
        UsageError: No such form, a gain that is no number.
        FileError: The file cannot be read, or fails when it is imported.
        UnknownNameError: The file has no such law.
    """
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
    try:
        spec.loader.exec_module(module)
    except TautError:
        raise
    except Exception as cause:
        raise FileError(f"law file '{file}' fails: {type(cause).__name__}: {cause}", name=str(file)) from cause
    found = {key: value for key, value in vars(module).items() if isinstance(value, type) and issubclass(value, Law)}
    own = {key: value for key, value in found.items() if value.__module__ == module_name}
    if name not in own:
        raise unknown_name(f"law file '{file}'", "law", name, own)
    return own[name](**dict(_gain(text) for text in gains))


def _gain(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    try:
        number = json.loads(value)
    except json.JSONDecodeError:
        number = value
    if not equals or isinstance(number, (bool, dict, type(None))):
        raise UsageError(f"--gain takes NAME=VALUE such as kp=100 or kp=[100,50]; got {text!r}", name="gain")
    return name.strip(), number
