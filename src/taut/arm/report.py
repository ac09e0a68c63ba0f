"""What `taut check MODEL` and `taut arms` say: what was read, and everything that is wrong with it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

from taut.arm.builtin import BUILT_IN
from taut.arm.catalogue import CATALOGUE, installed_package
from taut.arm.change import JOINT_FIELDS, LIMITS
from taut.arm.description import Arm, Joint
from taut.arm.friction import FRICTION_FIELDS
from taut.arm.load import load_arm, open_model
from taut.arm.loaders.tree import Tree
from taut.arm.parts import COMMANDS
from taut.arm.reach import reach
from taut.arm.rules import model_doubts
from taut.base.errors import ModelError, Problem, TautError, UsageError, count_of, quoted_list
from taut.base.result import Table
from taut.base.types import Float64Array

USUAL: Final = (*LIMITS, *FRICTION_FIELDS[:2], "rotor_inertia")  # the others are shown where a joint has them

Json: TypeAlias = "str | float | bool | list[Json] | dict[str, Json] | None"


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """What is known about one model; `arm` is there if nothing is wrong."""

    name: str
    problems: tuple[Problem, ...] = ()
    tree: Tree | None = None
    arm: Arm | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """Whether the model can be used."""
        return not self.problems

    def json(self) -> dict[str, Json]:
        """The report as plain values; None stands for "no limit" and for what is not known."""
        arm, tree = self.arm, self.tree
        return {
            "ok": self.ok,
            "name": self.name,
            "problems": [
                {"object": p.object, "attribute": p.attribute, "line": p.line, "message": p.message}
                for p in self.problems
            ],
            "source": None if tree is None else tree.source,
            "joints": [_joint_json(joint) for joint in self._joints()],
            "locked": {} if tree is None else dict(tree.locked),
            "bodies": [] if arm is None else _bodies_json(arm),
            "frames": [] if arm is None else _frames_json(arm),
            "tool": None if arm is None else arm.tool,
            "home": None if arm is None else arm.home.tolist(),
            "gravity": None if arm is None else arm.gravity.tolist(),
            "commands": [] if arm is None else list(arm.commands),
            "total_mass": None if arm is None else arm.total_mass,
            "reach": None if arm is None else _finite(reach(arm)),
            "notes": list(self.notes),
        }

    def text(self) -> str:
        """The report for people."""
        joints = self._joints()
        tool = "" if self.arm is None else f", tool '{self.arm.tool}'"
        lines = [f"{self.name}: {count_of(len(joints), 'joint')}{tool}" if joints else self.name]
        if self.tree is not None:
            lines.append(f"read from {self.tree.source}")
        if joints:
            lines += ["", str(joint_table(joints))]
        if self.arm is not None and self.tree is not None:
            lines += _arm_text(self.arm, self.tree)
        if self.notes:
            lines += ["", *(f"note: {note}" for note in self.notes)]
        lines += ["", "no problems" if self.ok else count_of(len(self.problems), "problem")]
        return "\n".join([*lines, *(f"  {problem}" for problem in self.problems)])

    def _joints(self) -> Sequence[Joint]:
        if self.arm is not None:
            return self.arm.joints
        return () if self.tree is None else tuple(self.tree.movable.values())


def check_model(model: str | os.PathLike[str]) -> CheckReport:
    """Read a model and report; problems of the model do not raise."""
    name = str(model)
    try:
        opened = open_model(model)
    except TautError as wrong:
        return CheckReport(name=name, problems=_problems_of(wrong, name))
    notes: tuple[str, ...] = ()
    try:
        try:
            arm = load_arm(opened)
        except UsageError as ask:  # several ends, and no tool named: any of them will do to look at the arm
            notes = (f"{ask}; here it is '{ask.value}'",)
            arm = load_arm(opened, tool=str(ask.value))
    except TautError as wrong:
        return CheckReport(
            name=opened.name, problems=_problems_of(wrong, opened.name), tree=opened, notes=tuple(opened.notes)
        )
    doubts = () if name in BUILT_IN else model_doubts(arm)  # the chapter's own links are as light as it draws them
    said = (*notes, *arm.notes, *_without_rotors(arm), *doubts)
    return CheckReport(name=arm.name, tree=opened, arm=arm, notes=said)


def _without_rotors(arm: Arm) -> tuple[str, ...]:
    """Joints with a gear whose rotor inertia is zero, which no real rotor's is."""
    light = [joint for joint in arm.joints if joint.gear != 1.0 and joint.rotor_inertia == 0.0]
    if not light:
        return ()
    gear = max(joint.gear for joint in light)
    return (
        f"{quoted_list(joint.name for joint in light)}: gears and no rotor inertia; one of 1e-5 kg m^2 would be "
        f"{1e-5 * gear**2:.3g} kg m^2 behind a gear of {gear:g}; with_joints(rotor_inertia=...) states it as seen at "
        "the joint",
    )


def _problems_of(wrong: TautError, name: str) -> tuple[Problem, ...]:
    if isinstance(wrong, ModelError):
        return wrong.problems
    return (Problem(object=name, attribute=None, message=str(wrong)),)


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _joint_json(joint: Joint) -> dict[str, Json]:
    return {
        "name": joint.name,
        "type": joint.kind,
        "unit": joint.unit,
        "axis": joint.axis.tolist(),
        **{name: _finite(getattr(joint, name)) for name in JOINT_FIELDS},
    }


def _bodies_json(arm: Arm) -> list[Json]:
    return [
        {
            "joint": joint.name,
            "mass": body.mass,
            "com": body.com.tolist(),
            "inertia": body.inertia.tolist(),
            "links": list(body.links),
        }
        for joint, body in zip(arm.joints, arm.bodies, strict=True)
    ]


def _frames_json(arm: Arm) -> list[Json]:
    joints = (*arm.joint_names, None)  # of the base, which is the last by its index
    return [{"name": frame.name, "joint": joints[frame.body]} for frame in arm.frames]


def _arm_text(arm: Arm, tree: Tree) -> list[str]:
    rows = [
        (joint.name, f"{body.mass:.4g}", _row(body.com), ", ".join(body.links))
        for joint, body in zip(arm.joints, arm.bodies, strict=True)
    ]
    locked = ", ".join(f"'{name}' at {position:g}" for name, position in tree.locked.items())
    far = reach(arm)
    distance = f"{far:.4g} m" if math.isfinite(far) else "without bound"
    return [
        "",
        str(Table(columns=("moved by", "mass [kg]", "centre of mass [m]", "links"), rows=rows)),
        "",
        *([f"held still: {locked}"] if locked else []),
        f"{len(arm.frames)} frames: {', '.join(arm.frame_names)}",
        f"home: {_row(arm.home)}",
        f"gravity: {_row(arm.gravity)} m/s^2",
        f"moving mass {arm.total_mass:.4g} kg; reach {distance} (tool from the first joint)",
        f"the real arm takes: {', '.join(arm.commands)}",
    ]


def _row(numbers: Float64Array) -> str:
    return " ".join(f"{x:.4g}" for x in numbers)


def joint_table(joints: Sequence[Joint]) -> Table:
    """Limits, friction, gears and rotors of joints; static friction and the like where one has any."""
    none = Joint(name="", kind="revolute")
    shown = [
        name
        for name in JOINT_FIELDS
        if name in USUAL or any(getattr(joint, name) != getattr(none, name) for joint in joints)
    ]
    return Table(
        columns=("joint", "type", "axis", *(name.replace("_", " ") for name in shown), "unit"),
        rows=[
            (
                joint.name,
                joint.kind,
                _row(joint.axis),
                *(_cell(getattr(joint, name)) for name in shown),
                f"{joint.unit}, {joint.effort_unit}",
            )
            for joint in joints
        ],
    )


def _cell(value: float | None) -> str:
    if value is None:
        return "same"  # at rest as in motion
    if math.isnan(value):
        return "missing"
    return "none" if math.isinf(value) else f"{value:.4g}"


def arm_rows() -> list[dict[str, Any]]:
    """The arms that `load_arm` knows by name, with what the real arm takes and the package on PyPI that has it."""
    own: list[dict[str, Any]] = [
        {
            "name": name,
            "joints": len(made().movable),
            "commands": list(COMMANDS),
            "source": "built in",
            "installed": True,
        }
        for name, made in BUILT_IN.items()
    ]
    return own + [
        {
            "name": entry.name,
            "joints": len(entry.home),
            "commands": list(entry.commands),
            "source": entry.package,
            "installed": installed_package(entry) is not None,
        }
        for entry in CATALOGUE.values()
    ]
