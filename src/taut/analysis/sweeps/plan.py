"""Plan of a sweep: what runs, what is varied and how, and the values of each sample, whoever runs it."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from taut.analysis.sweeps.distributions import Distribution
from taut.base.checks import finite_array, whole_number
from taut.base.errors import ShapeError, TautError, UsageError, unknown_name
from taut.base.fields import Declared, Field
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.codegen.engine import Engine
from taut.codegen.noise import MAX_SEED
from taut.control.lawside import LawSide
from taut.control.trajectories.reference import Reference, Sample
from taut.controller import Controller
from taut.loop import Loop, LoopParameters, ModelPlant, state_at_start
from taut.record.run import Run
from taut.runtime.simulate import Plant, simulated

DRAWN_TOGETHER: Final = 1024  # samples that are drawn together
SEED: Final = "seed"  # of the noise of a sample
REF: Final = "ref."  # begins the path of a number of the reference
STATE: Final = ("q0", "v0")
CORNERS: Final = 64  # combinations of ends at which a start is tried
_ENTRY: Final = re.compile(r"(.+)\[(\d+)\]")
Values: TypeAlias = Mapping[str, Float64Array]
Variation: TypeAlias = Distribution | ArrayLike | Sequence[Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """A closed loop as what it is made of, so that another process can make it again."""

    side: LawSide
    engine: Engine
    plant: Plant
    ref: Reference
    duration: float  # [s]
    parameters: dict[str, Float64Array]  # of both
    q0: Float64Array
    v0: Float64Array

    @classmethod
    def of(cls, made: Controller | Loop, plant: Plant, ref: Reference, duration: float, q0: Any, v0: Any) -> Subject:
        """What `taut.run` runs."""
        q, v = state_at_start(plant.arm, q0, v0)
        values = {path: np.array(x) for path, x in {**plant.parameters, **made.parameters}.items()}
        return cls(
            side=made.side, engine=made.engine, plant=plant, ref=ref, duration=duration, parameters=values, q0=q, v0=v
        )  # fmt: skip

    def loop(self, ref: Reference) -> Loop:
        """The loop of a model plant with a reference."""
        assert isinstance(self.plant, ModelPlant)
        loop = Loop(self, self.plant, None if self.side.task is not None else ref, duration=self.duration)
        for path in self.plant.parameters:
            loop.parameters[path] = self.parameters[path]
        return loop

    @property
    def content(self) -> str:
        """What it is made of, as text: the same for equal loops."""
        numbers = {**self.parameters, **reference_fields(self.ref), "q0": self.q0, "v0": self.v0}
        texts = [repr((self.side, self.engine, self.plant, type(self.ref).__name__, self.duration))]
        texts += [f"{name} {_digest(value)}" for name, value in sorted(numbers.items())]
        return re.sub(r" at 0x[0-9a-f]+", "", "; ".join(texts))


def _digest(numbers: Float64Array) -> str:
    return hashlib.sha256(np.ascontiguousarray(numbers, dtype=np.float64).tobytes()).hexdigest()


@dataclass(frozen=True, kw_only=True, eq=False)
class Varied:
    """One path of a sweep."""

    path: str  # as it was given: "law.kp", "law.kp[2]", "q0"
    target: str  # without the entry
    entry: int | None
    drawn: Distribution | None
    listed: Float64Array | None  # (samples, ...) where it has a value for each sample
    base: Float64Array  # the target's own value

    @property
    def shape(self) -> tuple[int, ...]:
        """Of one sample."""
        return self.drawn.shape if self.drawn is not None else self.listed.shape[1:]  # type: ignore[union-attr]

    def samples(self, seed: int, first: int, count: int) -> Float64Array:
        """(count, ...) of the samples from `first` on."""
        if self.listed is not None:
            return self.listed[first : first + count]
        assert self.drawn is not None
        u = uniforms(seed, self.path, first, count, self.shape)
        return self.drawn.at(u)

    def ends(self) -> list[Float64Array]:
        """Samples where all are valid if these are."""
        if self.drawn is not None:
            return self.drawn.ends()
        assert self.listed is not None
        flat = self.listed.reshape(len(self.listed), -1)
        return [self.listed[i] for i in dict.fromkeys([*flat.argmin(axis=0).tolist(), *flat.argmax(axis=0).tolist()])]

    def put(self, samples: Float64Array, into: Float64Array) -> None:
        """Write (count, ...) samples into (count, *shape) values of the target."""
        if self.entry is not None:
            into[:, self.entry] = samples
        elif self.shape == self.base.shape:
            into[...] = samples
        elif self.base.ndim == 2:
            into[...] = np.eye(len(self.base)) * samples[:, np.newaxis, np.newaxis]
        else:
            into[...] = samples[:, np.newaxis]


def uniforms(seed: int, name: str, first: int, count: int, shape: tuple[int, ...]) -> Float64Array:
    """(count, ...) numbers between 0 and 1 of samples from `first` on, by seed, name and number of the sample."""
    digest = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    blocks = range(first // DRAWN_TOGETHER, -(-(first + count) // DRAWN_TOGETHER))
    rows = [
        np.random.Generator(np.random.Philox(key=[seed, digest], counter=[0, 0, 0, b])).random(
            (DRAWN_TOGETHER, *shape)
        )
        for b in blocks
    ]
    start = first - blocks[0] * DRAWN_TOGETHER
    return np.concatenate(rows)[start : start + count]


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Everything that determines the results of a sweep. It can be pickled where the loop's parts can."""

    subject: Subject
    varied: tuple[Varied, ...]
    samples: int
    seed: int
    columns: Mapping[str, tuple[str, Sequence[int]]] = field(default_factory=dict)  # of metrics, see `columns_of`
    figures: Mapping[str, Callable[[Run], float]] = field(default_factory=dict)  # other numbers, of whole runs
    units: Mapping[str, str] = field(default_factory=dict)  # of columns
    record: tuple[str, ...] = ()  # names of `run.arrays()` that are kept
    every: int = 1  # tick of those
    real: str = "double"
    device: str = "cpu"

    @classmethod
    def of(cls, subject: Subject, vary: Mapping[str, Variation], samples: object, seed: object) -> Plan:
        """A plan whose paths exist and whose ends are valid.

        Raises:
            UnknownNameError, UsageError, ShapeError, RangeError: No such path, or values that the loop refuses.
        """
        number = whole_number("samples", samples, minimum=1)
        if not isinstance(vary, Mapping):
            raise UsageError(
                f"vary must name what is varied, such as {{'law.kp': taut.uniform(50, 400)}}; got {vary!r}",
                name="vary",
            )
        varied = tuple(_varied(subject, path, value, number) for path, value in vary.items())
        whole = {each.target for each in varied if each.entry is None}
        for each in varied:
            if each.entry is not None and each.target in whole:
                raise UsageError(
                    f"vary has '{each.target}' and its entry '{each.path}'; vary the whole, or its entries",
                    name="vary",
                )
        plan = cls(subject=subject, varied=varied, samples=number, seed=whole_number("seed", seed, maximum=MAX_SEED))
        plan._check()
        return plan

    def drawn(self, first: int, count: int) -> dict[str, Float64Array]:
        """(count, ...) what is drawn for each sample, by path; and its seed."""
        out = {each.path: each.samples(self.seed, first, count) for each in self.varied}
        if SEED not in out:
            out[SEED] = np.floor(uniforms(self.seed, SEED, first, count, ()) * 2.0**53)
        return out

    def values(self, drawn: Values) -> dict[str, Float64Array]:
        """(count, *shape) the values of what is varied, by target, from what was drawn."""
        out: dict[str, Float64Array] = {}
        for each in self.varied:
            samples = drawn[each.path]
            if each.target not in out:
                out[each.target] = np.repeat(each.base[np.newaxis], len(samples), axis=0)
            each.put(samples, out[each.target])
        return out

    def seeds(self, drawn: Values) -> NDArray[np.uint64]:
        """(count,) of the noise of each sample."""
        return drawn[SEED].astype(np.uint64)

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of what is kept of each run."""
        return *self.columns, *self.figures

    @property
    def digest(self) -> str:
        """The same for plans with the same results."""
        own = [(x.path, repr(x.drawn) if x.listed is None else _digest(x.listed)) for x in self.varied]
        parts = (self.subject.content, own, self.samples, self.seed, list(self.numbers), self.record, self.every)
        return hashlib.sha256(repr((*parts, self.real, self.device)).encode()).hexdigest()

    def _check(self) -> None:
        """Refuse what some sample would be refused for: each end alone, and starts where several ends meet."""
        subject = self.subject
        for each in self.varied:
            for end in each.ends():
                try:
                    self._checked(each, end)
                except TautError as error:
                    reached = f"'{each.path}' of the sweep reaches {end.tolist()}, which the loop refuses"
                    raise type(error)(f"{reached}: {error}", name=each.path) from error
        if isinstance(subject.plant, ModelPlant):
            loop = subject.loop(subject.ref)
            for drawn in itertools.islice(self._corners(), CORNERS):
                self._try_start(loop, self.values(drawn))

    def _corners(self) -> Iterator[dict[str, Float64Array]]:
        ends = [[(each.path, end) for end in _outer(each.ends())] for each in self.varied if each.path != SEED]
        for corner in itertools.product(*ends):
            yield {path: end[np.newaxis] for path, end in corner} | {SEED: np.zeros(1)}

    def _checked(self, each: Varied, end: Float64Array) -> None:
        """A value at an end: what the loop makes of it must be what a sample gets."""
        subject = self.subject
        value = np.repeat(each.base[np.newaxis], 1, axis=0)
        if each.path == SEED:
            whole_number(SEED, int(end) if float(end).is_integer() else float(end), maximum=2**53)
            return
        each.put(end[np.newaxis], value)
        if each.target in STATE:
            state_at_start(subject.plant.arm, *(value[0] if each.target == name else None for name in STATE))
        elif each.target.startswith(REF):
            changed_reference(subject.ref, {each.target: value[0]})
        else:
            parameters = LoopParameters(subject.side, subject.plant, subject.parameters)
            made = parameters.checked(each.target, value[0])
            given = parameters.checked(each.target, end) if each.entry is None else made
            if not np.array_equal(made, value[0]) or not np.array_equal(given, made):
                raise ShapeError(f"{each.target} must be given in shape {made.shape}; got {end.tolist()}")
            subject.plant.check_together({**subject.parameters, each.target: made})

    def _try_start(self, loop: Loop, values: Values) -> None:
        subject = self.subject
        here = {path: value[0] for path, value in values.items()}
        parameters = {**subject.parameters, **{path: x for path, x in here.items() if path in subject.parameters}}
        q, v = (here.get(name, getattr(subject, name)) for name in STATE)
        try:
            subject.plant.check_together(parameters)
            loop.side.check_start(q, parameters, loop.ref)
            loop.plant_at_start(q, v, {**parameters, "dt": loop.dt})
        except TautError as error:
            where = ", ".join(f"{path} = {value.tolist()}" for path, value in here.items())
            reached = f"the sweep reaches {where}, where the loop cannot start"
            raise type(error)(f"{reached}: {error}", name="vary") from error


def _outer(ends: list[Float64Array]) -> list[Float64Array]:
    """The first and the last of several ends."""
    return ends if len(ends) < 3 else [ends[0], ends[-1]]


def _varied(subject: Subject, path: str, value: Variation, samples: int) -> Varied:
    """A path of a sweep with what is given for it."""
    match = _ENTRY.fullmatch(path) if isinstance(path, str) else None
    target, entry = (match[1], int(match[2])) if match else (path, None)
    base = _base(subject, target)
    if entry is not None and (base.ndim != 1 or entry >= base.size):
        raise ShapeError(f"'{target}' has shape {base.shape}, and no entry [{entry}]", name=path)
    drawn = value if isinstance(value, Distribution) else None
    listed = finite_array(f"vary['{path}']", value) if not isinstance(value, Distribution) else None
    if listed is not None and (listed.ndim == 0 or len(listed) != samples):
        raise ShapeError(
            f"vary['{path}'] must be a distribution, such as taut.uniform(1, 2), or one value for each of the "
            f"{samples} samples; got shape {listed.shape}",
            name=path,
        )
    each = Varied(path=path, target=target, entry=entry, drawn=drawn, listed=listed, base=base)
    wanted = () if entry is not None else base.shape
    if each.shape not in ((), wanted):
        raise ShapeError(f"vary['{path}'] must give one number, or shape {wanted}; got shape {each.shape}", name=path)
    return each


def _base(subject: Subject, target: str) -> Float64Array:
    """The value that a path has without the sweep."""
    known: dict[str, Float64Array] = {**subject.parameters, "q0": subject.q0, "v0": subject.v0, SEED: np.zeros(())}
    known |= {f"{REF}{name}": value for name, value in reference_fields(subject.ref).items()}
    if target not in known:
        raise unknown_name("the loop", "path", target, known)
    return known[target]


def reference_fields(ref: Reference) -> dict[str, Float64Array]:
    """The numbers of a reference that can be varied, by name: of a sample, or the declared fields of a trajectory."""
    if isinstance(ref, Sample):
        stated = ref.stated()
    elif isinstance(ref, Declared):
        stated = {name: getattr(ref, name) for name, each in ref.declared.items() if isinstance(each, Field)}
    else:
        return {}
    return {name: np.asarray(x) for name, x in stated.items() if isinstance(x, (np.ndarray, float, int))}


def changed_reference(ref: Reference, values: Values) -> Reference:
    """A reference with some numbers changed, by path."""
    new = subtree(values, REF.rstrip("."))
    if not new:
        return ref
    if isinstance(ref, Sample):
        return type(ref)(**{**ref.stated(), **new})
    return dataclasses.replace(ref, **new)  # type: ignore[type-var]  # a declared one


class Runs:
    """Runs of samples one by one, by `taut.run`: of a loop with any plant, or of a task."""

    def __init__(self, plan: Plan) -> None:
        self._subject = subject = plan.subject
        self._loop: Loop | None = None
        if not isinstance(subject.plant, ModelPlant):
            self._ctrl = Controller(subject.side, subject.engine)
            for path in self._ctrl.parameters:
                self._ctrl.parameters[path] = subject.parameters[path]

    def run(self, values: Values, seed: int) -> Run:
        """The run of a sample, of the values of what is varied."""
        subject, plant = self._subject, self._subject.plant
        q, v = (values.get(name, getattr(subject, name)) for name in STATE)
        ref = changed_reference(subject.ref, values)
        new = {path: value for path, value in values.items() if path in subject.parameters}
        once = {"q0": q, "v0": v, "seed": seed, "progress": False, "judged": False}
        if isinstance(plant, ModelPlant):
            if self._loop is None or ref is not subject.ref:
                self._loop = subject.loop(ref)
            self._loop.parameters.update(new)
            return simulated(self._loop, plant, self._loop.ref, subject.duration, **once)
        self._ctrl.parameters.update({path: x for path, x in new.items() if path in self._ctrl.parameters})
        own = {path: x for path, x in new.items() if path in plant.parameters}
        plant.set_parameters(own)
        try:
            return simulated(self._ctrl, plant, ref, subject.duration, **once)
        finally:  # the plant may be the caller's
            plant.set_parameters({path: subject.parameters[path] for path in own})
