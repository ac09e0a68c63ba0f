"""A sine sweep at the tool in simulation: a force that holds from tick to tick, and what the tool makes of it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.codegen.coordinates import small_turns
from taut.codegen.loop import StepLoop
from taut.linear.frequency import Complex
from taut.linear.linear_loop import LinearLoop
from taut.linear.linearise import WITHIN, rest_of
from taut.linear.loop_map import loop_map
from taut.loop import Loop
from taut.plant.disturbance import WRENCH

__all__ = ["swept"]

PERIODS: Final = 4  # that are fitted
LEFT: Final = 1e-5  # of what a force sets off at first, when the fit begins
BLOCK: Final = 4096  # ticks between two visits of Python
MOST: Final = 2_000_000  # ticks of one run
SLOW: Final = 1.0 - 1e-9  # a pole of this modulus does not die out


def swept(loop: Loop, lin: LinearLoop, direction: Float64Array, omega: Float64Array, sizes: Float64Array) -> Complex:
    """(k,) X / F along a direction, by runs of the loop itself.

    Args:
        loop: The loop.
        lin: Its linear model: the runs begin at its equilibrium, and have settled by its slowest pole.
        direction: (6,) unit vector.
        omega: (k,) [rad/s].
        sizes: (k,) of the force [N | N m].

    Raises:
        RangeError: A run that would be too long, or that diverged.
    """
    map_ = loop_map(loop)
    # What is held is the start of the model's own search, not where a law that sags came to rest.
    within = WITHIN + float(np.abs(lin.moved).max())
    point = rest_of(loop, map_, lin.q - lin.moved, within).point
    made = StepLoop(map_.period, (point.inputs, point.parameters, point.memory), engine=loop.engine)
    dying = np.abs(lin.poles)[np.abs(lin.poles) < SLOW]
    settling = math.ceil(math.log(LEFT) / math.log(dying.max(initial=0.5)))
    first = map_.recorded(map_.derivative(point))
    out = np.zeros(len(omega), dtype=np.complex128)
    for i, (w, size) in enumerate(zip(omega, sizes, strict=True)):
        fitted = math.ceil(PERIODS * 2.0 * math.pi / (w * lin.dt))
        count = settling + fitted
        if count > MOST:
            raise RangeError(
                f"a sweep at {w:.3g} rad/s would take {count * lin.dt:.3g} s of simulation, and {MOST * lin.dt:g} s "
                "is the most; ask for higher frequencies, or damp what is slow in the loop",
                name="omega",
                value=float(w),
            )
        wave = size * np.exp(1j * w * lin.dt * np.arange(count))
        memory, moved = point.memory.copy(), np.zeros(count)
        for k in range(0, count, BLOCK):
            some = wave[k : k + BLOCK]
            rows, record = np.tile(point.inputs, (len(some), 1)), np.zeros((len(some), made.outputs.size))
            map_.inputs.views(rows)[WRENCH][...] = some.imag[:, np.newaxis] * direction
            if made.run(rows, point.parameters, memory, record) < len(some):
                raise RangeError(f"the run of the sweep at {w:.3g} rad/s diverged", name="omega", value=float(w))
            views = made.outputs.views(record)
            tool = np.hstack([views["tip.p"] - first["tip.p"], small_turns(views["tip.R"] @ first["tip.R"].T)])
            moved[k : k + BLOCK] = tool @ direction
        late = wave[settling:]
        basis = np.stack([late.imag, late.real, np.ones(len(late))], axis=1)
        along, across, _ = np.linalg.lstsq(basis, moved[settling:], rcond=None)[0]
        out[i] = along + 1j * across
    return out
