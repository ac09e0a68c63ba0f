"""The gains behind error dynamics: of one joint under PID, or under feedback linearisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taut.base.checks import finite_scalar, positive_scalar, require_at_least
from taut.base.types import Float64Array

__all__ = ["JointGains"]


@dataclass(frozen=True, kw_only=True)
class JointGains:
    """One joint and the gains that act on it.

    Model:        M a + b v = tau - tau_dist
    Law:          tau = kp e + ki int(e) + kd e_dot, with M a_des + b v_des if fed forward
    Closed loop:  M e_ddot + (b + kd) e_dot + kp e + ki int(e) = tau_dist + M a_des + b v_des, without the last two
                  if they are fed forward                                                            eq. 10.12

    Args:
        M: Inertia [kg m^2 | kg]; 1 for gains in units of acceleration.
        b: Viscous friction [N m s/rad | N s/m].
        kp: [N m/rad | N/m]; per unit of inertia [1/s^2] where M = 1.
        kd: [N m s/rad | N s/m]; [1/s].
        ki: [N m/(rad s) | N/(m s)]; [1/s^3]. Zero for none.
        fed_forward: Whether the motion's torque is known to the law.
    """

    M: float = 1.0
    b: float = 0.0
    kp: float
    kd: float
    ki: float = 0.0
    fed_forward: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "M", positive_scalar("M", self.M, unit="kg m^2"))
        for name, unit in (("b", "N m s/rad"), ("kp", "N m/rad"), ("kd", "N m s/rad"), ("ki", "N m/(rad s)")):
            value = finite_scalar(name, getattr(self, name), unit=unit)
            require_at_least(name, np.array(value), 0.0, unit=unit)
            object.__setattr__(self, name, value)

    @property
    def coefficients(self) -> Float64Array:
        """Of the characteristic polynomial: (3,), with an integral (4,)."""
        tail = [self.ki] if self.ki else []
        return np.array([self.M, self.b + self.kd, self.kp, *tail])

    @property
    def reference(self) -> Float64Array:
        """Numerator of the error over the desired position."""
        moved = [0.0, 0.0, 0.0] if self.fed_forward else [self.M, self.b, 0.0]
        return np.array([*moved, 0.0] if self.ki else moved)

    @property
    def disturbance(self) -> Float64Array:
        """Numerator of the error over tau_dist."""
        return np.array([1.0, 0.0] if self.ki else [1.0])

    @property
    def largest_ki(self) -> float:
        """(b + kd) kp / M, which ki must be below: the bound of section 10.2.1.1."""
        return (self.b + self.kd) * self.kp / self.M
