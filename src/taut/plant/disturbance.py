"""Disturbances: what acts on a loop from outside, beside its environment, in a study of it.

They are inputs of a tick, held until the next, that a loop takes where it is given them; a run has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from taut.base.types import Array, Vector
from taut.maths import dynamics as dyn
from taut.maths.model import Model

__all__ = ["COMMAND", "TORQUE", "WRENCH", "disturbance_shapes", "joint_forces", "of_plant"]

COMMAND: Final = "disturbance.command"  # (n,) added to what the law commands, before the drives
TORQUE: Final = "disturbance.torque"  # (n,) on the joints [N m | N]
WRENCH: Final = "disturbance.wrench"  # (6,) on the tool, force first, in world axes [N, N m]


def disturbance_shapes(n: int) -> dict[str, tuple[int, ...]]:
    """The shape of each, for an arm of n joints."""
    return {COMMAND: (n,), TORQUE: (n,), WRENCH: (6,)}


def of_plant(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a tick's inputs that act behind the drives, which a plant takes among its parameters."""
    return {path: inputs[path] for path in (TORQUE, WRENCH) if path in inputs}


def joint_forces(model: Model, q: Vector, wrench: Array | None, parameters: Mapping[str, Any]) -> Array | None:
    """(n,) what a wrench at the tool, and a disturbance, put on the joints; None where there is neither."""
    torque: Array | None = parameters.get(TORQUE)
    if wrench is None:
        return torque
    force: Array = dyn.jacobian(model, q).T @ wrench
    return force if torque is None else force + torque
