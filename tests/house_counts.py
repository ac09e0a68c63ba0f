"""Counts of the house: lines, modules, importers, circles, names, constants, expressions of the glossary.

`python tests/house_counts.py` prints them; `python tests/house_counts.py circles` lists what a count counts.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "taut"
APART = ("tests", "benchmarks", "docs", "examples", "notebooks")
FAMILIES = (  # members of a family, and front doors, may have one importer
    "control/laws", "control/trajectories", "plant/environments",
    "arm/loaders", "cli", "book",
)  # fmt: skip
EXPRESSIONS = (  # the twenty unambiguous ones of the left column of the glossary
    r"swings?\b", r"swinging", r"for ever\b", r"by the book", r"joints to spare", r"los(?:es|ing) rank", r"what counts",
    r"is borne", r"bears?\b", r"turned round", r"felt\b", r"told\b", r"ways? out\b", r"set off\b", r"kinks?\b",
    r"sags?\b", r"says? otherwise", r"calm\b", r"how far it may go", r"the border\b",
)  # fmt: skip


def python_files() -> list[Path]:
    """Every Python file that is tracked and counted."""
    names = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = [ROOT / name for name in names.split() if name.split("/")[0] not in APART]
    return [file for file in files if file.exists()]


def modules() -> list[Path]:
    return [file for file in python_files() if file.is_relative_to(PACKAGE)]


def lines() -> int:
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in python_files())


def code_lines() -> int:
    """Lines with a token of code: no comments, no docstrings, no blank lines."""
    return sum(len(_code_of(file)) for file in python_files())


def _code_of(file: Path) -> set[int]:
    text = file.read_text(encoding="utf-8")
    used = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT):
            used |= set(range(token.start[0], token.end[0] + 1)) if token.string.strip() else set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                used -= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return used


def largest_folder() -> int:
    counts: dict[Path, int] = defaultdict(int)
    for file in modules():
        counts[file.parent] += 1
    return max(counts.values())


def name_of(file: Path) -> str:
    parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def imports() -> dict[str, set[str]]:
    """Modules that each module imports, those inside functions too, but for those of type checkers."""
    names = {name_of(file) for file in modules()}
    return {name_of(file): set(_imported(file, names)) - {name_of(file)} for file in modules()}


def _imported(file: Path, names: set[str]) -> Iterator[str]:
    waiting: list[ast.AST] = [ast.parse(file.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting.extend(node.orelse)
            continue
        waiting.extend(ast.iter_child_nodes(node))
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in names)
        elif isinstance(node, ast.ImportFrom) and node.module in names:
            below = {f"{node.module}.{alias.name}" for alias in node.names} & names
            yield from below
            if len(below) < len(node.names):
                yield node.module


def circles() -> list[list[str]]:
    """Strongly connected components of more than one module (Tarjan)."""
    graph, index, low, stack, found = imports(), {}, {}, [], []
    on: set[str] = set()

    def visit(v: str) -> None:
        index[v] = low[v] = len(index)
        stack.append(v)
        on.add(v)
        for w in graph[v]:
            if w not in index:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in on:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            component = []
            while not component or component[-1] != v:
                component.append(stack.pop())
                on.discard(component[-1])
            if len(component) > 1:
                found.append(sorted(component))

    sys.setrecursionlimit(10_000)
    for v in graph:
        if v not in index:
            visit(v)
    return found


def slices() -> list[str]:
    """Modules that exactly one module of another idea imports."""
    importers: dict[str, set[str]] = defaultdict(set)
    for name, imported in imports().items():
        for other in imported:
            importers[other].add(name)
    doors = {name_of(file) for file in modules() if file.name == "__init__.py" or file.parent == PACKAGE}
    family = tuple(f"taut.{folder.replace('/', '.')}." for folder in FAMILIES)
    return sorted(
        name for name in imports()
        if len(importers[name] - {"taut"}) == 1 and name not in doors and not name.startswith(family)
    )  # fmt: skip


def loaded_for(code: str, below: str = "taut") -> list[str]:
    """Modules of taut, or of a room of it, that a few lines of Python load."""
    code += "\nimport sys; print(*sorted(m for m in sys.modules if m.split('.')[0] == 'taut'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return [name for name in done.stdout.splitlines()[-1].split() if name.startswith(below)]


def constants_of_several_values() -> list[str]:
    """Names of numeric constants of modules that have different values in different modules."""
    values: dict[str, set[str]] = defaultdict(set)
    for file in modules():
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            target = node.target if isinstance(node, ast.AnnAssign) else None
            if isinstance(node, ast.Assign) and len(node.targets) == 1:
                target = node.targets[0]
            if isinstance(target, ast.Name) and target.id.isupper() and node.value is not None:
                try:
                    value = ast.literal_eval(node.value)
                except ValueError:
                    continue
                if isinstance(value, int | float) and not isinstance(value, bool):
                    values[target.id].add(repr(float(value)))
    return sorted(name for name, found in values.items() if len(found) > 1)


def expressions() -> list[str]:
    """Places in the package and in the pages with an expression that the glossary replaces."""
    pattern = re.compile(rf"(?<![\w.]){'(?:' + '|'.join(EXPRESSIONS) + ')'}", re.IGNORECASE)
    files = [*modules(), ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    return [
        f"{file.relative_to(ROOT)}:{number}: {found.group()}"
        for file in files
        if file.name not in ("renamed.md",)
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)
        for found in pattern.finditer(line)
    ]


if __name__ == "__main__":
    from test_house import LIMITS

    for what, (limit, count) in LIMITS.items():
        print(f"{count():>7}  at most {limit:>7}  {what}")
    for argument in sys.argv[1:]:
        print(*globals()[argument](), sep="\n")
