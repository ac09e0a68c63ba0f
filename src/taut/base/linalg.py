"""Small linear algebra for floats and symbols alike.

Straight-line code: no pivoting where the matrix is symmetric positive definite, selects where it is not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from taut.base.array import has_symbols, select_one, traced_array
from taut.base.errors import NumericalError, ShapeError, user_location
from taut.base.types import Array, Matrix

__all__ = ["LTDL", "factor_spd", "solve_general"]


class LTDL:
    """The factors of a symmetric positive definite matrix, A = L^T D L with L unit lower triangular.

    Eliminating from the last row up keeps the zeros that a branched arm has in its mass matrix.

    References:
        Featherstone, Rigid Body Dynamics Algorithms (2008), section 6.5.
    """

    __slots__ = ("_inverse_d", "_l", "d")

    def __init__(self, A: Matrix) -> None:
        if np.ndim(A) != 2 or np.shape(A)[0] != np.shape(A)[1]:
            raise ShapeError(f"a symmetric positive definite matrix is (n, n); got shape {np.shape(A)}")
        rows = _entries(A).tolist()
        n = len(rows)
        self._inverse_d: list[Any] = [None] * n
        self.d: list[Any] = [None] * n
        for k in range(n - 1, -1, -1):
            self.d[k] = rows[k][k]
            self._inverse_d[k] = 1.0 / _nonzero(rows[k][k])
            scaled = [rows[k][j] * self._inverse_d[k] for j in range(k)]
            for i in range(k):
                for j in range(i + 1):
                    rows[i][j] = rows[i][j] - scaled[i] * rows[k][j]
            rows[k][:k] = scaled
        self._l = rows

    def solve(self, b: Array) -> Array:
        """x in A x = b; b may have columns."""
        columns, n = _entries(b), len(self.d)
        if columns.shape[:1] != (n,) or columns.ndim > 2:
            raise ShapeError(f"b must be ({n},) or ({n}, k) to be solved with A ({n}, {n}); got {columns.shape}")
        if columns.ndim == 1:
            return _back(self._solve_one(columns.tolist()), columns.shape)
        solved = [self._solve_one(column) for column in columns.T.tolist()]
        return _back(solved, (columns.shape[1], columns.shape[0])).T

    def inverse(self) -> Matrix:
        """A^-1 = L^-1 D^-1 L^-T, symmetric to the last bit: half the work of solving for each column."""
        n, L = len(self.d), self._l
        K: list[list[Any]] = []  # rows of L^-1 below the diagonal, where it is 1
        for i in range(n):
            row: list[Any] = []
            for j in range(i):
                total = -L[i][j]
                for k in range(j + 1, i):
                    total = total - L[i][k] * K[k][j]
                row.append(total)
            K.append(row)
        out: list[list[Any]] = [[0.0] * n for _ in range(n)]
        for j in range(n):
            weighted = [K[j][k] * self._inverse_d[k] for k in range(j)]
            for i in range(j, n):
                total = self._inverse_d[j] if i == j else K[i][j] * self._inverse_d[j]
                for k in range(j):
                    total = total + K[i][k] * weighted[k]
                out[i][j] = out[j][i] = total
        return _back([x for row in out for x in row], (n, n))

    def _solve_one(self, x: list[Any]) -> list[Any]:
        n, L = len(x), self._l
        for k in range(n - 1, -1, -1):  # L^T y = b
            for i in range(k):
                x[i] = x[i] - L[k][i] * x[k]
        x = [x[k] * self._inverse_d[k] for k in range(n)]
        for k in range(n):  # L x = D^-1 y
            for i in range(k):
                x[k] = x[k] - L[k][i] * x[i]
        return x


def factor_spd(A: Matrix) -> LTDL:
    """Factors of a symmetric positive definite matrix, to solve with more than once."""
    return LTDL(A)


def _entries(x: Any) -> Array:
    """A bare array of floats, or of symbols."""
    x = np.asarray(x)
    return x if x.dtype == object else np.asarray(x, dtype=np.float64)


def _nonzero(pivot: Any) -> Any:
    if isinstance(pivot, float) and pivot == 0.0:
        raise NumericalError(
            f"a matrix is singular at {user_location()}: a pivot of its factorisation is zero; damp it, as in "
            "A + 1e-6 * taut.math.eye(n), or stay away from that state"
        )
    return pivot


def _back(values: list[Any], shape: tuple[int, ...]) -> Array:
    if has_symbols(values):
        return traced_array(values).reshape(shape)
    return np.array(values, dtype=np.float64).reshape(shape)


def solve_general(A: Matrix, b: Array) -> Array:
    """x in A x = b for any regular A: Gauss elimination with partial pivoting by selects."""
    matrix, rhs = _entries(A), _entries(b)
    n = len(matrix) if matrix.ndim else 0
    if matrix.shape != (n, n) or rhs.shape[:1] != (n,) or rhs.ndim > 2:
        raise ShapeError(f"solve(A, b) needs A (n, n) and b (n,) or (n, k); got {matrix.shape} and {rhs.shape}")
    width = 1 if rhs.ndim == 1 else rhs.shape[1]
    columns = rhs.reshape(n, width).tolist()
    work = [row + column for row, column in zip(matrix.tolist(), columns, strict=True)]
    for k in range(n):
        for i in range(k + 1, n):
            larger = abs(work[i][k]) > abs(work[k][k])
            top, low = work[k], work[i]
            work[k] = [select_one(larger, y, x) for x, y in zip(top, low, strict=True)]
            work[i] = [select_one(larger, x, y) for x, y in zip(top, low, strict=True)]
        inverse = 1.0 / _nonzero(work[k][k])
        for i in range(k + 1, n):
            f = work[i][k] * inverse
            work[i] = [0.0] * (k + 1) + [x - f * y for x, y in zip(work[i][k + 1 :], work[k][k + 1 :], strict=True)]
    solution: list[list[Any]] = [[0.0] * width for _ in range(n)]
    for k in range(n - 1, -1, -1):
        inverse = 1.0 / work[k][k]
        for column in range(width):
            x = work[k][n + column]
            for j in range(k + 1, n):
                x = x - work[k][j] * solution[j][column]
            solution[k][column] = x * inverse
    return _back([x for row in solution for x in row], rhs.shape)
