"""Scalar: a number that is not known yet. What law code computes with while it is traced."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, NoReturn

import numpy as np

from taut.base.errors import TautError, TraceError, user_location
from taut.trace.graph import Graph, Op

_ACTIVE: Final = threading.local()

SQRT, SIN, COS, ASIN, ACOS = (int(op) for op in (Op.SQRT, Op.SIN, Op.COS, Op.ASIN, Op.ACOS))
EXP, LOG, TANH, ABS, FLOOR = (int(op) for op in (Op.EXP, Op.LOG, Op.TANH, Op.ABS, Op.FLOOR))
MIN, MAX, LT, LE, EQ = (int(op) for op in (Op.MIN, Op.MAX, Op.LT, Op.LE, Op.EQ))
AND, OR = int(Op.AND), int(Op.OR)


@contextmanager
def tracing(graph: Graph) -> Iterator[Graph]:
    """While this lasts, `taut.math.zeros` and its like give arrays that take symbols."""
    before = getattr(_ACTIVE, "graph", None)
    _ACTIVE.graph = graph
    try:
        yield graph
    finally:
        _ACTIVE.graph = before


def active_graph() -> Graph | None:
    """The graph that is being traced in this thread, if any."""
    return getattr(_ACTIVE, "graph", None)


def to_node(graph: Graph, x: Any) -> int:
    """The node of a symbol or of a plain number."""
    if isinstance(x, Symbol):
        if x.graph is not graph:
            raise TraceError(
                f"a value of another trace is used at {user_location()}; "
                "a law must not keep traced values from one compile to the next",
                rule="one trace",
            )
        return x.node
    if not isinstance(x, (str, bytes)):  # which float() would read
        try:
            return graph.const(float(x))
        except TautError:
            raise
        except (TypeError, ValueError, OverflowError):
            pass
    shown = f"{x!r}" if x is None or isinstance(x, (str, bytes, complex)) else f"a value of type {type(x).__name__}"
    raise TraceError(f"{shown} is used as a number at {user_location()}", value=x, rule="numbers only")


def to_symbol(graph: Graph, node: int, *, truth: bool = False) -> Any:
    """A node as law code sees it: a plain number or NumPy's truth value where it is known, else a symbol."""
    value = graph.value[node]
    if value is not None:
        return np.bool_(value) if truth else value  # of Python's own bool, ~True is -2
    return Condition(graph, node) if truth else Scalar(graph, node)


class Symbol:
    """What numbers and truth values have in common: a node, and what they refuse."""

    __slots__ = ("graph", "node")
    __array_priority__ = 1000.0

    def __init__(self, graph: Graph, node: int) -> None:
        self.graph = graph
        self.node = node

    def __float__(self) -> NoReturn:
        raise TraceError(
            f"a traced value is turned into a plain float at {user_location()}; while a law is traced its "
            "numbers are not known yet. Use taut.math.sin(x) instead of math.sin(x), leave out float(x), "
            "and make arrays that you assign into with taut.math.zeros(n) instead of np.zeros(n)",
            rule="no float()",
        )

    def __int__(self) -> NoReturn:
        raise TraceError(
            f"a traced value is turned into an integer at {user_location()}; "
            "use taut.math.floor(x), or a plain number that the law is made with",
            rule="no int()",
        )

    __index__ = __trunc__ = __int__

    def __round__(self, digits: int | None = None) -> NoReturn:
        raise TraceError(
            f"a traced value is rounded at {user_location()}; use taut.math.floor(x + 0.5)",
            rule="no round()",
        )

    def __format__(self, spec: str) -> str:
        return repr(self)

    def __bool__(self) -> NoReturn:
        raise TraceError(
            f"a traced value decides a branch at {user_location()} (if, while, and, or, min, max, sort, "
            "np.clip on a list); while a law is traced it is not known yet. Use taut.math.where(condition, "
            "a, b), taut.math.minimum or taut.math.clip; combine conditions with & | ~",
            rule="no bool()",
        )

    def __hash__(self) -> int:
        return hash((id(self.graph), self.node))

    def __copy__(self) -> Symbol:
        return self

    def __deepcopy__(self, memo: object) -> Symbol:
        return self

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        from taut.trace.array import apply_ufunc

        return apply_ufunc(ufunc, method, inputs, kwargs)

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        from taut.trace.array import apply_function

        return apply_function(func, args, kwargs)


def _number(x: Any) -> Any:
    return x.number() if isinstance(x, Condition) else x


def _foreign(other: object) -> bool:
    """Operands whose own operators should answer: arrays and everything that is no number."""
    return not isinstance(other, (float, int, np.floating, np.integer))


class Condition(Symbol):
    """A truth value that is not known yet. Combine with & | ~, use with `taut.math.where`."""

    __slots__ = ()

    def _logic(self, op: int, other: Any) -> Any:
        if isinstance(other, (bool, np.bool_)):
            node = self.graph.const(1.0 if other else 0.0)
        elif isinstance(other, Condition):
            node = to_node(self.graph, other)
        else:
            return NotImplemented
        return to_symbol(self.graph, self.graph.logic(op, self.node, node), truth=True)

    def __and__(self, other: Any) -> Any:
        return self._logic(AND, other)

    __rand__ = __and__

    def __or__(self, other: Any) -> Any:
        return self._logic(OR, other)

    __ror__ = __or__

    def __invert__(self) -> Any:
        return to_symbol(self.graph, self.graph.invert(self.node), truth=True)

    def __xor__(self, other: Any) -> Any:
        either = self | other
        return either if either is NotImplemented else either & ~(self & other)

    __rxor__ = __xor__

    def __eq__(self, other: Any) -> Any:
        if isinstance(other, (bool, np.bool_, Condition)):
            return ~(self ^ other)
        return NotImplemented if not isinstance(other, Scalar) and _foreign(other) else self.number() == other

    def __ne__(self, other: Any) -> Any:
        if isinstance(other, (bool, np.bool_, Condition)):
            return self ^ other
        return NotImplemented if not isinstance(other, Scalar) and _foreign(other) else self.number() != other

    __hash__ = Symbol.__hash__

    def number(self) -> Any:
        """1.0 where it holds, else 0.0."""
        g = self.graph
        return to_symbol(g, g.select(self.node, g.const(1.0), g.const(0.0)))

    def _no_truth(self, other: Any) -> None:
        """NumPy's sum of two truth values is a truth value, and a difference is none: neither is guessed here."""
        if isinstance(other, (bool, np.bool_, Condition)):
            raise TraceError(
                f"two conditions are added or subtracted at {user_location()}; combine them with & | ~, or make "
                "numbers of them with taut.math.where(condition, 1.0, 0.0)",
                rule="conditions are no numbers",
            )

    def __add__(self, other: Any) -> Any:
        self._no_truth(other)
        return self.number() + other

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        self._no_truth(other)
        return self.number() - other

    def __rsub__(self, other: Any) -> Any:
        self._no_truth(other)
        return other - self.number()

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, (bool, np.bool_, Condition)):
            return self & other
        return self.number() * other

    __rmul__ = __mul__

    def __repr__(self) -> str:
        return f"<traced condition {self.node}>"


def _arithmetic(operate: Callable[[Graph, int, int], int], neutral: float) -> Callable[[Scalar, Any], Any]:
    """An operator of traced values, under which `neutral` as the second operand changes nothing."""

    def apply(x: Scalar, other: Any) -> Any:
        g = x.graph
        if type(other) is Scalar and other.graph is g:  # nearly always
            node = operate(g, x.node, other.node)
        elif type(other) is float:
            if other == neutral:
                return x
            node = operate(g, x.node, g.const(other))
        elif isinstance(other, Symbol) or not _foreign(other):
            node = operate(g, x.node, _operand(g, other))
        else:
            return NotImplemented
        value = g.value[node]
        return Scalar(g, node) if value is None else value

    return apply


def _reflected(operate: Callable[[Graph, int, int], int]) -> Callable[[Scalar, Any], Any]:
    """The same operator after a plain number."""

    def apply(x: Scalar, number: Any) -> Any:
        if _foreign(number):
            return NotImplemented
        g = x.graph
        return to_symbol(g, operate(g, _operand(g, number), x.node))

    return apply


def _comparison(op: int, *, swapped: bool = False) -> Callable[[Scalar, Any], Any]:
    """x op other, or other op x if `swapped`."""

    def apply(x: Scalar, other: Any) -> Any:
        if not isinstance(other, Scalar) and _foreign(other):
            return NotImplemented
        g = x.graph
        a, b = x.node, _operand(g, other)
        return to_symbol(g, g.compare(op, b, a) if swapped else g.compare(op, a, b), truth=True)

    return apply


def _function(op: int) -> Callable[[Scalar], Any]:
    """A function of one number."""

    def apply(x: Scalar) -> Any:
        return to_symbol(x.graph, x.graph.unary(op, x.node))

    return apply


class Scalar(Symbol):
    """A number that is not known yet. Arithmetic on it adds nodes to its graph."""

    __slots__ = ()

    __add__ = __radd__ = _arithmetic(Graph.add, 0.0)
    __sub__ = _arithmetic(Graph.sub, 0.0)
    __rsub__ = _reflected(Graph.sub)
    __mul__ = __rmul__ = _arithmetic(Graph.mul, 1.0)
    __truediv__ = _arithmetic(Graph.div, 1.0)
    __rtruediv__ = _reflected(Graph.div)

    def __pow__(self, exponent: Any) -> Any:
        if isinstance(exponent, Symbol):
            return _traced_power(self, _number(exponent))
        if _foreign(exponent):
            return NotImplemented
        return _power(self, float(exponent))

    def __rpow__(self, base: Any) -> Any:
        if _foreign(base):
            return NotImplemented
        if not base > 0.0:
            raise TraceError(
                f"{float(base)!r} is raised to a traced power at {user_location()}; the base must be > 0",
                value=base,
                rule="base > 0",
            )
        return np.exp(self * math.log(base))

    def __neg__(self) -> Any:
        return to_symbol(self.graph, self.graph.neg(self.node))

    def __pos__(self) -> Scalar:
        return self

    def __floordiv__(self, other: Any) -> Any:
        return np.floor(self / other)

    def __rfloordiv__(self, other: Any) -> Any:
        return np.floor(other / self)

    def __mod__(self, other: Any) -> Any:
        return self - other * np.floor(self / other)

    def __rmod__(self, other: Any) -> Any:
        return other - self * np.floor(other / self)

    __lt__ = _comparison(LT)
    __le__ = _comparison(LE)
    __gt__ = _comparison(LT, swapped=True)
    __ge__ = _comparison(LE, swapped=True)
    __eq__ = _comparison(EQ)

    def __ne__(self, other: Any) -> Any:
        equal = self.__eq__(other)
        return NotImplemented if equal is NotImplemented else ~equal

    __hash__ = Symbol.__hash__
    __abs__ = _function(ABS)

    # NumPy calls these by name on the entries of an object array.

    sqrt = _function(SQRT)
    sin = _function(SIN)
    cos = _function(COS)
    arcsin = _function(ASIN)
    arccos = _function(ACOS)
    exp = _function(EXP)
    log = _function(LOG)
    tanh = _function(TANH)
    floor = __floor__ = _function(FLOOR)

    def tan(self) -> Any:
        return self.sin() / self.cos()

    def arctan(self) -> Any:
        return self.arctan2(1.0)

    def arctan2(self, x: Any) -> Any:
        g = self.graph
        return to_symbol(g, g.atan2(self.node, _operand(g, x)))

    def ceil(self) -> Any:
        return -(-self).floor()

    __ceil__ = ceil

    def conjugate(self) -> Scalar:
        return self

    def __repr__(self) -> str:
        return f"<traced value {self.node}>"


def _operand(graph: Graph, x: Any) -> int:
    if isinstance(x, Scalar) and x.graph is graph:  # nearly always
        return x.node
    return to_node(graph, _number(x))


def _traced_power(x: Scalar, y: Scalar) -> Any:
    """x**y for an exponent that is not known: exp(y log |x|), with the sign that whole exponents give."""
    g, half = x.graph, 0.5 * y
    whole, odd, negative = y.floor() == y, half.floor() != half, x < 0.0

    def select(condition: Condition, a: Any, b: Any) -> Any:
        return to_symbol(g, g.select(to_node(g, condition), to_node(g, a), to_node(g, b)))

    size = (y * select(whole, abs(x), x).log()).exp()  # NaN of a negative x and a fraction, as in NumPy
    signed = select(whole & odd & negative, -size, size)
    return select(y == 0.0, 1.0, signed)


def _power(x: Scalar, exponent: float) -> Any:
    """x**k: products for whole k, times a square root for halves, else exp(k log x), for x >= 0."""
    if exponent < 0.0:
        return 1.0 / _power(x, -exponent)
    whole, half = divmod(exponent, 1.0)
    if half in (0.0, 0.5):
        result: Any = x.sqrt() if half else 1.0
        square: Any = x
        k = int(whole)
        while k:
            if k & 1:
                result = result * square
            square, k = square * square if k > 1 else square, k >> 1
        return result
    return (x.log() * exponent).exp()
