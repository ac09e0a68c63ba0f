"""Feeding the references of a task: each phase has its own, whose time counts from its begin."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from taut.base.checks import float_array
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.lawside import LawSide
from taut.control.tasks.phase import STOP
from taut.control.tasks.phase_sample import PhaseSample
from taut.control.tasks.phases import Phases
from taut.control.trajectories.feed import ReferenceFeed
from taut.control.trajectories.reference import Hold, Sample, Stream, Trajectory, as_reference
from taut.maths.snapshot import Snapshot

__all__ = ["PhaseFeed"]


class PhaseFeed:
    """Fills the reference of a block of ticks in which one phase acts.

    A phase without a reference holds where it began. So does what no phase follows at the moment, and what stands
    in the record once the task has stopped.

    Args:
        task: The law of the task.
        side: What surrounds it.
        parameters: Gives those of the law side by path, in a run: phases are checked there where they begin. Without,
            ticks are taken one by one, and samples of a stream without a source come from the caller.

    Raises:
        UsageError: A stream without a source, in a run.
    """

    def __init__(
        self, task: Phases, side: LawSide, parameters: Callable[[], Mapping[str, Any]] | None = None
    ) -> None:
        self._task, self._side = task, side
        self._index, self._since = 0, 0
        self._inner: ReferenceFeed | None = None  # made when the phase is first filled
        self._others: dict[str, Float64Array] = {}
        self._parameters = parameters
        for name, phase in task.phases.items():
            self._look_at(name, phase.reference)
            if parameters is not None and isinstance(phase.reference, Stream) and phase.reference.source is None:
                raise UsageError(
                    f"phase '{name}': a stream in a simulation needs source=, a function that gives the next sample",
                    name="reference",
                )

    def _look_at(self, name: str, given: Any) -> None:
        """The first sample of a reference that is known must fit the arm."""
        given = given.sample if isinstance(given, Hold) else given
        if given is None or isinstance(given, Stream) or (callable(given) and not isinstance(given, Trajectory)):
            return
        law, arm = self._task.laws[name], self._side.arm
        views = {field: np.zeros((1, *shape)) for field, shape in law.reference.fields(arm.n).items()}
        home = law.at_rest(Snapshot(self._side.model, q=arm.home, v=np.zeros(arm.n)))
        with self._task.blamed(name):
            feed = ReferenceFeed(as_reference(given), law.reference, arm, self._side.dt, home)
            feed.fill(views, 0, lambda: home)

    @property
    def waits(self) -> bool:
        """Whether the phase that acts follows samples that the caller gives."""
        name = self._name
        reference = None if name == STOP else self._task.phases[name].reference
        return isinstance(reference, Stream) and reference.source is None

    @property
    def _name(self) -> str:
        return self._task.names[self._index]

    def begin(self, index: int, tick: int) -> None:
        """A phase begins with a tick: its reference is made when it is first asked for."""
        self._index, self._since, self._inner = index, tick, None

    def prepare(self, state: Callable[[], Any]) -> None:
        """Make the reference of a phase that has begun, if that was not done yet."""
        if self._inner is None:
            self._begin(state())

    def next_question(self, tick: int) -> int | None:
        """The first tick after `tick` at which the source of a stream is asked; None if never."""
        question = None if self._inner is None else self._inner.next_question(tick - self._since)
        return None if question is None else question + self._since

    @property
    def in_rows(self) -> bool:
        """Whether the samples of many ticks cost little more than that of one, once the reference is made."""
        return self._inner is None or self._inner.in_rows

    def fill(
        self, views: Mapping[str, Float64Array], first: int, state: Callable[[], Any], given: Sample | None = None
    ) -> int:
        """Write the reference of the ticks from `first` on into views (k, ...) by field.

        Args:
            views: Where to write: one array per field of the sample.
            first: Number of the first tick.
            state: Gives the snapshot at the first tick: what a function of it, a hold and a source are given.
            given: The sample of a caller, where the phase `waits` for one.

        Returns:
            Number of ticks that were filled: if that is less than k, the reference fails in a later tick.

        Raises:
            TautError: There is nothing that can be followed in the first of the ticks.
        """
        law = self._law
        self.prepare(state)
        start = ""
        if isinstance(kind := self._task.reference, type) and issubclass(kind, PhaseSample):
            start = f"{kind.name_of(law.reference)}_"
            for field, values in self._others.items():
                views[field][...] = values
        own = {field[len(start) :]: view for field, view in views.items() if field.startswith(start)}
        if given is not None:
            joints = self._side.arm.joint_names
            for field, view in own.items():
                shape = view.shape[1:]
                of_joints = joints if shape == (len(joints),) else None
                view[...] = float_array(f"ref.{field}", getattr(given, field), shape=shape, joints=of_joints)
            return len(next(iter(views.values())))
        assert self._inner is not None
        with self._task.blamed(self._name):
            return self._inner.fill(own, first - self._since, state, ahead=False)

    @property
    def _law(self) -> Any:
        """The law that is followed; where nothing is, the first one that follows something."""
        law = self._task.laws[self._name]
        followers = [one for one in self._task.laws.values() if not one.ignores_reference]
        return law if not law.ignores_reference or not followers else followers[0]

    def _begin(self, x: Snapshot) -> None:
        """The reference of the phase, from what is seen in its first tick."""
        law, name = self._law, self._name
        given = None if name == STOP else self._task.phases[name].reference
        if callable(given) and not isinstance(given, Trajectory):
            with self._task.blamed(name):
                given = given(x)
        at_rest: Sample = law.at_rest(x)
        with self._task.blamed(name):
            reference = Hold() if given is None or self.waits else as_reference(given)
            self._inner = ReferenceFeed(reference, law.reference, self._side.arm, self._side.dt, at_rest)
        if name != STOP and self._parameters is not None:
            bound = self._task.bound(subtree(self._parameters(), "law"))
            assert isinstance(bound, Phases)
            bound.check_begin(name, x, reference, self._side.rate)
        kind = self._task.reference
        if issubclass(kind, PhaseSample):
            rest, start = self._task.at_rest(x), f"{kind.name_of(law.reference)}_"
            fields = [field for field in kind.fields(self._side.arm.n) if not field.startswith(start)]
            self._others = {field: np.asarray(getattr(rest, field), dtype=np.float64) for field in fields}
