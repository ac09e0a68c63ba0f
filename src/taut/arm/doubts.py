"""Numbers of a model that no arm has: those that leave no mass matrix are refused, those to doubt are named."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.parts import BASE
from taut.base.errors import quoted_list
from taut.base.types import Float64Array

if TYPE_CHECKING:
    from taut.arm.description import Arm

__all__ = ["indefinite", "model_doubts"]

LEAST_EIGENVALUE: Final = 1e-12  # of M scaled to a unit diagonal; rounding is 1e-16 of its entries
POSES: Final = 10
MAX_ENTRIES: Final = 20_000  # of all matrices M: fewer poses of an arm of many joints
DEGREES: Final = (13.0, 1000.0)  # [rad] limits in degrees are in here; no joint turns about twice and stops
HEAVIEST: Final = 25_000.0  # [kg/m^3] osmium has 22,600
HEAVIEST_ARM: Final = 1000.0  # [kg/m^3] of all that moves, in a cube as wide as the arm is long; 140 are known


def indefinite(arm: Arm) -> float | None:
    """The least eigenvalue of M, scaled to a unit diagonal, where it is too small at a random pose; None if never.

    It is what rounding has to stay below, for M to be positive definite in floats too.
    """
    poses = max(1, min(POSES, MAX_ENTRIES // arm.n**2))
    rng = np.random.default_rng(0)
    low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    q = np.where(low < high, rng.uniform(np.minimum(low, high), np.maximum(low, high), (poses, arm.n)), arm.home)
    M = _mass_matrices(arm, q)
    size = np.sqrt(np.einsum("kii->ki", M))
    if not (np.isfinite(M).all() and (size > 0.0).all()):
        return 0.0
    least = float(np.linalg.eigvalsh(M / (size[:, :, np.newaxis] * size[:, np.newaxis, :])).min())
    return None if least > LEAST_EIGENVALUE else least


def _mass_matrices(arm: Arm, q: Float64Array) -> Float64Array:
    """(k, n, n) sum of m J_v^T J_v + J_w^T I J_w over the bodies, and the rotors."""
    k, n = q.shape
    R, p = np.zeros((n, k, 3, 3)), np.zeros((n, k, 3))
    axes = np.zeros((n, k, 3))
    M = np.zeros((k, n, n)) + np.diag(arm.rotor_inertia)
    for i, (joint, body) in enumerate(zip(arm.joints, arm.bodies, strict=True)):
        start = (np.eye(3), np.zeros(3)) if joint.parent == BASE else (R[joint.parent], p[joint.parent])
        R[i], p[i] = start[0] @ joint.placement.R, start[1] + start[0] @ joint.placement.p
        axes[i] = R[i] @ joint.axis
        if joint.kind == "prismatic":
            p[i] += axes[i] * q[:, i : i + 1]
        else:
            R[i] = R[i] @ _about(joint.axis, q[:, i])
        c = p[i] + R[i] @ body.com
        moving = list(arm.ancestors(i))
        slides = np.array([arm.joints[j].kind == "prismatic" for j in moving])[:, np.newaxis, np.newaxis]
        z = axes[moving]
        J_v = np.where(slides, z, np.cross(z, c - p[moving]))
        J_w = np.where(slides, 0.0, z)
        I = R[i] @ body.inertia @ np.swapaxes(R[i], 1, 2)
        part = body.mass * np.einsum("ikx,jkx->kij", J_v, J_v) + np.einsum("ikx,kxy,jky->kij", J_w, I, J_w)
        M[np.ix_(range(k), moving, moving)] += part
    return M


def _about(axis: Float64Array, angle: Float64Array) -> Float64Array:
    """(k, 3, 3) rotations about a unit axis."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, np.newaxis, np.newaxis], np.cos(angle)[:, np.newaxis, np.newaxis]
    return np.asarray(np.eye(3) + s * K + (1.0 - c) * (K @ K))


def model_doubts(arm: Arm) -> Iterator[str]:
    """What is hard to believe of limits and masses, in sentences: mostly a wrong unit. Nothing of it is refused."""
    turned = [
        joint.name
        for joint in arm.joints
        if joint.kind == "revolute" and any(DEGREES[0] < abs(x) < DEGREES[1] for x in (joint.lower, joint.upper))
    ]
    if turned:
        yield f"position limits of {quoted_list(turned)} are more than two turns; were they given in degrees?"
    length = _length(arm)
    if not math.isfinite(length):
        return
    if arm.total_mass > HEAVIEST_ARM * length**3:
        yield f"{arm.total_mass:.4g} kg are hard to believe of an arm of {length:.3g} m; were masses given in g?"
    radii = np.array([math.sqrt(float(np.linalg.eigvalsh(body.inertia)[-1]) / body.mass) for body in arm.bodies])
    balls = 4.0 / 3.0 * math.pi * (math.sqrt(2.5) * radii) ** 3  # [m^3] with the same radius of gyration
    masses = np.array([body.mass for body in arm.bodies])
    for wrong, why in (
        (radii > length, f"its radius of gyration is up to {radii.max():.3g} m, and the arm has {length:.3g} m"),
        (masses > HEAVIEST * balls, "no matter is so dense that it could be so small for its mass"),
    ):
        if wrong.any():
            links = quoted_list([body.links[0] for body, one in zip(arm.bodies, wrong, strict=True) if one], 3)
            yield f"the inertia of {links} is hard to believe: {why}; give it in kg m^2, about the centre of mass"


def _length(arm: Arm) -> float:
    """[m] from the first joint to the farthest centre of mass or the tool, were all of it stretched."""
    joints: list[float] = []
    for joint in arm.joints:
        before = 0.0 if joint.parent == BASE else joints[joint.parent] + float(np.linalg.norm(joint.placement.p))
        slide = max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
        joints.append(before + slide)
    ends = [*zip(range(arm.n), (body.com for body in arm.bodies), strict=True)]
    tool = arm.frame(None)
    ends += [(tool.body, tool.placement.p)] if tool.body != BASE else []
    return max(joints[i] + float(np.linalg.norm(p)) for i, p in ends)
