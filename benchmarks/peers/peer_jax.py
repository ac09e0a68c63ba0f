"""JAX (`pip install jax`) on the processor: dynamics written by hand with jax.numpy, jit, vmap, lax.scan.

Beside it the same step from taut's own graph, written out as straight-line Python and traced by JAX.
"""

from __future__ import annotations

import os

os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # XLA takes all the processors that it is given
os.environ["JAX_PLATFORMS"] = "cpu"

import functools
import importlib.util
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from worker import Array, Case, Task, task_ticks, ticks

jax.config.update("jax_enable_x64", True)


class Model:
    """Constants of an arm; of each body mass, first moment and inertia about the origin of its joint."""

    def __init__(self, task: Task, robot: str, real: str = "float64") -> None:
        data = task.robots[robot]
        self.n, self.real = len(data["joints"]), real
        array = functools.partial(np.array, dtype=real)
        self.p = [array(joint["p"]) for joint in data["joints"]]
        self.R = [array(joint["R"]) for joint in data["joints"]]
        self.bodies = [moments(b["mass"], array(b["com"]), array(b["inertia"])) for b in data["bodies"]]
        self.gravity = array(data["gravity"])
        self.tool = array(data["tool"]["p"]), array(data["tool"]["R"])


def moments(mass: Array, com: Array, inertia: Array) -> tuple[Array, Array, Array]:
    across = com @ com * np.eye(3, dtype=com.dtype) - np.outer(com, com)
    return mass, mass * com, inertia + mass * across


def rotations(model: Model, q: Array) -> list[Array]:
    """Rotation of each joint's frame in that of its parent."""
    c, s = jnp.cos(q), jnp.sin(q)
    zero, one = jnp.zeros_like(c[0]), jnp.ones_like(c[0])
    turns = [jnp.array([[c[i], -s[i], zero], [s[i], c[i], zero], [zero, zero, one]]) for i in range(model.n)]
    return [R @ turn for R, turn in zip(model.R, turns, strict=True)]


def rnea(model: Model, Rs: list[Array], v: Array, a: Array, gravity: Array, last: tuple | None = None) -> Array:
    """Inverse dynamics by the recursive Newton-Euler algorithm; `last` replaces the last body."""
    none = jnp.zeros(3, model.real)
    z = jnp.array([0.0, 0.0, 1.0], model.real)
    bodies = [*model.bodies[:-1], last or model.bodies[-1]]
    w, dw, acc = none, none, -gravity
    forces, couples = [], []
    for i, (mass, first, inertia) in enumerate(bodies):
        R, p = Rs[i], model.p[i]
        acc = R.T @ (acc + jnp.cross(dw, p) + jnp.cross(w, jnp.cross(w, p)))
        w_parent = R.T @ w
        w = w_parent + z * v[i]
        dw = R.T @ dw + z * a[i] + jnp.cross(w_parent, z * v[i])
        forces.append(mass * acc + jnp.cross(dw, first) + jnp.cross(w, jnp.cross(w, first)))
        couples.append(inertia @ dw + jnp.cross(w, inertia @ w) + jnp.cross(first, acc))
    tau = [None] * model.n
    f, couple = none, none
    for i in reversed(range(model.n)):
        f, couple = f + forces[i], couple + couples[i]
        tau[i] = couple[2]
        f, couple = Rs[i] @ f, Rs[i] @ couple
        couple = couple + jnp.cross(model.p[i], f)
    return jnp.stack(tau)


def inertia_matrix(model: Model, Rs: list[Array], last: tuple | None = None) -> Array:
    """One recursion for each column."""
    zero, none = jnp.zeros(model.n, model.real), jnp.zeros(3, model.real)
    return jax.vmap(lambda a: rnea(model, Rs, zero, a, none, last))(jnp.eye(model.n, dtype=model.real))


def computed_torque(model: Model, kp: Array, kd: Array) -> Callable[..., Array]:
    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        return rnea(model, rotations(model, q), v, a_des + kp * (q_des - q) + kd * (v_des - v), model.gravity)

    return law


def tick(task: Task, robot: str) -> Case:
    law = jax.jit(computed_torque(Model(task, robot), task.kp, task.kd))
    return ticks(task, lambda *x: np.asarray(law(*x)), "jit of a hand-written recursion", robot)


def tool_pose(model: Model, q: Array) -> tuple[Array, Array]:
    p, R = jnp.zeros(3), jnp.eye(3)
    for i, own in enumerate(rotations(model, q)):
        p, R = p + R @ model.p[i], R @ own
    return p + R @ model.tool[0], R @ model.tool[1]


def jacobian(model: Model, q: Array) -> Array:
    p, R = jnp.zeros(3), jnp.eye(3)
    axes, places = [], []
    for i, own in enumerate(rotations(model, q)):
        p, R = p + R @ model.p[i], R @ own
        axes.append(R[:, 2])
        places.append(p)
    tip = p + R @ model.tool[0]
    z = jnp.stack(axes)
    return jnp.concatenate([jnp.cross(z, tip - jnp.stack(places)).T, z.T])


def task_tick(task: Task) -> Case:
    model, par = Model(task, "panda"), task.impedance

    @jax.jit
    def law(q: Array, v: Array, p_des: Array, R_des: Array, V_des: Array, a_des: Array) -> Array:
        Rs = rotations(model, q)
        M, h = inertia_matrix(model, Rs), rnea(model, Rs, v, jnp.zeros(model.n), model.gravity)
        J, Jdot = jax.jvp(lambda q: jacobian(model, q), (q,), (v,))
        p, R = tool_pose(model, q)
        E = R_des @ R.T
        w = jnp.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
        angle = jnp.arccos(jnp.clip(0.5 * (jnp.trace(E) - 1.0), -1.0, 1.0))
        error = jnp.concatenate([p_des - p, w * jnp.where(angle < 1e-7, 0.5, 0.5 * angle / jnp.sin(angle))])
        chol = jax.scipy.linalg.cho_factor(M)
        Minv_JT = jax.scipy.linalg.cho_solve(chol, J.T)
        Lambda = jnp.linalg.inv(J @ Minv_JT)
        F = Lambda @ (a_des - Jdot @ v) + par["B"] * (V_des - J @ v) + par["K"] * error
        posture = M @ (par["kp"] * (par["rest"] - q) - par["kd"] * v)
        return J.T @ (F - Lambda @ (Minv_JT.T @ posture)) + h + posture

    return task_ticks(task, lambda *x: np.asarray(law(*x)), "jit of hand-written dynamics, jvp of the Jacobian")


def one_loop(task: Task, robot: str, ticks: int, real: str = "float64") -> Callable[..., tuple[Array, Array]]:
    """The loop of one sample, as a scan: (kp, kd, payload's mass) -> q at the end, RMS error."""
    model = Model(task, robot, real)
    p, R = model.tool
    com, inertia = (task.payload[name].astype(real) for name in ("com", "inertia"))
    com, inertia = p + R @ com, R @ inertia @ R.T
    center, amplitude, omega = (row.astype(real) for row in task.sine(robot))
    base = model.bodies[-1]

    def loop(kp: Array, kd: Array, mass: Array) -> tuple[Array, Array]:
        law = computed_torque(model, kp, kd)
        held = moments(mass, com, inertia)
        last = tuple(a + b for a, b in zip(base, held, strict=True))

        def step(state: tuple, k: Array) -> tuple[tuple, None]:
            q, v, squares = state
            t = k.astype(real) * task.dt
            s, c = jnp.sin(omega * t), jnp.cos(omega * t)
            q_des, v_des = center + amplitude * s, amplitude * omega * c
            tau = law(q, v, q_des, v_des, -amplitude * omega**2 * s)
            Rs = rotations(model, q)
            bias = rnea(model, Rs, v, jnp.zeros(model.n, real), model.gravity, last)
            chol = jax.scipy.linalg.cho_factor(inertia_matrix(model, Rs, last))
            squares = squares + jnp.sum((q_des - q) ** 2)
            v = v + task.dt * jax.scipy.linalg.cho_solve(chol, tau - bias)
            q = q + task.dt * v
            return (q, v, squares), None

        start = jnp.asarray(center), jnp.asarray(amplitude * omega), jnp.zeros((), real)
        (q, _, squares), _ = jax.lax.scan(step, start, jnp.arange(ticks))
        return q, jnp.sqrt(squares / ticks)

    return loop


def closed_loop(task: Task, robot: str) -> Case:
    steps = 1000
    run = jax.jit(one_loop(task, robot, steps))
    par = (np.float64(task.kp), np.float64(task.kd), np.float64(task.payload["mass"]))
    return Case(lambda: np.asarray(run(*par)[0]), steps, "jit of lax.scan; semi-implicit Euler")


def sweep(task: Task, samples: int, ticks: int, real: str) -> Case:
    run = jax.jit(jax.vmap(one_loop(task, "panda", ticks, real)))
    par = [jnp.asarray(column, dtype=real) for column in task.gains[:samples].T]
    how = f"jit of vmap of lax.scan, {real}; semi-implicit Euler"
    return Case(lambda: np.asarray(run(*par)[1]), samples * ticks, how)


def graph_sweep(task: Task, samples: int, ticks: int, real: str) -> Case:
    """The step that taut compiles, traced by JAX in its place."""
    spec = importlib.util.spec_from_file_location("taut_step", task.folder / "taut_step.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    center, amplitude, omega = (row.astype(real) for row in task.sine("panda"))

    def loop(kp: Array, kd: Array, mass: Array) -> Array:
        par = jnp.asarray(module.PARAMETERS, real)
        for path, value in (("law.kp", kp), ("law.kd", kd), ("plant.payload.mass", mass)):
            first, size = module.PLACES[path]
            par = par.at[first : first + size].set(value)

        def step(state: tuple, k: Array) -> tuple[tuple, None]:
            memory, squares = state
            t = k.astype(real) * task.dt
            s, c = jnp.sin(omega * t), jnp.cos(omega * t)
            q_des = center + amplitude * s
            given = {"t": t, "ref.q": q_des, "ref.v": amplitude * omega * c, "ref.a": -amplitude * omega**2 * s}
            row = jnp.concatenate([jnp.ravel(given[path]) for path in module.INPUTS])
            at, size = module.STATE
            squares = squares + jnp.sum((q_des - memory[at : at + size]) ** 2)
            memory = jnp.stack(module.step(jnp, list(row), list(par), list(memory)))
            return (memory, squares), None

        start = jnp.asarray(module.MEMORY, real), jnp.zeros((), real)
        (_, squares), _ = jax.lax.scan(step, start, jnp.arange(ticks))
        return jnp.sqrt(squares / ticks)

    run = jax.jit(jax.vmap(loop))
    par = [jnp.asarray(column, dtype=real) for column in task.gains[:samples].T]
    return Case(lambda: np.asarray(run(*par)), samples * ticks, f"taut's own graph, jit of vmap of lax.scan, {real}")


CASES: dict[str, Callable[..., Case]] = {
    "tick": tick,
    "task_tick": task_tick,
    "loop": closed_loop,
    "sweep": sweep,
    "graph_sweep": graph_sweep,
}
