"""Commands and their named terms: a torque is the sum of what it is made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from taut.base.errors import MatchError, ShapeError, TraceError, UsageError, user_location
from taut.base.types import Array, Float64Array
from taut.trace import math as tm
from taut.trace.array import has_symbols, traced_array


class Terms:
    """A named sum. Linear maps go through it: `x.M @ Terms(P=..., D=...)` maps the sum and each term.

    The sum is computed at once, each term on demand, so that a law pays one `M @` for any number of terms.

    Example:
        >>> a = Terms(P=np.array([1.0, 0.0]), D=np.array([0.0, 2.0]))
        >>> (2.0 * a).total.tolist(), sorted((2.0 * a).parts)
        ([2.0, 4.0], ['D', 'P'])
    """

    __slots__ = ("_parts", "total")
    answers_ufuncs: ClassVar[bool] = True

    def __init__(self, **terms: Any) -> None:
        if not terms:
            raise UsageError("Terms needs one named term at least; got none")
        arrays = {name: _array(name, value) for name, value in terms.items()}
        total, *rest = arrays.values()
        for array in rest:
            total = total + array
        self.total = total
        self._parts: Mapping[str, Array] | Callable[[], dict[str, Array]] = arrays

    @classmethod
    def _of(cls, total: Array, parts: Callable[[], dict[str, Array]]) -> Terms:
        made = cls.__new__(cls)
        made.total = total
        made._parts = parts
        return made

    @classmethod
    def known(cls, total: Array, parts: Mapping[str, Array]) -> Terms:
        """A named sum of which both are known: the terms add up to the total."""
        return cls._of(total, lambda: dict(parts))

    @property
    def parts(self) -> Mapping[str, Array]:
        """Each term by its name; they add up to `total`."""
        if callable(self._parts):
            self._parts = self._parts()
        return self._parts

    def mapped(self, linear: Callable[[Array], Array]) -> Terms:
        """A linear map of the sum, and of each term."""
        return Terms._of(linear(self.total), lambda: {name: linear(part) for name, part in self.parts.items()})

    def up_to(self, total: Array, rest: str) -> Terms:
        """These terms and one more, called `rest`, with which they add up to `total`."""
        return Terms._of(total, lambda: {**self.parts, rest: total - self.total})

    def _plus(self, other: Any, sign: float) -> Terms:
        if not isinstance(other, Terms):
            raise _final(other) if isinstance(other, Command) else _unnamed(other)

        def parts() -> dict[str, Array]:
            out = dict(self.parts)
            for name, part in other.parts.items():
                part = part if sign > 0.0 else -part
                out[name] = out[name] + part if name in out else part
            return out

        total = self.total + other.total if sign > 0.0 else self.total - other.total
        return Terms._of(total, parts)

    def __add__(self, other: Any) -> Terms:
        return self._plus(other, 1.0)

    def __sub__(self, other: Any) -> Terms:
        return self._plus(other, -1.0)

    def __radd__(self, other: Any) -> Terms:
        raise _unnamed(other)

    __rsub__ = __radd__

    def __neg__(self) -> Terms:
        return self.mapped(lambda x: -x)

    def __mul__(self, factor: Any) -> Terms:
        return self.mapped(lambda x: x * factor)

    __rmul__ = __mul__

    def __truediv__(self, divisor: Any) -> Terms:
        return self.mapped(lambda x: x / divisor)

    def __rmatmul__(self, matrix: Any) -> Terms:
        return self.mapped(lambda x: matrix @ x)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **_: Any) -> Any:
        if method == "__call__" and len(inputs) == 2:
            left, right = inputs
            if ufunc is np.matmul and right is self:
                return self.__rmatmul__(left)
            if ufunc is np.multiply:
                return self * (left if right is self else right)
            if ufunc is np.divide and left is self:
                return self / right
            if ufunc in (np.add, np.subtract):
                raise _unnamed(left if right is self else right)
        raise UsageError(
            f"np.{ufunc.__name__} is no linear map, so it cannot go through named terms "
            f"at {user_location()}; apply it to .total and name the result"
        )

    def __repr__(self) -> str:
        return f"Terms({', '.join(self.parts)})"


def _array(name: str, value: Any) -> Array:
    if isinstance(value, Terms):
        raise UsageError(f"term '{name}' is itself a named sum; add the two: Terms(...) + Terms(...)")
    return as_array(value, f"term '{name}'")


def as_array(value: Any, name: str) -> Array:
    """A value of a term or of memory as an array of numbers or symbols; TraceError where it is none."""
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


def _unnamed(value: Any) -> UsageError:
    return UsageError(
        f"an unnamed {type(value).__name__} is added to named terms at {user_location()}; "
        "give it a name: + Terms(friction=...)"
    )


def _final(value: Any) -> UsageError:
    kind = type(value).__name__
    return UsageError(
        f"a {kind} is what a law returns, and is used in a formula at {user_location()}; add and map Terms, and make "
        f"the {kind} last: {kind}(x.M @ Terms(P=...) + Terms(h=...))"
    )


class Command:
    """Named terms of one kind of command, as a law returns them: Torque, Velocity, Position or MitCommand."""

    __slots__ = ("terms",)
    kind: ClassVar[str]
    unit: ClassVar[str]

    def __init__(self, terms: Terms | None = None, /, **named: Any) -> None:
        if terms is not None and not isinstance(terms, Terms):
            raise UsageError(
                f"{type(self).__name__} takes named terms at {user_location()}; got an unnamed "
                f"{type(terms).__name__}; write {type(self).__name__}(feedforward=...)"
            )
        if terms is None:
            self.terms = Terms(**named)
        else:
            self.terms = terms + Terms(**named) if named else terms

    @property
    def total(self) -> Array:
        """(n,) the command itself."""
        return self.terms.total

    def _refuse(self, *_: Any, **__: Any) -> Any:
        raise _final(self)

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __matmul__ = __rmatmul__ = __neg__ = _refuse
    __array_ufunc__ = _refuse


class Torque(Command):
    """A joint torque or force command (n,) [N m | N], as the sum of its named terms.

    Example:
        >>> Torque(P=np.array([1.0]), D=np.array([0.5])).total.tolist()
        [1.5]
    """

    kind = "torque"
    unit = "N m | N"


class Velocity(Command):
    """A joint velocity command (n,) [rad/s | m/s], for arms whose drives close the velocity loop."""

    kind = "velocity"
    unit = "rad/s | m/s"


class Position(Command):
    """A joint position command (n,) [rad | m], for arms whose drives close the position loop."""

    kind = "position"
    unit = "rad | m"


class MitCommand(Command):
    """Five numbers for each joint, of which its motor makes the torque by itself between ticks (MIT-type motors).

    Law:          tau_motor(t) = kp (q - q(t)) + kd (v - v(t)) + tau, at the motor's own rate

    Limits, records and named terms are those of the torque in the instant of the tick: of the law's terms, which are
    those of tau, with P and D of the motor's gains.

    Args:
        q: (n,) position that the motor's spring pulls to [rad | m].
        v: (n,) velocity that its damper pulls to [rad/s | m/s].
        kp: (n,) or scalar, stiffness of the motor [N m/rad | N/m].
        kd: (n,) or scalar, its damping [N m s/rad | N s/m].
        tau: Feed-forward torque, as `Terms` or as an array (n,) [N m | N].

    Example:
        >>> command = MitCommand(q=[0.5], v=[0.0], kp=20.0, kd=1.0, tau=Terms(gravity=[2.0]))
        >>> command.total.tolist(), command.kp.tolist()
        ([2.0], [20.0])
    """

    __slots__ = ("kd", "kp", "q", "v")
    q: Array
    v: Array
    kp: Array
    kd: Array
    kind = "mit"
    unit = "N m | N"

    def __init__(self, *, q: Any, v: Any, kp: Any, kd: Any, tau: Any) -> None:
        super().__init__(tau if isinstance(tau, Terms) else Terms(feedforward=tau))
        for name, value in {"q": q, "v": v, "kp": kp, "kd": kd}.items():
            array = as_array(value, name)
            if array.shape not in ((), self.total.shape):
                raise ShapeError(
                    f"MitCommand: {name} must have shape {self.total.shape}, as tau; got {array.shape}", name=name
                )
            setattr(self, name, array * np.ones(self.total.shape))

    @property
    def rows(self) -> dict[str, Array]:
        """What it has besides the terms of its torque, each (n,)."""
        return {name: getattr(self, name) for name in self.__slots__}

    def feedback(self, x: Any) -> Terms:
        """The torque of the motor's gains at a snapshot."""
        return Terms(P=self.kp * x.difference(self.q), D=self.kd * (self.v - x.v))

    def sent(self, x: Any, tau: Array) -> Array:
        """(5, n) q, v, kp, kd and feed-forward torque with which the motors give tau (n,) at a snapshot."""
        return tm.stack([self.q, self.v, self.kp, self.kd, tau - self.feedback(x).total])


def of_kind(kind: type[Command], terms: Terms, rows: Mapping[str, Array]) -> Command:
    """A command of some kind: of its terms, and of the rows that a MitCommand has besides."""
    return MitCommand(tau=terms, **rows) if kind is MitCommand else kind(terms)


def rows_of(command: Command) -> dict[str, Array]:
    """The rows that a MitCommand has besides its terms; none of others."""
    return command.rows if isinstance(command, MitCommand) else {}


def one_kind(commands: Mapping[str, Command], who: str) -> type[Command]:
    """The kind of command that all of several laws give; MatchError where they give several."""
    kind, *others = {type(command) for command in commands.values()}
    if others:
        words = ", ".join(f"'{name}' a {command.kind}" for name, command in commands.items())
        raise MatchError(f"{who} must give commands of one kind; these give {words}", name=who)
    return kind


class WildTerm(NamedTuple):
    """A term of a command that is not finite."""

    name: str
    joint: int
    value: float


def wild_term(terms: Mapping[str, Float64Array]) -> WildTerm | None:
    """The first of some terms, each (n,), that is not finite; those of the law stand before those of the limits."""
    for name, values in terms.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            return WildTerm(name, int(bad[0]), float(values[bad[0]]))
    return None
