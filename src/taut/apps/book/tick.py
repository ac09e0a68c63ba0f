"""One tick of a law on plain floats, and what is read off runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.arm.description import Arm
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.control.reference import Sample
from taut.controller import Controller, compile

__all__ = ["one_pole", "rms", "ticked", "total", "two_poles"]


def ticked(law: Law, arm: Arm, q: ArrayLike, v: ArrayLike, ref: Sample, **measured: ArrayLike) -> Controller:
    """A controller after one tick at 1 kHz, not compiled: `terms` has what it asked for, `memory` what it keeps."""
    ctrl = compile(law, arm, rate=1000.0, engine="float")
    ctrl.step(q, v, ref, **measured)
    return ctrl


def total(terms: Mapping[str, Float64Array]) -> float:
    """What the terms of a single joint add up to."""
    return float(sum(each[0] for each in terms.values()))


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
