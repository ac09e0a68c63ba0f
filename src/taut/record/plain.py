"""Plain values: a dataclass as what JSON has, and back, checked against the annotations of its fields."""

from __future__ import annotations

import dataclasses
import functools
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from taut.base.errors import TautError, UsageError
from taut.trace.pose import Pose

LARGEST_NUMBER: Final = 1e12  # of a length, mass or gain, in SI units
ROTATION_ERROR: Final = 1e-6  # [-] that R R^T may be from the identity

T = TypeVar("T")


def plain(value: Any) -> Any:
    """A value as mappings, lists, texts and numbers; fields that have their default are left out.

    Example:
        >>> plain({"R": np.eye(2), "path": Path("a")})
        {'R': [[1.0, 0.0], [0.0, 1.0]], 'path': 'a'}
    """
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Pose):
        return {"p": value.p.tolist(), "R": value.R.tolist()}
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if dataclasses.is_dataclass(value):
        parts = ((field, getattr(value, field.name)) for field in dataclasses.fields(value))
        return {field.name: plain(x) for field, x in parts if isinstance(x, np.ndarray) or x != field.default}
    raise UsageError(
        f"the info of a run holds numbers, texts, lists, mappings and dataclasses; got {type(value).__name__}",
        name="info",
        value=value,
    )


def restored(kind: type[T], values: Any, name: str) -> T:
    """The inverse of `plain` for a dataclass; ValueError, which calls it `name`, for values that do not fit.

    Its fields are numbers, texts, arrays (`Annotated` with their shape), poses, literals, dataclasses, and tuples and
    mappings of these.
    """
    made: T = _restored(kind, values, name)
    return made


def _restored(kind: Any, value: Any, name: str) -> Any:
    origin, args = get_origin(kind), get_args(kind)
    if kind is Any:
        return value
    if origin is Annotated:
        return _array(value, name, args[1])
    if origin is np.ndarray:
        return _array(value, name)
    if origin in (Union, types.UnionType):
        return None if value is None else _restored(args[0], value, name)
    if origin is Literal and value in args and isinstance(value, str):
        return value
    if origin is tuple and isinstance(value, list):
        each = args[:1] * len(value) if args[-1] is Ellipsis else args
        return tuple(_restored(one, x, f"{name}[{i}]") for i, (one, x) in enumerate(zip(each, value, strict=True)))
    if origin is Mapping and isinstance(value, dict):
        return {key: _restored(args[1], x, f"{name}.{key}") for key, x in value.items()}
    if kind is Pose and isinstance(value, dict):
        return Pose.of(_rotation(value.get("R"), f"{name}.R"), _array(value.get("p"), f"{name}.p", (3,)))
    if dataclasses.is_dataclass(kind) and isinstance(kind, type) and isinstance(value, dict):
        return _dataclass(kind, value, name)
    if kind is float and type(value) in (int, float):
        return float(value)
    if type(value) is kind:
        return value
    raise ValueError(f"{name} has another type than it was written with")


def _dataclass(kind: Any, values: dict[str, Any], name: str) -> Any:
    hints = _hints(kind)
    unknown = [key for key in values if key not in hints]
    if unknown:
        raise ValueError(f"{name} has no entry '{unknown[0][:100]}'")
    parts = {key: _restored(hints[key], x, f"{name}.{key}") for key, x in values.items()}
    try:
        return kind(**parts)
    except (TypeError, TautError) as cause:
        raise ValueError(f"{name} is not what was written: {cause}") from cause


@functools.cache
def _hints(kind: Any) -> Mapping[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _array(value: Any, name: str, shape: tuple[int, ...] | None = None) -> Any:
    """Numbers; of a known shape they are those of kinematics, and finite."""
    try:
        array = np.asarray(value)
    except (ValueError, OverflowError):  # rows of several lengths
        array = np.array("")
    if array.dtype.kind not in "iuf" or np.isnan(array).any() or shape not in (None, array.shape):
        raise ValueError(f"{name} is no array of {'' if shape is None else f'{shape} '}numbers")
    if shape is not None and not (np.abs(array) < LARGEST_NUMBER).all():
        raise ValueError(f"{name} has a number beyond {LARGEST_NUMBER:g}")
    return array.astype(np.float64)


def _rotation(value: Any, name: str) -> Any:
    R = _array(value, name, (3, 3))
    if np.abs(R @ R.T - np.eye(3)).max() > ROTATION_ERROR or np.linalg.det(R) < 0.0:
        raise ValueError(f"{name} is no rotation")
    return R
