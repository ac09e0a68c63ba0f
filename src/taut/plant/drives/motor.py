"""Motors: what torque a drive can give at which speed, in general or from its electrical numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from taut.base.errors import UsageError
from taut.base.quantity import Quantity, keep_quantities
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.trace import math as tm

__all__ = ["ElectricMotor", "Motor", "TorqueLoop"]

Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Motor:
    """The speed-torque curve of motors, at their own shafts; the gear makes of it what the joint sees.

    Law:          -min(peak, stall (1 + omega / no_load)) <= tau_motor <= min(peak, stall (1 - omega / no_load))
                  with omega = gear v, and gear tau_motor at the joint
                  beyond its no-load speed a motor brakes; nowhere is it stronger than its peak

    Args:
        peak: Largest torque, by current or by gear [N m]; unlimited if left out.
        stall: Torque at rest, where the supply's voltage is the limit [N m]. Needs `no_load`.
        no_load: Speed at which no torque is left [rad/s]. Needs `stall`.

    Raises:
        UsageError: No limit at all, or one of stall and no_load alone.
        RangeError: A limit that is not above zero.
    """

    title: ClassVar[str] = "actuation.motor"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "peak": Quantity(unit="N m", rule="> 0"),
        "stall": Quantity(unit="N m", rule="> 0"),
        "no_load": Quantity(unit="rad/s", rule="> 0"),
    }

    peak: ArrayLike | None = None
    stall: ArrayLike | None = None
    no_load: ArrayLike | None = None

    def __post_init__(self) -> None:
        if (self.stall is None) != (self.no_load is None):
            raise UsageError("a motor's curve needs both stall [N m] and no_load [rad/s], or neither", name="stall")
        if self.peak is None and self.stall is None:
            raise UsageError("Motor needs peak, or stall and no_load, or all three; without limits leave it out")
        keep_quantities(self)

    def braking(self, gear: Float64Array, p: Values) -> Float64Array:
        """(n,) how much less torque there is at the joint per speed, where the curve is the limit [N m s/rad]."""
        if self.stall is None:
            return np.zeros(len(gear))
        slope: Float64Array = gear**2 * p["stall"] / p["no_load"]
        return slope

    def limited(self, tau: Vector, v: Vector, gear: Float64Array, p: Values) -> Vector:
        """(n,) a torque at the joint, within the curve at joint speeds v."""
        high: Any = None
        low: Any = None
        if self.stall is not None:
            share = gear * v / p["no_load"]
            high, low = gear * p["stall"] * (1.0 - share), -gear * p["stall"] * (1.0 + share)
        if self.peak is not None:
            most = gear * p["peak"]
            high = most if high is None else tm.clip(high, -most, most)
            low = -most if low is None else tm.clip(low, -most, most)
        return tm.clip(tau, low, high)  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True, eq=False)
class ElectricMotor:
    """Direct-current (or field-oriented) motors by their electrical numbers, at their own shafts.

    Model:        L di/dt = V - R i - k omega,   tau_motor = k i,   |V| <= voltage, |i| <= current
                  the amplifier's current loop has `Actuation(bandwidth=)`, and asks for the voltage which that takes:
                  where the supply has it, i follows its target as a first-order lag; where not, by R and L alone
                  within a step of the integrator V is held, and i is exact

    Args:
        torque_constant: k [N m/A], which is also the back-EMF constant [V s/rad].
        resistance: R [ohm] of the winding.
        inductance: L [H]; 0 if left out, so that the current is there at once.
        voltage: Largest voltage of the supply [V]; unlimited if left out.
        current: Largest current of the amplifier [A]; unlimited if left out.

    Raises:
        RangeError: A number that is not above zero.
    """

    title: ClassVar[str] = "actuation.motor"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "torque_constant": Quantity(unit="N m/A", rule="> 0"),
        "resistance": Quantity(unit="ohm", rule="> 0"),
        "inductance": Quantity(unit="H", rule="> 0", instead="leave it out where the current is there at once"),
        "voltage": Quantity(unit="V", rule="> 0"),
        "current": Quantity(unit="A", rule="> 0"),
    }

    torque_constant: ArrayLike
    resistance: ArrayLike
    inductance: ArrayLike | None = None
    voltage: ArrayLike | None = None
    current: ArrayLike | None = None

    def __post_init__(self) -> None:
        keep_quantities(self)

    def braking(self, gear: Float64Array, p: Values) -> Float64Array:
        """(n,) how much less torque there is at the joint per speed, where the voltage is the limit [N m s/rad]."""
        if self.voltage is None:
            return np.zeros(len(gear))
        slope: Float64Array = (gear * p["torque_constant"]) ** 2 / p["resistance"]
        return slope

    @property
    def stall(self) -> Float64Array:
        """Torque at rest under the full voltage [N m], at the shaft; inf without a limit."""
        if self.voltage is None:
            return np.full(np.shape(self.torque_constant), np.inf)
        stall: Float64Array = (
            np.asarray(self.torque_constant) * np.asarray(self.voltage) / np.asarray(self.resistance)
        )
        return stall

    @property
    def no_load(self) -> Float64Array:
        """Speed under the full voltage without torque [rad/s], at the shaft; inf without a limit."""
        if self.voltage is None:
            return np.full(np.shape(self.torque_constant), np.inf)
        no_load: Float64Array = np.asarray(self.voltage) / np.asarray(self.torque_constant)
        return no_load


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueLoop:
    """An inner loop around the drive that makes the torque behind gear and friction what was asked for.

    Law:          target = tau + kp (tau - tau_link) + x,   dx/dt = ki (tau - tau_link)
                  once in each step of the integrator, on the joint torque of the last one; x rests while the motor
                  is at its limit and the error would drive it further

    Closed loop:  of friction f before the sensor, f / (1 + kp) is left at once and nothing in the long run:
                  tau_link follows tau with the pole -ki / (1 + kp), where the drive is fast enough
                  what the loop can do ends where it is as fast as the drive: its lag, and one step of delay

    It reads the joint torque sensor at the link: `Sensors(torque=...)`, its bias included; noise and steps of that
    sensor are those of the controller's ticks, and the loop, which is faster, has none.

    Args:
        kp: Proportional gain [1].
        ki: Integral gain [1/s].

    References:
        Chapter, figure 10.1 (a): local feedback of motor current or joint torque.
    """

    title: ClassVar[str] = "actuation.torque_loop"
    quantities: ClassVar[Mapping[str, Quantity]] = {
        "kp": Quantity(unit="1", rule=">= 0"),
        "ki": Quantity(unit="1/s", rule=">= 0"),
    }

    kp: ArrayLike = 0.0
    ki: ArrayLike = 0.0

    def __post_init__(self) -> None:
        keep_quantities(self)
        if not np.any(self.kp) and not np.any(self.ki):
            raise UsageError("TorqueLoop needs kp or ki above zero; without a loop leave it out", name="torque_loop")
