"""Root loci, stability maps and Routh's table: stability over one or two parameters, and by coefficients."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import bisect, linear_sum_assignment

from taut.base.checks import finite_array
from taut.base.errors import RangeError, ShapeError, UsageError, count_of
from taut.base.plot_style import INK, SMALL, WIDTH, colour, prepared
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.linear.linear_system import Complex, LinearSystem
from taut.linear.plots import pole_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOCUS_TOLERANCE: Final = 1e-12  # [-] of a value, between two of a locus
MAP_TOLERANCE: Final = 1e-3  # [-] likewise of a map, each point of which is a system
NEAR_ZERO: Final = 1e-6  # [-] of the distance of two values, below which a boundary is at zero
STABLE: Final = "#C4E7DC"  # a light shade of colour(2), opaque: neighbouring cells show no seam
SHOWN_QUANTILE: Final = 0.98  # quantile of the poles that a picture shows


def bisected(same: Callable[[float], bool], low: float, high: float, tolerance: float = LOCUS_TOLERANCE) -> float:
    """The value between two at which `same` (as at `low`) changes, by bisection; tolerance relative."""
    near_zero = tolerance * NEAR_ZERO * abs(high - low)
    return float(bisect(lambda value: 1.0 if same(value) else -1.0, low, high, xtol=near_zero, rtol=tolerance))


@dataclass(frozen=True, kw_only=True)
class LocusPoint:
    """A point of a root locus: the value of the parameter, and the pole there."""

    value: float
    pole: complex


@dataclass(frozen=True, kw_only=True, eq=False)
class RootLocus(Result):
    """Root locus: poles over one parameter.

    Args:
        values: (m,) of the parameter.
        poles: (m, n) in s [1/s], or in z where dt is not None; a column is one branch, NaN where it does not exist.
        stable: (m,) whether the system is stable.
        limits: Where it becomes stable or unstable, by bisection, with the pole that crosses.
        breakaways: Where two real poles become a complex pair or the reverse, likewise.
        dt: Period [s], or None.
        label: The parameter, with its unit.
    """

    values: Float64Array
    poles: Complex
    stable: NDArray[np.bool_]
    limits: tuple[LocusPoint, ...]
    breakaways: tuple[LocusPoint, ...]
    dt: float | None
    label: str

    def content(self) -> Content:
        """Stability limits and breakaway points."""
        rows: list[list[Cell]] = [
            [kind, point.value, point.pole.real, abs(point.pole.imag)]
            for kind, points in (("stability limit", self.limits), ("breakaway", self.breakaways))
            for point in points
        ]
        plane = "s [1/s]" if self.dt is None else "z"
        columns = ("point", self.label, f"Re {plane}", f"Im {plane}")
        return Content(
            title=f"root locus over {self.label} from {self.values[0]:g} to {self.values[-1]:g}",
            summary=(f"stable for {100.0 * float(self.stable.mean()):.0f} % of {len(self.values)} values",),
            tables=(Table(title="points", columns=columns, rows=rows),),
            figures={"root locus": lambda: _drawn(self.draw)},
        )

    def draw(self, ax: Axes, mark: Sequence[float] = ()) -> None:
        """Draw the locus: crosses at the first value, circles at the last, diamonds at stability limits.

        Args:
            ax: Axes.
            mark: Values that are marked with their number, from 1 on.
        """
        known = self.poles[np.isfinite(self.poles)]
        near = known[np.abs(known) <= np.quantile(np.abs(known), SHOWN_QUANTILE)]
        pole_axes(ax, near if self.dt is None else known, self.dt)
        ends = (f"{float(f'{value:.4g}'):.6g}" for value in (self.values[0], self.values[-1]))
        ax.set_title(f"{self.label}: {' (x) to '.join(ends)} (o)", fontsize=SMALL, color=INK, loc="left")
        for k, branch in enumerate(self.poles.T):
            there = branch[np.isfinite(branch)]
            ax.plot(there.real, there.imag, color=colour(k), linewidth=1.5, solid_joinstyle="round")
            ax.plot(there.real[:1], there.imag[:1], "x", color=colour(k), markersize=6.0, markeredgewidth=1.5)
            ax.plot(there.real[-1:], there.imag[-1:], "o", color=colour(k), markersize=4.5, markerfacecolor="white")
        marked = [(point.pole, f"{point.value:.4g}", "D") for point in self.limits]
        for k, value in enumerate(mark):
            at = self.poles[np.argmin(np.abs(self.values - value))]
            marked += [(s, str(k + 1), "o") for s in at[np.isfinite(at) & (at.imag >= 0.0)]]
        for s, text, marker in marked:
            ax.plot(s.real, abs(s.imag), marker, color=INK, markersize=3.5, zorder=4)
            ax.annotate(
                text, (s.real, abs(s.imag)), xytext=(-6.0, 3.0), ha="right", textcoords="offset points",
                fontsize=SMALL, color=INK, zorder=5,
            )  # fmt: skip


def root_locus(
    system_of: Callable[[float], LinearSystem], values: ArrayLike, *, label: str = "parameter"
) -> RootLocus:
    """Root locus: the poles of a linear system as one parameter takes increasing values.

    Args:
        system_of: The system at a value: `taut.error_dynamics`, `taut.linearise`, `taut.LinearSystem`, ...
        values: (m,) increasing; branches are followed from one to the next.
        label: The parameter, with its unit: "kp [N m/rad]".

    Raises:
        ShapeError, RangeError: Fewer than two values, or values that do not increase.
        UsageError: No function that gives a linear system.

    Example:
        >>> import taut
        >>> found = taut.analysis.root_locus(
        ...     lambda ki: taut.error_dynamics(M=0.5, b=0.1, kp=2.205, kd=2.0, ki=ki), np.linspace(0.0, 12.0, 50)
        ... )
        >>> round(found.limits[0].value, 6)  # (b + kd) kp / M
        9.261

    References:
        Chapter, figures 10.5 and 10.7.
    """
    grid = _grid("values", values)
    systems = [_system(system_of, value) for value in grid.tolist()]
    n = max(len(system.poles) for system in systems)
    branches = np.full((len(systems), n), np.nan + 0j)
    for k, system in enumerate(systems):
        branches[k] = _matched(branches[k - 1], system.poles)
    stable = np.array([system.stable for system in systems])
    limits, breakaways = [], []
    for i, (low, high) in enumerate(pairwise(grid.tolist())):
        if stable[i] != stable[i + 1]:
            value = bisected(lambda x, i=i: system_of(x).stable == stable[i], low, high)  # type: ignore[misc]
            limits.append(LocusPoint(value=value, pole=_crossing(system_of(value))))
        count = _complex_poles(systems[i])
        if len(systems[i].poles) == len(systems[i + 1].poles) and count != _complex_poles(systems[i + 1]):
            value = bisected(lambda x, count=count: _complex_poles(system_of(x)) == count, low, high)  # type: ignore[misc]
            breakaways.append(LocusPoint(value=value, pole=_closest_pair(system_of(value).poles)))
    return RootLocus(
        values=grid, poles=branches, stable=stable, limits=tuple(limits), breakaways=tuple(breakaways),
        dt=systems[0].dt, label=label,
    )  # fmt: skip


def _matched(before: Complex, poles: Complex) -> Complex:
    """(n,) poles in the order of the branches that they continue; those of no branch take free places."""
    distance = np.abs(before[:, np.newaxis] - poles)
    rows, columns = linear_sum_assignment(np.where(np.isnan(distance), 0.0, distance))
    out = np.full(len(before), np.nan + 0j)
    out[rows] = poles[columns]
    return out


def _complex_poles(system: LinearSystem) -> int:
    return int((system.poles.imag != 0.0).sum())


def _crossing(system: LinearSystem) -> complex:
    """The pole nearest to the stability boundary, but for those that rest at z = 1 or s = 0; the upper of a pair."""
    distance = np.abs(np.abs(system.poles) - 1.0) if system.dt else np.abs(system.poles.real)
    apart = np.abs(system.poles - (1.0 if system.dt else 0.0))
    distance = np.where(
        (apart < NEAR_ZERO * np.abs(system.poles).max(initial=0.0)) & (apart < apart.max()), np.inf, distance
    )
    pole = complex(system.poles[int(np.argmin(distance))])
    return complex(pole.real, abs(pole.imag))


def _closest_pair(poles: Complex) -> complex:
    """The mean of the two poles that are closest to each other."""
    apart = np.abs(poles[:, np.newaxis] - poles) + np.diag(np.full(len(poles), np.inf))
    i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
    return complex(0.5 * (poles[i] + poles[j]))


@dataclass(frozen=True, kw_only=True, eq=False)
class StabilityMap(Result):
    """Stability over two parameters: a grid, and points of the boundary between its neighbours.

    Args:
        x: (m,) values of the first parameter.
        y: (k,) values of the second.
        stable: (m, k) whether the system is stable.
        decay_rate: (m, k) [1/s] of the system, negative where it is not stable; NaN of a verdict alone.
        boundary: (p, 2) points on the boundary, by bisection.
        along: (p,) the parameter that was bisected for each: 0 for x, 1 for y.
        labels: The two parameters, with their units.
    """

    x: Float64Array
    y: Float64Array
    stable: NDArray[np.bool_]
    decay_rate: Float64Array
    boundary: Float64Array
    along: NDArray[np.intp]
    labels: tuple[str, str]

    def content(self) -> Content:
        """The fraction that is stable, and the boundary."""
        rows: list[list[Cell]] = [[one, other] for one, other in self.boundary.tolist()]
        return Content(
            title=f"stability map of {self.labels[0]} and {self.labels[1]}",
            summary=(
                f"stable at {100.0 * float(self.stable.mean()):.0f} % of {self.stable.size} points of the grid",
            ),
            tables=(Table(title="stability boundary", columns=self.labels, rows=rows),),
            figures={"stability map": lambda: _drawn(self.draw)},
        )

    def draw(self, ax: Axes) -> None:
        """Draw the map: the stable region filled up to the points of its boundary."""
        from matplotlib.tri import Triangulation

        prepared(ax, "", self.labels[1], self.labels[0])
        nodes = np.stack(np.meshgrid(self.x, self.y, indexing="ij"), axis=-1).reshape(-1, 2)
        points = np.concatenate([nodes, self.boundary])
        sign = np.concatenate([np.where(self.stable, 1.0, -1.0).ravel(), np.zeros(len(self.boundary))])
        i, j = (np.interp(points[:, k], grid, np.arange(len(grid))) for k, grid in enumerate((self.x, self.y)))
        triangles = Triangulation(i, j).triangles  # in steps of the grid, whose two scales differ
        ax.tricontourf(Triangulation(points[:, 0], points[:, 1], triangles), sign, levels=[0.0, 2.0], colors=[STABLE])
        ax.plot(*self.boundary.T, ".", color=INK, markersize=3.0, label="boundary")
        ax.fill(np.nan, np.nan, color=STABLE, label="stable")
        ax.legend(fontsize=SMALL, frameon=False, labelcolor=INK, loc="best")


def stability_map(
    system_of: Callable[[float, float], LinearSystem | bool],
    x: ArrayLike,
    y: ArrayLike,
    *,
    labels: tuple[str, str] = ("x", "y"),
) -> StabilityMap:
    """Stability of a linear system over two parameters, or another verdict, such as that no limit cycle is large.

    Regions smaller than the steps of the grid are not seen, and between two neighbours one boundary is found.

    Args:
        system_of: The system at two values, or whether the loop is good there.
        x: (m,) increasing values of the first parameter.
        y: (k,) increasing values of the second.
        labels: The two, with their units: ("rate [Hz]", "kd [N m s/rad]").

    Raises:
        ShapeError, RangeError: Fewer than two values, or values that do not increase.
        UsageError: No function that gives a linear system.

    Example:
        >>> import taut
        >>> found = taut.analysis.stability_map(
        ...     lambda rate, kd: taut.error_dynamics(M=0.5, kd=kd, zeta=1.0, rate=rate), [50.0, 100.0], [10.0, 400.0]
        ... )
        >>> [round(kd / rate, 2) for rate, kd in found.boundary[found.along == 1].tolist()]  # 2 M
        [1.0, 1.0]

    References:
        Chapter, section 10.2.1.1, practical bounds on feedback gains.
    """
    grids = _grid("x", x), _grid("y", y)

    def verdict(*values: float) -> tuple[bool, float]:
        found = system_of(*values) if callable(system_of) else None
        if isinstance(found, (bool, np.bool_)):
            return bool(found), np.nan
        system = _system((lambda: found) if callable(system_of) else system_of)
        return system.stable, system.decay_rate

    verdicts = np.array([[verdict(a, b) for b in grids[1].tolist()] for a in grids[0].tolist()])
    stable = verdicts[..., 0] > 0.0
    points, along = [], []
    for axis in (0, 1):
        for place in np.argwhere(np.diff(stable, axis=axis)).tolist():
            point = [float(grids[0][place[0]]), float(grids[1][place[1]])]
            low, high = grids[axis][place[axis] : place[axis] + 2].tolist()

            def same(
                value: float, point: list[float] = point, axis: int = axis, first: bool = stable[*place]
            ) -> bool:
                point[axis] = value
                return verdict(*point)[0] == first

            point[axis] = bisected(same, low, high, MAP_TOLERANCE)
            points.append(point)
            along.append(axis)
    return StabilityMap(
        x=grids[0], y=grids[1], stable=stable,
        decay_rate=verdicts[..., 1],
        boundary=np.array(points).reshape(-1, 2), along=np.array(along, dtype=np.intp), labels=labels,
    )  # fmt: skip


def _system(system_of: Callable[..., Any], *values: float) -> LinearSystem:
    found = system_of(*values) if callable(system_of) else None  # callers without a type checker
    if not isinstance(found, LinearSystem):
        got = type(system_of).__name__ if found is None else f"one that gives {type(found).__name__}"
        raise UsageError(f"system_of must be a function that gives a taut.LinearSystem; got {got}", name="system_of")
    return found


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


def _drawn(draw: Callable[[Axes], None]) -> Figure:
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(0.7 * WIDTH, 3.3), dpi=150, layout="constrained", facecolor="white")
    draw(figure.subplots())
    return figure


@dataclass(frozen=True, kw_only=True)
class RouthRow:
    """One row of the table."""

    power: int  # of s in its first entry
    entries: tuple[Fraction, ...]
    note: str = ""  # what was done where the usual rule has no answer


@dataclass(frozen=True, kw_only=True)
class RouthTable(Result):
    """Routh's table of a polynomial.

    Args:
        rows: From the highest power to 0.
        right: Number of roots with a positive real part: the changes of sign in the first column.
        on_axis: Number of roots on the imaginary axis.
    """

    rows: tuple[RouthRow, ...]
    right: int
    on_axis: int

    @property
    def stable(self) -> bool:
        """Whether every root has a negative real part."""
        return self.right == 0 and self.on_axis == 0

    def content(self) -> Content:
        """The table, and the verdict."""
        places = ((self.right, "in the right half-plane"), (self.on_axis, "on the imaginary axis"))
        roots = [f"{count_of(count, 'root')} {place}" for count, place in places if count]
        width = len(self.rows[0].entries)
        rows: list[list[Cell]] = [
            [f"s^{row.power}", *map(float, row.entries), *[None] * (width - len(row.entries)), row.note]
            for row in self.rows
        ]
        columns = ("power", *(f"entry {k + 1}" for k in range(width)), "note")
        return Content(
            title=f"Routh's table of order {self.rows[0].power}",
            summary=("stable: no change of sign in the first column",) if self.stable else (),
            faults=() if self.stable else (f"not stable: {' and '.join(roots)}",),
            tables=(Table(columns=columns, rows=rows),),
        )


def routh(coefficients: ArrayLike) -> RouthTable:
    """Routh's table of a_n s^n + ... + a_1 s + a_0, any order, special cases included.

    The numbers are exact fractions, so that no tolerance decides. A row with a zero at its head is added to itself,
    shifted to the left by its k zeros, with the sign (-1)^k. A row of zeros is replaced by the derivative of the row
    above, whose polynomial divides the whole, and has every pair of roots that lie opposite each other.

    Args:
        coefficients: (n + 1,) from the highest power down; the first is not zero.

    Raises:
        ShapeError: Not a list of two numbers or more.
        RangeError: NaN, infinite, or a leading zero.

    Example:
        >>> table = routh([0.5, 2.1, 2.205, 1.0])
        >>> table.stable, [round(float(row.entries[0]), 4) for row in table.rows]
        (True, [0.5, 2.1, 1.9669, 1.0])
        >>> routh([1.0, 1.0, 2.0, 2.0]).on_axis
        2

    References:
        Routh, A treatise on the stability of a given state of motion (1877). Benidir and Picinbono, Extended table
        for eliminating the singularities in Routh's array (1990). Chapter, section 10.2.1.1.
    """
    given = finite_array("coefficients", coefficients)
    if given.ndim != 1 or len(given) < 2:
        raise ShapeError(
            "coefficients must be a list of two numbers or more, from the highest power of s down; got shape "
            f"{given.shape}",
            name="coefficients",
        )
    if given[0] == 0.0:
        raise RangeError(
            "coefficients[0] must not be zero: it belongs to the highest power of s; leave it out",
            name="coefficients",
            value=0.0,
        )
    exact = [Fraction(float(a)) for a in given]
    order = len(exact) - 1
    rows = [RouthRow(power=order, entries=tuple(exact[0::2])), _mended(order - 1, exact[1::2], exact[0::2])]
    for power in range(order - 2, -1, -1):
        before, above = rows[-2].entries, rows[-1].entries
        ratio = before[0] / above[0]
        made = [before[k + 1] - ratio * (above[k + 1] if k + 1 < len(above) else 0) for k in range(power // 2 + 1)]
        rows.append(_mended(power, made, above))
    signs = np.array([row.entries[0] > 0 for row in rows])
    changes = signs[1:] != signs[:-1]
    opposite = next((k for k, row in enumerate(rows) if row.note.startswith("zeros")), None)
    on_axis = 0 if opposite is None else rows[opposite - 1].power - 2 * int(changes[opposite - 1 :].sum())
    return RouthTable(rows=tuple(rows), right=int(changes.sum()), on_axis=on_axis)


def _mended(power: int, entries: list[Fraction], above: list[Fraction] | tuple[Fraction, ...]) -> RouthRow:
    """A row as the table takes it, where it begins with a zero or is all zeros."""
    zeros = next((k for k, entry in enumerate(entries) if entry), len(entries))
    if zeros == 0:
        return RouthRow(power=power, entries=tuple(entries))
    if zeros == len(entries):
        slope = tuple((power + 1 - 2 * k) * above[k] for k in range(len(entries)))
        return RouthRow(power=power, entries=slope, note=f"zeros: the derivative of the row s^{power + 1}")
    sign = -1 if zeros % 2 else 1
    shifted = [*entries[zeros:], *[Fraction(0)] * zeros]
    mixed = tuple(entry + sign * other for entry, other in zip(entries, shifted, strict=True))
    return RouthRow(power=power, entries=mixed, note=f"it began with {count_of(zeros, 'zero')}")
