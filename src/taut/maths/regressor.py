"""The dynamics as linear in inertial parameters, and what keeps those of a body possible.

Ten parameters of a body, in the axes and about the origin of its joint's frame (the axis on z): mass m, first moment
h = m c, and the inertia xx, yy, zz, xy, xz, yz. Joint torques are Y pi with the regressor Y; rotors are not in it.

References:
    Atkeson, An and Hollerbach (1986), IJRR 5 (3): the regressor. Wensing, Kim and Slotine (2018), IEEE RA-L 3 (1):
    the pseudo-inertia P = [[tr(I)/2 1 - I, h], [h^T, m]], positive definite for every possible body and no other.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from taut.arm.parts import inertia_entries
from taut.base.types import Float64Array, Matrix, Vector, Vector3
from taut.maths.dynamics import along_reference, body_motions, body_velocities, joint_placements
from taut.maths.model import Model, RigidBody
from taut.maths.model import body_of as body_of
from taut.trace import math as tm
from taut.trace.math import cross

PARAMETERS: Final = ("m", "h_x", "h_y", "h_z", "I_xx", "I_yy", "I_zz", "I_xy", "I_xz", "I_yz")
"""Ten parameters of a body [kg, kg m, kg m^2]."""


def parameters_of(body: RigidBody) -> Vector:
    """(10,) of a body."""
    return tm.array([body.m, *body.h, *inertia_entries(body.I)])


def moved(R: Matrix, p: Vector3) -> Float64Array:
    """(10, 10) from the parameters of a body in a frame at R, p to those in the frame around it."""
    return np.array([parameters_of(body_of(unit).seen_from(R, p)) for unit in np.eye(10)], dtype=np.float64).T


def covectors(model: Model, q: Vector, v: Vector, a: Vector, s: Vector, *, gravity: Any = True) -> Matrix:
    """(n, 10) y of each body: s . (M a + C v + g) is the sum of y . pi over all bodies, but for the rotors' part."""
    placed = joint_placements(model, q)
    motions = body_motions(model, placed, range(model.n), v, a, gravity=gravity)
    rows = []
    for (w, dw, dv, U), (u_s, w_s) in zip(motions.values(), body_velocities(model, placed, s)[1], strict=True):
        turn = cross(w_s, w)  # w_s . (w x I w) = (w_s x w) . I w
        Y = np.outer(w_s, dw) + np.outer(turn, w)
        six = [Y[0, 0], Y[1, 1], Y[2, 2], Y[0, 1] + Y[1, 0], Y[0, 2] + Y[2, 0], Y[1, 2] + Y[2, 1]]
        rows.append([u_s @ dv, *(U.T @ u_s + cross(dv, w_s)), *six])
    return tm.array(rows)


def reference_covectors(model: Model, q: Vector, v: Vector, v_ref: Vector, a_ref: Vector, s: Vector) -> Matrix:
    """(n, 10) as `covectors`, of s . (M a_ref + C(q, v) v_ref + g) with M-dot - 2 C skew."""

    def torques(v: Vector, a: Vector, gravity: Any) -> Matrix:
        return covectors(model, q, v, a, s, gravity=gravity)

    return np.reshape(along_reference(torques, v, v_ref, a_ref), (model.n, 10))


def regressor(model: Model, q: Vector, v: Vector, a: Vector) -> Matrix:
    """(n, 10 n) Y with M a + C v + g = Y pi + rotor inertia * a; columns body by body, as `PARAMETERS`."""
    rows = [covectors(model, q, v, a, unit).reshape(-1).tolist() for unit in np.eye(model.n)]
    return tm.array(rows)


def pseudo_inertia(parameters: Vector) -> Matrix:
    """(4, 4) P of ten parameters."""
    body = body_of(parameters)
    half = 0.5 * (body.I[0, 0] + body.I[1, 1] + body.I[2, 2])
    rows = [[*(half * np.eye(3)[i] - body.I[i]), body.h[i]] for i in range(3)]
    return tm.array([*rows, [*body.h, body.m]])


def of_pseudo_inertia(P: Matrix) -> Vector:
    """(10,) parameters of P (4, 4)."""
    trace = P[0, 0] + P[1, 1] + P[2, 2]
    return parameters_of(RigidBody(m=P[3, 3], h=P[:3, 3], I=trace * tm.eye(3) - P[:3, :3]))


def covector_matrix(y: Vector) -> Matrix:
    """(4, 4) symmetric L with tr(L P) = y . pi for every body."""
    xx, yy, zz, xy, xz, yz = y[4:]
    (a, b, c), (d, e, f) = 0.5 * y[1:4], (-0.5 * xy, -0.5 * xz, -0.5 * yz)
    return tm.array([[yy + zz, d, e, a], [d, xx + zz, f, b], [e, f, xx + yy, c], [a, b, c, y[0]]])
