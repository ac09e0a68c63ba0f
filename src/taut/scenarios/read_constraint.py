"""Constraints in a scenario: { kind = "plane", point = [0.5, 0.0, 0.3], normal = [0, 0, 1] }, or an array of them."""

from __future__ import annotations

import inspect
from typing import Any, Final

from taut.maths.constraints.constraint import Constraint
from taut.scenarios.read_pose import pose_table
from taut.scenarios.toml import Section

__all__ = ["KINDS", "read_constraint"]

KINDS: Final = ("plane", "point", "sphere", "cylinder", "line", "hinge", "grasp", "pin", "knife_edge")


def read_constraint(section: Section, key: str = "constraint") -> Constraint:
    """The constraint at a key: a table, or an array of tables, which hold together.

    Raises:
        ScenarioError: Another kind, a key that its kind lacks, numbers that make no constraint.
    """
    if key not in section:
        section.take(key)
    tables = section.sections(key) if isinstance(section.peek(key), list) else [section.section(key)]
    if not tables:
        raise section.error(f"{key} must be a table, or an array of one at least; got []")
    total = _one(tables[0])
    for table in tables[1:]:
        total = total + _one(table)
    return total


def _one(table: Section) -> Constraint:
    kind = table.word("kind", KINDS)
    make = getattr(Constraint, kind)
    parameters = inspect.signature(make).parameters
    required = [name for name, p in parameters.items() if p.default is p.empty]
    pose = {"T": pose_table(table.section("T", required="T" in required))} if "T" in table or "T" in required else {}
    names = [name for name in parameters if name != "T"]
    values: dict[str, Any] = table.fields(names, [name for name in required if name != "T"])
    with table.blamed("kind"):
        made: Constraint = make(**values, **pose)
        return made
