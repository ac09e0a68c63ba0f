"""Drives that take velocities or positions: what their loop aims at, and the torques that get there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm, CommandKind
from taut.base.paths import subtree
from taut.base.types import Float64Array, Vector
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues
from taut.plant.drives.motor import lagged
from taut.plant.step_length import Steps
from taut.trace import math as tm

__all__ = ["INNER", "Follower", "aim"]

Values = Mapping[str, Any]
INNER: Final = 10.0  # bandwidths of the drive: how fast its inner loop is


def aim(
    takes: CommandKind, arm: Arm, wanted: Vector, q: Vector, v: Vector, bandwidth: Any, dt: Any
) -> tuple[Vector, Vector]:
    """(n,) position and velocity a time dt after q and v, for a command that is held: both are exact.

    Law:          a velocity is followed as a first-order lag, a position as a critically damped second-order one
    """
    if takes == "velocity":
        # The exact integral of the exponential approach.
        way = wanted * dt + (v - wanted) * ((1.0 - tm.exp(-bandwidth * dt)) / bandwidth)
        return q + way, lagged(wanted, v, bandwidth, dt)
    # e(t) = (e0 + (v + omega e0) t) exp(-omega t).
    e = -arm.difference(wanted, q)  # a continuous joint goes the short way round
    rate = v + bandwidth * e
    decay = tm.exp(-bandwidth * dt)
    return (q - e) + (e + rate * dt) * decay, (rate - bandwidth * (e + rate * dt)) * decay


@dataclass(frozen=True, kw_only=True, eq=False)
class Follower:
    """A drive's inner loop, for a simulator that moves the arm: torques that make it follow what the drive aims at.

    Law:          tau = M (u_dot + kd (u - v) + kp e) + h + b v+, within the effort of the joints
                  u   the speed of `aim` in a step, e the error of position that is left
                  kp, kd: both poles of e at `INNER` bandwidths, exactly for steps of dt of semi-implicit Euler
    Closed loop:  in free motion v (where velocities are taken) or q (positions) is that of `aim`, to rounding; a
                  torque outside moves a joint as a spring of stiffness kp M and a damper kd M would
                  A joint at its effort waits: e grows no more, and what it aims at stays with it.

    Args:
        arm: The arm.
        takes: "velocity" or "position".
        model: Its constants, without rotors.
    """

    arm: Arm
    takes: CommandKind
    model: Model

    def start(self, q: Vector, v: Vector, parameters: Values, steps: Steps) -> dict[str, Any]:
        """Memory at the start: what it aims at is where the arm is.

        Raises:
            RangeError: Steps that are too long for the inner loop, in which what the arm touches shows a step late.
        """
        bandwidth = np.broadcast_to(parameters["actuation.bandwidth"], (self.arm.n,))
        i = int(np.argmax(bandwidth))
        steps.require(
            INNER * float(bandwidth[i]) * steps.dt,
            "actuation.bandwidth",
            f"the inner loop of the drive of joint '{self.arm.joint_names[i]}', {bandwidth[i]:g} rad/s, is {INNER:g} "
            "times as fast",
            "slower drives",
        )
        return {"drive.q": q, "drive.v": v, "drive.u": v}

    def torque(self, memory: Values, q: Vector, v: Vector, parameters: Values, dt: Any) -> tuple[Vector, Vector, Any]:
        """(n,) torques for a step of dt at q and v, the part that the effort cuts off, and memory after it."""
        bandwidth, held = parameters["actuation.bandwidth"], memory["held"]
        before, u = memory["drive.q"], memory["drive.u"]
        target, speed = aim(self.takes, self.arm, held, before, memory["drive.v"], bandwidth, dt)
        if self.takes == "velocity":
            u_new, target = speed, before + dt * speed
        else:
            u_new = (target - before) / dt
        left = tm.exp(-INNER * bandwidth * dt)
        kd, kp = (1.0 - left * left) / dt, ((1.0 - left) / dt) ** 2
        a = (u_new - u) / dt + kd * (u - v) + kp * (before - q)
        payload = PayloadValues.of(subtree(parameters, "plant.payload"))
        wanted = dyn.inverse_dynamics(self.model, q, v, a, payload)
        if "plant.rotor_inertia" in parameters:
            wanted = wanted + parameters["plant.rotor_inertia"] * a
        if "plant.friction.viscous" in parameters:
            wanted = wanted + parameters["plant.friction.viscous"] * (v + dt * a)
        tau = _within(wanted, self.arm.effort)
        cut = wanted - tau
        waits = cut * (u_new - v) > 0.0
        after = {"drive.q": tm.where(waits, before + dt * v, target), "drive.v": speed, "drive.u": u_new}
        return tau, cut, after


def _within(tau: Vector, effort: Float64Array) -> Vector:
    """(n,) torques, none larger than its joint has."""
    parts = [tm.clip(tau[i], -most, most) if np.isfinite(most) else tau[i] for i, most in enumerate(effort)]
    return tm.array(parts)
