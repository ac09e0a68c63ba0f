"""Targets of laws that follow a TaskMotion: whether they are out of the arm's reach."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.types import Float64Array, Vector, Wrench
from taut.control.law import Law
from taut.control.laws.task_error import Coordinates, ErrorKind
from taut.control.side_by_side import SideBySide
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.out_of_reach import Asked, Beyond, distance_beyond, spheres
from taut.maths.singularity import TOP_SPEED
from taut.maths.snapshot import Snapshot
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm

if TYPE_CHECKING:
    from taut.control.tasks.task import Task

__all__ = ["RATE", "asked_of", "eased", "far_away", "may_bound", "out_of_reach", "within_speed"]

EASED: Final = (0.05, 0.3)  # of the reach, and [rad]: what an error counts for at most, out of reach
RATE: Final = 5.0  # [1/s] at which joints settle under a spring to a target out of reach


def asked_of(kind: ErrorKind, coordinates: Coordinates | None) -> Asked | None:
    """What an error says of the pose: all of it, its position, or nothing that is known."""
    if kind != "coordinates":
        return "pose"
    return "position" if coordinates == Coordinates.position() else None


def out_of_reach(x: Snapshot, ref: TaskMotion, tool: str | None, asked: Asked | None) -> Beyond | None:
    """How clearly a target is out of reach; None where an error does not say enough to know."""
    if asked is None:
        return None
    found = spheres(x.model, tool, asked)
    return Beyond.of(found, ref.p, ref.R) if found else None


def eased(away: Beyond, share: Any, X: Vector) -> Any:
    """The factor, at most 1, of a spring with the error X to a target out of reach; 1 where share is 0.

    In full, X counts for less than EASED: it is X / sqrt(1 + r^2), with r its length in parts of that.
    """
    length = (X[:3] @ X[:3]) * (1.0 / (EASED[0] * away.reach) ** 2)
    turn = (X[3:] @ X[3:]) * (1.0 / EASED[1] ** 2) if len(X) == 6 else 0.0
    return 1.0 / tm.sqrt(1.0 + share * (length + turn))


def within_speed(x: Snapshot, inertia: TaskInertia, F: Wrench) -> Wrench:
    """(k,) a spring's wrench, made smaller until it brings no joint beyond its speed limit.

    With tau = J^T F - RATE M v + h the joint speeds follow M^-1 J^T F / RATE at that rate.

    Args:
        x: The arm at its measured state.
        inertia: That of the task.
        F: (k,) in the coordinates of J.
    """
    most: Any = 1.0
    for speed, top in zip(inertia.joint_acceleration(F), x.arm.velocity, strict=True):
        if np.isfinite(top):
            most = tm.maximum(most, tm.abs(speed) * (1.0 / (TOP_SPEED * RATE * top)))
    out: Wrench = F / most
    return out


def far_away(law: Law | Task, x: Snapshot, rows: dict[str, Float64Array]) -> Float64Array | None:
    """(k,) how far at least the targets of a run are out of reach [m]; None where the law follows no pose.

    Args:
        law: The law of the run.
        x: Any state of its arm.
        rows: (k, ...) each field of what it followed.
    """
    if isinstance(law, SideBySide):
        seen = law.seen(x)
        parts = [
            far_away(
                part,
                seen[name],
                {field[len(name) + 1 :]: rows[field] for field in rows if field.startswith(f"{name}_")},
            )
            for name, part in law.parts.items()
        ]
        known = [part for part in parts if part is not None]
        return np.max(known, axis=0) if known else None
    asked = _asked(law) if law.reference is TaskMotion else None
    if asked is None:
        return None
    return distance_beyond(spheres(x.model, law.controlled_frame, asked), rows["p"], rows["R"])


def may_bound(law: Law | Task) -> bool:
    """Whether a law, or one that it holds, has a spring that could be bounded and is not."""
    own = isinstance(law, Law) and "error_max" in vars(law) and not law.gives("error_max")
    return own or any(map(may_bound, law.children().values()))


def _asked(law: Law | Task) -> Asked | None:
    """What of the pose a law asks for, or the law that it holds."""
    own = vars(law)
    if "directions" in own:
        return "pose" if own["directions"] == "all" else "position"
    if "error" in own:
        return asked_of(own["error"], own["coordinates"])
    inner = [
        child for child in law.children().values() if child.reference is TaskMotion and not child.ignores_reference
    ]
    return _asked(inner[0]) if inner else "pose"
