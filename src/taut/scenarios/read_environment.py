"""What touches the tool in a scenario: [plant.environment], one by its kind, or tables of several by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from taut.base.errors import quoted_list
from taut.plant.environments.environment import Environment, Environments
from taut.plant.environments.held import Hand, Handle
from taut.plant.environments.prescribed import BandNoise, Oscillation
from taut.plant.environments.push import Push
from taut.plant.environments.springs import Damper, Spring
from taut.plant.environments.wall import StiffWall
from taut.scenarios.read_drives import made_from
from taut.scenarios.read_pose import pose_table
from taut.scenarios.toml import Section

__all__ = ["read_environment"]

KINDS: Final[Mapping[str, Any]] = {
    "spring": Spring,
    "damper": Damper,
    "wall": StiffWall,
    "handle": Handle,
    "hand": Hand,
    "push": Push,
}
WILLS: Final = {"oscillation": Oscillation, "noise": BandNoise}


def read_environment(section: Section) -> Environment:
    """An environment with its kind; without a kind, a table for each of several that act together.

    Args:
        section: [plant.environment].
    """
    if "kind" in section:
        return _one(section)
    names = section.left
    if not names or not all(isinstance(section.peek(name), dict) for name in names):
        raise section.error(
            f"needs kind, one of {quoted_list(list(KINDS), most=len(KINDS))}, or a table for each of several: "
            f"[{section.below('wall')}]"
        )
    parts = {name: _one(section.section(name)) for name in names}
    for name in parts:
        if not name.isidentifier():
            raise section.error(f"must name its tables by letters, digits and underscores; got '{name}'")
    with section.blamed():
        return Environments(**parts)


def _one(section: Section) -> Environment:
    kind = section.word("kind", tuple(KINDS))
    parts: dict[str, Any] = {}
    if kind == "spring" and isinstance(section.peek("at"), dict):
        parts["at"] = pose_table(section.section("at"))
    if kind == "hand":
        for name in ("motion", "force"):
            if name in section:
                table = section.section(name)
                parts[name] = made_from(table, WILLS[table.word("kind", tuple(WILLS))])
    return made_from(section, KINDS[kind], **parts)  # type: ignore[no-any-return]  # an environment
