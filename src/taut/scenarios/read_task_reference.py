"""References of the task in a scenario: kind = "pose", "line", "screw", "circle", "task-samples" or "policy"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

from taut.control.trajectories.reference import Stream
from taut.control.trajectories.task import Circle, Line, Screw
from taut.control.trajectories.task_reference import TaskMotion, TaskSamples
from taut.scenarios.read_pose import HomeFrame, read_pose, read_poses
from taut.scenarios.sample_policy import SamplePolicy
from taut.scenarios.toml import Section, file_beside

__all__ = ["TASK_KINDS", "TaskReference", "read_task_reference"]

TaskReference: TypeAlias = TaskMotion | Line | Screw | Circle | TaskSamples | Stream

TIMING: Final = ("duration", "velocity", "acceleration", "scaling")
ARC: Final = ("via", "end")  # a circle through points
ROUND: Final = ("centre", "axis", "angle")  # one about an axis
POINTS: Final = ("centre", "via", "end")  # which relative_to_home is for


def read_task_reference(section: Section, kind: str, home: HomeFrame, folder: Path) -> TaskReference:
    """A pose to hold, a motion of the tool, or samples of one.

    Args:
        section: [reference], of which kind and relative_to_home are read already.
        kind: One of TASK_KINDS.
        home: Where the tool is at home.
        folder: Where a file of samples lies.
    """
    return TASK_KINDS[kind](section, home, folder)


def _pose(section: Section, home: HomeFrame, folder: Path) -> TaskReference:  # noqa: ARG001
    pose = read_pose(section, "pose", home)
    section.done()
    return TaskMotion(pose=pose)


def _line(section: Section, home: HomeFrame, folder: Path) -> TaskReference:  # noqa: ARG001
    return _between(section, home, Line)


def _screw(section: Section, home: HomeFrame, folder: Path) -> TaskReference:  # noqa: ARG001
    return _between(section, home, Screw)


def _between(section: Section, home: HomeFrame, cls: type[Line | Screw]) -> TaskReference:
    T0, T1 = read_pose(section, "T0", home, required=False), read_pose(section, "T1", home)
    values = section.fields(TIMING)
    with section.blamed("kind"):
        return cls(T0=T0, T1=T1, **values)


def _circle(section: Section, home: HomeFrame, folder: Path) -> TaskReference:  # noqa: ARG001
    T0 = read_pose(section, "T0", home, required=False)
    make: Callable[..., Circle] = Circle
    if any(key in section for key in ARC):
        if any(key in section for key in ROUND):
            raise section.error("takes via and end, or centre, axis and angle, and not some of both")
        make, values = Circle.through, section.fields((*ARC, "orientation", *TIMING), ARC)
    else:
        values = section.fields((*ROUND, "orientation", *TIMING), ROUND[:2])
    with section.blamed("kind"):
        return make(T0=T0, **{key: _point(section, key, value, home) for key, value in values.items()})


def _point(section: Section, key: str, value: Any, home: HomeFrame) -> Any:
    """A point from home where the file says so."""
    if key not in POINTS or not home.relative:
        return value
    if not isinstance(value, list) or len(value) != 3 or not all(type(x) in (int, float) for x in value):
        raise section.error(f"{key} must be three numbers [m]; got {value!r}")
    return home.T.p + value


def _samples(section: Section, home: HomeFrame, folder: Path) -> TaskReference:
    values: dict[str, Any] = {"interpolation": section.word("interpolation", ("spline", "linear"), "spline")}
    file = section.text("file", None)
    if file is not None:
        section.done()
        with section.blamed("file"):
            read = TaskSamples.from_csv(file_beside("CSV file", file, folder), **values)
            if not home.relative:
                return read
            return TaskSamples(times=read.times, poses=[home.placed(pose) for pose in read.poses], **values)
    times, poses = section.numbers("times"), read_poses(section, "poses", home)
    section.done()
    with section.blamed("kind"):
        return TaskSamples(times=times, poses=poses, **values)


def _policy(section: Section, home: HomeFrame, folder: Path) -> TaskReference:  # noqa: ARG001
    numbers: dict[str, Any] = {key: section.whole(key) for key in ("ahead", "seed") if key in section}
    pairs: dict[str, Any] = {key: section.numbers(key) for key in ("size", "disagreement") if key in section}
    period, blend = section.number("period", 0.1), section.number("blend", None)
    section.done()
    with section.blamed():
        return Stream(period=period, source=SamplePolicy(T=home.T, period=period, **numbers, **pairs), blend=blend)


TASK_KINDS: Final[Mapping[str, Callable[[Section, HomeFrame, Path], TaskReference]]] = {
    "pose": _pose,
    "line": _line,
    "screw": _screw,
    "circle": _circle,
    "task-samples": _samples,
    "policy": _policy,
}
