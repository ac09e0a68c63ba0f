"""modern_robotics, the textbook's own library (`pip install modern_robotics`)."""

from __future__ import annotations

from collections.abc import Callable

import modern_robotics as mr
import numpy as np
from worker import Array, Case, Task, loop, ticks


def lists(task: Task, robot: str) -> tuple[Array, Array, Array]:
    """Mlist, Glist and Slist: frames in the centres of mass, axes in the base, angular part first."""
    data = task.robots[robot]
    T, centre = np.eye(4), np.eye(4)
    M, G, S = [], [], []
    for joint, body in zip(data["joints"], data["bodies"], strict=True):
        T = T @ mr.RpToTrans(np.array(joint["R"]), np.array(joint["p"]))
        axis = T[:3, 2]
        S.append(np.hstack([axis, -np.cross(axis, T[:3, 3])]))
        here = T @ mr.RpToTrans(np.eye(3), np.array(body["com"]))
        M.append(mr.TransInv(centre) @ here)
        full = np.zeros((6, 6))
        full[:3, :3], full[3:, 3:] = body["inertia"], body["mass"] * np.eye(3)
        G.append(full)
        centre = here
    M.append(np.eye(4))
    return np.array(M), np.array(G), np.array(S).T


def computed_torque(task: Task, robot: str) -> Callable[..., Array]:
    M, G, S = lists(task, robot)
    gravity, none = np.array(task.robots[robot]["gravity"]), np.zeros(S.shape[1])

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return mr.ComputedTorque(q, v, none, gravity, M, G, S, q_des, v_des, a_des, task.kp, 0.0, task.kd)

    return law


def tick(task: Task, robot: str) -> Case:
    return ticks(task, robot, computed_torque(task, robot), "ComputedTorque")


def closed_loop(task: Task, robot: str) -> Case:
    M, G, S = lists(task, robot + "_loaded")
    gravity, none = np.array(task.robots[robot]["gravity"]), np.zeros(6)

    def acceleration(q: Array, v: Array, tau: Array) -> Array:
        return mr.ForwardDynamics(q, v, tau, gravity, none, M, G, S)

    how = "ComputedTorque, ForwardDynamics; loop in Python"
    return loop(task, robot, computed_torque(task, robot), acceleration, 10, how)


CASES = {"tick": tick, "loop": closed_loop}
