"""Limit cycles of a linear loop with friction, backlash or steps of an encoder in it, by describing functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import root

from taut.base.checks import finite_array, instance_of
from taut.base.errors import RangeError, UsageError, count_of
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.linear.linear_system import Complex, LinearSystem

Element = Callable[[Float64Array, Float64Array], ArrayLike]
"""What a signal and its rate, both (k,) over one period of a sine, give: lambda y, rate: -0.4 * np.sign(rate)."""

SAMPLES: Final = 512  # of a sine
SMALLEST_JUMP: Final = 0.01  # [-] of an element's range
SECTIONS: Final = (64, 6)  # parts into which the interval of a jump is cut, and how often
MAX_JUMPS: Final = 64  # in a period: of more, each changes little
FIRST_GRID: Final = 64  # frequencies, and amplitudes, before they are refined
LARGEST_STEP: Final = (0.1, 0.4)  # [-] change of G and of N from one to the next, with one element and with several
REFINEMENTS: Final = 10  # halvings of a step at most, and only below so many points
MAX_GRID: Final = 400
OFF_AXIS: Final = 1e-12  # [-] of a frequency, so that no pole lies on the grid
SOLVER_STEPS: Final = 25  # evaluations for each unknown: starts are near
CELL_MARGIN: Final = 0.25  # [-] of the change over a cell: a root this near to it is looked for as well
SWEEPS: Final = 12  # of the amplitudes of other elements, at a frequency and an amplitude of the first
SETTLED_CHANGE: Final = 0.2  # [-] change of such an amplitude in the last sweep
OTHER_AMPLITUDES: Final = (1e-9, 1e9, 193)  # [-] of the first one's range, for the tables of other elements
COARSE_FREQUENCIES: Final = 17  # of the table of an element that depends on the rate's size
BELOW_HALF_RATE: Final = 0.9  # [-] above it a sampled sine is none
FREQUENCIES_BEYOND: Final = 30.0  # [-] of the frequencies of the slowest and the fastest pole
LEAST_SIGNAL: Final = 1e-12  # [-] of the first one
MAX_RESIDUAL: Final = 1e-8  # [-] of the harmonic balance
ALIKE: Final = 1e-3  # [-] two solutions whose frequency and amplitudes differ by less are one
NUDGE: Final = 1e-4  # [-] of the amplitudes, and of the frequency, for the stability of a cycle


@dataclass(frozen=True, kw_only=True)
class LimitCycle:
    """A sine at which the loop balances.

    Args:
        omega: Frequency [rad/s].
        amplitudes: Of the output that goes into each element, by name.
        stable: Whether larger cycles shrink and smaller ones grow: one that a run settles to.
    """

    omega: float
    amplitudes: Mapping[str, float]
    stable: bool

    @property
    def period(self) -> float:
        """[s]."""
        return 2.0 * math.pi / self.omega


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitCycles(Result):
    """Limit cycles that harmonic balance predicts, by frequency."""

    cycles: tuple[LimitCycle, ...]

    def content(self) -> Content:
        """The cycles in a table."""
        stable = [cycle for cycle in self.cycles if cycle.stable]
        signals = list(self.cycles[0].amplitudes) if self.cycles else []
        rows = [
            [cycle.omega, cycle.period, *cycle.amplitudes.values(), "stable" if cycle.stable else "unstable"]
            for cycle in self.cycles
        ]
        columns = ("omega [rad/s]", "period [s]", *(f"amplitude of {name}" for name in signals), "cycle")
        return Content(
            title="limit cycles by harmonic balance",
            summary=() if stable else ("no stable limit cycle is predicted",),
            faults=(f"{count_of(len(stable), 'stable limit cycle')} predicted",) if stable else (),
            tables=(Table(columns=columns, rows=rows),) if rows else (),
            notes=("signals are taken for sines: the loop must damp the third harmonic, and slow cycles are missed",),
        )


def limit_cycles(
    system: LinearSystem, elements: Mapping[str, tuple[str, Element]], *, amplitudes: tuple[float, float]
) -> LimitCycles:
    """Limit cycles of a linear system whose inputs come from its outputs through non-linear elements.

    Law:          y = G(j omega) u,  u_k = N_k(|y_k|) y_k,  N_k the first harmonic of element k over a sine of y_k
                  a cycle where det(1 - G N) = 0; it is stable if its mode decays with amplitudes a little larger

    Describing functions are made from the elements themselves, so that any function serves: Coulomb friction
    `-c np.sign(v)` from v to the torque, backlash `-k (d - np.clip(d, -b, b))` from the deflection of the teeth, an
    encoder `np.round(q / s) * s - q` from a position to the error of its measurement.

    Cycles whose amplitudes differ by less than a third, or just beyond the threshold of a jump, may be missed.

    Args:
        system: The loop without the elements, sampled or continuous: `taut.error_dynamics`, `taut.linearise`, ...
        elements: For an input of the system, the output that drives it and the function between them.
        amplitudes: The smallest and the largest amplitude of the first output to look at, in its unit.

    Raises:
        UnknownNameError: No such input or output.
        UsageError: No element, or one between several outputs and inputs.
        RangeError, ShapeError: Amplitudes that do not increase; an element that gives no number for each sample.

    Example:
        A relay of 1 around 1 / (s (s + 1) (s + 2)) oscillates at sqrt(2) rad/s with an amplitude of 2 / (3 pi).

        >>> import taut
        >>> chain = taut.LinearSystem(A=[[0, 1, 0], [0, 0, 1], [0, -2, -3]], B=[[0], [0], [1]], C=[[1, 0, 0]])
        >>> found = limit_cycles(chain, {"u[0]": ("y[0]", lambda y, rate: -np.sign(y))}, amplitudes=(0.01, 1.0))
        >>> [(round(c.omega, 3), round(c.amplitudes["y[0]"], 3), c.stable) for c in found.cycles]
        [(1.414, 0.212, True)]

    References:
        Khalil, Nonlinear systems (2002), section 7.2. Gelb and Vander Velde, Multiple-input describing functions and
        nonlinear system design (1968). Chapter, sections 10.1 and 10.2.1.4.
    """
    instance_of("system", system, LinearSystem, "a taut.LinearSystem")
    low, high = finite_array("amplitudes", amplitudes, shape=(2,)).tolist()
    if not 0.0 < low < high:
        raise RangeError(f"amplitudes must be two increasing numbers > 0; got {amplitudes!r}", name="amplitudes")
    if not elements:
        raise UsageError("elements must have one function or more, such as a friction from v to a torque",
                         name="elements")  # fmt: skip
    balance = _Balance(system, elements)
    speeds = np.abs(system.s_poles)
    speeds = speeds[speeds > 0.0] if (speeds > 0.0).any() else np.ones(1)
    top = math.inf if system.dt is None else BELOW_HALF_RATE * math.pi / system.dt
    band = speeds.min() / FREQUENCIES_BEYOND, min(FREQUENCIES_BEYOND * speeds.max(), top)
    names = [output for output, _ in elements.values()]
    points: list[Complex] = []
    with np.errstate(all="ignore"):
        for start in balance.starts(band, (low, high)):
            point = balance.solved(start)
            if point is not None and not _known(point, points):
                points.append(point)
    found = [
        LimitCycle(omega=float(point[0].real), amplitudes=dict(zip(names, abs(point[1:]).tolist(), strict=True)),
                   stable=balance.attracts(point))
        for point in points if low <= abs(point[1]) <= high and point[0].real < top
    ]  # fmt: skip
    return LimitCycles(cycles=tuple(sorted(found, key=lambda cycle: cycle.omega)))


def _known(point: Complex, others: list[Complex]) -> bool:
    return any(np.allclose(abs(point), abs(other), rtol=ALIKE, atol=0.0) for other in others)


def _refined(low: float, high: float, of: Callable[[Float64Array], Complex], largest: float) -> Float64Array:
    """Increasing numbers such that a function of them changes by little from one to the next."""
    points = np.geomspace(low, high, FIRST_GRID)
    values = of(points).reshape(FIRST_GRID, -1)
    for _ in range(REFINEMENTS):
        size = np.linalg.norm(values, axis=1)
        coarse = np.linalg.norm(np.diff(values, axis=0), axis=1) > largest * np.maximum(size[1:], size[:-1])
        if not coarse.any() or len(points) > MAX_GRID:
            break
        after = np.flatnonzero(coarse) + 1
        middle = np.sqrt(points[after - 1] * points[after])
        values = np.insert(values, after, of(middle).reshape(len(middle), -1), axis=0)
        points = np.insert(points, after, middle)
    return points


def _cells_of_roots(F: Complex) -> list[list[int]]:
    """(k, 2) cells of a grid (., .) in which a complex function may have a root: both its parts change their sign."""
    inside: Any = True
    for part in (F.real, F.imag):
        corners = np.stack([part[:-1, :-1], part[1:, :-1], part[:-1, 1:], part[1:, 1:]])
        least, largest = corners.min(axis=0), corners.max(axis=0)
        inside = inside & (np.abs(least + largest) <= (1.0 + 2.0 * CELL_MARGIN) * (largest - least))
    cells: list[list[int]] = np.argwhere(inside).tolist()
    return cells


class _Balance:
    """The harmonic balance of a system and its elements."""

    def __init__(self, system: LinearSystem, elements: Mapping[str, tuple[str, Element]]) -> None:
        columns = [column for name in elements for column in system.columns(name)]
        rows = [row for name, _ in elements.values() for row in system.rows(name)]
        if len(columns) != len(elements) or len(rows) != len(elements):
            raise UsageError(
                "elements go from one output to one input each; name them with their index, as in 'v[0]'",
                name="elements",
            )
        self.A, self.dt = system.A, system.dt
        self.B, self.C, self.D = system.B[:, columns], system.C[rows], system.D[np.ix_(rows, columns)]
        self.functions = [function for _, function in elements.values()]
        self.phase = 2.0 * np.pi * (np.arange(SAMPLES) + 0.5) / SAMPLES  # never at the corners of an element
        for name, function in zip(elements, self.functions, strict=True):
            given = function(np.sin(self.phase), np.cos(self.phase)) if callable(function) else function
            finite_array(f"what the element of '{name}' gives", given, shape=(SAMPLES,))

    def G(self, s: Any) -> Complex:
        """(..., m, m) from the inputs to the outputs."""
        z = np.asarray(np.exp(s * self.dt) if self.dt else s)[..., np.newaxis, np.newaxis]
        return np.asarray(self.C @ np.linalg.solve(z * np.eye(len(self.A)) - self.A, self.B + 0.0 * z) + self.D)

    def N(self, omega: float, sizes: Float64Array) -> Complex:
        """(m,) describing functions at amplitudes."""
        pairs = zip(self.functions, sizes.tolist(), strict=True)
        return np.array([self._harmonic(function, omega, size) for function, size in pairs])

    def _harmonic(self, function: Element, omega: float, size: float, *, exact: bool = True) -> complex:
        """Describing function of an element, linear between samples; exactly, its jumps are located between them."""
        (parts, repeats), phase = SECTIONS, self.phase
        for remaining in range(repeats if exact else 0, -1, -1):  # an element sees a whole period each time
            u = np.asarray(function(size * np.sin(phase), size * omega * np.cos(phase)), dtype=np.float64)
            change, width = np.diff(u, append=u[0]), np.diff(phase, append=phase[0] + 2.0 * np.pi)
            if not remaining:
                break
            unlike = np.minimum(*(np.abs(change - np.roll(change, side)) for side in (-1, 1)))  # those beside it
            at = np.flatnonzero(unlike > SMALLEST_JUMP * np.ptp(u))
            if not 0 < at.size <= MAX_JUMPS:
                break
            inner = phase[at, np.newaxis] + width[at, np.newaxis] * np.arange(1, parts) / parts
            phase = np.insert(phase, np.repeat(at + 1, parts - 1), inner.ravel())
        weight = np.sinc(width / (2.0 * np.pi)) * np.exp(-1j * (phase + 0.5 * width))
        return complex(change @ weight) / (np.pi * size)

    def starts(self, band: tuple[float, float], sizes: tuple[float, float]) -> list[Complex]:
        """(1 + m,) frequency and signals near every cycle: where the loop of one element balances on a grid.

        At each point the others' signals are iterated, from small and from large ones on, which converges for the
        element that dominates: each has a grid.
        """
        m, (low, high) = len(self.functions), sizes
        step = LARGEST_STEP[m > 1]
        omegas = _refined(*band, lambda w: self.G((1j + OFF_AXIS) * w), step)
        first = _refined(low, high, lambda a: self._table(0, np.array(band), a).T, step)
        wide = np.geomspace(OTHER_AMPLITUDES[0] * low, OTHER_AMPLITUDES[1] * high, OTHER_AMPLITUDES[2])
        N = [self._interpolated(k, omegas, wide if k else first) for k in range(m)]
        G, found = self.G((1j + OFF_AXIS) * omegas)[:, np.newaxis], list[Complex]()
        for one, initial in product(range(m), wide[[0, -1]][:m]):
            order, grid = [one, *(k for k in range(m) if k != one)], wide if one else first
            y = np.full((len(omegas), len(grid), m), initial)
            y[..., 0] = grid
            for _ in range(SWEEPS if m > 1 else 1):
                each = [N[k]((np.log(omegas)[:, np.newaxis], np.log(y[..., i]))) for i, k in enumerate(order)]
                loop = np.eye(m) - G[..., order, :][..., order] * np.stack(each, axis=-1)[..., np.newaxis, :]
                rest = np.linalg.solve(loop[..., 1:, 1:], -loop[..., 1:, :1])[..., 0] * y[..., :1]
                change = np.sqrt(np.clip(np.abs(rest), wide[0], wide[-1]) / y[..., 1:])
                y[..., 1:] *= change
            balance = loop[..., 0, 0] + np.sum(loop[..., 0, 1:] * rest / y[..., :1], axis=-1)
            balance[(np.abs(np.log(change)) > SETTLED_CHANGE).any(axis=-1)] = np.nan
            for i, j in _cells_of_roots(balance):
                signals = np.array([grid[j : j + 2].mean(), *rest[i, j]])[np.argsort(order)]
                found.append(np.array([omegas[i : i + 2].mean(), *(signals / signals[0] * abs(signals[0]))]))
        return found

    def _table(self, k: int, omegas: Float64Array, sizes: Float64Array) -> Complex:
        return np.array([[self._harmonic(self.functions[k], w, a, exact=False) for a in sizes] for w in omegas])

    def _interpolated(self, k: int, omegas: Float64Array, sizes: Float64Array) -> Any:
        """A describing function by logarithms of frequency and amplitude; most do not depend on the frequency."""
        coarse = np.geomspace(omegas[0], omegas[-1], COARSE_FREQUENCIES)
        table = self._table(k, coarse[[0, -1]], sizes)
        alike = np.allclose(table[0], table[1], rtol=ALIKE)
        coarse, table = (coarse[[0, -1]], table) if alike else (coarse, self._table(k, coarse, sizes))
        return RegularGridInterpolator((np.log(coarse), np.log(sizes)), table, bounds_error=False, fill_value=None)

    def solved(self, start: Complex) -> Complex | None:
        """(1 + m,) frequency and signals of a cycle near these, if the equations have a solution."""
        others = len(self.functions) - 1

        def point(x: Float64Array) -> Complex:
            ratios = x[2 : 2 + others] + 1j * x[2 + others :]
            ratios = np.where(np.abs(ratios) > LEAST_SIGNAL, ratios, LEAST_SIGNAL)
            omega, size = np.exp(np.clip(x[:2], -300.0, 300.0)).tolist()
            return np.array([omega, size, *(size * ratios)])

        def missing(x: Float64Array) -> Float64Array:
            omega, y = float(point(x)[0].real), point(x)[1:]
            left = (y - self.G(1j * omega) @ (self.N(omega, np.abs(y)) * y)) / y[0]
            return np.concatenate([left.real, left.imag])

        ratios = start[2:] / start[1]
        x = np.concatenate([np.log(np.abs(start[:2])), ratios.real, ratios.imag])
        out = root(missing, x, tol=1e-11, options={"maxfev": SOLVER_STEPS * len(x)})
        return point(out.x) if np.abs(out.fun).max() < MAX_RESIDUAL else None

    def attracts(self, point: Complex) -> bool:
        """Whether the mode of the cycle decays with larger amplitudes: Re ds/d(size) < 0 of det(1 - G(s) N) = 0."""

        def determinant(s: complex, sizes: Float64Array) -> Any:
            return np.linalg.det(np.eye(len(sizes)) - self.G(s) * self.N(omega, sizes))

        omega, sizes = float(point[0].real), np.abs(point[1:])
        s, step = 1j * omega, NUDGE * omega
        by_s = (determinant(s + step, sizes) - determinant(s - step, sizes)) / (2.0 * step)
        by_size = (determinant(s, sizes * (1.0 + NUDGE)) - determinant(s, sizes * (1.0 - NUDGE))) / (2.0 * NUDGE)
        return bool((-by_size / by_s).real < 0.0)
