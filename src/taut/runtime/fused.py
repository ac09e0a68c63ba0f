"""A run of a fused loop: controller and model plant in native code, block by block."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from time import monotonic
from typing import Any, Final

import numpy as np

from taut.base.errors import NumericalError, RangeError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.loop import compiled_loop
from taut.codegen.program import Block
from taut.control.limits import take_up
from taut.control.tasks.feed import feed_of
from taut.loop import DT, Loop
from taut.maths.snapshot import Snapshot
from taut.plant.contact import check_force_feedback
from taut.record.info import Outcome
from taut.runtime.events import Event, Schedule
from taut.runtime.tape import LOG_PERIOD, OngoingRun, Tape

__all__ = ["FusedRun"]

FIRST_BLOCK: Final = 16  # ticks: how long one takes is not known yet


class FusedRun(OngoingRun):
    """One run of a Loop.

    Args:
        loop: The loop.
        q: (n,) true position at the start.
        v: (n,) true velocity at the start.
        seed: Seed of the noise.
        events: Events with the tick at which they act, in order.
    """

    def __init__(
        self,
        loop: Loop,
        q: Float64Array,
        v: Float64Array,
        seed: int,
        events: Iterable[tuple[int, Event]],
    ) -> None:
        self._loop, self._q, self._v = loop, q, v
        side = loop.side
        self._events = Schedule(side, loop.plant, loop.parameters, events)
        self._inputs, self._parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        self._values = self._parameters.pack({**loop.parameters, DT: loop.dt})
        self._numbers = self._parameters.views(self._values)  # by path
        self._apply(0)
        # One generator per measurement, by its name: neither how the run is cut into blocks nor what else is noisy
        # changes the numbers.
        self._noise = {name: np.random.default_rng([seed, *name.encode()]) for name in loop.plant.noise}
        side.check_start(q, self._numbers, loop.ref)
        check_force_feedback(side, loop.plant, q, self._numbers)
        block, packed = self._parameters, self._values  # the feed holds these, and not the run, which holds the feed
        self._feed = feed_of(side, loop.ref, q, lambda: block.views(packed))
        self._drawn = 1  # the noise of row 0 is drawn at the start
        self._ticks, self._size = loop.ticks, FIRST_BLOCK  # of the run, and of the next block
        first = np.zeros((1, self._inputs.size))
        memory = self._started(q, v, first)
        self._memory = Block.of({path: np.shape(value) for path, value in memory.items()})
        self._state = self._memory.pack(memory)
        # A sensor that fails at once is no state to compare engines at.
        blocks, example = (self._inputs, self._parameters, self._memory), (first[0], self._values, self._state)
        self._run = compiled_loop(loop, blocks, example, sound=self._sound(memory, first[0]))
        self.tape = Tape(side, loop.plant, loop.ticks, self._inputs, self._run.outputs)
        self.tape.input_rows[0] = first[0]

    def _started(self, q: Float64Array, v: Float64Array, first: Float64Array) -> dict[str, Any]:
        """Memory in the first tick, whose reference and noise (1, ...) are filled in here, before there is a tape."""
        views, parameters = self._inputs.views(first), self._numbers
        self._draw(views)
        row, plant = self._inputs.views(first[0]), self._loop.plant_at_start(q, v, parameters)
        self._feed.fill(subtree(views, "ref"), 0, lambda: self._seen(plant, None, row))
        return self._loop.start(q, v, row, parameters)

    def _sound(self, memory: Mapping[str, Any], row: Float64Array) -> bool:
        """Whether all that is measured in the first tick is finite."""
        parameters = self._numbers
        with np.errstate(all="ignore"):
            measured = self._loop.measured(subtree(memory, "plant"), self._inputs.views(row), parameters)
        return all(bool(np.isfinite(value).all()) for value in measured.values())

    def _apply(self, tick: int) -> Float64Array | None:
        """Events that act at a tick; if a blend takes up the change, the parameters without what it is to take up."""
        side, new, views = self._loop.side, self._events.at(tick), self._numbers
        before = self._values.copy() if side.blends(new) else None
        for path, value in new.items():
            views[path][...] = value
            if before is not None and path not in side.parameters:  # what happens to the plant acts at once
                self._parameters.views(before)[path][...] = value
        return before

    def _take_up(self, k: int, before: Float64Array) -> None:
        """Let tick k command what it would have without a change of the controller's parameters."""
        asked = []
        for values in (before, self._values):
            state, row = self._state.copy(), np.zeros((1, self._run.outputs.size))
            self._run.run(self.tape.input_rows[k : k + 1], values, state, row)
            asked.append(self._memory.views(state)["limits.asked"])
        take_up(self._memory.views(self._state), *asked)

    def _draw(self, views: dict[str, Float64Array]) -> None:
        for name, column in subtree(views, "noise").items():
            column[...] = self._noise[name].standard_normal(column.shape)

    def _before(self) -> tuple[Float64Array, Mapping[str, Float64Array]]:
        return self._memory.views(self._state)["plant.q"].copy(), self._numbers

    def _go_on(self, k: int) -> tuple[int, Outcome | None]:
        """One block, which takes about half as long as a log may be behind."""
        began = monotonic()
        end, done = self._block(k, self._prepare(k))
        if done < end - k:
            return end, self._diverged(k + done)
        growth = min(16.0, 0.5 * LOG_PERIOD / max(monotonic() - began, 1e-9))
        self._size = max(1, int((end - k) * growth))
        return end, None

    def _block(self, k: int, end: int) -> tuple[int, int]:
        """The ticks from k on: where the block ends, and how many of them ended in finite memory.

        Where another reference begins in between, the block is taken back and ends there, since what is followed
        from there on is known only then.
        """
        inputs, outputs, before = self.tape.input_rows, self.tape.output_rows, self._state.copy()
        done = self._run.run(inputs[k:end], self._values, self._state, outputs[k:end])
        last = self._feed.ends(self.tape.outputs, k, k + done)
        if last is None or last == end:
            return end, done
        self._state[:] = before
        return last, self._run.run(inputs[k:last], self._values, self._state, outputs[k:last])

    def _diverged(self, k: int) -> Outcome:
        """How a run ended whose step after row k was not finite: by a sensor, by the law, or by itself."""
        error = self._run.raised
        if isinstance(error, NumericalError):  # plain Python raises where compiled code gives infinity
            return self.tape.without_numbers(k, error)
        if error is not None:
            return self.tape.failed(k, error)
        row, memory = self._inputs.views(self.tape.input_rows[k]), self._memory.views(self._state)
        side, parameters = self._loop.side, self._numbers
        with np.errstate(all="ignore"):
            measured = self._loop.measured(subtree(memory, "plant"), row, parameters)
        try:
            side.check_finite({name: measured[name] for name in ("q", *side.takes) if name in measured}, k)
            side.check_reading(measured, memory, k)
        except RangeError as fault:
            if self.tape.is_sane(k):
                return self.tape.without_numbers(k, fault)
        return self.tape.diverged(k)

    def _prepare(self, k: int) -> int:
        """Events that act at tick k, then noise and reference of the block, whose end is returned."""
        before = self._apply(k)
        self._draw_up_to(k + 1)
        row = self._inputs.views(self.tape.input_rows[k])
        memory = self._memory.views(self._state)
        plant, sensing = subtree(memory, "plant"), subtree(memory, "sensing")

        def state() -> Snapshot:
            return self._seen(plant, sensing, row)

        self._fill_reference(k, memory, state)
        end = min(self._end_of_block(k, self._size), self._filled)
        self._draw_up_to(end)
        if before is not None and k > 0:  # in the first tick there is nothing yet to go on from
            self._take_up(k, before)
        return end

    def _draw_up_to(self, end: int) -> None:
        """The noise of the ticks before `end`, as far as it was not drawn for a block that was taken back."""
        if self._drawn < end:
            self._draw({path: column[self._drawn : end] for path, column in self.tape.inputs.items()})
            self._drawn = end

    def _seen(
        self, plant: Mapping[str, Any], sensing: Mapping[str, Any] | None, inputs: Mapping[str, Any]
    ) -> Snapshot:
        """What the controller sees in a tick, for the source of a stream."""
        measured = self._loop.measured(plant, inputs, self._numbers)
        return self._loop.side.seen(measured, sensing, self._numbers, float(inputs["t"]))
