"""Derivatives: every rule against central differences and CasADi, at ordinary and at special points."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from base_tools import native_values, traced_value
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from taut import math as tm
from taut.errors import ShapeError, TraceError
from taut.trace.derivative import adjoints, jacobian
from taut.trace.graph import Graph
from taut.trace.scalar import Scalar, to_node, tracing

STEP = 1e-6
DIFFERENCES = 2e-8  # central differences: STEP^2 of truncation, 1e-16 / STEP of rounding, times values of a few
EXACT = 1e-13  # the same formula in another order
NEAR_THE_END = 1e-6  # of asin and acos, where the derivative is 700 and more

# A function, the same in CasADi, and ordinary points.
RULES: dict[str, tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]] = {
    "add": (lambda x, y: x + y, lambda x, y: x + y),
    "sub": (lambda x, y: x - y, lambda x, y: x - y),
    "mul": (lambda x, y: x * y, lambda x, y: x * y),
    "div": (lambda x, y: x / y, lambda x, y: x / y),
    "neg": (lambda x, y: -x, lambda x, y: -x),
    "sqrt": (lambda x, y: tm.sqrt(2.0 + x), lambda x, y: ca.sqrt(2.0 + x)),
    "sin": (lambda x, y: tm.sin(x * y), lambda x, y: ca.sin(x * y)),
    "cos": (lambda x, y: tm.cos(x * y), lambda x, y: ca.cos(x * y)),
    "tan": (lambda x, y: tm.tan(x), lambda x, y: ca.tan(x)),
    "asin": (lambda x, y: tm.asin(x * y), lambda x, y: ca.asin(x * y)),
    "acos": (lambda x, y: tm.acos(x * y), lambda x, y: ca.acos(x * y)),
    "atan2": (lambda x, y: tm.atan2(x, y), lambda x, y: ca.atan2(x, y)),
    "atan": (lambda x, y: np.arctan(x), lambda x, y: ca.atan(x)),
    "exp": (lambda x, y: tm.exp(x - y), lambda x, y: ca.exp(x - y)),
    "log": (lambda x, y: tm.log(2.0 + x), lambda x, y: ca.log(2.0 + x)),
    "tanh": (lambda x, y: tm.tanh(x * y), lambda x, y: ca.tanh(x * y)),
    "abs": (lambda x, y: tm.abs(x), lambda x, y: ca.fabs(x)),
    "floor": (lambda x, y: x * tm.floor(y), lambda x, y: x * ca.floor(y)),
    "min": (lambda x, y: tm.minimum(x, y), lambda x, y: ca.fmin(x, y)),
    "max": (lambda x, y: tm.maximum(x, y), lambda x, y: ca.fmax(x, y)),
    "select": (lambda x, y: tm.where(x < y, x * x, y), lambda x, y: ca.if_else(x < y, x * x, y)),
    "sign": (lambda x, y: x * tm.sign(y), lambda x, y: x * ca.sign(y)),
    "power": (lambda x, y: x**3 - y**-2, lambda x, y: x**3 - y**-2),
    "broken power": (lambda x, y: (2.0 + x) ** 1.7, lambda x, y: (2.0 + x) ** 1.7),
    "power of a power": (lambda x, y: (2.0 + x) ** y, lambda x, y: (2.0 + x) ** y),
    "modulo": (lambda x, y: (7.0 * x) % 1.3, lambda x, y: 7.0 * x - 1.3 * ca.floor(7.0 * x / 1.3)),
    "hypot": (lambda x, y: np.hypot(x, y), lambda x, y: ca.hypot(x, y)),
    "all together": (
        lambda x, y: tm.sin(x) * tm.exp(y) / (2.0 + tm.tanh(x * y)),
        lambda x, y: ca.sin(x) * ca.exp(y) / (2.0 + ca.tanh(x * y)),
    ),
}
POINTS = [(0.3, -0.8), (-0.6, 0.9), (-1.1, -0.4), (0.7, 0.2)]


def function_of(rule: str) -> Callable[[Any], Any]:
    return lambda x: RULES[rule][0](x[0], x[1])


def by_casadi(rule: str, point: tuple[float, float]) -> tuple[Any, Any]:
    """Gradient and Hessian."""
    x = ca.SX.sym("x", 2)
    y = RULES[rule][1](x[0], x[1])
    hessian, gradient = ca.hessian(y, x)
    values = ca.Function("d", [x], [gradient, hessian])(point)
    return np.array(values[0]).ravel(), np.array(values[1])


def by_differences(function: Callable[[Any], Any], point: Any) -> Any:
    columns = []
    for k in range(len(point)):
        step = np.zeros(len(point))
        step[k] = STEP
        columns.append((np.asarray(function(point + step)) - np.asarray(function(point - step))) / (2.0 * STEP))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("rule", RULES)
def test_every_rule_agrees_with_casadi_and_with_differences(rule: str) -> None:
    for point in POINTS:
        gradient, hessian = by_casadi(rule, point)
        got = jacobian(function_of(rule), point)
        np.testing.assert_allclose(got, gradient, rtol=EXACT, atol=EXACT)
        np.testing.assert_allclose(
            got, by_differences(function_of(rule), np.array(point)), rtol=0.0, atol=DIFFERENCES
        )
        second = jacobian(lambda x: jacobian(function_of(rule), x), point)
        np.testing.assert_allclose(second, hessian, rtol=10.0 * EXACT, atol=10.0 * EXACT)


def reverse(function: Callable[[Any], Any], point: Any, weights: Any = (1.0,)) -> Any:
    """The derivative of weights @ function, in reverse mode."""
    graph = Graph()
    with tracing(graph):
        marks = [graph.input() for _ in point]
        results = np.atleast_1d(np.asarray(function(tm.array([Scalar(graph, mark) for mark in marks])), dtype=object))
        nodes = [to_node(graph, y) for y in results]
        found = adjoints(graph, nodes, [graph.const(w) for w in weights], marks)
    return graph.evaluate(found, list(point))


@pytest.mark.parametrize("rule", RULES)
def test_reverse_mode_agrees_with_forward_mode(rule: str) -> None:
    for point in POINTS:
        forward = jacobian(function_of(rule), point)
        np.testing.assert_allclose(reverse(function_of(rule), point), forward, rtol=EXACT, atol=EXACT)


def several(x: Any) -> Any:
    """Results that share nodes, with each other and with themselves; one is a constant, one an argument."""
    a, b = tm.sin(x[0] * x[1]), x[1] / (1.0 + x[2] * x[2])
    y = tm.where(a > b, a * a - b, tm.sqrt(2.0 + b) * a)
    return tm.array([y, y + a, y, a * y * a, 3.0, x[2], tm.maximum(a, x[2]) - x[0]])


def test_reverse_mode_adds_up_what_results_share() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        point, weights = rng.uniform(-1.0, 1.0, 3), rng.standard_normal(7)
        forward = weights @ jacobian(several, point)
        np.testing.assert_allclose(reverse(several, point, weights), forward, rtol=1e-12, atol=1e-12)


BRANCHES: dict[str, tuple[Callable[[Any], Any], list[float], list[float]]] = {
    "the length of nothing": (lambda x: tm.sqrt(x[0] * x[0] + x[1] * x[1]), [0.0, 0.0], [0.0, 0.0]),
    "a root that is not taken": (lambda x: tm.where(x[0] > 0.0, x[1] * tm.sqrt(x[0]), x[0]), [-1.0, 2.0], [1.0, 0.0]),
    "a quotient that is not taken": (
        lambda x: tm.where(x[0] == 0.0, x[1], x[1] * (x[1] / x[0]) * tm.exp(x[1] / x[0])), [0.0, 2.0], [0.0, 1.0],
    ),
    "an end of the arc": (lambda x: tm.asin(x[0]) * x[1], [1.0, 2.0], [0.0, 0.5 * math.pi]),
    "a logarithm that is not taken": (lambda x: tm.where(x[0] > 0.0, tm.log(x[0]), 3.0 * x[1]), [0.0, 1.0], [0.0, 3.0]),
}  # fmt: skip


@pytest.mark.parametrize("what", BRANCHES)
def test_reverse_mode_takes_nothing_from_what_is_not_taken_or_infinite(what: str) -> None:
    function, point, wanted = BRANCHES[what]
    np.testing.assert_array_equal(reverse(function, point), wanted)


@pytest.mark.parametrize("rule", RULES)
def test_derivatives_are_native_like_any_other_node(rule: str) -> None:
    graph = Graph()
    x = tm.array([Scalar(graph, graph.input()), Scalar(graph, graph.input())])
    with tracing(graph):
        nodes = [to_node(graph, entry) for entry in jacobian(function_of(rule), x)]
    for point in POINTS:
        wanted = jacobian(function_of(rule), point)
        np.testing.assert_allclose(native_values(graph, nodes, point), wanted, rtol=EXACT, atol=EXACT)


# -------------------------------------------------------------------- special points

SPECIAL: list[tuple[str, Callable[[Any], Any], float, float]] = [
    ("|x| right of its kink", lambda x: tm.abs(x), 1e-300, 1.0),
    ("|x| left of its kink", lambda x: tm.abs(x), -1e-300, -1.0),
    ("|x| at its kink is its right side", lambda x: tm.abs(x), 0.0, 1.0),
    ("max(x, 0) above", lambda x: tm.maximum(x, 0.0), 1e-300, 1.0),
    ("max(x, 0) below", lambda x: tm.maximum(x, 0.0), -1e-300, 0.0),
    ("max(x, 0) at the kink is its right side", lambda x: tm.maximum(x, 0.0), 0.0, 1.0),
    ("min(x, 1) below", lambda x: tm.minimum(x, 1.0), 1.0 - 1e-15, 1.0),
    ("min(x, 1) above", lambda x: tm.minimum(x, 1.0), 1.0 + 1e-15, 0.0),
    ("min(x, 1) at the kink is its right side", lambda x: tm.minimum(x, 1.0), 1.0, 0.0),
    ("clip inside", lambda x: tm.clip(x, -1.0, 1.0), 0.5, 1.0),
    ("clip outside", lambda x: tm.clip(x, -1.0, 1.0), 1.5, 0.0),
    ("sign", lambda x: tm.sign(x), 0.0, 0.0),
    ("floor on a whole number", lambda x: tm.floor(x), 2.0, 0.0),
    ("a comparison", lambda x: tm.where(x > 0.0, 1.0, 0.0), 0.0, 0.0),
    ("a guarded root", lambda x: tm.where(x > 0.0, tm.sqrt(x), 0.0), 0.0, 0.0),
    ("a guarded root of a negative number", lambda x: tm.where(x > 0.0, tm.sqrt(x), 0.0), -1.0, 0.0),
    ("a guarded quotient", lambda x: tm.where(x == 0.0, 1.0, tm.sin(x) / x), 0.0, 0.0),
    ("asin near 1", lambda x: tm.asin(x), 1.0 - NEAR_THE_END, 1.0 / math.sqrt(NEAR_THE_END * (2.0 - NEAR_THE_END))),
    ("asin near -1", lambda x: tm.asin(x), NEAR_THE_END - 1.0, 1.0 / math.sqrt(NEAR_THE_END * (2.0 - NEAR_THE_END))),
    ("acos near 1", lambda x: tm.acos(x), 1.0 - NEAR_THE_END, -1.0 / math.sqrt(NEAR_THE_END * (2.0 - NEAR_THE_END))),
    ("asin at 1", lambda x: tm.asin(x), 1.0, math.inf),
    ("sqrt at 0", lambda x: tm.sqrt(x), 0.0, math.inf),
    ("log at 0", lambda x: tm.log(x), 0.0, math.inf),
    ("x^2 at 0", lambda x: x**2, 0.0, 0.0),
    ("x^3 below 0", lambda x: x**3, -2.0, 12.0),
    ("x^1 at 0", lambda x: x**1, 0.0, 1.0),
    ("x^0 at 0", lambda x: x**0, 0.0, 0.0),
    ("tanh far out", lambda x: tm.tanh(x), 400.0, 0.0),
    ("exp far down", lambda x: tm.exp(x), -1000.0, 0.0),
    ("atan2 on the positive axis", lambda x: tm.atan2(x, 1.0), 0.0, 1.0),
    ("atan2 on the negative axis", lambda x: tm.atan2(x, -1.0), 0.0, -1.0),
    ("atan2 straight up", lambda x: tm.atan2(1.0, x), 0.0, -1.0),
]


@pytest.mark.parametrize(("what", "function", "x", "wanted"), SPECIAL, ids=[case[0] for case in SPECIAL])
def test_special_points(what: str, function: Callable[[Any], Any], x: float, wanted: float) -> None:
    got = jacobian(lambda v: function(v[0]), [x])
    np.testing.assert_allclose(got, [wanted], rtol=1e-9)  # 1 - x x loses ten digits near the end of asin
    np.testing.assert_array_equal(traced_value(lambda v: jacobian(lambda w: function(w[0]), v), [x]), got)


def test_where_there_is_no_derivative_the_result_says_so() -> None:
    assert np.isnan(jacobian(tm.norm, [0.0, 0.0])).all()


# -------------------------------------------------------------------- shapes, closures, nesting


def test_shapes_of_results_and_of_nothing() -> None:
    assert jacobian(lambda x: x[0], [1.0, 2.0]).shape == (2,)
    assert jacobian(lambda x: 3.0, [1.0, 2.0]).tolist() == [0.0, 0.0]
    assert jacobian(lambda x: x, [1.0, 2.0]).tolist() == [[1.0, 0.0], [0.0, 1.0]]
    assert jacobian(lambda x: np.outer(x, x), [1.0, 2.0]).shape == (2, 2, 2)
    assert jacobian(lambda x: [x[0] > 0.0, x[1]], [1.0, 2.0]).tolist() == [[0.0, 0.0], [0.0, 1.0]]
    with refused(ShapeError):
        jacobian(lambda x: x, [[1.0], [2.0]])


def test_only_the_functions_own_argument_is_differentiated() -> None:
    def of_both(x: Any) -> Any:
        return jacobian(lambda y: x[0] * y[0] * y[1] + x[1], x)  # x from outside is a constant in here

    x = np.array([2.0, 3.0])
    for result in (of_both(x), traced_value(of_both, x)):
        assert result.tolist() == [2.0 * 3.0, 2.0 * 2.0]


def test_a_derivative_of_a_derivative_with_a_value_from_outside() -> None:
    def outer(x: Any) -> Any:
        return jacobian(lambda y: x[0] ** 2 * y[0] ** 3, x)[0]  # 3 x^2 y^2 at y = x

    for x in (0.0, -1.5, 2.0):
        for result in (jacobian(outer, [x]), traced_value(lambda v: jacobian(outer, v), [x])):
            assert result[0] == pytest.approx(12.0 * x**3, rel=EXACT)  # d/dx of 3 x^4


def test_derivatives_of_equal_functions_are_shared() -> None:
    graph = Graph()
    x = tm.array([Scalar(graph, graph.input())])
    with tracing(graph):
        once = jacobian(lambda y: tm.sin(y[0]) * y[0], x)
        before = len(graph.live([to_node(graph, entry) for entry in once]))
        again = jacobian(lambda y: tm.sin(y[0]) * y[0], x)
    assert [to_node(graph, a) for a in once] == [to_node(graph, b) for b in again]
    assert before <= 7  # x, sin, cos, their product and sum


def test_a_value_that_leaves_the_function_is_refused() -> None:
    caught: list[Any] = []

    def leaks(x: Any) -> Any:
        jacobian(lambda y: caught.append(y[0]) or y[0], x)
        return caught[-1]

    with refused(TraceError):
        traced_value(leaks, [1.0])
    with refused(TraceError):
        jacobian(leaks, [1.0])
    jacobian(lambda y: caught.append(y[0]) or y[0], [1.0])
    with refused(TraceError):
        float(caught[-1])


def test_branches_in_a_function_to_differentiate_are_refused_on_floats_too() -> None:
    with refused(TraceError):
        jacobian(lambda x: x[0] if x[0] > 0.0 else 0.0, [1.0])
    with refused(TraceError):
        jacobian(lambda x: None, [1.0])


@given(st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_a_chain_of_everything_agrees_with_casadi(values: list[float]) -> None:
    def ours(x: Any) -> Any:
        u = tm.sin(x[0] * x[1]) + tm.exp(-(x[2] ** 2))
        w = tm.atan2(u, 2.0 + tm.cos(x[3])) * tm.tanh(x[0]) + tm.sqrt(1.0 + u * u)
        return tm.array([w / (1.5 + tm.sin(u)), tm.maximum(w, u) * x[3]])

    x = ca.SX.sym("x", 4)
    u = ca.sin(x[0] * x[1]) + ca.exp(-(x[2] ** 2))
    w = ca.atan2(u, 2.0 + ca.cos(x[3])) * ca.tanh(x[0]) + ca.sqrt(1.0 + u * u)
    theirs = ca.Function("J", [x], [ca.jacobian(ca.vertcat(w / (1.5 + ca.sin(u)), ca.fmax(w, u) * x[3]), x)])
    np.testing.assert_allclose(jacobian(ours, values), np.array(theirs(values)), rtol=0.0, atol=100.0 * EXACT)
