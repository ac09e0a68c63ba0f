"""Fade: from one motion to another without a jump of position, velocity or acceleration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.arm.angles import short_way
from taut.arm.description import Arm
from taut.base.types import Float64Array
from taut.control.trajectories.reference import JointMotion, Sample
from taut.control.trajectories.task_blend import faded, offset
from taut.control.trajectories.task_reference import TaskMotion
from taut.control.trajectories.timing import quintic_between

__all__ = ["Fade", "can_fade"]

Rows = Mapping[str, Float64Array]


def can_fade(kind: type[Sample]) -> bool:
    """Whether samples of this kind are motions, with rates."""
    return kind in (JointMotion, TaskMotion)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fade:
    """What led from a new motion to an old one when it took its place, which fades to nothing as a quintic."""

    kind: type[Sample]
    since: float  # [s]
    duration: float  # [s]
    start: Any  # the offset at `since`

    @classmethod
    def of(cls, kind: type[Sample], old: Rows, new: Rows, since: float, duration: float, arm: Arm) -> Fade:
        """The fade from one motion to another.

        Args:
            kind: Kind of sample of both.
            old: Its fields at `since`, one row each.
            new: The same of what takes its place.
            since: [s].
            duration: [s].
            arm: Whose continuous joints go the short way round.
        """
        if kind is TaskMotion:
            return cls(kind=kind, since=since, duration=duration, start=offset(old, new))
        q = short_way(old["q"] - new["q"], arm.continuous)
        return cls(kind=kind, since=since, duration=duration, start=(q, old["v"] - new["v"], old["a"] - new["a"]))

    def applied(self, rows: Rows, times: Float64Array) -> dict[str, Float64Array]:
        """The new motion with what is left of the old one, at times from `since` on [s]."""
        x = np.clip((times - self.since) / self.duration, 0.0, 1.0)
        full = {name: np.broadcast_to(values, (len(times), *values.shape[1:])) for name, values in rows.items()}
        if self.kind is TaskMotion:
            return faded(full, x, self.duration, self.start)
        none = (np.zeros_like(self.start[0]),) * 3
        left = quintic_between(x, self.duration, self.start, none)
        return {name: full[name] + part for name, part in zip(("q", "v", "a"), left, strict=True)}
