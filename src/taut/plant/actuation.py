"""The drives between command and arm: delay, amplifier, motor, gear."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm, CommandKind
from taut.base.errors import RangeError
from taut.base.fields import Declared, Field, Part
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.plant.drivetrain import Transmission
from taut.plant.sensors import quantised
from taut.trace import math as tm

Values = Mapping[str, Any]
MAX_TAPS: Final = 1000
DUE: Final = 1e-3  # [-] of a period of the motors' own loop: rounding of its clock
OF_DRIVES: Final = ("drives.", "saturated.drives")  # begin what of the drives' memory a run records
PARTS: Final = ("motor", "ripple", "transmission", "torque_loop")


def lagged(command: Vector, state: Vector, bandwidth: Any, dt: Any) -> tuple[Vector, Vector]:
    """(n,) mean over dt of a first-order lag's output for a command that is held, exact; and the output after dt."""
    left = tm.exp(-bandwidth * dt)
    mean: Vector = command + (state - command) * ((1.0 - left) / (bandwidth * dt))
    after: Vector = command + (state - command) * left
    return mean, after


@dataclass(frozen=True, kw_only=True)
class MotorInput:
    """What a motor meets in one step."""

    tau: Vector  # (n,) what is asked for, at the joints [N m | N]
    q: Vector  # (n,) joint positions when the step begins [rad | m]
    v: Vector  # (n,) joint speeds [rad/s | m/s]
    gear: Float64Array  # (n,) revolutions of the motor per revolution of the joint
    ripple: Any  # factor of the motor's torque at this position
    memory: Values  # before the step; "held" is the command that stands at the drives
    p: Values  # current values of the fields by name
    bandwidth: Any  # of the amplifier [rad/s]; None for an ideal one
    dt: Any  # length of the step [s]


@dataclass(frozen=True, kw_only=True)
class MotorStep:
    """What the motors did in one step."""

    tau: Vector  # (n,) mean torque at the joints
    memory: dict[str, Any]
    work: dict[str, Vector] = field(default_factory=dict)  # (n,) [J] what it took, and where that went
    cut: Any = 0.0  # what its limits kept back, or something of the same sign


class MotorModel(Declared):
    """Base of motors: declared fields, and pure functions of the joint torque that is asked for.

    A subclass writes `step`; one that remembers something writes `start` too, one behind springs `stiffness`. Each
    `Field` is a parameter of the plant by its path, actuation.motor.NAME.
    """

    @property
    def work(self) -> tuple[str, ...]:
        """Names of `taut.plant.motion.WORK` that `step` gives."""
        return ()

    def start(self, tau: Vector, gear: Float64Array, bandwidth: Any, p: Values) -> dict[str, Any]:  # noqa: ARG002
        """Memory at the start, when the motors hold the arm with tau: of the lag, where there is a bandwidth."""
        return {} if bandwidth is None else {"motor": tau}

    @property
    def kp_at_start(self) -> Float64Array | float:
        """(n,) or scalar, stiffness with which motors that take a MitCommand hold the arm before the first one."""
        return 0.0

    def placed(self, memory: dict[str, Any], q: Vector) -> dict[str, Any]:  # noqa: ARG002
        """Memory at the start, with the joints at q (n,), of motors that have positions of their own."""
        return memory

    def step(self, x: MotorInput) -> MotorStep:
        """What the motors do in one step."""
        raise NotImplementedError

    def braking(self, gear: Float64Array, p: Values) -> Float64Array:  # noqa: ARG002
        """(n,) loss of torque at the joint per speed at the limit [N m s/rad], for the check of steps."""
        return np.zeros(len(gear))

    def stiffness(self, p: Values) -> Float64Array | float:  # noqa: ARG002
        """(n,) or scalar, largest loss of torque at the joint per position [N m/rad], for the check of steps."""
        return 0.0

    def check_with(self, arm: Arm, takes: str, others: Collection[str]) -> None:
        """Refuse an arm, a kind of command, or `others` of the plant's options that do not go with these motors."""


class Motor(MotorModel):
    """The speed-torque curve of motors, at their own shafts; the gear makes of it what the joint sees.

    Law:          -min(peak, stall (1 + omega / no_load)) <= tau_motor <= min(peak, stall (1 - omega / no_load))
                  with omega = gear v, and gear tau_motor at the joint
                  beyond its no-load speed a motor brakes; nowhere is it stronger than its peak

    Args:
        peak: Largest torque, by current or by gear [N m]; unlimited if left out.
        stall: Torque at rest, where the supply's voltage is the limit [N m]. Needs `no_load`.
        no_load: Speed at which no torque is left [rad/s]. Needs `stall`.

    Raises:
        UsageError, RangeError: One of stall and no_load alone; a limit that is not above zero.
    """

    peak: Field = Field(unit="N m", shape="n", above=0.0, optional=True)
    stall: Field = Field(unit="N m", shape="n", above=0.0, optional=True)
    no_load: Field = Field(unit="rad/s", shape="n", above=0.0, optional=True)

    def check(self) -> None:
        """A curve is whole."""
        if (self.stall is None) != (self.no_load is None):
            missing = "no_load" if self.no_load is None else "stall"
            self.refuse(missing, "is missing: a motor's curve needs both stall [N m] and no_load [rad/s], or neither")

    def step(self, x: MotorInput) -> MotorStep:
        """The torque that is asked for within the curve, and again after the lag."""
        tau = self._limited(x.tau, x)
        cut, after = 0.0 if tau is x.tau else x.tau - tau, {}
        if x.bandwidth is not None:
            mean, after["motor"] = lagged(tau, x.memory["motor"], x.bandwidth, x.dt)
            tau = self._limited(mean, x)
        return MotorStep(tau=tau * x.ripple, memory=after, cut=cut)

    def braking(self, gear: Float64Array, p: Values) -> Float64Array:
        """(n,) how much less torque there is at the joint per speed, where the curve is the limit [N m s/rad]."""
        if self.stall is None:
            return np.zeros(len(gear))
        slope: Float64Array = gear**2 * p["stall"] / p["no_load"]
        return slope

    def _limited(self, tau: Vector, x: MotorInput) -> Vector:
        """(n,) a torque at the joint, within the curve at the joints' speeds."""
        high: Any = None
        low: Any = None
        if self.stall is not None:
            share, stall = x.gear * x.v / x.p["no_load"], x.gear * x.p["stall"]
            high, low = stall * (1.0 - share), -stall * (1.0 + share)
        if self.peak is not None:
            peak = x.gear * x.p["peak"]
            high = peak if high is None else tm.clip(high, -peak, peak)
            low = -peak if low is None else tm.clip(low, -peak, peak)
        return tau if high is None else tm.clip(tau, low, high)


IDEAL: Final = Motor()
"""A motor without limits, behind the lag of its amplifier."""


class ElectricMotor(MotorModel):
    """Direct-current (or field-oriented) motors by their electrical numbers, at their own shafts.

    Model:        L di/dt = V - R i - k omega,   tau_motor = k i,   |V| <= voltage, |i| <= current
                  the amplifier's current loop has `Actuation(bandwidth=)`: i follows its target as a first-order lag,
                  or by R and L alone where the voltage saturates; within a step V is held, and i is exact

    Args:
        torque_constant: k [N m/A], which is also the back-EMF constant [V s/rad].
        resistance: R [ohm] of the winding.
        inductance: L [H]; 0 if left out, so that the current is there at once.
        voltage: Largest voltage of the supply [V]; unlimited if left out.
        current: Largest current of the amplifier [A]; unlimited if left out.

    Raises:
        RangeError: A number that is not above zero.
    """

    torque_constant: Field = Field(unit="N m/A", shape="n", above=0.0)
    resistance: Field = Field(unit="ohm", shape="n", above=0.0)
    inductance: Field = Field(
        unit="H", shape="n", above=0.0, optional=True, hint="leave it out where the current is there at once"
    )
    voltage: Field = Field(unit="V", shape="n", above=0.0, optional=True)
    current: Field = Field(unit="A", shape="n", above=0.0, optional=True)

    @property
    def work(self) -> tuple[str, ...]:
        """What it takes, and where that goes; windings without inductance store nothing."""
        stored = () if self.inductance is None else ("magnetic",)
        return ("electric", "copper", *stored, "conversion")

    def start(self, tau: Vector, gear: Float64Array, bandwidth: Any, p: Values) -> dict[str, Any]:  # noqa: ARG002
        """The current that holds the arm, or all that there is."""
        current = tau / (gear * p["torque_constant"])
        if self.current is not None:
            current = tm.clip(current, -p["current"], p["current"])
        return {"current": current}

    def step(self, x: MotorInput) -> MotorStep:
        """The step of a current target; the amplifier does not know the torque's ripple.

        The voltage is held over the step; the current that it drives is exact, and so are its mean and its heat.
        """
        p, bandwidth, dt = x.p, x.bandwidth, x.dt
        constant = x.gear * p["torque_constant"]  # [N m/A] at the joint
        asked, i, k = x.tau / constant, x.memory["current"], constant * x.ripple
        R = p["resistance"]
        target = asked
        if self.current is not None:
            target = tm.clip(target, -p["current"], p["current"])
        goal = target if bandwidth is None else target + (i - target) * tm.exp(-bandwidth * dt)
        emf = k * x.v
        if self.inductance is None:
            mean = goal if bandwidth is None else lagged(target, i, bandwidth, dt)[0]
            after, unlimited = goal, mean
            if self.voltage is not None:
                low, high = (-p["voltage"] - emf) / R, (p["voltage"] - emf) / R
                mean, after = tm.clip(mean, low, high), tm.clip(after, low, high)
            work = {"electric": (emf + R * mean) * mean * dt, "copper": R * mean * mean * dt}
            return MotorStep(
                tau=k * mean, memory={"current": after}, work=work, cut=(asked - target) + (unlimited - mean)
            )
        L = p["inductance"]
        left = tm.exp(-R * dt / L)
        voltage = wanted = emf + R * (goal - i * left) / (1.0 - left)
        if self.voltage is not None:
            voltage = tm.clip(voltage, -p["voltage"], p["voltage"])
        end = (voltage - emf) / R
        deviation = i - end
        after = end + deviation * left
        decay = (1.0 - left) * L / R  # integral of exp(-R t / L) over the step [s]
        charge = end * dt + deviation * decay
        squared = (
            end * end * dt
            + 2.0 * end * deviation * decay
            + deviation * deviation * (1.0 - left * left) * (0.5 * L / R)
        )
        work = {
            "electric": voltage * charge,
            "copper": R * squared,
            "magnetic": 0.5 * L * (after * after - i * i),
        }
        cut = (asked - target) + (wanted - voltage) / R
        return MotorStep(tau=k * charge / dt, memory={"current": after}, work=work, cut=cut)

    def braking(self, gear: Float64Array, p: Values) -> Float64Array:
        """(n,) how much less torque there is at the joint per speed, where the voltage is the limit [N m s/rad]."""
        if self.voltage is None:
            return np.zeros(len(gear))
        slope: Float64Array = (gear * p["torque_constant"]) ** 2 / p["resistance"]
        return slope


class TorqueLoop(Declared):
    """An inner loop around the drive that makes the torque behind gear and friction what was asked for.

    Law:          target = tau + kp (tau - tau_link) + x,   dx/dt = ki (tau - tau_link)
                  once in each step of the integrator, on the joint torque of the last one; x rests while the motor
                  is at its limit and the error would drive it further

    Closed loop:  of friction f before the sensor, f / (1 + kp) is left at once and nothing in the long run:
                  tau_link follows tau with the pole -ki / (1 + kp), where the drive is fast enough;
                  the drive's lag, and one step of delay, limit the gains

    It reads the joint torque sensor at the link, `Sensors(torque=...)`, with its bias, but without noise and steps,
    which are those of the controller's ticks.

    Args:
        kp: Proportional gain [1].
        ki: Integral gain [1/s].

    References:
        Chapter, figure 10.1 (a): local feedback of motor current or joint torque.
    """

    kp: Field = Field(0.0, unit="1", shape="n", minimum=0.0)
    ki: Field = Field(0.0, unit="1/s", shape="n", minimum=0.0)

    def check(self) -> None:
        """It does something."""
        if not np.any(self.kp) and not np.any(self.ki):
            self.refuse("", "needs kp or ki above zero; without a loop leave it out")


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

    Motors that take a `taut.laws.MitCommand` make the torque command by themselves, kp (q - q(t)) + kd (v - v(t)) +
    tau of their own position and velocity, at `inner_rate`.

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
        inner_rate: Rate of the loop in motors that take a MitCommand [Hz], a whole multiple of the control rate; that
            of the integrator's steps if left out.

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
    inner_rate: Field = Field(unit="Hz", above=0.0, optional=True, run_time=False)

    @property
    def acts(self) -> bool:
        """Whether there is anything in it that acts in each step: all but the delay."""
        return self.bandwidth is not None or bool(self.for_torque_only)

    @property
    def for_torque_only(self) -> tuple[str, ...]:
        """The parts that are there which only a torque command goes through."""
        return tuple(name for name in ("resolution", *PARTS) if getattr(self, name) is not None)

    def taps(self, dt: float) -> int:
        """The delay in controller periods; RangeError where it is not a whole number of them."""
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

    def start(self, arm: Arm, q: Vector, weight: Vector, parameters: Values) -> dict[str, Any]:
        """The drives' memory at the start: they hold the arm, as its brakes did before, or give all they can."""
        motor, p = self.motor or IDEAL, subtree(parameters, "actuation.motor")
        memory = motor.placed(motor.start(weight, arm.gear, parameters.get("actuation.bandwidth"), p), q)
        if self.torque_loop is not None:
            memory["torque_loop"] = tm.zeros(arm.n)
        if self.inner_rate is not None:
            memory |= {"inner_tau": weight, "inner_time": 1.0}
        return memory

    def _wanted(self, arm: Arm, memory: Values, q: Vector, v: Vector, dt: Any) -> tuple[Vector, dict[str, Any]]:
        """(n,) the torque of the command that stands at the drives, and the memory of the motors' own loop."""
        held = memory["held"]
        if np.ndim(held) == 1:
            return held, {}
        tau = held[2] * arm.difference(held[0], q) + held[3] * (held[1] - v) + held[4]
        if self.inner_rate is None:
            return tau, {}
        time = memory["inner_time"]  # since the last tick of that loop, in its periods
        due = time > 1.0 - DUE
        tau = tm.where(due, tau, memory["inner_tau"])
        return tau, {"inner_tau": tau, "inner_time": tm.where(due, 0.0, time) + float(self.inner_rate) * dt}

    def step(
        self, arm: Arm, memory: Values, q: Vector, v: Vector, parameters: Values, dt: Any, added: ArrayLike = 0.0
    ) -> MotorStep:
        """One step, dt long, with motors at q and v (joint units) when it starts, and the memory after it.

        The order is that of the signals: inner loop, resolution, the motor's curve, the lag, ripple. What the plant
        adds to the command comes after all of them, but the inner loop's sensor has it too.
        """
        p = subtree(parameters, "actuation")
        tau, inner = self._wanted(arm, memory, q, v, dt)
        error = None
        if self.torque_loop is not None:
            error = tau + added - memory["tau_link"] - parameters.get("sensors.torque.bias", 0.0)
            tau = tau + p["torque_loop.kp"] * error + memory["torque_loop"]
        if self.resolution is not None:
            tau = quantised(tau, p["resolution"])
        ripple: Any = 1.0
        if self.ripple is not None:
            ripple = 1.0 + p["ripple.amplitude"] * tm.sin(p["ripple.periods"] * arm.gear * q)
        x = MotorInput(
            tau=tau, q=q, v=v, gear=arm.gear, ripple=ripple, memory=memory, p=subtree(p, "motor"),
            bandwidth=p.get("bandwidth"), dt=dt,
        )  # fmt: skip
        given = (self.motor or IDEAL).step(x)
        given = dataclasses.replace(given, memory={**given.memory, **inner}) if inner else given
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


def aim(
    takes: CommandKind, arm: Arm, wanted: Vector, q: Vector, v: Vector, bandwidth: Any, dt: Any
) -> tuple[Vector, Vector]:
    """(n,) position and velocity a time dt after q and v, for a command that is held: both are exact.

    Law:          a velocity is followed as a first-order lag, a position as a critically damped second-order one
    """
    if takes == "velocity":
        mean, after = lagged(wanted, v, bandwidth, dt)
        return q + mean * dt, after
    # A continuous joint goes the short way round.
    return settling(-arm.difference(wanted, q), q, v, bandwidth, dt)


def settling(e: Vector, q: Vector, v: Vector, bandwidth: Any, dt: Any) -> tuple[Vector, Vector]:
    """Position and velocity a time dt after q and v, e away from what a critically damped lag follows: both exact."""
    # e(t) = (e0 + (v + omega e0) t) exp(-omega t).
    rate = v + bandwidth * e
    decay = tm.exp(-bandwidth * dt)
    return (q - e) + (e + rate * dt) * decay, (rate - bandwidth * (e + rate * dt)) * decay
