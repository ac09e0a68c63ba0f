"""What a plant adds to a torque command itself, from a model's own formulas."""

from __future__ import annotations

from typing import Any

import numpy as np

from taut.base.types import Array, Vector
from taut.maths import dynamics as dyn
from taut.maths.adds import Adds
from taut.maths.model import Model, PayloadValues

__all__ = ["compensation"]


def compensation(model: Model, adds: Adds, q: Vector, v: Vector, payload: PayloadValues) -> Array:
    """(n,) gravity and Coriolis torques that are added; friction apart, of which none is left then."""
    total: Any = np.zeros(model.n)
    if adds.gravity:
        load = payload
        if adds.load is not None:
            load = PayloadValues(mass=adds.load.mass, com=adds.load.com, inertia=adds.load.inertia)
        total = total + dyn.gravity_torque(model, q, load)
    if adds.coriolis:
        total = total + dyn.bias(model, q, v, payload, gravity=False)
    return total  # type: ignore[no-any-return]
