"""Robotics Toolbox for Python (`pip install roboticstoolbox-python`): modified Denavit-Hartenberg, dynamics in C."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from roboticstoolbox import DHRobot, RevoluteMDH
from spatialmath import SE3
from worker import Array, Case, Task, impedance, loop, ticks, tool_ticks


def robot_of(task: Task, robot: str) -> DHRobot:
    data = task.robots[robot]
    links = []
    for joint, body in zip(data["joints"], data["bodies"], strict=True):
        p, R, I = np.array(joint["p"]), np.array(joint["R"]), np.array(body["inertia"])
        alpha = np.arctan2(R[2, 1], R[1, 1])
        d = p[2] * np.cos(alpha) - p[1] * np.sin(alpha)
        assert np.allclose(p, [p[0], -d * np.sin(alpha), d * np.cos(alpha)])
        inertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[1, 2], I[0, 2]]
        links.append(RevoluteMDH(d=d, a=p[0], alpha=alpha, m=body["mass"], r=body["com"], I=inertia))
    tool = SE3.Rt(np.array(data["tool"]["R"]), data["tool"]["p"], check=False)
    return DHRobot(links, tool=tool, gravity=data["gravity"])


def computed_torque(task: Task, robot: str) -> Callable[..., Array]:
    arm, kp, kd = robot_of(task, robot), task.kp, task.kd

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return arm.rne(q, v, a_des + kp * (q_des - q) + kd * (v_des - v))

    return law


def tick(task: Task, robot: str) -> Case:
    return ticks(task, robot, computed_torque(task, robot), "DHRobot.rne")


def tool_tick(task: Task) -> Case:
    arm = robot_of(task, "panda")
    still = np.zeros(arm.n)

    def law(q: Array, v: Array, *target: Array) -> Array:
        J = arm.jacob0(q)
        T = arm.fkine(q).A
        Jdot_v = arm.jacob0_dot(q, v, J0=J) @ v
        return impedance(task, arm.inertia(q), arm.rne(q, v, still), J, Jdot_v, T[:3, 3], T[:3, :3], q, v, target)

    return tool_ticks(task, law, "DHRobot.inertia, rne, jacob0, jacob0_dot, fkine")


def closed_loop(task: Task, robot: str) -> Case:
    plant = robot_of(task, robot + "_loaded")
    return loop(task, robot, computed_torque(task, robot), plant.accel, 100, "rne, accel; loop in Python")


CASES = {"tick": tick, "impedance": tool_tick, "loop": closed_loop}
