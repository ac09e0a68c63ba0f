"""Error dynamics that no direction has by itself: all joints together, in continuous time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import expm

from taut.analysis.design.asked import BAND
from taut.base.types import Float64Array

__all__ = ["Coupled"]

ALONE: Final = 1e-6  # of a rate: what goes into other directions
STANDS: Final = 1e-9  # of the fastest pole: a pole of what nothing draws back


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupled:
    """The joints of an arm at rest under a law, linear, in continuous time.

    Law:  M e_ddot + C e_dot + K e + Ki int(e) = 0

    Args:
        M: (n, n) inertia.
        C: (n, n) damping, the arm's own friction included.
        K: (n, n) stiffness.
        Ki: (n, n) of the integral.
    """

    M: Float64Array
    C: Float64Array
    K: Float64Array
    Ki: Float64Array

    def apart(self, column: Float64Array) -> bool:
        """Whether a motion (n,) of the joints makes none but itself."""
        Minv = np.linalg.inv(self.M)
        size = float(column @ self.M @ column)
        for part in (self.C, self.K, self.Ki):
            way = Minv @ part @ column
            rest = way - (column @ self.M @ way / size) * column
            if rest @ self.M @ rest > ALONE**2 * (way @ self.M @ way):
                return False
        return True

    @property
    def _matrix(self) -> Float64Array:
        """(3n, 3n) of the integral, the error and its rate."""
        n = len(self.M)
        none, eye = np.zeros((n, n)), np.eye(n)
        rates = -np.linalg.solve(self.M, np.hstack([self.Ki, self.K, self.C]))
        return np.block([[none, eye, none], [none, none, eye], [rates]])

    @property
    def longest(self) -> float:
        """[s] in which its slowest motion falls to 2 %."""
        s = np.linalg.eigvals(self._matrix)
        rates = -s.real[np.abs(s) > STANDS * np.abs(s).max()]
        return math.log(BAND) / float(rates.min()) if rates.size and rates.min() > 0.0 else math.inf

    def response(
        self, column: Float64Array, dt: float, steps: int
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """(steps + 1, n) error, its rate and its integral at every dt, from a motion of the joints on."""
        n = len(self.M)
        move = expm(self._matrix * dt)
        out = np.zeros((steps + 1, 3 * n))
        out[0, n : 2 * n] = column
        for k in range(steps):
            out[k + 1] = move @ out[k]
        return out[:, n : 2 * n], out[:, 2 * n :], out[:, :n]
