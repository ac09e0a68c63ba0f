"""TaskSteps: the references of a task whose ticks are taken one by one, by `ctrl.step`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import float_array
from taut.base.errors import UsageError, one_thread_at_a_time
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.lawside import LawSide
from taut.control.tasks.phase_feed import PhaseFeed
from taut.control.tasks.phases import Phases
from taut.control.trajectories.feed import plain_snapshot
from taut.maths.snapshot import Snapshot, measurement_shapes

__all__ = ["TaskSteps"]

NEXT: Final = "law.next"
TICKS: Final = "law.ticks"
AHEAD: Final = 512  # ticks whose samples are made at once
ONE_BY_ONE: Final = 16  # the same of a trajectory that gives one at a time, so that no tick waits long for them


class TaskSteps:
    """Makes the sample of each tick, ahead for a block of them as a run does.

    A tick whose sample is there costs one row to copy. In the others, such as the first one of a phase, the sample
    is made from what is measured then.

    Args:
        side: The law side.
        task: Its law.
        memory: Memory of the law side by path, as compiled code changes it.
        wanted: Where compiled code reads the sample, flat: the fields of the task's kind, one behind the other.
    """

    def __init__(self, side: LawSide, task: Phases, memory: Mapping[str, Float64Array], wanted: Float64Array) -> None:
        self._side, self._task, self._memory, self._wanted = side, task, memory, wanted
        self._feed = PhaseFeed(task, side)
        self._table = np.zeros((AHEAD, wanted.size))
        self._fields: dict[str, Float64Array] = {}  # of all rows of the table
        self._places: dict[str, Float64Array] = {}  # of the sample that is wanted
        first = 0
        for name, shape in task.reference.fields(side.arm.n).items():
            size = int(np.prod(shape, dtype=np.int64))
            self._fields[name] = self._table[:, first : first + size].reshape(AHEAD, *shape)
            self._places[name] = wanted[first : first + size].reshape(shape)
            first += size
        self._ahead: dict[int, Float64Array] = {}  # the sample, flat, by the number of a tick in its phase
        self._taken: dict[str, Float64Array] = {}  # where the fields of a sample go that a caller gives, if one does
        self._given: Any = None  # that sample, in a call

    def name(self, going: bool) -> str:
        """The phase that the coming tick belongs to, of a task that is going on or begins with it."""
        return self._task.names[int(self._memory[NEXT]) if going else 0]

    def around(self, step: Callable[..., Any], slow: Callable[..., Any]) -> Callable[..., Any]:
        """`step`, which reads the sample where it is wanted, with that sample; `slow` where it is still to be made.

        What is no plain call, and a tick before memory has started, `step` itself hands to `slow`.
        """
        ticks, wanted = self._memory[TICKS].item, self._wanted
        alone = [None]  # what the thread takes that is in a tick: half of the time of a lock
        begin, end = alone.pop, alone.append

        def with_sample(*args: Any, **kwargs: Any) -> Any:
            try:
                begin()
            except IndexError:
                raise one_thread_at_a_time() from None
            try:
                tick = int(ticks())
                row = self._ahead.get(tick)
                if row is None:
                    known = tick > 0 and bool(self._taken) and self._take(args)
                    return self._with_given(step, args, kwargs) if known else slow(*args, **kwargs)
                wanted[:] = row
                return step(*args, **kwargs)
            finally:
                end(None)

        return with_sample

    def _take(self, args: tuple[Any, ...]) -> bool:
        """Write the last of some arguments where it is wanted, if it is a sample that fits."""
        kind = self._task.laws[self.name(going=True)].reference
        if not args or type(args[-1]) is not kind:
            return False
        values = [getattr(args[-1], field) for field in self._taken]
        if any(np.shape(value) != view.shape for value, view in zip(values, self._taken.values(), strict=True)):
            return False
        for value, view in zip(values, self._taken.values(), strict=True):
            view[...] = value
        return True

    def _with_given(self, step: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        self._given = args[-1]  # for `place`, where this is no plain call
        try:
            return step(*args[:-1], **kwargs)
        finally:
            self._given = None

    def place(
        self, tick: int, going: bool, given: Mapping[str, Any], ref: Any, parameters: Mapping[str, Any]
    ) -> None:
        """Write what is followed in a tick where it is wanted.

        Where the reference of the phase fails, the task stops: the tick after the one that raises holds the arm.

        Args:
            tick: Its number.
            going: Whether the task is going on; else it begins with this tick.
            given: What is measured, as the caller gave it.
            ref: The sample that the caller gave; None for none.
            parameters: Parameters of the law side by path.

        Raises:
            UsageError: A sample where the phase has a reference of its own, or none where it waits for one.
            ShapeError: A sample of another size.
        """
        since = int(self._memory[TICKS]) if going else 0
        name, ref = self.name(going), self._given if ref is None else ref
        if since == 0:
            self._ahead = {}
            self._feed.begin(self._task.names.index(name), tick)
            part = self._task.follows(name) if self._feed.waits else None
            start = "" if part is None else f"{part}_"
            fields = self._places.items() if self._feed.waits else ()
            self._taken = {field[len(start) :]: view for field, view in fields if field.startswith(start)}
        if self._feed.waits:
            if not isinstance(ref, self._task.laws[name].reference):
                kind = self._task.laws[name].reference.described()
                got = "none" if ref is None else type(ref).__name__
                raise UsageError(f"phase '{name}' follows a stream: step needs ref, a {kind}; got {got}", name="ref")
        elif ref is not None:
            raise UsageError(f"phase '{name}' has its own reference; leave ref out of step", name="ref")

        row = self._ahead.get(since)
        if row is None:
            x = self._seen(tick, going, given, parameters) if since == 0 or not self._feed.waits else None
            try:
                count = self._make(tick, x, ref)
            except Exception:
                if going and not self._feed.waits:
                    self._memory[NEXT][...], self._memory[TICKS][...] = len(self._task.phases), 0.0
                raise
            # A first tick is never there beforehand, for what it follows depends on where its phase begins.
            row, self._ahead = self._table[0], {since + i: self._table[i] for i in range(1, count)}
        self._wanted[:] = row

    def _seen(self, tick: int, going: bool, given: Mapping[str, Any], parameters: Mapping[str, Any]) -> Snapshot:
        """What the controller sees in a tick."""
        sizes = measurement_shapes(self._side.arm.n)
        measured = {path: float_array(path, value, shape=sizes[path]) for path, value in given.items()}
        self._side.check_finite(measured, tick)
        sensing = subtree(self._memory, "sensing") if going else None
        return plain_snapshot(self._side, measured, sensing, parameters, tick * self._side.dt)

    def _make(self, tick: int, x: Snapshot | None, ref: Any) -> int:
        """The samples from a tick on: how many."""
        self._feed.prepare(lambda: x)
        fields = {field: rows[: self._count(tick)] for field, rows in self._fields.items()}
        return self._feed.fill(fields, tick, lambda: x, ref)

    def _count(self, tick: int) -> int:
        """Ticks whose samples can be made in this one."""
        if self._feed.waits:
            return 1
        question = self._feed.next_question(tick)
        count = AHEAD if self._feed.in_rows else ONE_BY_ONE
        return count if question is None else min(count, question - tick)
