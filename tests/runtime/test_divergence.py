"""A simulation that diverges ends with an outcome, on every arm and in both plants; it never starts again in silence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import taut
from taut.arm.catalogue import CATALOGUE

NAMES = ("one_joint", "planar2", "planar3", "gantry3", *(name for name in CATALOGUE if name != "baxter"))


def diverged(arm: taut.Arm, plant: taut.RigidPlant | taut.MujocoPlant) -> taut.Run:
    """Damping far beyond what a millisecond can take turns every velocity round and makes it larger."""
    law = taut.laws.ComputedTorque(kp=0.0, kd=1e5)
    return taut.run(taut.compile(law, arm), plant, taut.JointMotion(q=arm.home), duration=0.2, v0=np.full(arm.n, 0.1))


def is_told(out: taut.Run, arm: taut.Arm) -> bool:
    """The outcome names joint and tick, and the record holds what came before and nothing else."""
    outcome = out.outcome
    whole = all(np.isfinite(column).all() and len(column) == len(out) for column in out.arrays().values())
    return (
        outcome.kind == "diverged"
        and outcome.joint in arm.joint_names
        and outcome.tick == len(out) - 1 > 0
        and whole
        and bool((np.diff(out.t) > 0.0).all())
    )


@pytest.mark.long
@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_on_every_arm_in_both_plants(
    share: Callable[[int], int], bar: Callable[[str, object], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arms = [taut.load_arm(name) for name in NAMES[:: 3 // share(3)]]
    plants = [plant for arm in arms for plant in (taut.RigidPlant(arm), taut.MujocoPlant(arm))]
    failed = [(plant.arm.name, plant.name) for plant in plants if not is_told(diverged(plant.arm, plant), plant.arm)]
    bar("row 24: divergence told with joint and tick", f"{len(plants) - len(failed)} of {len(plants)}")
    assert not failed
    assert not list(tmp_path.iterdir())
