"""Bodies that are possible (pseudo-inertia positive definite) nearest to estimates, and the arm that has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from taut.analysis.identification.regression import ArmRegression
from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.arm.parts import Payload
from taut.base.types import Float64Array
from taut.maths.regressor import body_of, pseudo_inertia
from taut.trace import math as tm

PRIOR: Final = 1e-3  # weight of the arm as it was, in standard deviations: it decides what the record does not
RADIUS: Final = 0.05  # [m] of gyration, of the body with which the search begins where there was none
MIN_MASS: Final = 1e-6  # [kg] of it
DIFFERENCE: Final = 1e-6  # for slopes
UPPER: Final = np.triu_indices(4, 1)


def possible_bodies(
    regression: ArmRegression, estimate: Float64Array, covariance: Float64Array
) -> tuple[Float64Array, float]:
    """(m,) all unknowns, with bodies that are possible, and how far they are from the estimate [standard deviations].

    The base parameters K x are fitted with the weights of the estimate over log-Cholesky parameters of each body,
    P = U U^T, U upper triangular with positive diagonal. What K x does not determine stays near the arm as it was.
    """
    K, base, count = regression.K, list(regression.base), 10 * regression.bodies
    x = regression.nominal.copy()
    rows = [row for row, j in enumerate(base) if j < count]
    for row, j in enumerate(base[len(rows) :], start=len(rows)):
        x[j] = estimate[row]
    if len(rows) == count:
        x[:count] = estimate[rows]
        if all(_is_possible(body) for body in x[:count].reshape(-1, 10)):
            return x, 0.0
        x[:count] = regression.nominal[:count]
    A = K[rows][:, :count]
    target = estimate[rows] - K[rows][:, count:] @ x[count:]
    shape = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(rows, rows)]))
    pairs = zip(x[:count].reshape(-1, 10), np.linalg.lstsq(A, target, rcond=None)[0].reshape(-1, 10), strict=True)
    start = np.concatenate([_log_cholesky(own, likely) for own, likely in pairs])

    def misfit(theta: Float64Array) -> Float64Array:
        return np.concatenate([shape @ (A @ _bodies(theta) - target), PRIOR * (theta - start)])

    def slope(theta: Float64Array) -> Float64Array:
        steps = DIFFERENCE * np.eye(count)
        change = (_bodies(theta + steps) - _bodies(theta - steps)) / (2.0 * DIFFERENCE)
        return np.vstack([shape @ A @ change.T, PRIOR * np.eye(count)])

    theta = least_squares(misfit, start, jac=slope, max_nfev=200).x if rows else start
    x[:count] = _bodies(theta)
    return x, float(np.linalg.norm(misfit(theta)[: len(rows)]))


def _is_possible(body: Float64Array) -> bool:
    return bool(np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0)


def _log_cholesky(own: Float64Array, likely: Float64Array) -> Float64Array:
    """(10,) logarithms of the diagonal of U, and what is above it: of a body, or of one about a likely centre."""
    P = np.asarray(pseudo_inertia(own), dtype=np.float64)
    if not _is_possible(own):
        mass = max(float(likely[0]), MIN_MASS)
        c = np.array([*(likely[1:4] / mass if likely[0] > MIN_MASS else np.zeros(3)), 1.0])
        P = mass * (np.outer(c, c) + RADIUS**2 * np.diag([1.0, 1.0, 1.0, 0.0]))
    U = np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1]
    return np.concatenate([np.log(np.diag(U)), U[UPPER]])


def _bodies(theta: Float64Array) -> Float64Array:
    """(..., m) parameters of bodies, ten each, from log-Cholesky parameters (..., m)."""
    parts = theta.reshape(-1, 10)
    U = np.exp(parts[:, :4])[:, :, np.newaxis] * np.eye(4)
    U[:, UPPER[0], UPPER[1]] = parts[:, 4:]
    P = U @ np.swapaxes(U, 1, 2)
    xx, yy, zz = (P[:, i, i] for i in range(3))
    six = [yy + zz, xx + zz, xx + yy, -P[:, 0, 1], -P[:, 0, 2], -P[:, 1, 2]]
    return np.stack([P[:, 3, 3], *P[:, :3, 3].T, *six], axis=1).reshape(theta.shape)


def changed_arm(regression: ArmRegression, x: Float64Array, slow: Mapping[int, tuple[float, float]]) -> Arm:
    """The arm with the unknowns x, and static friction and Stribeck speed by joint; none of them is negative."""
    arm, n = regression.arm, regression.arm.n
    parts = iter(np.split(x, 10 * regression.bodies + n * np.arange(4)))
    bodies = next(parts).reshape(-1, 10)
    if "payload" in regression.what:
        mass, com, inertia = _about_centre(bodies[0])
        arm = dataclasses.replace(arm, payload=Payload(mass=mass, com=com, inertia=inertia))
    if "links" in regression.what:
        for joint, body in zip(arm.joint_names, bodies, strict=True):
            mass, com, inertia = _about_centre(body)
            arm = arm.with_body(joint, mass=mass, com=com, inertia=inertia)
    if "rotors" in regression.what:
        arm = arm.with_joints(rotor_inertia=np.maximum(next(parts), 0.0))
    if "friction" in regression.what:
        viscous, coulomb = (np.maximum(next(parts), 0.0) for _ in range(2))
        static, stribeck = coulomb.copy(), np.zeros(n)
        for i, (at_rest, speed) in slow.items():
            static[i], stribeck[i] = max(at_rest, coulomb[i]), speed
        arm = arm.with_friction(Friction(viscous=viscous, coulomb=coulomb, static=static, stribeck=stribeck))
    return arm


def _about_centre(parameters: Float64Array) -> tuple[float, Float64Array, Float64Array]:
    """Mass, centre of mass, and (3, 3) inertia about it."""
    body = body_of(parameters)
    com = body.h / body.m if body.m > 0.0 else np.zeros(3)
    S = tm.skew(com)
    return float(body.m), com, np.asarray(body.I + body.m * (S @ S), dtype=np.float64)
