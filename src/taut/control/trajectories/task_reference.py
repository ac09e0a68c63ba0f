"""TaskMotion: what a law of task space is asked to follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from taut.base.checks import one_of, read_only, vector
from taut.base.errors import UsageError
from taut.base.types import Array, ArrayLike, Float64Array
from taut.control.trajectories.reference import Sample
from taut.control.trajectories.task_blend import between
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated
from taut.trace.pose import Pose

__all__ = ["TaskMotion"]

MotionFrame = Literal["world", "tool"]
FRAMES: Final[tuple[MotionFrame, ...]] = ("world", "tool")


@dataclass(frozen=True, slots=True, init=False, eq=False)
class TaskMotion(Sample):
    """Desired pose, twist and acceleration of the tool.

    Frames:
        `pose` is T_WD, of the desired tool frame D in the world. With frame="world" `twist` is the velocity of D's
        origin and its angular velocity, in world axes, and `acceleration` the rate of both. With frame="tool" they
        are the body twist of D and the rate of its numbers, as the textbook's are; they are kept in world axes.

    Args:
        pose: Where the tool is to be.
        twist: (6,) linear part first [m/s, rad/s]; zero if left out.
        acceleration: (6,) linear part first [m/s^2, rad/s^2]; zero if left out.
        frame: The axes of twist and acceleration, "world" or "tool".

    Raises:
        UsageError: No Pose, or a frame that is neither.
        ShapeError: Not six numbers.
        RangeError: NaN or infinite numbers.

    Example:
        >>> pose = Pose([0.4, 0.0, 0.3], rpy=[0.0, np.pi, 0.0])
        >>> ref = TaskMotion(pose=pose, twist=[0, 0, 1, 0, 0, 0], frame="tool")
        >>> ref.twist.round(6).tolist()
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]

    References:
        Section 10.2.3 task space motion control.
    """

    p: Array  # (3,) [m]
    R: Array  # (3, 3)
    twist: Array  # (6,) world axes
    acceleration: Array  # (6,) world axes

    def __init__(
        self,
        *,
        pose: Pose,
        twist: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        frame: MotionFrame = "world",
    ) -> None:
        if not isinstance(pose, Pose):  # callers without a type checker
            raise UsageError(
                f"ref.pose must be a taut.Pose(p=..., rpy=...); got {type(pose).__name__}", name="ref.pose"
            )
        one_of("frame", frame, FRAMES)
        V = np.zeros(6) if twist is None else vector("ref.twist", twist, 6, unit="m/s, rad/s")
        rate = vector("ref.acceleration", np.zeros(6) if acceleration is None else acceleration, 6)
        if frame == "tool":
            rate = rotated(pose.R, rate) + np.append(np.cross(pose.R @ V[3:], pose.R @ V[:3]), np.zeros(3)) + 0.0
            V = rotated(pose.R, V) + 0.0
        for name, value in (("p", pose.p), ("R", pose.R), ("twist", V), ("acceleration", rate)):
            object.__setattr__(self, name, read_only(value))

    @property
    def pose(self) -> Pose:
        """T_WD, where the tool is to be."""
        return Pose.of(self.R, self.p)

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:  # noqa: ARG003
        return {"p": (3,), "R": (3, 3), "twist": (6,), "acceleration": (6,)}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        made = object.__new__(cls)
        for name in ("p", "R", "twist", "acceleration"):
            object.__setattr__(made, name, values[name])
        return made

    @classmethod
    def between(
        cls, times: Float64Array, knots: Float64Array, rows: Mapping[str, Float64Array]
    ) -> dict[str, Float64Array]:
        return between(times, knots, rows)

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:
        T, zero = x.T(tool), np.zeros(6)
        return cls.of({"p": T.p, "R": T.R, "twist": zero, "acceleration": zero})

    def __repr__(self) -> str:
        if self.p.dtype == object:
            return "TaskMotion(<traced>)"
        return (
            f"TaskMotion(pose={self.pose!r}, twist={self.twist.tolist()}, acceleration={self.acceleration.tolist()})"
        )
