"""References of force in a scenario: kind = "force" or "force-samples"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

import numpy as np

from taut.control.trajectories.chunk import chunk
from taut.control.trajectories.force_reference import FRAMES, TaskForce
from taut.control.trajectories.reference import Chunk
from taut.scenarios.toml import Section

__all__ = ["FORCE_KINDS", "ForceReference", "read_force_reference"]

ForceReference: TypeAlias = TaskForce | Chunk


def read_force_reference(section: Section, kind: str) -> ForceReference:
    """A wrench to hold, or wrenches at stated times with straight lines in between.

    Args:
        section: [reference], of which kind is read already.
        kind: One of FORCE_KINDS.
    """
    return FORCE_KINDS[kind](section)


def _force(section: Section) -> ForceReference:
    F_app, frame = section.numbers("F_app"), section.word("frame", FRAMES, "world")
    section.done()
    with section.blamed():
        return TaskForce(F_app=F_app, frame=frame)


def _samples(section: Section) -> ForceReference:
    times, rows = section.numbers("times"), section.numbers("F_app")
    frame = section.word("frame", FRAMES, "world")
    section.done()
    if np.ndim(np.array(rows, dtype=object)) != 2:
        raise section.error(f"F_app must be one wrench of six numbers for each time; got {rows!r}")
    with section.blamed():
        return chunk(times, [TaskForce(F_app=row, frame=frame) for row in rows])


FORCE_KINDS: Final[Mapping[str, Callable[[Section], ForceReference]]] = {"force": _force, "force-samples": _samples}
