"""TaskForce: what a law of force control is asked to press with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numpy as np

from taut.base.checks import one_of, read_only, vector
from taut.base.errors import UsageError
from taut.base.types import Array, ArrayLike, Rotation, Wrench
from taut.control.trajectories.reference import Sample
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated

__all__ = ["TaskForce"]

ForceFrame = Literal["world", "tool"]
FRAMES: Final[tuple[ForceFrame, ...]] = ("world", "tool")
UNIT: Final = "N, N m"


@dataclass(frozen=True, slots=True, init=False, eq=False)
class TaskForce(Sample):
    """Desired wrench of the arm on the environment, at the tool's origin.

    Between two samples of a chunk each number goes straight. One in the axes of the tool turns with the tool.

    Frames:
        frame="world" is the axes of the world, "tool" those of the frame that the law controls. Either way the force
        acts at the origin of that frame.

    Args:
        F_app: (6,) wrench of the arm on the environment, force first [N, N m].
        F_ext: (6,) the same as the wrench of the environment on the arm, -F_app; one of the two.
        frame: "world" or "tool".

    Raises:
        UsageError: Both F_app and F_ext, or neither; axes that are neither.
        ShapeError: Not six numbers.
        RangeError: NaN or infinite numbers.

    Example:
        >>> press = TaskForce(F_app=[0, 0, 10.0, 0, 0, 0], frame="tool")
        >>> press.in_world(np.diag([1.0, -1.0, -1.0])).tolist()
        [0.0, 0.0, -10.0, 0.0, 0.0, 0.0]

    References:
        Section 10.3 force control.
    """

    F_world: Array  # (6,) the part in world axes
    F_tool: Array  # (6,) the part in the tool's axes

    def __init__(
        self, *, F_app: ArrayLike | None = None, F_ext: ArrayLike | None = None, frame: ForceFrame = "world"
    ) -> None:
        one_of("frame", frame, FRAMES)
        if (F_app is None) == (F_ext is None):
            got = "neither" if F_app is None else "both"
            raise UsageError(
                "a wrench is F_app=, of the arm on the environment, or F_ext=, of the environment on the arm; got "
                f"{got}; give one of them",
                name="ref.F_app",
            )
        if F_app is not None:
            F = vector("ref.F_app", F_app, 6, unit=UNIT)
        else:
            F = 0.0 - vector("ref.F_ext", F_ext, 6, unit=UNIT)  # type: ignore[arg-type]  # one of them is there
        zero = np.zeros(6)
        object.__setattr__(self, "F_world", read_only(F if frame == "world" else zero))
        object.__setattr__(self, "F_tool", read_only(zero if frame == "world" else F))

    def in_world(self, R: Rotation) -> Wrench:
        """(6,) F_app in world axes, with the tool turned by R_WE; of rows (k, ...) a row for each."""
        if np.ndim(self.F_tool) == 2:
            parts = np.asarray(self.F_tool).reshape(-1, 2, 3)
            rows: Wrench = np.asarray(self.F_world) + np.einsum("kij,kaj->kai", R, parts).reshape(-1, 6)
            return rows
        turned: Wrench = self.F_world + rotated(R, self.F_tool)
        return turned

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:  # noqa: ARG003
        return {"F_world": (6,), "F_tool": (6,)}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        made = object.__new__(cls)
        for name in ("F_world", "F_tool"):
            object.__setattr__(made, name, values[name])
        return made

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:  # noqa: ARG003
        """No force at all."""
        return cls.of({"F_world": np.zeros(6), "F_tool": np.zeros(6)})

    def __repr__(self) -> str:
        if self.F_world.dtype == object:
            return "TaskForce(<traced>)"
        if np.any(self.F_world) and np.any(self.F_tool):
            return f"TaskForce(F_world={self.F_world.tolist()}, F_tool={self.F_tool.tolist()})"
        if np.any(self.F_tool):
            return f"TaskForce(F_app={self.F_tool.tolist()}, frame='tool')"
        return f"TaskForce(F_app={self.F_world.tolist()})"
