"""References: what a law is asked to follow. The law sees one sample a tick.

A reference is one of four: a hold, a trajectory with `at(t)`, a stream of samples, or a chunk of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np

from taut.base import math as tm
from taut.base.checks import finite_array, finite_scalar, positive_scalar, vector
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import Array, ArrayLike, Float64Array
from taut.maths.snapshot import Snapshot

__all__ = [
    "Chunk",
    "Hold",
    "JointMotion",
    "Reference",
    "Sample",
    "Stream",
    "Trajectory",
    "as_reference",
    "chunk",
    "hold",
    "sample_rows",
    "stream",
]


class Sample(ABC):
    """One sample of a reference, as a law sees it. Final subclasses state their fields."""

    __slots__ = ()

    @classmethod
    @abstractmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        """Shape of each field, for an arm of n joints."""

    @classmethod
    @abstractmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """A sample from values that are known to fit; symbols too."""

    @classmethod
    @abstractmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:
        """The sample that asks to stay as in the snapshot.

        Args:
            x: The arm at the state to stay at.
            tool: The frame that the law controls; None for the arm's tool.
        """


@dataclass(frozen=True, slots=True, init=False, eq=False)
class JointMotion(Sample):
    """Desired joint positions, velocities and accelerations.

    Args:
        q: (n,) positions [rad | m].
        v: (n,) velocities [rad/s | m/s]; zero if left out.
        a: (n,) accelerations [rad/s^2 | m/s^2]; zero if left out.

    Raises:
        ShapeError: The three have different lengths.
        RangeError: An entry is NaN or infinite.

    Example:
        >>> JointMotion(q=[0.1, 0.2]).v.tolist()
        [0.0, 0.0]
    """

    q: Array
    v: Array
    a: Array

    def __init__(self, *, q: ArrayLike, v: ArrayLike | None = None, a: ArrayLike | None = None) -> None:
        q = finite_array("ref.q", q, unit="rad | m")
        if q.ndim != 1:
            raise ShapeError(f"ref.q must be a vector (n,); got shape {q.shape}", name="ref.q")
        n = q.shape[0]
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "v", _zeros(n) if v is None else vector("ref.v", v, n, unit="rad/s | m/s"))
        object.__setattr__(self, "a", _zeros(n) if a is None else vector("ref.a", a, n, unit="rad/s^2 | m/s^2"))

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        return {"q": (n,), "v": (n,), "a": (n,)}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        made = object.__new__(cls)
        for name in ("q", "v", "a"):
            object.__setattr__(made, name, values[name])
        return made

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:  # noqa: ARG003
        zero = np.zeros(x.n)
        return cls.of({"q": tm.array(x.q), "v": zero, "a": zero})

    def __repr__(self) -> str:
        if self.q.dtype == object:
            return "JointMotion(<traced>)"
        return f"JointMotion(q={self.q.tolist()}, v={self.v.tolist()}, a={self.a.tolist()})"


def _zeros(n: int) -> Float64Array:
    zero = np.zeros(n)
    zero.flags.writeable = False
    return zero


# -------------------------------------------------------------------- the four kinds


@runtime_checkable
class Trajectory(Protocol):
    """A function of time. `at` takes one time [s] and gives a sample.

    A trajectory may have `rows(times)` that gives a sample of arrays (k, n) for many times at once; then a
    simulation asks for thousands at a time.
    """

    def at(self, t: float) -> Sample:
        """The sample at time t [s]."""
        ...


@dataclass(frozen=True, kw_only=True)
class Hold:
    """Stay: at the sample, or at the state of the first tick. Never times out."""

    sample: Sample | None = None


@dataclass(frozen=True, kw_only=True)
class Stream:
    """Samples that arrive one by one; in simulation `source(x)` gives the next sample, or chunk, each period."""

    period: float  # [s]
    source: Callable[[Any], Sample | Chunk] | None = None

    def __post_init__(self) -> None:
        positive_scalar("period", self.period, unit="s")
        if self.source is not None and not callable(self.source):
            raise UsageError(f"source must be a function of the snapshot; got {self.source!r}", name="source")


@dataclass(frozen=True, kw_only=True, eq=False)
class Chunk:
    """A few future samples with their times, as a learned policy emits them; linear in between, else at rest.

    Before its first time it rests at its first position, after its last time at its last.
    """

    times: Float64Array  # (k,) [s] from the moment it starts
    samples: tuple[Sample, ...]

    def at(self, t: float) -> Sample:
        """The sample at time t [s]."""
        return type(self.samples[0]).of({name: rows[0] for name, rows in self._blend(np.array([t])).items()})

    def rows(self, times: Float64Array) -> Sample:
        """Samples at many times, as arrays (k, n)."""
        return type(self.samples[0]).of(self._blend(times))

    def _blend(self, times: Float64Array) -> dict[str, Float64Array]:
        """Each field at many times (k, n)."""
        rests = hasattr(self.samples[0], "q")  # a sample of positions has no other fields than rates
        outside = (times < self.times[0]) | (times > self.times[-1])
        values = {}
        for name in type(self.samples[0]).fields(1):
            table = np.stack([getattr(sample, name) for sample in self.samples])
            columns = [np.interp(times, self.times, table[:, i]) for i in range(table.shape[1])]
            values[name] = rows = np.stack(columns, axis=-1)
            if rests and name != "q":
                rows[outside] = 0.0
        return values


Reference: TypeAlias = Sample | Hold | Stream | Chunk | Trajectory


def hold(sample: Sample | None = None) -> Hold:
    """Stay at `sample`; without one, at the state of the first tick. Never times out."""
    if sample is not None and not isinstance(sample, Sample):
        raise UsageError(f"hold takes a sample such as taut.JointMotion(q=...); got {sample!r}", name="sample")
    return Hold(sample=sample)


def stream(*, period: float, source: Callable[[Any], Sample | Chunk] | None = None) -> Stream:
    """Samples that come one a period, from a policy, a planner or a person.

    Args:
        period: Time between samples [s].
        source: In simulation, a function of the snapshot that gives a sample or a chunk.
    """
    return Stream(period=finite_scalar("period", period, unit="s"), source=source)


def chunk(times: ArrayLike, targets: Sequence[Sample] | ArrayLike) -> Chunk:
    """A few future samples with their times.

    Args:
        times: (k,) [s] from the moment the chunk starts, increasing.
        targets: k samples, or joint positions (k, n); velocities then follow from the differences.

    Raises:
        ShapeError: Not as many targets as times.
        RangeError: Times that do not increase.

    Example:
        >>> chunk([0.0, 0.1], [[0.0], [1.0]]).at(0.05).q.tolist()
        [0.5]
    """
    t = finite_array("times", times, unit="s")
    if t.ndim != 1 or not t.size:
        raise ShapeError(f"times must be a vector (k,); got shape {t.shape}", name="times")
    if (np.diff(t) <= 0.0).any():
        k = int(np.argmax(np.diff(t) <= 0.0))
        raise RangeError(
            f"times must increase; times[{k + 1}] = {t[k + 1]:g} follows {t[k]:g}",
            name="times",
            rule="increasing",
        )
    if isinstance(targets, Sequence) and all(isinstance(sample, Sample) for sample in targets):
        samples: tuple[Sample, ...] = tuple(targets)  # type: ignore[arg-type]  # checked in the line above
    else:
        q = finite_array("targets", targets, unit="rad | m")  # type: ignore[arg-type]  # checked inside
        if q.ndim != 2:
            raise ShapeError(f"targets must have shape (k, n); got {q.shape}", name="targets")
        v = np.gradient(q, t, axis=0) if len(t) > 1 and len(q) == len(t) else np.zeros_like(q)
        samples = tuple(JointMotion(q=row, v=speed) for row, speed in zip(q, v, strict=True))
    if len(samples) != len(t):
        raise ShapeError(
            f"targets must have one sample per time; got {len(samples)} for {len(t)} times", name="targets"
        )
    for k, sample in enumerate(samples):
        for name in type(samples[0]).fields(1):
            got, first = (np.shape(getattr(each, name, 0.0)) for each in (sample, samples[0]))
            if got != first:
                raise ShapeError(
                    f"targets must be samples of one kind and size; targets[{k}].{name} has shape {got} and "
                    f"targets[0].{name} {first}",
                    name="targets",
                )
    return Chunk(times=t, samples=samples)


# -------------------------------------------------------------------- reading one


def as_reference(ref: object) -> Reference:
    """What a caller hands in as one of the four kinds.

    Raises:
        UsageError: It is none of them.
    """
    if isinstance(ref, (Sample, Hold, Stream, Chunk)):
        return ref
    if isinstance(ref, Trajectory):
        return ref
    raise UsageError(
        f"a reference is a sample such as taut.JointMotion(q=...), taut.hold(), a trajectory with at(t), "
        f"taut.stream(...) or taut.chunk(...); got {type(ref).__name__}",
        name="ref",
    )


def sample_rows(trajectory: Trajectory, times: Float64Array, kind: type[Sample], n: int) -> dict[str, Float64Array]:
    """A trajectory at many times: each field as an array (k, size), checked.

    Raises:
        UsageError: It gives another kind of sample than the law follows.
        ShapeError: It is for another number of joints.
        RangeError: It gives NaN or infinite numbers; the message names time and field.
    """
    rows = getattr(trajectory, "rows", None)
    if rows is not None:
        sample = rows(times)
        _check_kind(sample, kind)
        table = {name: np.asarray(getattr(sample, name), dtype=np.float64) for name in kind.fields(n)}
    else:
        samples = [trajectory.at(float(t)) for t in times]
        for sample in samples:
            _check_kind(sample, kind)
            for name, shape in kind.fields(n).items():
                _check_shape(name, np.shape(getattr(sample, name)), shape)
        table = {name: np.stack([getattr(s, name) for s in samples]) for name in kind.fields(n)}
    for name, shape in kind.fields(n).items():
        if len(times) == 1 and table[name].ndim == 1:
            table[name] = table[name][np.newaxis]
        _check_shape(name, table[name].shape[1:], shape)
        if len(table[name]) != len(times):
            raise ShapeError(
                f"rows(times) must give one row per time; it gives {len(table[name])} of ref.{name} for {len(times)} "
                "times",
                name=f"ref.{name}",
            )
        bad = ~np.isfinite(table[name])
        if bad.any():
            row, entry = np.argwhere(bad)[0]
            raise RangeError(
                f"ref.{name}[{entry}] must be finite; the reference gives {float(table[name][row, entry])!r} "
                f"at t = {times[row]:g} s",
                name=f"ref.{name}",
                rule="finite",
            )
    return table


def _check_shape(name: str, got: tuple[int, ...], shape: tuple[int, ...]) -> None:
    if got != shape:
        raise ShapeError(f"ref.{name} must have shape {shape}; the reference gives {got}", name=f"ref.{name}")


def _check_kind(sample: object, kind: type[Sample]) -> None:
    if not isinstance(sample, kind):
        raise UsageError(f"the law follows {kind.__name__}; the reference gives {type(sample).__name__}", name="ref")
