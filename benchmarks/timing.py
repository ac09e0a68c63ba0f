"""Timing, as ratios within one run: cases take turns in every round, and medians of rounds are compared."""

from __future__ import annotations

import os
import tempfile
import time
import timeit
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.codegen.engine import Steps
from taut.codegen.loop import StepLoop
from taut.codegen.program import Block
from taut.control.trajectories.joint import Sine
from taut.controller import Controller
from taut.loop import DT, Loop
from taut.plant.rigid import RigidPlant

BENCH_ROUNDS: Final = 9
BUDGET: Final = 0.05  # [s] that one case takes in one round


@dataclass(frozen=True)
class Timing:
    """Seconds per call of one case: one median per round."""

    rounds: Float64Array

    @property
    def median(self) -> float:
        """Median over the rounds [s]."""
        return float(np.median(self.rounds))

    @property
    def spread(self) -> float:
        """Half the range between the quartiles, relative to the median."""
        low, high = np.quantile(self.rounds, (0.25, 0.75))
        return float((high - low) / 2.0 / self.median)

    def times_faster_than(self, other: Timing) -> float:
        """Median of the per-round ratios other / this."""
        return float(np.median(other.rounds / self.rounds))


def interleaved(
    cases: Mapping[str, Callable[[], object] | str],
    names: Mapping[str, object] | None = None,
    *,
    rounds: int = BENCH_ROUNDS,
    budget: float = BUDGET,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Timing]:
    """Time every case in every round, for about `budget` seconds each; the collector rests meanwhile.

    Args:
        cases: Functions, or statements such as "f(x)", which cost no call of their own.
        names: What the statements refer to.
        rounds: How often every case has its turn.
        budget: Time of one turn [s].
        clock: time.thread_time counts that of this thread alone, whatever else runs on the machine.
    """
    timers = {name: timeit.Timer(case, timer=clock, globals=dict(names or {})) for name, case in cases.items()}
    counts = {}
    for name, timer in timers.items():
        timer.timeit(1)
        n, spent = 1, timer.timeit(1)
        while spent < 0.2 * budget:
            n *= 2
            spent = timer.timeit(n)
        counts[name] = max(1, round(n * budget / spent)) if budget else 1
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(rounds):
        for name, timer in timers.items():
            seconds[name].append(timer.timeit(counts[name]) / counts[name])
    return {name: Timing(np.array(values)) for name, values in seconds.items()}


@contextmanager
def empty_cache() -> Iterator[None]:
    """A cache folder of its own, so that a compile is a cold one."""
    before = os.environ.get("TAUT_CACHE_DIR")
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o700)
        os.environ["TAUT_CACHE_DIR"] = folder
        try:
            yield
        finally:
            if before is None:
                del os.environ["TAUT_CACHE_DIR"]
            else:
                os.environ["TAUT_CACHE_DIR"] = before


class BareLoop:
    """The fused closed loop alone, without a record: what a sweep or a tuner runs."""

    def __init__(self, ctrl: Controller, plant: RigidPlant, ref: Sine, ticks: int) -> None:
        loop = Loop(ctrl, plant, ref, duration=(ticks - 1) * ctrl.dt)
        inputs, parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        self._values = parameters.pack({**loop.parameters, DT: loop.dt})
        self._rows = np.zeros((ticks, inputs.size))
        views = inputs.views(self._rows)
        times: Float64Array = np.arange(ticks, dtype=np.float64) * ctrl.dt
        wanted = ref.rows(times)
        views["t"][...] = times
        for name in ("q", "v", "a"):
            views[f"ref.{name}"][...] = getattr(wanted, name)
        at = self._rows[0]
        memory = loop.start(wanted.q[0], wanted.v[0], inputs.views(at), parameters.views(self._values))
        self.memory = Block.of({path: np.shape(value) for path, value in memory.items()})
        self._start = self.memory.pack(memory)
        self._state = self._start.copy()

        def step(ins: Any, values: Any, state: Any) -> Any:
            _, after = loop.step(ins, values, state)
            return {}, after

        example = at, self._values, self._start
        steps = Steps(step, inputs, parameters, self.memory, loop.substep, plant.substeps - 1)
        self.native = StepLoop(steps, example, engine="native")
        self._outputs = np.zeros((ticks, 0))
        self.ticks = ticks

    def run(self) -> Float64Array:
        """All ticks from the start; the final joint positions."""
        self._state[:] = self._start
        self.native.run(self._rows, self._values, self._state, self._outputs)
        return self.memory.views(self._state)["plant.q"]
