"""Limit cycles of a linear loop with friction, backlash or steps of an encoder in it, by describing functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np
from scipy.optimize import root

from taut.base.checks import finite_array, instance_of
from taut.base.errors import RangeError, UsageError, count_of
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.linear.linear_system import Complex, LinearSystem

Element = Callable[[Float64Array, Float64Array], ArrayLike]
"""What a signal and its rate, both (k,) over one period of a sine, give: lambda y, rate: -0.4 * np.sign(rate)."""

SAMPLES: Final = 512  # of a sine
SOLVER_STARTS: Final = (24, 12)  # frequencies and amplitudes from which the equations are solved
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

    Args:
        system: The loop without the elements, sampled or continuous: `taut.error_dynamics`, `taut.linearise`, ...
        elements: For an input of the system, the output that drives it and the function between them.
        amplitudes: The smallest and the largest amplitude of the first output to look at, in its unit.

    Raises:
        UnknownNameError: No such input or output.
        UsageError: No element, or one that is not a function of a signal and its rate.
        RangeError: Amplitudes that do not increase.

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
    low_speed, high_speed = speeds.min() / FREQUENCIES_BEYOND, min(FREQUENCIES_BEYOND * speeds.max(), top)
    names = [output for output, _ in elements.values()]
    found: list[LimitCycle] = []
    starts = product(np.geomspace(low_speed, high_speed, SOLVER_STARTS[0]), np.geomspace(low, high, SOLVER_STARTS[1]))
    for omega, size in starts:
        cycle = balance.solved(omega, size)
        if cycle is None or not (low <= cycle[1][0] <= high and cycle[0] < top):
            continue
        each = dict(zip(names, cycle[1].tolist(), strict=True))
        made = LimitCycle(omega=cycle[0], amplitudes=each, stable=balance.attracts(*cycle))
        if not any(_alike(made, other) for other in found):
            found.append(made)
    return LimitCycles(cycles=tuple(sorted(found, key=lambda cycle: cycle.omega)))


def _alike(one: LimitCycle, other: LimitCycle) -> bool:
    a, b = ([cycle.omega, *cycle.amplitudes.values()] for cycle in (one, other))
    return bool(np.allclose(a, b, rtol=ALIKE, atol=0.0))


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
        self.first = 2.0j * np.exp(-1j * self.phase) / SAMPLES
        for name, function in zip(elements, self.functions, strict=True):
            given = function(np.sin(self.phase), np.cos(self.phase)) if callable(function) else function
            finite_array(f"what the element of '{name}' gives", given, shape=(SAMPLES,))

    def G(self, s: complex) -> Complex:
        """(m, m) from the inputs to the outputs."""
        z = np.exp(s * self.dt) if self.dt else s
        return np.asarray(self.C @ np.linalg.solve(z * np.eye(len(self.A)) - self.A, self.B) + self.D)

    def N(self, omega: float, sizes: Float64Array) -> Complex:
        """(m,) describing functions at amplitudes."""
        out = []
        for function, size in zip(self.functions, sizes.tolist(), strict=True):
            y, rate = size * np.sin(self.phase), size * omega * np.cos(self.phase)
            out.append(self.first @ np.asarray(function(y, rate)) / size)
        return np.array(out)

    def solved(self, omega: float, size: float) -> tuple[float, Float64Array] | None:
        """Frequency and amplitudes of a cycle near these, if the equations have a solution."""
        m = len(self.functions)
        loop = np.eye(m) - self.G(1j * omega) * self.N(omega, np.full(m, size))
        shape = np.linalg.svd(loop)[2][-1].conj()  # nearly in balance
        shape = shape / shape[0] if shape[0] else np.ones(m)
        start = np.concatenate([[math.log(omega), math.log(size)], shape[1:].real, shape[1:].imag])

        def missing(x: Float64Array) -> Float64Array:
            omega, y = self._unpacked(x)
            left = (y - self.G(1j * omega) @ (self.N(omega, np.abs(y)) * y)) / y[0]
            return np.concatenate([left.real, left.imag])

        with np.errstate(all="ignore"):
            out = root(missing, start, tol=1e-11)
        if not np.abs(out.fun).max() < MAX_RESIDUAL:
            return None
        omega, y = self._unpacked(out.x)
        return omega, np.abs(y)

    def _unpacked(self, x: Float64Array) -> tuple[float, Complex]:
        omega, size = np.exp(np.clip(x[:2], -300.0, 300.0)).tolist()
        others = len(self.functions) - 1
        ratios = np.concatenate([[1.0], x[2 : 2 + others] + 1j * x[2 + others :]])
        return omega, np.where(np.abs(ratios) > LEAST_SIGNAL, ratios, LEAST_SIGNAL) * size

    def attracts(self, omega: float, sizes: Float64Array) -> bool:
        """Whether the mode of the cycle decays with larger amplitudes: Re ds/d(size) < 0 of det(1 - G(s) N) = 0."""

        def determinant(s: complex, sizes: Float64Array) -> Any:
            return np.linalg.det(np.eye(len(sizes)) - self.G(s) * self.N(omega, sizes))

        s, step = 1j * omega, NUDGE * omega
        by_s = (determinant(s + step, sizes) - determinant(s - step, sizes)) / (2.0 * step)
        by_size = (determinant(s, sizes * (1.0 + NUDGE)) - determinant(s, sizes * (1.0 - NUDGE))) / (2.0 * NUDGE)
        return bool((-by_size / by_s).real < 0.0)
