"""The exact derivative of a control period, by automatic differentiation of the loop's program."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from taut.base.errors import RangeError, UsageError, unknown_name
from taut.base.types import Float64Array, Vector
from taut.codegen.engine import Steps
from taut.codegen.layout import Block
from taut.codegen.tangent import TANGENT, StepTangent, tangent_block
from taut.linear.period import (
    RESOLUTION,
    BlockCoordinates,
    Derivative,
    PeriodMap,
    Point,
    Side,
    held_reference,
    smooth_plant,
)
from taut.loop import DT, Loop, Values
from taut.maths import dynamics as dyn
from taut.maths.model import model_of
from taut.plant.environments.environment import COMMAND, disturbance_shapes
from taut.plant.rigid import RigidPlant

__all__ = ["LoopMap", "beside", "finite_derivative", "loop_map", "starting"]

OUTPUTS: Final = ("q", "v", "tip.p", "tip.R", "tip.twist", "command")
BESIDE: Final = 1e-7  # [-] of a state's size: distance of a derivative beside a point that has none


class LoopMap(PeriodMap):
    """One control period of a loop, compiled with its exact derivative.

    Quantisation of encoders and amplifiers counts by its mean slope, which is one: it is left out.

    Args:
        loop: The loop.
        with_respect_to: Paths of parameters that are inputs too.

    Raises:
        UsageError: A task of phases.
        UnknownNameError: No such parameter.
    """

    tolerance, rest = 0.0, 1e-13

    def __init__(self, loop: Loop, with_respect_to: tuple[str, ...] = ()) -> None:
        side, plant = loop.side, loop.plant
        if side.task is not None:
            raise UsageError(
                "a task of phases has no one linear model: which law acts, and with what reference, changes with its "
                "guards; make a taut.Loop with the law and the reference of the phase that is wanted",
                name="loop",
            )
        self.steps = tuple(path for path in loop.parameters if path.endswith(RESOLUTION))
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
        self.plant = smooth_plant(plant, side.needs) if self.steps else plant
        self._stepped = Loop(Side(side, side.parameters, loop.engine), self.plant, loop.ref, duration=loop.duration)
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
    """The start of a loop at rest at joint positions (n,), in the sample of its reference there.

    Raises:
        RangeError: It may not start there.
    """
    loop.side.check_start(q, {**loop.parameters, DT: loop.dt}, loop.ref)
    inputs, values = held_reference(loop, map_.inputs, q, loop.ref), map_.values(loop.parameters)
    memory = map_.start(q, np.zeros_like(q), inputs, values)
    return Point(inputs=inputs, parameters=values, memory=memory)


def beside(map_: LoopMap, at: Point, found: Derivative, states: Iterable[int]) -> Derivative:
    """The mean derivative of two points on either side, for a point that itself has none.

    A law that takes the length of an error that is zero, or compares two energies that are, has such a point.
    """
    coordinates = map_.state_coordinates
    values, which = coordinates.numbers(at.memory), list(states)
    by = np.zeros(len(coordinates))
    by[which] = BESIDE * (1.0 + np.abs(values[which])) * np.cos(np.arange(len(which)))
    places = (coordinates.moved(at.memory, change) for change in (by, -by))
    one, other = (map_.derivative(dataclasses.replace(at, memory=memory)) for memory in places)
    means = {name: 0.5 * (getattr(one, name) + getattr(other, name)) for name in "ABCD"}
    return dataclasses.replace(found, **means)


def finite_derivative(map_: PeriodMap, at: Point) -> Derivative:
    """The derivative at a point; beside it, where it is not finite there.

    Raises:
        RangeError: Nor is it there; the message names a state.
    """
    found, names = map_.derivative(at), map_.state_coordinates.names
    if isinstance(map_, LoopMap) and not all(np.isfinite(x).all() for x in (found.A, found.B, found.C, found.D)):
        found = beside(map_, at, found, range(len(names)))
    for matrix in (found.residual[np.newaxis].T, found.A, found.B):
        wrong = ~np.isfinite(matrix).all(axis=1)
        if wrong.any():
            name = names[int(np.argmax(wrong))]
            raise RangeError(
                f"the loop has no derivative here: '{name}' after a period, or how it depends on the others, is not "
                "finite; linearise at another pose",
                name=name,
            )
    return found
