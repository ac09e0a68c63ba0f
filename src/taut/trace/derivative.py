"""Derivatives: a forward-mode transform of the graph, one rule for each operation; they are nodes like any others.

Source: Griewank and Walther, Evaluating Derivatives (2008), chapter 3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from taut.base.errors import ShapeError
from taut.base.types import Array, Matrix
from taut.trace.array import has_symbols, traced_array
from taut.trace.graph import BOOLEAN_OPS, LARGEST, Graph, Op
from taut.trace.scalar import Condition, Scalar, active_graph, to_node, to_symbol, tracing


def tangents(graph: Graph, outputs: Sequence[int], seeds: Mapping[int, int], *, means: bool = False) -> list[int]:
    """Nodes of the directional derivatives of `outputs`; `seeds` has that of each independent node. The graph grows.

    With `means`, infinite slopes at a constant argument count as 0: |x| at x = 0 has the mean of both sides' slopes.
    """
    zero = graph.const(0.0)
    known: dict[int, int] = dict(seeds)
    for i in graph.live(outputs):
        if i not in known:
            slope = _tangent(graph, i, known, zero)
            if means and slope != zero and graph.ops[i] in _STEEP:  # zero where the argument does not change
                slope = graph.select(graph.compare(int(Op.EQ), known[graph.a[i]], zero), zero, slope)
            known[i] = slope
    return [known[i] for i in outputs]


def _tangent(g: Graph, i: int, known: Mapping[int, int], zero: int) -> int:
    op, operands = Op(g.ops[i]), g.operands(i)
    if op == Op.FLOOR or op in BOOLEAN_OPS or all(known[x] == zero for x in operands):
        return zero
    if op == Op.SELECT:
        condition, a, b = operands
        return g.select(condition, known[a], known[b])
    a, da = operands[0], known[operands[0]]
    if op in _CHAIN:
        return g.mul(_CHAIN[op](g, a, i), da)
    if op == Op.NEG:
        return g.neg(da)
    if op == Op.ABS:
        return g.select(g.compare(int(Op.LT), a, zero), g.neg(da), da)
    b, db = operands[1], known[operands[1]]
    if op in (Op.MIN, Op.MAX):
        less = g.compare(int(Op.LT), a, b)
        return g.select(less, da, db) if op == Op.MIN else g.select(less, db, da)
    if op == Op.ADD:
        return g.add(da, db)
    if op == Op.SUB:
        return g.sub(da, db)
    if op == Op.MUL:
        return g.add(g.mul(da, b), g.mul(a, db))
    if op == Op.DIV:  # y = a / b: dy = (da - y db) / b
        return g.div(g.sub(da, g.mul(i, db)), b)
    assert op == Op.ATAN2, op  # y = atan2(a, b): dy = (b da - a db) / (a^2 + b^2)
    return g.div(g.sub(g.mul(b, da), g.mul(a, db)), g.add(g.mul(a, a), g.mul(b, b)))


def adjoints(graph: Graph, outputs: Sequence[int], weights: Sequence[int], wanted: Sequence[int]) -> list[int]:
    """Nodes of the derivative of sum(weight output) by each node of `wanted`. The graph grows.

    In reverse mode, so that all of them together cost two to five times the function. Infinite slopes at a constant
    argument count as 0; what a branch that is not taken would give, finite or not, does not count.
    """
    zero, one, depends = graph.const(0.0), graph.const(1.0), set(wanted)
    live, wild = graph.live(outputs), set[int]()  # wild: infinite at some finite arguments, or made of such a node
    for i in live:
        operands = graph.operands(i)
        if not depends.isdisjoint(operands) and graph.ops[i] not in BOOLEAN_OPS:
            depends.add(i)
        if graph.ops[i] in _WILD or not wild.isdisjoint(operands):
            wild.add(i)
    total: dict[int, int] = {}
    for i, weight in zip(outputs, weights, strict=True):
        total[i] = graph.add(total.get(i, zero), weight)
    for i in reversed(live):
        weight, operands = total.get(i, zero), graph.operands(i)
        for x in dict.fromkeys(operands) if i in depends and weight != zero else ():
            if x not in depends:
                continue
            slope = _tangent(graph, i, {y: one if y == x else zero for y in operands}, zero)
            if graph.ops[i] in _STEEP:
                finite = graph.compare(int(Op.LE), graph.unary(int(Op.ABS), slope), graph.const(LARGEST))
                slope = graph.select(finite, slope, zero)
            part = graph.mul(weight, slope)
            if i in wild and graph.value[slope] is None:
                part = graph.select(graph.compare(int(Op.EQ), weight, zero), zero, part)
            total[x] = graph.add(total.get(x, zero), part)
    return [total.get(i, zero) for i in wanted]


def _inverse_root(g: Graph, a: int) -> int:
    """1 / sqrt(1 - a^2)."""
    one = g.const(1.0)
    return g.div(one, g.unary(int(Op.SQRT), g.sub(one, g.mul(a, a))))


# The derivative of a function of one number, from its argument and its value.
_CHAIN: Final[dict[Op, Callable[[Graph, int, int], int]]] = {
    Op.SQRT: lambda g, _, y: g.div(g.const(0.5), y),
    Op.SIN: lambda g, x, _: g.unary(int(Op.COS), x),
    Op.COS: lambda g, x, _: g.neg(g.unary(int(Op.SIN), x)),
    Op.ASIN: lambda g, x, _: _inverse_root(g, x),
    Op.ACOS: lambda g, x, _: g.neg(_inverse_root(g, x)),
    Op.EXP: lambda _g, _x, y: y,
    Op.LOG: lambda g, x, _: g.div(g.const(1.0), x),
    Op.TANH: lambda g, _, y: g.sub(g.const(1.0), g.mul(y, y)),
}

_STEEP: Final = frozenset({int(Op.SQRT), int(Op.ASIN), int(Op.ACOS)})  # infinite slopes at the ends of what they take
_WILD: Final = frozenset({*_STEEP, int(Op.DIV), int(Op.LOG), int(Op.EXP), int(Op.ATAN2)})


def jacobian(function: Callable[[Array], Any], x: Any) -> Matrix:
    """The derivative of a function of a vector, exact, on floats or while a law is traced.

    Args:
        function: Takes (n,) and gives a number or an array.
        x: (n,) where to differentiate.

    Returns:
        (..., n) the derivative of each entry of the result along each entry of x. Where there is none, as of
        norm at 0, it is NaN or infinite; at a non-smooth point it is the derivative of one side.

    Example:
        >>> from taut import math
        >>> jacobian(lambda x: math.array([x[0] * x[1], math.sin(x[0])]), [0.0, 2.0]).tolist()
        [[2.0, 0.0], [1.0, 0.0]]
    """
    at = traced_array(x) if has_symbols(x) else np.asarray(x, dtype=np.float64)
    if at.ndim != 1:
        raise ShapeError(f"jacobian differentiates along a vector (n,); got shape {at.shape}")
    graph = active_graph()
    if graph is None:
        return _on_floats(function, at)
    # Fresh nodes stand for x meanwhile, so that only the function's own dependence on x is differentiated.
    marks = [graph.placeholder() for _ in at]
    shape, columns = _columns(graph, function, marks)
    values = {mark: to_node(graph, entry) for mark, entry in zip(marks, at, strict=True)}
    flat = [node for column in columns for node in column]
    rows = traced_array([to_symbol(graph, node) for node in _substituted(graph, flat, values)])
    return np.moveaxis(rows.reshape((len(at), *shape)), 0, -1)


def _on_floats(function: Callable[[Array], Any], at: Array) -> Matrix:
    graph = Graph()
    with tracing(graph):
        marks = [graph.input() for _ in at]
        shape, columns = _columns(graph, function, marks)
    flat = [node for column in columns for node in column]
    values = graph.evaluate(flat, at.tolist())
    return np.moveaxis(values.reshape((len(at), *shape)), 0, -1)


def _columns(
    graph: Graph, function: Callable[[Array], Any], marks: Sequence[int]
) -> tuple[tuple[int, ...], list[list[int]]]:
    """Shape of the function's result, and its derivative along each mark."""
    placeholders = graph.n_placeholders
    result = np.asarray(function(traced_array([Scalar(graph, mark) for mark in marks])), dtype=object)
    nodes = [to_node(graph, y.number() if isinstance(y, Condition) else y) for y in result.ravel()]
    graph.check_closed(graph.live(nodes), placeholders)
    one = graph.const(1.0)
    return result.shape, [tangents(graph, nodes, {mark: one}) for mark in marks]


def _substituted(graph: Graph, nodes: Sequence[int], values: Mapping[int, int]) -> list[int]:
    """The same expressions with other nodes in the place of some."""
    new: dict[int, int] = dict(values)
    for i in graph.live(nodes):
        if i in new:
            continue
        operands = graph.operands(i)
        moved = tuple(new[x] for x in operands)
        new[i] = i if moved == operands else graph.operate(graph.ops[i], *moved)
    return [new[i] for i in nodes]
