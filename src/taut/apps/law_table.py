"""The table of laws: what each computes, yields and needs, from its docstring and from a run of it."""

from __future__ import annotations

import functools
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.control import laws
from taut.control.describe import held_laws, section, summary
from taut.control.gains import Gain
from taut.control.law import Law, field_units
from taut.control.lawside import LawSide
from taut.control.sensing import Sensing
from taut.maths.adds import Adds

__all__ = ["LawRow", "law_rows"]


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
    told = [re.sub(r"   (.+)$", r" (\1)", line) for line in lines]
    return [told[0], *(["; ".join(told[1:])] if told[1:] else [])]


def law_rows() -> list[LawRow]:
    """Every law of taut.laws that stands on its own."""
    return [_row(getattr(laws, name)) for name in laws.__all__ if name != "Sum"]


BESIDES: Final = {"Impedance": {"zeta": 1.0}}  # which needs this or another gain


def _example(cls: type[Law]) -> Law:
    """A law with the gains that it cannot do without."""
    needed = {field.name: getattr(cls, field.name, None) is None for field in fields(cls)}  # type: ignore[arg-type]
    given: dict[str, Any] = {}
    for name, gain in vars(cls).items():
        if isinstance(gain, Gain) and needed[name] and not gain.optional:
            given[name] = 1.0 if gain.scalar else (1.0, 1.0)
    held = {name: laws.PID(kp=1.0) for name in held_laws(cls)}
    return cls(**given, **held, **BESIDES.get(cls.__name__, {}))


@functools.cache
def _six_joints() -> Arm:
    """Three slides and a wrist: an arm that every law can control at its home, those of the task too."""
    slides, hinges = np.vstack([np.zeros((3, 3)), np.eye(3)]), np.vstack([np.eye(3)[::-1], np.zeros((3, 3))])
    return Arm.from_screws(np.stack([np.eye(4)] * 7), np.stack([np.eye(6)] * 6), np.hstack([slides, hinges]))


def _row(cls: type[Law]) -> LawRow:
    fields_of = {field.name: cls.__dict__.get(field.name) for field in fields(cls)}  # type: ignore[arg-type]
    gains = [name for name, field in fields_of.items() if isinstance(field, Gain) and field.where is None]
    side = LawSide(law=_example(cls), arm=_six_joints(), rate=1000.0, sensing=Sensing(), limits=None, adds=Adds())
    units = field_units(cls)
    return LawRow(
        name=cls.__name__,
        summary=summary(cls),
        law=section(cls, "Law"),
        closed_loop=section(cls, "Closed loop"),
        gains={name: units.get(name, "") for name in gains},
        command=side.probe.kind,
        reference="none" if cls.ignores_reference else cls.reference.__name__,
        needs=("q", *side.needs),
    )
