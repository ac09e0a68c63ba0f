"""What a controller is, in words: its laws, gains with units, closed loop, and what a tick costs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taut.base.errors import count_of
from taut.control.describe import all_laws, section, short, summary

if TYPE_CHECKING:
    from taut.controller.controller import Controller

__all__ = ["explanation"]


def explanation(ctrl: Controller) -> str:
    """What `ctrl.explain()` prints."""
    side = ctrl.side
    lines = [f"{side.title} for arm '{side.arm.name}' ({count_of(side.arm.n, 'joint')}) at {side.rate:g} Hz"]
    for name, law in all_laws(side.law):
        lines += ["", f"{name}: {summary(type(law))}"] if name else []
        for head in ("Law", "Closed loop"):
            texts = section(type(law), head)
            lines += [f"  {head + ':' if not i else '':13}{text}" for i, text in enumerate(texts)]
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
    return "\n".join(lines)
