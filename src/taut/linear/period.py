"""One control period of a loop as a map from memory to memory, with its derivative, in named coordinates.

`Period` is the compiled loop that simulates, differentiated by central differences; `LoopMap` has inputs and an exact
derivative, by automatic differentiation. `equilibrium` searches with either.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Protocol, cast, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from taut.arm.description import CommandKind
from taut.base.checks import instance_of
from taut.base.errors import RangeError, UsageError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.engine import Steps
from taut.codegen.loop import compiled_loop
from taut.codegen.program import Block
from taut.codegen.tangent import TANGENT, StepTangent
from taut.control.lawside import LawSide
from taut.control.tasks.feed import ReferenceFeed
from taut.control.trajectories.reference import Hold, Reference
from taut.loop import DT, AnyPlant, Loop, Values
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.maths.spatial import rotation_exp
from taut.plant.environments.environment import COMMAND, disturbance_shapes
from taut.plant.environments.kinds import Push
from taut.plant.rigid import RigidPlant
from taut.trace import math as tm

ROTATION: Final = "R"  # the last name in the path of a rotation
GENERATORS: Final = np.stack([np.asarray(tm.skew(e), dtype=np.float64) for e in np.eye(3)])  # rotations about axes
RESOLUTION: Final = ".resolution"  # the end of the path of a quantisation step, which has no derivative
STEP: Final = 1e-5  # [-] of a state's size, of central differences: near the cube root of rounding
BESIDE: Final = 5e-8  # [-] of a state's size: distance of a derivative beside a point that has none
OUTPUTS: Final = ("q", "v", "tip.p", "tip.R", "tip.twist", "command")
CLOCK: Final = "plant.t"
INNER_STEPS: Final = 20  # in a control period, of the loop in motors whose rate is not stated
EMPTY: Final[Mapping[str, Any]] = MappingProxyType({})


@runtime_checkable
class Stepping(Protocol):
    """A plant that moves the arm in time steps of its own."""

    def steps_in(self, dt: float) -> int:
        """Steps in a control period of dt [s]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """State of a loop in a tick, flat."""

    inputs: Float64Array  # time, reference, noise, disturbances
    parameters: Float64Array
    memory: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Derivative:
    """The derivative of a period at a point, in all its coordinates."""

    at: Point
    A: Float64Array  # (N, N) memory after the period by memory before it
    B: Float64Array  # (N, m) memory after the period by inputs
    C: Float64Array  # (p, N) outputs by memory before it
    D: Float64Array  # (p, m) outputs by inputs
    residual: Float64Array  # (N,) change of the memory in the period
    memory: Float64Array  # after the period
    record: Float64Array  # of the tick, flat


class Period:
    """One period of a loop from rest at q, its reference and clock held, by central differences.

    Of a task, in the phase of that number. It is the compiled loop that simulates, without quantisation.
    """

    tolerance: Final = 1e-6  # [-] of a derivative: smaller entries are rounding
    rest: Final = 1e-11  # [-] of a state's size per period: a residual of rounding, of which no step can be made

    def __init__(self, loop: Loop, q: Float64Array, changes: Mapping[str, Any] = EMPTY, phase: int = 0) -> None:
        self.side, self.dt, self.arm = loop.side, loop.dt, loop.plant.arm
        self.inputs, self.parameters = Block.of(loop.input_shapes()), Block.of(loop.parameter_shapes())
        checked = {path: loop.parameters.checked(path, value) for path, value in changes.items()}
        self.memory, self.start = start_of(loop, self.inputs, self.parameters, q, Hold(), checked)
        if phase:
            self.memory.views(self.start.memory)["law.next"][...] = phase
        self.state_coordinates = BlockCoordinates(self.memory)
        self._columns = np.arange(len(self.state_coordinates))
        self._clock = [self.memory.field(CLOCK).offset] if CLOCK in self.memory.shapes else []
        example = (self.start.inputs, self.start.parameters, self.start.memory)
        self._run = compiled_loop(loop, (self.inputs, self.parameters, self.memory), example, q, np.zeros_like(q))
        outputs = [self._run.outputs.field(path) for path in ("q", "v", "command")]
        self._shown = np.concatenate([np.arange(field.offset, field.offset + field.size) for field in outputs])

    def only(self, states: NDArray[np.intp]) -> Period:
        """The same period, differentiated by some states alone: the others count as without effect."""
        other = copy.copy(self)
        other._columns = states
        return other

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
        _, record = self._periods(point, point.memory[np.newaxis])
        return np.array(self._run.outputs.views(record[0])["command"])

    def _periods(self, at: Point, memory: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Each row of memory after a period, NaN where it is not finite, and what the ticks record."""
        new, rows = np.array(memory), np.zeros((len(memory), self._run.outputs.size))
        done = self._run.run(at.inputs[np.newaxis], at.parameters, new, rows)
        command = self._run.outputs.views(rows)["command"]
        new[done:] = np.nan
        new[~(np.isfinite(new).all(axis=1) & np.isfinite(command).all(axis=1))] = np.nan
        new[:, self._clock] = memory[:, self._clock]
        return new, rows

    def after(self, at: Point, memory: Float64Array) -> Float64Array:
        """(size,) the memory after a period, with the inputs and parameters of a point."""
        ends, _ = self._periods(at, memory[np.newaxis])
        return np.asarray(ends[0])

    def derivative(self, at: Point, step: float = STEP) -> Derivative:
        """The map and its derivative, without inputs, by central differences."""
        states = self.state_coordinates
        steps = step * (1.0 + np.abs(states.numbers(at.memory)))[self._columns, np.newaxis]
        moves = steps * states.basis(at.memory)[self._columns]
        ends, rows = self._periods(at, at.memory + np.concatenate([np.zeros((1, moves.shape[1])), moves, -moves]))
        memory, record = ends[0], rows[0]
        (more, less), (right, left) = (np.split(x[1:], 2) for x in (ends, rows[:, self._shown]))
        new, shown = more - less, right - left
        A, C = np.zeros((len(states), len(states))), np.zeros((len(self._shown), len(states)))
        A[:, self._columns] = (states.read(memory, new) / (2.0 * steps)).T
        C[:, self._columns] = (shown / (2.0 * steps)).T
        return Derivative(
            at=at, A=A, B=np.zeros((len(states), 0)), C=C, D=np.zeros((len(self._shown), 0)),
            residual=states.difference(memory, at.memory), memory=memory, record=record,
        )  # fmt: skip


class LoopMap:
    """One period of a loop with its exact derivative; quantisation counts by its mean slope, which is one."""

    tolerance: Final = 0.0  # as of `Period`
    rest: Final = 1e-13

    def __init__(self, loop: Loop) -> None:
        side, plant = loop.side, loop.plant
        if side.task is not None:
            raise UsageError(
                "a task of phases has no one linear model: which law acts, and with what reference, changes with its "
                "guards; make a taut.Loop with the law and the reference of the phase that is wanted",
                name="loop",
            )
        self.side, self.dt = side, loop.dt  # and not the loop, which may go
        self._twin = copy.copy(loop)
        pushes = disturbance_shapes(side.arm.n)
        if not isinstance(plant, RigidPlant):
            pushes = {COMMAND: pushes[COMMAND]}  # what it does of the others is not known
        self.inputs = Block.of(loop.input_shapes() | pushes)
        self.parameters = Block.of(loop.parameter_shapes())
        self.memory, _ = start_of(loop, self.inputs, self.parameters, plant.arm.home, loop.ref)
        self.state_coordinates = BlockCoordinates(self.memory)
        self.input_coordinates = BlockCoordinates(self.inputs, [path for path in self.inputs.shapes if path != "t"])
        blocks = self.inputs, self.parameters, self.memory
        self.period = Steps(self.step, *blocks, self._twin.substep, plant.substeps - 1)
        self.tangent = StepTangent(self.period, directed=(), outputs=OUTPUTS, engine=loop.engine)
        self.outputs = Block.of({path: self.tangent.outputs.shapes[path] for path in OUTPUTS})
        self.output_coordinates = BlockCoordinates(self.outputs)

    def step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """A period, with where the tool is in its first instant."""
        record, after = self._twin.step(inputs, parameters, memory)
        model, q, v = model_of(self._twin.plant.arm), memory["plant.q"], memory["plant.v"]
        T = dyn.pose(model, q)
        return {**record, "tip.p": T.p, "tip.R": T.R, "tip.twist": dyn.twist(model, q, v)}, after

    def derivative(self, at: Point) -> Derivative:
        """The map and its derivative at a point."""
        states, ins = self.state_coordinates, self.input_coordinates
        N, count = len(states), len(states) + len(ins)
        blocks = (self.tangent.inputs, self.tangent.parameters, self.tangent.memory)
        inputs, parameters, memory = (np.zeros((count, block.size)) for block in blocks)
        for rows, flat in zip((inputs, parameters, memory), (at.inputs, at.parameters, at.memory), strict=True):
            rows[:, : len(flat)] = flat  # without a direction
        memory[:N, self.memory.size :] = states.basis(at.memory)
        inputs[N:, self.inputs.size :] = ins.basis(at.inputs)
        out, new = self.tangent.rows(inputs, parameters, memory)
        after = new[0, : self.memory.size]
        moved = states.read(after, new[:, self.memory.size :]).T
        views = self.tangent.outputs.views(out)
        shown = self.outputs.pack({path: views[path][0] for path in OUTPUTS})
        ways = np.hstack([views[TANGENT + path].reshape(count, -1) for path in OUTPUTS])
        seen = self.output_coordinates.read(shown, ways).T
        return Derivative(
            at=at, A=moved[:, :N], B=moved[:, N:], C=seen[:, :N], D=seen[:, N:],
            residual=states.difference(after, at.memory), memory=after, record=out[0],
        )  # fmt: skip

    def recorded(self, found: Derivative) -> Mapping[str, Float64Array]:
        """What the tick of a derivative records, by column."""
        return {p: x for p, x in self.tangent.outputs.views(found.record).items() if not p.startswith(TANGENT)}


PeriodMap = Period | LoopMap
_MAPS: Final[WeakKeyDictionary[Loop, LoopMap]] = WeakKeyDictionary()


def loop_map(loop: Loop) -> LoopMap:
    """The map of a loop, compiled once however often it is asked for."""
    instance_of("loop", loop, Loop, "a taut.Loop(ctrl, plant, ref, duration=...)")
    if loop not in _MAPS:
        _MAPS[loop] = LoopMap(loop)
    return _MAPS[loop]


def start_of(
    loop: Loop,
    inputs: Block,
    parameters: Block,
    q: Float64Array,  # (n,) [rad | m]
    ref: Reference,
    changes: Mapping[str, Any] = EMPTY,  # of its parameters
) -> tuple[Block, Point]:
    """The memory's block and the start at rest, the reference held: no quantisation, noise or disturbance."""
    rows, side = np.zeros((1, inputs.size)), loop.side
    feed = ReferenceFeed(ref, side.law.reference, side.arm, loop.dt, side.at_rest(q))
    feed.fill(subtree(inputs.views(rows), "ref"), 0, lambda: None)
    steps = {path: np.zeros(shape) for path, shape in parameters.shapes.items() if path.endswith(RESOLUTION)}
    values = parameters.pack({**loop.parameters, **changes, **steps, DT: loop.dt})
    memory = loop.start(q, np.zeros_like(q), inputs.views(rows[0]), parameters.views(values))
    block = Block.of({path: np.shape(value) for path, value in memory.items()})
    return block, Point(inputs=rows[0], parameters=values, memory=block.pack(memory))


def beside(map_: PeriodMap, at: Point, states: Iterable[int]) -> tuple[Derivative, Derivative]:
    """The derivatives at two points, to either side of a point in some states."""
    coordinates = map_.state_coordinates
    values, which = coordinates.numbers(at.memory), list(states)
    by = np.zeros(len(coordinates))
    by[which] = BESIDE * (1.0 + np.abs(values[which])) * np.cos(np.arange(len(which)))
    places = (coordinates.moved(at.memory, change) for change in (by, -by))
    one, other = (map_.derivative(dataclasses.replace(at, memory=memory)) for memory in places)
    return one, other


def mean_of(found: Derivative, sides: tuple[Derivative, Derivative]) -> Derivative:
    """The mean of the derivatives beside a point that has none, as where a law takes the length of a zero error."""
    means = {name: 0.5 * (getattr(sides[0], name) + getattr(sides[1], name)) for name in "ABCD"}
    return dataclasses.replace(found, **means)


def finite_derivative(map_: PeriodMap, at: Point) -> Derivative:
    """The derivative at a point, or beside it where it is not finite there; RangeError names a state without one."""
    found, names = map_.derivative(at), map_.state_coordinates.names
    if not all(np.isfinite(x).all() for x in (found.A, found.B, found.C, found.D)):
        found = mean_of(found, beside(map_, at, range(len(names))))
    wrong = ~np.isfinite(np.column_stack([found.residual, found.A, found.B])).all(axis=1)
    if wrong.any():
        name = names[int(np.argmax(wrong))]
        raise RangeError(
            f"the loop has no derivative here: '{name}' after a period, or how it depends on the others, is not "
            "finite; linearise at another pose",
            name=name,
        )
    return found


PARTS_OF_MODEL: Final = ("friction", "actuation", "sensors", "integrator")


def model_in_place_of(plant: AnyPlant, side: LawSide) -> RigidPlant:
    """The same arm, with friction, drives and sensors where they are known, in place of an engine or a robot.

    A robot moves exactly under a command that is held, an engine in its steps. The loop in motors that take a
    MitCommand runs in each step of an engine; else at what the drives state, or fast.
    """
    ideal = RigidPlant(plant.arm, adds=plant.adds)
    stages = {name: getattr(plant, name, getattr(ideal, name)) for name in PARTS_OF_MODEL}
    if side.probe.mit:
        rate = stages["actuation"].inner_rate
        steps = INNER_STEPS if rate is None else max(1, round(float(rate) * side.dt))
        stages["substeps"] = plant.steps_in(side.dt) if isinstance(plant, Stepping) else steps
    wrench = "F_ext" in side.needs or stages["sensors"].wrench is not None
    takes = cast(CommandKind, plant.takes)
    return dataclasses.replace(ideal, **stages, takes=takes, environment=Push(peak=np.zeros(6)) if wrench else None)


class BlockCoordinates:
    """Small changes of a block: one for each entry, three (world rotation vector) for each rotation R (3, 3)."""

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
