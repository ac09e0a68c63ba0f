"""The closed loop of a law of the tool: its error's coordinates at rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from taut.control.closed_loop import ClosedLoop, PlacedGains
from taut.control.law import Law
from taut.control.laws.task_space import TaskSpace
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.snapshot import Snapshot

__all__ = ["tool_loop"]

AXES: Final = ("x", "y", "z", "about x", "about y", "about z")
UNITS: Final = ("m", "m", "m", "rad", "rad", "rad")


def tool_loop(law: Law, x: Snapshot, gains: Callable[[PlacedGains], Law], **options: Any) -> ClosedLoop:
    """That of a law with a `tool`, in the axes of its gains.

    Args:
        law: The law; `error`, `frame` and `coordinates` count where it has them.
        x: The arm at rest.
        gains: The law with other gains.
        **options: Fields of `ClosedLoop`.
    """
    space = TaskSpace.of(law)
    at = space.at(x, TaskMotion.at_rest(x, space.tool))
    J = np.asarray(at.inwards(at.error.J), dtype=np.float64)
    six = len(J) == len(AXES)
    names, units = (AXES, UNITS) if six else (tuple(f"y{i}" for i in range(len(J))), ("m",) * len(J))
    return ClosedLoop(x=x, J=J, names=names, units=units, gains=gains, **options)
