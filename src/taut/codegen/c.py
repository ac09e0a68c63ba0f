"""C99: blocks as structs, a program as the text of a function, from the same nodes as machine code."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.errors import UsageError, printable
from taut.base.types import Float64Array
from taut.codegen import llvm
from taut.codegen.program import Block, Field, Program
from taut.trace.graph import Op

Place = Callable[[str, int], str]
"""The C expression of a double in a block: `in->q[3]` for ("inputs", 4)."""
_SINGLE: Final = np.finfo(np.float32)


@dataclass(frozen=True, kw_only=True)
class Precision:
    """The C type of all numbers, and the constants of sine and cosine in it."""

    real: str
    suffix: str  # of functions of math.h
    letter: str  # of constants
    pi_half: Sequence[float]
    sin: Sequence[float]
    cos: Sequence[float]
    farthest: float

    def number(self, value: float) -> str:
        """A constant, exactly; in single precision the nearest that is neither infinite nor zero."""
        if self.real == "float":
            least, most = float(_SINGLE.tiny), float(_SINGLE.max)
            value = math.copysign(min(max(abs(value), least), most), value) if value else value
            value = float(np.float32(value))
        text = value.hex() + self.letter
        return f"({text})" if value < 0.0 else text


DOUBLE: Final = Precision(
    real="double", suffix="", letter="", pi_half=llvm.PI_HALF, sin=llvm.SIN, cos=llvm.COS, farthest=llvm.FARTHEST
)
SINGLE: Final = Precision(  # Cody and Waite in parts of 8 to 11 bits, and the polynomials of Cephes
    real="float",
    suffix="f",
    letter="F",
    pi_half=(1.5703125, 4.837512969970703125e-4, 7.54978995489188216e-8),
    sin=(-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4),
    cos=(4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5),
    farthest=2.0**21,
)

_OPERATION: Final = {
    Op.ADD: "{0} + {1}", Op.SUB: "{0} - {1}", Op.MUL: "{0} * {1}", Op.DIV: "{0} / {1}", Op.NEG: "-{0}",
    Op.SQRT: "sqrt{f}({0})", Op.ABS: "fabs{f}({0})", Op.FLOOR: "floor{f}({0})", Op.ASIN: "asin{f}({0})",
    Op.ACOS: "acos{f}({0})", Op.ATAN2: "atan2{f}({0}, {1})", Op.EXP: "exp{f}({0})", Op.LOG: "log{f}({0})",
    Op.TANH: "tanh{f}({0})", Op.LT: "{0} < {1}", Op.LE: "{0} <= {1}", Op.EQ: "{0} == {1}", Op.AND: "{0} && {1}",
    Op.OR: "{0} || {1}", Op.NOT: "!{0}", Op.SELECT: "{0} ? {1} : {2}",
}  # fmt: skip
_TRUTH: Final = {Op.LT, Op.LE, Op.EQ, Op.AND, Op.OR, Op.NOT}
_FIRST: Final = {Op.MIN: "<", Op.MAX: ">"}


def prelude(precision: Precision, *programs: Program) -> str:
    """What the functions of these programs need: FUSED, and sine and cosine, which are those of machine code."""
    p = precision
    turns = any(program.graph.ops[i] in (Op.SIN, Op.COS) for program in programs for i in program.live)
    return _FUSED.format(letter=p.letter, suffix=p.suffix) + (_sine_cosine(p) if turns else "")


_FUSED: Final = """\
/* FUSED rounds once where the processor can, as taut's machine code does; -DTAUT_EXACT asks for it anywhere. */
#if defined(FP_FAST_FMA{letter}) || defined(TAUT_EXACT)
#define FUSED(a, b, c) fma{suffix}((a), (b), (c))
#else
#define FUSED(a, b, c) ((a) * (b) + (c))
#endif
"""


def _sine_cosine(p: Precision) -> str:
    return f"""
/* Cody and Waite reduction by pi/2 in three parts, then a polynomial; NaN where the angle is lost. */
static void sine_cosine({p.real} x, {p.real} *s, {p.real} *c)
{{
    const {p.real} k = floor{p.suffix}(FUSED(x, {p.number(0.6366197723675814)}, {p.number(0.5)}));
    const {p.real} r0 = FUSED(-k, {p.number(p.pi_half[0])}, x);
    const {p.real} r1 = FUSED(-k, {p.number(p.pi_half[1])}, r0);
    const {p.real} r2 = FUSED(-k, {p.number(p.pi_half[2])}, r1);
    const {p.real} r = fabs{p.suffix}(x) < {p.number(p.farthest)} ? r2 : ({p.real})NAN;
    const {p.real} z = r * r;
    const {p.real} sr = FUSED(r * z, {_polynomial(p, p.sin)}, r);
    const {p.real} cr = FUSED(z * z, {_polynomial(p, p.cos)}, FUSED(-z, {p.number(0.5)}, {p.number(1.0)}));
    const {p.real} half = k * {p.number(0.5)};
    const {p.real} whole = floor{p.suffix}(half);
    const {p.real} quarter = whole * {p.number(0.5)};
    const int odd = half > whole;
    const int lower = quarter > floor{p.suffix}(quarter);
    const {p.real} sa = odd ? cr : sr;
    const {p.real} ca = odd ? sr : cr;
    *s = lower ? -sa : sa;
    *c = (odd != lower) ? -ca : ca;
}}
"""


def _polynomial(precision: Precision, coefficients: Sequence[float]) -> str:
    text = precision.number(coefficients[-1])
    for x in reversed(coefficients[:-1]):
        text = f"FUSED(z, {text}, {precision.number(x)})"
    return text


def body(program: Program, precision: Precision, place: Place) -> Iterator[str]:
    """The lines of a function that reads inputs, parameters and memory, and writes "new" memory and outputs last."""
    graph, p, within, paired = program.graph, precision, llvm.products_in_sums(program), set[int]()
    products, real = set(within.values()), precision.real

    def value(i: int) -> str:
        x = graph.value[i]
        return f"v{i}" if x is None else p.number(x)

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
                yield f"sine_cosine({value(a)}, &s{a}, &c{a});"
            text = f"{'s' if op == Op.SIN else 'c'}{a}"
        elif op in _FIRST:
            a, b = graph.operands(i)
            a, b = (b, a) if graph.value[b] is not None else (a, b)
            text = f"({value(a)} {_FIRST[op]} {value(b)}) ? {value(a)} : {value(b)}"
            if graph.value[a] is None:  # NaN if one is
                text = f"({value(a)} != {value(a)}) ? {value(a)} : ({text})"
        else:
            text = _OPERATION[op].format(*(value(x) for x in graph.operands(i)), f=p.suffix)
        yield f"const {'int' if op in _TRUTH else real} v{i} = {text};"
    for block, nodes in (("new", program.memory_nodes), ("outputs", program.output_nodes)):
        for offset, i in enumerate(nodes):
            yield f"{place(block, offset)} = {value(i)};"


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
