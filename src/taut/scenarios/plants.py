"""The arms and the plant of a scenario: [arm], which the controllers assume, [plant], which is true, and [spread]."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from taut.arm.builtin import BUILT_IN, one_joint_tree
from taut.arm.catalogue import CATALOGUE, PATTERN
from taut.arm.change import joints_replaced
from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.arm.load import arm_of, load_arm, open_model
from taut.base.fields import Declared, Field, Part, Whole
from taut.base.types import Float64Array
from taut.drives import ElectricMotor, Motor, MotorModel
from taut.environments import (
    Damper,
    Environment,
    Environments,
    Hand,
    Push,
    Spring,
    StiffWall,
)
from taut.maths.model import Adds
from taut.maths.spatial import rotation_exp
from taut.plant.rigid import RigidPlant
from taut.runtime.host import PlantBase
from taut.scenarios.reading import Table, arguments, of_kind, read, reads
from taut.trace.pose import Pose

__all__ = ["Plant", "Spread", "read_arm", "read_plant", "read_spread"]

Plant: TypeAlias = RigidPlant | PlantBase
CHANGES: Final = ("bodies", "friction", "gears", "perturbed", "joint_values", "payload")

# -------------------------------------------------------------------- [arm]


def read_arm(table: Table) -> Arm:
    """The controllers' model of the arm, from [arm]."""
    table.need("model")
    model, link = table.text("model"), table.table("link")
    if not link.values:
        with table.blamed("model"):
            tree = open_model(_model(table))
    elif model == "one_joint":
        tree = read(one_joint_tree, link)
    else:
        raise table.error(f"is for the model 'one_joint'; got model '{model}'", "link")
    others = ("model", "link", "tool_offset", *CHANGES)
    arm: Arm = read(arm_of, table, others=others, blame="model", tree=tree)
    if friction_word(table, "none") == "none":
        arm = arm.with_friction(Friction())
    if "tool_offset" in table:
        offset = read(Pose, table.table("tool_offset"))
        with table.blamed("tool_offset"):
            arm = arm.with_tool(arm.tool, offset)
    return _changed(table, arm)


def read_true_arm(table: Table, assumed: Arm) -> Arm:
    """The plant's arm: the assumed one, or another model, with the changes that [plant] states."""
    if "model" not in table:
        return _changed(table, assumed)
    with table.blamed("model"):
        arm = load_arm(_model(table))
    return _changed(table, arm)


def _model(table: Table) -> str:
    """A name that taut knows, else the path of a file."""
    name = table.text("model")
    path = Path(name)
    there = os.path.exists(table.folder / path)  # noqa: PTH110  (long names)
    if not there and PATTERN.match(name):
        raise table.error(
            f"'{name}' is of the package robot_descriptions, which downloads it when asked, and a scenario downloads "
            "nothing; name the path of its file",
            "model",
        )
    is_file = (
        name and name not in BUILT_IN and name not in CATALOGUE and (path.suffix or len(path.parts) > 1 or there)
    )
    return str(table.file_of("model", "model")) if is_file else name


def friction_word(table: Table, *words: str) -> str | None:
    """The word that `friction` is, if it is no table."""
    return None if isinstance(table.get("friction"), dict) else table.choice("friction", words)


def _changed(table: Table, arm: Arm) -> Arm:
    """The arm with the changes that a table states."""
    bodies = table.table("bodies")
    for joint in bodies.values:
        arm = read(arm.with_body, bodies.table(joint), joint=joint)
    if isinstance(table.get("friction"), dict):
        below = table.table("friction")
        friction = read(Friction, below)
        with below.blamed():
            arm = arm.with_friction(friction)
    if "gears" in table:
        arm = read(arm.with_gears, table.table("gears"))
    if "perturbed" in table:
        arm = read(arm.perturbed, table.table("perturbed"))
    values = table.table("joint_values")
    with values.blamed():
        arm = joints_replaced(arm, values.values)
    return read(arm.with_payload, table.table("payload")) if "payload" in table else arm


# -------------------------------------------------------------------- [plant]

ENVIRONMENTS: Final[Mapping[str, Callable[..., Any]]] = {
    "spring": Spring,
    "damper": Damper,
    "wall": StiffWall,
    "hand": Hand,
    "push": Push,
}


@reads(Environment)
def _environment(table: Table, key: str) -> Environment:
    """One by its kind; without a kind, a table for each of several that act together."""
    below = table.table(key)
    if "kind" in below or not all(isinstance(each, dict) for each in below.values.values()) or not below.values:
        return of_kind(ENVIRONMENTS, below)  # type: ignore[no-any-return]
    parts = {name: of_kind(ENVIRONMENTS, below.table(name)) for name in below.values}
    with below.blamed():
        return Environments(**parts)


@reads(MotorModel)
def _motor(table: Table, key: str) -> Any:
    """A motor with electrical numbers is an electric motor."""
    below = table.table(key)
    return read(Motor if below.values.keys() <= arguments(Motor).keys() else ElectricMotor, below)


def read_plant(table: Table, assumed: Arm, rate: float) -> Plant:
    """A rigid plant or one in MuJoCo.

    Args:
        table: [plant].
        assumed: The controllers' arm, from which the true one is made.
        rate: Commands per second [Hz].
    """
    make: Callable[..., Plant] = RigidPlant
    if table.choice("kind", ("rigid", "mujoco"), "rigid") == "mujoco":
        from taut.runtime.robots.mujoco.plant import MujocoPlant

        make = MujocoPlant
    arm = read_true_arm(table, assumed)
    if arm.n != assumed.n:
        raise table.error(
            f"must have as many joints as that of [arm], the {assumed.n} of '{assumed.name}'; got the {arm.n} of "
            f"'{arm.name}'",
            "model",
        )
    made: dict[str, Any] = {"friction": None if friction_word(table, "arm", "none") == "none" else "arm"}
    if "adds" in table:
        with table.blamed("adds"):
            made["adds"] = Adds.of(table.texts("adds", example='["gravity"]') or ())
    if "scene" in table and "scene" in arguments(make):
        made["scene"] = table.file_of("scene", "scene")
    others, blame = ["kind", "model", *CHANGES, *made], "scene" if "scene" in made else ""
    plant: Plant = read(make, table, others=others, blame=blame, arm=arm, **made)
    _require_start(plant, table, rate)
    return plant


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


# -------------------------------------------------------------------- [spread]

MAX_TILT: Final = 0.5 * np.pi  # [rad]


class Spread(Declared):
    """[spread]: how far chance puts the scene away from where [plant] has it, in each of several runs.

    Shift and tilt are each spread evenly over a disc across the world's z axis: the shift along a vector in it, the
    tilt about one, at the origin of the scene. The place of a run depends on the seed and its number alone.
    """

    at: Part[Pose] = Part(Pose)  # where the scene stands in the file
    runs: Whole = Whole(minimum=2, maximum=1000)  # how many
    seed: Whole = Whole(0)
    shift: Field = Field(0.0, unit="m", minimum=0.0)  # the largest, in any direction across z
    tilt: Field = Field(0.0, unit="rad", minimum=0.0, maximum=MAX_TILT)  # the largest, about any axis across z

    def check(self) -> None:
        """Something is spread."""
        if not self.shift and not self.tilt:
            self.refuse("", "needs shift [m], tilt [rad] or both above zero")

    def place(self, run: int) -> Pose:
        """Where the scene stands in a run."""
        rng = np.random.default_rng([self.seed, run])
        shift, tilt = self.shift * _on_disc(rng), self.tilt * _on_disc(rng)
        return Pose(self.at.p + shift, R=np.asarray(rotation_exp(tilt)) @ self.at.R)

    def plants(self, plant: Table) -> Iterator[tuple[str, Table]]:
        """Each run's name, and its section [plant]."""
        for run in range(1, self.runs + 1):
            place, name = self.place(run), f"run {run}"
            here = {"scene_at": {"p": place.p.tolist(), "R": place.R.tolist()}}
            yield name, Table(f"{plant.file}: {name}", "plant", {**plant.values, **here}, plant.folder)


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
    if plant.get("kind") != "mujoco" or "scene" not in plant:
        raise table.error('moves the scene; give [plant] kind = "mujoco" and scene')
    return read(Spread, table, at=read(Pose, plant.table("scene_at")))  # type: ignore[no-any-return]
