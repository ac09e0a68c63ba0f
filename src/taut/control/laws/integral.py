"""The integral of an error, and what keeps it from winding up."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np

from taut.base.errors import RangeError
from taut.base.types import Matrix, Vector
from taut.control.gains import GainValue
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["ANTI_WINDUP", "AntiWindup", "check_force_pole", "check_tracking", "integrated", "solved"]

AntiWindup = Literal["none", "clamping", "back-calculation"]
ANTI_WINDUP: Final[tuple[AntiWindup, ...]] = ("none", "clamping", "back-calculation")
DAMPING: Final = 1e-5  # of a matrix ki that is inverted, relative to its trace


def integrated(
    e_int: Vector,
    e: Vector,
    x: Snapshot,
    dt: Any,
    scheme: AntiWindup,
    ki: GainValue,
    tracking: GainValue,
    *,
    acceleration: bool = False,
    cut: Vector | None = None,
) -> Vector:
    """(n,) the integral of the error after this tick, e_int + e dt, less what keeps it from winding up.

    * "clamping" (conditional integration): a joint's integral rests while limits cut that joint's command and the
      error pushes further into the limit.
    * "back-calculation": what limits cut drives the integral back,
      e_int + (e - tracking ki^-1 cut) dt; it comes to rest where ki e = tracking cut.

    Without limits all schemes are the same, and cost the same.

    Args:
        e_int: (n,) the integral before.
        e: (n,) the error.
        x: The arm.
        dt: Period [s].
        scheme: By name.
        ki: The gain that the integral is multiplied with.
        tracking: How fast it is driven back [1/s].
        acceleration: Whether the integral is an acceleration rather than a torque.
        cut: What limits took, in the directions of the error; that of the joints' torques if left out.

    References:
        Astrom and Hagglund, PID Controllers (1995), section 3.5.
    """
    grown: Vector = e_int + e * dt
    if scheme == "none":
        return grown
    if scheme == "clamping":
        taken = x.tau_cut if cut is None else cut
        held: Vector = tm.where(taken * e > 0.0, e_int, grown)
        return held
    if cut is None:
        cut = tm.solve_spd(x.M_factors, x.tau_cut) if acceleration else x.tau_cut
    driven: Vector = grown - (tracking @ solved(ki, cut)) * dt
    return driven


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


def check_tracking(scheme: AntiWindup, tracking: GainValue, rate: float) -> None:
    """An integral cannot be driven back faster than the rate [Hz].

    Raises:
        RangeError: It is asked to.
    """
    largest = float(np.max(tracking.as_array()))
    if scheme == "back-calculation" and largest > rate:
        raise RangeError(
            f"tracking must be at most the rate, {rate:g} [1/s], or the integral would swing; got {largest:g}",
            name="tracking",
            value=largest,
        )


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
            f"kfi / (1 + kfp) must be below twice the rate, {2.0 * rate:g} [1/s], or the force swings on any "
            f"contact; got {pole:g}; a pole of 1 to 20 1/s is usual",
            name="kfi",
            value=pole,
            rule="kfi / (1 + kfp) < 2 rate",
        )
