"""References: a hold, a trajectory with `at(t)`, a stream or a chunk of samples; a law sees one sample a tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np

from taut.base.checks import entry_names, finite_array, instance_of, vector
from taut.base.errors import RangeError, ShapeError, UsageError, unknown_name
from taut.base.fields import Declared, Field, Part, Plain
from taut.base.types import Array, ArrayLike, Float64Array
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm
from taut.trace.pose import ROTATION_TOLERANCE, Pose

Shapes: TypeAlias = Mapping[str, tuple[int | str, ...]]
Rows: TypeAlias = Mapping[str, Float64Array]
"""The fields of samples by name, each with one row per time, (k, ...)."""


class Sample(ABC):
    """One sample of a reference, as a law sees it. Final subclasses state their fields."""

    __slots__ = ()
    _shapes: ClassVar[Shapes] = {}
    """Shape of each field by name; "n" stands for the number of joints."""

    if not TYPE_CHECKING:  # type checkers know the fields

        def __getattr__(self, name: str) -> Any:
            cls = type(self)
            if name.startswith("_"):  # of Python's own protocols
                raise AttributeError(name)
            known = [word for word in dir(cls) if not word.startswith("_") and not callable(getattr(cls, word))]
            raise AttributeError(str(unknown_name(f"a {cls.__name__}", "field", name, known)), name=name, obj=None)

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        """Shape of each field, for an arm of n joints."""
        return {name: tuple(n if k == "n" else int(k) for k in shape) for name, shape in cls._shapes.items()}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """A sample from values that are known to fit; symbols too."""
        made = object.__new__(cls)
        for name in cls._shapes:
            object.__setattr__(made, name, values[name])
        return made

    @classmethod
    def taken(cls, sample: object) -> Self | None:
        """The sample as one of this kind; None where it is none."""
        return sample if isinstance(sample, cls) else None

    def stated(self) -> dict[str, Any]:
        """What it holds, by field."""
        return {name: getattr(self, name) for name in self.fields(1)}

    @property
    def motion(self) -> Sample:
        """The motion that it asks for; of a sample that asks for forces too, without them."""
        return self

    @classmethod
    def described(cls) -> str:
        """Its kind, for messages."""
        return cls.__name__

    @classmethod
    def between(cls, times: Float64Array, knots: Float64Array, rows: Rows) -> dict[str, Float64Array]:
        """Each field (k, ...) at times (k,) [s], from rows (m, ...) at knots (m,) [s]: linear by default."""
        return {name: _interpolated(times, knots, table) for name, table in rows.items()}

    @classmethod
    @abstractmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:
        """The sample that keeps the arm where it is in the snapshot; `tool` is the frame that the law controls."""


@dataclass(frozen=True, slots=True, init=False, eq=False)
class JointMotion(Sample):
    """Desired joint positions, velocities and accelerations.

    Args:
        q: (n,) positions [rad | m].
        v: (n,) velocities [rad/s | m/s]; zero if left out.
        a: (n,) accelerations [rad/s^2 | m/s^2]; zero if left out.
        j: (n,) jerks [rad/s^3 | m/s^3], for laws that follow a `SmoothMotion`; unknown if left out.
        s: (n,) snaps, their rates [rad/s^4 | m/s^4]; likewise.

    Raises:
        ShapeError, RangeError: Different lengths; NaN or infinite entries.

    Example:
        >>> JointMotion(q=[0.1, 0.2]).v.tolist()
        [0.0, 0.0]
    """

    _shapes: ClassVar[Shapes] = {"q": ("n",), "v": ("n",), "a": ("n",)}

    q: Array
    v: Array
    a: Array
    j: Array | None
    s: Array | None

    def __init__(
        self,
        *,
        q: ArrayLike,
        v: ArrayLike | None = None,
        a: ArrayLike | None = None,
        j: ArrayLike | None = None,
        s: ArrayLike | None = None,
    ) -> None:
        q = finite_array("ref.q", q, unit="rad | m")
        if q.ndim != 1:
            raise ShapeError(f"ref.q must be a vector (n,); got shape {q.shape}", name="ref.q")
        n = q.shape[0]
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "v", _zeros(n) if v is None else vector("ref.v", v, n, unit="rad/s | m/s"))
        object.__setattr__(self, "a", _zeros(n) if a is None else vector("ref.a", a, n, unit="rad/s^2 | m/s^2"))
        object.__setattr__(self, "j", None if j is None else vector("ref.j", j, n, unit="rad/s^3 | m/s^3"))
        object.__setattr__(self, "s", None if s is None else vector("ref.s", s, n, unit="rad/s^4 | m/s^4"))

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        made = object.__new__(cls)
        for name in "qvajs":
            object.__setattr__(made, name, values.get(name) if name in "js" else values[name])
        return made

    def stated(self) -> dict[str, Any]:
        return {name: value for name in "qvajs" if (value := getattr(self, name)) is not None}

    @classmethod
    def between(cls, times: Float64Array, knots: Float64Array, rows: Rows) -> dict[str, Float64Array]:
        out = Sample.between(times, knots, rows)
        outside = (times < knots[0]) | (times > knots[-1])
        out["v"][outside] = out["a"][outside] = 0.0
        return out

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:  # noqa: ARG003
        return cls.of({"q": tm.array(x.q), **dict.fromkeys("vajs", np.zeros(x.n))})

    def __repr__(self) -> str:
        if self.q.dtype == object:
            return "JointMotion(<traced>)"
        return f"JointMotion(q={self.q.tolist()}, v={self.v.tolist()}, a={self.a.tolist()})"


class SmoothMotion(JointMotion):
    """The kind of sample that a law follows which needs jerk and snap too: set `reference = SmoothMotion`.

    A `JointMotion` that states j and s is one, and so is one at rest, whose derivatives are all zero.
    """

    __slots__ = ()
    _shapes: ClassVar[Shapes] = {**JointMotion._shapes, "j": ("n",), "s": ("n",)}

    @classmethod
    def taken(cls, sample: object) -> Self | None:
        if isinstance(sample, cls) or not isinstance(sample, JointMotion):
            return sample if isinstance(sample, cls) else None
        values = sample.stated()
        if "j" not in values and not (np.any(sample.v) or np.any(sample.a)):
            values |= dict.fromkeys("js", np.zeros_like(sample.q))
        return cls.of(values) if values.keys() >= set("js") else None

    @classmethod
    def described(cls) -> str:
        return "JointMotion with jerk j and snap s, as trajectories.Sine and Septic give them"


def _interpolated(times: Float64Array, knots: Float64Array, table: Float64Array) -> Float64Array:
    """(k, ...) rows of a table (m, ...) at many times, linear in between, constant outside."""
    flat = table.reshape(len(knots), -1)
    columns = [np.interp(times, knots, flat[:, i]) for i in range(flat.shape[1])]
    return np.stack(columns, axis=-1).reshape(len(times), *table.shape[1:])


def _zeros(n: int) -> Float64Array:
    zero = np.zeros(n)
    zero.flags.writeable = False
    return zero


@runtime_checkable
class Trajectory(Protocol):
    """A function of time. `at` takes one time [s] and gives a sample.

    With `rows(times)`, a sample of arrays (k, n) for many times, a simulation asks for thousands at once.
    """

    def at(self, t: float) -> Sample:
        """The sample at time t [s]."""
        ...


class Hold(Declared):
    """Stay: at the sample, or at the state of the first tick. Never times out."""

    sample: Part[Sample | None] = Part(Sample, optional=True)


class Stream(Declared):
    """Samples that arrive one by one; made by `taut.stream`."""

    period: Field = Field(unit="s", above=0.0, run_time=False)
    source: Plain[Callable[[Any], Any] | None] = Plain(Callable, optional=True)  # type: ignore[arg-type]  # an abstract class
    blend: Field = Field(unit="s", above=0.0, optional=True, run_time=False)


Reference: TypeAlias = Sample | Hold | Stream | Trajectory


def hold(sample: Sample | None = None) -> Hold:
    """Stay at `sample`; without one, at the state of the first tick. Never times out."""
    return Hold(sample=sample)


def stream(*, period: float, source: Callable[[Any], Any] | None = None, blend: float | None = None) -> Stream:
    """Samples that come one a period, from a policy, a planner or a person.

    With `blend` the reference passes smoothly to each new sample or chunk but the first: its difference from the old
    one at that instant, in position, velocity and acceleration, fades to nothing as a quintic, so that none of the
    three jumps. A difference d is made up with speeds up to 1.9 d / blend and accelerations up to 5.8 d / blend^2,
    which laws with feedforward ask for. Without `blend` the new one holds at once.

    Args:
        period: Time between samples [s].
        source: In simulation, a function of the snapshot that gives a sample or a chunk.
        blend: Time to pass from one answer to the next [s], such as the period itself.
    """
    return Stream(period=period, source=source, blend=blend)


def as_reference(ref: object) -> Reference:
    """A caller's reference as one of the four kinds."""
    if isinstance(ref, (Sample, Hold, Stream, Trajectory)):
        return ref
    hint = "; a pose to go to is taut.TaskMotion(pose=...)" if isinstance(ref, Pose) else ""
    raise UsageError(
        f"a reference is a sample such as taut.JointMotion(q=...), taut.hold(), a trajectory with at(t), "
        f"taut.stream(...) or taut.chunk(...); got {type(ref).__name__}{hint}",
        name="ref",
    )


def rows_of(motion: Sample | Trajectory, times: Float64Array, kind: type[Sample] = Sample) -> Sample:
    """Samples of a kind at many times, as arrays (k, ...); one by one where a trajectory has no `rows`."""
    at_once = getattr(motion, "rows", None)
    samples = [motion if isinstance(motion, Sample) else motion.at(float(t)) for t in times] if not at_once else []
    fitting = []
    for sample in [at_once(times)] if at_once else samples:
        taken = kind.taken(sample)
        if taken is None:
            got = sample.described() if isinstance(sample, Sample) else type(sample).__name__
            raise UsageError(f"the law follows {kind.described()}; the reference gives {got}", name="ref")
        fitting.append(taken)
    return fitting[0] if at_once else stacked(fitting)


def stacked(samples: Sequence[Sample]) -> Sample:
    """Several samples as one of arrays (k, ...)."""
    kind = type(samples[0])
    try:
        return kind.of({name: np.stack([getattr(sample, name) for sample in samples]) for name in kind.fields(1)})
    except (AttributeError, ValueError) as cause:
        raise ShapeError("the samples of a reference must be of one kind and size", name="ref") from cause


def known_rows(name: str, motion: object, times: Float64Array, n: int) -> JointMotion:
    """A motion of n joints that is known beforehand, at many times; UsageError for a stream or a hold."""
    known = "a motion that is known beforehand, a trajectory with at(t) or a taut.JointMotion"
    instance_of(name, motion, (Trajectory, Sample), known)
    assert isinstance(motion, (Trajectory, Sample))
    return JointMotion.of(sample_rows(motion, times, JointMotion, n))


def sample_rows(
    motion: Sample | Trajectory, times: Float64Array, kind: type[Sample], n: int
) -> dict[str, Float64Array]:
    """A reference at many times: each field as an array (k, size), checked; errors name time and field."""
    rows, table = rows_of(motion, times, kind), {}
    for name, shape in kind.fields(n).items():
        table[name] = values = np.asarray(getattr(rows, name), dtype=np.float64)
        if len(times) == 1 and values.ndim == len(shape):
            table[name] = values = values[np.newaxis]
        if values.shape[1:] != shape:
            raise ShapeError(
                f"ref.{name} must have shape {shape}; the reference gives {values.shape[1:]}", name=f"ref.{name}"
            )
        if len(values) != len(times):
            raise ShapeError(
                f"rows(times) must give one row per time; it gives {len(values)} for {len(times)} times",
                name=f"ref.{name}",
            )
        bad = ~np.isfinite(values)
        if bad.any():
            row, *entry = np.argwhere(bad)[0]
            raise RangeError(
                f"{entry_names(f'ref.{name}', entry)} must be finite; the reference gives "
                f"{float(values[row, *entry])!r} at t = {times[row]:g} s",
                name=f"ref.{name}",
                rule="finite",
            )
        if shape == (3, 3) and (name == "R" or name.endswith("_R")):
            _check_rotations(name, values, times)
    return table


def _check_rotations(name: str, R: Float64Array, times: Float64Array) -> None:
    """A trajectory of a user's own may give any matrix."""
    error = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max(axis=(1, 2))
    if error.size and error.max() > ROTATION_TOLERANCE:
        row = int(np.argmax(error > ROTATION_TOLERANCE))
        raise RangeError(
            f"ref.{name} must be orthonormal; at t = {times[row]:g} s R^T R differs from the identity by "
            f"{error[row]:.2g}",
            name=f"ref.{name}",
            value=float(error[row]),
            rule="orthonormal",
        )
