"""taut.math: what law code computes with, the same for floats and for traced values.

Arithmetic, `@`, slices and the usual NumPy functions (np.sin, np.clip, np.linalg.norm, ...) work on traced
arrays as they are. This module has what NumPy cannot know about: arrays to assign into, branches, solves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from taut.base.errors import ShapeError, user_location
from taut.base.types import Array, Matrix, Vector3
from taut.trace.array import Traced, has_symbols, traced_array
from taut.trace.array import where as _traced_where
from taut.trace.linalg import LTDL, factor_spd, solve_general
from taut.trace.scalar import Symbol, active_graph

__all__ = [
    "abs",
    "acos",
    "arange",
    "array",
    "asin",
    "atan2",
    "clip",
    "cos",
    "cross",
    "exp",
    "eye",
    "factor_spd",
    "floor",
    "full",
    "inverse",
    "inverse_spd",
    "jacobian",
    "log",
    "maximum",
    "minimum",
    "norm",
    "ones",
    "sign",
    "sin",
    "skew",
    "solve",
    "solve_spd",
    "sqrt",
    "stack",
    "tan",
    "tanh",
    "where",
    "zeros",
]

Shape = int | tuple[int, ...]


def _numbers(x: Any) -> Any:
    """Lists and object arrays with symbols become traced arrays, so that NumPy's functions know them."""
    if isinstance(x, (list, tuple)) or (isinstance(x, np.ndarray) and x.dtype == object):
        return array(x) if has_symbols(x) else np.asarray(x, dtype=np.float64)
    return x


def array(x: Any) -> Array:
    """An array of numbers, some of which may be traced: use it where NumPy code has np.array([a, b])."""
    if not has_symbols(x):
        return np.array(x, dtype=np.float64)
    return traced_array(x).copy() if isinstance(x, np.ndarray) else _rectangular(x)


def _rectangular(x: Any) -> Traced:
    """A list as an array of symbols; NumPy alone would make a ragged one an array of arrays."""
    out = traced_array(x)
    for k, entry in enumerate(out.flat):
        if isinstance(entry, (Symbol, float)):
            continue
        if isinstance(entry, NDArrayOperatorsMixin):  # a gain
            entry = out.flat[k] = np.asarray(entry)[()]
        if isinstance(entry, (np.ndarray, list, tuple)):
            raise ShapeError(f"the rows of an array have different lengths at {user_location()}")
    return out


def zeros(shape: Shape) -> Array:
    """Zeros that traced values can be assigned into."""
    return full(shape, 0.0)


def ones(shape: Shape) -> Array:
    """Ones that traced values can be assigned into."""
    return full(shape, 1.0)


def full(shape: Shape, value: Any) -> Array:
    """An array of one value that traced values can be assigned into."""
    if active_graph() is None and not has_symbols(value):
        return np.full(shape, value, dtype=np.float64)
    out = np.empty(shape, dtype=object)
    out[...] = np.asarray(value, dtype=object)
    return out.view(Traced)


def eye(n: int) -> Matrix:
    """The identity matrix, which traced values can be assigned into."""
    out = zeros((n, n))
    for i in range(n):
        out[i, i] = 1.0
    return out


def arange(n: int) -> Array:
    """0.0, 1.0, ..., n - 1."""
    return np.arange(float(n))


def stack(arrays: Sequence[Any]) -> Array:
    """Arrays or numbers as the rows of one array."""
    return array([np.asarray(a).tolist() if np.ndim(a) else a for a in arrays])


def where(condition: Any, a: Any, b: Any) -> Any:
    """a where the condition holds, else b. Both are computed: keep 1/0 and sqrt(-1) out of both."""
    if any(has_symbols(x) for x in (condition, a, b)):
        return _traced_where(_numbers(condition), _numbers(a), _numbers(b))
    return np.where(condition, a, b)[()]


def clip(x: Any, low: Any, high: Any) -> Any:
    """x held between low and high; NaN stays NaN."""
    return minimum(high, maximum(low, x))


def _entrywise(ufunc: np.ufunc, doc: str) -> Callable[..., Any]:
    """A function of NumPy that takes lists with symbols too."""

    def function(*numbers: Any) -> Any:
        return ufunc(*map(_numbers, numbers))

    function.__doc__ = doc
    return function


minimum = _entrywise(np.minimum, "The smaller of two, entry by entry; NaN stays NaN.")
maximum = _entrywise(np.maximum, "The larger of two, entry by entry; NaN stays NaN.")
sign = _entrywise(np.sign, "-1, 0 or 1.")
abs = _entrywise(np.absolute, "Absolute value.")
floor = _entrywise(np.floor, "The largest whole number that is not above x.")
sin = _entrywise(np.sin, "Sine.")
cos = _entrywise(np.cos, "Cosine.")
tan = _entrywise(np.tan, "Tangent.")
asin = _entrywise(np.arcsin, "Inverse sine [rad].")
acos = _entrywise(np.arccos, "Inverse cosine [rad].")
atan2 = _entrywise(np.arctan2, "Angle of the point (x, y) from y and x [rad].")
sqrt = _entrywise(np.sqrt, "Square root.")
exp = _entrywise(np.exp, "e to the power x.")
log = _entrywise(np.log, "Natural logarithm.")
tanh = _entrywise(np.tanh, "Hyperbolic tangent.")


def norm(x: Any, axis: int | None = None) -> Any:
    """Euclidean length."""
    x = _numbers(x)
    return np.sqrt(np.sum(x * x, axis=axis))


def cross(a: Any, b: Any) -> Vector3:
    """a x b for two vectors of three."""
    a0, a1, a2 = _three("cross", a)
    b0, b1, b2 = _three("cross", b)
    return _flat([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def _flat(entries: list[Any]) -> Vector3:
    """A vector of numbers and symbols that are known to be such: `array` without its looks at nested lists."""
    if any(isinstance(x, Symbol) for x in entries):
        return traced_array(entries)
    return np.array(entries, dtype=np.float64)


def _three(what: str, a: Any) -> list[Any]:
    entries = list(a)
    if len(entries) != 3 or isinstance(entries[0], np.ndarray):
        raise ShapeError(f"{what} takes vectors (3,); got shape {np.shape(a)} at {user_location()}")
    return entries


def skew(a: Any) -> Matrix:
    """The matrix [a] with [a] b = a x b."""
    x, y, z = _three("skew", a)
    return array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _mapped(solve_one: Callable[[Any], Any], b: Any) -> Any:
    """A linear map on an array, or on named terms, which know how to be mapped."""
    mapped = getattr(b, "mapped", None)
    return solve_one(b) if mapped is None else mapped(solve_one)


def solve_spd(A: Any, b: Any) -> Any:
    """x in A x = b for a symmetric positive definite A; b may be a vector, a matrix or named terms."""
    factors = A if isinstance(A, LTDL) else factor_spd(A)
    return _mapped(factors.solve, b)


def solve(A: Any, b: Any) -> Any:
    """x in A x = b for any regular A; b may be a vector, a matrix or named terms."""
    return _mapped(lambda x: solve_general(A, x), b)


def inverse_spd(A: Any) -> Matrix:
    """The inverse of a symmetric positive definite matrix."""
    return factor_spd(A).solve(np.eye(np.shape(A)[0]))


def jacobian(function: Callable[[Array], Any], x: Any) -> Matrix:
    """The derivative (..., n) of a function of a vector (n,), exact; on floats or while a law is traced."""
    from taut.trace.derivative import jacobian as derivative

    return derivative(function, x)


def inverse(A: Any) -> Matrix:
    """The inverse of a regular matrix; solve(A, b) is cheaper and more accurate."""
    return solve_general(A, np.eye(np.shape(A)[0]))
