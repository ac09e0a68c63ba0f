"""Law: a control law as a pure function of a snapshot, written like the textbook writes it.

The same code runs on floats and is traced for every target.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import numpy as np

from taut.base.errors import ShapeError, UsageError
from taut.base.fields import Declaration, Part
from taut.base.paths import unflatten
from taut.control.command import Command
from taut.control.gains import GainValue, LawMemory, MemoryView, Remembers
from taut.control.trajectories.reference import JointMotion, Reference, Sample
from taut.maths.snapshot import Snapshot

if TYPE_CHECKING:
    from taut.arm.description import Arm
    from taut.control.closed_loop import ApparentImpedance, ClosedLoop
    from taut.control.tasks.task import Task


class Law(Remembers):
    """Base of every control law.

    A law is a frozen, keyword-only dataclass with these parts:

    * fields: gains `kp: Gain = Gain(unit="1/s^2")` (run-time parameters), inner laws `inner: taut.Law`, parts such as
      `integral: Part[Integral]`, or plain values; relations between them are checked in `check(self)`;
    * memory `e_int = Memory(unit="rad s")`, which is no argument of the law;
    * `command(self, x, ref)`, or `command(self, x, ref, memory, dt)` with memory, which returns a Command and,
      with memory, a dict of the new memory by name;
    * `reference`, the kind of sample it follows (by default JointMotion), and `ignores_reference`;
    * `needs_contact`, whether a `taut.Phase` with it never starts without contact (by default False);
    * optionally `closed_loop(self, x)`, its error dynamics as matrices, by which `taut.design` finds its gains;
    * hooks with a default that does nothing: `start`, `check_rate`, `check_state`, `check_reference`, `check_plant`.

    Laws add: `FeedForward() + PID(kp=..., kd=...)`. A law must not inherit from another one: it has it as a field, or
    is a `Wrapper` around it. A law in a field `inner: taut.Law` starts with it, and is called as
    `self.inner.command(x, ref, memory.inner, dt)`; its new memory is returned under its name, {"inner": ...}.
    """

    reference: ClassVar[type[Sample]] = JointMotion
    ignores_reference: ClassVar[bool] = False  # such a law adds to, and is held by, laws of every kind of sample
    needs_contact: ClassVar[bool] = False  # a phase of such a law never starts without contact
    uses_memory: ClassVar[bool] = False
    optional_memory: ClassVar[tuple[str, ...]] = ()  # has a start, but is kept only by what returns it

    def __init_subclass__(cls, *, abstract: bool = False) -> None:
        base = cls.__mro__[1]
        if base is not Law and "command" in vars(base):
            raise UsageError(
                f"law {cls.__name__} inherits from law {base.__name__}; inherit from taut.Law "
                "and hold the other law in a field",
                name=cls.__name__,
            )
        super().__init_subclass__()
        if not abstract:
            cls.uses_memory = _takes_memory(cls)

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise dataclasses.FrozenInstanceError(
            f"cannot assign to field '{name}' of {type(self).__name__}: a law does not change; what it remembers is "
            f"declared as {name} = taut.Memory(0.0), read as memory.{name}, and returned with the command: "
            f"return taut.Torque(...), {{'{name}': ...}}"
        )

    def start(self, x: Snapshot, ref: Any) -> Mapping[str, Any]:  # noqa: ARG002
        """Memory by name that starts from the measured state; called in the first tick."""
        return {}

    def check_state(self, x: Snapshot, rate: float) -> None:
        """Refuse gains that have no meaning where a run starts, or where they change."""

    def check_reference(self, x: Snapshot, ref: Reference, rate: float) -> None:
        """Refuse a reference that cannot be followed from x."""

    def check_plant(self, path: str, arm: Arm, plant: str, parameters: Mapping[str, Any]) -> None:
        """Refuse a plant by its parameters: this law at its path, its controller's arm, the plant's name."""

    @classmethod
    def declaration_of(cls, name: str, annotation: str, default: Any) -> Declaration[Any]:
        """`inner: Law` and `inner: Law | None` hold a law, `kp: Gain` is a gain; anything else is a plain field."""
        kind, _, none = annotation.partition(" | ")
        if kind.rpartition(".")[2] == "Law":
            return Part(Law, default=default, optional=none == "None")
        return super().declaration_of(name, annotation, default)

    def parts_with_memory(self) -> dict[str, Remembers]:
        """Not the laws that it holds, whose memory is their own."""
        return {name: part for name, part in super().parts_with_memory().items() if not isinstance(part, Law)}

    def children(self) -> dict[str, Law]:
        """The laws that this law holds, by field."""
        return {name: part for name, part in self.declared_parts().items() if isinstance(part, Law)}

    def gains(self) -> dict[str, GainValue]:
        """This law's own gains, by field."""
        return {name: value for name, value in vars(self).items() if isinstance(value, GainValue)}

    @property
    def recorded(self) -> tuple[str, ...]:
        """Paths of its memory that a run keeps as further columns."""
        return tuple(path for path, memory in self.every_memory().items() if memory.record)

    @property
    def notices(self) -> tuple[tuple[str, str], ...]:
        """Path of each memory with a notice, and the sentence in a run's outcome where it is not zero."""
        return tuple((path, memory.notice) for path, memory in self.every_memory().items() if memory.notice)

    def seen_by(self, child: str, x: Snapshot, ref: Any) -> tuple[Snapshot, Any]:  # noqa: ARG002
        """Snapshot and reference of a law that this one holds."""
        return x, ref

    def memory_of_children(self, x: Snapshot, ref: Sample) -> dict[str, Any]:
        """Memory at the first tick of the laws that this one holds, by field."""
        return {name: child.initial_memory(*self.seen_by(name, x, ref)) for name, child in self.children().items()}

    def initial_memory(self, x: Snapshot, ref: Sample) -> dict[str, Any]:
        """Memory at the first tick: stated values, that of laws it holds, and what `start` returns."""
        stated = unflatten({path: memory.initial for path, memory in self.every_memory().items()})
        return {**stated, **self.memory_of_children(x, ref), **self.start(x, ref)}

    @property
    def controlled_frame(self) -> str | None:
        """The frame that this law, or a law that it holds, controls; None for the arm's tool."""
        if "tool" in vars(self):  # what it holds beside, such as a law in `null`, may look at another frame
            own: str | None = vars(self)["tool"]
            return own
        followers = [law for law in self.children().values() if not law.ignores_reference]
        return next((frame for law in followers if (frame := law.controlled_frame)), None)

    def closed_loop(self, x: Snapshot) -> ClosedLoop | None:  # noqa: ARG002
        """Error dynamics as matrices, at rest: `taut.design` places their poles. None: `taut.tune` only."""
        return None

    def apparent_impedance(self, x: Snapshot) -> ApparentImpedance | None:  # noqa: ARG002
        """Apparent impedance of the tool at a state, in plain numbers; None for a law that specifies none."""
        return None

    def at_rest(self, x: Snapshot) -> Sample:
        """The sample with which this law keeps the arm where it is in the snapshot."""
        return self.reference.at_rest(x, self.controlled_frame)

    def check_rates(self, rate: float) -> None:
        """This law, its parts and inner laws must fit the rate, with their present gains. Raises RangeError."""
        for part in self.declared_parts().values():
            if isinstance(part, Law):
                part.check_rates(rate)
            elif isinstance(part, Remembers):
                part.check_rate(rate)
        self.check_rate(rate)

    def check_states(self, x: Snapshot, rate: float) -> None:
        """This law and inner laws must fit the state x. Raises RangeError."""
        for name, law in self.children().items():
            law.check_states(self.seen_by(name, x, None)[0], rate)
        self.check_state(x, rate)

    def check_references(self, x: Snapshot, ref: Reference, rate: float) -> None:
        """This law, and inner laws with the same reference, can follow it from x. Raises RangeError, UsageError."""
        for law in self.children().values():
            if issubclass(self.reference, law.reference):
                law.check_references(x, ref, rate)
        self.check_reference(x, ref, rate)

    def __add__(self, other: Law) -> Law:
        from taut.control.combine import added

        if not isinstance(other, Law):
            return NotImplemented
        return added(self, other)


def _takes_memory(cls: type[Law]) -> bool:
    command = cls.__dict__.get("command")
    if command is None:
        raise UsageError(f"law {cls.__name__} has no command(self, x, ref)", name=cls.__name__)
    names = list(inspect.signature(command).parameters)
    if names not in (["self", "x", "ref"], ["self", "x", "ref", "memory", "dt"]):
        raise UsageError(
            f"law {cls.__name__}: command must take (self, x, ref) or (self, x, ref, memory, dt); "
            f"got ({', '.join(names)})",
            name=cls.__name__,
        )
    return len(names) == 5


def call(law: Law | Task, x: Snapshot, ref: Sample, memory: LawMemory, dt: Any) -> tuple[Command, dict[str, Any]]:
    """One evaluation of a law; UsageError if it returns no command, or memory that does not fit."""
    who = type(law).__name__
    run: Callable[..., Any] = law.command  # type: ignore[union-attr]  # each subclass declares its own
    result = run(x, ref, MemoryView(memory, who), dt) if law.uses_memory else run(x, ref)
    result, after = result if isinstance(result, tuple) and len(result) == 2 else (result, {})
    if not isinstance(result, Command) or not isinstance(after, Mapping):
        raise UsageError(
            f"{who}.command must return a taut.Torque, Velocity or Position"
            f"{' and a dict of memory' if law.uses_memory else ''}; got {_described(result, after)}",
            name=who,
        )
    for name in after:
        if name not in memory:
            raise UsageError(
                f"{who}.command returns memory '{name}', which has no start; declare {name}: Memory = "
                "Memory(0.0), or return it from start(self, x, ref)",
                name=name,
            )
    missing = [
        name
        for name, value in memory.items()
        if name not in after and name not in law.optional_memory and not (isinstance(value, Mapping) and not value)
    ]
    if missing:
        raise UsageError(
            f"{who}.command does not return its memory '{missing[0]}'; return {{'{missing[0]}': ...}} "
            "with the command, in every tick",
            name=missing[0],
        )
    for name, term in result.terms.parts.items():
        if np.shape(term) != (x.n,):
            raise ShapeError(
                f"{who}.command must give one entry per joint, shape ({x.n},); its term '{name}' has shape "
                f"{np.shape(term)}",
                name=who,
            )
    return result, dict(after)


def _described(result: Any, after: Any) -> str:
    if isinstance(result, np.ndarray):
        return f"an unnamed array of shape {result.shape}; write taut.Torque(P=...)"
    return type(result).__name__ + (f" and {type(after).__name__}" if after != {} else "")
