"""The controllers of a scenario, [laws.LABEL] and [control], and laws as text, "PID(kp=100, kd=20)"."""

from __future__ import annotations

import ast
import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from taut import laws as all_laws
from taut.arm.description import Arm
from taut.base.checks import rate_in_hertz
from taut.base.errors import UsageError, quoted_list, unknown_name
from taut.base.plot_style import short
from taut.control.combine import Wrapper
from taut.control.describe import law_classes
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.sensing.filters import Difference, Kalman, LowPass
from taut.control.sensing.sensing import VELOCITIES, Sensing
from taut.control.side_by_side import SideBySide
from taut.maths.constraints.constraint import Constraint
from taut.scenarios.reading import arguments, of_kind, read, reads, value
from taut.scenarios.toml import Table, shown

__all__ = ["law_of_text", "read_constraint", "read_control", "read_law"]

OF_OTHERS: Final = ("Sum", "SideBySide")  # laws made of others, by a list or in Python
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
def _held(table: Table, key: str) -> Law:
    return read_law(table.table(key, required=True))


def read_law(table: Table) -> Law:
    """law = "PID" with its gains, or law = ["FeedForward", "PID"] with a table of gains for each."""
    if isinstance(table.get("law"), list):
        return _sum(table)
    table.need("law")
    return _one_law(table, table, table.text("law"))


def _sum(table: Table) -> Law:
    names = table.texts("law", example='["FeedForward", "PID"]') or []
    if not names:
        raise table.error("must be the name of a law, or an array of one at least; got []", "law")
    total: Law | None = None
    for name in names:
        if names.count(name) > 1:
            raise table.error(f"must name each law once; got '{name}' {names.count(name)} times", "law")
        law = _one_law(table, table.table(name), name)
        with table.blamed("law"):
            total = law if total is None else total + law
    table.only(("law", *names))
    assert total is not None
    return total


def _one_law(table: Table, gains: Table, name: str) -> Law:
    """The law of that name; `table` names it, and `gains` has its gains."""
    if name == "SideBySide":
        return _side_by_side(gains.without("law"))
    known = {word: kind for word, kind in law_classes(all_laws).items() if word not in OF_OTHERS}
    wrappers = {word: kind for word, kind in known.items() if issubclass(kind, Wrapper)}
    inner = {word: kind for word, kind in known.items() if word not in wrappers}
    with table.blamed("law"):
        if name in wrappers:
            raise UsageError(f"law '{name}' is around another one: write wrapped_by = {{ law = '{name}' }} there")
        if name not in inner:
            raise unknown_name("taut.laws", "law", name, inner)
    law: Law = read(inner[name], gains, others=["wrapped_by", *(["law"] if gains is table else [])])
    if "wrapped_by" in gains:
        outer = gains.table("wrapped_by")
        outer.need("law")
        law = read(wrappers[outer.choice("law", wrappers)], outer, others=["law"], law=law)
    return law


def _side_by_side(table: Table) -> Law:
    """A table for each law, with the names of its joints where it does not say them by its tool."""
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
    total: Constraint = of_kind(kinds, tables[0], blame="kind")
    for each in tables[1:]:
        total = total + of_kind(kinds, each, blame="kind")
    return total


# -------------------------------------------------------------------- [control]


def read_control(table: Table, arm: Arm) -> tuple[float, Sensing, Limits | None]:
    """Rate [Hz], sensing and limits."""
    sensing = arguments(Sensing)
    table.only(["rate", "limits", *sensing])
    rate = table.number("rate", 1000.0)
    with table.blamed():
        rate = rate_in_hertz(rate)
    if rate > MAX_RATE:
        raise table.error(f"must be <= {MAX_RATE:g} [Hz]; got {rate:g}", "rate")
    parts = {name: _part(table, name, arm, rate) for name in sensing if name in table}
    return rate, Sensing(**parts), _limits(table, arm, rate)


def _part(table: Table, name: str, arm: Arm, rate: float) -> Any:
    """One part of the sensing, which fits the arm and the rate."""
    written = table.get(name)
    if name == "velocity" and not isinstance(written, dict) and written not in VELOCITIES:
        if isinstance(written, str) and written in VELOCITY_SOURCES:
            needed = [key for key, each in arguments(VELOCITY_SOURCES[written]).items() if each.required]
            numbers = ", ".join(f"{key} = ..." for key in needed)
            raise table.error(f'= "{written}" needs its numbers: {{ kind = "{written}", {numbers} }}', name)
        raise table.error(
            f"must be one of {quoted_list(VELOCITIES)}, or a table with kind = one of "
            f"{quoted_list(VELOCITY_SOURCES)}; got {shown(written)}",
            name,
        )
    if name == "velocity":
        made = of_kind(VELOCITY_SOURCES, table.table(name)) if isinstance(written, dict) else written
    else:
        made = value(arguments(Sensing)[name], table, name)
    with (table.table(name) if isinstance(written, dict) else table).blamed():
        Sensing(**{name: made}).check_fit(arm, rate)
    return made


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
MAX_LETTERS: Final = 2000  # of a text
MAX_SHOWN: Final = 80  # of them in a message


def law_of_text(text: str) -> tuple[str, Law]:
    """A law and what it is called: the text itself, or the name that stands before it, "stiff: PID(kp=900)".

    The names, gains and tables are those of [laws.LABEL] in a scenario: lists for arrays, dictionaries for tables,
    laws within laws where a law holds one, and + for a sum.

    Raises:
        UsageError: No such form.
        ScenarioError: No such law or gain; the message says what there is.
    """
    label, colon, rest = text.partition(":")
    named = bool(colon) and "(" not in label
    name, words = (label.strip(), rest) if named else (" ".join(text.split()), text)
    if not name or not name.isprintable() or len(text) > MAX_LETTERS:
        raise UsageError(
            f"a law is written as {EXAMPLE}, or with a name before it, stiff: {EXAMPLE}; got "
            f"{short(text, MAX_SHOWN)!r}"
        )
    try:
        tree = ast.parse(words.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as cause:
        raise _no_law(text) from cause
    return name, read_law(Table(f"law '{name}':", "", _table(tree, text)))


def _no_law(text: str, what: str = "") -> UsageError:
    return UsageError(f"a law is written as {EXAMPLE}; got {short(text, MAX_SHOWN)!r}{what}", name="laws", value=text)


def _table(node: ast.expr, text: str) -> dict[str, Any]:
    """The table that [laws.LABEL] of a scenario would be."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        parts = [_one(part, text) for part in _parts(node)]
        names = [part.pop("law") for part in parts]
        return {"law": names, **dict(zip(names, parts, strict=True))}
    return _one(node, text)


def _parts(node: ast.expr) -> list[ast.expr]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return [*_parts(node.left), *_parts(node.right)]
    return [node]


def _one(node: ast.expr, text: str) -> dict[str, Any]:
    """One law with its gains."""
    if isinstance(node, ast.Name):
        return {"law": node.id}
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
        raise _no_law(text)
    if node.args or any(word.arg is None for word in node.keywords):
        raise _no_law(text, "; each gain by its name")
    return {"law": node.func.id, **{str(word.arg): _value(word.value, text) for word in node.keywords}}


def _value(node: ast.expr, text: str) -> Any:
    """A number, a word, a list, a table, or a law that is held."""
    if isinstance(node, (ast.Call, ast.BinOp)) and not _is_number(node):
        return _table(node, text)
    written = ast.unparse(node)
    try:
        value = ast.literal_eval(_NotFinite().visit(node))
    except (ValueError, TypeError, SyntaxError, RecursionError) as cause:
        raise _no_law(text, f"; '{written}' is no number, list, word or law") from cause
    return _plain(value)


class _NotFinite(ast.NodeTransformer):
    """nan and inf are numbers, as in TOML, so that the law itself says which gain must be finite."""

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Constant(float(node.id)) if node.id.lower() in ("nan", "inf") else node


def _is_number(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp) and not isinstance(node.op, ast.Add)


def _plain(value: Any) -> Any:
    """As TOML has it: tuples are lists, and None is the word for nothing."""
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    return "none" if value is None else value
