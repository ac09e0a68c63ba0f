"""The response of a sampled linear system to sines: the frequencies that it has, and what it is at a pole."""

from __future__ import annotations

from typing import Final

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError
from taut.base.types import ArrayLike, Float64Array

__all__ = ["Complex", "at_a_pole", "checked_frequencies"]

Complex = NDArray[np.complex128]
SINGULAR: Final = 1e-11  # of the largest singular value
CHAIN: Final = 3  # the longest chain of states that drive one another at one pole, such as a free mass's
NOTHING: Final = 1e-9  # of the sizes of what is multiplied


def at_a_pole(A: Float64Array, B: Float64Array, C: Float64Array, z: complex) -> Complex:
    """(p, m) C (z I - A)^-1 B where z is a pole, or so near one that it may be.

    What the inputs do not set off, or the outputs do not show, is left out of it: that is its limit. What they do
    and show is infinite.
    """
    W: Complex = np.asarray(z * np.eye(len(A)) - A, dtype=np.complex128)
    size = float(np.linalg.norm(W, 2))
    right, left = _chains(W), _chains(np.conj(W).T)
    if not right.shape[1]:
        return np.asarray(C @ np.linalg.solve(W, B), dtype=np.complex128)
    P = right @ np.linalg.solve(left.conj().T @ right, left.conj().T)  # onto the states of this pole
    out = np.asarray(C @ np.linalg.solve(W + size * P, B), dtype=np.complex128)
    least = NOTHING * np.outer(np.linalg.norm(C, axis=1), np.linalg.norm(B, axis=0))
    for k in range(CHAIN):
        out[np.abs(C @ np.linalg.matrix_power(W / size, k) @ P @ B) > least] = np.inf
    return out


def _chains(W: Complex) -> Complex:
    """(n, k) what W turns into nothing, when it is applied again and again: orthonormal."""
    found = scipy.linalg.null_space(W, SINGULAR)
    for _ in range(CHAIN - 1):
        found = scipy.linalg.null_space(W - found @ (found.conj().T @ W), SINGULAR)
    return np.asarray(found, dtype=np.complex128)


def checked_frequencies(omega: ArrayLike, dt: float) -> Float64Array:
    """(k,) frequencies [rad/s] up to half the rate.

    Raises:
        ShapeError: Not one, or a list of them.
        RangeError: Negative, or beyond it.
    """
    w = np.atleast_1d(finite_array("omega", omega, unit="rad/s"))
    if w.ndim != 1 or not len(w):
        raise ShapeError(f"omega must be one frequency or (k,) of them [rad/s]; got shape {w.shape}", name="omega")
    most = np.pi / dt
    wrong = (w < 0.0) | (w > most * (1.0 + 1e-12))
    if wrong.any():
        value = float(w[wrong][0])
        raise RangeError(
            f"omega must be between 0 and {most:.6g} rad/s, half the rate, beyond which a sampled loop knows no "
            f"sine; got {value:g}",
            name="omega",
            value=value,
            rule="0 <= omega <= pi / dt",
        )
    return w
