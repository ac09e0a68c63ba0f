"""A design in words and as plain values."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.analysis.design.contact import Pressed
from taut.analysis.design.directions import designed_part
from taut.analysis.design.limits import RESTS
from taut.analysis.design.requirements import Requirement
from taut.analysis.design.result import Achieved
from taut.analysis.design.stiffness import STATIC, Stiff
from taut.analysis.design.trial import Numbers

if TYPE_CHECKING:
    from taut.analysis.design.design import Design

__all__ = ["as_json", "gains_of", "report"]

WIDTH: Final = 110
COLUMNS: Final = {
    "zeta": "zeta",
    "omega_n": "omega_n [rad/s]",
    "overshoot": "overshoot [%]",
    "settling": "settling [s]",
}
BANDWIDTH: Final = {"bandwidth": "bandwidth [rad/s]"}
GAINS: Final = ("kp", "kd", "ki", "K", "B", "D", "zeta", "kfp", "kfi", "kdamp")
NOTHING: Final = 1e-6  # of a number that is shown: what rounding leaves of none
MOST: Final = 6  # of the poses that are listed


def gains_of(d: Design) -> dict[str, Any]:
    """The gains, by path; those of free motion only where the task leaves any."""
    free = d.arm.n > getattr(designed_part(d.law), "dimensions", 6)
    return {name: x for name, x in d.law.parameters().items() if free or "null" not in name.split(".")}


def report(d: Design) -> str:
    """Gains, the table of numbers, the limits."""
    asked = ", ".join(f"{name} = {_short(value)}" for name, value in d.asked.items())
    lines = [f"{type(d.law).__name__} on {d.arm.name} at {d.rate:g} Hz, for {asked}", "", *_requirements(d), ""]
    for name, values in d.law.parameters().items():
        *held, last = name.split(".")
        if np.any(values) and last in GAINS and "null" not in held:
            lines += _gain(name, np.asarray(values), d.arm.n)
    where = "worst of the poses" if len(d.poses) > 1 else "pose"
    lines += ["", f"at the {where}, q = {np.round(d.q, 4).tolist()}"]
    if np.abs(d.tried.lin.moved).max() > RESTS:
        lines.append(f"its equilibrium under the weight, q = {np.round(d.tried.lin.q, 4).tolist()}")
    if d.alone:
        lines.append(f"tried as {d.alone} alone, which {type(d.law).__name__} holds")
    if d.achieved:
        lines.append(f"predicted and simulated: {d.motion}")
        lines += ["", *_table(d.achieved, COLUMNS | (BANDWIDTH if "bandwidth" in d.asked else {}))]
        if not all(response.whole for response in d.responses):
            longest = max(float(response.t[-1]) for response in d.responses)
            lines += ["", f"- : followed for {longest:g} s, which is too short to show where it settles"]
    else:
        lines += ["", "nothing draws the arm anywhere, so that a step has no answer to show"]
    if d.stiffness:
        lines += ["", *_stiffness(d.stiffness)]
    if d.forces and d.q_contact is not None:
        lines += ["", f"against the constraint, held by it at q = {np.round(d.q_contact, 4).tolist()}"]
        lines.append("simulated: a rigid contact moves in steps of semi-implicit Euler, one in a period")
        lines += ["", *_table(d.forces)]
    if len(d.poses) > 1:
        lines += ["", *_poses(d)]
    lines.append("")
    for each in d.limits:
        mark = "  " if each.ok else "!!"
        head = f"{mark} {each.name:<13} "
        lines += textwrap.wrap(each.sentence, WIDTH, initial_indent=head, subsequent_indent=" " * len(head))
    return "\n".join(lines)


def _requirements(d: Design) -> list[str]:
    """Each number that was asked for in a line: asked, got, and whether it is met in all directions."""
    grouped: dict[tuple[str, str, float], list[Requirement]] = {}
    for each in d.requirements:
        grouped.setdefault((each.name, each.unit, each.asked), []).append(each)
    lines = [f"   {'':<16}{'asked':>13}   got"] if grouped else []
    for (name, unit, asked), rows in grouped.items():
        numbers = [_number(each.got) for each in sorted(rows, key=lambda each: each.got)]
        got = numbers[0] if numbers[0] == numbers[-1] else f"{numbers[0]} to {numbers[-1]}"
        missed = [each.direction for each in rows if not each.met]
        verdict = f"missed along {', '.join(missed)}" if missed else "met"
        title = f"{name} [{unit}]" if unit else name
        head = f"{'!!' if missed else '  '} {title:<16}{_number(asked):>13}   "
        lines += textwrap.wrap(f"{got}   {verdict}", WIDTH, initial_indent=head, subsequent_indent=" " * len(head))
    elsewhere = [pose for pose in d.poses if not pose.met and not np.array_equal(pose.q, d.q)]
    return lines + [f"!! missed at q = {np.round(pose.q, 4).tolist()} too" for pose in elsewhere[:MOST]]


def _gain(name: str, values: Any, n: int) -> list[str]:
    if values.ndim == 2 and not np.any(values - np.diag(np.diag(values))):
        values = np.diag(values)
    if values.ndim < 2:
        distinct = np.unique(values)
        text = f"{distinct[0]:.6g}" if distinct.size == 1 else ", ".join(f"{x:.6g}" for x in values)
        return textwrap.wrap(f"   {name} = {text}", WIDTH, subsequent_indent=" " * (len(name) + 6))
    del n
    head = f"   {name} = "
    rows = ["  ".join(f"{x:9.4g}" for x in row) for row in values]
    return [(head if i == 0 else " " * len(head)) + row for i, row in enumerate(rows)]


def _table(directions: Sequence[Achieved | Pressed], columns: Mapping[str, str] = COLUMNS) -> list[str]:
    """Each direction, one line: designed, predicted, simulated, on the plant."""
    sources = ["designed", "predicted", "simulated"] + ["on plant"] * (_on_plant(directions[0]) is not None)
    width = max(len(each.direction) for each in directions)
    lines = []
    for name, title in columns.items():
        rows = []
        for each in directions:
            real = _on_plant(each)
            given = [each.designed, each.predicted, each.simulated, *([real] if real else [])]
            rows.append([_number(getattr(numbers, name)) for numbers in given])
        lines.append(f"   {title:<{max(width, 16)}}" + "".join(f"{source:>13}" for source in sources))
        names = [each.direction for each in directions]
        if len(rows) > 1 and all(row == rows[0] for row in rows):
            names, rows = ["in each direction"], rows[:1]
        lines += [
            f"   {direction:<{max(width, 16)}}" + "".join(f"{cell:>13}" for cell in row)
            for direction, row in zip(names, rows, strict=True)
        ]
        lines.append("")
    return lines[:-1]


def _stiffness(rows: Sequence[Stiff]) -> list[str]:
    """What was asked for, and what a small force at rest shows."""
    width = max(16, *(len(f"{each.direction} [{each.unit}]") for each in rows))
    head = f"   {'stiffness':<{width}}" + "".join(f"{name:>13}" for name in ("designed", "predicted", "simulated"))
    lines = [head] + [
        f"   {f'{each.direction} [{each.unit}]':<{width}}"
        + "".join(f"{_number(value):>13}" for value in (each.designed, each.predicted, each.simulated))
        for each in rows
    ]
    if any(each.designed > (1.0 + STATIC) * each.asked for each in rows):
        lines.append("   designed is more than K where the arm cannot move along one direction without another")
    return lines


def _on_plant(each: Achieved | Pressed) -> Numbers | None:
    return each.on_plant if isinstance(each, Achieved) else None


def _poses(d: Design) -> list[str]:
    zetas = [pose.zeta for pose in d.poses]
    lines = [
        f"over {len(d.poses)} poses zeta is {min(z[0] for z in zetas):.4g} to {max(z[1] for z in zetas):.4g}, and "
        f"the longest settling time {_number(max(pose.settling for pose in d.poses))} s"
    ]
    return lines + [
        f"   q = {np.round(pose.q, 3).tolist()}: zeta {pose.zeta[0]:.4g} to {pose.zeta[1]:.4g}"
        for pose in d.poses[:MOST]
    ]


def _number(value: float) -> str:
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "never"
    return "0" if abs(value) < NOTHING else f"{value:.4g}"


def _short(value: object) -> str:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0:
        return f"{float(array):g}"
    return f"({', '.join(f'{x:g}' for x in array)})" if array.ndim == 1 else "a matrix"


def as_json(d: Design) -> dict[str, Any]:
    """Everything of it but the pictures."""
    return {
        "law": type(d.law).__name__,
        "arm": d.arm.name,
        "rate": d.rate,
        "asked": {name: np.asarray(value).tolist() for name, value in d.asked.items()},
        "gains": {name: np.asarray(value).tolist() for name, value in gains_of(d).items()},
        "q": d.q.tolist(),
        "met": d.met,
        "requirements": [{**dataclasses.asdict(each), "got": _finite(each.got)} for each in d.requirements],
        "achieved": [_row(each) for each in d.achieved],
        "stiffness": [
            {name: value if isinstance(value, str) else _finite(value) for name, value in vars(each).items()}
            for each in d.stiffness
        ],
        "forces": [_row(each) for each in d.forces],
        "q_contact": None if d.q_contact is None else d.q_contact.tolist(),
        "poses": [
            {
                "q": pose.q.tolist(),
                "zeta": [_finite(z) for z in pose.zeta],
                "settling": _finite(pose.settling),
                "stable": pose.stable,
                "met": pose.met,
            }
            for pose in d.poses
        ],
        "limits": [
            {**dataclasses.asdict(each), "value": _finite(each.value), "limit": _finite(each.limit)}
            for each in d.limits
        ],
        "motion": d.motion,
        "alone": d.alone,
    }


def _row(each: Achieved | Pressed) -> dict[str, Any]:
    sources = {
        "designed": each.designed, "predicted": each.predicted, "simulated": each.simulated,
        "on_plant": _on_plant(each),
    }  # fmt: skip
    numbers = {name: None if of is None else _plain(of) for name, of in sources.items()}
    return {"direction": each.direction, "unit": each.unit, **numbers}


def _plain(numbers: Numbers) -> dict[str, float | None]:
    return {name: _finite(value) for name, value in dataclasses.asdict(numbers).items()}


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
