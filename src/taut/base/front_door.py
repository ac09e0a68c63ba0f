"""Front doors: modules that give the public names of a room, each loaded when it is first used.

A front door lists its names once, as imports below `if TYPE_CHECKING:`, which type checkers follow and Python reads
as
text. So `import taut` loads nothing, and a controller loads what it uses.
"""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

__all__ = ["lazy_names", "public_name"]

ROOMS: Final = ("analysis", "drives", "dynamics", "environments", "guards", "laws", "sensors", "trajectories")
_IMPORT: Final = re.compile(r"^    from (taut[.\w]*) import (\w+) as \2$", re.MULTILINE)
_UNCHECKED: Final[dict[str, set[tuple[str, str]]]] = {}  # front doors and names, by the module that defines them

_DOORS: Final[dict[tuple[str, str], str]] = {}  # by the module that defines a name, and the name


def lazy_names(module: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a front door.

    Args:
        module: Its name.
        file: Its file, whose imports for type checkers are its public names.
    """
    homes = {name: home for home, name in _IMPORT.findall(Path(file).read_text(encoding="utf-8"))}
    names = sorted(homes)
    for name, home in homes.items():
        _UNCHECKED.setdefault(home, set()).add((module, name))
        _DOORS.setdefault((home, name), module)

    def load(name: str) -> Any:
        if name not in homes:
            from taut.base.errors import unknown_name

            raise AttributeError(str(unknown_name(module, "public name", name, names)), name=name, obj=None)
        try:
            value = _value(homes[name], name)
        except OSError as cause:  # no file descriptor left
            from taut.base.errors import FileError

            raise FileError(f"{module}.{name} cannot be loaded: {cause.strerror}", name=name) from cause
        if name != "math":  # whose functions are too quick to wrap
            value = _checked(module, name, value)
        vars(sys.modules[module])[name] = value
        return value

    return load, lambda: names, names


def public_name(kind: type) -> str:
    """The name under which users find a class: "taut.sensors.Encoder"."""
    for door in ROOMS:
        importlib.import_module(f"taut.{door}")
    return f"{_DOORS.get((kind.__module__, kind.__name__), 'taut')}.{kind.__name__}"


def _value(home: str, name: str) -> Any:
    if home == "taut":  # a front door itself
        return importlib.import_module(f"taut.{name}")
    return getattr(importlib.import_module(home), name)


def _checked(module: str, name: str, value: Any) -> Any:
    """A public name whose arguments are checked, as are those of the classes whose objects it may give."""
    from taut.base.signatures import checked_arguments

    for home in [home for home in _UNCHECKED if home in sys.modules and home != "taut"]:
        for door, other in _UNCHECKED.pop(home):
            thing = getattr(sys.modules[home], other, None)
            if isinstance(thing, type):
                checked_arguments(thing, door, other)
    return checked_arguments(value, module, name)
