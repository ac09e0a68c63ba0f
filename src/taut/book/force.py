"""Sections 10.3 and 10.4.1: force control, and natural and artificial constraints."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import taut
from taut import Constraint, Pose, RigidContact, Run, TaskForce, snapshot
from taut.analysis import ConstraintTable, check_specification, natural_constraints
from taut.base.plot_style import INK, SMALL, colour
from taut.book.models import in_mujoco, panda, simulated, ticked, total, two, two_links
from taut.book.multi_joint import TORQUE, Q, V
from taut.book.page import MUJOCO, Row, Shown, compared, entry, panels, row
from taut.book.single_joint import ConstantTorque
from taut.environments import Damper, Environments, Spring
from taut.laws import ForceControl

if TYPE_CHECKING:
    from matplotlib.figure import Figure

F: Final = np.array([5.0, -3.0, -10.0, 0.3, 0.2, -0.1])  # [N, N m] of the arm on what it touches
KFP, KFI = 0.5, 3.0  # [1], [1/s] those of MATHS: the pole is -2, the chapter's is -6
UNKNOWN: Final = 0.5  # [kg] that the law does not know
KDAMP: Final = (40.0, 40.0, 40.0, 2.0, 2.0, 0.1)  # [N s/m, N m s/rad]
PRESS: Final = TaskForce(F_app=F)


@entry("eq-10.32", "dynamics of an arm that touches")
def eq_10_32() -> Shown:
    """The tool of two links slides on a plane, which bounds its motion by a contact force.

    Chosen: 3 N m at both joints, 0.4 m/s along a frictionless plane; negative presses.
    """
    q, tau = np.array([0.3, 0.8]), 3.0
    v = np.linalg.solve(two(q).J[[0, 2]], np.array([0.4, 0.0]))
    m = two(q, v)
    board = Constraint.plane(point=m.p, normal=[0.0, 0.0, 1.0])
    contact = RigidContact(constraint=board)
    out = simulated(ConstantTorque(tau=tau), two_links(), duration=0.002, q0=q, v0=v, contact=contact)
    A_q, free = m.J[2:3], np.linalg.solve(m.M, tau - m.h)
    lam = (A_q @ free + m.Jdot_v[2]) / (A_q @ np.linalg.solve(m.M, A_q.T))[0]
    name = "force on a plane that two links slide on [N]"
    yield row(name, out.extra["contact.lam"][0, 0], lam[0], "10.42 with MuJoCo's M, h and J", rel=1e-6)


@entry("eq-10.33", "the same at rest")
def eq_10_33() -> Shown:
    """Chosen: the wrench (5, -3, -10) N, (0.3, 0.2, -0.1) N m."""
    x, m = snapshot(panda(), Q), in_mujoco(Q)
    got = np.asarray(x.g) + np.asarray(x.J()).T @ F
    yield from compared("torque of a Panda that presses [N m]", got, m.h + m.J.T @ F, MUJOCO)


@entry("eq-10.34", "force control by feedforward")
def eq_10_34() -> Shown:
    """The wrench of equation 10.33."""
    got = total(ticked(ForceControl(feedback="none", null=None), panda(), Q, np.zeros(7), PRESS).terms)
    m = in_mujoco(Q)
    yield from compared(TORQUE, got, m.h + m.J.T @ F, MUJOCO)


@entry("eq-10.35", "force control by feedback")
def eq_10_35() -> Shown:
    """Chosen: Kfp = 0.5, Kfi = 3 1/s; 0.8 of the wrench is measured."""
    law, F_e, m = ForceControl(kfp=KFP, kfi=KFI, null=None), F - 0.8 * F, in_mujoco(Q)
    got = total(ticked(law, panda(), Q, np.zeros(7), PRESS, F_app=0.8 * F).terms)
    yield from compared(TORQUE, got, m.h + m.J.T @ (F + KFP * F_e + KFI * F_e * 1e-3), MUJOCO)


@cache
def pressing_down(kfi: float) -> tuple[Run, Any]:
    """A run of a Panda that presses with an unmodelled load, and (k,) its error of the vertical force [N]."""
    held = Environments(
        spring=Spring(stiffness=[2e4, 2e4, 2e4, 500.0, 500.0, 5.0]),
        damper=Damper(damping=[400.0, 400.0, 400.0, 6.0, 6.0, 0.05]),
    )
    law = ForceControl(kfp=KFP, kfi=kfi, kdamp=KDAMP, e_int_max=(4.0, 0.2))
    loaded = panda().with_payload(mass=UNKNOWN)
    out = simulated(law, panda(), PRESS, plant=loaded, duration=3.0, environment=held)
    return out, F[2] + out.extra["F_ext"][:, 2]


@entry("eq-10.36", "its error")
def eq_10_36() -> Shown:
    """Without the integral, (1 + Kfp) F_e equals the unmodelled weight of the load.

    The feedforward F_d was left out: (I + Kfp) F_e + Kfi int(F_e) is what g does not know. A Panda against
    springs, Kfp = 0.5, with half a kilogram that the law does not know.
    """
    e, weight = pressing_down(0.0)[1], UNKNOWN * 9.81
    name, states = "vertical error of force at rest, Kfi = 0 [N]", f"slip: Kfp F_e = m g, {weight / KFP:.3g} N"
    yield row(name, e[-1], weight / (1.0 + KFP), "m g / (1 + Kfp)", rel=2e-3, states=states)


@entry("eq-10.37", "its pole")
def eq_10_37() -> Shown:
    """Kfp = 0.5, Kfi = 3 1/s, as in equation 10.36: the pole is -2, not -6 1/s."""
    out, e = pressing_down(KFI)
    late, wanted = (out.t > 0.8) & (out.t < 2.0), -KFI / (1.0 + KFP)
    found = np.polyfit(out.t[late], np.log(np.abs(e[late])), 1)[0]  # a straight line through its logarithm
    states, source = f"slip: -Kfi / Kfp = {-KFI / KFP:g}", "-Kfi / (1 + Kfp)"
    yield row("pole of the error of force [1/s]", found, wanted, source, rel=0.01, states=states)
    yield row("error of force after 3 s [N]", e[-1], 0.0, "the chapter: converges to zero", near=0.01)


@entry("eq-10.38", "force control with damping")
def eq_10_38() -> Shown:
    """Without contact, the damping bounds the speed.

    The damping is that at the end of the tick, (I + Kdamp Lambda^-1 dt)^-1 Kdamp V, which is the chapter's as dt
    falls. Chosen: Kdamp = (40, 2) and 0.1 about z; the gantry has 10 N and 50 N s/m.
    """
    V_tool, m, F_e = in_mujoco(Q, V).J @ V, in_mujoco(Q), 0.2 * F
    law = ForceControl(kfp=KFP, kfi=KFI, kdamp=KDAMP, null=None)
    got = total(ticked(law, panda(), Q, V, PRESS, F_app=0.8 * F).terms)
    K, dt = np.diag(KDAMP), 1e-3
    damping = np.linalg.solve(np.eye(6) + dt * K @ np.linalg.inv(m.Lambda), K @ V_tool)
    wanted = m.h + m.J.T @ (F + KFP * F_e + KFI * F_e * dt - damping)
    yield from compared(TORQUE, got, wanted, MUJOCO, 1e-6)
    gantry = taut.load_arm("gantry3").with_joints(viscous=0.0)
    mass, kdamp = sum(body.mass for body in gantry.bodies[:3]), np.array([50.0, 50.0, 50.0, 1.0, 1.0, 1.0])
    push = TaskForce(F_app=[10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    damped, free = (
        simulated(ForceControl(feedback="none", kdamp=gain), gantry, push, duration=2.5).v[-1, 0]
        for gain in (kdamp, 0.0 * kdamp)
    )
    name, claim = "speed of a gantry that presses on nothing for 2.5 s", "the robot will accelerate"
    yield row(f"{name} [m/s]", damped, 10.0 / 50.0, "F_d / Kdamp", rel=0.01, states="acceleration is limited")
    yield row(f"{name}, Kdamp = 0 [m/s]", free, 10.0 * 2.5 / mass, "F_d t / m", states=claim)


B_ENV: Final = [[2.0, 1.0], [1.0, 1.0]]  # the chapter's damper


@entry("sec-10.4", "what may be specified against a damper")
def sec_10_4() -> Shown:
    """Chosen: the values of F1 and V1."""
    given = check_specification({"F1": 3.0, "V1": 1.0}, B=B_ENV)
    dependent = check_specification(["F1", "2 V1 + V2"], B=B_ENV).ok
    V2, rank = 3.0 - 2.0 * 1.0, np.linalg.matrix_rank(np.vstack([B_ENV[0], [2.0, 1.0]]))
    yield row("F1 = 3, V1 = 1 may be chosen [0 or 1]", given.ok, 1.0, "the chapter", states="yes")
    states = "determined by B_env"
    yield row("then V2 is [m/s]", given.quantities["V2"], V2, "F1 = 2 V1 + V2, solved", states=states)
    yield row("and F2 is [N]", given.quantities["F2"], 1.0 + V2, "F2 = V1 + V2", states=states)
    name, states = "F1 and 2 V1 + V2 may be chosen [0 or 1]", "no: the same direction"
    yield row(name, dependent, rank == 2, "rank of the two rows", states=states)


def eraser() -> Constraint:
    """The eraser's face on the chalkboard of figure 10.16: three rows."""
    return Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], face=[0.0, 0.0, -1.0])


def counted(name: str, found: ConstraintTable, motions: int, forces: int) -> Iterator[Row]:
    """Rows of the numbers of motions and forces that may be specified."""
    states = f"{motions} + {forces}"
    yield row(f"{name}: motions that may be chosen", found.motions, motions, "the chapter", states=states)
    yield row(f"{name}: forces that may be chosen", found.forces, forces, "the chapter")


@entry("sec-10.4.1", "natural and artificial constraints")
def sec_10_4_1() -> Shown:
    handle, at = Pose([0.4, 0.1, 0.3]), Pose([0.4, 0.1, 0.0])
    door = Constraint.hinge(point=[0.5, 0.2, 0.3], axis=[0.0, 0.0, 1.0], T=handle)
    chalk = Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
    sharp = Constraint(lambda T: T.p[2], one_sided=True)
    yield from counted("cabinet door", natural_constraints(door, at=handle), 1, 5)
    yield from counted("chalk on a board", natural_constraints(chalk, at=at), 5, 1)
    yield from counted("chalk that sticks", natural_constraints(sharp, at=at, mode="stick"), 3, 3)
    yield from counted("chalk pulled away", natural_constraints(sharp, at=at, mode="apart"), 6, 0)


@entry("fig-10.16", "the eraser on the chalkboard")
def fig_10_16() -> Shown:
    """The frames are as in the chapter: {s} on the board, {b} on the eraser."""
    found = natural_constraints(eraser(), at=Pose([0.4, 0.1, 0.0]))
    yield from counted("eraser", found, 3, 3)
    table = {each.natural: each.artificial for each in found.rows}
    for natural, artificial in (
        ("phi_x-dot = 0", "F_phi_x"), ("phi_y-dot = 0", "F_phi_y"), ("F_phi_z = 0", "phi_z-dot"),
        ("F_x = 0", "x-dot"), ("F_y = 0", "y-dot"), ("z-dot = 0", "F_z"),
    ):  # fmt: skip
        name, states = f"row {natural} beside {artificial} [0 or 1]", f"{natural}, {artificial} = ..."
        yield row(name, table.get(natural) == artificial, 1.0, "the chapter's table", states=states)
    yield board()


def board() -> Figure:
    """The chalkboard and the eraser, with their frames."""
    figure, axes = panels(None, height=3.6, subplot_kw={"projection": "3d", "computed_zorder": False})
    ax: Any = axes[0]
    ax.bar3d(-0.3, -0.5, -0.03, 2.4, 1.5, 0.03, color="#E9F0EA", edgecolor=INK, linewidth=0.5)
    ax.bar3d(1.0, 0.1, 0.0, 0.6, 0.3, 0.2, color="#D6C8AC", edgecolor=INK, linewidth=0.5)
    for name, origin in (("s", np.zeros(3)), ("b", np.array([1.3, 0.25, 0.2]))):
        for k, (axis, letter) in enumerate(zip(0.45 * np.eye(3), "xyz", strict=True)):
            ax.quiver(*origin, *axis, color=colour(k))
            ax.text(*(origin + 1.2 * axis), letter, fontsize=SMALL)
        ax.text(*(origin - [0.15, 0.1, 0.0]), f"{{{name}}}", fontsize=SMALL)
    ax.set(xlim=(-0.3, 2.1), ylim=(-0.5, 1.0), zlim=(0.0, 0.7))
    ax.set_box_aspect((2.4, 1.5, 0.7), zoom=1.1)
    ax.view_init(35.0, -70.0)
    return figure
