"""frax (`pip install frax`), dynamics in JAX, on the processor."""

from __future__ import annotations

import os

os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # XLA takes all the processors that it is given
os.environ["JAX_PLATFORMS"] = "cpu"

import frax
import jax
import jax.numpy as jnp
import numpy as np
from worker import Array, Case, Task, task_ticks, ticks

jax.config.update("jax_enable_x64", True)


def upwards(task: Task) -> Array:
    return np.hstack([-np.array(task.robots["panda"]["gravity"]), np.zeros(3)])


def tick(task: Task, robot: str) -> Case:
    arm, kp, kd, up = frax.Robot(task.urdf(robot)), task.kp, task.kd, upwards(task)

    @jax.jit
    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return arm.rnea(q, v, a_des + kp * (q_des - q) + kd * (v_des - v), up, None)

    return ticks(task, lambda *x: np.asarray(law(*x)), "jit of Robot.rnea", robot)


def task_tick(task: Task) -> Case:
    place = np.eye(4)
    tool = task.robots["panda"]["tool"]
    place[:3, :3], place[:3, 3] = tool["R"], tool["p"]
    arm, up, par = frax.Manipulator(task.urdf("panda"), ee_offset=place), upwards(task), task.impedance

    @jax.jit
    def law(q: Array, v: Array, p_des: Array, R_des: Array, V_des: Array, a_des: Array) -> Array:
        M, h = arm.mass_matrix(q), arm.rnea(q, v, None, up, None)
        T = arm.ee_transform(q)
        J, Jdot = arm.ee_jacobian_and_derivative(q, v)
        E = R_des @ T[:3, :3].T
        w = jnp.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
        angle = jnp.arccos(jnp.clip(0.5 * (jnp.trace(E) - 1.0), -1.0, 1.0))
        turn = w * jnp.where(angle < 1e-7, 0.5, 0.5 * angle / jnp.sin(angle))
        error = jnp.concatenate([p_des - T[:3, 3], turn])
        Minv = arm.mass_matrix_inverse(M)
        Lambda = jnp.linalg.inv(J @ Minv @ J.T)
        F = Lambda @ (a_des - Jdot @ v) + par["B"] * (V_des - J @ v) + par["K"] * error
        posture = M @ (par["kp"] * (par["rest"] - q) - par["kd"] * v)
        return J.T @ (F - Lambda @ (J @ (Minv @ posture))) + h + posture

    return task_ticks(task, lambda *x: np.asarray(law(*x)), "jit of mass_matrix, rnea, ee_jacobian_and_derivative")


def closed_loop(task: Task, robot: str) -> Case:
    arm, plant, up = frax.Robot(task.urdf(robot)), frax.Robot(task.urdf(robot + "_loaded")), upwards(task)
    center, amplitude, omega = task.sine(robot)
    steps = 1000

    @jax.jit
    def run(q: Array, v: Array) -> Array:
        def step(state: tuple, k: Array) -> tuple[tuple, None]:
            q, v = state
            s, c = jnp.sin(omega * k * task.dt), jnp.cos(omega * k * task.dt)
            q_des, v_des, a_des = center + amplitude * s, amplitude * omega * c, -amplitude * omega**2 * s
            tau = arm.rnea(q, v, a_des + task.kp * (q_des - q) + task.kd * (v_des - v), up, None)
            chol = jax.scipy.linalg.cho_factor(plant.mass_matrix(q))
            v = v + task.dt * jax.scipy.linalg.cho_solve(chol, tau - plant.rnea(q, v, None, up, None))
            return (q + task.dt * v, v), None

        return jax.lax.scan(step, (q, v), jnp.arange(steps))[0][0]

    return Case(lambda: np.asarray(run(center, amplitude * omega)), steps, "jit of lax.scan; semi-implicit Euler")


CASES = {"tick": tick, "task_tick": task_tick, "loop": closed_loop}
