"""Pushes at the tool: pulses of a wrench."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.base.checks import finite_array, read_only
from taut.base.errors import ShapeError
from taut.base.fields import Choice, Field
from taut.base.types import ArrayLike, Float64Array, Twist, Wrench
from taut.plant.environments.environment import EnvironmentBase
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["Push", "wrench_at_peak"]

Values = Mapping[str, Any]


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


class Push(EnvironmentBase):
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

    peak: Field = Field((0.0, 0.0, 0.0), unit="N, N m", shape=6, accepts=("force",))
    t: Field = Field(math.inf, unit="s", minimum=0.0, infinite=True)
    duration: Field = Field(0.1, unit="s", above=0.0, hint="for no push leave it out")
    shape: Choice[str] = Choice("half-sine", "rectangular")

    @property
    def impulse(self) -> Float64Array:
        """(6,) integral of the wrench over time [N s, N m s]."""
        mean = 1.0 if self.shape == "rectangular" else 2.0 / math.pi
        return np.asarray(self.peak) * float(np.asarray(self.duration)) * mean

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
