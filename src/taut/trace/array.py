"""Traced: NumPy arrays of symbols, so that law code reads as NumPy code.

Each ufunc and function has a traced meaning or is refused; an object array alone would answer NaN, or broadcast.
"""

from __future__ import annotations

import functools
import inspect
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from taut.base.errors import TraceError, user_location
from taut.trace.graph import Op
from taut.trace.scalar import Condition, Scalar, Symbol, to_node, to_symbol

MIN, MAX = int(Op.MIN), int(Op.MAX)


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
    if isinstance(x, float):  # most are, and a trace asks a million times
        return False
    if isinstance(x, (Symbol, Traced)):
        return True
    if isinstance(x, np.ndarray):
        return x.dtype.hasobject and any(isinstance(entry, Symbol) for entry in x.flat)
    if isinstance(x, NDArrayOperatorsMixin):  # a gain
        return has_symbols(np.asarray(x))
    return isinstance(x, (list, tuple)) and any(has_symbols(entry) for entry in x)


def _bare(x: Any) -> Any:
    return x.view(np.ndarray) if isinstance(x, Traced) else x


def _wrap(x: Any) -> Any:
    if isinstance(x, np.ndarray) and x.dtype == object:
        return x.view(Traced) if x.ndim else x[()]
    if isinstance(x, (list, tuple)) and any(isinstance(item, np.ndarray) for item in x):
        return type(x)(_wrap(item) for item in x)
    return x


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
        return getattr(x, name)() if isinstance(x, Scalar) else _known(name, plain, x)

    return one


def _known(name: str, plain: Callable[..., float], *numbers: float) -> float:
    """A function of plain numbers; what NumPy gives NaN for is refused, as everywhere in a trace."""
    try:
        return float(plain(*numbers))
    except (ValueError, OverflowError) as cause:
        shown = ", ".join(repr(float(x)) for x in numbers)
        raise TraceError(
            f"the law takes {name}({shown}) at {user_location()}, which is no number", rule="no NaN"
        ) from cause


def _extremum(op: int, plain: Callable[[float, float], float]) -> Callable[[Any, Any], Any]:
    def one(a: Any, b: Any) -> Any:
        a, b = _number(a), _number(b)
        graph = _graph_of(a, b)
        if graph is None:
            return plain(a, b)
        return to_symbol(graph, graph.extremum(op, to_node(graph, a), to_node(graph, b)))

    return one


def _logic(combine: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def one(a: Any, b: Any) -> Any:
        a, b = _truth(a), _truth(b)
        truth = combine(b, a) if isinstance(b, Symbol) else combine(a, b)  # a symbol's operator, not NumPy's
        return truth if isinstance(truth, Symbol) else np.bool_(truth)

    return one


def _truth(x: Any) -> Any:
    if isinstance(x, (Condition, bool, np.bool_)):
        return x
    return x != 0.0


def _comparison(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def one(a: Any, b: Any) -> Any:
        truth = compare(a, b)
        return truth if isinstance(truth, Symbol) else np.bool_(truth)  # of Python's own bool, ~True is -2

    return one


def _logical_not(x: Any) -> Any:
    x = _truth(x)
    return ~x if isinstance(x, Condition) else np.bool_(not x)


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
    x, exponent = _number(x), _number(exponent)
    if isinstance(x, Symbol) or isinstance(exponent, Symbol):
        return x**exponent
    return _known("power", math.pow, x, exponent)


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
    }
)


def _vectorised(one: Callable[..., Any], count: int) -> Any:
    return np.frompyfunc(one, count, 1, identity=None)  # no identity, and entries may be taken in any order


def _entrywise(table: Mapping[np.ufunc, Callable[..., Any]]) -> dict[np.ufunc, Any]:
    return {ufunc: _vectorised(one, ufunc.nin) for ufunc, one in table.items()}


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
        np.ceil: _method("ceil", math.ceil),
        np.absolute: _absolute,
        np.sign: _sign,
        np.minimum: minimum_one,
        np.maximum: maximum_one,
        np.power: _power,
        np.hypot: _hypot,
        np.remainder: lambda x, y: _number(x) % _number(y),
        np.floor_divide: lambda x, y: _number(x) // _number(y),
        np.deg2rad: lambda x: x * (math.pi / 180.0),
        np.radians: lambda x: x * (math.pi / 180.0),
        np.rad2deg: lambda x: x * (180.0 / math.pi),
        np.degrees: lambda x: x * (180.0 / math.pi),
        np.less: _comparison(operator.lt),
        np.less_equal: _comparison(operator.le),
        np.greater: _comparison(operator.gt),
        np.greater_equal: _comparison(operator.ge),
        np.equal: _comparison(operator.eq),
        np.not_equal: _comparison(operator.ne),
        np.logical_and: _logic(operator.and_),
        np.logical_or: _logic(operator.or_),
        np.bitwise_and: _logic(operator.and_),
        np.bitwise_or: _logic(operator.or_),
        np.bitwise_xor: _logic(operator.xor),
        np.logical_not: _logical_not,
        np.invert: _logical_not,
    }
)
_LOGICAL: Final = frozenset({np.logical_and, np.logical_or})
_CLIP: Final = _vectorised(_clip, 3)
_SELECT: Final = _vectorised(select_one, 3)
_TRUTH: Final = _vectorised(_truth, 1)
_NUMBER: Final = _vectorised(_number, 1)
_OPTIONS: Final[Mapping[str, frozenset[str]]] = {
    "__call__": frozenset(),
    "outer": frozenset(),
    "reduce": frozenset({"axis", "keepdims", "initial"}),
    "accumulate": frozenset({"axis"}),
}


def apply_ufunc(ufunc: np.ufunc, method: str, inputs: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """A NumPy ufunc on symbols; TraceError where it has no traced meaning, or writes into floats."""
    for x in inputs:  # a type with rules of its own (a gain, named terms) answers itself
        if getattr(x, "answers_ufuncs", False):
            return NotImplemented
    run = _CLIP if ufunc.__name__ == "clip" else _ENTRYWISE.get(ufunc, ufunc)
    if run is ufunc and ufunc not in _LOOPS:
        raise _refused(f"np.{ufunc.__name__}")
    if method == "__call__" and not kwargs:  # nearly always
        return _wrap(run(*[_lift(x) for x in inputs]))
    out = kwargs.pop("out", None)
    if out is not None:
        _check_out(out)
    result = _with_options(run, ufunc, method, [_lift(x) for x in inputs], kwargs)
    if out is None:
        return result
    out[0][...] = result
    return out[0]


def _with_options(run: Any, ufunc: np.ufunc, method: str, operands: list[Any], given: Mapping[str, Any]) -> Any:
    """A method of a ufunc, or a call with options."""
    what = f"np.{ufunc.__name__}"
    if method not in _OPTIONS:
        raise _refused(f"{what}.{method}")
    options = _options(what, given, _OPTIONS[method])
    if method in ("reduce", "accumulate"):
        operands = [_lift((_TRUTH if ufunc in _LOGICAL else _NUMBER)(operands[0]))]
    return _wrap(getattr(run, method)(*operands, **options))


def _check_out(out: tuple[Any, ...]) -> None:
    if len(out) != 1 or not isinstance(out[0], Traced):
        raise TraceError(
            f"a traced value is written into an array of floats at {user_location()}; "
            "make the array with taut.math.zeros(n), or write x = x + y instead of x += y",
            rule="no assignment into float arrays",
        )
    if not out[0].flags.writeable:
        raise TraceError(
            f"what a law is given is changed in place at {user_location()}; "
            "write x = x + y instead of x += y, or change a copy: q = x.q.copy()",
            rule="inputs are read-only",
        )


def _options(what: str, given: Mapping[str, Any], traced: frozenset[str]) -> dict[str, Any]:
    """The options that have a traced meaning; those that change nothing are dropped, others refused."""
    kept: dict[str, Any] = {}
    for name, value in given.items():
        if name in traced:
            kept[name] = value
        elif not _changes_nothing(name, value):
            raise _refused(f"{what} with {name}=")
    return kept


def _changes_nothing(name: str, value: Any) -> bool:
    if name == "dtype":
        return value in (None, bool, float, object)
    return name in ("casting", "order", "subok") or (value is True if name == "where" else not value)


def _lift(x: Any) -> Any:
    """An operand as a bare array or a symbol in a 0-d object array."""
    if isinstance(x, Symbol):
        box = np.empty((), dtype=object)
        box[()] = x
        return box
    if isinstance(x, NDArrayOperatorsMixin):  # a gain
        return np.asarray(x)
    return _bare(x)


def _refused(what: str) -> TraceError:
    return TraceError(
        f"{what} cannot be traced; it is used at {user_location()}. taut.math has what law code may use, "
        "for floats and traced values alike",
        name=what,
        rule="traceable functions only",
    )


# Functions that only move entries around, or that reach our operators by themselves.
_PASS: Final = frozenset(
    {
        np.append,
        np.atleast_1d,
        np.atleast_2d,
        np.block,
        np.broadcast_to,
        np.column_stack,
        np.concatenate,
        np.copy,
        np.diag,
        np.diagonal,
        np.diff,
        np.dot,
        np.einsum,
        np.expand_dims,
        np.flip,
        np.full_like,
        np.hstack,
        np.inner,
        np.moveaxis,
        np.ndim,
        np.outer,
        np.ravel,
        np.repeat,
        np.reshape,
        np.roll,
        np.shape,
        np.size,
        np.split,
        np.squeeze,
        np.stack,
        np.swapaxes,
        np.take,
        np.tile,
        np.trace,
        np.transpose,
        np.vstack,
        np.array_repr,
        np.array_str,
        np.array2string,
    }
)


_STACKING: Final = frozenset({np.stack, np.hstack, np.vstack, np.column_stack})


def apply_function(func: Any, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
    """A NumPy function on symbols; TraceError where it has no traced meaning."""
    special = _functions().get(func)
    if special is not None:
        run, signature = special
        try:
            signature.bind(*args, **kwargs)
        except TypeError as cause:
            unknown = [f"{name}=" for name in kwargs if name not in signature.parameters]
            which = f" with {', '.join(unknown)}" if unknown else " with these arguments"
            raise _refused(_function_name(func) + which) from cause
        return run(*args, **kwargs)
    if func not in _PASS:
        raise _refused(_function_name(func))
    strip = _stripped_blocks if func is np.block else _stripped
    if func in _STACKING and isinstance(args[0], np.ndarray):  # NumPy takes its entries or rows one by one
        args = (list(args[0]), *args[1:])
    return _wrap(func(*(strip(x) for x in args), **{name: strip(x) for name, x in kwargs.items()}))


def _stripped(x: Any) -> Any:
    """An argument without our types: an array, or a list of arrays, each of which may be given as a list."""
    if not isinstance(x, (list, tuple)):
        return _lift(x)
    return type(x)(np.asarray(row, dtype=object) if _is_row(row) else _lift(row) for row in x)


def _is_row(x: Any) -> bool:
    return isinstance(x, (list, tuple)) and has_symbols(x)


def _stripped_blocks(x: Any) -> Any:
    return [_stripped_blocks(item) for item in x] if isinstance(x, list) else _lift(x)


def _function_name(func: Any) -> str:
    module = getattr(func, "__module__", "numpy") or "numpy"
    prefix = "np.linalg" if "linalg" in module else "np"
    return f"{prefix}.{getattr(func, '__name__', func)}"


def _reduction(ufunc: np.ufunc) -> Callable[..., Any]:
    def reduce(a: Any, axis: Any = None, *, keepdims: bool = False) -> Any:
        return ufunc.reduce(traced_array(a), axis=axis, keepdims=keepdims)

    return reduce


def _like(a: Any, dtype: Any, value: float) -> Traced:
    if not _changes_nothing("dtype", dtype):
        raise _refused(f"an array of type {np.dtype(dtype).name}")
    return traced_array(np.full(np.shape(a), value))


@functools.cache
def _functions() -> dict[Any, tuple[Callable[..., Any], inspect.Signature]]:
    from taut.trace import math as tm

    def clip(a: Any, a_min: Any = None, a_max: Any = None, *, min: Any = None, max: Any = None) -> Any:
        low = a_min if min is None else min
        high = a_max if max is None else max
        return tm.clip(a, -math.inf if low is None else low, math.inf if high is None else high)

    def norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
        vectors = np.ndim(x) == 1 or isinstance(axis, int)
        if not (ord is None or (ord == 2 and vectors) or (ord == "fro" and not vectors)):
            raise _refused(f"np.linalg.norm with ord={ord!r}")
        x = traced_array(x)
        return np.sqrt(np.sum(x * x, axis=axis, keepdims=keepdims))

    def cross(a: Any, b: Any) -> Any:
        if np.shape(a) != (3,) or np.shape(b) != (3,):
            raise _refused(f"np.cross of shapes {np.shape(a)} and {np.shape(b)}")
        return tm.cross(a, b)

    def mean(a: Any, axis: Any = None, *, keepdims: bool = False) -> Any:
        total = np.sum(a, axis=axis, keepdims=keepdims)
        return total / (np.size(a) / np.size(total))

    def cumsum(a: Any, axis: int | None = None) -> Any:
        return np.add.accumulate(np.ravel(a) if axis is None else a, axis=axis or 0)

    table: dict[Any, Callable[..., Any]] = {
        np.where: where,
        np.clip: clip,
        np.linalg.norm: norm,
        np.linalg.solve: lambda a, b: tm.solve(a, b),
        np.linalg.inv: lambda a: tm.inverse(a),
        np.cross: cross,
        np.sum: _reduction(np.add),
        np.prod: _reduction(np.multiply),
        np.mean: mean,
        np.cumsum: cumsum,
        np.max: _reduction(np.maximum),
        np.min: _reduction(np.minimum),
        np.any: _reduction(np.logical_or),
        np.all: _reduction(np.logical_and),
        np.zeros_like: lambda a, dtype=None: _like(a, dtype, 0.0),
        np.empty_like: lambda a, dtype=None: _like(a, dtype, 0.0),
        np.ones_like: lambda a, dtype=None: _like(a, dtype, 1.0),
    }
    return {function: (run, inspect.signature(run)) for function, run in table.items()}


def where(condition: Any, x: Any, y: Any) -> Any:
    """np.where on symbols."""
    return _wrap(_SELECT(_lift(condition), _lift(x), _lift(y)))
