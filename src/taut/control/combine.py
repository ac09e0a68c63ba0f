"""Laws that hold laws: sums, laws side by side, and wrappers around one law."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from types import ModuleType
from typing import TYPE_CHECKING, Any, Self

from taut.arm.description import Arm
from taut.base.errors import MatchError, UsageError, unknown_name
from taut.base.fields import Declared, Part
from taut.base.types import Vector
from taut.control.command import Command, MitCommand, Terms, Torque, of_kind, one_kind, rows_of
from taut.control.gains import MemoryView
from taut.control.law import Law, call
from taut.control.trajectories.compound import joined, require_part_name, together_kind
from taut.control.trajectories.reference import Reference, Sample
from taut.maths.model import Model, model_of
from taut.maths.snapshot import AT_TOOL, Snapshot
from taut.trace import math as tm

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
        kinds = [law.reference for law in followers or self.parts.values()]
        narrowest = max(kinds, key=lambda kind: len(kind.__mro__))  # the one that the others are bases of
        self.__dict__.update(reference=narrowest, ignores_reference=not followers)

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
        commands: dict[str, Command] = {}
        owner: dict[str, str] = {}
        for name, law in self.parts.items():
            own = x.with_own_record()
            commands[name], after[name] = call(law, own, ref, memory[name], dt)
            for what in (each for each in ADDED_ONCE if each in own.used):
                if what in owner:
                    raise MatchError(
                        f"{owner[what]} + {name}: both compensate {what}, so it would be added twice; "
                        f"{ADDED_ONCE[what]}",
                        name=name,
                        rule="added once",
                    )
                owner[what] = name
            x.used.update(own.used)
        first, *others = (command.terms for command in commands.values())
        who = f"the laws of {' + '.join(self.parts)}"
        kind = one_kind(commands, who)
        if kind is MitCommand:
            raise MatchError(f"{who} each give a MitCommand; wrap their sum: ViaMit(law=law + law)", name="law")
        return kind(sum(others, start=first)), after

    def __repr__(self) -> str:
        return " + ".join(repr(law) for law in self.parts.values())


class SideBySide(Law):
    """Laws on disjoint joints, side by side: SideBySide(left=law, right=law); the path of a gain is law.left.K.

    Law:          each part gives the command of its own joints, from an arm of these joints alone
    Closed loop:  that of each part, where no joint of one part carries another: arms on a torso that stands

    A law of task space acts on the joints that move its tool, and names it: `Impedance(tool="left_gripper", ...)`.
    For another law the joints are named: SideBySide(head=(law, ["head_pan"])). Every joint belongs to one part. Its
    reference is `taut.together(left=..., right=...)`.

    Args:
        laws: The laws by name; a law, or a pair of a law and the names of its joints.

    Raises:
        UsageError: No law, something else than a law, a joint law without its joints.
    """

    parts: Mapping[str, Law]
    joints: Mapping[str, tuple[str, ...] | None]

    def __init__(self, /, **laws: Law | tuple[Law, Sequence[str]]) -> None:
        if not laws:
            raise UsageError("SideBySide needs laws by name: SideBySide(left=law, right=law)", name="SideBySide")
        parts: dict[str, Law] = {}
        joints: dict[str, tuple[str, ...] | None] = {}
        for name, given in laws.items():
            require_part_name("SideBySide", name)
            law, own = given if isinstance(given, tuple) else (given, None)
            if not isinstance(law, Law):
                raise UsageError(
                    f"SideBySide: {name} must be a law, or (law, names of its joints); got {type(law).__name__}",
                    name=name,
                )
            if own is None and law.controlled_frame is None:
                raise UsageError(
                    f"SideBySide: {name} must name its joints, as in {name}=(law, ['joint_1', ...]): "
                    f"{type(law).__name__} without tool= does not name them",
                    name=name,
                )
            parts[name], joints[name] = law, None if own is None else tuple(own)
        kinds = tuple((name, law.reference, len(joints[name] or ())) for name, law in parts.items())
        self.__dict__.update(parts=parts, joints=joints, reference=together_kind(kinds))

    def declared_parts(self) -> dict[str, Declared]:
        return dict(self.parts)

    def _with_parts(self, parts: Mapping[str, Any]) -> Self:
        return self._replaced({"parts": {**self.parts, **parts}})

    def check_size(self, joints: Sequence[str] | int, prefix: str = "") -> None:
        """Each part has a size of its own, which is checked where it is known: in the first evaluation."""

    def _places(self, arm: Arm) -> dict[str, list[int]]:
        """Indices of each part's joints; MatchError for a joint of no part, or of two."""
        owner: dict[int, str] = {}
        out = {}
        for name, law in self.parts.items():
            places = _places_of(law, self.joints[name], arm)
            for i in places:
                if i in owner:
                    raise MatchError(
                        f"joint '{arm.joint_names[i]}' of '{arm.name}' belongs to {owner[i]} and to {name}; laws "
                        "side by side act on joints of their own; lock what carries both with arm.subset",
                        name=name,
                    )
                owner[i] = name
            out[name] = places
        free = [arm.joint_names[i] for i in range(arm.n) if i not in owner]
        if free:
            raise MatchError(
                f"joint '{free[0]}' of '{arm.name}' belongs to no law; give it one, as in "
                f"SideBySide(..., other=(law, {free})), or lock it with arm.subset",
                name=free[0],
            )
        return out

    def seen_by(self, child: str, x: Snapshot, ref: Any) -> tuple[Snapshot, Any]:
        return self.seen(x)[child], getattr(ref, child, None)

    def seen(self, x: Snapshot) -> dict[str, Snapshot]:
        """What each part sees: its own joints, as an arm of their own."""
        names = x.arm.joint_names
        return {
            part: _of_joints(x, model_of(_subset(x.arm, tuple(names[i] for i in places))), places)
            for part, places in self._places(x.arm).items()
        }

    def at_rest(self, x: Snapshot) -> Sample:
        seen = self.seen(x)
        return joined({name: law.at_rest(seen[name]) for name, law in self.parts.items()})

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        places, seen = self._places(x.arm), self.seen(x)
        after: dict[str, Any] = {}
        commands: dict[str, Command] = {}
        for name, law in self.parts.items():
            law.check_size(len(places[name]))
            commands[name], after[name] = call(law, seen[name], getattr(ref, name), memory[name], dt)
        spread = {name: partial(_spread, places=places[name], n=x.n) for name in commands}
        whole = [c.terms.mapped(spread[name]) for name, c in commands.items()]
        rows: dict[str, Any] = {}
        for name, command in commands.items():
            rows |= {row: rows.get(row, 0.0) + spread[name](values) for row, values in rows_of(command).items()}
        return of_kind(one_kind(commands, "laws side by side"), sum(whole[1:], start=whole[0]), rows), after

    def __repr__(self) -> str:
        own = {
            name: law if self.joints[name] is None else (law, self.joints[name]) for name, law in self.parts.items()
        }
        return f"SideBySide({', '.join(f'{name}={part!r}' for name, part in own.items())})"


def _places_of(law: Law, joints: tuple[str, ...] | None, arm: Arm) -> list[int]:
    if joints is None:
        body = model_of(arm).placement(law.controlled_frame)[0]
        return [] if body < 0 else sorted(arm.ancestors(body))
    for joint in joints:
        if joint not in arm.joint_names:
            raise unknown_name(f"arm '{arm.name}'", "joint", joint, arm.joint_names)
    return [i for i, joint in enumerate(arm.joint_names) if joint in joints]


def _of_joints(x: Snapshot, model: Model, places: Sequence[int]) -> Snapshot:
    """The snapshot of an arm, of that model, in which only the joints at `places` move."""
    rows = {
        name: values if name in AT_TOOL else tm.array([values[i] for i in places])
        for name, values in x.measured.items()
    }
    return x.of_model(model, rows, elsewhere=x.elsewhere)


@cache
def _subset(arm: Arm, joints: tuple[str, ...]) -> Arm:
    return arm.subset(joints)


def _spread(values: Vector, *, places: Sequence[int], n: int) -> Vector:
    """(n,) what stands in the places of some joints, and zero elsewhere."""
    out = tm.zeros(n)
    for k, i in enumerate(places):
        out[i] = values[k]
    return out


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

    def inner_torque(self, x: Snapshot, ref: Any, memory: MemoryView, dt: Any) -> tuple[Terms, dict[str, Any]]:
        """The terms of the torque of the law that is wrapped, and its new memory; UsageError for another command."""
        command, after = self.inner(self.law, x, ref, memory, dt)
        if not isinstance(command, Torque):
            self.refuse("law", f"must give a torque, and {type(self.law).__name__} gives a {command.kind}")
        return command.terms, after

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


def added(first: Law, second: Law) -> Sum:
    """The sum of two laws, flattened; UsageError if they follow different kinds of reference."""
    follows = second.reference if first.ignores_reference else first.reference
    related = issubclass(second.reference, follows) or issubclass(follows, second.reference)
    if not second.ignores_reference and not related:
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
