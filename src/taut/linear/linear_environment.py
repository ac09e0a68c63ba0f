"""A linear environment at one instant: F = M V-dot + B V + K X, and what its quantities are called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.checks import finite_array, read_only, vector
from taut.base.errors import ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array

__all__ = ["LinearEnvironment"]

NOTHING: Final = 1e-12  # of the largest number of the environment: a force that no motion makes


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearEnvironment:
    """F = G y + F0 at one instant, with y the highest rate of motion that the environment feels.

    Args:
        G: (n, n) M, else B, else K.
        F0: (n,) what the lower rates make, which are what they are at that instant [N, N m].
        names: (2n,) of y, then of F.
    """

    G: Float64Array
    F0: Float64Array
    names: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of directions, and of freedoms."""
        return len(self.F0)

    @property
    def all(self) -> Float64Array:
        """(2n, n) from y to all of the quantities, less F0."""
        return np.vstack([np.eye(self.n), self.G])

    def felt(self, rows: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(m, n) rows over all quantities as rows over y, each of length 1 or 0; and the lengths."""
        full = rows @ self.all
        largest = max(float(np.abs(self.G).max()), 1e-300)
        least = NOTHING * (np.abs(rows[:, : self.n]).sum(axis=1) + largest * np.abs(rows[:, self.n :]).sum(axis=1))
        sizes = np.linalg.norm(full, axis=1)
        sizes = np.where(sizes <= least, 0.0, sizes)
        return np.divide(full, sizes[:, None], out=np.zeros_like(full), where=sizes[:, None] > 0.0), sizes

    @classmethod
    def of(
        cls,
        *,
        B: ArrayLike | None,
        K: ArrayLike | None,
        M: ArrayLike | None,
        X: ArrayLike | None,
        V: ArrayLike | None,
        axes: Sequence[str] | None,
    ) -> LinearEnvironment:
        """That of M V-dot + B V + K X = F."""
        given = {name: finite_array(name, m) for name, m in (("M", M), ("B", B), ("K", K)) if m is not None}
        if not given:
            raise UsageError(
                "an environment F = M V_dot + B V + K X needs one of B, K and M, such as B=[[2, 1], [1, 1]]", name="B"
            )
        n = max(len(m) if m.ndim else 1 for m in given.values())
        G, *lower = (_square(name, m, n) for name, m in given.items())
        known = {"B": ("V", V, "velocity"), "K": ("X", X, "displacement")}
        F0 = np.zeros(n)
        for name, matrix in zip(list(given)[1:], lower, strict=True):
            symbol, value, word = known[name]
            if value is None:
                raise UsageError(
                    f"{name} beside {next(iter(given))} needs {symbol}=, the {word} at that instant", name=symbol
                )
            F0 = F0 + matrix @ vector(symbol, value, n)
        for name, (symbol, value, word) in known.items():
            if value is not None and name not in list(given)[1:]:
                raise UsageError(
                    f"{symbol} is the {word} at that instant, for {name} beside a higher rate; here it has no part: "
                    "leave it out",
                    name=symbol,
                )
        motion = {"M": "V_dot", "B": "V", "K": "X"}[next(iter(given))]
        return cls(G=read_only(G), F0=read_only(F0), names=_names(motion, n, axes))


def _square(name: str, given: Float64Array, n: int) -> Float64Array:
    if given.shape not in ((), (n,), (n, n)):
        raise ShapeError(f"{name} must be a number, ({n},) or ({n}, {n}); got shape {given.shape}", name=name)
    return given if given.ndim == 2 else np.diag(np.broadcast_to(given, (n,)))


def _names(motion: str, n: int, axes: Sequence[str] | None) -> tuple[str, ...]:
    if axes is None:
        return tuple(f"{symbol}{i + 1}" for symbol in (motion, "F") for i in range(n))
    if isinstance(axes, str) or len(set(axes)) != n or not all(isinstance(a, str) and a.isidentifier() for a in axes):
        raise UsageError(f"axes must be {n} different words, such as ('x', 'y'); got {axes!r}", name="axes")
    return tuple(f"{symbol}_{axis}" for symbol in (motion, "F") for axis in axes)
