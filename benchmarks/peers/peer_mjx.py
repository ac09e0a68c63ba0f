"""MJX (`pip install mujoco-mjx`): MuJoCo in JAX, on the processor, contacts and constraints switched off."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import mjx
from peer_mujoco import model_of
from worker import Array, Case, Task, ticks

jax.config.update("jax_enable_x64", True)


def law_of(task: Task, robot: str) -> Callable[..., Array]:
    model = mjx.put_model(model_of(task, robot))
    blank = mjx.make_data(model)

    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        a = a_des + task.kp * (q_des - q) + task.kd * (v_des - v)
        return mjx.inverse(model, blank.replace(qpos=q, qvel=v, qacc=a)).qfrc_inverse

    return law


def tick(task: Task, robot: str) -> Case:
    law = jax.jit(law_of(task, robot))
    return ticks(task, robot, lambda *x: np.asarray(law(*x)), "jit of mjx.inverse")


def one_loop(task: Task, robot: str, ticks: int) -> Callable[..., tuple[Array, Array]]:
    """The loop of one sample, as a scan: (kp, kd, payload's mass) -> q at the end, RMS error."""
    own = mjx.put_model(model_of(task, robot))
    loaded = model_of(task, robot, payload=True)
    plant, held = mjx.put_model(loaded), loaded.body("payload").id
    center, amplitude, omega = task.sine(robot)
    blank = mjx.make_data(own)

    def loop(kp: Array, kd: Array, mass: Array) -> tuple[Array, Array]:
        model = plant.replace(body_mass=plant.body_mass.at[held].set(mass))

        def step(state: tuple, k: Array) -> tuple[tuple, None]:
            data, squares = state
            s, c = jnp.sin(omega * k * task.dt), jnp.cos(omega * k * task.dt)
            error = center + amplitude * s - data.qpos
            a = -amplitude * omega**2 * s + kp * error + kd * (amplitude * omega * c - data.qvel)
            tau = mjx.inverse(own, blank.replace(qpos=data.qpos, qvel=data.qvel, qacc=a)).qfrc_inverse
            return (mjx.step(model, data.replace(qfrc_applied=tau)), squares + jnp.sum(error**2)), None

        start = mjx.make_data(plant).replace(qpos=jnp.asarray(center), qvel=jnp.asarray(amplitude * omega))
        (data, squares), _ = jax.lax.scan(step, (start, jnp.zeros(())), jnp.arange(ticks))
        return data.qpos, jnp.sqrt(squares / ticks)

    return loop


def closed_loop(task: Task, robot: str) -> Case:
    steps = 10
    run = jax.jit(one_loop(task, robot, steps))
    par = (np.float64(task.kp), np.float64(task.kd), np.float64(task.payload["mass"]))
    return Case(
        lambda: np.asarray(run(*par)[0]), steps, "jit of lax.scan over mjx.inverse, mjx.step; semi-implicit Euler"
    )


def sweep(task: Task, samples: int, ticks: int, real: str) -> Case:
    jax.config.update("jax_enable_x64", real == "float64")
    run = jax.jit(jax.vmap(one_loop(task, "panda", ticks)))
    par = [jnp.asarray(column, dtype=real) for column in task.gains[:samples].T]
    how = f"jit of vmap of lax.scan over mjx.inverse, mjx.step, {real}"
    return Case(lambda: np.asarray(run(*par)[1]), samples * ticks, how)


CASES: dict[str, Callable[..., Case]] = {"tick": tick, "loop": closed_loop, "sweep": sweep}
