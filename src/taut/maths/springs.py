"""Two non-linear springs that pull a joint against each other: its torque, and its stiffness apart from it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError, ShapeError
from taut.base.fields import Declared, Field
from taut.trace import math as tm

ROUNDING: Final = 1e-9  # [-] of 4 a c


class AntagonisticSprings(Declared):
    """Two tendons with quadratic springs, f = a d^2, that pull a joint against each other.

    Model:        d_1, d_2 = max(c +- phi, 0), with the pretension c and the deflection phi = equilibrium - q
                  tau = a (d_1^2 - d_2^2) = 4 a c phi, and d tau / d phi = 4 a c whatever the load, while |phi| < c
                  energy = a (d_1^3 + d_2^3) / 3 = (2 a / 3) (c^3 + 3 c phi^2)
                  beyond, one tendon is slack, and the other hardens: tau = a (c + |phi|)^2 sgn phi

    So the torque is linear up to 4 a c^2 = stiffness^2 / (4 a), and stiffness costs both motors a holding torque of
    a (c +- phi)^2.

    Args:
        a: Of each spring, at the joint.
        c_min: Smallest pretension.
        c_max: Largest pretension.

    Raises:
        RangeError: A number that is not above zero, or a largest pretension below the smallest.

    Example:
        >>> springs = AntagonisticSprings(a=40.0, c_min=0.25, c_max=0.75)
        >>> [float(x) for x in springs.stiffness_range], float(springs.max_torque(80.0))
        ([40.0, 120.0], 40.0)

    References:
        Palli, Melchiorri and De Luca, On the feedback linearization of robots with variable joint stiffness, IEEE
        ICRA (2008). Vanderborght et al., Variable impedance actuators: a review, Robotics and Autonomous Systems 61
        (12), 2013.
    """

    a: Field = Field(unit="N m/rad^2 | N/m^2", shape="n", above=0.0)
    c_min: Field = Field(unit="rad | m", shape="n", above=0.0)
    c_max: Field = Field(unit="rad | m", shape="n", above=0.0)

    def check(self) -> None:
        """A range has its limits in order."""
        for _, least, most in _entries(self.a, self.c_min, self.c_max):
            if most < least:
                self.refuse("c_max", f"must be >= c_min, {least:g} [rad | m]; got {most:g}; swap them", RangeError)

    def require_reached(self, owner: Declared, field: str, stiffness: Any) -> None:
        """RangeError about an owner's field for a stiffness (n,) that these springs do not give."""
        for i, (k, low, high) in enumerate(_entries(stiffness, *self.stiffness_range)):
            if not low * (1.0 - ROUNDING) <= k <= high * (1.0 + ROUNDING):
                where = f" for joint {i}" if np.ndim(stiffness) else ""
                owner.refuse(
                    field,
                    f"must be within what the springs give, {low:g} to {high:g} [N m/rad | N/m]; got {k:g}{where}; "
                    "other springs (a), or another range of pretension (c_min, c_max), give others",
                    RangeError,
                )

    @property
    def stiffness_range(self) -> tuple[Any, Any]:
        """Smallest and largest stiffness [N m/rad | N/m]."""
        return 4.0 * self.a * self.c_min, 4.0 * self.a * self.c_max

    def pretension(self, stiffness: Any) -> Any:
        """The pretension of a stiffness, within the springs' range [rad | m]."""
        return tm.clip(stiffness / (4.0 * self.a), self.c_min, self.c_max)

    def max_torque(self, stiffness: Any) -> Any:
        """The torque at which one tendon is slack [N m | N]."""
        return stiffness * stiffness / (4.0 * self.a)

    def torque(self, c: Any, phi: Any) -> Any:
        """On the link [N m | N]."""
        one, other = _stretched(c, phi)
        return self.a * (one * one - other * other)

    def stiffness(self, c: Any, phi: Any) -> Any:
        """Torque per deflection [N m/rad | N/m]."""
        one, other = _stretched(c, phi)
        return 2.0 * self.a * (one + other)

    def energy(self, c: Any, phi: Any) -> Any:
        """Stored in both springs [J]."""
        one, other = _stretched(c, phi)
        return self.a * (one**3 + other**3) / 3.0


def _entries(*values: Any) -> Any:
    """(n, k) rows of k numbers, or of k with one for each joint."""
    try:
        return np.stack(np.broadcast_arrays(*(np.atleast_1d(value) for value in values)), axis=1)
    except ValueError as cause:
        sizes = ", ".join(str(np.size(value)) for value in values)
        raise ShapeError(
            f"springs and stiffness must each be one number or one per joint; got {sizes} numbers"
        ) from cause


def _stretched(c: Any, phi: Any) -> tuple[Any, Any]:
    return tm.maximum(c + phi, 0.0), tm.maximum(c - phi, 0.0)
