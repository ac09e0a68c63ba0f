"""Laws that hold laws: sums, and wrappers around one law."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any, Self

from taut.base.errors import MatchError, UsageError
from taut.base.fields import Declared, Part
from taut.control.command import Command
from taut.control.gains import MemoryView
from taut.control.law import Law, call
from taut.control.trajectories.reference import Reference, Sample
from taut.maths.snapshot import Snapshot

if TYPE_CHECKING:
    from taut.control.closed_loop import ApparentImpedance, ClosedLoop
    from taut.control.tasks.task import Task

ADDED_ONCE = {
    "gravity": "use one law that does not (PID instead of GravityPID or ComputedTorque)",
    "coriolis": "use one law that does not (PID or GravityPID instead of ComputedTorque)",
    "friction": "leave one of the two out",
}
"""What two laws may not both compensate, and how to fix it."""


class Sum(Law):
    """The sum of laws, made by `law + law`. Its parts keep their class names: the path of a gain is law.PID.kp.

    Law:          tau = tau_1 + tau_2 + ...; terms of equal names add
    Closed loop:  that of the parts together

    Two parts that both compensate gravity (or Coriolis torques, or friction) are refused.
    """

    parts: Mapping[str, Law]

    def check(self) -> None:
        followers = [law for law in self.parts.values() if not law.ignores_reference]
        first = next(iter(followers or self.parts.values()))
        self.__dict__.update(reference=first.reference, ignores_reference=not followers)

    def declared_parts(self) -> dict[str, Declared]:
        return dict(self.parts)

    def _with_parts(self, parts: Mapping[str, Any]) -> Self:
        return self._replaced({"parts": {**self.parts, **parts}})

    def closed_loop(self, x: Snapshot) -> ClosedLoop | None:
        """That of the one part that states one; None where several do."""
        stated = {name: loop for name, law in self.parts.items() if (loop := law.closed_loop(x)) is not None}
        if len(stated) != 1:
            return None
        ((name, loop),) = stated.items()
        return loop.held_by(lambda law, _: self._with_parts({name: law}))

    def command(self, x: Snapshot, ref: Sample, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        after: dict[str, Any] = {}
        total: Command | None = None
        owner: dict[str, str] = {}
        for name, law in self.parts.items():
            own = x.with_own_record()
            command, after[name] = call(law, own, ref, memory[name], dt)
            _check_added_once(owner, name, own.used)
            x.used.update(own.used)
            if total is None:
                total = command
            elif type(command) is type(total):
                total = type(total)(total.terms + command.terms)
            else:
                raise MatchError(
                    f"{' + '.join(self.parts)}: {name} gives a {command.kind} and the others a {total.kind}; "
                    "only commands of one kind add"
                )
        assert total is not None
        return total, after

    def __repr__(self) -> str:
        return " + ".join(repr(law) for law in self.parts.values())


class Wrapper(Law, abstract=True):
    """Base of a law around a law, which it calls with `self.inner(...)`. Paths of gains and memory are those of both.

    `EnergyTank(law=Impedance(K=..., B=...), capacity=2.0)` has the parameters law.K, law.B and law.capacity, and the
    columns of both. References and needs are those of its law. A wrapper states its own gains, memory and `command`,
    and in `check` what it needs of its law.
    """

    law: Part[Law] = Part(Law, inline=True)

    def check(self) -> None:
        law = self.law
        self.__dict__.update(
            reference=law.reference, ignores_reference=law.ignores_reference, needs_contact=law.needs_contact
        )

    def inner(self, law: Law, x: Snapshot, ref: Any, memory: MemoryView, dt: Any) -> tuple[Command, dict[str, Any]]:
        """The command of the law that is wrapped, or of a changed copy of it, and its new memory."""
        return call(law, x, ref, {name: memory[name] for name in memory if name not in self.memories}, dt)

    @property
    def controlled_frame(self) -> str | None:
        return self.law.controlled_frame

    def closed_loop(self, x: Snapshot) -> ClosedLoop | None:
        """That of the law that is wrapped."""
        inner = self.law.closed_loop(x)
        return inner and inner.held_by(lambda law, _: self._replaced({"law": law}))

    def apparent_impedance(self, x: Snapshot) -> ApparentImpedance | None:
        return self.law.apparent_impedance(x)

    def children(self) -> dict[str, Law]:
        return self.law.children()

    def seen_by(self, child: str, x: Snapshot, ref: Any) -> tuple[Snapshot, Any]:
        return self.law.seen_by(child, x, ref)

    def at_rest(self, x: Snapshot) -> Sample:
        return self.law.at_rest(x)

    def memory_of_children(self, x: Snapshot, ref: Sample) -> dict[str, Any]:
        return self.law.initial_memory(x, ref)

    def check_states(self, x: Snapshot, rate: float) -> None:
        self.law.check_states(x, rate)
        self.check_state(x, rate)

    def check_references(self, x: Snapshot, ref: Reference, rate: float) -> None:
        self.law.check_references(x, ref, rate)
        self.check_reference(x, ref, rate)


def bare(law: Law) -> Law:
    """The law within all wrappers."""
    return bare(law.law) if isinstance(law, Wrapper) else law


def _check_added_once(owner: dict[str, str], name: str, used: set[str]) -> None:
    for what in ADDED_ONCE:
        if what not in used:
            continue
        if what in owner:
            raise MatchError(
                f"{owner[what]} + {name}: both compensate {what}, so it would be added twice; {ADDED_ONCE[what]}",
                name=name,
                rule="added once",
            )
        owner[what] = name


def added(first: Law, second: Law) -> Sum:
    """The sum of two laws, flattened; UsageError if they follow different kinds of reference."""
    follows = second.reference if first.ignores_reference else first.reference
    if not second.ignores_reference and second.reference is not follows:
        raise UsageError(
            f"{type(first).__name__} follows {first.reference.__name__} and {type(second).__name__} "
            f"{second.reference.__name__}; only laws that follow the same kind of reference add; "
            f"taut.via_joint_space(law) makes one of joint motion follow a TaskMotion"
        )
    parts: dict[str, Law] = {}
    for law in (first, second):
        for name, part in law.parts.items() if isinstance(law, Sum) else [(type(law).__name__, law)]:
            k, unique = 1, name
            while unique in parts:
                k += 1
                unique = f"{name}{k}"
            parts[unique] = part
    return Sum(parts=parts)


def law_classes(door: ModuleType) -> dict[str, type[Law]]:
    """The classes of laws among the public names of a module, by name; not the base of wrappers."""
    values = {name: getattr(door, name) for name in door.__all__}
    return {
        name: value
        for name, value in values.items()
        if isinstance(value, type) and issubclass(value, Law) and value is not Wrapper
    }


def all_laws(law: Law | Task, name: str = "") -> Iterator[tuple[str, Law]]:
    """A law and the laws that it holds, each with its path; of a task, those of its phases."""
    if isinstance(law, Law):
        yield name, law
    if isinstance(law, Wrapper):
        yield from all_laws(law.law, name)
        return
    for child, inner in law.children().items():
        yield from all_laws(inner, f"{name}.{child}" if name else child)


def title(law: Law | Task) -> str:
    """A law's name; of a sum, the names of its parts, and of a task those of its phases."""
    if not isinstance(law, Law):
        return law.title
    return " + ".join(law.children()) if isinstance(law, Sum) else type(law).__name__
