"""Random loops with one non-linear element, and their limit cycles by another way: closed-loop roots over amplitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import taut
from taut.base.types import Float64Array

POINTS = 1500  # amplitudes at which the roots are followed
Function = Callable[[Float64Array, Float64Array], Float64Array]


@dataclass(frozen=True)
class Case:
    """A chain -G(s) with an element whose describing function N(A) is known in closed form."""

    kind: str
    numerator: Float64Array
    denominator: Float64Array
    element: Function
    N: Callable[[Float64Array], Float64Array]  # complex
    amplitudes: tuple[float, float]

    @property
    def system(self) -> taut.LinearSystem:
        n = len(self.denominator) - 1
        A = np.eye(n, k=1)
        A[-1] = -self.denominator[:0:-1]
        C = np.zeros((1, n))
        C[0, : len(self.numerator)] = self.numerator[::-1]
        return taut.LinearSystem(A=A, B=-np.eye(n)[:, -1:], C=C)

    def cycles(self) -> list[tuple[float, float, bool]]:
        """Frequency, amplitude and stability wherever a root of den + N(A) num = 0 crosses the imaginary axis."""
        coarse = self._crossings(np.geomspace(*self.amplitudes, POINTS))
        return [self._crossings(np.geomspace(low, high, 50))[0][:3] for *_, low, high in coarse]

    def apart(self, cycles: list[tuple[float, float, bool]]) -> list[tuple[float, float, bool]]:
        """Those that no other is near to, nor the threshold of a jump, just beyond which N changes by 20 % within 1 %."""
        out = []
        for cycle in cycles:
            before, after = self.N(cycle[1] * np.array([0.9995, 1.0005]))
            near = sum(abs(np.log(other[1] / cycle[1])) < 0.3 for other in cycles)
            if near == 1 and abs(after - before) < 0.02 * abs(after):
                out.append(cycle)
        return out

    def _crossings(self, sizes: Float64Array) -> list[tuple[float, float, bool, float, float]]:
        n = len(self.denominator) - 1
        padded = np.concatenate([np.zeros(n + 1 - len(self.numerator)), self.numerator])
        companion = np.tile(np.eye(n, k=1) + 0j, (len(sizes), 1, 1))
        companion[:, -1] = -(self.denominator + self.N(sizes)[:, np.newaxis] * padded)[:, :0:-1]
        roots, found = np.linalg.eigvals(companion), []
        for before, after, low, high in zip(roots, roots[1:], sizes, sizes[1:], strict=False):
            for s in before[before.imag > 1e-9]:
                t = after[np.argmin(np.abs(after - s))]
                if (s.real < 0.0) != (t.real < 0.0):
                    found.append((float(s.imag), float(low), bool(t.real < 0.0), float(low), float(high)))
        return found


def root(x: Float64Array) -> Float64Array:
    return np.sqrt(np.maximum(x, 0.0))


def limited(x: Float64Array) -> Float64Array:
    """Describing function of a unit saturation at amplitude 1 / x."""
    x = np.minimum(x, 1.0)
    return 2.0 / np.pi * (np.arcsin(x) + x * root(1.0 - x * x))


def element(kind: str, rng: np.random.Generator) -> tuple[Function, Callable[[Float64Array], Float64Array], float]:
    """An element, its describing function, and the amplitude from which on it answers."""
    c, d = 10.0 ** rng.uniform(-1.0, 1.0, 2)
    if kind == "relay":
        return lambda y, _: c * np.sign(y), lambda A: 4.0 * c / (np.pi * A), 1e-3 * d
    if kind == "relay with hysteresis":
        return (
            lambda y, rate: c * np.sign(y - d * np.sign(rate)),
            lambda A: 4.0 * c / (np.pi * A) * (root(1.0 - (d / A) ** 2) - 1j * d / A),
            d,
        )
    if kind == "relay with dead zone":
        return (
            lambda y, _: c * np.sign(y) * (np.abs(y) > d),
            lambda A: 4.0 * c / (np.pi * A) * root(1.0 - (d / A) ** 2),
            d,
        )
    if kind == "saturation":
        return lambda y, _: c * np.clip(y, -d, d), lambda A: c * limited(d / A), d
    if kind == "dead zone":
        return lambda y, _: c * (y - np.clip(y, -d, d)), lambda A: c * (1.0 - limited(d / A)), d
    if kind == "limited beyond a dead zone":
        e = d * rng.uniform(1.2, 4.0)
        return (
            lambda y, _: c * (np.clip(y, -e, e) - np.clip(y, -d, d)),
            lambda A: c * (limited(e / A) - limited(d / A)),
            d,
        )
    if kind == "quantiser":
        steps = d * (np.arange(400) + 0.5)[:, np.newaxis]
        return (
            lambda y, _: d * np.round(y / d),
            lambda A: 4.0 * d / (np.pi * A) * root(1.0 - (steps / A) ** 2).sum(axis=0),
            0.5 * d,
        )
    if kind == "stiction":  # Stribeck's, of a velocity
        least, angle = rng.uniform(0.1, 1.0), (np.arange(2000) + 0.5)[:, np.newaxis] * np.pi / 4000.0

        def friction(v: Float64Array) -> Float64Array:
            return c * np.sign(v) * (least + (1.0 - least) * np.exp(-((v / d) ** 2)))

        sine = np.sin(angle)
        return lambda v, _: friction(v), lambda A: (friction(A * sine) * sine).mean(axis=0) * 2.0 / A, 0.01 * d
    assert kind == "backlash"

    def play(y: Float64Array, rate: Float64Array) -> Float64Array:
        end = np.abs(y).max() - d
        return np.where(rate > 0.0, np.maximum(y - d, -end), np.minimum(y + d, end))

    def of_play(A: Float64Array) -> Float64Array:
        x = 1.0 - 2.0 * d / A
        return 0.5 + (np.arcsin(x) + x * root(1.0 - x * x)) / np.pi - 4j * d / (np.pi * A) * (1.0 - d / A)

    return play, of_play, d


KINDS = (
    "relay", "relay with hysteresis", "relay with dead zone", "saturation", "dead zone", "limited beyond a dead zone",
    "quantiser", "backlash", "stiction",
)  # fmt: skip


def case(seed: int) -> Case:
    """A chain of three to five real poles, an integrator often among them, at times with a pair of zeros."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    function, N, least = element(kind, rng)
    poles = -(10.0 ** rng.uniform(-1.0, 1.5, rng.integers(3, 6)))
    poles[: rng.integers(0, 2 + (kind == "saturation"))] = 0.0
    zeros = -(10.0 ** rng.uniform(-0.5, 1.5, 2 * rng.integers(0, 2) if len(poles) > 3 else 0))
    numerator, denominator = np.poly(zeros) if len(zeros) else np.ones(1), np.poly(poles)
    if kind == "stiction":  # a mass under PID
        d, kp = 10.0 ** rng.uniform(-1.0, 1.5), 10.0 ** rng.uniform(0.0, 3.0)
        ki = kp * (d + abs(N(np.array([least * 10.0 ** rng.uniform(0.0, 2.0)]))[0]))
        return Case(kind, np.array([1.0, 0.0, 0.0]), np.array([1.0, d, kp, ki]), function, N, (least, 300.0 * least))
    w = 10.0 ** rng.uniform(-0.5, 1.0)  # the gain is about that at which it oscillates
    gain = 10.0 ** rng.uniform(-0.3, 0.8) * abs(np.polyval(denominator, 1j * w) / np.polyval(numerator, 1j * w))
    reach = (1.001 * least, 300.0 * least if kind != "relay" else 1e7 * least)
    return Case(
        kind, gain / max(1.0, abs(N(np.array([3.0 * least]))[0])) * numerator, denominator, function, N, reach
    )
