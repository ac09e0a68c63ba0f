"""Kinematics and dynamics of a tree of joints, written once, for floats and for symbols.

Vectors are (n,) in the order of the arm's joints, in body i's own frame unless said. The payload is added to the body
that carries the tool; rotor inertia acts on each joint's own acceleration. Without friction: h = C v + g.

References:
    Featherstone, Rigid Body Dynamics Algorithms (2008): recursive Newton-Euler (5.3), composite rigid bodies (6.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from taut.arm.description import BASE
from taut.base.types import Array, Matrix, Vector, Vector3
from taut.maths.model import Adds, JointConstants, Model, PayloadValues, RigidBody, body_of
from taut.trace import math as tm
from taut.trace.math import cross
from taut.trace.pose import Pose

Z = np.array([0.0, 0.0, 1.0])


def _placed(joint: JointConstants, q: Any) -> tuple[Matrix, Vector3]:
    """Orientation and origin of a body in its parent's frame."""
    if joint.prismatic:
        return joint.R, joint.p + joint.R[:, 2] * q
    c, s = tm.cos(q), tm.sin(q)
    return joint.R @ tm.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), joint.p


def joint_placements(model: Model, q: Vector) -> list[tuple[Matrix, Vector3]]:
    """Orientation and origin of each body in its parent's frame."""
    return [_placed(joint, q[i]) for i, joint in enumerate(model.joints)]


def loaded_bodies(model: Model, payload: PayloadValues | None) -> list[RigidBody]:
    """The bodies, with the payload on the one that carries the tool, and what the links carry besides."""
    bodies = list(model.bodies)
    if payload is not None:
        if payload.links is not None:
            bodies = [body + body_of(row) for body, row in zip(bodies, payload.links, strict=True)]
        body, R, p = model.placement(None)
        if body != BASE:
            bodies[body] = bodies[body] + payload.body().seen_from(R, p)
    return bodies


Motion = tuple[Vector3, Vector3, Vector3, Matrix]


def _swept(w: Vector3, dw: Vector3) -> Matrix:
    """(3, 3) U with U r = dw x r + w x (w x r): the acceleration of a body's points by its turning."""
    (x, y, z), (a, b, c) = w, dw
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    return tm.array([[-(yy + zz), xy - c, xz + b], [xy + c, -(xx + zz), yz - a], [xz - b, yz + a, -(xx + yy)]])


def body_motions(
    model: Model,
    placed: Sequence[tuple[Matrix, Vector3]],
    bodies: Iterable[int],  # each after its parent
    v: Vector | None,
    a: Vector | None,
    *,
    gravity: Any,  # the base is accelerated by -g times it
) -> dict[int, Motion]:
    """Angular velocity and acceleration, acceleration of the origin and U of bodies, in body axes; None is zero."""
    zero = np.zeros(3)
    upwards = zero if gravity is False else -model.gravity_B * gravity
    out: dict[int, Motion] = {BASE: (zero, zero, upwards, np.zeros((3, 3)))}
    for i in bodies:
        joint, (R, p) = model.joints[i], placed[i]
        w, dw, dv, U = out[joint.parent]
        w_i = R.T @ w
        dv_i = R.T @ (dv + U @ p)
        dw_i = R.T @ dw
        if joint.prismatic:
            if v is not None:
                dv_i = dv_i + 2.0 * v[i] * cross(w_i, Z)
            if a is not None:
                dv_i = dv_i + a[i] * Z
        else:
            if v is not None:
                dw_i = dw_i + v[i] * cross(w_i, Z)
                w_i = w_i + v[i] * Z
            if a is not None:
                dw_i = dw_i + a[i] * Z
        out[i] = w_i, dw_i, dv_i, _swept(w_i, dw_i)
    del out[BASE]
    return out


def inverse_dynamics(
    model: Model,
    q: Vector,
    v: Vector | None,
    a: Vector | None,
    payload: PayloadValues | None = None,
    *,
    gravity: bool = True,
) -> Vector:
    """(n,) joint torques M a + C v + g, by recursive Newton-Euler; None stands for zeros."""
    return newton_euler(model, loaded_bodies(model, payload), q, v, a, gravity=gravity)


def newton_euler(
    model: Model,
    bodies: Sequence[RigidBody],  # one for each joint, in place of the model's
    q: Vector,
    v: Vector | None,
    a: Vector | None,
    *,
    gravity: Any = True,  # or by how much to multiply it
) -> Vector:
    """(n,) joint torques M a + C v + g of an arm of these bodies, linear in them but for the rotors' I a."""
    placed = joint_placements(model, q)
    forces: list[Vector3] = []
    moments: list[Vector3] = []
    motions = body_motions(model, placed, range(model.n), v, a, gravity=gravity)
    for body, (w, dw, dv, U) in zip(bodies, motions.values(), strict=True):
        forces.append(body.m * dv + U @ body.h)
        moments.append(body.I @ dw + cross(w, body.I @ w) + cross(body.h, dv))
    tau: list[Any] = [0.0] * model.n
    for i in range(model.n - 1, -1, -1):
        joint = model.joints[i]
        tau[i] = forces[i][2] if joint.prismatic else moments[i][2]
        if a is not None:
            tau[i] = tau[i] + joint.rotor_inertia * a[i]
        if joint.parent != BASE:
            R, p = placed[i]
            force = R @ forces[i]
            forces[joint.parent] = forces[joint.parent] + force
            moments[joint.parent] = moments[joint.parent] + R @ moments[i] + cross(p, force)
    return tm.array(tau)


def along_reference(torques: Callable[..., Any], v: Vector, v_ref: Vector, a_ref: Vector) -> Any:
    """What torques(v, a, gravity) = M a + C(v) v + gravity g is as M a_ref + C(v) v_ref + g; also for parts of it.

    C of Christoffel symbols, with M-dot - 2 C skew, is linear in v with C(v) w = C(w) v: C(v) v_ref is half the
    derivative of C(v) v along v_ref. The rest is linear, so that half the derivative of it all is what is asked for.
    """

    def moved(step: Array) -> Any:
        twice = 2.0 * step[0]
        return np.reshape(torques(v + step[0] * v_ref, twice * a_ref, twice), (-1,))

    return 0.5 * tm.jacobian(moved, np.zeros(1))[:, 0]


def reference_dynamics(
    model: Model,
    bodies: Sequence[RigidBody],
    q: Vector,
    v: Vector,
    v_ref: Vector,
    a_ref: Vector,
) -> Vector:
    """(n,) M a_ref + C(q, v) v_ref + g of an arm of these bodies, with M-dot - 2 C skew."""

    def torques(v: Vector, a: Vector, gravity: Any) -> Vector:
        return newton_euler(model, bodies, q, v, a, gravity=gravity)

    out: Vector = along_reference(torques, v, v_ref, a_ref)
    return out


Velocities = list[tuple[Vector3, Vector3]]


def body_velocities(
    model: Model, placed: Sequence[tuple[Matrix, Vector3]], v: Vector
) -> tuple[Velocities, Velocities]:
    """Linear and angular velocity at each joint's origin, in its axes: of the body before it, and of its own."""
    before: Velocities = []
    own: Velocities = []
    for i, (joint, (R, p)) in enumerate(zip(model.joints, placed, strict=True)):
        u, w = (np.zeros(3), np.zeros(3)) if joint.parent == BASE else own[joint.parent]
        u, w = R.T @ (u + cross(w, p)), R.T @ w
        before.append((u, w))
        own.append((u + v[i] * Z, w) if joint.prismatic else (u, w + v[i] * Z))
    return before, own


def momentum(model: Model, q: Vector, v: Vector, payload: PayloadValues | None = None) -> tuple[Vector, Vector]:
    """(n,) each: generalised momentum p = M v, and C^T v = (d/dq) v M v / 2, by one recursion.

    dp/dt = tau + C^T v - g. A joint that turns what it carries changes its energy only by the velocity V of the body
    before, so that (d/dq_i) T = -P_i . (S_i x V): P_i momentum of all that joint i carries, S_i its axis.
    """
    placed = joint_placements(model, q)
    before, own = body_velocities(model, placed, v)
    momenta = [
        (body.m * u + cross(w, body.h), body.I @ w + cross(body.h, u))
        for body, (u, w) in zip(loaded_bodies(model, payload), own, strict=True)
    ]
    p_joints, rate = tm.zeros(model.n), tm.zeros(model.n)
    for i in range(model.n - 1, -1, -1):
        joint, (force, moment), (u, w) = model.joints[i], momenta[i], before[i]
        p_joints[i] = (force[2] if joint.prismatic else moment[2]) + joint.rotor_inertia * v[i]
        rate[i] = -(force @ cross(Z, w)) if joint.prismatic else -(force @ cross(Z, u) + moment @ cross(Z, w))
        if joint.parent != BASE:
            R, p = placed[i]
            force = R @ force
            moment = R @ moment + cross(p, force)
            momenta[joint.parent] = (momenta[joint.parent][0] + force, momenta[joint.parent][1] + moment)
    return p_joints, rate


def bias(
    model: Model,
    q: Vector,
    v: Vector,
    payload: PayloadValues | None = None,
    *,
    gravity: bool = True,
) -> Vector:
    """(n,) h = C v + g, or C v alone without gravity."""
    return inverse_dynamics(model, q, v, None, payload, gravity=gravity)


def gravity_torque(model: Model, q: Vector, payload: PayloadValues | None = None) -> Vector:
    """(n,) g: the torques that hold the arm at rest."""
    return inverse_dynamics(model, q, None, None, payload)


def compensation(model: Model, adds: Adds, q: Vector, v: Vector, payload: PayloadValues) -> Array:
    """(n,) gravity and Coriolis torques that are added; friction apart, of which none is left then."""
    total: Any = np.zeros(model.n)
    if adds.gravity:
        load = payload if adds.load is None else PayloadValues.of(adds.load)
        total = total + gravity_torque(model, q, load)
    if adds.coriolis:
        total = total + bias(model, q, v, payload, gravity=False)
    return total  # type: ignore[no-any-return]


def mass_matrix(model: Model, q: Vector, payload: PayloadValues | None = None) -> Matrix:
    """(n, n) M, symmetric positive definite, by composite rigid bodies."""
    placed = joint_placements(model, q)
    composite = loaded_bodies(model, payload)
    M = tm.zeros((model.n, model.n))
    for i in range(model.n - 1, -1, -1):
        joint, body = model.joints[i], composite[i]
        # Momentum of the composite body when joint i alone moves at unit speed.
        if joint.prismatic:
            force, moment = body.m * Z, cross(body.h, Z)
        else:
            force, moment = cross(Z, body.h), body.I[:, 2]
        M[i, i] = (force[2] if joint.prismatic else moment[2]) + joint.rotor_inertia
        j = i
        while model.joints[j].parent != BASE:
            R, p = placed[j]
            force = R @ force
            moment = R @ moment + cross(p, force)
            j = model.joints[j].parent
            M[i, j] = M[j, i] = force[2] if model.joints[j].prismatic else moment[2]
        if joint.parent != BASE:
            composite[joint.parent] = composite[joint.parent] + body.seen_from(*placed[i])
    return M


def forward_dynamics(
    model: Model,
    q: Vector,
    v: Vector,
    tau: Vector,
    payload: PayloadValues | None = None,
    *,
    damping: Array | None = None,
) -> Vector:
    """(n,) accelerations M^-1 (tau - h); `damping` (n,) is added to the diagonal of M.

    The mass matrix is factorised, which for the arms of this field beats the articulated-body recursion.
    """
    M = mass_matrix(model, q, payload)
    if damping is not None:
        for i in range(model.n):
            M[i, i] = M[i, i] + damping[i]
    solved: Vector = tm.solve_spd(M, tau - bias(model, q, v, payload))
    return solved


def link_poses(model: Model, q: Vector) -> list[tuple[Matrix, Vector3]]:
    """Orientation and origin of every body in the world, in the model's own body frames."""
    out: list[tuple[Matrix, Vector3]] = []
    for i, joint in enumerate(model.joints):
        R, p = _placed(joint, q[i])
        R_W, p_W = (model.R_WB, model.p_WB) if joint.parent == BASE else out[joint.parent]
        out.append((R_W @ R, R_W @ p + p_W))
    return out


def pose(model: Model, q: Vector, frame: str | None = None) -> Pose:
    """T_WE of a frame; of the tool if none is named."""
    body, R, p = model.placement(frame)
    if body == BASE:
        return Pose.of(model.R_WB @ R, model.R_WB @ p + model.p_WB)
    R_W, p_W = link_poses(model, q)[body]
    return Pose.of(R_W @ R, R_W @ p + p_W)


def jacobian(model: Model, q: Vector, frame: str | None = None, axes: str = "W") -> Matrix:
    """(6, n) J_WE: twist of the frame's origin per joint speed, linear part first.

    Frames: axes "W" gives J_WE_W, aligned with the world; "E" gives J_WE_E, aligned with the frame itself.
    """
    body, R_in_body, p_in_body = model.placement(frame)
    J = tm.zeros((6, model.n))
    if body == BASE:
        return J
    links = link_poses(model, q)
    R_W, p_W = links[body]
    origin = R_W @ p_in_body + p_W
    for i in model.arm.ancestors(body):
        R_i, p_i = links[i]
        axis = R_i[:, 2]
        if model.joints[i].prismatic:
            J[:3, i] = axis
        else:
            J[:3, i] = cross(axis, origin - p_i)
            J[3:, i] = axis
    if axes == "E":
        R_EW = (R_W @ R_in_body).T
        J[:3], J[3:] = R_EW @ J[:3], R_EW @ J[3:]
    return J


def twist(model: Model, q: Vector, v: Vector, frame: str | None = None, axes: str = "W") -> Vector:
    """(6,) twist of a frame, linear part first [m/s, rad/s]: J v."""
    moved: Vector = jacobian(model, q, frame, axes) @ v
    return moved


def jacobian_rate_v(model: Model, q: Vector, v: Vector, frame: str | None = None, axes: str = "W") -> Vector:
    """(6,) J-dot v: the acceleration of a frame when the joints do not accelerate [m/s^2, rad/s^2].

    With axes "W" the linear part is the acceleration of the frame's origin, with "E" the rate of the twist's own
    numbers.
    """
    body, R_in_body, p_in_body = model.placement(frame)
    if body == BASE:
        return tm.zeros(6)
    placed = joint_placements(model, q)
    _, dw, dp, U = body_motions(model, placed, model.arm.ancestors(body), v, None, gravity=False)[body]
    dp = dp + U @ p_in_body
    if axes == "W":
        R_W = link_poses(model, q)[body][0]
        return tm.array([*(R_W @ dp), *(R_W @ dw)])
    velocity = twist(model, q, v, frame, axes="E")
    w_E = velocity[3:]
    return tm.array([*(R_in_body.T @ dp - cross(w_E, velocity[:3])), *(R_in_body.T @ dw)])


def coriolis_matrix(model: Model, q: Vector, v: Vector, payload: PayloadValues | None = None) -> Matrix:
    """(n, n) C of Christoffel symbols: C v are Coriolis and centripetal torques, M-dot - 2 C is skew.

    C v is quadratic in v with C(v) w = C(w) v, so that C is half its derivative.
    """
    derivative = tm.jacobian(lambda at: bias(model, q, at, payload, gravity=False), v)
    return 0.5 * derivative


def kinetic_energy(model: Model, q: Vector, v: Vector, payload: PayloadValues | None = None) -> Any:
    """Kinetic energy [J]: v M v / 2."""
    return 0.5 * (v @ (mass_matrix(model, q, payload) @ v))


def potential_energy(model: Model, q: Vector, payload: PayloadValues | None = None) -> Any:
    """Potential energy in gravity [J], zero at the world's origin, of the Arm's bodies: regrouping moves mass."""
    g = model.arm.gravity
    energy: Any = 0.0
    links = link_poses(model, q)
    for (R, p), A, body in zip(links, model.aligned, model.arm.bodies, strict=True):
        energy = energy - body.mass * (g @ (R @ (A.T @ body.com) + p))
    if payload is not None:
        T = pose(model, q)
        energy = energy - payload.mass * (g @ T.act(payload.com))
    return energy
