"""The sensors of a plant: pure functions with parameters and memory, like a law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base import math as tm
from taut.base.checks import finite_array, require_at_least
from taut.base.types import ArrayLike, Float64Array, Vector

__all__ = ["Sensors"]

Values = Mapping[str, Any]
SENSOR_FIELDS: Final = ("resolution", "noise_q", "noise_v")


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensors:
    """Joint sensors with resolution and noise. The noise comes from the run's seed.

    Args:
        resolution: (n,) or scalar, step of the position sensor [rad | m]; 0 for none.
        noise_q: (n,) or scalar, standard deviation of the position [rad | m].
        noise_v: (n,) or scalar, standard deviation of the velocity [rad/s | m/s].
    """

    resolution: ArrayLike = 0.0
    noise_q: ArrayLike = 0.0
    noise_v: ArrayLike = 0.0

    def __post_init__(self) -> None:
        for name in SENSOR_FIELDS:
            values = finite_array(f"sensors.{name}", getattr(self, name))
            require_at_least(f"sensors.{name}", values, 0.0)
            object.__setattr__(self, name, values)

    def check_size(self, arm: Arm) -> None:
        """Each number must be a scalar or have one entry per joint.

        Raises:
            ShapeError: One has another size.
        """
        for name in SENSOR_FIELDS:
            values = getattr(self, name)
            if np.ndim(values):
                finite_array(f"sensors.{name}", values, shape=(arm.n,), joints=arm.joint_names)

    @property
    def noisy(self) -> tuple[str, ...]:
        """The measurements that have noise."""
        return tuple(name for name in ("q", "v") if np.any(getattr(self, f"noise_{name}")))

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name: those that are there."""
        names = [f"noise_{name}" for name in self.noisy]
        if np.any(self.resolution):
            names.append("resolution")
        return {name: np.asarray(getattr(self, name), dtype=np.float64) for name in names}

    def read(self, q: Vector, v: Vector, noise: Values, parameters: Values) -> tuple[Vector, Vector]:
        """(n,) measured position and velocity; `noise` holds standard normal numbers by name."""
        if "q" in noise:
            q = q + parameters["noise_q"] * noise["q"]
        if "v" in noise:
            v = v + parameters["noise_v"] * noise["v"]
        if "resolution" in parameters:
            step = parameters["resolution"]
            some = tm.where(step > 0.0, step, 1.0)
            q = tm.where(step > 0.0, some * tm.floor(q / some + 0.5), q)
        return q, v
