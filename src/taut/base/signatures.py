"""Arguments of public names: one that does not exist, or is missing, gets a sentence with the nearest that do.

A front door applies it to what it gives out. A call that succeeds costs one more Python frame; the signature is
read only where Python itself refuses the arguments of that very call.
"""

from __future__ import annotations

import enum
import functools
import inspect
from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any, Final

from taut.base.errors import TautError, UsageError, unknown_name

__all__ = ["checked_arguments"]

_CHECKED: Final = "_taut_checked"
_NAMED = inspect.Parameter.VAR_KEYWORD
_LISTED = inspect.Parameter.VAR_POSITIONAL


def checked_arguments(thing: Any, module: str, name: str) -> Any:
    """A public function that refuses arguments in words; a class, whose constructors and methods then do.

    Args:
        thing: The value of the public name; a class stays the object it is, a module of functions too.
        module: The front door that has the name, where pickle finds a function again.
        name: Its public name.
    """
    if isinstance(thing, FunctionType):
        function = _checked(thing)
        function.__module__, function.__qualname__ = module, name
        return function
    if isinstance(thing, ModuleType):
        for word in thing.__all__:
            member = vars(thing).get(word)
            if isinstance(member, FunctionType):
                setattr(thing, word, _checked(member))
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
        by_name = function.__defaults__ or function.__code__.co_kwonlyargcount
        if name == "__init__" or (by_name and not name.startswith("_")):
            setattr(cls, name, _checked(function) if kind is None else kind(_checked(function)))


def _checked(function: FunctionType) -> FunctionType:
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
    """What is wrong with the arguments of a call."""
    parameters = list(inspect.signature(function).parameters.values())
    if parameters[:1] and parameters[0].name in ("self", "cls"):
        parameters, args = parameters[1:], args[1:]
    named = [p.name for p in parameters if p.kind not in (_NAMED, _LISTED, inspect.Parameter.POSITIONAL_ONLY)]
    open_ended = any(p.kind is _NAMED for p in parameters)
    for word in kwargs:
        if word not in named and not open_ended:
            return UsageError(str(unknown_name(name, "argument", word, named)), name=word, value=kwargs[word])
    places = [p.name for p in parameters if p.kind < _LISTED]
    if len(args) > len(places) and not any(p.kind is _LISTED for p in parameters):
        taken = f"takes {', '.join(places)} by position" if places else "takes its arguments by name"
        rest = [word for word in named if word not in places and word not in kwargs]
        how = f"; name the others: {', '.join(f'{word}=' for word in rest)}" if rest else ""
        return UsageError(f"{name} {taken}; got {len(args)} arguments without a name{how}", name=name)
    for word in places[: len(args)]:
        if word in kwargs:
            return UsageError(f"{name} got {word} twice: by position and by name", name=word)
    needed = [p.name for p in parameters if p.default is p.empty and p.kind not in (_NAMED, _LISTED)]
    missing = [word for word in needed if word not in kwargs and word not in places[: len(args)]]
    return UsageError(f"{name} needs {', '.join(missing)}", name=missing[0]) if missing else None
