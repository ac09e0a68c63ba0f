"""One step of the drives: from the command that stands at them to the torque of the motor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from taut.arm.description import Arm
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Vector
from taut.plant.drives.actuation import Actuation, mean_lagged
from taut.plant.drives.motor import ElectricMotor
from taut.trace import math as tm

__all__ = ["Driven", "driven", "start"]

Values = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Driven:
    """What the drives did in one step."""

    tau: Vector  # (n,) mean torque of the motors at the joints
    memory: dict[str, Any]  # by path
    work: dict[str, Vector]  # (n,) [J] of an electric motor: what it took, and where that went


def start(actuation: Actuation, arm: Arm, weight: Vector, parameters: Values) -> dict[str, Any]:
    """The drives' memory at the start: they hold the arm, as its brakes did before, or give all they can."""
    memory: dict[str, Any] = {}
    if isinstance(actuation.motor, ElectricMotor):
        current = weight / (arm.gear * parameters["actuation.motor.torque_constant"])
        if actuation.motor.current is not None:
            most = parameters["actuation.motor.current"]
            current = tm.clip(current, -most, most)
        memory["current"] = current
    elif actuation.bandwidth is not None:
        memory["motor"] = weight
    if actuation.torque_loop is not None:
        memory["torque_loop"] = tm.zeros(arm.n)
    return memory


def driven(
    actuation: Actuation,
    arm: Arm,
    memory: Values,
    q: Vector,
    v: Vector,
    parameters: Values,
    dt: Any,
    added: ArrayLike = 0.0,
) -> Driven:
    """One step, dt long, with motors at q and v (joint units) when it starts.

    The order is that of the signals: inner loop, resolution, the motor's curve, the lag, ripple. What the plant adds
    to the command itself comes after all of them, but the inner loop's sensor has it too.
    """
    p = subtree(parameters, "actuation")
    after: dict[str, Any] = {}
    tau, error = memory["held"], None
    if actuation.torque_loop is not None:
        error = tau + added - memory["tau_link"] - parameters.get("sensors.torque.bias", 0.0)
        tau = tau + p["torque_loop.kp"] * error + memory["torque_loop"]
    if actuation.resolution is not None:
        tau = p["resolution"] * tm.floor(tau / p["resolution"] + 0.5)
    swing: Any = 1.0
    if actuation.ripple is not None:
        swing = 1.0 + p["ripple.amplitude"] * tm.sin(p["ripple.periods"] * arm.gear * q)
    work: dict[str, Vector] = {}
    cut: Any = 0.0  # what the motor's limits keep back, or something of the same sign
    motor, bandwidth = subtree(p, "motor"), p.get("bandwidth")
    if isinstance(actuation.motor, ElectricMotor):
        k = arm.gear * motor["torque_constant"]  # [N m/A] at the joint; of its ripple the amplifier knows nothing
        tau, after["current"], work, cut = _electric(
            actuation.motor, tau / k, memory["current"], v, k * swing, motor, bandwidth, dt
        )
    else:
        if actuation.motor is not None:
            cut = tau
            tau = actuation.motor.limited(tau, v, arm.gear, motor)
            cut = cut - tau
        if bandwidth is not None:
            tau, after["motor"] = mean_lagged(tau, memory["motor"], bandwidth, dt)
            if actuation.motor is not None:
                tau = actuation.motor.limited(tau, v, arm.gear, motor)
        tau = tau * swing
    if actuation.torque_loop is not None:
        grown = memory["torque_loop"] + p["torque_loop.ki"] * dt * error
        after["torque_loop"] = tm.where(cut * error > 0.0, memory["torque_loop"], grown)
    return Driven(tau=tau, memory=after, work=work)


def _electric(
    motor: ElectricMotor, asked: Vector, i: Vector, v: Vector, k: Any, p: Values, bandwidth: Any, dt: Any
) -> tuple[Vector, Vector, dict[str, Vector], Vector]:
    """Mean torque at the joint, the current after the step, the work of the supply, and what its limits kept back.

    What is asked for is a current. The voltage is held over the step; the current that it drives is exact, and so are
    its mean and its heat.
    """
    R = p["resistance"]
    target = asked
    if motor.current is not None:
        target = tm.clip(target, -p["current"], p["current"])
    goal = target if bandwidth is None else target + (i - target) * tm.exp(-bandwidth * dt)
    emf = k * v
    if motor.inductance is None:
        mean = goal if bandwidth is None else mean_lagged(target, i, bandwidth, dt)[0]
        after, unlimited = goal, mean
        if motor.voltage is not None:
            low, high = (-p["voltage"] - emf) / R, (p["voltage"] - emf) / R
            mean, after = tm.clip(mean, low, high), tm.clip(after, low, high)
        work = {"electric": (emf + R * mean) * mean * dt, "copper": R * mean * mean * dt}
        return k * mean, after, work, (asked - target) + (unlimited - mean)
    L = p["inductance"]
    left = tm.exp(-R * dt / L)
    voltage = wanted = emf + R * (goal - i * left) / (1.0 - left)
    if motor.voltage is not None:
        voltage = tm.clip(voltage, -p["voltage"], p["voltage"])
    end = (voltage - emf) / R
    swing = i - end
    after = end + swing * left
    decay = (1.0 - left) * L / R  # integral of exp(-R t / L) over the step [s]
    charge = end * dt + swing * decay
    squared = end * end * dt + 2.0 * end * swing * decay + swing * swing * (1.0 - left * left) * (0.5 * L / R)
    work = {
        "electric": voltage * charge,
        "copper": R * squared,
        "magnetic": 0.5 * L * (after * after - i * i),
    }
    return k * charge / dt, after, work, (asked - target) + (wanted - voltage) / R
