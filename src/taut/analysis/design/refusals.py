"""What a design cannot be: which limit of the sampled loop is in the way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from taut.analysis.design.asked import Asked, plain
from taut.analysis.design.directions import designed_part, weight_gradient
from taut.analysis.design.limits import growth
from taut.analysis.design.trial import Bench
from taut.base.errors import RangeError
from taut.base.types import Float64Array
from taut.linear.linearise import Linearisation
from taut.maths.snapshot import snapshot

__all__ = ["no_rest", "require_pace", "require_stable"]

SLOWEST: Final = 1e-7  # of an error in a tick: less cannot be told from none, for rounding splits a pair so far
STAYS: Final = 1e-12  # of the fastest pole: one that is slower is of what has no stiffness
HELP: Final = "GravityPID compensates the weight where the arm is; or ask for a faster design, whose kp is larger"


def require_pace(asked: Asked, bench: Bench, poles: Sequence[Any]) -> None:
    """Refuse an error that decays by less in a tick than rounding hides."""
    rates = [rate for s in poles for rate in -s.real if rate > STAYS * np.abs(s).max()]
    slowest = float(min(rates, default=math.inf)) / bench.ctrl.rate
    if slowest < SLOWEST:
        raise RangeError(
            f"{_what(asked)} cannot be tried at {_where(bench)}: its slowest pole takes {slowest:.2g} of an error "
            f"away in a tick, and rounding hides less than {SLOWEST:g}; ask for a faster design, or a lower rate",
            name=_name(asked),
            value=slowest,
            rule=f">= {SLOWEST:g} in a tick",
        )


def require_stable(asked: Asked, bench: Bench, lin: Linearisation) -> None:
    """Refuse a sampled loop that is not stable about its equilibrium, with what makes it so."""
    if lin.stable:
        return
    why, where = "ask for a slower design, more damping or a higher rate", ""
    if bench.uncompensated:
        where = f" about its equilibrium under the weight, q = {(np.round(lin.q, 4) + 0.0).tolist()}"
        part: Any = designed_part(bench.law)
        least = float(np.linalg.eigvalsh(part.kp.matrix(len(lin.q)) + weight_gradient(snapshot(bench.arm, lin.q)))[0])
        if least <= 0.0:
            why = (
                "the weight's gradient dg/dq takes more off kp than it has, which no rate mends: kp + dg/dq has the "
                f"eigenvalue {least:.4g}, so that the arm falls over; {HELP}"
            )
    raise RangeError(
        f"{_what(asked)} cannot be met: at {_where(bench)} the sampled loop {growth(lin.radius)} in a tick{where}; "
        f"{why}",
        name=_name(asked),
        value=lin.radius,
        rule="stable",
    )


def no_rest(asked: Asked, q: Float64Array, error: RangeError) -> RangeError:
    """The refusal of a law that does not compensate the weight and with these gains rests nowhere."""
    return RangeError(
        f"{_what(asked)} cannot be met: with these gains the weight takes the arm away from "
        f"q = {np.round(q, 4).tolist()}, and no equilibrium was found ({error}); {HELP}",
        name=_name(asked),
        value=error.value,
        rule="an equilibrium",
    )


def _what(asked: Asked) -> str:
    return ", ".join(f"{name} = {plain(value)}" for name, value in asked.given.items())


def _name(asked: Asked) -> str:
    return next(iter(asked.speeds), "K")


def _where(bench: Bench) -> str:
    delay = float(bench.plant.actuation.delay)
    velocity = bench.ctrl.side.sensing.velocity
    cutoff = None if isinstance(velocity, str) else getattr(velocity, "cutoff", None)
    parts = [f"{bench.ctrl.rate:g} Hz"]
    if delay:
        parts.append(f"{1e3 * delay:g} ms of delay")
    if cutoff is not None:
        parts.append(f"a low-pass of {float(np.min(cutoff)):g} Hz in the velocity")
    if not bench.motion.exact:
        parts.append(f"{bench.motion.steps}, as plant= has it,")
    return " and ".join(parts)
