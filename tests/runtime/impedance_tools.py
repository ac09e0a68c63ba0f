"""Wrenches that act on a tool, and what a run says about its deviation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import taut
from taut.base.types import Float64Array
from taut.trace import math as tm

Values = Mapping[str, Any]


class Shaker(taut.environments.Environment):
    """A wrench of the world: constant + amplitude sin(2 pi f t), force first, world axes."""

    constant: taut.environments.Field = taut.environments.Field((0.0,) * 6, shape=6)
    amplitude: taut.environments.Field = taut.environments.Field((0.0,) * 6, shape=6)
    frequency: taut.environments.Field = taut.environments.Field(1.0, unit="Hz")

    def wrench(
        self, T_WE: taut.Pose, twist: Any, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        wave = tm.sin(2.0 * np.pi * parameters["frequency"] * t)
        return parameters["constant"] + parameters["amplitude"] * wave, {}


class Kick(taut.environments.Environment):
    """A wrench that acts until a time, as half a sine."""

    wrench_most: taut.environments.Field = taut.environments.Field(shape=6)
    duration: taut.environments.Field = taut.environments.Field(unit="s")

    def wrench(
        self, T_WE: taut.Pose, twist: Any, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Any, dict[str, Any]]:
        phase = tm.minimum(t / parameters["duration"], 1.0)
        return parameters["wrench_most"] * tm.sin(np.pi * phase), {}


def deviation(run: taut.Run, pose: taut.Pose, every: int = 1) -> Float64Array:
    """(k, 6) where the tool is, less where it should be, world axes [m, rad]."""
    turn = Rotation.from_matrix(run.task.R[::every] @ pose.R.T).as_rotvec()
    return np.hstack([run.task.p[::every] - pose.p, turn])


def poses_of(arm: taut.Arm, count: int, seed: int) -> list[Float64Array]:
    """Joint positions around home where the tool can move in every direction."""
    rng = np.random.default_rng(seed)
    found: list[Float64Array] = []
    while len(found) < count:
        q = arm.home + rng.uniform(-0.5, 0.5, arm.n)
        if np.linalg.svd(taut.snapshot(arm, q).J(), compute_uv=False)[-1] > 0.1:
            found.append(q)
    return found


def inertia(arm: taut.Arm, q: Float64Array) -> Float64Array:
    """(6, 6) Lambda at q."""
    x = taut.snapshot(arm, q)
    return np.linalg.inv(x.J() @ np.linalg.inv(x.M) @ x.J().T)
