"""A run of a fused loop: controller and model plant in native code, block by block."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from time import monotonic
from typing import Any, Final

import numpy as np

from taut.base.errors import NumericalError, RangeError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.layout import Block
from taut.codegen.loop import compiled_loop
from taut.control.limits import take_up
from taut.control.tasks.phase_feed import PhaseFeed
from taut.control.tasks.phases import Phases
from taut.control.trajectories.feed import ReferenceFeed, plain_snapshot
from taut.loop import DT, Loop
from taut.maths.snapshot import Snapshot
from taut.plant.swing import check_swing
from taut.record.outcome import Outcome
from taut.runtime.events import Event
from taut.runtime.tape import LOG_PERIOD, RowLog, Tape

__all__ = ["FusedRun"]

BLOCK: Final = 4096  # ticks between two visits of Python
TASK_BLOCK: Final = 256  # the same for a task, in which a block may have to be taken back
FIRST_BLOCK: Final = 16  # of a run with a log, which is written by time: how long a tick takes is not known yet


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
        self._loop, self._q, self._v = loop, q, v
        side = loop.side
        self._events: dict[int, dict[str, Float64Array]] = {}
        values = dict(loop.parameters)
        for tick, event in events:
            new = {path: loop.parameters.checked(path, value) for path, value in event.set.items()}
            values |= new
            loop.plant.check_together(values)
            self._events.setdefault(tick, {}).update(new)
        self._stops = sorted(self._events)
        self._inputs, self._parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        self._values = self._parameters.pack({**loop.parameters, DT: loop.dt})
        self._apply(0)
        # One generator per measurement, by its name: neither how the run is cut into blocks nor what else is noisy
        # changes the numbers.
        self._noise = {name: np.random.default_rng([seed, *name.encode()]) for name in loop.plant.noise}
        side.check_start(q, self._parameters.views(self._values), loop.ref)
        check_swing(side, loop.plant, q, self._parameters.views(self._values))
        at_rest = side.at_rest(q)
        task = side.law if isinstance(side.law, Phases) else None
        block, packed = self._parameters, self._values  # the feed holds these, and not the run, which holds the feed
        self._feed: ReferenceFeed | PhaseFeed = (
            ReferenceFeed(loop.ref, side.law.reference, side.arm, loop.dt, at_rest)
            if task is None
            else PhaseFeed(task, side, lambda: block.views(packed))
        )
        self._of_task, self._drawn = task is not None, 1  # the noise of row 0 is drawn at the start
        self._size, self._filled = BLOCK, 0  # of the next block; ticks with a reference
        first = np.zeros((1, self._inputs.size))
        memory = self._started(q, v, first)
        self._memory = Block.of({path: np.shape(value) for path, value in memory.items()})
        self._state = self._memory.pack(memory)
        # A sensor that fails at once is no state to compare engines at.
        blocks, example = (self._inputs, self._parameters, self._memory), (first[0], self._values, self._state)
        self._run = compiled_loop(loop, blocks, example, sound=self._sound(memory, first[0]))
        self.tape = Tape(side, loop.plant, loop.ticks, self._inputs, self._run.outputs, info)
        self.tape.input_rows[0] = first[0]

    def _started(self, q: Float64Array, v: Float64Array, first: Float64Array) -> dict[str, Any]:
        """Memory in the first tick, whose reference and noise (1, ...) are filled in here, before there is a tape."""
        views, parameters = self._inputs.views(first), self._parameters.views(self._values)
        self._draw(views)
        row, plant = self._inputs.views(first[0]), self._loop.plant_at_start(q, v, parameters)
        self._feed.fill(subtree(views, "ref"), 0, lambda: self._seen(plant, None, row))
        return self._loop.start(q, v, row, parameters)

    def _sound(self, memory: Mapping[str, Any], row: Float64Array) -> bool:
        """Whether all that is measured in the first tick is finite."""
        parameters = self._parameters.views(self._values)
        with np.errstate(all="ignore"):
            measured = self._loop.measured(subtree(memory, "plant"), self._inputs.views(row), parameters)
        return all(bool(np.isfinite(value).all()) for value in measured.values())

    def _apply(self, tick: int) -> Float64Array | None:
        """Events that act at a tick; if a blend takes up the change, the parameters without what it is to take up."""
        side, new, views = self._loop.side, self._events.get(tick, {}), self._parameters.views(self._values)
        before = self._values.copy() if side.blends(new) else None
        for path, value in new.items():
            views[path][...] = value
            if before is not None and path not in side.parameters:  # what happens to the plant is felt at once
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

    def go(self, advance: Callable[[int], None], log: RowLog | None) -> tuple[int, Outcome]:
        """Run to the end: (number of rows recorded, outcome)."""
        tape, ticks, k = self.tape, self._loop.ticks, 0
        running = Outcome(kind="stopped", message="the run is still going on", tick=0)
        self._size = BLOCK if log is None else FIRST_BLOCK
        while k < ticks:
            began = monotonic()
            refused = self._refused(k)
            if refused is not None:
                return k, refused
            try:
                end = self._prepare(k, ticks)
            except Exception as error:
                if k == 0:
                    raise
                return k, tape.failed(k, error)
            end, done = self._block(k, end)
            if done < end - k:
                kept, outcome = self._diverged(k + done)
                if log is not None:
                    log.write(tape.piece(k, kept, running))
                return kept, outcome
            if log is not None:
                log.write(tape.piece(k, end, running))
                growth = min(16.0, LOG_PERIOD / max(monotonic() - began, 1e-9))
                self._size = max(1, int((end - k) * growth))
            advance(end - k)
            k = end
        return ticks, self.tape.completed()

    def _block(self, k: int, end: int) -> tuple[int, int]:
        """The ticks from k on: where the block ends, and how many of them ended in finite memory.

        Where a phase of a task begins in between, the block is taken back and ends there, since what is followed
        from there on is known only then.
        """
        inputs, outputs, before = self.tape.input_rows, self.tape.output_rows, self._state.copy()
        done = self._run.run(inputs[k:end], self._values, self._state, outputs[k:end])
        if not self._of_task:
            return end, done
        ended = np.flatnonzero(self.tape.outputs["phase_ended"][k : k + done])
        if not len(ended) or k + int(ended[0]) + 1 == end:
            return end, done
        end = k + int(ended[0]) + 1
        self._state[:] = before
        return end, self._run.run(inputs[k:end], self._values, self._state, outputs[k:end])

    def _diverged(self, k: int) -> tuple[int, Outcome]:
        """How a run ended whose step after row k was not finite: by a sensor, by the law, or by itself."""
        if self._run.raised is not None:
            return self._raised(k, self._run.raised)
        row, memory = self._inputs.views(self.tape.input_rows[k]), self._memory.views(self._state)
        side, parameters = self._loop.side, self._parameters.views(self._values)
        with np.errstate(all="ignore"):
            measured = self._loop.measured(subtree(memory, "plant"), row, parameters)
        try:
            side.check_finite({name: measured[name] for name in ("q", *side.takes) if name in measured}, k)
            side.check_reading(measured, memory, k)
        except RangeError as error:
            if self.tape.is_sane(k):
                message = f"{error} (t = {float(row['t']):.6g} s)"
                return k, Outcome(kind="diverged", message=message, tick=k - 1, joint=error.joint)
        return self.tape.diverged(k)

    def _raised(self, k: int, error: Exception) -> tuple[int, Outcome]:
        """The same where plain Python raised something in tick k: numbers that are none, or a mistake in its code."""
        if isinstance(error, NumericalError):
            message = f"{error} (t = {self.tape.inputs['t'][k]:.6g} s, tick {k})"
            return k, Outcome(kind="diverged", message=message, tick=k - 1, joint=error.joint)
        if k == 0:
            raise error
        return k, self.tape.failed(k, error)

    def _refused(self, k: int) -> Outcome | None:
        """How the run ends where an event asks for what has no meaning where the arm is."""
        new = self._events.get(k)
        if not new or k == 0:  # what begins with the run is refused before
            return None
        q = np.array(self._memory.views(self._state)["plant.q"])
        try:
            self._loop.side.check_change(q, self._parameters.views(self._values), new)
        except RangeError as error:
            return self.tape.refused(k, new, error)
        return None

    def _end_of_block(self, k: int, ticks: int, size: int) -> int:
        later = bisect_right(self._stops, k)
        stops = [k + min(size, TASK_BLOCK if self._of_task else BLOCK), ticks, *self._stops[later : later + 1]]
        question = self._feed.next_question(k)
        return min(stops if question is None else [*stops, question])

    def _prepare(self, k: int, ticks: int) -> int:
        """Events that act at tick k, then noise and reference of the block, whose end is returned."""
        before = self._apply(k)
        self._draw_up_to(k + 1)
        row = self._inputs.views(self.tape.input_rows[k])
        memory = self._memory.views(self._state)
        plant, sensing = subtree(memory, "plant"), subtree(memory, "sensing")

        def state() -> Snapshot:
            return self._seen(plant, sensing, row)

        if isinstance(self._feed, PhaseFeed) and k > 0 and Phases.begins(subtree(memory, "law")):
            self._feed.begin(int(memory["law.next"]), k)
            self._feed.prepare(state)
        if self._of_task or k >= self._filled:
            far = self._end_of_block(k, ticks, self._size if self._of_task else BLOCK)
            self._filled = k + self._feed.fill(self.tape.reference(k, far), k, state)
        end = min(self._end_of_block(k, ticks, self._size), self._filled)
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
        parameters, side = self._parameters.views(self._values), self._loop.side
        measured = self._loop.measured(plant, inputs, parameters)
        return plain_snapshot(side, measured, sensing, parameters, float(inputs["t"]))
