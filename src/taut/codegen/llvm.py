"""LLVM: a program as LLVM intermediate representation, in text, and a writer of the small functions around it."""

from __future__ import annotations

import itertools
import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from taut.codegen.functions import DOUBLE, FUNCTIONS, NAMES, Real, function
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
WARP: Final = 32  # threads of a GPU that go together, and whose numbers stand side by side in blocks
CACHE_LINE: Final = 64  # bytes: as wide as the widest numbers in lanes

_OPERATION: Final = {  # of numbers {t}, called {s}, and truth values {b}
    Op.ADD: "fadd {t} {0}, {1}",
    Op.SUB: "fsub {t} {0}, {1}",
    Op.MUL: "fmul {t} {0}, {1}",
    Op.DIV: "fdiv {t} {0}, {1}",
    Op.NEG: "fneg {t} {0}",
    Op.SQRT: "call {t} @llvm.sqrt.{s}({t} {0})",
    Op.ABS: "call {t} @llvm.fabs.{s}({t} {0})",
    Op.FLOOR: "call {t} @llvm.floor.{s}({t} {0})",
    Op.LT: "fcmp olt {t} {0}, {1}",
    Op.LE: "fcmp ole {t} {0}, {1}",
    Op.EQ: "fcmp oeq {t} {0}, {1}",
    Op.AND: "and {b} {0}, {1}",
    Op.OR: "or {b} {0}, {1}",
    Op.NOT: "xor {b} {0}, {true}",
    Op.SELECT: "select {b} {0}, {t} {1}, {t} {2}",
}
_FIRST: Final = {Op.MIN: "olt", Op.MAX: "ogt"}


def number(value: float) -> str:
    """A double as LLVM writes it exactly."""
    return "0x" + struct.pack(">d", value).hex().upper()


@dataclass(frozen=True)
class Lanes:
    """What one instruction computes with: a number, or several side by side; blocks have their numbers so too."""

    count: int = 1
    real: Real = DOUBLE
    thread: bool = False  # of a GPU: one number, and many threads side by side

    def of(self, kind: str) -> str:
        """A type of LLVM in all lanes."""
        return kind if self.count == 1 else f"<{self.count} x {kind}>"

    def cell(self, kind: str) -> str:
        """A number of all lanes in a block, or in threads the room of those of a warp."""
        return f"[{WARP} x {kind}]" if self.thread else self.of(kind)

    @property
    def side(self) -> int:
        """Lanes whose numbers stand side by side in blocks."""
        return WARP if self.thread else self.count

    def same(self, kind: str, value: str) -> str:
        """A constant that is the same in all lanes."""
        return value if self.count == 1 else f"splat ({kind} {value})"

    @property
    def type(self) -> str:
        """The type of numbers."""
        return self.of(self.real.name)

    @property
    def align(self) -> int:
        """Bytes of one number, at multiples of which all stand."""
        return self.real.dtype().itemsize

    @property
    def name(self) -> str:
        """The type of numbers in the names of LLVM's functions."""
        return f"{f'v{self.count}' if self.count > 1 else ''}f{8 * self.align}"

    def number(self, value: float) -> str:
        """A constant."""
        return self.same(self.real.name, number(self.real.rounded(value)))

    @property
    def attributes(self) -> str:
        """Of a function: LLVM would let the widest numbers lie across two cache lines on the stack."""
        wide = self.count * self.align >= CACHE_LINE
        return f'nounwind alignstack({CACHE_LINE}) "stackrealign"' if wide else "nounwind"


ONE: Final = Lanes()


def spread(name: str, value: str, kind: str, lanes: Lanes) -> list[str]:
    """Lines that give one value to all lanes."""
    if lanes.count == 1:
        return [f" {name} = bitcast {kind} {value} to {kind}"]
    wide = lanes.of(kind)
    return [
        f" {name}.i = insertelement {wide} poison, {kind} {value}, i64 0",
        f" {name} = shufflevector {wide} {name}.i, {wide} poison, <{lanes.count} x i32> zeroinitializer",
    ]


def declarations(lanes: Lanes = ONE) -> str:
    """Declarations and definitions of the functions that kernels call."""
    t, s = lanes.type, lanes.name
    lines = [f"declare {t} @llvm.{name}.{s}({t})" for name in ("sqrt", "fabs", "floor")]
    lines.append(f"declare {t} @llvm.fmuladd.{s}({t}, {t}, {t})")
    return "\n".join([*lines, *(function_text(name, function(name, lanes.real), lanes) for name in FUNCTIONS)])


def function_text(name: str, program: Program, lanes: Lanes = ONE, fused: Mapping[int, int] | None = None) -> str:
    """A program of numbers as a function that is inlined where it is used; several results are a structure."""
    inputs = {program.graph.a[i]: i for i in program.live if program.graph.ops[i] == Op.INPUT}
    body = _Body(program, lanes, products_in_sums(program) if fused is None else fused)
    body.given |= set(inputs.values())
    arguments = ", ".join(f"{lanes.type} %v{inputs[k]}" for k in range(program.inputs.size))
    results = [f"{lanes.type} {body.value(i)}" for i in program.output_nodes]
    lines, kind = body.lines(), result_type(lanes, len(results))
    if len(results) == 1:
        lines.append(f" ret {results[0]}")
    else:
        for k, result in enumerate(results):
            lines.append(f" %r{k} = insertvalue {kind} {f'%r{k - 1}' if k else 'undef'}, {result}, {k}")
        lines.append(f" ret {kind} %r{len(results) - 1}")
    return "\n".join([f"define internal {kind} @{name}({arguments}) alwaysinline {{", *lines, "}"])


def result_type(lanes: Lanes, count: int) -> str:
    """The type of so many results of a function."""
    return lanes.type if count == 1 else f"{{ {', '.join([lanes.type] * count)} }}"


def kernel(program: Program, name: str, lanes: Lanes = ONE, fused: Mapping[int, int] | None = None) -> str:
    """`void name(inputs, parameters, memory, new memory, outputs)`, five pointers to numbers in lanes.

    All inputs are read before anything is written, so the new memory may be the old one. `fused` are sums with the
    product that is rounded with each, those of the program if left out: a part of a program is given those of all of
    it, so that it gives the same bits.
    """
    lines = _Body(program, lanes, products_in_sums(program) if fused is None else fused).kernel_lines()
    parts = [lines[k : k + BLOCK_LINES] for k in range(0, len(lines), BLOCK_LINES)]
    blocks = ([f" br label %part{k}", f"part{k}:", *part] for k, part in enumerate(parts))
    pointers = ", ".join(f"ptr %{block}" for block in ("inputs", "parameters", "memory", "new", "outputs"))
    head = f"define void @{name}({pointers}) {lanes.attributes} {{"
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

    def __init__(self, program: Program, lanes: Lanes, fused: Mapping[int, int]) -> None:
        self._program, self._graph, self._lanes = program, program.graph, lanes
        live = set(program.live)
        self._within = {i: product for i, product in fused.items() if i in live}
        self._out: list[str] = []
        self._cell = lanes.cell(lanes.real.name)
        self._paired: set[int] = set()  # arguments whose sine and cosine stand already
        self.given: set[int] = set()  # nodes that are there already
        self._common = {
            "t": lanes.type, "s": lanes.name, "b": lanes.of("i1"), "true": lanes.same("i1", "true"),
        }  # fmt: skip

    def kernel_lines(self) -> list[str]:
        """The lines of a kernel."""
        self.lines()
        self._stores("new", self._program.memory_nodes)
        self._stores("outputs", self._program.output_nodes)
        return self._out

    def lines(self) -> list[str]:
        """The lines that compute all nodes."""
        graph, alone = self._graph, self._needed_alone()
        for i in self._program.live:
            op = Op(graph.ops[i])
            if i in self.given or op == Op.CONST or i not in alone:
                continue
            if i in self._within:
                self._sum_with_product(i, self._within[i])
            elif op == Op.INPUT:
                self._input(i)
            elif op in NAMES:
                self._function(i, op)
            elif op in _FIRST:
                self._extremum(i)
            elif op == Op.SCALE:
                self._scaled(i)
            elif op == Op.EXPONENT:
                self._exponent(i)
            else:
                operands = (self.value(x) for x in graph.operands(i))
                self._put(i, _OPERATION[op].format(*operands, **self._common))
        return self._out

    def _needed_alone(self) -> set[int]:
        """The nodes that something needs besides the sums in which they are the product."""
        needed = {*self._program.output_nodes, *self._program.memory_nodes}
        for i in self._program.live:
            operands = list(self._graph.operands(i))
            if i in self._within:
                operands.remove(self._within[i])
                operands += self._graph.operands(self._within[i])
            needed.update(operands)
        return needed

    def value(self, i: int) -> str:
        """A node as an operand."""
        value = self._graph.value[i]
        return f"%v{i}" if value is None else self._lanes.number(value)

    def _put(self, i: int, text: str) -> None:
        self._out.append(f" %v{i} = {text}")

    def _input(self, i: int) -> None:
        block, offset = self._program.place_of_input(self._graph.a[i])
        self._out.append(f" %p{i} = getelementptr {self._cell}, ptr %{block}, i64 {offset}")
        self._put(i, f"load {self._lanes.type}, ptr %p{i}, align {self._lanes.align}")

    def _sum_with_product(self, i: int, product: int) -> None:
        """a b + c; c - a b where the product is taken away, a b - c where the other is."""
        graph, t = self._graph, self._lanes.type
        less = graph.ops[i] == Op.SUB
        x, y = graph.operands(product)
        other = graph.b[i] if product == graph.a[i] else graph.a[i]
        a, b, c = self.value(x), self.value(y), self.value(other)
        if less:
            self._out.append(f" %v{i}.n = fneg {t} {a if product == graph.b[i] else c}")
            a, c = (f"%v{i}.n", c) if product == graph.b[i] else (a, f"%v{i}.n")
        self._put(i, f"call {t} @llvm.fmuladd.{self._lanes.name}({t} {a}, {t} {b}, {t} {c})")

    def _extremum(self, i: int) -> None:
        """The smaller or larger of two, NaN if one is: LLVM's own function takes twice the time to order zeros."""
        a, b = self._graph.operands(i)
        a, b = (b, a) if self._graph.value[b] is not None else (a, b)
        x, y, t, truth = self.value(a), self.value(b), self._lanes.type, self._lanes.of("i1")
        self._out.append(f" %v{i}.f = fcmp {_FIRST[Op(self._graph.ops[i])]} {t} {x}, {y}")
        if self._graph.value[a] is not None:  # a constant is never NaN
            self._put(i, f"select {truth} %v{i}.f, {t} {x}, {t} {y}")
            return
        self._out += [
            f" %v{i}.m = select {truth} %v{i}.f, {t} {x}, {t} {y}",
            f" %v{i}.n = fcmp uno {t} {x}, {x}",
        ]
        self._put(i, f"select {truth} %v{i}.n, {t} {x}, {t} %v{i}.m")

    def _function(self, i: int, op: Op) -> None:
        t, name = self._lanes.type, NAMES[op]
        arguments = ", ".join(f"{t} {self.value(x)}" for x in self._graph.operands(i))
        kind = result_type(self._lanes, function(name, self._lanes.real).outputs.size)
        if kind == t:
            self._put(i, f"call {t} @{name}({arguments})")
            return
        a = self._graph.a[i]
        if a not in self._paired:
            self._paired.add(a)
            self._out.append(f" %t{a} = call {kind} @{name}({arguments})")
        self._put(i, f"extractvalue {kind} %t{a}, {0 if op == Op.SIN else 1}")

    def _scaled(self, i: int) -> None:
        """x 2^k in two factors, so that neither leaves the range of numbers, made in the bits of the exponent."""
        lanes, real, v = self._lanes, self._lanes.real, f"%v{i}"
        bits = f"i{8 * lanes.align}"
        t, whole, shift = lanes.type, lanes.of(bits), lanes.same(bits, str(real.digits - 1))
        x, k = (self.value(a) for a in self._graph.operands(i))
        self._out += [
            f" {v}.q = fmul {t} {k}, {lanes.number(0.5)}",
            f" {v}.0 = call {t} @llvm.floor.{lanes.name}({t} {v}.q)",
            f" {v}.1 = fsub {t} {k}, {v}.0",
        ]
        for part in range(2):
            value = x if part == 0 else f"{v}.p0"
            self._out += [  # the sum has the whole number in its last bits
                f" {v}.s{part} = fadd {t} {v}.{part}, {lanes.number(1.5 * 2.0 ** (real.digits - 1) + real.bias)}",
                f" {v}.b{part} = bitcast {t} {v}.s{part} to {whole}",
                f" {v}.e{part} = shl {whole} {v}.b{part}, {shift}",
                f" {v}.f{part} = bitcast {whole} {v}.e{part} to {t}",
                f" {v}{'.p0' if part == 0 else ''} = fmul {t} {value}, {v}.f{part}",
            ]

    def _exponent(self, i: int) -> None:
        """The bits of the exponent as the last bits of a number."""
        lanes, real, v = self._lanes, self._lanes.real, f"%v{i}"
        bits = f"i{8 * lanes.align}"
        t, whole, base = lanes.type, lanes.of(bits), 2.0 ** (real.digits - 1)
        pattern = int.from_bytes(real.dtype(base).tobytes(), "little")
        self._out += [
            f" {v}.b = bitcast {t} {self.value(self._graph.a[i])} to {whole}",
            f" {v}.e = lshr {whole} {v}.b, {lanes.same(bits, str(real.digits - 1))}",
            f" {v}.o = or {whole} {v}.e, {lanes.same(bits, str(pattern))}",
            f" {v}.f = bitcast {whole} {v}.o to {t}",
        ]
        self._put(i, f"fsub {t} {v}.f, {lanes.number(base + real.bias)}")

    def _stores(self, block: str, nodes: tuple[int, ...]) -> None:
        t = self._lanes.type
        for offset, i in enumerate(nodes):
            assert i != NONE
            assert self._graph.ops[i] not in BOOLEAN_OPS
            self._out += [
                f" %{block}{offset} = getelementptr {self._cell}, ptr %{block}, i64 {offset}",
                f" store {t} {self.value(i)}, ptr %{block}{offset}, align {self._lanes.align}",
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
            total = self.sum("<4 x double>", differences[4])
            differences[1] += [self.put(f"extractelement <4 x double> {total}, i64 {i}") for i in range(4)]
        if not differences[1]:
            return None
        return self.put(f"fcmp une double {self.sum('double', differences[1])}, 0.0")

    def sum(self, kind: str, values: list[str]) -> str:
        """The sum of some values, by halves, so that no addition waits for all before it."""
        if len(values) == 1:
            return values[0]
        half = len(values) // 2
        return self.put(f"fadd {kind} {self.sum(kind, values[:half])}, {self.sum(kind, values[half:])}")


def _pieces(size: int) -> list[tuple[int, int]]:
    """A length as pieces of four doubles and single ones: (start, width)."""
    whole = size - size % 4
    return [(start, 4) for start in range(0, whole, 4)] + [(start, 1) for start in range(whole, size)]
