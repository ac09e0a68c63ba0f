"""Phases: a task as one law. All laws are in one program; the phase that acts is a number in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, Final, Self, TypeVar

import numpy as np

from taut.base.errors import (
    MatchError,
    NumericalError,
    RangeError,
    ShapeError,
    TautError,
    UsageError,
    raised_location,
)
from taut.base.types import Array
from taut.control.command import Command, Terms
from taut.control.law import Law, LawMemory, MemoryView, call, initial_memory
from taut.control.tasks.guards import Guard, Lasting, condition
from taut.control.tasks.halt import Halt
from taut.control.tasks.phase import STOP, Phase, named_phases
from taut.control.tasks.phase_sample import PhaseSample, phase_sample
from taut.control.trajectories.reference import Hold, JointMotion, Reference, Sample, Stream, Trajectory, as_reference
from taut.maths.snapshot import PhaseView, Snapshot
from taut.trace import math as tm

__all__ = ["ENDED", "NO_CONTACT", "Phases"]

T = TypeVar("T")
RUNNING, UNTIL, UNLESS, TIMEOUT, NO_CONTACT = range(5)
ENDED: Final = {UNTIL: "until", UNLESS: "unless", TIMEOUT: "timeout", NO_CONTACT: "no contact"}
"""What ended a phase, by the code that is recorded in the last tick of it."""
BESIDE: Final = 0.1  # [rad | m]
NEAR: Final = 1e-6  # [ticks] what a timeout that is meant to be a whole number of ticks may miss one by


class Phases(Law):
    """A task: phases, each with a law of its own. Made by `taut.compile([taut.Phase(...), ...], arm)`.

    Law:          that of the phase that acts; where the task has stopped, `Halt`: the arm is held where it was
    Closed loop:  that of the phase that acts

    All laws are evaluated in every tick and one is chosen: a number of a law that does not act, finite or not,
    reaches neither the command nor a memory. The guards of the phase that acts decide, from what is measured in a
    tick, which phase acts from the next one on. A law starts in the first tick of its phase. A change of phases
    comes in by `Limits(blend=)`, from the command of the tick before, and within `Limits(tau_dot=)`.

    The path of a gain is law.approach.kp, by the name of the phase; law.stop.kp and law.stop.kd are those of `Halt`.
    """

    phases: Mapping[str, Phase]
    laws: Mapping[str, Law]

    @classmethod
    def of(cls, task: Sequence[Phase]) -> Phases:
        """The law of a task.

        Raises:
            UsageError, UnknownNameError: A task that is none; the message says why.
        """
        phases = named_phases(task)
        made = cls(phases=phases, laws={**{name: phase.law for name, phase in phases.items()}, STOP: Halt()})
        followers = [phase.law for phase in phases.values() if not phase.law.ignores_reference]
        kinds = list(dict.fromkeys(law.reference for law in followers)) or [JointMotion]
        object.__setattr__(made, "reference", kinds[0] if len(kinds) == 1 else phase_sample(tuple(kinds)))
        return made

    # ---------------------------------------------------------------- its parts

    @property
    def names(self) -> tuple[str, ...]:
        """The phases in their order, and what follows where the task has stopped."""
        return (*self.phases, STOP)

    def children(self) -> dict[str, Law]:
        return dict(self.laws)

    def with_children(self, children: Mapping[str, Law]) -> Self:
        return self._replaced({"laws": dict(children)})

    def check_size(self, joints: Sequence[str] | int, prefix: str = "") -> None:
        for name, law in self.laws.items():
            try:
                law.check_size(joints, prefix)
            except ShapeError as cause:
                raise ShapeError(f"phase '{name}': {cause}", name=name) from cause

    def seen_by(self, child: str, x: Snapshot, ref: Sample) -> tuple[Snapshot, Sample]:
        return x, self.sample_of(child, ref)

    def sample_of(self, name: str, ref: Sample) -> Sample:
        """What the law of a phase follows, of a sample of the task."""
        law = self.laws[name]
        of_kind: Sample = ref if isinstance(ref, law.reference) else getattr(ref, "of_kind", lambda _: ref)(law)
        return of_kind

    def follows(self, name: str) -> str | None:
        """Which part of a sample of the task the law of a phase follows; None where the sample is of one kind."""
        kind, law = self.reference, self.laws[name]
        return kind.name_of(law.reference) if issubclass(kind, PhaseSample) and not law.ignores_reference else None

    @property
    def controlled_frame(self) -> str | None:
        """The frame that the first law of the tool controls."""
        return next((frame for law in self.laws.values() if (frame := law.controlled_frame)), None)

    def at_rest(self, x: Snapshot) -> Sample:
        kind = self.reference
        followers = [law for law in self.laws.values() if not law.ignores_reference]
        own = {law.reference: law.at_rest(x) for law in reversed(followers)}
        if kind in own or not followers:
            return own[kind] if followers else JointMotion.at_rest(x, None)
        joined: Sample = kind.joined(own)  # type: ignore[attr-defined]  # a sample of several kinds
        return joined

    def check_states(self, x: Snapshot, rate: float, *, changed: bool = False) -> None:
        """Only the first phase starts where the run does; what changes may be of any."""
        for name in self.laws if changed else [next(iter(self.phases))]:
            self.laws[name].check_states(x, rate, changed=changed)

    def check_references(self, x: Snapshot, ref: Reference, rate: float, *, later: bool = False) -> None:  # noqa: ARG002
        """What the phases are to follow, as far as it is known before: not what depends on where a phase begins."""
        for i, (name, phase) in enumerate(self.phases.items()):
            given = phase.reference
            if isinstance(given, Trajectory) or not (callable(given) or isinstance(given, Stream)):
                reference = as_reference(Hold() if given is None else given)
                with self.blamed(name):
                    self.laws[name].check_references(x, reference, rate, later=i > 0)

    def check_begin(self, name: str, x: Snapshot, ref: Reference, rate: float) -> None:
        """A phase that begins must have a meaning there, with its gains and what it is to follow.

        Not one that is refused, since there is no contact.

        Raises:
            RangeError, UsageError: It has none; the message names the phase.
        """
        phase = self.phases[name]
        if phase.needs_contact and not condition(phase.in_contact(x), f"contact of phase '{name}'"):
            return
        with self.blamed(name):
            self.laws[name].check_states(x, rate)
            self.laws[name].check_references(x, ref, rate)

    @staticmethod
    @contextmanager
    def blamed(name: str, what: str = "its reference") -> Iterator[None]:
        """An error is said to be of a phase; one that is no sentence of ours, that it failed, and where."""
        try:
            yield
        except (ShapeError, RangeError) as cause:
            raise type(cause)(
                f"phase '{name}': {cause}", name=cause.name, joint=cause.joint, value=cause.value, rule=cause.rule
            ) from cause
        except TautError as cause:
            raise UsageError(f"phase '{name}': {cause}", name="reference") from cause
        except Exception as cause:
            how = f"{type(cause).__name__}: {cause} at {raised_location(cause)}"
            raise UsageError(f"phase '{name}': {what} fails: {how}", name="reference") from cause

    # ---------------------------------------------------------------- a tick

    def start(self, x: Snapshot, ref: Sample) -> dict[str, Any]:  # noqa: ARG002
        counters = sum(len(_counters(phase)) for phase in self.phases.values())
        none = {"lasted": np.zeros(counters)} if counters else {}
        return {"phase": 0.0, "next": 0.0, "ticks": 0.0, "ended": 0.0, "begin": tm.array(x.q), **none}

    def memory_of_children(self, x: Snapshot, ref: Sample) -> dict[str, Any]:
        """Zeros: each law starts when its phase begins, and what it would start with now may not be finite."""
        out: dict[str, Any] = {}
        for name, law in self.laws.items():
            own = self.sample_of(name, ref)
            out[name] = _zeros(_beside_singular(partial(initial_memory, law, ref=own), x, idle=True))
        return out

    @staticmethod
    def begins(memory: Mapping[str, Any]) -> Any:
        """Whether the coming tick is the first one of its phase."""
        return memory["ticks"] < 0.5

    def command(self, x: Snapshot, ref: Sample, memory: MemoryView, dt: Any) -> tuple[Command, dict[str, Any]]:
        fresh, count = memory.ticks < 0.5, len(self.phases)
        here = [_is(memory.next, i, count) for i in range(count + 1)]
        begin = tm.where(fresh, tm.array(x.q), memory.begin)
        refused = self._refused(x, here, fresh)
        acting = {name: here[i] & ~refused for i, name in enumerate(self.phases)}
        acting[STOP] = here[count] | refused
        commands: dict[str, Command] = {}
        after: dict[str, Any] = {}
        for name, law in self.laws.items():
            own = self.sample_of(name, ref)
            if name == STOP:
                law = law._replaced({"kind": self._kind(commands)})
            old = memory[name]

            def called(x: Snapshot, law: Law = law, own: Sample = own, old: LawMemory = old) -> tuple[Command, Any]:
                return call(law, x, own, _chosen(fresh, initial_memory(law, x, own), old), dt)

            commands[name], left = _beside_singular(called, x, idle=_known_false(acting[name]))
            after[name] = _chosen(acting[name], left, old)
        elapsed = memory.ticks * dt
        moved = self._moved_on(x, ref, memory, (here, refused, fresh, begin, elapsed), dt)
        total, terms = _of_the_acting(commands, acting, x.n)
        return self._made(commands)(Terms.known(total, terms)), {**after, **moved, "begin": begin}

    def _refused(self, x: Snapshot, here: list[Any], fresh: Any) -> Any:
        """Whether a phase begins that needs contact, and has none."""
        refused: Any = np.bool_(False)
        for i, (name, phase) in enumerate(self.phases.items()):
            if phase.needs_contact:
                touches = _holding(phase.in_contact, x, f"contact of phase '{name}'", idle=_known_false(here[i]))
                refused = refused | (here[i] & fresh & ~touches)
        return refused

    def _moved_on(
        self, x: Snapshot, ref: Sample, memory: MemoryView, now: tuple[list[Any], Any, Any, Any, Any], dt: Any
    ) -> dict[str, Any]:
        """The memory of which phase acts, after this tick."""
        here, refused, fresh, begin, elapsed = now
        where_begun = x.at(begin, np.zeros(x.n))
        following, ended = memory.next, 0.0 * memory.ticks
        counts: list[Any] = []
        for i, (name, phase) in enumerate(self.phases.items()):
            own = self.sample_of(name, ref)
            tool = self.laws[name].controlled_frame
            seen = x.of_phase(PhaseView(elapsed=elapsed, ref=own, begin=where_begun, tool=tool))
            holds: dict[int, Any] = {NO_CONTACT: refused if phase.needs_contact else np.bool_(False)}
            for code, word in ((UNLESS, "unless"), (UNTIL, "until")):
                holds[code] = self._holds(phase, name, word, seen, (memory, fresh, here[i], counts))
            late = np.bool_(False)
            if phase.timeout is not None:
                late = memory.ticks + 1.0 > phase.timeout / dt - NEAR
            holds[TIMEOUT] = late
            for code in (TIMEOUT, UNTIL, UNLESS, NO_CONTACT):  # the later one wins
                goes = here[i] & holds[code]
                target = self._target(i, phase.then if code == UNTIL else phase.otherwise)
                following = tm.where(goes, float(target), following)
                ended = tm.where(goes, float(code), ended)
        phase_now = memory.next
        counted = {"lasted": tm.array(counts)} if counts else {}
        ticks = tm.where(ended > 0.5, 0.0, memory.ticks + 1.0)
        return {"phase": phase_now, "next": following, "ticks": ticks, "ended": ended, **counted}

    def _holds(
        self, phase: Phase, name: str, word: str, seen: Snapshot, now: tuple[MemoryView, Any, Any, list[Any]]
    ) -> Any:
        """Whether a guard holds; one that counts counts in `now`."""
        guard = getattr(phase, word)
        if guard is None:
            return np.bool_(False)
        memory, fresh, here, counts = now
        holds = _holding(guard, seen, f"{word} of phase '{name}'", idle=_known_false(here))
        if not isinstance(guard, Lasting):
            return holds
        before = tm.where(fresh, 0.0, memory["lasted"][len(counts)])
        counts.append(tm.where(here & holds, before + 1.0, 0.0))
        return counts[-1] > guard.ticks - 0.5

    def _target(self, i: int, target: str | int | None) -> int:
        """The number of the phase that follows."""
        if target is None:
            return i + 1
        return target if isinstance(target, int) else self.names.index(target)

    def _made(self, commands: Mapping[str, Command]) -> type[Command]:
        return type(commands[STOP])

    def _kind(self, commands: Mapping[str, Command]) -> str:
        kinds = {command.kind for command in commands.values()}
        if len(kinds) > 1:
            words = ", ".join(f"'{name}' a {command.kind}" for name, command in commands.items())
            raise MatchError(f"the phases of a task give commands of one kind; these give {words}", name="task")
        return kinds.pop()

    # ---------------------------------------------------------------- in words

    def alone(self, name: str) -> Phases:
        """The task of one of the phases."""
        return Phases.of([replace(self.phases[name], name=name, otherwise=STOP, then=None)])

    def plan(self) -> list[str]:
        """What ends each phase, and what follows then, a line each."""
        lines = []
        for i, (name, phase) in enumerate(self.phases.items()):
            onward, back = (self.names[self._target(i, to)] for to in (phase.then, phase.otherwise))
            parts = [f"until {_called(phase.until)} -> {onward}"] if phase.until is not None else []
            parts += [f"unless {_called(phase.unless)} -> {back}"] if phase.unless is not None else []
            parts += [f"after {phase.timeout:g} s -> {back}"] if phase.timeout is not None else []
            parts += [f"without contact -> {back}"] if phase.needs_contact else []
            lines.append(f"{name}: {'; '.join(parts) or 'to the end'}")
        return lines

    def __repr__(self) -> str:
        return f"[{', '.join(f'{name}: {self.laws[name]!r}' for name in self.phases)}]"


def _is(number: Any, i: int, last: int) -> Any:
    """Whether a phase has this number; what lies outside belongs to the first and the last one."""
    holds: Any = np.bool_(True)
    if i > 0:
        holds = (number > i - 0.5) & holds
    if i < last:
        holds = (number < i + 0.5) & holds
    return holds


def _known_false(which: Any) -> bool:
    """Whether a condition is known not to hold: as plain Python runs it, what does not act is idle."""
    return isinstance(which, (bool, np.bool_)) and not which


def _beside_singular(evaluated: Callable[[Snapshot], T], x: Snapshot, *, idle: bool) -> T:
    """What a law gives in a tick, or what a function makes of it.

    Compiled code gives numbers that are not finite where a law is singular. Plain Python refuses to, and an idle law
    is asked beside that state: of what it gives only names and shapes are used.
    """
    try:
        return evaluated(x)
    except NumericalError:
        if not idle:
            raise
        return evaluated(x.at(x.q + BESIDE * np.cos(np.arange(x.n)), x.v))


def _zeros(memory: Any) -> Any:
    """Memory of the same shapes."""
    if isinstance(memory, Mapping):
        return {name: _zeros(value) for name, value in memory.items()}
    return tm.zeros(np.shape(memory))


def _holding(guard: Guard, x: Snapshot, who: str, *, idle: bool) -> Any:
    """Whether a guard holds; that of an idle phase does not where it is singular."""
    try:
        return condition(guard(x), who)
    except NumericalError:
        if not idle:
            raise
        return np.bool_(False)
    except TautError:
        raise
    except Exception as cause:
        how = f"{type(cause).__name__}: {cause} at {raised_location(cause)}"
        raise UsageError(f"{who} fails: {how}", name="guard") from cause


def _chosen(which: Any, a: Any, b: Any) -> Any:
    """`a` where the condition holds, else `b`: memory, with that of laws that are held."""
    if isinstance(a, Mapping):
        return {name: _chosen(which, value, b[name]) for name, value in a.items()}
    return tm.where(which, a, b)


def _of_the_acting(
    commands: Mapping[str, Command], acting: Mapping[str, Any], n: int
) -> tuple[Array, dict[str, Any]]:
    """The command of the law that acts, and its terms, zero where it has none of that name."""
    total: Array = commands[STOP].total
    for name, command in commands.items():
        if name != STOP:
            total = tm.where(acting[name], command.total, total)
    terms: dict[str, Any] = {}
    for name, command in commands.items():
        for term, values in command.terms.parts.items():
            terms[term] = tm.where(acting[name], values, terms.get(term, tm.zeros(n)))
    return total, terms


def _called(guard: Any) -> str:
    """What a guard is called."""
    inner = guard.guard if isinstance(guard, Lasting) else guard
    word = getattr(inner, "__name__", type(inner).__name__)
    word = "its guard" if word == "<lambda>" else word
    return f"{word} for {guard.ticks} ticks" if isinstance(guard, Lasting) else word


def _counters(phase: Phase) -> list[Lasting]:
    return [guard for guard in (phase.unless, phase.until) if isinstance(guard, Lasting)]
