"""A controller in words: its laws, gains with units, closed loop, and the cost of a tick."""

from __future__ import annotations

import inspect
import re
from typing import TYPE_CHECKING

from taut.base.errors import count_of, printable
from taut.control.combine import all_laws
from taut.control.law import Law
from taut.controller.parameters import short

if TYPE_CHECKING:
    from taut.controller.controller import Controller


def explanation(ctrl: Controller) -> str:
    """The text that `ctrl.explain()` prints."""
    side = ctrl.side
    lines = [f"{side.title} for arm '{side.arm.name}' ({count_of(side.arm.n, 'joint')}) at {side.rate:g} Hz"]
    for name, law in all_laws(side.law):
        lines += ["", f"{name}: {summary(type(law))}"] if name else []
        for head in ("Law", "Closed loop"):
            texts = _section(type(law), head)
            lines += [f"  {head + ':' if not i else '':13}{text}" for i, (_, text) in enumerate(texts)]
    lines += ["", "parameters"]
    units = side.units
    width = max(24, *(len(path) for path in ctrl.parameters))
    for path, value in ctrl.parameters.items():
        unit = f"  [{units[path]}]" if path in units else ""
        lines.append(f"  {path:{width}} {short(value)}{unit}")
    if side.task is not None:
        lines += ["", *(f"phase          {line}" for line in side.task.plan())]
    lines += ["", f"terms          {', '.join(side.probe.terms)}"]
    lines += [f"sensing        {side.sensing.summary}"] if side.sensing.alters else []
    lines.append(f"needs          {', '.join(('q', *side.needs))}")
    if side.adds.names:
        lines.append(f"left out       {', '.join(side.adds.names)} (the plant adds them)")
    cost = f"{ctrl.operations} operations a tick" if ctrl.operations else "not traced"
    lines.append(f"engine         {ctrl.engine}, {cost}")
    return printable("\n".join(lines), lines=True)


def summary(law: type[Law]) -> str:
    """The first line of a law's docstring."""
    return (inspect.getdoc(law) or "").partition("\n")[0]


def statements(law: type[Law], head: str) -> list[str]:
    """The statements behind 'Law:' or 'Closed loop:' of a docstring; indented lines continue the one before."""
    lines = _section(law, head)
    out: list[str] = []
    for indent, text in lines:
        if out and indent > lines[0][0]:
            out[-1] += f" {text}"
        else:
            out.append(text)
    return out


def _section(law: type[Law], head: str) -> list[tuple[int, str]]:
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
