"""Steady: the tool moves on at a constant velocity, as a guarded move does until something stops it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taut.base.checks import finite_scalar, positive_scalar, vector
from taut.base.errors import RangeError
from taut.base.types import ArrayLike, Float64Array
from taut.control.trajectories.task import checked_pose
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.rotation_rows import exp_rows
from taut.trace.pose import Pose

__all__ = ["Steady"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Steady:
    """A motion at a constant velocity without an end, which starts from rest.

    v(t) = V (3 u^2 - 2 u^3) with u = t / ramp, and V from then on. With a phase's guard it is a guarded move: "down
    at 20 mm/s until 2 N" is

        Phase(law, lambda x: Steady(T0=x.T(), velocity=[0, 0, -0.02]), until=lambda x: taut.guards.contact(x, 2.0))

    Args:
        T0: First pose.
        velocity: (3,) of the tool's origin, world axes [m/s].
        angular: (3,) angular velocity, world axes [rad/s]; none if left out.
        ramp: Time to come up to speed [s].

    Raises:
        UsageError: No Pose.
        ShapeError: A wrong number of entries.
        RangeError: No velocity at all, a ramp that is not above zero.

    Example:
        >>> down = Steady(T0=Pose([0.4, 0.0, 0.3]), velocity=[0.0, 0.0, -0.02], ramp=0.1)
        >>> down.at(1.05).p.round(6).tolist(), down.at(1.05).twist[2].item()
        ([0.4, 0.0, 0.28], -0.02)
    """

    T0: Pose
    velocity: ArrayLike = (0.0, 0.0, 0.0)  # (3,) [m/s]
    angular: ArrayLike = (0.0, 0.0, 0.0)  # (3,) [rad/s]
    ramp: float = 0.1  # [s]

    def __post_init__(self) -> None:
        checked_pose("T0", self.T0)
        for name, unit in (("velocity", "m/s"), ("angular", "rad/s")):
            object.__setattr__(self, name, vector(name, getattr(self, name), 3, unit=unit))
        if not np.any(self.velocity) and not np.any(self.angular):
            raise RangeError("velocity or angular must be above zero, or nothing moves; got zeros", name="velocity")
        object.__setattr__(self, "ramp", positive_scalar("ramp", self.ramp, unit="s"))

    def at(self, t: float) -> TaskMotion:
        """The sample at time t [s]."""
        rows = self.rows(np.array([finite_scalar("t", t, unit="s")]))
        return TaskMotion.of({name: getattr(rows, name)[0] for name in TaskMotion.fields(1)})

    def rows(self, times: Float64Array) -> TaskMotion:
        """Samples at many times, as arrays (k, ...)."""
        u = np.clip(times / self.ramp, 0.0, 1.0)[:, np.newaxis]
        late = np.maximum(times - self.ramp, 0.0)[:, np.newaxis]
        way = self.ramp * u**3 * (1.0 - 0.5 * u) + late  # [s] at full speed
        speed, rate = u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u) / self.ramp
        V = np.concatenate([np.asarray(self.velocity), np.asarray(self.angular)])
        return TaskMotion.of(
            {
                "p": self.T0.p + way * V[:3],
                "R": exp_rows(way * V[3:]) @ self.T0.R,
                "twist": speed * V,
                "acceleration": rate * V,
            }
        )
