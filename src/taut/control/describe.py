"""Words about laws: their docstrings and the laws that they hold, for `explain` and for lists."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from taut.base.fields import Part
from taut.base.types import Array
from taut.control.combine import Sum, Wrapper
from taut.control.law import Law

if TYPE_CHECKING:
    from taut.control.tasks.task import Task

__all__ = [
    "all_laws",
    "law_classes",
    "held_laws",
    "section",
    "short",
    "statements",
    "summary",
    "title",
]


def law_classes(door: ModuleType) -> dict[str, type[Law]]:
    """The classes of laws among the public names of a module, by name; not the base of wrappers."""
    values = {name: getattr(door, name) for name in door.__all__}
    return {
        name: value
        for name, value in values.items()
        if isinstance(value, type) and issubclass(value, Law) and value is not Wrapper
    }


def all_laws(law: Law | Task, name: str = "") -> Iterator[tuple[str, Law]]:
    """A law and the laws that it holds, each with its path; of a task, those of its phases."""
    if isinstance(law, Law):
        yield name, law
    if isinstance(law, Wrapper):
        yield from all_laws(law.law, name)
        return
    for child, inner in law.children().items():
        yield from all_laws(inner, f"{name}.{child}" if name else child)


def held_laws(law: type[Law]) -> list[str]:
    """The fields of a law that hold a law each: `inner: Law`."""
    parts = {name: field for name, field in law.declared.items() if isinstance(field, Part) and not field.optional}
    return [name for name, field in parts.items() if any(issubclass(kind, Law) for kind in field.of)]


def title(law: Law | Task) -> str:
    """A law's name; of a sum, the names of its parts, and of a task those of its phases."""
    if not isinstance(law, Law):
        return law.title
    return " + ".join(law.children()) if isinstance(law, Sum) else type(law).__name__


def summary(law: type[Law]) -> str:
    """The first line of a law's docstring."""
    return (inspect.getdoc(law) or "").partition("\n")[0]


def section(law: type[Law], head: str) -> list[str]:
    """The lines behind 'Law:' or 'Closed loop:' in a docstring."""
    return [text for _, text in _lines(law, head)]


def statements(law: type[Law], head: str) -> list[str]:
    """What stands behind 'Law:' or 'Closed loop:', each statement whole: lines set in further go on with it."""
    lines = _lines(law, head)
    out: list[str] = []
    for indent, text in lines:
        if out and indent > lines[0][0]:
            out[-1] += f" {text}"
        else:
            out.append(text)
    return out


def _lines(law: type[Law], head: str) -> list[tuple[int, str]]:
    """Column and text of each line of a part of a docstring."""
    lines = (inspect.getdoc(law) or "").splitlines()
    for i, line in enumerate(lines):
        if line.startswith(f"{head}:"):
            found = [" " * len(f"{head}:") + line.partition(":")[2]]
            for follow in lines[i + 1 :]:
                if not follow.startswith(" "):
                    break
                found.append(follow)
            return [(len(text) - len(text.lstrip()), re.sub(r"\s{3,}", "   ", text.strip())) for text in found]
    return []


def short(value: Array) -> str:
    """A parameter's value in one line."""
    if value.ndim == 0:
        return f"{float(value):g}"
    return np.array2string(value, precision=6, separator=", ", threshold=20).replace("\n", " ")
