"""The one reader of scenario files: tables that know their place, and the walker from tables to objects.

The arguments of a class with declared fields, a dataclass or a function state which keys its table may have, which
are required, and which have tables of their own. Values are checked where the object is made; an error then names
file, section and key as they are written.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import inspect
import os
import re
import tomllib
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple, Union, get_args, get_origin, get_type_hints

from taut.base.checks import readable_file
from taut.base.errors import FileError, ScenarioError, TautError, quoted_list, unknown_name
from taut.base.fields import Declared, Part
from taut.trace.pose import Pose

MAX_BYTES: Final = 500_000  # of a file
TABLE_DEPTH: Final = 16  # tables within tables; a scenario has five
MAX_LETTERS: Final = 100  # of a value in a message
LEFT_OUT_WORD: Final = "none"  # the word for an object that is left out
TEXT_OR_COMMENT: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL
)
DOTTED: Final = re.compile(rf"(?<![^\s.,=\[\]{{}}])(?:[^\s.,=\[\]{{}}]+[ \t]*+\.[ \t]*+){{{TABLE_DEPTH}}}")


def read_toml(path: str | Path, label: str = "", kind: str = "scenario") -> Table:
    """The root table of a file, which messages call `label`. Raises FileError or ScenarioError."""
    file = readable_file(kind, path)
    if file.stat().st_size > MAX_BYTES:
        raise ScenarioError(f"{kind} '{file}' is larger than {MAX_BYTES} bytes; a {kind} is a page of text")
    try:
        text = file.read_text(encoding="utf-8-sig")  # editors on Windows begin a file with a mark
    except UnicodeDecodeError as cause:
        raise ScenarioError(f"{kind} '{file}' is no UTF-8 text ({cause.reason} at byte {cause.start})") from cause
    root = Table(label or str(file), "", {}, file.parent)
    dotted = DOTTED.search(TEXT_OR_COMMENT.sub(lambda found: "" if found[0][0] == "#" else "_", text))
    if dotted is not None:  # the parser's time grows with the third power of such a key's length
        raise _too_deep(root, dotted[0].rstrip(". "))
    try:
        root.values = tomllib.loads(text)
    except (ValueError, RecursionError) as cause:  # TOML that is wrong, a number with thousands of digits
        raise ScenarioError(f"{kind} '{file}' is no valid TOML: {cause}") from cause
    _refuse_hostile(root)
    return root


def _too_deep(root: Table, place: str) -> ScenarioError:
    return root.error(
        f"has at '{place[:MAX_LETTERS]}' more than {TABLE_DEPTH} tables or arrays in each other; no key takes that"
    )


def _refuse_hostile(root: Table) -> None:
    """Refuse values that no scenario has, or that would not fit into any message."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), root.values)]
    while waiting:
        path, value = waiting.pop()
        place = f"has at '{'.'.join(path)[:MAX_LETTERS]}'"
        if isinstance(value, (dict, list)):
            if len(path) == TABLE_DEPTH:
                raise _too_deep(root, ".".join(path))
            inside = value.items() if isinstance(value, dict) else enumerate(value)
            waiting += [((*path, str(key)), each) for key, each in inside]
        words = list(value) if isinstance(value, dict) else []
        if isinstance(value, str):
            words = [value.replace("\n", "").replace("\t", "")]
        hidden = next((word for word in words if not word.isprintable()), "")
        if hidden:
            raise root.error(f"{place} {shown(hidden)} with an invisible character; delete it")
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise root.error(f"{place} a whole number beyond the 64 bits of TOML; write it as 1e20")


class Table:
    """One table of a file: its values and the place that messages name; `path` is "" for the root."""

    def __init__(self, file: str, path: str, values: Mapping[str, Any], folder: Path = Path()) -> None:
        self.file, self.path, self.values, self.folder = file, path, dict(values), folder

    @property
    def where(self) -> str:
        """File and section, as messages begin with."""
        return f"{self.file}: [{self.path}]" if self.path else self.file

    def below(self, key: str) -> str:
        """The whole path of a key; of the table itself where there is none."""
        return ".".join(filter(None, (self.path, key)))

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def get(self, key: str, default: Any = None) -> Any:
        return self.values.get(key, default)

    def error(self, text: str, key: str = "") -> ScenarioError:
        """An error about this table, or about one of its keys, with which its text then begins."""
        return ScenarioError(f"{self.where} {key}{' ' if key else ''}{text}", name=self.below(key))

    @contextlib.contextmanager
    def blamed(self, key: str = "", *, made: str = "") -> Iterator[None]:
        """Errors of `made` from this table name it and the key that they are about, or `key` if that is not here."""
        try:
            yield
        except ScenarioError:
            raise
        except TautError as cause:
            raise self._blame(str(cause).removeprefix(f"{made} "), cause.name or "", key) from cause
        except OverflowError as cause:  # of a period, a delay, a time that no float holds
            raise self.error(f"is too large: {cause}", key or "a number") from cause

    def _blame(self, text: str, name: str, key: str) -> ScenarioError:
        """An error that calls a key as it is written here: q, not ref.q; in the table below where it stands there."""
        words = re.findall(r"[^.\[\]]+", name)
        first = next((i for i, word in enumerate(words) if word in self.values), None)
        if first is not None:
            key, rest = words[first], words[first + 1 :]
            inner = self.values[key]
            if rest and isinstance(inner, dict) and rest[0] in inner:
                return self.table(key)._blame(text, name, "")
            if not rest:
                text = text.replace(name, key, 1)
        else:
            key = next((each for each, value in self.values.items() if _names(value, name)), key)
        if key and not re.match(rf"[\w.]*(?<!\w){re.escape(key)}(?!\w)", text):
            text = f"{key}: {text}"
        return ScenarioError(f"{self.where} {text}", name=self.below(key))

    def need(self, key: str, what: str = "") -> None:
        """A key has to be there, else ScenarioError; `what` is what its message calls it."""
        if key not in self.values:
            what = what or f"the key '{key}'"
            raise ScenarioError(f"{self.where} needs {what}", name=self.below(key))

    def only(self, known: Iterable[str]) -> None:
        """No other keys may be there. Raises ScenarioError."""
        names = sorted(set(known))
        for key in self.values:
            if key not in names:
                text = str(unknown_name(self.where, "key", key, names)).replace("; it has ", "; it takes ")
                raise ScenarioError(text, name=self.below(key))

    def text(self, key: str, default: Any = None) -> Any:
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
        value, words = self.values.get(key, default), tuple(options)
        if key in self.values and (not isinstance(value, str) or value not in words):
            close = difflib.get_close_matches(value, words, n=1) if isinstance(value, str) else []
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise self.error(f"must be one of {quoted_list(words, most=len(words))}; got {shown(value)}{hint}", key)
        return value

    def file_of(self, key: str, kind: str) -> Path:
        """The file that a key names: a path from the scenario's folder, or an absolute one. Raises ScenarioError."""
        name = self.text(key)
        place = self.folder.resolve() / name
        with self.blamed(key):
            try:
                return readable_file(kind, place)
            except FileError as cause:
                if Path(name).is_absolute() or os.path.exists(place):  # noqa: PTH110  (long names)
                    raise
                raise FileError(f"{cause} (paths begin at the scenario's own folder)", name=cause.name) from cause

    def at(self, path: str, values: Mapping[str, Any]) -> Table:
        return Table(self.file, path, values, self.folder)

    def table(self, key: str, *, required: bool = False) -> Table:
        """A table below this one; empty where it is not there."""
        if required:
            self.need(key, f"the section [{self.below(key)}]")
        value = self.values.get(key, {})
        if not isinstance(value, dict):
            raise self.error(f"must be a table: [{self.below(key)}]; got {shown(value)}", key)
        return self.at(self.below(key), value)

    def tables(self, key: str) -> list[Table]:
        """An array of tables: [[key]]."""
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(f"must be an array of tables: [[{self.below(key)}]]; got {shown(value)}", key)
        return [self.at(f"{self.below(key)} {i}", item) for i, item in enumerate(value, start=1)]

    def without(self, *keys: str) -> Table:
        """The same place without some of its keys."""
        return self.at(self.path, {key: value for key, value in self.values.items() if key not in keys})

    def merged(self, changes: Mapping[str, Any], label: str) -> Table:
        """This table with other values: tables merge, others are replaced; `label` is what messages call the file."""
        return Table(label, self.path, _merged(self.values, changes), self.folder)


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    both = {key: _merged(old[key], value) for key, value in new.items() if _are_tables(old.get(key), value)}
    return {**old, **new, **both}


def _names(value: object, name: str) -> bool:
    return value == name if isinstance(value, str) else isinstance(value, (list, dict)) and name in value


def _are_tables(*values: object) -> bool:
    return all(isinstance(value, dict) for value in values)


def shown(value: object) -> str:
    """A value in a message: a long one is cut."""
    text = repr(value)
    return text if len(text) <= MAX_LETTERS else f"{text[: MAX_LETTERS - 3]}..."


def with_values(root: Table, values: Mapping[str, Any]) -> Table:
    """A file with other values of some keys, by their paths: {"run.duration": 2.0}."""
    for path, value in values.items():
        changes = value
        for word in reversed(path.split(".")):
            changes = {word: changes}
        root = root.merged(changes, root.file)
    return root


Reader = Callable[[Table, str], Any]


class Argument(NamedTuple):
    """An argument of a class or function."""

    required: bool
    part: type | None  # class of the object that a table describes
    plain: bool  # whether it takes values that are no tables
    optional: bool  # whether it takes None


_READERS: Final[dict[type, Reader]] = {Pose: lambda table, key: read(Pose, table.table(key))}


def reads(kind: type) -> Callable[[Reader], Reader]:
    """State how an object of a class is read from a table and one of its keys."""

    def keep(reader: Reader) -> Reader:
        _READERS[kind] = reader
        return reader

    return keep


def arguments(kind: Callable[..., Any]) -> Mapping[str, Argument]:
    """The arguments of a class or function, by name."""
    if inspect.ismethod(kind):
        return dict(list(_arguments(kind.__func__).items())[1:])
    return _arguments(kind)


@cache
def _arguments(kind: Callable[..., Any]) -> Mapping[str, Argument]:
    if isinstance(kind, type) and issubclass(kind, Declared):
        options_of: Mapping[str, Any] = {
            name: [
                *(field.of if isinstance(field, Part) else ()),
                *([field.convert] if field.convert is not None else []),  # which takes something shorter
                *([None] if field.optional else []),
            ]
            for name, field in kind.declared.items()
        }
    else:
        hinted = kind if dataclasses.is_dataclass(kind) or not isinstance(kind, type) else vars(kind)["__init__"]
        options_of = {name: list(_options(hint)) for name, hint in get_type_hints(hinted).items()}
    out = {}
    for p in inspect.signature(kind).parameters.values():
        options = [each for each in options_of.get(p.name, ()) if each not in (None, types.NoneType)]
        parts = [each for each in options if each in _READERS or dataclasses.is_dataclass(each)]
        parts.sort(key=lambda each: each not in _READERS)
        optional = len(options) < len(options_of.get(p.name, ()))
        out[p.name] = Argument(p.default is p.empty, next(iter(parts), None), len(parts) < len(options), optional)
    return out


def _options(hint: Any) -> Iterable[Any]:
    if get_origin(hint) in (Union, types.UnionType):
        for each in get_args(hint):
            yield from _options(each)
    else:
        yield hint


def read(kind: Callable[..., Any], table: Table, *, others: Iterable[str] = (), blame: str = "", **made: Any) -> Any:
    """The object of a kind (class or function) that a table describes; `made` are arguments from elsewhere.

    `others` are keys read elsewhere, `blame` the key to name where an error is about none of those written. Raises
    ScenarioError.
    """
    known = {name: argument for name, argument in arguments(kind).items() if name not in made}
    table.only([*known, *others])
    values = dict(made)
    for name, argument in known.items():
        if name in table:
            values[name] = _value(argument, table, name)
        elif argument.required:
            table.need(name)
    with table.blamed(blame, made=getattr(kind, "__name__", "")):
        return kind(**values)


def _value(argument: Argument, table: Table, key: str) -> Any:
    """The value of one key: as it is written, or the object that its table describes."""
    written = table.get(key)
    if written == LEFT_OUT_WORD and argument.optional:
        return None
    tables = isinstance(written, dict) or (isinstance(written, list) and any(isinstance(x, dict) for x in written))
    made = written is None or dataclasses.is_dataclass(written) or isinstance(written, Pose)  # of a law's text
    if argument.part is None or made or (argument.plain and not tables):
        return written
    reader = _READERS.get(argument.part)
    return reader(table, key) if reader is not None else read(argument.part, table.table(key))


def of_kind(kinds: Mapping[str, Callable[..., Any]], table: Table, *, blame: str = "", **made: Any) -> Any:
    """The object that a table describes, which names its kind: kind = "spring"."""
    table.need("kind", f"kind, one of {quoted_list(kinds, most=len(kinds))}")
    return read(kinds[table.choice("kind", kinds)], table, others=["kind"], blame=blame, **made)
