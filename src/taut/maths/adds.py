"""Adds: torques that a plant adds to a command itself, so that a law leaves exactly these out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Payload
from taut.base.errors import UsageError, unknown_name
from taut.base.types import Array, Vector
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues

__all__ = ["Adds", "compensation"]

COMPONENTS: Final = ("gravity", "coriolis", "friction")


@dataclass(frozen=True, kw_only=True)
class Adds:
    """Torques that the plant adds to every command.

    Args:
        gravity: Gravity of the arm, and of `load` where one is known to it.
        coriolis: Coriolis and centripetal torques.
        friction: The arm's own friction.
        load: The payload whose gravity the plant adds; None means the controller's own payload.
    """

    gravity: bool = False
    coriolis: bool = False
    friction: bool = False
    load: Payload | None = None

    @classmethod
    def of(cls, given: Adds | Iterable[str] | Mapping[str, Payload | None]) -> Adds:
        """From names such as ("gravity", "coriolis"), or {"gravity": Payload(...)}.

        Raises:
            UnknownNameError: A component that no plant adds.
            UsageError: A payload for something else than gravity.
        """
        if isinstance(given, Adds):
            return given
        if isinstance(given, str):
            raise UsageError(f"adds must be a tuple of names; got {given!r}; write ({given!r},)", name="adds")
        if not isinstance(given, Iterable):  # callers without a type checker
            raise UsageError(f"adds must be a tuple of names such as ('gravity',); got {given!r}", name="adds")
        names = list(given)
        for name in names:
            if name not in COMPONENTS:
                raise unknown_name("what a plant adds", "component", str(name), COMPONENTS)
        load = None
        if isinstance(given, Mapping):
            for name, payload in given.items():
                if payload is None:
                    continue
                if name != "gravity" or not isinstance(payload, Payload):
                    raise UsageError(
                        f"adds[{name!r}] must be None; only 'gravity' takes a taut.Payload; got {payload!r}",
                        name="adds",
                    )
                load = payload
        return cls(**dict.fromkeys(names, True), load=load)

    @property
    def names(self) -> tuple[str, ...]:
        """The components that are added."""
        return tuple(name for name in COMPONENTS if getattr(self, name))

    def __str__(self) -> str:
        return "{" + ", ".join(self.names) + "}"


def compensation(model: Model, adds: Adds, q: Vector, v: Vector, payload: PayloadValues) -> Array:
    """(n,) gravity and Coriolis torques that are added; friction apart, of which none is left then."""
    total: Any = np.zeros(model.n)
    if adds.gravity:
        load = payload
        if adds.load is not None:
            load = PayloadValues(mass=adds.load.mass, com=adds.load.com, inertia=adds.load.inertia)
        total = total + dyn.gravity_torque(model, q, load)
    if adds.coriolis:
        total = total + dyn.bias(model, q, v, payload, gravity=False)
    return total  # type: ignore[no-any-return]
