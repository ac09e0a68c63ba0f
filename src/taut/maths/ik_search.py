"""The steps of a search for joint positions: pure functions from one state to the next, for floats and symbols."""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.base.types import Array, Float64Array
from taut.maths import dynamics as dyn
from taut.maths.ik import TINY, Resolved, Task, held_joints, shortened
from taut.maths.model import Model
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["posture_step", "search_step"]

LONGEST: Final = 1.0  # [rad | m] step of the search
LITTLE: Final = 1e-6  # damping that a chain with fewer directions than rows needs, and that others do not feel
LONGEST_POSTURE: Final = 0.2  # [rad | m] step along the free motion, where the task is followed to first order


def search_step(
    model: Model, task: Task, state: Array, target: Array, lower: Float64Array, upper: Float64Array
) -> Array:
    """One step of a Levenberg-Marquardt search with limits: a new state from an old one.

    A state is (kept q, tried q, cost of the kept one, damping, linear error, angular error, slope, limited). What was
    tried is kept where it is better; the next try starts from what is kept. Joints at a limit that the gradient
    would drive beyond are held (projected Newton). A target is (p, R row by row, posture).
    """
    n = model.n
    kept, tried, cost, trust = state[:n], state[n : 2 * n], state[2 * n], state[2 * n + 1]
    T_des = Pose.of(target[3:12].reshape(3, 3), target[:3])
    e = task.error(dyn.pose(model, tried, task.frame), T_des)
    better = (tm.array([e @ e]) < cost)[0]
    q = tm.where(better, tried, kept)
    trust = tm.clip(tm.where(better, 0.25 * trust, 6.0 * trust), 1e-6, 1e6)
    T = dyn.pose(model, q, task.frame)
    J, e = task.seen(T, dyn.jacobian(model, q, task.frame)), task.error(T, T_des)
    gradient = J.T @ e
    held = held_joints(q, gradient, lower, upper)
    free = 1.0 - held
    step = Resolved(J, free, trust * tm.norm(e) + TINY)(e)
    linear, angular = task.parts(T, T_des)
    slope, limited = tm.norm(free * gradient), np.sum(held)
    turn = tm.norm(angular) if len(angular) else 0.0
    new = tm.clip(q + shortened(step, LONGEST), lower, upper)
    return tm.array([*q, *new, e @ e, trust, tm.norm(linear), turn, slope, limited])


def posture_step(
    model: Model, task: Task, state: Array, target: Array, lower: Float64Array, upper: Float64Array
) -> Array:
    """One step towards the posture among the positions that keep the tool where it is to be.

    A state is (q, held, and of the q before it: linear error, angular error, distance to the posture; size of the
    step), a target as for `search_step`.
    """
    n = model.n
    q, held = state[:n], state[n : 2 * n]
    T_des = Pose.of(target[3:12].reshape(3, 3), target[:3])
    T = dyn.pose(model, q, task.frame)
    J, e = task.seen(T, dyn.jacobian(model, q, task.frame)), task.error(T, T_des)
    free, wanted = 1.0 - held, target[12:] - q
    solve = Resolved(J, free, LITTLE)
    step = shortened(solve(e, free * wanted), LONGEST_POSTURE)
    wish = wanted + J.T @ solve.multipliers(e, free * wanted)
    new = tm.clip(q + step, lower, upper)
    held = held_joints(new, wish, lower, upper)
    linear, angular = task.parts(T, T_des)
    turn = tm.norm(angular) if len(angular) else 0.0
    return tm.array([*new, *held, tm.norm(linear), turn, tm.norm(wanted), tm.norm(new - q)])
