"""NumPy with Pinocchio (`pip install pin`)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from worker import Array, Case, Task, impedance, loop, ticks, tool_ticks


def model_of(task: Task, robot: str) -> tuple[pin.Model, pin.Data]:
    model = pin.buildModelFromUrdf(task.urdf(robot))
    model.gravity.linear = np.array(task.robots[robot]["gravity"])
    return model, model.createData()


def computed_torque(task: Task, robot: str) -> Callable[..., Array]:
    (model, data), kp, kd = model_of(task, robot), task.kp, task.kd

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return pin.rnea(model, data, q, v, a_des + kp * (q_des - q) + kd * (v_des - v))

    return law


def tick(task: Task, robot: str) -> Case:
    return ticks(task, robot, computed_torque(task, robot), "rnea")


def tool_tick(task: Task) -> Case:
    model, data = model_of(task, "panda")
    frame, still = model.getFrameId("tool"), np.zeros(model.nv)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def law(q: Array, v: Array, *target: Array) -> Array:
        M = pin.crba(model, data, q)
        h = pin.nonLinearEffects(model, data, q, v)
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, still)
        pin.updateFramePlacements(model, data)
        J = pin.getFrameJacobian(model, data, frame, axes)
        Jdot_v = pin.getFrameClassicalAcceleration(model, data, frame, axes).vector
        T = data.oMf[frame]
        return impedance(task, M, h, J, Jdot_v, T.translation, T.rotation, q, v, target)

    return tool_ticks(task, law, "crba, nonLinearEffects, getFrameJacobian, getFrameClassicalAcceleration")


def closed_loop(task: Task, robot: str) -> Case:
    model, data = model_of(task, robot + "_loaded")
    law = computed_torque(task, robot)
    return loop(task, robot, law, lambda q, v, tau: pin.aba(model, data, q, v, tau), 400, "rnea, aba; loop in Python")


CASES = {"tick": tick, "impedance": tool_tick, "loop": closed_loop}
