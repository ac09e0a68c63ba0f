"""NumPy with dynibo (`pip install dynibo`): Rust behind a Python interface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dynibo import Robot
from worker import Array, Case, Task, impedance, loop, ticks, tool_ticks

ORDER = [3, 4, 5, 0, 1, 2]  # its 6-vectors have the angular part first


def computed_torque(task: Task, robot: str) -> Callable[..., Array]:
    arm, kp, kd = Robot.from_urdf(task.urdf(robot)), task.kp, task.kd

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return arm.inverse_dynamics(q, v, a_des + kp * (q_des - q) + kd * (v_des - v))

    return law


def tick(task: Task, robot: str) -> Case:
    return ticks(task, robot, computed_torque(task, robot), "inverse_dynamics")


def rotation(xyzw: tuple[float, ...]) -> Array:
    x, y, z, w = xyzw
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def tool_tick(task: Task) -> Case:
    arm = Robot.from_urdf(task.urdf("panda"))
    tool, n, still = arm.link_id("tool"), arm.joint_count, np.zeros(arm.joint_count)

    def law(q: Array, v: Array, *target: Array) -> Array:
        M = arm.mass_matrix(q).reshape(n, n)
        h = arm.inverse_dynamics(q, v, still)
        J = arm.jacobian(q, tool).reshape(n, 6).T[ORDER]
        Jdot_v = (arm.jacobian_derivative(q, v, tool).reshape(n, 6).T @ v)[ORDER]
        T = arm.forward_kinematics(q, tool)
        return impedance(task, M, h, J, Jdot_v, np.array(T.translation), rotation(T.rotation_xyzw), q, v, target)

    return tool_ticks(task, law, "mass_matrix, inverse_dynamics, jacobian, jacobian_derivative, forward_kinematics")


def closed_loop(task: Task, robot: str) -> Case:
    plant = Robot.from_urdf(task.urdf(robot + "_loaded"))
    how = "inverse_dynamics, forward_dynamics; loop in Python"
    return loop(task, robot, computed_torque(task, robot), plant.forward_dynamics, 400, how)


CASES = {"tick": tick, "impedance": tool_tick, "loop": closed_loop}
