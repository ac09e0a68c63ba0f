"""The reference of a scenario: [reference], what the arm is to do."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.arm.angles import require_radians
from taut.arm.description import Arm
from taut.base.checks import finite_array
from taut.base.errors import quoted_list
from taut.base.types import ArrayLike, Float64Array
from taut.control.law import Law
from taut.control.trajectories.force_reference import TaskForce, pressing
from taut.control.trajectories.joint import Cubic, JerkLimited, Quintic, Sine, Spline, Trapezoidal
from taut.control.trajectories.reference import Hold, JointMotion, Reference, Stream
from taut.control.trajectories.samples import Chunk, Samples, TaskSamples, chunk
from taut.control.trajectories.task import Circle, Line, Screw
from taut.control.trajectories.task_reference import Axes, TaskMotion
from taut.maths.snapshot import snapshot
from taut.scenarios.arms import below_pose
from taut.scenarios.reading import arguments, read
from taut.scenarios.sample_policy import SamplePolicy
from taut.scenarios.toml import Table, file_beside
from taut.trace.pose import Pose

__all__ = ["FORCE_KINDS", "JOINT_KINDS", "TASK_KINDS", "forces_of", "read_reference"]

JOINT_KINDS: Final[Mapping[str, Callable[..., Any]]] = {
    "set-point": JointMotion,
    "cubic": Cubic,
    "jerk-limited": JerkLimited,
    "quintic": Quintic,
    "samples": Samples,
    "sine": Sine,
    "spline": Spline,
    "trapezoidal": Trapezoidal,
}
POSITIONS: Final = ("q", "q0", "q1", "center", "points")  # which "home" and relative_to_home are for
POINTS: Final = ("centre", "via", "end")  # of the tool, which relative_to_home is for
ROTATIONS: Final = ("xyzw", "wxyz", "rpy", "R")
FORCES: Final = ("press", "lam", "F_app")  # what a motion is to press with, as of taut.pressing
POSE: Final = "{ p = [0.4, 0.0, 0.3], rpy = [3.14, 0.0, 0.0] }"


def read_reference(table: Table, arm: Arm, home: Float64Array, folder: Path, laws: Mapping[str, Law]) -> Reference:
    """A hold, a set-point or a trajectory, of joints, of the task or of a force.

    Args:
        table: [reference]; a hold of the first state if it is empty.
        arm: The arm that follows it.
        home: (n,) what "home" and relative_to_home mean [rad | m].
        folder: Where a file of samples lies.
        laws: The laws by their labels: the frame that they control is the one whose pose at home is "home".
    """
    if not table.values:
        return Hold()
    table.need("kind")
    kind = table.choice("kind", ("hold", *JOINT_KINDS, *TASK_KINDS, *FORCE_KINDS))
    if kind == "hold":
        table.only(("kind",))
        made: Reference = Hold()
    elif kind in FORCE_KINDS:
        made = read(FORCE_KINDS[kind], table, others=["kind"], blame="kind")
    elif kind in TASK_KINDS:
        T = snapshot(arm, home).T(_controlled_frame(table, laws))
        forces = forces_of(table)
        motion = TASK_KINDS[kind](_Task(table.without(*FORCES), T, folder))
        with table.blamed("press"):
            made = pressing(motion, **forces) if forces else motion
    else:
        made = _of_joints(table, kind, arm, home, folder)
    return made


def forces_of(table: Table) -> dict[str, Any]:
    """What a motion is to press with: press, lam or F_app; empty if nothing is said."""
    table.number("press")
    return {name: table.get(name) for name in FORCES if name in table}


def _controlled_frame(table: Table, laws: Mapping[str, Law]) -> str | None:
    """The frame that all laws control."""
    frames = {law.controlled_frame for law in laws.values()}
    if len(frames) > 1:
        named = [frame or "the arm's tool" for frame in frames]
        raise table.error(
            f"is for laws that control one frame, and these control {' and '.join(sorted(named))}; give them the "
            "same tool, or put them in scenarios of their own"
        )
    return next(iter(frames), None)


def _relative(table: Table) -> bool:
    """Whether positions are given from home."""
    relative = table.get("relative_to_home", False)
    if not isinstance(relative, bool):
        raise table.error(f"must be true or false; got {relative!r}", "relative_to_home")
    return relative


# -------------------------------------------------------------------- of joints


def _of_joints(table: Table, kind: str, arm: Arm, home: Float64Array, folder: Path) -> Reference:
    cls, relative = JOINT_KINDS[kind], _relative(table)
    if kind == "samples" and "file" in table:
        table.only(("kind", "file", "relative_to_home"))
        with table.blamed("file"):
            made: Any = Samples.from_csv(file_beside("CSV file", table.text("file"), folder))
    else:
        origin = np.zeros(arm.n) if relative else home
        given = {name: _position(table, name, origin, arm) for name in POSITIONS if name in table}
        given = {name: each for name, each in given.items() if name in arguments(cls)}
        others = ["kind", "relative_to_home", *given, *(["file"] if kind == "samples" else [])]
        made = read(cls, table, others=others, blame="kind", **given)
    names = [name for name in POSITIONS if hasattr(made, name)]
    for name in names:
        _check_size(table, name, getattr(made, name), arm)
    if relative:
        moved = {name: home + getattr(made, name) for name in names}
        motion = isinstance(made, JointMotion)
        made = JointMotion(**moved, v=made.v, a=made.a) if motion else dataclasses.replace(made, **moved)
    with table.blamed("kind"):
        for name in names:
            require_radians(name, getattr(made, name), arm)
    return made  # type: ignore[no-any-return]  # a sample or a trajectory


def _position(table: Table, name: str, home: Float64Array, arm: Arm) -> Any:
    """Positions as they are written, or "home"."""
    written = table.get(name)
    if isinstance(written, str):
        if written != "home":
            raise table.error(f'must be numbers, one per joint, or "home"; got {written!r}', name)
        return home
    if isinstance(written, list):
        with table.blamed():
            _check_size(table, name, finite_array(name, written, unit="rad | m"), arm)
    return written


def _check_size(table: Table, name: str, positions: Float64Array, arm: Arm) -> None:
    count = np.shape(positions)[-1] if np.ndim(positions) else 1
    if count != arm.n:
        raise table.error(f"must have one entry for each of the {arm.n} joints; got {count}", name)


# -------------------------------------------------------------------- of the tool


class _Task:
    """A [reference] of the tool, and where the tool is at home.

    Poses may be given from there: p is then added to its position, and the rotation is by the world's axes, about the
    tool.
    """

    def __init__(self, table: Table, home: Pose, folder: Path) -> None:
        self.table, self.home, self.folder, self.relative = table, home, folder, _relative(table)

    def made(self, kind: Callable[..., Any], **given: Any) -> Any:
        """The motion that the table describes; `given` is what was made of some of its keys."""
        return read(kind, self.table, others=["kind", "relative_to_home", *given], blame="kind", **given)

    def pose(self, key: str, *, required: bool = True) -> Pose:
        """The pose at a key; "home" is where the tool is at home, which is meant too where none is required."""
        written = self.table.get(key)
        if written == "home" or (written is None and not required):
            return self.home
        if written is not None and not isinstance(written, dict):
            raise self.table.error(f'must be a pose such as {POSE}, or "home"; got {written!r}', key)
        return self.placed(self.table.table(key, required=True))

    def placed(self, table: Table) -> Pose:
        """The pose of a table, in the world."""
        if not self.relative:  # where a zero is a place, and the identity an orientation, that few arms can take
            table.need("p", "its position p")
            if not any(word in table for word in ROTATIONS):
                raise table.error(f"needs its orientation: one of {quoted_list(ROTATIONS)}")
        return self.moved(below_pose(table))

    def moved(self, pose: Pose) -> Pose:
        """A pose as it is written, in the world."""
        return Pose(self.home.p + pose.p, R=pose.R @ self.home.R) if self.relative else pose

    def points(self) -> dict[str, Any]:
        """The points that are there, in the world."""
        return {key: self._point(key, self.table.get(key)) for key in POINTS if key in self.table}

    def _point(self, key: str, point: Any) -> Any:
        if not self.relative:
            return point
        if not isinstance(point, list) or len(point) != 3 or not all(type(x) in (int, float) for x in point):
            raise self.table.error(f"must be three numbers [m]; got {point!r}", key)
        return self.home.p + point


def _pose(task: _Task) -> TaskMotion:
    task.table.only(("kind", "relative_to_home", "pose"))
    return TaskMotion(pose=task.pose("pose"))


def _line(task: _Task) -> Any:
    return task.made(Line, T0=task.pose("T0", required=False), T1=task.pose("T1"))


def _screw(task: _Task) -> Any:
    return task.made(Screw, T0=task.pose("T0", required=False), T1=task.pose("T1"))


def _circle(task: _Task) -> Any:
    return task.made(Circle, T0=task.pose("T0", required=False), **task.points())


def _task_samples(task: _Task) -> Any:
    table = task.table
    if "file" not in table:
        table.need("poses")
        return task.made(TaskSamples, poses=[task.placed(each) for each in table.tables("poses")])
    table.only(("kind", "relative_to_home", "file"))
    with table.blamed("file"):
        samples = TaskSamples.from_csv(file_beside("CSV file", table.text("file"), task.folder))
        return dataclasses.replace(samples, poses=[task.moved(pose) for pose in samples.poses])


def _policy(task: _Task) -> Stream:
    """Chunks of a stand-in for a learned policy, each period one."""
    table = task.table
    source = read(SamplePolicy, table.without("blend"), others=["kind", "relative_to_home"], T=task.home)
    with table.blamed():
        return Stream(period=source.period, source=source, blend=table.number("blend"))


TASK_KINDS: Final[Mapping[str, Callable[[_Task], Any]]] = {
    "pose": _pose,
    "line": _line,
    "screw": _screw,
    "circle": _circle,
    "task-samples": _task_samples,
    "policy": _policy,
}


# -------------------------------------------------------------------- of a force


def _force_samples(*, times: ArrayLike, F_app: ArrayLike, frame: Axes = "world") -> Chunk:
    """Wrenches at stated times with straight lines in between."""
    rows = finite_array("F_app", F_app, shape=(np.size(np.asarray(times, dtype=object)), 6))
    return chunk(times, [TaskForce(F_app=row, frame=frame) for row in rows])


FORCE_KINDS: Final[Mapping[str, Callable[..., Any]]] = {"force": TaskForce, "force-samples": _force_samples}
