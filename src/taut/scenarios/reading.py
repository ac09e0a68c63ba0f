"""The one walker from tables to objects: what a class or a function takes is what its table may have.

A class with declared fields, a dataclass or a function states by its arguments which keys there are, which must be
there, and which of them are objects that have tables of their own. Values are checked where the object is made.
"""

from __future__ import annotations

import dataclasses
import inspect
import types
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any, Final, NamedTuple, Union, get_args, get_origin, get_type_hints

from taut.base.errors import quoted_list
from taut.base.fields import REQUIRED, Declared, Part, Plain
from taut.control.gains import Memory
from taut.scenarios.toml import EMPTY, Table

__all__ = ["arguments", "of_keys", "of_kind", "read", "reads"]

NONE: Final = "none"  # the word for an object that is not there

Reader = Callable[[Table, str], Any]
_READERS: Final[dict[frozenset[type], Reader]] = {}


class Argument(NamedTuple):
    """What a class or function takes by a name."""

    required: bool
    parts: frozenset[type]  # classes of objects that a table describes
    plain: bool  # whether it takes values that are no tables
    optional: bool  # whether it takes None


def reads(*kinds: type) -> Callable[[Reader], Reader]:
    """State how an object of a class, or of one of several, is read: from a table and one of its keys."""

    def keep(reader: Reader) -> Reader:
        _READERS[frozenset(kinds)] = reader
        return reader

    return keep


def arguments(kind: Callable[..., Any]) -> Mapping[str, Argument]:
    """What a class or function takes, by name."""
    if inspect.ismethod(kind):
        return dict(list(_arguments(kind.__func__).items())[1:])
    return _arguments(kind)


@cache
def _arguments(kind: Callable[..., Any]) -> Mapping[str, Argument]:
    if isinstance(kind, type) and issubclass(kind, Declared):
        return {
            name: Argument(field.default is REQUIRED, parts, not parts or field.convert is not None, field.optional)
            for name, field in kind.declared.items()
            for parts in [frozenset(field.of if isinstance(field, Part) and not isinstance(field, Plain) else ())]
        }
    if dataclasses.is_dataclass(kind) and kind.__dataclass_params__.init:  # type: ignore[attr-defined]
        hints = get_type_hints(kind)
        of = [f for f in dataclasses.fields(kind) if not isinstance(vars(kind).get(f.name), Memory)]
        must = {f.name: f.default is f.default_factory is dataclasses.MISSING for f in of}
        return {name: _argument(hints[name], required) for name, required in must.items()}
    hints = get_type_hints(vars(kind)["__init__"] if isinstance(kind, type) else kind)
    signature = inspect.signature(kind)
    named = (p for p in signature.parameters.values() if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY))
    return {p.name: _argument(hints.get(p.name, Any), p.default is p.empty) for p in named}


def _argument(hint: Any, required: bool) -> Argument:
    options = set(_options(hint))
    parts = frozenset(each for each in options if isinstance(each, type) and _has_table(each))
    return Argument(required, parts, bool(options - parts - {type(None)}) or not parts, type(None) in options)


def _options(hint: Any) -> Iterable[Any]:
    if get_origin(hint) in (Union, types.UnionType):
        for each in get_args(hint):
            yield from _options(each)
    else:
        yield hint


def _has_table(kind: type) -> bool:
    return frozenset([kind]) in _READERS or dataclasses.is_dataclass(kind)


def read(
    kind: Callable[..., Any],
    table: Table,
    *,
    others: Iterable[str] = (),
    skip: Iterable[str] = (),
    elsewhere: Mapping[str, str] = EMPTY,
    blame: str = "",
    **made: Any,
) -> Any:
    """What a table describes.

    Args:
        kind: The class or function that makes it.
        table: Keys and values.
        others: Keys that are read elsewhere.
        skip: Arguments that no table has.
        elsewhere: What to say of keys that have their place where the table is of another kind.
        blame: The key to name where an error is about none of those that are written.
        made: Arguments that do not come from the table.

    Raises:
        ScenarioError: A key that there is not, one that is missing, a value that the object does not take.
    """
    known = arguments(kind)
    free = [name for name in known if name not in made and name not in skip]
    table.only([*free, *others], elsewhere)
    values = dict(made)
    for name in free:
        if name in table:
            values[name] = value(known[name], table, name)
        elif known[name].required:
            table.need(name)
    with table.blamed(blame, made=getattr(kind, "__name__", "")):
        return kind(**values)


def value(argument: Argument, table: Table, key: str) -> Any:
    """The value of one key: as it is written, or the object that its table describes."""
    written = table.get(key)
    if written == NONE and argument.optional:
        return None
    tables = isinstance(written, Mapping) or (isinstance(written, list) and any(isinstance(x, dict) for x in written))
    if not argument.parts or (argument.plain and not tables):
        return written
    reader = _READERS.get(argument.parts)
    if reader is not None:
        return reader(table, key)
    below = table.table(key)
    return of_keys(argument.parts, below)


def of_keys(kinds: Iterable[type], table: Table) -> Any:
    """What a table describes: of several classes the one that has its keys."""
    return read(_fitting(frozenset(kinds), table), table)


def _fitting(kinds: frozenset[type], table: Table) -> type:
    if len(kinds) == 1:
        return next(iter(kinds))
    by_name = {kind.__name__: arguments(kind).keys() & table.values.keys() for kind in kinds}
    table.only({name for kind in kinds for name in arguments(kind)})
    best = max(kinds, key=lambda kind: (len(by_name[kind.__name__]), kind.__name__))
    for kind in kinds:
        if by_name[kind.__name__] - by_name[best.__name__]:
            several = sorted(f"{quoted_list(sorted(names))} of {name}" for name, names in by_name.items() if names)
            raise table.error(f"has {' and '.join(several)}; keep one of them")
    return best


def of_kind(kinds: Mapping[str, Callable[..., Any]], table: Table, **made: Any) -> Any:
    """What a table describes that names its kind: kind = "spring"."""
    table.need("kind")
    return read(kinds[table.choice("kind", kinds)], table, others=["kind"], **made)
