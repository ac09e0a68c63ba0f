"""What laws of force and hybrid laws follow: a wrench; a motion along a constraint, and forces against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Final, Self

import numpy as np

from taut.base.checks import finite_scalar, one_of, read_only, vector
from taut.base.errors import ShapeError, UsageError
from taut.base.fields import Field, Part, Plain
from taut.base.types import Array, ArrayLike, Float64Array, Rotation, Wrench
from taut.control.trajectories.reference import Hold, JointMotion, Rows, Sample, Shapes, Trajectory, rows_of
from taut.control.trajectories.task_reference import FRAMES, Axes, TaskMotion
from taut.control.trajectories.timing import Motion
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated

UNIT: Final = "N, N m"


@dataclass(frozen=True, slots=True, init=False, eq=False)
class TaskForce(Sample):
    """Desired wrench of the arm on the environment, at the tool's origin.

    It is linear between two samples of a chunk. One in the axes of the tool rotates with the tool.

    Frames:
        frame="world" is the axes of the world, "tool" those of the frame that the law controls. Either way the force
        acts at the origin of that frame.

    Args:
        F_app: (6,) wrench of the arm on the environment, force first [N, N m].
        F_ext: (6,) the same as the wrench of the environment on the arm, -F_app; one of the two.
        frame: "world" or "tool".

    Raises:
        UsageError: Both F_app and F_ext, or neither; other axes.
        ShapeError, RangeError: Not six numbers, or not finite ones.

    Example:
        >>> press = TaskForce(F_app=[0, 0, 10.0, 0, 0, 0], frame="tool")
        >>> press.in_world(np.diag([1.0, -1.0, -1.0])).tolist()
        [0.0, 0.0, -10.0, 0.0, 0.0, 0.0]

    References:
        Section 10.3 force control.
    """

    _shapes: ClassVar[Shapes] = {"F_world": (6,), "F_tool": (6,)}

    F_world: Array  # (6,) the part in world axes
    F_tool: Array  # (6,) the part in the tool's axes

    def __init__(
        self, *, F_app: ArrayLike | None = None, F_ext: ArrayLike | None = None, frame: Axes = "world"
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


MAX_MULTIPLIERS: Final = 12  # of all constraints at once
FORCES: Final = {"press": (1,), "lam": (MAX_MULTIPLIERS,), "F_app": (6,), "given": (1,)}


class HybridMotion(Sample):
    """A motion, and the forces that the arm is to apply against its constraints; `taut.pressing` makes them.

    Fields are those of the motion, and the forces, which add up:
        press (1,) [N] into the surface of the first row, lam (12,) the multipliers of eq. 10.40 row by row, and F_app
        (6,) a wrench [N, N m] of the arm on the environment at the tool, in world axes. given (1,) tells how many
        multipliers were given, 0 where none were.
    """

    __slots__ = ("F_app", "_motion", "given", "lam", "press")
    kind: ClassVar[type[Sample]] = TaskMotion

    press: Array
    lam: Array
    F_app: Array
    given: Array

    def __init__(self, motion: Sample, press: Array, lam: Array, F_app: Array, given: Array) -> None:
        self._motion, self.press, self.lam, self.F_app, self.given = motion, press, lam, F_app, given
        for name in self.kind.fields(0):  # where the call path finds them
            setattr(self, name, getattr(motion, name))

    @property
    def motion(self) -> Sample:
        """The motion without the forces."""
        return self._motion

    @classmethod
    def described(cls) -> str:
        return f"HybridMotion of a {cls.kind.described()}, from taut.pressing(...)"

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        return {**cls.kind.fields(n), **FORCES}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        return cls(cls.kind.of(values), *(values[name] for name in FORCES))

    @classmethod
    def between(cls, times: Float64Array, knots: Float64Array, rows: Rows) -> dict[str, Float64Array]:
        forces = {name: rows[name] for name in FORCES}
        motion = {name: values for name, values in rows.items() if name not in FORCES}
        return {**cls.kind.between(times, knots, motion), **super().between(times, knots, forces)}

    @classmethod
    def at_rest(cls, x: Snapshot, tool: str | None) -> Self:
        """To stay, and to apply no force."""
        return cls(cls.kind.at_rest(x, tool), *(np.zeros(shape) for shape in FORCES.values()))

    def __repr__(self) -> str:
        if self.F_app.dtype == object:
            return "HybridMotion(<traced>)"
        given = {name: np.asarray(getattr(self, name)) for name in FORCES if name != "given"}
        forces = [f"{name}={values.squeeze().tolist()}" for name, values in given.items() if np.any(values)]
        return f"pressing({', '.join([repr(self.motion), *forces])})"


@cache
def hybrid_kind(motion: type[Sample]) -> type[HybridMotion]:
    """The kind of sample that holds this kind of motion."""
    body = {"__slots__": tuple(motion.fields(0)), "__module__": __name__, "kind": motion}
    return type("HybridMotion", (HybridMotion,), body)


OF_TASK, OF_JOINTS = hybrid_kind(TaskMotion), hybrid_kind(JointMotion)  # so that logs find them
OF_TASK.__qualname__, OF_JOINTS.__qualname__ = "OF_TASK", "OF_JOINTS"  # and pickles of a law


class Pressing(Motion[HybridMotion]):
    """A motion with forces as one trajectory; made by `taut.pressing`."""

    motion: Part[Any] = Part(Sample, Trajectory)
    press: Plain[float | Callable[[float], float]] = Plain(default=0.0)
    lam: Field = Field(unit=UNIT, shape="k", optional=True)
    F_app: Field = Field(unit=UNIT, shape=6, optional=True)

    def check(self) -> None:
        """Forces are stated in one way."""
        if isinstance(self.motion, (HybridMotion, Pressing)):
            self.refuse("motion", "must be a motion alone, and this one has forces already; give it once")
        if sum((self.presses, self.lam is not None, self.F_app is not None)) > 1:
            self.refuse("press", "is in place of lam and F_app; give one of the three")
        if self.lam is not None and len(self.lam) > MAX_MULTIPLIERS:
            self.refuse("lam", f"must have at most {MAX_MULTIPLIERS} rows; got {len(self.lam)}", ShapeError)
        if not callable(self.press):
            finite_scalar("press", self.press, unit="N", minimum=0.0)

    @property
    def presses(self) -> bool:
        """Whether it presses at any time."""
        return callable(self.press) or self.press != 0.0

    @property
    def duration(self) -> float | None:
        """[s] of the motion, where it has one."""
        return getattr(self.motion, "duration", None)

    def rows(self, times: Float64Array) -> HybridMotion:
        motion, k = rows_of(self.motion, times), len(times)
        asked = [self.press(float(t)) if callable(self.press) else self.press for t in times]
        press = np.array([[finite_scalar("press", value, unit="N", minimum=0.0)] for value in asked])
        lam, count = np.zeros((k, MAX_MULTIPLIERS)), np.zeros((k, 1))
        if self.lam is not None:
            lam[:, : len(self.lam)], count[:] = self.lam, len(self.lam)
        F_app = np.zeros((k, 6)) + (0.0 if self.F_app is None else self.F_app)
        return hybrid_kind(type(motion))(motion, press, lam, F_app, count)


def pressing(
    motion: Sample | Hold | Trajectory,
    press: float | Callable[[float], float] = 0.0,
    *,
    lam: ArrayLike | None = None,
    F_app: ArrayLike | None = None,
) -> HybridMotion | Pressing:
    """A motion along a constraint, and forces against it: what `taut.laws.HybridMotionForce` follows.

    Args:
        motion: Of tool or joints: a sample, or a trajectory such as `taut.trajectories.Line`.
        press: Force >= 0 into the surface of the first row [N], which is one-sided; a number or a function of time
            [s].
        lam: (k,) multipliers of eq. 10.40, F_app = A^T lam, in place of press, one for each row of the constraint;
            pressing on a contact they are < 0.
        F_app: (6,) wrench of the arm on the environment [N, N m], at the tool in world axes, in place of press. It
            must lie in the range of A^T.

    Returns:
        A sample where motion and press are one, else a trajectory.

    Raises:
        UsageError: No motion; more than one of press, lam, F_app.
        ShapeError, RangeError: Another size; a negative press, numbers that are not finite.

    Example:
        >>> import taut
        >>> pose = taut.Pose([0.4, 0.0, 0.1])
        >>> pressing(taut.TaskMotion(pose=pose), 10.0).press.item()
        10.0
    """
    taken = motion.sample if isinstance(motion, Hold) else motion
    made = Pressing(motion=taken, press=press, lam=lam, F_app=F_app)
    return made.at(0.0) if isinstance(taken, Sample) and not callable(press) else made
