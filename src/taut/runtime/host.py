"""HostPlant: a plant with a state of its own, such as a physics engine, stepped tick by tick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from taut.base.types import ArrayLike, Float64Array
from taut.loop import AnyPlant

__all__ = ["HostPlant", "RealArm"]


class HostPlant(AnyPlant, Protocol):
    """What a simulation asks of a plant that is not a pure function."""

    @property
    def parameters(self) -> Mapping[str, Float64Array]:
        """Run-time parameters by path: plant.payload.mass, ..."""
        ...

    def checked_parameter(self, path: str, value: ArrayLike) -> Float64Array:
        """A new value of a parameter, checked, without giving it."""
        ...

    def set_parameters(self, values: Mapping[str, ArrayLike]) -> None:
        """Give parameters new values, each checked, and all together."""
        ...

    def reset(self, q: Float64Array, v: Float64Array, dt: float, seed: int) -> None:
        """Put the plant into a state, and prepare it for control periods of dt [s]; any noise is the seed's."""
        ...

    def state(self) -> tuple[Float64Array, Float64Array]:
        """(n,) the true position and velocity."""
        ...

    def measure(self) -> dict[str, Float64Array]:
        """What the sensors give: q, and whatever `measures` names."""
        ...

    def advance(self, command: Float64Array) -> Float64Array:
        """One control period under a command; (n,) the torque that acted on the joints."""
        ...

    def trouble(self) -> tuple[str, int | None] | None:
        """What went wrong in the last period, in words, and the joint; None if nothing did."""
        ...

    def extra(self) -> dict[str, Any]:
        """Further columns of the record, by name; the same names in every tick."""
        ...


@runtime_checkable
class RealArm(Protocol):
    """A host plant that may be a real arm: then a run with an unstable loop is refused, not begun with a warning."""

    @property
    def real(self) -> bool:
        """Whether commands move a real arm."""
        ...
