"""Results by name, where a misspelt name gets the nearest that there are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn, TypeVar

from taut.base.errors import unknown_name

__all__ = ["Named"]

T = TypeVar("T")


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
