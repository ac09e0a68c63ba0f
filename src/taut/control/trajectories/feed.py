"""Feeding a reference to a simulation: a sample for every tick, asked for as late as needed."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.parts import require_radians, short_way
from taut.base.errors import TautError, UsageError
from taut.base.types import Float64Array
from taut.control.trajectories.reference import Hold, JointMotion, Reference, Rows, Sample, Stream, sample_rows
from taut.control.trajectories.samples import Chunk
from taut.control.trajectories.task_reference import TaskMotion, faded, offset, quintic_between

NEAR = 1e-9  # of a tick: what a period that is meant to be whole may miss one by
BLOCK: Final = 4096  # ticks that a run fills and takes at once


class Feed(ABC):
    """What fills the reference of a run, block by block: of a task several references, of a law one."""

    block = BLOCK  # ticks that a run takes at once, at most

    def follow(self, memory: Mapping[str, Any], tick: int, state: Callable[[], Any]) -> bool:  # noqa: ARG002
        """Whether another reference begins with a tick, so that what was filled beyond it is void."""
        return False

    def ends(self, outputs: Mapping[str, Float64Array], first: int, end: int) -> int | None:  # noqa: ARG002
        """The tick with which another reference begins after the ticks from first to end, by their outputs."""
        return None

    @abstractmethod
    def next_question(self, tick: int) -> int | None:
        """The first tick after `tick` at which the source of a stream is asked; None if never."""

    @abstractmethod
    def fill(self, views: Mapping[str, Float64Array], first: int, state: Callable[[], Any]) -> int:
        """Write the reference of the ticks from `first` on; the number of ticks that were filled."""


class ReferenceFeed(Feed):
    """Fills the reference of a block of ticks; `at_rest` is the sample to hold where the reference names none."""

    def __init__(self, ref: Reference, kind: type[Sample], arm: Arm, dt: float, at_rest: Sample) -> None:
        self._kind, self._arm, self._dt = kind, arm, dt
        self._ref: Any = ref
        self._since = 0.0  # time at which a chunk started
        self._current: Any = None
        self._asked = -1  # the last tick at which a stream was asked
        self._fade: Fade | None = None  # from the answer before
        if isinstance(ref, Hold):
            self._ref = at_rest if ref.sample is None else ref.sample
        if isinstance(ref, Stream) and ref.source is None:
            raise UsageError(
                "a stream in a simulation needs source=, a function that gives the next sample", name="ref"
            )
        if isinstance(ref, Stream) and ref.blend is not None and not can_fade(kind):
            raise UsageError(
                f"blend is for a stream of motions, and the law follows {kind.__name__}; leave it out", name="blend"
            )

    def next_question(self, tick: int) -> int | None:
        """The first tick after `tick` at which the source of a stream is asked; None if never.

        Question j is asked in the first tick at or after j periods, so that any period is kept on average.
        """
        if not isinstance(self._ref, Stream):
            return None
        period: float = self._ref.period / self._dt  # [ticks]
        j = math.floor(tick / period + NEAR) + 1
        return max(tick + 1, math.ceil(j * period - NEAR))

    def fill(
        self, views: Mapping[str, Float64Array], first: int, state: Callable[[], Any], *, ahead: bool = True
    ) -> int:
        """Write the reference of the ticks from `first` on into views (k, ...) by field; the number of filled ticks.

        Less than k are filled where the reference fails in a later tick; in the first it raises. `state` gives the
        snapshot at the first tick, for a source; `ahead` refuses a later sample that does not fit before tick 0.
        """
        count = len(next(iter(views.values())))
        if isinstance(self._ref, Stream):
            self._ask(self._ref, first, state)
        while True:
            try:
                table = self._checked_rows((first + np.arange(count, dtype=np.float64)) * self._dt)
            except Exception as error:
                if count == 1 or (ahead and first == 0 and isinstance(error, TautError)):
                    raise
                count //= 2  # what comes later may never be asked for
                continue
            for name, view in views.items():
                view[:count] = table[name]
            return count

    def _checked_rows(self, times: Float64Array) -> dict[str, Float64Array]:
        table = self._rows(times)
        if "q" in table:
            require_radians("ref.q", table["q"], self._arm)
        return table

    def _ask(self, stream: Stream, first: int, state: Callable[[], Any]) -> None:
        """The next answer of a stream, if its time has come, and the fade from the one before."""
        if first == self._asked or (first != 0 and self.next_question(first - 1) != first):
            return
        now = np.array([first * self._dt])
        before = None if stream.blend is None or self._current is None else self._rows(now)
        self._since, self._fade = first * self._dt, None
        self._current = self._answer(stream, state())
        self._asked = first
        if before is not None:
            assert stream.blend is not None
            self._fade = Fade.of(self._kind, before, self._rows(now), self._since, stream.blend, self._arm)

    def _rows(self, times: Float64Array) -> dict[str, Float64Array]:
        """Each field at many times: one row each, or a single one where all are the same."""
        streaming = isinstance(self._ref, Stream)
        source = self._current if streaming else self._ref
        since = times - self._since if streaming else times
        table = sample_rows(source, since[:1] if isinstance(source, Sample) else since, self._kind, self._arm.n)
        return table if self._fade is None else self._fade.applied(table, times)

    def _answer(self, stream: Stream, x: Any) -> Sample | Chunk:
        assert stream.source is not None
        answer: object = stream.source(x)
        if not isinstance(answer, (Sample, Chunk)):
            raise UsageError(
                f"the source of a stream must give a sample or a chunk; got {type(answer).__name__} at "
                f"t = {self._since:g} s",
                name="source",
            )
        return answer


def can_fade(kind: type[Sample]) -> bool:
    """Whether samples of this kind are motions, with rates."""
    return kind in (JointMotion, TaskMotion)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fade:
    """What led from a new motion to an old one when it took its place, which fades to nothing as a quintic."""

    kind: type[Sample]
    since: float  # [s]
    duration: float  # [s]
    start: Any  # the offset at `since`

    @classmethod
    def of(cls, kind: type[Sample], old: Rows, new: Rows, since: float, duration: float, arm: Arm) -> Fade:
        """The fade from one motion to another, of rows at `since` [s]; continuous joints take the shorter way."""
        if kind is TaskMotion:
            return cls(kind=kind, since=since, duration=duration, start=offset(old, new))
        q = short_way(old["q"] - new["q"], arm.continuous)
        return cls(kind=kind, since=since, duration=duration, start=(q, old["v"] - new["v"], old["a"] - new["a"]))

    def applied(self, rows: Rows, times: Float64Array) -> dict[str, Float64Array]:
        """The new motion with what is left of the old one, at times from `since` on [s]."""
        x = np.clip((times - self.since) / self.duration, 0.0, 1.0)
        full = {name: np.broadcast_to(values, (len(times), *values.shape[1:])) for name, values in rows.items()}
        if self.kind is TaskMotion:
            return faded(full, x, self.duration, self.start)
        none = (np.zeros_like(self.start[0]),) * 3
        left = quintic_between(x, self.duration, self.start, none)
        return {name: full[name] + part for name, part in zip(("q", "v", "a"), left, strict=True)}
