"""Impulses of rigid contacts that act together: they push and do not pull, stick and slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from taut.base.types import Matrix, Vector
from taut.trace import math as tm
from taut.trace.linalg import LTDL, factor_spd

CONTACT_SWEEPS: Final = 4  # of block Gauss-Seidel where several contacts act together
SLIDING_ROUNDS: Final = 3  # of the direction of sliding, which depends on the normal force and the other way round
CONTACT_NEWTON_STEPS: Final = 3  # of Newton's method for all contacts at once
SLACK: Final = 1e-11  # of the diagonal, so that contacts that share a load need not be independent
JAMMED: Final = 1e-3  # smallest fraction of a normal mobility that friction leaves; below it rigid bodies jam
MIN_SLIDING: Final = 1e-30  # of squares of velocities: keeps quotients finite at rest


@dataclass(frozen=True, kw_only=True)
class Touch:
    """The rows of one contact among all rows."""

    normal: int
    one_sided: bool
    beside: tuple[int, ...] = ()  # rows that hold both ways as long as it touches, such as the tilts of a face
    tangents: tuple[int, ...] = ()  # two rows in which it rubs, or none
    spin: int | None = None  # row in which it rubs as it turns about its normal, if any

    @property
    def held(self) -> tuple[int, ...]:
        """The rows without friction."""
        return (self.normal, *self.beside)

    @property
    def rubs(self) -> tuple[int, ...]:
        """The rows with friction."""
        return self.tangents if self.spin is None else (*self.tangents, self.spin)


def contact_impulses(
    W: Matrix,  # (m, m) velocities per impulse, B M^-1 B^T
    r: Vector,
    touches: Sequence[Touch],  # rows of each contact; each row belongs to one
    mu: Sequence[Any],  # of each contact, with respect to p_n; not used without tangents
    there: Sequence[Any],  # whether each contact may act at all
    guess: Sequence[Any],  # (m,) impulses to start from, where there are several contacts
    *,
    radius: Sequence[Any] | None = None,  # of each contact, moment about the normal over friction
    sweeps: int = CONTACT_SWEEPS,
) -> Vector:
    """Impulses p (m,) of contacts, from the velocities r that their rows would have without any.

    With u = r + W p, for each contact

        u_n = 0, or of a one-sided one   u_n >= 0,  p_n >= 0,  u_n p_n = 0
        u_t = 0 and |p_t| <= mu |p_n|,   or   p_t = -mu |p_n| u_t / |u_t|

    the last with a round cone; of its spin |p_s| <= radius mu |p_n| in the same way. The contacts take turns, in a
    fixed number of sweeps so that it is straight-line code: each finds whether it sticks, from the impulses that
    would stop it, else roughly where it slides. Newton's method then solves for all of them together, as they touch,
    stick and slide: three steps, of which one that does not help is not taken.

    References:
        Alart and Curnier, A mixed formulation for frictional contact problems prone to Newton like solution methods,
        Computer Methods in Applied Mechanics and Engineering 92 (1991).
    """
    blocks = [_Block.of(W, touch) for touch in touches]
    alone, reach = len(blocks) == 1, [0.0] * len(blocks) if radius is None else radius
    p = [0.0] * len(r) if alone else list(guess)
    for _ in range(1 if alone else sweeps):
        for c, block in enumerate(blocks):
            own = set(block.rows)
            others = [j for j in range(len(r)) if j not in own]
            free = {i: _sum(r[i], ((W[i, j], p[j]) for j in others)) for i in block.rows}
            block.solve(free, p, mu[c], there[c])
            if touches[c].spin is not None:
                _turn(W, r, touches[c], p, mu[c] * reach[c])
    if alone and not touches[0].tangents:
        return tm.array(p)
    modes, miss = _modes(W, r, touches, mu, reach, there, p)
    for _ in range(CONTACT_NEWTON_STEPS):
        new = _newton(W, r, touches, modes)
        new_modes, left = _modes(W, r, touches, mu, reach, there, new)
        better = left < miss
        p = [choose(better, a, b) for a, b in zip(new, p, strict=True)]
        modes = [now.instead(old, better) for now, old in zip(new_modes, modes, strict=True)]
        miss = choose(better, left, miss)
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
class _Block:
    """One contact, the impulses of the others given."""

    touch: Touch
    held: LTDL  # of the rows without friction
    all: LTDL | None  # of all
    across: Matrix | None  # (held, 2) velocities of those rows per impulse of the tangents
    plane: Matrix | None  # (2, 2) of the tangents

    @classmethod
    def of(cls, W: Matrix, touch: Touch) -> _Block:
        held, tangents = list(touch.held), list(touch.tangents)
        inner = _part(W, held, held)
        if not tangents:
            return cls(touch=touch, held=factor_spd(inner), all=None, across=None, plane=None)
        rows = held + tangents
        return cls(
            touch=touch,
            held=factor_spd(inner),
            all=factor_spd(_regularised(_part(W, rows, rows))),
            across=_part(W, held, tangents),
            plane=_part(W, tangents, tangents),
        )

    @property
    def rows(self) -> tuple[int, ...]:
        return (*self.touch.held, *self.touch.tangents)

    def solve(self, r: dict[int, Any], p: list[Any], mu: Any, there: Any) -> None:
        """Write its impulses into p, from velocities without them."""
        held, tangents = self.touch.held, self.touch.tangents
        r_h = tm.array([r[i] for i in held])
        y = self.held.solve(r_h)
        best = [-entry for entry in y]
        if tangents:
            best = self._rubbing(r_h, tm.array([r[i] for i in tangents]), y, best, mu)
        on = there if not self.touch.one_sided else both(there, best[0] > 0.0)
        for i, value in zip(self.rows, best, strict=True):
            p[i] = choose(on, value, 0.0)

    def _rubbing(self, r_h: Vector, r_t: Vector, y: Vector, p_h: list[Any], mu: Any) -> list[Any]:
        assert self.all is not None
        assert self.across is not None
        assert self.plane is not None
        stop = -self.all.solve(tm.array([*r_h, *r_t]))
        h = len(p_h)
        pressed = mu * stop[0]
        sticks = stop[h] * stop[h] + stop[h + 1] * stop[h + 1] <= pressed * pressed
        if self.touch.one_sided:
            sticks = both(sticks, stop[0] > 0.0)
        signed, d, speed = mu, (0.0, 0.0), None
        for _ in range(SLIDING_ROUNDS):
            if not self.touch.one_sided:
                signed = choose(p_h[0] < 0.0, -mu, mu)
            z = [_sum(r_t[k], ((self.across[i, k], p_h[i]) for i in range(h))) for k in range(2)]
            d, speed = _sliding(self.plane, z, tm.maximum(signed * p_h[0], 0.0), speed)
            bent = self.held.solve(tm.array([self.across[i, 0] * d[0] + self.across[i, 1] * d[1] for i in range(h)]))
            normal = -y[0] / tm.maximum(1.0 - signed * bent[0], JAMMED)
            p_h = [normal, *(signed * normal * bent[i] - y[i] for i in range(1, h))]
        slides = [*p_h, -signed * d[0] * p_h[0], -signed * d[1] * p_h[0]]
        return [choose(sticks, a, b) for a, b in zip(stop, slides, strict=True)]


def _sliding(W: Matrix, z: Sequence[Any], c: Any, speed: Any) -> tuple[tuple[Any, Any], Any]:
    """Direction d in which a point slides that friction of size c brakes, and its speed s: a step of Newton's method.

    It solves s d + c W d = z, |d| = 1, s >= 0: 1 / |(s + c W)^-1 z| is nearly linear in s, exactly for isotropic W.
    """
    size = tm.sqrt(z[0] * z[0] + z[1] * z[1])
    smallest = 1e-12 * size + MIN_SLIDING
    s = tm.maximum(size - c * (W[0, 0] + W[1, 1]) if speed is None else speed, smallest)

    def solved(b: Sequence[Any]) -> tuple[Any, Any]:
        a00, a01, a11 = s + c * W[0, 0], c * W[0, 1], s + c * W[1, 1]
        scale = 1.0 / (a00 * a11 - a01 * a01)
        return (a11 * b[0] - a01 * b[1]) * scale, (a00 * b[1] - a01 * b[0]) * scale

    d = solved(z)
    slower = solved(d)
    square = d[0] * d[0] + d[1] * d[1]
    fall = d[0] * slower[0] + d[1] * slower[1]
    s = tm.maximum(s + (tm.sqrt(square) - 1.0) * square / (fall + MIN_SLIDING), smallest)
    d = solved(z)
    size = 1.0 / tm.sqrt(d[0] * d[0] + d[1] * d[1] + MIN_SLIDING)
    return (d[0] * size, d[1] * size), s


def _turn(W: Matrix, r: Vector, touch: Touch, p: list[Any], limit: Any) -> None:
    """Write the impulse that stops a contact's spin, as far as its friction can."""
    s = touch.spin
    assert s is not None
    size = tm.abs(limit * p[touch.normal])
    turns = _sum(r[s], ((W[s, j], p[j]) for j in range(len(r)) if j != s))
    p[s] = tm.clip(-turns / _diagonal(W, s), -size, size)


@dataclass(frozen=True, kw_only=True)
class _Mode:
    """Behaviour of a contact for Newton's method: friction is z = p_t - step u_t within the cone, else limit d."""

    on: Any  # whether it touches
    sticks: Any
    d: tuple[Any, Any] = (0.0, 0.0)  # z / |z|
    fraction: Any = 0.0
    step: Any = 0.0  # impulse per velocity
    mu: Any = 0.0  # with the sign of the normal impulse
    spins: Any = False  # whether it turns about its normal
    moment: Any = 0.0  # then its impulse of spin over the normal one

    def instead(self, other: _Mode, holds: Any) -> _Mode:
        """This one where the condition holds, else the other."""
        flags = {
            name: opposite(both(opposite(both(holds, a)), opposite(both(opposite(holds), b))))
            for name in ("on", "sticks", "spins")
            for a, b in [(getattr(self, name), getattr(other, name))]
        }
        d = [choose(holds, a, b) for a, b in zip(self.d, other.d, strict=True)]
        numbers = {
            name: choose(holds, getattr(self, name), getattr(other, name))
            for name in ("fraction", "step", "mu", "moment")
        }
        return _Mode(d=(d[0], d[1]), **flags, **numbers)


def _modes(
    W: Matrix,
    r: Vector,
    touches: Sequence[Touch],
    mu: Sequence[Any],
    radius: Sequence[Any],
    there: Sequence[Any],
    p: Sequence[Any],
) -> tuple[list[_Mode], Any]:
    """The mode of each contact at some impulses, and by how much, squared, these miss the laws."""
    m = len(r)
    u = [_sum(r[i], ((W[i, j], p[j]) for j in range(m))) for i in range(m)]
    out: list[_Mode] = []
    miss: Any = 0.0
    for touch, friction, far, may in zip(touches, mu, radius, there, strict=True):
        n, on, signed = touch.normal, may, friction
        if touch.one_sided:
            push = p[n] - u[n] / W[n, n]
            on = both(may, push > 0.0)
            missed = [p[n] - choose(on, push, 0.0)]
        else:
            missed = [choose(on, u[n] / W[n, n], 0.0)]
        missed += [choose(on, u[i] / W[i, i], p[i]) for i in touch.beside]
        mode = _Mode(on=on, sticks=False)
        if touch.tangents:
            if not touch.one_sided:
                signed = choose(p[n] < 0.0, -friction, friction)
            step = 2.0 / _sum(0.0, ((_diagonal(W, i), 1.0) for i in touch.tangents))
            z = [p[i] - step * u[i] for i in touch.tangents]
            size = tm.sqrt(z[0] * z[0] + z[1] * z[1] + MIN_SLIDING)
            fraction = tm.maximum(signed * p[n], 0.0) / size
            sticks = both(on, fraction >= 1.0)
            missed += [p[i] - choose(on, tm.minimum(fraction, 1.0) * z[k], 0.0) for k, i in enumerate(touch.tangents)]
            spins, moment = False, 0.0
            if touch.spin is not None:
                turn, limit = p[touch.spin] - u[touch.spin] / _diagonal(W, touch.spin), far * signed * p[n]
                spins = both(on, tm.abs(turn) > limit)
                moment = choose(turn < 0.0, -far * signed, far * signed)
                missed.append(p[touch.spin] - choose(on, choose(spins, moment * p[n], turn), 0.0))
            mode = _Mode(
                on=on, sticks=sticks, d=(z[0] / size, z[1] / size), fraction=fraction, step=step, mu=signed,
                spins=spins, moment=moment,
            )  # fmt: skip
        out.append(mode)
        miss = _sum(miss, ((part, part) for part in missed))
    return out, miss


def _newton(W: Matrix, r: Vector, touches: Sequence[Touch], modes: Sequence[_Mode]) -> list[Any]:
    """One step of Newton's method for all impulses: exact for those that stick, touch or are apart as they do now."""
    m = len(r)
    A = [[0.0] * m for _ in range(m)]
    rhs: list[Any] = [0.0] * m

    def stopped(i: int, holds: Any) -> None:
        for j in range(m):
            A[i][j] = choose(holds, _diagonal(W, i) if i == j else W[i, j], 1.0 if i == j else 0.0)
        rhs[i] = choose(holds, -r[i], 0.0)

    for touch, now in zip(touches, modes, strict=True):
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
        if touch.spin is not None:
            i = touch.spin
            stopped(i, both(now.on, opposite(now.spins)))
            A[i][touch.normal] = choose(now.spins, -now.moment, A[i][touch.normal])
    return list(tm.solve(tm.array(A), tm.array(rhs)))


def _part(W: Matrix, rows: Sequence[int], columns: Sequence[int]) -> Matrix:
    return tm.array([[W[i, j] for j in columns] for i in rows])


def _regularised(W: Matrix) -> Matrix:
    for i, value in enumerate([_diagonal(W, i) for i in range(len(W))]):
        W[i, i] = value
    return W


def _diagonal(W: Matrix, i: int) -> Any:
    """An entry of the diagonal with a little more, also where no joint moves the row."""
    mean = _sum(0.0, ((W[j, j], 1.0 / len(W)) for j in range(len(W))))
    return W[i, i] + SLACK * mean


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
