"""Declarations of fields: numbers, words, parts and plain values. See `taut.base.fields`, which gives them out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Generic, Literal, NoReturn, Self, TypeVar, overload

import numpy as np

from taut.base.checks import float_array, one_of, read_only, require_range, symmetric_psd, whole_number
from taut.base.errors import RangeError, ShapeError, TautError, UsageError, count_of
from taut.base.types import ArrayLike, Float64Array

T = TypeVar("T")
REQUIRED: Final = object()
Shape = str | int | tuple[int | str, ...]
Joints = Sequence[str] | int | None
IN_WORDS: Final[Mapping[Any, str]] = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "a text",
    dict: "a table",
    Callable: "a function",
}
ShortForm = Literal["scalar", "pair", "force", "matrix"]


class Declaration(Generic[T]):
    """One declared field. Abstract: use Field, Whole, Choice, Part or Plain.

    `convert` makes the value of something shorter, such as a Pose of a point; it raises a TautError.
    """

    run_time: bool = False
    unit: str = ""

    def __init__(
        self,
        default: Any = REQUIRED,  # REQUIRED: the field must be given, or is None if `optional`
        *,
        optional: bool = False,
        convert: Callable[[Any], Any] | None = None,
    ) -> None:
        self.default = None if optional and default is REQUIRED else default
        self.optional, self.convert, self.name = optional, convert, ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    if TYPE_CHECKING:  # an instance has the value under the name of its field

        @overload
        def __get__(self, obj: None, owner: type) -> Self: ...
        @overload
        def __get__(self, obj: object, owner: type) -> T: ...
        def __get__(self, obj: object | None, owner: type) -> Any: ...
        def __set__(self, obj: object, value: Any) -> None: ...

    def checked(self, value: Any, owner: Any = None, joints: Joints = None) -> Any:
        """The value as stored, or a TautError that begins with the field's name; `owner` and `joints` know sizes."""
        raise NotImplementedError

    def refuse(self, rule: str, value: object, kind: type[TautError] = UsageError) -> NoReturn:
        """Refuse a value: `self.refuse("must be finite", value)`. Raises the TautError."""
        raise kind(f"{self.name} {rule}", name=self.name, value=value, rule=rule)

    def stored(self, value: Any) -> Any:
        """A checked value, or a symbol in its place, as code reads it."""
        return value

    def taken(self, value: Any, owner: Any = None) -> Any:
        """A given value, converted and checked, as it is stored. Raises TautError."""
        return None if value is None and self.optional else self.stored(self.checked(self.converted(value), owner))

    def converted(self, value: Any) -> Any:
        """The value that `convert` makes of a given one. Raises TautError."""
        if self.convert is None:
            return value
        try:
            return self.convert(value)
        except TautError as cause:
            self.refuse(str(cause).removeprefix(self.name).lstrip(), value, type(cause))


class Field(Declaration[Any]):
    """Numbers with a unit, a range and a shape.

    Args:
        default: Value where none is given; without it the field must be given, or may be None if `optional`.
        unit: Shown in messages and tables.
        shape: "scalar"; "n" for one entry per joint, of which one number alone stands for all; a length (3, 6); the
            name of an attribute of the object with the length, such as "dimensions"; any other name for a length
            that only the owner of the part knows; or the whole shape, (6, 6), with names for lengths of any size.
        accepts: Short forms: "scalar" for all entries (of "n" always), "pair" (linear, angular) for six or
            as two, "force" for six with a moment of zero, "matrix" for a symmetric positive semidefinite matrix.
        minimum: Smallest allowed entry.
        above: Every entry must be greater.
        maximum: Largest allowed entry.
        zero_for_none: Whether some entries may be 0, for joints that have none, though every other is `above` 0.
        infinite: Whether infinity is allowed.
        hint: What to do instead of zero, for the message.
        run_time: Whether it may change between ticks; then it is a parameter by its path.
        optional: Whether it may be None.
        convert: As in `Declaration`.
    """

    def __init__(
        self,
        default: Any = REQUIRED,
        *,
        unit: str = "",
        shape: Shape = "scalar",
        accepts: Iterable[ShortForm] = (),
        minimum: float = -math.inf,
        above: float = -math.inf,
        maximum: float = math.inf,
        zero_for_none: bool = False,
        infinite: bool = False,
        hint: str = "",
        run_time: bool = True,
        optional: bool = False,
        convert: Callable[[Any], Any] | None = None,
    ) -> None:
        super().__init__(default, optional=optional, convert=convert)
        if shape == "n":
            accepts = ("scalar", *accepts)
        self.unit, self.shape, self.accepts, self.run_time = unit, shape, frozenset(accepts), run_time
        self.minimum, self.above, self.maximum = minimum, above, maximum
        self.zero_for_none, self.infinite, self.hint = zero_for_none, infinite, hint

    if TYPE_CHECKING:

        def __set__(self, obj: object, value: ArrayLike | None) -> None: ...

    def stored(self, value: Any) -> Any:
        """An array; a plain number of a scalar that never changes."""
        return value if self.run_time or self.shape != "scalar" else float(value)

    @property
    def unit_words(self) -> str:
        return f" [{self.unit}]" if self.unit else ""

    def size(self, owner: Any, joints: Joints = None) -> int | None:
        """Length of a vector; None while it is not known, as the number of joints before a law meets its arm."""
        if self.shape == "n":
            return len(joints) if isinstance(joints, Sequence) else joints
        if isinstance(self.shape, str):
            return getattr(owner, self.shape, None)
        return self.shape if isinstance(self.shape, int) else None

    def checked(self, value: Any, owner: Any = None, joints: Joints = None) -> Float64Array:
        """The value as floats, read-only, in the shape in which it is stored. Raises TautError."""
        given = float_array(self.name, value.as_array() if hasattr(value, "as_array") else value, unit=self.unit)
        array = self._shaped(given, self.size(owner, joints), joints)
        matrix, some_zero = given.ndim == 2 and "matrix" in self.accepts, self.zero_for_none and given.ndim > 0
        low = {} if matrix else {"minimum": 0.0} if some_zero else {"minimum": self.minimum, "above": self.above}
        require_range(  # messages are about the numbers as they were given
            self.name,
            given,
            unit=self.unit,
            joints=joints if isinstance(joints, Sequence) and self.shape == "n" else None,
            maximum=self.maximum,
            infinite=self.infinite,
            hint=self.hint,
            **low,
        )
        if matrix:
            symmetric_psd(self.name, given, unit=self.unit)
        if some_zero and not given.any():
            hint = f"; {self.hint}" if self.hint else ""
            rule = f"must be > 0 for one entry at least{self.unit_words}; got {given.tolist()}{hint}"
            self.refuse(rule, 0.0, RangeError)
        return array if array is given else read_only(array)

    def check_shape(self, shape: tuple[int, ...], owner: Any, joints: Joints) -> None:
        """Numbers of this shape fit the owner and the joints. Raises ShapeError."""
        self._shaped(np.zeros(shape), self.size(owner, joints), joints)

    def _shaped(self, array: Float64Array, size: int | None, joints: Joints = None) -> Float64Array:
        if "pair" in self.accepts and size == 6 and array.shape == (2,):
            return np.repeat(array, 3)
        if "force" in self.accepts and size == 6 and array.shape == (3,):
            return np.concatenate([array, np.zeros(3)])
        k = size or self.shape
        fits = array.size > 0 and array.ndim > 0 and size in (None, len(array))
        whole, pair = self.shape if isinstance(self.shape, tuple) else (), "pair" in self.accepts
        forms = {  # in words: (taken by this field, true of the array)
            "a number": (self.shape == "scalar" or "scalar" in self.accepts, array.ndim == 0),
            "(linear, angular)": (pair and size in (2, 6, None), size != 6 and array.shape == (2,)),
            "a force (3,)": ("force" in self.accepts, False),
            f"({k},)": (self.shape != "scalar" and not whole and not (pair and size == 2), array.ndim == 1 and fits),
            f"({k}, {k})": ("matrix" in self.accepts, array.ndim == 2 and len(set(array.shape)) == 1 and fits),
            f"({', '.join(map(str, whole))})": (
                bool(whole),
                len(whole) == array.ndim
                and all(isinstance(a, str) or a == b for a, b in zip(whole, array.shape, strict=True)),
            ),
        }
        taken = {words: true for words, (takes, true) in forms.items() if takes}
        if not any(taken.values()):
            *first, last = taken
            words = f"{', '.join(first)} or {last}" if first else last
            got = f"{float(array):g} alone" if array.ndim == 0 else f"shape {array.shape}"
            known = self.shape == "n" and isinstance(joints, Sequence)
            whose = f" for {count_of(size or 0, 'joint')}" if known else ""
            self.refuse(f"must be {words}{self.unit_words}{whose}; got {got}", array, ShapeError)
        return array


class Whole(Declaration[int]):
    """A whole number in a range."""

    def __init__(
        self,
        default: Any = REQUIRED,
        *,
        minimum: int = 0,
        maximum: int | None = None,
        optional: bool = False,
    ) -> None:
        super().__init__(default, optional=optional)
        self.minimum, self.maximum = minimum, maximum

    def checked(self, value: Any, owner: Any = None, joints: Joints = None) -> int:  # noqa: ARG002
        return whole_number(self.name, value, minimum=self.minimum, maximum=self.maximum)


class Choice(Declaration[T]):
    """One of a few words (or whole numbers); the first one is the default.

    Args:
        options: The words.
        optional: Whether it may be None, which is the default then.
    """

    def __init__(self, *options: T, optional: bool = False) -> None:
        super().__init__(None if optional else options[0], optional=optional)
        self.options = options

    def checked(self, value: Any, owner: Any = None, joints: Joints = None) -> Any:  # noqa: ARG002
        return one_of(self.name, value, self.options)


class Part(Declaration[T]):
    """Another object as a field: a declared class, or one of a family such as the laws, of the classes `of`."""

    def __init__(
        self,
        *of: type[T],
        default: Any = REQUIRED,
        optional: bool = False,
        inline: bool = False,  # whether its parameters and memory have the owner's paths, as of a law in a wrapper
        convert: Callable[[Any], Any] | None = None,
    ) -> None:
        super().__init__(default, optional=optional, convert=convert)
        self.of, self.inline = of, inline

    def rule(self) -> str:
        return " or ".join(IN_WORDS.get(kind, f"{_article(kind.__name__)} {kind.__name__}") for kind in self.of)

    def checked(self, value: Any, owner: Any = None, joints: Joints = None) -> Any:  # noqa: ARG002
        wrong = isinstance(value, bool) and bool not in self.of  # a flag is no whole number
        if self.of and (wrong or not isinstance(value, self.of)):
            words = f"{value!r}" if isinstance(value, (str, int, float, type)) else type(value).__name__
            self.refuse(f"must be {self.rule()}; got {words}", value)
        return value


class Plain(Part[T]):
    """A value without a unit: a text, a flag, a whole number, a function; `Plain()` takes anything."""

    def checked(self, value: Any, owner: Any = None, joints: Joints = None) -> Any:
        own = super().checked(value, owner, joints)
        return read_only(own) if isinstance(own, np.ndarray) and own.dtype.kind in "fiu" else own


class Parts(Part[T]):
    """Several objects as a field, kept as a tuple: an array of tables in a file. They have no run-time parameters."""

    def checked(self, value: Any, owner: Any = None, joints: Joints = None) -> Any:
        many = (value,) if isinstance(value, self.of) else value
        if not isinstance(many, (list, tuple)):
            self.refuse(f"must be several of {self.rule()}; got {value!r}", value)
        return tuple(super(Parts, self).checked(one, owner, joints) for one in many)


def _article(word: str) -> str:
    return "an" if word[0] in "AEIOU" else "a"
