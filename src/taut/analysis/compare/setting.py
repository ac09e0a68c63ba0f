"""What laws are compared on: an arm, a plant, a reference, and how the plant may differ from what is believed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from taut.analysis.compare.truth import PlantChange, is_noisy
from taut.arm.description import Arm
from taut.base.errors import MatchError, TautError, UsageError, unknown_name
from taut.base.types import ArrayLike
from taut.control.describe import title
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.sensing.sensing import Sensing
from taut.control.tasks.task import Task
from taut.control.trajectories.reference import Chunk, Hold, JointMotion, Reference, Sample, Stream, Trajectory
from taut.control.trajectories.task_reference import TaskMotion
from taut.controller import Controller, compile
from taut.loop import Loop, ModelPlant, check_fit
from taut.plant.rigid import RigidPlant
from taut.plant.sensors.sensors import Sensors
from taut.record.run import Run
from taut.runtime.events import Event
from taut.runtime.host import HostPlant
from taut.runtime.simulate import run

__all__ = ["Plant", "Setting", "blamed", "setting_of", "task_refused"]

Plant: TypeAlias = ModelPlant | HostPlant


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """An experiment that any law can be put into.

    Args:
        name: What messages call it.
        arm: What the controllers believe.
        rate: [Hz].
        sensing: Of the controllers.
        limits: Of the controllers; None for none.
        plant: What is true.
        another_plant: Gives a plant that differs; None where there is no way to.
        reference: What is followed.
        duration: [s].
        q0: Where a run starts; home if left out.
        v0: With which velocity.
        seed: Of all noise.
        events: Parameters that change on the way.
        parameters: Values by path that the loops get before they run.
        engine: Of the controllers.
        texts: What tells more of it, by title, such as the text of a scenario.
    """

    name: str
    arm: Arm
    rate: float
    sensing: Sensing
    limits: Limits | None
    plant: Plant
    another_plant: Callable[[PlantChange], Plant] | None
    reference: Reference
    duration: float
    q0: ArrayLike | None = None
    v0: ArrayLike | None = None
    seed: int = 0
    events: tuple[Event, ...] = ()
    parameters: Mapping[str, ArrayLike] = field(default_factory=dict)
    engine: str = "auto"
    texts: Mapping[str, str] = field(default_factory=dict)

    @property
    def noisy(self) -> bool:
        """Whether the plant's sensors have noise."""
        return any(is_noisy(self.sensors, name) for name in Sensors.declared)

    @property
    def sensors(self) -> Sensors:
        """The plant's sensors; ideal ones of a plant that does not tell."""
        found = getattr(self.plant, "sensors", None)
        return found if isinstance(found, Sensors) else Sensors()

    def controller(self, name: str, law: Law | Task) -> Controller:
        """The law compiled for this experiment, checked against its reference and plant.

        Raises:
            MatchError: The law follows another kind of reference, or does not fit the plant.
            TautError: It cannot be compiled.
        """
        if isinstance(law, Task):
            raise UsageError(task_refused(f"law '{name}'", law.names), name=name)
        self.check_kind(name, law)
        with blamed(name):
            ctrl = compile(
                law,
                self.arm,
                rate=self.rate,
                sensing=self.sensing,
                limits=self.limits,
                adds=self.plant.adds,
                engine=self.engine,  # type: ignore[arg-type]  # compile checks the word
            )
            check_fit(ctrl.side, self.plant)
        return ctrl

    def check_kind(self, name: str, law: Law) -> None:
        """A reference serves the laws of its kind.

        Raises:
            MatchError: The law follows another.
        """
        given, wanted = kind_of(self.reference), law.reference
        if given is None or issubclass(given, wanted) or law.ignores_reference:
            return
        way_out = f"give it a reference of its own in Python, taut.compare(..., references={{'{name}': ...}})"
        if wanted is JointMotion and given is TaskMotion:
            way_out = f"hold it in one that does, ViaJointSpace(inner={title(law)}(...)), or {way_out}"
        raise MatchError(
            f"law '{name}' follows a {wanted.__name__}, and {self.name} asks for a {given.__name__}; {way_out}",
            name=name,
        )

    def run(self, ctrl: Controller, plant: Plant | None = None) -> Run:
        """A run of a controller; against another plant where one is given.

        Raises:
            UnknownNameError: A parameter that the loop does not have.
            TautError: What a run refuses.
        """
        plant = plant or self.plant
        start = {"q0": self.q0, "v0": self.v0, "seed": self.seed, "events": self.events, "progress": False}
        if isinstance(plant, ModelPlant):
            loop = Loop(ctrl, plant, self.reference, duration=self.duration)
            for path, value in self.parameters.items():
                loop.parameters[path] = value
            return run(loop, **start)  # type: ignore[arg-type]  # each as run takes it
        known = [*ctrl.side.parameters, *plant.parameters]
        for path in self.parameters:
            if path not in known:
                raise unknown_name("the loop", "parameter", path, known)
        for path, value in self.parameters.items():
            if path in ctrl.side.parameters:
                ctrl.parameters[path] = value
        plant.set_parameters({path: value for path, value in self.parameters.items() if path in plant.parameters})
        return run(ctrl, plant, self.reference, duration=self.duration, **start)  # type: ignore[arg-type]


@contextmanager
def blamed(name: str) -> Iterator[None]:
    """What is refused of a law names it.

    Raises:
        UsageError: What was refused.
    """
    try:
        yield
    except TautError as cause:
        raise UsageError(f"law '{name}': {cause}", name=name) from cause


def task_refused(whose: str, phases: Sequence[str]) -> str:
    """Why a task is not compared, and what can be."""
    return (
        f"{whose} is a task, whose phases ({', '.join(phases)}) follow each its own reference; compare one of "
        f"them, of recorded runs: taut.compare({{'a': taut.load_run('a.mcap').phase('{phases[0]}'), ...}})"
    )


def kind_of(reference: Reference) -> type[Sample] | None:
    """The kind of sample that a reference gives; None where it gives any, or cannot be asked."""
    if isinstance(reference, Hold):
        return None if reference.sample is None else type(reference.sample)
    if isinstance(reference, Sample):
        return type(reference)
    if isinstance(reference, Chunk):
        return type(reference.samples[0])
    if isinstance(reference, Stream) or not isinstance(reference, Trajectory):
        return None
    return type(reference.at(0.0))


def setting_of(loop: Loop, *, seed: int = 0) -> Setting:
    """The experiment of a loop, with the parameters of its plant, sensing and limits that were changed."""
    own, plant = loop.side, loop.plant
    made = {**own.parameters, **plant.parameters}
    changed = {
        path: value
        for path, value in loop.parameters.items()
        if not path.startswith("law.") and not np.array_equal(value, made[path])
    }
    return Setting(
        name="the loop",
        arm=own.arm,
        rate=own.rate,
        sensing=own.sensing,
        limits=own.limits,
        plant=plant,
        another_plant=another_rigid_plant(plant),
        reference=loop.ref,
        duration=loop.duration,
        seed=seed,
        parameters=changed,
        engine=loop.engine,
    )


def another_rigid_plant(plant: Plant) -> Callable[[PlantChange], Plant] | None:
    """Plants like a RigidPlant, which differ."""
    if not isinstance(plant, RigidPlant):
        return None

    def another(change: PlantChange) -> Plant:
        return dataclasses.replace(plant, arm=change.arm(plant.arm), sensors=change.sensors(plant.sensors))

    return another
