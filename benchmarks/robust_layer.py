"""Draw the picture of docs/robust.md, accuracy against chatter over the boundary layer, and print its table.

Run it in this folder: `python robust_layer.py [FOLDER]`.
"""

from __future__ import annotations

import dataclasses
import sys
import warnings
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

import taut
from taut.base.plot_style import COLOURS, DASHED, INK, SMALL, WIDTH, prepared

IMAGES = Path(__file__).parent.parent / "docs" / "images"
FACTORS = (3.0, 2.0, 1.0, 0.6, 0.3, 0.2, 0.15, 0.1, 0.05, 0.03)  # of the layer by taut.analysis.boundary_layer
SET = taut.laws.Uncertainty(links=0.1, payload=(0.0, 2.0), viscous=(0.1, 0.5), coulomb=(0.1, 0.5))
NOISE = taut.sensors.Sensors(velocity=taut.sensors.Tachometer(noise=1e-3))
AMPLITUDE = np.array([0.5, 0.4, -0.5, 0.6, 0.5, -0.6, 0.8])


def main() -> None:
    """Draw, and print."""
    mpl.use("Agg")
    warnings.simplefilter("ignore", taut.errors.StabilityWarning)  # of layers that are too thin, on purpose
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    arm = taut.load_arm("panda")
    ref = taut.trajectories.Sine(
        center=arm.home + AMPLITUDE / 2,
        amplitude=-AMPLITUDE / 2,
        frequency=[0.5, 0.4, 0.6, 0.5, 0.7, 0.6, 0.5],
        phase=np.pi / 2,
    )
    phi = taut.analysis.boundary_layer(arm, ref, SET, lam=10.0, k=10.0, duration=4.0)
    ctrl = taut.compile(taut.laws.Robust(lam=10.0, k=10.0, phi=phi, uncertainty=SET), arm)
    plants = {
        "lightest arm": taut.RigidPlant(true_arm(arm, 0.9, 0.0, 0.1), substeps=4),
        "heaviest arm": taut.RigidPlant(true_arm(arm, 1.1, 2.0, 0.5), substeps=4),
        "lightest, noise of 1 mrad/s": taut.RigidPlant(true_arm(arm, 0.9, 0.0, 0.1), substeps=4, sensors=NOISE),
    }
    figure = Figure(figsize=(WIDTH, 2.8), layout="constrained", facecolor="white")
    error_axes, chatter_axes = figure.subplots(1, 2)
    prepared(error_axes, "largest error of a joint [rad]", "", "layer / layer of the rate")
    prepared(chatter_axes, "total variation of the torques [N m/s]", "", "layer / layer of the rate")
    table = Table("plant", "figure", *(f"{factor:g}" for factor in FACTORS), title="layer / layer of the rate")
    for colour, (name, plant) in zip(COLOURS, plants.items(), strict=False):
        errors, chatter = [], []
        for factor in FACTORS:
            ctrl.parameters["law.phi"] = factor * phi
            run = taut.run(ctrl, plant, ref, duration=4.0)
            errors.append(float(np.abs(run.error).max()))
            chatter.append(float(np.abs(np.diff(run.command, axis=0)).sum()) / 4.0)
        for ax, values, label in ((error_axes, errors, "error [rad]"), (chatter_axes, chatter, "chatter [N m/s]")):
            ax.loglog(FACTORS, values, "o-", color=colour, markersize=3.0, linewidth=1.2, label=name)
            ax.axvline(1.0, color=INK, linestyle=DASHED, linewidth=0.9)
            table.add_row(name, label, *(f"{value:.3g}" for value in values))
    error_axes.legend(loc="upper left", fontsize=SMALL, frameon=False, labelcolor=INK)
    figure.savefig(folder / "robust_layer.png", dpi=150)
    Console(width=150).print(table)


def true_arm(arm: taut.Arm, factor: float, payload: float, coulomb: float) -> taut.Arm:
    """A corner of the set."""
    bodies = (dataclasses.replace(x, mass=factor * x.mass, inertia=factor * x.inertia) for x in arm.bodies)
    made = dataclasses.replace(arm, bodies=tuple(bodies)).with_payload(payload)
    return made.with_friction(taut.Friction(viscous=0.1, coulomb=coulomb))


if __name__ == "__main__":
    main()
