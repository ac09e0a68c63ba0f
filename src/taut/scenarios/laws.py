"""The controllers of a scenario, [laws.LABEL] and [control], and laws as text, "PID(kp=100, kd=20)"."""

from __future__ import annotations

import ast
import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from taut import laws as all_laws
from taut.arm.description import Arm
from taut.base.checks import rate_in_hertz
from taut.base.errors import UsageError, unknown_name
from taut.base.plot_style import short
from taut.control.combine import Wrapper, law_classes
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.sensing import Difference, Kalman, LowPass, Sensing
from taut.control.side_by_side import SideBySide
from taut.maths.constraints.constraint import Constraint
from taut.scenarios.reading import Table, arguments, of_kind, read, reads

__all__ = ["law_of_text", "read_constraint", "read_control", "read_law"]

CONSTRAINTS: Final = ("plane", "point", "sphere", "cylinder", "line", "hinge", "grasp", "pin", "knife_edge")
VELOCITY_SOURCES: Final[Mapping[str, Any]] = {"low-pass": LowPass, "difference": Difference, "kalman": Kalman}
MAX_RATE: Final = 1e6  # [Hz] of any controller that there is
LIMITS: Final[Mapping[str, Mapping[str, bool]]] = {
    "arm": {},
    "arm with rate": {"rate": True},
    "arm with speed": {"speed": True},
    "arm with rate and speed": {"rate": True, "speed": True},
}
"""The arm's own limits, in words: what they are to Limits.of."""


# -------------------------------------------------------------------- laws


@reads(Law)
def _inner(table: Table, key: str) -> Law:
    return read_law(table.table(key, required=True))


def read_law(table: Table) -> Law:
    """law = "PID" with its gains, or law = ["FeedForward", "PID"] with a table of gains for each."""
    table.need("law")
    if not isinstance(table.get("law"), list):
        return _one_law(table.without("law"), table, table.text("law"))
    names = table.texts("law", example='["FeedForward", "PID"]') or []
    if len(names) != len(set(names)) or not names:
        raise table.error(f"must name one law at least, each once; got {names}", "law")
    table.only(("law", *names))
    laws = [_one_law(table.table(name), table, name) for name in names]
    with table.blamed("law"):
        return sum(laws[1:], start=laws[0])


def _one_law(gains: Table, table: Table, name: str) -> Law:
    """The law of that name, which a table gives."""
    if name == "SideBySide":
        return _side_by_side(gains)
    known = {word: kind for word, kind in law_classes(all_laws).items() if word != "Sum"}
    with table.blamed("law"):
        if name not in known:
            raise unknown_name("taut.laws", "law", name, known)
    if issubclass(known[name], Wrapper) and "law" not in gains:
        raise table.error(f"'{name}' is around another one: write wrapped_by = {{ law = '{name}' }} there", "law")
    law: Law = read(known[name], gains, others=["wrapped_by"])
    wrappers = {word: kind for word, kind in known.items() if issubclass(kind, Wrapper)}
    while "wrapped_by" in gains:
        gains = gains.table("wrapped_by")
        gains.need("law")
        law = read(wrappers[gains.choice("law", wrappers)], gains, others=["law", "wrapped_by"], law=law)
    return law


def _side_by_side(table: Table) -> Law:
    """A table for each law, with the names of its joints where it does not state them by its tool."""
    parts: dict[str, Any] = {}
    for part in table.values:
        below = table.table(part)
        joints, law = below.texts("joints", example='["head_pan"]'), read_law(below.without("joints"))
        parts[part] = law if joints is None else (law, joints)
    with table.blamed():
        return SideBySide(**parts)


@reads(Constraint)
def read_constraint(table: Table, key: str = "constraint") -> Constraint:
    """{ kind = "plane", point = [0.5, 0.0, 0.3], normal = [0, 0, 1] }, or an array of tables, which hold together."""
    table.need(key)
    tables = table.tables(key) if isinstance(table.get(key), list) else [table.table(key)]
    if not tables:
        raise table.error("must be a table, or an array of one at least; got []", key)
    kinds = {kind: getattr(Constraint, kind) for kind in CONSTRAINTS}
    constraints: list[Constraint] = [of_kind(kinds, each, blame="kind") for each in tables]
    return sum(constraints[1:], start=constraints[0])


# -------------------------------------------------------------------- [control]


def read_control(table: Table, arm: Arm) -> tuple[float, Sensing, Limits | None]:
    """Rate [Hz], sensing and limits."""
    with table.blamed():
        rate = rate_in_hertz(table.get("rate", 1000.0))
    if rate > MAX_RATE:
        raise table.error(f"must be <= {MAX_RATE:g} [Hz]; got {rate:g}", "rate")
    made = {}
    if isinstance(table.get("velocity"), dict):
        made["velocity"] = of_kind(VELOCITY_SOURCES, table.table("velocity"))
    sensing: Sensing = read(Sensing, table, others=["rate", "limits", "velocity"], **made)
    with table.blamed():
        sensing.check_fit(arm, rate)
    return rate, sensing, _limits(table, arm, rate)


def _limits(table: Table, arm: Arm, rate: float) -> Limits | None:
    """limits = one of LIMITS, or a table of the fields of Limits; `of = "arm"` gives what the table leaves out."""
    if not isinstance(table.get("limits"), dict):
        word = table.choice("limits", ("none", *LIMITS), "none")
        with table.blamed("limits"):
            return None if word == "none" else Limits.of(arm, **LIMITS[word])
    below = table.table("limits")
    word = below.choice("of", LIMITS)
    below.only(["of", *arguments(Limits)])
    given = below.without("of").values
    with below.blamed():
        made = Limits(**given) if word is None else dataclasses.replace(Limits.of(arm, **LIMITS[word]), **given)
        made.check_fit(arm, rate)
    return made


# -------------------------------------------------------------------- laws as text

EXAMPLE: Final = "PID(kp=100, kd=20)"
MAX_TEXT: Final = 2000  # letters
MAX_SHOWN: Final = 80  # of them in a message


def law_of_text(text: str) -> tuple[str, Law]:
    """A law and what it is called: the text itself, or the name that stands before it, "stiff: PID(kp=900)".

    The names, gains and tables are those of [laws.LABEL] in a scenario: lists for arrays, dictionaries for tables,
    laws within laws where a law holds one, and + for a sum.

    Raises:
        UsageError: No such form.
        ScenarioError: No such law or gain; the message names what exists.
    """
    label, colon, rest = text.partition(":")
    named = bool(colon) and "(" not in label
    name, words = (label.strip(), rest) if named else (" ".join(text.split()), text)
    try:
        if not name or not name.isprintable() or len(text) > MAX_TEXT:
            raise ValueError(text)
        table = {**_written(ast.parse(words.strip(), mode="eval").body)}
    except (ValueError, TypeError, LookupError, SyntaxError, RecursionError, MemoryError) as cause:
        raise UsageError(
            f"a law is written as {EXAMPLE}, each gain by its name, or with a name before it, stiff: {EXAMPLE}; got "
            f"{short(text, MAX_SHOWN)!r}",
            name="laws",
            value=text,
        ) from cause
    return name, read_law(Table(f"law '{name}':", "", table))


def _written(node: ast.expr) -> Any:
    """A law as the table that [laws.LABEL] of a scenario would be; any other value as TOML has it.

    Raises:
        ValueError, TypeError, KeyError: Something else.
    """
    match node:
        case ast.Name(id=word):  # nan and inf are numbers, as in TOML, so that the law says which gain must be finite
            if word.lower() in ("nan", "inf"):
                return float(word)
            if not word[:1].isupper():  # no law has such a name
                raise ValueError(word)
            return {"law": word}
        case ast.Call(func=ast.Name(id=name), args=[], keywords=gains) if all(gain.arg for gain in gains):
            return {"law": name, **{str(gain.arg): _written(gain.value) for gain in gains}}
        case ast.BinOp(op=ast.Add(), left=left, right=right):
            first, second = _as_sum(_written(left)), _as_sum(_written(right))
            return {**first, **second, "law": first["law"] + second["law"]}
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_written(operand)
        case ast.List(elts=items) | ast.Tuple(elts=items):
            return [_written(item) for item in items]
        case ast.Dict(keys=keys, values=values):
            return {str(ast.literal_eval(key or "")): _written(each) for key, each in zip(keys, values, strict=True)}
    value = ast.literal_eval(node)
    return "none" if value is None else value


def _as_sum(table: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a law as that of a sum with one part."""
    gains = dict(table)
    name = gains.pop("law")
    return dict(table) if isinstance(name, list) else {"law": [name], name: gains}
