"""Poles of whatever has some: their order, their damping, and whether they are stable, in s and in z."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import Float64Array

__all__ = ["Spectrum", "damping_ratios", "in_s", "sorted_poles", "spectrum"]

Complex = NDArray[np.complex128]
GONE: Final = 1e-12  # modulus below which a pole in z is a mere delay


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum:
    """Poles, the period they are for (None in continuous time), and whether they are stable."""

    poles: Complex
    dt: float | None
    stable: bool


def sorted_poles(poles: NDArray[Any]) -> Complex:
    """Slowest first, the upper one of a pair before the lower."""
    made = np.asarray(poles, dtype=np.complex128) + 0.0  # no -0
    return made[np.lexsort((-made.imag, -made.real))]


def damping_ratios(poles: Complex) -> Float64Array:
    """-Re(s) / abs(s) of each; 1 for what is gone at once, 0 at the origin."""
    sizes = np.abs(poles)
    ratios = np.divide(-poles.real, sizes, out=np.zeros(len(poles)), where=(sizes > 0.0) & np.isfinite(sizes))
    made: Float64Array = np.where(np.isfinite(sizes), ratios, 1.0)
    return made


def in_s(poles: Complex, dt: float) -> Complex:
    """ln(z) / dt of poles in z [1/s]: minus infinity for those at zero, at half the rate for negative ones."""
    made = np.full(len(poles), complex(-np.inf, 0.0))
    some = np.abs(poles) > GONE
    made[some] = np.log(poles[some]) / dt
    return made


def spectrum(thing: Any, dt: float | None = None) -> Spectrum:
    """The poles of error dynamics, of a loop, of a system of python-control or of a matrix.

    Args:
        thing: What has `poles` (an array, or a method that gives one), `stable` and `dt` (None or 0 in continuous
            time) as far as it knows; or a square matrix.
        dt: Period of a matrix of a sampled system [s]; None for continuous time.

    Raises:
        UsageError: It has no poles.
        ShapeError, RangeError: A matrix that is not square or not finite; a pole that is NaN.
    """
    if isinstance(thing, (np.ndarray, list, tuple)):
        matrix = np.asarray(thing)
        if (
            matrix.ndim != 2
            or matrix.shape[0] != matrix.shape[1]
            or not matrix.size
            or matrix.dtype.kind not in "fiuc"
        ):
            raise ShapeError(f"a matrix that has poles is square; got shape {matrix.shape}", name="matrix")
        bad = np.argwhere(~np.isfinite(matrix))
        if bad.size:
            i, j = bad[0].tolist()
            raise RangeError(
                f"a matrix that has poles must be finite; got {matrix[i, j]} at [{i}, {j}]", name="matrix"
            )
        return _judged(np.linalg.eigvals(matrix), dt, None)
    poles = getattr(thing, "poles", None)
    if poles is None:
        raise UsageError(
            "poles are those of error dynamics, a loop, a system of python-control or a square matrix; got "
            f"{type(thing).__name__}",
            name="poles",
        )
    period = getattr(thing, "dt", None)
    if period is None:
        period = getattr(thing, "T", None)
    return _judged(poles() if callable(poles) else poles, float(period) if period else None, thing)


def _judged(poles: Any, dt: float | None, thing: Any) -> Spectrum:
    made = np.asarray(poles, dtype=np.complex128)
    if np.isnan(made).any():
        raise RangeError(f"poles must be numbers; {type(thing).__name__} has one that is NaN", name="poles")
    own = getattr(thing, "stable", None)
    if own is None or callable(own):
        own = bool((np.abs(made) < 1.0).all() if dt else (made.real < 0.0).all())
    return Spectrum(poles=sorted_poles(made), dt=dt, stable=bool(own))
