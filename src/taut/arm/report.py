"""What `taut check MODEL` and `taut arms` say: what was read, and everything that is wrong with it."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from taut.arm.builtin import BUILT_IN
from taut.arm.catalogue import CATALOGUE, is_installed
from taut.arm.description import BASE, Arm, CommandKind, Joint
from taut.arm.friction import FRICTION_FIELDS
from taut.arm.load import arm_of, open_model
from taut.arm.loaders.tree import Tree
from taut.arm.parts import COMMANDS
from taut.arm.reach import reach
from taut.arm.rules import model_doubts
from taut.base.errors import ModelError, Problem, TautError, UsageError, count_of, quoted_list
from taut.base.types import Float64Array

__all__ = ["ArmRow", "CheckReport", "arm_rows", "check_model", "joint_table"]

MORE_OF_JOINTS: Final = (*FRICTION_FIELDS[2:], "gear")  # shown in the table where a joint has it
WORDS: Final = {"stribeck_shape": "shape"}

Json: TypeAlias = "str | float | bool | list[Json] | dict[str, Json] | None"


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """What is known about one model; `arm` is there if nothing is wrong."""

    name: str
    problems: tuple[Problem, ...] = ()
    opened: Tree | None = None
    arm: Arm | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """Whether the model can be used."""
        return not self.problems

    def json(self) -> dict[str, Json]:
        """The report as plain values; None stands for "no limit" and for what is not known."""
        return {
            "ok": self.ok,
            "name": self.name,
            "problems": [
                {"object": p.object, "attribute": p.attribute, "line": p.line, "message": p.message}
                for p in self.problems
            ],
            "source": self._source(),
            "joints": [_joint_json(joint) for joint in self._joints()],
            "locked": {} if self.opened is None else dict(self.opened.locked),
            "bodies": [] if self.arm is None else _bodies_json(self.arm),
            "frames": [] if self.arm is None else _frames_json(self.arm),
            "tool": None if self.arm is None else self.arm.tool,
            "home": None if self.arm is None else _floats(self.arm.home),
            "gravity": None if self.arm is None else _floats(self.arm.gravity),
            "commands": [] if self.arm is None else list(self.arm.commands),
            "total_mass": None if self.arm is None else self.arm.total_mass,
            "reach": None if self.arm is None else _finite(reach(self.arm)),
            "notes": list(self.notes),
        }

    def text(self) -> str:
        """The report for people."""
        return "\n".join(_text(self))

    def _source(self) -> str | None:
        return None if self.opened is None else self.opened.source

    def _joints(self) -> Sequence[Joint]:
        if self.arm is not None:
            return self.arm.joints
        return () if self.opened is None else tuple(self.opened.movable.values())


def check_model(model: str | os.PathLike[str]) -> CheckReport:
    """Read a model and report; nothing that is wrong with it raises.

    Example:
        >>> report = check_model("planar2")
        >>> report.ok, report.json()["total_mass"]
        (True, 6.0)
    """
    name = str(model)
    try:
        opened = open_model(model)
    except TautError as wrong:
        return CheckReport(name=name, problems=_problems_of(wrong, name))
    notes: tuple[str, ...] = ()
    try:
        try:
            arm = arm_of(opened)
        except UsageError as ask:  # several ends, and no tool named: any of them will do to look at the arm
            notes = (f"{ask}; here it is '{ask.value}'",)
            arm = arm_of(opened, tool=str(ask.value))
    except TautError as wrong:
        return CheckReport(
            name=opened.name, problems=_problems_of(wrong, opened.name), opened=opened, notes=tuple(opened.notes)
        )
    doubts = () if name in BUILT_IN else model_doubts(arm)  # the chapter's own links are as light as it draws them
    said = (*notes, *arm.notes, *_without_rotors(arm), *doubts)
    return CheckReport(name=arm.name, opened=opened, arm=arm, notes=said)


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


# -------------------------------------------------------------------- as values


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _floats(array: Float64Array) -> list[Json]:
    return [float(value) for value in array]


def _joint_json(joint: Joint) -> dict[str, Json]:
    return {
        "name": joint.name,
        "type": joint.kind,
        "unit": joint.unit,
        "axis": _floats(joint.axis),
        "lower": _finite(joint.lower),
        "upper": _finite(joint.upper),
        "velocity": _finite(joint.velocity),
        "effort": _finite(joint.effort),
        "damping": _finite(joint.viscous),
        "friction": _finite(joint.coulomb),
        **{name: None if (value := getattr(joint, name)) is None else _finite(value) for name in MORE_OF_JOINTS},
        "rotor_inertia": _finite(joint.rotor_inertia),
    }


def _bodies_json(arm: Arm) -> list[Json]:
    return [
        {
            "joint": joint.name,
            "mass": body.mass,
            "com": _floats(body.com),
            "inertia": [_floats(row) for row in body.inertia],
            "links": list(body.links),
        }
        for joint, body in zip(arm.joints, arm.bodies, strict=True)
    ]


def _frames_json(arm: Arm) -> list[Json]:
    return [
        {"name": frame.name, "joint": None if frame.body == BASE else arm.joint_names[frame.body]}
        for frame in arm.frames
    ]


# -------------------------------------------------------------------- as text


def _text(report: CheckReport) -> Iterator[str]:
    joints = report._joints()
    source = report._source()
    if joints:
        tool = "" if report.arm is None else f", tool '{report.arm.tool}'"
        yield f"{report.name}: {count_of(len(joints), 'joint')}{tool}"
    else:
        yield report.name
    if source is not None:
        yield f"read from {source}"
    if joints:
        yield ""
        yield from joint_table(joints)
    if report.arm is not None:
        yield from _arm_text(report.arm, report.opened)
    if report.notes:
        yield ""
        yield from (f"note: {note}" for note in report.notes)
    yield ""
    if report.ok:
        yield "no problems"
        return
    yield count_of(len(report.problems), "problem")
    yield from (f"  {problem}" for problem in report.problems)


def _arm_text(arm: Arm, opened: Tree | None) -> Iterator[str]:
    yield ""
    cells: list[tuple[str, ...]] = [("moved by", "mass [kg]", "centre of mass [m]", "links")]
    for joint, body in zip(arm.joints, arm.bodies, strict=True):
        com = " ".join(f"{c:.4g}" for c in body.com)
        cells.append((joint.name, f"{body.mass:.4g}", com, ", ".join(body.links)))
    yield from _table(cells)
    yield ""
    if opened is not None and opened.locked:
        held = (f"'{name}' at {position:g}" for name, position in opened.locked.items())
        yield f"held still: {', '.join(held)}"
    yield f"{len(arm.frames)} frames: {', '.join(arm.frame_names)}"
    yield f"home: {' '.join(f'{q:.4g}' for q in arm.home)}"
    yield f"gravity: {' '.join(f'{g:g}' for g in arm.gravity)} m/s^2"
    far = reach(arm)
    distance = f"{far:.4g} m" if math.isfinite(far) else "without bound"
    yield f"moving mass {arm.total_mass:.4g} kg; reach {distance} (tool from the first joint)"
    yield f"the real arm takes: {', '.join(arm.commands)}"


def joint_table(joints: Sequence[Joint]) -> Iterator[str]:
    """Lines with the limits, friction, gears and rotors of joints; static friction and the like where one has any."""
    yield from _table(_joint_cells(joints))


def _joint_cells(joints: Sequence[Joint]) -> list[tuple[str, ...]]:
    usual = Joint(name="", kind="revolute")
    more = [name for name in MORE_OF_JOINTS if any(getattr(joint, name) != getattr(usual, name) for joint in joints)]
    heads = [WORDS.get(name, name.replace("_", " ")) for name in more]
    cells: list[tuple[str, ...]] = [
        ("joint", "type", "axis", "lower", "upper", "speed", "effort", "damping", "friction", *heads, "rotor", "unit")
    ]
    for joint in joints:
        numbers = (
            joint.lower,
            joint.upper,
            joint.velocity,
            joint.effort,
            joint.viscous,
            joint.coulomb,
            *(getattr(joint, name) for name in more),
            joint.rotor_inertia,
        )
        axis = " ".join(f"{a:.4g}" for a in joint.axis)
        unit = "m, N" if joint.kind == "prismatic" else "rad, N m"
        cells.append((joint.name, joint.kind, axis, *(_cell(x) for x in numbers), unit))
    return cells


def _cell(value: float | None) -> str:
    if value is None:
        return "same"  # at rest as in motion
    if math.isnan(value):
        return "missing"
    return "none" if math.isinf(value) else f"{value:.4g}"


def _table(cells: list[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
    for row in cells:
        yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


# -------------------------------------------------------------------- the catalogue


@dataclass(frozen=True, kw_only=True)
class ArmRow:
    """One line of `taut arms`."""

    name: str
    joints: int
    commands: tuple[CommandKind, ...]  # what the real arm takes
    source: str  # "built in", or the package on PyPI
    installed: bool


def arm_rows() -> list[ArmRow]:
    """The arms that `load_arm` knows by name."""
    own = [
        ArmRow(
            name=name,
            joints=len(made().movable),
            commands=COMMANDS,
            source="built in",
            installed=True,
        )
        for name, made in BUILT_IN.items()
    ]
    return own + [
        ArmRow(
            name=entry.name,
            joints=len(entry.home),
            commands=entry.commands,
            source=entry.package,
            installed=is_installed(entry),
        )
        for entry in CATALOGUE.values()
    ]
