"""References of a robot's loop: tables made beforehand, or where a phase begins, and streams."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np

from taut.arm.parts import require_radians
from taut.base.checks import instance_of
from taut.base.errors import RangeError, TautError, UsageError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.lawside import LawSide
from taut.control.safety import REFERENCE_STEP, SafetyLimits, is_position, step_of
from taut.control.tasks.feed import ReferenceFeed, TaskFeed
from taut.control.trajectories.reference import (
    Hold,
    Reference,
    Sample,
    Stream,
    Trajectory,
    as_reference,
    sample_rows,
)
from taut.control.trajectories.samples import Chunk
from taut.controller import Controller
from taut.maths.snapshot import Snapshot
from taut.runtime.realtime.acting import Acting
from taut.runtime.realtime.sets import MADE_ROWS, NO_ROWS, Table

MOVING: Final = ("v", "a", "twist", "acceleration")  # fields of a reference that are zero at rest
ROUNDING: Final = 1e-9  # [rad | m | ...]
MAX_TICKS: Final = 1_200_000  # of a reference that is made beforehand
FEED_EVERY: Final = 0.002  # [s] between two looks at whether a phase has begun
IDLE_EVERY: Final = 0.05  # [s] between two looks where nothing is fed
STALE: Final = (2.0, 3.0)  # [periods] of a stream: then it holds, then it stops
SERVO_PERIOD: Final = 0.02  # [s] streams of this period, or a shorter one, stop after
SERVO_STOP: Final = 0.05  # [s], if that is more


def time_outs(period: float) -> tuple[float, float]:
    """Ages of a stream's sample [s] after which the loop holds, and after which it stops."""
    stop = STALE[1] * period
    return STALE[0] * period, max(stop, SERVO_STOP) if period <= SERVO_PERIOD else stop


@dataclass(frozen=True, kw_only=True, eq=False)
class References:
    """What feeds a law: a table for each phase, or one; the streams, by the number of the phase."""

    tables: list[Table]
    streams: dict[int, Stream] = field(default_factory=dict)
    feed: ReferenceFeed | TaskFeed | None = None  # None where everything is in the tables


def references_of(ctrl: Controller, ref: object, q: Float64Array, duration: float | None) -> References:
    """What a controller follows that starts at q. Raises UsageError, RangeError."""
    side, task, numbers = ctrl.side, ctrl.side.task, dict(ctrl.parameters)
    if task is None:
        reference: Reference = Hold() if ref is None else as_reference(ref)
        side.check_start(q, numbers, reference)
        if isinstance(reference, Stream) and reference.source is None:
            return References(tables=[_of_stream(reference)], streams={0: reference})
        feed = ReferenceFeed(reference, side.law.reference, side.arm, side.dt, side.at_rest(q))
        if isinstance(reference, Stream):
            return References(tables=[_of_stream(reference)], streams={0: reference}, feed=feed)
        rows = NO_ROWS if _here(reference) else _rows(side, feed, duration, lambda: None)
        return References(tables=[Table(rows=rows)])
    if ref is not None:
        raise UsageError("each phase of a task has its own reference; leave ref out", name="ref")
    side.check_start(q, numbers)
    tables, streams, feeds = list[Table](), dict[int, Stream](), TaskFeed(side, task, lambda: numbers)
    for i, (name, phase) in enumerate(task.phases.items()):
        given = phase.reference
        if given is None or _here(given):
            tables.append(Table(rows=NO_ROWS))
        elif isinstance(given, Stream):
            streams[i] = given
            tables.append(_of_stream(given))
        elif callable(given) and not isinstance(given, Trajectory):
            tables.append(Table(rows=None))
        else:
            tables.append(Table(rows=_phase_rows(side, feeds, name, Snapshot(side.model, q=q, v=np.zeros(len(q))))))
    return References(tables=tables, streams=streams, feed=feeds)


def _here(reference: object) -> bool:
    """Whether it holds where the arm is."""
    return isinstance(reference, Hold) and reference.sample is None


def _of_stream(stream: Stream) -> Table:
    """Its table. Samples that a program sends act as they are."""
    if stream.source is None and stream.blend is not None:
        raise UsageError("blend is for a stream with source=; leave it out", name="blend")
    return Table(rows=None, stream=True)


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
    return _filled(side, feed, 0, ticks, state)


def _filled(
    side: LawSide, feed: ReferenceFeed | TaskFeed, first: int, count: int, state: Callable[[], Any]
) -> Float64Array:
    """(count, reference) samples from a tick on."""
    fields = side.law.reference.fields(side.arm.n)
    views, done = {name: np.zeros((count, *shape)) for name, shape in fields.items()}, 0
    while done < count:
        done += feed.fill({name: view[done:] for name, view in views.items()}, first + done, state)
    return np.concatenate([view.reshape(count, -1) for view in views.values()], axis=1)


def _row(side: LawSide, sample: Sample) -> Float64Array:
    """(reference_size,) a sample."""
    fields = side.law.reference.fields(side.arm.n)
    return np.concatenate([np.ravel(np.asarray(getattr(sample, name), dtype=np.float64)) for name in fields])


def require_fitting(side: LawSide, references: References, q: Float64Array, limits: SafetyLimits) -> None:
    """RangeError for references that are known beforehand and jump, the first from q (n,), or exceed the limits."""
    for k, table in enumerate(references.tables):
        if table.rows is None or not len(table.rows):
            continue
        begins = _row(side, side.at_rest(q)) if k == 0 else table.rows[0]
        part = None if side.task is None else side.task.follows(side.task.names[k])
        require_steady(side, table.rows, begins, "where the arm is", limits, part)
        moves, first = table.rows[:1] if len(table.rows) == 1 else NO_ROWS, 0
        for name, shape in side.law.reference.fields(side.arm.n).items():
            at, first = slice(first, first + math.prod(shape)), first + math.prod(shape)
            if name.rpartition("_")[2] in MOVING and len(moves):
                _require_each(side, name, np.abs(moves[:, at]), "of a set-point must be zero; it is {x}")


def require_steady(
    side: LawSide, rows: Float64Array, before: Float64Array, beginning: str, limits: SafetyLimits,
    part: str | None = None,
) -> None:  # fmt: skip
    """RangeError where rows (k, reference) jump in their positions, the first from a row before, or exceed limits.

    `part` is what is followed of a sample of a task whose phases follow several kinds.
    """
    arm, first = side.arm, 0
    for name, shape in side.law.reference.fields(arm.n).items():
        at, first = slice(first, first + math.prod(shape)), first + math.prod(shape)
        if not name.startswith(f"{part}_" if part else ""):
            continue
        was, now, kind = np.vstack([before[at], rows[:-1, at]]), rows[:, at], name.rpartition("_")[2]
        require = partial(_require_each, side, name)
        if is_position(name):
            moved, away = (
                np.abs(step_of(arm, name, now, was)),
                f"of {beginning}; it is {{x}} away; robot.move_to it first",
            )
            require(moved[:1], f"must be within {{most}} {away}, or take a trajectory from there", REFERENCE_STEP)
            require(moved, "must move by at most {most} in a tick; it moves by {x} after {t}", REFERENCE_STEP)
        if kind == "q" and shape == (arm.n,):
            for word, limit, sign in (("upper", limits.upper, 1.0), ("lower", limits.lower, -1.0)):
                if limit is not None:  # one that is beyond may come back
                    beyond = np.where(sign * (now - was) > 0.0, sign * (now - limit), -1.0)
                    require(beyond, f"must stay within limits.{word}; it is {{x}} beyond after {{t}}")
        if kind == "v" and shape == (arm.n,) and limits.v is not None:
            require(np.abs(now) - limits.v, "must be within limits.v; it is {x} beyond after {t}; take longer")


def _require_each(side: LawSide, name: str, x: Float64Array, what: str, most: float = 0.0) -> None:
    """RangeError for the first tick and entry of x (k, size) above its bound."""
    wrong = np.argwhere(x > most + ROUNDING)
    if not len(wrong):
        return
    arm, (k, i) = side.arm, (int(index) for index in wrong[0])
    joint = arm.joint_names[i] if x.shape[1] == arm.n else None
    whose = f"ref.{name}" if joint is None else f"ref.{name} of joint '{joint}'"
    units = {"q": "" if joint is None else arm.units[i], "v": "" if joint is None else f"{arm.units[i]}/s", "p": "m"}
    unit = units.get(name.rpartition("_")[2], "")
    words = {"x": f"{x[k, i]:.3g} {unit}".strip(), "most": f"{most:g} {unit}".strip(), "t": f"{k * side.dt:.4g} s"}
    raise RangeError(f"{whose} {what.format(**words)}", name="ref", joint=joint, value=float(x[k, i]))


class Feeder(threading.Thread):
    """Feeds a law with what is not known beforehand, and keeps the ticks before a fault.

    It makes the reference of a phase where that begins, and asks the source of a stream each period, whose answer
    counts from the tick in which it was asked.
    """

    def __init__(self, acting: Acting, references: References) -> None:
        super().__init__(daemon=True, name="taut feeder")
        self._acting, self._references, self._side = acting, references, acting.made.safe.side
        acting.feeder = self
        self._feeds = any(table.rows is None for table in references.tables)
        self._ended = threading.Event()
        self._begun, self._due = (-1, 0), 0  # the phase that is fed, and its ticks; the tick of the next question
        self.error: TautError | None = None
        """Why it feeds no more; the loop holds, or stops by its time-out."""

    @property
    def periods(self) -> list[float]:
        """Of the streams that a program sends [s]."""
        return [float(one.period) for one in self._references.streams.values() if one.source is None]

    def end(self) -> None:
        """Stop feeding."""
        self._ended.set()
        if self.is_alive() and self is not threading.current_thread():
            self.join(1.0)

    def run(self) -> None:
        while not self._ended.wait(FEED_EVERY if self._feeds and self.error is None else IDLE_EVERY):
            self.step()

    def step(self) -> None:
        """Look at the last tick, and feed the next ones."""
        rows = self._acting.rows(1)
        self._acting.keep_fault(rows)
        if not (len(rows) and self._feeds) or self.error is not None:
            return
        try:
            self._feed(rows)
        except TautError as error:
            self.error = error
        except Exception as cause:
            self.error = UsageError(f"a reference fails: {type(cause).__name__}: {cause}", name="reference")

    def send(self, answer: Sample | Chunk) -> None:
        """A sample of the stream that is followed now, or a chunk that begins now; from any thread."""
        instance_of("sample", answer, (Sample, Chunk), "a sample such as taut.JointMotion, or a taut.chunk")
        rows = self._acting.rows(1)
        phase, side = self._phase(rows), self._side
        stream = self._references.streams.get(phase)
        if stream is None or not len(rows):
            return  # another phase acts
        task, fields = side.task, side.law.reference.fields(side.arm.n)
        law = side.single_law if task is None else task.laws[task.names[phase]]
        part = None if task is None else task.follows(task.names[phase])
        count = 1 if isinstance(answer, Sample) else min(MADE_ROWS, round(answer.duration * side.rate) + 1)
        given = sample_rows(answer, side.dt * np.arange(count, dtype=np.float64), law.reference, side.arm.n)
        if "q" in given:
            require_radians("ref.q", given["q"], side.arm)
        rest = side.law.at_rest(self._seen(rows))  # for what the phase does not follow
        table = {name: np.broadcast_to(getattr(rest, name), (count, *shape)) for name, shape in fields.items()}
        table |= {name if part is None else f"{part}_{name}": values for name, values in given.items()}
        made = np.concatenate([np.reshape(table[name], (count, -1)) for name in fields], axis=1)
        require_steady(side, made, self._last(rows), "the last sample", self._acting.made.safe.limits, part)
        self._publish(phase, stream, made, -1)

    def _feed(self, rows: Float64Array) -> None:
        phase, feed, side = self._phase(rows), self._references.feed, self._side
        if phase < 0 or feed is None or self._references.tables[phase].rows is not None:
            return
        ticks, stream = self._acting.controls.ticks(phase), self._references.streams.get(phase)
        begins, self._begun = self._begun[0] != phase or ticks < self._begun[1], (phase, ticks)
        name = "" if side.task is None else side.task.names[phase]
        if stream is None:
            if self._acting.controls.waits(phase) and isinstance(feed, TaskFeed):
                self._acting.controls.fill(phase, _phase_rows(side, feed, name, self._seen(rows)))
            return
        if begins:
            self._due = 0
        if begins and isinstance(feed, TaskFeed):
            feed.begin(name, 0)
        if stream.source is None or ticks < self._due:
            return
        while not begins and (following := feed.next_question(self._due)) is not None and following <= ticks:
            self._due = following  # what it did not come to
        count = min(MADE_ROWS, math.ceil((float(stream.period) + time_outs(float(stream.period))[1]) * side.rate) + 1)
        x = self._seen(rows)
        made = _filled(side, feed, self._due, count, lambda: x)
        part = None if side.task is None else side.task.follows(name)
        begins_at = _row(side, side.law.at_rest(x)) if begins else self._last(rows)
        require_steady(side, made, begins_at, "where the arm is", self._acting.made.safe.limits, part)
        if not self._ended.is_set():
            self._publish(phase, stream, made, self._due)
        following = feed.next_question(self._due)
        self._due = self._due + 1 if following is None else following

    def _publish(self, phase: int, stream: Stream, rows: Float64Array, arrived: int) -> None:
        self._acting.controls.time_out(*time_outs(float(stream.period)))
        self._acting.controls.fill(phase, rows, arrived)

    def _last(self, rows: Float64Array) -> Float64Array:
        """(reference_size,) the sample of the last tick."""
        fields = self._side.law.reference.fields(self._side.arm.n)
        return np.concatenate([np.ravel(self._acting.column(rows, f"reference.{name}")[-1]) for name in fields])

    def _phase(self, rows: Float64Array) -> int:
        """The phase of the coming tick; -1 where that is not known yet."""
        if self._side.task is None or not len(rows):
            return 0 if len(rows) else -1
        now = int(self._acting.column(rows, "phase")[-1])
        ended = self._acting.column(rows, "phase_ended")[-1] > 0.5
        return -1 if ended or now >= len(self._references.tables) else now

    def _seen(self, rows: Float64Array) -> Snapshot:
        """The controller's snapshot in the last tick."""
        acting = self._acting
        now = {path: acting.column(rows, path)[-1] for path in acting.layout.columns}
        measured = {name: now[name] for name in acting.made.safe.measured}
        return self._side.seen(measured, subtree(now, "memory.sensing"), subtree(now, "parameters"), float(now["t"]))
