"""TaskSteps: the references of a task whose ticks are taken one by one, by `ctrl.step`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import float_array
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.feed import plain_snapshot
from taut.control.lawside import LawSide
from taut.control.phase_feed import PhaseFeed
from taut.control.phases import Phases
from taut.control.reference import Sample
from taut.maths.snapshot import Snapshot, measurement_shapes

__all__ = ["TaskSteps"]

NEXT: Final = "law.next"
AHEAD: Final = 64  # ticks whose samples are made at once


class TaskSteps:
    """Makes the sample of each tick, as a run does for a block of them.

    Args:
        side: The law side.
        task: Its law.
    """

    def __init__(self, side: LawSide, task: Phases) -> None:
        self._side, self._task = side, task
        self._feed = PhaseFeed(task, side, stepped=True)
        kind = task.reference
        self._rows = {name: np.zeros((AHEAD, *shape)) for name, shape in kind.fields(side.arm.n).items()}
        self._filled = range(0)  # ticks whose samples are there

    def name(self, memory: Mapping[str, Float64Array] | None) -> str:
        """The phase that the coming tick belongs to."""
        return self._task.names[0 if memory is None else int(memory[NEXT])]

    def looks(self, tick: int, memory: Mapping[str, Float64Array] | None) -> bool:
        """Whether `sample` looks at what is measured in a tick."""
        return memory is None or bool(memory["law.ticks"] < 0.5) or tick not in self._filled

    def sample(
        self,
        tick: int,
        memory: Mapping[str, Float64Array] | None,
        given: Mapping[str, Any],
        ref: Any,
        parameters: Mapping[str, Any],
    ) -> Sample:
        """What is followed in a tick.

        Args:
            tick: Its number.
            memory: All memory by path; None before the first tick.
            given: What is measured, as the caller gave it.
            ref: The sample that the caller gave; None for none.
            parameters: Parameters of the law side by path.

        Raises:
            UsageError: A sample where the phase has a reference of its own, or none where it waits for one.
        """
        if memory is None or memory["law.ticks"] < 0.5:
            self._feed.begin(0 if memory is None else int(memory[NEXT]), tick)
            self._filled = range(0)
        name = self.name(memory)
        if self._feed.waits:
            if not isinstance(ref, self._task.laws[name].reference):
                kind = self._task.laws[name].reference.described()
                got = "none" if ref is None else type(ref).__name__
                raise UsageError(f"phase '{name}' follows a stream: step needs ref, a {kind}; got {got}", name="ref")
        elif ref is not None:
            raise UsageError(f"phase '{name}' has its own reference; leave ref out of step", name="ref")

        if self._feed.waits or tick not in self._filled:
            self._fill(tick, memory, given, ref, parameters)
        row = tick - self._filled.start
        return self._task.reference.of({field: values[row] for field, values in self._rows.items()})

    def _fill(
        self,
        tick: int,
        memory: Mapping[str, Float64Array] | None,
        given: Mapping[str, Any],
        ref: Any,
        parameters: Mapping[str, Any],
    ) -> None:
        """The samples of the ticks from this one on, at most up to where a stream is asked again."""

        def state() -> Snapshot:
            sizes = measurement_shapes(self._side.arm.n)
            measured = {path: float_array(path, value, shape=sizes[path]) for path, value in given.items()}
            self._side.check_finite(measured, tick)
            sensing = None if memory is None else subtree(memory, "sensing")
            return plain_snapshot(self._side, measured, sensing, parameters, tick * self._side.dt)

        self._feed.prepare(state)
        question = self._feed.next_question(tick)
        count = AHEAD if question is None else min(AHEAD, question - tick)
        self._filled = range(tick, tick + count)
        self._feed.fill({field: values[:count] for field, values in self._rows.items()}, tick, state, ref)
