"""Passive things that touch a sampled loop: seeded ones, and the worst there is, with the eigenvalues of both together.

Written apart from `taut.study`, whose oracle it is: continuous masses and springs, and a law that samples them.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import expm
from scipy.signal import butter, tf2ss

from taut.base.types import Float64Array


@dataclass(frozen=True, kw_only=True)
class Hand:
    """A slide of mass m and damping b, seen by a law K x + B v at a rate, with delay and a low-pass of v."""

    m: float
    b: float
    K: float
    B: float = 0.0
    rate: float = 1000.0
    delay: float = 0.0
    differenced: bool = True
    cutoff: float | None = None


@dataclass(frozen=True, kw_only=True)
class Thing:
    """A ground spring, a rigid mass, and masses on springs, all held by the tip."""

    k0: float = 0.0
    m0: float = 0.0
    k: tuple[float, ...] = ()
    mu: tuple[float, ...] = ()

    def rates(self, m: float, b: float) -> tuple[Float64Array, Float64Array, Float64Array]:
        """A, column of the law's force, row of the tip's position and of its velocity: states x, z, then their speeds."""
        k, mu, n = np.array(self.k), np.array(self.mu), 1 + len(self.k)
        masses = np.array([m + self.m0, *mu])
        stiff = np.diag(np.array([self.k0 + k.sum(), *k]))
        stiff[0, 1:] = stiff[1:, 0] = -k
        damp = np.zeros((n, n))
        damp[0, 0] = b
        A = np.block([[np.zeros((n, n)), np.eye(n)], [-stiff / masses[:, None], -damp / masses[:, None]]])
        force = np.zeros((2 * n, 1))
        force[n, 0] = 1.0 / masses[0]
        seen = np.zeros((2, 2 * n))
        seen[0, 0] = seen[1, n] = 1.0
        return A, force, seen


def random_thing(rng: np.random.Generator, m: float, rate: float) -> Thing:
    """Up to four masses on springs, some with a rigid mass or a spring to the ground; resonances to four times the rate."""
    count = int(rng.integers(0, 5))
    mu = m * 10.0 ** rng.uniform(-2.0, 2.0, count)
    omega = rate * 10.0 ** rng.uniform(-3.0, math.log10(8.0 * math.pi), count)
    k0 = m * (rate * 10.0 ** rng.uniform(-3.0, math.log10(2.0 * math.pi))) ** 2
    return Thing(
        k0=k0 if rng.uniform() < 0.5 else 0.0,
        m0=m * 10.0 ** rng.uniform(-2.0, 2.0) if rng.uniform() < 0.5 else 0.0,
        k=tuple((mu * omega**2).tolist()),
        mu=tuple(mu.tolist()),
    )


def radius(hand: Hand, thing: Thing) -> float:
    """Largest pole of the two together, sampled, exactly."""
    A, force, seen = thing.rates(hand.m, hand.b)
    n, T = len(A), 1.0 / hand.rate
    held = np.block([[A, force], [np.zeros((1, n + 1))]])
    whole = math.floor(hand.delay / T + 1e-9)
    part = max(hand.delay / T - whole, 0.0)
    part = 0.0 if part < 1e-9 else part
    first, second = expm(held * part * T), expm(held * (1.0 - part) * T)
    step = second[:n, :n] @ first[:n, :n]
    old, new = second[:n, :n] @ first[:n, n:], second[:n, n:]
    a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    if hand.cutoff is not None:
        a, b, c, d = low_pass(hand.cutoff, hand.rate)
    taps = whole + (1 if part else 0)
    N = n + 1 + len(a) + taps  # state, last position, filter, forces under way
    raw = np.zeros((1, N))
    if hand.differenced:
        raw[0, :n], raw[0, n] = seen[0] / T, -1.0 / T
    else:
        raw[0, :n] = seen[1]
    law = hand.B * d @ raw
    law[0, :n] += hand.K * seen[0]
    law[0, n + 1 : n + 1 + len(a)] += hand.B * c[0]
    at = n + 1 + len(a)
    under_way = [law, *(np.eye(N)[at + i : at + i + 1] for i in range(taps))]
    loop = np.zeros((N, N))
    loop[:n, :n] = step
    loop[:n] -= new @ under_way[whole] + (old @ under_way[whole + 1] if part else 0.0)
    loop[n, :n] = seen[0]
    loop[n + 1 : at, n + 1 : at] = a
    loop[n + 1 : at] += b @ raw
    for i in range(taps):
        loop[at + i] = under_way[i]
    return float(np.abs(np.linalg.eigvals(loop)).max())


# -------------------------------------------------------------------- the worst thing


def worst_thing(hand: Hand, *, pairs: int = 6, heavy: float = 30.0) -> Thing:
    """A passive thing that brings the loop as near to instability as resonances near `2 pairs` aliases can.

    At each alias omega_n of the worst frequency the tip's mobility may be any (1 + exp(j phi)) / 2b, for the thing's
    reactance may be any. Reactances X_n are placed so that what comes back of a sampled force is largest, by a mode of
    `heavy` times the least mass that holds X_n near omega_n. Modes in series are the partial fractions of the
    mobility; those of its inverse are the thing.
    """
    T, best = 1.0 / hand.rate, (math.inf, np.zeros(0), np.zeros(0))
    for theta in np.linspace(1e-3, math.pi, 2001):
        omega = np.array([(theta + 2.0 * math.pi * n) / T for n in range(-pairs, pairs)])
        F = 1.0 if hand.cutoff is None else response(hand, theta)
        by_v = F * (1.0 - np.exp(-1j * theta)) / (1j * omega * T) if hand.differenced else F
        hold = (1.0 - np.exp(-1j * omega * T)) / (1j * omega * T) * np.exp(-1j * omega * hand.delay)
        w = hold * (hand.K / (1j * omega) + hand.B * by_v)
        distance = abs(2.0 * hand.b + w.sum()) - np.abs(w).sum()
        if distance < best[0]:
            towards = -(2.0 * hand.b + w.sum()) / abs(2.0 * hand.b + w.sum())
            best = distance, omega, np.angle(towards * w.conj())
    distance, omega, phi = best
    X = -hand.b * np.tan(np.clip(phi, -3.0, 3.0) / 2.0)
    omega, X = np.abs(omega), np.where(omega < 0.0, -X, X)
    order = np.argsort(omega)
    omega, X = omega[order], X[order]
    keep = np.append(True, np.diff(omega) > 0.02 / T)  # at pi / T aliases come in pairs
    omega, X = omega[keep], X[keep]
    share = np.maximum(1.0, np.abs(X) / hand.b)
    modal = max(heavy * hand.b * T, len(omega) * hand.m) * share
    return of_modes(omega - X / (2.0 * modal), modal, hand.m)


@cache
def low_pass(cutoff: float, rate: float) -> tuple[Float64Array, ...]:
    return tuple(tf2ss(*butter(1, cutoff, fs=rate)))


def response(hand: Hand, theta: float) -> complex:
    k, z = math.tan(math.pi * (hand.cutoff or 0.0) / hand.rate), np.exp(-1j * theta)
    return complex(k * (1.0 + z) / (1.0 + k + (k - 1.0) * z))


def of_modes(omega: Float64Array, modal: Float64Array, m: float) -> Thing:
    """The thing that, with a tip of mass m, has the mobility sum s / (modal (s^2 + omega^2))."""
    total = 1.0 / (1.0 / modal).sum()
    assert total >= m * (1.0 - 1e-12)
    # Zeros of the mobility are roots of sum 1 / (modal (omega^2 - p)), one between each two omega^2.
    p = []
    w2 = omega**2
    for low, high in itertools.pairwise(w2):
        a, b = low * (1.0 + 1e-13), high * (1.0 - 1e-13)
        for _ in range(200):
            middle = 0.5 * (a + b)
            if (1.0 / (modal * (w2 - middle))).sum() > 0.0:
                b = middle
            else:
                a = middle
        p.append(0.5 * (a + b))
    # Impedance: total s + k0 / s + sum k s / (s^2 + p).
    slope = [(1.0 / (modal * (w2 - each) ** 2)).sum() for each in p]
    k = 1.0 / (np.array(slope) * np.array(p))
    k0 = 1.0 / (1.0 / (modal * w2)).sum()
    mu = k / np.array(p)
    return Thing(k0=float(k0), m0=max(float(total - m), 0.0), k=tuple(k.tolist()), mu=tuple(mu.tolist()))
