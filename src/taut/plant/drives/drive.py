"""One step of the drives: from the command that stands at them to the torque of the motor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from taut.arm.description import Arm
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Vector
from taut.plant.drives.actuation import Actuation
from taut.plant.drives.motor import IDEAL
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
    motor, p = actuation.motor or IDEAL, subtree(parameters, "actuation.motor")
    memory = motor.start(weight, arm.gear, parameters.get("actuation.bandwidth"), p)
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
    ripple: Any = 1.0
    if actuation.ripple is not None:
        ripple = 1.0 + p["ripple.amplitude"] * tm.sin(p["ripple.periods"] * arm.gear * q)
    motor = actuation.motor or IDEAL
    given = motor.step(tau, v, arm.gear, ripple, memory, subtree(p, "motor"), p.get("bandwidth"), dt)
    after |= given.memory
    if actuation.torque_loop is not None:
        grown = memory["torque_loop"] + p["torque_loop.ki"] * dt * error
        after["torque_loop"] = tm.where(given.cut * error > 0.0, memory["torque_loop"], grown)
    return Driven(tau=given.tau, memory=after, work=given.work)
