"""A sine sweep in simulation: the impedance at the tool, measured, with nothing of the linear model in it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

import taut
from taut.codegen.loop import StepLoop
from taut.linear.linearise import WITHIN, rest_of
from taut.linear.period import loop_map, small_rotations
from taut.plant.environments.environment import WRENCH

__all__ = ["measured_Z"]

AMPLITUDE = 1e-4  # [m | rad] of the tool
PERIODS = 4  # that are fitted
TRANSIENT = 1e-5  # of the transient at the start, when the fit begins
NO_DECAY = 1.0 - 1e-9  # modulus of a pole that does not decay


def measured_Z(tip: taut.analysis.ToolImpedance, omega: ArrayLike) -> NDArray[np.complex128]:
    """(k,) F / X of runs under a force that is held from tick to tick, fitted over whole periods."""
    loop, lin, w = tip.loop, tip.lin, np.atleast_1d(np.asarray(omega, dtype=float))
    map_ = loop_map(loop)
    # The reference is held at the start of the model's own search, not where a law with a steady-state error rests.
    within = WITHIN + float(np.abs(lin.point.moved).max())
    point = rest_of(loop, map_, lin.point.q - lin.point.moved, within).at
    period = StepLoop(map_.period, (point.inputs, point.parameters, point.memory), engine=loop.engine)
    rest = map_.recorded(map_.derivative(point))
    decaying = np.abs(lin.poles)[np.abs(lin.poles) < NO_DECAY]
    settling = math.ceil(math.log(TRANSIENT) / math.log(decaying.max(initial=0.5)))
    Z = np.abs(tip.Z(w))
    out = np.zeros(len(w), dtype=np.complex128)
    for i, amplitude in enumerate(np.where(np.isfinite(Z), AMPLITUDE * Z, 1.0)):
        count = settling + math.ceil(PERIODS * 2.0 * math.pi / (w[i] * lin.period))
        wave = amplitude * np.exp(1j * w[i] * lin.period * np.arange(count))
        rows, record = np.tile(point.inputs, (count, 1)), np.zeros((count, period.outputs.size))
        map_.inputs.views(rows)[WRENCH][...] = wave.imag[:, np.newaxis] * tip.direction
        assert period.run(rows, point.parameters, point.memory.copy(), record) == count
        views = period.outputs.views(record)
        rotation = small_rotations(views["tip.R"] @ rest["tip.R"].T)
        moved = np.hstack([views["tip.p"] - rest["tip.p"], rotation])[settling:] @ tip.direction
        late = wave[settling:]
        basis = np.stack([late.imag, late.real, np.ones(len(late))], axis=1)
        in_phase, quadrature, _ = np.linalg.lstsq(basis, moved, rcond=None)[0]
        out[i] = np.inf if in_phase == quadrature == 0.0 else 1.0 / (in_phase + 1j * quadrature)
    return out
