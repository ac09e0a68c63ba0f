"""Limits: the one place where a torque command is cut."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base import math as tm
from taut.base.checks import finite_array, require_positive
from taut.base.errors import ModelError, Problem, UsageError
from taut.base.types import Array, ArrayLike, Float64Array, Vector

__all__ = ["RATE_PER_EFFORT", "Limits"]

RATE_PER_EFFORT: Final = 10.0  # default torque rate: ten times the effort limit per second


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Largest torque, and largest change of torque per second, joint by joint.

    The magnitude wins over the rate: from a torque outside the limits the command goes to the limit in one
    step. The rate starts from the torque that the plant holds: what `reset(tau_applied=)` says, else the
    gravity torque, else zero if the plant compensates gravity itself.

    Args:
        tau: (n,) or scalar [N m | N]; None for no limit.
        tau_dot: (n,) or scalar [N m/s | N/s]; None for no limit.

    Raises:
        RangeError: A limit that is zero, negative or NaN.

    Example:
        >>> Limits(tau=87.0).tau.tolist()
        87.0
    """

    tau: ArrayLike | None = None
    tau_dot: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.tau is None and self.tau_dot is None:
            raise UsageError("Limits needs tau=, tau_dot= or both; for no limits leave limits=None")
        for name, unit in (("tau", "N m | N"), ("tau_dot", "N m/s | N/s")):
            value = getattr(self, name)
            if value is None:
                continue
            array = finite_array(f"limits.{name}", value, unit=unit, allow_infinite=True)
            require_positive(f"limits.{name}", array, unit=unit)
            object.__setattr__(self, name, array)

    @classmethod
    def of(cls, arm: Arm, *, rate: bool = False) -> Limits:
        """The arm's own effort limits; with `rate`, also ten times the effort limit per second.

        Raises:
            ModelError: The arm states no effort limit at all.
        """
        if not isinstance(arm, Arm):  # callers without a type checker
            raise UsageError(f"Limits.of takes an Arm from taut.load_arm; got {type(arm).__name__}", name="arm")
        if np.isinf(arm.effort).all():
            problem = Problem(
                object=arm.name,
                attribute="effort",
                message=f"arm '{arm.name}' states no effort limits; give taut.Limits(tau=...)",
            )
            raise ModelError(arm.name, [problem])
        return cls(tau=arm.effort, tau_dot=RATE_PER_EFFORT * arm.effort if rate else None)

    def check_size(self, arm: Arm) -> None:
        """Limits must be scalars or have one entry per joint."""
        for name in ("tau", "tau_dot"):
            value = getattr(self, name)
            if value is not None and np.ndim(value):
                finite_array(f"limits.{name}", value, shape=(arm.n,), joints=arm.joint_names, allow_infinite=True)

    def parameters(self) -> dict[str, Float64Array]:
        """The limits by name, as run-time parameters."""
        return {
            name: np.asarray(getattr(self, name), dtype=np.float64)
            for name in ("tau", "tau_dot")
            if getattr(self, name) is not None
        }


def limited(tau: Vector, held: Vector, parameters: Mapping[str, Array], dt: Any) -> Vector:
    """(n,) the command after rate and magnitude limits, from the torque that went out in the last tick."""
    if "tau_dot" in parameters:
        step = parameters["tau_dot"] * dt
        tau = tm.clip(tau, held - step, held + step)
    if "tau" in parameters:
        bound = parameters["tau"]
        tau = tm.clip(tau, -bound, bound)
    return tau
