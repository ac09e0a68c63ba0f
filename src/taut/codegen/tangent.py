"""A step with its derivative along one direction: compiled once, called for each direction.

Value and derivative are one program and share subexpressions. Its blocks are those of the step, each followed by the
direction: the derivative of each number.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.codegen.engine import Engine, Steps
from taut.codegen.loop import Run, TracedSteps, loop_text, native_loop
from taut.codegen.native import QUICK, available, compiled
from taut.codegen.program import Block, Function, Program, Values
from taut.trace.array import traced_array
from taut.trace.derivative import tangents
from taut.trace.scalar import Condition, active_graph, to_node, to_symbol

TANGENT: Final = "tangent."  # begins the path of a derivative


def tangent_block(block: Block, directed: Collection[str] | None = None) -> Block:
    """The block, and behind it the direction of each field, or of those that are `directed`."""
    some = block.shapes if directed is None else {p: s for p, s in block.shapes.items() if p in directed}
    return Block.of({**block.shapes, **{f"{TANGENT}{path}": shape for path, shape in some.items()}})


def with_tangent(function: Function, outputs: Collection[str]) -> Function:
    """A function as its values and their derivatives along a direction, for tracing, on blocks as of `tangent_block`.

    It gives all outputs, the derivatives of those in `outputs`, and the new memory with its derivative. The length
    of a vector that is zero has the mean of its slopes.
    """

    def both(inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:
        graph = active_graph()
        assert graph is not None, "derivatives are taken of a trace"
        seeds: dict[int, int] = {}
        plain: list[dict[str, Any]] = []
        for block in (inputs, parameters, memory):
            plain.append({path: value for path, value in block.items() if not path.startswith(TANGENT)})
            for path, value in plain[-1].items():
                if TANGENT + path in block:
                    ways = np.ravel(np.asarray(block[TANGENT + path], dtype=object))
                    numbers = np.ravel(np.asarray(value, dtype=object))
                    seeds |= {to_node(graph, x): to_node(graph, dx) for x, dx in zip(numbers, ways, strict=True)}
        recorded, after = function(*plain)
        moved = {f"out.{path}": recorded[path] for path in outputs} | {f"new.{path}": x for path, x in after.items()}
        values = {path: np.asarray(value, dtype=object) for path, value in moved.items()}
        nodes = [
            to_node(graph, x.number() if isinstance(x, Condition) else x)
            for value in values.values()
            for x in value.flat
        ]
        found = iter(tangents(graph, nodes, seeds, means=True))
        ways_out: dict[str, Any] = {}
        for path, value in values.items():
            symbols = [to_symbol(graph, next(found)) for _ in range(value.size)]
            ways_out[path] = symbols[0] if value.ndim == 0 else traced_array(symbols).reshape(value.shape)
        return (
            {**recorded, **{f"{TANGENT}{path}": ways_out[f"out.{path}"] for path in outputs}},
            {**after, **{f"{TANGENT}{path}": ways_out[f"new.{path}"] for path in after}},
        )

    return both


class StepTangent:
    """A step and its substeps with their derivative along a direction; plain Python evaluates all at once."""

    def __init__(
        self,
        steps: Steps,
        *,
        directed: Collection[str],  # parameters that a direction may have; inputs and memory always may
        outputs: Collection[str],
        engine: Engine,
    ) -> None:
        self.inputs, self.memory = tangent_block(steps.inputs), tangent_block(steps.memory)
        self.parameters = tangent_block(steps.parameters, directed)
        both = with_tangent(steps.step, outputs)
        inner = None if steps.substep is None else with_tangent(steps.substep, ())
        period = Steps(both, self.inputs, self.parameters, self.memory, inner, steps.repeats)
        self._period = TracedSteps(period)
        self.outputs, self.operations = self._period.step.outputs, self._period.operations
        self._native: Run | None = None
        if engine == "native" and available():
            self._module = compiled(b"tangent" + self._period.content, self._text, ("loop",), level=QUICK)
            self._native = native_loop(self._module["loop"])

    def _text(self) -> str:
        return "\n".join([self._period.text(), loop_text(self.memory.size, self._period.repeats)])

    def rows(
        self, inputs: Float64Array, parameters: Float64Array, memory: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """(k, ...) outputs and memory after a period, for k rows of inputs, parameters and memory with directions."""
        count = len(inputs)
        given = [np.ascontiguousarray(block, dtype=np.float64) for block in (inputs, parameters, memory)]
        if self._native is None:
            return self._plain_rows(*given)
        out, new = np.zeros((count, self.outputs.size)), given[2].copy()
        self._native(*given[:2], new, out)
        return out, new

    def _plain_rows(
        self, inputs: Float64Array, parameters: Float64Array, memory: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        outputs, new = _evaluated(self._period.step, inputs, parameters, memory)
        if self._period.inner is not None:
            for _ in range(self._period.repeats):
                _, new = _evaluated(self._period.inner, inputs, parameters, new)
        return outputs, new


def _evaluated(program: Program, *blocks: Float64Array) -> tuple[Float64Array, Float64Array]:
    """A program at many rows at once, each node an array of NumPy's."""
    rows = np.concatenate(blocks, axis=1)
    with np.errstate(all="ignore"):
        ends = program.evaluated(rows.T)
    made = [np.zeros((len(rows), len(end))) for end in ends]
    for out, end in zip(made, ends, strict=True):
        for k, value in enumerate(end):
            out[:, k] = value
    return made[0], made[1]
