"""Limits: what a command may be. What cuts it is `limiting.py`."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, require_positive
from taut.base.errors import MatchError, ModelError, Problem, RangeError, ShapeError, UsageError, unknown_name
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.control.command import Command, Torque, Velocity
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = [
    "LIMIT_TERMS",
    "RATE_PER_EFFORT",
    "UNITS",
    "Limited",
    "Limits",
    "anew",
    "fresh_blend",
    "limited",
    "room",
    "take_up",
    "terms_of",
]

RATE_PER_EFFORT: Final = 10.0  # default torque rate: ten times the effort limit per second
BRAKING_TICKS: Final = 10.0  # default v_gain: a joint comes up to its speed limit with this time constant
UNITS: Final = {
    "tau": "N m | N",
    "tau_dot": "N m/s | N/s",
    "v": "rad/s | m/s",
    "v_gain": "1/s",
    "blend": "s",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Largest torque, largest change of torque per second, largest speed, and how a change of the law comes in.

    Law:          tau = law + blend; then the rate is limited, then the speed, then the magnitude: the later one wins
                  rate:       |tau - tau of the last tick| <= tau_dot dt
                  speed:      a sign(v) <= v_gain (v_max - |v|) max(1, v_max / |v|), where M a = tau - h
                  magnitude:  |tau| <= tau
    Closed loop:  with an exact model a joint that is driven on comes up to its speed limit as
                  v_max - |v| = c exp(-v_gain t), and one that is faster is braked in the same way
                  what slows the arm down is not cut, and of what moves a joint at rest only what would take it
                  beyond its limit within a tick

    The speed limit acts on the acceleration that a torque means, so that a loaded joint neither drops nor gains speed
    and none is driven over its limit by the others, which move on as they would have. Where a joint lacks the torque
    for that, all of them accelerate less. From a state outside the limits the command goes to the limit in one step.
    A velocity command is cut to v; it takes no limit of torque.

    The rate, and the blend, start from the torque that the plant holds: what `reset(tau_applied=)` says, else the
    gravity torque, else zero if the plant compensates gravity itself. (A velocity command starts from zero.) With
    `blend` the command begins there, and the difference to what the law asks for goes to zero in that time as
    1 - 3 x^2 + 2 x^3. The jump that a new gain or a new payload would make is taken up in the same way.

    Each kind is a term of its own in the record: rate_limit, speed_limit, torque_limit, blend.

    Args:
        tau: (n,) or scalar [N m | N]; None for no limit.
        tau_dot: (n,) or scalar [N m/s | N/s]; None for no limit.
        v: (n,) or scalar [rad/s | m/s]; None for no limit.
        v_gain: (n,) or scalar [1/s], acceleration for each rad/s below the speed limit, at most the rate; a tenth of
            the rate if left out.
        blend: Time in which a change comes in [s]; None for at once.

    Raises:
        RangeError: A limit that is zero, negative or NaN.
        UsageError: No limit at all, or v_gain without v.

    Example:
        >>> Limits(tau=87.0).tau.tolist()
        87.0
    """

    tau: ArrayLike | None = None
    tau_dot: ArrayLike | None = None
    v: ArrayLike | None = None
    v_gain: ArrayLike | None = None
    blend: float | None = None

    def __post_init__(self) -> None:
        if not self.given() - {"v_gain"}:
            raise UsageError(
                "Limits needs one of tau, tau_dot, v and blend at least; for no limits leave the limits out"
            )
        if self.v_gain is not None and self.v is None:
            raise UsageError(
                "limits.v_gain belongs to a speed limit; give v too, or leave it out", name="limits.v_gain"
            )
        for name in self.given():
            object.__setattr__(self, name, self.checked(name, getattr(self, name)))

    def given(self) -> set[str]:
        """The names of those that are there."""
        return {field.name for field in fields(self) if getattr(self, field.name) is not None}

    def __str__(self) -> str:
        return ", ".join(f"{name} = {np.asarray(getattr(self, name)).tolist()}" for name in sorted(self.given()))

    @staticmethod
    def checked(name: str, value: ArrayLike, rate: float | None = None) -> Float64Array:
        """A value of one of the limits, for a controller of that rate [Hz] if one is given.

        Raises:
            UnknownNameError: There is no such limit.
            RangeError: Zero, negative, NaN, infinite where that has no meaning, or faster than the rate.
            ShapeError: A time that is no single number.
        """
        if name not in UNITS:
            raise unknown_name("Limits", "limit", name, UNITS)
        what, unit = f"limits.{name}", UNITS[name]
        array = finite_array(what, value, unit=unit, allow_infinite=name in ("tau", "tau_dot", "v"))
        if name == "blend" and array.ndim:
            raise ShapeError(f"{what} must be one number [{unit}]; got shape {array.shape}", name=what)
        require_positive(what, array, unit=unit)
        if name == "v_gain" and rate is not None and (array > rate).any():
            raise RangeError(
                f"{what} must be at most the rate, {rate:g} [{unit}], or a joint would overshoot its speed limit; "
                f"got {array.max():g}",
                name=what,
                value=float(array.max()),
            )
        return array

    @classmethod
    def of(cls, arm: Arm, *, rate: bool = False, speed: bool = False, blend: float | None = None) -> Limits:
        """The arm's own effort limits.

        Args:
            arm: The arm.
            rate: Limit the torque rate too, to ten times the effort limit per second.
            speed: Limit the speed too, to the arm's own limits.
            blend: Time in which a change comes in [s].

        Raises:
            ModelError: The arm states no effort limit at all, or no speed limit where it is asked for.
        """
        if not isinstance(arm, Arm):  # callers without a type checker
            raise UsageError(f"Limits.of takes an Arm from taut.load_arm; got {type(arm).__name__}", name="arm")
        _require_stated(arm, "effort", "tau")
        if speed:
            _require_stated(arm, "velocity", "v")
        return cls(
            tau=arm.effort,
            tau_dot=RATE_PER_EFFORT * arm.effort if rate else None,
            v=arm.velocity if speed else None,
            blend=blend,
        )

    def check_fit(self, arm: Arm, rate: float) -> None:
        """Limits must be scalars or have one entry per joint, and nothing may be faster than the rate [Hz]."""
        if self.v_gain is not None:
            self.checked("v_gain", self.v_gain, rate)
        for name in UNITS:
            value = getattr(self, name)
            if value is not None and np.ndim(value):
                finite_array(f"limits.{name}", value, shape=(arm.n,), joints=arm.joint_names, allow_infinite=True)

    def parameters(self, rate: float, kind: str) -> dict[str, Float64Array]:
        """The limits by name, as run-time parameters, for a command of that kind at a rate [Hz]."""
        out = {
            name: np.asarray(getattr(self, name), dtype=np.float64)
            for name in UNITS
            if getattr(self, name) is not None
        }
        if self.v is not None and self.v_gain is None and kind == "torque":
            out["v_gain"] = np.asarray(rate / BRAKING_TICKS)
        return out


def _require_stated(arm: Arm, attribute: str, name: str) -> None:
    """An arm that states no limit of a kind has none to be taken over."""
    if np.isinf(getattr(arm, attribute)).all():
        message = f"arm '{arm.name}' states no {attribute} limits; give limits with {name}"
        raise ModelError(arm.name, [Problem(object=arm.name, attribute=attribute, message=message)])


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
            f"limits cut torques and velocities, and {who} gives a {command.kind}; leave the limits out",
            name="limits",
        )
    wrong = sorted(given & {"tau", "tau_dot", "v_gain"})
    if wrong and not isinstance(command, Torque):
        raise MatchError(
            f"limits.{wrong[0]} is for torques, and {who} gives a {command.kind}; leave it out, or "
            "give limits with v",
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
