"""The response of one joint to a step: overshoot, settling time, steady-state error.

The error starts at e0 and tends to e_ss. With y = (e - e_ss) / (e0 - e_ss), which starts at 1 and tends to 0:

    overshoot           = -min(y)
    settling time       = the last time at which |y| = 0.02
    steady-state error  = e_ss / e0

An under-damped second-order system overshoots by exp(-pi zeta / sqrt(1 - zeta^2)).

These are the chapter's definitions, which take e0 = 1 (section 10.2.1.1, figure 10.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.types import Float64Array

__all__ = ["StepResponse", "step_response"]

BAND: Final = 0.02  # of the step: the chapter's 2 %
RESOLUTION: Final = 1e-6  # [rad | m] an initial error below this is none
TAIL: Final = 0.02  # of the run: its mean is the steady state
DRIFT: Final = 0.1 * BAND  # what moves more than this during the last tenth of the run has not come to rest


@dataclass(frozen=True, kw_only=True)
class StepResponse:
    """NaN where the joint had no step to answer."""

    overshoot: float = np.nan  # [%]
    settling_time: float = np.nan  # [s]; inf if it did not come to rest
    steady_state_error: float = np.nan  # [%]


def step_response(t: Float64Array, error: Float64Array) -> StepResponse:
    """Overshoot, settling time and steady-state error of one joint.

    Args:
        t: (k,) [s].
        error: (k,) wanted minus true [rad | m], for a constant reference.
    """
    if abs(error[0]) < RESOLUTION or not np.isfinite(error).all():
        return StepResponse()
    e = error / error[0]
    tail = max(1, round(TAIL * len(e)))
    e_ss = float(np.mean(e[-tail:]))
    left = StepResponse(steady_state_error=100.0 * e_ss)
    if abs(1.0 - e_ss) < BAND:  # it never left: there is no way that it could have gone too far
        return left
    y = (e - e_ss) / (1.0 - e_ss)
    before = min(round(0.9 * len(y)), len(y) - 1)
    at_rest = abs(float(np.mean(y[before : before + tail]))) <= DRIFT
    return StepResponse(
        overshoot=100.0 * max(0.0, -_minimum(y)),
        settling_time=_last_crossing(t, y) if at_rest else np.inf,
        steady_state_error=left.steady_state_error,
    )


def _minimum(y: Float64Array) -> float:
    """The least value, between the ticks too: the vertex of the parabola through the lowest three."""
    k = int(np.argmin(y))
    if not 0 < k < len(y) - 1:
        return float(y[k])
    slope, bend = 0.5 * (y[k + 1] - y[k - 1]), y[k + 1] - 2.0 * y[k] + y[k - 1]
    return float(y[k] - 0.5 * slope**2 / bend) if bend > 0.0 else float(y[k])


def _last_crossing(t: Float64Array, y: Float64Array) -> float:
    """Time since the start of the last crossing of the band, linear between two ticks."""
    outside = np.flatnonzero(np.abs(y) > BAND)
    if not outside.size:
        return 0.0
    k = int(outside[-1])
    if k + 1 == len(y):
        return np.inf
    inwards = abs(float(y[k] - y[k + 1]))
    into = (abs(float(y[k])) - BAND) / inwards
    return float(t[k] + into * (t[k + 1] - t[k]) - t[0])
