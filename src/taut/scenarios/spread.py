"""Runs that differ by chance: [spread], which puts the scene elsewhere in each of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.maths.spatial import rotation_exp
from taut.scenarios.read_pose import pose_table
from taut.scenarios.toml import Section
from taut.trace.pose import Pose

__all__ = ["Spread", "read_spread"]

RUNS: Final = (2, 1000)
UNITS: Final = {"shift": "m", "tilt": "rad"}
TILTS: Final = 0.5 * np.pi  # [rad]


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Where the scene stands, as chance has it.

    Shift and tilt are each spread evenly over a disc across the world's z axis: the shift along a vector in it, the
    tilt about one, at the origin of the scene. The place of a run depends on the seed and its number alone.
    """

    runs: int
    seed: int
    shift: float  # [m] the largest
    tilt: float  # [rad] the largest
    at: Pose  # where the scene stands in the file
    plant: Mapping[str, Any]  # [plant] in the file
    source: str  # what messages call the file

    def place(self, run: int) -> Pose:
        """Where the scene stands in a run."""
        rng = np.random.default_rng([self.seed, run])
        shift, tilt = self.shift * _on_disc(rng), self.tilt * _on_disc(rng)
        return Pose(self.at.p + shift, R=np.asarray(rotation_exp(tilt)) @ self.at.R)

    def plants(self) -> Iterator[tuple[str, Section]]:
        """Each run's name, and its section [plant]."""
        for run in range(1, self.runs + 1):
            place, name = self.place(run), f"run {run}"
            here = {"p": place.p.tolist(), "R": place.R.tolist()}
            yield name, Section(f"{self.source}: {name}", "plant", {**self.plant, "scene_at": here})


def _on_disc(rng: np.random.Generator) -> Float64Array:
    """(3,) a point of the unit disc across z, each as likely as any other."""
    radius, angle = np.sqrt(rng.random()), 2.0 * np.pi * rng.random()
    return np.array([radius * np.cos(angle), radius * np.sin(angle), 0.0])


def read_spread(root: Section) -> Spread | None:
    """The spread of a scenario; None if it has none. `root` loses its key 'spread' and keeps everything else.

    Raises:
        ScenarioError: No numbers for it, no scene that could be elsewhere, cases too.
    """
    if "spread" not in root:
        return None
    section = root.section("spread")
    if "cases" in root:
        raise section.error("does not go with [cases]; put them in scenarios of their own")
    runs, seed = section.whole("runs"), section.whole("seed", 0)
    sizes = {key: section.number(key, 0.0) for key in UNITS}
    section.done()
    if not RUNS[0] <= runs <= RUNS[1]:
        raise section.error(f"runs must be from {RUNS[0]} to {RUNS[1]}; got {runs}")
    if seed < 0:
        raise section.error(f"seed must be a whole number >= 0; got {seed}")
    for key, unit in UNITS.items():
        if sizes[key] < 0.0:
            raise section.error(f"{key} must be >= 0 [{unit}]; got {sizes[key]:g}")
    if sizes["tilt"] > TILTS:
        raise section.error(f"tilt must be <= pi/2 [rad]; got {sizes['tilt']:g}")
    if not any(sizes.values()):
        raise section.error("needs shift [m], tilt [rad] or both above zero")
    plant = root.peek("plant")
    if not isinstance(plant, dict) or plant.get("kind") != "mujoco" or "scene" not in plant:
        raise section.error('moves the scene; give [plant] kind = "mujoco" and scene')
    at = pose_table(Section(root.where, "plant", plant).section("scene_at"))
    return Spread(runs=runs, seed=seed, at=at, plant=plant, source=root.where, **sizes)
