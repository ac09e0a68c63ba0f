"""Draw docs/images/observer.png, and print the figures of docs/observer.md.

Run it with `python benchmarks/observer.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import taut
from taut.base.plot_style import DASHED, INK, SMALL, WIDTH, colour, prepared
from taut.sensors import MomentumObserver

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "control"))
from test_observer import CT, TABLE, OnElbow, along_R, frictionless, heavier, observed, reactions, tau_ext, wall

THRESHOLD = {"planar2": np.array([2.0, 1.0]), "panda": np.array([4.35] * 4 + [0.6] * 3)}  # [N m]


def force(run: taut.Run) -> np.ndarray:
    return np.linalg.norm(run.extra["F_ext"][:, :3], axis=1)


def collided(name: str, bandwidth: float) -> dict[str, taut.Run]:
    """Runs against the wall, by reaction."""
    arm = frictionless(name)
    plant = taut.RigidPlant(arm, integrator="rk4", environment=wall(arm, name))
    sensing = taut.Sensing(observer=MomentumObserver(bandwidth=bandwidth))
    runs = {"no reaction": taut.run(taut.compile(CT, arm, sensing=sensing), plant, along_R(arm, name), duration=1.0)}
    for reaction, task in reactions(arm, name, THRESHOLD[name]).items():
        runs[reaction] = taut.run(taut.compile(task, arm, sensing=sensing), plant, duration=1.0)
    return runs


def print_reactions() -> None:
    for name in TABLE:
        for bandwidth in (50.0, 200.0):
            runs = collided(name, bandwidth)
            over = (np.abs(tau_ext(runs["stop"])) > THRESHOLD[name]).any(axis=1)
            peaks = ", ".join(f"{reaction} {force(run).max():.1f} N" for reaction, run in runs.items())
            print(f"{name}, K_O = {bandwidth:g}: detected after {np.argmax(over) - 350} ms; {peaks}")


def print_errors_without_contact() -> None:
    for name in TABLE:
        arm = frictionless(name)
        plants = {
            "exact model, rk4": taut.RigidPlant(arm, integrator="rk4"),
            "exact model, semi-implicit Euler": taut.RigidPlant(arm),
            "masses 5 % more": taut.RigidPlant(heavier(arm, 1.05)),
            "friction 0.3 v + 0.3": taut.RigidPlant(arm.with_friction(taut.Friction(viscous=0.3, coulomb=0.3))),
            "0.5 kg at the tool": taut.RigidPlant(arm.with_payload(0.5, com=[0.0, 0.0, 0.0])),
        }
        ctrl = taut.compile(CT, arm, sensing=observed(50.0))
        for what, plant in plants.items():
            run = taut.run(ctrl, plant, along_R(arm, name), duration=4.0)
            print(f"{name}, {what}: {np.abs(tau_ext(run)).max():.3g} N m")


def draw_step(axes: Axes) -> None:
    arm = frictionless("planar2")
    push = OnElbow(torque=2.0, since=1.0 - 1e-9)
    plant = taut.RigidPlant(arm, integrator="rk4", substeps=4, environment=push)
    for i, bandwidth in enumerate((20.0, 50.0, 200.0)):
        ctrl = taut.compile(CT, arm, sensing=observed(bandwidth))
        run = taut.run(ctrl, plant, along_R(arm, "planar2"), duration=1.1)
        label = f"$K_O$ = {bandwidth:g} 1/s"
        axes.plot(1e3 * (run.t - 1.0), tau_ext(run)[:, 1], color=colour(i), lw=1.4, label=label)
    axes.plot([-20, 0, 0, 100], [0, 0, 2, 2], color=INK, lw=0.9, ls=DASHED, label="exact")
    axes.set_xlim(-20, 100)
    axes.set_xlabel("t [ms] after the step", fontsize=SMALL, color=INK)
    axes.legend(fontsize=SMALL, frameon=False, loc="lower right")


def draw_collision(axes: Axes) -> None:
    for i, (reaction, run) in enumerate(collided("panda", 200.0).items()):
        axes.plot(1e3 * (run.t - 0.35), force(run), color=colour(i), lw=1.4, label=reaction)
    axes.axvline(7, color=INK, lw=0.9, ls=DASHED)
    axes.text(8, 1, "detected", fontsize=SMALL, color=INK)
    axes.set_xlim(-10, 150)
    axes.set_xlabel("t [ms] after the wall is reached", fontsize=SMALL, color=INK)
    axes.legend(fontsize=SMALL, frameon=False)


def main() -> None:
    print_errors_without_contact()
    print_reactions()
    figure = Figure(figsize=(WIDTH, 3.0), dpi=150, layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_step(prepared(left, "estimate of 2 N m on the second joint, planar2 [N m]"))
    draw_collision(prepared(right, "force of the wall, Panda, $K_O$ = 200 1/s [N]"))
    figure.savefig(Path(__file__).parents[1] / "docs" / "images" / "observer.png")


if __name__ == "__main__":
    main()
