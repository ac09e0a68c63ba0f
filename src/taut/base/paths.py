"""Paths: the one namespace for parameters and memory, 'law.kp', 'plant.payload.mass'; results by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn, TypeVar

from taut.base.errors import unknown_name

__all__ = ["Named", "flatten", "subtree", "unflatten"]


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
    """A dict that reports missing names with the nearest ones.

    Args:
        owner: What has the names, for the message: "the run".
        kind: What they name: "term".
        values: What is there, by name.
    """

    __slots__ = ("_kind", "_owner")

    def __init__(self, owner: str, kind: str, values: Mapping[str, T]) -> None:
        super().__init__(values)
        self._owner, self._kind = owner, kind

    def __missing__(self, name: str) -> NoReturn:
        raise unknown_name(self._owner, self._kind, name, self)

    def __reduce__(self) -> tuple[type[Named[T]], tuple[str, str, dict[str, T]]]:
        return type(self), (self._owner, self._kind, dict(self))
