"""Stability maps: over two numbers, what is stable, and the border between."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.study.poles import spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["StabilityMap", "stability_map"]

CLOSE: Final = 5e-4  # of a border's value: between what is stable and what is not


@dataclass(frozen=True, kw_only=True, eq=False)
class StabilityMap:
    """What is stable over two numbers.

    Args:
        names: Of the two.
        values: Of each, the grid: (m,) and (k,).
        stable: (m, k) at its points.
        border: (p, 2) points between a stable and an unstable neighbour, to 0.1 % of the one that was bisected.
        along: (p,) which of the two was bisected.
        inside: (p,) whether the stable side is that of the larger value.
    """

    names: tuple[str, str]
    values: tuple[Float64Array, Float64Array]
    stable: NDArray[np.bool_]
    border: Float64Array
    along: NDArray[np.intp]
    inside: NDArray[np.bool_]

    @property
    def share(self) -> float:
        """Of the points of the grid that are stable."""
        return float(self.stable.mean())

    def plot(self, units: tuple[str, str] = ("", ""), *, log: bool = False) -> Figure:
        """What is stable, and the border; the first number along.

        Args:
            units: Of the two numbers.
            log: Whether both axes are logarithmic.
        """
        from taut.study.stability_plots import of_map

        return of_map(self, units, log=log)


def stability_map(
    make: Callable[..., Any], over: Mapping[str, ArrayLike], *, dt: float | None = None
) -> StabilityMap:
    """Which of two numbers go together: a grid, and the border between its neighbours by bisection.

    Islands smaller than the grid's steps are not seen, and between two neighbours one border is found.

    Args:
        make: Called with the two numbers by their names; makes `ErrorDynamics`, its sampled kind, `SampledLoop`, a
            system of python-control, anything with `poles`, `dt` and `stable`, or a matrix.
        over: The two names and the values of each, increasing.
        dt: Period of the matrices, if `make` makes matrices of sampled systems [s].

    Raises:
        UsageError: Not two names, or what is made has no poles.
        ShapeError, RangeError: Values that do not increase.

    Example:
        >>> import taut
        >>> def servo(rate, kd):
        ...     return taut.second_order(M=0.5, kd=kd, zeta=1.0).sampled(rate=rate)
        >>> found = taut.stability_map(servo, {"rate": [50.0, 100.0, 200.0], "kd": [10.0, 400.0]})
        >>> [round(kd / rate, 3) for rate, kd in found.border[found.along == 1].tolist()]  # 2 M / dt
        [1.0, 1.0, 1.0]

    References:
        Chapter, section 10.2.1.1, practical bounds on feedback gains.
    """
    if not isinstance(over, Mapping) or len(over) != 2:
        raise UsageError(
            "over must name two numbers with the values of each, such as {'rate': [100, 200], 'kd': [1, 10]}; got "
            f"{over!r}",
            name="over",
        )
    first, second = over
    grids = tuple(_grid(name, values) for name, values in over.items())
    x, y = grids

    def stable(one: float, other: float) -> bool:
        return spectrum(make(**{first: one, second: other}), dt).stable

    seen = np.array([[stable(a, b) for b in y.tolist()] for a in x.tolist()])
    border: list[tuple[float, float]] = []
    along: list[int] = []
    inside: list[bool] = []
    for i, j in np.argwhere(seen[1:] != seen[:-1]).tolist():
        other = float(y[j])
        border.append((_between(lambda one: stable(one, other), x[i], x[i + 1]), other))  # noqa: B023
        along.append(0)
        inside.append(bool(seen[i + 1, j]))
    for i, j in np.argwhere(seen[:, 1:] != seen[:, :-1]).tolist():
        one = float(x[i])
        border.append((one, _between(lambda other: stable(one, other), y[j], y[j + 1])))  # noqa: B023
        along.append(1)
        inside.append(bool(seen[i, j + 1]))
    return StabilityMap(
        names=(first, second),
        values=(x, y),
        stable=seen,
        border=np.array(border).reshape(-1, 2),
        along=np.array(along, dtype=np.intp),
        inside=np.array(inside, dtype=bool),
    )


def _grid(name: str, values: ArrayLike) -> Float64Array:
    grid = finite_array(name, values)
    if grid.ndim != 1 or len(grid) < 2:
        raise ShapeError(
            f"{name} must be a list of two values or more, such as np.linspace(1, 10, 20); got shape {grid.shape}",
            name=name,
        )
    if (np.diff(grid) <= 0.0).any():
        raise RangeError(f"{name} must increase from one value to the next", name=name, rule="increasing")
    return grid


def _between(stable: Callable[[float], bool], low: float, high: float) -> float:
    """The border between two values of which one is stable."""
    low, high = float(low), float(high)
    first = stable(low)
    while high - low > CLOSE * max(abs(low), abs(high)):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) == first else (low, middle)
    return 0.5 * (low + high)
