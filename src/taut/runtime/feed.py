"""Feeding a reference to a simulation: a sample for every tick, asked for as late as needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.control.reference import Chunk, Hold, Reference, Sample, Stream, sample_rows

__all__ = ["ReferenceFeed"]


class ReferenceFeed:
    """Fills the reference of a block of ticks.

    Args:
        ref: The reference.
        kind: The kind of sample that the law follows.
        n: Number of joints.
        dt: Control period [s].
        at_rest: The sample to hold where the reference names none: the first state.

    Raises:
        UsageError: The reference gives another kind of sample, or a stream has no source.
    """

    def __init__(self, ref: Reference, kind: type[Sample], n: int, dt: float, at_rest: Sample) -> None:
        self._kind, self._n, self._dt = kind, n, dt
        self._ref: Any = ref
        self._since = 0.0  # time at which a chunk started
        self._current: Any = None
        self._asked = -1  # the last tick at which a stream was asked
        if isinstance(ref, Hold):
            self._ref = at_rest if ref.sample is None else ref.sample
        if isinstance(self._ref, Sample) and not isinstance(self._ref, kind):
            raise UsageError(
                f"the law follows {kind.__name__}; the reference is a {type(self._ref).__name__}", name="ref"
            )
        if isinstance(ref, Stream):
            if ref.source is None:
                raise UsageError(
                    "a stream in a simulation needs source=, a function that gives the next sample", name="ref"
                )
            self._every = max(1, round(ref.period / dt))

    def next_question(self, tick: int) -> int | None:
        """The first tick after `tick` at which the source of a stream is asked; None if never."""
        if not isinstance(self._ref, Stream):
            return None
        return (tick // self._every + 1) * self._every

    def fill(self, views: Mapping[str, Float64Array], first: int, state: Callable[[], Any]) -> None:
        """Write the reference of the ticks from `first` on into views (k, ...) by field.

        Args:
            views: Where to write: one array per field of the sample.
            first: Number of the first tick.
            state: Gives the snapshot at the first tick, for the source of a stream.
        """
        count = len(next(iter(views.values())))
        times: Float64Array = (first + np.arange(count, dtype=np.float64)) * self._dt
        source = self._ref
        if isinstance(source, Stream):
            if first % self._every == 0 and first != self._asked:
                assert source.source is not None
                self._asked = first
                self._current, self._since = source.source(state()), first * self._dt
            source = self._current
            times = times - self._since
        if isinstance(source, Chunk) or not isinstance(source, Sample):
            table = sample_rows(source, times, self._kind, self._n)
        else:
            table = sample_rows(_Constant(source), times[:1], self._kind, self._n)
        for name, view in views.items():
            view[...] = table[name]


class _Constant:
    """A sample as a trajectory."""

    def __init__(self, sample: Sample) -> None:
        self._sample = sample

    def at(self, t: float) -> Sample:  # noqa: ARG002
        return self._sample
