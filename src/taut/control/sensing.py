"""Sensing: from what the sensors give to what the law sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from taut.arm.description import Arm
from taut.base.checks import one_of
from taut.base.types import Vector

__all__ = ["Sensing"]

VELOCITIES: Final[tuple[Literal["measured", "difference"], ...]] = ("measured", "difference")


@dataclass(frozen=True, kw_only=True)
class Sensing:
    """How the law gets its velocity.

    Args:
        velocity: "measured" takes the velocity that the plant measures; "difference" differences positions of
            successive ticks, v = (q - q_prev) / dt, with q_prev the first position in the first tick.

    References:
        The chapter's pseudocode, figures 10.8 and 10.13.
    """

    velocity: Literal["measured", "difference"] = "measured"

    def __post_init__(self) -> None:
        one_of("velocity", self.velocity, VELOCITIES)

    @property
    def needs_velocity(self) -> bool:
        """Whether a measured velocity is used."""
        return self.velocity == "measured"

    def start(self, q: Vector) -> dict[str, Any]:
        """Memory at the first tick."""
        return {} if self.needs_velocity else {"q_prev": q}

    def velocity_of(
        self, arm: Arm, q: Vector, v: Vector, memory: Mapping[str, Any], dt: Any
    ) -> tuple[Vector, dict[str, Any]]:
        """(n,) the velocity, and the new memory."""
        if self.needs_velocity:
            return v, {}
        return arm.difference(q, memory["q_prev"]) / dt, {"q_prev": q}
