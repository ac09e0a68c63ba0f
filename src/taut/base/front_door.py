"""Front doors: modules that give the public names of a room, each loaded when it is first used.

A front door lists its names once, as imports below `if TYPE_CHECKING:`, which type checkers follow and Python reads
as text. So `import taut` loads hardly anything.
"""

from __future__ import annotations

import enum
import functools
import importlib
import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final

from taut.base.errors import TautError, UsageError, unknown_name

_IMPORT: Final = re.compile(r"^    from (taut[.\w]*) import (\w+) as \2$", re.MULTILINE)
_UNCHECKED: Final[dict[str, set[tuple[str, str]]]] = {}  # front doors and names, by the module that defines them


def lazy_names(module: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a front door, from the imports for type checkers in its file."""
    homes = {name: home for home, name in _IMPORT.findall(Path(file).read_text(encoding="utf-8"))}
    names = sorted(homes)
    for name, home in homes.items():
        _UNCHECKED.setdefault(home, set()).add((module, name))

    def load(name: str) -> Any:
        if name not in homes:
            others = [] if name.startswith("_") else _doors_with(name)
            unknown = unknown_name(module, "public name", name, names)
            text = f"{module} has no public name {name!r}; it is {others[0]}" if others else str(unknown)
            raise AttributeError(text, name=name, obj=None)
        value = _value(homes[name], name)
        if name != "math":  # whose functions are too quick to wrap
            value = _checked(module, name, value)
        vars(sys.modules[module])[name] = value
        return value

    return load, lambda: names, names


def _doors_with(name: str) -> list[str]:
    """Where front doors have a public name, or the same in other letters: lqr for LQR, not Lqr."""
    top = importlib.import_module("taut")
    doors = [top, *(value for word in top.__all__ if isinstance(value := getattr(top, word), ModuleType))]
    found = [(door.__name__, each) for door in doors for each in door.__all__ if each.lower() == name.lower()]
    found.sort(key=lambda one: (one[1] != name, one[1] != name.lower()))
    return [".".join(one) for one in found]


def _value(home: str, name: str) -> Any:
    if home == "taut":  # a front door itself
        return importlib.import_module(f"taut.{name}")
    return getattr(importlib.import_module(home), name)


def _checked(module: str, name: str, value: Any) -> Any:
    """A public name whose arguments are checked, as are those of the classes whose objects it may give."""
    for home in [home for home in _UNCHECKED if home in sys.modules and home != "taut"]:
        for door, other in _UNCHECKED.pop(home):
            thing = getattr(sys.modules[home], other, None)
            if isinstance(thing, type):
                checked_arguments(thing, door, other)
    return checked_arguments(value, module, name)


# An argument that does not exist, or is missing, gets a sentence with the nearest that do. A call that succeeds costs
# one Python frame more; the signature is read only where Python itself refuses the arguments of that very call.


_CHECKED: Final = "_taut_checked"


def checked_arguments(thing: Any, module: str, name: str) -> Any:
    """A public function that refuses arguments in words, which pickle finds in `module`; of a class, its methods."""
    if isinstance(thing, FunctionType):
        function = _refusing(thing)
        function.__module__, function.__qualname__ = module, name
        return function
    if isinstance(thing, ModuleType):
        for word in thing.__all__:
            member = vars(thing).get(word)
            if isinstance(member, FunctionType):
                setattr(thing, word, _refusing(member))
            elif isinstance(member, type):
                checked_arguments(member, module, word)
    if isinstance(thing, type) and not issubclass(thing, (Exception, enum.Enum)):
        for cls in thing.__mro__:
            if cls.__module__.startswith("taut.") and not vars(cls).get("_is_protocol"):
                _check_class(cls)
    return thing


def _check_class(cls: type) -> None:
    for name, member in list(vars(cls).items()):
        kind = type(member) if isinstance(member, (classmethod, staticmethod)) else None
        function = member.__func__ if kind is not None else member
        if not isinstance(function, FunctionType) or hasattr(function, _CHECKED):
            continue
        code = function.__code__
        if name == "__init__" or (code.co_argcount + code.co_kwonlyargcount > 1 and not name.startswith("_")):
            setattr(cls, name, _refusing(function) if kind is None else kind(_refusing(function)))


def _refusing(function: FunctionType) -> FunctionType:
    """The function, in which a refusal of its arguments becomes a UsageError."""

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except TypeError as error:
            trace = error.__traceback__
            if isinstance(error, TautError) or trace is None or trace.tb_next is not None:
                raise  # from inside the function, which Python did enter
            made = function.__name__ == "__init__"
            wrong = _wrong(function, type(args[0]).__name__ if made else function.__qualname__, args, kwargs)
            if wrong is None:
                raise
            raise wrong from None

    setattr(call, _CHECKED, True)
    return call  # type: ignore[return-value]  # a wrapper is a plain function


def _wrong(
    function: Callable[..., Any], name: str, args: tuple[Any, ...], kwargs: dict[str, Any]
) -> UsageError | None:
    signature = inspect.signature(function)
    parameters = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
    named = [p.name for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters)
    for word in kwargs:
        if word not in named and not open_ended:
            return UsageError(str(unknown_name(name, "argument", word, named)), name=word, value=kwargs[word])
    try:
        signature.bind(*args, **kwargs)
    except TypeError as cause:
        shown = (p.name if p.kind < p.KEYWORD_ONLY else f"{p.name}=" for p in parameters)
        return UsageError(f"{name}({', '.join(shown)}): {cause}", name=name)
    return None
