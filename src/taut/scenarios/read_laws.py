"""The controllers of a scenario: [laws.LABEL] and [control]."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

from taut import laws as all_laws
from taut.arm.description import Arm
from taut.base.errors import UsageError, unknown_name
from taut.base.fields import read
from taut.control.combine import Wrapper
from taut.control.describe import held_laws, law_classes, optional_laws
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.side_by_side import SideBySide
from taut.scenarios.read_constraint import read_constraint
from taut.scenarios.toml import Section

__all__ = ["read_law", "read_limits"]

OF_OTHERS: Final = ("Sum", "SideBySide")  # laws made of others, by a list or in Python
LIMITS: Final[Mapping[str, Mapping[str, bool]]] = {
    "arm": {},
    "arm with rate": {"rate": True},
    "arm with speed": {"speed": True},
    "arm with rate and speed": {"rate": True, "speed": True},
}
"""The arm's own limits, in words: what they are to Limits.of."""


def read_law(section: Section) -> Law:
    """law = "PID" with its gains, or law = ["FeedForward", "PID"] with a table of gains for each."""
    if isinstance(section.peek("law"), list):
        return _sum(section)
    name = section.text("law")
    return _one_law(section, section, name)


def _sum(section: Section) -> Law:
    names = section.texts("law", example='["FeedForward", "PID"]')
    if not names:
        raise section.error("law must be the name of a law, or an array of one at least; got []")
    total: Law | None = None
    for name in names:
        if names.count(name) > 1:
            raise section.error(f"law must name each law once; got '{name}' {names.count(name)} times")
        law = _one_law(section, section.section(name), name)
        with section.blamed("law"):
            total = law if total is None else total + law
    section.done()
    assert total is not None
    return total


def _one_law(section: Section, gains: Section, name: str) -> Law:
    """The law of that name; `section` names it, and `gains` has its gains."""
    if name == "SideBySide":
        return _side_by_side(gains)
    known = {word: kind for word, kind in law_classes(all_laws).items() if word not in OF_OTHERS}
    inner = {word: kind for word, kind in known.items() if not issubclass(kind, Wrapper)}
    with section.blamed("law"):
        if name in known and name not in inner:
            raise UsageError(f"law '{name}' is around another one: write wrapped_by = {{ law = '{name}' }} there")
        if name not in inner:
            raise unknown_name("taut.laws", "law", name, inner)
    cls, wrapped = known[name], gains.section("wrapped_by") if "wrapped_by" in gains else None
    fields = list(cls.declared)
    made = {"constraint": read_constraint(gains)} if "constraint" in fields else {}
    held = {field: gains.section(field, required=True) for field in held_laws(cls)}
    given = [field for field in optional_laws(cls) if field in gains]
    none = [field for field in given if gains.peek(field) == "none" and gains.take(field)]
    held |= {field: gains.section(field) for field in given if field not in none}
    values = gains.fields([field for field in fields if field not in made])
    values |= made | {field: read_law(table) for field, table in held.items()} | dict.fromkeys(none)
    with gains.blamed():
        for field, value in values.items():
            if isinstance(value, dict):
                values[field] = read(cls.declared[field].of[0], value, field)  # type: ignore[attr-defined]  # a part
        law: Law = cls(**values)
    return law if wrapped is None else _wrapped(wrapped, law, known)


def _wrapped(section: Section, law: Law, known: Mapping[str, type[Law]]) -> Law:
    """wrapped_by = { law = "EnergyTank", capacity = 0.5 }: a law around this one."""
    name = section.word("law", [word for word, kind in known.items() if issubclass(kind, Wrapper)])
    values = section.fields([field for field in known[name].declared if field != "law"])
    with section.blamed():
        return known[name](law=law, **values)


def _side_by_side(section: Section) -> Law:
    """A table for each law, with the names of its joints where it does not say them by its tool."""
    parts: dict[str, Law | tuple[Law, list[str]]] = {}
    for part in section.left:
        table = section.section(part)
        joints = table.texts("joints", None, example='["head_pan"]')
        law = read_law(table)
        parts[part] = law if joints is None else (law, joints)
    with section.blamed():
        return SideBySide(**parts)  # type: ignore[arg-type]  # it makes its own __init__


def read_limits(section: Section, arm: Arm, rate: float) -> Limits | None:
    """limits = one of LIMITS, or a table of the fields of Limits; `of = "arm"` gives what the table leaves out."""
    if not isinstance(section.peek("limits"), dict):
        word = section.word("limits", ("none", *LIMITS), "none")
        with section.blamed("limits"):
            return None if word == "none" else Limits.of(arm, **LIMITS[word])
    table = section.section("limits")
    word = table.word("of", tuple(LIMITS), None)
    values = {field.name: table.numbers(field.name, None) for field in dataclasses.fields(Limits)}
    table.done()
    given = {name: value for name, value in values.items() if value is not None}
    with table.blamed():
        made = Limits(**given) if word is None else dataclasses.replace(Limits.of(arm, **LIMITS[word]), **given)
        made.check_fit(arm, rate)
        return made
