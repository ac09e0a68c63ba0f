"""A smooth model plant in the place of an engine, a robot, or a plant whose sensors and amplifiers make steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Container
from typing import Any, Literal, Protocol, cast, runtime_checkable

import numpy as np

from taut.arm.description import CommandKind
from taut.loop import AnyPlant, ModelPlant
from taut.plant.drives.actuation import Actuation
from taut.plant.environments.push import Push
from taut.plant.rigid import RigidPlant
from taut.plant.sensors.sensors import Sensors

__all__ = ["has_steps", "stand_in"]


@runtime_checkable
class HasStages(Protocol):
    """A plant with the drives, sensors and joint friction of `taut.plant`."""

    @property
    def friction(self) -> Literal["arm"] | None: ...

    @property
    def actuation(self) -> Actuation: ...

    @property
    def sensors(self) -> Sensors: ...


def has_steps(plant: AnyPlant) -> bool:
    """Whether sensors or amplifiers of a plant make steps, which have no derivative."""
    return any(path.endswith(".resolution") for path in plant.parameters)


def stand_in(plant: AnyPlant, needs: Container[str]) -> ModelPlant:
    """The same arm, drives and sensors as a model plant without steps.

    Args:
        plant: The plant.
        needs: What the controller measures.
    """
    if isinstance(plant, ModelPlant) and not isinstance(plant, RigidPlant):
        return plant  # a model of the user's own
    stages = plant if isinstance(plant, HasStages) else RigidPlant(plant.arm)
    actuation, sensors = _without_steps(stages.actuation), stages.sensors
    sensors = dataclasses.replace(
        sensors, **{field.name: _without_steps(getattr(sensors, field.name)) for field in dataclasses.fields(sensors)}
    )
    if isinstance(plant, RigidPlant):
        return dataclasses.replace(plant, actuation=actuation, sensors=sensors)
    return RigidPlant(
        plant.arm,
        stages.friction,
        takes=cast(CommandKind, plant.takes),
        actuation=actuation,
        sensors=sensors,
        adds=plant.adds,
        environment=Push(peak=np.zeros(6)) if "F_ext" in needs or sensors.wrench is not None else None,
    )


def _without_steps(part: Any) -> Any:
    return dataclasses.replace(part, resolution=None) if getattr(part, "resolution", None) is not None else part
