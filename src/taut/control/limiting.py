"""Limiting: the one place where a command is cut, and where a change of the law comes in."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from taut.base.errors import MatchError, UsageError
from taut.base.types import Array, Float64Array, Vector
from taut.control.command import Command, Torque, Velocity
from taut.control.limits import Limits
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["LIMIT_TERMS", "Limited", "anew", "fresh_blend", "limited", "room", "take_up", "terms_of"]

LIMIT_TERMS: Final = ("rate_limit", "speed_limit", "torque_limit")
"""Terms that limits add to a command, in the order in which they act."""
TERM_OF: Final = {"blend": "blend", "tau_dot": "rate_limit", "v": "speed_limit", "tau": "torque_limit"}
TINY: Final = 1e-9  # of speeds and torques, so that nothing is divided by zero


@dataclass(frozen=True, kw_only=True)
class Limited:
    """A command after limits."""

    command: Vector  # (n,)
    cut: Vector  # (n,) what limits took from it
    terms: dict[str, Vector]  # by name, what was added to what the law asked for
    memory: dict[str, Any]  # of the blend


def limited(
    asked: Vector,
    memory: Mapping[str, Any],
    parameters: Mapping[str, Array],
    dt: Any,
    x: Snapshot | None = None,
) -> Limited:
    """The command that goes out: blended, then limited in rate, in speed, in magnitude.

    Args:
        asked: (n,) what the law asks for.
        memory: `tau_applied`, the command of the last tick, for a rate limit; what a blend remembers.
        parameters: The limits that there are, by name.
        dt: Period [s].
        x: What moves, for a speed limit on a torque; None for a velocity command.
    """
    terms: dict[str, Vector] = {}
    kept: dict[str, Any] = {}
    wanted = asked
    if "blend" in parameters:
        wanted = asked + memory["bump"] * left(memory["phase"])
        terms["blend"] = wanted - asked
        over = tm.minimum(memory["phase"] + dt / parameters["blend"], 1.0)
        kept = {"asked": asked, "bump": memory["bump"], "phase": over}
    out = wanted
    for name, after in _stages(wanted, memory, parameters, dt, x):
        terms[name] = terms.get(name, 0.0) + (after - out)
        out = after
    return Limited(command=out, cut=wanted - out, terms=terms, memory=kept)


def _stages(
    out: Vector, memory: Mapping[str, Any], parameters: Mapping[str, Array], dt: Any, x: Snapshot | None
) -> Iterator[tuple[str, Vector]]:
    """The command after each limit, with the term of that limit."""
    if "tau_dot" in parameters:
        step, held = parameters["tau_dot"] * dt, memory["tau_applied"]
        out = tm.clip(out, held - step, held + step)
        yield "rate_limit", out
    if "v" in parameters and x is None:
        out = tm.clip(out, -parameters["v"], parameters["v"])
        yield "speed_limit", out
    if "v" in parameters and x is not None:
        if "tau" in parameters:  # what a joint cannot give does not drive the others either
            out = tm.clip(out, -parameters["tau"], parameters["tau"])
            yield "torque_limit", out
        out = _slowed(out, x, parameters, dt)
        yield "speed_limit", out
    if "tau" in parameters:
        out = tm.clip(out, -parameters["tau"], parameters["tau"])
        yield "torque_limit", out


def terms_of(limits: Limits, command: Command, who: str) -> tuple[str, ...]:
    """The terms that limits add to a command of this kind.

    Args:
        limits: The limits.
        command: A command of the law.
        who: The law, for messages.

    Raises:
        MatchError: Limits that have no meaning for it.
        UsageError: The law has a term of that name.
    """
    given = limits.given()
    if not isinstance(command, (Torque, Velocity)):
        raise MatchError(
            f"limits cut torques and velocities, and {who} gives a {command.kind}; leave limits=None",
            name="limits",
        )
    wrong = sorted(given & {"tau", "tau_dot", "v_gain"})
    if wrong and not isinstance(command, Torque):
        raise MatchError(
            f"limits.{wrong[0]} is for torques, and {who} gives a {command.kind}; leave it out, or "
            "give taut.Limits(v=...)",
            name="limits",
        )
    added = tuple(term for name, term in TERM_OF.items() if name in given)
    taken = [name for name in added if name in command.terms.parts]
    if taken:
        raise UsageError(
            f"{who} names a term '{taken[0]}', which is what the controller's limits add; give it another name",
            name=taken[0],
        )
    return added


def _slowed(tau: Vector, x: Snapshot, parameters: Mapping[str, Array], dt: Any) -> Vector:
    """(n,) torque without what would drive a joint beyond its speed limit."""
    a = tm.solve_spd(x.M_factors, tau - x.h)
    most = room(tm.abs(x.v), parameters["v"], parameters["v_gain"], dt)
    behind = tm.where(x.v < 0.0, tm.maximum(a, -most), tm.clip(a, -most, most))
    allowed = tm.where(x.v > 0.0, tm.minimum(a, most), behind)
    out: Vector = tau + x.M @ (allowed - a)
    if "tau" not in parameters:
        return out
    # A joint that lacks the torque for it would be driven on by the others: then all of them accelerate less.
    motion, bound = out - x.h, parameters["tau"]
    up, down = (bound - x.h) / tm.maximum(motion, TINY), (bound + x.h) / tm.maximum(-motion, TINY)
    parts = tm.clip(tm.where(out > bound, up, tm.where(out < -bound, down, 1.0)), 0.0, 1.0)
    least = functools.reduce(tm.minimum, [parts[i] for i in range(x.n)])
    fitting: Vector = out - (1.0 - least) * motion
    return fitting


def room(speed: Vector, v_max: Array, v_gain: Array, dt: Any) -> Vector:
    """(n,) acceleration in the direction of motion that a joint may have at a speed; negative beyond its limit.

    Near the limit v_gain (v_max - speed). It grows towards rest, where the direction of motion is nothing to go by,
    to what takes the joint to its limit within a tick.
    """
    growth = tm.clip(v_max / tm.maximum(speed, TINY), 1.0, 1.0 / (v_gain * dt))
    out: Vector = v_gain * (v_max - speed) * growth
    return out


# -------------------------------------------------------------------- how a change comes in


def left(phase: Any) -> Any:
    """What is left of a jump when this part of its time is over: from 1 to 0, with no slope at either end."""
    x = tm.clip(phase, 0.0, 1.0)
    return 1.0 + x * x * (2.0 * x - 3.0)


def fresh_blend(n: int) -> dict[str, Any]:
    """Memory of a blend that has nothing to do."""
    return {"asked": tm.zeros(n), "bump": tm.zeros(n), "phase": 1.0}


def anew(memory: Mapping[str, Any], asked: Vector, begins: Any) -> dict[str, Any]:
    """Memory of a blend in a tick in which another law may begin: the command starts from that of the last tick.

    Args:
        memory: `tau_applied`, the command of the last tick, and what a blend remembers.
        asked: (n,) what is asked for now.
        begins: Whether a law begins.
    """
    bump = tm.where(begins, memory["tau_applied"] - asked, memory["bump"])
    return {**memory, "bump": bump, "phase": tm.where(begins, 0.0, memory["phase"])}


def take_up(memory: Mapping[str, Float64Array], before: Float64Array, after: Float64Array) -> None:
    """Let the next tick command what it would have without a change of parameters, and the difference fade.

    Args:
        memory: Memory of the law side by path, changed in place.
        before: (n,) what the law would have asked for with the old parameters.
        after: (n,) what it asks for now, at the same inputs and memory.
    """
    bump, phase = memory["limits.bump"], memory["limits.phase"]
    bump[...] = bump * left(phase) + before - after
    phase[...] = 0.0
