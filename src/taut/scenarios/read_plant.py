"""The plant of a scenario: [plant], what is true."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from taut.analysis.compare.truth import PlantChange
from taut.arm.description import Arm, Payload
from taut.maths.adds import Adds
from taut.plant.rigid import RigidPlant
from taut.plant.sensors.readings import Sensor
from taut.plant.sensors.sensors import SENSORS, Sensors
from taut.plant.sensors.tool_sensors import WrenchSensor
from taut.runtime.host import HostPlant
from taut.scenarios.read_arm import read_true_arm
from taut.scenarios.read_drives import made_from, read_actuation
from taut.scenarios.read_environment import read_environment
from taut.scenarios.read_joints import friction_word
from taut.scenarios.read_pose import pose_table
from taut.scenarios.toml import Section, file_beside

__all__ = ["Plant", "read_plant"]

MOST_STEPS: Final = 1000  # of MuJoCo in a control period, as of the other plant

OF_RIGID: Final = ("integrator", "substeps", "sweeps", "energy")
OF_MUJOCO: Final = ("timestep", "scene", "scene_at", "tool_radius", "tool_length", "tip")

Plant: TypeAlias = RigidPlant | HostPlant


def read_plant(
    section: Section, believed: Arm, rate: float, folder: Path, *, change: PlantChange | None = None
) -> Plant:
    """A rigid plant or one in MuJoCo.

    Args:
        section: [plant].
        believed: The controllers' arm, from which the true one is made.
        rate: Commands per second [Hz].
        folder: Where a scene and a model lie.
        change: What is different in it.
    """
    kind, change = section.word("kind", ("rigid", "mujoco"), "rigid"), change or PlantChange()
    arm = change.arm(read_true_arm(section, believed, folder))
    if arm.n != believed.n:
        raise section.error(
            f"model must have as many joints as that of [arm], the {believed.n} of '{believed.name}'; got the "
            f"{arm.n} of '{arm.name}'"
        )
    options: dict[str, Any] = {"friction": None if friction_word(section, "arm", "none") == "none" else "arm"}
    adds = section.texts("adds", [], example='["gravity"]')
    with section.blamed("adds"):
        options["adds"] = Adds.of(adds)
    options["sensors"] = change.sensors(_sensors(section.section("sensors")))
    if (takes := section.text("takes", None)) is not None:
        options["takes"] = takes
    if "actuation" in section:
        options["actuation"] = read_actuation(section.section("actuation"))
    if "environment" in section:
        options["environment"] = read_environment(section.section("environment"))
    for key in ("sensors", "actuation", "environment"):
        section.take(key, None)  # known, so that a misspelt one is compared with it
    if kind == "mujoco":
        return _in_mujoco(section, arm, options, rate, folder)
    if "integrator" in section:
        options["integrator"] = section.text("integrator")
    options |= {word: section.whole(word) for word in ("substeps", "sweeps") if word in section}
    if "energy" in section:
        options["energy"] = section.flag("energy")
    section.only(*OF_RIGID, elsewhere=dict.fromkeys(OF_MUJOCO, ', which is for kind = "mujoco"'))
    with section.blamed():
        plant = RigidPlant(arm, **options)
    with section.blamed("actuation.delay"):
        plant.actuation.taps(1.0 / rate)
    with section.blamed():
        plant.start(arm.home, np.zeros(arm.n), plant.parameters, 1.0 / rate)  # a step that is too long for a spring
    return plant


def _in_mujoco(section: Section, arm: Arm, options: dict[str, Any], rate: float, folder: Path) -> Plant:
    from taut.runtime.robots.mujoco.plant import MujocoPlant
    from taut.runtime.robots.mujoco.tool import SpringTip

    timestep, scene = section.number("timestep", None), section.text("scene", None)
    if "scene_at" in section:
        options["scene_at"] = pose_table(section.section("scene_at"))
    section.take("scene_at", None)  # known, so that a misspelt one is compared with it
    if "tip" in section:
        options["tip"] = made_from(section.section("tip"), SpringTip)
    section.take("tip", None)
    options |= {word: section.number(word) for word in ("tool_radius", "tool_length") if word in section}
    section.only(*OF_MUJOCO, elsewhere=dict.fromkeys(OF_RIGID, ', which is for kind = "rigid"'))
    if timestep is not None and 0.0 < timestep * rate * MOST_STEPS < 1.0:
        raise section.error(
            f"timestep must be >= {1.0 / (rate * MOST_STEPS):g} [s], {MOST_STEPS} of which make a control period; "
            f"got {timestep:g}"
        )
    with section.blamed("scene" if scene is not None else "kind"):
        place = None if scene is None else file_beside("scene", scene, folder)
        plant = MujocoPlant(arm, scene=place, timestep=timestep, **options)
    with section.blamed("timestep"):
        plant.reset(arm.home, np.zeros(arm.n), 1.0 / rate)
    return plant


def _sensors(section: Section) -> Sensors:
    """A table for each sensor, or "none" for one that is not there."""
    numbers = (name for _, kind in SENSORS.values() for name in kind.quantities)
    elsewhere = dict.fromkeys(numbers, f", which a sensor has, as in [{section.below('position')}]")
    section.only(*SENSORS, elsewhere=elsewhere)
    options: dict[str, Any] = {}
    for name, (_, kind) in SENSORS.items():
        if section.peek(name) == "none" and name != "position":
            section.take(name)
            options[name] = None
        elif name in section:
            options[name] = _sensor(section.section(name), kind)
    with section.blamed():
        return Sensors(**options)


def _sensor(section: Section, kind: type[Sensor]) -> Any:
    """One sensor; that of the wrist may have a table for the tool that it weighs."""
    parts = (
        {"tool": made_from(section.section("tool"), Payload)} if kind is WrenchSensor and "tool" in section else {}
    )
    return made_from(section, kind, **parts)
