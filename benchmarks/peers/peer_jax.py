"""JAX (`pip install jax`) on one core: the graphs that taut compiles, as straight-line Python: jit, vmap, lax.scan.

A recursion written by hand with jax.numpy was slower: 6.3 against 4.9 us a step of 1024 loops at once.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from worker import Array, Case, Task, ticks

jax.config.update("jax_enable_x64", True)


def graphs(task: Task) -> ModuleType:
    """The file that `peer_taut.write_graphs` wrote."""
    spec = importlib.util.spec_from_file_location("graphs", task.folder / "graphs.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def tick(task: Task, robot: str) -> Case:
    module = graphs(task)
    par = [np.float64(x) for x in module.TICK_PARAMETERS]
    memory = [np.float64(x) for x in module.TICK_MEMORY]

    @jax.jit
    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        given = {"t": 0.0, "q": q, "v": v, "ref.q": q_des, "ref.v": v_des, "ref.a": a_des}
        row = jnp.concatenate([jnp.ravel(given[path]) for path in module.TICK_INPUTS])
        return jnp.stack(module.tick(jnp, list(row), par, memory))

    return ticks(task, robot, lambda *x: np.asarray(law(*x)), "jit of the graph")


def one_loop(task: Task, ticks: int, real: str) -> Callable[..., tuple[Array, Array]]:
    """The loop of one sample, as a scan: (kp, kd, payload's mass) -> q at the end, RMS error."""
    module = graphs(task)
    center, amplitude, omega = (row.astype(real) for row in task.sine("panda"))
    at, n = module.PLACES["plant.q"]

    def loop(kp: Array, kd: Array, mass: Array) -> tuple[Array, Array]:
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
            squares = squares + jnp.sum((q_des - memory[at : at + n]) ** 2)
            return (jnp.stack(module.step(jnp, list(row), list(par), list(memory))), squares), None

        start = jnp.asarray(module.MEMORY, real), jnp.zeros((), real)
        (memory, squares), _ = jax.lax.scan(step, start, jnp.arange(ticks))
        return memory[at : at + n], jnp.sqrt(squares / ticks)

    return loop


def closed_loop(task: Task, robot: str) -> Case:  # noqa: ARG001
    steps = 1000
    run = jax.jit(one_loop(task, steps, "float64"))
    par = [np.float64(x) for x in (task.kp, task.kd, task.payload["mass"])]
    return Case(lambda: np.asarray(run(*par)[0]), steps, "jit of lax.scan of the graph")


def sweep(task: Task, samples: int, ticks: int, real: str) -> Case:
    run = jax.jit(jax.vmap(one_loop(task, ticks, real)))
    par = [jnp.asarray(column, dtype=real) for column in task.gains[:samples].T]
    return Case(lambda: np.asarray(run(*par)[1]), samples * ticks, f"jit of vmap of lax.scan of the graph, {real}")


CASES: dict[str, Callable[..., Case]] = {"tick": tick, "loop": closed_loop, "sweep": sweep}
