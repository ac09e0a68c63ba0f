"""A law of the user's own, from a file that the user names on the command line."""

from __future__ import annotations

import contextlib
import importlib.util
import sys
from collections.abc import Iterator, Sequence

from taut.base.checks import readable_file
from taut.base.errors import FileError, TautError, UsageError, unknown_name
from taut.control.law import Law
from taut.scenarios.name_value import named_values

__all__ = ["load_law"]


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
    path, colon, name = place.rpartition(":")
    if not colon or not path.endswith(".py") or not name.isidentifier():
        raise UsageError(f"--law takes FILE.py:CLASS; got {place!r}", name="law")
    file = readable_file("law file", path)
    module_name = f"taut_user_{file.stem}"
    spec = importlib.util.spec_from_file_location(module_name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # where dataclasses look for its names
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
