"""The spring of impedance and admittance: its bound, with which it still has an energy, and how it pulls the tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from taut.base.types import Matrix, Vector, Wrench
from taut.control.gains import GainValue
from taut.maths.spatial import curve, turned_back
from taut.trace import math as tm

__all__ = ["Bound", "pulled"]


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
        return cls(curves=(1.0 / (error_max[0] * error_max[0]), 1.0 / (error_max[1] * error_max[1])))

    def error(self, X: Vector) -> Vector:
        """(k,) part by part X / sqrt(1 + r^2), which is shorter than error_max."""
        return _by_parts(X, [1.0 / root for root in self._roots(X)])

    def stretch(self, X: Vector) -> Vector:
        """(k,) Y, with the energy Y . K Y / 2 of the bounded spring: part by part X sqrt(2 / (1 + root))."""
        return _by_parts(X, [tm.sqrt(2.0 / (1.0 + root)) for root in self._roots(X)])

    def force(self, K: GainValue | Matrix, X: Vector) -> Wrench:
        """(k,) the gradient of that energy; with one stiffness for all directions of a part it is K error(X)."""
        whole, out = K @ self.stretch(X), []
        for places, root, bound in zip(_places(X), self._roots(X), self.curves, strict=False):
            part, own = X[places], whole[places]
            bend = 0.5 * bound / ((1.0 + root) * root)
            out.extend(tm.sqrt(2.0 / (1.0 + root)) * (own - bend * (part @ own) * part))
        return tm.array(out)

    def _roots(self, X: Vector) -> list[Any]:
        return [
            tm.sqrt(1.0 + (X[places] @ X[places]) * bound)
            for places, bound in zip(_places(X), self.curves, strict=False)
        ]


def pulled(X: Vector, force: Vector, *, turning: bool) -> Wrench:
    """(6,) what pulls the tool where the potential X . force falls, with X the decoupled error, desired minus actual.

    -X-dot = A V of the tool at a resting reference, and the wrench is A^T force. For forces along X it is the force
    itself; for a stiffness that differs by direction the rest is what makes the spring conservative.

    Args:
        X: (6,) in the axes of the gains.
        force: (6,) likewise.
        turning: Whether these axes are those of the tool, and turn with it.
    """
    w = X[3:]
    moment = turned_back(w, curve(w), force[3:], -1.0 if turning else 1.0)
    if turning:
        moment = moment + tm.cross(X[:3], force[:3])
    return tm.array([*force[:3], *moment])


def _places(X: Vector) -> list[slice]:
    """The linear and the angular part; of three numbers the linear one alone."""
    return [slice(0, 3), slice(3, 6)][: len(X) // 3]


def _by_parts(X: Vector, shares: list[Any]) -> Vector:
    return tm.array([entry for places, share in zip(_places(X), shares, strict=True) for entry in share * X[places]])
