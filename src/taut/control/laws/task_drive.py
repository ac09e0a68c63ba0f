"""Laws of task-space motion for arms whose drives close the loops of velocity or position themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Vector
from taut.control.closed_loop import ClosedLoop
from taut.control.command import Command, Position, Terms, Velocity
from taut.control.gains import Gain, GainValue
from taut.control.law import Law, MemoryView
from taut.control.laws.task_error import task_error
from taut.control.laws.tool_loop import tool_loop
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["TaskPosition", "TaskVelocity"]


class TaskVelocity(Law):
    """Task-space motion by joint velocities: feedforward plus P, for arms whose drives close the velocity loop.

    Law:          v_cmd = J^+ (V_des + lead a_des + kp X_e),  J^+ = J^T (J J^T + damping^2)^-1
    Closed loop:  X_e-dot + kp X_e = 0, where the drives follow v_cmd exactly and the tool can move
                  a drive that lags by 1 / bandwidth and a delay t is led by lead = 1 / bandwidth + t: what is left of
                  its lag is of second order
                  stable for kp (1 / bandwidth + t) below about 1

    Damping keeps joint speeds finite at singularities: at most 1 / (2 damping) for each m/s or rad/s of the tool, and
    zero in a direction that is lost. X_e is the decoupled error, in world axes.

    Args:
        lead: What the drives lag by [s].
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Lynch and Park, Modern Robotics (2017), section 11.3; Wampler (1986), IEEE Trans. SMC 16 (1), on the damping.
    """

    reference = TaskMotion
    kp: Gain = Gain(size=6, pairs=True)  # [1/s]
    lead: Gain = Gain(0.0, size=0)  # [s]
    damping: Gain = Gain(0.01, minimum=1e-9, size=0)  # [m, 1]
    tool: str | None = None

    def check_rate(self, rate: float) -> None:
        check_feedback(self.kp, rate)

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """X_e-dot + kp X_e = 0."""
        return tool_loop(self, x, lambda g: replace(self, kp=g.D), inertia=np.eye(6), single_pole="always")

    def command(self, x: Snapshot, ref: TaskMotion) -> Command:
        error = task_error("decoupled", x, ref, self.tool, None)
        V = Terms(feedforward=ref.twist, lead=self.lead.as_array() * ref.acceleration, P=self.kp @ error.X)
        return Velocity(_joint_speeds(error.J, self.damping, V))


class TaskPosition(Law):
    """Task-space motion by joint positions: one damped Newton step of inverse kinematics a tick, for position drives.

    Law:          v_cmd = J^+(q_cmd) (V_des + kp X_e(q_cmd)),  q_cmd grows by v_cmd dt,
                  asked for is q_cmd + lead v_cmd + lead^2 J^+ a_des / 2;  J^+ = J^T (J J^T + damping^2)^-1
    Closed loop:  X_e-dot + kp X_e = 0 of the commanded pose, whatever the arm does: nothing measured comes back
                  a critically damped drive lags by 2 / bandwidth, and a delay t: lead = 2 / bandwidth + t asks for
                  where the tool is to be then

    q_cmd starts where the arm is. X_e is the decoupled error, in world axes.

    Args:
        lead: What the drives lag by [s].
        tool: The frame that is controlled; the arm's tool if left out.

    References:
        Section 10.2.3, equations 10.28 and 10.29; Wampler (1986), IEEE Trans. SMC 16 (1), on the damping.
    """

    reference = TaskMotion
    kp: Gain = Gain(size=6, pairs=True)  # [1/s]
    lead: Gain = Gain(0.0, size=0)  # [s]
    damping: Gain = Gain(0.01, minimum=1e-9, size=0)  # [m, 1]
    tool: str | None = None

    def check_rate(self, rate: float) -> None:
        check_feedback(self.kp, rate)

    def start(self, x: Snapshot, ref: TaskMotion) -> Mapping[str, Vector]:  # noqa: ARG002
        return {"q": x.q}

    def closed_loop(self, x: Snapshot) -> ClosedLoop:
        """X_e-dot + kp X_e = 0."""
        return tool_loop(self, x, lambda g: replace(self, kp=g.D), inertia=np.eye(6), single_pole="always")

    def command(self, x: Snapshot, ref: TaskMotion, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        error = task_error("decoupled", x.at(memory.q, np.zeros(x.n)), ref, self.tool, None)
        V, lead = ref.twist + self.kp @ error.X, self.lead.as_array()
        speeds = _joint_speeds(error.J, self.damping, Terms(V=V, a=0.5 * lead * ref.acceleration))
        q = memory.q + dt * speeds.parts["V"]
        return Position(solution=q, lead=lead * speeds.total), {"q": q}


def _joint_speeds(J: Any, damping: GainValue, V: Terms) -> Terms:
    """J^+ V, by damped least squares."""
    factors = tm.factor_spd(J @ J.T + damping.as_array() ** 2 * tm.eye(6))
    return V.mapped(lambda part: J.T @ factors.solve(part))


def check_feedback(kp: GainValue, rate: float) -> None:
    """An error cannot be taken away faster than the rate [Hz].

    Raises:
        RangeError: It is asked to.
    """
    values = np.asarray(kp.as_array(), dtype=np.float64)
    largest = float(np.linalg.eigvalsh(values)[-1]) if values.ndim == 2 else float(values.max())
    if largest > rate:
        raise RangeError(
            f"kp must be at most the rate, {rate:g} [1/s], with which the error is gone in one tick; got {largest:g}",
            name="kp",
            value=largest,
        )
