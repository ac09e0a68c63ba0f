"""The drives between command and arm: delay, amplifier, motor, gear. Pure functions with parameters and memory."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.base.errors import RangeError
from taut.base.fields import Declared, Field, Part
from taut.base.types import Vector
from taut.plant.drives.motor import MotorModel, TorqueLoop
from taut.plant.drives.transmission import Transmission
from taut.trace import math as tm

__all__ = ["Actuation", "Ripple", "delayed"]

MAX_TAPS: Final = 1000
PARTS: Final = ("motor", "ripple", "transmission", "torque_loop")


class Ripple(Declared):
    """Torque ripple: a motor's torque constant that changes along its turn.

    Law:          tau = (1 + amplitude sin(periods gear q)) tau_motor

    Args:
        amplitude: Share of the torque, in [0, 1).
        periods: Periods in one turn of the motor, a whole number: slots, or magnets.
    """

    amplitude: Field = Field(unit="1", shape="n", minimum=0.0)
    periods: Field = Field(unit="1", shape="n", above=0.0)

    def check(self) -> None:
        """A share of the torque, and whole periods."""
        if np.any(self.amplitude >= 1.0):
            most = float(np.max(self.amplitude))
            self.refuse("amplitude", f"must be below 1, a share of the torque; got {most:g}; 5 % is 0.05", RangeError)
        if np.any(self.periods != np.round(self.periods)):
            rule = "must be a whole number: after one turn of the motor its torque is the same again"
            self.refuse("periods", rule, RangeError)


class Actuation(Declared):
    """The drives between command and arm (figure 10.1 a): each part is ideal where it is left out.

    A torque command goes through a pure delay, an inner torque loop, steps of the amplifier's resolution, the motor's
    speed-torque limits, the lag of amplifier and current loop, ripple, and the transmission. The delay is the
    controller's; everything else acts in each step of the integrator.

    A velocity command is what a drive's own loop follows as a first-order lag, a position command as a critically
    damped second-order one; these drives are stiff, so that the arm's dynamics and its load do not show, and have
    a bandwidth and a delay only.

    Args:
        bandwidth: [rad/s] of amplifier and current loop, or of the drive.
        delay: [s], a whole number of the controller's periods.
        resolution: Smallest step of the torque at the joint [N m | N].
        motor: What the motor can do: `taut.drives.Motor` or `taut.drives.ElectricMotor`.
        ripple: Of the motor's torque.
        transmission: Losses, play and elasticity of the gear. Its ratio is the Arm's: `arm.with_gears`.
        torque_loop: An inner loop on the joint torque sensor.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint").with_gears(ratio=100.0, motor_inertia=1e-5)
        >>> drives = taut.drives.Actuation(
        ...     bandwidth=2000.0,
        ...     motor=taut.drives.Motor(peak=0.5, stall=0.6, no_load=500.0),
        ...     transmission=taut.drives.Transmission(efficiency=0.8),
        ... )
        >>> sorted(taut.RigidPlant(arm, actuation=drives).parameters)[:3]
        ['actuation.bandwidth', 'actuation.motor.no_load', 'actuation.motor.peak']
    """

    bandwidth: Field = Field(
        unit="rad/s", shape="n", above=0.0, optional=True, hint="for an ideal torque drive leave it out"
    )
    delay: Field = Field(0.0, unit="s", minimum=0.0, run_time=False)
    resolution: Field = Field(
        unit="N m | N", shape="n", above=0.0, optional=True, hint="for an ideal amplifier leave it out"
    )
    motor: Part[MotorModel | None] = Part(MotorModel, optional=True)
    ripple: Part[Ripple | None] = Part(Ripple, optional=True)
    transmission: Part[Transmission | None] = Part(Transmission, optional=True)
    torque_loop: Part[TorqueLoop | None] = Part(TorqueLoop, optional=True)

    @property
    def acts(self) -> bool:
        """Whether there is anything in it that acts in each step: all but the delay."""
        return self.bandwidth is not None or bool(self.for_torque_only)

    @property
    def for_torque_only(self) -> tuple[str, ...]:
        """The parts that are there which only a torque command goes through."""
        return tuple(name for name in ("resolution", *PARTS) if getattr(self, name) is not None)

    def taps(self, dt: float) -> int:
        """The delay in controller periods.

        Raises:
            RangeError: It is not a whole number of them.
        """
        taps = float(self.delay) / dt
        whole = abs(taps - round(taps)) <= 1e-6
        if not whole or round(taps) > MAX_TAPS:
            other = "a higher control rate, or taut.error_dynamics(rate=..., delay=...), which takes any"
            way_out = "" if whole else f"; a part of a period needs {other}"
            raise RangeError(
                f"actuation.delay must be a whole number of control periods of {dt:g} s, at most {MAX_TAPS}; "
                f"got {float(self.delay):g} s{way_out}",
                name="actuation.delay",
                value=float(self.delay),
            )
        return round(taps)


def delayed(command: Vector, line: Any) -> tuple[Vector, Any]:
    """The command of some ticks ago, and the delay line (taps, n) after this tick."""
    if line is None:
        return command, None
    rows = [command, *(line[i] for i in range(len(line)))]
    return rows[-1], tm.stack(rows[:-1])
