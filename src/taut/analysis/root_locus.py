"""Root locus over any number: where the poles go, where they meet, and where they leave what is stable."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from taut.analysis.stable_ranges import quantity, ranges_text, stable_ranges
from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import ArrayLike, Float64Array
from taut.linear.error_words import pole as pole_text
from taut.linear.poles import Spectrum, spectrum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Crossing", "Locus", "Replaceable", "locus"]

Complex = NDArray[np.complex128]
FINE: Final = 0.02  # of the picture's extent: what a pole may move between two values
DEPTH: Final = 14  # halvings of the space between two values that are asked for
HALVINGS: Final = 44
NOTHING: Final = 1e-9  # of a pole's size
REAL: Final = 1e-6  # imaginary part of what a double pole splits into, in parts of its size


class Replaceable(Protocol):
    """What has numbers by name: error dynamics, sampled ones, and whatever else knows `replaced`."""

    def replaced(self, **numbers: float) -> Any:
        """The same with other numbers."""
        ...


@dataclass(frozen=True, kw_only=True)
class Crossing:
    """Where something happens to poles.

    Args:
        value: Of the number that is varied.
        pole: Of the pole, in s or z; of a pair the upper one.
    """

    value: float
    pole: complex


@dataclass(frozen=True, kw_only=True, eq=False)
class Locus:
    """Where poles go as a number grows. Print it for where it is stable, `plot()` it, hand it to `taut.report`.

    Args:
        name: What is varied.
        values: (m,) of it: those asked for, and more where poles move fast.
        poles: (m, n) each column one branch; NaN where there is no such pole.
        stable: (m,) whether all of them are.
        borders: Where it becomes stable or ceases to be, in the order of the values, with the pole that crosses.
        meetings: Where two poles meet on the real axis, or leave it.
        dt: Period of poles in z [s]; None for poles in s.
        spectrum: What has the poles at a value.
        unit: Of the number, for words and pictures.
    """

    name: str
    values: Float64Array = field(repr=False)
    poles: Complex = field(repr=False)
    stable: NDArray[np.bool_] = field(repr=False)
    borders: tuple[Crossing, ...]
    meetings: tuple[Crossing, ...]
    dt: float | None
    spectrum: Callable[[float], Spectrum] = field(repr=False)
    unit: str = ""

    def at(self, value: float) -> Complex:
        """(n,) the poles at a value, whether or not it is one of its values."""
        return self.spectrum(value).poles

    @property
    def ranges(self) -> list[tuple[float, float]]:
        """From where to where it is stable."""
        cuts = [crossing.value for crossing in self.borders]
        return stable_ranges(bool(self.stable[0]), cuts, float(self.values[0]), float(self.values[-1]))

    def tables(self) -> dict[str, list[list[str]]]:
        """The poles where something happens to them, and at both ends: a row for each value, the first one heads."""
        low, high = float(self.values[0]), float(self.values[-1])
        rows = [(low, "begins", self.at(low).tolist()), (high, "ends", self.at(high).tolist())]
        rows += [(each.value, "stable from or up to here", [each.pole]) for each in self.borders]
        rows += [(each.value, "two poles meet", [each.pole]) for each in self.meetings]
        heads = [
            quantity(self.name, self.unit),
            "what happens",
            "pole in s [1/s]" if self.dt is None else "pole in z",
        ]
        rows.sort(key=lambda row: row[0])
        return {
            "Where poles are": [heads, *([f"{value:.5g}", what, _words(poles)] for value, what, poles in rows)],
        }

    def __str__(self) -> str:
        low, high = float(self.values[0]), float(self.values[-1])
        unit = f" {self.unit}" if self.unit else ""
        count = self.poles.shape[1]
        return "\n".join(
            [
                f"root locus over {self.name} from {low:.4g} to {high:.4g}{unit}",
                f"  poles in {'s' if self.dt is None else 'z'}       {count}",
                f"  stable           {ranges_text(self.ranges, low, high)}",
                *(
                    f"  border           {self.name} = {each.value:.5g}{unit}, {_words([each.pole])}"
                    for each in self.borders
                ),
                *(
                    f"  two poles meet   {self.name} = {each.value:.5g}{unit}, {_words([each.pole])}"
                    for each in self.meetings
                ),
            ]
        )

    def plot(self, mark: ArrayLike = (), unit: str | None = None) -> Figure:
        """The branches, from crosses at the first value to circles at the last.

        Args:
            mark: Values whose poles are marked.
            unit: Of the number, instead of its own.
        """
        from taut.analysis.stability_plots import of_locus

        marked = finite_array("mark", np.atleast_1d(np.asarray(mark, dtype=np.float64)))
        return of_locus(self, marked, self.unit if unit is None else unit)


def locus(
    vary: Callable[[float], Any] | str,
    values: ArrayLike,
    *,
    of: Replaceable | None = None,
    name: str | None = None,
    dt: float | None = None,
    unit: str = "",
) -> Locus:
    """Root locus: the poles of error dynamics, a loop or a matrix as one number grows.

    Args:
        vary: What makes it of the number: number -> `ErrorDynamics`, its sampled kind, `SampledLoop`, a system of
            python-control, anything with `poles`, `dt` and `stable`, or a matrix; or the number's name in `of`.
        values: (m,) increasing, two or more; between them more are taken where poles move fast.
        of: What has the number, where a name is given.
        name: What is varied, for pictures.
        dt: Period of the matrices, if `vary` makes matrices of sampled systems [s].
        unit: Of what is varied, for words and pictures.

    Raises:
        ShapeError, RangeError: Values that do not increase.
        UsageError: A name without `of`, or what is made has no poles.

    Example:
        >>> import taut
        >>> pd = taut.analysis.second_order(M=0.5, b=0.1, kp=2.205, kd=2.0)
        >>> figure_10_7 = taut.analysis.locus("ki", [0.0, 12.0], of=pd)
        >>> round(figure_10_7.borders[0].value, 6), round(figure_10_7.borders[0].pole.imag, 3)
        (9.261, 2.1)

    References:
        Chapter, figures 10.5 and 10.7. Evans, Control system synthesis by root locus method (1950).
    """
    grid = finite_array("values", values)
    if grid.ndim != 1 or len(grid) < 2:
        raise ShapeError(
            f"values must be a list of two numbers or more, such as np.linspace(0, 10, 50); got shape {grid.shape}",
            name="values",
        )
    if (np.diff(grid) <= 0.0).any():
        raise RangeError("values must increase from one to the next", name="values", rule="increasing")
    make = _maker(vary, of)

    def at(value: float) -> Spectrum:
        return spectrum(make(float(value)), dt)

    found = {float(value): at(value) for value in grid}
    periods = {each.dt for each in found.values()}
    if len(periods) > 1 and None in periods:
        raise UsageError("all that vary makes must be in continuous time, or all of it sampled", name="vary")
    extent = _extent([each.poles for each in found.values()])
    for low, high in zip(grid[:-1].tolist(), grid[1:].tolist(), strict=True):
        _refined(at, found, low, high, FINE * extent, DEPTH)
    order = sorted(found)
    branches = _branches([found[value].poles for value in order])
    stable = np.array([found[value].stable for value in order])
    period = found[order[0]].dt
    borders, meetings = [], []
    for low, high in itertools.pairwise(order):
        if found[low].stable != found[high].stable:
            value = _bisected(lambda value: at(value).stable, low, high)
            borders.append(Crossing(value=value, pole=_edge(at(value).poles, period)))
        if _real(found[low].poles) != _real(found[high].poles) and len(found[low].poles) == len(found[high].poles):
            value = _bisected(lambda value: _real(at(value).poles), low, high)
            meetings.append(Crossing(value=value, pole=_closest(at(value).poles)))
    word = name if name is not None else vary if isinstance(vary, str) else "number"
    return Locus(
        name=word, values=np.array(order), poles=branches, stable=stable, borders=tuple(borders),
        meetings=tuple(meetings), dt=period, spectrum=at, unit=unit,
    )  # fmt: skip


def _words(poles: list[complex]) -> str:
    """Poles in words, of pairs the upper one; what rounding left of a part is nothing."""
    told = []
    for s in poles:
        small = NOTHING * abs(s)
        real, imag = (0.0 if abs(part) <= small else part for part in (s.real, s.imag))
        if imag >= 0.0:
            told.append(pole_text(complex(real, imag)))
    return ", ".join(told)


def _maker(vary: Callable[[float], Any] | str, of: Replaceable | None) -> Callable[[float], Any]:
    if not isinstance(vary, str):
        if not callable(vary):
            raise UsageError(
                f"vary must be a function of one number, or the name of a number of `of`; got {vary!r}", name="vary"
            )
        if of is not None:
            raise UsageError("of= is for the name of a number; a function makes the whole itself", name="of")
        return vary
    if of is None or not hasattr(of, "replaced"):
        raise UsageError(
            f"the name {vary!r} needs of=, error dynamics that have this number; or give a function of the number",
            name="of",
        )
    return lambda value: of.replaced(**{vary: value})


def _extent(rows: list[Complex]) -> float:
    """The size of the region where poles are, but for the farthest tenth of them."""
    sizes = np.concatenate([np.abs(row) for row in rows])
    sizes = sizes[np.isfinite(sizes)]
    return max(float(np.quantile(sizes, 0.9)), 1e-300) if len(sizes) else 1.0


def _matched(one: Complex, other: Complex) -> tuple[NDArray[np.intp], NDArray[np.intp], Float64Array]:
    """Which goes where, so that they move least in all."""
    distances = np.abs(one[:, np.newaxis] - other)
    rows, columns = linear_sum_assignment(distances)
    return rows, columns, distances[rows, columns]


def _refined(
    at: Callable[[float], Spectrum], found: dict[float, Spectrum], low: float, high: float, fine: float, depth: int
) -> None:
    """Values between two, until no pole moves farther than is fine."""
    one, other = found[low].poles, found[high].poles
    moved = _matched(one, other)[2]
    middle = 0.5 * (low + high)
    if depth == 0 or (len(one) == len(other) and (moved <= fine).all()) or not low < middle < high:
        return
    found[middle] = at(middle)
    _refined(at, found, low, middle, fine, depth - 1)
    _refined(at, found, middle, high, fine, depth - 1)


def _branches(rows: list[Complex]) -> Complex:
    """(m, n) each pole in the column of the one before that it is nearest to."""
    width = max(len(row) for row in rows)
    made = np.full((len(rows), width), complex(np.nan, np.nan))
    made[0, : len(rows[0])] = rows[0]
    for i in range(1, len(rows)):
        here = np.flatnonzero(~np.isnan(made[i - 1]))
        before, row = made[i - 1, here], rows[i]
        if i > 1:
            step = before - made[i - 2, here]
            before = before + np.where(np.isnan(step), 0.0, 1e-3 * step)  # straight on, where two meet
        one, other, _ = _matched(before, row)
        made[i, here[one]] = row[other]
        rest = np.setdiff1d(np.arange(len(row)), other)
        free = np.setdiff1d(np.arange(width), here)
        made[i, free[: len(rest)]] = row[rest]
    return made


def _real(poles: Complex) -> int:
    return int((np.abs(poles.imag) <= REAL * np.maximum(np.abs(poles), 1e-300)).sum())


def _bisected(word: Callable[[float], Any], low: float, high: float) -> float:
    """Where a word changes; at an end if it is another there than next to it."""
    first, start, end = word(low), low, high
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if word(middle) == first else (low, middle)
    value = 0.5 * (low + high)
    ends = [each for each in (start, end) if abs(value - each) <= 1e-12 * (end - start)]
    return ends[0] if ends else value


def _edge(poles: Complex, dt: float | None) -> complex:
    """The pole that is farthest out; of a pair the upper one."""
    out = np.abs(poles) if dt else poles.real
    near = poles[out >= out.max() - 1e-9 * max(float(np.abs(out).max()), 1.0)]
    return complex(near[near.imag.argmax()])


def _closest(poles: Complex) -> complex:
    """The point between the two that are nearest to each other."""
    distances = np.abs(poles[:, np.newaxis] - poles)
    np.fill_diagonal(distances, math.inf)
    i, j = np.unravel_index(int(distances.argmin()), distances.shape)
    return complex(float((0.5 * (poles[i] + poles[j])).real), 0.0)
