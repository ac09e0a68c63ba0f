"""Distributions of what a sweep varies: a number for each sample, from one between 0 and 1."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.checks import finite_array, read_only
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array

SMALLEST: Final = 2.0**-54  # of the numbers between 0 and 1: no sample is farther out than 8.3 standard deviations


class Distribution(ABC):
    """A distribution of a parameter. Made by `taut.uniform`, `taut.log_uniform`, `taut.normal` or `taut.choice`."""

    @property
    @abstractmethod
    def shape(self) -> tuple[int, ...]:
        """Of one sample."""

    @abstractmethod
    def at(self, u: Float64Array) -> Float64Array:
        """(k, ...) samples, of (k, ...) numbers between 0 and 1."""

    @abstractmethod
    def ends(self) -> list[Float64Array]:
        """Samples at the ends of what can be drawn: where they are valid, all are."""


@dataclass(frozen=True, eq=False)
class _Between(Distribution):
    """Uniform between two ends, of a number or of its logarithm."""

    low: Float64Array
    high: Float64Array
    logarithmic: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        return self.low.shape

    def at(self, u: Float64Array) -> Float64Array:
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** u)
        return np.asarray(self.low + (self.high - self.low) * u)

    def ends(self) -> list[Float64Array]:
        return [self.low, self.high]

    def __repr__(self) -> str:
        name = "log_uniform" if self.logarithmic else "uniform"
        return f"{name}({self.low.tolist()}, {self.high.tolist()})"


@dataclass(frozen=True, eq=False)
class _Normal(Distribution):
    mean: Float64Array
    std: Float64Array
    low: Float64Array
    high: Float64Array

    @property
    def shape(self) -> tuple[int, ...]:
        return self.mean.shape

    def at(self, u: Float64Array) -> Float64Array:
        from scipy.special import ndtr, ndtri

        first, last = (ndtr((end - self.mean) / self.std) for end in (self.low, self.high))
        inside = np.clip(first + (last - first) * u, SMALLEST, 1.0 - 2.0 * SMALLEST)
        return np.asarray(np.clip(self.mean + self.std * ndtri(inside), self.low, self.high))

    def ends(self) -> list[Float64Array]:
        return [self.at(np.full(self.shape, u)) for u in (0.0, 1.0)]

    def __repr__(self) -> str:
        numbers = (self.mean, self.std, self.low, self.high)
        return "normal({}, {}, low={}, high={})".format(*(number.tolist() for number in numbers))


@dataclass(frozen=True, eq=False)
class _Choice(Distribution):
    values: Float64Array  # (m, ...)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.values.shape[1:]

    def at(self, u: Float64Array) -> Float64Array:
        first = u.reshape(len(u), -1)[:, 0]  # one choice for all entries
        return np.asarray(self.values[np.minimum((first * len(self.values)).astype(int), len(self.values) - 1)])

    def ends(self) -> list[Float64Array]:
        return list(self.values)

    def __repr__(self) -> str:
        return f"choice({self.values.tolist()})"


def uniform(low: ArrayLike, high: ArrayLike) -> Distribution:
    """Numbers that are equally likely from `low` to `high`, to vary a parameter in `taut.sweep`.

    Args:
        low: A number, drawn once for all entries of the parameter; or an array, with a draw for each entry.
        high: Above `low`.

    Raises:
        RangeError: Not low < high.
        ShapeError: Two different shapes.

    Example:
        >>> import taut
        >>> taut.uniform(0.0, 3.0)
        uniform(0.0, 3.0)
    """
    return _Between(*_ends("uniform", low, high))


def log_uniform(low: ArrayLike, high: ArrayLike) -> Distribution:
    """Numbers whose logarithm is equally likely from that of `low` to that of `high`; otherwise as `uniform`."""
    ends = _ends("log_uniform", low, high)
    if np.any(ends[0] <= 0.0):
        raise RangeError(f"low of log_uniform must be > 0; got {ends[0].min():g}", name="low", rule="> 0")
    return _Between(*ends, logarithmic=True)


def normal(mean: ArrayLike, std: ArrayLike, *, low: ArrayLike = -np.inf, high: ArrayLike = np.inf) -> Distribution:
    """Normal numbers, within `low` and `high` where these are given, to vary a parameter in `taut.sweep`.

    Without ends, a number is at most 8.3 standard deviations from the mean; a parameter that must not be negative
    needs `low` where that reaches below zero.

    Args:
        mean: A number, or an array whose entries are drawn each by itself.
        std: Standard deviation, > 0.
        low: Smallest number, below `high`.
        high: Largest number.

    Raises:
        RangeError: A standard deviation that is not positive, or not low < high.
        ShapeError: Different shapes.

    Example:
        >>> import taut
        >>> taut.normal(1.0, 0.3, low=0.0)
        normal(1.0, 0.3, low=0.0, high=inf)
    """
    given = [finite_array("mean", mean), finite_array("std", std)]
    given += [np.asarray(end, dtype=np.float64) for end in (low, high)]
    try:
        center, spread, first, last = (read_only(np.array(x)) for x in np.broadcast_arrays(*given))
    except ValueError as cause:
        shapes = ", ".join(str(x.shape) for x in given)
        raise ShapeError(
            f"mean, std, low and high of normal must have one shape; got {shapes}", name="std"
        ) from cause
    if not np.all(spread > 0.0):
        raise RangeError(f"std of normal must be > 0; got {spread.min():g}", name="std", rule="> 0")
    if not np.all(first < last):
        raise RangeError(f"normal needs low < high; got {first.tolist()} and {last.tolist()}", name="low")
    return _Normal(center, spread, first, last)


def choice(values: Sequence[ArrayLike]) -> Distribution:
    """One of some values, each equally likely, to vary a parameter in `taut.sweep`.

    Args:
        values: One at least; numbers, or arrays of one shape.

    Example:
        >>> import taut
        >>> taut.choice([0.0, 0.5, 2.0])
        choice([0.0, 0.5, 2.0])
    """
    numbers = finite_array("values", np.asarray(values, dtype=np.float64))
    if numbers.ndim == 0 or not len(numbers):
        raise UsageError(f"choice needs a list of one value at least; got {values!r}", name="values")
    return _Choice(read_only(numbers))


def _ends(name: str, low: ArrayLike, high: ArrayLike) -> tuple[Float64Array, Float64Array]:
    first, last = finite_array("low", low), finite_array("high", high)
    if first.shape != last.shape:
        raise ShapeError(
            f"low and high of {name} must have one shape; got {first.shape} and {last.shape}", name="high"
        )
    if not np.all(first < last):
        raise RangeError(f"{name} needs low < high; got {first.tolist()} and {last.tolist()}", name="low")
    return read_only(first), read_only(last)
