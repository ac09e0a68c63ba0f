"""Distributions of what a sweep varies: a number for each sample, from one between 0 and 1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np

from taut.base.checks import finite_array, read_only
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array

SMALLEST: Final = 2.0**-54  # of the numbers between 0 and 1: no sample is farther out than 8.3 standard deviations


@dataclass(frozen=True, eq=False)
class Distribution:
    """A distribution of a parameter. Made by `taut.uniform`, `taut.log_uniform`, `taut.normal` or `taut.choice`."""

    text: str
    shape: tuple[int, ...]  # of one sample
    at: Callable[[Float64Array], Float64Array]
    """(k, ...) samples, of (k, ...) numbers between 0 and 1."""
    tried: Sequence[float] = (0.0, 1.0)  # of these numbers: where what they give is valid, all is

    def ends(self) -> list[Float64Array]:
        """Samples at the ends of what can be drawn."""
        return [self.at(np.full((1, *self.shape), u))[0] for u in self.tried]

    def __repr__(self) -> str:
        return self.text


def _between(u: Float64Array, low: Any, high: Any) -> Float64Array:
    return np.asarray(low * (1.0 - u) + high * u)


def _log_between(u: Float64Array, low: Any, high: Any) -> Float64Array:
    return np.asarray(np.clip(low * (high / low) ** u, low, high))


def _normal(u: Float64Array, mean: Any, std: Any, low: Any, high: Any) -> Float64Array:
    from scipy.special import ndtr, ndtri

    first, last = (ndtr((end - mean) / std) for end in (low, high))
    inside = np.clip(first + (last - first) * u, SMALLEST, 1.0 - 2.0 * SMALLEST)
    return np.asarray(np.clip(mean + std * ndtri(inside), low, high))


def _chosen(u: Float64Array, values: Any) -> Float64Array:
    first = u.reshape(len(u), -1)[:, 0]  # one choice for all entries
    return np.asarray(values[np.minimum((first * len(values)).astype(int), len(values) - 1)])


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
    first, last = _ends("uniform", low, high)
    return Distribution(_text("uniform", first, last), first.shape, partial(_between, low=first, high=last))


def log_uniform(low: ArrayLike, high: ArrayLike) -> Distribution:
    """Numbers whose logarithm is equally likely from that of `low` to that of `high`; otherwise as `uniform`."""
    first, last = _ends("log_uniform", low, high)
    if np.any(first <= 0.0):
        raise RangeError(f"low of log_uniform must be > 0; got {first.min():g}", name="low", rule="> 0")
    return Distribution(_text("log_uniform", first, last), first.shape, partial(_log_between, low=first, high=last))


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
    text = _text("normal", center, spread, low=first, high=last)
    return Distribution(text, center.shape, partial(_normal, mean=center, std=spread, low=first, high=last))


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
    middles = (np.arange(len(numbers)) + 0.5) / len(numbers)
    return Distribution(
        _text("choice", numbers), numbers.shape[1:], partial(_chosen, values=read_only(numbers)), middles.tolist()
    )  # fmt: skip


def _text(name: str, *numbers: Float64Array, **named: Float64Array) -> str:
    texts = [repr(x.tolist()) for x in numbers] + [f"{word}={x.tolist()}" for word, x in named.items()]
    return f"{name}({', '.join(texts)})"


def _ends(name: str, low: ArrayLike, high: ArrayLike) -> tuple[Float64Array, Float64Array]:
    first, last = finite_array("low", low), finite_array("high", high)
    if first.shape != last.shape:
        raise ShapeError(
            f"low and high of {name} must have one shape; got {first.shape} and {last.shape}", name="high"
        )
    if not np.all(first < last):
        raise RangeError(f"{name} needs low < high; got {first.tolist()} and {last.tolist()}", name="low")
    return read_only(first), read_only(last)
