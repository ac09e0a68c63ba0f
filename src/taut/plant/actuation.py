"""The drives between command and arm: pure functions with parameters and memory, like a law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base import math as tm
from taut.base.checks import finite_scalar, require_at_least
from taut.base.errors import RangeError
from taut.base.types import Float64Array, Vector

__all__ = ["Actuation", "delayed", "lagged", "mean_lagged"]

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
