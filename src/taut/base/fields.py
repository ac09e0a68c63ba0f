"""Declared fields of frozen, keyword-only dataclasses: unit, range, shape and documentation, stated once.

    class Encoder(Declared):
        resolution: Field = Field(unit="rad | m", above=0.0, optional=True)
        noise: Field = Field(0.0, unit="rad | m", minimum=0.0)
        side: Choice[Side] = Choice("link", "motor")

One declaration gives validation, the error sentence, run-time parameters by path, and the reader of a TOML table. A
sentence begins with the name of the field and contains no Python syntax, so that it reads the same for an argument
(`kp[2] must be >= 0 [1/s^2]; got -3.0`) and for a key of a file (`law.kp[2] must be >= 0 [1/s^2]; got -3.0`).
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, ClassVar, NoReturn, Self, dataclass_transform

import numpy as np

from taut.base.declarations import REQUIRED as REQUIRED
from taut.base.declarations import Choice as Choice
from taut.base.declarations import Declaration as Declaration
from taut.base.declarations import Field as Field
from taut.base.declarations import Part as Part
from taut.base.declarations import Parts as Parts
from taut.base.declarations import Plain as Plain
from taut.base.declarations import Whole as Whole
from taut.base.errors import ShapeError, TautError, UsageError, unknown_name
from taut.base.types import Float64Array


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Declared:
    """Base of every declared class: `mass: Field = Field(unit="kg", above=0.0)`. It is frozen and keyword-only.

    An annotated attribute that is no declaration, `tool: str | None = None`, is a plain field that takes anything.
    Values are converted, checked and stored in the order of the declarations; then `check(self)` sees to relations
    between them. `dataclasses.fields` and `dataclasses.replace` work. A class variable is annotated as ClassVar.

    Example:
        >>> class Load(Declared):
        ...     mass: Field = Field(unit="kg", above=0.0)
        >>> Load(mass=2.0).parameters()
        {'mass': array(2.)}
        >>> Load(mass=-2.0)
        Traceback (most recent call last):
        taut.base.errors.RangeError: mass must be > 0 [kg]; got -2.0
    """

    declared: ClassVar[Mapping[str, Declaration[Any]]] = {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        own = {}
        for name, annotation in inspect.get_annotations(cls).items():
            word = annotation.__name__ if isinstance(annotation, type) else str(annotation)
            if "ClassVar" in word:
                continue
            given = cls.__dict__.get(name, REQUIRED)
            if not isinstance(given, Declaration):
                if isinstance(given, (list, set, dict, np.ndarray)):
                    raise UsageError(
                        f"{cls.__name__}: the default of '{name}' is a {type(given).__name__}, which could be "
                        "changed; write a tuple",
                        name=name,
                    )
                given = cls.declaration_of(name, word, given)
                given.__set_name__(cls, name)
                setattr(cls, name, given)
            own[name] = given
        for name in set(own) & set(dir(cls.__mro__[1])) - set(cls.declared):
            raise UsageError(
                f"{cls.__name__}: '{name}' is a word of {cls.__mro__[1].__name__} itself; "
                "give the field another name",
                name=name,
            )
        for name, given in vars(cls).items():
            if isinstance(given, Declaration) and name not in own:
                kind = type(given).__name__
                raise UsageError(
                    f"{cls.__name__}: '{name}' needs its type; write {name}: {kind} = {kind}(...)", name=name
                )
        cls.declared = {**cls.declared, **own}
        dataclasses.dataclass(kw_only=True, eq=False, repr=False, init=False)(cls)
        cls.__signature__ = _signature(cls)  # type: ignore[attr-defined]  # what help() and editors show

    @classmethod
    def declaration_of(cls, name: str, annotation: str, default: Any) -> Declaration[Any]:  # noqa: ARG003
        """The declaration of an annotated attribute that is none. A base may override it."""
        return Plain(default=default, optional=default is None)

    def __init__(self, *args: Any, **values: Any) -> None:
        if args:
            raise UsageError(
                f"{type(self).__name__} takes its fields by name; got {len(args)} without; write "
                f"{type(self).__name__}({', '.join(f'{name}=...' for name in self.declared)})",
                name=type(self).__name__,
            )
        for name in values:
            if name not in self.declared:
                raise unknown_name(type(self).__name__, "field", name, self.declared)
        missing = [
            f"{name} [{field.unit}]" if field.unit else name
            for name, field in self.declared.items()
            if field.default is REQUIRED and name not in values
        ]
        if missing:
            self.refuse("", f"needs {', '.join(missing)}")
        for name, field in self.declared.items():  # in order: a size such as "rows" may depend on a field before it
            self.__dict__[name] = values.get(name, field.default)
            self.__dict__[name] = field.taken(values.get(name, field.default), self)
        given = {name for name in values if not _same(self.__dict__[name], self.declared[name].default)}
        self.__dict__["_specified"] = frozenset(given)
        self.check()

    @property
    def specified(self) -> frozenset[str]:
        """Names of the fields that were given another value than their default."""
        names: frozenset[str] = self.__dict__["_specified"]
        return names

    def check(self) -> None:
        """Relations between fields; a class that has some overrides it and calls `refuse`."""

    def refuse(self, field: str, rule: str, kind: type[TautError] = UsageError) -> NoReturn:
        """Refuse a field, "" being the whole object: `self.refuse("zeta", "is for a law without B")`."""
        subject = field or type(self).__name__
        raise kind(f"{subject} {rule}", name=subject, value=self.__dict__.get(field), rule=rule)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise dataclasses.FrozenInstanceError(
            f"cannot assign to field '{name}' of {type(self).__name__}: it does not change; make another with "
            "dataclasses.replace"
        )

    def __delattr__(self, name: str) -> NoReturn:
        raise dataclasses.FrozenInstanceError(f"cannot delete field '{name}' of {type(self).__name__}")

    def declared_parts(self) -> dict[str, Declared]:
        """The declared objects that this one has, by field."""
        return {name: value for name in self.declared if isinstance(value := self.__dict__[name], Declared)}

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by path, those of parts below their names."""
        out: dict[str, Any] = {}
        for name, field in self.declared.items():
            value = self.__dict__[name]
            if field.run_time and value is not None:
                out[name] = value.as_array() if hasattr(value, "as_array") else np.asanyarray(value)  # or symbols
        for name, part in self.declared_parts().items():
            for path, value in part.parameters().items():
                whole = f"{self._below(name)}{path}"
                if whole in out:
                    raise UsageError(f"{type(self).__name__} and what is in it both have a parameter '{whole}'")
                out[whole] = value
        return out

    def bound(self, values: Mapping[str, Any]) -> Self:
        """A copy with other values of run-time parameters by path, as numbers or symbols. Nothing is checked."""
        inner = {}
        for name, part in self.declared_parts().items():
            below = self._below(name)
            own = {path.removeprefix(below): x for path, x in values.items() if path.startswith(below)}
            if own:
                inner[name] = part.bound(own)
        copy = self._with_parts(inner) if inner else self._replaced({})
        for name, field in self.declared.items():
            if field.run_time and name in values and self.__dict__[name] is not None:
                copy.__dict__[name] = field.stored(values[name])
        return copy

    def find(self, path: str) -> tuple[Declared, Declaration[Any]]:
        """The object that has the parameter at a path, and its declaration. Raises UnknownNameError."""
        if path in self.declared and self.declared[path].run_time and self.__dict__[path] is not None:
            return self, self.declared[path]
        for name, part in self.declared_parts().items():
            below = self._below(name)
            if path.startswith(below) and path.removeprefix(below) in part.parameters():
                return part.find(path.removeprefix(below))
        raise unknown_name(type(self).__name__, "parameter", path, self.parameters())

    def changed(self, path: str, value: Any, *, name: str = "") -> Self:
        """A copy with another value of the parameter at a path, which messages call `name`; checked as a new one."""
        new = self.bound({path: self.checked_parameter(path, value, name=name)})
        owner, field = new.find(path)
        try:
            owner.check()
        except TautError as cause:
            raise cause.about(field.name, name or path) from None
        return new

    def checked_parameter(
        self, path: str, value: Any, *, name: str = "", joints: Sequence[str] | int | None = None
    ) -> Float64Array:
        """A new value of the parameter at a path, which messages call `name`; checked by its declaration alone."""
        owner, field = self.find(path)
        try:
            checked: Float64Array = field.checked(field.converted(value), owner, joints)
        except TautError as cause:
            raise cause.about(field.name, name or path) from None
        return checked

    def units(self) -> dict[str, str]:
        return {path: self.find(path)[1].unit for path in self.parameters()}

    def _below(self, name: str) -> str:
        field = self.declared.get(name)
        return "" if isinstance(field, Part) and field.inline else f"{name}."

    def _with_parts(self, parts: Mapping[str, Any]) -> Self:
        """A copy with other objects in the place of some of `declared_parts`. Nothing is checked."""
        return self._replaced(parts)

    def _replaced(self, values: Mapping[str, Any]) -> Self:
        """A copy with other values of fields. Nothing is checked."""
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        copy.__dict__.update(values)
        return copy

    def check_size(self, joints: Sequence[str] | int, prefix: str = "") -> None:
        """Every vector has an entry for each joint, else ShapeError; `prefix` begins the message: "law."."""
        for name, field in self.declared.items():
            value = self.__dict__[name]
            if isinstance(field, Field) and isinstance(field.shape, str) and value is not None:
                try:
                    field.check_shape(np.shape(value), self, joints)
                except ShapeError as cause:
                    raise cause.about(name, f"{prefix}{name}") from None
        for name, part in self.declared_parts().items():
            part.check_size(joints, f"{prefix}{self._below(name)}")

    def _as_by_default(self, name: str) -> bool:
        """True where a field has the value and shape of its default; a copy of a part may be another object."""
        stored, field = self.__dict__[name], self.declared[name]
        same = _same(stored, field.default) and np.shape(stored) == np.shape(field.taken(field.default, self))
        return same or (isinstance(stored, Declared) and repr(stored) == repr(field.default))

    def __repr__(self) -> str:
        shown = (
            f"{name}={_shown(self.__dict__[name])}"
            for name in self.declared
            if name in self.specified or not self._as_by_default(name)
        )
        return f"{type(self).__name__}({', '.join(shown)})"


def _shown(value: Any) -> str:
    return repr(value.tolist() if isinstance(value, np.ndarray) else value)


def _same(stored: Any, default: Any) -> bool:
    if stored is default:
        return True
    if stored is None or default is None or default is REQUIRED:
        return False
    values = stored.as_array() if hasattr(stored, "as_array") else stored
    if isinstance(values, np.ndarray):
        if values.dtype == object:
            return False
        numbers = np.asarray(default, dtype=np.float64)
        if numbers.shape == (2,) and values.shape == (6,):  # (linear, angular)
            numbers = np.repeat(numbers, 3)
        return numbers.shape in ((), values.shape) and bool(np.all(values == numbers))
    return isinstance(stored, (str, bool, int, float, tuple)) and type(stored) is type(default) and stored == default


def _signature(cls: type[Declared]) -> inspect.Signature:
    empty = inspect.Parameter.empty
    return inspect.Signature(
        [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=empty if field.default is REQUIRED else field.default
            )
            for name, field in cls.declared.items()
        ]
    )


def unchanging(thing: object) -> bool:
    """Whether a thing is made of numbers, texts and taut's own classes, which do not change.

    A class or a function of the user's may use anything, and something else tomorrow; lists and dicts change too.
    """
    if thing is None or isinstance(thing, (str, int, float, np.generic, np.ndarray, PurePath)):
        return True
    if isinstance(thing, (tuple, frozenset)):
        return all(unchanging(part) for part in thing)
    if type(thing).__module__.partition(".")[0] != "taut":
        return False
    if isinstance(thing, Declared):
        return all(unchanging(vars(thing)[name]) for name in thing.declared)
    fields = dataclasses.fields(thing) if dataclasses.is_dataclass(thing) else ()
    return all(unchanging(getattr(thing, field.name)) for field in fields)
