"""References of a robot's loop: made beforehand as tables, where a phase begins, or asked from a stream's source."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.parts import short_way
from taut.base.errors import RangeError, TautError, UsageError
from taut.base.types import Float64Array
from taut.control.lawside import LawSide
from taut.control.tasks.feed import ReferenceFeed, TaskFeed
from taut.control.trajectories.reference import Hold, Reference, Stream, Trajectory, as_reference
from taut.controller import Controller
from taut.maths.snapshot import Snapshot
from taut.runtime.realtime.acting import Acting
from taut.runtime.realtime.sets import Table

STARTS_NEAR: Final = 0.1  # [rad | m] between the arm and the first sample of a joint motion
MAX_TICKS: Final = 1_200_000  # of a reference that is made beforehand
LOOK: Final = 0.002  # [s] between two looks at whether a phase has begun
STALE: Final = (2.0, 3.0)  # [periods] of a stream: then it holds, then it stops
SERVO_PERIOD: Final = 0.02  # [s] streams of this period, or a shorter one, stop after
SERVO_STOP: Final = 0.05  # [s], if that is more
NO_ROWS: Final = np.zeros((0, 1))


def time_outs(period: float) -> tuple[float, float]:
    """Ages of a stream's sample [s] after which the loop holds, and after which it stops."""
    stop = STALE[1] * period
    return STALE[0] * period, max(stop, SERVO_STOP) if period <= SERVO_PERIOD else stop


@dataclass(frozen=True, kw_only=True, eq=False)
class References:
    """What feeds a law: a table for each phase, or one; the streams, by the number of the phase."""

    tables: list[Table]
    streams: dict[int, Stream]
    task: TaskFeed | None = None

    @property
    def stream(self) -> Stream | None:
        """The stream that is followed, or the first one of a task."""
        return next(iter(self.streams.values()), None)


def references_of(ctrl: Controller, ref: object, q: Float64Array, duration: float | None) -> References:
    """What a controller follows that starts at q. Raises UsageError, RangeError."""
    side, task = ctrl.side, ctrl.side.task
    if task is None:
        reference: Reference = Hold() if ref is None else as_reference(ref)
        side.check_start(q, dict(ctrl.parameters), reference)
        if isinstance(reference, Stream):
            return References(tables=[], streams={0: reference})
        feed = ReferenceFeed(reference, side.law.reference, side.arm, side.dt, side.at_rest(q))
        here = isinstance(reference, Hold) and reference.sample is None
        rows = NO_ROWS if here else _rows(side, feed, duration, lambda: None)
        if isinstance(reference, Trajectory):
            _require_near(side, rows, q)
        return References(tables=[Table(rows=rows)], streams={})
    if ref is not None:
        raise UsageError("each phase of a task has its own reference; leave ref out", name="ref")
    side.check_start(q, dict(ctrl.parameters))
    tables, streams, numbers = list[Table](), dict[int, Stream](), dict(ctrl.parameters)
    feeds = TaskFeed(side, task, lambda: numbers)
    for i, (name, phase) in enumerate(task.phases.items()):
        given = phase.reference
        if given is None or (isinstance(given, Hold) and given.sample is None):
            tables.append(Table(rows=NO_ROWS))
        elif isinstance(given, Stream):
            streams[i] = given
            tables.append(Table(rows=None, stream=True))
        elif callable(given) and not isinstance(given, Trajectory):
            tables.append(Table(rows=None))
        else:
            x = Snapshot(side.model, q=q, v=np.zeros(len(q)))
            tables.append(Table(rows=_phase_rows(side, feeds, name, x)))
    return References(tables=tables, streams=streams, task=feeds)


def _phase_rows(side: LawSide, feed: TaskFeed, name: str, x: Snapshot) -> Float64Array:
    """The samples of a phase that begins at x."""
    assert side.task is not None
    feed.begin(name, 0)
    feed.prepare(lambda: x)
    return _rows(side, feed, side.task.phases[name].timeout, lambda: x)


def _rows(
    side: LawSide, feed: ReferenceFeed | TaskFeed, duration: float | None, state: Callable[[], Any]
) -> Float64Array:
    """(k, reference) samples of a reference, up to its end or for a stated time."""
    length = duration if feed.duration is None else feed.duration
    if length is None:
        where = "the phase a timeout=" if side.task is not None else "duration="
        raise UsageError(f"this reference has no end of its own; give {where} [s]", name="duration")
    ticks = round(length * side.rate) + 1
    if ticks > MAX_TICKS:
        raise RangeError(
            f"a reference of {ticks} ticks is longer than {MAX_TICKS}; give a shorter duration=", name="duration"
        )
    fields = side.law.reference.fields(side.arm.n)
    views, done = {name: np.zeros((ticks, *shape)) for name, shape in fields.items()}, 0
    while done < ticks:
        done += feed.fill({name: view[done:] for name, view in views.items()}, done, state)
    return np.concatenate([view.reshape(ticks, -1) for view in views.values()], axis=1)


def _require_near(side: LawSide, rows: Float64Array, q: Float64Array) -> None:
    """A joint motion must begin where the arm is."""
    fields, n = side.law.reference.fields(side.arm.n), side.arm.n
    if next(iter(fields)) != "q":
        return
    apart = np.abs(short_way(rows[0, :n] - q, side.arm.continuous))
    i = int(np.argmax(apart))
    if apart[i] > STARTS_NEAR:
        raise RangeError(
            f"the reference begins {apart[i]:.3g} {side.arm.units[i]} away from joint '{side.arm.joint_names[i]}'; "
            "robot.move_to its beginning first",
            name="ref",
            joint=side.arm.joint_names[i],
            value=float(apart[i]),
        )


class Feeder(threading.Thread):
    """Makes the reference of a phase where it begins, and asks the source of a stream each period."""

    def __init__(self, acting: Acting, references: References) -> None:
        super().__init__(daemon=True, name="taut feeder")
        self._acting, self._references = acting, references
        self._numbers = dict(acting.controls.views)
        self._ended = threading.Event()
        self.error: TautError | None = None
        """Why it ended; the loop holds, or stops by its time-out."""

    @property
    def needed(self) -> bool:
        """Whether there is anything to feed."""
        makes = any(table.rows is None and not table.stream for table in self._references.tables)
        return makes or any(stream.source is not None for stream in self._references.streams.values())

    def end(self) -> None:
        """Stop feeding."""
        self._ended.set()
        if self.is_alive() and self is not threading.current_thread():
            self.join(1.0)

    def run(self) -> None:
        next_question = time.monotonic()
        try:
            while not self._ended.is_set():
                rows = self._acting.rows(1)
                if len(rows):
                    phase = self._phase(rows)
                    stream = self._references.streams.get(phase)
                    now = time.monotonic()
                    if stream is not None and stream.source is not None:
                        if now >= next_question:
                            self._acting.controls.send(stream.source(self._seen(rows)))
                            self._acting.controls.time_out(*time_outs(float(stream.period)))
                            next_question = max(next_question + float(stream.period), now)
                    elif self._acting.controls.waits(phase):
                        self._make(phase, rows)
                self._ended.wait(max(min(LOOK, next_question - time.monotonic()), 5e-4))
        except TautError as error:
            self.error = error
        except Exception as cause:
            self.error = UsageError(f"a reference fails: {type(cause).__name__}: {cause}", name="reference")

    def _phase(self, rows: Float64Array) -> int:
        """The phase of the coming tick."""
        task = self._acting.made.safe.side.task
        if task is None:
            return 0
        now = int(self._acting.column(rows, "phase")[-1])
        ended = self._acting.column(rows, "phase_ended")[-1] > 0.5
        return -1 if ended else now  # which follows is known in the next tick

    def _make(self, phase: int, rows: Float64Array) -> None:
        side, task = self._acting.made.safe.side, self._references.task
        assert side.task is not None
        assert task is not None
        name = side.task.names[phase]
        made = _phase_rows(side, task, name, self._seen(rows))
        self._acting.controls.fill(phase, made)

    def _seen(self, rows: Float64Array) -> Snapshot:
        """The controller's snapshot in the last tick."""
        acting = self._acting
        side = acting.made.safe.side
        measured = {name: acting.column(rows, name)[-1] for name in acting.made.safe.measured}
        numbers = {path: view.copy() for path, view in self._numbers.items()}
        return side.seen(measured, None, numbers, float(acting.column(rows, "t")[-1]))
