"""SideBySide: laws that act on disjoint joints, such as those of two arms on a torso."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any, Self

from taut.arm.description import Arm
from taut.base.errors import MatchError, UsageError, unknown_name
from taut.base.fields import Declared
from taut.base.types import Vector
from taut.control.command import Command
from taut.control.gains import MemoryView
from taut.control.law import Law, call
from taut.control.trajectories.compound import joined, require_part_name, together_kind
from taut.control.trajectories.reference import Sample
from taut.maths.model import Model, model_of
from taut.maths.snapshot import AT_TOOL, Snapshot
from taut.trace import math as tm


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
        kind, *others = {type(command) for command in commands.values()}
        if others:
            words = ", ".join(f"{name} a {command.kind}" for name, command in commands.items())
            raise MatchError(f"laws side by side give commands of one kind; these give {words}", name="SideBySide")
        whole = [c.terms.mapped(partial(_spread, places=places[name], n=x.n)) for name, c in commands.items()]
        return kind(sum(whole[1:], start=whole[0])), after

    def __repr__(self) -> str:
        return f"SideBySide({', '.join(f'{name}={law!r}' for name, law in self.parts.items())})"


def _made(self: SideBySide, /, **laws: Law | tuple[Law, Sequence[str]]) -> None:
    laws = _by_name(laws)
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
                f"{type(law).__name__} without tool= does not say them",
                name=name,
            )
        parts[name], joints[name] = law, None if own is None else tuple(own)
    self.__dict__.update(parts=parts, joints=joints)
    kinds = tuple((name, law.reference, len(joints[name] or ())) for name, law in parts.items())
    object.__setattr__(self, "reference", together_kind(kinds))


def _by_name(given: Mapping[str, Any]) -> dict[str, Any]:
    """Laws by name, also where dataclasses.replace gives those of another one as its fields."""
    parts, joints = given.get("parts"), given.get("joints")
    if not isinstance(parts, Mapping) or not isinstance(joints, Mapping):
        return dict(given)
    kept = {name: law if joints[name] is None else (law, joints[name]) for name, law in parts.items()}
    return kept | {name: law for name, law in given.items() if name not in ("parts", "joints")}


SideBySide.__init__ = _made  # type: ignore[assignment, method-assign]


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
