"""Sensors at the tool: the wrench at the wrist, and the acceleration of the tip."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from taut.arm.description import Arm, Payload
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.quantity import FORCE_AND_MOMENT, Quantity, keep_quantities, six_of
from taut.base.types import Array, ArrayLike, Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues
from taut.maths.wrist import load_wrench, sensor_place
from taut.plant.sensors.readings import reading, saturated

__all__ = ["Accelerometer", "WrenchSensor"]

Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class WrenchSensor:
    """A six-axis force-torque sensor between arm and tool.

    Model:
        reading = the wrench of the environment on the arm + load + bias + noise, cut at +-range: that is what the
        real part does, and a run tells in how many ticks it did
        load = m (g - a_c) and its moment, less I alpha + omega x I omega: weight and inertia of the tool and of the
        plant's payload, where `tool` is given; without it nothing weighs, as if all that had been taken out exactly

    Frames:
        What it gives is F_ext, in world axes at the tool's origin. Bias, noise, range and load are of the sensor's
        own axes and origin, force first: those of `frame`. A driver turns the reading into the world by the
        positions that the arm measures, and so does this: an encoder that is wrong turns it wrongly. Accelerations
        are those of the last step of the integrator, zero before the first, as F_ext is.

    Args:
        bias: (6,) or (force, moment), what it reads without load [N, N m].
        noise: (6,) or (force, moment), standard deviation [N, N m], new in every tick.
        range: (6,) or (force, moment), the most it can read [N, N m], infinity for one without end; None for none.
        tool: What stands beyond the sensor and is part of the arm's own bodies, such as a gripper, in the sensor's
            frame; `taut.Payload()` if that weighs nothing. The plant's payload hangs beyond it too. None for a sensor
            whose reading has no weight in it.
        frame: Where it stands: a frame of the tool's body; the tool's own if None.

    Raises:
        ShapeError: One number for forces and moments.
        RangeError: A range of zero or below, negative noise, NaN.
        UsageError: A tool that is no payload.

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
    tool: Payload | None = None
    frame: str | None = None

    def __post_init__(self) -> None:
        for name, quantity in self.quantities.items():
            if getattr(self, name) is not None:
                values = six_of(f"{self.title}.{name}", quantity, getattr(self, name))
                object.__setattr__(self, name, values)
        tool: Any = self.tool
        if not isinstance(tool, (Payload, type(None))):  # callers without a type checker
            got = type(tool).__name__
            raise UsageError(
                f"{self.title}.tool must be taut.Payload(mass=, com=, inertia=) or None; got {got}", name="tool"
            )

    def size(self, arm: Arm) -> int:  # noqa: ARG002
        """Entries of a reading."""
        return 6

    def tool_numbers(self) -> dict[str, Float64Array]:
        """Run-time parameters of what stands beyond it, by path below the sensor."""
        if self.tool is None:
            return {}
        return {f"tool.{name}": np.asarray(getattr(self.tool, name)) for name in ("mass", "com", "inertia")}

    def read(self, model: Model, true: Values, noise: Array | None, parameters: Values) -> tuple[Array, Any]:
        """(6,) F_ext [N, N m], world axes."""
        F_W = true.get("F_ext", np.zeros(6))
        if not parameters:
            return F_W, None
        place = sensor_place(model.arm, self.frame, "sensors.wrench")
        F_S = place.in_sensor(F_W, dyn.pose(model, true["q"]).R)
        if self.tool is not None:
            tool = PayloadValues.of(subtree(parameters, "tool")).body()
            payload = PayloadValues.of(subtree(true, "payload")).body()
            g, a, omega, alpha = place.motion(model, true["q"], true["v"], true["a"])
            F_S = F_S + load_wrench(tool + place.from_tool(payload), g, a, omega, alpha)
        F_S, cut = reading(F_S, noise, parameters, "bias"), None
        if "range" in parameters:
            F_S, cut = saturated(F_S, parameters["range"])
        return place.in_world(F_S, dyn.pose(model, true["q_read"]).R), cut


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
