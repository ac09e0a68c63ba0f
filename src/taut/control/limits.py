"""Limits of a command, and what cuts it to them: blend, rate, speed, magnitude."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of
from taut.base.errors import MatchError, ModelError, Problem, UsageError
from taut.base.fields import Declared, Field
from taut.base.types import Array, Float64Array, Vector
from taut.control.command import Command, Torque, Velocity
from taut.control.gains import require_at_most
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

RATE_PER_EFFORT: Final = 10.0  # [1/s] default torque rate over the effort limit
BRAKING_TICKS: Final = 10.0  # [ticks] default time constant in which a joint comes up to its speed limit
LIMIT_TERMS: Final = ("rate_limit", "speed_limit", "torque_limit")
"""Terms that limits add to a command, in the order in which they act."""
TERM_OF: Final = {"blend": "blend", "tau_dot": "rate_limit", "v": "speed_limit", "tau": "torque_limit"}
SPEED_FLOOR: Final = 1e-9  # [rad/s, N m] so that nothing is divided by zero


class Limits(Declared):
    """Largest torque, largest change of torque per second, largest speed, and blending of a change of the law.

    Law:          tau = law + blend; then the rate is limited, then the speed, then the magnitude: the later one wins
                  rate:       |tau - tau of the last tick| <= tau_dot dt
                  speed:      a sign(v) <= v_gain (v_max - |v|) max(1, v_max / |v|), where M a = tau - h
                  magnitude:  |tau| <= tau
    Closed loop:  with an exact model a joint that is driven on comes up to its speed limit as
                  v_max - |v| = c exp(-v_gain t), and one that is faster is braked in the same way
                  what slows the arm down is not cut, and of what moves a joint at rest only what would take it
                  beyond its limit within a tick

    The speed limit acts on the acceleration that a torque means, so that a loaded joint neither drops nor speeds up
    and none is driven over its limit by the others. Where a joint lacks the torque for that, all of them accelerate
    less. From a state outside the limits the command goes to the limit in one step. A velocity command takes only v.

    Rate limit and blend start from the torque that the plant holds: that of `reset(tau_applied=)`, else the gravity
    torque, else zero if the plant compensates gravity. (A velocity command starts from zero.) With `blend` the
    difference to the law's command, also after a new gain or payload, goes to zero in that time as 1 - 3 x^2 + 2 x^3.

    Each kind is a term of its own in the record: rate_limit, speed_limit, torque_limit, blend.

    Args:
        tau: Largest torque, one number or one per joint; no limit if left out.
        tau_dot: Largest change of torque per second, likewise.
        v: Largest speed, likewise.
        v_gain: Acceleration for each rad/s below the speed limit, at most the rate; a tenth of the rate if left out.
        blend: Time in which a change comes in; at once if left out.

    Example:
        >>> Limits(tau=87.0).tau.tolist()
        87.0
    """

    tau: Field = Field(unit="N m | N", shape="n", above=0.0, infinite=True, optional=True)
    tau_dot: Field = Field(unit="N m/s | N/s", shape="n", above=0.0, infinite=True, optional=True)
    v: Field = Field(unit="rad/s | m/s", shape="n", above=0.0, infinite=True, optional=True)
    v_gain: Field = Field(unit="1/s", shape="n", above=0.0, optional=True)
    blend: Field = Field(unit="s", above=0.0, optional=True)

    def check(self) -> None:
        if not self._stated() - {"v_gain"}:
            self.refuse("", "needs one of tau, tau_dot, v and blend at least; for no limits leave the limits out")
        if self.v_gain is not None and self.v is None:
            self.refuse("v_gain", "belongs to a speed limit; give v too, or leave it out")

    def _stated(self) -> set[str]:
        return {name for name in self.declared if self.__dict__[name] is not None}

    def __str__(self) -> str:
        return ", ".join(f"{name} = {np.asarray(getattr(self, name)).tolist()}" for name in sorted(self._stated()))

    @classmethod
    def of(cls, arm: Arm, *, rate: bool = False, speed: bool = False, blend: float | None = None) -> Limits:
        """The arm's own effort limits.

        Args:
            arm: The arm.
            rate: Limit the torque rate too, to ten times the effort limit per second.
            speed: Limit the speed too, to the arm's own limits.
            blend: Time in which a change comes in [s].

        Raises:
            ModelError: The arm states no effort limit, or no speed limit where `speed`.
        """
        instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
        for attribute, name in (("effort", "tau"), ("velocity", "v"))[: 1 + speed]:
            if np.isinf(getattr(arm, attribute)).all():
                message = f"arm '{arm.name}' states no {attribute} limits; give limits with {name}"
                raise ModelError(arm.name, [Problem(object=arm.name, attribute=attribute, message=message)])
        tau_dot, v = RATE_PER_EFFORT * arm.effort if rate else None, arm.velocity if speed else None
        return cls(tau=arm.effort, tau_dot=tau_dot, v=v, blend=blend)

    def check_fit(self, arm: Arm, rate: float) -> None:
        """Limits have one entry or one per joint, v_gain is below the rate [Hz]. Raises ShapeError, RangeError."""
        self.check_size(arm.joint_names, "limits.")
        if self.v_gain is not None:
            require_at_most("limits.v_gain", self.v_gain, rate, "1/s", "the rate, or a joint overshoots")

    def completed(self, rate: float, kind: str) -> Limits:
        """The same limits with the default of v_gain, where a speed limit of torques at a rate [Hz] needs it."""
        needs = self.v is not None and self.v_gain is None and kind == Torque.kind
        return replace(self, v_gain=rate / BRAKING_TICKS) if needs else self

    def terms(self, command: Command, who: str) -> tuple[str, ...]:
        """Names of the terms that limits add to this kind of command. Raises MatchError, UsageError (names taken)."""
        stated = self._stated()
        if not isinstance(command, (Torque, Velocity)):
            raise MatchError(
                f"limits cut torques and velocities, and {who} gives a {command.kind}; leave the limits out",
                name="limits",
            )
        wrong = sorted(stated & {"tau", "tau_dot", "v_gain"})
        if wrong and not isinstance(command, Torque):
            raise MatchError(
                f"limits.{wrong[0]} is for torques, and {who} gives a {command.kind}; leave it out, or "
                "give limits with v",
                name="limits",
            )
        added = tuple(term for name, term in TERM_OF.items() if name in stated)
        taken = [name for name in added if name in command.terms.parts]
        if taken:
            raise UsageError(
                f"{who} names a term '{taken[0]}', which is what the controller's limits add; give it another name",
                name=taken[0],
            )
        return added


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
    """The command that goes out: `asked` (n,) blended, then limited in rate, in speed, in magnitude.

    `memory` has `tau_applied`, the last command; x is needed for a speed limit on a torque, None for a velocity.
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
    up, down = (bound - x.h) / tm.maximum(motion, SPEED_FLOOR), (bound + x.h) / tm.maximum(-motion, SPEED_FLOOR)
    parts = tm.clip(tm.where(out > bound, up, tm.where(out < -bound, down, 1.0)), 0.0, 1.0)
    least = functools.reduce(tm.minimum, [parts[i] for i in range(x.n)])
    fitting: Vector = out - (1.0 - least) * motion
    return fitting


def room(speed: Vector, v_max: Array, v_gain: Array, dt: Any) -> Vector:
    """(n,) admissible acceleration along the motion, v_gain (v_max - speed) near the limit, negative beyond it.

    Towards rest it grows to what takes the joint to its limit within a tick: the direction means nothing there.
    """
    growth = tm.clip(v_max / tm.maximum(speed, SPEED_FLOOR), 1.0, 1.0 / (v_gain * dt))
    out: Vector = v_gain * (v_max - speed) * growth
    return out


def left(phase: Any) -> Any:
    """Remaining fraction of a jump after this fraction of the blend time: 1 to 0, with zero slope at both ends."""
    x = tm.clip(phase, 0.0, 1.0)
    return 1.0 + x * x * (2.0 * x - 3.0)


def fresh_blend(n: int) -> dict[str, Any]:
    """Memory of an inactive blend."""
    return {"asked": tm.zeros(n), "bump": tm.zeros(n), "phase": 1.0}


def anew(memory: Mapping[str, Any], asked: Vector, begins: Any) -> dict[str, Any]:
    """Memory of a blend: where another law `begins`, the command starts from the last one, `tau_applied`."""
    bump = tm.where(begins, memory["tau_applied"] - asked, memory["bump"])
    return {**memory, "bump": bump, "phase": tm.where(begins, 0.0, memory["phase"])}


def take_up(memory: Mapping[str, Float64Array], before: Float64Array, after: Float64Array) -> None:
    """Blend a change of parameters: memory, in place, by the commands (n,) of old and new at the same inputs."""
    bump, phase = memory["limits.bump"], memory["limits.phase"]
    bump[...] = bump * left(phase) + before - after
    phase[...] = 0.0
