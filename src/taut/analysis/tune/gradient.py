"""The derivative of a run by its parameters: each tick with its derivative along each direction, in native code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError, UsageError
from taut.base.types import Float64Array
from taut.codegen.engine import Steps
from taut.codegen.layout import Block
from taut.codegen.tangent import TANGENT, StepTangent, tangent_block
from taut.loop import DT, Loop
from taut.runtime.fused import FusedRun

__all__ = ["Along", "TangentLoop"]

STAGE: Final = "stage"
STEPS: Final = ".resolution"
MOVED: Final = 1e-3  # of a parameter, to see whether what a loop starts with depends on it


@dataclass(frozen=True, kw_only=True, eq=False)
class Along:
    """A run with its derivatives by d parameters.

    Args:
        stage: (k,) the cost of each tick.
        stage_ways: (d, k).
        tau: (k, n) [N m | N].
        tau_ways: (d, k, n).
    """

    stage: Float64Array
    stage_ways: Float64Array
    tau: Float64Array
    tau_ways: Float64Array


class TangentLoop:
    """A loop with the derivative of its cost and torques by parameters, compiled once.

    Exact, as automatic differentiation is: through law, sensing, limits, drives and arm, with the noise of a seed as
    it is. A non-smooth point has the derivative of the branch that it is on.

    Args:
        loop: The loop.
        paths: The parameters.
        stage: (inputs, what a tick records) -> its share of the cost.

    Raises:
        UsageError: Encoders or amplifiers with steps, which have no derivative.
    """

    def __init__(self, loop: Loop, paths: Sequence[str], stage: Callable[[Any, Any], Any]) -> None:
        steps = [path for path in loop.parameters if path.endswith(STEPS)]
        if steps:
            raise UsageError(
                f"method='gradient' needs a plant without steps, and this one has {steps[0]}; leave it out, or take "
                "method='search'",
                name="method",
            )
        self.loop, self.paths = loop, tuple(paths)
        self._stage = stage
        self.inputs, self.parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        self._tangent: StepTangent | None = None

    def _step(self, inputs: Any, parameters: Any, memory: Any) -> Any:
        record, after = self.loop.step(inputs, parameters, memory)
        return {STAGE: self._stage(inputs, record), "tau": record["tau"]}, after

    def _started(self, q: Float64Array, v: Float64Array, row: Float64Array, values: Float64Array) -> dict[str, Any]:
        return self.loop.start(q, v, self.inputs.views(row), self.parameters.views(values))

    def along(self, ways: Mapping[str, Float64Array], q: Float64Array, v: Float64Array, seed: int) -> Along:
        """The run with the loop's parameters as they are.

        Args:
            ways: By path, (d, ...) how each direction changes the parameter.
            q: (n,) positions at the start.
            v: (n,) velocities at the start.
            seed: Of the noise.

        Raises:
            RangeError: The run diverges.
        """
        loop = self.loop
        fused = FusedRun(loop, q, v, seed, ())
        kept, outcome = fused.go(lambda _: None, None)
        if not outcome.ok:
            raise RangeError(f"the run has no gradient: {outcome}", name="gradient")
        rows = fused.tape.input_rows[:kept]
        values = self.parameters.pack({**loop.parameters, DT: loop.dt})
        start = self._started(q, v, rows[0], values)
        if self._tangent is None:
            block = Block.of({path: np.shape(value) for path, value in start.items()})
            self._tangent = StepTangent(
                Steps(self._step, self.inputs, self.parameters, block, loop.substep, loop.plant.substeps - 1),
                directed=self.paths, outputs=(STAGE, "tau"), engine=loop.engine,
            )  # fmt: skip
            self.memory = block
        self._require_still(ways, q, v, rows[0], start)
        return self._gone(ways, rows, values, self.memory.pack(start))

    def _require_still(self, ways: Any, q: Any, v: Any, row: Any, start: Mapping[str, Any]) -> None:
        """What the loop starts with must not depend on what is tuned."""
        for path in self.paths:
            moved = dict(self.loop.parameters)
            moved[path] = moved[path] * (1.0 + MOVED) + MOVED * np.abs(ways[path]).max(axis=0)
            other = self._started(q, v, row, self.parameters.pack({**moved, DT: self.loop.dt}))
            for name, value in start.items():
                if not np.array_equal(np.asarray(value), np.asarray(other[name])):
                    raise UsageError(
                        f"what the loop starts with depends on {path} ('{name}'), so that the gradient of its cost "
                        "is not known; take method='search'",
                        name=path,
                    )

    def _gone(
        self, ways: Mapping[str, Float64Array], rows: Float64Array, values: Float64Array, start: Float64Array
    ) -> Along:
        assert self._tangent is not None
        t, count = self._tangent, len(next(iter(ways.values())))
        inputs, parameters, memory = (np.zeros((count, block.size)) for block in (t.inputs, t.parameters, t.memory))
        parameters[:, : len(values)] = values
        directed = tangent_block(self.parameters, self.paths)
        for path, way in ways.items():
            field = directed.field(f"{TANGENT}{path}")
            parameters[:, field.offset : field.offset + field.size] = way.reshape(count, -1)
        memory[:, : len(start)] = start
        n, ticks = self.loop.plant.arm.n, len(rows)
        stage, tau = np.zeros(ticks), np.zeros((ticks, n))
        stage_ways, tau_ways = np.zeros((count, ticks)), np.zeros((count, ticks, n))
        for k in range(ticks):
            inputs[:, : rows.shape[1]] = rows[k]
            out, memory = t.rows(inputs, parameters, memory)
            seen = t.outputs.views(out)
            stage[k], tau[k] = seen[STAGE][0], seen["tau"][0]
            stage_ways[:, k], tau_ways[:, k] = seen[TANGENT + STAGE], seen[TANGENT + "tau"]
        return Along(stage=stage, stage_ways=stage_ways, tau=tau, tau_ways=tau_ways)
