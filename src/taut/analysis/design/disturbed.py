"""Runs of a loop from a point at which it rests: under an unknown force, or after a step of its reference."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.codegen.loop import StepLoop
from taut.linear.loop_map import Point, loop_map
from taut.loop import Loop

__all__ = ["disturbed", "runs_from"]


def runs_from(loop: Loop, start: Point, inputs: Sequence[Float64Array], ticks: int) -> list[dict[str, Float64Array]]:
    """What the loop records in runs from one point, each of so many ticks with inputs that stay.

    Raises:
        RangeError: A run that diverges.
    """
    map_ = loop_map(loop)
    rows = np.tile(start.inputs, (ticks, 1))
    made = StepLoop(map_.period, (rows[0], start.parameters, start.memory), engine=loop.engine)
    seen = []
    for each in inputs:
        rows[:] = each
        map_.inputs.views(rows)["t"][...] = np.arange(ticks) * loop.dt
        memory, record = start.memory.copy(), np.zeros((ticks, made.outputs.size))
        if made.run(rows, start.parameters, memory, record) < ticks:
            raise RangeError("a run diverged under a small step or force", name="loop")
        seen.append(made.outputs.views(record))
    return seen


def disturbed(loop: Loop, start: Point, path: str, values: Float64Array, ticks: int) -> list[dict[str, Float64Array]]:
    """The same of a run without a disturbance, and with each `values[k]` of one of `taut.plant.disturbance`."""
    inputs = np.tile(start.inputs, (1 + len(values), 1))
    loop_map(loop).inputs.views(inputs)[path][1:] = values
    return runs_from(loop, start, list(inputs), ticks)
