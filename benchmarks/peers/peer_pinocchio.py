"""NumPy with Pinocchio (`pip install pin`)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from worker import Array, Case, Task, impedance, loop, task_ticks, ticks

HOW = "rnea(q, v, a)"


class Arm:
    """A model with its data."""

    def __init__(self, task: Task, robot: str) -> None:
        self.model = pin.buildModelFromUrdf(task.urdf(robot))
        self.model.gravity.linear = np.array(task.robots[robot]["gravity"])
        self.data = self.model.createData()


def computed_torque(task: Task, robot: str):
    arm, kp, kd = Arm(task, robot), task.kp, task.kd
    model, data = arm.model, arm.data

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return pin.rnea(model, data, q, v, a_des + kp * (q_des - q) + kd * (v_des - v))

    return law


def tick(task: Task, robot: str) -> Case:
    return ticks(task, computed_torque(task, robot), HOW, robot)


def task_tick(task: Task) -> Case:
    arm = Arm(task, "panda")
    model, data, still = arm.model, arm.data, np.zeros(arm.model.nv)
    frame = model.getFrameId("tool")
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

    return task_ticks(task, law, "crba, nonLinearEffects, getFrameJacobian, getFrameClassicalAcceleration")


def closed_loop(task: Task, robot: str) -> Case:
    plant = Arm(task, robot + "_loaded")
    model, data = plant.model, plant.data
    law = computed_torque(task, robot)
    how = "rnea, aba; semi-implicit Euler, loop in Python"
    return loop(task, robot, law, lambda q, v, tau: pin.aba(model, data, q, v, tau), 400, how)


CASES = {"tick": tick, "task_tick": task_tick, "loop": closed_loop}
