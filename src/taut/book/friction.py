"""Section 10.2.1.4: laws of friction, figure 10.14."""

from __future__ import annotations

import math
from typing import Final

from taut.arm.friction import Friction
from taut.book.link import M, controller, link, on_link
from taut.book.page import Entry, Page, Row, row
from taut.book.single_joint import ConstantTorque
from taut.control.trajectories.reference import JointMotion
from taut.record.plots.friction_curves import plot_friction

__all__ = ["ENTRIES"]

STATIC, KINETIC, VISCOUS, STRIBECK = 0.5, 0.3, 0.2, 0.1  # [N m], [N m], [N m s/rad], [rad/s] chosen
LAWS: Final = {
    "(a) viscous": Friction(viscous=VISCOUS),
    "(b) Coulomb": Friction(coulomb=KINETIC),
    "(c) static and viscous": Friction(coulomb=KINETIC, viscous=VISCOUS),
    "(d) static and kinetic": Friction(coulomb=KINETIC, static=STATIC),
    "(e) static, kinetic, viscous": Friction(coulomb=KINETIC, static=STATIC, viscous=VISCOUS),
    "(f) Stribeck": Friction(coulomb=KINETIC, static=STATIC, viscous=VISCOUS, stribeck=STRIBECK),
}
SPEEDS: Final = (0.05, -1.0)  # [rad/s]
REST: Final = JointMotion(q=[0.0])
STICKING: Final = "semi-implicit-euler"
EQUATION: Final = "the law of the panel, written out"


def torque(panel: str, v: float) -> float:
    """What each panel says of a joint that moves [N m]."""
    dry = {"(a) viscous": 0.0}.get(panel, KINETIC)
    if panel == "(f) Stribeck":
        dry = KINETIC + (STATIC - KINETIC) * math.exp(-((v / STRIBECK) ** 2))
    return math.copysign(dry, v) + (VISCOUS * v if "viscous" in panel or panel == "(f) Stribeck" else 0.0)


def fig_10_14() -> Page:
    rows: list[Row] = []
    ctrl = controller(ConstantTorque(tau=1.0), link(gravity=False))
    for panel, friction in LAWS.items():
        arm = link(gravity=False).with_friction(friction)
        for v in SPEEDS:
            ctrl.parameters["law.tau"] = 1.0
            run = on_link(ctrl, plant=arm, ref=REST, duration=1e-3, q0=[0.0], v0=[v], integrator=STICKING)
            a = (run.v[1, 0] - run.v[0, 0]) * run.rate
            rows.append(
                row(f"{panel}: friction at {v:g} rad/s", "N m", 1.0 - M * a, torque(panel, v), EQUATION, near=1e-4)
            )
    arm = link(gravity=False).with_friction(LAWS["(d) static and kinetic"])
    for tau in (0.99 * STATIC, 1.01 * STATIC, -0.99 * STATIC, -1.01 * STATIC):
        ctrl.parameters["law.tau"] = tau
        run = on_link(ctrl, plant=arm, ref=REST, duration=0.5, q0=[0.0], integrator=STICKING)
        breaks = abs(tau) > STATIC
        wanted = 0.5 * (tau - math.copysign(KINETIC, tau)) / M if breaks else 0.0
        slip = "slip: tau_fric >= |b_static|" if tau < 0.0 and breaks else ""
        rows.append(
            row(
                f"(d): speed after 0.5 s under {tau:g} N m, from rest", "rad/s",
                run.v[-1, 0], wanted, "|tau| >= b_static", rel=1e-3, near=1e-12, states=slip,
            )
        )  # fmt: skip
    note = (
        "Chosen: b_static = 0.5 N m, b_kinetic = 0.3 N m, b_viscous = 0.2 N m s/rad, a Stribeck speed of 0.1 rad/s. "
        "To initiate motion the torque on the joint must be |tau| >= b_static, in either direction; the chapter asks "
        "it of the friction torque, and without the sign."
    )
    return Page(rows=tuple(rows), figure=plot_friction(LAWS, speed=1.0), note=note)


ENTRIES: Final = (Entry(id="fig-10.14", title="laws of friction", make=fig_10_14),)
