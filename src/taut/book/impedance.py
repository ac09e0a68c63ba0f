"""Section 10.5: impedance and admittance control, and what a sampled display can be."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

import numpy as np
from scipy.linalg import expm

from taut.analysis.impedance_at_tool import ToolImpedance, tool_impedance
from taut.arm.description import Arm
from taut.arm.load import load_arm
from taut.base.errors import RangeError
from taut.base.fields import Field
from taut.base.plot_style import DASHED, INK, colour, prepared
from taut.book.models import M, engine, link, looped, panda, simulated, ticked, total
from taut.book.multi_joint import Q, V
from taut.book.page import MUJOCO, Shown, compared, entry, legend, panels, row
from taut.control.command import Torque
from taut.control.gains import Gain, Memory, MemoryView
from taut.control.law import Law
from taut.control.laws.admittance import Admittance
from taut.control.laws.impedance import Impedance
from taut.control.laws.task import TaskComputedTorque
from taut.control.trajectories.reference import Sample
from taut.control.trajectories.task_reference import TaskMotion
from taut.controller import compile
from taut.maths.snapshot import Snapshot, snapshot
from taut.plant.environments.environment import Environment
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["FAST", "B", "K", "Pushed", "along_x", "slides", "still"]

D, B, K = 2.0, 20.0, 400.0  # [kg], [N s/m], [N/m] chosen
ANGULAR: Final = (0.05, 0.5, 10.0)  # [kg m^2], [N m s/rad], [N m/rad]
POLYNOMIAL: Final = "m s^2 + b s + k"
CLOSED_FORM: Final = "scipy.linalg.expm of 10.46"
Values = Mapping[str, Any]
FAST: Final = 10000.0  # [Hz]


class Pushed(Environment):
    """A force on the tool's origin along one axis of the world: force cos(omega t)."""

    axis: int = 0
    force: Field = Field(10.0, unit="N")
    omega: Field = Field(0.0, unit="rad/s")

    def wrench(
        self, T_WE: Pose, twist: Any, t: Any, memory: Values, parameters: Values, dt: Any  # noqa: ARG002
    ) -> tuple[Any, dict[str, Any]]:  # fmt: skip
        force = parameters["force"] * tm.cos(parameters["omega"] * t)
        return tm.array([force if k == self.axis else 0.0 for k in range(6)]), {}


@cache
def slides() -> Arm:
    """The gantry without friction: its three directions stand for one each."""
    return load_arm("gantry3").with_joints(viscous=0.0)


VIRTUAL: Final = Impedance(D=(D, ANGULAR[0]), B=(B, ANGULAR[1]), K=(K, ANGULAR[2]))
"""A mass, a damper and a spring that an arm shows at its tool."""


def still(arm: Arm) -> TaskMotion:
    """Where the tool is at home."""
    return TaskMotion(pose=snapshot(arm, arm.home).T())


def answer(m: float, b: float, k: float, force: float, t: float) -> float:
    """x(t) of m x'' + b x' + k x = f, from rest [m]."""
    A = np.array([[0.0, 1.0, 0.0], [-k / m, -b / m, force / m], [0.0, 0.0, 0.0]])
    return float((expm(A * t) @ np.array([0.0, 0.0, 1.0]))[0])


@entry("eq-10.46", "an environment of one direction")
def eq_10_46() -> Shown:
    arm = slides()
    out = simulated(VIRTUAL, arm, still(arm), rate=FAST, duration=0.5, environment=Pushed())
    yield from (
        row(
            f"where the tool is {t:g} s after a push of 10 N",
            "m",
            out.q[round(t * FAST), 0] - arm.home[0],
            answer(D, B, K, 10.0, t),
            CLOSED_FORM,
            rel=5e-3,
        )
        for t in (0.1, 0.2, 0.4)
    )
    yield "Chosen: m = 2 kg, b = 20 N s/m, k = 400 N/m; a gantry of 21 kg along x, a wrist sensor, 10 kHz."


def asked(w: Any) -> Any:
    """m s^2 + b s + k at s = j w [N/m]."""
    return D * (1j * w) ** 2 + B * 1j * w + K


def along_x(law: Law, ref: Sample, rate: float = FAST) -> ToolImpedance:
    """How the gantry's tool answers a force along x."""
    wrist = Pushed(force=0.0)
    return tool_impedance(looped(law, slides(), ref, rate=rate, environment=wrist), direction=[1.0, 0.0, 0.0])


def swept(w: float) -> complex:
    """F / X of a run under an oscillating force, fitted over the last period [N/m]."""
    arm, settled = slides(), np.log(1e5) * 2.0 * D / B
    push = Pushed(force=1.0, omega=w)
    out = simulated(VIRTUAL, arm, still(arm), rate=FAST, duration=settled + 2.0 * np.pi / w, environment=push)
    late = out.between(settled, out.t[-1])
    wt = w * late.t
    basis = np.stack([np.cos(wt), -np.sin(wt), np.ones_like(wt)], axis=1)
    real, imaginary, _ = np.linalg.lstsq(basis, late.q[:, 0], rcond=None)[0]
    return 1.0 / complex(real, imaginary)


@entry("eq-10.47", "its impedance")
def eq_10_47() -> Shown:
    ws = np.geomspace(1.5, 90.0, 5)
    tool = along_x(VIRTUAL, still(slides()))
    measured, wanted = np.array([swept(w) for w in ws]), asked(ws)
    claims = {0: "dominated by the spring", 4: "dominated by the mass"}
    for way, got in (("linearised", tool.Z(ws)), ("by a sweep of runs", measured)):
        for k in (0, 2, 4):
            name = f"Z at {ws[k]:.3g} rad/s, {way}"
            size, turn = (abs(got[k]), abs(wanted[k])), (np.angle(got[k]), np.angle(wanted[k]))
            yield row(f"|{name.replace(' at', '| at')}", "N/m", *size, POLYNOMIAL, rel=0.01, states=claims.get(k, ""))
            yield row(f"phase of {name}", "rad", *turn, POLYNOMIAL, rel=0.01)
    for name, k, part in (("|Z| at 1.5 rad/s over k", 0, K), ("|Z| at 90 rad/s over m w^2", 4, D * ws[4] ** 2)):
        got, want = abs(measured[k]) / part, abs(wanted[k]) / part
        yield row(name, "", got, want, POLYNOMIAL, rel=0.01, states="near 1")
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "impedance at the tool", "|F / X| [N/m]", "w [rad/s]")
    fine = np.geomspace(1.0, 120.0, 200)
    ax.loglog(fine, np.abs(asked(fine)), color=INK, linewidth=0.9, label="|m s² + b s + k|")
    ax.loglog(ws, np.abs(measured), "o", color=colour(0), markersize=4.5, label="runs")
    ax.axhline(K, color=colour(2), linewidth=0.9, linestyle=DASHED, label="k")
    ax.loglog(fine, D * fine**2, color=colour(1), linewidth=0.9, linestyle=DASHED, label="m w²")
    ax.set_ylim(50.0, 4e4)
    legend(ax)

    yield figure
    yield "Numbers of equation 10.46. Linearised by taut.analysis.tool_impedance."


@entry("eq-10.48", "the behaviour that is asked of an arm")
def eq_10_48() -> Shown:
    arm = panda()
    p = still(arm).p
    out = simulated(VIRTUAL, arm, still(arm), duration=2.0, environment=Pushed(axis=1, force=8.0))
    moved = out.task.p[:, 1] - p[1]
    yield from (
        row(
            f"tool of a Panda {t:g} s after a push of 8 N along y",
            "m",
            moved[round(1000 * t)],
            answer(D, B, K, 8.0, t),
            CLOSED_FORM,
            rel=0.03,
        )
        for t in (0.1, 0.3)
    )
    yield row("where it comes to rest", "m", moved[-1], 8.0 / K, "K^-1 F_ext", rel=5e-3)
    yield row(
        "what it moves across, in the end",
        "m",
        np.abs(out.task.p[-1, [0, 2]] - p[[0, 2]]).max(),
        0.0,
        "10.48: nothing",
        near=2e-4,
    )
    yield "D, B and K of equation 10.46 in all directions, (0.05, 0.5, 10) for turning; 1 kHz."


@entry("eq-10.49", "impedance control")
def eq_10_49() -> Shown:
    m = engine().at(Q, V)
    ref = TaskMotion(pose=Pose(m.p + np.array([0.02, -0.01, 0.03]), R=m.R), twist=[0.1, 0.2, -0.1, 0.0, 0.0, 0.0])
    ctrl = ticked(Impedance(B=(B, ANGULAR[1]), K=(K, ANGULAR[2]), null=None), panda(), Q, V, ref)
    got = total(ctrl.terms)
    X = np.array([0.02, -0.01, 0.03, 0.0, 0.0, 0.0])
    gains = [np.array([each[0]] * 3 + [each[1]] * 3) for each in ((K, ANGULAR[2]), (B, ANGULAR[1]))]
    spring = gains[0] * X + gains[1] * (ref.twist - m.J @ V)
    wanted = m.J.T @ (spring - m.Lambda @ m.Jdot_v) + m.h
    yield from compared(got, wanted, "N m", MUJOCO, "torque of the Panda, D left out", 1e-6)
    for factor in (0.1, 1.9, 2.1):
        yield row(
            f"D = {factor:g} of the arm's inertia: accepted",
            "0 or 1",
            accepted(factor),
            abs(1.0 - factor) < 1.0,
            "|1 - Lambda^-1 D| < 1",
            states="slip: D V-dot with the measured V-dot" if factor > 2.0 else "",
        )
    for factor in (1.9, 2.1):
        yield row(
            f"error of the acceleration, one tick over the last, D = {factor:g} of M",
            "",
            echoed(factor),
            1.0 - factor,
            "1 - M^-1 D",
            rel=1e-6,
        )

    yield (
        "With a measured acceleration D V-dot is an algebraic loop; a tick old it is stable only for 0 < "
        "eig(Lambda^-1 D) < 2, and refused elsewhere. Common practice, as the chapter says, leaves "
        "the inertia out: the first rows."
    )


class MeasuredInertia(Law):
    """Inertia by the acceleration of the tick before, as equation 10.49 has it, and nothing else.

    Law:          tau = (M - D) a, with a differenced velocities
    Closed loop:  a_next = (1 - M^-1 D) a, tick by tick
    """

    ignores_reference = True
    D: Gain  # [kg m^2]
    before: Memory = Memory(0.0)  # [rad/s]

    def command(
        self, x: Snapshot, ref: Sample, memory: MemoryView, dt: float  # noqa: ARG002
    ) -> tuple[Torque, dict[str, object]]:  # fmt: skip
        a = (x.v - memory.before) / dt
        return Torque(compensation=x.M @ a, inertia=-(self.D @ a)), {"before": x.v}


def echoed(factor: float) -> float:
    """By how much the acceleration changes from one tick to the next, with D a multiple of M."""
    arm = link(gravity=False, b=0.0)
    out = simulated(MeasuredInertia(D=factor * M), arm, duration=0.02, q0=[0.0], v0=[1e-3])
    a = np.diff(out.v[:, 0])
    return float(a[10] / a[9])


def accepted(factor: float) -> bool:
    """Whether a gantry's x axis may show a multiple of its inertia by its own measured acceleration."""
    arm = slides().subset(["x"])
    mass = float(snapshot(arm, [0.0]).M[0, 0])
    law = Impedance(D=(factor * mass, 1.0), B=(10.0, 1.0), K=(10.0, 1.0), feedback="acceleration")
    try:
        simulated(law, arm, still(arm), duration=0.01)
    except RangeError:
        return False
    return True


@entry("eq-10.50", "admittance control")
def eq_10_50() -> Shown:
    law = Admittance(
        inner=TaskComputedTorque(kp=2500.0, kd=100.0, singularity="plain"),
        D=(D, ANGULAR[0]), B=(B, ANGULAR[1]), K=(K, ANGULAR[2]),
    )  # fmt: skip
    arm = panda()
    rest = still(arm)
    F_ext = np.array([0.0, 8.0, 0.0, 0.0, 0.0, 0.0])
    first = {}
    for dt in (1e-3, 1e-6):
        ctrl = compile(law, arm, rate=1.0 / dt, engine="float")
        ctrl.step(arm.home, np.zeros(7), rest, F_ext=F_ext)
        first[dt] = float(ctrl.memory["law.twist"][1]) / dt
    out = simulated(law, arm, rest, duration=2.0, environment=Pushed(axis=1, force=8.0))
    moved = out.task.p[:, 1] - rest.p[1]
    yield row(
        "acceleration of the model in the first tick, 1 ms",
        "m/s^2",
        first[1e-3],
        8.0 / (D + 0.5 * B * 1e-3 + 0.25 * K * 1e-6),
        "D^-1 F_ext, implicit midpoint rule",
        rel=1e-9,
    )
    yield row(
        "the same in a tick of 1 us",
        "m/s^2",
        first[1e-6],
        8.0 / D,
        "D^-1 F_ext",
        rel=1e-5,
        states="D^-1 (F_ext - B V - K X)",
    )
    yield from (
        row(
            f"tool of a Panda {t:g} s after a push of 8 N along y",
            "m",
            moved[round(1000 * t)],
            answer(D, B, K, 8.0, t),
            CLOSED_FORM,
            rel=0.03,
        )
        for t in (0.1, 0.3)
    )
    yield row("where it comes to rest", "m", moved[-1], 8.0 / K, "K^-1 F_ext", rel=5e-3)
    yield "D, B and K of equation 10.48; the model's own motion is followed with kp = 2500, kd = 100."
