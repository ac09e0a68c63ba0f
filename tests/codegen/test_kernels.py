"""Kernels: what the emitted code computes, and that the native loop and the plain one agree."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut import math as tm
from taut.base.types import Float64Array
from taut.codegen.engine import Steps
from taut.codegen.llvm import declarations, kernel, number, products_in_sums
from taut.codegen.loop import StepLoop
from taut.codegen.native import compiled
from taut.codegen.program import Block, Program, trace

ULP = 2.0**-52
SINE = 1.5 * ULP  # the reduction keeps 1e-16 of the angle for |x| < 1e6, the polynomials half a unit of the result
FAR = 2.0  # ulps of the angle itself, beyond

sine = taut.native(lambda x: tm.array([tm.sin(x), tm.cos(x)]), x=())


def sines(x: Float64Array) -> tuple[Float64Array, Float64Array]:
    both = np.array([sine(np.array(value)) for value in x])
    return both[:, 0], both[:, 1]


def true_sines(x: Float64Array) -> tuple[Float64Array, Float64Array]:
    return np.array([math.sin(v) for v in x]), np.array([math.cos(v) for v in x])


def largest_error(x: Float64Array) -> float:
    return max(float(np.abs(got - true).max()) for got, true in zip(sines(x), true_sines(x), strict=True))


def test_sine_and_cosine_on_many_turns() -> None:
    assert largest_error(np.linspace(-50.0, 50.0, 20_001)) < SINE


def test_sine_and_cosine_keep_their_relative_accuracy_at_their_zeros() -> None:
    rng = np.random.default_rng(0)
    quarters = np.arange(-2000, 2001) * (math.pi / 2)
    for spread in (0.0, 1e-15, 1e-12, 1e-9, 1e-4):
        x = quarters * (1.0 + spread * rng.standard_normal(len(quarters)))
        for got, true in zip(sines(x), true_sines(x), strict=True):
            assert np.abs(got - true).max() < SINE
            assert np.all(np.abs(got - true) <= 2.0 * ULP * np.abs(true))


def test_sine_and_cosine_up_to_a_million() -> None:
    assert largest_error(np.random.default_rng(1).uniform(-1e6, 1e6, 20_000)) < SINE


@pytest.mark.parametrize("size", [1e7, 1e9, 1e12, 1e15])
def test_far_out_the_error_is_that_of_the_angle(size: float) -> None:
    x = np.random.default_rng(2).uniform(-size, size, 2000)
    assert largest_error(x) < FAR * ULP * size + SINE


@pytest.mark.parametrize("x", [2.0**50, 1e22, -1e300, math.inf, -math.inf, math.nan])
def test_where_a_double_has_lost_the_angle_there_is_no_sine(x: float) -> None:
    assert np.isnan(sine(np.array(x))).all()


def test_sine_of_small_numbers_is_the_number() -> None:
    for x in (0.0, 1e-320, 1e-300, 1e-20, -1e-9):
        assert sine(np.array(x)).tolist() == [x, 1.0]


def test_a_number_is_written_exactly() -> None:
    assert number(0.1) == "0x3FB999999999999A"
    assert number(-0.0) == "0x8000000000000000"
    assert number(math.inf) == "0x7FF0000000000000"
    assert number(5e-324) == "0x0000000000000001"


@pytest.mark.parametrize(
    ("function", "x", "wanted"),
    [
        (lambda x: x * 2.0, 5e-324, 1e-323),
        (lambda x: x / 2.0, 1e-320, 5e-321),
        (lambda x: x * x, 1e200, math.inf),
        (lambda x: x - x * 0.5, 1.7e308, 0.85e308),
        (tm.sqrt, 1e-320, math.sqrt(1e-320)),
        (tm.floor, -5e-324, -1.0),
        (tm.floor, 1e300, 1e300),
        (tm.abs, -1e-320, 1e-320),
        (tm.exp, -800.0, 0.0),
        (tm.log, 5e-324, math.log(5e-324)),
        (tm.tanh, 1e300, 1.0),
        (lambda x: tm.minimum(x, 1.0), 1e-320, 1e-320),
        (lambda x: tm.atan2(x, -1.0), 1e-320, math.pi),
        (lambda x: tm.where(x > 0.0, 1.0, 2.0), 5e-324, 1.0),
    ],
)
def test_denormal_and_huge_numbers_are_numbers(function: Any, x: float, wanted: float) -> None:
    assert taut.native(function, x=())(np.array(x)) == wanted


@pytest.mark.parametrize(("pick", "of_three"), [(tm.minimum, 1.0), (tm.maximum, 3.0)])
def test_the_smaller_and_larger_of_two_numbers_are_nan_where_one_is(pick: Any, of_three: float) -> None:
    both = taut.native(lambda x, y: tm.array([pick(x, y), pick(y, x), pick(x, 2.0), pick(2.0, x)]), x=(), y=())
    nan = both(np.array(math.nan), np.array(1.0))
    assert np.isnan(nan).tolist() == [True] * 4
    assert both(np.array(of_three), np.array(2.0)).tolist() == [of_three] * 4
    assert both(np.array(4.0 - of_three), np.array(2.0)).tolist() == [2.0] * 4
    assert np.isnan(both(np.array(1.0), np.array(math.nan))[:2]).all()


@pytest.mark.parametrize(
    ("low", "high"), [(-1.0, 1.0), (-708.0, 709.0), (-745.2, -708.0), (709.0, 709.78), (-1e-9, 1e-9)]
)
def test_the_exponential_is_right_within_one_unit_of_its_last_place(low: float, high: float) -> None:
    ours = taut.native(lambda x: tm.exp(x), x=50)
    for x in np.random.default_rng(0).uniform(low, high, (40, 50)):
        expected = np.exp(x)
        assert (np.abs(ours(x) - expected) <= np.spacing(expected)).all()


def test_the_exponential_has_ends() -> None:
    x = [
        0.0,
        -0.0,
        np.inf,
        -np.inf,
        np.nan,
        1e308,
        -1e308,
        709.782712893384,
        709.7827128933841,
        -745.1332191019411,
        -745.1332191019412,
    ]
    with np.errstate(over="ignore"):
        expected = np.exp(x)
    np.testing.assert_array_equal(taut.native(lambda x: tm.exp(x), x=len(x))(np.array(x)), expected)


def test_equal_squares_differ_by_nothing() -> None:
    """Fused, x x - y y of equal numbers is the rounding of x x, and its root NaN half the time."""
    root = taut.native(lambda x, y: tm.sqrt(x * x - y * y), x=(), y=())
    for x in np.random.default_rng(0).uniform(0.1, 10.0, 200):
        assert root(np.array(x), np.array(x)) == 0.0


def test_what_rounding_makes_large_is_not_taken_for_a_fault() -> None:
    """Zero but for rounding, 1e-16 times 1e12: fused code and Python differ by more than any tolerance that is useful."""
    native = taut.native(lambda x: 1e12 * ((x * x + x) - x * (x + 1.0)), x=())
    assert abs(native(np.array(0.7))) < 1e-2


def test_lengths_are_fused_and_roots_of_differences_are_not() -> None:
    def fused(function: Any) -> int:
        program = trace(lambda i, _p, _m: ({"y": function(i["x"])}, {}), Block.of({"x": (3,)}), Block(), Block())
        return len(products_in_sums(program))

    assert fused(lambda x: tm.sqrt(x @ x)) == 2
    assert fused(lambda x: tm.sqrt(tm.abs(x[0]) + tm.maximum(x[1], 0.5) * tm.exp(x[2]))) == 1
    assert fused(lambda x: tm.sqrt(x @ x - x[0])) == 0
    assert fused(lambda x: tm.sqrt(x[0] * x[1] + x[2])) == 0
    assert fused(lambda x: tm.where(x @ x > 1.0, 1.0, 0.0)) == 0


def everything(inputs: Any, parameters: Any, memory: Any) -> Any:
    """Operations of each kind, products and sums among them in every order."""
    x, y, z = inputs["x"]
    a, b = memory["a"]
    k = parameters["k"]
    mixed = [x * y + z, x - y * z, x * y - z, x * y + y * z, x * y - z * a, tm.sin(x * y + b), tm.exp(x) * tm.cos(y)]
    more = [tm.sqrt(x * x + y * y), tm.maximum(x * k, y) / (1.0 + z * z), tm.atan2(x, y), tm.where(x * y > z, a, b)]
    return {"y": tm.array([*mixed, *more])}, {"a": tm.array([0.9 * a + 0.1 * tm.sin(b + x), b - k * a * y])}


def test_code_gives_the_same_numbers_to_the_last_bit_at_each_level(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TAUT_CACHE_DIR", str(tmp_path))
    blocks = Block.of({"x": (3,)}), Block.of({"k": ()}), Block.of({"a": (2,)})
    example = np.full(3, 0.5), np.ones(1), np.full(2, 0.25)
    rows, runs = np.random.default_rng(0).standard_normal((500, 3)), []
    for ticks in (1, None):
        loop = StepLoop(Steps(everything, *blocks), example, engine="native", ticks=ticks)
        memory, outputs = np.array([0.3, -0.2]), np.zeros((500, loop.outputs.size))
        assert loop.run(rows, np.array([0.01]), memory, outputs) == 500
        runs.append((loop.module.code_bytes, memory, outputs))
    assert runs[0][0] != runs[1][0]  # other code
    assert np.array_equal(runs[0][1], runs[1][1])
    assert np.array_equal(runs[0][2], runs[1][2])


def test_a_loop_is_compiled_well_once_it_has_run_for_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TAUT_CACHE_DIR", str(tmp_path))
    loop = StepLoop(Steps(swap, *BLOCKS), (np.ones(2), np.ones(1), np.ones(4)), engine="native", ticks=10)
    first = loop.module
    loop.expect(10_000)
    assert loop.module is first
    loop.expect(100_000)
    assert loop.module is not first
    memory, outputs = np.ones(4), np.zeros((3, loop.outputs.size))
    assert loop.run(np.ones((3, 2)), np.ones(1), memory, outputs) == 3


# -------------------------------------------------------------------- memory


def swap(inputs: Any, parameters: Any, memory: Any) -> Any:
    a, b = memory["a"], memory["b"]
    return {"sum": parameters["k"] * (a + b) + inputs["u"]}, {"a": b, "b": a + inputs["u"]}


BLOCKS = Block.of({"u": (2,)}), Block.of({"k": ()}), Block.of({"a": (2,), "b": (2,)})


def test_new_memory_may_stand_where_the_old_one_stood() -> None:
    program = trace(swap, *BLOCKS)
    module = compiled(program.content, lambda: f"{declarations()}\n{kernel(program, 'kernel')}", ("kernel",))
    run = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)(module["kernel"])
    inputs, parameters, out = np.array([10.0, 20.0]), np.array([2.0]), np.zeros(2)
    memory = np.array([1.0, 2.0, 3.0, 4.0])
    run(*(x.ctypes.data for x in (inputs, parameters, memory, memory, out)))
    assert out.tolist() == [18.0, 32.0]
    assert memory.tolist() == [3.0, 4.0, 11.0, 22.0]


def both_loops(step: Any, substep: Any, repeats: int, *blocks: Block) -> tuple[StepLoop, StepLoop]:
    inputs, parameters, memory = (block.zeros() for block in blocks)
    steps, example = Steps(step, *blocks, substep, repeats), (inputs, parameters, memory)
    return StepLoop(steps, example, engine="native"), StepLoop(steps, example, engine="float")


def double(inputs: Any, parameters: Any, memory: Any) -> Any:
    return {}, {"a": memory["a"] * parameters["k"], "b": memory["b"]}


@pytest.mark.parametrize("repeats", [0, 1, 3])
def test_the_native_loop_is_the_plain_one(repeats: int) -> None:
    rows = np.random.default_rng(0).standard_normal((50, 2))
    results = []
    for loop in both_loops(swap, double, repeats, *BLOCKS):
        memory, outputs = np.array([1.0, -2.0, 0.5, 0.25]), np.zeros((50, loop.outputs.size))
        assert loop.run(rows, np.array([0.9]), memory, outputs) == 50
        results.append((memory, outputs))
    for native, plain in zip(*results, strict=True):
        np.testing.assert_allclose(native, plain, rtol=1e-13)  # 50 steps of a few roundings each


@pytest.mark.parametrize("which", [0, 1], ids=["native", "float"])
def test_a_loop_stops_before_memory_that_is_not_finite(which: int) -> None:
    def grow(inputs: Any, parameters: Any, memory: Any) -> Any:
        return {"x": memory["x"]}, {"x": memory["x"] * 1e100}

    loop = both_loops(grow, grow, 0, Block.of({"u": ()}), Block(), Block.of({"x": ()}))[which]
    memory, outputs = np.array([1.0]), np.zeros((10, 1))
    assert loop.run(np.zeros((10, 1)), np.zeros(0), memory, outputs) == 3
    assert memory.tolist() == [1e300]
    assert outputs[:4, 0].tolist() == [1.0, 1e100, 1e200, 1e300]


def test_a_loop_over_no_rows_does_nothing() -> None:
    loop, _ = both_loops(swap, double, 0, *BLOCKS)
    memory = np.array([1.0, 2.0, 3.0, 4.0])
    assert loop.run(np.zeros((0, 2)), np.array([1.0]), memory, np.zeros((0, 2))) == 0
    assert memory.tolist() == [1.0, 2.0, 3.0, 4.0]


# -------------------------------------------------------------------- contents


def program_of(function: Any) -> Program:
    return trace(lambda i, p, m: ({"y": function(i["x"])}, {}), Block.of({"x": (2,)}), Block(), Block())


def test_equal_programs_have_equal_content_however_they_were_traced() -> None:
    one = program_of(lambda x: tm.sin(x[0]) * x[1] + 1.0)
    other = program_of(lambda x: 0.0 * tm.cos(x[1]) + (1.0 + x[1] * tm.sin(x[0])))
    assert one.content == other.content
    assert one.operations == 3


@pytest.mark.parametrize(
    "function",
    [
        lambda x: tm.sin(x[0]) * x[1] + 1.0 + ULP,
        lambda x: tm.sin(x[1]) * x[0] + 1.0,
        lambda x: tm.cos(x[0]) * x[1] + 1.0,
        lambda x: [tm.sin(x[0]) * x[1] + 1.0, 0.0],
        lambda x: tm.sin(x[0]) * x[1] - 1.0,
    ],
    ids=["a constant", "inputs", "an operation", "outputs", "a sign"],
)
def test_other_programs_have_other_content(function: Any) -> None:
    assert program_of(function).content != program_of(lambda x: tm.sin(x[0]) * x[1] + 1.0).content


def test_blocks_lay_fields_one_behind_the_other() -> None:
    block = Block.of({"a": (2,), "b": (), "c": (2, 2)})
    assert block.size == 7
    assert [field.offset for field in block.fields] == [0, 2, 3]
    flat = block.pack({"a": [1, 2], "b": 3, "c": [[4, 5], [6, 7]]})
    assert flat.tolist() == [1, 2, 3, 4, 5, 6, 7]
    views = block.views(flat)
    assert views["c"].tolist() == [[4, 5], [6, 7]]
    views["b"][...] = 9.0
    assert flat[2] == 9.0
    rows = block.views(np.arange(14.0).reshape(2, 7))
    assert rows["c"].shape == (2, 2, 2)
    assert rows["b"].tolist() == [2.0, 9.0]
