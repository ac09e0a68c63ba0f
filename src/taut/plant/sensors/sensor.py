"""What every sensor of a plant is: declared fields, and one pure function from what is true to a reading."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np

from taut.base.fields import Declared
from taut.base.types import Array, Float64Array
from taut.maths.model import Model
from taut.trace import math as tm

__all__ = ["FaultySensor", "Sensor", "Side", "quantised", "saturated"]

Values = Mapping[str, Any]
Side = Literal["link", "motor"]


class Sensor(Declared):
    """Base of sensors, and of your own: declared fields, and one pure function.

    Your own one stands in the place of that which gives the same measurement: `Sensors(position=...)`. Each `Field`
    is a parameter of the plant by its path, sensors.position.NAME. A field that is called `noise` makes the run draw
    standard normal numbers for it in every tick, from the run's seed.

    Example:
        >>> import taut
        >>> import taut.math as tm
        >>> class Resolver(taut.sensors.Sensor):
        ...     ripple: taut.sensors.Field = taut.sensors.Field(unit="rad", shape="n", minimum=0.0)
        ...
        ...     def read(self, model, true, p, noise):
        ...         return true["q"] + p["ripple"] * tm.sin(2.0 * true["q"])
        >>> sensors = taut.sensors.Sensors(position=Resolver(ripple=1e-3))
        >>> float(taut.RigidPlant(taut.load_arm("one_joint"), sensors=sensors).parameters["sensors.position.ripple"])
        0.001
    """

    needs_acceleration: ClassVar[bool] = False
    """Whether `read` looks at true["a"], the joints' acceleration in the last step."""

    def read(self, model: Model, true: Values, p: Values, noise: Array | None) -> Any:
        """The reading; of a sensor with a range a pair: the reading, and 1.0 in a tick in which it is cut, else 0.0.

        Args:
            model: The constants of the true arm, for `taut.dynamics`.
            true: What is true, by name: q, v, tau (of the motors), tau_link, F_ext where something touches the tool,
                q_motor and v_motor where they differ from the link's.
            p: Current values of the fields by name.
            noise: Standard normal numbers, one for each entry; None without a field `noise`.
        """
        raise NotImplementedError

    @property
    def ideal(self) -> bool:
        """Whether it reads the truth at the link."""
        return False


class FaultySensor(Sensor):
    """Base of the sensors that come with taut, which are ideal where no fault is given."""

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name: those that change the reading."""
        own = Declared.parameters(self)
        return {name: x for name, x in own.items() if "." in name or np.any(np.isfinite(x) & (x != 0.0))}

    @property
    def ideal(self) -> bool:
        """Whether it reads the truth at the link."""
        return not self.parameters()

    @staticmethod
    def faulty(x: Array, p: Values, noise: Array | None) -> Array:
        """A quantity with a constant error, noise, and then steps, where they are there."""
        for constant in ("offset", "bias"):
            if constant in p:
                x = x + p[constant]
        if noise is not None:
            x = x + p["noise"] * noise
        return quantised(x, p["resolution"]) if "resolution" in p else x


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
    largest = over[0]
    for each in over[1:]:
        largest = tm.maximum(largest, each)
    return tm.clip(x, -bound, bound), tm.where(largest > 0.0, 1.0, 0.0)
