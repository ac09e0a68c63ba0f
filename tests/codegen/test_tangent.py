"""The derivative of a step along a direction: against closed forms, native against node by node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from taut.codegen.engine import Steps
from taut.codegen.native import available
from taut.codegen.program import Block
from taut.codegen.tangent import TANGENT, StepTangent
from taut.trace import math as tm

Values = Mapping[str, Any]
REPEATS = 3


def step(inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
    x = memory["x"]
    after = tm.array([tm.sin(x[0]) * parameters["k"], x[1] + inputs["u"] * x[0]])
    return {"y": x[0] * x[1] + inputs["u"], "z": x[1]}, {"x": after, "n": memory["n"] + 1.0}


def substep(inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
    x = memory["x"]
    return {}, {"x": tm.array([x[0] + parameters["k"] * x[1], x[1] * x[1]]), "n": memory["n"]}


def tangent(engine: str) -> StepTangent:
    blocks = (Block.of({"u": ()}), Block.of({"k": (), "unused": ()}), Block.of({"x": (2,), "n": ()}))
    return StepTangent(Steps(step, *blocks, substep, REPEATS), directed=("k",), outputs=("y",), engine=engine)


def by_hand(u: float, k: float, x: np.ndarray, du: float, dk: float, dx: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The memory after the step and its derivative, rule by rule."""
    y = np.array([np.sin(x[0]) * k, x[1] + u * x[0]])
    dy = np.array([np.cos(x[0]) * k * dx[0] + np.sin(x[0]) * dk, dx[1] + du * x[0] + u * dx[0]])
    for _ in range(REPEATS):
        dy = np.array([dy[0] + dk * y[1] + k * dy[1], 2.0 * y[1] * dy[1]])
        y = np.array([y[0] + k * y[1], y[1] ** 2])
    return y, dy


def rows(random: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    return random.normal(size=(count, 2)), random.normal(size=(count, 3)), random.normal(size=(count, 6))


@pytest.mark.parametrize("engine", ["native", "float"])
def test_the_chain_rule_goes_through_step_and_substeps(engine: str) -> None:
    made = tangent(engine)
    inputs, parameters, memory = rows(np.random.default_rng(0), 20)
    out, new = made.rows(inputs, parameters, memory)
    shown, after = made.outputs.views(out), made.memory.views(new)
    for i, ((u, du), (k, _, dk), m) in enumerate(zip(inputs, parameters, memory, strict=True)):
        x, dx = m[:2], m[3:5]
        y, dy = by_hand(u, k, x, du, dk, dx)
        assert after["x"][i] == pytest.approx(y, rel=1e-13)
        assert after[f"{TANGENT}x"][i] == pytest.approx(dy, rel=1e-12, abs=1e-13)
        assert shown[f"{TANGENT}y"][i] == pytest.approx(dx[0] * x[1] + x[0] * dx[1] + du, rel=1e-13)
        assert after["n"][i] == m[2] + 1.0
        assert after[f"{TANGENT}n"][i] == m[5]


def test_outputs_whose_derivative_nobody_wants_are_given_alone() -> None:
    assert set(tangent("float").outputs.shapes) == {"y", "z", f"{TANGENT}y"}


@pytest.mark.parametrize("engine", ["native", "float"])
def test_the_length_of_a_vector_that_is_zero_has_the_mean_of_its_slopes(engine: str) -> None:
    """|x| x has the derivative zero there, and |x| none: in place of it stands the mean of 1 and -1."""

    def lengths(inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        x = memory["x"]
        return {"y": tm.norm(x)}, {"x": (1.0 + tm.norm(x)) * x}

    blocks = (Block.of({}), Block.of({}), Block.of({"x": (2,)}))
    made = StepTangent(Steps(lengths, *blocks), directed=(), outputs=("y",), engine=engine)
    none = np.zeros((2, 0))
    out, new = made.rows(none, none, np.array([[0.0, 0.0, 3.0, 4.0], [3.0, 4.0, 1.0, 0.0]]))
    assert made.outputs.views(out)[f"{TANGENT}y"] == pytest.approx([0.0, 0.6])
    assert made.memory.views(new)[f"{TANGENT}x"] == pytest.approx(np.array([[3.0, 4.0], [6.0 + 1.8, 2.4]]))


@pytest.mark.skipif(not available(), reason="needs llvmlite")
def test_native_code_and_node_by_node_agree() -> None:
    given = rows(np.random.default_rng(1), 50)
    for one, other in zip(tangent("native").rows(*given), tangent("float").rows(*given), strict=True):
        assert one == pytest.approx(other, rel=1e-13, abs=1e-14)
