"""What a caller hands in is checked here, once, and kept as a read-only copy."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from taut.base.errors import FileError, RangeError, ShapeError, TautError, UsageError, count_of
from taut.base.types import ArrayLike, Float64Array

__all__ = [
    "entry_names",
    "finite_array",
    "finite_scalar",
    "float_array",
    "in_compiled_shape",
    "non_negative_scalar",
    "one_of",
    "positive_scalar",
    "rate_in_hertz",
    "read_only",
    "readable_file",
    "require_at_least",
    "require_positive",
    "rounded_up",
    "symmetric",
    "symmetric_psd",
    "vector",
    "whole_number",
]

T = TypeVar("T", bound=str)

SYMMETRY_TOLERANCE = 1e-9  # relative to the largest entry


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _number(value: float) -> str:
    return repr(float(value))


def entry_names(name: str, index: Sequence[int], joints: Sequence[str] | None = None) -> str:
    """How an entry of an array is called in a message: kp[2], or kp[2] (joint 'elbow')."""
    if not len(index):
        return name
    joint = f" (joint '{joints[index[0]]}')" if joints is not None and len(index) == 1 else ""
    return f"{name}[{', '.join(str(int(i)) for i in index)}]{joint}"


def read_only(array: ArrayLike) -> Float64Array:
    """A copy that nobody can write to."""
    copy = np.array(array, dtype=np.float64, order="C")
    copy.flags.writeable = False
    return copy


def _as_floats(name: str, value: ArrayLike, unit: str) -> Float64Array:
    if isinstance(value, (str, bytes)) or value is None:
        raise ShapeError(f"{name} must be numbers{_unit(unit)}; got {value!r}", name=name, value=value)
    try:
        if _is_masked(value):
            raise ShapeError(f"{name} has masked entries{_unit(unit)}; fill them: x.filled(...)", name=name)
        raw = np.asarray(value)
        if raw.dtype.kind not in "fiuO" and raw.size:  # no bools, complex numbers, texts, dates, records
            raise ShapeError(
                f"{name} must be real numbers{_unit(unit)}; got an array of {raw.dtype}",
                name=name,
                value=value,
            )
        return np.asarray(raw, dtype=np.float64)
    except TautError:
        raise
    except (TypeError, ValueError, OverflowError) as cause:
        raise ShapeError(
            f"{name} must be numbers{_unit(unit)} in a rectangular array; got {value!r}",
            name=name,
            value=value,
        ) from cause


def _is_masked(value: object) -> bool:
    subclass = isinstance(value, np.ndarray) and type(value) is not np.ndarray
    return subclass and isinstance(value, np.ma.MaskedArray) and bool(np.ma.getmaskarray(value).any())


def float_array(
    name: str,
    value: ArrayLike,
    *,
    shape: tuple[int, ...] | None = None,
    unit: str = "",
    joints: Sequence[str] | None = None,
) -> Float64Array:
    """A read-only copy of `value` as floats of the given shape; NaN and infinity pass.

    Raises:
        ShapeError: Not numbers, or another shape.
    """
    array = _as_floats(name, value, unit)
    if shape is not None and array.shape != shape:
        count = f" ({count_of(len(joints), 'joint')})" if joints is not None and shape[:1] == (len(joints),) else ""
        raise ShapeError(
            f"{name} must have shape {shape}{count}{_unit(unit)}; got shape {array.shape}",
            name=name,
            value=value,
        )
    return read_only(array)


def finite_array(
    name: str,
    value: ArrayLike,
    *,
    shape: tuple[int, ...] | None = None,
    unit: str = "",
    joints: Sequence[str] | None = None,
    allow_infinite: bool = False,
) -> Float64Array:
    """A read-only copy of `value` as floats, all finite and of the given shape.

    Raises:
        ShapeError: Not numbers, or another shape.
        RangeError: An entry is NaN or infinite; the message names it.
    """
    array = float_array(name, value, shape=shape, unit=unit, joints=joints)
    bad = np.isnan(array) if allow_infinite else ~np.isfinite(array)
    if bad.any():
        index = np.argwhere(bad)[0]
        raise RangeError(
            f"{entry_names(name, index, joints)} must be finite{_unit(unit)}; got {_number(array[tuple(index)])}",
            name=name,
            joint=joints[index[0]] if joints is not None and len(index) == 1 else None,
            value=float(array[tuple(index)]),
            rule="finite",
        )
    return array


def vector(
    name: str,
    value: ArrayLike,
    size: int,
    *,
    unit: str = "",
    joints: Sequence[str] | None = None,
    allow_infinite: bool = False,
) -> Float64Array:
    """A finite vector of `size` entries."""
    return finite_array(name, value, shape=(size,), unit=unit, joints=joints, allow_infinite=allow_infinite)


def finite_scalar(name: str, value: object, *, unit: str = "") -> float:
    """A finite float."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        try:
            array = _as_floats(name, value, unit)  # type: ignore[arg-type]  # checked inside
        except ShapeError:
            array = None
        if array is None or array.shape != () or isinstance(value, bool):
            raise ShapeError(f"{name} must be one number{_unit(unit)}; got {value!r}", name=name, value=value)
        value = float(array)
    number = float(value)
    if not math.isfinite(number):
        raise RangeError(
            f"{name} must be finite{_unit(unit)}; got {number!r}",
            name=name,
            value=number,
            rule="finite",
        )
    return number


def positive_scalar(name: str, value: object, *, unit: str = "") -> float:
    """A finite float above zero."""
    number = finite_scalar(name, value, unit=unit)
    if number <= 0.0:
        raise RangeError(f"{name} must be > 0{_unit(unit)}; got {number!r}", name=name, value=number, rule="> 0")
    return number


def non_negative_scalar(name: str, value: object, *, unit: str = "") -> float:
    """A finite float that is zero or above."""
    number = finite_scalar(name, value, unit=unit)
    require_at_least(name, np.array(number), 0.0, unit=unit)
    return number


def whole_number(name: str, value: object, *, minimum: int = 0, maximum: int | None = None) -> int:
    """A whole number in a range; True and False are none."""
    rule = f">= {minimum}" if maximum is None else f"from {minimum} to {maximum}"
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or value < minimum or (maximum is not None and value > maximum):  # type: ignore[operator]
        raise RangeError(f"{name} must be a whole number {rule}; got {value!r}", name=name, value=value, rule=rule)
    return int(value)  # type: ignore[call-overload,no-any-return]


def rate_in_hertz(value: object) -> float:
    """A rate of ticks [Hz]; a number below 1 is a period in seconds that was taken for one."""
    rate = positive_scalar("rate", value, unit="Hz")
    if rate < 1.0:
        raise RangeError(
            f"rate must be in ticks per second, >= 1 [Hz]; got {rate!r}; a period of {rate:g} s is rate=1/{rate:g}",
            name="rate",
            value=rate,
            rule=">= 1",
        )
    return rate


def _require(
    name: str,
    array: Float64Array,
    good: Callable[[Float64Array], np.ndarray[tuple[int, ...], np.dtype[np.bool_]]],
    rule: str,
    unit: str,
    joints: Sequence[str] | None,
) -> None:
    bad = ~np.atleast_1d(good(array))
    if bad.any():
        index = [int(i) for i in np.argwhere(bad)[0]] if array.ndim else []
        value = float(array[tuple(index)])
        raise RangeError(
            f"{entry_names(name, index, joints)} must be {rule}{_unit(unit)}; got {_number(value)}",
            name=name,
            joint=joints[index[0]] if joints is not None and len(index) == 1 else None,
            value=value,
            rule=rule,
        )


def require_at_least(
    name: str,
    array: Float64Array,
    minimum: float,
    *,
    unit: str = "",
    joints: Sequence[str] | None = None,
) -> None:
    """Every entry is at least `minimum`."""
    _require(name, array, lambda a: a >= minimum, f">= {minimum:g}", unit, joints)


def require_positive(name: str, array: Float64Array, *, unit: str = "", joints: Sequence[str] | None = None) -> None:
    """Every entry is above zero."""
    _require(name, array, lambda a: a > 0.0, "> 0", unit, joints)


def rounded_up(value: float) -> str:
    """A lower bound in four digits that keeps it.

    Example:
        >>> rounded_up(2.50501), rounded_up(2.0), rounded_up(0.0)
        ('2.506', '2', '0')
    """
    if not 0.0 < value < math.inf:
        return f"{value:g}"
    digit = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.ceil(value / digit * (1.0 - 1e-12)) * digit:.4g}"


def symmetric(name: str, matrix: Float64Array, *, unit: str = "") -> float:
    """The largest entry of a matrix that is symmetric within rounding."""
    scale = max(float(np.abs(matrix).max(initial=0.0)), np.finfo(float).tiny)
    skew = float(np.abs(matrix - matrix.T).max(initial=0.0))
    if skew > SYMMETRY_TOLERANCE * scale:
        raise RangeError(
            f"{name} must be a symmetric matrix{_unit(unit)}; it differs from its transpose by {skew:g}",
            name=name,
            value=skew,
            rule="symmetric",
        )
    return scale


def symmetric_psd(name: str, matrix: Float64Array, *, unit: str = "", definite: bool = False) -> None:
    """A symmetric positive semidefinite matrix, within rounding, or a positive definite one."""
    scale = symmetric(name, matrix, unit=unit)
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest < -SYMMETRY_TOLERANCE * scale or (definite and smallest <= 0.0):
        rule = "positive definite" if definite else "positive semidefinite"
        raise RangeError(
            f"{name} must be {rule}{_unit(unit)}; its smallest eigenvalue is {smallest:g}",
            name=name,
            value=smallest,
            rule=rule,
        )


def one_of(name: str, value: object, options: Sequence[T]) -> T:
    """One of a few words."""
    for option in options:
        if value == option:
            return option
    raise UsageError(
        f"{name} must be one of {', '.join(repr(o) for o in options)}; got {value!r}",
        name=name,
        value=value,
    )


def readable_file(kind: str, path: str | os.PathLike[str]) -> Path:
    """A path to a file that exists, is no folder, is not empty and can be read."""
    file = Path(path)
    try:
        if file.is_dir():
            raise FileError(f"{kind} '{file}' is a folder; name a file in it", name=str(file))
        if not file.exists():
            raise FileError(f"{kind} '{file}' does not exist{_beside(file)}", name=str(file))
        if not file.is_file():
            raise FileError(f"{kind} '{file}' is not a regular file", name=str(file))
        if not os.access(file, os.R_OK):
            raise FileError(f"{kind} '{file}' cannot be read; check its permissions", name=str(file))
        if file.stat().st_size == 0:
            raise FileError(f"{kind} '{file}' is empty", name=str(file))
        with file.open("rb"):  # no file descriptor may be left
            pass
    except FileError:
        raise
    except OSError as cause:  # a name that is too long, a folder that may not be searched
        raise FileError(f"{kind} '{file}' cannot be opened: {cause.strerror}", name=str(file)) from cause
    return file


def _beside(file: Path) -> str:
    """The files of the same kind that lie where this one was looked for, for a message."""
    if not file.suffix or not file.parent.is_dir():
        return ""
    near = sorted(other.name for other in file.parent.iterdir() if other.suffix == file.suffix)[:5]
    return f"; '{file.parent}' has {', '.join(repr(name) for name in near)}" if near else ""


def in_compiled_shape(path: str, value: Float64Array, shape: tuple[int, ...]) -> Float64Array:
    """A parameter in the shape it was compiled with: a scalar k serves as k I, one per joint as a diagonal.

    Raises:
        ShapeError: It has more entries than the compiled shape has room for.
    """
    if value.shape == shape:
        return value
    if value.ndim < len(shape) == 2 and value.shape in ((), shape[:1]):
        return np.eye(shape[0]) * value
    if value.ndim == 0:
        return np.full(shape, float(value))
    raise ShapeError(
        f"{path} was compiled with shape {shape}; got shape {value.shape}; compile the law with a value of the "
        "new shape",
        name=path,
    )
