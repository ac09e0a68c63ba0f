"""Metrics as text: one line per joint, one column per metric."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from taut.record.metrics import MEASURES

if TYPE_CHECKING:
    from taut.record.metrics import Metrics

__all__ = ["metrics_table", "number_text"]


def metrics_table(metrics: Metrics) -> str:
    """The metrics that have a meaning for this run, with units."""
    joints = [name for name, measure in MEASURES.items() if measure.per_joint]
    names = [name for name in joints if not all(math.isnan(x) for x in getattr(metrics, name))]
    # One kind of limit that acted alone says what "saturated" says.
    whole = metrics.saturation_time.tolist()
    names = [name for name in names if not name.endswith("_limit_time") or getattr(metrics, name).tolist() != whole]
    together = (
        {f"all in {unit}": values for unit, values in metrics.groups.items()} if len(metrics.groups) > 1 else {}
    )
    if len(metrics.joint_names) > 1:
        together["overall"] = metrics.overall
    columns = []
    for name in names:
        numbers = [number_text(x) for x in getattr(metrics, name)]
        last = [number_text(values[name]) for values in together.values()]
        columns.append([*_heading(MEASURES[name].title), metrics.unit(name), *numbers, *last])
    return "\n".join([_aligned(["", "", "", *metrics.joint_names, *together], columns), *_of_tool(metrics)])


def _of_tool(metrics: Metrics) -> list[str]:
    """The numbers of the tool, one line each."""
    found = {name: metrics.overall[name] for name, measure in MEASURES.items() if not measure.per_joint}
    shown = {name: value for name, value in found.items() if not math.isnan(value)}
    width = max((len(name) for name in shown), default=0)
    words = {name: f"[{MEASURES[name].unit}]: {MEASURES[name].overall}" for name in shown}
    return [f"{name.ljust(width)}  {number_text(value)} {words[name]}" for name, value in shown.items()]


def _heading(title: str) -> tuple[str, str]:
    """A title on two lines."""
    first, _, second = title.partition(" ")
    return (first, second) if second else ("", first)


def number_text(value: float) -> str:
    """A metric in words: a number, a dash where it has no meaning, "not settled" where it is infinite."""
    if math.isnan(value):
        return "-"
    return "not settled" if math.isinf(value) else f"{value:.4g}"


def _aligned(side: list[str], columns: list[list[str]]) -> str:
    width = max(len(text) for text in side)
    widths = [max(len(text) for text in column) for column in columns]
    lines = []
    for i, text in enumerate(side):
        cells = [column[i].rjust(size) for column, size in zip(columns, widths, strict=True)]
        lines.append("  ".join([text.ljust(width), *cells]).rstrip())
    return "\n".join(lines)
