"""TOML files as tables that know their place, so that a message names file, section and key as they are written."""

from __future__ import annotations

import contextlib
import copy
import difflib
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from taut.base.checks import readable_file
from taut.base.errors import FileError, ScenarioError, TautError, quoted_list

__all__ = ["Table", "file_beside", "read_toml", "shown", "table_of", "with_values"]

EMPTY: Final[Mapping[str, str]] = {}
MAX_BYTES: Final = 500_000  # of a file
MAX_DEPTH: Final = 16  # tables within tables; a scenario has five
MAX_SHOWN: Final = 100  # letters of a value in a message
TEXT_OR_COMMENT: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL
)
PARAMETERS: Final = {
    "sensors": "plant.sensors",
    "actuation": "plant.actuation",
    "environment": "plant.environment",
    "sensing": "control",
    "limits": "control.limits",
}
"""Where parameters of a loop stand in a file, by the first word of their paths."""
DOTTED: Final = re.compile(rf"(?<![^\s.,=\[\]{{}}])(?:[^\s.,=\[\]{{}}]+[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")


def read_toml(path: Path, label: str = "") -> Table:
    """The root table of a file.

    Args:
        path: The file.
        label: What messages call it; its path if left out.

    Raises:
        FileError: It cannot be read.
        ScenarioError: It is no TOML, or none that a scenario could be.
    """
    file = readable_file("scenario", path)
    if file.stat().st_size > MAX_BYTES:
        raise ScenarioError(f"scenario '{file}' is larger than {MAX_BYTES} bytes; a scenario is a page of text")
    try:
        text = file.read_text(encoding="utf-8-sig")  # editors on Windows begin a file with a mark
    except UnicodeDecodeError as cause:
        raise ScenarioError(f"scenario '{file}' is no UTF-8 text ({cause.reason} at byte {cause.start})") from cause
    return table_of(text, label or str(file), f"scenario '{file}'")


def table_of(text: str, label: str, what: str) -> Table:
    """The root table of a text.

    Args:
        text: The text.
        label: What messages about its keys call it.
        what: What a message calls it that it is no TOML.

    Raises:
        ScenarioError: It is no TOML, or none that a scenario could be.
    """
    dotted = DOTTED.search(TEXT_OR_COMMENT.sub(lambda found: "" if found[0][0] == "#" else "_", text))
    if dotted is not None:  # the parser's time grows with the third power of such a key's length
        raise Table(label, "", {}).error(
            f"has at '{dotted[0].rstrip('. ')[:MAX_SHOWN]}' more than {MAX_DEPTH} tables in each other; no key takes "
            "that"
        )
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as cause:  # TOML that is wrong, a number with thousands of digits
        raise ScenarioError(f"{what} is no valid TOML: {cause}") from cause
    root = Table(label, "", table)
    _refuse_hostile(root, table)
    return root


def _refuse_hostile(root: Table, table: Mapping[str, Any]) -> None:
    """What no scenario has, and what would not fit into any message."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), table)]
    while waiting:
        path, value = waiting.pop()
        place = f"has at '{'.'.join(path)[:MAX_SHOWN]}'"
        if isinstance(value, (dict, list)):
            if len(path) == MAX_DEPTH:
                raise root.error(f"{place} more than {MAX_DEPTH} tables or arrays in each other; no key takes that")
            inside = value.items() if isinstance(value, dict) else enumerate(value)
            waiting += [((*path, str(key)), each) for key, each in inside]
            hidden = next((key for key in value if isinstance(key, str) and not key.isprintable()), "")
            if hidden:
                raise root.error(f"{place} the key '{hidden[:MAX_SHOWN]}' with an invisible character; delete it")
        elif isinstance(value, str) and not value.replace("\n", "").replace("\t", "").isprintable():
            raise root.error(f"{place} a text with an invisible character: {shown(value)}; delete it")
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise root.error(f"{place} a whole number beyond the 64 bits of TOML; write it as 1e20")


def file_beside(kind: str, name: str, folder: Path) -> Path:
    """A file that a scenario names: a path from the scenario's own folder, or an absolute one.

    Raises:
        FileError: It cannot be read; the message says where it was looked for.
    """
    place = folder.resolve() / name
    try:
        return readable_file(kind, place)
    except FileError as cause:
        if Path(name).is_absolute() or os.path.exists(place):  # noqa: PTH110  (long names)
            raise
        raise FileError(f"{cause} (paths begin at the scenario's own folder)", name=cause.name) from cause


class Table:
    """One table of a file: its values, and the place that messages name.

    Args:
        file: What messages call the file.
        path: Of the table in it, such as "plant.actuation"; empty for the root.
        values: The keys and what stands behind them.
    """

    def __init__(self, file: str, path: str, values: Mapping[str, Any]) -> None:
        self.file, self.path, self.values = file, path, dict(values)

    @property
    def where(self) -> str:
        """File and section, as messages begin with."""
        return f"{self.file}: [{self.path}]" if self.path else self.file

    def below(self, key: str) -> str:
        """The whole path of a key."""
        return f"{self.path}.{key}" if self.path else key

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def get(self, key: str, default: Any = None) -> Any:
        """The value of a key, whatever it is."""
        return self.values.get(key, default)

    # ---------------------------------------------------------------- errors

    def error(self, text: str, key: str = "") -> ScenarioError:
        """An error about this table, or about one of its keys, with which its text then begins."""
        words = text if not key else f"{key}{text}" if text.startswith(":") else f"{key} {text}"
        return ScenarioError(f"{self.where} {words}", name=self.below(key) if key else self.path)

    @contextlib.contextmanager
    def blamed(self, key: str = "", *, made: str = "") -> Iterator[None]:
        """Errors of what is made from this table name it, and the key that they are about.

        Args:
            key: The key to name where an error is about none that is written here.
            made: What is made, whose name a message need not begin with.
        """
        try:
            yield
        except ScenarioError:
            raise
        except TautError as cause:
            raise self._blame(str(cause).removeprefix(f"{made} "), cause.name or "", key) from cause
        except OverflowError as cause:  # of a period, a delay, a time that no float holds
            raise self.error(f"is too large: {cause}", key or "a number") from cause

    def _blame(self, text: str, name: str, key: str) -> ScenarioError:
        """An error that calls a key as it is written here: q, not ref.q."""
        words = re.findall(r"[^.\[\]]+", name)
        written = next((word for word in words if word in self.values), "")
        if written and words[-1] == written and name in text:
            text = text.replace(name, written, 1)
        about = written or key
        if about and not re.match(rf"[\w.]*(?<!\w){re.escape(about)}(?!\w)", text):
            text = f"{about}: {text}"
        return ScenarioError(f"{self.where} {text}", name=self.below(about) if about else self.path)

    def need(self, key: str, what: str = "") -> None:
        """A key has to be there; `what` is what a message calls it.

        Raises:
            ScenarioError: It is not.
        """
        if key not in self.values:
            close = difflib.get_close_matches(key, self.values, n=1)
            hint = f"; is '{close[0]}' meant for it?" if close else ""
            wanted = what or f"the key '{key}'"
            raise ScenarioError(f"{self.where} needs {wanted}{hint}", name=self.below(key))

    def only(self, known: Iterable[str], elsewhere: Mapping[str, str] = EMPTY) -> None:
        """Nothing but these keys may be there.

        Args:
            known: The keys.
            elsewhere: What to say of keys that have their place where this table is of another kind.

        Raises:
            ScenarioError: There is another key.
        """
        names = sorted(set(known))
        for key in self.values:
            if key in names:
                continue
            close = [] if key in elsewhere else difflib.get_close_matches(key, names, n=1)
            # All of them: a list that is cut sends the reader to the manual.
            hint = f"did you mean '{close[0]}'?" if close else f"it takes {quoted_list(names, most=len(names))}"
            text = f"has no key '{key}'{elsewhere.get(key, '')}; {hint}"
            raise ScenarioError(f"{self.where} {text}", name=self.below(key))

    # ---------------------------------------------------------------- values

    def number(self, key: str, default: Any = None) -> Any:
        """A number; whoever takes it checks it."""
        value = self.values.get(key, default)
        if value is not default and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise self.error(f"must be a number; got {shown(value)}", key)
        return value

    def text(self, key: str, default: Any = None) -> Any:
        """A text."""
        value = self.values.get(key, default)
        if value is not default and not isinstance(value, str):
            raise self.error(f"must be a text in quotes; got {shown(value)}", key)
        return value

    def texts(self, key: str, example: str) -> list[str] | None:
        """An array of texts, such as the example; None where it is not there."""
        value = self.values.get(key)
        if value is None or (isinstance(value, list) and all(isinstance(item, str) for item in value)):
            return value
        raise self.error(f"must be an array of texts such as {example}; got {shown(value)}", key)

    def choice(self, key: str, options: Iterable[str], default: Any = None) -> Any:
        """One of a few words."""
        value, words = self.values.get(key, default), tuple(options)
        if value is default and key not in self.values:
            return default
        if not isinstance(value, str) or value not in words:
            raise self.error(f"must be one of {quoted_list(words, most=len(words))}; got {shown(value)}", key)
        return value

    # ---------------------------------------------------------------- tables

    def table(self, key: str, *, required: bool = False) -> Table:
        """A table below this one; empty where it is not there."""
        if required:
            self.need(key, f"the section [{self.below(key)}]")
        value = self.values.get(key, {})
        if not isinstance(value, dict):
            raise self.error(f"must be a table: [{self.below(key)}]; got {shown(value)}", key)
        return Table(self.file, self.below(key), value)

    def tables(self, key: str) -> list[Table]:
        """An array of tables: [[key]]."""
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(f"must be an array of tables: [[{self.below(key)}]]; got {shown(value)}", key)
        return [Table(self.file, f"{self.below(key)} {i}", item) for i, item in enumerate(value, start=1)]

    def without(self, *keys: str) -> Table:
        """The same place without some of its keys."""
        return Table(self.file, self.path, {key: value for key, value in self.values.items() if key not in keys})

    def replaced(self, changes: Mapping[str, Any], label: str) -> Table:
        """This table with other values: tables merge, anything else takes the place of what was there.

        Args:
            changes: The keys with their new values.
            label: What messages call the file then.
        """
        return Table(label, self.path, _merged(self.values, changes))


def with_values(root: Table, values: Mapping[str, Any]) -> Table:
    """A file with other values of some keys, by their paths: {"run.duration": 2.0}; rows of [[event]] have numbers.

    Paths of parameters are known too: "law.kp" in each of the laws, "law.touch.kp" in the law of a phase,
    "sensors.position.noise", "limits.tau".

    Raises:
        ScenarioError: A path below something that is no table.
    """
    table = copy.deepcopy(root.values)
    for path, value in values.items():
        words = path.split(".")
        for whole in _places(root, words):
            at: Any = table
            for word in whole[:-1]:
                at = at.setdefault(word, {}) if isinstance(at, dict) else _row(at, word)
            if not isinstance(at, dict):
                raise ScenarioError(f"{root.where} has no table '{'.'.join(whole[:-1])}' for '{path}'", name=path)
            at[whole[-1]] = value
    return Table(root.file, root.path, table)


def _places(root: Table, words: list[str]) -> list[list[str]]:
    """Where a path stands in the file."""
    first, rest = words[0], words[1:]
    phases = root.get("phases")
    if first != "law":
        return [[*PARAMETERS.get(first, first).split("."), *rest]]
    if isinstance(phases, list):
        names = [row.get("name", f"phase{i}") for i, row in enumerate(phases, start=1)]
        if not rest or rest[0] not in names:
            raise ScenarioError(
                f"{root.where} has the phases {quoted_list(names)}; write law.{names[0]}.kp", name="law"
            )
        return [["phases", str(1 + names.index(rest[0])), "law", *rest[1:]]]
    return [["laws", label, *rest] for label in root.get("laws", {})]


def _row(rows: Any, word: str) -> Any:
    """A row of an array of tables by its number, from 1 on."""
    there = isinstance(rows, list) and word.isdigit() and 1 <= int(word) <= len(rows)
    return rows[int(word) - 1] if there else None


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(old)
    for key, value in new.items():
        before = old.get(key)
        out[key] = _merged(before, value) if isinstance(before, dict) and isinstance(value, dict) else value
    return out


def shown(value: object) -> str:
    """A value in a message: a long one is cut."""
    text = repr(value)
    return text if len(text) <= MAX_SHOWN else f"{text[: MAX_SHOWN - 3]}..."
