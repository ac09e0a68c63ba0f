"""Sections 10.5 and 10.6: impedance and admittance control, a haptic display, and a flexible transmission."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Final

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import taut
from taut import Arm, Law, Pose, TaskMotion, linearise, snapshot
from taut import math as tm
from taut.analysis import ToolImpedance, check_virtual_wall, tool_impedance
from taut.base.plot_style import DASHED, INK, SMALL
from taut.book.models import (
    FAST,
    REST,
    M,
    held_radius,
    in_mujoco,
    link,
    looped,
    panda,
    simulated,
    ticked,
    total,
    two_poles,
)
from taut.book.multi_joint import Q, V
from taut.book.page import (
    MUJOCO,
    ROOTS,
    Row,
    Shown,
    arrow,
    block,
    compared,
    curve,
    entry,
    legend,
    panels,
    pole,
    row,
    rows,
    words,
)
from taut.control.gains import MemoryView
from taut.control.trajectories.reference import Sample
from taut.drives import Actuation, Transmission
from taut.environments import Environment, Field, Hand
from taut.errors import RangeError
from taut.laws import PID, Admittance, ForceControl, Impedance, TaskComputedTorque

D, B, K = 2.0, 20.0, 400.0  # [kg], [N s/m], [N/m] chosen
ANGULAR: Final = (0.05, 0.5, 10.0)  # [kg m^2], [N m s/rad], [N m/rad]
POLYNOMIAL: Final = "m s^2 + b s + k"
CLOSED_FORM: Final = "scipy.linalg.expm of 10.46"
Values = Mapping[str, Any]


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
    """The gantry without friction, whose three directions are decoupled."""
    return taut.load_arm("gantry3").with_joints(viscous=0.0)


VIRTUAL: Final = Impedance(D=(D, ANGULAR[0]), B=(B, ANGULAR[1]), K=(K, ANGULAR[2]))
"""A mass, a damper and a spring that an arm renders at its tool."""


def still(arm: Arm) -> TaskMotion:
    """The tool at rest at its home."""
    return TaskMotion(pose=snapshot(arm, arm.home).T())


def answer(force: float, t: float) -> float:
    """x(t) of m x'' + b x' + k x = f, from rest [m]."""
    A = np.array([[0.0, 1.0, 0.0], [-K / D, -B / D, force / D], [0.0, 0.0, 0.0]])
    return float((expm(A * t) @ np.array([0.0, 0.0, 1.0]))[0])


@entry("eq-10.46", "an environment of one direction")
def eq_10_46() -> Shown:
    """Chosen: m = 2 kg, b = 20 N s/m, k = 400 N/m; a gantry of 21 kg along x, a wrist sensor, 10 kHz."""
    out = simulated(VIRTUAL, slides(), still(slides()), rate=FAST, duration=0.5, environment=Pushed())
    times = (0.1, 0.2, 0.4)
    got = [out.q[round(t * FAST), 0] - slides().home[0] for t in times]
    wanted = [answer(10.0, t) for t in times]
    yield from rows("where the tool is {:g} s after a push of 10 N [m]", times, got, wanted, CLOSED_FORM, rel=5e-3)


def along_x(law: Law, ref: Sample) -> ToolImpedance:
    """Impedance of the gantry's tool along x."""
    wrist = Pushed(force=0.0)
    return tool_impedance(looped(law, slides(), ref, rate=FAST, environment=wrist), direction=[1.0, 0.0, 0.0])


def swept(w: float) -> complex:
    """F / X of a run under an oscillating force, fitted over the last period [N/m]."""
    settled, push = np.log(1e5) * 2.0 * D / B, Pushed(force=1.0, omega=w)
    duration = settled + 2.0 * np.pi / w
    out = simulated(VIRTUAL, slides(), still(slides()), rate=FAST, duration=duration, environment=push)
    late = out.between(settled, out.t[-1])
    wt = w * late.t
    basis = np.stack([np.cos(wt), -np.sin(wt), np.ones_like(wt)], axis=1)
    real, imaginary, _ = np.linalg.lstsq(basis, late.q[:, 0], rcond=None)[0]
    return 1.0 / complex(real, imaginary)


@entry("eq-10.47", "its impedance")
def eq_10_47() -> Shown:
    """Numbers of equation 10.46. Linearised by taut.analysis.tool_impedance."""

    def asked(w: Any) -> Any:
        return D * (1j * w) ** 2 + B * 1j * w + K

    ws, tool = np.geomspace(1.5, 90.0, 5), along_x(VIRTUAL, still(slides()))
    measured, wanted = np.array([swept(w) for w in ws]), asked(ws)
    claims = {0: "dominated by the spring", 4: "dominated by the mass"}
    for way, got in (("linearised", tool.Z(ws)), ("by a sweep of runs", measured)):
        for k in (0, 2, 4):
            size, turn = (abs(got[k]), abs(wanted[k])), (np.angle(got[k]), np.angle(wanted[k]))
            at = f"at {ws[k]:.3g} rad/s, {way}"
            yield row(f"|Z| {at} [N/m]", *size, POLYNOMIAL, rel=0.01, states=claims.get(k, ""))
            yield row(f"phase of Z {at} [rad]", *turn, POLYNOMIAL, rel=0.01)
    for name, k, part in (("|Z| at 1.5 rad/s over k", 0, K), ("|Z| at 90 rad/s over m w^2", 4, D * ws[4] ** 2)):
        yield row(name, abs(measured[k]) / part, abs(wanted[k]) / part, POLYNOMIAL, rel=0.01, states="near 1")


def pushed_panda(law: Law) -> tuple[Any, Iterator[Row]]:
    """(k, 3) displacement of the tool of a Panda that is pushed along y, at 1 kHz, and rows of it."""
    rest = still(panda())
    out = simulated(law, panda(), rest, duration=2.0, environment=Pushed(axis=1, force=8.0))
    moved = out.task.p - rest.p
    times, name = (0.1, 0.3), "tool of a Panda {:g} s after a push of 8 N along y [m]"
    got, wanted = ([moved[round(1000 * t), 1] for t in times], [answer(8.0, t) for t in times])
    return moved, rows(name, times, got, wanted, CLOSED_FORM, rel=0.03)


@entry("eq-10.48", "the behaviour that is asked of an arm")
def eq_10_48() -> Shown:
    """D, B and K of equation 10.46 in all directions, (0.05, 0.5, 10) for rotation; 1 kHz."""
    moved, shown = pushed_panda(VIRTUAL)
    yield from shown
    yield row("where it comes to rest [m]", moved[-1, 1], 8.0 / K, "K^-1 F_ext", rel=5e-3)
    across = np.abs(moved[-1, [0, 2]]).max()
    yield row("what it moves across, in the end [m]", across, 0.0, "10.48: nothing", near=2e-4)


@entry("eq-10.49", "impedance control")
def eq_10_49() -> Shown:
    """With a measured acceleration D V-dot is an algebraic loop.

    A tick old it is stable only for 0 < eig(Lambda^-1 D) < 2, and refused elsewhere. Common practice, as the chapter
    says, leaves the inertia out: the first rows.
    """
    m, X, twist = in_mujoco(Q, V), np.array([0.02, -0.01, 0.03, 0.0, 0.0, 0.0]), [0.1, 0.2, -0.1, 0.0, 0.0, 0.0]
    ref = TaskMotion(pose=Pose(m.p + X[:3], R=m.R), twist=twist)
    law = Impedance(B=(B, ANGULAR[1]), K=(K, ANGULAR[2]), null=None)
    got = total(ticked(law, panda(), Q, V, ref).terms)
    stiffness, damping = (np.repeat(each, 3) for each in ((K, ANGULAR[2]), (B, ANGULAR[1])))
    spring = stiffness * X + damping * (ref.twist - m.J @ V)
    wanted = m.J.T @ (spring - m.Lambda @ m.Jdot_v) + m.h
    yield from compared("torque of the Panda, D left out [N m]", got, wanted, MUJOCO, 1e-6)
    for factor in (0.1, 1.9, 2.1):
        name, source = f"D = {factor:g} of the arm's inertia: accepted [0 or 1]", "|1 - Lambda^-1 D| < 1"
        slip = "slip: D V-dot with the measured V-dot" if factor > 2.0 else ""
        yield row(name, accepted(factor), abs(1.0 - factor) < 1.0, source, states=slip)
    for factor in (1.9, 2.1):
        name = f"error of the acceleration, one tick over the last, D = {factor:g} of M"
        yield row(name, echoed(factor), 1.0 - factor, "1 - M^-1 D", rel=1e-6)


class MeasuredInertia(Law):
    """The inertia term of equation 10.49 alone, with the acceleration measured in the previous tick.

    Law:          tau = (M - D) a, with a differenced velocities
    Closed loop:  a_next = (1 - M^-1 D) a, tick by tick
    """

    ignores_reference = True
    D: taut.Gain = taut.Gain(unit="kg m^2")
    before: taut.Memory = taut.Memory(0.0)  # [rad/s]

    def command(
        self, x: taut.Snapshot, ref: Sample, memory: MemoryView, dt: float  # noqa: ARG002
    ) -> tuple[taut.Torque, dict[str, object]]:  # fmt: skip
        a = (x.v - memory.before) / dt
        return taut.Torque(compensation=x.M @ a, inertia=-(self.D @ a)), {"before": x.v}


def echoed(factor: float) -> float:
    """Ratio of the acceleration to that of the previous tick, with D a multiple of M."""
    arm = link(gravity=False, b=0.0)
    a = np.diff(simulated(MeasuredInertia(D=factor * M), arm, duration=0.02, q0=[0.0], v0=[1e-3]).v[:, 0])
    return float(a[10] / a[9])


def accepted(factor: float) -> bool:
    """The library accepts an apparent inertia that is a multiple of the gantry's, with measured acceleration."""
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
    """D, B and K of equation 10.48; the model's own motion is followed with kp = 2500, kd = 100."""
    inner = TaskComputedTorque(kp=2500.0, kd=100.0, singularity="plain")
    law = Admittance(inner=inner, D=(D, ANGULAR[0]), B=(B, ANGULAR[1]), K=(K, ANGULAR[2]))
    arm, first = panda(), []
    for dt in (1e-3, 1e-6):
        ctrl = taut.compile(law, arm, rate=1.0 / dt, engine="float")
        ctrl.step(arm.home, np.zeros(7), still(arm), F_ext=np.array([0.0, 8.0, 0.0, 0.0, 0.0, 0.0]))
        first.append(float(ctrl.memory["law.twist"][1]) / dt)
    wanted, source = 8.0 / (D + 0.5 * B * 1e-3 + 0.25 * K * 1e-6), "D^-1 F_ext, implicit midpoint rule"
    yield row("acceleration of the model in the first tick, 1 ms [m/s^2]", first[0], wanted, source)
    name, states = "the same in a tick of 1 us [m/s^2]", "D^-1 (F_ext - B V - K X)"
    yield row(name, first[1], 8.0 / D, "D^-1 F_ext", rel=1e-5, states=states)
    moved, shown = pushed_panda(law)
    yield from shown
    yield row("where it comes to rest [m]", moved[-1, 1], 8.0 / K, "K^-1 F_ext", rel=5e-3)


KP, KD = 400.0, 40.0  # [1/s^2], [1/s] of motion control
KFP, KDAMP = 2.0, 50.0  # [1], [N s/m] of force control
PLACE: Final = taut.Coordinates.position()


@entry("sec-10.5", "high and low impedance")
def kinds() -> Shown:
    """Motion control has a high impedance, force control a low one.

    A gantry of 21 kg along x at 10 kHz, by taut.analysis.tool_impedance. Chosen: motion control with kp = 400, kd
    = 40; impedance control with K and B of equation 10.46 and the gantry's own inertia; force control of no force
    with Kfp = 2, Kdamp = 50 N s/m.
    """
    rest, mass = still(slides()), float(snapshot(slides(), slides().home).M[0, 0])
    hertz = (0.5, 5.0)
    s = 2j * math.pi * np.array(hertz)
    motion = TaskComputedTorque(kp=KP, kd=KD, error="coordinates", coordinates=PLACE)
    shown = Impedance(B=(B, 0.5), K=(K, 10.0))
    force, zero = ForceControl(kfp=KFP, kdamp=[KDAMP] * 3 + [1.0] * 3), taut.TaskForce(F_app=np.zeros(6))
    laws: tuple[tuple[str, Law, Sample, Any, str], ...] = (
        ("motion control", motion, rest, mass * (s * s + KD * s + KP), "high impedance"),
        ("impedance control", shown, rest, mass * s * s + B * s + K, ""),
        ("force control", force, zero, (mass * s * s + KDAMP * s) / (1.0 + KFP), "low impedance"),
    )
    for name, law, ref, wanted, claim in laws:
        tool, source = along_x(law, ref), "the law and m x-ddot = F, written out"
        got = map(abs, tool.Z(s.imag))
        yield from rows(
            f"{name}: |Z| at {{:g}} Hz [N/m]", hertz, got, map(abs, wanted), source, rel=3e-3, states=claim
        )
    out = simulated(motion, slides(), rest, rate=FAST, duration=1.0, environment=Pushed())
    moved, name = out.q[-1, 0] - slides().home[0], "motion control: Delta X under a Delta F of 10 N [m]"
    yield row(name, moved, 10.0 / (KP * mass), "Delta F / Z(0)", rel=1e-3, states="Delta X = Y Delta F")


@entry("sec-10.5", "what impedance and admittance control are good at")
def sides() -> Shown:
    """A hand holds the tool: impedance control is stable with low impedances, admittance control with stiff ones.

    A hand of 1 kg, 5 N s/m and 300 N/m on the gantry's tool, 1 kHz, by taut.linearise. Chosen: m = 0.1 kg, b = 2
    N s/m, k = 20 N/m as a low impedance, 20 kg, 200 N s/m, 1e6 N/m as a stiff one; impedance control leaves the
    arm's own inertia.
    """
    hand = Hand(mass=1.0, damping=5.0, stiffness=300.0)
    inner = TaskComputedTorque(kp=2500.0, kd=100.0, error="coordinates", coordinates=PLACE)
    for name, mass, damping, stiffness in (("low", 0.1, 2.0, 20.0), ("stiff", 20.0, 200.0, 1e6)):
        b, k = (damping, 0.5), (stiffness, 10.0)
        for kind, law, good in (
            ("impedance", Impedance(B=b, K=k), "low"),
            ("admittance", Admittance(inner=inner, D=(mass, 0.05), B=b, K=k), "stiff"),
        ):
            loop = looped(law, slides(), still(slides()), duration=0.5, environment=hand, integrator="rk4")
            stable, x = linearise(loop).stable, np.abs(taut.run(loop, q0=[1e-6, 0.0, 0.0], progress=False).q[:, 0])
            what, source = (
                f"{kind} control shows a {name} impedance: stable",
                "whether the oscillation of a run decays",
            )
            states = "good" if name == good else "not as good"
            yield row(f"{what} [0 or 1]", stable, x[-100:].max() < x[:100].max(), source, states=states)


MASS, FRICTION_DAMPING, VIRTUAL_DAMPING = 0.2, 1.0, 0.5  # [kg], [N s/m], [N s/m] of the display, chosen
DISPLAY_RATE: Final = 1000.0  # [Hz]
HELD: Final = "poles of the held mass"


def radius(stiffness: float, rate: float) -> float:
    """Largest modulus of the display's poles."""
    return held_radius(MASS, FRICTION_DAMPING, stiffness, VIRTUAL_DAMPING, rate)


@entry("fig-10.17", "a virtual mass, spring and damper")
def fig_10_17() -> Shown:
    """Chosen: a display of 0.2 kg with 1 N s/m that renders a spring and 0.5 N s/m, with differenced positions.

    More of it is on the page about haptics.
    """
    rates = np.array([250.0, 500.0, 1000.0, 2000.0, 4000.0])
    display = {"mass": MASS, "damping": FRICTION_DAMPING, "B": VIRTUAL_DAMPING}
    walls = [check_virtual_wall(**display, rate=float(rate), velocity="difference") for rate in rates]
    limits, passive = [each.limit for each in walls], [each.passive_limit for each in walls]
    stiffest = [brentq(lambda k, rate=rate: radius(k, rate) - 1.0, 1.0, 1e6) for rate in rates.tolist()]
    yield from rows("stiffest stable spring at {:g} Hz [N/m]", rates, limits, stiffest, f"{HELD}, bisected", rel=1e-5)
    colgate = (FRICTION_DAMPING - VIRTUAL_DAMPING) * 2.0 * rates
    name, source = "stiffest spring that is safe in any hand, 1 kHz [N/m]", "Colgate: (b - |B|) / (T / 2)"
    yield row(name, passive[2], colgate[2], source, rel=1e-3)
    z = taut.load_arm("gantry3").subset(["z"]).with_body("z", mass=MASS)
    slide = z.with_joints(viscous=FRICTION_DAMPING).with_gravity([0.0, 0.0, 0.0])
    law, sensing = PID(kp=1.0, kd=VIRTUAL_DAMPING), taut.Sensing(velocity="difference")
    ctrl = taut.compile(law, slide, rate=DISPLAY_RATE, sensing=sensing)
    for factor, states in ((0.8, ""), (1.2, "oscillatory in stiff virtual environments")):
        stiffness = factor * walls[2].limit
        ctrl.parameters["law.kp"] = stiffness
        out = simulated(ctrl, slide, REST, duration=0.4, q0=[1e-3], friction="arm", integrator="rk4")
        got = float(np.exp(max(two_poles(out.q[100:, 0], 1.0).real)))
        name = f"factor by which an oscillation grows in a tick, K = {factor:g} of the limit"
        yield row(name, got, radius(stiffness, DISPLAY_RATE), HELD, rel=1e-5, states=states)
    title = ("how stiff the environment may be", "K [N/m]", "servo rate [Hz]")
    figure, (left, right) = panels(None, title, width_ratios=[1.0, 1.1])
    _display(left)
    curve(right, rates, limits, "stable alone", 0, marker="o", linestyle="-")
    curve(right, rates, passive, "safe in any hand", 2, marker="o", linestyle="-")
    curve(right, rates, colgate, "2 (b - |B|) / T", linestyle=DASHED)
    right.set_xticks([250.0, 1000.0, 2000.0, 4000.0])
    right.set_ylim(0.0, None)
    legend(right)
    yield figure


def _display(ax: Any) -> None:
    """A mass on a spring and a damper, that a hand pushes."""
    block(ax, 0.05, 1.0, width=0.1, height=1.6, fill="#D9DEE4")
    x = np.linspace(0.1, 2.0, 200)
    zigzag = np.interp((x - 0.4) * 5.0 % 1.0, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
    for xs, ys, width in (
        (x, 1.45 + 0.16 * zigzag * ((x > 0.4) & (x < 1.7)), 1.1), ([0.1, 0.85], [0.6, 0.6], 1.1),
        ([1.3, 0.85, 0.85, 1.3], [0.76, 0.76, 0.44, 0.44], 1.1), ([1.1, 1.1], [0.48, 0.72], 1.6),
        ([1.1, 2.0], [0.6, 0.6], 1.1),
    ):  # fmt: skip
        ax.plot(xs, ys, color=INK, linewidth=width)
    block(ax, 2.5, 1.0, width=1.0, height=1.2, fill="#F4F6F8")
    for at, letter in (((1.05, 1.8), "k"), ((1.05, 0.26), "b"), ((2.5, 1.0), "m")):
        words(ax, at, letter, size=SMALL + 1.0, zorder=3)
    arrow(ax, (3.0, 1.0), (3.68, 1.0), width=1.6)
    words(ax, (3.5, 1.2), "f: the hand")
    arrow(ax, (2.5, 1.85), (3.1, 1.85))
    words(ax, (3.2, 1.85), "x")
    ax.set(xlim=(-0.1, 4.0), ylim=(-0.1, 2.2))


@entry("sec-10.6", "a flexible transmission")
def soft_joint() -> Shown:
    """The free link with a spring and a damper between it and its motor, by taut.linearise.

    Chosen: a gear of 100, a rotor of 1e-4 kg m^2, 2000 N m/rad and 5 N m s/rad between motor and link; no law, no
    friction, no gravity.
    """
    gear, rotor, stiffness, damping = 100.0, 1e-4, 2000.0, 5.0  # ratio, [kg m^2], [N m/rad], [N m s/rad] chosen
    arm, free = link(gravity=False, b=0.0).with_gears(gear, rotor), PID(kp=0.0, kd=0.0)
    drive = Actuation(transmission=Transmission(stiffness=stiffness, damping=damping))
    stiff = linearise(looped(free, arm, REST, rate=FAST), at=[0.0])
    soft = linearise(looped(free, arm, REST, rate=FAST, actuation=drive, substeps=10), at=[0.0])
    mobility = 1.0 / M + 1.0 / (gear**2 * rotor)
    wanted = np.roots([1.0, damping * mobility, stiffness * mobility])[0]
    found = max((mode.s for mode in soft.modes), key=lambda s: s.imag)
    yield row("order of the dynamics, rigid", len(stiff.poles), 2, "M theta-ddot = tau")
    yield row("order of the dynamics, flexible", len(soft.poles), 4, "two masses and a spring", states="increased")
    source = f"{ROOTS} of s^2 + (d s + k)(1 / M + 1 / G^2 I_motor)"
    yield from pole("oscillation of link against motor: {}", found, wanted, source, rel=1e-3)
