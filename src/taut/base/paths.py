"""Paths: the one namespace for parameters and memory, 'law.kp', 'plant.payload.mass'; results by name."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any, NoReturn, TypeVar

from taut.base.checks import read_only
from taut.base.errors import UsageError, unknown_name
from taut.base.types import ArrayLike, Float64Array

T = TypeVar("T")


def flatten(nested: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as one mapping by path.

    Example:
        >>> flatten({"law": {"kp": 1.0}, "t": 0.0})
        {'law.kp': 1.0, 't': 0.0}
    """
    out: dict[str, Any] = {}
    for name, value in nested.items():
        if isinstance(value, Mapping):
            out |= flatten(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out


def unflatten(flat: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `flatten`; empty mappings are lost.

    Example:
        >>> unflatten({"law.kp": 1.0, "t": 0.0})
        {'law': {'kp': 1.0}, 't': 0.0}
    """
    out: dict[str, Any] = {}
    for path, value in flat.items():
        *heads, last = path.split(".")
        inner = out
        for head in heads:
            inner = inner.setdefault(head, {})
        inner[last] = value
    return out


def subtree(flat: Mapping[str, Any], head: str) -> dict[str, Any]:
    """The entries under `head`, with paths relative to it.

    Example:
        >>> subtree({"law.kp": 1.0, "limits.tau": 2.0}, "law")
        {'kp': 1.0}
    """
    start = head + "."
    return {path[len(start) :]: value for path, value in flat.items() if path.startswith(start)}


class Named(dict[str, T]):
    """A dict that reports missing names with the nearest ones, as `kind` ("term") of `owner` ("the run")."""

    __slots__ = ("_kind", "_owner")

    def __init__(self, owner: str, kind: str, values: Mapping[str, T]) -> None:
        super().__init__(values)
        self._owner, self._kind = owner, kind

    def __missing__(self, name: str) -> NoReturn:
        raise unknown_name(self._owner, self._kind, name, self)

    def __reduce__(self) -> tuple[type[Named[T]], tuple[str, str, dict[str, T]]]:
        return type(self), (self._owner, self._kind, dict(self))


class PlantParameters(Named[Float64Array]):
    """Parameters of a plant by path, to be read."""

    __slots__ = ()

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise UsageError(
            "a plant's parameters cannot be set in it: make it of another arm, such as arm.with_payload(1.0), or set "
            "loop.parameters of a taut.Loop, or give the run events",
            name="parameters",
        )

    __setitem__ = __delitem__ = __ior__ = update = setdefault = pop = popitem = clear = _refuse


class Parameters(MutableMapping[str, Float64Array]):
    """Run-time parameters by path; a new value is checked like the first one. Messages name the owner: "the loop"."""

    def __init__(self, owner: str, values: Mapping[str, Float64Array]) -> None:
        self._owner, self._values = owner, dict(values)

    def __getitem__(self, path: str) -> Float64Array:
        return read_only(self._values[self._known(path)])

    @abstractmethod
    def __setitem__(self, path: str, value: ArrayLike) -> None: ...

    def _known(self, path: str) -> str:
        if path not in self._values:
            raise unknown_name(self._owner, "parameter", path, self._values)
        return path

    def __contains__(self, path: object) -> bool:
        return path in self._values

    def get(self, path: str, default: Any = None) -> Any:
        return self[path] if path in self._values else default

    def __delitem__(self, path: str) -> None:
        raise UsageError(f"parameter '{path}' cannot be removed; set it", name=path)

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)
