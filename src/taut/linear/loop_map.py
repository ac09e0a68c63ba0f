"""A loop as a map from one tick to the next, with its exact derivative, in coordinates that have names."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from taut.base.errors import RangeError, UsageError, unknown_name
from taut.base.paths import subtree
from taut.base.types import Float64Array, Vector
from taut.codegen.coordinates import BlockCoordinates
from taut.codegen.engine import Engine, Steps
from taut.codegen.layout import Block
from taut.codegen.tangent import TANGENT, StepTangent, tangent_block
from taut.control.trajectories.feed import ReferenceFeed
from taut.loop import DT, Loop, Values
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.plant.disturbance import COMMAND, disturbance_shapes
from taut.plant.rigid import RigidPlant

__all__ = [
    "Derivative",
    "LoopMap",
    "Point",
    "beside",
    "finite_derivative",
    "loop_map",
    "starting",
]

OUTPUTS: Final = ("q", "v", "tip.p", "tip.R", "tip.twist", "command")
STEPS: Final = ".resolution"
BESIDE: Final = 1e-7  # of a state's size: how far beside a point without a derivative one is taken


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """Where a loop is in a tick."""

    inputs: Float64Array
    parameters: Float64Array
    memory: Float64Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Derivative:
    """The derivative of a loop's map at a point, in all its coordinates; and the map itself."""

    A: Float64Array
    B: Float64Array
    C: Float64Array
    D: Float64Array
    residual: Float64Array  # (states,) what a period changes
    memory: Float64Array  # after the period
    record: Float64Array  # all that the tick records


class LoopMap:
    """The map of a loop from the memory in one tick to that in the next, compiled with its derivative.

    Steps of encoders and amplifiers count by their mean slope, which is one: they are left out.

    Args:
        loop: The loop.
        with_respect_to: Paths of parameters that are inputs too.

    Raises:
        UsageError: A task of phases.
        UnknownNameError: No such parameter.
    """

    def __init__(self, loop: Loop, with_respect_to: tuple[str, ...] = ()) -> None:
        side, plant = loop.side, loop.plant
        if side.task is not None:
            raise UsageError(
                "a task of phases has no one linear model: which law acts, and with what reference, changes with its "
                "guards; make a taut.Loop with the law and the reference of the phase that is wanted",
                name="loop",
            )
        self.steps = tuple(path for path in loop.parameters if path.endswith(STEPS))
        for path in with_respect_to:
            if path not in loop.parameters:
                raise unknown_name("the loop", "parameter", path, loop.parameters)
            if path in self.steps:
                raise UsageError(
                    f"steps count by their mean slope in a linear model, so that {path} has no effect; leave it out "
                    "of with_respect_to",
                    name=path,
                )
        self.side, self.engine, self.dt = side, loop.engine, loop.dt  # and not the loop, which may go
        self.plant = _without_steps(plant)
        self._stepped = Loop(_Side(side, side.parameters, loop.engine), self.plant, loop.ref, duration=loop.duration)
        shapes = loop.input_shapes()
        pushes = disturbance_shapes(side.arm.n)
        if not isinstance(plant, RigidPlant):
            pushes = {COMMAND: pushes[COMMAND]}  # what it does of the others is not known
        self.inputs = Block.of(shapes | pushes)
        self.parameters = Block.of({p: s for p, s in loop.parameter_shapes().items() if p not in self.steps})
        self._wrt = with_respect_to
        self._tangent: StepTangent | None = None
        moving = [path for path in self.inputs.shapes if path != "t"]
        self.input_coordinates = BlockCoordinates(self.inputs, moving)
        self.parameter_coordinates = BlockCoordinates(self.parameters, with_respect_to)
        self.input_names = (*self.input_coordinates.names, *self.parameter_coordinates.names)

    # ---------------------------------------------------------------- a point

    def values(self, parameters: Values) -> Float64Array:
        """The parameters of a loop, flat."""
        return self.parameters.pack({**parameters, DT: self.dt})

    def start(self, q: Vector, v: Vector, inputs: Float64Array, values: Float64Array) -> Float64Array:
        """The memory in the first tick."""
        views, numbers = self.inputs.views(inputs), self.parameters.views(values)
        memory = self._stepped.start(q, v, views, numbers)
        shapes = {path: np.shape(value) for path, value in memory.items()}
        if self._tangent is None:
            self._compile(Block.of(shapes))
        return self.memory.pack(memory)

    def _compile(self, memory: Block) -> None:
        self.memory = memory
        self.state_coordinates = BlockCoordinates(memory)
        self.period = Steps(self.step, self.inputs, self.parameters, memory, self.substep, self.plant.substeps - 1)
        self.tangent = self._tangent = StepTangent(
            self.period, directed=self._wrt, outputs=OUTPUTS, engine=self.engine
        )
        self.outputs = Block.of({path: self.tangent.outputs.shapes[path] for path in OUTPUTS})
        self.output_coordinates = BlockCoordinates(self.outputs)

    def step(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """A period, with where the tool is in its first instant."""
        record, after = self._stepped.step(inputs, parameters, memory)
        model, q, v = model_of(self.plant.arm), memory["plant.q"], memory["plant.v"]
        T = dyn.pose(model, q)
        return {**record, "tip.p": T.p, "tip.R": T.R, "tip.twist": dyn.twist(model, q, v)}, after

    def substep(self, inputs: Values, parameters: Values, memory: Values) -> tuple[dict[str, Any], dict[str, Any]]:
        """What is left of a period, part by part."""
        return self._stepped.substep(inputs, parameters, memory)

    # ---------------------------------------------------------------- the map

    def derivative(self, at: Point) -> Derivative:
        """The map and its derivative at a point."""
        states, ins, numbers = self.state_coordinates, self.input_coordinates, self.parameter_coordinates
        N, m, p = len(states), len(ins), len(numbers)
        inputs, parameters, memory = (
            _repeated(block, flat, N + m + p)
            for block, flat in (
                (self.tangent.inputs, at.inputs),
                (self.tangent.parameters, at.parameters),
                (self.tangent.memory, at.memory),
            )
        )
        memory[:N, self.memory.size :] = states.basis(at.memory)
        inputs[N : N + m, self.inputs.size :] = ins.basis(at.inputs)
        directed = tangent_block(self.parameters, self._wrt)
        for path in self._wrt:
            field, way = self.parameters.field(path), directed.field(f"{TANGENT}{path}")
            parameters[N + m :, way.offset : way.offset + way.size] = numbers.basis(at.parameters)[
                :, field.offset : field.offset + field.size
            ]
        out, new = self.tangent.rows(inputs, parameters, memory)
        after = new[0, : self.memory.size]
        moved = states.read(after, new[:, self.memory.size :]).T
        views = self.tangent.outputs.views(out)
        shown = self.outputs.pack({path: views[path][0] for path in OUTPUTS})
        ways = np.zeros((N + m + p, self.outputs.size))
        for path in OUTPUTS:
            field = self.outputs.field(path)
            ways[:, field.offset : field.offset + field.size] = views[TANGENT + path].reshape(N + m + p, -1)
        seen = self.output_coordinates.read(shown, ways).T
        return Derivative(
            A=moved[:, :N], B=moved[:, N:], C=seen[:, :N], D=seen[:, N:],
            residual=states.difference(after, at.memory), memory=after, record=out[0],
        )  # fmt: skip

    def after(self, at: Point, memories: Float64Array) -> Float64Array:
        """(k, size) the memory after a period from k memories, with the inputs and parameters of a point."""
        rows = [
            _repeated(block, flat, len(memories))
            for block, flat in (
                (self.tangent.inputs, at.inputs),
                (self.tangent.parameters, at.parameters),
                (self.tangent.memory, at.memory),
            )
        ]
        rows[2][:, : self.memory.size] = memories
        _, new = self.tangent.rows(*rows)
        return np.asarray(new[:, : self.memory.size])

    def recorded(self, found: Derivative) -> Mapping[str, Float64Array]:
        """What the tick of a derivative records, by column."""
        return {p: x for p, x in self.tangent.outputs.views(found.record).items() if not p.startswith(TANGENT)}


def _repeated(block: Block, flat: Float64Array, count: int) -> Float64Array:
    rows = np.zeros((count, block.size))
    rows[:, : len(flat)] = flat
    return rows


@dataclass(frozen=True)
class _Side:
    """A controller as a loop takes it."""

    side: Any
    parameters: Mapping[str, Float64Array]
    engine: Engine


def _without_steps(plant: Any) -> Any:
    """The plant without the steps of its amplifiers; those of sensors go with their parameters."""
    if isinstance(plant, RigidPlant) and plant.actuation.resolution is not None:
        return dataclasses.replace(plant, actuation=dataclasses.replace(plant.actuation, resolution=None))
    return plant


_MAPS: Final[WeakKeyDictionary[Loop, dict[tuple[str, ...], LoopMap]]] = WeakKeyDictionary()


def loop_map(loop: Loop, with_respect_to: Iterable[str] = ()) -> LoopMap:
    """The map of a loop, compiled once however often it is asked for.

    Raises:
        UsageError: Not a loop, or not paths.
    """
    if not isinstance(loop, Loop):  # callers without a type checker
        raise UsageError(
            f"a taut.Loop(ctrl, plant, ref, duration=...) is needed; got {type(loop).__name__}", name="loop"
        )
    named = (with_respect_to,) if isinstance(with_respect_to, str) else with_respect_to
    paths = tuple(named) if isinstance(named, Iterable) else (named,)
    if not all(isinstance(path, str) for path in paths):
        raise UsageError(
            f"with_respect_to takes paths of parameters, such as ('law.kp',); got {with_respect_to!r}",
            name="with_respect_to",
        )
    wanted = tuple(dict.fromkeys(paths))
    known = _MAPS.setdefault(loop, {})
    if wanted not in known:
        known[wanted] = LoopMap(loop, wanted)
    return known[wanted]


def starting(loop: Loop, map_: LoopMap, q: Float64Array) -> Point:
    """Where a loop begins from rest at joint positions (n,), in the sample of its reference there.

    Raises:
        RangeError: It may not start there.
    """
    side, values = loop.side, map_.values(loop.parameters)
    side.check_start(q, {**loop.parameters, DT: loop.dt}, loop.ref)
    inputs = np.zeros((1, map_.inputs.size))
    feed = ReferenceFeed(loop.ref, side.law.reference, side.arm, loop.dt, side.at_rest(q))
    feed.fill(subtree(map_.inputs.views(inputs), "ref"), 0, lambda: None)
    memory = map_.start(q, np.zeros_like(q), inputs[0], values)
    return Point(inputs=inputs[0], parameters=values, memory=memory)


def beside(map_: LoopMap, at: Point, found: Derivative, states: Iterable[int]) -> Derivative:
    """The mean derivative of two points a little to either side, for one that itself has none.

    So it is where a law takes the length of an error that is zero, or compares two energies that are.
    """
    coordinates = map_.state_coordinates
    values, which = coordinates.read(at.memory, at.memory[np.newaxis])[0], list(states)
    by = np.zeros(len(coordinates))
    by[which] = BESIDE * (1.0 + np.abs(values[which])) * np.cos(np.arange(len(which)))
    places = (coordinates.moved(at.memory, way) for way in (by, -by))
    one, other = (map_.derivative(dataclasses.replace(at, memory=memory)) for memory in places)
    means = {name: 0.5 * (getattr(one, name) + getattr(other, name)) for name in "ABCD"}
    return dataclasses.replace(found, **means)


def finite_derivative(map_: LoopMap, at: Point) -> Derivative:
    """The derivative at a point; beside it, where it is not finite there.

    Raises:
        RangeError: Nor is it there.
    """
    found = map_.derivative(at)
    if not all(np.isfinite(x).all() for x in (found.A, found.B, found.C, found.D)):
        found = beside(map_, at, found, range(len(map_.state_coordinates)))
    _require_finite(found, map_.state_coordinates.names)
    return found


def _require_finite(found: Derivative, names: tuple[str, ...]) -> None:
    """Refuse a map, or a derivative of it, that is not finite.

    Raises:
        RangeError: It is not; the message names a state.
    """
    for matrix in (found.residual[np.newaxis].T, found.A, found.B):
        wrong = ~np.isfinite(matrix).all(axis=1)
        if wrong.any():
            name = names[int(np.argmax(wrong))]
            raise RangeError(
                f"the loop has no derivative here: '{name}' after a period, or how it depends on the others, is not "
                "finite; linearise at another pose",
                name=name,
            )
