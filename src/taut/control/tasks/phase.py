"""Phase: one step of a task: a law, what it follows, and when it ends."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeAlias, runtime_checkable

from taut.base.checks import positive_scalar
from taut.base.errors import UsageError, unknown_name
from taut.control.combine import all_laws
from taut.control.law import Law
from taut.control.tasks.guards import Guard, Lasting, contact
from taut.control.trajectories.reference import Reference, as_reference
from taut.maths.snapshot import Snapshot

__all__ = ["STOP", "Phase", "PhaseReference", "named_phases"]

STOP: Final = "stop"
CONTACT: Final = 1.0  # [N] a force that counts as contact, for laws that never start without
OWN_WORDS: Final = (STOP, "phase", "next", "ticks", "ended", "begin", "lasted")  # of the memory of a task
PhaseReference: TypeAlias = Reference | Callable[[Snapshot], Reference] | None


@runtime_checkable
class KnowsContact(Protocol):
    """A law that knows where contact is."""

    def touches(self, x: Snapshot) -> Any:
        """Whether the arm is in contact, as a condition."""
        ...


@dataclass(frozen=True, eq=False)
class Phase:
    """One phase of a task: a law, what it follows, and when it ends. A task is a list of them.

    A law starts in the tick in which its phase begins, with its integrators at zero and whatever else it remembers;
    a phase that is entered again starts afresh. Guards are looked at in each tick, on what is measured then; what
    they decide acts from the next tick on. Where several hold, `unless` comes before `until`, and both before
    `timeout`.

    A guard is a function of the snapshot that gives one condition: `lambda x: taut.guards.contact(x, 2.0)`. Besides
    what
    a law sees it may ask for `x.elapsed`, the time in the phase [s], `x.ref`, the sample that its law follows, and
    `x.begin`, the arm where the phase began. It is traced like a law: combine conditions with & | ~.

    A law that controls forces never starts without contact: where there is none when its phase begins, the arm is
    held for that tick and the task goes on as `otherwise` says.

    Args:
        law: What controls the arm.
        reference: A sample, hold, trajectory, stream or chunk, whose time counts from the begin of the phase; or a
            function of the snapshot at its begin that gives one of these: `lambda x:
            taut.trajectories.Line(T0=x.T(), ...)`. A
            hold of the state at the begin if left out.
        until: Guard that ends the phase well.
        unless: Guard that says that something is wrong.
        timeout: Longest time in the phase [s].
        otherwise: Where `unless` and `timeout` lead: "stop", or the name or number of a phase.
        then: Where `until` leads: the next phase, and from the last one "stop", if left out.
        name: What it is called, as in the path of a gain: law.approach.kp; phase1, phase2, ... if left out.
        contact: Threshold of contact for a law that needs it: a force [N], or a guard; 1.0 N if left out, and for
            a law that knows its surface, such as HybridMotionForce, to be on it.

    Raises:
        UsageError: Not a law, a reference that is none, a guard that is no function.
        RangeError: A timeout or a force that is not above zero.

    Example:
        >>> import taut
        >>> law = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)
        >>> down = lambda x: taut.trajectories.Steady(T0=x.T(), velocity=[0.0, 0.0, -0.02])
        >>> Phase(law, down, name="approach", until=lambda x: taut.guards.contact(x, 2.0), timeout=5.0).name
        'approach'
    """

    law: Law
    reference: PhaseReference = None
    until: Guard | None = None
    unless: Guard | None = None
    timeout: float | None = None  # [s]
    otherwise: str | int = STOP
    then: str | int | None = None
    name: str | None = None
    contact: float | Guard | None = None  # [N]

    def __post_init__(self) -> None:
        if not isinstance(self.law, Law):
            raise UsageError(f"a phase takes a law such as taut.laws.PID(kp=...); got {self.law!r}", name="law")
        word = self.name is None or (isinstance(self.name, str) and self.name.isidentifier())
        if not word or self.name in OWN_WORDS:
            raise UsageError(
                f"the name of a phase must be a word of letters, digits and _, as it stands in the paths of gains, "
                f"and none of {', '.join(OWN_WORDS)}; got {self.name!r}",
                name="name",
            )
        for guard in ("until", "unless"):
            value = getattr(self, guard)
            if value is not None and not callable(value):
                raise UsageError(
                    f"{guard} must be a function of the snapshot, such as lambda x: taut.guards.contact(x, 2.0); got "
                    f"{value!r}",
                    name=guard,
                )
        if self.timeout is not None:
            object.__setattr__(self, "timeout", positive_scalar("timeout", self.timeout, unit="s"))
        if isinstance(self.contact, Lasting):
            raise UsageError("contact is looked at once; give the guard that lasting(...) holds", name="contact")
        if self.contact is not None and not callable(self.contact):
            positive_scalar("contact", self.contact, unit="N")
        if self.reference is not None and not callable(self.reference):
            as_reference(self.reference)

    @property
    def needs_contact(self) -> bool:
        """Whether its law, or one that it holds, never starts without contact."""
        return any(law.needs_contact for _, law in all_laws(self.law))

    def in_contact(self, x: Snapshot) -> Any:
        """Whether there is contact, as a condition."""
        if callable(self.contact):
            return self.contact(x)
        holds: list[Any] = [law.touches(x) for _, law in all_laws(self.law) if isinstance(law, KnowsContact)]
        force = self.contact if self.contact is not None else None if holds else CONTACT
        if force is not None:
            holds.append(contact(x, force))
        return functools.reduce(lambda a, b: a & b, holds)


def named_phases(task: Sequence[Phase]) -> dict[str, Phase]:
    """The phases of a task by name.

    Raises:
        UsageError: No phase, something else than a phase, two of one name.
        UnknownNameError: `otherwise` or `then` is a phase that is not there.
    """
    if not task:
        raise UsageError("a task needs one phase at least; got an empty list", name="task")
    named: dict[str, Phase] = {}
    for i, phase in enumerate(task):
        if not isinstance(phase, Phase):
            raise UsageError(f"a task is a list of taut.Phase; entry {i} is a {type(phase).__name__}", name="task")
        name = phase.name or f"phase{i + 1}"
        if name in named:
            raise UsageError(f"two phases of a task are called '{name}'; give one another name=", name="name")
        named[name] = phase
    for name, phase in named.items():
        for word, target in (("otherwise", phase.otherwise), ("then", phase.then)):
            known = (STOP, *named, *range(len(named)), *((None,) if word == "then" else ()))
            if isinstance(target, bool) or target not in known:
                raise unknown_name(f"phase '{name}': {word}: the task", "phase", str(target), [*named, STOP])
    return named
