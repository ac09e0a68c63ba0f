"""One control period of a loop as a map from memory to memory, with its derivative, in coordinates that have names.

`Period` is the loop that simulates, differentiated by central differences: quick to make, for it is compiled anyway.
`taut.linear.loop_map` has the exact derivative of the same map. `taut.linear.equilibrium` searches with either.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal, Protocol, cast, runtime_checkable

import numpy as np

from taut.arm.description import CommandKind
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.layout import Block
from taut.codegen.loop import compiled_loop
from taut.control.lawside import LawSide
from taut.control.trajectories.feed import ReferenceFeed
from taut.control.trajectories.reference import Hold, Reference
from taut.loop import DT, AnyPlant, Loop, ModelPlant
from taut.maths.spatial import rotation_exp
from taut.plant.drives.actuation import Actuation
from taut.plant.environments.hands import Push
from taut.plant.rigid import RigidPlant
from taut.plant.sensors.sensors import Sensors
from taut.trace import math as tm

__all__ = [
    "RESOLUTION",
    "BlockCoordinates",
    "Derivative",
    "Period",
    "PeriodMap",
    "Point",
    "Side",
    "held_reference",
    "small_rotations",
    "smooth_plant",
]

ROTATION: Final = "R"  # the last name in the path of a rotation
GENERATORS: Final = np.stack([np.asarray(tm.skew(e), dtype=np.float64) for e in np.eye(3)])  # rotations about axes
RESOLUTION: Final = ".resolution"  # the end of the path of a quantisation step, which has no derivative
STEP: Final = 1e-6  # [-] of a state's size, of central differences
CLOCK: Final = "plant.t"
EMPTY: Final[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """State of a loop in a tick, flat.

    Args:
        inputs: Time, reference, noise and disturbances.
        parameters: All parameters.
        memory: All memory.
    """

    inputs: Float64Array
    parameters: Float64Array
    memory: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Derivative:
    """The derivative of a period at a point, in all its coordinates.

    Args:
        A: (N, N) of the memory after the period by that before it.
        B: (N, m) of the memory after the period by inputs.
        C: (p, N) of outputs by the memory before it.
        D: (p, m) of outputs by inputs.
        residual: (N,) change of the memory in the period.
        memory: The memory after it.
        record: What the tick records, flat.
    """

    A: Float64Array
    B: Float64Array
    C: Float64Array
    D: Float64Array
    residual: Float64Array
    memory: Float64Array
    record: Float64Array


class PeriodMap(ABC):
    """The map of a control period of a loop from its memory before to its memory after it."""

    memory: Block
    state_coordinates: BlockCoordinates
    side: LawSide
    dt: float
    tolerance: float  # [-] of a derivative: smaller entries are rounding
    rest: float  # [-] of a state's size per period: a residual of rounding alone, of which no step can be made

    @abstractmethod
    def derivative(self, at: Point) -> Derivative:
        """The map and its derivative at a point."""

    @abstractmethod
    def after(self, at: Point, memories: Float64Array) -> Float64Array:
        """(k, size) the memory after a period from k memories, with the inputs and parameters of a point."""


class Period(PeriodMap):
    """One control period of a loop as it is simulated: reference and clock held, without noise.

    The loop is compiled once, for runs and for this. Derivatives are central differences.

    Args:
        loop: The loop.
        q: (n,) joint positions of the start, at rest [rad | m].
        changes: Parameters by path that differ from those of the loop.

    Raises:
        RangeError: The loop cannot start there.
    """

    tolerance, rest = STEP, 1e-11

    def __init__(self, loop: Loop, q: Float64Array, changes: Mapping[str, Any] = EMPTY) -> None:
        self.side, self.dt, self.arm = loop.side, loop.dt, loop.plant.arm
        self.inputs, self.parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        checked = {path: loop.parameters.checked(path, value) for path, value in changes.items()}
        values = self.parameters.pack({**loop.parameters, **checked, DT: loop.dt})
        row = held_reference(loop, self.inputs, q)
        memory = loop.start(q, np.zeros_like(q), self.inputs.views(row), self.parameters.views(values))
        self.memory = Block.of({path: np.shape(value) for path, value in memory.items()})
        self.state_coordinates = BlockCoordinates(self.memory)
        self._clock = [self.memory.field(CLOCK).offset] if CLOCK in self.memory.shapes else []
        self.start = Point(inputs=row, parameters=values, memory=self.memory.pack(memory))
        blocks, example = (self.inputs, self.parameters, self.memory), (row, values, self.start.memory)
        self._run = compiled_loop(loop, blocks, example)
        outputs = [self._run.outputs.field(path) for path in ("q", "v", "command")]
        self._shown = np.concatenate([np.arange(field.offset, field.offset + field.size) for field in outputs])

    def values(self, point: Point) -> dict[str, Float64Array]:
        """The parameters of a point by path."""
        return {path: np.array(value) for path, value in self.parameters.views(point.parameters).items()}

    def changed(self, point: Point, changes: Mapping[str, Any]) -> Point:
        """The point with some parameters changed, by path."""
        parameters = point.parameters.copy()
        for path, value in changes.items():
            self.parameters.views(parameters)[path][...] = value
        return dataclasses.replace(point, parameters=parameters)

    def command(self, point: Point) -> Float64Array:
        """(n,) the command of the law in the period."""
        return np.array(self._run.outputs.views(self._period(point, point.memory)[1])["command"])

    def _period(self, at: Point, memory: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Memory after the period, NaN where it is not finite, and what the tick records."""
        new, row = np.array(memory), np.zeros((1, self._run.outputs.size))
        done = self._run.run(at.inputs[np.newaxis], at.parameters, new, row)
        new[self._clock] = memory[self._clock]
        return (new if done else np.full_like(new, np.nan)), row[0]

    def after(self, at: Point, memories: Float64Array) -> Float64Array:
        """(k, size) the memory after a period from k memories, with the inputs and parameters of a point."""
        return np.stack([self._period(at, memory)[0] for memory in memories])

    def derivative(self, at: Point, step: float = STEP) -> Derivative:
        """The map and its derivative, without inputs, by central differences."""
        states = self.state_coordinates
        memory, record = self._period(at, at.memory)
        steps = step * (1.0 + np.abs(states.numbers(at.memory)))[:, np.newaxis]
        ends = [
            [self._period(at, at.memory + sign * move) for sign in (1.0, -1.0)]
            for move in steps * states.basis(at.memory)
        ]
        new = np.stack([more[0] - less[0] for more, less in ends])
        shown = np.stack([(more[1] - less[1])[self._shown] for more, less in ends])
        return Derivative(
            A=(states.read(memory, new) / (2.0 * steps)).T, B=np.zeros((len(states), 0)),
            C=(shown / (2.0 * steps)).T, D=np.zeros((len(self._shown), 0)),
            residual=states.difference(memory, at.memory), memory=memory, record=record,
        )  # fmt: skip


def held_reference(loop: Loop, inputs: Block, q: Float64Array, ref: Reference | None = None) -> Float64Array:
    """(size,) inputs of a tick: the reference held where the loop starts at rest, no noise, no disturbance.

    Args:
        loop: The loop.
        inputs: Block of the inputs.
        q: (n,) joint positions of the start [rad | m].
        ref: The reference that is held; a hold of the start if left out.
    """
    rows, side = np.zeros((1, inputs.size)), loop.side
    feed = ReferenceFeed(Hold() if ref is None else ref, side.law.reference, side.arm, loop.dt, side.at_rest(q))
    feed.fill(subtree(inputs.views(rows), "ref"), 0, lambda: None)
    return np.asarray(rows[0])


# -------------------------------------------------------------------- smooth plants


@dataclass(frozen=True)
class Side:
    """A controller as a loop takes it."""

    side: LawSide
    parameters: Mapping[str, Float64Array]
    engine: str


@runtime_checkable
class HasStages(Protocol):
    """A plant with the drives, sensors and joint friction of `taut.plant`."""

    @property
    def friction(self) -> Literal["arm"] | None: ...

    @property
    def actuation(self) -> Actuation: ...

    @property
    def sensors(self) -> Sensors: ...


def smooth_plant(plant: AnyPlant, needs: Container[str]) -> ModelPlant:
    """The same arm, drives and sensors as a model plant without quantisation, which has no derivative.

    A plant that no model can be made of, such as an engine or a robot, is represented by `RigidPlant`.

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


# -------------------------------------------------------------------- coordinates


class BlockCoordinates:
    """Small changes of the numbers of a block: one for each entry, three for each rotation.

    A field named R with shape (3, 3) is a rotation; it changes by a small rotation vector in world axes.

    Args:
        block: The block.
        only: The fields to change; all if left out.
    """

    def __init__(self, block: Block, only: Iterable[str] | None = None) -> None:
        chosen = None if only is None else set(only)
        self.block = block
        self.fields = [field for field in block.fields if chosen is None or field.path in chosen]
        self.places: dict[str, slice] = {}
        names: list[str] = []
        for field in self.fields:
            first = len(names)
            if _is_rotation(field.path, field.shape):
                names += [f"{field.path.rpartition('.')[0]}.rotation[{k}]".lstrip(".") for k in range(3)]
            elif field.shape == ():
                names.append(field.path)
            else:
                names += [f"{field.path}[{','.join(map(str, i))}]" for i in np.ndindex(field.shape)]
            self.places[field.path] = slice(first, len(names))
        self.names = tuple(names)

    def __len__(self) -> int:
        return len(self.names)

    def basis(self, at: Float64Array) -> Float64Array:
        """(k, size) derivative of the block by each coordinate."""
        out = np.zeros((len(self), self.block.size))
        for field in self.fields:
            rows, columns = self.places[field.path], slice(field.offset, field.offset + field.size)
            if _is_rotation(field.path, field.shape):
                R = at[columns].reshape(3, 3)
                out[rows, columns] = (GENERATORS @ R).reshape(3, 9)
            else:
                out[rows, columns] = np.eye(field.size)
        return out

    def read(self, at: Float64Array, changes: Float64Array) -> Float64Array:
        """(m, k) changes of the coordinates that belong to m changes (m, size) of the block at a place."""
        out = np.zeros((len(changes), len(self)))
        for field in self.fields:
            rows, columns = self.places[field.path], slice(field.offset, field.offset + field.size)
            if _is_rotation(field.path, field.shape):
                out[:, rows] = small_rotations(changes[:, columns].reshape(-1, 3, 3) @ at[columns].reshape(3, 3).T)
            else:
                out[:, rows] = changes[:, columns]
        return out

    def moved(self, at: Float64Array, by: Float64Array) -> Float64Array:
        """The block after a change that need not be small."""
        out = at + by @ self.basis(at)
        for field in self.fields:
            if _is_rotation(field.path, field.shape):
                columns = slice(field.offset, field.offset + field.size)
                R = np.asarray(rotation_exp(by[self.places[field.path]]), dtype=np.float64)
                out[columns] = (R @ at[columns].reshape(3, 3)).ravel()
        return out

    def difference(self, after: Float64Array, before: Float64Array) -> Float64Array:
        """(k,) the change from one place to another: exact for numbers, to first order for rotations."""
        return np.asarray(self.read(before, (after - before)[np.newaxis])[0])

    def numbers(self, at: Float64Array) -> Float64Array:
        """(k,) the numbers of a block in its coordinates."""
        return np.asarray(self.read(at, at[np.newaxis])[0])


def small_rotations(W: Float64Array) -> Float64Array:
    """(m, 3) the rotation vectors in the skew parts of matrices (m, 3, 3)."""
    entries = [W[:, 2, 1] - W[:, 1, 2], W[:, 0, 2] - W[:, 2, 0], W[:, 1, 0] - W[:, 0, 1]]
    return 0.5 * np.stack(entries, axis=1)


def _is_rotation(path: str, shape: tuple[int, ...]) -> bool:
    return shape == (3, 3) and path.rpartition(".")[2] == ROTATION
