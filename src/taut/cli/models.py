"""The commands `taut arms`, `taut laws` and `taut check`, which list and check models."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import re
import shutil
import textwrap
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from taut import laws
from taut.arm.description import Arm, Friction
from taut.base.errors import ModelError
from taut.base.fields import REQUIRED, Part
from taut.base.result import Table
from taut.cli.command import DONE, WRONG, Answer, Command, Say
from taut.control.combine import law_classes
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.sensing import Sensing
from taut.control.trajectories.force_reference import HybridMotion
from taut.control.trajectories.task_reference import TaskMotion
from taut.controller.explain import statements, summary
from taut.maths.adds import Adds
from taut.maths.constraints.constraint import Constraint

__all__ = ["ARMS", "CHECK", "LAWS", "law_rows"]


@dataclass(frozen=True, kw_only=True)
class LawRow:
    """One law."""

    name: str
    summary: str
    law: list[str]
    closed_loop: list[str]
    gains: dict[str, str]  # with units
    command: str
    reference: str
    needs: tuple[str, ...]

    def json(self) -> dict[str, Any]:
        """As plain values."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def text(self, width: int) -> str:
        """For people: the equation, then what is said of it as running text, in lines of at most `width` letters."""
        parts = {
            "law": _equation_first(self.law),
            "closed loop": _equation_first(self.closed_loop),
            "gains": [", ".join(f"{name} [{unit}]" if unit else name for name, unit in self.gains.items()) or "none"],
            "follows": [f"{self.reference}; gives a {self.command}; needs {', '.join(self.needs)}"],
        }
        lines = textwrap.wrap(f"{self.name}: {self.summary}", width)
        for head, paragraphs in parts.items():
            for i, paragraph in enumerate(paragraphs):
                start = f"  {'' if i else head:11}  "
                lines += textwrap.wrap(
                    paragraph, width, initial_indent=start, subsequent_indent=" " * len(start), break_on_hyphens=False
                )
        return "\n".join(lines)


def _equation_first(lines: Sequence[str]) -> list[str]:
    """The lines of a docstring as paragraphs: the equation with its source in brackets, then the rest."""
    texts = [re.sub(r"   (.+)$", r" (\1)", line) for line in lines]
    return [texts[0], *(["; ".join(texts[1:])] if texts[1:] else [])]


def law_rows() -> list[LawRow]:
    """Every law of taut.laws that stands on its own."""
    return [_row(cls) for name, cls in law_classes(laws).items() if name not in OF_OTHERS]


OF_OTHERS: Final = (
    "Sum",
    "SideBySide",
    "NormalEstimate",
    "EnergyTank",
    "LossOfContact",
)  # which are made of other laws


def _row(cls: type[Law]) -> LawRow:
    given = {"constraint": Constraint(lambda T: T.p[2])} if "constraint" in cls.declared else {}
    law = cls(**_numbers(cls), **given, **_held(cls))
    side = LawSide(law=law, arm=_six_axes(), rate=1000.0, sensing=Sensing(), limits=None, adds=Adds())
    return LawRow(
        name=cls.__name__,
        summary=summary(cls),
        law=statements(cls, "Law"),
        closed_loop=statements(cls, "Closed loop"),
        gains={name: field.unit for name, field in cls.declared.items() if isinstance(field, Gain)},
        command=side.probe.kind,
        reference="none" if law.ignores_reference else law.reference.__name__,
        needs=("q", *side.needs),
    )


def _numbers(cls: type[Law]) -> dict[str, Any]:
    """Ones for every gain that a law must have; of damping and damping ratio, the damping."""
    numbers: dict[str, Any] = {}
    for name, field in cls.declared.items():
        if isinstance(field, Gain) and (field.default is REQUIRED or name == "B"):
            scalar = field.shape == "scalar" or "scalar" in field.accepts
            numbers[name] = 1.0 if scalar else (1.0, 1.0, 1.0) if field.shape == 3 else (1.0, 1.0)
    return numbers


def _held(cls: type[Law]) -> dict[str, Law]:
    """A law for each field of one that holds others."""
    of_task = cls.reference in (TaskMotion, HybridMotion) and cls is not laws.ViaJointSpace
    inner: Law = laws.TaskComputedTorque(kp=1.0, kd=1.0) if of_task else laws.PID(kp=1.0)
    parts = {name: field for name, field in cls.declared.items() if isinstance(field, Part) and not field.optional}
    return {name: inner for name, field in parts.items() if any(issubclass(kind, Law) for kind in field.of)}


@functools.cache
def _six_axes() -> Arm:
    """An arm of six joints, with friction and nowhere near a singularity, to try a law on."""
    axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float64)
    places = np.array([[0, 0, 0], [0, 0, 0.4], [0.4, 0, 0.6], [0.5, 0, 0.5], [0.6, 0, 0.4], [0.7, 0.1, 0.4]])
    screws = np.vstack([axes.T, -np.cross(axes, places).T])
    steps = np.diff(np.vstack([np.zeros(3), places, places[-1:]]), axis=0)
    links = [np.vstack([np.column_stack([np.eye(3), step]), [0.0, 0.0, 0.0, 1.0]]) for step in steps]
    inertia = np.diag([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])
    arm = Arm.from_screws(links, [inertia] * 6, screws, np.array([0.0, 0.0, -9.81]))
    return arm.with_friction(Friction(viscous=1.0))


# -------------------------------------------------------------------- commands


def _arms(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.arm.report import arm_rows

    rows = list(arm_rows())
    table = Table(
        title="taut.load_arm(NAME)",
        columns=("arm", "joints", "takes in real life", "from", "installed"),
        rows=[(row.name, str(row.joints), ", ".join(row.commands), row.source, bool(row.installed)) for row in rows],
    )
    return Answer(text=str(table), data=[dataclasses.asdict(row) for row in rows])


def _laws(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    rows, width = law_rows(), shutil.get_terminal_size((140, 0)).columns
    return Answer(text="\n\n".join(row.text(width) for row in rows), data=[row.json() for row in rows])


def _check(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.arm.load import open_model
    from taut.arm.report import check_model

    report = check_model(arguments.model)
    if report.opened is None and not arguments.json:
        with suppress(ModelError):  # a model that is broken has its report; a name without a model ends here
            open_model(arguments.model)
    return Answer(text=report.text(), data=report.json(), status=DONE if report.ok else WRONG)


def _check_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("model", metavar="MODEL", help="a name, a .urdf or an MJCF .xml file")


ARMS: Final = Command(name="arms", help="List the arms that taut knows by name.", run=_arms)
LAWS: Final = Command(name="laws", help="List the laws with their equations and what they need measured.", run=_laws)
CHECK: Final = Command(
    name="check",
    help="Read a robot model and report what is in it and everything that is wrong with it.",
    arguments=_check_arguments,
    run=_check,
)
