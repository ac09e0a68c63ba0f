"""Characteristic polynomials: of poles, of a matrix, and their roots; exact where rounding would lose a case."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError
from taut.base.types import Float64Array
from taut.linear.poles import sorted_poles

__all__ = ["excess", "final_value", "from_matrix", "from_poles", "roots"]

Complex = NDArray[np.complex128]
CRITICAL: Final = 1e-14  # of zeta^2 about 1: what rounding leaves of a critically damped design


def from_poles(poles: ArrayLike) -> Float64Array:
    """(n + 1,) of (n,) roots, real or in conjugate pairs [1/s].

    Raises:
        ShapeError, RangeError: They are no such roots.
    """
    given = np.atleast_1d(np.asarray(poles))
    if given.ndim != 1 or not given.size or given.dtype.kind not in "fiuc":
        raise ShapeError(f"poles must be a list of numbers [1/s]; got {poles!r}", name="poles")
    if not np.isfinite(given).all():
        raise RangeError("poles must be finite [1/s]", name="poles", value=given)
    upper = np.sort_complex(given[given.imag > 0.0])
    lower = np.sort_complex(np.conj(given[given.imag < 0.0]))
    if len(upper) != len(lower) or not np.allclose(upper, lower, rtol=1e-12, atol=0.0):
        raise RangeError("complex poles must come in conjugate pairs; give -a + jb and -a - jb", name="poles")
    made: Float64Array = np.real(np.poly(np.concatenate([given[given.imag == 0.0], upper, np.conj(upper)])))
    return made


def from_matrix(A: ArrayLike) -> Float64Array:
    """(n + 1,) of det(s I - A), by Faddeev and Leverrier in fractions: double roots stay double.

    Raises:
        ShapeError, RangeError: Not a square matrix of finite numbers.
    """
    matrix = finite_array("A", A)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size:
        raise ShapeError(f"A must be a square matrix; got shape {matrix.shape}", name="A")
    n = len(matrix)
    exact = [[Fraction(float(entry)) for entry in row] for row in matrix]
    made, N = [Fraction(1)], [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    for k in range(1, n + 1):
        AN = [[sum((exact[i][m] * N[m][j] for m in range(n)), Fraction(0)) for j in range(n)] for i in range(n)]
        made.append(-sum((AN[i][i] for i in range(n)), Fraction(0)) / k)
        N = [[AN[i][j] + (made[k] if i == j else 0) for j in range(n)] for i in range(n)]
    return np.array([float(a) for a in made])


def excess(a: Float64Array) -> float:
    """zeta^2 omega_n^2 - omega_n^2 of a second order [1/s^2], rounded once, for it decides between the cases.

    Zero within the rounding of a critically damped design.
    """
    a2, a1, a0 = (Fraction(float(each)) for each in a)
    exact = float((a1 * a1 - 4 * a2 * a0) / (4 * a2 * a2))
    return 0.0 if abs(exact) <= CRITICAL * float(a1 / (2 * a2)) ** 2 else exact


def roots(a: Float64Array) -> Complex:
    """(n,) the roots [1/s], the slowest first; of the second order by the formula below equation 10.10."""
    if len(a) != 3:
        return sorted_poles(np.roots(a))
    sigma, beyond = float(a[1] / (2.0 * a[0])), excess(a)
    if beyond <= 0.0:
        omega_d = math.sqrt(-beyond)
        return sorted_poles(np.array([complex(-sigma, omega_d), complex(-sigma, -omega_d)]))
    far = -(sigma + math.copysign(math.sqrt(beyond), sigma))
    return sorted_poles(np.array([complex(far), complex(float(a[2] / a[0]) / far)]))


def final_value(numerator: Float64Array, a: Float64Array, power: int, size: float) -> float:
    """What numerator / a makes in the end of size t^power / power!: 0, a number, or infinite; for a stable a."""
    low = numerator[::-1]  # from s^0 up
    if not low.any() or size == 0.0:
        return 0.0
    first = int(np.flatnonzero(low)[0])
    if first < power:
        return math.copysign(math.inf, low[first] * a[-1] * size)
    return float(size * low[power] / a[-1]) if first == power else 0.0
