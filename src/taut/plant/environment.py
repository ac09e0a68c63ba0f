"""What touches the tool of a model plant: a class of the user's own with the methods of `Environment`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from taut.base.pose import Pose
from taut.base.types import Float64Array, Twist, Wrench

__all__ = ["Environment"]

Values = Mapping[str, Any]


@runtime_checkable
class Environment(Protocol):
    """What touches the tool. A frozen dataclass of numbers, with a pure function for the wrench.

    The wrench is that of the environment on the arm, force first, in world axes at the tool's origin.
    """

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name."""
        ...

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start, from the tool's pose."""
        ...

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the new memory."""
        ...
