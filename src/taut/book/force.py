"""Sections 10.3 and 10.4.1: force control, and natural and artificial constraints."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from taut.analysis.constraints.natural_constraints import ConstraintTable, natural_constraints
from taut.analysis.constraints.specification import check_specification
from taut.arm.load import load_arm
from taut.base.plot_style import DASHED, INK, SMALL, colour, prepared
from taut.base.types import Float64Array
from taut.book.models import TWO_LINKS, engine, one_pole, panda, simulated, ticked, total, two_links
from taut.book.multi_joint import Q, V
from taut.book.page import MUJOCO, Shown, arrow, canvas, compared, entry, legend, panels, row, words
from taut.book.single_joint import ConstantTorque
from taut.control.laws.force import ForceControl
from taut.control.trajectories.force_reference import TaskForce
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import snapshot
from taut.plant.contact import RigidContact
from taut.plant.environments.environment import Environments
from taut.plant.environments.springs import Damper, Spring
from taut.record.run import Run
from taut.trace.pose import Pose

__all__ = ["pressing_down"]

F: Final = np.array([5.0, -3.0, -10.0, 0.3, 0.2, -0.1])  # [N, N m] of the arm on what it touches
KFP, KFI = 0.5, 3.0  # [1], [1/s] those of MATHS: the pole is -2, the chapter's is -6
UNKNOWN: Final = 0.5  # [kg] that the law does not know
KDAMP: Final = (40.0, 40.0, 40.0, 2.0, 2.0, 0.1)  # [N s/m, N m s/rad]
REST: Final = TaskForce(F_app=F)


@entry("eq-10.32", "dynamics of an arm that touches")
def eq_10_32() -> Shown:
    """The tool of two links slides on a plane, which takes the force that the dynamics leave."""
    arm, q = two_links(), np.array([0.3, 0.8])
    height = float(TWO_LINKS.tip(q)[1])
    v = np.linalg.solve(TWO_LINKS.J(q), np.array([0.4, 0.0]))
    board = Constraint.plane(point=[0.0, 0.0, height], normal=[0.0, 0.0, 1.0])
    tau = 3.0
    contact = RigidContact(constraint=board)
    out = simulated(ConstantTorque(tau=tau), arm, duration=0.002, q0=q, v0=v, contact=contact)
    A_q, M = TWO_LINKS.J(q)[1:], TWO_LINKS.M(q)
    bias = TWO_LINKS.Jdot_v(q, v)[1]
    free = np.linalg.solve(M, tau - TWO_LINKS.h(q, v))
    lam = (A_q @ free + bias) / (A_q @ np.linalg.solve(M, A_q.T))[0]
    yield row(
        "force on a plane that two links slide on",
        "N",
        out.extra["contact.lam"][0, 0],
        lam[0],
        "10.32, solved by hand",
        rel=1e-6,
    )
    yield "Chosen: 3 N m at both joints, 0.4 m/s along a frictionless plane; negative presses."


@entry("eq-10.33", "the same at rest")
def eq_10_33() -> Shown:
    arm = panda()
    x = snapshot(arm, Q)
    got = np.asarray(x.g) + np.asarray(x.J()).T @ F
    m = engine().at(Q, np.zeros(7))
    yield from compared(got, m.h + m.J.T @ F, "N m", MUJOCO, "torque of a Panda that presses")
    yield "Chosen: the wrench (5, -3, -10) N, (0.3, 0.2, -0.1) N m."


@entry("eq-10.34", "force control by feedforward")
def eq_10_34() -> Shown:
    ctrl = ticked(ForceControl(feedback="none", null=None), panda(), Q, np.zeros(7), REST)
    got = total(ctrl.terms)
    m = engine().at(Q, np.zeros(7))
    yield from compared(got, m.h + m.J.T @ F, "N m", MUJOCO, "torque of the Panda")
    yield "The wrench of equation 10.33."


@entry("eq-10.35", "force control by feedback")
def eq_10_35() -> Shown:
    F_app = 0.8 * F
    law = ForceControl(kfp=KFP, kfi=KFI, null=None)
    ctrl = ticked(law, panda(), Q, np.zeros(7), REST, F_app=F_app)
    got = total(ctrl.terms)
    m = engine().at(Q, np.zeros(7))
    F_e = F - F_app
    wanted = m.h + m.J.T @ (F + KFP * F_e + KFI * F_e * 1e-3)
    yield from compared(got, wanted, "N m", MUJOCO, "torque of the Panda")
    yield "Chosen: Kfp = 0.5, Kfi = 3 1/s; 0.8 of the wrench is measured."


@cache
def pressing_down(kfi: float) -> Run:
    """A Panda that presses, and carries what its law does not know."""
    held = Environments(
        spring=Spring(stiffness=[2e4, 2e4, 2e4, 500.0, 500.0, 5.0]),
        damper=Damper(damping=[400.0, 400.0, 400.0, 6.0, 6.0, 0.05]),
    )
    law = ForceControl(kfp=KFP, kfi=kfi, kdamp=KDAMP, e_int_max=(4.0, 0.2))
    loaded = panda().with_payload(mass=UNKNOWN)
    return simulated(law, panda(), REST, plant=loaded, duration=3.0, environment=held)


def force_error(out: Run) -> np.ndarray:
    """(k,) of the vertical force [N]."""
    return np.asarray(F[2] + out.extra["F_ext"][:, 2])


@entry("eq-10.36", "its error")
def eq_10_36() -> Shown:
    """Without its integral, (1 + Kfp) F_e is what the law does not know: its load's weight."""
    out = pressing_down(0.0)
    wanted = UNKNOWN * 9.81 / (1.0 + KFP)
    yield row(
        "vertical error of force at rest, Kfi = 0",
        "N",
        force_error(out)[-1],
        wanted,
        "m g / (1 + Kfp)",
        rel=2e-3,
        states=f"slip: Kfp F_e = m g, {UNKNOWN * 9.81 / KFP:.3g} N",
    )

    yield (
        "The feedforward F_d was left out: (I + Kfp) F_e + Kfi int(F_e) is what g does not know. A Panda against "
        "springs, Kfp = 0.5, with half a kilogram that the law does not know."
    )


@entry("eq-10.37", "its pole")
def eq_10_37() -> Shown:
    out = pressing_down(KFI)
    e = force_error(out)
    late = (out.t > 0.8) & (out.t < 2.0)
    yield row(
        "pole of the error of force",
        "1/s",
        one_pole(out.t[late], e[late]),
        -KFI / (1.0 + KFP),
        "-Kfi / (1 + Kfp)",
        rel=0.01,
        states=f"slip: -Kfi / Kfp = {-KFI / KFP:g}",
    )
    yield row("error of force after 3 s", "N", e[-1], 0.0, "the chapter: converges to zero", near=0.01)
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "error of the vertical force", "|F_e| [N]", "t [s]")
    ax.semilogy(out.t, np.abs(e), color=colour(0), linewidth=1.5, label="run")
    k = int(np.searchsorted(out.t, 0.8))
    for k_color, (pole, name) in enumerate(
        ((-KFI / (1.0 + KFP), "-Kfi / (1 + Kfp)"), (-KFI / KFP, "the chapter: -Kfi / Kfp"))
    ):
        there = out.t > 0.3
        line = abs(e[k]) * np.exp(pole * (out.t[there] - out.t[k]))
        ax.semilogy(
            out.t[there], line, color=INK if not k_color else colour(1), linewidth=0.9, linestyle=DASHED, label=name
        )
    ax.set_ylim(1e-4, 20.0)
    legend(ax)

    yield figure
    yield "Kfp = 0.5, Kfi = 3 1/s, as in equation 10.36: the pole is -2, not -6 1/s."


@entry("eq-10.38", "force control with damping")
def eq_10_38() -> Shown:
    """With nothing to press on, the damping bounds the speed."""
    V_tool = engine().at(Q, V).J @ V
    law = ForceControl(kfp=KFP, kfi=KFI, kdamp=KDAMP, null=None)
    ctrl = ticked(law, panda(), Q, V, REST, F_app=0.8 * F)
    got = total(ctrl.terms)
    m, K, dt = engine().at(Q, np.zeros(7)), np.diag(KDAMP), 1e-3
    F_e = 0.2 * F
    damping = np.linalg.solve(np.eye(6) + dt * K @ np.linalg.inv(m.Lambda), K @ V_tool)
    wanted = m.h + m.J.T @ (F + KFP * F_e + KFI * F_e * dt - damping)
    yield from compared(got, wanted, "N m", MUJOCO, "torque of the Panda", 1e-6)
    gantry = load_arm("gantry3").with_joints(viscous=0.0)
    kdamp = np.array([50.0, 50.0, 50.0, 1.0, 1.0, 1.0])
    push = TaskForce(F_app=[10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    damped, free = (
        simulated(ForceControl(feedback="none", kdamp=gain), gantry, push, duration=2.5).v[-1, 0]
        for gain in (kdamp, 0.0 * kdamp)
    )
    mass = gantry.bodies[0].mass + gantry.bodies[1].mass + gantry.bodies[2].mass
    name = "speed of a gantry that presses on nothing for 2.5 s"
    yield row(name, "m/s", damped, 10.0 / 50.0, "F_d / Kdamp", rel=0.01, states="acceleration is limited")
    yield row(f"{name}, Kdamp = 0", "m/s", free, 10.0 * 2.5 / mass, "F_d t / m", states="the robot will accelerate")

    yield (
        "The damping is that at the end of the tick, (I + Kdamp Lambda^-1 dt)^-1 Kdamp V, which is the chapter's as "
        "dt falls. Chosen: Kdamp = (40, 2) and 0.1 about z; the gantry has 10 N and 50 N s/m."
    )


B_ENV: Final = [[2.0, 1.0], [1.0, 1.0]]  # the chapter's damper


@entry("sec-10.4", "what may be specified against a damper")
def sec_10_4() -> Shown:
    given = check_specification({"F1": 3.0, "V1": 1.0}, B=B_ENV)
    got = given.quantities
    V2 = 3.0 - 2.0 * 1.0
    dependent = check_specification(["F1", "2 V1 + V2"], B=B_ENV)
    rank = np.linalg.matrix_rank(np.vstack([B_ENV[0], [2.0, 1.0]]))
    yield row("F1 = 3, V1 = 1 may be chosen", "0 or 1", given.ok, 1.0, "the chapter", states="yes")
    yield row("then V2 is", "m/s", got["V2"], V2, "F1 = 2 V1 + V2, solved", states="determined by B_env")
    yield row("and F2 is", "N", got["F2"], 1.0 + V2, "F2 = V1 + V2", states="determined by B_env")
    yield row(
        "F1 and 2 V1 + V2 may be chosen",
        "0 or 1",
        dependent.ok,
        rank == 2,
        "rank of the two rows",
        states="no: the same direction",
    )
    yield "Chosen: the values of F1 and V1."


def eraser() -> Constraint:
    """The eraser's face on the chalkboard of figure 10.16: three rows."""
    return Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], face=[0.0, 0.0, -1.0])


def counted(name: str, found: ConstraintTable, motions: int, forces: int, states: str) -> list[Any]:
    """Rows of how many motions and forces may be chosen."""
    return [
        row(f"{name}: motions that may be chosen", "", found.motions, motions, "the chapter", states=states),
        row(f"{name}: forces that may be chosen", "", found.forces, forces, "the chapter"),
    ]


@entry("sec-10.4.1", "natural and artificial constraints")
def sec_10_4_1() -> Shown:
    door = Constraint.hinge(point=[0.5, 0.2, 0.3], axis=[0.0, 0.0, 1.0], T=Pose([0.4, 0.1, 0.3]))
    chalk = Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
    sharp = Constraint(lambda T: T.p[2], one_sided=True)
    at = Pose([0.4, 0.1, 0.0])
    yield from counted("cabinet door", natural_constraints(door, at=Pose([0.4, 0.1, 0.3])), 1, 5, "1 + 5")
    yield from counted("chalk on a board", natural_constraints(chalk, at=at), 5, 1, "5 + 1")
    yield from counted(
        "chalk that sticks", natural_constraints(sharp, at=at, mode="stick", friction=0.3), 3, 3, "3 + 3"
    )
    yield from counted("chalk pulled away", natural_constraints(sharp, at=at, mode="apart"), 6, 0, "6 + 0")


@entry("fig-10.16", "the eraser on the chalkboard")
def fig_10_16() -> Shown:
    found = natural_constraints(eraser(), at=Pose([0.4, 0.1, 0.0]))
    yield from counted("eraser", found, 3, 3, "3 + 3")
    wanted = {
        "phi_x-dot = 0": "F_phi_x",
        "phi_y-dot = 0": "F_phi_y",
        "F_phi_z = 0": "phi_z-dot",
        "F_x = 0": "x-dot",
        "F_y = 0": "y-dot",
        "z-dot = 0": "F_z",
    }
    table = {row.natural: row.artificial for row in found.rows}
    for natural, artificial in wanted.items():
        there = table.get(natural) == artificial
        yield row(
            f"row {natural} beside {artificial}",
            "0 or 1",
            there,
            1.0,
            "the chapter's table",
            states=f"{natural}, {artificial} = ...",
        )
    yield board()
    yield "The frames are as in the chapter: {s} on the board, {b} on the eraser."


def board() -> Any:
    """The chalkboard and the eraser, with their frames, in a parallel projection."""
    figure, ax = canvas(8.0, 4.2, 0.85)
    view = (
        Rotation.from_euler("zyx", [0.0, 0.0, -62.0], degrees=True).as_matrix()
        @ Rotation.from_euler("z", 28.0, degrees=True).as_matrix()
    )

    def seen(points: Any) -> Float64Array:
        flat = np.atleast_2d(points) @ view.T
        return np.column_stack([2.1 + 2.3 * flat[:, 0], 1.1 + 2.3 * flat[:, 1]])

    def patch(corners: Any, fill: str) -> None:
        ax.fill(*seen(corners).T, facecolor=fill, edgecolor=INK, linewidth=0.9)

    def axes_at(T: Pose, name: str) -> None:
        o = np.asarray(T.p)
        for k, letter in enumerate("xyz"):
            start, end = seen([o, o + 0.45 * np.asarray(T.R)[:, k]])
            arrow(ax, (float(start[0]), float(start[1])), (float(end[0]), float(end[1])), ink=colour(k), width=1.6)
            far = seen(o + 0.52 * np.asarray(T.R)[:, k])[0]
            words(ax, float(far[0]), float(far[1]), letter)
        place = seen(o - 0.1 * np.asarray(T.R)[:, 0] - 0.1 * np.asarray(T.R)[:, 1])[0]
        words(ax, float(place[0]), float(place[1]), f"{{{name}}}")

    patch([[-0.3, -0.5, 0.0], [2.1, -0.5, 0.0], [2.1, 1.0, 0.0], [-0.3, 1.0, 0.0]], "#E9F0EA")
    b = Pose([1.25, 0.3, 0.12], rpy=[0.0, 0.0, 0.3])
    half = np.array([0.28, 0.14, 0.12])
    for k, sign, fill in (
        (0, 1.0, "#C8B89A"),
        (0, -1.0, "#C8B89A"),
        (1, 1.0, "#D6C8AC"),
        (1, -1.0, "#D6C8AC"),
        (2, 1.0, "#E4D9C2"),
    ):
        outwards = sign * np.asarray(b.R)[:, k]
        if (view @ outwards)[2] > 0.0:  # towards who looks
            i, j = (axis for axis in range(3) if axis != k)
            face = np.zeros((4, 3))
            face[:, k], face[:, i], face[:, j] = sign, [-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]
            patch(np.asarray(b.p) + (face * half) @ np.asarray(b.R).T, fill)
    axes_at(Pose([0.0, 0.0, 0.0]), "s")
    axes_at(b, "b")
    words(ax, 5.6, 1.15, "chalkboard", size=SMALL)
    return figure
