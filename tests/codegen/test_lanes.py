"""Code in lanes: the bits of one lane in every lane, in double and in single precision."""

from __future__ import annotations

import ctypes
import math
from typing import Any

import numpy as np
import pytest

import taut
from taut import math as tm
from taut.codegen.functions import DOUBLE, SINGLE
from taut.codegen.llvm import ONE, Lanes, declarations, kernel, products_in_sums
from taut.codegen.native import compiled
from taut.codegen.program import Block, Program, trace

FLOAT = Lanes(1, SINGLE)
COUNT = 96  # a multiple of every number of lanes


def everything(inputs: Any, parameters: Any, memory: Any) -> Any:
    """Operations of each kind, products and sums among them in every order."""
    x, y, z = inputs["x"]
    a, b = memory["a"]
    k = parameters["k"]
    mixed = [x * y + z, x - y * z, x * y - z, x * y + y * z, x * y - z * a, tm.sin(x * y + b), tm.exp(x) * tm.cos(y)]
    more = [tm.sqrt(x * x + y * y), tm.maximum(x * k, y) / (1.0 + z * z), tm.atan2(x, y), tm.where(x * y > z, a, b)]
    rest = [tm.log(tm.abs(x)), tm.tanh(y), tm.asin(0.3 * tm.sin(x)), tm.acos(0.5 * tm.cos(z)), tm.floor(3.0 * x)]
    rest += [
        tm.minimum(x, y),
        tm.maximum(y, z),
        tm.minimum(z, 0.25),
        tm.where((x > y) & ~(y <= z) | (z == 0.0), -x, y),
    ]
    return {"y": tm.array([*mixed, *more, *rest])}, {"a": tm.array([0.9 * a + 0.1 * tm.sin(b + x), b - k * a * y])}


PROGRAM = trace(everything, Block.of({"x": (3,)}), Block.of({"k": ()}), Block.of({"a": (2,)}))


def run(program: Program, lanes: Lanes, rows: list[Any]) -> tuple[Any, Any]:
    """(COUNT, m) outputs and new memory, of (COUNT, ...) inputs, parameters and memory."""
    text = "\n".join([declarations(lanes), kernel(program, "kernel", lanes)])
    module = compiled(f"{lanes}".encode() + program.content, lambda: text, ("kernel",))
    function = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)(module["kernel"])
    out = [np.empty((COUNT, size)) for size in (program.memory.size, program.outputs.size)]
    for i in range(0, COUNT, lanes.count):
        group = slice(i, i + lanes.count)
        given = [np.ascontiguousarray(block[group].T, dtype=lanes.real.dtype) for block in rows]
        made = [np.empty((block.shape[1], lanes.count), dtype=lanes.real.dtype) for block in out]
        function(*(block.ctypes.data for block in (*given, *made)))
        for block, values in zip(out, made, strict=True):
            block[group] = values.T
    return out[1], out[0]


def samples(seed: int = 0) -> list[Any]:
    rng = np.random.default_rng(seed)
    return [rng.standard_normal((COUNT, size)) for size in (3, 1, 2)]


@pytest.mark.parametrize("count", [2, 4, 8, 16])
@pytest.mark.parametrize("real", [DOUBLE, SINGLE], ids=["double", "float"])
def test_every_lane_has_the_bits_of_one(count: int, real: Any) -> None:
    rows = samples()
    rows[0][3], rows[0][10], rows[0][17] = math.nan, math.inf, 0.0  # which no other lane sees
    for wide, alone in zip(run(PROGRAM, Lanes(count, real), rows), run(PROGRAM, Lanes(1, real), rows), strict=True):
        np.testing.assert_array_equal(wide, alone)


def test_single_precision_is_double_precision_to_its_own_rounding() -> None:
    for few, many in zip(run(PROGRAM, FLOAT, samples(1)), run(PROGRAM, ONE, samples(1)), strict=True):
        close = np.abs(few - many) <= 1e-5 * np.maximum(1.0, np.abs(many))
        assert close.mean() > 0.995  # a branch or a floor may fall to the other side
        assert np.abs(few - many).max() <= 1.0 + 1e-5


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("function", "low", "high"),
    [
        *((tm.sin, -30.0, 30.0), (tm.cos, -30.0, 30.0), (tm.exp, -80.0, 80.0), (tm.log, 1e-30, 1e3)),
        *((tm.tanh, -3.0, 3.0), (tm.asin, -1.0, 1.0), (tm.acos, -1.0, 1.0)),
        (lambda x: tm.atan2(x, 1.0 - x), -4.0, 4.0),
    ],
)
def test_functions_in_single_precision_have_an_error_of_some_units(function: Any, low: float, high: float) -> None:
    program = trace(lambda i, _p, _m: ({"y": function(i["x"])}, {}), Block.of({"x": ()}), Block(), Block())
    empty, rng = np.zeros((COUNT, 0)), np.random.default_rng(0)
    for _ in range(20):
        x = rng.uniform(low, high, (COUNT, 1)).astype(np.float32).astype(np.float64)
        got, _ = run(program, FLOAT, [x, empty, empty])
        exact, _ = run(program, ONE, [x, empty, empty])
        scale = np.maximum(np.abs(exact), 1.0 if low < 0.0 and function in (tm.sin, tm.cos) else 0.0)
        assert (np.abs(got - exact) <= 4.0 * np.spacing(scale.astype(np.float32))).all()


def test_ends_of_functions_in_single_precision() -> None:
    ends = trace(
        lambda i, _p, _m: ({"y": tm.array([tm.exp(i["x"]), tm.log(i["x"]), tm.sin(i["x"]), tm.tanh(i["x"])])}, {}),
        Block.of({"x": ()}), Block(), Block(),
    )  # fmt: skip
    x = np.resize([math.inf, -math.inf, math.nan, 0.0, 1e30, -200.0, 200.0], COUNT)[:, np.newaxis]
    got, _ = run(ends, FLOAT, [x, np.zeros((COUNT, 0)), np.zeros((COUNT, 0))])
    nan, inf = math.nan, math.inf
    np.testing.assert_array_equal(got[0], [inf, inf, nan, 1.0])
    np.testing.assert_array_equal(got[1], [0.0, nan, nan, -1.0])
    np.testing.assert_array_equal(got[2], [nan, nan, nan, nan])
    np.testing.assert_array_equal(got[3], [1.0, -inf, 0.0, 0.0])
    assert got[4, 0] == inf and math.isnan(got[4, 2]) and got[4, 3] == 1.0  # noqa: PT018
    assert got[5, 0] == 0.0 and got[6, 0] == inf  # noqa: PT018


# -------------------------------------------------------------------- parts of a program


def test_a_part_of_a_program_has_the_bits_of_all_of_it() -> None:
    """What is left out changes which products nothing else needs, and so which are rounded with their sum."""
    both = trace(
        lambda i, _p, m: ({"product": i["x"] * i["y"]}, {"a": i["x"] * i["y"] + m["a"]}),
        Block.of({"x": (), "y": ()}), Block(), Block.of({"a": ()}),
    )  # fmt: skip
    part = Program(
        graph=both.graph, inputs=both.inputs, parameters=both.parameters, memory=both.memory,
        outputs=Block(), output_nodes=(), memory_nodes=both.memory_nodes,
    )  # fmt: skip
    assert products_in_sums(part) != products_in_sums(both) == {}
    texts = [kernel(part, "kernel", fused=fused) for fused in (None, products_in_sums(both))]
    assert ["fmuladd" in text for text in texts] == [True, False]
    whole = kernel(both, "kernel", fused=products_in_sums(part))  # a product that is needed alone too
    assert "fmuladd" in whole
    assert "fmul double" in whole


def test_a_law_in_lanes_has_the_bits_of_one() -> None:
    program = taut.compile(taut.laws.Impedance(K=(400.0, 20.0), zeta=1.0), taut.load_arm("panda")).program
    rng = np.random.default_rng(2)
    rows = [rng.standard_normal((COUNT, b.size)) for b in (program.inputs, program.parameters, program.memory)]
    rows[1] = np.abs(rows[1])
    for wide, alone in zip(run(program, Lanes(8), rows), run(program, ONE, rows), strict=True):
        np.testing.assert_array_equal(wide, alone)
