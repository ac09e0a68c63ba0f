"""adam (`pip install adam-robotics[casadi]`): each law as one CasADi function, called through its buffer."""

from __future__ import annotations

from collections.abc import Callable

import casadi as cs
import numpy as np
from adam.casadi import KinDynComputations
from worker import Array, Case, Task, task_ticks, ticks


class Arm:
    """Terms of an arm whose base does not move, on symbols."""

    def __init__(self, task: Task, robot: str) -> None:
        data = task.robots[robot]
        gravity = np.hstack([data["gravity"], np.zeros(3)])
        names = [joint["name"] for joint in data["joints"]]
        self.n = len(names)
        self.terms = KinDynComputations(task.urdf(robot), names, gravity=gravity)
        self.base, self.still = np.eye(4), np.zeros(6)

    def M(self, q: cs.SX) -> cs.SX:
        return self.terms.mass_matrix(self.base, q)[6:, 6:]

    def h(self, q: cs.SX, v: cs.SX) -> cs.SX:
        return self.terms.bias_force(self.base, q, self.still, v)[6:]


def by_buffer(function: cs.Function) -> Callable[..., Array]:
    """The function on NumPy arrays, without CasADi's own matrices in between."""
    buffer, evaluate = function.buffer()
    given = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
    out = np.zeros(function.numel_out(0))
    for i, array in enumerate(given):
        buffer.set_arg(i, memoryview(array))
    buffer.set_res(0, memoryview(out))

    def call(*values: Array) -> Array:
        for array, value in zip(given, values, strict=True):
            array[:] = value if value.ndim == 1 else value.T.ravel()
        evaluate()
        return out.copy()

    call.buffer = buffer  # or it is freed, and evaluate() hangs
    return call


def law_of(task: Task, arm: Arm) -> Callable[..., cs.SX]:
    def law(q: cs.SX, v: cs.SX, q_des: cs.SX, v_des: cs.SX, a_des: cs.SX) -> cs.SX:
        return arm.M(q) @ (a_des + task.kp * (q_des - q) + task.kd * (v_des - v)) + arm.h(q, v)

    return law


def tick(task: Task, robot: str) -> Case:
    arm = Arm(task, robot)
    symbols = [cs.SX.sym(name, arm.n) for name in ("q", "v", "q_des", "v_des", "a_des")]
    law = cs.Function("law", symbols, [law_of(task, arm)(*symbols)], {"cse": True})
    return ticks(task, by_buffer(law), "M a + h as a casadi.Function, buffer()", robot)


def task_tick(task: Task) -> Case:
    arm, par = Arm(task, "panda"), task.impedance
    q, v = cs.SX.sym("q", arm.n), cs.SX.sym("v", arm.n)
    p_des, R_des, V_des, a_des = cs.SX.sym("p", 3), cs.SX.sym("R", 3, 3), cs.SX.sym("V", 6), cs.SX.sym("a", 6)
    M, h = arm.M(q), arm.h(q, v)
    T = arm.terms.forward_kinematics("tool", arm.base, q)
    J = arm.terms.jacobian("tool", arm.base, q)[:, 6:]
    Jdot_v = arm.terms.jacobian_dot("tool", arm.base, q, arm.still, v)[:, 6:] @ v
    E = R_des @ T[:3, :3].T
    w = cs.vertcat(E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1])
    angle = cs.acos(cs.fmin(1.0, cs.fmax(-1.0, 0.5 * (cs.trace(E) - 1.0))))
    error = cs.vertcat(p_des - T[:3, 3], w * cs.if_else(angle < 1e-7, 0.5, 0.5 * angle / cs.sin(angle)))
    Minv_JT = cs.ldl_solve(J.T, *cs.ldl(M))
    Lambda = cs.inv(J @ Minv_JT)
    F = Lambda @ (a_des - Jdot_v) + par["B"] * (V_des - J @ v) + par["K"] * error
    posture = M @ (par["kp"] * (par["rest"] - q) - par["kd"] * v)
    tau = J.T @ (F - Lambda @ (Minv_JT.T @ posture)) + h + posture
    law = cs.Function("law", [q, v, p_des, R_des, V_des, a_des], [tau], {"cse": True})
    return task_ticks(task, by_buffer(law), "one casadi.Function, buffer()")


def closed_loop(task: Task, robot: str) -> Case:
    arm, plant, steps = Arm(task, robot), Arm(task, robot + "_loaded"), 400
    center, amplitude, omega = task.sine(robot)
    state, t = cs.SX.sym("x", 2 * arm.n), cs.SX.sym("t")
    q, v = state[: arm.n], state[arm.n :]
    s, c = cs.sin(omega * t), cs.cos(omega * t)
    tau = law_of(task, arm)(q, v, center + amplitude * s, amplitude * omega * c, -amplitude * omega**2 * s)
    factors = cs.ldl(plant.M(q))
    v_next = v + task.dt * cs.ldl_solve(tau - plant.h(q, v), *factors)
    step = cs.Function("step", [state, t], [cs.vertcat(q + task.dt * v_next, v_next)], {"cse": True})
    run = step.mapaccum(steps)
    times, start = task.dt * np.arange(steps)[None, :], np.hstack([center, amplitude * omega])
    how = "one casadi.Function, mapaccum; semi-implicit Euler"
    return Case(lambda: np.array(run(start, times))[: arm.n, -1], steps, how)


CASES = {"tick": tick, "task_tick": task_tick, "loop": closed_loop}
