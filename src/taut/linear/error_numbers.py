"""The numbers that error dynamics have in continuous time and at a servo rate: gains, ratios, those of a step."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array
from taut.linear.joint_gains import JointGains
from taut.linear.linear_response import StepShape
from taut.linear.poles import damping_ratios

__all__ = ["ErrorNumbers"]


class ErrorNumbers(ABC):
    """What is read off the gains, the poles and the step of error dynamics, whichever time they are in."""

    @property
    @abstractmethod
    def gains(self) -> JointGains:
        """The joint and its gains."""

    @property
    @abstractmethod
    def s_poles(self) -> NDArray[np.complex128]:
        """(n,) poles in s [1/s]."""

    @property
    @abstractmethod
    def step(self) -> StepShape:
        """Overshoot, settling, rise and peak of the error after a step."""

    @property
    def kp(self) -> float:
        """Proportional gain: [N m/rad], or [1/s^2] where no inertia was given."""
        return self.gains.kp

    @property
    def kd(self) -> float:
        """Derivative gain: [N m s/rad], or [1/s]."""
        return self.gains.kd

    @property
    def ki(self) -> float:
        """Integral gain: [N m/(rad s)], or [1/s^3]."""
        return self.gains.ki

    @property
    def largest_ki(self) -> float:
        """(b + kd) kp / M, which ki must be below (figure 10.7)."""
        return self.gains.largest_ki

    @property
    def damping_ratios(self) -> Float64Array:
        """(n,) -Re(s) / abs(s) of each pole."""
        return damping_ratios(self.s_poles)

    @property
    def natural_frequencies(self) -> Float64Array:
        """(n,) abs(s) of each pole [rad/s]."""
        made: Float64Array = np.abs(self.s_poles)
        return made

    @property
    def overshoot(self) -> float:
        """[%] of the step, below figure 10.4, sampled at the ticks; NaN if it does not settle."""
        return self.step.overshoot

    @property
    def settling_time(self) -> float:
        """[s] exact, sampled that of a tick: from then on the error is within 2 % of the step; infinite if never."""
        return self.step.settling_time

    @property
    def rise_time(self) -> float:
        """[s] from 90 % to 10 % of the error."""
        return self.step.rise_time

    @property
    def peak_time(self) -> float:
        """[s] of the largest overshoot; NaN if there is none."""
        return self.step.peak_time
