"""Laws that hold laws: sums."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from taut.base.errors import MatchError, UsageError
from taut.control.command import Command
from taut.control.law import Law, MemoryView, call
from taut.control.trajectories.reference import Sample
from taut.maths.snapshot import Snapshot

__all__ = ["Sum", "added"]

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

    def __post_init__(self) -> None:
        followers = [law for law in self.parts.values() if not law.ignores_reference]
        first = next(iter(followers or self.parts.values()))
        object.__setattr__(self, "reference", first.reference)
        object.__setattr__(self, "ignores_reference", not followers)

    def children(self) -> dict[str, Law]:
        return dict(self.parts)

    def with_children(self, children: Mapping[str, Law]) -> Law:
        return self._replaced({"parts": dict(children)})

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
    """The sum of two laws; sums are flattened.

    Raises:
        UsageError: The two follow different kinds of reference.
    """
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
