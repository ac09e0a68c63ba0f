"""Limiting: the one place where a command is cut, and where a change of the law comes in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from taut.base import math as tm
from taut.base.types import Array, Float64Array, Vector

__all__ = ["LIMIT_TERMS", "Limited", "fresh_blend", "limited", "room", "take_up", "term_names"]

LIMIT_TERMS: Final = ("rate_limit", "speed_limit", "torque_limit")
"""Terms that limits add to a command, in the order in which they act."""
TERM_OF: Final = {"blend": "blend", "tau_dot": "rate_limit", "v": "speed_limit", "tau": "torque_limit"}
MOST_ROOM: Final = 10.0  # with the default v_gain, it takes a joint at rest to its speed limit in one tick
SMALLEST_SPEED: Final = 1e-9  # [rad/s | m/s], so that nothing is divided by zero


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
    *,
    v: Vector | None = None,
    hold: Callable[[], Vector] | None = None,
) -> Limited:
    """The command that goes out: blended, then limited in rate, in speed, in magnitude.

    Args:
        asked: (n,) what the law asks for.
        memory: `tau_applied`, the command of the last tick, for a rate limit; what a blend remembers.
        parameters: The limits that there are, by name.
        dt: Period [s].
        v: (n,) velocity, for a speed limit on a torque [rad/s | m/s].
        hold: Gives (n,) the torque that holds the weight, for the same; None for a velocity command.
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
    if "tau_dot" in parameters:
        out, before = _near(out, memory["tau_applied"], parameters["tau_dot"] * dt), out
        terms["rate_limit"] = out - before
    if "v" in parameters:
        slow = _within(out, parameters["v"]) if hold is None or v is None else _braked(out, v, hold(), parameters)
        out, before = slow, out
        terms["speed_limit"] = out - before
    if "tau" in parameters:
        out, before = _within(out, parameters["tau"]), out
        terms["torque_limit"] = out - before
    return Limited(command=out, cut=wanted - out, terms=terms, memory=kept)


def term_names(parameters: Mapping[str, Array]) -> tuple[str, ...]:
    """The terms that these limits add to a command."""
    return tuple(term for name, term in TERM_OF.items() if name in parameters)


def _within(command: Vector, bound: Array) -> Vector:
    out: Vector = tm.clip(command, -bound, bound)
    return out


def _near(command: Vector, held: Vector, step: Array) -> Vector:
    out: Vector = tm.clip(command, held - step, held + step)
    return out


def _braked(tau: Vector, v: Vector, hold: Vector, parameters: Mapping[str, Array]) -> Vector:
    """(n,) torque; what drives a joint on, beyond what holds its weight, is cut to what its speed leaves room for."""
    most = room(tm.abs(v), parameters["v"], parameters["v_gain"])
    falling = tm.where(v < 0.0, tm.maximum(tau, hold - most), tau)
    out: Vector = tm.where(v > 0.0, tm.minimum(tau, hold + most), falling)
    return out


def room(speed: Vector, v_max: Array, v_gain: Array) -> Vector:
    """(n,) torque in the direction of motion that a joint may have at a speed; negative beyond its limit.

    Near the limit v_gain (v_max - speed). It grows towards rest, where the direction of motion is nothing to go by:
    what is cut there is only what would take the joint to its limit in a tick.
    """
    growth = tm.clip(v_max / tm.maximum(speed, SMALLEST_SPEED), 1.0, MOST_ROOM)
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
