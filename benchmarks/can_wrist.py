"""Draw docs/images/can_wrist.png and print the table of docs/can_motors.md: damping of a wrist, by host and by motor.

Run it in this folder: `python can_wrist.py [FOLDER]`.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

import taut
from taut.arm.builtin import one_joint
from taut.base.plot_style import COLOURS, DASHED, SMALL, WIDTH, prepared

IMAGES = Path(__file__).parent.parent / "docs" / "images"
ROTOR = 1.8e-5 * 10.0**2  # [kg m^2] of a DM4310 at its output, as published
HAND = 2.4e-3  # [kg m^2] about the last axis
INNER = 4000.0  # [Hz] of the loop in the motor
RATES = (50.0, 100.0, 200.0, 400.0, 500.0, 1000.0, 2000.0)
WRIST = one_joint(M=ROTOR + HAND, m=0.05, r=0.03, b=0.0).with_gravity([0.0, 0.0, 0.0])
START = 0.02  # [rad]


def loop(rate: float, kp: float, kd: float, *, in_motor: bool, delay: int) -> taut.Loop:
    """A PD of the wrist over a bus: as torques of the host, or with its gains in the motor."""
    law = taut.laws.PID(kp=kp, kd=kd)
    mit = taut.laws.ViaMit(law=law) if in_motor else taut.laws.ViaMit(law=law, kp_motor=0.0, kd_motor=0.0)
    drives = taut.drives.Actuation(delay=delay / rate, inner_rate=INNER)
    plant = taut.RigidPlant(WRIST, takes="mit", substeps=round(INNER / rate), actuation=drives)
    return taut.Loop(taut.compile(mit, WRIST, rate=rate), plant, duration=0.4)


def limit(rate: float, kp: float, *, in_motor: bool = False, delay: int = 1) -> float:
    """The largest stable kd [N m s/rad]; 0 where none is."""
    scale = WRIST_INERTIA * (INNER if in_motor else rate)
    for start in scale * np.array([0.1, 0.2, 0.4, 0.6, 0.8]):
        verdict = taut.analysis.judge(loop(rate, kp, float(start), in_motor=in_motor, delay=delay), gains=["law.kd"])
        if verdict.stable:
            return float(start * verdict.largest["law.kd"])
    return 0.0


WRIST_INERTIA = float(np.asarray(taut.snapshot(WRIST, WRIST.home).M)[0, 0])


def main() -> None:
    """Draw, and print."""
    mpl.use("Agg")
    warnings.simplefilter("ignore", taut.errors.StabilityWarning)  # on purpose
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    kinds = {
        "torque of the host, state a period old": {"in_motor": False, "delay": 1},
        "torque of the host, no delay": {"in_motor": False, "delay": 0},
        f"kp and kd in the motor, {INNER / 1e3:g} kHz": {"in_motor": True, "delay": 1},
    }
    table = Table("rate [Hz]", *kinds, title="largest stable kd [N m s/rad], kp = 10 N m/rad")
    found = {name: [limit(rate, 10.0, **kind) for rate in RATES] for name, kind in kinds.items()}
    for i, rate in enumerate(RATES):
        table.add_row(f"{rate:g}", *(f"{values[i]:.3g}" for values in found.values()))
    Console().print(table)

    figure = Figure(figsize=(WIDTH, 2.9), layout="constrained", facecolor="white")
    left, right = figure.subplots(1, 2)
    prepared(left, "largest stable kd of a wrist [N m s/rad]", "", "rate of commands [Hz]")
    for colour, (name, values) in zip(COLOURS, found.items(), strict=False):
        shown = np.where(np.array(values) > 0.0, values, np.nan)
        left.loglog(RATES, shown, color=colour, label=name, ls=DASHED if "no delay" in name else "-", marker=".")
    for kd, name in ((0.5, "OpenArm"), (3.5, "Axol, first"), (2.25, "Axol, later")):
        left.axhline(kd, color="0.75", lw=0.6)
        left.annotate(name, (RATES[0], kd), fontsize=SMALL, color="0.4", va="bottom")
    left.set_ylim(0.1, 60.0)
    left.legend(fontsize=SMALL, frameon=False)
    prepared(right, "the wrist, from 20 mrad [mrad], kd = 2.25, kp = 10", "", "t [s]")
    for colour, in_motor, name in (
        (COLOURS[0], False, "torque of the host at 500 Hz"),
        (COLOURS[2], True, "in the motor"),
    ):
        one = loop(500.0, 10.0, 2.25, in_motor=in_motor, delay=1)
        limits = taut.Limits(tau=7.0)
        ctrl = taut.compile(one.side.law, WRIST, rate=500.0, limits=limits)
        run = taut.run(ctrl, one.plant, taut.JointMotion(q=[0.0]), duration=0.4, q0=[START])
        right.plot(run.t, 1e3 * run.q[:, 0], color=colour, label=name)
    right.legend(fontsize=SMALL, frameon=False)
    figure.savefig(folder / "can_wrist.png", dpi=150)


if __name__ == "__main__":
    main()
