"""LLVM: a program as LLVM intermediate representation, in text, and a writer of the small functions around it."""

from __future__ import annotations

import itertools
import math
import struct
from collections import Counter
from collections.abc import Sequence
from typing import Final

from taut.codegen.program import Program
from taut.trace.graph import BOOLEAN_OPS, LARGEST, NONE, Op

# A product and a sum are rounded once, together, where the processor can. Which of them is decided here and not by
# LLVM, so that code gives the same numbers at each of its levels.
#
# What jumps, or ends, at a value of its argument is an exception. All that goes into it is computed as in Python, to
# the last bit: fused, x x - y y of equal x and y is not zero but +-1e-17, and its root NaN. A sum of squares is none.
_DECIDING: Final = frozenset(
    {Op.SQRT, Op.LOG, Op.ASIN, Op.ACOS, Op.ATAN2, Op.FLOOR, Op.LT, Op.LE, Op.EQ},
)
BLOCK_LINES: Final = 200  # LLVM's quick level takes a time that grows with the square of a block's length
LIBM: Final = ("asin", "acos", "atan2", "log", "tanh")

_OPERATION: Final = {
    Op.ADD: "fadd double {0}, {1}",
    Op.SUB: "fsub double {0}, {1}",
    Op.MUL: "fmul double {0}, {1}",
    Op.DIV: "fdiv double {0}, {1}",
    Op.NEG: "fneg double {0}",
    Op.SQRT: "call double @llvm.sqrt.f64(double {0})",
    Op.ABS: "call double @llvm.fabs.f64(double {0})",
    Op.FLOOR: "call double @llvm.floor.f64(double {0})",
    Op.ASIN: "call double @asin(double {0})",
    Op.ACOS: "call double @acos(double {0})",
    Op.ATAN2: "call double @atan2(double {0}, double {1})",
    Op.EXP: "call double @expo(double {0})",
    Op.LOG: "call double @log(double {0})",
    Op.TANH: "call double @tanh(double {0})",
    Op.LT: "fcmp olt double {0}, {1}",
    Op.LE: "fcmp ole double {0}, {1}",
    Op.EQ: "fcmp oeq double {0}, {1}",
    Op.AND: "and i1 {0}, {1}",
    Op.OR: "or i1 {0}, {1}",
    Op.NOT: "xor i1 {0}, true",
    Op.SELECT: "select i1 {0}, double {1}, double {2}",
}
_FIRST: Final = {Op.MIN: "olt", Op.MAX: "ogt"}

# Sine and cosine from + - * floor: Cody and Waite reduction by pi/2 in three parts, then fdlibm's kernels.
# 1 ulp of the result for |x| < 1e6, 1 ulp of x beyond, NaN beyond 2^50, where a double has lost the angle. Faster
# than libm, the same everywhere, and in lanes.
FARTHEST: Final = 2.0**50
PI_HALF: Final = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
SIN: Final = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
COS: Final = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)

# The exponential: 2^k times fdlibm's rational approximation on |r| <= ln(2) / 2. Within 1 ulp; a call of libm costs
# twice the time, and has every register saved around it.
_LN2: Final = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
_EXP: Final = (
    1.66666666666666019037e-01,
    -2.77777777770155933842e-03,
    6.61375632143793436117e-05,
    -1.65339022054652515390e-06,
    4.13813679705723846039e-08,
)
_EXP_ENDS: Final = (-746.0, 710.0)  # beyond them it is 0, and infinite


def number(value: float) -> str:
    """A double as LLVM writes it exactly."""
    return "0x" + struct.pack(">d", value).hex().upper()


def _multiplied(name: str, a: str, b: str, c: str, *, less: bool = False, minus: bool = False) -> list[str]:
    """Lines that compute a b + c; c - a b where that is to be `less`, a b - c with `minus`."""
    lines = []
    if less:
        lines, a = [f" {name}.n = fneg double {a}"], f"{name}.n"
    if minus:
        lines, c = [f" {name}.n = fneg double {c}"], f"{name}.n"
    return [*lines, f" {name} = call double @llvm.fmuladd.f64(double {a}, double {b}, double {c})"]


def declarations() -> str:
    """Declarations and definitions of the functions that kernels call."""
    one = [f"declare double @llvm.{name}.f64(double)" for name in ("sqrt", "fabs", "floor")]
    libm = [f"declare double @{name}(double{', double' if name == 'atan2' else ''}) #0" for name in LIBM]
    whole = "declare i64 @llvm.fptosi.sat.i64.f64(double)\ndeclare double @llvm.fmuladd.f64(double, double, double)"
    return "\n".join([*one, whole, *libm, _sincos(), _exp(), "attributes #0 = { nounwind willreturn memory(none) }"])


def _sincos() -> str:
    """A function {sin, cos} of one double, inlined where it is used."""
    lines = [
        "define internal { double, double } @sincos(double %x) alwaysinline {",
        *_multiplied("%shifted", "%x", number(0.6366197723675814), number(0.5)),
        " %k = call double @llvm.floor.f64(double %shifted)",
    ]
    before = "%x"
    for i, part in enumerate(PI_HALF):
        lines += _multiplied(f"%r{i}", "%k", number(part), before, less=True)
        before = f"%r{i}"
    lines += [
        " %far = call double @llvm.fabs.f64(double %x)",
        f" %near = fcmp olt double %far, {number(FARTHEST)}",
        f" %r = select i1 %near, double %r2, double {number(math.nan)}",
        " %z = fmul double %r, %r",
    ]
    for name, table in (("s", SIN), ("c", COS)):
        lines += _polynomial(f"%{name}a", "%z", table)
    lines += [
        " %rz = fmul double %r, %z",
        *_multiplied("%sr", "%rz", "%sa0", "%r"),
        " %zz = fmul double %z, %z",
        *_multiplied("%one", "%z", number(0.5), number(1.0), less=True),
        *_multiplied("%cr", "%zz", "%ca0", "%one"),
        # Quadrant k mod 4: odd quadrants swap sine and cosine, then signs follow.
        f" %half = fmul double %k, {number(0.5)}",
        " %halffloor = call double @llvm.floor.f64(double %half)",
        " %odd = fcmp one double %half, %halffloor",
        f" %quarter = fmul double %halffloor, {number(0.5)}",
        " %quarterfloor = call double @llvm.floor.f64(double %quarter)",
        " %lower = fcmp one double %quarter, %quarterfloor",
        " %sabs = select i1 %odd, double %cr, double %sr",
        " %cabs = select i1 %odd, double %sr, double %cr",
        " %cneg = xor i1 %odd, %lower",
        " %sminus = fneg double %sabs",
        " %cminus = fneg double %cabs",
        " %sin = select i1 %lower, double %sminus, double %sabs",
        " %cos = select i1 %cneg, double %cminus, double %cabs",
        " %first = insertvalue { double, double } undef, double %sin, 0",
        " %both = insertvalue { double, double } %first, double %cos, 1",
        " ret { double, double } %both",
        "}",
    ]
    return "\n".join(lines)


def _polynomial(name: str, x: str, coefficients: Sequence[float]) -> list[str]:
    """Lines that compute {name}0, a polynomial of x by Horner's rule; its constant is the first coefficient."""
    lines, value = [], number(coefficients[-1])
    for i in range(len(coefficients) - 2, -1, -1):
        lines += _multiplied(f"{name}{i}", x, value, number(coefficients[i]))
        value = f"{name}{i}"
    return lines


def _exp() -> str:
    """A function of one double, inlined where it is used."""
    low, high = (number(end) for end in _EXP_ENDS)
    lines = [
        "define internal double @expo(double %x) alwaysinline {",
        f" %below = fcmp olt double %x, {low}",
        f" %raised = select i1 %below, double {low}, double %x",
        f" %above = fcmp ogt double %raised, {high}",
        f" %in = select i1 %above, double {high}, double %raised",  # NaN goes through
        f" %scaled = fmul double %in, {number(1.4426950408889634)}",
        f" %shifted = fadd double %scaled, {number(0.5)}",
        " %k = call double @llvm.floor.f64(double %shifted)",
        *_multiplied("%hi", "%k", number(_LN2[0]), "%in", less=True),
        f" %lo = fmul double %k, {number(_LN2[1])}",
        " %r = fsub double %hi, %lo",
        " %t = fmul double %r, %r",
        *_polynomial("%a", "%t", _EXP),
        *_multiplied("%c", "%t", "%a0", "%r", less=True),
        " %rc = fmul double %r, %c",
        f" %rest = fsub double {number(2.0)}, %c",
        " %part = fdiv double %rc, %rest",
        " %less = fsub double %lo, %part",
        " %minus = fsub double %less, %hi",
        f" %y = fsub double {number(1.0)}, %minus",
        # 2^k in two factors, so that neither leaves the range of doubles.
        " %whole = call i64 @llvm.fptosi.sat.i64.f64(double %k)",
        " %half = ashr i64 %whole, 1",
        " %other = sub i64 %whole, %half",
        " %biased1 = add i64 %half, 1023",
        " %biased2 = add i64 %other, 1023",
        " %bits1 = shl i64 %biased1, 52",
        " %bits2 = shl i64 %biased2, 52",
        " %factor1 = bitcast i64 %bits1 to double",
        " %factor2 = bitcast i64 %bits2 to double",
        " %once = fmul double %y, %factor1",
        " %twice = fmul double %once, %factor2",
        " ret double %twice",
        "}",
    ]
    return "\n".join(lines)


def kernel(program: Program, name: str, linkage: str = "") -> str:
    """`void name(inputs, parameters, memory, new memory, outputs)`, five pointers to doubles.

    All inputs are read before anything is written, so the new memory may be the old one.
    """
    lines = _Body(program).lines()
    parts = [lines[k : k + BLOCK_LINES] for k in range(0, len(lines), BLOCK_LINES)]
    blocks = ([f" br label %part{k}", f"part{k}:", *part] for k, part in enumerate(parts))
    pointers = ", ".join(f"ptr %{block}" for block in ("inputs", "parameters", "memory", "new", "outputs"))
    head = f"define {linkage} void @{name}({pointers}) nounwind {{"
    return "\n".join([head, *itertools.chain.from_iterable(blocks), " ret void", "}"])


def _never_negative(program: Program) -> set[int]:
    """Nodes that are sums of squares and the like: not negative, however they are rounded."""
    graph = program.graph
    found: set[int] = set()
    for i in program.live:
        op, a, b, c, value = graph.ops[i], graph.a[i], graph.b[i], graph.c[i], graph.value[i]
        if value is not None:
            positive = value >= 0.0
        elif op == Op.MUL:
            positive = a == b or (a in found and b in found)
        elif op in (Op.ADD, Op.DIV, Op.MIN):
            positive = a in found and b in found
        elif op == Op.MAX:
            positive = a in found or b in found
        elif op == Op.SELECT:
            positive = b in found and c in found
        else:
            positive = op in (Op.SQRT, Op.ABS, Op.EXP)
        if positive:
            found.add(i)
    return found


def products_in_sums(program: Program) -> dict[int, int]:
    """Sums with the product that is computed together with each: one that nothing else needs."""
    graph, positive = program.graph, _never_negative(program)

    def decides(i: int) -> bool:
        if graph.ops[i] == Op.SQRT:  # a length does not
            return graph.a[i] not in positive
        # nor does a comparison that only detects infinity, which rounding does not cause in practice
        return graph.ops[i] in _DECIDING and not (graph.ops[i] == Op.LE and graph.value[graph.b[i]] == LARGEST)

    exact = frozenset(graph.live(x for i in program.live if decides(i) for x in graph.operands(i)))
    uses = Counter((*program.output_nodes, *program.memory_nodes))
    for i in program.live:
        uses.update(graph.operands(i))
    out: dict[int, int] = {}
    for i in program.live:
        if graph.ops[i] in (Op.ADD, Op.SUB) and i not in exact:
            for x in (graph.a[i], graph.b[i]):
                if graph.ops[x] == Op.MUL and uses[x] == 1:
                    out[i] = x
                    break
    return out


class _Body:
    """The straight-line code of one program."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._graph = program.graph
        self._out: list[str] = []
        self._paired: set[int] = set()  # arguments whose sine and cosine stand already
        self._within = products_in_sums(program)

    def lines(self) -> list[str]:
        products = set(self._within.values())
        for i in self._program.live:
            op = self._graph.ops[i]
            if i in self._within:
                self._sum_with_product(i, self._within[i])
            elif op == Op.INPUT:
                self._input(i)
            elif op in (Op.SIN, Op.COS):
                self._sine_or_cosine(i)
            elif op in _FIRST:
                self._extremum(i)
            elif op != Op.CONST and i not in products:
                operands = (self._value(x) for x in self._graph.operands(i))
                self._out.append(f" %v{i} = {_OPERATION[Op(op)].format(*operands)}")
        self._stores("new", self._program.memory_nodes)
        self._stores("outputs", self._program.output_nodes)
        return self._out

    def _value(self, i: int) -> str:
        value = self._graph.value[i]
        return f"%v{i}" if value is None else number(value)

    def _input(self, i: int) -> None:
        block, offset = self._program.place_of_input(self._graph.a[i])
        self._out += [
            f" %p{i} = getelementptr double, ptr %{block}, i64 {offset}",
            f" %v{i} = load double, ptr %p{i}",
        ]

    def _sum_with_product(self, i: int, product: int) -> None:
        graph = self._graph
        a, b, less = graph.a[i], graph.b[i], graph.ops[i] == Op.SUB
        other = b if product == a else a
        x, y, c = (self._value(k) for k in (graph.a[product], graph.b[product], other))
        self._out += _multiplied(f"%v{i}", x, y, c, less=less and product == b, minus=less and product == a)

    def _extremum(self, i: int) -> None:
        """The smaller or larger of two, NaN if one is: LLVM's own function takes twice the time to order zeros."""
        a, b = self._graph.operands(i)
        a, b = (b, a) if self._graph.value[b] is not None else (a, b)
        x, y, name = self._value(a), self._value(b), f"%v{i}"
        known = self._graph.value[a] is not None  # a constant is never NaN
        better = name if known else f"{name}.m"
        self._out += [
            f" {name}.f = fcmp {_FIRST[Op(self._graph.ops[i])]} double {x}, {y}",
            f" {better} = select i1 {name}.f, double {x}, double {y}",
        ]
        if not known:
            self._out += [
                f" {name}.n = fcmp uno double {x}, {x}",
                f" {name} = select i1 {name}.n, double {x}, double {better}",
            ]

    def _sine_or_cosine(self, i: int) -> None:
        a = self._graph.a[i]
        if a not in self._paired:
            self._paired.add(a)
            self._out += [f" %t{a} = call {{ double, double }} @sincos(double {self._value(a)})"]
        part = 0 if self._graph.ops[i] == Op.SIN else 1
        self._out.append(f" %v{i} = extractvalue {{ double, double }} %t{a}, {part}")

    def _stores(self, block: str, nodes: tuple[int, ...]) -> None:
        for offset, i in enumerate(nodes):
            assert i != NONE
            assert self._graph.ops[i] not in BOOLEAN_OPS
            self._out += [
                f" %{block}{offset} = getelementptr double, ptr %{block}, i64 {offset}",
                f" store double {self._value(i)}, ptr %{block}{offset}",
            ]


class Writer:
    """Collects the lines of one function; every value gets a name of its own."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0

    def name(self) -> str:
        """A fresh name for a value."""
        self._count += 1
        return f"%x{self._count}"

    def put(self, text: str) -> str:
        """A line that computes a value, and the value's name."""
        name = self.name()
        self.lines.append(f" {name} = {text}")
        return name

    def line(self, *lines: str) -> None:
        """Lines as they are."""
        self.lines += lines

    def function(self, head: str) -> str:
        """The lines so far as the body of a function."""
        text = "\n".join([f"define {head} {{", *self.lines, "}"])
        self.lines = []
        return text

    def unless(self, wrong: str, target: str) -> None:
        """Leave for the label `target` if a condition is true."""
        after = self.name()[1:]
        self.line(f" br i1 {wrong}, label %{target}, label %{after}", f"{after}:")

    def load_at(self, owner: str, offset: int, kind: str = "ptr") -> str:
        """The value `offset` bytes behind a pointer."""
        place = self.put(f"getelementptr i8, ptr {owner}, i64 {offset}")
        return self.put(f"load {kind}, ptr {place}")

    def copy(self, source: str, target: str, size: int) -> None:
        """Copy `size` doubles."""
        for start, width in _pieces(size):
            kind = "double" if width == 1 else f"<{width} x double>"
            read = self.put(f"getelementptr double, ptr {source}, i64 {start}")
            value = self.put(f"load {kind}, ptr {read}, align 8")
            write = self.put(f"getelementptr double, ptr {target}, i64 {start}")
            self.line(f" store {kind} {value}, ptr {write}, align 8")

    def not_finite(self, block: str, size: int) -> str | None:
        """A truth value: whether a block has NaN or infinity in it (x - x is not zero); None for an empty block."""
        differences: dict[int, list[str]] = {4: [], 1: []}
        for start, width in _pieces(size):
            kind = "double" if width == 1 else f"<{width} x double>"
            place = self.put(f"getelementptr double, ptr {block}, i64 {start}")
            value = self.put(f"load {kind}, ptr {place}, align 8")
            differences[width].append(self.put(f"fsub {kind} {value}, {value}"))
        if differences[4]:
            total = self._sum("<4 x double>", differences[4])
            differences[1] += [self.put(f"extractelement <4 x double> {total}, i64 {i}") for i in range(4)]
        if not differences[1]:
            return None
        return self.put(f"fcmp une double {self._sum('double', differences[1])}, 0.0")

    def _sum(self, kind: str, values: list[str]) -> str:
        """The sum of some values, by halves, so that no addition waits for all before it."""
        if len(values) == 1:
            return values[0]
        half = len(values) // 2
        return self.put(f"fadd {kind} {self._sum(kind, values[:half])}, {self._sum(kind, values[half:])}")


def _pieces(size: int) -> list[tuple[int, int]]:
    """A length as pieces of four doubles and single ones: (start, width)."""
    whole = size - size % 4
    return [(start, 4) for start in range(0, whole, 4)] + [(start, 1) for start in range(whole, size)]
