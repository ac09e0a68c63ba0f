"""How far a point of an arm can get from its first joint: the largest distance that its limits allow."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from taut.arm.description import Arm, Joint
from taut.base.types import ArrayLike, Float64Array

STARTS: Final = 64  # poses to climb from; the hill has few tops, and one start in four finds the highest
MAX_SWEEPS_OF_CLIMB: Final = 200
LEAST_GAIN: Final = 1e-10  # [m] a sweep that gains less than this ends the climb
SEED: Final = 0


def reach(arm: Arm, frame: str | None = None, point: ArrayLike = (0.0, 0.0, 0.0)) -> float:
    """Largest distance [m] of a point (3,) [m] of a frame from the origin of the first joint on its chain.

    As a function of one joint it has its maximum in closed form (a sine, or a parabola of the slide): each joint in
    turn goes there until convergence. Infinite if a slide has no limit.
    """
    tool = arm.frame(frame)
    chain = [arm.joints[i] for i in arm.ancestors(tool.body)]
    if any(joint.kind == "prismatic" and math.isinf(joint.upper - joint.lower) for joint in chain):
        return math.inf
    rng = np.random.default_rng(SEED)
    q = np.stack([rng.uniform(*_range(joint), size=STARTS) for joint in chain]) if chain else np.zeros((0, STARTS))
    p_tool = tool.placement.p + tool.placement.R @ np.asarray(point, dtype=np.float64)
    best = -1.0
    for _ in range(MAX_SWEEPS_OF_CLIMB):
        distance = _sweep(chain, q, p_tool)
        if distance - best < LEAST_GAIN:
            break
        best = distance
    return max(best, distance)


def _range(joint: Joint) -> tuple[float, float]:
    if joint.kind == "prismatic":
        return joint.lower, joint.upper
    return max(joint.lower, -math.pi), min(joint.upper, max(joint.lower, -math.pi) + 2.0 * math.pi)


def _sweep(chain: list[Joint], q: Float64Array, p_tool: Float64Array) -> float:
    """Move each joint to its best position, in all starts at once; the largest distance then reached."""
    origins = _first_origin(chain, q)
    t = np.broadcast_to(p_tool, (STARTS, 3)).copy()  # the tool, in the frame of the joint at hand
    first = math.hypot(*p_tool)
    for k in reversed(range(len(chain))):
        joint, axis = chain[k], chain[k].axis
        o = origins[k]
        along, across = t @ axis, np.cross(axis, t)
        if joint.kind == "prismatic":
            near = along - o @ axis  # |t + a q - o|^2 grows with |q + near|
            low, high = joint.lower + near, joint.upper + near
            q[k] = np.where(np.abs(low) > np.abs(high), joint.lower, joint.upper)
            t = t + q[k][:, None] * axis
        else:
            radial = t - along[:, None] * axis
            A, B = -np.sum(o * radial, axis=1), -np.sum(o * across, axis=1)  # gain: A cos q + B sin q
            q[k] = _best_angle(A, B, joint)
            t = along[:, None] * axis + np.cos(q[k])[:, None] * radial + np.sin(q[k])[:, None] * across
        if k == 0:
            first = float(np.sqrt(np.max(np.sum(t * t, axis=1))))
        t = t @ joint.placement.R.T + joint.placement.p
    return first


def _best_angle(A: Float64Array, B: Float64Array, joint: Joint) -> Float64Array:
    best: Float64Array = np.arctan2(B, A)
    if math.isinf(joint.lower) or math.isinf(joint.upper):
        return best
    best = best + 2.0 * np.pi * np.ceil((joint.lower - best) / (2.0 * np.pi))  # the first one above `lower`
    ends = np.where(
        A * math.cos(joint.lower) + B * math.sin(joint.lower) > A * math.cos(joint.upper) + B * math.sin(joint.upper),
        joint.lower,
        joint.upper,
    )
    return np.where(best <= joint.upper, best, ends)


def _first_origin(chain: list[Joint], q: Float64Array) -> list[Float64Array]:
    """The first joint's origin, seen from where each joint stands before it moves: (STARTS, 3) each."""
    o = np.zeros((STARTS, 3))
    seen = []
    for k, joint in enumerate(chain):
        if k > 0:
            o = (o - joint.placement.p) @ joint.placement.R
        seen.append(o)
        axis = joint.axis
        if joint.kind == "prismatic":
            o = o - q[k][:, None] * axis
        else:  # turn back by q
            along = (o @ axis)[:, None] * axis
            o = along + np.cos(q[k])[:, None] * (o - along) - np.sin(q[k])[:, None] * np.cross(axis, o)
    return seen
