"""The bounded spring: its error counts for less the larger it is, part by part, and it still has an energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from taut.base import math as tm
from taut.base.types import Matrix, Vector, Wrench
from taut.control.gains import GainValue

__all__ = ["Bound"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Bound:
    """What bounds the linear and the angular part of an error: r^2 is its squared length times the part's curve.

    Args:
        curves: 1 / error_max^2 of each part [1/m^2, 1/rad^2]; 0 where there is no bound.
    """

    curves: tuple[Any, Any]

    @classmethod
    def of(cls, error_max: GainValue) -> Self:
        """That of error_max=(linear, angular) [m, rad]."""
        most = [error_max[k] if error_max.ndim else error_max[()] for k in range(2)]
        return cls(curves=(1.0 / (most[0] * most[0]), 1.0 / (most[1] * most[1])))

    def error(self, X: Vector) -> Vector:
        """(k,) part by part X / sqrt(1 + r^2), which is shorter than error_max."""
        return _by_parts(X, [1.0 / root for root in self._roots(X)])

    def stretch(self, X: Vector) -> Vector:
        """(k,) Y, with the energy Y . K Y / 2 of the bounded spring: part by part X sqrt(2 / (1 + root))."""
        return _by_parts(X, [tm.sqrt(2.0 / (1.0 + root)) for root in self._roots(X)])

    def force(self, K: GainValue | Matrix, X: Vector) -> Wrench:
        """(k,) the gradient of that energy; with one stiffness for all directions of a part it is K error(X)."""
        whole, out = K @ self.stretch(X), []
        for places, root, curve in zip(_places(X), self._roots(X), self.curves, strict=False):
            part, own = X[places], whole[places]
            bend = 0.5 * curve / ((1.0 + root) * root)
            out.extend(tm.sqrt(2.0 / (1.0 + root)) * (own - bend * (part @ own) * part))
        return tm.array(out)

    def _roots(self, X: Vector) -> list[Any]:
        return [
            tm.sqrt(1.0 + (X[places] @ X[places]) * curve)
            for places, curve in zip(_places(X), self.curves, strict=False)
        ]


def _places(X: Vector) -> list[slice]:
    """The linear and the angular part; of three numbers the linear one alone."""
    return [slice(0, 3), slice(3, 6)][: len(X) // 3]


def _by_parts(X: Vector, shares: list[Any]) -> Vector:
    return tm.array([entry for places, share in zip(_places(X), shares, strict=True) for entry in share * X[places]])
