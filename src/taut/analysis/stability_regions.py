"""Stability maps: over two numbers, what is stable, and the border between."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from inspect import signature
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.analysis.stable_ranges import quantity, ranges_text, stable_ranges
from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.linear.poles import spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["StabilityMap", "stability_map"]

CLOSE: Final = 5e-4  # of a border's value: between what is stable and what is not
SHOWN: Final = 9  # values of the first number in print
NEAR_ZERO: Final = 1e-3  # of the step between two neighbours: what counts as its value where it is less


@dataclass(frozen=True, kw_only=True, eq=False)
class StabilityMap:
    """What is stable over two numbers. Print it for the borders, `plot()` it, hand it to `taut.report`.

    Args:
        names: Of the two.
        values: Of each, the grid: (m,) and (k,).
        stable: (m, k) at its points.
        border: (p, 2) points between a stable and an unstable neighbour, to 0.1 % of the one that was bisected, or of
            a thousandth of the grid's step if it is less than that.
        along: (p,) which of the two was bisected.
        inside: (p,) whether the stable side is that of the larger value.
        units: Of the two, for words and pictures.
    """

    names: tuple[str, str]
    values: tuple[Float64Array, Float64Array] = field(repr=False)
    stable: NDArray[np.bool_] = field(repr=False)
    border: Float64Array = field(repr=False)
    along: NDArray[np.intp] = field(repr=False)
    inside: NDArray[np.bool_] = field(repr=False)
    units: tuple[str, str] = ("", "")

    @property
    def share(self) -> float:
        """Of the points of the grid that are stable."""
        return float(self.stable.mean())

    def ranges(self, i: int) -> list[tuple[float, float]]:
        """From where to where of the second number it is stable, at the first number's value i."""
        here = (self.along == 1) & (self.border[:, 0] == self.values[0][i])
        y = self.values[1]
        return stable_ranges(
            bool(self.stable[i, 0]), sorted(self.border[here, 1].tolist()), float(y[0]), float(y[-1])
        )

    def tables(self) -> dict[str, list[list[str]]]:
        """Where the second number is stable, a row for each value of the first; the first row is heads."""
        x, y = self.values
        heads = [quantity(name, unit) for name, unit in zip(self.names, self.units, strict=True)]
        rows = [[f"{one:.4g}", ranges_text(self.ranges(i), float(y[0]), float(y[-1]))] for i, one in enumerate(x)]
        return {f"Where {self.names[1]} is stable": [heads, *rows]}

    def __str__(self) -> str:
        (first, second), (x, y) = self.names, self.values
        one, other = (f" {unit}" if unit else "" for unit in self.units)
        ((heads, *rows),) = self.tables().values()
        shown = sorted({round(k) for k in np.linspace(0, len(rows) - 1, min(len(rows), SHOWN))})
        lines = [
            f"stability map over {first} from {x[0]:.4g} to {x[-1]:.4g}{one} and {second} from {y[0]:.4g} to "
            f"{y[-1]:.4g}{other}",
            f"  {100.0 * self.share:.3g} % of {self.stable.size} points are stable",
            f"  {heads[0]:>12}   stable {heads[1]}",
            *(f"  {rows[k][0]:>12}   {rows[k][1]}" for k in shown),
        ]
        return "\n".join(lines)

    def plot(self, units: tuple[str, str] | None = None, *, log: bool = False) -> Figure:
        """What is stable, and the border; the first number along.

        Args:
            units: Of the two numbers, instead of their own.
            log: Whether both axes are logarithmic.

        Raises:
            UsageError: Units that are not two texts.
        """
        from taut.analysis.stability_plots import of_map

        return of_map(self, self.units if units is None else _units(units, self.names), log=log)


def stability_map(
    make: Callable[..., Any],
    over: Mapping[str, ArrayLike],
    *,
    dt: float | None = None,
    units: tuple[str, str] = ("", ""),
) -> StabilityMap:
    """Which of two numbers go together: a grid, and the border between its neighbours by bisection.

    Islands smaller than the grid's steps are not seen, and between two neighbours one border is found.

    Args:
        make: Called with the two numbers by their names; makes `ErrorDynamics`, its sampled kind, `SampledLoop`, a
            system of python-control, anything with `poles`, `dt` and `stable`, or a matrix.
        over: The two names and the values of each, increasing.
        dt: Period of the matrices, if `make` makes matrices of sampled systems [s].
        units: Of the two numbers, for words and pictures, such as ("Hz", "N m s/rad").

    Raises:
        UsageError: Not two names or two units, or what is made has no poles.
        ShapeError, RangeError: Values that do not increase.

    Example:
        >>> import taut
        >>> def servo(rate, kd):
        ...     return taut.analysis.second_order(M=0.5, kd=kd, zeta=1.0).sampled(rate=rate)
        >>> found = taut.analysis.stability_map(servo, {"rate": [50.0, 100.0, 200.0], "kd": [10.0, 400.0]})
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
    words = _units(units, (first, second))
    grids = tuple(_grid(name, values) for name, values in over.items())
    _takes(make, first, second)
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
        units=words,
    )


def _takes(make: Callable[..., object], first: str, second: str) -> None:
    """`make` is called with both numbers by their names."""
    try:
        own = signature(make)
    except (TypeError, ValueError):  # no function, which says so itself, or one that does not tell what it takes
        return
    try:
        own.bind(**{first: 0.0, second: 0.0})
    except TypeError:
        raise UsageError(
            f"make is called by the names of over, make({first}=..., {second}=...), and takes {own}; name both alike",
            name="make",
        ) from None


def _units(units: object, names: tuple[str, str]) -> tuple[str, str]:
    """Two texts."""
    if isinstance(units, (tuple, list)) and len(units) == 2 and all(isinstance(unit, str) for unit in units):
        return units[0], units[1]
    raise UsageError(
        f"units must be two texts, of {names[0]} and of {names[1]}, such as ('Hz', 'N m s/rad'); got {units!r}",
        name="units",
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
    first, small = stable(low), NEAR_ZERO * (high - low)
    while high - low > CLOSE * max(abs(low), abs(high), small):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) == first else (low, middle)
    return 0.5 * (low + high)
