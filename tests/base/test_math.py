"""taut.math: one function, the same on floats, on lists, and on traced values."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from base_tools import native_values, traced_value
from refusals import refused

from taut import math as tm
from taut.errors import NumericalError, ShapeError
from taut.trace.graph import Graph, Op
from taut.trace.scalar import Scalar, to_node, tracing

SOLVED = 1e-13  # relative; matrices of condition up to 1e3, in double precision
ROUNDING = 4e-15

A = np.array([0.3, -1.2, 0.7])
B = np.array([0.9, 0.4, -0.7])


def both(function: Callable[..., Any], *arguments: Any) -> tuple[Any, Any]:
    """A function on floats, and traced."""
    return np.asarray(function(*arguments)), traced_value(function, *arguments)


ENTRY_BY_ENTRY = [
    (tm.sin, np.sin, A),
    (tm.cos, np.cos, A),
    (tm.tan, np.tan, A),
    (tm.asin, np.arcsin, B),
    (tm.acos, np.arccos, B),
    (tm.sqrt, np.sqrt, np.abs(A)),
    (tm.exp, np.exp, A),
    (tm.log, np.log, np.abs(A)),
    (tm.tanh, np.tanh, A),
    (tm.abs, np.abs, A),
    (tm.sign, np.sign, np.array([-2.0, 0.0, 3.0])),
    (tm.floor, np.floor, np.array([-2.5, -2.0, 2.5])),
]


@pytest.mark.parametrize(("ours", "numpys", "x"), ENTRY_BY_ENTRY, ids=[case[0].__name__ for case in ENTRY_BY_ENTRY])
def test_functions_of_one_number_are_numpys(ours: Any, numpys: Any, x: Any) -> None:
    for argument in (x, x.tolist(), np.stack([x, x]), float(x[0])):
        on_floats, traced = ours(argument), traced_value(ours, argument)
        np.testing.assert_array_equal(on_floats, numpys(argument))
        np.testing.assert_allclose(traced, numpys(argument), rtol=ROUNDING)
    mixed = traced_value(lambda s: ours([s, float(x[1])]), x[0])
    np.testing.assert_allclose(mixed, numpys(x[:2]), rtol=ROUNDING)


def test_floor_is_below_also_for_negative_numbers_and_sign_of_zero_is_zero() -> None:
    for floor in both(tm.floor, [-0.5, -1.0, -1e-300, 0.0, 1.5]):
        assert floor.tolist() == [-1.0, -1.0, -1.0, 0.0, 1.0]
    for sign in both(tm.sign, [-1e-300, 0.0, 1e-300]):
        assert sign.tolist() == [-1.0, 0.0, 1.0]


@pytest.mark.parametrize("function", [tm.minimum, tm.maximum])
def test_minimum_and_maximum_keep_nan(function: Any) -> None:
    for result in both(function, [math.nan, 1.0, math.nan, 2.0], [1.0, math.nan, math.nan, 3.0]):
        assert np.isnan(result).tolist() == [True, True, True, False]


def test_clip_keeps_nan_and_takes_numbers_vectors_and_infinity() -> None:
    for result in both(lambda x: tm.clip(x, -1.0, [0.5, 2.0, math.inf, 1.0]), [0.7, 0.7, 5.0, math.nan]):
        np.testing.assert_array_equal(result, [0.5, 0.7, 5.0, math.nan])
    for result in both(lambda x: tm.clip(x, -0.1, 0.1), 0.7):
        assert result == 0.1


def test_where_takes_one_branch_even_if_the_other_is_no_number() -> None:
    def root_or_zero(x: Any) -> Any:
        with np.errstate(all="ignore"):
            return tm.where(x > 0.0, tm.sqrt(x), 0.0)

    for result in both(root_or_zero, np.array([-1.0, 0.0, 4.0])):
        assert result.tolist() == [0.0, 0.0, 2.0]

    def inverse_or_one(x: Any) -> Any:
        with np.errstate(all="ignore"):
            return tm.where(x == 0.0, 1.0, 1.0 / x)

    for result in both(inverse_or_one, np.array([0.0, 2.0])):
        assert result.tolist() == [1.0, 0.5]


def test_where_takes_numbers_lists_and_arrays_for_each_of_its_arguments() -> None:
    assert tm.where(True, 1.0, 2.0) == 1.0
    assert tm.where([True, False], [1.0, 2.0], 0.0).tolist() == [1.0, 0.0]
    assert traced_value(lambda x: tm.where([x[0] > 0.0, True], [x[0], 2.0], -1.0), [-3.0, 0.0]).tolist() == [
        -1.0,
        2.0,
    ]
    assert traced_value(lambda x: tm.where(True, x, 0.0), A).tolist() == A.tolist()


def test_atan2_is_right_in_every_quadrant_and_on_every_axis() -> None:
    y, x = np.array([0.0, 1.0, 0.0, -1.0, 1.0, -1.0, 0.0]), np.array([1.0, 0.0, -1.0, 0.0, -1.0, -1.0, 0.0])
    for result in both(tm.atan2, y, x):
        np.testing.assert_array_equal(result, np.arctan2(y, x))


def test_norm_is_a_length_also_of_nothing() -> None:
    for result in both(tm.norm, np.zeros(3)):
        assert result == 0.0
    for result in both(tm.norm, [3.0, 4.0]):
        assert result == 5.0
    for result in both(lambda m: tm.norm(m, axis=1), [[3.0, 4.0], [0.0, 1.0]]):
        assert result.tolist() == [5.0, 1.0]


def test_cross_skew_and_stack() -> None:
    for result in both(tm.cross, A, B):
        np.testing.assert_allclose(result, np.cross(A, B), rtol=ROUNDING)
    for result in both(lambda a, b: tm.skew(a) @ b, A, B):
        np.testing.assert_allclose(result, np.cross(A, B), rtol=ROUNDING)
    for result in both(lambda a, b: tm.stack([a, [1.0, 2.0, 3.0], b]), A, B):
        np.testing.assert_array_equal(result, np.stack([A, [1.0, 2.0, 3.0], B]))
    for result in both(lambda a: tm.stack([a[0], 1.0]), A):
        np.testing.assert_array_equal(result, [A[0], 1.0])


def test_full_takes_a_number_a_vector_and_a_traced_one() -> None:
    for result in both(lambda a: tm.full((2, 3), a), A):
        np.testing.assert_array_equal(result, [A, A])
    for result in both(lambda s: tm.full(2, s), 0.5):
        np.testing.assert_array_equal(result, [0.5, 0.5])


# -------------------------------------------------------------------- solving

NEED_PIVOTS = {
    "a permutation": [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
    "zeros on the diagonal": [[0.0, 2.0, 1.0], [1.0, 0.0, 3.0], [2.0, 1.0, 0.0]],
    "a zero that appears while eliminating": [[1.0, 2.0, 3.0], [2.0, 4.0, 1.0], [1.0, 1.0, 1.0]],
    "a tiny first pivot": [[1e-20, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 1.0, 3.0]],
    "the last row is the largest": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 10.0]],
    "one entry": [[-2.0]],
    "antisymmetric": [[0.0, 1.0, -2.0, 1.0], [-1.0, 0.0, 3.0, 1.0], [2.0, -3.0, 0.0, 1.0], [-1.0, -1.0, -1.0, 0.0]],
}


@pytest.mark.parametrize("name", NEED_PIVOTS)
def test_solve_pivots(name: str) -> None:
    M = np.array(NEED_PIVOTS[name])
    b = np.arange(1.0, len(M) + 1.0)
    columns = np.column_stack([b, b**2])
    for result in both(tm.solve, M, b):
        np.testing.assert_allclose(result, np.linalg.solve(M, b), rtol=SOLVED, atol=SOLVED)
    for result in both(tm.solve, M, columns):
        np.testing.assert_allclose(result, np.linalg.solve(M, columns), rtol=SOLVED, atol=SOLVED)
    for result in both(tm.inverse, M):
        np.testing.assert_allclose(result, np.linalg.inv(M), rtol=SOLVED, atol=SOLVED)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_solve_of_random_matrices(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(20):
        M, b = rng.standard_normal((n, n)), rng.standard_normal(n)
        wanted = np.linalg.solve(M, b)
        for result in both(tm.solve, M, b):
            np.testing.assert_allclose(
                result, wanted, rtol=0.0, atol=SOLVED * np.linalg.cond(M) * np.abs(wanted).max()
            )


def test_solve_is_native_as_it_is_on_floats() -> None:
    M = np.array(NEED_PIVOTS["zeros on the diagonal"])
    graph = Graph()
    entries = np.array([Scalar(graph, graph.input()) for _ in range(9)], dtype=object).reshape(3, 3)
    with tracing(graph):
        nodes = [to_node(graph, x) for x in tm.solve(entries, [1.0, 2.0, 3.0])]
    np.testing.assert_allclose(native_values(graph, nodes, M.ravel()), np.linalg.solve(M, [1, 2, 3]), rtol=SOLVED)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_spd_solves(n: int) -> None:
    rng = np.random.default_rng(n)
    root = rng.standard_normal((n, n))
    M, b = root @ root.T + np.eye(n), rng.standard_normal((n, 2))
    for result in both(tm.solve_spd, M, b):
        np.testing.assert_allclose(result, np.linalg.solve(M, b), rtol=SOLVED, atol=SOLVED)
    for result in both(tm.inverse_spd, M):
        np.testing.assert_allclose(result, np.linalg.inv(M), rtol=SOLVED, atol=SOLVED)
    factors = tm.factor_spd(M)
    for k in range(2):  # factors serve more than once
        np.testing.assert_allclose(tm.solve_spd(factors, b[:, k]), np.linalg.solve(M, b[:, k]), rtol=SOLVED)
    assert all(d > 0.0 for d in factors.d)


def test_the_two_halves_of_a_solution_are_the_solution() -> None:
    rng = np.random.default_rng(5)
    root = rng.standard_normal((5, 5))
    M, B, c = root @ root.T + np.eye(5), rng.standard_normal((5, 3)), rng.standard_normal(5)

    def halves(M: Any, B: Any, c: Any) -> Any:
        factors = tm.factor_spd(M)
        half, y = factors.half(B), factors.weighed(factors.half(c))
        return tm.array([*(half.T @ y), *(half.T @ factors.weighed(half)).ravel(), *factors.other_half(half @ c[:3])])

    W = np.linalg.solve(M, B)
    for result in both(halves, M, B, c):
        np.testing.assert_allclose(result, [*(W.T @ c), *(B.T @ W).ravel(), *(W @ c[:3])], rtol=SOLVED, atol=SOLVED)


def test_spd_factors_keep_the_zeros_of_a_branched_arm() -> None:
    M = np.diag([3.0, 2.0, 2.0])
    M[0, 1] = M[1, 0] = M[0, 2] = M[2, 0] = 0.5  # two branches on one joint
    graph = Graph()

    def entry(value: float) -> Any:
        return Scalar(graph, graph.input()) if value else 0.0

    traced = np.array([[entry(x) for x in row] for row in M], dtype=object)
    with tracing(graph):
        tm.factor_spd(traced)
    operations = sum(op > Op.INPUT for op in graph.ops)
    assert operations == 3 + 2 + 2 * 2  # inverses of D, two scaled entries, two updates of M[0, 0]


def test_whole_numbers_and_lists_solve_like_floats() -> None:
    assert tm.solve([[0, 1], [1, 0]], [1, 2]).tolist() == [2.0, 1.0]
    assert tm.solve_spd([[2, 0], [0, 4]], [1, 2]).tolist() == [0.5, 0.5]
    assert tm.inverse([[0, 2], [1, 0]]).tolist() == [[0.0, 1.0], [0.5, 0.0]]


MESSAGES = {
    "singular": (NumericalError, lambda: tm.solve([[0, 0], [0, 1]], [1, 2])),
    "singular, spd": (NumericalError, lambda: tm.solve_spd(np.zeros((2, 2)), [1, 2])),
    "not square": (ShapeError, lambda: tm.inverse(np.zeros((2, 3)))),
    "b too short": (ShapeError, lambda: tm.solve(np.eye(3), [1.0, 2.0])),
    "b of three dimensions": (ShapeError, lambda: tm.solve(np.eye(2), np.zeros((2, 2, 2)))),
    "not square, spd": (ShapeError, lambda: tm.factor_spd(np.zeros((2, 3)))),
    "b too long, spd": (ShapeError, lambda: tm.solve_spd(np.eye(2), [1.0, 2.0, 3.0])),
    "b too short, spd": (ShapeError, lambda: tm.solve_spd(np.eye(3), [1.0, 2.0])),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_what_cannot_be_solved_is_told(name: str) -> None:
    kind, call = MESSAGES[name]
    with refused(kind):
        call()


def test_a_row_that_depends_on_later_ones_is_left_out_of_the_factors() -> None:
    """A = B B^T whose first row of B is the second: what is left is solved as if that row were not there."""
    from taut.trace.linalg import factor_spd

    B = np.array([[1.0, 2.0, 0.5], [1.0, 2.0, 0.5], [0.3, -1.0, 2.0]])
    b = np.array([4.0, 4.0, -1.0])
    factors = factor_spd(B @ B.T, 1e-7)
    assert [bool(gone) for gone in factors.dropped] == [True, False, False]
    rest = np.linalg.solve(B[1:] @ B[1:].T, b[1:])
    np.testing.assert_allclose(factors.solve(b), [0.0, *rest], rtol=1e-12)
    whole = factor_spd(B[1:] @ B[1:].T, 1e-7)
    assert not any(whole.dropped)
    np.testing.assert_allclose(whole.solve(b[1:]), rest, rtol=1e-12)
