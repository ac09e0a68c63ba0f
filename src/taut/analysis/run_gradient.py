"""Derivative of the cost and torques of a run by parameters, exact, every tick in native code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError, UsageError, unknown_name
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.engine import Steps
from taut.codegen.program import Block
from taut.codegen.tangent import TANGENT, StepTangent, tangent_block
from taut.control.trajectories.reference import JointMotion
from taut.control.trajectories.task_reference import TaskMotion
from taut.loop import DT, Loop
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.maths.spatial import rotation_log
from taut.runtime.events import Schedule
from taut.runtime.ongoing import FusedRun
from taut.trace import math as tm

PROBE: Final = 1e-3  # relative change of a parameter, to see whether the state at the start depends on it


def _squared(rows: Any) -> Any:
    return tm.array(list(rows)) @ tm.array(list(rows))


@dataclass(frozen=True, kw_only=True, eq=False)
class RunSlopes:
    """Cost and torques of a run of k ticks, each with its derivative along d directions."""

    dt: float  # [s]
    cost: Float64Array  # (k,)
    cost_slopes: Float64Array  # (d, k)
    tau: Float64Array  # (k, n) [N m | N]
    tau_slopes: Float64Array  # (d, k, n)
    error: Float64Array  # (k,) norm of the tracking error [rad | m]; NaN where the law follows no motion

    def mean_cost(self) -> tuple[float, Float64Array]:
        """The cost of the run, and (d,) its derivative."""
        return float(self.cost.mean()), self.cost_slopes.mean(axis=1)

    def chatter(self) -> tuple[float, Float64Array]:
        """Total variation of the torques per second [N m/s], and (d,) its derivative."""
        steps, slopes = np.diff(self.tau, axis=0), np.diff(self.tau_slopes, axis=1)
        seconds = len(steps) * self.dt
        return float(np.abs(steps).sum()) / seconds, (np.sign(steps) * slopes).sum(axis=(1, 2)) / seconds

    def largest(self, limit: ArrayLike | None, *, rate: bool = False) -> tuple[float, Float64Array]:
        """The largest torque, or rate of a torque, as a fraction of a limit, and (d,) its derivative; NaN without."""
        if limit is None:
            return np.nan, np.zeros(len(self.tau_slopes))
        rows, slopes = self.tau, self.tau_slopes
        if rate:
            rows, slopes = np.diff(rows, axis=0) / self.dt, np.diff(slopes, axis=1) / self.dt
        limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), rows.shape)
        k, i = np.unravel_index(int(np.argmax(np.abs(rows) / limits)), rows.shape)
        return float(abs(rows[k, i]) / limits[k, i]), np.sign(rows[k, i]) * slopes[:, k, i] / limits[k, i]


@contextmanager
def _changed(loop: Loop, values: Mapping[str, ArrayLike]) -> Iterator[None]:
    """A loop with some parameters changed for a while."""
    before = {path: np.array(loop.parameters[path]) for path in values}
    try:
        for path, value in values.items():
            loop.parameters[path] = value
        yield
    finally:
        for path, value in before.items():
            loop.parameters[path] = value


class RunGradient:
    """A loop with the derivative of its cost and torques by parameters, compiled once.

    Exact by automatic differentiation through law, sensing, limits, drives and arm, with the noise of a seed; at a
    non-smooth point that of the branch taken.
    """

    def __init__(self, loop: Loop, paths: Sequence[str], cost: str | Mapping[str, float]) -> None:
        self._loop, self._paths = loop, tuple(paths)
        self._weights = {cost: 1.0} if isinstance(cost, str) else dict(cost)
        kind = loop.side.law.reference
        costs = ["effort", "speed"]
        costs += ["tracking"] if issubclass(kind, (JointMotion, TaskMotion)) else []
        costs += ["rotation"] if issubclass(kind, TaskMotion) else []
        for name in self._weights:
            if name not in costs:
                raise unknown_name(f"a law that follows a {kind.described()}", "cost", name, costs)
        self._inputs, self._parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        self._compiled: tuple[StepTangent, Block] | None = None  # and the memory

    def _step(self, inputs: Any, parameters: Any, memory: Any) -> Any:
        loop = self._loop
        record, after = loop.step(inputs, parameters, memory)
        errors = self._errors(record["q"], loop.side.law.reference.of(subtree(inputs, "ref")))
        vectors = {"effort": record["tau"], "speed": record["v"], **errors}
        cost = sum(weight * _squared(vectors[name]) for name, weight in self._weights.items())
        outputs = {"cost": cost, "tau": record["tau"]}
        if "tracking" in vectors:
            outputs["error"] = tm.sqrt(_squared(vectors["tracking"]))
        return outputs, after

    def _errors(self, q: Any, ref: Any) -> dict[str, Any]:
        """The tracking error of joints [rad | m]; or of the tool's position [m], and its rotation vector [rad]."""
        law, arm = self._loop.side.law, self._loop.plant.arm
        if issubclass(law.reference, JointMotion):
            return {"tracking": arm.difference(ref.q, q)}
        if not issubclass(law.reference, TaskMotion):
            return {}
        T = dyn.pose(model_of(arm), q, law.controlled_frame)
        return {"tracking": ref.motion.p - T.p, "rotation": rotation_log(ref.motion.R @ T.R.T)}

    def at(
        self,
        changes: Mapping[str, ArrayLike],
        directions: Mapping[str, Float64Array],
        q: Float64Array,
        v: Float64Array,
        seed: int,
    ) -> RunSlopes:
        """The run from q, v with parameters changed, and its derivative along (d, ...) directions by path."""
        loop = self._loop
        with _changed(loop, changes):
            fused = FusedRun(loop, q, v, seed, Schedule(loop.side, loop.plant, loop.parameters, (), loop.ticks))
            kept, outcome = fused.go(lambda _: None, None)
            numbers = {**loop.parameters, DT: loop.dt}
        if not outcome.ok:
            raise RangeError(outcome.message, name="cost")
        rows = fused.tape.input_rows[:kept]

        def started(numbers: Mapping[str, Any]) -> dict[str, Any]:
            values = self._parameters.views(self._parameters.pack(numbers))
            return loop.start(q, v, self._inputs.views(rows[0]), values)

        start = started(numbers)
        for path in self._paths:  # the derivative of the state at the start is not known
            probe = np.asarray(numbers[path]) * (1.0 + PROBE) + PROBE * np.abs(directions[path]).max(axis=0)
            other = started({**numbers, path: probe})
            if any(not np.array_equal(value, other[name]) for name, value in start.items()):
                raise UsageError(
                    f"the state of the loop at the start depends on {path}, so that the derivative of the cost is "
                    "not known; leave it out of paths",
                    name=path,
                )
        if self._compiled is None:
            block = Block.of({path: np.shape(value) for path, value in start.items()})
            steps = Steps(self._step, self._inputs, self._parameters, block, loop.substep, loop.plant.substeps - 1)
            outputs = ("cost", "tau")
            self._compiled = StepTangent(steps, directed=self._paths, outputs=outputs, engine=loop.engine), block
        return self._advanced(directions, rows, self._parameters.pack(numbers), self._compiled[1].pack(start))

    def _advanced(
        self, directions: Mapping[str, Float64Array], rows: Float64Array, values: Float64Array, start: Float64Array
    ) -> RunSlopes:
        """All ticks, each with its derivative along each direction."""
        assert self._compiled is not None
        steps, d = self._compiled[0], len(next(iter(directions.values())))
        inputs, parameters, memory = (
            np.zeros((d, block.size)) for block in (steps.inputs, steps.parameters, steps.memory)
        )
        parameters[:, : len(values)] = values
        directed = tangent_block(self._parameters, self._paths)
        for path, direction in directions.items():
            field = directed.field(f"{TANGENT}{path}")
            parameters[:, field.offset : field.offset + field.size] = direction.reshape(d, -1)
        memory[:, : len(start)] = start
        n, ticks = self._loop.plant.arm.n, len(rows)
        cost, tau, error = np.zeros(ticks), np.zeros((ticks, n)), np.full(ticks, np.nan)
        cost_slopes, tau_slopes = np.zeros((d, ticks)), np.zeros((d, ticks, n))
        for k in range(ticks):
            inputs[:, : rows.shape[1]] = rows[k]
            out, memory = steps.rows(inputs, parameters, memory)
            seen = steps.outputs.views(out)
            cost[k], tau[k] = seen["cost"][0], seen["tau"][0]
            if "error" in seen:
                error[k] = seen["error"][0]
            cost_slopes[:, k], tau_slopes[:, k] = seen[TANGENT + "cost"], seen[TANGENT + "tau"]
        return RunSlopes(
            dt=self._loop.dt, cost=cost, cost_slopes=cost_slopes, tau=tau, tau_slopes=tau_slopes, error=error
        )
