"""The graph: equal nodes are one, and folding what is known changes no value."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from base_tools import native_values
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from taut import math as tm
from taut.errors import TraceError
from taut.trace.graph import Graph, Op
from taut.trace.scalar import Condition, Scalar, to_node, to_symbol

LARGEST = (
    1e6  # intermediate results beyond it are left out, so that infinity and its rules stay out of random programs
)
DENORMAL = 2.0**-1074
ROUNDING = 1e-9  # native code may round a product and a sum once: up to 60 operations on numbers up to 1e6

SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.0, 3.0, 0.1, 1e-300, 1e5, math.pi]

ARITHMETIC: dict[str, tuple[int, Callable[..., Any]]] = {
    "add": (2, lambda a, b: a + b),
    "sub": (2, lambda a, b: a - b),
    "mul": (2, lambda a, b: a * b),
    "div": (2, lambda a, b: a / b),
    "neg": (1, lambda a: -a),
    "abs": (1, abs),
    "sqrt": (1, tm.sqrt),
    "floor": (1, tm.floor),
    "minimum": (2, tm.minimum),
    "maximum": (2, tm.maximum),
    "where <": (4, lambda a, b, c, d: tm.where(a < b, c, d)),
    "where <= and not": (4, lambda a, b, c, d: tm.where((a <= b) & np.logical_not(b == c), c, d)),
    "where == or >": (4, lambda a, b, c, d: tm.where((a == b) | (c > d), c, d)),
    "where != xor >=": (4, lambda a, b, c, d: tm.where((a != b) ^ (c >= d), c, d)),
    "condition as a number": (3, lambda a, b, c: (a < b) * c),
    "sign": (1, tm.sign),
    "product with itself": (1, lambda a: a * a),
}
FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "sin": (1, tm.sin),
    "cos": (1, tm.cos),
    "tan": (1, tm.tan),
    "asin": (1, tm.asin),
    "acos": (1, tm.acos),
    "atan2": (2, tm.atan2),
    "exp": (1, tm.exp),
    "log": (1, tm.log),
    "tanh": (1, tm.tanh),
    "square": (1, lambda a: a**2),
    "power 1.5": (1, lambda a: tm.abs(a) ** 1.5),
    "power 0.3": (1, lambda a: tm.abs(a) ** 0.3),
    "power -3": (1, lambda a: a**-3),
    "power 21": (1, lambda a: a**21),
    "modulo": (2, lambda a, b: a % b),
}
EVERYTHING = ARITHMETIC | FUNCTIONS

Step = tuple[str, tuple[int, ...]]


def random_program(table: dict[str, tuple[int, Callable[..., Any]]]) -> st.SearchStrategy[list[Step]]:
    """Operations by name, each with the places of its operands among what was computed before, counted from the end."""
    step = st.sampled_from(sorted(table)).flatmap(
        lambda name: st.tuples(st.just(name), st.tuples(*[st.integers(0, 11)] * table[name][0]))
    )
    return st.lists(step, min_size=1, max_size=60)


numbers = st.one_of(st.sampled_from(SPECIAL), st.floats(-10.0, 10.0))


def executed(
    steps: Sequence[Step],
    table: dict[str, tuple[int, Callable[..., Any]]],
    known: list[Any],
    finite: list[bool] | None,
) -> list[Any]:
    """Run a program on floats or on symbols.

    On floats, `finite` is filled with what gives an ordinary number; on symbols it says what to leave out.
    """
    record = finite is not None and not finite
    values = list(known)
    for k, (name, places) in enumerate(steps):
        operands = [values[-1 - place % len(values)] for place in places]
        if record:
            with np.errstate(all="ignore"):
                result = table[name][1](*(np.float64(x) for x in operands))
            good = bool(np.isfinite(result)) and abs(result) <= LARGEST
            finite.append(good)
            if good:
                values.append(result)
        elif finite[k]:
            values.append(table[name][1](*operands))
    return values


def traced(
    steps: Sequence[Step],
    table: dict[str, tuple[int, Callable[..., Any]]],
    inputs: Sequence[float],
    constants: Sequence[float],
) -> tuple[Graph, list[int], list[float]]:
    """The same program as a graph, and its results on floats."""
    finite: list[bool] = []
    expected = executed(steps, table, [*inputs, *constants], finite)
    graph = Graph()
    symbols = [Scalar(graph, graph.input()) for _ in inputs]
    results = executed(steps, table, [*symbols, *map(np.float64, constants)], finite)
    return (
        graph,
        [to_node(graph, tm.where(x, 1.0, 0.0) if isinstance(x, Condition) else x) for x in results],
        expected,
    )


@given(
    random_program(ARITHMETIC), st.lists(numbers, min_size=3, max_size=3), st.lists(numbers, min_size=3, max_size=3)
)
@settings(max_examples=300, derandomize=True)
def test_folding_keeps_every_value_to_the_last_bit(
    steps: list[Step], inputs: list[float], constants: list[float]
) -> None:
    graph, nodes, expected = traced(steps, ARITHMETIC, inputs, constants)
    assert graph.evaluate(nodes, inputs).tolist() == [float(x) for x in expected]


@given(
    random_program(EVERYTHING), st.lists(numbers, min_size=3, max_size=3), st.lists(numbers, min_size=3, max_size=3)
)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_native_code_gives_the_values_of_plain_python(
    steps: list[Step], inputs: list[float], constants: list[float]
) -> None:
    graph, nodes, expected = traced(steps, EVERYTHING, inputs, constants)
    nearby = graph.evaluate(nodes, [x * (1.0 + 1e-14) + 1e-14 for x in inputs])
    for got, wanted, moved in zip(native_values(graph, nodes, inputs), expected, nearby, strict=True):
        # One ulp of a sine may decide a later comparison: what jumps or explodes right beside the inputs is left out.
        if abs(moved - wanted) < ROUNDING * max(1.0, abs(wanted)):
            assert got == pytest.approx(wanted, rel=ROUNDING, abs=ROUNDING)


@given(
    random_program(ARITHMETIC), st.lists(numbers, min_size=3, max_size=3), st.lists(numbers, min_size=3, max_size=3)
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_what_decides_is_computed_natively_to_the_last_bit(
    steps: list[Step], inputs: list[float], constants: list[float]
) -> None:
    """A comparison, a floor or a square root sees the very numbers that Python computes: nothing before it is fused."""
    graph, nodes, expected = traced(steps, ARITHMETIC, inputs, constants)
    floors = [to_node(graph, tm.floor(to_symbol(graph, node))) for node in nodes]
    assert native_values(graph, floors, inputs).tolist() == [math.floor(x) for x in expected]


# -------------------------------------------------------------------- one rule at a time


def fresh(count: int = 2) -> tuple[Graph, list[int]]:
    graph = Graph()
    return graph, [graph.input() for _ in range(count)]


def test_equal_operations_are_one_node() -> None:
    graph, (x, y) = fresh()
    assert graph.add(x, y) == graph.add(y, x)
    assert graph.mul(x, y) == graph.mul(y, x)
    assert graph.sub(x, y) != graph.sub(y, x)
    assert graph.extremum(int(Op.MIN), x, y) == graph.extremum(int(Op.MIN), y, x)
    assert graph.unary(int(Op.SIN), x) == graph.unary(int(Op.SIN), x)


@pytest.mark.parametrize(
    ("rule", "left", "right"),
    [
        ("x + 0 = x", lambda g, x, y: g.add(x, g.const(0.0)), lambda g, x, y: x),
        ("0 + x = x", lambda g, x, y: g.add(g.const(0.0), x), lambda g, x, y: x),
        ("x + (-y) = x - y", lambda g, x, y: g.add(x, g.neg(y)), lambda g, x, y: g.sub(x, y)),
        ("(-x) + y = y - x", lambda g, x, y: g.add(g.neg(x), y), lambda g, x, y: g.sub(y, x)),
        ("(-x) + (-y) = -(x + y)", lambda g, x, y: g.add(g.neg(x), g.neg(y)), lambda g, x, y: g.neg(g.add(x, y))),
        ("x - 0 = x", lambda g, x, y: g.sub(x, g.const(0.0)), lambda g, x, y: x),
        ("0 - x = -x", lambda g, x, y: g.sub(g.const(0.0), x), lambda g, x, y: g.neg(x)),
        ("x - x = 0", lambda g, x, y: g.sub(x, x), lambda g, x, y: g.const(0.0)),
        ("x - (-y) = x + y", lambda g, x, y: g.sub(x, g.neg(y)), lambda g, x, y: g.add(x, y)),
        ("(-x) - y = -(x + y)", lambda g, x, y: g.sub(g.neg(x), y), lambda g, x, y: g.neg(g.add(x, y))),
        ("-(-x) = x", lambda g, x, y: g.neg(g.neg(x)), lambda g, x, y: x),
        ("-(x - y) = y - x", lambda g, x, y: g.neg(g.sub(x, y)), lambda g, x, y: g.sub(y, x)),
        ("0 x = 0", lambda g, x, y: g.mul(g.const(0.0), x), lambda g, x, y: g.const(0.0)),
        ("1 x = x", lambda g, x, y: g.mul(g.const(1.0), x), lambda g, x, y: x),
        ("-1 x = -x", lambda g, x, y: g.mul(x, g.const(-1.0)), lambda g, x, y: g.neg(x)),
        ("(-x) (-y) = x y", lambda g, x, y: g.mul(g.neg(x), g.neg(y)), lambda g, x, y: g.mul(x, y)),
        ("(-x) y = -(x y)", lambda g, x, y: g.mul(g.neg(x), y), lambda g, x, y: g.neg(g.mul(x, y))),
        ("(-x) 3 = x (-3)", lambda g, x, y: g.mul(g.neg(x), g.const(3.0)), lambda g, x, y: g.mul(x, g.const(-3.0))),
        ("x / 1 = x", lambda g, x, y: g.div(x, g.const(1.0)), lambda g, x, y: x),
        ("x / 4 = x 0.25", lambda g, x, y: g.div(x, g.const(4.0)), lambda g, x, y: g.mul(x, g.const(0.25))),
        ("0 / x = 0", lambda g, x, y: g.div(g.const(0.0), x), lambda g, x, y: g.const(0.0)),
        ("(-x) / y = -(x / y)", lambda g, x, y: g.div(g.neg(x), y), lambda g, x, y: g.neg(g.div(x, y))),
        ("|-x| = |x|", lambda g, x, y: g.unary(int(Op.ABS), g.neg(x)), lambda g, x, y: g.unary(int(Op.ABS), x)),
        (
            "||x|| = |x|",
            lambda g, x, y: g.unary(int(Op.ABS), g.unary(int(Op.ABS), x)),
            lambda g, x, y: g.unary(int(Op.ABS), x),
        ),
        ("min(x, x) = x", lambda g, x, y: g.extremum(int(Op.MIN), x, x), lambda g, x, y: x),
        ("min(x, inf) = x", lambda g, x, y: g.extremum(int(Op.MIN), x, g.const(math.inf)), lambda g, x, y: x),
        ("max(-inf, x) = x", lambda g, x, y: g.extremum(int(Op.MAX), g.const(-math.inf), x), lambda g, x, y: x),
        ("x if true else y", lambda g, x, y: g.select(g.const(1.0), x, y), lambda g, x, y: x),
        ("x if false else y", lambda g, x, y: g.select(g.const(0.0), x, y), lambda g, x, y: y),
        ("y if c else y", lambda g, x, y: g.select(g.compare(int(Op.LT), x, y), y, y), lambda g, x, y: y),
        (
            "not not c = c",
            lambda g, x, y: g.invert(g.invert(g.compare(int(Op.LT), x, y))),
            lambda g, x, y: g.compare(int(Op.LT), x, y),
        ),
        (
            "c and true = c",
            lambda g, x, y: g.logic(int(Op.AND), g.compare(int(Op.LT), x, y), g.const(1.0)),
            lambda g, x, y: g.compare(int(Op.LT), x, y),
        ),
        (
            "false and c = false",
            lambda g, x, y: g.logic(int(Op.AND), g.const(0.0), g.compare(int(Op.LT), x, y)),
            lambda g, x, y: g.const(0.0),
        ),
        (
            "c or true = true",
            lambda g, x, y: g.logic(int(Op.OR), g.compare(int(Op.LT), x, y), g.const(1.0)),
            lambda g, x, y: g.const(1.0),
        ),
        (
            "false or c = c",
            lambda g, x, y: g.logic(int(Op.OR), g.const(0.0), g.compare(int(Op.LT), x, y)),
            lambda g, x, y: g.compare(int(Op.LT), x, y),
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_known_is_folded(rule: str, left: Callable[..., int], right: Callable[..., int]) -> None:
    graph, (x, y) = fresh()
    assert left(graph, x, y) == right(graph, x, y)


@pytest.mark.parametrize("op", [Op.LT, Op.LE, Op.EQ])
@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (-0.0, 0.0), (math.inf, math.inf)])
def test_comparisons_of_constants_are_known(op: Op, a: float, b: float) -> None:
    graph = Graph()
    known = graph.value[graph.compare(int(op), graph.const(a), graph.const(b))]
    assert known == {Op.LT: a < b, Op.LE: a <= b, Op.EQ: a == b}[op]


def test_zero_has_no_sign_and_one_node() -> None:
    graph = Graph()
    assert graph.const(-0.0) == graph.const(0.0) == graph.const(0)
    assert math.copysign(1.0, graph.value[graph.const(-0.0)] or 0.0) == 1.0
    assert graph.const(True) == graph.const(1.0)


@pytest.mark.parametrize(
    "undefined",
    [
        lambda g: g.const(math.nan),
        lambda g: g.sub(g.const(math.inf), g.const(math.inf)),
        lambda g: g.add(g.const(math.inf), g.const(-math.inf)),
        lambda g: g.mul(g.const(0.0), g.const(math.inf)),
        lambda g: g.div(g.const(math.inf), g.const(math.inf)),
    ],
    ids=["nan", "inf - inf", "inf + -inf", "0 inf", "inf / inf"],
)
def test_a_constant_that_is_no_number_is_refused(undefined: Callable[[Graph], int]) -> None:
    with refused(TraceError):
        undefined(Graph())


def test_infinity_is_a_constant() -> None:
    graph, (x, y) = fresh()
    node = graph.extremum(int(Op.MIN), graph.add(x, graph.const(math.inf)), y)
    assert graph.evaluate([node], [1.0, 2.0]).tolist() == [2.0]


def test_dividing_by_a_constant_zero_is_refused() -> None:
    graph, (x, _) = fresh()
    for zero in (0.0, -0.0):
        with refused(TraceError):
            graph.div(x, graph.const(zero))


@pytest.mark.parametrize(
    ("op", "value"),
    [
        (Op.SQRT, -1.0),
        (Op.LOG, 0.0),
        (Op.ASIN, 1.5),
        (Op.ACOS, -2.0),
        (Op.SIN, math.inf),
        (Op.EXP, 1000.0),
        (Op.FLOOR, math.inf),
    ],
)
def test_a_function_of_a_constant_it_does_not_take_is_refused(op: Op, value: float) -> None:
    graph = Graph()
    with refused(TraceError):
        graph.unary(int(op), graph.const(value))


def test_dividing_by_the_smallest_number_is_no_product_with_infinity() -> None:
    graph, (x, _) = fresh()
    node = graph.div(x, graph.const(DENORMAL))
    assert graph.evaluate([node], [4.0 * DENORMAL, 0.0]).tolist() == [4.0]
    assert native_values(graph, [node], [4.0 * DENORMAL, 0.0]).tolist() == [4.0]


def test_a_quotient_of_equals_is_not_one_at_zero() -> None:
    graph, (x, _) = fresh()
    node = graph.div(x, x)
    assert np.isnan(graph.evaluate([node], [0.0, 0.0]))
    assert np.isnan(native_values(graph, [node], [0.0, 0.0]))


@pytest.mark.parametrize(
    ("op", "x", "wanted"),
    [
        (Op.SQRT, -1.0, math.nan),
        (Op.LOG, 0.0, -math.inf),
        (Op.LOG, -1.0, math.nan),
        (Op.ASIN, 2.0, math.nan),
        (Op.ACOS, 2.0, math.nan),
        (Op.EXP, 1000.0, math.inf),
        (Op.SIN, math.inf, math.nan),
        (Op.COS, -math.inf, math.nan),
        (Op.TANH, math.inf, 1.0),
        (Op.FLOOR, -math.inf, -math.inf),
        (Op.ABS, -math.inf, math.inf),
    ],
)
def test_evaluating_gives_what_is_not_finite_as_native_code_does(op: Op, x: float, wanted: float) -> None:
    graph, (node, _) = fresh()
    result = graph.unary(int(op), node)
    np.testing.assert_equal(graph.evaluate([result], [x, 0.0]), [wanted])
    np.testing.assert_equal(native_values(graph, [result], [x, 0.0]), [wanted])


@pytest.mark.parametrize("op", [Op.MIN, Op.MAX])
@pytest.mark.parametrize(("a", "b"), [(math.nan, 1.0), (1.0, math.nan), (math.nan, math.nan), (math.inf, math.nan)])
def test_the_smaller_and_larger_of_nan_is_nan(op: Op, a: float, b: float) -> None:
    graph, (x, y) = fresh()
    node = graph.extremum(int(op), x, y)
    assert np.isnan(graph.evaluate([node], [a, b]))
    assert np.isnan(native_values(graph, [node], [a, b]))


@pytest.mark.parametrize("op", [Op.LT, Op.LE, Op.EQ])
def test_no_comparison_with_nan_holds_and_its_opposite_does(op: Op) -> None:
    graph, (x, y) = fresh()
    condition = graph.compare(int(op), x, y)
    nodes = [graph.select(c, graph.const(1.0), graph.const(2.0)) for c in (condition, graph.invert(condition))]
    assert graph.evaluate(nodes, [math.nan, 1.0]).tolist() == [2.0, 1.0]
    assert native_values(graph, nodes, [math.nan, 1.0]).tolist() == [2.0, 1.0]


def test_only_what_the_outputs_need_is_live() -> None:
    graph, (x, y) = fresh()
    used, unused = graph.add(x, y), graph.mul(x, y)
    assert unused not in graph.live([used])
    assert graph.live([used]) == [x, y, used]


def test_a_placeholder_that_nobody_filled_is_refused() -> None:
    graph, (x, _) = fresh()
    node = graph.add(x, graph.placeholder())
    with refused(TraceError):
        graph.evaluate([node], [1.0, 2.0])


def test_symbols_of_two_graphs_do_not_mix() -> None:
    (one, (x, _)), (other, (y, _)) = fresh(), fresh()
    for mix in (lambda a, b: a + b, lambda a, b: b * a, lambda a, b: a < b, lambda a, b: tm.where(a > 0.0, b, 1.0)):
        with refused(TraceError):
            mix(Scalar(one, x), Scalar(other, y))


def test_two_threads_trace_at_the_same_time() -> None:
    from taut.trace.scalar import active_graph, tracing

    both, seen, errors = threading.Barrier(2), {}, []

    def trace(name: str) -> None:
        try:
            graph = Graph()
            with tracing(graph):
                both.wait(timeout=60.0)
                out = tm.zeros(2)  # a traced array in each thread, whatever the other does
                for _ in range(200):
                    out[0] = out[0] + Scalar(graph, graph.input())
                both.wait(timeout=60.0)
                seen[name] = (active_graph() is graph, to_node(graph, out[0]), len(graph))
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=trace, args=(name,)) for name in "ab"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert seen["a"] == seen["b"]
    assert seen["a"][0]
    assert active_graph() is None
