"""Samples that hold several samples: of laws side by side, and of the phases of a task."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, ClassVar, Final, NamedTuple, Self

from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.control.trajectories.reference import Hold, JointMotion, Sample, Trajectory
from taut.maths.snapshot import Snapshot

TOGETHER: Final = "Together["  # the names of kinds of samples of laws side by side begin with it


class Part(NamedTuple):
    """One of the samples that a compound sample holds."""

    name: str
    kind: type[Sample]
    joints: int  # 0 where it is for as many joints as the arm has, or its size does not depend on them


class Compound(Sample):
    """Base of samples that hold several, each with a name; the field q of `left` is left_q."""

    __slots__ = ()
    parts: ClassVar[tuple[Part, ...]] = ()

    def __init__(self, samples: Mapping[str, Sample]) -> None:
        for name, kind, joints in self.parts:
            setattr(self, name, samples[name])
            for field in kind.fields(joints):
                setattr(self, f"{name}_{field}", getattr(samples[name], field))

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        return {
            f"{name}_{field}": shape
            for name, kind, joints in cls.parts
            for field, shape in kind.fields(joints or n).items()
        }

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        return cls(
            {
                name: kind.of({field: values[f"{name}_{field}"] for field in kind.fields(joints)})
                for name, kind, joints in cls.parts
            }
        )

    @classmethod
    def between(
        cls, times: Float64Array, knots: Float64Array, rows: Mapping[str, Float64Array]
    ) -> dict[str, Float64Array]:
        out: dict[str, Float64Array] = {}
        for name, kind, joints in cls.parts:
            own = kind.between(times, knots, {field: rows[f"{name}_{field}"] for field in kind.fields(joints)})
            out |= {f"{name}_{field}": values for field, values in own.items()}
        return out

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:  # noqa: ARG003
        raise UsageError("the samples at rest of several laws are theirs: law.at_rest(x)")

    def __repr__(self) -> str:
        head = type(self).__name__.partition("[")[0]
        return f"{head}({', '.join(f'{name}={getattr(self, name)!r}' for name, _, _ in self.parts)})"


def _made(base: type[Compound], name: str, parts: tuple[Part, ...]) -> type[Any]:
    slots = [f"{part.name}_{field}" for part in parts for field in part.kind.fields(part.joints)]
    return type(name, (base,), {"parts": parts, "__slots__": (*(part.name for part in parts), *slots)})


class SampleTogether(Compound):
    """One sample for each of several laws at once; subclasses are made by what they hold."""

    __slots__ = ()

    @classmethod
    def taken(cls, sample: object) -> Self | None:
        """The samples of the same names, each as one of its kind here."""
        if isinstance(sample, cls) or not isinstance(sample, SampleTogether):
            return sample if isinstance(sample, cls) else None
        if [(name, n) for name, _, n in sample.parts] != [(name, n) for name, _, n in cls.parts]:
            return None
        taken = {name: kind.taken(getattr(sample, name)) for name, kind, _ in cls.parts}
        fitting = {name: one for name, one in taken.items() if one is not None}
        return cls(fitting) if len(fitting) == len(taken) else None

    @classmethod
    def described(cls) -> str:
        return f"Together({', '.join(f'{part.name}={part.kind.described()}' for part in cls.parts)})"


def require_part_name(who: str, name: str) -> None:
    """UsageError for a name that cannot be an attribute of a sample."""
    if not name.isidentifier() or hasattr(SampleTogether, name):
        raise UsageError(f"{who}: a law is named by a word such as left, and not by one that samples have: {name!r}")


@cache
def _together_kind(parts: tuple[Part, ...]) -> type[SampleTogether]:
    words = ",".join(f"{name}:{kind.__name__}:{joints}" for name, kind, joints in parts)
    return _made(SampleTogether, f"{TOGETHER}{words}]", parts)


def together_kind(parts: tuple[tuple[str, type[Sample], int], ...]) -> type[SampleTogether]:
    """The kind of sample that laws side by side follow: for each its name, kind and number of joints."""
    for name, _, _ in parts:
        require_part_name("together", name)
    # Parts whose size matters to nobody have none, so that equal ones are one kind.
    return _together_kind(
        tuple(Part(name, kind, n if issubclass(kind, JointMotion) else 0) for name, kind, n in parts)
    )


def joined(samples: Mapping[str, Sample]) -> SampleTogether:
    """One sample of samples by name."""
    sizes = {name: len(one.q) if isinstance(one, JointMotion) else 0 for name, one in samples.items()}
    return together_kind(tuple((name, type(one), sizes[name]) for name, one in samples.items()))(samples)


class Together:
    """Trajectories and samples side by side, as one trajectory."""

    def __init__(self, references: Mapping[str, Sample | Trajectory]) -> None:
        self._references = dict(references)

    def at(self, t: float) -> Sample:
        """The sample at time t [s]."""
        return joined({name: ref if isinstance(ref, Sample) else ref.at(t) for name, ref in self._references.items()})


def together(**references: Sample | Hold | Trajectory) -> Sample | Together:
    """The reference of laws side by side: a sample or a trajectory for each, by the name of the law.

    Returns:
        A sample, where all of them are samples; else a trajectory. Other references are a UsageError.

    Example:
        >>> both = together(left=JointMotion(q=[0.5]), right=JointMotion(q=[0.1, 0.2]))
        >>> both.right.q.tolist()
        [0.1, 0.2]
    """
    taken: dict[str, Sample | Trajectory] = {}
    for name, ref in references.items():
        require_part_name("together", name)
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
    return joined(samples) if len(samples) == len(taken) else Together(taken)


class PhaseSample(Compound):
    """One sample of each kind that the phases of a task follow; subclasses are made by the kinds."""

    __slots__ = ()

    @classmethod
    def described(cls) -> str:
        return " or ".join(part.kind.described() for part in cls.parts)

    @classmethod
    def name_of(cls, kind: type[Sample]) -> str:
        """The name of the part that is of a kind; what its fields begin with."""
        return next(part.name for part in cls.parts if part.kind is kind)


@cache
def phase_sample(kinds: tuple[type[Sample], ...]) -> type[PhaseSample]:
    """The kind of sample that has one of each of these kinds."""
    named: dict[str, type[Sample]] = {}
    for kind in kinds:
        name, k = kind.__name__, 1
        while name in named:
            k += 1
            name = f"{kind.__name__}{k}"
        named[name] = kind
    parts = tuple(Part(name, kind, 0) for name, kind in named.items())
    return _made(PhaseSample, f"PhaseSample[{','.join(kind.__name__ for kind in kinds)}]", parts)
