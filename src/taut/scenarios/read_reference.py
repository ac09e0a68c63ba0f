"""The reference of a scenario: [reference], what the arm is to do."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.arm.angles import require_radians
from taut.arm.description import Arm
from taut.base.checks import finite_array
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.trajectories.force_reference import pressing
from taut.control.trajectories.joint import Cubic, JerkLimited, Quintic, Samples, Sine, Spline, Trapezoidal
from taut.control.trajectories.reference import Hold, JointMotion, Reference
from taut.maths.snapshot import snapshot
from taut.scenarios.read_force_reference import FORCE_KINDS, read_force_reference
from taut.scenarios.read_pose import HomeFrame
from taut.scenarios.read_task_reference import TASK_KINDS, read_task_reference
from taut.scenarios.toml import Section, file_beside

__all__ = ["JOINT_KINDS", "read_forces", "read_reference"]

JOINT_KINDS: Final = {
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


def read_reference(
    section: Section, arm: Arm, home: Float64Array, folder: Path, laws: Mapping[str, Law]
) -> Reference:
    """A hold, a set-point or a trajectory, of joints, of the task or of a force.

    Args:
        section: [reference]; a hold of the first state if it is empty.
        arm: The arm that follows it.
        home: (n,) what "home" and relative_to_home mean [rad | m].
        folder: Where a file of samples lies.
        laws: The laws by their labels: the frame that they control is the one whose pose at home is "home".
    """
    if not section.left:
        return Hold()
    kind = section.word("kind", ("hold", *JOINT_KINDS, *TASK_KINDS, *FORCE_KINDS))
    if kind == "hold":
        section.done()
        return Hold()
    if kind in FORCE_KINDS:
        return read_force_reference(section, kind)
    relative = section.flag("relative_to_home", False)
    if kind in TASK_KINDS:
        T = snapshot(arm, home).T(_controlled_frame(section, laws))
        forces = read_forces(section)
        motion = read_task_reference(section, kind, HomeFrame(T, relative=relative), folder)
        with section.blamed("press"):
            return pressing(motion, **forces) if forces else motion  # type: ignore[arg-type]  # it refuses streams
    origin = np.zeros(arm.n) if relative else home
    file = section.text("file", None) if kind == "samples" else None
    if file is None:
        made = _made(section, JOINT_KINDS[kind], arm, origin)
    else:
        section.done()
        with section.blamed("file"):
            made = Samples.from_csv(file_beside("CSV file", file, folder))
    given = [name for name in POSITIONS if hasattr(made, name)]
    for name in given:
        _check_size(section, name, getattr(made, name), arm)
    if relative:
        made = _moved(made, {name: home + getattr(made, name) for name in given})
    with section.blamed("kind"):
        for name in given:
            require_radians(name, getattr(made, name), arm)
    return made  # type: ignore[no-any-return]  # a sample or a trajectory


def read_forces(section: Section) -> dict[str, Any]:
    """What a motion is to press with: press, lam or F_app, as of taut.pressing; empty if nothing is said."""
    forces = {"press": section.number("press", None)}
    forces |= {name: section.numbers(name, None) for name in ("lam", "F_app")}
    return {name: value for name, value in forces.items() if value is not None}


def _controlled_frame(section: Section, laws: Mapping[str, Law]) -> str | None:
    """The frame that all laws control."""
    frames = {law.controlled_frame for law in laws.values()}
    if len(frames) > 1:
        named = [frame or "the arm's tool" for frame in frames]
        raise section.error(
            f"is for laws that control one frame, and these control {' and '.join(sorted(named))}; give them the "
            "same tool, or put them in scenarios of their own"
        )
    return next(iter(frames), None)


def _made(section: Section, cls: Any, arm: Arm, home: Float64Array) -> Any:
    """A sample or a trajectory from the keys of a section."""
    required = [field.name for field in dataclasses.fields(cls) if field.default is dataclasses.MISSING]
    optional = [field.name for field in dataclasses.fields(cls) if field.name not in required]
    if cls is JointMotion:  # it makes its own __init__
        required, optional = ["q"], ["v", "a"]
    values = section.fields([*required, *optional], required)
    for name in POSITIONS:
        value = values.get(name)
        if isinstance(value, str):
            if value != "home":
                raise section.error(f'{name} must be numbers, one per joint, or "home"; got {value!r}')
            values[name] = home
        elif isinstance(value, list):
            with section.blamed():
                _check_size(section, name, finite_array(name, value, unit="rad | m"), arm)
    with section.blamed("kind"):
        return cls(**values)


def _check_size(section: Section, name: str, value: Float64Array, arm: Arm) -> None:
    count = np.shape(value)[-1]
    if count != arm.n:
        raise section.error(f"{name} must have one entry for each of the {arm.n} joints; got {count}")


def _moved(made: Any, positions: Mapping[str, Any]) -> Any:
    """The same motion elsewhere."""
    if isinstance(made, JointMotion):
        return JointMotion(**positions, v=made.v, a=made.a)
    return dataclasses.replace(made, **positions)
