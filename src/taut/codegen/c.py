"""C99: blocks as structs, a program as the text of a function, from the same nodes as machine code."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.errors import UsageError, printable
from taut.base.types import Float64Array
from taut.codegen import functions, llvm
from taut.codegen.functions import Real
from taut.codegen.program import Block, Field, Program
from taut.trace.graph import Op

Place = Callable[[str, int], str]
"""The C expression of a double in a block: `in->q[3]` for ("inputs", 4)."""


@dataclass(frozen=True, kw_only=True)
class Precision:
    """The C type of all numbers."""

    numbers: Real
    suffix: str  # of functions of math.h
    letter: str  # of constants

    @property
    def real(self) -> str:
        """The type's name."""
        return self.numbers.name

    def number(self, value: float) -> str:
        """A constant, exactly; in single precision the nearest that is neither infinite nor zero."""
        if not math.isfinite(value):
            name = "NAN" if math.isnan(value) else "INFINITY"
            return f"({'-' if value < 0.0 else ''}({self.real}){name})"
        text = self.numbers.rounded(value).hex() + self.letter
        return f"({text})" if value < 0.0 else text


DOUBLE: Final = Precision(numbers=functions.DOUBLE, suffix="", letter="")
SINGLE: Final = Precision(numbers=functions.SINGLE, suffix="f", letter="F")

_OPERATION: Final = {
    Op.ADD: "{0} + {1}", Op.SUB: "{0} - {1}", Op.MUL: "{0} * {1}", Op.DIV: "{0} / {1}", Op.NEG: "-{0}",
    Op.SQRT: "sqrt{f}({0})", Op.ABS: "fabs{f}({0})", Op.FLOOR: "floor{f}({0})", Op.EXPONENT: "logb{f}({0})",
    Op.SCALE: "ldexp{f}({0}, {1} == {1} ? (int){1} : 0)", Op.LT: "{0} < {1}", Op.LE: "{0} <= {1}",
    Op.EQ: "{0} == {1}", Op.AND: "{0} && {1}", Op.OR: "{0} || {1}", Op.NOT: "!{0}", Op.SELECT: "{0} ? {1} : {2}",
}  # fmt: skip
_TRUTH: Final = {Op.LT, Op.LE, Op.EQ, Op.AND, Op.OR, Op.NOT}
_FIRST: Final = {Op.MIN: "<", Op.MAX: ">"}


def prelude(precision: Precision, *programs: Program) -> str:
    """What the functions of these programs need: FUSED, and the elementary functions, those of machine code."""
    names = functions.needed(precision.numbers, *programs)
    fused = _FUSED.format(letter=precision.letter, suffix=precision.suffix)
    return fused + "".join(f"\n{_function(name, precision)}" for name in names)


_FUSED: Final = """\
/* FUSED rounds once where the processor can, as taut's machine code does; -DTAUT_EXACT asks for it anywhere. */
#if defined(FP_FAST_FMA{letter}) || defined(TAUT_EXACT)
#define FUSED(a, b, c) fma{suffix}((a), (b), (c))
#else
#define FUSED(a, b, c) ((a) * (b) + (c))
#endif
"""


def _function(name: str, precision: Precision) -> str:
    """An elementary function; of two results each has a pointer."""
    program, real = functions.function(name, precision.numbers), precision.real
    ends = program.output_nodes
    arguments = [f"{real} x{i}" for i in range(program.inputs.size)]
    arguments += [f"{real} *y{i}" for i in range(len(ends))] if len(ends) > 1 else []
    lines = list(_lines(program, precision, lambda _, offset: f"x{offset}"))
    values = [_value(program, precision, i) for i in ends]
    lines += [f"*y{i} = {v};" for i, v in enumerate(values)] if len(ends) > 1 else [f"return {values[0]};"]
    head = f"static {'void' if len(ends) > 1 else real} {name}({', '.join(arguments)})"
    return "\n".join([head, "{", *(f"    {line}" for line in lines), "}", ""])


def _value(program: Program, precision: Precision, i: int) -> str:
    x = program.graph.value[i]
    return f"v{i}" if x is None else precision.number(x)


def _lines(program: Program, precision: Precision, place: Place) -> Iterator[str]:
    """The lines that compute all nodes."""
    graph, p, within, paired = program.graph, precision, llvm.products_in_sums(program), set[int]()
    products, real = set(within.values()), precision.real

    def value(i: int) -> str:
        return _value(program, p, i)

    for i in program.live:
        op = Op(graph.ops[i])
        if op == Op.CONST or i in products:
            continue
        if op == Op.INPUT:
            text = place(*program.place_of_input(graph.a[i]))
        elif i in within:
            x = within[i]
            first, second, other = graph.a[x], graph.b[x], graph.b[i] if x == graph.a[i] else graph.a[i]
            minus = "-" if op == Op.SUB and x == graph.b[i] else "", "-" if op == Op.SUB and x == graph.a[i] else ""
            text = f"FUSED({minus[0]}{value(first)}, {value(second)}, {minus[1]}{value(other)})"
        elif op in (Op.SIN, Op.COS):
            a = graph.a[i]
            if a not in paired:
                paired.add(a)
                yield f"{real} s{a}, c{a};"
                yield f"{functions.NAMES[op]}({value(a)}, &s{a}, &c{a});"
            text = f"{'s' if op == Op.SIN else 'c'}{a}"
        elif op in functions.NAMES:
            text = f"{functions.NAMES[op]}({', '.join(value(x) for x in graph.operands(i))})"
        elif op in _FIRST:
            a, b = graph.operands(i)
            a, b = (b, a) if graph.value[b] is not None else (a, b)
            text = f"({value(a)} {_FIRST[op]} {value(b)}) ? {value(a)} : {value(b)}"
            if graph.value[a] is None:  # NaN if one is
                text = f"({value(a)} != {value(a)}) ? {value(a)} : ({text})"
        else:
            text = _OPERATION[op].format(*(value(x) for x in graph.operands(i)), f=p.suffix)
        yield f"const {'int' if op in _TRUTH else real} v{i} = {text};"


def body(program: Program, precision: Precision, place: Place) -> Iterator[str]:
    """The lines of a function that reads inputs, parameters and memory, and writes "new" memory and outputs last."""
    yield from _lines(program, precision, place)
    for block, nodes in (("new", program.memory_nodes), ("outputs", program.output_nodes)):
        for offset, i in enumerate(nodes):
            yield f"{place(block, offset)} = {_value(program, precision, i)};"


KEYWORDS: Final = frozenset(
    {
        "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern",
        "float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed",
        "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while",
        # of C++, which reads the header
        "alignas", "alignof", "and", "and_eq", "asm", "bitand", "bitor", "bool", "catch", "char16_t", "char32_t",
        "char8_t", "class", "co_await", "co_return", "co_yield", "compl", "concept", "const_cast", "consteval",
        "constexpr", "constinit", "decltype", "delete", "dynamic_cast", "explicit", "export", "false", "friend",
        "mutable", "namespace", "new", "noexcept", "not", "not_eq", "nullptr", "operator", "or", "or_eq", "private",
        "protected", "public", "reinterpret_cast", "requires", "static_assert", "static_cast", "template", "this",
        "thread_local", "throw", "true", "try", "typeid", "typename", "using", "virtual", "wchar_t", "xor", "xor_eq",
    }
)  # fmt: skip


class Struct:
    """A block as nested C structs, whose members are the parts of taut's paths."""

    def __init__(self, block: Block) -> None:
        self._fields = [field for field in block.fields if field.size]
        self._members = {field.path: [member(part) for part in field.path.split(".")] for field in self._fields}
        taken = Counter(map(tuple, self._members.values()))
        if any(count > 1 for count in taken.values()):
            names = [path for path, members in self._members.items() if taken[tuple(members)] > 1]
            raise UsageError(f"{' and '.join(names)} are one name in C; give one of them another", name=names[0])
        self._at = {field.offset + k: (field, k) for field in self._fields for k in range(field.size)}

    def __bool__(self) -> bool:
        return bool(self._fields)

    def place(self, offset: int) -> str:
        """The member that one double of the block is."""
        field, k = self._at[offset]
        index = "".join(f"[{i}]" for i in np.unravel_index(k, field.shape)) if field.shape else ""
        return ".".join(self._members[field.path]) + index

    def _tree(self) -> dict[str, Any]:
        tree: dict[str, Any] = {}
        for field in self._fields:
            *heads, last = self._members[field.path]
            node = tree
            for head in heads:
                node = node.setdefault(head, {})
            node[last] = field
        return tree

    def definition(self, name: str, real: str, notes: Mapping[str, str]) -> list[str]:
        """The struct, each member with its path and what is known of it."""

        def members(tree: Mapping[str, Any], indent: str) -> Iterator[str]:
            for member, node in tree.items():
                if isinstance(node, Field):
                    shape = "".join(f"[{size}]" for size in node.shape)
                    unit = f" [{notes[node.path]}]" if node.path in notes else ""
                    yield f"{indent}{real} {member}{shape};  /* {comment(node.path)}{unit} */"
                else:
                    yield from (f"{indent}struct {{", *members(node, indent + "    "), f"{indent}}} {member};")

        inside = list(members(self._tree(), "    ")) or [f"    {real} none;  /* this law has nothing here */"]
        return ["typedef struct {", *inside, f"}} {name};"]

    def paths(self) -> Iterator[tuple[str, str, int]]:
        """Each path, its member, and how many numbers it has."""
        for field in self._fields:
            yield comment(field.path), ".".join(self._members[field.path]), field.size

    def initial(self, flat: Float64Array, precision: Precision) -> str:
        """The initialiser of a struct with these numbers."""

        def array(values: Any) -> str:
            if isinstance(values, float):
                return precision.number(values)
            return "{" + ", ".join(array(value) for value in values) + "}"

        def members(tree: Mapping[str, Any]) -> str:
            texts = []
            for member, node in tree.items():
                if isinstance(node, Field):
                    part = flat[node.offset : node.offset + node.size].reshape(node.shape).tolist()
                    texts.append(f".{member} = {array(part)}")
                else:
                    texts.append(f".{member} = {members(node)}")
            return "{" + ", ".join(texts) + "}"

        return members(self._tree()) if self else "{" + precision.number(0.0) + "}"


def comment(text: str) -> str:
    """A text from outside, such as a name in a model's file, which neither ends a comment nor hides in it."""
    return printable(text).replace("*/", "* /")


def member(part: str) -> str:
    """A part of a path as a C identifier."""
    name = re.sub(r"\W", "_", part, flags=re.ASCII)
    return f"{name}_" if name in KEYWORDS else f"_{name}" if name[0].isdigit() else name
