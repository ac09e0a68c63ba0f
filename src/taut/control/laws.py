"""taut.laws: every law of the library, by name."""

from __future__ import annotations

from taut.control.combine import Sum
from taut.control.joint import (
    PID,
    ComputedTorque,
    FeedForward,
    FrictionCompensation,
    GravityCompensation,
    GravityPID,
    VelocityPI,
)

__all__ = [
    "PID",
    "ComputedTorque",
    "FeedForward",
    "FrictionCompensation",
    "GravityCompensation",
    "GravityPID",
    "Sum",
    "VelocityPI",
]
