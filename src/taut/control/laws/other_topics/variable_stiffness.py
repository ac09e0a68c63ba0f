"""Control of position and stiffness of joints with variable-stiffness actuators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import MatchError, RangeError
from taut.base.fields import Part
from taut.control.command import MitCommand, Terms
from taut.control.gains import Gain, Memory, MemoryView
from taut.control.law import Law
from taut.control.trajectories.reference import JointMotion
from taut.maths.snapshot import Snapshot
from taut.maths.springs import AntagonisticSprings
from taut.trace import math as tm


class VariableStiffness(Law):
    """Position and stiffness of joints with variable-stiffness actuators, each by itself.

    Law:          q_des, kp = sigma and tau = M a_des + C v_des + g at the desired motion, as a `MitCommand`:
                  pretension sigma / (4 a), equilibrium q_des + tau / sigma (+ kd (v_des - v) / sigma)
                  sigma follows `stiffness` at no more than `slew`, so that the motors keep up with it
    Closed loop:  M e_ddot + (b + D + kd) e_dot + sigma e = tau_dist, by steel and without a sensor; D is the damping
                  of the drives, kd moves the motors and is theirs up to their bandwidth
                  with an exact model and fast motors a change of sigma does not move the joint; motors of bandwidth w
                  push it by about 2 tau (sigma_dot / (sigma w))^2 meanwhile

    With kd = 0 nothing measured is fed back, so that no rate or delay of the controller makes it unstable, and it is
    passive while sigma rests and nothing is limited.

    Args:
        springs: Those of the drives: how stiff they get, and what they carry.
        stiffness: sigma of each joint, which may change at any time.
        slew: Largest rate of sigma.
        kd: Damping by the motors, in addition to that of the drives.

    Raises:
        RangeError: A stiffness beyond the springs; at the start of a run one that does not carry the arm's weight.

    Example:
        >>> import taut
        >>> springs = taut.drives.AntagonisticSprings(a=40.0, c_min=0.25, c_max=0.75)
        >>> law = taut.laws.VariableStiffness(springs=springs, stiffness=80.0, slew=200.0)
        >>> ctrl = taut.compile(law, taut.load_arm("one_joint"))
        >>> q, v, kp, kd, tau = ctrl.step([0.1], [0.0], taut.JointMotion(q=[0.2]))
        >>> float(kp[0]), round(float(tau[0]), 3)
        (80.0, 0.961)
        >>> ctrl.parameters["law.stiffness"] = 200.0
        Traceback (most recent call last):
        taut.base.errors.RangeError: law.stiffness must be within what the springs give, 40 to 120 [N ...

    References:
        Albu-Schaeffer et al., Soft robotics, IEEE Robotics and Automation Magazine 15 (3), 2008.
    """

    springs: Part[AntagonisticSprings] = Part(AntagonisticSprings)
    stiffness: Gain = Gain(unit="N m/rad | N/m", accepts=("scalar",), above=0.0)
    slew: Gain = Gain(unit="N m/(rad s) | N/(m s)", accepts=("scalar",), above=0.0)
    kd: Gain = Gain(0.0, unit="N m s/rad | N s/m", accepts=("scalar",))
    sigma = Memory(unit="N m/rad | N/m", record=True)

    def check(self) -> None:
        self.springs.require_reached(self, "stiffness", self.stiffness.as_array())

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        carried = self.springs.max_torque(self.stiffness.as_array()) * np.ones(x.n)
        needed = np.sqrt(4.0 * self.springs.a * np.abs(x.g))
        for i, joint in enumerate(x.arm.joint_names):
            if abs(x.g[i]) > carried[i]:
                raise RangeError(
                    f"stiffness of joint '{joint}' carries {carried[i]:.4g} N m before a tendon is slack, and its "
                    f"weight at the start is {abs(x.g[i]):.4g} N m; make it {needed[i]:.4g} N m/rad at least",
                    name="stiffness",
                    joint=joint,
                )

    def check_plant(self, path: str, arm: Arm, plant: str, parameters: Mapping[str, Any]) -> None:  # noqa: ARG002
        """The drives must have the law's springs."""
        for name, ours in self.springs.parameters().items():
            theirs = parameters.get(f"actuation.motor.springs.{name}", ours)
            if not np.allclose(ours, theirs, atol=0.0):
                both = f"is {ours.tolist()}, and the drives of plant '{plant}' have {theirs.tolist()}"
                raise MatchError(f"{path}.springs.{name} {both}; give both the same springs", name="springs")

    def start(self, x: Snapshot, ref: Any) -> dict[str, Any]:  # noqa: ARG002
        return {"sigma": self.stiffness.as_array() * tm.ones(x.n)}

    def command(
        self, x: Snapshot, ref: JointMotion, memory: MemoryView, dt: float
    ) -> tuple[MitCommand, dict[str, Any]]:
        change = self.slew.as_array() * dt
        sigma = memory.sigma + tm.clip(self.stiffness.as_array() - memory.sigma, -change, change)
        tau = x.at(ref.q, ref.v).inverse_dynamics(ref.a)
        command = MitCommand(q=ref.q, v=ref.v, kp=sigma, kd=self.kd, tau=Terms(feedforward=tau))
        return command, {"sigma": sigma}
