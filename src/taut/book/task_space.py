"""Section 10.2.3: motion control in task space, by way of the joints or directly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from taut.base.plot_style import INK, colour, prepared
from taut.base.types import Float64Array
from taut.book.drawing import legend, panels
from taut.book.multi_joint import Q, V
from taut.book.oracle import TWO_LINKS, engine, panda, two_links
from taut.book.page import MUJOCO, TWO_BY_HAND, Entry, Page, Row, compared, row
from taut.book.simulation import simulated, ticked, total, two_poles
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

__all__ = ["ENTRIES", "AsWritten"]

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


def eq_10_28() -> Page:
    p = around(0.0)[0]
    found = inverse_kinematics(
        two_links(), Pose([p[0], 0.0, p[1]]), q0=[0.1, 0.9], directions="position", tolerance=(1e-10, 1e-6)
    )
    wanted = TWO_LINKS.ik(p)
    ctrl, t = followed()
    along, later = ctrl.memory["law.q_des"], joints(t)[0]
    rows = [
        row(f"joint {i + 1} of two links", "rad", found.q[i], wanted[i], "law of cosines", near=1e-9) for i in (0, 1)
    ]
    rows += [
        row(
            f"joint {i + 1} of a law that follows a circle, after 0.4 s",
            "rad",
            along[i],
            later[i],
            "law of cosines",
            near=1e-6,
        )
        for i in (0, 1)
    ]
    return Page(
        rows=tuple(rows), note="Chosen: the tool at (0.65, 0.1) m, then a circle of 0.1 m radius at 1.5 rad/s."
    )


def eq_10_29() -> Page:
    ctrl, t = followed()
    got, wanted = ctrl.memory["law.v_des"], joints(t)[1]
    rows = [
        row(f"speed of joint {i + 1} after 0.4 s", "rad/s", got[i], wanted[i], f"J^-1 V, {TWO_BY_HAND}", near=1e-5)
        for i in (0, 1)
    ]
    return Page(rows=tuple(rows), note="The circle of equation 10.28.")


def eq_10_30() -> Page:
    ctrl, t = followed()
    got, wanted = ctrl.memory["law.a_des"], joints(t)[2]
    rows = [
        row(
            f"acceleration of joint {i + 1} after 0.4 s",
            "rad/s^2",
            got[i],
            wanted[i],
            f"J^-1 (V-dot - J-dot v), {TWO_BY_HAND}",
            near=1e-4,
        )
        for i in (0, 1)
    ]
    return Page(rows=tuple(rows), note="The circle of equation 10.28.")


def target() -> TaskMotion:
    """Near the Panda's tool at Q."""
    m = engine().at(Q, V)
    R = Rotation.from_rotvec([0.1, -0.05, 0.08]).as_matrix() @ m.R
    return TaskMotion(
        pose=Pose(m.p + np.array([0.02, -0.01, 0.03]), R=R),
        twist=[0.1, 0.2, -0.1, 0.3, 0.1, -0.2],
        acceleration=[1.0, 0.5, -0.5, 0.4, 0.3, 0.2],
    )


def eq_10_31() -> Page:
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
    rows = compared(got, wanted + free, "N m", MUJOCO, "torque of the Panda", 1e-6)
    stretched, bent = (snapshot(two_links(), [0.3, q2]) for q2 in (0.0, 1.2))
    for name, x, q in (("stretched", stretched, np.array([0.3, 0.0])), ("bent", bent, np.array([0.3, 1.2]))):
        J = np.asarray(x.J())[[0, 2]]
        told_M, wanted_M = (np.linalg.eigvalsh(np.asarray(M))[0] for M in (x.M, TWO_LINKS.M(q)))
        states = "slip: M is singular at a dynamic singularity" if name == "stretched" else ""
        rows.append(
            row(f"two links, {name}: least eigenvalue of M", "kg m^2", told_M, wanted_M, TWO_BY_HAND, states=states)
        )
        told_J, wanted_J = (np.linalg.svd(each)[1][-1] for each in (J, TWO_LINKS.J(q)))
        rows.append(
            row(f"two links, {name}: least singular value of J", "m", told_J, wanted_J, TWO_BY_HAND, near=1e-12)
        )
    note = (
        "The chapter speaks of a dynamic singularity where M is singular. M never is: J is singular there, and "
        "Lambda is unbounded. Chosen: the error of the third choice, a Panda, kp = 100, kd = 20, ki = 50; h "
        "goes to all joints, so that the free motion carries its own weight."
    )
    return Page(rows=tuple(rows), note=note)


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
        error = task_error("body", x, ref, None, None)
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


def transported() -> Page:
    rows: list[Row] = []
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
            rows.append(
                row(
                    f"{name}: pole {i + 1}, real part",
                    "1/s",
                    got[i].real,
                    wanted[i].real,
                    source,
                    rel=0.0,
                    near=0.1,
                    states=states,
                )
            )
            rows.append(
                row(
                    f"{name}: pole {i + 1}, imaginary part",
                    "1/s",
                    got[i].imag,
                    wanted[i].imag,
                    source,
                    rel=0.0,
                    near=0.1,
                )
            )
        ax.plot(out.t, 1e3 * errors.real, color=colour(k), linewidth=1.4, label=name)
    ax.axhline(0.0, color=INK, linewidth=0.6)
    legend(ax)
    note = (
        "With the body error the desired acceleration must be transported to the tool, Ad V-dot_d + ad_{V_e}(Ad "
        "V_d). Fed as it is, a target that spins at 3 rad/s adds +-3j to kd = 16 across its axis. A Panda, kp = 100."
    )
    return Page(rows=tuple(rows), figure=figure, note=note)


ENTRIES: Final = (
    Entry(id="eq-10.28", title="inverse kinematics", make=eq_10_28),
    Entry(id="eq-10.29", title="joint speeds of a motion of the tool", make=eq_10_29),
    Entry(id="eq-10.30", title="joint accelerations of a motion of the tool", make=eq_10_30),
    Entry(id="eq-10.31", title="computed torque in task space", make=eq_10_31),
    Entry(id="sec-10.2.3", title="the body error at a target that spins", make=transported, part="spin"),
)
