"""Traced: NumPy arrays of symbols, so that law code reads as NumPy code and nothing wrong passes in silence.

An object array alone would answer NaN, broadcast a matrix gain or fail with a foreign text; here each ufunc
and function either has a traced meaning or is refused in words.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from taut.base.errors import TraceError, user_location
from taut.base.graph import Op
from taut.base.scalar import Condition, Scalar, Symbol, to_node, to_symbol

__all__ = ["Traced", "apply_function", "apply_ufunc", "has_symbols", "select_one", "traced_array", "where"]

MIN, MAX, AND, OR = int(Op.MIN), int(Op.MAX), int(Op.AND), int(Op.OR)


class Traced(np.ndarray[Any, np.dtype[Any]]):
    """An array whose entries are symbols or plain floats."""

    __array_priority__ = 1000.0

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        return apply_ufunc(ufunc, method, inputs, kwargs)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        return apply_function(func, args, kwargs)

    def __reduce__(self) -> Any:
        raise TraceError("traced values cannot be pickled; they live as long as the trace")


def traced_array(x: Any) -> Traced:
    """`x` as an array of symbols; nested lists and object arrays too."""
    return np.asarray(x, dtype=object).view(Traced)


def has_symbols(x: Any) -> bool:
    """Whether an array, list or number holds a symbol."""
    if isinstance(x, (Symbol, Traced)):
        return True
    if isinstance(x, np.ndarray):
        return x.dtype == object and any(isinstance(entry, Symbol) for entry in x.flat)
    return isinstance(x, (list, tuple)) and any(has_symbols(entry) for entry in x)


def _bare(x: Any) -> Any:
    return x.view(np.ndarray) if isinstance(x, Traced) else x


def _wrap(x: Any) -> Any:
    if isinstance(x, np.ndarray) and x.dtype == object:
        return x.view(Traced) if x.ndim else x[()]
    if isinstance(x, (list, tuple)) and any(isinstance(item, np.ndarray) for item in x):
        return type(x)(_wrap(item) for item in x)
    return x


# -------------------------------------------------------------------- one entry at a time


def _graph_of(*values: Any) -> Any:
    for value in values:
        if isinstance(value, Symbol):
            return value.graph
    return None


def _number(x: Any) -> Any:
    return x.number() if isinstance(x, Condition) else x


def _method(name: str, plain: Callable[[float], float]) -> Callable[[Any], Any]:
    def one(x: Any) -> Any:
        x = _number(x)
        return getattr(x, name)() if isinstance(x, Scalar) else plain(x)

    return one


def _extremum(op: int, plain: Callable[[float, float], float]) -> Callable[[Any, Any], Any]:
    def one(a: Any, b: Any) -> Any:
        a, b = _number(a), _number(b)
        graph = _graph_of(a, b)
        if graph is None:
            return plain(a, b)
        return to_symbol(graph, graph.extremum(op, to_node(graph, a), to_node(graph, b)))

    return one


def _logic(op: int) -> Callable[[Any, Any], Any]:
    def one(a: Any, b: Any) -> Any:
        a, b = _truth(a), _truth(b)
        graph = _graph_of(a, b)
        if graph is None:
            return (a and b) if op == AND else (a or b)
        x, y = (v.node if isinstance(v, Symbol) else graph.const(float(v)) for v in (a, b))
        return to_symbol(graph, graph.logic(op, x, y), truth=True)

    return one


def _truth(x: Any) -> Any:
    if isinstance(x, (Condition, bool, np.bool_)):
        return x
    return x != 0.0


def select_one(condition: Any, a: Any, b: Any) -> Any:
    """a where the condition holds, else b; one entry."""
    condition, a, b = _truth(condition), _number(a), _number(b)
    if not isinstance(condition, Condition):
        return a if condition else b
    graph = condition.graph
    return to_symbol(graph, graph.select(condition.node, to_node(graph, a), to_node(graph, b)))


def _sign(x: Any) -> Any:
    x = _number(x)
    return select_one(x > 0.0, 1.0, select_one(x < 0.0, -1.0, 0.0))


def _absolute(x: Any) -> Any:
    return abs(_number(x))


def _power(x: Any, exponent: Any) -> Any:
    return _number(x) ** exponent


def _arctan2(y: Any, x: Any) -> Any:
    y, x = _number(y), _number(x)
    graph = _graph_of(y, x)
    if graph is None:
        return math.atan2(y, x)
    return to_symbol(graph, graph.atan2(to_node(graph, y), to_node(graph, x)))


def _hypot(x: Any, y: Any) -> Any:
    square = x * x + y * y
    return square.sqrt() if isinstance(square, Scalar) else math.sqrt(square)


def _clip(x: Any, low: Any, high: Any) -> Any:
    return minimum_one(high, maximum_one(low, x))


minimum_one = _extremum(MIN, lambda a, b: float(np.minimum(a, b)))
maximum_one = _extremum(MAX, lambda a, b: float(np.maximum(a, b)))

# Object loops of NumPy that call our operators and give the right answer by themselves.
_LOOPS: Final = frozenset(
    {
        np.add,
        np.subtract,
        np.multiply,
        np.divide,
        np.negative,
        np.positive,
        np.square,
        np.matmul,
        np.conjugate,
        np.vecdot,
        np.matvec,
        np.vecmat,
    }
)


def _entrywise(table: Mapping[np.ufunc, Callable[..., Any]]) -> dict[np.ufunc, Any]:
    return {ufunc: np.frompyfunc(one, ufunc.nin, 1) for ufunc, one in table.items()}


_ENTRYWISE: Final = _entrywise(
    {
        np.sin: _method("sin", math.sin),
        np.cos: _method("cos", math.cos),
        np.tan: _method("tan", math.tan),
        np.arcsin: _method("arcsin", math.asin),
        np.arccos: _method("arccos", math.acos),
        np.arctan: _method("arctan", math.atan),
        np.arctan2: _arctan2,
        np.exp: _method("exp", math.exp),
        np.log: _method("log", math.log),
        np.tanh: _method("tanh", math.tanh),
        np.sqrt: _method("sqrt", math.sqrt),
        np.floor: _method("floor", math.floor),
        np.ceil: lambda x: -_method("floor", math.floor)(-x),
        np.absolute: _absolute,
        np.fabs: _absolute,
        np.sign: _sign,
        np.minimum: minimum_one,
        np.maximum: maximum_one,
        np.power: _power,
        np.float_power: _power,
        np.hypot: _hypot,
        np.reciprocal: lambda x: 1.0 / x,
        np.remainder: lambda x, y: x % y,
        np.deg2rad: lambda x: x * (math.pi / 180.0),
        np.radians: lambda x: x * (math.pi / 180.0),
        np.rad2deg: lambda x: x * (180.0 / math.pi),
        np.degrees: lambda x: x * (180.0 / math.pi),
        np.heaviside: lambda x, y: select_one(x > 0.0, 1.0, select_one(x < 0.0, 0.0, y)),
        np.less: lambda a, b: a < b,
        np.less_equal: lambda a, b: a <= b,
        np.greater: lambda a, b: a > b,
        np.greater_equal: lambda a, b: a >= b,
        np.equal: lambda a, b: a == b,
        np.not_equal: lambda a, b: a != b,
        np.logical_and: _logic(AND),
        np.logical_or: _logic(OR),
        np.bitwise_and: _logic(AND),
        np.bitwise_or: _logic(OR),
        np.logical_not: lambda a: ~a if isinstance(a, Condition) else not a,
        np.invert: lambda a: ~a if isinstance(a, Condition) else not a,
    }
)
_CLIP: Final = np.frompyfunc(_clip, 3, 1)
_SELECT: Final = np.frompyfunc(select_one, 3, 1)


def apply_ufunc(ufunc: np.ufunc, method: str, inputs: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """A NumPy ufunc on symbols.

    Raises:
        TraceError: It has no traced meaning, or its result goes into an array of floats.
    """
    for x in inputs:  # a type with rules of its own (a gain, named terms) answers itself
        if getattr(x, "answers_ufuncs", False):
            return NotImplemented
    out = kwargs.pop("out", None)
    if out is not None and not (isinstance(out[0], Traced) and len(out) == 1):
        raise TraceError(
            f"a traced value is written into an array of floats at {user_location()}; "
            "make the array with taut.math.zeros(n), or write x = x + y instead of x += y",
            rule="no assignment into float arrays",
        )
    operands = [_lift(x) for x in inputs]
    if ufunc in _LOOPS:
        run = getattr(ufunc, method)
    elif ufunc in _ENTRYWISE:
        run = getattr(_ENTRYWISE[ufunc], method)
        if method in ("reduce", "accumulate"):
            kwargs = {"axis": kwargs.get("axis", 0)}
        else:
            kwargs = {}
    elif ufunc.__name__ == "clip" and method == "__call__":
        run, kwargs = _CLIP, {}
    else:
        raise _refused(f"np.{ufunc.__name__}")
    result = _wrap(run(*operands, **kwargs))
    if out is None:
        return result
    out[0][...] = result
    return out[0]


def _lift(x: Any) -> Any:
    """An operand as a bare array or a symbol in a 0-d object array."""
    if isinstance(x, Symbol):
        box = np.empty((), dtype=object)
        box[()] = x
        return box
    return _bare(x)


def _refused(what: str) -> TraceError:
    return TraceError(
        f"{what} cannot be traced; it is used at {user_location()}. taut.math has what law code may use, "
        "for floats and traced values alike",
        name=what,
        rule="traceable functions only",
    )


# -------------------------------------------------------------------- functions

# Functions that only move entries around, or that reach our operators by themselves.
_PASS: Final = frozenset(
    {
        np.append,
        np.array_split,
        np.atleast_1d,
        np.atleast_2d,
        np.block,
        np.broadcast_to,
        np.column_stack,
        np.concatenate,
        np.copy,
        np.cumsum,
        np.diag,
        np.diagflat,
        np.diagonal,
        np.dot,
        np.einsum,
        np.empty_like,
        np.expand_dims,
        np.flip,
        np.full_like,
        np.hstack,
        np.inner,
        np.kron,
        np.moveaxis,
        np.ndim,
        np.outer,
        np.prod,
        np.ravel,
        np.repeat,
        np.reshape,
        np.roll,
        np.shape,
        np.size,
        np.split,
        np.squeeze,
        np.stack,
        np.sum,
        np.swapaxes,
        np.tensordot,
        np.tile,
        np.trace,
        np.transpose,
        np.tril,
        np.triu,
        np.vdot,
        np.vstack,
        np.array_repr,
        np.array_str,
        np.array2string,
    }
)


def apply_function(func: Any, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
    """A NumPy function on symbols.

    Raises:
        TraceError: It has no traced meaning.
    """
    special = _functions().get(func)
    if special is not None:
        return special(*args, **kwargs)
    if func not in _PASS:
        raise _refused(_function_name(func))
    bare = [_strip(a) for a in args]
    return _wrap(func(*bare, **{k: _strip(v) for k, v in kwargs.items()}))


def _strip(x: Any) -> Any:
    if isinstance(x, (list, tuple)):
        return type(x)(_strip(item) for item in x)
    return _lift(x)


def _function_name(func: Any) -> str:
    module = getattr(func, "__module__", "numpy") or "numpy"
    prefix = "np.linalg" if "linalg" in module else "np"
    return f"{prefix}.{getattr(func, '__name__', func)}"


@functools.cache
def _functions() -> dict[Any, Callable[..., Any]]:
    from taut.base import math as tm

    def clip(a: Any, a_min: Any = None, a_max: Any = None, out: Any = None, **kw: Any) -> Any:
        low = kw.get("min", a_min)
        high = kw.get("max", a_max)
        if out is not None:
            raise _refused("np.clip with out=")
        return tm.clip(a, -math.inf if low is None else low, math.inf if high is None else high)

    def norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
        if ord not in (None, 2) or keepdims:
            raise _refused(f"np.linalg.norm with ord={ord!r}")
        return tm.norm(x, axis=axis)

    def mean(a: Any, axis: Any = None, **_: Any) -> Any:
        count = np.size(a) if axis is None else np.shape(a)[axis]
        return np.sum(a, axis=axis) / count

    def zeros_like(a: Any, **_: Any) -> Any:
        return tm.zeros(np.shape(a))

    def ones_like(a: Any, **_: Any) -> Any:
        return tm.ones(np.shape(a))

    return {
        np.where: where,
        np.clip: clip,
        np.linalg.norm: norm,
        np.linalg.solve: tm.solve,
        np.linalg.inv: tm.inverse,
        np.cross: tm.cross,
        np.mean: mean,
        np.zeros_like: zeros_like,
        np.ones_like: ones_like,
        np.max: lambda a, axis=None, **_: np.maximum.reduce(a, axis=axis),
        np.min: lambda a, axis=None, **_: np.minimum.reduce(a, axis=axis),
        np.amax: lambda a, axis=None, **_: np.maximum.reduce(a, axis=axis),
        np.amin: lambda a, axis=None, **_: np.minimum.reduce(a, axis=axis),
        np.any: lambda a, axis=None, **_: np.logical_or.reduce(a, axis=axis),
        np.all: lambda a, axis=None, **_: np.logical_and.reduce(a, axis=axis),
    }


def where(condition: Any, *branches: Any) -> Any:
    """np.where on symbols."""
    if len(branches) != 2:
        raise _refused("np.where with one argument")
    return _wrap(_SELECT(_lift(condition), *(_lift(x) for x in branches)))
