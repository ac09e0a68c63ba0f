"""Brax (`pip install brax`): its generalised-coordinate pipeline in JAX, on the processor."""

from __future__ import annotations

import os

os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # XLA takes all the processors that it is given
os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import numpy as np
from brax.generalized import dynamics, pipeline
from brax.io import mjcf
from peer_mujoco import model_of
from worker import Array, Case, Task, ticks

jax.config.update("jax_enable_x64", True)


def tick(task: Task, robot: str) -> Case:
    system, kp, kd = mjcf.load_model(model_of(task, robot, geoms=True)), task.kp, task.kd

    @jax.jit
    def law(q: Array, v: Array, q_des: Array, v_des: Array, a_des: Array) -> Array:
        state = pipeline.init(system, q, v)
        return state.mass_mx @ (a_des + kp * (q_des - q) + kd * (v_des - v)) + dynamics.inverse(system, state)

    return ticks(task, lambda *x: np.asarray(law(*x)), "jit of pipeline.init, mass_mx, dynamics.inverse", robot)


CASES = {"tick": tick}
