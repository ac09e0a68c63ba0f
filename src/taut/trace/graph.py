"""Graph: the straight-line program that tracing yields, of operations on earlier nodes.

Equal nodes are one (hash-consing); constants, zeros, ones and signs are folded, exact to the last bit but for three
rules that make sparse arms cheap: 0 x = 0, 0 / x = 0 and x - x = 0 also where x is infinite, NaN or a divisor of
zero. Zero has no sign. Nodes that nothing needs are dropped when a target reads the graph.
"""

from __future__ import annotations

import math
import operator
import sys
from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from typing import Any, Final

import numpy as np

from taut.base.errors import TraceError, user_location
from taut.base.types import Float64Array

NONE: Final = -1  # the operand of a node that has fewer than three
LARGEST: Final = sys.float_info.max  # |x| <= LARGEST: x is neither infinite nor NaN


class Op(IntEnum):
    """The operations of a graph. Comparisons and logic give a truth value, all others a number."""

    CONST = 0
    INPUT = 1
    ADD = 2
    SUB = 3
    MUL = 4
    DIV = 5
    NEG = 6
    SQRT = 7
    SIN = 8
    COS = 9
    ASIN = 10
    ACOS = 11
    ATAN2 = 12
    EXP = 13
    LOG = 14
    TANH = 15
    ABS = 16
    FLOOR = 17
    MIN = 18
    MAX = 19
    SELECT = 20  # a if c else b, with the condition first
    LT = 21
    LE = 22
    EQ = 23
    AND = 24
    OR = 25
    NOT = 26
    SCALE = 27  # a 2^b for a whole b; of the functions of codegen, as the next one: law code has neither
    EXPONENT = 28  # the whole k with 2^k <= a < 2^(k+1), of a normal number a > 0


BOOLEAN_OPS: Final = frozenset({Op.LT, Op.LE, Op.EQ, Op.AND, Op.OR, Op.NOT})

# Plain ints: an enum member costs a dictionary look-up more at each of a few thousand nodes.
CONST, INPUT, ADD, SUB, MUL, DIV, NEG = (int(op) for op in list(Op)[:7])
SELECT, MIN, MAX, NOT = int(Op.SELECT), int(Op.MIN), int(Op.MAX), int(Op.NOT)
ABS, AND, OR = int(Op.ABS), int(Op.AND), int(Op.OR)

COMPARISONS: Final = (int(Op.LT), int(Op.LE), int(Op.EQ))


class Graph:
    """A program under construction. Node numbers grow, so operands always come before their node."""

    __slots__ = ("a", "b", "c", "n_inputs", "n_placeholders", "ops", "table", "value")

    def __init__(self) -> None:
        self.ops: list[int] = []
        self.a: list[int] = []
        self.b: list[int] = []
        self.c: list[int] = []
        self.value: list[float | None] = []  # of a constant; a truth value is 0.0 or 1.0
        self.table: dict[tuple[int, int, int, int] | float, int] = {}
        self.n_inputs = 0
        self.n_placeholders = 0

    def __len__(self) -> int:
        return len(self.ops)

    def _append(self, op: int, a: int, b: int, c: int, value: float | None) -> int:
        i = len(self.ops)
        self.ops.append(op)
        self.a.append(a)
        self.b.append(b)
        self.c.append(c)
        self.value.append(value)
        return i

    def node(self, op: int, a: int, b: int = NONE, c: int = NONE) -> int:
        """The node of this operation on these operands, new or known."""
        key = (op, a, b, c)
        i = self.table.get(key)
        if i is None:
            i = self.table[key] = self._append(op, a, b, c, None)
        return i

    def const(self, value: float) -> int:
        """The node of a constant."""
        i = self.table.get(value)
        if i is None:
            value = float(value) + 0.0  # -0.0 and 0.0 are one constant
            if math.isnan(value):
                raise TraceError(
                    f"a constant in the law is NaN at {user_location()}; every number in it must be one",
                    value=value,
                    rule="no NaN",
                )
            i = self.table.get(value)
            if i is None:
                i = self.table[value] = self._append(CONST, NONE, NONE, NONE, value)
        return i

    def input(self) -> int:
        """A new input node."""
        i = self._append(INPUT, self.n_inputs, NONE, NONE, None)
        self.n_inputs += 1
        return i

    def placeholder(self) -> int:
        """A node that stands for a number to be put in later, when a derivative is taken."""
        self.n_placeholders += 1
        return self._append(INPUT, -self.n_placeholders, NONE, NONE, None)

    def add(self, a: int, b: int) -> int:
        va, vb = self.value[a], self.value[b]
        if va is not None:
            if vb is not None:
                return self.const(va + vb)
            if va == 0.0:
                return b
        elif vb == 0.0:
            return a
        if self.ops[b] == NEG:
            return self.sub(a, self.a[b])
        if self.ops[a] == NEG:
            return self.sub(b, self.a[a])
        return self.node(ADD, a, b) if a < b else self.node(ADD, b, a)

    def sub(self, a: int, b: int) -> int:
        va, vb = self.value[a], self.value[b]
        if va is not None:
            if vb is not None:
                return self.const(va - vb)
            if va == 0.0:
                return self.neg(b)
        elif vb == 0.0:
            return a
        if a == b:
            return self.const(0.0)
        if self.ops[b] == NEG:
            return self.add(a, self.a[b])
        if self.ops[a] == NEG:
            return self.neg(self.add(self.a[a], b))
        return self.node(SUB, a, b)

    def neg(self, a: int) -> int:
        value = self.value[a]
        if value is not None:
            return self.const(-value)
        op = self.ops[a]
        if op == NEG:
            return self.a[a]
        if op == SUB:
            return self.node(SUB, self.b[a], self.a[a])
        return self.node(NEG, a)

    def mul(self, a: int, b: int) -> int:
        va, vb = self.value[a], self.value[b]
        if va is not None:
            if vb is not None:
                return self.const(va * vb)
            a, b, va, vb = b, a, vb, va
        if vb is not None:
            if vb == 0.0:
                return b
            if vb == 1.0:
                return a
            if vb == -1.0:
                return self.neg(a)
            if self.ops[a] == NEG:
                return self.node(MUL, self.a[a], self.const(-vb))
            return self.node(MUL, a, b)
        negative = False
        if self.ops[a] == NEG:
            a, negative = self.a[a], True
        if self.ops[b] == NEG:
            b, negative = self.a[b], not negative
        product = self.node(MUL, a, b) if a < b else self.node(MUL, b, a)
        return self.node(NEG, product) if negative else product

    def div(self, a: int, b: int) -> int:
        va, vb = self.value[a], self.value[b]
        if vb is not None:
            if vb == 0.0:
                raise TraceError(
                    f"the law divides by a constant zero at {user_location()}",
                    rule="no division by zero",
                )
            if va is not None:
                return self.const(va / vb)
            if vb == 1.0:
                return a
            if math.frexp(vb)[0] in (0.5, -0.5) and math.isfinite(1.0 / vb):
                return self.mul(a, self.const(1.0 / vb))  # a power of two: the product is exact and cheaper
        if va == 0.0:
            return a
        negative = False
        if self.ops[a] == NEG:
            a, negative = self.a[a], True
        if self.ops[b] == NEG:
            b, negative = self.a[b], not negative
        quotient = self.node(DIV, a, b)
        return self.node(NEG, quotient) if negative else quotient

    def unary(self, op: int, a: int) -> int:
        """sqrt, sin, cos and the other functions of one number."""
        value = self.value[a]
        if value is not None:
            with np.errstate(all="ignore"):
                result = float(_VALUES[op](value))
            if not math.isfinite(result):
                raise TraceError(
                    f"the law takes {Op(op).name.lower()}({value!r}) at {user_location()}, which is no number",
                    value=value,
                )
            return self.const(result)
        if op == ABS and self.ops[a] in (ABS, NEG):
            a = self.a[a]
        return self.node(op, a)

    def atan2(self, y: int, x: int) -> int:
        vy, vx = self.value[y], self.value[x]
        if vy is not None and vx is not None:
            return self.const(math.atan2(vy, vx))
        return self.node(int(Op.ATAN2), y, x)

    def extremum(self, op: int, a: int, b: int) -> int:
        """MIN or MAX."""
        if a == b:
            return a
        va, vb = self.value[a], self.value[b]
        if va is not None and vb is not None:
            return self.const(float(_VALUES[op](va, vb)))
        neutral = math.inf if op == MIN else -math.inf
        if va == neutral:
            return b
        if vb == neutral:
            return a
        return self.node(op, a, b) if a < b else self.node(op, b, a)

    def compare(self, op: int, a: int, b: int) -> int:
        va, vb = self.value[a], self.value[b]
        if va is not None and vb is not None:
            return self.const(float(_VALUES[op](va, vb)))
        return self.node(op, a, b)

    def logic(self, op: int, a: int, b: int) -> int:
        """AND or OR of two truth values."""
        if a == b:
            return a
        for known, other in ((self.value[a], b), (self.value[b], a)):
            if known is not None:
                decides = known == (0.0 if op == AND else 1.0)
                return self.const(known) if decides else other
        return self.node(op, a, b) if a < b else self.node(op, b, a)

    def invert(self, a: int) -> int:
        """NOT of a truth value."""
        value = self.value[a]
        if value is not None:
            return self.const(1.0 - value)
        return self.a[a] if self.ops[a] == NOT else self.node(NOT, a)

    def select(self, condition: int, a: int, b: int) -> int:
        """a where the condition holds, else b."""
        value = self.value[condition]
        if value is not None:
            return a if value != 0.0 else b
        return a if a == b else self.node(SELECT, condition, a, b)

    def operate(self, op: int, *operands: int) -> int:
        """Any operation by its number, folded like the others."""
        if op in _FOLDED:
            return _FOLDED[op](self, *operands)
        if op in (MIN, MAX):
            return self.extremum(op, *operands)
        if op in (AND, OR):
            return self.logic(op, *operands)
        return self.compare(op, *operands) if op in COMPARISONS else self.unary(op, *operands)

    def operands(self, i: int) -> tuple[int, ...]:
        """The nodes that node i computes with."""
        if self.ops[i] in (CONST, INPUT):
            return ()
        return tuple(x for x in (self.a[i], self.b[i], self.c[i]) if x != NONE)

    def live(self, outputs: Iterable[int]) -> list[int]:
        """The nodes that `outputs` need, in an order in which they can be computed."""
        needed = bytearray(len(self.ops))
        stack = list(outputs)
        ops, a, b, c = self.ops, self.a, self.b, self.c
        while stack:
            i = stack.pop()
            if needed[i]:
                continue
            needed[i] = 1
            if ops[i] > INPUT:
                stack.append(a[i])
                if b[i] != NONE:
                    stack.append(b[i])
                    if c[i] != NONE:
                        stack.append(c[i])
        return [i for i, flag in enumerate(needed) if flag]

    def evaluate(self, outputs: Sequence[int], inputs: Sequence[float]) -> Float64Array:
        """The numbers that `outputs` have at these inputs, node by node in Python: slow, for points and tests."""
        values: dict[int, float] = {}
        live = self.live(outputs)
        self.check_closed(live)
        with np.errstate(all="ignore"):  # what is not finite shows in the result, as in native code
            for i in live:
                op = self.ops[i]
                if op == INPUT:
                    values[i] = inputs[self.a[i]]
                elif (known := self.value[i]) is not None:
                    values[i] = known
                else:
                    values[i] = float(_VALUES[op](*(values[x] for x in self.operands(i))))
        return np.array([values[i] for i in outputs], dtype=np.float64)

    def check_closed(self, nodes: Iterable[int], before: int = 0) -> None:
        """Refuse nodes that depend on a placeholder made after the first `before`: a value left its function."""
        if self.n_placeholders > before and any(self.ops[i] == INPUT and self.a[i] < -before for i in nodes):
            raise TraceError(
                "a value from inside a function that jacobian differentiates is used outside of it; "
                "let the function return what is needed",
                rule="closed functions",
            )


def scaled(a: Any, b: Any) -> Any:
    """a 2^b for whole numbers b, in numbers or arrays."""
    return np.ldexp(a, np.nan_to_num(b).astype(np.int32))


def exponent(a: Any) -> Any:
    """The whole k with 2^k <= a < 2^(k+1), as numbers."""
    return np.frexp(a)[1] - 1.0


_FOLDED: Final[dict[int, Callable[..., int]]] = {
    ADD: Graph.add,
    SUB: Graph.sub,
    MUL: Graph.mul,
    DIV: Graph.div,
    NEG: Graph.neg,
    int(Op.ATAN2): Graph.atan2,
    SELECT: Graph.select,
    NOT: Graph.invert,
}
_VALUES: Final[dict[int, Callable[..., float]]] = {  # with NaN and infinity for what is no number
    ADD: operator.add,
    SUB: operator.sub,
    MUL: operator.mul,
    DIV: np.divide,
    NEG: operator.neg,
    int(Op.SQRT): np.sqrt,
    int(Op.SIN): np.sin,
    int(Op.COS): np.cos,
    int(Op.ASIN): np.arcsin,
    int(Op.ACOS): np.arccos,
    int(Op.ATAN2): math.atan2,
    int(Op.EXP): np.exp,
    int(Op.LOG): np.log,
    int(Op.TANH): np.tanh,
    ABS: np.abs,
    int(Op.FLOOR): np.floor,
    MIN: np.minimum,
    MAX: np.maximum,
    SELECT: lambda condition, a, b: a if condition else b,
    int(Op.LT): operator.lt,
    int(Op.LE): operator.le,
    int(Op.EQ): operator.eq,
    AND: min,
    OR: max,
    NOT: operator.not_,
    int(Op.SCALE): lambda a, b: float(scaled(a, b)),
    int(Op.EXPONENT): lambda a: float(exponent(a)),
}
