"""Section 10.2.3: motion control in task space, through the joints or directly, and three choices of the error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import taut
from taut import Controller, Gain, Law, Pose, Snapshot, TaskMotion, Torque, snapshot
from taut import math as tm
from taut.base.types import Float64Array
from taut.book.models import in_mujoco, panda, simulated, ticked, total, two, two_links, two_poles
from taut.book.multi_joint import TORQUE, Q, V
from taut.book.page import MUJOCO, Shown, compared, entry, pole, row, rows
from taut.control.laws.task_error import task_error
from taut.laws import ComputedTorque, TaskComputedTorque
from taut.maths.spatial import rotated
from taut.maths.task_inertia import TaskInertia

if TYPE_CHECKING:
    from taut.control.laws.task_error import ErrorKind

W: Final = 1.5  # [rad/s] of the circle that two links follow
X_AND_Z: Final = [0, 2]  # rows of the tool of two links
CENTRE, RADIUS = np.array([0.55, 0.1]), 0.1  # [m] x and z


def around(t: float) -> tuple[Float64Array, Float64Array, Float64Array]:
    """(2,) position, velocity and acceleration on the circle."""
    s, c = math.sin(W * t), math.cos(W * t)
    return CENTRE + RADIUS * np.array([c, s]), RADIUS * W * np.array([-s, c]), -RADIUS * W**2 * np.array([c, s])


def by_cosines(tip: Float64Array) -> Float64Array:
    """(2,) joints of two links by the law of cosines, the elbow below the line to the tool."""
    L1, L2 = 0.5, 0.4  # [m]
    elbow = math.acos((float(tip @ tip) - L1**2 - L2**2) / (2.0 * L1 * L2))
    reach = math.atan2(L2 * math.sin(elbow), L1 + L2 * math.cos(elbow))
    return np.array([math.atan2(tip[1], tip[0]) - reach, elbow])


def joints(t: float) -> tuple[Float64Array, Float64Array, Float64Array]:
    """(2,) q, v and a of two links on the circle, with MuJoCo's Jacobian."""
    p, v_tip, a_tip = around(t)
    q = by_cosines(p)
    inverse = np.asarray(np.linalg.inv(two(q).J[X_AND_Z]), dtype=np.float64)
    v: Float64Array = inverse @ v_tip
    return q, v, inverse @ (a_tip - two(q, v).Jdot_v[X_AND_Z])


@cache
def followed() -> tuple[Controller, tuple[Float64Array, Float64Array, Float64Array]]:
    """A joint-space law after 0.4 s on the circle, and q, v and a with MuJoCo's Jacobian."""
    ctrl = taut.compile(taut.via_joint_space(ComputedTorque(kp=100.0, kd=20.0), directions="position"), two_links())
    for k in range(401):
        p, v, a = (np.array([each[0], 0.0, each[1]]) for each in around(1e-3 * k))
        state = joints(1e-3 * k)
        ctrl.step(*state[:2], TaskMotion(pose=Pose(p), twist=[*v, 0, 0, 0], acceleration=[*a, 0, 0, 0]))
    return ctrl, state


@entry("eq-10.28", "inverse kinematics")
def eq_10_28() -> Shown:
    """Chosen: the tool at (0.65, 0.1) m, then a circle of 0.1 m radius at 1.5 rad/s."""
    p, source = around(0.0)[0], "law of cosines"
    found = taut.inverse_kinematics(
        two_links(), Pose([p[0], 0.0, p[1]]), q0=[0.1, 0.9], directions="position", tolerance=(1e-10, 1e-6)
    ).q
    yield from rows("joint {} of two links [rad]", (1, 2), found, by_cosines(p), source, near=1e-9)
    ctrl, (q, _, _) = followed()
    name = "joint {} of a law that follows a circle, after 0.4 s [rad]"
    yield from rows(name, (1, 2), ctrl.memory["law.q_des"], q, source, near=1e-6)


@entry("eq-10.29", "joint speeds of a motion of the tool")
def eq_10_29() -> Shown:
    """The circle of equation 10.28."""
    ctrl, (_, v, _) = followed()
    name, source = "speed of joint {} after 0.4 s [rad/s]", "J^-1 V, with MuJoCo's J"
    yield from rows(name, (1, 2), ctrl.memory["law.v_des"], v, source, near=1e-5)


@entry("eq-10.30", "joint accelerations of a motion of the tool")
def eq_10_30() -> Shown:
    """The circle of equation 10.28."""
    ctrl, (_, _, a) = followed()
    name, source = "acceleration of joint {} after 0.4 s [rad/s^2]", "J^-1 (V-dot - J-dot v), with MuJoCo's J"
    yield from rows(name, (1, 2), ctrl.memory["law.a_des"], a, source, near=1e-4)


@entry("eq-10.31", "computed torque in task space")
def eq_10_31() -> Shown:
    """The decoupled error, with Lambda, gamma and eta of MuJoCo.

    The chapter speaks of a dynamic singularity where M is singular. M never is: J is singular there, and Lambda
    is unbounded. Chosen: the error of the third choice, a Panda, kp = 100, kd = 20, ki = 50; h goes to all
    joints, so that the free motion carries its own weight.
    """
    m, turn = in_mujoco(Q, V), Rotation.from_rotvec([0.1, -0.05, 0.08]).as_matrix()
    ref = TaskMotion(
        pose=Pose(m.p + np.array([0.02, -0.01, 0.03]), R=turn @ m.R),
        twist=[0.1, 0.2, -0.1, 0.3, 0.1, -0.2],
        acceleration=[1.0, 0.5, -0.5, 0.4, 0.3, 0.2],
    )
    got = total(ticked(TaskComputedTorque(kp=100.0, kd=20.0, ki=50.0, null=None), panda(), Q, V, ref).terms)
    X = np.concatenate([np.asarray(ref.p) - m.p, Rotation.from_matrix(np.asarray(ref.R) @ m.R.T).as_rotvec()])
    a = ref.acceleration + 100.0 * X + 50.0 * X * 1e-3 + 20.0 * (ref.twist - m.J @ V)
    J_bar = np.linalg.solve(m.M, m.J.T) @ m.Lambda  # J_bar^T h is gamma + eta where nothing moves freely
    gamma_eta = J_bar.T @ m.h - m.Lambda @ m.Jdot_v
    wanted = m.J.T @ (m.Lambda @ a + gamma_eta)
    free = (np.eye(7) - m.J.T @ J_bar.T) @ m.h  # what of h the free motion has, which the law adds too
    yield from compared(TORQUE, got, wanted + free, MUJOCO, 1e-6)
    slip = "slip: M is singular at a dynamic singularity"
    for name, q, states in (("stretched", np.array([0.3, 0.0]), slip), ("bent", np.array([0.3, 1.2]), "")):
        x, m = snapshot(two_links(), q), two(q)
        got, wanted = (np.linalg.eigvalsh(np.asarray(M))[0] for M in (x.M, m.M))
        yield row(f"two links, {name}: least eigenvalue of M [kg m^2]", got, wanted, MUJOCO, states=states)
        got, wanted = (np.linalg.svd(J)[1][-1] for J in (np.asarray(x.J())[X_AND_Z], m.J[X_AND_Z]))
        yield row(f"two links, {name}: least singular value of J [m]", got, wanted, MUJOCO, near=1e-12)


@dataclass(frozen=True)
class Spinning:
    """A target that rotates in place."""

    T: Pose
    w: Float64Array  # [rad/s]

    def at(self, t: float) -> TaskMotion:
        R = Rotation.from_rotvec(self.w * t).as_matrix() @ np.asarray(self.T.R)
        return TaskMotion(pose=Pose(self.T.p, R=R), twist=[0.0, 0.0, 0.0, *self.w])


class AsWritten(Law):
    """Equation 10.31 with the chapter's body error and the desired acceleration fed forward untransported.

    Law:          tau = J^T Lambda (V-dot_d + kp X_e + kd V_e - J-dot v) + h, X_e = log(T^-1 T_des)
    Closed loop:  X_e-ddot + (kd + ad V_d) X_e-dot + kp X_e = 0 to first order, about a target that turns
    """

    reference = TaskMotion
    kp: Gain = Gain(unit="1/s^2")
    kd: Gain = Gain(unit="1/s")

    def command(self, x: Snapshot, ref: TaskMotion) -> Torque:
        error = task_error(x, ref, kind="body")
        V_D, rate = rotated(ref.R.T, ref.twist), rotated(ref.R.T, ref.acceleration)
        fed = rate - tm.array([*tm.cross(V_D[3:], V_D[:3]), 0.0, 0.0, 0.0])  # the rate of the numbers of V_D
        a = fed + self.kp @ error.X + self.kd @ error.V - error.Jdot_v
        Lambda = TaskInertia.of(error.J, x.M_factors).Lambda
        return Torque(motion=error.J.T @ (Lambda @ a), nonlinear=x.h)


SPIN, KP, KD, TICK = 3.0, 100.0, 16.0, 1e-3  # [rad/s], [1/s^2], [1/s], [s]


def spun(law: Law) -> Any:
    """The error across the axis of a target that spins about the tool's z axis, as complex numbers [rad]."""
    arm = panda()
    x = snapshot(arm, arm.home)
    T = x.T()
    w = SPIN * np.asarray(T.R)[:, 2]
    twists = np.array([[0.0, 0.0, 0.0, *w], [0.0, 0.0, 0.0, 0.006, -0.009, 0.006]])
    v, away = np.linalg.lstsq(np.asarray(x.J()), twists.T, rcond=None)[0].T
    out = simulated(law, arm, Spinning(T, w), duration=0.5, q0=arm.home + away, v0=v)
    errors = []
    for t, R in zip(out.t, out.task.R, strict=True):
        across = Rotation.from_matrix(R.T @ Rotation.from_rotvec(w * t).as_matrix() @ np.asarray(T.R)).as_rotvec()
        errors.append(across[0] + 1j * across[1])
    return np.array(errors)


def in_order(poles: Any) -> Any:
    """(2,) poles, the lower imaginary part first."""
    return poles[np.argsort(poles.imag)]


@entry("sec-10.2.3", "the body error at a target that spins")
def transported() -> Shown:
    """With the body error the desired acceleration must be transported to the tool, Ad V-dot_d + ad_{V_e}(Ad V_d).

    Fed as it is, a target that spins at 3 rad/s adds +-3j to kd = 16 across its axis. A Panda, kp = 100.
    """
    well = TaskComputedTorque(kp=KP, kd=KD, error="body", null=None, singularity="plain")
    slip = "slip: V-dot_d fed as it is, the poles as designed"
    laws: tuple[tuple[str, Law, complex, str], ...] = (
        ("transported", well, KD, ""), ("fed as it is", AsWritten(kp=KP, kd=KD), KD + 1j * SPIN, slip),
    )  # fmt: skip
    for name, law, kd, states in laws:
        stepped = np.roots([1.0, kd * TICK + KP * TICK**2 - 2.0, 1.0 - kd * TICK])  # as the plant steps
        got, wanted = in_order(two_poles(spun(law), TICK)), in_order(np.log(stepped.astype(complex)) / TICK)
        for i, design in enumerate(in_order(np.roots([1.0, kd, KP]))):
            source = f"s^2 + {kd:g} s + 100, sampled at 1 kHz; {design:.3g} in continuous time"
            what = f"{name}: pole {i + 1}, {{}}"
            yield from pole(what, got[i], wanted[i], source, rel=0.0, near=0.1, real=states)


SHIFT, TURN = np.array([0.05, 0.15, -0.05]), np.array([0.0, 0.7, 0.4])  # [m], rotation vector [rad], chosen
ALONE: Final = "(1 + 10 t) exp(-10 t) of what was to go"


def screw(T0: Pose, T1: Pose) -> Float64Array:
    """(k, 3) the tool's origin on the one screw motion from a pose to another, by SciPy's logm and expm."""
    one, other = T0.matrix, T1.matrix
    log = np.real(logm(np.linalg.solve(one, other)))
    return np.array([(one @ expm(s * log))[:3, 3] for s in np.linspace(0.0, 1.0, 400)])


def aside(way: Float64Array) -> Float64Array:
    """(k,) distance of a path from the straight line along SHIFT [m]."""
    ahead = SHIFT / np.linalg.norm(SHIFT)
    moved = way - way[0]
    return np.asarray(np.linalg.norm(moved - np.outer(moved @ ahead, ahead), axis=1))


@entry("sec-10.2.3", "three choices of the error")
def choices() -> Shown:
    """The errors of body and space lead the tool along the screw motion from one pose to the other.

    The third leads it straight ahead. Chosen: a Panda, kp = 100, kd = 20, 0.17 m and 0.81 rad.
    """
    arm = panda()
    T0 = snapshot(arm, arm.home).T()
    T1 = Pose(np.asarray(T0.p) + SHIFT, R=np.asarray(T0.R) @ Rotation.from_rotvec(TURN).as_matrix())
    bow = aside(screw(T0, T1)).max()
    kinds: tuple[ErrorKind, ...] = ("body", "space", "decoupled")
    for kind in kinds:
        law = TaskComputedTorque(kp=100.0, kd=20.0, error=kind, null=None, singularity="plain")
        out = simulated(law, arm, TaskMotion(pose=T1), duration=1.5)
        off, name = aside(out.task.p), f"{kind}: farthest from a straight line [m]"
        if kind == "decoupled":
            at, t = round(0.2 * out.rate), 0.2
            turned = Rotation.from_matrix(np.asarray(out.task.R[at]).T @ np.asarray(T1.R)).magnitude()
            left = np.linalg.norm(np.asarray(T1.p) - out.task.p[at])
            wanted = np.linalg.norm(TURN) * (1.0 + 10.0 * t) * math.exp(-10.0 * t)
            way = wanted / np.linalg.norm(TURN) * np.linalg.norm(SHIFT)
            claim = "decouples rotational and linear terms"
            yield row(name, off.max(), 0.0, "each by itself: straight", near=2e-4, states=claim)
            yield row(f"{kind}: angle left after 0.2 s [rad]", turned, wanted, ALONE, rel=0.02, states=claim)
            yield row(f"{kind}: way left after 0.2 s [m]", left, way, ALONE, rel=0.02, states=claim)
        else:
            yield row(name, off.max(), bow, "the screw motion between both poses", rel=0.01)
