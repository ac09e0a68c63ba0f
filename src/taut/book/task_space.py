"""Section 10.2.3: motion control in task space, through the joints or directly, and three choices of the error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from taut.base.plot_style import DASHED, INK, colour, prepared
from taut.base.types import Float64Array
from taut.book.models import TWO_LINKS, engine, panda, simulated, ticked, total, two_links, two_poles
from taut.book.multi_joint import Q, V
from taut.book.page import MUJOCO, TWO_BY_HAND, Shown, compared, entry, legend, panels, row
from taut.codegen.inverse_kinematics import inverse_kinematics
from taut.control.command import Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.laws.joint import ComputedTorque
from taut.control.laws.task import TaskComputedTorque
from taut.control.laws.task_error import task_error
from taut.control.laws.via_joint_space import via_joint_space
from taut.control.trajectories.task_reference import TaskMotion
from taut.controller import Controller, compile
from taut.maths.snapshot import Snapshot, snapshot
from taut.maths.spatial import rotated
from taut.maths.task_inertia import TaskInertia
from taut.record.run import Run
from taut.trace import math as tm
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from taut.control.laws.task_error import ErrorKind

__all__ = ["AsWritten"]

W: Final = 1.5  # [rad/s] of the circle that two links follow
CENTRE, RADIUS = np.array([0.55, 0.1]), 0.1  # [m] x and z


def around(t: float) -> tuple[Float64Array, Float64Array, Float64Array]:
    """(2,) place, velocity and acceleration on the circle."""
    s, c = math.sin(W * t), math.cos(W * t)
    return CENTRE + RADIUS * np.array([c, s]), RADIUS * W * np.array([-s, c]), -RADIUS * W**2 * np.array([c, s])


def joints(t: float) -> tuple[Float64Array, Float64Array, Float64Array]:
    """(2,) q, v and a of two links on the circle, written out."""
    p, v_tip, a_tip = around(t)
    q = TWO_LINKS.ik(p)
    inverse = np.asarray(np.linalg.inv(TWO_LINKS.J(q)), dtype=np.float64)
    v: Float64Array = inverse @ v_tip
    return q, v, inverse @ (a_tip - TWO_LINKS.Jdot_v(q, v))


def sample(t: float) -> TaskMotion:
    """The circle as a motion of the tool."""
    p, v, a = (np.array([each[0], 0.0, each[1]]) for each in around(t))
    nothing = np.zeros(3)
    return TaskMotion(pose=Pose(p), twist=[*v, *nothing], acceleration=[*a, *nothing])


def followed() -> tuple[Controller, float]:
    """A law that goes by way of the joints, after 0.4 s on the circle, and that time."""
    ctrl = compile(via_joint_space(ComputedTorque(kp=100.0, kd=20.0), directions="position"), two_links())
    for k in range(401):
        t = 1e-3 * k
        q, v, _ = joints(t)
        ctrl.step(q, v, sample(t))
    return ctrl, t


@entry("eq-10.28", "inverse kinematics")
def eq_10_28() -> Shown:
    p = around(0.0)[0]
    found = inverse_kinematics(
        two_links(), Pose([p[0], 0.0, p[1]]), q0=[0.1, 0.9], directions="position", tolerance=(1e-10, 1e-6)
    )
    wanted = TWO_LINKS.ik(p)
    ctrl, t = followed()
    along, later = ctrl.memory["law.q_des"], joints(t)[0]
    yield from (
        row(f"joint {i + 1} of two links", "rad", found.q[i], wanted[i], "law of cosines", near=1e-9) for i in (0, 1)
    )
    yield from (
        row(
            f"joint {i + 1} of a law that follows a circle, after 0.4 s",
            "rad",
            along[i],
            later[i],
            "law of cosines",
            near=1e-6,
        )
        for i in (0, 1)
    )
    yield "Chosen: the tool at (0.65, 0.1) m, then a circle of 0.1 m radius at 1.5 rad/s."


@entry("eq-10.29", "joint speeds of a motion of the tool")
def eq_10_29() -> Shown:
    ctrl, t = followed()
    got, wanted = ctrl.memory["law.v_des"], joints(t)[1]
    yield from (
        row(f"speed of joint {i + 1} after 0.4 s", "rad/s", got[i], wanted[i], f"J^-1 V, {TWO_BY_HAND}", near=1e-5)
        for i in (0, 1)
    )
    yield "The circle of equation 10.28."


@entry("eq-10.30", "joint accelerations of a motion of the tool")
def eq_10_30() -> Shown:
    ctrl, t = followed()
    got, wanted = ctrl.memory["law.a_des"], joints(t)[2]
    yield from (
        row(
            f"acceleration of joint {i + 1} after 0.4 s",
            "rad/s^2",
            got[i],
            wanted[i],
            f"J^-1 (V-dot - J-dot v), {TWO_BY_HAND}",
            near=1e-4,
        )
        for i in (0, 1)
    )
    yield "The circle of equation 10.28."


def target() -> TaskMotion:
    """Near the Panda's tool at Q."""
    m = engine().at(Q, V)
    R = Rotation.from_rotvec([0.1, -0.05, 0.08]).as_matrix() @ m.R
    return TaskMotion(
        pose=Pose(m.p + np.array([0.02, -0.01, 0.03]), R=R),
        twist=[0.1, 0.2, -0.1, 0.3, 0.1, -0.2],
        acceleration=[1.0, 0.5, -0.5, 0.4, 0.3, 0.2],
    )


@entry("eq-10.31", "computed torque in task space")
def eq_10_31() -> Shown:
    """The decoupled error, with Lambda, gamma and eta of MuJoCo."""
    ref = target()
    ctrl = ticked(TaskComputedTorque(kp=100.0, kd=20.0, ki=50.0, null=None), panda(), Q, V, ref)
    got = total(ctrl.terms)
    m = engine().at(Q, V)
    X = np.concatenate([np.asarray(ref.p) - m.p, Rotation.from_matrix(np.asarray(ref.R) @ m.R.T).as_rotvec()])
    a = ref.acceleration + 100.0 * X + 50.0 * X * 1e-3 + 20.0 * (ref.twist - m.J @ V)
    J_bar = np.linalg.solve(m.M, m.J.T) @ m.Lambda  # J_bar^T h is gamma + eta where nothing moves freely
    gamma_eta = J_bar.T @ m.h - m.Lambda @ m.Jdot_v
    wanted = m.J.T @ (m.Lambda @ a + gamma_eta)
    free = (np.eye(7) - m.J.T @ J_bar.T) @ m.h  # what of h the free motion has, which the law adds too
    yield from compared(got, wanted + free, "N m", MUJOCO, "torque of the Panda", 1e-6)
    stretched, bent = (snapshot(two_links(), [0.3, q2]) for q2 in (0.0, 1.2))
    for name, x, q in (("stretched", stretched, np.array([0.3, 0.0])), ("bent", bent, np.array([0.3, 1.2]))):
        J = np.asarray(x.J())[[0, 2]]
        told_M, wanted_M = (np.linalg.eigvalsh(np.asarray(M))[0] for M in (x.M, TWO_LINKS.M(q)))
        states = "slip: M is singular at a dynamic singularity" if name == "stretched" else ""
        yield row(f"two links, {name}: least eigenvalue of M", "kg m^2", told_M, wanted_M, TWO_BY_HAND, states=states)
        told_J, wanted_J = (np.linalg.svd(each)[1][-1] for each in (J, TWO_LINKS.J(q)))
        yield row(f"two links, {name}: least singular value of J", "m", told_J, wanted_J, TWO_BY_HAND, near=1e-12)

    yield (
        "The chapter speaks of a dynamic singularity where M is singular. M never is: J is singular there, and "
        "Lambda is unbounded. Chosen: the error of the third choice, a Panda, kp = 100, kd = 20, ki = 50; h "
        "goes to all joints, so that the free motion carries its own weight."
    )


# -------------------------------------------------------------------- a target that spins


@dataclass(frozen=True)
class Spinning:
    """A target that turns on the spot."""

    T: Pose
    w: Float64Array  # [rad/s]

    def at(self, t: float) -> TaskMotion:
        """The sample at time t [s]."""
        R = Rotation.from_rotvec(self.w * t).as_matrix() @ np.asarray(self.T.R)
        return TaskMotion(pose=Pose(self.T.p, R=R), twist=[0.0, 0.0, 0.0, *self.w])


class AsWritten(Law):
    """Equation 10.31 with the chapter's body error and the desired acceleration fed as it is.

    Law:          tau = J^T Lambda (V-dot_d + kp X_e + kd V_e - J-dot v) + h, X_e = log(T^-1 T_des)
    Closed loop:  X_e-ddot + (kd + ad V_d) X_e-dot + kp X_e = 0 to first order, about a target that turns
    """

    reference = TaskMotion
    kp: Gain  # [1/s^2]
    kd: Gain  # [1/s]

    def command(self, x: Snapshot, ref: TaskMotion) -> Torque:
        error = task_error(x, ref, kind="body")
        V_D, rate = rotated(ref.R.T, ref.twist), rotated(ref.R.T, ref.acceleration)
        fed = rate - tm.array([*tm.cross(V_D[3:], V_D[:3]), 0.0, 0.0, 0.0])  # the rate of the numbers of V_D
        a = fed + self.kp @ error.X + self.kd @ error.V - error.Jdot_v
        Lambda = TaskInertia.of(error.J, x.M_factors).Lambda
        return Torque(motion=error.J.T @ (Lambda @ a), nonlinear=x.h)


SPIN, KP, KD, TICK = 3.0, 100.0, 16.0, 1e-3  # [rad/s], [1/s^2], [1/s], [s]


def spun(law: Law) -> tuple[Run, Any]:
    """A run about a target that spins about the tool's z axis, and the error across it as complex numbers [rad]."""
    arm = panda()
    x = snapshot(arm, arm.home)
    T = x.T()
    w = SPIN * np.asarray(T.R)[:, 2]
    J = np.asarray(x.J())
    towards = np.linalg.lstsq(
        J, np.array([[0.0, 0.0, 0.0, *w], [0.0, 0.0, 0.0, 0.006, -0.009, 0.006]]).T, rcond=None
    )[0]
    out = simulated(law, arm, Spinning(T, w), duration=0.5, q0=arm.home + towards[:, 1], v0=towards[:, 0])
    errors = []
    for t, R in zip(out.t, out.task.R, strict=True):
        across = Rotation.from_matrix(R.T @ Rotation.from_rotvec(w * t).as_matrix() @ np.asarray(T.R)).as_rotvec()
        errors.append(across[0] + 1j * across[1])
    return out, np.array(errors)


def sampled(kd: complex) -> Any:
    """(2,) poles of s^2 + kd s + kp, stepped as the plant steps, the lower imaginary part first [1/s]."""
    poles = np.log(np.roots([1.0, kd * TICK + KP * TICK**2 - 2.0, 1.0 - kd * TICK]).astype(complex)) / TICK
    return poles[np.argsort(poles.imag)]


@entry("sec-10.2.3", "the body error at a target that spins", part="spin")
def transported() -> Shown:
    figure, (ax,) = panels(1, 2.6)
    prepared(ax, "error about the tool's x axis, at a target that spins", "error [mrad]", "t [s]")
    laws: dict[str, tuple[Law, complex]] = {
        "transported": (TaskComputedTorque(kp=KP, kd=KD, error="body", null=None, singularity="plain"), KD),
        "fed as it is": (AsWritten(kp=KP, kd=KD), KD + 1j * SPIN),
    }
    for k, (name, (law, kd)) in enumerate(laws.items()):
        out, errors = spun(law)
        got = two_poles(errors, TICK)
        got, wanted = got[np.argsort(got.imag)], sampled(kd)
        design = np.roots([1.0, kd, KP])
        design = design[np.argsort(design.imag)]
        states = "slip: V-dot_d fed as it is, the poles as designed" if name == "fed as it is" else ""
        for i in (0, 1):
            source = f"s^2 + {kd:g} s + 100, sampled at 1 kHz; {design[i]:.3g} in continuous time"
            yield row(
                f"{name}: pole {i + 1}, real part",
                "1/s",
                got[i].real,
                wanted[i].real,
                source,
                rel=0.0,
                near=0.1,
                states=states,
            )
            yield row(
                f"{name}: pole {i + 1}, imaginary part", "1/s", got[i].imag, wanted[i].imag, source, rel=0.0, near=0.1
            )
        ax.plot(out.t, 1e3 * errors.real, color=colour(k), linewidth=1.4, label=name)
    ax.axhline(0.0, color=INK, linewidth=0.6)
    legend(ax)

    yield figure
    yield (
        "With the body error the desired acceleration must be transported to the tool, Ad V-dot_d + ad_{V_e}(Ad "
        "V_d). Fed as it is, a target that spins at 3 rad/s adds +-3j to kd = 16 across its axis. A Panda, kp = 100."
    )


SHIFT, TURN = np.array([0.05, 0.15, -0.05]), np.array([0.0, 0.7, 0.4])  # [m], rotation vector [rad], chosen
KP_E, KD_E = 100.0, 20.0  # [1/s^2], [1/s]
ALONE: Final = "(1 + 10 t) exp(-10 t) of what was to go"


def screw(T0: Pose, T1: Pose) -> Float64Array:
    """(k, 3) the tool's origin on the one screw motion from a pose to another, by SciPy's logm and expm."""
    one, other = T0.matrix, T1.matrix
    log = np.real(logm(np.linalg.solve(one, other)))
    return np.array([(one @ expm(s * log))[:3, 3] for s in np.linspace(0.0, 1.0, 400)])


def aside(way: Float64Array) -> Float64Array:
    """(k,) how far a way is from the straight line along SHIFT [m]."""
    ahead = SHIFT / np.linalg.norm(SHIFT)
    moved = way - way[0]
    return np.asarray(np.linalg.norm(moved - np.outer(moved @ ahead, ahead), axis=1))


@entry("sec-10.2.3", "three choices of the error", part="choices")
def choices() -> Shown:
    arm = panda()
    T0 = snapshot(arm, arm.home).T()
    T1 = Pose(np.asarray(T0.p) + SHIFT, R=np.asarray(T0.R) @ Rotation.from_rotvec(TURN).as_matrix())
    bow = aside(screw(T0, T1))
    figure, (ax,) = panels(1, 2.6)
    prepared(ax, "the tool on its way to another place and orientation", "aside of a straight line [mm]", "way [mm]")
    kinds: tuple[ErrorKind, ...] = ("body", "space", "decoupled")
    for k, kind in enumerate(kinds):
        law = TaskComputedTorque(kp=KP_E, kd=KD_E, error=kind, null=None, singularity="plain")
        out = simulated(law, arm, TaskMotion(pose=T1), duration=1.5)
        off = aside(out.task.p)
        name = f"{kind}: farthest from a straight line"
        if kind == "decoupled":
            turned = Rotation.from_matrix(np.swapaxes(np.asarray(out.task.R), 1, 2) @ np.asarray(T1.R)).magnitude()
            at = round(0.2 * out.rate)
            wanted = np.linalg.norm(TURN) * (1.0 + 10.0 * 0.2) * math.exp(-10.0 * 0.2)
            claim = "decouples rotational and linear terms"
            yield row(name, "m", off.max(), 0.0, "each by itself: straight", near=2e-4, states=claim)
            yield row(f"{kind}: angle left after 0.2 s", "rad", turned[at], wanted, ALONE, rel=0.02, states=claim)
            yield row(
                f"{kind}: way left after 0.2 s",
                "m",
                np.linalg.norm(np.asarray(T1.p) - out.task.p[at]),
                wanted / np.linalg.norm(TURN) * np.linalg.norm(SHIFT),
                ALONE,
                rel=0.02,
                states=claim,
            )
        else:
            yield row(name, "m", off.max(), bow.max(), "the screw motion between both poses", rel=0.01)
        way = np.linalg.norm(out.task.p - out.task.p[0], axis=1)
        ax.plot(1e3 * way, 1e3 * off, color=colour(k), linewidth=1.4, linestyle=DASHED if k == 1 else "-", label=kind)
    ax.axhline(0.0, color=INK, linewidth=0.6)
    legend(ax)

    yield figure
    yield (
        "The errors of body and space lead the tool along the screw motion from one pose to the other, the third "
        "straight ahead. Chosen: a Panda, kp = 100, kd = 20, 0.17 m and 0.81 rad."
    )
