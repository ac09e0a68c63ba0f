"""Section 10.5: high and low impedance, what either control is good at, and a haptic display."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from scipy.optimize import brentq

from taut.analysis.stiffness import check_virtual_wall
from taut.arm.load import load_arm
from taut.base.plot_style import DASHED, INK, SMALL, colour, prepared
from taut.book.impedance import FAST, B, K, Pushed, along_x, slides, still
from taut.book.models import held_radius, looped, simulated, two_poles
from taut.book.page import Shown, arrow, box, entry, legend, panels, row, words
from taut.control.law import Law
from taut.control.laws.admittance import Admittance
from taut.control.laws.force import ForceControl
from taut.control.laws.impedance import Impedance
from taut.control.laws.joint import PID
from taut.control.laws.task import TaskComputedTorque
from taut.control.laws.task_error import Coordinates
from taut.control.sensing import Sensing
from taut.control.trajectories.force_reference import TaskForce
from taut.control.trajectories.reference import JointMotion, Sample
from taut.controller import compile
from taut.linear.linearise import linearise
from taut.maths.snapshot import snapshot
from taut.plant.environments.hands import Hand
from taut.runtime.simulate import run

__all__: list[str] = []

HERTZ: Final = 0.5, 5.0
KP, KD = 400.0, 40.0  # [1/s^2], [1/s] of motion control
KFP, KDAMP = 2.0, 50.0  # [1], [N s/m] of force control
PLACE: Final = Coordinates.position()


@entry("sec-10.5", "high and low impedance", part="kinds")
def kinds() -> Shown:
    """Motion control is high impedance, force control low; and what the first does to a disturbance."""
    rest, mass = still(slides()), float(snapshot(slides(), slides().home).M[0, 0])
    s = 2j * math.pi * np.array(HERTZ)
    motion = TaskComputedTorque(kp=KP, kd=KD, error="coordinates", coordinates=PLACE)
    shown = Impedance(B=(B, 0.5), K=(K, 10.0))
    force = ForceControl(kfp=KFP, kdamp=[KDAMP] * 3 + [1.0] * 3)
    laws: dict[str, tuple[Law, Sample, Any, str]] = {
        "motion control": (motion, rest, mass * (s * s + KD * s + KP), "high impedance"),
        "impedance control": (shown, rest, mass * s * s + B * s + K, ""),
        "force control": (
            force, TaskForce(F_app=np.zeros(6)), (mass * s * s + KDAMP * s) / (1.0 + KFP), "low impedance"
        ),
    }  # fmt: skip
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "impedance of three kinds of control", "|F / X| [N/m]", "frequency [Hz]")
    every = np.geomspace(0.2, 20.0, 100)
    for k, (name, (law, ref, wanted, claim)) in enumerate(laws.items()):
        tool = along_x(law, ref)
        for f, got, want in zip(HERTZ, tool.Z(s.imag), wanted, strict=True):
            source = "the law and m x-ddot = F, written out"
            yield row(f"{name}: |Z| at {f:g} Hz", "N/m", abs(got), abs(want), source, rel=3e-3, states=claim)
        ax.loglog(every, np.abs(tool.Z(2.0 * math.pi * every)), color=colour(k), linewidth=1.4, label=name)
    legend(ax)
    out = simulated(motion, slides(), rest, rate=FAST, duration=1.0, environment=Pushed())
    moved = out.q[-1, 0] - slides().home[0]
    name, claim = "motion control: Delta X under a Delta F of 10 N", "Delta X = Y Delta F"
    yield row(name, "m", moved, 10.0 / (KP * mass), "Delta F / Z(0)", rel=1e-3, states=claim)

    yield figure
    yield (
        "A gantry of 21 kg along x at 10 kHz, by taut.analysis.tool_impedance. Chosen: motion control with kp = "
        "400, kd = 40; "
        "impedance control with K and B of equation 10.46 and the gantry's own inertia; force control of no force "
        "with Kfp = 2, Kdamp = 50 N s/m."
    )


@entry("sec-10.5", "what impedance and admittance control are good at", part="sides")
def sides() -> Shown:
    """A hand holds the tool by a handle: which of the two laws stands a low impedance, and which a stiff one."""
    hand = Hand(mass=1.0, damping=5.0, stiffness=300.0)
    inner = TaskComputedTorque(kp=2500.0, kd=100.0, error="coordinates", coordinates=PLACE)
    for name, D, damping, stiffness in (("low", 0.1, 2.0, 20.0), ("stiff", 20.0, 200.0, 1e6)):
        b, k = (damping, 0.5), (stiffness, 10.0)
        for kind, law, good in (
            ("impedance", Impedance(B=b, K=k), "low"),
            ("admittance", Admittance(inner=inner, D=(D, 0.05), B=b, K=k), "stiff"),
        ):
            loop = looped(law, slides(), still(slides()), duration=0.5, environment=hand, integrator="rk4")
            lin = linearise(loop)
            x = np.abs(run(loop, q0=[1e-6, 0.0, 0.0], progress=False).q[:, 0])
            yield row(
                f"{kind} control shows a {name} impedance: stable",
                "0 or 1",
                lin.stable,
                x[-100:].max() < x[:100].max(),
                "whether the oscillation of a run decays",
                states="good" if name == good else "not as good",
            )

    yield (
        "A hand of 1 kg, 5 N s/m and 300 N/m on the gantry's tool, 1 kHz, by taut.linearise. Chosen: m = 0.1 kg, b = "
        "2 N s/m, k = 20 N/m as a low impedance, 20 kg, 200 N s/m, 1e6 N/m as a stiff one; impedance control leaves "
        "the arm's own inertia."
    )


MASS, FRICTION_DAMPING, VIRTUAL, RATE = 0.2, 1.0, 0.5, 1000.0  # [kg], [N s/m], [N s/m], [Hz] of the display, chosen
POLES: Final = "poles of the held mass"


def radius(stiffness: float, rate: float) -> float:
    """Largest modulus of the display's poles."""
    return held_radius(MASS, FRICTION_DAMPING, stiffness, VIRTUAL, rate)


def stiffest(rate: float) -> float:
    """Up to which it is stable, by bisection on those poles [N/m]."""
    return float(brentq(lambda k: radius(k, rate) - 1.0, 1.0, 1e6))


@entry("fig-10.17", "a virtual mass, spring and damper")
def fig_10_17() -> Shown:
    rates = np.array([250.0, 500.0, 1000.0, 2000.0, 4000.0])
    walls = [
        check_virtual_wall(mass=MASS, damping=FRICTION_DAMPING, B=VIRTUAL, rate=float(rate), velocity="difference")
        for rate in rates
    ]
    for wall, rate in zip(walls, rates.tolist(), strict=True):
        name = f"stiffest stable spring at {rate:g} Hz"
        yield row(name, "N/m", wall.limit, stiffest(rate), f"{POLES}, bisected", rel=1e-5)
    passive = (FRICTION_DAMPING - VIRTUAL) * 2.0 * RATE
    name = "stiffest spring that is safe in any hand, 1 kHz"
    yield row(name, "N/m", walls[2].passive_limit, passive, "Colgate: (b - |B|) / (T / 2)", rel=1e-3)
    z = load_arm("gantry3").subset(["z"]).with_body("z", mass=MASS)
    slide = z.with_joints(viscous=FRICTION_DAMPING).with_gravity([0.0, 0.0, 0.0])
    ctrl = compile(PID(kp=1.0, kd=VIRTUAL), slide, rate=RATE, sensing=Sensing(velocity="difference"))
    for factor in (0.8, 1.2):
        K = factor * walls[2].limit
        ctrl.parameters["law.kp"] = K
        rest = JointMotion(q=[0.0])
        out = simulated(ctrl, slide, rest, duration=0.4, q0=[1e-3], friction="arm", integrator="rk4")
        got = float(np.exp(max(two_poles(out.q[100:, 0], 1.0).real)))
        states = "oscillatory in stiff virtual environments" if factor > 1.0 else ""
        name = f"growth of an oscillation in a tick, K = {factor:g} of the limit"
        yield row(name, "", got, radius(K, RATE), POLES, rel=1e-5, states=states)
    figure, (left, right) = panels(2, 2.5, width_ratios=[1.0, 1.1])
    _display(left)
    prepared(right, "how stiff the environment may be", "K [N/m]", "servo rate [Hz]")
    for k, name, values in (
        (0, "stable alone", [each.limit for each in walls]),
        (2, "safe in any hand", [each.passive_limit for each in walls]),
    ):
        right.plot(rates, values, "o-", color=colour(k), markersize=4.0, linewidth=1.3, label=name)
    right.plot(
        rates,
        2.0 * (FRICTION_DAMPING - VIRTUAL) * rates,
        color=INK,
        linestyle=DASHED,
        linewidth=0.9,
        label="2 (b - |B|) / T",
    )
    right.set_xticks([250.0, 1000.0, 2000.0, 4000.0])
    right.set_ylim(0.0, None)
    legend(right)

    yield figure
    yield (
        "Chosen: a display of 0.2 kg with 1 N s/m that shows a spring and 0.5 N s/m, with differenced positions. "
        "More of it is on the page about haptics."
    )


def _display(ax: Any) -> None:
    """A mass on a spring and a damper, that a hand pushes."""
    ax.axis("off")
    ax.set_aspect("equal")
    box(ax, 0.05, 1.0, 0.1, 1.6, fill="#D9DEE4")
    x = np.linspace(0.1, 2.0, 200)
    zigzag = 1.45 + 0.16 * np.interp((x - 0.4) * 5.0 % 1.0, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0]) * (
        (x > 0.4) & (x < 1.7)
    )
    ax.plot(x, zigzag, color=INK, linewidth=1.1)
    words(ax, 1.05, 1.8, "k", size=SMALL + 1.0)
    ax.plot([0.1, 0.85], [0.6, 0.6], color=INK, linewidth=1.1)
    ax.plot([1.3, 0.85, 0.85, 1.3], [0.76, 0.76, 0.44, 0.44], color=INK, linewidth=1.1)
    ax.plot([1.1, 1.1], [0.48, 0.72], color=INK, linewidth=1.6)
    ax.plot([1.1, 2.0], [0.6, 0.6], color=INK, linewidth=1.1)
    words(ax, 1.05, 0.26, "b", size=SMALL + 1.0)
    box(ax, 2.5, 1.0, 1.0, 1.2)
    words(ax, 2.5, 1.0, "m", size=SMALL + 1.0, zorder=3)
    arrow(ax, (3.0, 1.0), (3.68, 1.0), width=1.6)
    words(ax, 3.5, 1.2, "f: the hand", ha="center")
    arrow(ax, (2.5, 1.85), (3.1, 1.85))
    words(ax, 3.2, 1.85, "x")
    ax.set_xlim(-0.1, 4.0)
    ax.set_ylim(-0.1, 2.2)
