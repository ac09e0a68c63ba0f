"""Runs of arms that nothing drives, with something at their tools."""

from __future__ import annotations

from typing import Any

import numpy as np

import taut
from taut.base.types import Float64Array

GANTRY = taut.load_arm("gantry3").with_joints(viscous=0.0)
MASSES = np.array([21.0, 9.0, 3.0])  # what each slide moves [kg]


class Nothing(taut.Law):
    """No torque at all."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(nothing=0.0 * ref.q)


def free(
    plant: Any,
    *,
    duration: float = 1.0,
    rate: float = 1000.0,
    q0: Any = None,
    v0: Any = None,
    events: list[taut.Event] | None = None,
) -> taut.Run:
    """A run without any command."""
    ctrl = taut.compile(Nothing(), plant.arm, rate=rate, adds=plant.adds)
    out = taut.run(ctrl, plant, duration=duration, q0=q0, v0=v0, events=events)
    assert out.outcome.ok, out.outcome
    return out


def rigid(environment: Any, arm: taut.Arm = GANTRY, **options: Any) -> taut.RigidPlant:
    """An arm without friction and weight, with an environment."""
    return taut.RigidPlant(arm, environment=environment, adds=("gravity",), **options)


def work(run: taut.Run) -> Float64Array:
    """What the environment did until each tick [J]."""
    return run.extra["work.environment"]


def at(
    environment: Any, p: Any, v: Any = (0.0, 0.0, 0.0), omega: Any = (0.0, 0.0, 0.0), R: Any = None
) -> Float64Array:
    """(6,) wrench of an environment at a pose and twist, on plain numbers, in its first step of 1 ms."""
    T = taut.Pose(p, R=R)
    memory = environment.start(taut.Pose())
    out, _ = environment.wrench(T, np.array([*v, *omega]), 0.0, memory, environment.parameters(), 1e-3)
    return np.asarray(out)
