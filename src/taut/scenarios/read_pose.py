"""Poses in a scenario: { p = [0.4, 0.0, 0.3], rpy = [3.14, 0.0, 0.0] }, or "home"."""

from __future__ import annotations

from typing import Any, Final

from taut.base.errors import quoted_list
from taut.scenarios.toml import Section
from taut.trace.pose import Pose

__all__ = ["HomeFrame", "pose_table", "read_pose", "read_poses"]

ROTATIONS: Final = ("xyzw", "wxyz", "rpy", "R")
EXAMPLE: Final = "{ p = [0.4, 0.0, 0.3], rpy = [3.14, 0.0, 0.0] }"


class HomeFrame:
    """Where the tool is at home, and whether poses are given from there.

    Args:
        T: T_WE at home.
        relative: Whether poses are offsets from it: p is added to its position, and the rotation is by the world's
            axes, about the tool.
    """

    def __init__(self, T: Pose, *, relative: bool) -> None:
        self.T, self.relative = T, relative

    def placed(self, pose: Pose) -> Pose:
        """A pose as the file has it, in the world."""
        return Pose(self.T.p + pose.p, R=pose.R @ self.T.R) if self.relative else pose


def pose_table(section: Section) -> Pose:
    """A pose from the keys of a table; what is left out is zero."""
    rotation = {word: section.numbers(word) for word in ROTATIONS if word in section}
    p = section.numbers("p", [0.0, 0.0, 0.0])
    section.only(*ROTATIONS)
    with section.blamed():
        return Pose(p, **rotation)


def read_pose(section: Section, key: str, home: HomeFrame, *, required: bool = True) -> Pose:
    """The pose at a key, in the world; home if it is not required and not there.

    Raises:
        ScenarioError: No pose, one that lacks its position or orientation, another word than "home".
    """
    if key not in section and not required:
        section.take(key, None)
        return home.T
    value: Any = section.peek(key)
    if value == "home":
        section.take(key)
        return home.T
    if value is not None and not isinstance(value, dict):
        raise section.error(f'{key} must be a pose such as {EXAMPLE}, or "home"; got {value!r}')
    return _placed(section.section(key, required=True), home)


def read_poses(section: Section, key: str, home: HomeFrame) -> list[Pose]:
    """An array of poses."""
    if key not in section:
        section.take(key)
    return [_placed(table, home) for table in section.sections(key)]


def _placed(table: Section, home: HomeFrame) -> Pose:
    given = [word for word in ROTATIONS if word in table]
    if not home.relative:  # where a zero is a place, and the identity an orientation, that few arms can take
        if "p" not in table:
            table.take("p", what="its position p")
        if not given:
            raise table.error(f"needs its orientation: one of {quoted_list(ROTATIONS)}")
    pose = pose_table(table)
    return home.placed(pose)
