"""The plant of a scenario: [plant], what is true, and [spread], which puts its scene elsewhere in each run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import quoted_list
from taut.base.fields import Declared, Field
from taut.base.types import Float64Array
from taut.maths.adds import Adds
from taut.maths.spatial import rotation_exp
from taut.plant.drives.motor import ElectricMotor, Motor, MotorModel
from taut.plant.environments.environment import Environment, Environments
from taut.plant.environments.hands import BandNoise, Hand, Oscillation, PrescribedMotion, Push
from taut.plant.environments.springs import Damper, Spring, StiffWall
from taut.plant.rigid import RigidPlant
from taut.plant.sensors.kinds import Accelerometer, Encoder, Tachometer, TorqueSensor, WrenchSensor
from taut.plant.sensors.sensors import Sensors
from taut.runtime.host import HostPlant
from taut.scenarios.arms import OF_TRUE_ARM, friction_word, pose_of, read_true_arm
from taut.scenarios.reading import arguments, of_keys, of_kind, read, reads
from taut.scenarios.sections import Whole
from taut.scenarios.toml import Table, file_beside
from taut.trace.pose import Pose

__all__ = ["Plant", "Spread", "read_plant", "read_spread"]

Plant: TypeAlias = RigidPlant | HostPlant

MAX_STEPS: Final = 1000  # of MuJoCo in a control period, as of the other plant
ENVIRONMENTS: Final[Mapping[str, Callable[..., Any]]] = {
    "spring": Spring,
    "damper": Damper,
    "wall": StiffWall,
    "hand": Hand,
    "push": Push,
}
MOTIONS: Final[Mapping[str, Callable[..., Any]]] = {"oscillation": Oscillation, "noise": BandNoise}
COMMON: Final = ("takes", "actuation", "environment")
OPTIONS: Final = {
    "rigid": ("integrator", "substeps", "sweeps", "energy"),
    "mujoco": ("timestep", "scene", "scene_at", "tool_radius", "tool_length", "tip"),
}


@reads(Environment)
def _environment(table: Table, key: str) -> Environment:
    """One by its kind; without a kind, a table for each of several that act together."""
    below = table.table(key)
    if "kind" in below:
        return of_kind(ENVIRONMENTS, below)  # type: ignore[no-any-return]
    if not below.values or not all(isinstance(each, dict) for each in below.values.values()):
        raise below.error(
            f"needs kind, one of {quoted_list(ENVIRONMENTS, most=len(ENVIRONMENTS))}, or a table for each of "
            f"several: [{below.below('wall')}]"
        )
    parts = {name: of_kind(ENVIRONMENTS, below.table(name)) for name in below.values}
    for name in parts:
        if not name.isidentifier():
            raise below.error(f"must name its tables by letters, digits and underscores; got '{name}'")
    with below.blamed():
        return Environments(**parts)


@reads(PrescribedMotion)
def _motion(table: Table, key: str) -> Any:
    return of_kind(MOTIONS, table.table(key))


@reads(MotorModel)
def _motor(table: Table, key: str) -> MotorModel:
    """A motor with electrical numbers is an electric motor."""
    return of_keys((Motor, ElectricMotor), table.table(key))  # type: ignore[no-any-return]


@reads(Sensors)
def _sensors(table: Table, key: str) -> Sensors:
    """A table for each sensor, or "none" for one that is not there."""
    below = table.table(key)
    kinds = Encoder, Tachometer, TorqueSensor, WrenchSensor, Accelerometer
    numbers = (name for kind in kinds for name in arguments(kind))
    elsewhere = dict.fromkeys(numbers, f", which a sensor has, as in [{below.below('position')}]")
    return read(Sensors, below, elsewhere=elsewhere)  # type: ignore[no-any-return]


def read_plant(table: Table, believed: Arm, rate: float, folder: Path) -> Plant:
    """A rigid plant or one in MuJoCo.

    Args:
        table: [plant].
        believed: The controllers' arm, from which the true one is made.
        rate: Commands per second [Hz].
        folder: Where a scene and a model lie.
    """
    make: Callable[..., Plant] = RigidPlant
    kind = table.choice("kind", ("rigid", "mujoco"), "rigid")
    if kind == "mujoco":
        from taut.runtime.robots.mujoco.plant import MujocoPlant

        make = MujocoPlant
        _require_slow_steps(table, rate)
    arm = read_true_arm(table, believed, folder)
    if arm.n != believed.n:
        raise table.error(
            f"must have as many joints as that of [arm], the {believed.n} of '{believed.name}'; got the {arm.n} of "
            f"'{arm.name}'",
            "model",
        )
    given: dict[str, Any] = {"friction": None if friction_word(table, "arm", "none") == "none" else "arm"}
    given["sensors"] = _sensors(table, "sensors")
    with table.blamed("adds"):
        given["adds"] = Adds.of(table.texts("adds", example='["gravity"]') or [])
    if kind == "mujoco" and "scene" in table:
        with table.blamed("scene"):
            given["scene"] = file_beside("scene", table.text("scene"), folder)
    other = "rigid" if kind == "mujoco" else "mujoco"
    plant: Plant = read(
        make,
        table,
        others=["kind", *OF_TRUE_ARM, *given],
        skip=arguments(make).keys() - {*COMMON, *OPTIONS[kind]},
        elsewhere=dict.fromkeys(OPTIONS[other], f', which is for kind = "{other}"'),
        blame="scene" if "scene" in given else "",
        arm=arm,
        **given,
    )
    _require_start(plant, table, rate)
    return plant


def _require_slow_steps(table: Table, rate: float) -> None:
    """Steps of MuJoCo that a computer comes to the end of."""
    timestep = table.number("timestep")
    if timestep is not None and 0.0 < timestep * rate * MAX_STEPS < 1.0:
        raise table.error(
            f"must be >= {1.0 / (rate * MAX_STEPS):g} [s], {MAX_STEPS} of which make a control period; got "
            f"{timestep:g}",
            "timestep",
        )


def _require_start(plant: Plant, table: Table, rate: float) -> None:
    """A delay of whole periods, and steps that are short enough for a spring."""
    rest, dt = np.zeros(plant.arm.n), 1.0 / rate
    if not isinstance(plant, RigidPlant):
        with table.blamed("timestep"):
            plant.reset(plant.arm.home, rest, dt, seed=0)
        return
    with table.blamed("actuation"):
        plant.actuation.taps(dt)
    with table.blamed():
        plant.start(plant.arm.home, rest, plant.parameters, dt)


# -------------------------------------------------------------------- spread

MAX_TILT: Final = 0.5 * np.pi  # [rad]


class SpreadSection(Declared):
    """How far chance puts the scene away from where [plant] has it."""

    runs: Whole = Whole(minimum=2, maximum=1000, doc="how many")
    seed: Whole = Whole(minimum=0, default=0)
    shift: Field = Field(0.0, unit="m", minimum=0.0, doc="the largest, in any direction across z")
    tilt: Field = Field(0.0, unit="rad", minimum=0.0, maximum=MAX_TILT, doc="the largest, about any axis across z")

    def check(self) -> None:
        """Something is spread."""
        if not self.shift and not self.tilt:
            self.refuse("", "needs shift [m], tilt [rad] or both above zero")


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Where the scene stands, as chance has it.

    Shift and tilt are each spread evenly over a disc across the world's z axis: the shift along a vector in it, the
    tilt about one, at the origin of the scene. The place of a run depends on the seed and its number alone.
    """

    section: SpreadSection
    at: Pose  # where the scene stands in the file
    plant: Table  # [plant] in the file

    def place(self, run: int) -> Pose:
        """Where the scene stands in a run."""
        rng = np.random.default_rng([self.section.seed, run])
        shift, tilt = float(self.section.shift) * _on_disc(rng), float(self.section.tilt) * _on_disc(rng)
        return Pose(self.at.p + shift, R=np.asarray(rotation_exp(tilt)) @ self.at.R)

    def plants(self) -> Iterator[tuple[str, Table]]:
        """Each run's name, and its section [plant]."""
        for run in range(1, self.section.runs + 1):
            place, name = self.place(run), f"run {run}"
            here = {"scene_at": {"p": place.p.tolist(), "R": place.R.tolist()}}
            values = {**self.plant.values, **here}
            yield name, Table(f"{self.plant.file}: {name}", "plant", values)


def _on_disc(rng: np.random.Generator) -> Float64Array:
    """(3,) a point of the unit disc across z, each as likely as any other."""
    radius, angle = np.sqrt(rng.random()), 2.0 * np.pi * rng.random()
    return np.array([radius * np.cos(angle), radius * np.sin(angle), 0.0])


def read_spread(root: Table) -> Spread | None:
    """The spread of a scenario; None if it has none.

    Raises:
        ScenarioError: No numbers for it, no scene that could be elsewhere, cases too.
    """
    if "spread" not in root:
        return None
    table, plant = root.table("spread"), root.table("plant")
    if "cases" in root:
        raise table.error("does not go with [cases]; put them in scenarios of their own")
    section = read(SpreadSection, table)
    if plant.get("kind") != "mujoco" or "scene" not in plant:
        raise table.error('moves the scene; give [plant] kind = "mujoco" and scene')
    at = pose_of(plant, "scene_at") if "scene_at" in plant else Pose([0.0, 0.0, 0.0])
    return Spread(section=section, at=at, plant=plant)
