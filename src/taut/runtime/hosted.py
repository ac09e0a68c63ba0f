"""A run of a controller against a plant with a state of its own, tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from taut.base.errors import NumericalError, RangeError
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.program import Block
from taut.control.tasks.feed import feed_of
from taut.control.trajectories.reference import Reference
from taut.controller import Controller, take_up_change
from taut.loop import sensed_of
from taut.maths.snapshot import Snapshot
from taut.record.info import Outcome
from taut.runtime.events import Event, Schedule
from taut.runtime.host import HostPlant
from taut.runtime.tape import OngoingRun, RowLog, Tape

__all__ = ["HostedRun"]


class HostedRun(OngoingRun):
    """One run against a host plant.

    Args:
        ctrl: The controller; its own memory is not touched.
        plant: The plant.
        ref: The reference.
        ticks: Number of control ticks.
        q: (n,) true position at the start.
        v: (n,) true velocity at the start.
        seed: Seed of the noise.
        events: Events with the tick at which they act, in order.
    """

    def __init__(
        self,
        ctrl: Controller,
        plant: HostPlant,
        ref: Reference,
        ticks: int,
        q: Float64Array,
        v: Float64Array,
        seed: int,
        events: Iterable[tuple[int, Event]],
    ) -> None:
        side = ctrl.side
        self._plant, self._ticks, self._side = plant, ticks, side
        self._events = Schedule(side, plant, {**ctrl.parameters, **plant.parameters}, events)
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
        self._command = outputs["command"]

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
        before = self._apply(self._events.at(k))
        out = tape.outputs
        out["q"][k], out["v"][k] = plant.state()
        measured = plant.measure()
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
        out["tau"][k] = plant.advance(self._command)
        for name, value in plant.extra().items():
            out[name][k] = value
        trouble = plant.trouble()
        if trouble is None:
            return None
        words, joint = trouble
        who = None if joint is None else self._side.arm.joint_names[joint]
        where = f" at t = {tape.inputs['t'][k]:.6g} s (tick {k})" + (f", joint '{who}'" if who else "")
        message = f"the simulation diverged{where}: {words}{self.tape.out_of_reach(k + 1)}"
        return Outcome(kind="diverged", message=message, tick=k, joint=who)

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
