"""Runs of a loop that something from outside acts on from the first tick, such as an unknown force."""

from __future__ import annotations

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.codegen.loop import FloatLoop, NativeLoop
from taut.loop import Loop
from taut.study.loop_map import loop_map, starting

__all__ = ["disturbed"]


def disturbed(
    loop: Loop, q: Float64Array, path: str, values: Float64Array, ticks: int
) -> list[dict[str, Float64Array]]:
    """What the loop records in a run from rest without a disturbance, and in one with each of them.

    Args:
        loop: The loop, whose reference is a sample that stays.
        q: (n,) where the runs start [rad | m].
        path: Which disturbance, of `taut.plant.disturbance`.
        values: (k, m) of it, each held through its run.
        ticks: Of each run.

    Raises:
        RangeError: A run that diverges.
    """
    map_ = loop_map(loop)
    start = starting(loop, map_, q)
    rows, numbers = np.tile(start.inputs, (ticks, 1)), start.parameters
    views = map_.inputs.views(rows)
    views["t"][...] = np.arange(ticks) * loop.dt
    kind = NativeLoop if loop.engine == "native" else FloatLoop
    blocks = (map_.inputs, map_.parameters, map_.memory)
    made = kind(map_.step, map_.substep, map_.plant.substeps - 1, *blocks, (rows[0], numbers, start.memory))
    seen = []
    for value in (np.zeros_like(values[0]), *values):
        views[path][...] = value
        memory, record = start.memory.copy(), np.zeros((ticks, made.outputs.size))
        if made.run(rows, numbers, memory, record) < ticks:
            raise RangeError(f"a run with a {path.replace('.', ' of ')} diverged", name=path)
        seen.append(made.outputs.views(record))
    return seen
