"""What a law is declared with: gains, memory, and the integral of an error with what keeps it from winding up."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import numpy as np

from taut.base.checks import read_only
from taut.base.errors import RangeError, ShapeError, UsageError, unknown_name, user_location
from taut.base.fields import REQUIRED, Choice, Declaration, Declared, Field
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.trace import math as tm
from taut.trace.array import Traced, traced_array
from taut.trace.scalar import Symbol

AntiWindup = Literal["clamping", "back-calculation", "none"]
TRACE_DAMPING: Final = 1e-5  # of a matrix ki that is inverted, relative to its trace


class GainValue(np.lib.mixins.NDArrayOperatorsMixin):
    """A gain in law code: `self.kp @ e` is k I, diag(k) or a matrix; `*`, entry by entry, is refused for a matrix."""

    __slots__ = ("_values", "name")
    __array_priority__ = 2000.0
    answers_ufuncs: ClassVar[bool] = True

    def __init__(self, values: Any, name: str) -> None:
        # A symbol alone becomes an array without dimensions, so that every gain has a shape.
        self._values = traced_array(values) if isinstance(values, Symbol) else np.asanyarray(values)
        self.name = name

    @property
    def ndim(self) -> int:
        """0, 1 or 2."""
        return self._values.ndim

    @property
    def shape(self) -> tuple[int, ...]:
        """(), (n,) or (n, n)."""
        return tuple(self._values.shape)

    def as_array(self) -> Array:
        """The bare numbers."""
        return self._values

    def matrix(self, n: int) -> Array:
        """(n, n): k I, diag(k), or the matrix itself."""
        return self._values if self.ndim == 2 else np.eye(n) * self._values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self._values, dtype=dtype) if copy else np.asarray(self._values, dtype=dtype)

    def __float__(self) -> float:
        return float(self._values[()])

    def __bool__(self) -> bool:
        return bool(self._values[()] if self.ndim == 0 else self._values)

    def __getitem__(self, index: Any) -> Any:
        return self._values[index]

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        if self._values.dtype == object:
            return f"<traced gain {self.name}>"
        return repr(float(self)) if self.ndim == 0 else repr(self._values.tolist())

    __hash__ = None  # type: ignore[assignment]  # compared by value, like an array

    def __matmul__(self, other: Any) -> Any:
        mapped = getattr(other, "mapped", None)
        if mapped is not None:
            return mapped(self._apply)
        if isinstance(other, GainValue):
            if self.ndim < 2 and other.ndim < 2:
                return GainValue(self._values * other._values, self.name)
            n = max(self._size(), other._size())
            return GainValue(self.matrix(n) @ other.matrix(n), self.name)
        return self._apply(other)

    def __rmatmul__(self, other: Any) -> Any:
        if self.ndim == 2:
            return np.asanyarray(other) @ self._values
        return other * self._values

    def _size(self) -> int:
        return self.shape[0] if self.ndim else 1

    def _apply(self, x: Any) -> Any:
        x = x if isinstance(x, Traced) else np.asanyarray(x)
        if self.ndim and x.ndim and x.shape[0] != self.shape[0]:
            raise ShapeError(
                f"{self.name} has {self.shape[0]} entries and is applied to {x.shape[0]} at {user_location()}",
                name=self.name,
            )
        if self.ndim == 2:
            return self._values @ x
        if self.ndim == 1 and x.ndim == 2:
            return self._values[:, np.newaxis] * x
        return self._values * x

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        if method != "__call__" or not isinstance(kwargs.get("out", (self,))[0], GainValue):
            return NotImplemented  # a gain as `out`, as in k *= 2, gives a new one
        if any(hasattr(x, "mapped") for x in inputs):  # named terms
            return NotImplemented
        if ufunc is np.matmul:
            left, right = inputs
            if isinstance(left, GainValue):
                return left.__matmul__(right)
            return self.__rmatmul__(left)
        gains = [x for x in inputs if isinstance(x, GainValue)]
        alike = all(isinstance(x, GainValue) or np.ndim(x) == 0 for x in inputs)
        if any(gain.ndim == 2 for gain in gains):
            scaling = ufunc in (np.multiply, np.divide, np.negative) and len(gains) == 1
            if not alike or not (scaling or ufunc in (np.add, np.subtract)):
                raise UsageError(
                    f"{self.name} is a matrix and np.{ufunc.__name__} works entry by entry, "
                    f"at {user_location()}; gains act by @: write {self.name} @ e",
                    name=self.name,
                )
            size = max(gain._size() for gain in gains)
            if ufunc in (np.add, np.subtract):
                inputs = tuple(x.matrix(size) if isinstance(x, GainValue) else x * np.eye(size) for x in inputs)
        result = ufunc(*(x._values if isinstance(x, GainValue) else x for x in inputs))
        return GainValue(np.asanyarray(result), self.name) if alike and _numeric(result) else result


def _numeric(result: Any) -> bool:
    return getattr(result, "dtype", np.dtype(np.float64)) != np.bool_


class Gain(Field):
    """A run-time parameter of a law that acts by `@`: a scalar as k I, a vector as diag(k), or a matrix.

    It takes a scalar, one number per joint, or a symmetric positive semidefinite matrix, with entries >= 0, unless it
    states another range.

    Args:
        default: Value where none is given; without it the gain is required, or None if `optional`.
        unit: Shown in messages, in `explain()` and in tables.
        shape: "n" for one per joint, "scalar", a length such as 3, or the law's attribute with it ("dimensions").
        accepts: Other forms: "scalar" for all entries, "pair" (linear, angular) for six, "matrix".
        minimum: Smallest allowed entry.
        above: Every entry must be greater.
        maximum: Largest allowed entry.
        optional: Whether it may be None.
        hint: What to do instead of zero, for the message.

    Example:
        >>> import taut
        >>> class Spring(taut.Law):
        ...     K: Gain = Gain(unit="N m/rad")
        ...     def command(self, x, ref):
        ...         return taut.Torque(spring=self.K @ (ref.q - x.q))
        >>> Spring(K=[10.0, 20.0])
        Spring(K=[10.0, 20.0])
    """

    def __init__(
        self,
        default: Any = REQUIRED,
        *,
        unit: str = "",
        shape: str | int = "n",
        accepts: Iterable[str] | None = None,
        minimum: float = 0.0,
        above: float = -math.inf,
        maximum: float = math.inf,
        optional: bool = False,
        hint: str = "",
    ) -> None:
        if accepts is None:
            accepts = () if shape == "scalar" else ("scalar", "matrix")
        super().__init__(
            default,
            unit=unit,
            shape=shape,
            accepts=accepts,  # type: ignore[arg-type]  # words
            minimum=minimum,
            above=above,
            maximum=maximum,
            optional=optional,
            hint=hint,
        )

    if TYPE_CHECKING:

        def __set__(self, obj: object, value: ArrayLike | GainValue | None) -> None: ...

    def stored(self, value: Any) -> GainValue:
        """The value as law code reads it."""
        return value if isinstance(value, GainValue) else GainValue(value, self.name)


class Memory:
    """State of a law from tick to tick, declared in its class and no argument of it: `e_int = Memory(unit="rad s")`.

    `command` reads memory.e_int and returns the new value with the command, {"e_int": ...}. What starts from the
    measured state is returned under its name by the law's `start(self, x, ref)`.

    Args:
        initial: Value at the start; a scalar takes the shape that `command` returns.
        unit: Shown in tables.
        record: Whether a run records it as a column, law.e_int.
        notice: Sentence of a run's outcome where it is not zero.
        doc: One sentence.
    """

    __slots__ = ("doc", "initial", "notice", "record", "unit")

    def __init__(
        self, initial: ArrayLike = 0.0, *, unit: str = "", record: bool = False, notice: str = "", doc: str = ""
    ) -> None:
        self.initial: Float64Array = read_only(initial)
        self.unit, self.record, self.notice, self.doc = unit, record or bool(notice), notice, doc


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

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__slots__:
            object.__setattr__(self, name, value)
            return
        raise UsageError(
            f"memory.{name} of {self._law} is set at {user_location()}; memory is not changed: return the new one "
            f"with the command, {{'{name}': ...}}",
            name=name,
        )


class Remembers(Declared):
    """A declared object with memory of its own: a law, or a part of laws such as the integral of an error."""

    memories: ClassVar[Mapping[str, Memory]] = {}

    def __init_subclass__(cls) -> None:
        annotations = dict(inspect.get_annotations(cls))
        for name, annotation in list(annotations.items()):
            word = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")
            given = cls.__dict__.get(name, REQUIRED)
            if word.rpartition(".")[2] == "Memory":  # e_int: Memory = Memory(0.0): no field of the dataclass
                if name in dir(cls.__mro__[1]):
                    raise UsageError(
                        f"{cls.__name__}: '{name}' is a word of {cls.__mro__[1].__name__} itself; give the field "
                        "another name",
                        name=name,
                    )
                setattr(
                    cls, name, given if isinstance(given, Memory) else Memory(0.0 if given is REQUIRED else given)
                )
                del annotations[name]
        cls.__annotations__ = annotations
        cls.memories = {name: value for name, value in vars(cls).items() if isinstance(value, Memory)}
        super().__init_subclass__()

    @classmethod
    def declaration_of(cls, name: str, annotation: str, default: Any) -> Declaration[Any]:
        """`kp: Gain` and `kp: Gain = 5.0` are gains."""
        kind, _, none = annotation.partition(" | ")
        if kind.rpartition(".")[2] == "Gain":
            return Gain(default, optional=none == "None")
        return super().declaration_of(name, annotation, default)

    def check_rate(self, rate: float) -> None:
        """Refuse gains that have no meaning at this rate [Hz], with a TautError."""

    def parts_with_memory(self) -> dict[str, Remembers]:
        """Its parts that may remember something, by field."""
        return {name: part for name, part in self.declared_parts().items() if isinstance(part, Remembers)}

    def every_memory(self) -> dict[str, Memory]:
        """Declared memory by path, that of parts below their names."""
        out = dict(self.memories)
        for name, part in self.parts_with_memory().items():
            out |= {f"{name}.{path}": memory for path, memory in part.every_memory().items()}
        return out


class Integral(Remembers):
    """The integral of an error in a law: `PID(kp=, ki=, integral=Integral(anti_windup="none"))`.

    Law:          e_int' = e_int + e dt, which includes the error of this tick, as in the chapter's pseudocode
                  "clamping" (conditional integration): an entry rests while limits cut that joint's command and e
                    pushes further into the limit
                  "back-calculation": e_int' = e_int + (e - tracking ki^-1 cut) dt, at rest where ki e = tracking cut
                  "none"; without limits all three are the same, and cost the same

    Args:
        anti_windup: "clamping", "back-calculation" or "none".
        tracking: Rate at which limits drive the integral back, for "back-calculation"; 10 1/s is usual.

    References:
        Astrom and Hagglund, PID Controllers (1995), section 3.5.
    """

    anti_windup: Choice[AntiWindup] = Choice("clamping", "back-calculation", "none")
    tracking: Gain = Gain(unit="1/s", shape="entries", optional=True)
    e_int = Memory(unit="error s")

    def check(self) -> None:
        if (self.anti_windup == "back-calculation") != (self.tracking is not None):
            self.refuse("tracking", "is for anti_windup 'back-calculation', which needs it; give both or neither")

    def check_rate(self, rate: float) -> None:
        """An integral cannot be driven back faster than the rate [Hz]."""
        if self.tracking is not None:
            require_at_most("tracking", self.tracking, rate, "1/s", "or the integral oscillates")

    def step(
        self,
        memory: MemoryView,
        e: Vector,
        dt: Any,
        *,
        ki: GainValue,
        cut: Callable[[], Vector],
        lost: Callable[[], Vector] | None = None,
    ) -> tuple[Vector, dict[str, Any]]:
        """(k,) the integral after this tick, and its new memory, from the error e (k,).

        `cut` and `lost` give what limits took of the command, along e: in its unit, and in that of ki int(e).
        """
        before = memory.e_int
        after: Vector = before + e * dt
        if self.anti_windup == "clamping":
            after = tm.where(cut() * e > 0.0, before, after)
        elif self.anti_windup == "back-calculation":
            after = after - (self.tracking @ solved(ki, (lost or cut)())) * dt
        return after, {"e_int": after}


def require_at_most(name: str, values: Any, maximum: float, unit: str, reason: str) -> None:
    """Refuse numbers above a maximum, such as a rate above the loop's; `reason` is what happens beyond it."""
    largest = float(np.max(np.asarray(values, dtype=np.float64)))
    if largest > maximum:
        raise RangeError(
            f"{name} must be <= {maximum:g} [{unit}], {reason}; got {largest:g}", name=name, value=largest
        )


def solved(ki: GainValue, cut: Vector) -> Vector:
    """(n,) ki^-1 cut; nothing for joints, or in directions, that have no integral."""
    k = ki.as_array()
    if ki.ndim < 2:
        some = tm.where(k > 0.0, k, 1.0)
        out: Vector = tm.where(k > 0.0, cut / some, 0.0 * cut)
        return out
    size = k.shape[0]
    trace = sum(k[i, i] for i in range(size))
    damped = k @ k + ((TRACE_DAMPING * trace) ** 2 + np.finfo(np.float64).tiny) * tm.eye(size)
    inverse: Vector = k @ tm.solve_spd(damped, cut)
    return inverse
