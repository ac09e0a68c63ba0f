"""Laws as text, as scenario files name them: "PID(kp=100, kd=20)", "FeedForward() + PID(kp=[10, 5])"."""

from __future__ import annotations

import ast
from typing import Any, Final

from taut.base.errors import UsageError
from taut.base.plot_style import short
from taut.control.law import Law
from taut.scenarios.read_laws import read_law
from taut.scenarios.toml import Section

__all__ = ["law_of_text"]

EXAMPLE: Final = "PID(kp=100, kd=20)"
LONGEST: Final = 2000  # letters of a text
SHOWN: Final = 80  # of them in a message


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
    if not name or not name.isprintable() or len(text) > LONGEST:
        raise UsageError(
            f"a law is written as {EXAMPLE}, or with a name before it, stiff: {EXAMPLE}; got {short(text, SHOWN)!r}"
        )
    try:
        tree = ast.parse(words.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as cause:
        raise _no_law(text) from cause
    return name, read_law(Section(f"law '{name}':", "", _table(tree, text)))


def _no_law(text: str, what: str = "") -> UsageError:
    return UsageError(f"a law is written as {EXAMPLE}; got {short(text, SHOWN)!r}{what}", name="laws", value=text)


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
