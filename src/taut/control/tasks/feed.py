"""Feeding references to a controller: a sample for every tick, of a law or of the phases of a task."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.parts import require_radians, short_way
from taut.base.checks import float_array
from taut.base.errors import TautError, UsageError, one_thread_at_a_time
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.tasks.phase import STOP
from taut.control.tasks.task import Task, blamed
from taut.control.trajectories.compound import PhaseSample
from taut.control.trajectories.reference import (
    Hold,
    JointMotion,
    Reference,
    Rows,
    Sample,
    Stream,
    Trajectory,
    as_reference,
    sample_rows,
)
from taut.control.trajectories.samples import Chunk
from taut.control.trajectories.task_reference import TaskMotion, faded, offset, quintic_between
from taut.maths.snapshot import Snapshot, measurement_shapes

NEAR: Final = 1e-9  # [ticks] tolerance of a period that is meant to be a whole number of ticks
BLOCK: Final = 4096  # ticks that a run fills and takes at once
NEXT: Final = "law.next"
TICKS: Final = "law.ticks"
TASK_BLOCK: Final = 256  # ticks that a run takes at once: more would be taken back where a phase begins among them
AHEAD: Final = 256  # ticks whose samples are made at once where ticks are taken one by one


def feed_of(
    side: LawSide, ref: Reference, q: Float64Array, parameters: Callable[[], Mapping[str, Any]]
) -> ReferenceFeed | TaskFeed:
    """The feed of a run that starts at q; the references of a task are those of its phases."""
    if side.task is not None:
        return TaskFeed(side, side.task, parameters)
    return ReferenceFeed(ref, side.law.reference, side.arm, side.dt, side.at_rest(q))


class ReferenceFeed:
    """Fills the reference of a block of ticks; `at_rest` is the sample to hold where the reference names none."""

    block = BLOCK  # ticks that a run takes at once, at most

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
        if isinstance(ref, Stream) and ref.blend is not None and kind not in (JointMotion, TaskMotion):
            raise UsageError(
                f"blend is for a stream of motions, and the law follows {kind.__name__}; leave it out", name="blend"
            )

    @property
    def duration(self) -> float | None:
        """Time after which the reference stays the same [s]; None where it has no end of its own."""
        if isinstance(self._ref, Sample):
            return 0.0
        length = getattr(self._ref, "duration", None)
        return None if length is None else float(length)

    def follow(self, memory: Mapping[str, Any], tick: int, state: Callable[[], Any]) -> bool:  # noqa: ARG002
        """Whether another reference begins with a tick, so that what was filled beyond it is void."""
        return False

    def ends(self, outputs: Mapping[str, Float64Array], first: int, end: int) -> int | None:  # noqa: ARG002
        """The tick with which another reference begins after the ticks from first to end, by their outputs."""
        return None

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
                table = self._rows((first + np.arange(count, dtype=np.float64)) * self._dt)
                if "q" in table:
                    require_radians("ref.q", table["q"], self._arm)
            except Exception as error:
                if count == 1 or (ahead and first == 0 and isinstance(error, TautError)):
                    raise
                count //= 2  # what comes later may never be asked for
                continue
            for name, view in views.items():
                view[:count] = table[name]
            return count

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Fade:
    """Offset of an old motion from the new one that replaced it; it decays to zero as a quintic."""

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
        """The new motion plus the remaining offset, at times from `since` on [s]."""
        x = np.clip((times - self.since) / self.duration, 0.0, 1.0)
        full = {name: np.broadcast_to(values, (len(times), *values.shape[1:])) for name, values in rows.items()}
        if self.kind is TaskMotion:
            return faded(full, x, self.duration, self.start)
        none = (np.zeros_like(self.start[0]),) * 3
        left = quintic_between(x, self.duration, self.start, none)
        return {name: full[name] + part for name, part in zip(("q", "v", "a"), left, strict=True)}


class TaskFeed:
    """Fills the reference of a block of ticks in which one phase acts.

    A phase without a reference holds where it began; so do fields that the phase does not follow, and a task that has
    stopped. Without `parameters` (those of the law side, by path) ticks are taken one by one, and samples of a
    stream without a source come from the caller; with them, in a run, phases are checked where they begin.
    """

    block = TASK_BLOCK

    def __init__(self, side: LawSide, task: Task, parameters: Callable[[], Mapping[str, Any]] | None = None) -> None:
        self._side, self._task, self._parameters = side, task, parameters
        self._name, self._since = task.names[0], 0  # the phase that acts, and the tick with which it began
        self._inner: ReferenceFeed | None = None  # made when the phase is first filled
        self._others: dict[str, Float64Array] = {}  # fields that the phase does not follow
        for name, phase in task.phases.items():
            self._check_first_sample(name, phase.reference)
            if parameters is not None and isinstance(phase.reference, Stream) and phase.reference.source is None:
                raise UsageError(
                    f"phase '{name}': a stream in a simulation needs source=, a function that gives the next sample",
                    name="reference",
                )

    def _check_first_sample(self, name: str, given: Any) -> None:
        """The first sample of a reference that is known must fit the arm."""
        given = given.sample if isinstance(given, Hold) else given
        if given is None or isinstance(given, Stream) or (callable(given) and not isinstance(given, Trajectory)):
            return
        law, arm = self._task.laws[name], self._side.arm
        views = {field: np.zeros((1, *shape)) for field, shape in law.reference.fields(arm.n).items()}
        home = law.at_rest(Snapshot(self._side.model, q=arm.home, v=np.zeros(arm.n)))
        with blamed(name):
            feed = ReferenceFeed(as_reference(given), law.reference, arm, self._side.dt, home)
            feed.fill(views, 0, lambda: home)

    @property
    def waits(self) -> bool:
        """Whether the phase that acts follows samples that the caller gives."""
        reference = None if self._name == STOP else self._task.phases[self._name].reference
        return isinstance(reference, Stream) and reference.source is None

    def begin(self, name: str, tick: int) -> None:
        """A phase begins with a tick: its reference is made when it is first asked for."""
        self._name, self._since, self._inner = name, tick, None

    def follow(self, memory: Mapping[str, Any], tick: int, state: Callable[[], Any]) -> bool:
        """Whether a phase begins with a tick, by the memory before it; then its reference is made."""
        if tick == 0:  # the first phase begins with the run
            self.prepare(state)
            return False
        if not memory[TICKS] < 0.5:
            return False
        self.begin(self._task.names[int(memory[NEXT])], tick)
        self.prepare(state)
        return True

    def ends(self, outputs: Mapping[str, Float64Array], first: int, end: int) -> int | None:
        """The tick after the first one from first to end that ends a phase."""
        ended = np.flatnonzero(outputs["phase_ended"][first:end])
        return first + int(ended[0]) + 1 if len(ended) else None

    def prepare(self, state: Callable[[], Any]) -> None:
        """Make the reference of the phase from what is seen in its first tick, if that was not done yet."""
        if self._inner is not None:
            return
        x, law, name = state(), self._law, self._name
        given = None if name == STOP else self._task.phases[name].reference
        with blamed(name):
            if callable(given) and not isinstance(given, Trajectory):
                given = given(x)
            reference = Hold() if given is None or self.waits else as_reference(given)
            self._inner = ReferenceFeed(reference, law.reference, self._side.arm, self._side.dt, law.at_rest(x))
        if name != STOP and self._parameters is not None:
            self._task.bound(subtree(self._parameters(), "law")).check_begin(name, x, reference, self._side.rate)
        start = self._start
        if start:
            rest, fields = self._task.at_rest(x), self._task.reference.fields(self._side.arm.n)
            others = [field for field in fields if not field.startswith(start)]
            self._others = {field: np.asarray(getattr(rest, field), dtype=np.float64) for field in others}

    @property
    def duration(self) -> float | None:
        """Time after which the reference of the phase stays the same [s], once it is prepared."""
        return None if self._inner is None else self._inner.duration

    @property
    def _law(self) -> Law:
        """The law that is followed; where nothing is, the first one that follows something."""
        law = self._task.laws[self._name]
        return law if not law.ignores_reference or not self._task.followers else self._task.followers[0]

    @property
    def _start(self) -> str:
        """Prefix of the fields of the sample that the phase follows."""
        kind = self._task.reference
        return f"{kind.name_of(self._law.reference)}_" if issubclass(kind, PhaseSample) else ""

    def next_question(self, tick: int) -> int | None:
        """The first tick after `tick` at which the source of a stream is asked; None if never."""
        question = None if self._inner is None else self._inner.next_question(tick - self._since)
        return None if question is None else question + self._since

    def fill(
        self, views: Mapping[str, Float64Array], first: int, state: Callable[[], Any], given: Sample | None = None
    ) -> int:
        """Write the reference of the ticks from `first` on into views (k, ...) by field; the number of filled ticks.

        Less than k are filled where the reference fails in a later tick; in the first it raises. `state` gives the
        snapshot at the first tick; `given` is the sample of a caller, where the phase `waits` for one.
        """
        self.prepare(state)
        assert self._inner is not None
        start = self._start
        for field, values in self._others.items() if start else ():
            views[field][...] = values
        own = {field[len(start) :]: view for field, view in views.items() if field.startswith(start)}
        if given is None:
            with blamed(self._name):
                return self._inner.fill(own, first - self._since, state, ahead=False)
        joints = self._side.arm.joint_names
        for field, view in own.items():
            shape = view.shape[1:]
            of_joints = joints if shape == (len(joints),) else None
            view[...] = float_array(f"ref.{field}", getattr(given, field), shape=shape, joints=of_joints)
        return len(next(iter(views.values())))


class TaskSteps:
    """The references of a task whose ticks are taken one by one, by `ctrl.step`.

    Samples are made ahead for a block of ticks, as a run does. A tick whose sample is there costs one row to copy. In
    the others, such as the first one of a phase, or one whose sample the caller gives, it is made in that tick.
    """

    def __init__(self, side: LawSide, task: Task, memory: Mapping[str, Float64Array], sample: Float64Array) -> None:
        self._side, self._task, self._memory, self._sample = side, task, memory, sample
        self._feed = TaskFeed(side, task)
        self._table = np.zeros((AHEAD, sample.size))
        self._fields: dict[str, Float64Array] = {}  # of all rows of the table
        first = 0
        for name, shape in task.reference.fields(side.arm.n).items():
            size = int(np.prod(shape, dtype=np.int64))
            self._fields[name] = self._table[:, first : first + size].reshape(AHEAD, *shape)
            first += size
        self._ahead: dict[int, Float64Array] = {}  # the sample, flat, by the number of a tick in its phase

    def name(self, going: bool) -> str:
        """The phase that the coming tick belongs to, of a task that is going on or begins with it."""
        return self._task.names[int(self._memory[NEXT]) if going else 0]

    def around(self, step: Callable[..., Any], slow: Callable[..., Any]) -> Callable[..., Any]:
        """`step` where the sample of the tick is made already, and else `slow`, which makes it."""
        ticks, sample = self._memory[TICKS].item, self._sample
        alone = [None]  # what the thread takes that is in a tick: half of the time of a lock
        begin, end = alone.pop, alone.append

        def with_sample(*args: Any, **kwargs: Any) -> Any:
            try:
                begin()
            except IndexError:
                raise one_thread_at_a_time() from None
            try:
                row = self._ahead.get(int(ticks()))
                if row is None:
                    return slow(*args, **kwargs)
                sample[:] = row
                return step(*args, **kwargs)
            finally:
                end(None)

        return with_sample

    def place(
        self, tick: int, going: bool, given: Mapping[str, Any], ref: Any, parameters: Mapping[str, Any]
    ) -> None:
        """Write the sample of a tick where compiled code reads it; it begins the task unless `going`.

        Where the reference of the phase fails, the task stops: the tick after the one that raises holds the arm.
        """
        since, name = int(self._memory[TICKS]) if going else 0, self.name(going)
        if since == 0:
            self._ahead = {}
            self._feed.begin(name, tick)
        waits = self._feed.waits
        if waits and not isinstance(ref, self._task.laws[name].reference):
            kind, got = self._task.laws[name].reference.described(), "none" if ref is None else type(ref).__name__
            raise UsageError(f"phase '{name}' follows a stream: step needs ref, a {kind}; got {got}", name="ref")
        if ref is not None and not waits:
            raise UsageError(f"phase '{name}' has its own reference; leave ref out of step", name="ref")
        row = self._ahead.get(since)
        if row is None:
            x = None if waits and since > 0 else self._seen(tick, going, given, parameters)
            try:
                self._feed.prepare(lambda: x)
                fields = {field: rows[: self._count(tick)] for field, rows in self._fields.items()}
                count = self._feed.fill(fields, tick, lambda: x, ref)
            except Exception:
                if going and not waits:
                    self._memory[NEXT][...], self._memory[TICKS][...] = len(self._task.phases), 0.0
                raise
            # A first tick is never there beforehand, for what it follows depends on where its phase begins.
            row, self._ahead = self._table[0], {since + i: self._table[i] for i in range(1, count)}
        self._sample[:] = row

    def _seen(self, tick: int, going: bool, given: Mapping[str, Any], parameters: Mapping[str, Any]) -> Snapshot:
        """The controller's snapshot in a tick."""
        sizes = measurement_shapes(self._side.arm.n)
        measured = {path: float_array(path, value, shape=sizes[path]) for path, value in given.items()}
        self._side.check_finite(measured, tick)
        sensing = subtree(self._memory, "sensing") if going else None
        return self._side.seen(measured, sensing, parameters, tick * self._side.dt)

    def _count(self, tick: int) -> int:
        """Ticks whose samples can be made in this one."""
        if self._feed.waits:
            return 1
        question = self._feed.next_question(tick)
        return AHEAD if question is None else min(AHEAD, question - tick)
