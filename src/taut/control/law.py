"""Law: a control law as a pure function of a snapshot, written like the textbook writes it.

A law of your own is a class like ours, in a file of your own. Its fields are gains and memory; `command` gives
the command, and with memory the new memory. The same code runs on floats and is traced for every target.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import io
import re
import tokenize
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, NoReturn, dataclass_transform

import numpy as np

from taut.base.errors import ShapeError, TraceError, UsageError, count_of, unknown_name, user_location
from taut.base.types import Float64Array
from taut.control.command import Command
from taut.control.gains import Gain, GainValue, Memory
from taut.control.trajectories.reference import JointMotion, Reference, Sample
from taut.maths.snapshot import Snapshot
from taut.trace.array import has_symbols, traced_array

if TYPE_CHECKING:
    from taut.control.tasks.task import Task

__all__ = ["Law", "LawMemory", "call", "field_units", "initial_memory"]

LawMemory = Mapping[str, Any]
"""Memory by name; a law that holds laws has theirs under their names."""


class MemoryView:
    """Memory as law code reads it: `memory.e_int`, and that of a law it holds: `memory.inner.e_int`."""

    __slots__ = ("_law", "_values")

    def __init__(self, values: LawMemory, law: str) -> None:
        self._values = values
        self._law = law

    def __getattr__(self, name: str) -> Any:
        if name not in self._values:
            raise unknown_name(f"the memory of {self._law}", "entry", name, self._values)
        value = self._values[name]
        return MemoryView(value, f"{self._law}.{name}") if isinstance(value, Mapping) else value

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__slots__:
            object.__setattr__(self, name, value)
            return
        raise UsageError(
            f"memory.{name} of {self._law} is set at {user_location()}; memory is not changed: return the new one "
            f"with the command, {{'{name}': ...}}",
            name=name,
        )


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Law:
    """Base of every control law.

    A law is a frozen, keyword-only dataclass with these parts:

    * fields `kp: Gain` (a run-time parameter), `e_int: Memory = Memory(0.0)` (remembered), or plain values;
    * `command(self, x, ref)`, or `command(self, x, ref, memory, dt)` with memory, which returns a Command and,
      with memory, a dict of the new memory by name;
    * optionally `start(self, x, ref) -> dict`: memory that starts from the measured state;
    * optionally `check_rate(self, rate)`, which refuses gains that have no meaning at that rate [Hz];
    * optionally `check_state(self, x, rate)`, which refuses gains that have no meaning where a run starts, and
      `check_change(self, x, rate)`, which refuses new ones where the arm is then;
    * optionally `check_reference(self, x, ref, rate)`, which refuses what a run is to follow from there, and
      `check_reference_later(self, x, ref, rate)`, what a phase would follow that begins later, elsewhere;
    * `reference`, the kind of sample it follows (JointMotion unless said);
    * `recorded`, the entries of its memory that a run keeps as further columns, where it has them (none unless said);
    * `notices`, pairs of a recorded entry and what the outcome of a run says where that is not zero;
    * `needs_contact`, whether a `taut.Phase` with it never starts without contact (not unless said).

    Laws add: `FeedForward() + PID(kp=..., kd=...)`. A law must not inherit from another one: it holds it in a field.
    A law that it holds in `inner: taut.Law` starts with it, and is called as
    `self.inner.command(x, ref, memory.inner, dt)`; its new memory is returned under its name, {"inner": ...}.
    """

    reference: ClassVar[type[Sample]] = JointMotion
    ignores_reference: ClassVar[bool] = False  # such a law adds to, and is held by, laws of every kind of sample
    recorded: ClassVar[tuple[str, ...]] = ()
    needs_contact: ClassVar[bool] = False  # a phase of such a law never starts without contact
    notices: ClassVar[tuple[tuple[str, str], ...]] = ()  # recorded entry, and what an outcome says where it is not 0
    uses_memory: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.__mro__[1] is not Law:
            raise UsageError(
                f"law {cls.__name__} inherits from law {cls.__mro__[1].__name__}; inherit from taut.Law "
                "and hold the other law in a field",
                name=cls.__name__,
            )
        for name, annotation in inspect.get_annotations(cls).items():
            word = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")
            if name in RESERVED and "ClassVar" not in str(annotation):
                raise UsageError(
                    f"law {cls.__name__}: '{name}' is a word of taut.Law itself; give the field another name",
                    name=name,
                )
            kind = FIELDS.get(word.rpartition(".")[2])
            given = cls.__dict__.get(name)
            if kind is not None and not isinstance(given, kind) and (given is not None or kind is Gain):
                field = Gain() if given is None else kind(given)  # kp: Gain, kp: Gain = 5.0, e_int: Memory = 0.0
                field.__set_name__(cls, name)
                setattr(cls, name, field)
            elif isinstance(given, (list, set, dict, np.ndarray)):
                raise UsageError(
                    f"law {cls.__name__}: the default of '{name}' is a {type(given).__name__}, which could be "
                    "changed; write a tuple",
                    name=name,
                )
        for name, given in vars(cls).items():
            if isinstance(given, tuple(FIELDS.values())) and name not in inspect.get_annotations(cls):
                kind_name = type(given).__name__
                raise UsageError(
                    f"law {cls.__name__}: '{name}' needs its type; write {name}: taut.{kind_name} = "
                    f"taut.{kind_name}(...)",
                    name=name,
                )
        cls.uses_memory = _takes_memory(cls)
        dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)(cls)
        _check_arguments(cls)
        cls.__setattr__ = _refuse_change  # type: ignore[assignment, method-assign]

    # ---------------------------------------------------------------- its parts

    def children(self) -> dict[str, Law]:
        """The laws that this law holds, by field."""
        return {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)  # type: ignore[arg-type]  # every subclass is a dataclass
            if isinstance(getattr(self, field.name), Law)
        }

    def with_children(self, children: Mapping[str, Law]) -> Law:
        """A copy that holds other laws."""
        return self._replaced(children)

    def gains(self) -> dict[str, GainValue]:
        """This law's own gains, by field."""
        own = {name: value for name, value in vars(self).items() if isinstance(value, GainValue)}
        return {name: value for name, value in own.items() if type(self).__dict__[name].has_meaning(self)}

    def parameters(self) -> dict[str, Float64Array]:
        """Every gain of this law and of the laws it holds, by path."""
        out = {name: gain.as_array() for name, gain in self.gains().items()}
        for child, law in self.children().items():
            out |= {f"{child}.{path}": values for path, values in law.parameters().items()}
        return out

    def gain_field(self, path: str) -> tuple[Gain, str]:
        """The field behind a path, and its unit: what a new value is checked with."""
        head, _, rest = path.partition(".")
        if rest:
            return self.children()[head].gain_field(rest)
        return type(self).__dict__[head], field_units(type(self)).get(head, "")

    def gain_size(self, path: str) -> int | None:
        """Entries of the gain behind a path where it is a vector; None for one per joint."""
        head, _, rest = path.partition(".")
        if rest:
            return self.children()[head].gain_size(rest)
        size = self.gain_declared(path).size
        return int(getattr(self, size)) if isinstance(size, str) else size

    def gain_declared(self, path: str) -> Gain:
        """How the gain behind a path is declared."""
        head, _, rest = path.partition(".")
        if rest:
            return self.children()[head].gain_declared(rest)
        declared: Gain = type(self).__dict__[head]
        return declared

    def gives(self, gain: str) -> bool:
        """Whether an optional gain was given, and has a meaning."""
        return gain in self.gains()

    def bound(self, values: Mapping[str, Any]) -> Law:
        """A copy whose gains are `values` by path: symbols while traced, numbers in the float engine."""
        own = {name: GainValue(values[name], name) for name in self.gains()}
        children = {
            child: law.bound({p[len(child) + 1 :]: v for p, v in values.items() if p.startswith(child + ".")})
            for child, law in self.children().items()
        }
        law = self.with_children(children) if children else self
        return law._replaced(own)

    def _replaced(self, values: Mapping[str, Any]) -> Law:
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        copy.__dict__.update(values)
        return copy

    def check_size(self, n: int) -> None:
        """Every gain that is no scalar must have as many entries as the law acts on.

        Raises:
            ShapeError: A gain has another size.
        """
        for path, values in self.parameters().items():
            declared = self.gain_size(path)
            size = n if declared is None else declared
            if values.ndim and values.shape[0] != size:
                ours = type(self).__module__.startswith("taut.")
                way_out = "" if ours or declared else "; a gain of another size is declared as taut.Gain(size=...)"
                whose = f"for {count_of(n, 'joint')}" if declared is None else "as its law declares it"
                gain = self.gain_declared(path)
                short = ["a scalar"] * gain.scalar + ["(linear, angular)"] * (gain.pairs and size == 6)
                raise ShapeError(
                    f"{path} must be {', '.join([*short, f'({size},)'])} or ({size}, {size}) {whose}; got shape "
                    f"{values.shape}"
                    f"{way_out}",
                    name=path,
                )

    def seen_by(self, child: str, x: Snapshot, ref: Sample) -> tuple[Snapshot, Sample]:  # noqa: ARG002
        """What a law that this one holds sees and follows."""
        return x, ref

    def memory_of_children(self, x: Snapshot, ref: Sample) -> dict[str, Any]:
        """Memory at the first tick of the laws that this one holds, by field."""
        return {name: initial_memory(child, *self.seen_by(name, x, ref)) for name, child in self.children().items()}

    @property
    def controlled_frame(self) -> str | None:
        """The frame that this law, or a law that it holds, controls; None for the arm's tool."""
        if "tool" in vars(self):  # what it holds beside, such as a law in `null`, may look at another frame
            own: str | None = vars(self)["tool"]
            return own
        followers = [law for law in self.children().values() if not law.ignores_reference]
        return next((frame for law in followers if (frame := law.controlled_frame)), None)

    def at_rest(self, x: Snapshot) -> Sample:
        """The sample that asks this law to stay as in the snapshot."""
        return self.reference.at_rest(x, self.controlled_frame)

    def check_rates(self, rate: float) -> None:
        """Every law that has a `check_rate` must fit the rate, with the gains that it has now.

        Raises:
            RangeError: A gain that has no meaning at this rate.
        """
        for law in self.children().values():
            law.check_rates(rate)
        check: Callable[[float], None] | None = getattr(self, "check_rate", None)
        if check is not None:
            check(rate)

    def check_states(self, x: Snapshot, rate: float, *, changed: bool = False) -> None:
        """Every law that has a `check_state` must fit the state of a snapshot, with the gains that it has now.

        Args:
            x: The state.
            rate: [Hz].
            changed: Whether gains have changed on the way: then it is `check_change` that is asked.

        Raises:
            RangeError: A gain that has no meaning there.
        """
        for law in self.children().values():
            law.check_states(x, rate, changed=changed)
        hook = "check_change" if changed else "check_state"
        check: Callable[[Snapshot, float], None] | None = getattr(self, hook, None)
        if check is not None:
            check(x, rate)

    def check_references(self, x: Snapshot, ref: Reference, rate: float, *, later: bool = False) -> None:
        """What is to be followed must have a meaning for this law, and for those it holds that follow the same.

        Args:
            x: Where it is followed from.
            ref: What is to be followed.
            rate: [Hz].
            later: Whether that begins later, where it is not known yet, and x is where the run starts.

        Raises:
            RangeError, UsageError: It has none.
        """
        for law in self.children().values():
            if law.reference is self.reference:
                law.check_references(x, ref, rate, later=later)
        hook = "check_reference_later" if later else "check_reference"
        check: Callable[[Snapshot, Reference, float], None] | None = getattr(self, hook, None)
        if check is not None:
            check(x, ref, rate)

    def __add__(self, other: Law) -> Law:
        from taut.control.combine import added

        if not isinstance(other, Law):
            return NotImplemented
        return added(self, other)

    def __repr__(self) -> str:
        shown = []
        for field in dataclasses.fields(self):  # type: ignore[arg-type]  # every subclass is a dataclass
            value = getattr(self, field.name)
            shows = (
                field.name in self.gains() if isinstance(value, GainValue) else not _is_default(value, field.default)
            )
            if shows:
                shown.append(f"{field.name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"


def _is_default(value: Any, default: Any) -> bool:
    if isinstance(value, np.ndarray):
        return default is not dataclasses.MISSING and np.array_equal(value, np.asarray(default))
    if isinstance(value, Law):  # one that is bound to its gains is another object
        return repr(value) == repr(default)
    return bool(value == default)


# -------------------------------------------------------------------- checks of a class of law


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


def _check_arguments(cls: type[Law]) -> None:
    """Make a misspelt, missing or positional argument one clear sentence."""
    generated = cls.__init__
    fields = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    required = [
        name
        for name, field in fields.items()
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]

    @functools.wraps(generated)
    def checked(self: Law, *args: Any, **kwargs: Any) -> None:
        if args:
            raise UsageError(
                f"{cls.__name__} takes its gains by name; got {len(args)} without; "
                f"write {cls.__name__}({', '.join(f'{name}=...' for name in fields)})",
                name=cls.__name__,
            )
        for name in kwargs:
            if name not in fields:
                raise unknown_name(cls.__name__, "gain", name, fields)
        missing = [name for name in required if name not in kwargs]
        if missing:
            units = field_units(cls)
            named = ", ".join(f"{name}{f' [{units[name]}]' if name in units else ''}" for name in missing)
            raise UsageError(f"{cls.__name__} needs {named}", name=missing[0])
        generated(self, *args, **kwargs)
        for name, value in kwargs.items():  # dataclasses.replace gives all that the law has, also what means nothing
            gain = cls.__dict__.get(name)
            if isinstance(gain, Gain) and isinstance(value, GainValue) and not gain.has_meaning(self):
                object.__setattr__(self, name, gain.default)
        for own, given in self.gains().items():
            if cls.__dict__[own].pairs:
                values = cls.__dict__[own].checked(given, name=own, entries=self.gain_size(own))
                self.__dict__[own] = GainValue(values, own)
        for name in kwargs:
            gain = cls.__dict__.get(name)
            if isinstance(gain, Gain) and not isinstance(kwargs[name], GainValue) and not gain.has_meaning(self):
                assert gain.where is not None
                other, value = gain.where
                words = value if isinstance(value, tuple) else (value,)
                case = f"{other}=" if value is ... else f"{other}=" + " or ".join(f"'{word}'" for word in words)
                raise UsageError(
                    f"{cls.__name__}: {name} is for {case}, and this one has {getattr(self, other)!r}; leave it out",
                    name=name,
                )
        for name, value in list(vars(self).items()):
            if isinstance(value, np.ndarray):  # a law never changes, and what is traced is kept
                kept = value.copy()
                kept.flags.writeable = False
                self.__dict__[name] = kept

    cls.__init__ = checked  # type: ignore[assignment, method-assign]


def _refuse_change(law: Law, name: str, value: object) -> NoReturn:  # noqa: ARG001
    raise dataclasses.FrozenInstanceError(
        f"cannot assign to field '{name}' of {type(law).__name__}: a law does not change; what it remembers is "
        f"declared as {name}: taut.Memory = taut.Memory(0.0), read as memory.{name}, and returned with the command: "
        f"return taut.Torque(...), {{'{name}': ...}}"
    )


_UNITS: Final[dict[type, dict[str, str]]] = {}


def field_units(cls: type) -> dict[str, str]:
    """The unit of each field, from the comment behind it: `kp: Gain  # [1/s^2]`."""
    if cls not in _UNITS:
        _UNITS[cls] = _read_units(cls)
    return _UNITS[cls]


def _read_units(cls: type) -> dict[str, str]:
    try:
        source = inspect.getsource(cls)
    except (OSError, TypeError):  # a class without a file, as in an interactive session
        return {}
    units = {}
    for name, comment in _commented_fields(source):
        match = re.search(r"\[([^\]]+)\]", comment)
        if match:
            units[name] = match.group(1)
    return units


def _commented_fields(source: str) -> Iterator[tuple[str, str]]:
    name: str | None = None
    try:
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            field = re.match(r"\s*(\w+)\s*:", token.line)
            if token.type == tokenize.NAME and field and token.string == field.group(1):
                name = token.string
            elif token.type == tokenize.COMMENT and name is not None:
                yield name, token.string
            elif token.type in (tokenize.NEWLINE, tokenize.NL):
                name = None
    except (tokenize.TokenError, IndentationError):
        return


# -------------------------------------------------------------------- running a law


def initial_memory(law: Law, x: Snapshot, ref: Sample) -> dict[str, Any]:
    """Memory at the first tick: stated values, that of laws it holds, what `start` makes of the measured state."""
    values: dict[str, Any] = {}
    for field in dataclasses.fields(law):  # type: ignore[arg-type]  # every law is a dataclass
        if isinstance(type(law).__dict__.get(field.name), Memory):
            values[field.name] = law.__dict__[field.name]
    values |= law.memory_of_children(x, ref)
    start: Callable[[Snapshot, Sample], Mapping[str, Any]] | None = getattr(law, "start", None)
    if start is not None:
        values |= start(x, ref)
    return values


FIELDS: Final[Mapping[str, type[Gain | Memory]]] = {"Gain": Gain, "Memory": Memory}
RESERVED: Final = frozenset(name for name in vars(Law) if not name.startswith("_")) | {
    "command",
    "start",
    "check_rate",
    "check_change",
    "check_state",
    "check_reference",
    "check_reference_later",
}


def call(law: Law | Task, x: Snapshot, ref: Sample, memory: LawMemory, dt: Any) -> tuple[Command, dict[str, Any]]:
    """One evaluation of a law.

    Raises:
        UsageError: What it returns is no command, or its memory does not fit.
    """
    who = type(law).__name__
    run: Callable[..., Any] = law.command  # type: ignore[union-attr]  # each subclass declares its own
    result = run(x, ref, MemoryView(memory, who), dt) if law.uses_memory else run(x, ref)
    after: Mapping[str, Any] = {}
    if isinstance(result, tuple) and len(result) == 2:
        result, after = result
    if not isinstance(result, Command):
        raise UsageError(
            f"{who}.command must return a taut.Torque, Velocity or Position"
            f"{' and a dict of memory' if law.uses_memory else ''}; got {_described(result)}",
            name=who,
        )
    if not isinstance(after, Mapping):
        raise UsageError(
            f"{who}.command must return its memory as a dict by name, with the command; got {_described(after)}",
            name=who,
        )
    for name in after:
        if name not in memory:
            raise UsageError(
                f"{who}.command returns memory '{name}', which has no start; declare {name}: Memory = "
                "Memory(0.0), or return it from start(self, x, ref)",
                name=name,
            )
    missing = [name for name in memory if name not in after and not _is_empty(memory[name])]
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


def _is_empty(value: Any) -> bool:
    return isinstance(value, Mapping) and not value


def _described(result: Any) -> str:
    if isinstance(result, np.ndarray):
        return f"an unnamed array of shape {result.shape}; write taut.Torque(P=...)"
    return type(result).__name__


def as_array(value: Any, name: str) -> Any:
    """A value of memory or a term as an array.

    Raises:
        TraceError: It is no number.
    """
    array = value.as_array() if hasattr(value, "as_array") else np.asanyarray(value)
    if array.dtype == object and has_symbols(array):
        return traced_array(array)
    if array.dtype.kind == "c":  # of which NumPy would keep the real part
        raise TraceError(f"{name} must be real numbers; got {value!r}", name=name)
    try:
        if array.dtype == object and any(entry is None for entry in array.flat):  # of which NumPy makes NaN
            raise TypeError
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise TraceError(f"{name} must be numbers in a rectangular array; got {value!r}", name=name) from cause
