"""What every sensor of a plant has: numbers that are there or not, and a reading with their faults."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Protocol

import numpy as np

from taut.arm.description import Arm
from taut.base.quantity import Quantified
from taut.base.types import Array, Float64Array
from taut.maths.model import Model
from taut.trace import math as tm

__all__ = ["Sensor", "Side", "at_side", "numbers_of", "reading", "saturated"]

Values = Mapping[str, Any]
Side = Literal["link", "motor"]


class Sensor(Quantified, Protocol):
    """One sensor: a frozen dataclass of numbers, with a pure function for what it gives."""

    def size(self, arm: Arm) -> int:
        """Entries of a reading."""
        ...

    def read(self, model: Model, true: Values, noise: Array | None, parameters: Values) -> tuple[Array, Any]:
        """The reading, and 1.0 where it is cut at the sensor's range; None where it has none.

        Args:
            model: The constants of the true arm.
            true: The plant's memory by name.
            noise: Standard normal numbers, one per entry; None if it has no noise.
            parameters: Its numbers by name: those that are there.
        """
        ...


def numbers_of(sensor: Quantified) -> dict[str, Float64Array]:
    """The numbers of a sensor that change its reading, by name."""
    given = {name: getattr(sensor, name) for name in sensor.quantities}
    return {
        name: np.asarray(value, dtype=np.float64)
        for name, value in given.items()
        if value is not None and np.any(np.isfinite(value) & (value != 0.0))
    }


def at_side(name: str, side: Side, true: Values) -> Array:
    """The true quantity at one side of the transmission, in joint units; rigid ones have it the same at both."""
    value: Array = true.get(f"{name}_motor", true[name]) if side == "motor" else true[name]
    return value


def reading(x: Array, noise: Array | None, parameters: Values, constant: str) -> Array:
    """A quantity with a constant error, noise, and then steps, where they are there."""
    if constant in parameters:
        x = x + parameters[constant]
    if noise is not None:
        x = x + parameters["noise"] * noise
    return quantised(x, parameters["resolution"]) if "resolution" in parameters else x


def quantised(x: Array, step: Array) -> Array:
    """The nearest whole number of steps; an entry of several whose step is zero has none."""
    if np.ndim(step) == 0:  # which is above zero
        nearest: Array = step * tm.floor(x / step + 0.5)
        return nearest
    some = tm.where(step > 0.0, step, 1.0)
    steps: Array = tm.where(step > 0.0, some * tm.floor(x / some + 0.5), x)
    return steps


def saturated(x: Array, limit: Array) -> tuple[Array, Any]:
    """x cut at +-limit, and 1.0 where that took something from any entry, else 0.0."""
    bound = limit + np.zeros(len(x)) if np.ndim(limit) == 0 else limit
    over = tm.abs(x) - bound
    most = over[0]
    for each in over[1:]:
        most = tm.maximum(most, each)
    return tm.clip(x, -bound, bound), tm.where(most > 0.0, 1.0, 0.0)
