"""Section 10.5: high and low impedance, and what impedance and admittance control are good at."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from taut.base.plot_style import colour, prepared
from taut.book.drawing import legend, panels
from taut.book.impedance import FAST, B, K, Pushed, along_x, slides, still
from taut.book.page import Entry, Page, Row, row
from taut.book.simulation import looped, simulated
from taut.control.law import Law
from taut.control.laws.admittance import Admittance
from taut.control.laws.force import ForceControl
from taut.control.laws.impedance import Impedance
from taut.control.laws.task import TaskComputedTorque
from taut.control.laws.task_error import Coordinates
from taut.control.trajectories.force_reference import TaskForce
from taut.control.trajectories.reference import Sample
from taut.linear.linearise import linearise
from taut.maths.snapshot import snapshot
from taut.plant.environments.hands import Hand
from taut.runtime.simulate import run

__all__ = ["ENTRIES"]

HERTZ: Final = 0.5, 5.0
KP, KD = 400.0, 40.0  # [1/s^2], [1/s] of motion control
KFP, KDAMP = 2.0, 50.0  # [1], [N s/m] of force control
PLACE: Final = Coordinates.position()


def kinds() -> Page:
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
    rows: list[Row] = []
    figure, (ax,) = panels(1, 2.5)
    prepared(ax, "impedance of three kinds of control", "|F / X| [N/m]", "frequency [Hz]")
    every = np.geomspace(0.2, 20.0, 100)
    for k, (name, (law, ref, wanted, claim)) in enumerate(laws.items()):
        tool = along_x(law, ref)
        for f, got, want in zip(HERTZ, tool.Z(s.imag), wanted, strict=True):
            source = "the law and m x-ddot = F, written out"
            rows.append(row(f"{name}: |Z| at {f:g} Hz", "N/m", abs(got), abs(want), source, rel=3e-3, states=claim))
        ax.loglog(every, np.abs(tool.Z(2.0 * math.pi * every)), color=colour(k), linewidth=1.4, label=name)
    legend(ax)
    out = simulated(motion, slides(), rest, rate=FAST, duration=1.0, environment=Pushed())
    moved = out.q[-1, 0] - slides().home[0]
    name, claim = "motion control: Delta X under a Delta F of 10 N", "Delta X = Y Delta F"
    rows.append(row(name, "m", moved, 10.0 / (KP * mass), "Delta F / Z(0)", rel=1e-3, states=claim))
    note = (
        "A gantry of 21 kg along x at 10 kHz, by taut.analysis.tool_impedance. Chosen: motion control with kp = "
        "400, kd = 40; "
        "impedance control with K and B of equation 10.46 and the gantry's own inertia; force control of no force "
        "with Kfp = 2, Kdamp = 50 N s/m."
    )
    return Page(rows=tuple(rows), figure=figure, note=note)


def sides() -> Page:
    """A hand holds the tool by a handle: which of the two laws stands a low impedance, and which a stiff one."""
    hand = Hand(mass=1.0, damping=5.0, stiffness=300.0)
    inner = TaskComputedTorque(kp=2500.0, kd=100.0, error="coordinates", coordinates=PLACE)
    rows = []
    for name, D, damping, stiffness in (("low", 0.1, 2.0, 20.0), ("stiff", 20.0, 200.0, 1e6)):
        b, k = (damping, 0.5), (stiffness, 10.0)
        for kind, law, good in (
            ("impedance", Impedance(B=b, K=k), "low"),
            ("admittance", Admittance(inner=inner, D=(D, 0.05), B=b, K=k), "stiff"),
        ):
            loop = looped(law, slides(), still(slides()), duration=0.5, environment=hand, integrator="rk4")
            lin = linearise(loop)
            x = np.abs(run(loop, q0=[1e-6, 0.0, 0.0], progress=False).q[:, 0])
            rows.append(
                row(
                    f"{kind} control shows a {name} impedance: stable", "0 or 1",
                    lin.stable, x[-100:].max() < x[:100].max(), "whether the oscillation of a run decays",
                    states="good" if name == good else "not as good",
                )
            )  # fmt: skip
    note = (
        "A hand of 1 kg, 5 N s/m and 300 N/m on the gantry's tool, 1 kHz, by taut.linearise. Chosen: m = 0.1 kg, b = "
        "2 N s/m, k = 20 N/m as a low impedance, 20 kg, 200 N s/m, 1e6 N/m as a stiff one; impedance control leaves "
        "the arm's own inertia."
    )
    return Page(rows=tuple(rows), note=note)


ENTRIES: Final = (
    Entry(id="sec-10.5", title="high and low impedance", make=kinds, part="kinds"),
    Entry(id="sec-10.5", title="what impedance and admittance control are good at", make=sides, part="sides"),
)
