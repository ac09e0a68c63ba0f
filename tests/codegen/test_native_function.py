"""taut.native: any function of arrays as a native one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import math as tm
from taut.errors import ShapeError, TraceError, UsageError

ROUNDING = 1e-14
A = np.array([0.3, -1.2, 0.7])
M = np.array([[2.0, -0.3, 0.1], [0.2, 1.5, -0.4], [-0.6, 0.3, 1.1]])


@pytest.mark.parametrize(
    ("function", "arguments"),
    [
        (lambda s: s * 2.0, (0.5,)),
        (lambda s: [s, s * s], (0.5,)),
        (lambda a: a[1], (A,)),
        (lambda a: np.outer(a, a), (A,)),
        (lambda m, a: m @ a, (M, A)),
        (lambda m: m.T, (M,)),
        (lambda m: np.stack([m, 2.0 * m]), (M,)),
        (lambda m, a, s: tm.solve(m, a) * s, (M, A, 3.0)),
        (lambda a: a[:0], (A,)),
        (lambda a: a > 0.0, (A,)),
        (lambda a: 3.0, (A,)),
        (lambda: tm.array([1.0, 2.0]), ()),
    ],
    ids=[
        "scalar",
        "list",
        "entry",
        "matrix",
        "product",
        "transpose",
        "cube",
        "solve",
        "empty",
        "truth",
        "constant",
        "none",
    ],
)
def test_it_gives_what_the_function_gives(function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    shapes = {f"x{k}": np.shape(x) for k, x in enumerate(arguments)}
    native = taut.native(function, **shapes)
    expected = np.asarray(function(*arguments), dtype=np.float64)
    for given in (arguments, [np.asarray(x, dtype=np.float64) for x in arguments]):
        got = native(*given)
        assert type(got) is np.ndarray
        assert got.shape == expected.shape
        np.testing.assert_allclose(got, expected, rtol=ROUNDING, atol=ROUNDING)


def test_results_are_new_arrays() -> None:
    native = taut.native(lambda a: 2.0 * a, a=3)
    first = native(A)
    second = native(-A)
    assert first.tolist() == (2.0 * A).tolist()
    assert second.tolist() == (-2.0 * A).tolist()
    assert first.flags.owndata
    assert first.flags.writeable


def test_several_functions_live_side_by_side() -> None:
    natives = [taut.native(lambda a, k=k: a * float(k), a=3) for k in range(5)]
    for k, native in enumerate(natives):
        assert native(A).tolist() == (A * k).tolist()
    del natives[0]
    assert natives[3](A).tolist() == (A * 4).tolist()


def test_nan_and_infinity_go_through() -> None:
    native = taut.native(lambda a: a + 1.0, a=2)
    for given in (np.array([np.nan, np.inf]), [np.nan, np.inf]):
        np.testing.assert_array_equal(native(given), [np.nan, np.inf])


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        (lambda f: f(A), UsageError),
        (lambda f: f(M, A, A), UsageError),
        (lambda f: f.call(M, a=A), UsageError),
        (lambda f: f(A, M), ShapeError),
        (lambda f: f(M, A[:2]), ShapeError),
        (lambda f: f(M, "abc"), ShapeError),
        (lambda f: f(M, None), ShapeError),
        (lambda f: f(M, A * 1j), ShapeError),
    ],
)
def test_what_does_not_fit_gets_one_sentence(call: Callable[[Any], Any], kind: type[Exception]) -> None:
    native = taut.native(lambda m, a: m @ a, m=(3, 3), a=3)
    with refused(kind):
        call(native)
    np.testing.assert_allclose(native(M, A), M @ A, rtol=ROUNDING)


@pytest.mark.parametrize("shape", [0, -1, 2.0, "3", (3, 0), (3, "3"), True, None, [3]], ids=lambda shape: repr(shape))
def test_a_shape_that_is_none_is_refused(shape: Any) -> None:
    with refused(UsageError):
        taut.native(lambda a: a, a=shape)


def test_a_length_may_be_any_whole_number() -> None:
    assert taut.native(lambda a: a, a=np.int64(3))(A).tolist() == A.tolist()
    assert taut.native(lambda a: a, a=(np.int32(3), 1))(A[:, None]).tolist() == A[:, None].tolist()


@pytest.mark.parametrize(
    "function",
    [
        lambda a: None,
        lambda a: {"y": a},
        lambda a: "text",
        lambda a: a * np.nan,
        lambda a: np.array([1.0, np.nan]),
        lambda a: a * np.random.default_rng().standard_normal(),
        lambda a: a.no_such_name,
        lambda a, b: a,
        lambda a: [a, [1.0]],
    ],
    ids=[
        "None",
        "dict",
        "text",
        "nan",
        "nan result",
        "random",
        "a wrong name",
        "a wrong number of arguments",
        "ragged",
    ],
)
def test_a_function_that_cannot_be_traced_is_refused(function: Callable[..., Any]) -> None:
    with refused(TraceError):
        taut.native(function, a=3)


def test_several_threads_call_it_at_once() -> None:
    native = taut.native(lambda a, m: m @ a, a=3, m=(3, 3))
    wrong: list[Any] = []

    def work(k: int) -> None:
        a = A * k
        wanted = (M @ a).tolist()
        as_list = a.tolist()
        for turn in range(2000):
            got = native(as_list if turn % 2 else a, M)  # the slow and the fast way in
            if np.abs(got - wanted).max() > ROUNDING * max(1.0, k):
                wrong.append((k, got))

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_it_says_how_many_operations_it_costs() -> None:
    assert taut.native(lambda a: a[0] * a[1] + a[2], a=3).operations == 2
