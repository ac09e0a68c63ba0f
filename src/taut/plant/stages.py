"""The stages around a rigid plant: sensors before the controller, actuation and environment behind it.

Each is a pure function with parameters and memory, like a law. An environment may be a class of your own with the
methods of `Environment`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from taut.arm.description import Arm
from taut.base import math as tm
from taut.base.checks import finite_array, finite_scalar, require_at_least
from taut.base.errors import RangeError
from taut.base.pose import Pose
from taut.base.types import ArrayLike, Float64Array, Twist, Vector, Wrench

__all__ = ["Actuation", "Environment", "Sensors"]

Values = Mapping[str, Any]
SENSOR_FIELDS: Final = ("resolution", "noise_q", "noise_v")


@runtime_checkable
class Environment(Protocol):
    """What touches the tool. A frozen dataclass of numbers, with a pure function for the wrench.

    The wrench is that of the environment on the arm, force first, in world axes at the tool's origin.
    """

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        ...

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start, from the tool's pose."""
        ...

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the new memory."""
        ...


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


MOST_TAPS: Final = 1000


@dataclass(frozen=True, kw_only=True)
class Actuation:
    """The drives between command and arm: a pure delay, then a bandwidth.

    A torque command reaches the joint through a first-order lag, whose mean over a step of the integrator acts in
    that step. A velocity command is what the drive's own loop follows as a first-order lag, a position command as a
    critically damped second-order one; these drives are stiff, so that the arm's dynamics and its load do not show.

    Args:
        bandwidth: [rad/s] of the lag; None for none, which only a torque drive can have.
        delay: [s], a whole number of the controller's periods.
    """

    bandwidth: float | None = None
    delay: float = 0.0

    def __post_init__(self) -> None:
        if self.bandwidth is not None:
            bandwidth = finite_scalar("actuation.bandwidth", self.bandwidth, unit="rad/s")
            if bandwidth <= 0.0:
                raise RangeError(
                    f"actuation.bandwidth must be > 0 [rad/s]; got {bandwidth!r}; for an ideal torque drive leave it "
                    "out",
                    name="actuation.bandwidth",
                )
        delay = finite_scalar("actuation.delay", self.delay, unit="s")
        require_at_least("actuation.delay", np.asarray(delay), 0.0, unit="s")

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        return {} if self.bandwidth is None else {"bandwidth": np.asarray(float(self.bandwidth))}

    def taps(self, dt: float) -> int:
        """The delay in controller periods.

        Raises:
            RangeError: It is not a whole number of them.
        """
        taps = self.delay / dt
        if abs(taps - round(taps)) > 1e-6 or round(taps) > MOST_TAPS:
            raise RangeError(
                f"actuation.delay must be a whole number of control periods of {dt:g} s, at most {MOST_TAPS}; "
                f"got {self.delay:g} s",
                name="actuation.delay",
                value=self.delay,
            )
        return round(taps)


def delayed(command: Vector, line: Any) -> tuple[Vector, Any]:
    """The command of some ticks ago, and the delay line (taps, n) after this tick."""
    if line is None:
        return command, None
    rows = [command, *(line[i] for i in range(len(line)))]
    return rows[-1], tm.stack(rows[:-1])


def lagged(command: Vector, output: Vector, bandwidth: Any, dt: Any) -> Vector:
    """(n,) output of a first-order lag after dt, exact for a command that is held."""
    moved: Vector = output + (1.0 - tm.exp(-bandwidth * dt)) * (command - output)
    return moved


def mean_lagged(command: Vector, state: Vector, bandwidth: Any, dt: Any) -> tuple[Vector, Vector]:
    """(n,) mean over dt of a first-order lag's output for a command that is held, exact; and the output after dt."""
    left = tm.exp(-bandwidth * dt)
    mean: Vector = command + (state - command) * ((1.0 - left) / (bandwidth * dt))
    after: Vector = command + (state - command) * left
    return mean, after
