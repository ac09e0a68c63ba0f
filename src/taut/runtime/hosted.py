"""A run of a controller against a plant with a state of its own, tick by tick."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from taut.base.errors import NumericalError, unknown_name
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.layout import Block
from taut.control.reference import Reference
from taut.controller import Controller
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot
from taut.record.outcome import Outcome
from taut.runtime.events import Event
from taut.runtime.feed import ReferenceFeed
from taut.runtime.host import HostPlant
from taut.runtime.tape import RowLog, Tape

__all__ = ["HostedRun"]

LOG_EVERY = 512  # ticks between two writes of a log


class HostedRun:
    """One run against a host plant.

    Args:
        ctrl: The controller; its own memory is not touched.
        plant: The plant.
        ref: The reference.
        ticks: Number of control ticks.
        q: (n,) true position at the start.
        v: (n,) true velocity at the start.
        events: Events with the tick at which they act, in order.
        info: What is known of the run beforehand.
    """

    def __init__(
        self,
        ctrl: Controller,
        plant: HostPlant,
        ref: Reference,
        ticks: int,
        q: Float64Array,
        v: Float64Array,
        events: Iterable[tuple[int, Event]],
        info: dict[str, Any],
    ) -> None:
        side = ctrl.side
        self._plant, self._ticks, self._side = plant, ticks, side
        self._events = list(events)
        for _, event in self._events:
            for path, value in event.set.items():
                if path in side.parameters:
                    side.checked_parameter(path, value)
                elif path not in plant.parameters:
                    raise unknown_name("the run", "parameter", path, [*side.parameters, *plant.parameters])
        self._kernel = ctrl.recording_kernel()
        plant.reset(q, v, side.dt)
        n = side.arm.n
        shapes: dict[str, tuple[int, ...]] = {"q": (n,), "v": (n,), "tau": (n,)}
        shapes |= self._kernel.blocks.layout["outputs"].shapes
        shapes |= {name: np.shape(value) for name, value in plant.extra().items()}
        wanted = self._kernel.blocks.layout["inputs"].shapes
        kept = {path: shape for path, shape in wanted.items() if path.startswith("ref.")}
        self.tape = Tape(side, plant, ticks, Block.of({"t": (), **kept}), Block.of(shapes), info)
        self._feed = ReferenceFeed(ref, side.law.reference, n, side.dt, side.law.reference.at_rest(q))
        self._filled = 0

    def go(self, advance: Callable[[int], None], log: RowLog | None) -> tuple[int, Outcome]:
        """Run to the end: (number of rows recorded, outcome)."""
        running = Outcome(kind="stopped", message="the run is still going on", tick=0)
        written = 0
        for k in range(self._ticks):
            outcome = self._tick(k)
            if log is not None and (k + 1 - written >= LOG_EVERY or outcome is not None or k + 1 == self._ticks):
                log.write(self.tape.piece(written, k + 1, running))
                written = k + 1
            if outcome is not None:
                return k + 1, outcome
            if k % LOG_EVERY == LOG_EVERY - 1:
                advance(LOG_EVERY)
        message = f"completed: {self._ticks} ticks, {(self._ticks - 1) * self._side.dt:g} s"
        return self._ticks, Outcome(kind="completed", message=message, tick=self._ticks - 1)

    def _tick(self, k: int) -> Outcome | None:
        tape, plant, kernel = self.tape, self._plant, self._kernel
        for tick, event in self._events:
            if tick == k:
                self._apply(event)
        out = tape.outputs
        out["q"][k], out["v"][k] = plant.state()
        measured = plant.measure()
        self._reference(k, measured)
        inputs = kernel.blocks.views("inputs")
        for name, view in inputs.items():
            if name != "t":
                view[...] = tape.inputs[name][k] if name.startswith("ref.") else measured[name]
        try:
            if not kernel.ready:
                kernel.start()
            kernel.tick()
        except (NumericalError, ValueError) as error:
            kept, outcome = tape.diverged(k)
            return Outcome(kind="diverged", message=f"{outcome.message}; {error}", tick=kept, joint=outcome.joint)
        for name, value in kernel.blocks.views("outputs").items():
            out[name][k] = value
        out["tau"][k] = plant.advance(out["command"][k])
        for name, value in plant.extra().items():
            out[name][k] = value
        trouble = plant.trouble()
        if trouble is None:
            return None
        words, joint = trouble
        who = None if joint is None else self._side.arm.joint_names[joint]
        where = f" at t = {tape.inputs['t'][k]:.6g} s (tick {k})" + (f", joint '{who}'" if who else "")
        return Outcome(kind="diverged", message=f"the simulation diverged{where}: {words}", tick=k, joint=who)

    def _apply(self, event: Event) -> None:
        for path, value in event.set.items():
            if path in self._side.parameters:
                self._kernel.blocks.views("parameters")[path][...] = self._side.checked_parameter(path, value)
            else:
                self._plant.set_parameter(path, value)

    def _reference(self, k: int, measured: dict[str, Float64Array]) -> None:
        """Fill the reference up to the next tick at which a stream is asked."""
        if k < self._filled:
            return
        question = self._feed.next_question(k)
        end = self._ticks if question is None else min(question, self._ticks)

        def state() -> Snapshot:
            payload = PayloadValues.of(subtree(self._kernel.blocks.views("parameters"), "model.payload"))
            v = measured.get("v", np.zeros(self._side.arm.n))
            return Snapshot(self._side.model, q=measured["q"], v=v, t=k * self._side.dt, payload=payload)

        self._feed.fill(self.tape.reference(k, end), k, state)
        self._filled = end
