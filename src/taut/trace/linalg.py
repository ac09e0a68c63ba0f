"""Small linear algebra for floats and symbols alike.

Straight-line code: no pivoting where the matrix is symmetric positive definite, selects where it is not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from taut.base.errors import NumericalError, ShapeError, user_location
from taut.base.types import Array, Matrix
from taut.trace.array import has_symbols, select_one, traced_array


class LTDL:
    """Factors of a symmetric positive definite matrix, A = L^T D L = U U^T: L keeps a branched arm's zeros.

    With `least`, a row whose pivot is at most that part of its diagonal entry (dependent on later rows) is left out:
    its unknown is 0, and `dropped` True. Source: Featherstone, Rigid Body Dynamics Algorithms (2008), section 6.5.
    """

    __slots__ = ("_inverse_d", "_l", "d", "dropped")

    def __init__(self, A: Matrix, least: float | None = None) -> None:
        if np.ndim(A) != 2 or np.shape(A)[0] != np.shape(A)[1]:
            raise ShapeError(f"a symmetric positive definite matrix is (n, n); got shape {np.shape(A)}")
        rows = _entries(A).tolist()
        n = len(rows)
        self._inverse_d: list[Any] = [None] * n
        self.d: list[Any] = [None] * n
        self.dropped: list[Any] = [False] * n
        diagonal = [rows[k][k] for k in range(n)]
        for k in range(n - 1, -1, -1):
            self.d[k] = rows[k][k]
            if least is None or k == n - 1:
                self._inverse_d[k] = 1.0 / _nonzero(rows[k][k])
            else:
                self.dropped[k] = rows[k][k] <= least * diagonal[k]
                self._inverse_d[k] = select_one(
                    self.dropped[k], 0.0, 1.0 / select_one(self.dropped[k], 1.0, rows[k][k])
                )
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
        return _by_columns(self._solve_one, columns)

    def half(self, b: Array) -> Array:
        """L^-T b, with columns or without: b . A^-1 c is then y . weighed(z) of the halves y and z of b and c."""
        return _by_columns(self._down, _entries(b))

    def weighed(self, y: Array) -> Array:
        """D^-1 y; y may have columns."""
        return (self.weights() * y.T).T

    def other_half(self, y: Array) -> Array:
        """The solution L^-1 D^-1 y of y = half(b), a vector."""
        return _back(self._up(self.weighed(y).tolist()), np.shape(y))

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

    def root(self) -> Matrix:
        """The upper triangular U = L^T sqrt(D)."""
        n, L, d = len(self.d), self._l, [np.sqrt(d) for d in self.d]
        rows = [[d[k] * (L[k][i] if i < k else float(i == k)) for k in range(n)] for i in range(n)]
        return _back([x for row in rows for x in row], (n, n))

    def weights(self) -> Array:
        """(n,) the diagonal of D^-1."""
        return _back(self._inverse_d, (len(self.d),))

    def least_direction(self) -> tuple[Array, Any]:
        """A unit vector u near the eigenvector of the smallest eigenvalue, and u . A u, by one inverse iteration.

        It starts from x in L x = e_k with k the smallest pivot: x . A x is that pivot, and |x| >= 1.
        """
        n, smallest = len(self.d), self.d[0]
        x: list[Any] = [1.0] + [0.0] * (n - 1)
        for k in range(1, n):
            less = self.d[k] < smallest
            smallest = select_one(less, self.d[k], smallest)
            x = [select_one(less, float(i == k), x[i]) for i in range(n)]
        for k in range(n):
            for i in range(k):
                x[k] = x[k] - self._l[k][i] * x[i]
        start = _back(x, (n,))
        out = self.solve(start)
        square = out @ out
        return out / np.sqrt(square), (start @ out) / square

    def _solve_one(self, x: list[Any]) -> list[Any]:
        return self._up([y * d for y, d in zip(self._down(x), self._inverse_d, strict=True)])

    def _down(self, x: list[Any]) -> list[Any]:
        for k in range(len(x) - 1, -1, -1):  # L^T y = b
            for i in range(k):
                x[i] = x[i] - self._l[k][i] * x[k]
        return x

    def _up(self, x: list[Any]) -> list[Any]:
        for k in range(len(x)):  # L x = y
            for i in range(k):
                x[k] = x[k] - self._l[k][i] * x[i]
        return x


def factor_spd(A: Matrix, least: float | None = None) -> LTDL:
    """Factors of a symmetric positive definite matrix, to solve with more than once; see `LTDL` for `least`."""
    return LTDL(A, least)


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


def _by_columns(map_one: Callable[[list[Any]], list[Any]], b: Array) -> Array:
    """A linear map on a vector, or on each column of a matrix."""
    if b.ndim == 1:
        return _back(map_one(b.tolist()), b.shape)
    return _back([map_one(column) for column in b.T.tolist()], (b.shape[1], b.shape[0])).T


def _back(values: list[Any], shape: tuple[int, ...]) -> Array:
    if has_symbols(values):
        return traced_array(values).reshape(shape)
    return np.array(values, dtype=np.float64).reshape(shape)


JACOBI_SWEEPS: Final = 5
TINIEST: Final = 1e-300


def times_square_root(C: Matrix, x: Array, sweeps: int = JACOBI_SWEEPS) -> Array:
    """C^(1/2) x of a symmetric positive semidefinite C by cyclic Jacobi rotations of x; 5 sweeps give 1e-6 for 6 x 6.

    Source: Golub and Van Loan, Matrix Computations (2013), section 8.5.
    """
    rows = _entries(C).tolist()
    n, y = len(rows), list(x)
    turns: list[tuple[int, int, Any, Any]] = []
    for _ in range(sweeps):
        for p in range(n - 1):
            for q in range(p + 1, n):
                c, s = _rotation(rows, p, q, n)
                turns.append((p, q, c, s))
                y[p], y[q] = c * y[p] - s * y[q], s * y[p] + c * y[q]
    y = [entry * np.sqrt(np.maximum(rows[k][k], 0.0)) for k, entry in enumerate(y)]
    for p, q, c, s in reversed(turns):
        y[p], y[q] = c * y[p] + s * y[q], c * y[q] - s * y[p]
    return _back(y, (n,))


def _rotation(rows: list[list[Any]], p: int, q: int, n: int) -> tuple[Any, Any]:
    """Rotate entry (p, q) of a symmetric matrix to zero; cosine and sine. Entries above the diagonal are kept."""
    a, d = rows[p][q], rows[q][q] - rows[p][p]
    size = np.sqrt(d * d + 4.0 * a * a)
    t = 2.0 * a / (np.abs(d) + size + TINIEST)
    t = select_one(d < 0.0, -t, t)
    c = 1.0 / np.sqrt(1.0 + t * t)
    s = t * c
    rows[p][p], rows[q][q], rows[p][q] = rows[p][p] - t * a, rows[q][q] + t * a, 0.0
    for k in range(n):
        if k in (p, q):
            continue
        (i, j), (m, o) = sorted((k, p)), sorted((k, q))
        rows[i][j], rows[m][o] = c * rows[i][j] - s * rows[m][o], s * rows[i][j] + c * rows[m][o]
    return c, s


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
