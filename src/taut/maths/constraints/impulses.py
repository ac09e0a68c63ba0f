"""Impulses of rigid contacts that act together: they push and do not pull, stick and slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from taut.base.types import Matrix, Vector
from taut.trace import math as tm

CONTACT_SWEEPS: Final = 16  # of projections of each contact in its turn
CONTACT_NEWTON_STEPS: Final = 4  # of Newton's method for all contacts at once
STEP_LENGTHS: Final = (1.0, 0.3, 0.1)  # of a step of Newton's method, of which the best is taken
SLACK: Final = 1e-11  # of the diagonal, so that contacts that share a load need not be independent
MIN_SLIDING: Final = 1e-30  # of squares of velocities: keeps quotients finite at rest


@dataclass(frozen=True, kw_only=True)
class Touch:
    """The rows of one contact among all rows."""

    normal: int
    one_sided: bool
    beside: tuple[int, ...] = ()  # rows that hold both ways as long as it touches, such as the tilts of a face
    tangents: tuple[int, ...] = ()  # two rows in which it rubs, or none

    @property
    def held(self) -> tuple[int, ...]:
        """The rows without friction."""
        return (self.normal, *self.beside)


def contact_impulses(
    W: Matrix,  # (m, m) velocities per impulse, B M^-1 B^T
    r: Vector,
    touches: Sequence[Touch],  # rows of each contact; each row belongs to one
    mu: Sequence[Any],  # of each contact, with respect to p_n; not used without tangents
    there: Sequence[Any],  # whether each contact may act at all
    guess: Vector | Sequence[Any],  # (m,) impulses to start from
) -> Vector:
    """Impulses p (m,) of contacts, from the velocities r that their rows would have without any.

    With u = r + W p, for each contact

        u_n = 0, or of a one-sided one   u_n >= 0,  p_n >= 0,  u_n p_n = 0
        u_t = 0 and |p_t| <= mu |p_n|,   or   p_t = -mu |p_n| u_t / |u_t|

    the last with a round cone. Both are projections: p_n of p_n - u_n / W_nn, then p_t of p_t - u_t / W_tt on the
    cone. The contacts take turns in a fixed number of such projections, so that it is straight-line code. Newton's
    method then solves for all of them together, as they touch, stick and slide; of each step the best of three
    lengths is taken, or none where none helps.

    References:
        Alart and Curnier, A mixed formulation for frictional contact problems prone to Newton like solution methods,
        Computer Methods in Applied Mechanics and Engineering 92 (1991).
    """
    p, alone = list(guess), len(touches) == 1 and not touches[0].tangents
    if not alone:
        W = W + SLACK * sum(W[i, i] for i in range(len(p))) / len(p) * tm.eye(len(p))
    for _ in range(1 if alone else CONTACT_SWEEPS):
        for touch, friction, may in zip(touches, mu, there, strict=True):
            for i, value in _Projected.of(W, r, touch, friction, may, p).impulses.items():
                p[i] = value
    if alone:
        return tm.array(p)

    def projected(p: Sequence[Any]) -> tuple[list[_Projected], Any]:
        """All contacts at impulses p, and how far p is from its projection, squared."""
        states = [_Projected.of(W, r, *of, p) for of in zip(touches, mu, there, strict=True)]
        missed = [p[i] - value for state in states for i, value in state.impulses.items()]
        return states, _sum(0.0, zip(missed, missed, strict=True))

    for _ in range(CONTACT_NEWTON_STEPS):
        states, least = projected(p)
        new, best = _newton(W, r, states), p
        for length in STEP_LENGTHS:
            trial = [a + length * (b - a) for a, b in zip(p, new, strict=True)]
            missed = projected(trial)[1]
            better = missed < least
            best = [choose(better, a, b) for a, b in zip(trial, best, strict=True)]
            least = choose(better, missed, least)
        p = best
    return tm.array(p)


def held_impulses(W: Matrix, u: Vector, held: Sequence[Any]) -> Vector:
    """(m,) impulses that change the velocities of rows that are held by -u, and of the others are zero."""
    m = len(u)
    if m == 1:
        return tm.array([choose(held[0], -u[0] / W[0, 0], 0.0)])
    A: list[list[Any]] = [[0.0] * m for _ in range(m)]
    for i in range(m):
        for j in range(i):
            A[i][j] = A[j][i] = choose(both(held[i], held[j]), W[i, j], 0.0)
        A[i][i] = choose(held[i], W[i, i] * (1.0 + SLACK), 1.0)
    rhs = [choose(held[i], -u[i], 0.0) for i in range(m)]
    solved: Vector = tm.solve_spd(tm.array(A), tm.array(rhs))
    return solved


@dataclass(frozen=True, kw_only=True)
class _Projected:
    """A contact at some impulses p: what their projection is, and whether it touches and sticks there."""

    touch: Touch
    impulses: dict[int, Any]  # of its rows
    on: Any  # whether it touches
    sticks: Any = False
    d: tuple[Any, Any] = (0.0, 0.0)  # z / |z| with z = p_t - step u_t
    fraction: Any = 0.0  # limit of friction over |z|
    step: Any = 0.0  # impulse per velocity
    mu: Any = 0.0  # with the sign of the normal impulse

    @classmethod
    def of(cls, W: Matrix, r: Vector, touch: Touch, mu: Any, there: Any, p: Sequence[Any]) -> _Projected:
        def u(i: int) -> Any:
            return _sum(r[i], ((W[i, j], p[j]) for j in range(len(r))))

        held = touch.held
        stop = tm.solve_spd(tm.array([[W[i, j] for j in held] for i in held]), tm.array([u(i) for i in held]))
        push = {i: p[i] - part for i, part in zip(held, stop, strict=True)}
        on = both(there, push[touch.normal] > 0.0) if touch.one_sided else there
        impulses = {i: choose(on, value, 0.0) for i, value in push.items()}
        if not touch.tangents:
            return cls(touch=touch, impulses=impulses, on=on)
        signed = mu if touch.one_sided else choose(p[touch.normal] < 0.0, -mu, mu)
        step = 2.0 / sum(W[i, i] for i in touch.tangents)
        # Friction is of the new normal impulse: that converges where both are strongly coupled.
        p = [impulses.get(i, value) for i, value in enumerate(p)]
        z = [p[i] - step * u(i) for i in touch.tangents]
        size = tm.sqrt(z[0] * z[0] + z[1] * z[1] + MIN_SLIDING)
        fraction = tm.maximum(signed * p[touch.normal], 0.0) / size
        for i, value in zip(touch.tangents, z, strict=True):
            impulses[i] = choose(on, tm.minimum(fraction, 1.0) * value, 0.0)
        return cls(
            touch=touch, impulses=impulses, on=on, sticks=both(on, fraction >= 1.0),
            d=(z[0] / size, z[1] / size), fraction=fraction, step=step, mu=signed,
        )  # fmt: skip


def _newton(W: Matrix, r: Vector, states: Sequence[_Projected]) -> list[Any]:
    """One step of Newton's method for all impulses: exact for those that stick, touch or are apart as they do now."""
    m = len(r)
    A = [[0.0] * m for _ in range(m)]
    rhs: list[Any] = [0.0] * m

    def stopped(i: int, holds: Any) -> None:
        for j in range(m):
            A[i][j] = choose(holds, W[i, j], 1.0 if i == j else 0.0)
        rhs[i] = choose(holds, -r[i], 0.0)

    for now in states:
        touch = now.touch
        for i in touch.held:
            stopped(i, now.on)
        slides = both(now.on, opposite(now.sticks))
        for k, i in enumerate(touch.tangents):
            stopped(i, now.sticks)
            # p_t - fraction P (p_t - step u_t) - mu d p_n = 0 with P = 1 - d d^T, across the direction of sliding
            across = [(1.0 if e == k else 0.0) - now.d[k] * now.d[e] for e in range(2)]
            pull = now.fraction * now.step
            for j in range(m):
                entry = _sum(0.0, ((pull * across[e], W[t, j]) for e, t in enumerate(touch.tangents)))
                if j == touch.normal:
                    entry = entry - now.mu * now.d[k]
                if j in touch.tangents:
                    entry = entry + (1.0 if i == j else 0.0) - now.fraction * across[touch.tangents.index(j)]
                A[i][j] = choose(slides, entry, A[i][j])
            lost = _sum(0.0, ((pull * across[e], r[t]) for e, t in enumerate(touch.tangents)))
            rhs[i] = choose(slides, -lost, rhs[i])
    return list(tm.solve(tm.array(A), tm.array(rhs)))


def _sum(start: Any, products: Any) -> Any:
    for a, b in products:
        start = start + a * b
    return start


def both(a: Any, b: Any) -> Any:
    """Both hold; either may be known when traced."""
    if isinstance(a, bool):
        return b if a else False
    if isinstance(b, bool):
        return a if b else False
    return a & b


def opposite(a: Any) -> Any:
    """It does not hold."""
    return not a if isinstance(a, bool) else ~a


def choose(condition: Any, a: Any, b: Any) -> Any:
    """a where the condition holds, else b; it may be known when traced."""
    if isinstance(condition, bool):
        return a if condition else b
    return tm.where(condition, a, b)
