"""The drives between command and arm: delay, amplifier, motor, gear."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import RangeError
from taut.base.fields import Declared, Field, Part
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Vector
from taut.plant.drives.drivetrain import Transmission
from taut.plant.drives.motor import IDEAL, MotorInput, MotorModel, MotorStep, TorqueLoop
from taut.trace import math as tm

__all__ = ["Actuation", "Ripple", "delayed"]

Values = Mapping[str, Any]
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

    # ---------------------------------------------------------------- the pure functions

    def start(self, arm: Arm, weight: Vector, parameters: Values) -> dict[str, Any]:
        """The drives' memory at the start: they hold the arm, as its brakes did before, or give all they can."""
        motor, p = self.motor or IDEAL, subtree(parameters, "actuation.motor")
        memory = motor.start(weight, arm.gear, parameters.get("actuation.bandwidth"), p)
        if self.torque_loop is not None:
            memory["torque_loop"] = tm.zeros(arm.n)
        return memory

    def step(
        self, arm: Arm, memory: Values, q: Vector, v: Vector, parameters: Values, dt: Any, added: ArrayLike = 0.0
    ) -> MotorStep:
        """One step, dt long, with motors at q and v (joint units) when it starts, and the memory after it.

        The order is that of the signals: inner loop, resolution, the motor's curve, the lag, ripple. What the plant
        adds to the command itself comes after all of them, but the inner loop's sensor has it too.
        """
        p = subtree(parameters, "actuation")
        tau, error = memory["held"], None
        if self.torque_loop is not None:
            error = tau + added - memory["tau_link"] - parameters.get("sensors.torque.bias", 0.0)
            tau = tau + p["torque_loop.kp"] * error + memory["torque_loop"]
        if self.resolution is not None:
            tau = p["resolution"] * tm.floor(tau / p["resolution"] + 0.5)
        ripple: Any = 1.0
        if self.ripple is not None:
            ripple = 1.0 + p["ripple.amplitude"] * tm.sin(p["ripple.periods"] * arm.gear * q)
        x = MotorInput(
            tau=tau, v=v, gear=arm.gear, ripple=ripple, memory=memory, p=subtree(p, "motor"),
            bandwidth=p.get("bandwidth"), dt=dt,
        )  # fmt: skip
        given = (self.motor or IDEAL).step(x)
        if self.torque_loop is None:
            return given
        grown = memory["torque_loop"] + p["torque_loop.ki"] * dt * error
        integral = tm.where(given.cut * error > 0.0, memory["torque_loop"], grown)
        return dataclasses.replace(given, memory={**given.memory, "torque_loop": integral})


def delayed(command: Vector, line: Any) -> tuple[Vector, Any]:
    """The command of some ticks ago, and the delay line (taps, n) after this tick."""
    if line is None:
        return command, None
    rows = [command, *(line[i] for i in range(len(line)))]
    return rows[-1], tm.stack(rows[:-1])
