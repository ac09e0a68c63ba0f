"""Pushes at the tool: pulses of a wrench."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

import numpy as np

from taut.base.checks import finite_array, one_of, read_only
from taut.base.errors import ShapeError
from taut.base.quantity import Quantity
from taut.base.types import ArrayLike, Float64Array, Twist, Wrench
from taut.plant.environments.environment import NO_RATES, Environment, Environments, added
from taut.plant.environments.numbers import keep_axes, replaced
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["SHAPES", "Push", "wrench_at_peak"]

Values = Mapping[str, Any]
Shape = Literal["half-sine", "rectangular"]
SHAPES: Final[tuple[Shape, ...]] = ("half-sine", "rectangular")


def wrench_at_peak(value: ArrayLike) -> Float64Array:
    """(6,) of a wrench, or of a force alone.

    Raises:
        ShapeError, RangeError: Neither six nor three numbers, or not finite.
    """
    peak = finite_array("push.peak", value, unit="N, N m")
    if peak.shape not in ((3,), (6,)):
        raise ShapeError(
            f"push.peak must be a force (3,) [N] or a wrench (6,), force first [N, N m]; got shape {peak.shape}",
            name="peak",
        )
    return peak if peak.shape == (6,) else read_only(np.concatenate([peak, np.zeros(3)]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Push:
    """A push at the tool's origin: a wrench that comes and goes once.

    Law:          F_ext = peak s((t_now - t) / duration), with s(x) = sin(pi x) or 1 for 0 <= x < 1, else 0
    Closed loop:  of mass Lambda at the tool, and nothing else: V = Lambda^-1 peak duration 2 / pi after a half sine,
                  Lambda^-1 peak duration after a rectangular one

    In each step acts the mean of the pulse over that step, so that its impulse is exact however long the steps are.
    (In the smooth integrator rk4 it comes half a step early.) A push that comes again, or at a time that is not known
    yet, gets another t by an event: see `taut.Event.push`.

    Args:
        peak: (6,) the wrench at its peak, force first, in world axes [N, N m]; three numbers are a force.
        t: When it begins [s]; infinity, for one that waits for an event, if left out.
        duration: How long it takes [s].
        shape: "half-sine" or "rectangular".

    Raises:
        ShapeError, RangeError: Numbers of another shape, not finite, a duration that is not above zero.
        UsageError: Another shape of the pulse.

    Example:
        >>> push = Push(peak=[20.0, 0.0, 0.0], t=1.0, duration=0.1)
        >>> [round(float(x), 3) for x in push.impulse]
        [1.273, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    title: ClassVar[str] = "push"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "t": Quantity(unit="s", rule=">= 0", infinite=True),
        "duration": Quantity(unit="s", rule="> 0", instead="for no push leave it out"),
    }

    peak: ArrayLike = (0.0, 0.0, 0.0)
    t: ArrayLike = math.inf
    duration: ArrayLike = 0.1
    shape: Shape = "half-sine"

    def __post_init__(self) -> None:
        object.__setattr__(self, "peak", wrench_at_peak(self.peak))
        one_of("push.shape", self.shape, SHAPES)
        keep_axes(self)

    @property
    def impulse(self) -> Float64Array:
        """(6,) integral of the wrench over time [N s, N m s]."""
        mean = 1.0 if self.shape == "rectangular" else 2.0 / math.pi
        return np.asarray(self.peak) * float(np.asarray(self.duration)) * mean

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        return {name: np.asarray(getattr(self, name)) for name in ("peak", "t", "duration")}

    def start(self, T_WE: Pose) -> dict[str, Any]:  # noqa: ARG002
        """It remembers nothing."""
        return {}

    def wrench(
        self,
        T_WE: Pose,  # noqa: ARG002
        twist: Twist,  # noqa: ARG002
        t: Any,
        memory: Values,  # noqa: ARG002
        parameters: Values,
        dt: Any,
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm: the mean from t to t + dt."""
        length = parameters["duration"]
        begin, end = (tm.clip((now - parameters["t"]) / length, 0.0, 1.0) for now in (t, t + dt))
        if self.shape == "rectangular":
            share = end - begin
        else:
            share = (tm.cos(math.pi * begin) - tm.cos(math.pi * end)) / math.pi
        return parameters["peak"] * (share * length / dt), {}

    def changed(self, name: str, value: ArrayLike) -> Push:
        """The same with another value of a parameter, checked as when it was made."""
        return replaced(self, name, value)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:  # noqa: ARG002
        """It neither swings nor brakes."""
        return NO_RATES

    def __add__(self, other: Environment) -> Environments:
        return added(self, other)
