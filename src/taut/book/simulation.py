"""Runs of a law, one tick of it on plain floats, and what is read off them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.control.trajectories.reference import Sample
from taut.controller import Controller, compile
from taut.loop import Loop
from taut.plant.rigid import RigidPlant
from taut.record.run import Run
from taut.runtime.simulate import run

__all__ = ["looped", "one_pole", "rms", "simulated", "ticked", "total", "two_poles"]


def looped(
    law: Law | Controller,
    arm: Arm,
    ref: object = None,
    *,
    rate: float = 1000.0,
    plant: Arm | None = None,
    duration: float = 1.0,
    **options: Any,
) -> Loop:
    """A law for an arm on a rigid plant of the same arm or another, without friction if no more is said."""
    ctrl = law if isinstance(law, Controller) else compile(law, arm, rate=rate)
    return Loop(ctrl, RigidPlant(plant or arm, **{"friction": None, **options}), ref, duration=duration)


def simulated(
    law: Law | Controller,
    arm: Arm,
    ref: object = None,
    *,
    duration: float,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    rate: float = 1000.0,
    plant: Arm | None = None,
    **options: Any,
) -> Run:
    """A run of such a loop.

    Args:
        law: Or a controller of it, whose rate it then is.
        arm: What the law knows.
        ref: What it follows; hold if left out.
        duration: [s].
        q0: (n,) at the start [rad | m]; home if left out.
        v0: (n,) [rad/s | m/s]; rest if left out.
        rate: [Hz].
        plant: What there really is; `arm` if left out.
        **options: Of the `RigidPlant`.
    """
    loop = looped(law, arm, ref, rate=rate, plant=plant, duration=duration, **options)
    return run(loop, q0=q0, v0=v0, progress=False)


def ticked(law: Law, arm: Arm, q: ArrayLike, v: ArrayLike, ref: Sample, **measured: ArrayLike) -> Controller:
    """A controller after one tick at 1 kHz, not compiled: `terms` has what it asked for, `memory` what it keeps."""
    ctrl = compile(law, arm, rate=1000.0, engine="float")
    ctrl.step(q, v, ref, **measured)
    return ctrl


def total(terms: Mapping[str, Float64Array]) -> Float64Array:
    """(n,) what the terms of a law add up to [N m | N]."""
    added: Float64Array = np.sum(list(terms.values()), axis=0)
    return added


def one_pole(t: Float64Array, y: Float64Array) -> float:
    """The rate at which something dies away, by a straight line through its logarithm [1/s]."""
    return float(np.polyfit(t, np.log(np.abs(y)), 1)[0])


def two_poles(y: Any, dt: float) -> Any:
    """(2,) the poles [1/s] of y[k + 1] = a y[k] + b y[k - 1], by least squares; y (m,) may be complex."""
    a, b = np.linalg.lstsq(np.column_stack([y[1:-1], y[:-2]]), y[2:], rcond=None)[0]
    return np.log(np.roots([1.0, -a, -b]).astype(complex)) / dt


def rms(y: Float64Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(y))))
