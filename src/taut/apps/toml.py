"""Reading a TOML file key by key, with sentences that name file, section, key and way out."""

from __future__ import annotations

import contextlib
import difflib
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from taut.base.checks import readable_file
from taut.base.errors import ScenarioError, TautError, quoted_list

__all__ = ["REQUIRED", "Section", "read_toml"]

REQUIRED: Final = object()
MOST_BYTES: Final = 1_000_000


def read_toml(path: Path, label: str = "") -> Section:
    """The root section of a file.

    Args:
        path: The file.
        label: What messages call it; its path if left out.

    Raises:
        FileError: It cannot be read.
        ScenarioError: It is no TOML.
    """
    file = readable_file("scenario", path)
    if file.stat().st_size > MOST_BYTES:
        raise ScenarioError(f"scenario '{file}' is larger than {MOST_BYTES} bytes; a scenario is a page of text")
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except UnicodeDecodeError as cause:
        raise ScenarioError(f"scenario '{file}' is no UTF-8 text ({cause.reason} at byte {cause.start})") from cause
    except (tomllib.TOMLDecodeError, RecursionError) as cause:
        raise ScenarioError(f"scenario '{file}' is no valid TOML: {cause}") from cause
    return Section(label or str(file), "", table)


class Section:
    """One table of a file. Keys are taken one by one; what is left at the end is refused."""

    def __init__(self, file: str, name: str, table: Mapping[str, Any]) -> None:
        self._file = file
        self._name = name
        self._table = dict(table)
        self._known: list[str] = []

    @property
    def where(self) -> str:
        """File and section, as messages begin with."""
        return f"{self._file}: [{self._name}]" if self._name else self._file

    def error(self, text: str) -> ScenarioError:
        """An error about this section."""
        return ScenarioError(f"{self.where} {text}")

    @contextlib.contextmanager
    def blamed(self) -> Iterator[None]:
        """Errors of what is made from this section name it."""
        try:
            yield
        except ScenarioError:
            raise
        except TautError as cause:
            raise self.error(f"{cause}") from cause

    # ---------------------------------------------------------------- values

    def __contains__(self, key: str) -> bool:
        return key in self._table

    def take(self, key: str, default: Any = REQUIRED) -> Any:
        """The value of a key, whatever it is."""
        self._known.append(key)
        if key in self._table:
            return self._table.pop(key)
        if default is REQUIRED:
            raise self.error(f"needs the key '{key}'")
        return default

    def _typed(self, key: str, default: Any, kinds: tuple[type, ...], rule: str) -> Any:
        value = self.take(key, default)
        if value is default:
            return value
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise self.error(f"{key} must be {rule}; got {value!r}")
        return value

    def number(self, key: str, default: Any = REQUIRED) -> Any:
        """A finite number."""
        value = self._typed(key, default, (int, float), "a number")
        if value is not default and not math.isfinite(value):
            raise self.error(f"{key} must be finite; got {value!r}")
        return value

    def whole(self, key: str, default: Any = REQUIRED) -> Any:
        """A whole number."""
        return self._typed(key, default, (int,), "a whole number")

    def text(self, key: str, default: Any = REQUIRED) -> Any:
        """A text."""
        return self._typed(key, default, (str,), "a text in quotes")

    def flag(self, key: str, default: Any = REQUIRED) -> Any:
        """True or false."""
        return self._typed(key, default, (bool,), "true or false")

    def numbers(self, key: str, default: Any = REQUIRED) -> Any:
        """A number, or arrays of numbers."""
        return self._typed(key, default, (int, float, list), "a number or an array of numbers")

    def word(self, key: str, options: Sequence[str], default: Any = REQUIRED) -> Any:
        """One of a few words."""
        value = self.take(key, default)
        if value is not default and value not in options:
            raise self.error(f"{key} must be one of {quoted_list(options)}; got {value!r}")
        return value

    def section(self, key: str, *, required: bool = False) -> Section:
        """A table below this one; empty where it is not there."""
        value = self._typed(key, REQUIRED if required else {}, (dict,), f"a table: [{self._below(key)}]")
        return Section(self._file, self._below(key), value)

    def sections(self, key: str) -> list[Section]:
        """An array of tables: [[key]]."""
        value = self._typed(key, [], (list,), f"an array of tables: [[{self._below(key)}]]")
        if not all(isinstance(item, dict) for item in value):
            raise self.error(f"{key} must be an array of tables: [[{self._below(key)}]]; got {value!r}")
        return [Section(self._file, f"{self._below(key)} {i + 1}", item) for i, item in enumerate(value)]

    def _below(self, key: str) -> str:
        return f"{self._name}.{key}" if self._name else key

    @property
    def left(self) -> list[str]:
        """The keys that were not taken yet, in the order of the file."""
        return list(self._table)

    def is_table(self, key: str) -> bool:
        """Whether a key holds a table."""
        return isinstance(self._table.get(key), dict)

    def done(self) -> None:
        """Nothing may be left.

        Raises:
            ScenarioError: There is a key that nobody asked for.
        """
        for key in self._table:
            close = difflib.get_close_matches(key, self._known, n=1)
            way_out = f"did you mean '{close[0]}'?" if close else f"it takes {quoted_list(sorted(set(self._known)))}"
            raise self.error(f"has no key '{key}'; {way_out}")
