"""Variable-stiffness actuators: two motors for each joint, which its springs hold between them."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.fields import Field, Part
from taut.base.paths import subtree
from taut.base.types import Float64Array, Vector
from taut.maths.springs import ROUNDING, AntagonisticSprings
from taut.plant.actuation import MotorInput, MotorModel, MotorStep, Values, settling
from taut.trace import math as tm


class VariableStiffnessActuator(MotorModel):
    """Two position-controlled motors for each joint, behind non-linear springs: they set position and stiffness.

    Model:        motors at mu + c and mu - c: the equilibrium mu of the joint, and the pretension c of its springs
                  tau = springs(c, mu - q) + damping (mu_dot - v), see `taut.drives.AntagonisticSprings`
                  of a `taut.laws.MitCommand` they make c = kp / (4 a), within [c_min, c_max], and
                  mu = q + clip(asked, -+4 a c^2) / (4 a c), with asked = kp (q_des - q) + kd (v_des - v) + tau
                  each motor follows its position and the rate v_des as a critically damped second-order lag of the
                  drives' bandwidth, at no more than `speed`; the spring's torque is fed forward in its loop, so that
                  neither it nor the rotor shows

    The run's column saturated.drives is 1 for a joint whose command is beyond the springs; drives.equilibrium and
    drives.stiffness are of the first step of each tick; work.motor is what the springs do on the links.

    Args:
        springs: Two for each joint.
        speed: Largest speed of each motor, at the joint; unlimited if left out.
        damping: Between motors and link.
        preset: Stiffness with which a run starts, carrying the weight; the middle of the range if left out.

    Raises:
        UsageError: A plant that does not take "mit"; an arm with rotors or gears, since these motors do not move with
            its links; parts of the drives other than bandwidth and delay.

    References:
        Grioli et al., Variable stiffness actuators: the user's point of view, International Journal of Robotics
        Research 34 (6), 2015.
    """

    springs: Part[AntagonisticSprings] = Part(AntagonisticSprings)
    speed: Field = Field(unit="rad/s | m/s", shape="n", above=0.0, optional=True)
    damping: Field = Field(0.0, unit="N m s/rad | N s/m", shape="n", minimum=0.0)
    preset: Field = Field(unit="N m/rad | N/m", shape="n", above=0.0, optional=True, run_time=False)

    def check(self) -> None:
        if self.preset is not None:
            self.springs.require_reached(self, "preset", self.preset)

    @property
    def kp_at_start(self) -> Float64Array:
        """(n,) or scalar stiffness [N m/rad]."""
        low, high = self.springs.stiffness_range
        start: Float64Array = 0.5 * (low + high) if self.preset is None else self.preset
        return start

    def start(self, tau: Vector, gear: Float64Array, bandwidth: Any, p: Values) -> dict[str, Any]:  # noqa: ARG002
        """The motors, (2, n), where the springs carry tau, as far as they do."""
        zero = tm.zeros(len(tau))
        k = self.kp_at_start + zero
        c, most = self.springs.pretension(k), self.springs.max_torque(k)
        return {
            "motors.q": _motors(tm.clip(tau, -most, most) / k, c), "motors.v": tm.stack([zero, zero]),
            "drives.equilibrium": zero, "drives.stiffness": k, "saturated.drives": zero,
        }  # fmt: skip

    def placed(self, memory: dict[str, Any], q: Vector) -> dict[str, Any]:
        """The motors about the joints."""
        return {**memory, "motors.q": memory["motors.q"] + q}

    def step(self, x: MotorInput) -> MotorStep:
        """The motors on their way to where the command puts them, and the torque of the springs before that."""
        springs, before, held = self.springs.bound(subtree(x.p, "springs")), x.memory, x.memory["held"]
        kp, (low, high) = held[2], springs.stiffness_range
        c = springs.pretension(kp)
        k = 4.0 * springs.a * c
        most = k * c
        # Stiffness beyond the springs would feed the joint's position back through the lag of the motors.
        asked = x.tau - (1.0 - high / tm.maximum(kp, high)) * (x.tau - held[3] * (held[1] - x.v) - held[4])
        q, target = before["motors.q"], _motors(x.q + tm.clip(asked, -most, most) / k, c)
        if x.bandwidth is None:
            after, rate = target, (target - q) / x.dt
        else:
            after, rate = settling(q - target, q, before["motors.v"] - held[1], x.bandwidth, x.dt)
            after, rate = after + held[1] * x.dt, rate + held[1]
        if self.speed is not None:
            speed = x.p["speed"]
            after, rate = q + tm.clip(after - q, -speed * x.dt, speed * x.dt), tm.clip(rate, -speed, speed)
        c, mu, moved = 0.5 * (q[0] - q[1]), 0.5 * (q[0] + q[1]), 0.5 * (after[0] + after[1])
        beyond = (kp < low * (1.0 - ROUNDING)) | (kp > high * (1.0 + ROUNDING)) | (tm.abs(asked) > most)
        memory = {
            "motors.q": after,
            "motors.v": rate,
            "drives.equilibrium": mu,
            "drives.stiffness": springs.stiffness(c, mu - x.q),
            "saturated.drives": tm.where(beyond, 1.0, 0.0),
        }
        tau = springs.torque(c, mu - x.q) + x.p["damping"] * ((moved - mu) / x.dt - x.v)
        return MotorStep(tau=tau, memory=memory)

    def braking(self, gear: Float64Array, p: Values) -> Float64Array:
        """(n,) damping [N m s/rad]."""
        damping: Float64Array = p["damping"] + np.zeros(len(gear))
        return damping

    def stiffness(self, p: Values) -> Float64Array | float:
        """(n,) of the springs at their largest pretension [N m/rad]."""
        largest: Float64Array = self.springs.bound(subtree(p, "springs")).stiffness_range[1]
        return largest

    def check_with(self, arm: Arm, takes: str, others: Collection[str]) -> None:
        """They take five numbers, have their own rotors, and are a whole drive but for bandwidth and delay."""
        if takes != "mit":
            raise UsageError(
                f"variable-stiffness actuators take position and stiffness, and this plant takes {takes}; give it "
                'takes="mit", and a law of MitCommand such as taut.laws.VariableStiffness',
                name="takes",
            )
        if arm.rotor_inertia.any():
            raise UsageError(
                "variable-stiffness actuators have their motors behind springs, and this arm has rotors that move "
                "with its links; load it without gears, or use arm.with_joints(rotor_inertia=0.0)",
                name="rotor_inertia",
            )
        for name in others:
            raise UsageError(
                f"{name} does not go with variable-stiffness actuators, whose torque is that of their springs; leave "
                "it out",
                name=name,
            )


def _motors(mu: Vector, c: Vector) -> Vector:
    """(2, n) positions of the motors."""
    both: Vector = tm.stack([mu + c, mu - c])
    return both
