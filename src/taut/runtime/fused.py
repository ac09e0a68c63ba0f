"""A run of a fused loop: controller and model plant in native code, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np

from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.layout import Block
from taut.codegen.loop import FloatLoop, NativeLoop
from taut.loop import DT, Loop
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot
from taut.record.outcome import Outcome
from taut.runtime.events import Event
from taut.runtime.feed import ReferenceFeed
from taut.runtime.tape import RowLog, Tape

__all__ = ["FusedRun"]

BLOCK: Final = 4096  # ticks between two visits of Python


class FusedRun:
    """One run of a Loop.

    Args:
        loop: The loop.
        q: (n,) true position at the start.
        v: (n,) true velocity at the start.
        seed: Seed of the noise.
        events: Events with the tick at which they act, in order.
        info: What is known of the run beforehand.
    """

    def __init__(
        self,
        loop: Loop,
        q: Float64Array,
        v: Float64Array,
        seed: int,
        events: Iterable[tuple[int, Event]],
        info: dict[str, Any],
    ) -> None:
        self._loop = loop
        side = loop.side
        self._events = [
            (tick, {path: loop.parameters.checked(path, value) for path, value in event.set.items()})
            for tick, event in events
        ]
        self._inputs, self._parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        self._values = self._parameters.pack({**loop.parameters, DT: loop.dt})
        # One generator per measurement: how the run is cut into blocks does not change the numbers.
        self._noise = {name: np.random.default_rng([seed, i]) for i, name in enumerate(sorted(loop.plant.noise))}
        at_rest = side.law.reference.at_rest(q)
        self._feed = ReferenceFeed(loop.ref, side.law.reference, side.arm.n, loop.dt, at_rest)
        first = np.zeros((1, self._inputs.size))
        self._fill_row(first, lambda: self._plain_snapshot(q, v, 0.0))
        memory = loop.start(q, v, self._inputs.views(first[0]), self._parameters.views(self._values))
        self._memory = Block.of({path: np.shape(value) for path, value in memory.items()})
        self._state = self._memory.pack(memory)
        make = NativeLoop if loop.engine == "native" else FloatLoop
        repeats = loop.plant.substeps - 1
        self._run = make(loop.step, loop.substep, repeats, self._inputs, self._parameters, self._memory)
        self.tape = Tape(side, loop.plant, loop.ticks, self._inputs, self._run.outputs, info)
        self.tape.input_rows[0] = first[0]

    def _fill_row(self, rows: Float64Array, state: Callable[[], Snapshot]) -> None:
        """Reference and noise of the first tick, which the start needs before there is a tape."""
        views = self._inputs.views(rows)
        self._feed.fill(subtree(views, "ref"), 0, state)
        self._draw(views)

    def _draw(self, views: dict[str, Float64Array]) -> None:
        for name, column in subtree(views, "noise").items():
            column[...] = self._noise[name].standard_normal(column.shape)

    def go(self, advance: Callable[[int], None], log: RowLog | None) -> tuple[int, Outcome]:
        """Run to the end: (number of rows recorded, outcome)."""
        tape, ticks, k = self.tape, self._loop.ticks, 0
        running = Outcome(kind="stopped", message="the run is still going on", tick=0)
        while k < ticks:
            end = self._end_of_block(k, ticks)
            self._prepare(k, end)
            done = self._run.run(tape.input_rows[k:end], self._values, self._state, tape.output_rows[k:end])
            if done < end - k:
                kept, outcome = tape.diverged(k + done)
                if log is not None:
                    log.write(tape.piece(k, kept, running))
                return kept, outcome
            if log is not None:
                log.write(tape.piece(k, end, running))
            advance(end - k)
            k = end
        message = f"completed: {ticks} ticks, {self._loop.duration:g} s"
        return ticks, Outcome(kind="completed", message=message, tick=ticks - 1)

    def _end_of_block(self, k: int, ticks: int) -> int:
        stops = [k + BLOCK, ticks, *(tick for tick, _ in self._events if tick > k)]
        question = self._feed.next_question(k)
        return min(stops if question is None else [*stops, question])

    def _prepare(self, k: int, end: int) -> None:
        """Events that act at tick k, then reference and noise of the block."""
        for tick, values in self._events:
            if tick == k:
                for path, value in values.items():
                    self._parameters.views(self._values)[path][...] = value
        self._feed.fill(self.tape.reference(k, end), k, lambda: self._snapshot(k))
        first = max(k, 1)  # the noise of row 0 was drawn at the start
        self._draw({path: column[first:end] for path, column in self.tape.inputs.items()})

    def _snapshot(self, k: int) -> Snapshot:
        memory = subtree(self._memory.views(self._state), "plant")
        return self._plain_snapshot(memory["q"].copy(), memory["v"].copy(), k * self._loop.dt)

    def _plain_snapshot(self, q: Float64Array, v: Float64Array, t: float) -> Snapshot:
        parameters = self._parameters.views(self._values)
        payload = PayloadValues.of(subtree(parameters, "model.payload"))
        return Snapshot(self._loop.side.model, q=q, v=v, t=t, payload=payload)
