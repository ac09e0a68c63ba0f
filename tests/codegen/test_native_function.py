"""taut.native: any function of arrays as a native one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

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
    ("call", "kind", "message"),
    [
        (lambda f: f(A), UsageError, "the function takes 2 arrays (m, a); got 1"),
        (lambda f: f(M, A, A), UsageError, "the function takes 2 arrays (m, a); got 3"),
        (lambda f: f.call(M, a=A), UsageError, "the function takes m, a by position; got a by name"),
        (lambda f: f(A, M), ShapeError, "m must have shape (3, 3); got shape (3,)"),
        (lambda f: f(M, A[:2]), ShapeError, "a must have shape (3,); got shape (2,)"),
        (lambda f: f(M, "abc"), ShapeError, "a must be numbers; got 'abc'"),
        (lambda f: f(M, None), ShapeError, "a must be numbers; got None"),
        (lambda f: f(M, A * 1j), ShapeError, "a must be real numbers; got an array of complex128"),
    ],
)
def test_what_does_not_fit_gets_one_sentence(call: Callable[[Any], Any], kind: type[Exception], message: str) -> None:
    native = taut.native(lambda m, a: m @ a, m=(3, 3), a=3)
    with pytest.raises(kind) as caught:
        call(native)
    assert str(caught.value) == message
    np.testing.assert_allclose(native(M, A), M @ A, rtol=ROUNDING)


@pytest.mark.parametrize("shape", [0, -1, 2.0, "3", (3, 0), (3, "3"), True, None, [3]], ids=lambda shape: repr(shape))
def test_a_shape_that_is_none_is_refused(shape: Any) -> None:
    with pytest.raises(UsageError) as caught:
        taut.native(lambda a: a, a=shape)
    assert str(caught.value) == f"a must be a length or a shape such as 7 or (3, 3); got {shape!r}"


def test_a_length_may_be_any_whole_number() -> None:
    assert taut.native(lambda a: a, a=np.int64(3))(A).tolist() == A.tolist()
    assert taut.native(lambda a: a, a=(np.int32(3), 1))(A[:, None]).tolist() == A[:, None].tolist()


HERE = r"\S*test_native_function\.py:\d+"
ANYWAY = r"; use taut\.math for arrays, branches and functions; engine='float' runs it on plain numbers"


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda a: None, f"None is used as a number at {HERE}"),
        (lambda a: {"y": a}, f"a value of type dict is used as a number at {HERE}"),
        (lambda a: "text", f"'text' is used as a number at {HERE}"),
        (lambda a: a * np.nan, f"a constant in the law is NaN at {HERE}; every number in it must be one"),
        (lambda a: np.array([1.0, np.nan]), r"result\[1\] is NaN whatever the law is given"),
        (
            lambda a: a * np.random.default_rng().standard_normal(),
            "<lambda>: two traces of the same code differ; a law must give the same at the same inputs: no random "
            "numbers, no clock, no state outside its memory",
        ),
        (
            lambda a: a.no_such_name,
            f"this code cannot be traced: AttributeError: 'Traced' object has no attribute 'no_such_name' at {HERE}{ANYWAY}",
        ),
        (
            lambda a, b: a,
            r"this code cannot be traced: TypeError: <lambda>\(\) missing 1 required positional argument: 'b' at "
            f"{HERE}{ANYWAY}",
        ),
        (
            lambda a: [a, [1.0]],
            "this code cannot be traced: ValueError: setting an array element with a sequence. The requested array has "
            r"an inhomogeneous shape after 1 dimensions. The detected shape was \(2,\) \+ inhomogeneous part\. at "
            f"{HERE}{ANYWAY}",
        ),
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
def test_a_function_that_cannot_be_traced_is_refused(function: Callable[..., Any], message: str) -> None:
    with pytest.raises(TraceError, match=f"^{message}$"):
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
