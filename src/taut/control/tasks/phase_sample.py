"""Samples of tasks whose phases follow different kinds of reference: one sample of each kind."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, ClassVar, Self

from taut.base.errors import UsageError
from taut.control.law import Law
from taut.control.trajectories.reference import Sample
from taut.maths.snapshot import Snapshot

__all__ = ["PhaseSample", "phase_sample"]


class PhaseSample(Sample):
    """One sample of each kind that the phases of a task follow; subclasses are made by the kinds."""

    __slots__ = ()
    kinds: ClassVar[Mapping[str, type[Sample]]] = {}

    def __init__(self, samples: Mapping[str, Sample], n: int) -> None:
        for name, kind in self.kinds.items():
            setattr(self, name, samples[name])
            for field in kind.fields(n):
                setattr(self, f"{name}_{field}", getattr(samples[name], field))

    @classmethod
    def described(cls) -> str:
        return " or ".join(kind.described() for kind in cls.kinds.values())

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        return {
            f"{name}_{field}": shape for name, kind in cls.kinds.items() for field, shape in kind.fields(n).items()
        }

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        samples = {
            name: kind.of({field: values[f"{name}_{field}"] for field in kind.fields(1)})
            for name, kind in cls.kinds.items()
        }
        return cls(samples, 1)  # the names of fields do not depend on the number of joints

    @classmethod
    def joined(cls, samples: Mapping[type[Sample], Sample]) -> Self:
        """A sample of one sample of each kind."""
        return cls({name: samples[kind] for name, kind in cls.kinds.items()}, 1)

    @classmethod
    def name_of(cls, kind: type[Sample]) -> str:
        """What the fields of a kind begin with."""
        return next(name for name, own in cls.kinds.items() if own is kind)

    def of_kind(self, law: Law) -> Sample:
        """The sample that a law follows."""
        if law.reference not in self.kinds.values():  # a law that ignores it
            return self
        own: Sample = getattr(self, self.name_of(law.reference))
        return own

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:  # noqa: ARG003
        raise UsageError("the sample at rest of a task is that of its laws: law.at_rest(x)")

    def __repr__(self) -> str:
        return f"PhaseSample({', '.join(f'{name}={getattr(self, name)!r}' for name in self.kinds)})"


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
    slots = [f"{name}_{field}" for name, kind in named.items() for field in kind.fields(1)]
    return type(
        f"PhaseSample[{','.join(kind.__name__ for kind in kinds)}]",
        (PhaseSample,),
        {"kinds": named, "__slots__": (*named, *slots)},
    )
