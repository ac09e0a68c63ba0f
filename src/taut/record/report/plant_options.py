"""The options that a plant was made with, as a run keeps them: those that repeat it, and the names of all others."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any, Final

from taut.maths.adds import Adds
from taut.record.report.page import stated

__all__ = ["OPTIONS", "plant_options"]

OPTIONS: Final = "plant_options"  # in run.info
TEXTS: Final = ("scene",)  # whose words may name a file


def plant_options(plant: object) -> dict[str, Any]:
    """What a plant was given beside its arm, where it is not the default.

    Args:
        plant: A plant that is a dataclass, or has the arguments that it was made with as `given`.

    Returns:
        "options", those that are numbers, words or components that it adds, by name; "others", the names of those
        that are more than that. Both are None of a plant of which they are not known.
    """
    kind = type(plant)
    parts = {part.name: part for part in dataclasses.fields(plant)} if dataclasses.is_dataclass(plant) else {}
    given: Mapping[str, Any] | None = getattr(plant, "given", None) or {name: getattr(plant, name) for name in parts}
    if not given:
        return {"options": None, "others": None}
    usual = {name: each.default for name, each in inspect.signature(kind).parameters.items()}
    options: dict[str, Any] = {}
    others: list[str] = []
    for name, value in given.items():
        factory = parts[name].default_factory if name in parts else dataclasses.MISSING
        default = usual.get(name) if factory is dataclasses.MISSING else factory()
        if name == "arm" or (type(value) is type(default) and stated(value) == stated(default)):
            continue
        if name == "adds" and Adds.of(value).load is None:
            options |= {name: list(Adds.of(value).names)} if Adds.of(value).names else {}
        elif value is None or (isinstance(value, (bool, int, float, str)) and name not in TEXTS):
            options[name] = value
        else:
            others.append(name)
    return {"options": options, "others": others}
