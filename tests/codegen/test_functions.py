"""Elementary functions in machine code: their errors, their ends, and the same bits wherever they run."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

import taut
from taut import math as tm
from taut.base.types import Float64Array

FEW = 2.5  # units in the last place
Draw = Any


def log_uniform(low: float, high: float) -> Draw:
    """Numbers of both signs, of every order of magnitude from 10^low to 10^high."""
    return lambda rng, k: rng.choice([-1.0, 1.0], k) * 10.0 ** rng.uniform(low, high, k)


def uniform(low: float, high: float) -> Draw:
    return lambda rng, k: rng.uniform(low, high, k)


def near(x: float) -> Draw:
    return lambda rng, k: x + rng.choice([-1.0, 1.0], k) * 10.0 ** rng.uniform(-16.0, -1.0, k)


ONE: dict[str, tuple[Any, Any, list[Draw], list[float]]] = {
    "log": (
        tm.log,
        np.log,
        [lambda rng, k: 10.0 ** rng.uniform(-323.0, 308.0, k), near(1.0), uniform(0.5, 2.0), near(math.sqrt(2.0))],
        [1.0, 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, 0.7071067811865476, 1.4142135623730951],
    ),
    "tanh": (
        tm.tanh,
        np.tanh,
        [log_uniform(-300.0, 2.0), uniform(-2.0, 2.0), near(0.625), near(-0.625)],
        [0.0, 0.625, -0.625, 5e-324, 19.0, -22.0, 1e300, -1e300],
    ),
    "asin": (
        tm.asin,
        np.arcsin,
        [uniform(-1.0, 1.0), log_uniform(-300.0, -0.1), near(0.5), near(-0.5), uniform(-1.0, -0.999)],
        [0.0, 0.5, -0.5, 1.0, -1.0, 5e-324],
    ),
    "acos": (
        tm.acos,
        np.arccos,
        [uniform(-1.0, 1.0), near(0.5), near(-0.5), uniform(0.999, 1.0), uniform(-1.0, -0.999)],
        [0.0, 0.5, -0.5, 1.0, -1.0, 5e-324],
    ),
}


def of_one(function: Any, size: int = 64) -> Any:
    """A function of any number of numbers, in native code."""
    native = taut.native(lambda x: function(x), x=size)

    def evaluate(x: Float64Array) -> Float64Array:
        padded = np.resize(x, -(-len(x) // size) * size).reshape(-1, size)
        return np.concatenate([native(row) for row in padded])[: len(x)]

    return evaluate


def ulps(got: Float64Array, exact: Any) -> Float64Array:
    """Errors in units of the last place of the result, against one of 64 bits."""
    return np.asarray(np.abs(np.longdouble(got) - exact) / np.spacing(np.abs(exact.astype(np.float64))))


@pytest.mark.part(2)
@pytest.mark.parametrize("name", ONE)
def test_a_function_is_right_to_its_last_bits(name: str) -> None:
    function, true, draws, special = ONE[name]
    rng, ours = np.random.default_rng(0), of_one(function)
    x = np.concatenate([special, *(draw(rng, 4000) for draw in draws)])
    x = x[np.isfinite(true(x))]
    assert len(x) > 4000
    assert ulps(ours(x), true(np.longdouble(x))).max() <= FEW


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("function", "x", "wanted"),
    [
        (tm.log, [0.0, -1.0, -math.inf, math.inf, math.nan, -5e-324], [-math.inf, math.nan, math.nan, math.inf, math.nan, math.nan]),
        (tm.tanh, [math.inf, -math.inf, math.nan], [1.0, -1.0, math.nan]),
        (tm.asin, [1.0 + 2e-16 + 1e-16, -2.0, math.inf, math.nan], [math.nan] * 4),
        (tm.acos, [1.0 + 2e-16 + 1e-16, -2.0, math.inf, math.nan], [math.nan] * 4),
    ],
)  # fmt: skip
def test_a_function_has_ends(function: Any, x: list[float], wanted: list[float]) -> None:
    np.testing.assert_array_equal(of_one(function)(np.array(x)), wanted)


def test_the_angle_of_a_point_is_right_to_its_last_bits() -> None:
    rng, both = np.random.default_rng(1), taut.native(lambda y, x: tm.atan2(y, x), y=64, x=64)
    draws = [log_uniform(-300.0, 300.0), log_uniform(-1.0, 1.0), lambda rng, k: rng.standard_normal(k)]
    for _ in range(300):
        y, x = draws[rng.integers(3)](rng, 64), draws[rng.integers(3)](rng, 64)
        if rng.random() < 0.2:  # the border of the two reductions
            y = x * math.tan(math.pi / 8.0) * (1.0 + rng.uniform(-1e-15, 1e-15, 64))
        exact = np.arctan2(np.longdouble(y), np.longdouble(x))
        normal = np.abs(exact) > 1e-300
        assert ulps(both(y, x), exact)[normal].max() <= FEW


def test_the_angle_of_a_point_on_an_axis_and_far_out() -> None:
    both = taut.native(lambda y, x: tm.atan2(y, x), y=(), x=())
    sides = [0.0, 5e-324, 1e-300, 1.0, 1e200, 1.7e308]
    for y, x in itertools.product([*sides, *(-s for s in sides[1:])], repeat=2):
        got, exact = float(both(np.array(y), np.array(x))), math.atan2(y, x)
        assert abs(got - exact) <= FEW * np.spacing(abs(exact))
    assert float(both(np.array(1.0), np.array(math.inf))) == 0.0
    assert float(both(np.array(-math.inf), np.array(2.0))) == -math.pi / 2.0
    assert math.isnan(both(np.array(math.inf), np.array(math.inf)))
    for bad in ((math.nan, 1.0), (1.0, math.nan), (0.0, math.nan)):
        assert math.isnan(both(*map(np.array, bad)))
