"""Section 10.3: force control, and the pole that the feedforward gives its error."""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np

from taut.arm.load import load_arm
from taut.base.plot_style import DASHED, INK, colour, prepared
from taut.book.drawing import legend, panels
from taut.book.multi_joint import Q, V
from taut.book.oracle import TWO_LINKS, engine, panda, two_links
from taut.book.page import MUJOCO, Entry, Page, compared, row
from taut.book.simulation import one_pole, simulated, ticked, total
from taut.book.single_joint import ConstantTorque
from taut.control.laws.force import ForceControl
from taut.control.trajectories.force_reference import TaskForce
from taut.maths.constraints.constraint import Constraint
from taut.maths.snapshot import snapshot
from taut.plant.contact import RigidContact
from taut.plant.environments.environment import Environments
from taut.plant.environments.springs import Damper, Spring
from taut.record.run import Run

__all__ = ["ENTRIES", "pressing_down"]

F: Final = np.array([5.0, -3.0, -10.0, 0.3, 0.2, -0.1])  # [N, N m] of the arm on what it touches
KFP, KFI = 0.5, 3.0  # [1], [1/s] those of MATHS: the pole is -2, the chapter's is -6
UNKNOWN: Final = 0.5  # [kg] that the law does not know
KDAMP: Final = (40.0, 40.0, 40.0, 2.0, 2.0, 0.1)  # [N s/m, N m s/rad]
REST: Final = TaskForce(F_app=F)


def eq_10_32() -> Page:
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
    rows = (
        row(
            "force on a plane that two links slide on",
            "N",
            out.extra["contact.lam"][0, 0],
            lam[0],
            "10.32, solved by hand",
            rel=1e-6,
        ),
    )
    return Page(rows=rows, note="Chosen: 3 N m at both joints, 0.4 m/s along a frictionless plane; negative presses.")


def eq_10_33() -> Page:
    arm = panda()
    x = snapshot(arm, Q)
    got = np.asarray(x.g) + np.asarray(x.J()).T @ F
    m = engine().at(Q, np.zeros(7))
    return Page(
        rows=tuple(compared(got, m.h + m.J.T @ F, "N m", MUJOCO, "torque of a Panda that presses")),
        note="Chosen: the wrench (5, -3, -10) N, (0.3, 0.2, -0.1) N m.",
    )


def eq_10_34() -> Page:
    ctrl = ticked(ForceControl(feedback="none", null=None), panda(), Q, np.zeros(7), REST)
    got = total(ctrl.terms)
    m = engine().at(Q, np.zeros(7))
    rows = compared(got, m.h + m.J.T @ F, "N m", MUJOCO, "torque of the Panda")
    return Page(rows=tuple(rows), note="The wrench of equation 10.33.")


def eq_10_35() -> Page:
    F_app = 0.8 * F
    law = ForceControl(kfp=KFP, kfi=KFI, null=None)
    ctrl = ticked(law, panda(), Q, np.zeros(7), REST, F_app=F_app)
    got = total(ctrl.terms)
    m = engine().at(Q, np.zeros(7))
    F_e = F - F_app
    wanted = m.h + m.J.T @ (F + KFP * F_e + KFI * F_e * 1e-3)
    return Page(
        rows=tuple(compared(got, wanted, "N m", MUJOCO, "torque of the Panda")),
        note="Chosen: Kfp = 0.5, Kfi = 3 1/s; 0.8 of the wrench is measured.",
    )


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


def eq_10_36() -> Page:
    """Without its integral, (1 + Kfp) F_e is what the law does not know: its load's weight."""
    out = pressing_down(0.0)
    wanted = UNKNOWN * 9.81 / (1.0 + KFP)
    rows = (
        row(
            "vertical error of force at rest, Kfi = 0", "N", force_error(out)[-1], wanted, "m g / (1 + Kfp)",
            rel=2e-3, states=f"slip: Kfp F_e = m g, {UNKNOWN * 9.81 / KFP:.3g} N",
        ),
    )  # fmt: skip
    note = (
        "The feedforward F_d was left out: (I + Kfp) F_e + Kfi int(F_e) is what g does not know. A Panda against "
        "springs, Kfp = 0.5, with half a kilogram that the law does not know."
    )
    return Page(rows=rows, note=note)


def eq_10_37() -> Page:
    out = pressing_down(KFI)
    e = force_error(out)
    late = (out.t > 0.8) & (out.t < 2.0)
    rows = (
        row(
            "pole of the error of force",
            "1/s",
            one_pole(out.t[late], e[late]),
            -KFI / (1.0 + KFP),
            "-Kfi / (1 + Kfp)",
            rel=0.01,
            states=f"slip: -Kfi / Kfp = {-KFI / KFP:g}",
        ),
        row("error of force after 3 s", "N", e[-1], 0.0, "the chapter: converges to zero", near=0.01),
    )
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
    note = "Kfp = 0.5, Kfi = 3 1/s, as in equation 10.36: the pole is -2, not -6 1/s."
    return Page(rows=rows, figure=figure, note=note)


def eq_10_38() -> Page:
    """With nothing to press on, the damping bounds the speed."""
    V_tool = engine().at(Q, V).J @ V
    law = ForceControl(kfp=KFP, kfi=KFI, kdamp=KDAMP, null=None)
    ctrl = ticked(law, panda(), Q, V, REST, F_app=0.8 * F)
    got = total(ctrl.terms)
    m, K, dt = engine().at(Q, np.zeros(7)), np.diag(KDAMP), 1e-3
    F_e = 0.2 * F
    damping = np.linalg.solve(np.eye(6) + dt * K @ np.linalg.inv(m.Lambda), K @ V_tool)
    wanted = m.h + m.J.T @ (F + KFP * F_e + KFI * F_e * dt - damping)
    rows = compared(got, wanted, "N m", MUJOCO, "torque of the Panda", 1e-6)
    gantry = load_arm("gantry3").with_joints(viscous=0.0)
    kdamp = np.array([50.0, 50.0, 50.0, 1.0, 1.0, 1.0])
    push = TaskForce(F_app=[10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    damped, free = (
        simulated(ForceControl(feedback="none", kdamp=gain), gantry, push, duration=2.5).v[-1, 0]
        for gain in (kdamp, 0.0 * kdamp)
    )
    mass = gantry.bodies[0].mass + gantry.bodies[1].mass + gantry.bodies[2].mass
    name = "speed of a gantry that presses on nothing for 2.5 s"
    rows += [
        row(name, "m/s", damped, 10.0 / 50.0, "F_d / Kdamp", rel=0.01, states="acceleration is limited"),
        row(f"{name}, Kdamp = 0", "m/s", free, 10.0 * 2.5 / mass, "F_d t / m", states="the robot will accelerate"),
    ]
    note = (
        "The damping is that at the end of the tick, (I + Kdamp Lambda^-1 dt)^-1 Kdamp V, which is the chapter's as "
        "dt falls. Chosen: Kdamp = (40, 2) and 0.1 about z; the gantry has 10 N and 50 N s/m."
    )
    return Page(rows=tuple(rows), note=note)


ENTRIES: Final = (
    Entry(id="eq-10.32", title="dynamics of an arm that touches", make=eq_10_32),
    Entry(id="eq-10.33", title="the same at rest", make=eq_10_33),
    Entry(id="eq-10.34", title="force control by feedforward", make=eq_10_34),
    Entry(id="eq-10.35", title="force control by feedback", make=eq_10_35),
    Entry(id="eq-10.36", title="its error", make=eq_10_36),
    Entry(id="eq-10.37", title="its pole", make=eq_10_37),
    Entry(id="eq-10.38", title="force control with damping", make=eq_10_38),
)
