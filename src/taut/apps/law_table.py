"""The table of laws: what each computes, yields and needs, from its docstring and from a run of it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from taut.arm.load import load_arm
from taut.control import laws
from taut.control.describe import section, summary
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


def law_rows() -> list[LawRow]:
    """Every law of taut.laws that stands on its own."""
    return [_row(getattr(laws, name)) for name in laws.__all__ if name != "Sum"]


def _row(cls: type[Law]) -> LawRow:
    gains = [field.name for field in fields(cls) if isinstance(cls.__dict__.get(field.name), Gain)]  # type: ignore[arg-type]
    law = cls(**dict.fromkeys(gains, 1.0))
    arm = load_arm("planar3")
    side = LawSide(law=law, arm=arm, rate=1000.0, sensing=Sensing(), limits=None, adds=Adds())
    units = field_units(cls)
    return LawRow(
        name=cls.__name__,
        summary=summary(cls),
        law=section(cls, "Law"),
        closed_loop=section(cls, "Closed loop"),
        gains={name: units.get(name, "") for name in gains},
        command=side.probe.kind,
        reference=cls.reference.__name__,
        needs=("q", *side.needs),
    )
