"""Sensors at the tool: the wrench at the wrist, and the acceleration of the tip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from taut.arm.description import Arm
from taut.base import math as tm
from taut.base.quantity import Quantity, keep_quantities
from taut.base.types import Array, ArrayLike
from taut.maths import dynamics as dyn
from taut.maths.model import Model
from taut.plant.readings import FORCE_AND_MOMENT, reading, saturated, six_of

__all__ = ["Accelerometer", "WrenchSensor"]

Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class WrenchSensor:
    """A six-axis force-torque sensor between arm and tool, at the tool's origin.

    Model:
        reading = the wrench of the environment on the arm + bias + noise, cut at +-range: that is what the real part
        does, and a run tells in how many ticks it did

    Frames:
        bias, noise and range are of the sensor's own axes, those of the tool, force first; what it gives is F_ext,
        in world axes at the tool's origin, turned there by the tool's true pose. The weight of the tool is no part
        of it.

    Args:
        bias: (6,) or (force, moment), what it reads without load [N, N m].
        noise: (6,) or (force, moment), standard deviation [N, N m], new in every tick.
        range: (6,) or (force, moment), the most it can read [N, N m], infinity for one without end; None for none.

    Raises:
        ShapeError: One number for forces and moments.
        RangeError: A range of zero or below, negative noise, NaN.

    Example:
        >>> WrenchSensor(range=(200.0, 10.0)).range.tolist()
        [200.0, 200.0, 200.0, 10.0, 10.0, 10.0]

    References:
        Chapter, section 10.3 force control, figure 10.15.
    """

    title: ClassVar[str] = "wrench_sensor"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "bias": Quantity(unit=FORCE_AND_MOMENT),
        "noise": Quantity(unit=FORCE_AND_MOMENT, rule=">= 0"),
        "range": Quantity(
            unit=FORCE_AND_MOMENT, rule="> 0", instead="leave it out for a sensor without end", infinite=True
        ),
    }

    bias: ArrayLike | None = None
    noise: ArrayLike | None = None
    range: ArrayLike | None = None

    def __post_init__(self) -> None:
        for name, quantity in self.quantities.items():
            if getattr(self, name) is not None:
                values = six_of(f"{self.title}.{name}", quantity, getattr(self, name))
                object.__setattr__(self, name, values)

    def size(self, arm: Arm) -> int:  # noqa: ARG002
        """Entries of a reading."""
        return 6

    def read(self, model: Model, true: Values, noise: Array | None, parameters: Values) -> tuple[Array, Any]:
        """(6,) F_ext [N, N m], world axes."""
        F_W = true["F_ext"]
        if not parameters:
            return F_W, None
        R_WE = dyn.pose(model, true["q"]).R
        F_E = tm.array([*(R_WE.T @ F_W[:3]), *(R_WE.T @ F_W[3:])])
        F_E, cut = reading(F_E, noise, parameters, "bias"), None
        if "range" in parameters:
            F_E, cut = saturated(F_E, parameters["range"])
        return tm.array([*(R_WE @ F_E[:3]), *(R_WE @ F_E[3:])]), cut


@dataclass(frozen=True, kw_only=True, eq=False)
class Accelerometer:
    """A three-axis accelerometer at the tool's origin.

    Model:
        reading = R_WE^T (a_tool - g) + bias + noise, cut at +-range: the proper acceleration, which is 9.81 m/s^2
        upwards at rest and zero in free fall; a_tool is that of the last step of the integrator, zero before the
        first

    Frames:
        Axes of the tool.

    Args:
        bias: (3,) or scalar, what it reads in free fall [m/s^2].
        noise: (3,) or scalar, standard deviation [m/s^2], new in every tick.
        range: (3,) or scalar, the most it can read [m/s^2]; None for no end.

    Raises:
        RangeError: A range of zero or below, negative noise, NaN.

    References:
        Chapter, section 10.5 impedance control.
    """

    title: ClassVar[str] = "accelerometer"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "bias": Quantity(unit="m/s^2"),
        "noise": Quantity(unit="m/s^2", rule=">= 0"),
        "range": Quantity(unit="m/s^2", rule="> 0", instead="leave it out for a sensor without end", infinite=True),
    }

    bias: ArrayLike = 0.0
    noise: ArrayLike = 0.0
    range: ArrayLike | None = None

    def __post_init__(self) -> None:
        keep_quantities(self)

    def size(self, arm: Arm) -> int:  # noqa: ARG002
        """Entries of a reading."""
        return 3

    def read(self, model: Model, true: Values, noise: Array | None, parameters: Values) -> tuple[Array, Any]:
        """(3,) proper acceleration [m/s^2], axes of the tool."""
        q, v = true["q"], true["v"]
        J, Jdot_v = dyn.jacobian(model, q), dyn.jacobian_rate_v(model, q, v)
        a_W = (J @ true["a"] + Jdot_v)[:3]
        a_E = reading(dyn.pose(model, q).R.T @ (a_W - model.arm.gravity), noise, parameters, "bias")
        return saturated(a_E, parameters["range"]) if "range" in parameters else (a_E, None)
