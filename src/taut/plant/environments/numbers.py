"""The numbers of ready-made environments: of forces and moments together, of world axes, and points."""

from __future__ import annotations

import dataclasses
from typing import Any, Final, TypeVar

import numpy as np

from taut.base.checks import finite_array, read_only, symmetric_psd
from taut.base.errors import ShapeError, UsageError
from taut.base.quantity import Quantified, Quantity, keep_quantities
from taut.base.types import Array, ArrayLike, Float64Array
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["Place", "applied", "fastest", "keep_axes", "kept_pose", "replaced", "spatial"]

Place = Pose | ArrayLike | None
AXES: Final = "one number for all three axes, or three for those of the world"
T = TypeVar("T")


def spatial(name: str, value: ArrayLike, unit: str, unit_angular: str) -> Float64Array:
    """A stiffness or damping: one number of the position alone, (linear, angular), six, or a matrix (6, 6).

    Raises:
        ShapeError: Another shape.
        RangeError: Negative, not finite, a matrix that is not symmetric and positive semidefinite.
    """
    units = f"{unit}, {unit_angular}"
    values = finite_array(name, value, unit=unit if np.ndim(value) == 0 else units)
    if values.ndim == 2 and values.shape == (6, 6):
        symmetric_psd(name, values, unit=units)
        return values
    if values.shape not in ((), (2,), (6,)):
        raise ShapeError(
            f"{name} must be one number of the position alone [{unit}], (linear, angular), six, or a matrix (6, 6) "
            f"[{units}]; got shape {values.shape}",
            name=name,
        )
    values = Quantity(unit=unit if values.ndim == 0 else units, rule=">= 0").checked(name, values)
    return read_only(np.repeat(values, 3)) if values.shape == (2,) else values


def applied(gain: Array, six: Any) -> Array:
    """(6,) such a stiffness or damping times a displacement or twist."""
    if np.ndim(gain) == 0:
        return tm.array([*(gain * six[:3]), 0.0, 0.0, 0.0])
    return gain @ six if np.ndim(gain) == 2 else gain * six  # type: ignore[no-any-return]


def fastest(mobility: Float64Array, gain: ArrayLike) -> float:
    """The largest eigenvalue of mobility times a stiffness [1/s^2] or a damping [1/s]."""
    values = np.asarray(gain, dtype=np.float64)
    if values.ndim == 0:
        values = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * values
    matrix = np.diag(values) if values.ndim == 1 else values
    return float(np.max(np.linalg.eigvals(mobility @ matrix).real, initial=0.0))


def keep_axes(thing: Quantified, *names: str) -> None:
    """Check the quantities of an environment that is being made; those named may have three entries, others one."""
    keep_quantities(thing)
    for name in thing.quantities:
        value = getattr(thing, name)
        shape = np.shape(value)
        if value is None or shape == () or (shape == (3,) and name in names):
            continue
        rule = AXES if name in names else "one number"
        unit = thing.quantities[name].unit
        raise ShapeError(f"{thing.title}.{name} must be {rule} [{unit}]; got shape {shape}", name=name)


def kept_pose(name: str, place: Place) -> Pose | None:
    """A pose; a point has the axes of the world."""
    if place is None or isinstance(place, Pose):
        return place
    if isinstance(place, str):
        raise UsageError(f"{name} must be a taut.Pose or a point (3,) [m]; got {place!r}", name=name)
    return Pose(finite_array(name, place, shape=(3,), unit="m"))


def replaced(thing: T, name: str, value: ArrayLike) -> T:
    """A frozen dataclass with another value of a field, or of a field of one of its fields."""
    head, _, rest = name.partition(".")
    new = replaced(getattr(thing, head), rest, value) if rest else value
    return dataclasses.replace(thing, **{head: new})  # type: ignore[type-var]
