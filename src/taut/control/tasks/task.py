"""Task: the stage of a control side that selects among the laws of phases. All laws are in one program."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, ClassVar, Final, Self, TypeVar

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
from taut.base.fields import Declared, Plain
from taut.control.command import (
    Command,
    MitCommand,
    Position,
    Terms,
    Torque,
    Velocity,
    of_kind,
    one_kind,
    rows_of,
)
from taut.control.gains import Gain, LawMemory, MemoryView
from taut.control.law import Law, call
from taut.control.tasks.phase import STOP, Guard, GuardView, Lasting, Phase, condition, named_phases
from taut.control.trajectories.compound import PhaseSample, phase_sample
from taut.control.trajectories.reference import Hold, JointMotion, Reference, Sample, Stream, Trajectory, as_reference
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["ENDED", "NO_CONTACT", "Halt", "Task"]

T = TypeVar("T")
RUNNING, UNTIL, UNLESS, TIMEOUT, NO_CONTACT = range(5)
ENDED: Final = {UNTIL: "until", UNLESS: "unless", TIMEOUT: "timeout", NO_CONTACT: "no contact"}
"""Cause of a phase's end, by the code that is recorded in its last tick."""
OFFSET_FROM_SINGULAR: Final = 0.1  # [rad | m] to a state beside a singular one
TICK_ROUNDING: Final = 1e-6  # [ticks] by which a timeout that is meant to be a whole number of ticks may miss one
MADE_BY: Final[Mapping[str, type[Command]]] = {kind.kind: kind for kind in (Torque, Velocity, Position, MitCommand)}


class Halt(Law):
    """Holds the arm where it was when this law began; it acts once a task has stopped.

    Law:          tau = M (kp (q_0 - q) - kd v) + h, with q_0 where it began; as a velocity 0, as a position q_0
    Closed loop:  e_ddot + kd e_dot + kp e = 0, e = q_0 - q
                  an arm that was moving comes to rest and returns; an earlier contact force is not maintained
    """

    ignores_reference: ClassVar[bool] = True

    kp: Gain = Gain(100.0, unit="1/s^2")
    kd: Gain = Gain(20.0, unit="1/s")
    kind: str = "torque"

    def start(self, x: Snapshot, ref: Any) -> dict[str, Any]:  # noqa: ARG002
        return {"q": tm.array(x.q)}

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: Any) -> tuple[Command, dict[str, Any]]:  # noqa: ARG002
        made, after = MADE_BY[self.kind], {"q": memory.q}
        if made in (Torque, MitCommand):
            a = Terms(P=self.kp @ x.difference(memory.q), D=-(self.kd @ x.v))
            free = {"q": memory.q, **dict.fromkeys(("v", "kp", "kd"), tm.zeros(x.n))}
            return of_kind(made, x.M @ a + Terms(nonlinear=x.h), free), after
        return of_kind(made, Terms(hold=tm.zeros(x.n) if made is Velocity else memory.q), {}), after


class Task(Declared):
    """Phases, each with a law of its own, of which one acts in each tick: what a control side evaluates.

    All laws are evaluated in every tick and one is selected: a number of a law that does not act, finite or not,
    reaches neither the command nor a memory. The guards of the phase that acts decide, from what is measured in a
    tick, which phase acts from the next one on. A change of phases comes in by `Limits(blend=)`, from the command of
    the tick before, and within `Limits(tau_dot=)`. Where the task has stopped, `Halt` holds the arm. The path of a
    gain is law.approach.kp, by the name of the phase; those of `Halt` are law.stop.kp and law.stop.kd.

    Args:
        phases: By name, in their order.
        laws: By the name of the phase, and last the law that acts where the task has stopped.
    """

    phases: Plain[Mapping[str, Phase]] = Plain()
    laws: Plain[Mapping[str, Law]] = Plain()

    uses_memory: ClassVar[bool] = True
    optional_memory: ClassVar[tuple[str, ...]] = ("energy", "seen")  # of guards that ask for the energy
    ignores_reference: ClassVar[bool] = False

    @classmethod
    def of(cls, phases: Sequence[Phase]) -> Task:
        """The task of a list of phases."""
        named = named_phases(phases)
        return cls(phases=named, laws={**{name: phase.law for name, phase in named.items()}, STOP: Halt()})

    @property
    def names(self) -> tuple[str, ...]:
        """The phases in their order, then the state in which the task has stopped."""
        return (*self.phases, STOP)

    @property
    def title(self) -> str:
        """Its name in messages."""
        return f"the task of {', '.join(self.phases)}"

    @property
    def followers(self) -> tuple[Law, ...]:
        """The laws that follow a reference."""
        return tuple(law for law in self.laws.values() if not law.ignores_reference)

    @property
    def reference(self) -> type[Sample]:
        """The kind of sample that its laws follow; one with a sample of each kind where there are several."""
        kinds = list(dict.fromkeys(law.reference for law in self.followers)) or [JointMotion]
        return kinds[0] if len(kinds) == 1 else phase_sample(tuple(kinds))

    @property
    def controlled_frame(self) -> str | None:
        """The frame that the first law of the tool controls."""
        return next((frame for law in self.laws.values() if (frame := law.controlled_frame)), None)

    def children(self) -> dict[str, Law]:
        """The laws by name."""
        return dict(self.laws)

    def follows(self, name: str) -> str | None:
        """Which part of a sample of the task the law of a phase follows; None where the sample is of one kind."""
        kind, law = self.reference, self.laws[name]
        return kind.name_of(law.reference) if issubclass(kind, PhaseSample) and not law.ignores_reference else None

    def sample_of(self, name: str, ref: Sample) -> Sample:
        """What the law of a phase follows, of a sample of the task."""
        part = self.follows(name)
        own: Sample = ref if part is None else getattr(ref, part)
        return own

    def at_rest(self, x: Snapshot) -> Sample:
        """The sample with which its laws keep the arm where it is in the snapshot."""
        kind, own = self.reference, {law.reference: law.at_rest(x) for law in reversed(self.followers)}
        if not issubclass(kind, PhaseSample):
            return own[kind] if own else JointMotion.at_rest(x, None)
        return kind({part.name: own[part.kind] for part in kind.parts})

    def declared_parts(self) -> dict[str, Declared]:
        """The laws by name, whose gains are below these."""
        return dict(self.laws)

    def _with_parts(self, parts: Mapping[str, Any]) -> Self:
        return self._replaced({"laws": {**self.laws, **parts}})

    def check_rates(self, rate: float) -> None:
        """Every law must fit the rate [Hz]."""
        for law in self.laws.values():
            law.check_rates(rate)

    def check_states(self, x: Snapshot, rate: float) -> None:
        """Only the first phase starts where the run does."""
        self.laws[self.names[0]].check_states(x, rate)

    def check_references(self, x: Snapshot, ref: Reference, rate: float) -> None:  # noqa: ARG002
        """That of the first phase, as far as it is known; the others are checked where they begin."""
        name, phase = next(iter(self.phases.items()))
        given = phase.reference
        if isinstance(given, Trajectory) or not (callable(given) or isinstance(given, Stream)):
            with blamed(name):
                self.laws[name].check_references(x, as_reference(Hold() if given is None else given), rate)

    def check_begin(self, name: str, x: Snapshot, ref: Reference, rate: float) -> None:
        """RangeError or UsageError for a phase that has no meaning at x, unless refused there without contact."""
        phase = self.phases[name]
        if phase.needs_contact and not condition(phase.in_contact(x), f"contact of phase '{name}'"):
            return
        with blamed(name):
            self.laws[name].check_states(x, rate)
            self.laws[name].check_references(x, ref, rate)

    def initial_memory(self, x: Snapshot, ref: Sample) -> dict[str, Any]:
        """Memory at the first tick: zeros for the laws, which start with their phases and may not be finite at x."""
        counters = sum(isinstance(guard, Lasting) for p in self.phases.values() for guard in (p.unless, p.until))
        out: dict[str, Any] = {"phase": 0.0, "next": 0.0, "ticks": 0.0, "ended": 0.0, "begin": tm.array(x.q)}
        out |= {"energy": 0.0, "seen": tm.array(x.q)}
        out |= {"lasted": np.zeros(counters)} if counters else {}
        for name, law in self.laws.items():
            own = self.sample_of(name, ref)
            out[name] = _zeros(_beside_singular(partial(law.initial_memory, ref=own), x, idle=True))
        return out

    @staticmethod
    def begins(memory: Mapping[str, Any]) -> Any:
        """Whether the coming tick is the first one of its phase."""
        return memory["ticks"] < 0.5

    def command(self, x: Snapshot, ref: Sample, memory: MemoryView, dt: Any) -> tuple[Command, dict[str, Any]]:
        """The command of the law that acts, and the memory of all."""
        fresh, count = memory.ticks < 0.5, len(self.phases)
        here = [_is(memory.next, i, count) for i in range(count + 1)]
        refused = self._refused(x, here, fresh)
        acting = {name: here[i] & ~refused for i, name in enumerate(self.phases)}
        acting[STOP] = here[count] | refused
        commands: dict[str, Command] = {}
        after: dict[str, Any] = {}
        for name, law in self.laws.items():
            own = self.sample_of(name, ref)
            if name == STOP:
                law = law._replaced({"kind": one_kind(commands, "the phases of a task").kind})
            old = memory[name]

            def called(x: Snapshot, law: Law = law, own: Sample = own, old: LawMemory = old) -> tuple[Command, Any]:
                return call(law, x, own, _chosen(fresh, law.initial_memory(x, own), old), dt)

            commands[name], new = _beside_singular(called, x, idle=_known_false(acting[name]))
            after[name] = _chosen(acting[name], new, old)
        command = _selected(commands, acting, x.n)
        return command, {**after, **self._moved_on(x, ref, memory, here, refused, dt, command.kind)}

    def _refused(self, x: Snapshot, here: list[Any], fresh: Any) -> Any:
        """Whether a phase begins that needs contact, and has none."""
        refused: Any = np.bool_(False)
        for i, (name, phase) in enumerate(self.phases.items()):
            if phase.needs_contact:
                touches = _holding(phase.in_contact, x, f"contact of phase '{name}'", idle=_known_false(here[i]))
                refused = refused | (here[i] & fresh & ~touches)
        return refused

    def _moved_on(
        self, x: Snapshot, ref: Sample, memory: MemoryView, here: list[Any], refused: Any, dt: Any, kind: str
    ) -> dict[str, Any]:
        """The memory of which phase acts, after this tick."""
        fresh = memory.ticks < 0.5
        begin = tm.where(fresh, tm.array(x.q), memory.begin)
        where_begun = x.at(begin, np.zeros(x.n))
        following, ended = memory.next, 0.0 * memory.ticks
        counts: list[Any] = []
        account: dict[str, Any] = {}

        def energy() -> Any:
            """Work of the last torque more than in the tick before, without that on the weight."""
            if kind != Torque.kind:
                rule = "x.energy is of torques, and this task gives"
                raise MatchError(
                    f"{rule} {kind} commands; leave its guard out, or use laws of torques", name="energy"
                )
            if not account:
                moved = -x.difference(memory.seen)
                tau = x.tau_applied - x.at(x.q - 0.5 * moved, np.zeros(x.n)).g
                account.update(energy=tm.where(fresh, 0.0, memory.energy + tau @ moved), seen=tm.array(x.q))
            return account["energy"]

        def holds(guard: Guard | None, seen: GuardView, who: str, acts: Any) -> Any:
            """Whether a guard holds; one that has to last counts the ticks."""
            if guard is None:
                return np.bool_(False)
            now = _holding(guard, seen, who, idle=_known_false(acts))
            if not isinstance(guard, Lasting):
                return now
            before = tm.where(fresh, 0.0, memory["lasted"][len(counts)])
            counts.append(tm.where(acts & now, before + 1.0, 0.0))
            return counts[-1] > guard.ticks - 0.5

        for i, (name, phase) in enumerate(self.phases.items()):
            seen = GuardView(
                x,
                elapsed=memory.ticks * dt,
                ref=self.sample_of(name, ref),
                begin=where_begun,
                tool=self.laws[name].controlled_frame,
                energy=energy,
            )
            late = np.bool_(False)
            if phase.timeout is not None:
                late = memory.ticks + 1.0 > phase.timeout / dt - TICK_ROUNDING
            wrong = holds(phase.unless, seen, f"unless of phase '{name}'", here[i])
            done = holds(phase.until, seen, f"until of phase '{name}'", here[i])
            without = refused if phase.needs_contact else np.bool_(False)
            # Where several hold, the later one here decides.
            for code, holding in ((TIMEOUT, late), (UNTIL, done), (UNLESS, wrong), (NO_CONTACT, without)):
                goes = here[i] & holding
                target = self._target(i, phase.then if code == UNTIL else phase.otherwise)
                following = tm.where(goes, float(target), following)
                ended = tm.where(goes, float(code), ended)
        ticks = tm.where(ended > 0.5, 0.0, memory.ticks + 1.0)
        counted = {"lasted": tm.array(counts)} if counts else {}
        return {
            "phase": memory.next,
            "next": following,
            "ticks": ticks,
            "ended": ended,
            "begin": begin,
            **counted,
            **account,
        }

    def _target(self, i: int, target: str | int | None) -> int:
        """The number of the phase that follows."""
        if target is None:
            return i + 1
        return target if isinstance(target, int) else self.names.index(target)

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


@contextmanager
def blamed(name: str) -> Iterator[None]:
    """Name the phase in an error; for errors that are not ours, report that its reference failed, and where."""
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
        raise UsageError(f"phase '{name}': its reference fails: {how}", name="reference") from cause


def _is(number: Any, i: int, last: int) -> Any:
    """Whether a phase has this number; numbers outside belong to the first and the last one."""
    holds: Any = np.bool_(True)
    if i > 0:
        holds = (number > i - 0.5) & holds
    if i < last:
        holds = (number < i + 0.5) & holds
    return holds


def _known_false(which: Any) -> bool:
    """Whether a condition is known not to hold: as plain Python runs it, a law that does not act is idle."""
    return isinstance(which, (bool, np.bool_)) and not which


def _beside_singular(evaluated: Callable[[Snapshot], T], x: Snapshot, *, idle: bool) -> T:
    """The result of a law in a tick, or of a function of it.

    Where a law is singular compiled code gives numbers that are not finite, but plain Python raises: then an idle law
    is evaluated beside that state, for names and shapes only.
    """
    try:
        return evaluated(x)
    except NumericalError:
        if not idle:
            raise
        return evaluated(x.at(x.q + OFFSET_FROM_SINGULAR * np.cos(np.arange(x.n)), x.v))


def _zeros(memory: Any) -> Any:
    """Memory of the same shapes."""
    if isinstance(memory, Mapping):
        return {name: _zeros(value) for name, value in memory.items()}
    return tm.zeros(np.shape(memory))


def _holding(guard: Callable[[Any], Any], x: Snapshot | GuardView, who: str, *, idle: bool) -> Any:
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


def _selected(commands: Mapping[str, Command], acting: Mapping[str, Any], n: int) -> Command:
    """The command of the law that acts, and its terms, zero where it has none of that name."""
    total, rows = commands[STOP].total, rows_of(commands[STOP])
    terms: dict[str, Any] = {}
    for name, command in commands.items():
        if name != STOP:
            total = tm.where(acting[name], command.total, total)
            rows = {row: tm.where(acting[name], x, rows[row]) for row, x in rows_of(command).items()}
        for term, values in command.terms.parts.items():
            terms[term] = tm.where(acting[name], values, terms.get(term, tm.zeros(n)))
    return of_kind(type(commands[STOP]), Terms.known(total, terms), rows)


def _called(guard: Any) -> str:
    """Name of a guard in messages."""
    inner = guard.guard if isinstance(guard, Lasting) else guard
    word = getattr(inner, "__name__", type(inner).__name__)
    word = "its guard" if word == "<lambda>" else word
    return f"{word} for {guard.ticks} ticks" if isinstance(guard, Lasting) else word
