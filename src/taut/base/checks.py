"""Checks of the numbers, words and files that a caller hands in, with the error sentences in one place."""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from taut.base.errors import FileError, RangeError, ShapeError, TautError, UsageError, count_of
from taut.base.types import ArrayLike, Float64Array

T = TypeVar("T")

SYMMETRY_TOLERANCE = 1e-9  # relative to the largest entry
MIN_LENGTH = 1e-9  # of a direction


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def entry_names(name: str, index: Sequence[int], joints: Sequence[str] | None = None) -> str:
    """Name of an entry of an array in a message: kp[2], or kp[2] (joint 'elbow')."""
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
        if isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
            raise ShapeError(f"{name} has masked entries{_unit(unit)}; fill them: x.filled(...)", name=name)
        raw = np.asarray(value)
        if raw.dtype.kind not in "fiuO" and raw.size:  # no bools, complex numbers, texts, dates, records
            got = reprlib.repr(value.tolist() if isinstance(value, np.ndarray) else value)
            raise ShapeError(f"{name} must be real numbers{_unit(unit)}; got {got}", name=name, value=value)
        return np.asarray(raw, dtype=np.float64)
    except TautError:
        raise
    except (TypeError, ValueError, OverflowError) as cause:
        raise ShapeError(
            f"{name} must be numbers{_unit(unit)} in a rectangular array; got {value!r}",
            name=name,
            value=value,
        ) from cause


def float_array(
    name: str,
    value: ArrayLike,
    *,
    shape: tuple[int, ...] | None = None,
    unit: str = "",
    joints: Sequence[str] | None = None,
) -> Float64Array:
    """A read-only copy of `value` as floats of the given shape; NaN and infinity pass. Raises ShapeError."""
    array = _as_floats(name, value, unit)
    if shape is not None and array.shape != shape:
        count = f" ({count_of(len(joints), 'joint')})" if joints is not None and shape[:1] == (len(joints),) else ""
        raise ShapeError(
            f"{name} must have shape {shape}{count}{_unit(unit)}; got shape {array.shape}",
            name=name,
            value=value,
        )
    return read_only(array)


def require_range(
    name: str,  # what messages call the numbers
    value: ArrayLike,
    *,
    unit: str = "",
    joints: Sequence[str] | None = None,  # where there is an entry for each
    minimum: float = -math.inf,
    above: float = -math.inf,  # every entry must be greater
    maximum: float = math.inf,
    infinite: bool = False,  # whether infinity is allowed
    hint: str = "",  # what to do instead of zero
) -> None:
    """Every entry is finite and in its range. The RangeError names the first that is not."""
    array = np.asarray(value, dtype=np.float64)
    if array.size and above < array.min() >= minimum and maximum >= array.max() < math.inf:  # and no NaN
        return
    rules = {
        "finite": np.isnan(array) if infinite else ~np.isfinite(array),
        f"> {above:g}": array < above if math.isinf(above) else array <= above,
        f">= {minimum:g}": array < minimum,
        f"<= {maximum:g}": array > maximum,
    }
    for rule, wrong in rules.items():
        if not np.any(wrong):
            continue
        index = [int(i) for i in np.argwhere(np.atleast_1d(wrong))[0]] if array.ndim else []
        own = joints if joints is not None and array.shape == (len(joints),) else None
        number = float(array[tuple(index)])
        tail = f"; {hint}" if hint and number in (0.0, math.inf) else ""
        raise RangeError(
            f"{entry_names(name, index, own)} must be {rule}{_unit(unit)}; got {number!r}{tail}",
            name=name,
            joint=own[index[0]] if own is not None else None,
            value=number,
            rule=rule,
        )


def finite_array(
    name: str,
    value: ArrayLike,
    *,
    shape: tuple[int, ...] | None = None,
    unit: str = "",
    joints: Sequence[str] | None = None,
    minimum: float = -math.inf,
    above: float = -math.inf,
    infinite: bool = False,
) -> Float64Array:
    """A read-only copy of `value` as finite floats of the given shape and range. Raises ShapeError or RangeError."""
    array = float_array(name, value, shape=shape, unit=unit, joints=joints)
    require_range(name, array, unit=unit, joints=joints, minimum=minimum, above=above, infinite=infinite)
    return array


def per_joint(
    name: str,
    value: ArrayLike,
    joints: Sequence[str],
    *,
    unit: str = "",
    above: float = -math.inf,
    infinite: bool = False,
) -> Float64Array:
    """(n,) finite floats in their range, from one number or one for each joint. Raises ShapeError or RangeError."""
    numbers, n = finite_array(name, value, unit=unit, above=above, joints=joints, infinite=infinite), len(joints)
    if numbers.shape not in ((), (n,)):
        raise ShapeError(f"{name} must be one number or {n}, one per joint; got shape {numbers.shape}", name=name)
    return np.broadcast_to(numbers, (n,))


def unit_vector(name: str, direction: ArrayLike) -> Float64Array:
    """(3,) a direction, of length 1. Raises RangeError for one without length."""
    given = finite_array(name, direction, shape=(3,))
    length = float(np.linalg.norm(given))
    if length < MIN_LENGTH:
        raise RangeError(f"{name} must have a length, as [0, 0, 1]; got {given.tolist()}", name=name)
    return read_only(given / length)


def vector(
    name: str, value: ArrayLike, size: int, *, unit: str = "", joints: Sequence[str] | None = None
) -> Float64Array:
    """A finite vector of `size` entries."""
    return finite_array(name, value, shape=(size,), unit=unit, joints=joints)


def finite_scalar(
    name: str, value: object, *, unit: str = "", minimum: float = -math.inf, above: float = -math.inf
) -> float:
    """A finite float in its range."""
    try:
        array = _as_floats(name, value, unit)  # type: ignore[arg-type]  # checked inside
    except ShapeError:
        array = np.empty(0)
    if array.shape != ():
        raise ShapeError(f"{name} must be one number{_unit(unit)}; got {value!r}", name=name, value=value)
    require_range(name, array, unit=unit, minimum=minimum, above=above)
    return float(array)


def positive_scalar(name: str, value: object, *, unit: str = "") -> float:
    """A finite float above zero."""
    return finite_scalar(name, value, unit=unit, above=0.0)


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


def instance_of(name: str, value: object, kind: Any, what: str) -> None:
    """UsageError for a value of another class, from callers without a type checker; `what` names the right one."""
    if not isinstance(value, kind):
        raise UsageError(f"{name} must be {what}; got {type(value).__name__}", name=name, rule=f"is {what}")


def one_of(name: str, value: object, options: Sequence[T]) -> T:
    """One of a few words or whole numbers."""
    for option in options:
        if type(value) is type(option) and value == option:
            return option
    rule = f"must be one of {', '.join(map(repr, options))}"
    raise UsageError(f"{name} {rule}; got {value!r}", name=name, value=value, rule=rule)


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
        if file.stat().st_size == 0:
            raise FileError(f"{kind} '{file}' is empty", name=str(file))
        with file.open("rb"):  # no file descriptor may be left
            pass
    except FileError:
        raise
    except OSError as cause:  # a name that is too long, no permission
        raise FileError(f"{kind} '{file}' cannot be opened: {cause.strerror}", name=str(file)) from cause
    return file


def _beside(file: Path) -> str:
    """The files of the same kind that lie where this one was looked for, for a message."""
    if not file.suffix or not file.parent.is_dir():
        return ""
    near = sorted(other.name for other in file.parent.iterdir() if other.suffix == file.suffix)[:5]
    return f"; '{file.parent}' has {', '.join(repr(name) for name in near)}" if near else ""


def in_compiled_shape(path: str, value: Float64Array, shape: tuple[int, ...]) -> Float64Array:
    """A parameter in its compiled shape: a scalar k serves as k I, one per joint as a diagonal. Raises ShapeError."""
    if value.shape == shape:
        return value
    if value.ndim < len(shape) == 2 and value.shape in ((), shape[:1]):
        return np.eye(shape[0]) * value
    if value.ndim == 0:
        return np.full(shape, float(value))
    raise ShapeError(
        f"{path} was compiled with shape {shape}; got shape {value.shape}; for another shape, compile the law "
        "or make the plant again",
        name=path,
    )
