"""The integral of an error, with what keeps it from winding up; and what sampled force control needs beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Literal

import numpy as np

from taut.base.errors import RangeError
from taut.base.fields import Choice
from taut.base.types import Matrix, Vector
from taut.control.gains import Gain, GainValue, Memory
from taut.control.law import MemoryView, Remembers
from taut.trace import math as tm

__all__ = ["AntiWindup", "Integral", "check_force_pole", "damping_force", "solved"]

AntiWindup = Literal["clamping", "back-calculation", "none"]
DAMPING: Final = 1e-5  # of a matrix ki that is inverted, relative to its trace


class Integral(Remembers):
    """The integral of an error in a law: `PID(kp=, ki=, integral=Integral(anti_windup="none"))`.

    Law:          e_int' = e_int + e dt, which includes the error of this tick, as in the chapter's pseudocode
                  "clamping" (conditional integration): an entry rests while limits cut that joint's command and e
                    pushes further into the limit
                  "back-calculation": e_int' = e_int + (e - tracking ki^-1 cut) dt, at rest where ki e = tracking cut
                  "none"; without limits all three are the same, and cost the same

    Args:
        anti_windup: "clamping", "back-calculation" or "none".
        tracking: How fast limits drive the integral back, at most the control rate; for "back-calculation", which
            needs it. 10 1/s is usual.

    References:
        Astrom and Hagglund, PID Controllers (1995), section 3.5.
    """

    anti_windup: Choice[AntiWindup] = Choice("clamping", "back-calculation", "none")
    tracking: Gain = Gain(unit="1/s", shape="entries", optional=True)
    e_int = Memory(unit="error s")

    def check(self) -> None:
        if (self.anti_windup == "back-calculation") != (self.tracking is not None):
            self.refuse("tracking", "is for anti_windup 'back-calculation', which needs it; give both or neither")

    def check_rate(self, rate: float) -> None:
        """An integral cannot be driven back faster than the rate [Hz]."""
        largest = 0.0 if self.tracking is None else float(np.max(self.tracking.as_array()))
        if largest > rate:
            raise RangeError(
                f"tracking must be <= the rate, {rate:g} [1/s], or the integral oscillates; got {largest:g}",
                name="tracking",
                value=largest,
            )

    def step(
        self,
        memory: MemoryView,
        e: Vector,
        dt: Any,
        *,
        ki: GainValue,
        cut: Callable[[], Vector],
        lost: Callable[[], Vector] | None = None,
    ) -> tuple[Vector, dict[str, Any]]:
        """(k,) the integral after this tick, and its new memory.

        Args:
            memory: Its memory, such as memory.integral.
            e: (k,) the error.
            dt: Period [s].
            ki: The gain that the integral is multiplied with, for back-calculation.
            cut: What limits took of the command, in the directions of e; called where it is needed.
            lost: The same in the unit of ki int(e), where that is another one.
        """
        before = memory.e_int
        after: Vector = before + e * dt
        if self.anti_windup == "clamping":
            after = tm.where(cut() * e > 0.0, before, after)
        elif self.anti_windup == "back-calculation":
            after = after - (self.tracking @ solved(ki, (lost or cut)())) * dt
        return after, {"e_int": after}


def solved(ki: GainValue, cut: Vector) -> Vector:
    """(n,) ki^-1 cut; nothing for joints, or in directions, that have no integral."""
    k = ki.as_array()
    if ki.ndim < 2:
        some = tm.where(k > 0.0, k, 1.0)
        out: Vector = tm.where(k > 0.0, cut / some, 0.0 * cut)
        return out
    size = k.shape[0]
    trace = sum(k[i, i] for i in range(size))
    damped = k @ k + ((DAMPING * trace) ** 2 + np.finfo(np.float64).tiny) * tm.eye(size)
    inverse: Vector = k @ tm.solve_spd(damped, cut)
    return inverse


def damping_force(kdamp: Matrix, mobility: Matrix, rate: Vector, dt: Any) -> Vector:
    """(k,) D y of a damper kdamp on y, with D = (kdamp^-1 + dt mobility)^-1 = (I + kdamp mobility dt)^-1 kdamp.

    It is kdamp times the y that this force alone leaves when the tick ends. Held over a tick, kdamp y itself reverses
    what is light, such as a last link about its own axis, and diverges where kdamp mobility dt > 2; the eigenvalues
    of D mobility dt are in [0, 1) for any kdamp.

    Args:
        kdamp: (k, k) symmetric, positive semidefinite.
        mobility: (k, k) by which a force accelerates y: J M^-1 J^T, symmetric, positive semidefinite.
        rate: (k,) y.
        dt: Control period [s].
    """
    out: Vector = tm.solve(tm.eye(len(mobility)) + dt * (kdamp @ mobility), kdamp @ rate)
    return out


def check_force_pole(kfp: Matrix, kfi: Matrix, rate: float) -> None:
    """The slow mode of a force that is fed back, -kfi / (1 + kfp), must be slower than the rate [Hz] on any contact.

    Raises:
        RangeError: It is not.
    """
    gains = [np.asarray(gain, dtype=np.float64) for gain in (kfp, kfi)]
    fastest = np.linalg.solve(np.eye(len(gains[0])) + gains[0], gains[1])
    pole = float(np.max(np.abs(np.linalg.eigvals(fastest))))
    if pole >= 2.0 * rate:
        raise RangeError(
            f"kfi / (1 + kfp) must be below twice the rate, {2.0 * rate:g} [1/s], or the force oscillates on any "
            f"contact; got {pole:g}; a pole of 1 to 20 1/s is usual",
            name="kfi",
            value=pole,
            rule="kfi / (1 + kfp) < 2 rate",
        )
