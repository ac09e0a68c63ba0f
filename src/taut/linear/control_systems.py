"""Systems of python-control: the one place that knows that library."""

from __future__ import annotations

from typing import Any

import numpy as np

from taut.base.errors import UsageError, missing_extra
from taut.base.types import Float64Array

__all__ = ["read", "state_space", "transfer_function"]


def _control() -> Any:
    try:
        import control
    except ImportError as cause:
        raise missing_extra("a system of python-control", "control", "control") from cause
    return control


def transfer_function(numerator: Float64Array, denominator: Float64Array) -> Any:
    """`control.TransferFunction` of s."""
    return _control().tf(numerator.tolist(), denominator.tolist())


def state_space(A: Float64Array, B: Float64Array, C: Float64Array, dt: float) -> Any:
    """`control.StateSpace` with a period [s] and without a direct way."""
    return _control().ss(A, B, C, np.zeros((C.shape[0], B.shape[1])), dt)


def read(system: Any) -> tuple[Float64Array, Float64Array]:
    """Numerator and denominator of a system in continuous time, from the highest power down."""
    control = _control()
    if not isinstance(system, (control.TransferFunction, control.StateSpace)):
        raise UsageError(
            f"a system is a control.TransferFunction or a control.StateSpace; got {type(system).__name__}",
            name="system",
        )
    if system.dt not in (None, 0):
        raise UsageError(
            f"error dynamics are in continuous time, and this system has the period {system.dt!r}; "
            f"taut.analysis.locus and "
            "taut.analysis.stability_map take it as it is",
            name="system",
        )
    if (system.ninputs, system.noutputs) != (1, 1):
        raise UsageError(
            f"a closed loop from desired to actual position has one input and one output; this has {system.ninputs} "
            f"and {system.noutputs}; take one: system[0, 0]",
            name="system",
        )
    made = control.tf(system)
    numerator, denominator = np.trim_zeros(made.num[0][0], "f"), np.trim_zeros(made.den[0][0], "f")
    if len(numerator) > len(denominator) or len(denominator) < 2:
        raise UsageError(
            f"a closed loop has poles, and no more zeros than these; got {len(denominator) - 1} poles and "
            f"{len(numerator) - 1} zeros",
            name="system",
        )
    return np.asarray(numerator, dtype=np.float64), np.asarray(denominator, dtype=np.float64)
