"""One step of an arm in rigid contact: from the velocities that it would have without, to those that it has."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Final

import numpy as np

from taut.base.types import Array, Matrix, Vector
from taut.maths.constraints.impulses import both, choose, contact_impulses, held_impulses, opposite
from taut.maths.model import Model
from taut.maths.snapshot import Snapshot
from taut.plant.contact import CLOSED, Contacts
from taut.trace import math as tm
from taut.trace.linalg import LTDL

Values = Mapping[str, Any]
REPORTED: Final = ("lam", "on", "drift", "correction", "slip")
"""What a run records of contacts, by name below "contact"."""
SHUT: Final = 1e-12  # [m | rad] a gap below this is none
LEAST_GRADIENT: Final = 1e-30  # keeps contacts without one, as on the axis of a hollow, from a division by zero
LIES_DOWN: Final = 0.02  # [s] in which the tilt that a face lands with is gone to 1/e


@dataclass(frozen=True, kw_only=True)
class ContactStep:
    """An arm after a step in contact."""

    q: Vector
    v: Vector
    impulse: Vector  # (n,) of the contacts on the joints, all in all [N m s | N s]
    wrench: Array  # (6,) F_ext of the contacts, as a sensor at the wrist feels it
    memory: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class _Here:
    """The constraints at one state, with their tangents: rates of rows are B v + moves."""

    phi: Vector  # (k,)
    B: Matrix  # (m, n)
    moves: Vector  # (m,)
    bias: Vector  # (m,)
    A: Mapping[int, Any]  # (6,) of the rows that act at the tool's body, about its origin
    scale: Sequence[Any]  # of each contact with friction: force per multiplier
    tangents: Sequence[Matrix]  # of each, (2, 3)

    @classmethod
    def at(cls, contacts: Contacts, x: Snapshot) -> _Here:
        k, m = contacts.count, contacts.size
        phi, B, moves, bias = tm.zeros(k), tm.zeros((m, x.n)), tm.zeros(m), tm.zeros(m)
        A: dict[int, Any] = {}
        scale: list[Any] = []
        tangents: list[Matrix] = []
        for place in contacts.places:
            rows = place.piece.at(x)
            measured = contacts.at_tool(place)
            frame = place.piece.frames[0] if place.piece.frames else None
            away = x.T(frame).p - x.T().p if measured and frame is not None else None
            for j, i in enumerate(place.rows):
                phi[i], moves[i], bias[i] = rows.phi[j], rows.phi_t[j], rows.bias[j]
                B[i] = rows.A_q[j]
                if measured and rows.A is not None:
                    A[i] = _about_tool(rows.A[j], away)
            for touch in place.touches:
                if not touch.tangents:
                    continue
                assert rows.A is not None
                gradient = rows.A[touch.normal - place.rows[0]][:3]
                size = tm.sqrt(gradient @ gradient + LEAST_GRADIENT**2)
                across = _across(gradient / size)
                J, falling = x.J(frame), x.Jdot_v(frame)
                for e, i in zip(across, touch.tangents, strict=True):
                    B[i], bias[i] = e @ J[:3], e @ falling[:3]
                    if measured:
                        A[i] = _about_tool(tm.array([*e, 0.0, 0.0, 0.0]), away)
                scale.append(size)
                tangents.append(across)
        return cls(phi=phi, B=B, moves=moves, bias=bias, A=A, scale=scale, tangents=tangents)


def contact_start(contacts: Contacts, x: Snapshot, *, load: bool) -> dict[str, Any]:
    """Memory at the start of a run; `load` where dry friction of the joints needs to know of it."""
    here = _Here.at(contacts, x)
    on: list[Any] = [1.0] * contacts.count
    for _, touch in contacts.touches:
        if touch.one_sided:
            for i in touch.held:
                on[i] = tm.where(here.phi[touch.normal] <= CLOSED, 1.0, 0.0)
    memory: dict[str, Any] = {
        "lam": tm.zeros(contacts.count),
        "on": tm.array(on),
        "drift": 0.0,
        "correction": 0.0,
        "force": tm.zeros(contacts.size),
    }
    if contacts.rubbing:
        memory["slip"] = tm.zeros((len(contacts.rubbing), 3))
    if load:
        memory["load"] = tm.zeros(contacts.arm.n)
    return {f"contact.{name}": value for name, value in memory.items()}


def contact_step(
    contacts: Contacts,
    model: Model,
    factors: LTDL,
    q: Vector,
    v: Vector,
    v_free: Vector,
    t: Any,
    memory: Values,
    parameters: Values,
    dt: Any,
) -> ContactStep:
    """A step of semi-implicit Euler under impulses that keep phi at its end, and then its rate (RATTLE).

    `factors` are of the mass matrix with implicit damping, `v_free` is the velocity that the step gives without
    contact.
    """
    k, touches = contacts.count, [touch for _, touch in contacts.touches]
    here = _Here.at(contacts, Snapshot(model, q=q, v=v, t=t))
    on = [memory["contact.on"][i] > 0.5 for i in range(k)]
    guess = [x * dt for x in memory["contact.force"]]
    # The multipliers of the tick, from accelerations.
    sol = factors.solve(here.B.T)
    W = _mobility(here, sol)
    gain = here.B @ (v_free - v) + dt * here.bias
    for _, touch in contacts.rubbing:
        for i in touch.tangents:
            gain[i] = here.B[i] @ v_free + dt * here.bias[i]
    p = _impulses(contacts, parameters, W, gain, here.scale, on, guess)
    # Positions with phi = 0, by impulses at the beginning.
    v_rubbed = v_free + sol[:, k:] @ p[k:] if contacts.rubbing else v_free
    A, sol_n, W_n = here.B[:k], sol[:, :k], W[:k, :k]
    rate = A @ v_rubbed + here.moves[:k] + 0.5 * dt * here.bias[:k]  # the mean one of the step
    bounce = _Bounces.of(contacts, parameters, here.phi, rate, gain, on, dt)
    goal = list(bounce.height)
    for i in contacts.tilts:
        goal[i] = here.phi[i] * tm.exp(-dt / LIES_DOWN)
    missing = tm.array([(here.phi[i] - goal[i]) / dt + rate[i] for i in range(k)])
    first = _impulses(contacts, parameters, W_n, missing, None, [True] * k, p[:k])
    acts: list[Any] = [True] * k
    apart = missing + W_n @ first  # [m/s], what opens the gaps
    for touch in touches:
        if touch.one_sided:
            for i in touch.held:
                acts[i] = dt * apart[touch.normal] <= SHUT
    v_half = v_rubbed + sol_n @ first
    q_there = q + dt * v_half
    there = _Here.at(contacts, Snapshot(model, q=q_there, v=v_half, t=t + dt))
    left = tm.array([there.phi[i] - goal[i] for i in range(k)])
    sol_end = factors.solve(there.B.T)
    W_end = _mobility(there, sol_end)
    q_new = q_there + sol_end[:, :k] @ held_impulses(W_end[:k, :k], left, acts)
    # Velocities along the constraints, by impulses at the end.
    so_far = tm.array([*first, *p[k:]])
    v_base = v_half - sol_end @ so_far
    wanted = [*bounce.speed, *([0.0] * (contacts.size - k))]
    for i in contacts.tilts:
        wanted[i] = -there.phi[i] / LIES_DOWN
    final = there.B @ v_base + there.moves - tm.array(wanted)
    total = _impulses(contacts, parameters, W_end, final, there.scale, acts, so_far)
    v_new = v_base + sol_end @ total
    # What is reported of it. A gap that closes in the step shows its impulse.
    closes = [both(opposite(on[i]), acts[i]) for i in range(k)]
    for _, touch in contacts.rubbing:
        closes += [closes[touch.normal]] * 2
    shown = tm.array([choose(c, total[i], p[i]) / dt for i, c in enumerate(closes)])
    after: dict[str, Any] = {
        "lam": -shown[:k],
        "on": tm.array([choose(both(acts[i], opposite(bounce.happens[i])), 1.0, 0.0) for i in range(k)]),
        "drift": reduce(tm.maximum, [choose(on[i], tm.abs(here.phi[i]), 0.0) for i in range(k)]),
        "correction": reduce(tm.maximum, [tm.abs(total[i] / dt - shown[i]) for i in range(k)]),
        "force": total / dt,
    }
    if contacts.rubbing:
        after["slip"] = _slips(contacts, here, v, on)
    if "contact.load" in memory:
        after["load"] = here.B.T @ p / dt
    return ContactStep(
        q=q_new,
        v=v_new,
        impulse=here.B.T @ so_far + there.B.T @ (total - so_far),
        wrench=_wrench(here, shown),
        memory={f"contact.{name}": value for name, value in after.items()},
    )


@dataclass(frozen=True, kw_only=True)
class _Bounces:
    """Of each row: whether its gap closes in the step and opens again, how fast then, and how far at its end."""

    happens: list[Any]
    speed: list[Any]
    height: list[Any]

    @classmethod
    def of(
        cls,
        contacts: Contacts,
        parameters: Values,
        phi: Vector,
        rate: Vector,
        gain: Vector,
        on: Sequence[Any],
        dt: Any,
    ) -> _Bounces:
        """From the gaps, their mean rates in the step without an impact, and what a step adds to these.

        Semi-implicit velocities are those of the middle of a step, so that the instant of the impact matters twice:
        for the speed there, and for the rest of the step.
        """
        k = contacts.count
        happens: list[Any] = [False] * k
        speed, height = [0.0] * k, [0.0] * k
        for place, touch in contacts.touches:
            e, i = contacts.value(place.contact, "restitution", parameters), touch.normal
            if e is None or not touch.one_sided:
                continue
            closes = both(opposite(on[i]), phi[i] + dt * rate[i] < 0.0)
            share = choose(closes, phi[i] / choose(closes, -dt * rate[i], 1.0), 0.0)  # of the step, until the impact
            away = -e * (rate[i] + (share - 0.5) * gain[i])
            happens[i] = both(closes, away > tm.maximum(-gain[i], 0.0))
            rest = 1.0 - share
            speed[i] = choose(happens[i], away + (0.5 - share) * gain[i], 0.0)
            height[i] = choose(happens[i], dt * rest * (away + 0.5 * rest * gain[i]), 0.0)
        return cls(happens=happens, speed=speed, height=height)


def _impulses(
    contacts: Contacts,
    parameters: Values,
    W: Matrix,
    r: Vector,
    scale: Sequence[Any] | None,  # of each contact with friction; None without friction
    on: Sequence[Any],  # (k,) whether each row may act
    guess: Vector | Sequence[Any],
) -> Vector:
    """(m,) or without friction (k,) impulses, from the velocities r without impulses."""
    pairs, rubbing = contacts.touches, iter(scale or ())
    if all(place.fixed for place, _ in pairs):
        solved: Vector = -tm.solve_spd(W, r)
        return solved
    touches, mu = [], []
    for place, touch in pairs:
        rubs = touch.tangents if scale is not None else ()
        touches.append(dataclasses.replace(touch, tangents=rubs))
        mu.append(contacts.value(place.contact, "friction", parameters) * next(rubbing) if rubs else 0.0)
    there = [on[touch.normal] if touch.one_sided or touch.tangents else True for _, touch in pairs]
    return contact_impulses(W, r, touches, mu, there, guess)


def _mobility(here: _Here, sol: Matrix) -> Matrix:
    """(m, m) velocities of the rows per impulse."""
    return here.B @ sol + LEAST_GRADIENT * tm.eye(len(here.B))


def _wrench(here: _Here, force: Vector) -> Array:
    """(6,) of the forces of the rows that act on the tool's body, about its origin."""
    F: Any = np.zeros(6)
    for i, row in here.A.items():
        F = F + row * force[i]
    return F  # type: ignore[no-any-return]


def _slips(contacts: Contacts, here: _Here, v: Vector, on: Sequence[Any]) -> Array:
    """(c, 3) at which the points with friction slide."""
    out = []
    for n, (_, touch) in enumerate(contacts.rubbing):
        speed = here.tangents[n].T @ tm.array([here.B[i] @ v for i in touch.tangents])
        out.append([choose(on[touch.normal], entry, 0.0) for entry in speed])
    return tm.array(out)


def _about_tool(row: Array, away: Array | None) -> Array:
    """(6,) a row about the tool's origin, of a frame that is `away` from there."""
    if away is None:
        return row
    return tm.array([*row[:3], *(row[3:] + tm.cross(away, row[:3]))])


def _across(n: Vector) -> Matrix:
    """(2, 3) two directions across a unit vector, smooth but at -z.

    Duff et al., Building an orthonormal basis, revisited, J. Computer Graphics Techniques 6 (2017).
    """
    x, y, z = n
    sign = tm.where(z < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return tm.array([[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]])
