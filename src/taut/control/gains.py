"""Gains and memory: the fields of a law. A gain is a scalar, one per joint, or a matrix, and acts by `@`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Self, overload

import numpy as np

from taut.base.checks import finite_array, require_at_least, require_at_most, symmetric_psd
from taut.base.errors import ShapeError, UsageError, user_location
from taut.base.types import Array, ArrayLike, Float64Array
from taut.trace.array import Traced, traced_array
from taut.trace.scalar import Symbol

__all__ = ["Gain", "GainValue", "Memory"]


class GainValue(np.lib.mixins.NDArrayOperatorsMixin):
    """A gain as law code sees it: `self.kp @ e` is right for a scalar, one per joint, and a matrix.

    A scalar k acts as k I, a vector as diag(k). `*` multiplies entry by entry and is refused for a matrix.
    """

    __slots__ = ("_values", "name")
    __array_priority__ = 2000.0
    answers_ufuncs: ClassVar[bool] = True

    def __init__(self, values: Any, name: str) -> None:
        # A symbol alone becomes an array without dimensions, so that every gain has a shape.
        self._values = traced_array(values) if isinstance(values, Symbol) else np.asanyarray(values)
        self.name = name

    # ---------------------------------------------------------------- as numbers

    @property
    def ndim(self) -> int:
        """0, 1 or 2."""
        return self._values.ndim

    @property
    def shape(self) -> tuple[int, ...]:
        """(), (n,) or (n, n)."""
        return tuple(self._values.shape)

    @property
    def T(self) -> GainValue:
        """Transpose."""
        return GainValue(self._values.T, self.name)

    def as_array(self) -> Array:
        """The bare numbers."""
        return self._values

    def matrix(self, n: int) -> Array:
        """(n, n): k I, diag(k), or the matrix itself."""
        return self._values if self.ndim == 2 else np.eye(n) * self._values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self._values, dtype=dtype) if copy else np.asarray(self._values, dtype=dtype)

    def __float__(self) -> float:
        return float(self._values[()])

    def __bool__(self) -> bool:
        return bool(self._values[()] if self.ndim == 0 else self._values)

    def __getitem__(self, index: Any) -> Any:
        return self._values[index]

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        if self._values.dtype == object:
            return f"<traced gain {self.name}>"
        return repr(float(self)) if self.ndim == 0 else repr(self._values.tolist())

    __hash__ = None  # type: ignore[assignment]  # compared by value, like an array

    # ---------------------------------------------------------------- acting

    def __matmul__(self, other: Any) -> Any:
        mapped = getattr(other, "mapped", None)
        if mapped is not None:
            return mapped(self._apply)
        if isinstance(other, GainValue):
            if self.ndim < 2 and other.ndim < 2:
                return GainValue(self._values * other._values, self.name)
            n = max(self._size(), other._size())
            return GainValue(self.matrix(n) @ other.matrix(n), self.name)
        return self._apply(other)

    def __rmatmul__(self, other: Any) -> Any:
        if self.ndim == 2:
            return np.asanyarray(other) @ self._values
        return other * self._values

    def _size(self) -> int:
        return self.shape[0] if self.ndim else 1

    def _apply(self, x: Any) -> Any:
        x = x if isinstance(x, Traced) else np.asanyarray(x)
        if self.ndim and x.ndim and x.shape[0] != self.shape[0]:
            raise ShapeError(
                f"{self.name} has {self.shape[0]} entries and is applied to {x.shape[0]} at {user_location()}",
                name=self.name,
            )
        if self.ndim == 2:
            return self._values @ x
        if self.ndim == 1 and x.ndim == 2:
            return self._values[:, np.newaxis] * x
        return self._values * x

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or not isinstance(kwargs.get("out", (self,))[0], GainValue):
            return NotImplemented  # a gain as `out`, as in k *= 2, gives a new one
        if any(hasattr(x, "mapped") for x in inputs):  # named terms
            return NotImplemented
        if ufunc is np.matmul:
            left, right = inputs
            if isinstance(left, GainValue):
                return left.__matmul__(right)
            return self.__rmatmul__(left)
        gains = [x for x in inputs if isinstance(x, GainValue)]
        alike = all(isinstance(x, GainValue) or np.ndim(x) == 0 for x in inputs)
        if any(gain.ndim == 2 for gain in gains):
            scaling = ufunc in (np.multiply, np.divide, np.negative) and len(gains) == 1
            if not alike or not (scaling or ufunc in (np.add, np.subtract)):
                raise UsageError(
                    f"{self.name} is a matrix and np.{ufunc.__name__} works entry by entry, "
                    f"at {user_location()}; gains act by @: write {self.name} @ e",
                    name=self.name,
                )
            size = max(gain._size() for gain in gains)
            if ufunc in (np.add, np.subtract):
                inputs = tuple(x.matrix(size) if isinstance(x, GainValue) else x * np.eye(size) for x in inputs)
        result = ufunc(*(x._values if isinstance(x, GainValue) else x for x in inputs))
        return GainValue(np.asanyarray(result), self.name) if alike and _numeric(result) else result


def _numeric(result: Any) -> bool:
    return getattr(result, "dtype", np.dtype(np.float64)) != np.bool_


def _hashable(default: ArrayLike | None) -> Any:
    """A default as a dataclass takes it: lists and arrays as tuples."""
    if isinstance(default, np.ndarray):
        default = default.tolist()
    return tuple(_hashable(x) for x in default) if isinstance(default, (list, tuple)) else default


class Gain:
    """A field of a law that holds a gain: a run-time parameter, given by name, checked, kept.

    Args:
        default: Value where none is given; without it the gain must be given.
        minimum: The smallest allowed entry, 0 for a gain that must not be negative. A matrix must be symmetric
            positive semidefinite instead.
        maximum: The largest allowed entry, if there is one.
        size: Number of entries of a vector; the number of joints if left out, 3 for a gain on positions of the tool,
            0 for one number only. A name stands for what the law has under it, such as "dimensions".
        optional: Whether it may be left out altogether; then the law has no such gain (`law.gives("B")`).
        pairs: Whether (linear, angular) stands for six entries, three of each.
        scalar: Whether one number serves; of a gain with two units it does not.
        function: Whether a function may stand in its place, which the law evaluates; then it is no parameter.
        where: Another field of the law and the value it must have for this gain to have a meaning, such as
            ("anti_windup", "back-calculation"), a tuple of such values, or ... for any value but None; elsewhere it
            is no parameter, and must not be given.

    Shape: scalar, (size,), or (size, size). Applied with `@`.
    """

    __slots__ = (
        "_default",
        "function",
        "maximum",
        "minimum",
        "name",
        "optional",
        "owner",
        "pairs",
        "scalar",
        "size",
        "where",
    )

    def __init__(
        self,
        default: ArrayLike | None = None,
        *,
        minimum: float = 0.0,
        maximum: float = np.inf,
        size: int | str | None = None,
        where: tuple[str, Any] | None = None,
        optional: bool = False,
        pairs: bool = False,
        scalar: bool = True,
        function: bool = False,
    ) -> None:
        self._default = _hashable(default)
        self.minimum = minimum
        self.maximum = maximum
        self.size = size
        self.where = where
        self.optional = optional
        self.pairs = pairs
        self.scalar = scalar
        self.function = function
        self.name = ""
        self.owner: type | None = None

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        self.owner = owner

    @property
    def default(self) -> ArrayLike | None:
        """The value where none is given; None where one must be given, or may be left out altogether."""
        default: ArrayLike | None = self._default
        return default

    @overload
    def __get__(self, obj: None, owner: type) -> Self: ...
    @overload
    def __get__(self, obj: object, owner: type) -> GainValue: ...
    def __get__(self, obj: object | None, owner: type) -> Any:
        if obj is not None:
            return obj.__dict__[self.name]
        if self._default is None and not self.optional:  # how a dataclass learns that a field has no default
            raise AttributeError(self.name)
        return self._default

    def __set__(self, obj: object, value: ArrayLike | Callable[..., Any] | None) -> None:
        from taut.control.law import field_units

        if callable(value) or (value is None and self.optional):
            if callable(value) and not self.function:
                raise UsageError(f"{self.name} must be numbers; got a function", name=self.name)
            obj.__dict__[self.name] = value
            return
        unit = field_units(type(obj)).get(self.name, "")
        obj.__dict__[self.name] = GainValue(self.checked(value, unit), self.name)

    def has_meaning(self, law: object) -> bool:
        """Whether it is a gain of this law, with the fields that the law has."""
        if self.where is None:
            return True
        field, value = self.where
        given = getattr(law, field)
        if isinstance(value, tuple):
            return given in value
        return given is not None if value is ... else bool(given == value)

    def checked(
        self, value: ArrayLike | None, unit: str = "", name: str | None = None, entries: int | None = None
    ) -> Float64Array:
        """`value` as a gain; of `entries` entries, where that is known.

        Raises:
            ShapeError: Not a scalar, a vector or a square matrix.
            RangeError: NaN, infinite, below the minimum, above the maximum, or a matrix that is not positive
                semidefinite.
        """
        name = name or self.name
        given: Any = value.as_array() if isinstance(value, GainValue) else value
        array = finite_array(name, given, unit=unit)
        if array.ndim == 0 and not self.scalar:
            raise ShapeError(
                f"{name} needs one number for metres and one for radians, {name}=(linear, angular), or six, or (6, 6)"
                f"{f' [{unit}]' if unit else ''}; got {float(array):g} alone",
                name=name,
                value=float(array),
            )
        if self.size == 0 and array.ndim:
            raise ShapeError(
                f"{name} must be one number{f' [{unit}]' if unit else ''}; got shape {array.shape}", name=name
            )
        if self.pairs and array.shape == (2,) and entries == 6:  # of two coordinates it is one for each
            array = np.repeat(array, 3)
        if array.ndim > 2 or (array.ndim == 2 and array.shape[0] != array.shape[1]) or not array.size:
            raise ShapeError(
                f"{name} must be a scalar, (n,) or (n, n){f' [{unit}]' if unit else ''}; got shape {array.shape}",
                name=name,
            )
        if array.ndim == 2 and self.minimum >= 0.0:
            symmetric_psd(name, array, unit=unit)
        elif array.ndim < 2:
            require_at_least(name, array, self.minimum, unit=unit)
        if self.maximum < np.inf:
            require_at_most(name, array, self.maximum, unit=unit)
        return array


class Memory:
    """A field of a law that is remembered from tick to tick; it states the value at the start.

    A scalar takes the shape that `command` returns. What starts from the measured state comes from the law's
    optional `start(self, x, ref)` instead.
    """

    __slots__ = ("_initial", "name")

    def __init__(self, initial: ArrayLike = 0.0) -> None:
        self._initial = _hashable(initial)
        self.name = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, obj: None, owner: type) -> Self: ...
    @overload
    def __get__(self, obj: object, owner: type) -> Float64Array: ...
    def __get__(self, obj: object | None, owner: type) -> Any:
        return self._initial if obj is None else obj.__dict__[self.name]

    def __set__(self, obj: object, value: ArrayLike) -> None:
        obj.__dict__[self.name] = finite_array(self.name, value)
