"""SideBySide: laws that act on disjoint joints, such as those of two arms on a torso, and what they follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, ClassVar, Final, Self

from taut.arm.description import Arm
from taut.base.errors import MatchError, UsageError, unknown_name
from taut.base.types import Array, Float64Array
from taut.control.command import Command, Terms
from taut.control.law import Law, MemoryView, call
from taut.control.trajectories.reference import Hold, JointMotion, Sample, Trajectory
from taut.maths.model import model_of
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["SideBySide", "together"]

TOGETHER: Final = "Together["  # the names of such kinds of samples begin with it
Parts = tuple[tuple[str, type[Sample], int], ...]
"""Name of each part, the kind of its sample, and its number of joints; 0 where the sample does not depend on it."""


class SideBySide(Law):
    """Laws on disjoint joints, side by side: SideBySide(left=law, right=law); the path of a gain is law.left.K.

    Law:          each part gives the command of its own joints, from an arm of these joints alone
    Closed loop:  that of each part, where no joint of one part carries another: arms on a torso that stands

    A law of task space acts on the joints that move its tool, and names it: `Impedance(tool="left_gripper", ...)`. Of
    another law the joints are named: SideBySide(head=(law, ["head_pan"])). Every joint belongs to one part. What it
    follows is `taut.together(left=..., right=...)`.

    Args:
        laws: The laws by name; a law, or a pair of a law and the names of its joints.

    Raises:
        UsageError: No law, something else than a law, a joint law without its joints.
    """

    parts: Mapping[str, Law]
    joints: Mapping[str, tuple[str, ...] | None]

    def children(self) -> dict[str, Law]:
        return dict(self.parts)

    def with_children(self, children: Mapping[str, Law]) -> Self:
        return self._replaced({"parts": dict(children)})

    def check_size(self, joints: Sequence[str] | int, prefix: str = "") -> None:
        """Each part has a size of its own, which is checked where it is known: in the first evaluation."""

    def _places(self, arm: Arm) -> dict[str, list[int]]:
        """Places of each part's joints.

        Raises:
            MatchError: A joint that belongs to no part, or to two.
        """
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

    def seen_by(self, child: str, x: Snapshot, ref: Sample) -> tuple[Snapshot, Sample]:
        return self.seen(x)[child], getattr(ref, child)

    def seen(self, x: Snapshot) -> dict[str, Snapshot]:
        """What each part sees: its own joints, as an arm of their own."""
        names = x.arm.joint_names
        return {
            part: x.of_joints(model_of(_subset(x.arm, tuple(names[i] for i in places))), places)
            for part, places in self._places(x.arm).items()
        }

    def at_rest(self, x: Snapshot) -> Sample:
        seen = self.seen(x)
        return _joined({name: law.at_rest(seen[name]) for name, law in self.parts.items()})

    def check_states(self, x: Snapshot, rate: float, *, changed: bool = False) -> None:
        seen = self.seen(x)
        for name, law in self.parts.items():
            law.check_states(seen[name], rate, changed=changed)

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        places, seen = self._places(x.arm), self.seen(x)
        after: dict[str, Any] = {}
        commands: dict[str, Command] = {}
        for name, law in self.parts.items():
            law.check_size(len(places[name]))
            commands[name], after[name] = call(law, seen[name], getattr(ref, name), memory[name], dt)
        kinds = {type(command) for command in commands.values()}
        if len(kinds) > 1:
            words = ", ".join(f"{name} a {command.kind}" for name, command in commands.items())
            raise MatchError(f"laws side by side give commands of one kind; these give {words}", name="SideBySide")
        total = _spread(commands, places, x.n)
        return kinds.pop()(total), after

    def __repr__(self) -> str:
        return f"SideBySide({', '.join(f'{name}={law!r}' for name, law in self.parts.items())})"


def _made(self: SideBySide, /, **laws: Law | tuple[Law, Sequence[str]]) -> None:
    laws = _by_name(laws)
    if not laws:
        raise UsageError("SideBySide needs laws by name: SideBySide(left=law, right=law)", name="SideBySide")
    parts: dict[str, Law] = {}
    joints: dict[str, tuple[str, ...] | None] = {}
    for name, given in laws.items():
        _require_name("SideBySide", name)
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
    object.__setattr__(self, "reference", _kind(_sized(kinds)))


def _require_name(who: str, name: str) -> None:
    """A name that a sample can have as an attribute, beside those that every sample has."""
    if not name.isidentifier() or hasattr(_AnyTogether, name):
        raise UsageError(f"{who}: a law is named by a word such as left, and not by one that samples have: {name!r}")


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


@cache
def _subset(arm: Arm, joints: tuple[str, ...]) -> Arm:
    return arm.subset(joints)


def _spread(commands: Mapping[str, Command], places: Mapping[str, list[int]], n: int) -> Terms:
    """The named terms of all parts, each with the joints of its own."""
    total, named = tm.zeros(n), dict[str, Array]()
    for part, command in commands.items():
        own = places[part]
        for k, i in enumerate(own):
            total[i] = command.total[k]
        for name, values in command.terms.parts.items():
            row = named.setdefault(name, tm.zeros(n))
            for k, i in enumerate(own):
                row[i] = values[k]
    return Terms.known(total, named)


# -------------------------------------------------------------------- what they follow


class _AnyTogether(Sample):
    """Samples of several laws at once; subclasses are made by what they hold."""

    __slots__ = ()
    parts: ClassVar[Parts] = ()

    def __init__(self, samples: Mapping[str, Sample]) -> None:
        for name, kind, n in self.parts:
            setattr(self, name, samples[name])
            for field in kind.fields(n):
                setattr(self, f"{name}_{field}", getattr(samples[name], field))

    @classmethod
    def described(cls) -> str:
        return f"Together({', '.join(f'{name}={kind.described()}' for name, kind, _ in cls.parts)})"

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:  # noqa: ARG003
        return {
            f"{name}_{field}": shape for name, kind, size in cls.parts for field, shape in kind.fields(size).items()
        }

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        return cls(
            {
                name: kind.of({field: values[f"{name}_{field}"] for field in kind.fields(size)})
                for name, kind, size in cls.parts
            }
        )

    @classmethod
    def between(
        cls, times: Float64Array, knots: Float64Array, rows: Mapping[str, Float64Array]
    ) -> dict[str, Float64Array]:
        out: dict[str, Float64Array] = {}
        for name, kind, size in cls.parts:
            own = kind.between(times, knots, {field: rows[f"{name}_{field}"] for field in kind.fields(size)})
            out |= {f"{name}_{field}": values for field, values in own.items()}
        return out

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:  # noqa: ARG003
        raise UsageError("the sample at rest of laws side by side is theirs: law.at_rest(x)")

    def __repr__(self) -> str:
        return f"together({', '.join(f'{name}={getattr(self, name)!r}' for name, _, _ in self.parts)})"


def _sized(parts: Parts) -> Parts:
    """Parts whose size matters to nobody have none, so that equal ones are one kind."""
    return tuple((name, kind, n if kind is JointMotion else 0) for name, kind, n in parts)


@cache
def _kind(parts: Parts) -> type[_AnyTogether]:
    slots = [f"{name}_{field}" for name, kind, n in parts for field in kind.fields(n)]
    words = ",".join(f"{name}:{kind.__name__}:{n}" for name, kind, n in parts)
    body = {"parts": parts, "__slots__": (*(name for name, _, _ in parts), *slots)}
    return type(f"{TOGETHER}{words}]", (_AnyTogether,), body)


def together_kind(parts: Parts) -> type[Sample]:
    """The kind of sample that laws side by side follow: for each its name, kind and number of joints."""
    for name, _, _ in parts:
        _require_name("together", name)
    return _kind(parts)


def _joined(samples: Mapping[str, Sample]) -> _AnyTogether:
    return _kind(
        tuple((name, type(s), len(s.q) if isinstance(s, JointMotion) else 0) for name, s in samples.items())
    )(samples)


class Together:
    """Trajectories and samples side by side, as one trajectory."""

    def __init__(self, references: Mapping[str, Sample | Trajectory]) -> None:
        self._references = dict(references)

    def at(self, t: float) -> Sample:
        """The sample at time t [s]."""
        return _joined(
            {name: ref if isinstance(ref, Sample) else ref.at(t) for name, ref in self._references.items()}
        )


def together(**references: Sample | Hold | Trajectory) -> Sample | Together:
    """What laws side by side follow: a sample or a trajectory for each, by the name of the law.

    Returns:
        A sample, where all of them are samples; else a trajectory.

    Raises:
        UsageError: A reference that is neither.

    Example:
        >>> both = together(left=JointMotion(q=[0.5]), right=JointMotion(q=[0.1, 0.2]))
        >>> both.right.q.tolist()
        [0.1, 0.2]
    """
    taken: dict[str, Sample | Trajectory] = {}
    for name, ref in references.items():
        _require_name("together", name)
        given = ref.sample if isinstance(ref, Hold) else ref
        if not isinstance(given, (Sample, Trajectory)):
            raise UsageError(
                f"together: {name} must be a sample or a trajectory; got {type(ref).__name__}"
                + ("; a hold needs its sample here" if isinstance(ref, Hold) else ""),
                name=name,
            )
        taken[name] = given
    if not taken:
        raise UsageError("together needs references by the names of laws: together(left=..., right=...)")
    samples = {name: ref for name, ref in taken.items() if isinstance(ref, Sample)}
    return _joined(samples) if len(samples) == len(taken) else Together(taken)
