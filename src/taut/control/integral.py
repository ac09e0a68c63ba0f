"""The integral of an error, and what keeps it from winding up."""

from __future__ import annotations

from typing import Any, Final, Literal

from taut.base import math as tm
from taut.base.types import Vector
from taut.maths.snapshot import Snapshot

__all__ = ["ANTI_WINDUP", "AntiWindup", "integrated"]

AntiWindup = Literal["none", "clamping"]
ANTI_WINDUP: Final[tuple[AntiWindup, ...]] = ("none", "clamping")


def integrated(e_int: Vector, e: Vector, x: Snapshot, dt: Any, scheme: AntiWindup) -> Vector:
    """(n,) the integral of the error after this tick, e_int + e dt.

    With "clamping" (conditional integration) a joint's integral rests while limits cut that joint's torque and
    the error pushes further into the limit. Without limits both schemes are the same, and cost the same.
    """
    grown: Vector = e_int + e * dt
    if scheme == "none":
        return grown
    held: Vector = tm.where(x.tau_cut * e > 0.0, e_int, grown)
    return held
