"""A run while it goes on, tick by tick or block by block: of a fused loop, or against a plant with its own state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from time import monotonic
from typing import Any, Final, Protocol

import numpy as np

from taut.base.errors import NumericalError, RangeError, ShapeError, TautError
from taut.base.fields import unchanging
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.loop import StepLoop, compiled_loop, known_loop
from taut.codegen.noise import Noise
from taut.codegen.program import Block
from taut.control.limits import take_up
from taut.control.tasks.feed import BLOCK, ReferenceFeed, TaskFeed, feed_of
from taut.control.trajectories.reference import Reference
from taut.control.trajectories.timing import Motion
from taut.controller import Controller, take_up_change
from taut.loop import DT, Loop, sensed_of
from taut.maths.snapshot import Snapshot
from taut.plant.contact import check_force_feedback
from taut.record.info import Outcome
from taut.record.run import Run
from taut.runtime.events import Schedule
from taut.runtime.host import PlantBase
from taut.runtime.tape import Tape

RUNNING: Final = Outcome(kind="stopped", message="the run is still going on", tick=0)
LOG_PERIOD: Final = 0.1  # [s] of computing between two writes of a log, which is so at most twice that behind
FIRST_BLOCK: Final = 16  # ticks: how long one takes is not known yet


class RowLog(Protocol):
    """A file that takes rows while a run goes on."""

    def write(self, rows: Run) -> None:
        """Append the ticks of a piece of the run."""
        ...


class OngoingRun(ABC):
    """A run from its first tick to its end, or to where it breaks off."""

    tape: Tape
    _events: Schedule
    _feed: ReferenceFeed | TaskFeed
    _ticks: int  # of the whole run
    _filled: int = 0  # ticks that have their reference

    def go(self, advance: Callable[[int], None], log: RowLog | None) -> tuple[int, Outcome]:
        """Run to the end: number of rows recorded, outcome. `advance` is called with the number of further ticks."""
        tape, k, written, since = self.tape, 0, 0, monotonic()
        outcome: Outcome | None = None
        while outcome is None and k < self._ticks:
            try:
                outcome = self._refused(k)
                if outcome is None:
                    k, outcome = self._go_on(k)
            except Exception as error:
                outcome = tape.failed(k, error)
            if outcome is not None:
                k = outcome.tick + 1
            if outcome is not None or k == self._ticks or monotonic() - since >= LOG_PERIOD:
                advance(k - written)
                if log is not None:
                    log.write(tape.piece(written, k, RUNNING))
                written, since = k, monotonic()
        return k, outcome or tape.completed()

    @abstractmethod
    def _go_on(self, k: int) -> tuple[int, Outcome | None]:
        """Some ticks from k on: the one behind them, and the outcome if the run broke off in one of them."""

    @abstractmethod
    def _before(self) -> tuple[Float64Array, Mapping[str, Float64Array]]:
        """(n,) where the arm is before a tick, and the parameters by path."""

    def _refused(self, k: int) -> Outcome | None:
        """The outcome of a run that ends before a tick whose events have no meaning there."""
        try:
            self._events.check(k, *self._before())
        except RangeError as error:
            return self.tape.refused(k, self._events.at(k), error)
        return None

    def _end_of_block(self, k: int, size: int) -> int:
        """Up to where nothing changes from outside, in so many ticks from k on at most."""
        stops = (self._ticks, self._events.next(k), self._feed.next_question(k))
        return min(k + size, *(stop for stop in stops if stop is not None))

    def _fill_reference(self, k: int, memory: Mapping[str, Any], state: Callable[[], Snapshot]) -> None:
        """See that tick k has its reference, and ticks after it, at most up to where a stream is asked again."""
        if self._feed.follow(memory, k, state) or k >= self._filled:
            end = self._end_of_block(k, self._feed.block)
            self._filled = k + self._feed.fill(self.tape.reference(k, end), k, state)


class FusedRun(OngoingRun):
    """One run of a Loop."""

    def __init__(self, loop: Loop, q: Float64Array, v: Float64Array, seed: int, events: Schedule) -> None:
        self._loop, self._events = loop, events
        side = loop.side
        self._inputs, self._parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        self._values = self._parameters.pack({**loop.parameters, DT: loop.dt})
        self._numbers = self._parameters.views(self._values)  # by path
        self._apply(0)
        self._noise, self._seed = Noise(self._inputs, loop.engine), seed
        side.check_start(q, self._numbers, loop.ref)
        check_force_feedback(side, loop.plant, q, self._numbers)
        block, packed = self._parameters, self._values  # the feed holds these, and not the run, which holds the feed
        self._feed = feed_of(side, loop.ref, q, lambda: block.views(packed))
        self._drawn = 1  # the noise of row 0 is drawn at the start
        self._ticks = loop.ticks
        known = self._known_rows()
        first = np.zeros((1, self._inputs.size)) if known is None else known[:1].copy()
        if known is None:
            self._fill_first(q, v, first)
        self._run = self._compiled(q, v, first[0])
        self._size = self._run.size or FIRST_BLOCK  # of the next block: that of the last run, or how long it takes
        self._memory = self._run.memory
        self._state = self._run.start(np.concatenate([first[0], q, v]), self._values)
        self.tape = Tape(side, loop.plant, loop.ticks, self._inputs, self._run.outputs)
        self.tape.input_rows[0] = first[0]
        if known is not None:
            self.tape.input_rows[...], self._filled = known, self._ticks

    def _known_rows(self) -> Float64Array | None:
        """The inputs of the last run, where it followed the same motion for as long."""
        ref, rows = self._loop.kept.rows or (None, np.zeros(0))
        return rows if ref is self._loop.ref and len(rows) == self._ticks else None

    def _keep_rows(self) -> None:
        """Keep the inputs of a short run without noise, whose motion cannot change."""
        ref, rows, noise = self._loop.ref, self.tape.input_rows, self._loop.plant.noise
        if isinstance(ref, Motion) and len(rows) <= BLOCK and not noise and self._known_rows() is None:
            self._loop.kept.rows = (ref, rows.copy()) if unchanging(ref) else None

    @property
    def blocks(self) -> tuple[Block, Block, Block]:
        """Inputs, parameters and memory of the loop."""
        return self._inputs, self._parameters, self._memory

    def _fill_first(self, q: Float64Array, v: Float64Array, first: Float64Array) -> None:
        """Reference and noise of the first tick, in a row (1, ...), before there is a tape."""
        views, parameters = self._inputs.views(first), self._numbers
        self._noise.fill(first, 0, self._seed)
        row, loop = self._inputs.views(first[0]), self._loop
        reference = subtree(views, "ref")
        try:
            self._feed.fill(reference, 0, lambda: self._seen(loop.plant_at_start(q, v, parameters), None, row))
        except TautError:
            raise
        except Exception:  # of a function of the user's, which ends the run when the first tick asks it again
            rest = self._loop.side.at_rest(q)
            for name, view in reference.items():
                view[...] = getattr(rest, name)

    def _compiled(self, q: Float64Array, v: Float64Array, row: Float64Array) -> StepLoop:
        """The code of the loop. A start that is not the last one of it is tried on numbers, which are checked."""
        begin = b"".join(part.tobytes() for part in (row, q, v, self._values))
        made = known_loop(self._loop)
        if made is not None and made.begun == begin:
            made.expect(self._loop.ticks)
        else:
            memory = self._loop.start(q, v, self._inputs.views(row), self._numbers)
            block = Block.of({path: np.shape(value) for path, value in memory.items()})
            blocks, example = (self._inputs, self._parameters, block), (row, self._values, block.pack(memory))
            made = compiled_loop(self._loop, blocks, example, q, v)
            made.begun = begin
        return made

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

    def _before(self) -> tuple[Float64Array, Mapping[str, Float64Array]]:
        return self._memory.views(self._state)["plant.q"].copy(), self._numbers

    def _go_on(self, k: int) -> tuple[int, Outcome | None]:
        """One block, which takes about half as long as a log may be behind."""
        began = monotonic()
        end, done = self._block(k, self._prepare(k))
        if done < end - k:
            return end, self._diverged(k + done)
        if end == self._ticks:
            self._keep_rows()
        growth = min(16.0, 0.5 * LOG_PERIOD / max(monotonic() - began, 1e-9))
        self._size = self._run.size = max(1, int((end - k) * growth))
        return end, None

    def _block(self, k: int, end: int) -> tuple[int, int]:
        """The ticks from k on: where the block ends, and how many of them ended in finite memory.

        A block in which another reference begins is undone and ends there, since what follows is known only then.
        """
        inputs, outputs, before = self.tape.input_rows, self.tape.output_rows, self._state.copy()
        done = self._run.run(inputs[k:end], self._values, self._state, outputs[k:end])
        last = self._feed.ends(self.tape.outputs, k, k + done)
        if last is None or last == end:
            return end, done
        self._state[:] = before
        return last, self._run.run(inputs[k:last], self._values, self._state, outputs[k:last])

    def _diverged(self, k: int) -> Outcome:
        """The outcome of a run whose step after row k was not finite: by a sensor, by the law, or the simulation."""
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
            self._noise.fill(self.tape.input_rows[self._drawn : end], self._drawn, self._seed)
            self._drawn = end

    def _seen(
        self, plant: Mapping[str, Any], sensing: Mapping[str, Any] | None, inputs: Mapping[str, Any]
    ) -> Snapshot:
        """Snapshot that the controller sees in a tick, for the source of a stream."""
        measured = self._loop.measured(plant, inputs, self._numbers)
        return self._loop.side.seen(measured, sensing, self._numbers, float(inputs["t"]))


class HostedRun(OngoingRun):
    """One run of a controller, whose own memory is not touched, against a plant with a state of its own."""

    def __init__(
        self,
        ctrl: Controller,
        plant: PlantBase,
        ref: Reference,
        ticks: int,
        q: Float64Array,
        v: Float64Array,
        seed: int,
        events: Schedule,
    ) -> None:
        side = ctrl.side
        self._plant, self._ticks, self._side, self._events = plant, ticks, side, events
        self._own = dict(plant.parameters)  # events last as long as the run
        self._kernel = ctrl.recording_kernel(sensed_of(side, plant), ticks)
        plant.reset(q, v, side.dt, seed)
        n = side.arm.n
        shapes: dict[str, tuple[int, ...]] = {"q": (n,), "v": (n,), "tau": (n,)}
        shapes |= self._kernel.blocks.layout["outputs"].shapes
        shapes |= {name: np.shape(value) for name, value in plant.extra().items()}
        wanted = self._kernel.blocks.layout["inputs"].shapes
        kept = {path: shape for path, shape in wanted.items() if path.startswith("ref.")}
        self.tape = Tape(side, plant, ticks, Block.of({"t": (), **kept}), Block.of(shapes))
        side.check_start(q, {**ctrl.parameters, **self._events.at(0)}, ref)
        blocks = self._kernel.blocks  # the feed holds these, and not the run, which holds the feed
        self._feed = feed_of(side, ref, q, lambda: blocks.views("parameters"))
        self._memory = self._kernel.blocks.views("memory")
        # Where each number goes from and to in every tick, found once.
        inputs = self._kernel.blocks.views("inputs")
        self._measured = [(path, inputs[path]) for path in ("q", *side.takes) if path in ("q", *plant.measures)]
        self._wanted = [(self.tape.inputs[path], inputs[path]) for path in kept]
        outputs = self._kernel.blocks.views("outputs")
        self._given = [(view, self.tape.outputs[path]) for path, view in outputs.items()]
        self._command = next(iter(outputs.values()))

    def go(self, advance: Callable[[int], None], log: RowLog | None) -> tuple[int, Outcome]:
        """Run to the end; the plant has its own parameters again after it."""
        try:
            return super().go(advance, log)
        finally:
            self._plant.set_parameters({p: self._own[p] for p in self._events.paths if p in self._own})

    def _before(self) -> tuple[Float64Array, Mapping[str, Float64Array]]:
        return self._plant.state()[0], self._kernel.blocks.views("parameters")

    def _go_on(self, k: int) -> tuple[int, Outcome | None]:
        return k + 1, self._tick(k)

    def _tick(self, k: int) -> Outcome | None:
        tape, plant, kernel = self.tape, self._plant, self._kernel
        new = self._events.at(k)
        before = self._apply(new) if new else None
        out = tape.outputs
        out["q"][k], out["v"][k] = plant.state()
        measured = plant.measure()
        self._require("measure", measured, self._measured)
        self._reference(k, measured)
        for path, view in self._measured:
            view[...] = measured[path]
        for rows, view in self._wanted:
            view[...] = rows[k]
        try:
            if not kernel.ready:
                kernel.start()
            elif before is not None:
                take_up_change(kernel, before)
            kernel.tick()
        except (NumericalError, RangeError) as error:  # a tick without a command: it is not recorded
            if tape.is_sane(k):
                return tape.without_numbers(k, error)
            outcome = tape.diverged(k)
            return Outcome(kind="diverged", message=f"{outcome.message}; {error}", tick=k - 1, joint=outcome.joint)
        for view, rows in self._given:
            rows[k] = view
        acted, tau = plant.advance(self._command), out["tau"][k]
        self._require("advance", {"the torques that acted": acted}, [("the torques that acted", tau)])
        tau[...] = acted
        for name, value in plant.extra().items():
            out[name][k] = value
        trouble = plant.trouble()
        if trouble is None:
            if not np.isfinite(tau).all():
                method = f"plant '{plant.name}': advance()"
                raise RangeError(f"{method} must return finite torques that acted; got {acted}", name="tau")
            return None
        words, joint = trouble
        who = None if joint is None else self._side.arm.joint_names[joint]
        where = f" at t = {tape.inputs['t'][k]:.6g} s (tick {k})" + (f", joint '{who}'" if who else "")
        message = f"the simulation diverged{where}: {words}{self.tape.out_of_reach(k + 1)}"
        return Outcome(kind="diverged", message=message, tick=k, joint=who)

    def _require(self, method: str, given: Any, wanted: Sequence[tuple[str, Float64Array]]) -> None:
        """Refuse what a method of a plant of the user's gives if it is not of the shapes that a run needs."""
        for name, view in wanted:
            value = given.get(name) if isinstance(given, Mapping) else None
            if value is None or np.shape(value) != view.shape:
                got = "none" if value is None else f"shape {np.shape(value)}"
                who = f"plant '{self._plant.name}': {method}()"
                raise ShapeError(f"{who} must return {name} with shape {view.shape}; got {got}", name=name)

    def _apply(self, values: Mapping[str, ArrayLike]) -> Float64Array | None:
        """New values of parameters; those of the controller before, where a blend takes up the change."""
        before = self._kernel.blocks.parameters.copy() if self._side.blends(values) else None
        for path, value in values.items():
            if path in self._side.parameters:
                self._kernel.blocks.views("parameters")[path][...] = value
        self._plant.set_parameters({path: value for path, value in values.items() if path in self._own})
        return before

    def _reference(self, k: int, measured: dict[str, Float64Array]) -> None:
        """Fill the reference of the next ticks, at most up to where a stream is asked again."""

        def state() -> Snapshot:
            parameters = self._kernel.blocks.views("parameters")
            sensing = subtree(self._memory, "sensing") if self._kernel.ready else None
            return self._side.seen(measured, sensing, parameters, k * self._side.dt)

        self._fill_reference(k, self._memory, state)
