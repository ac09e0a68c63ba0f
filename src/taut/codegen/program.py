"""Program: a pure function of named blocks, traced once; what every target is made from.

A block is a C struct of doubles: fields in order, arrays row by row, no padding.
"""

from __future__ import annotations

import hashlib
import importlib
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any, Final, TypeAlias

import numpy as np

from taut.base.checks import instance_of
from taut.base.errors import TautError, TraceError, missing_extra, raised_location
from taut.base.types import Float64Array
from taut.trace.array import traced_array
from taut.trace.graph import NONE, Graph, Op, exponent, scaled
from taut.trace.scalar import Condition, Scalar, to_node, tracing

Values: TypeAlias = Mapping[str, Any]
Function: TypeAlias = Callable[[Values, Values, Values], tuple[Values, Values]]
"""(inputs, parameters, memory) -> (outputs, new memory), each by path; for floats and for symbols."""

CONST, INPUT = int(Op.CONST), int(Op.INPUT)
AT_ONE_GO: Final = 2000  # rows that are evaluated together: their intermediate results fit into the cache
_FUNCTIONS: Final[Mapping[int, Callable[..., Any]]] = {
    int(Op.ADD): np.add, int(Op.SUB): np.subtract, int(Op.MUL): np.multiply, int(Op.DIV): np.divide,
    int(Op.NEG): np.negative, int(Op.SQRT): np.sqrt, int(Op.SIN): np.sin, int(Op.COS): np.cos,
    int(Op.ASIN): np.arcsin, int(Op.ACOS): np.arccos, int(Op.ATAN2): np.arctan2, int(Op.EXP): np.exp,
    int(Op.LOG): np.log, int(Op.TANH): np.tanh, int(Op.ABS): np.abs, int(Op.FLOOR): np.floor,
    int(Op.MIN): np.minimum, int(Op.MAX): np.maximum, int(Op.LT): np.less,
    int(Op.LE): np.less_equal, int(Op.EQ): np.equal, int(Op.AND): np.logical_and, int(Op.OR): np.logical_or,
    int(Op.NOT): np.logical_not, int(Op.SCALE): scaled, int(Op.EXPONENT): exponent,
}  # fmt: skip


@dataclass(frozen=True)
class Field:
    """One named array in a block."""

    path: str
    shape: tuple[int, ...]
    offset: int

    @property
    def size(self) -> int:
        """Number of doubles."""
        return prod(self.shape)


@dataclass(frozen=True)
class Block:
    """Named arrays, one behind the other."""

    fields: tuple[Field, ...] = ()

    @classmethod
    def of(cls, shapes: Mapping[str, tuple[int, ...]]) -> Block:
        """A block with these fields, in this order."""
        fields, offset = [], 0
        for path, shape in shapes.items():
            field = Field(path, tuple(shape), offset)
            fields.append(field)
            offset += field.size
        return cls(tuple(fields))

    @cached_property
    def size(self) -> int:
        """Number of doubles."""
        return sum(field.size for field in self.fields)

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each field, by path."""
        return {field.path: field.shape for field in self.fields}

    def zeros(self) -> Float64Array:
        """Room for the block, with zeros."""
        return np.zeros(self.size)

    def views(self, flat: Float64Array) -> dict[str, Float64Array]:
        """Each field as an array that shares memory with `flat`, whose last axis is the block's."""
        lead = flat.shape[:-1]
        return {
            field.path: flat[..., field.offset : field.offset + field.size].reshape((*lead, *field.shape))
            for field in self.fields
        }

    def pack(self, values: Mapping[str, Any], out: Float64Array | None = None) -> Float64Array:
        """Values by path as one flat array."""
        flat = self.zeros() if out is None else out
        for field in self.fields:
            flat[field.offset : field.offset + field.size] = np.ravel(values[field.path])
        return flat

    def field(self, path: str) -> Field:
        """The field of that path."""
        return next(field for field in self.fields if field.path == path)


@dataclass(frozen=True, kw_only=True, eq=False)
class Program:
    """A traced function: (inputs, parameters, memory) -> (outputs, new memory)."""

    graph: Graph
    inputs: Block
    parameters: Block
    memory: Block
    outputs: Block
    output_nodes: tuple[int, ...]  # one per double of `outputs`
    memory_nodes: tuple[int, ...]  # one per double of the new `memory`

    @cached_property
    def live(self) -> list[int]:
        """The nodes that are needed, in order."""
        return self.graph.live((*self.output_nodes, *self.memory_nodes))

    @cached_property
    def operations(self) -> int:
        """Number of arithmetic operations: live nodes that are neither inputs nor constants."""
        ops = self.graph.ops
        return sum(1 for i in self.live if ops[i] > INPUT)

    def place_of_input(self, index: int) -> tuple[str, int]:
        """Block and offset of an input node."""
        for name, block in (("inputs", self.inputs), ("parameters", self.parameters), ("memory", self.memory)):
            if index < block.size:
                return name, index
            index -= block.size
        raise AssertionError(index)

    def evaluated(self, inputs: Any, select: Callable[..., Any] = np.where) -> tuple[list[Any], list[Any]]:
        """Outputs and new memory, node by node, of numbers, arrays, or what else NumPy's functions take.

        `inputs` has one for each double of inputs, parameters and memory; `select` chooses by a condition.
        """
        graph, values = self.graph, dict[int, Any]()
        for i in self.live:
            op = graph.ops[i]
            if op == CONST:
                values[i] = graph.value[i]
            elif op == INPUT:
                values[i] = inputs[graph.a[i]]
            else:
                function = select if op == Op.SELECT else _FUNCTIONS[op]
                values[i] = function(*(values[x] for x in graph.operands(i)))
        return [values[i] for i in self.output_nodes], [values[i] for i in self.memory_nodes]

    @cached_property
    def content(self) -> bytes:
        """The program's content in a form that does not depend on how it was traced: the cache's key."""
        graph, live = self.graph, self.live
        number = dict(zip(live, range(len(live)), strict=True))
        number[NONE] = NONE
        rows = np.empty((len(live), 4), dtype=np.int32)
        constants: list[float] = []
        ops, a, b, c, value = graph.ops, graph.a, graph.b, graph.c, graph.value
        for k, i in enumerate(live):
            op = ops[i]
            if op == CONST:
                rows[k] = (op, len(constants), NONE, NONE)
                constants.append(value[i] or 0.0)
            elif op == INPUT:
                rows[k] = (op, a[i], NONE, NONE)
            else:
                rows[k] = (op, number[a[i]], number[b[i]], number[c[i]])
        ends = np.array([number[i] for i in (*self.output_nodes, *self.memory_nodes)], dtype=np.int32)
        sizes = np.array([b.size for b in (self.inputs, self.parameters, self.memory, self.outputs)], dtype=np.int32)
        digest = hashlib.sha256()
        for part in (sizes, rows, np.array(constants), ends):
            digest.update(part.tobytes())
        return digest.digest()


def trace(function: Function, inputs: Block, parameters: Block, memory: Block) -> Program:
    """Run `function` once on symbols."""
    graph = Graph()
    blocks = [_symbols(graph, block) for block in (inputs, parameters, memory)]
    with tracing(graph):
        try:
            outputs, after = function(*blocks)
            out_block = Block.of({path: np.shape(value) for path, value in outputs.items()})
        except TautError:
            raise
        except Exception as cause:
            way_out = "; use taut.math for arrays, branches and functions; engine='float' runs it on plain numbers"
            raise TraceError(f"this code cannot be traced: {failure(cause, way_out)}") from cause
        program = Program(
            graph=graph,
            inputs=inputs,
            parameters=parameters,
            memory=memory,
            outputs=out_block,
            output_nodes=_nodes(graph, {path: outputs[path] for path in out_block.shapes}),
            memory_nodes=_nodes(graph, {path: after[path] for path in memory.shapes}),
        )
    graph.check_closed(program.live)
    return program


def failure(cause: Exception, way_out: str = "") -> str:
    """An error of law code in words: what failed, where, and how to fix it."""
    text, place = f"{type(cause).__name__}: {cause}", raised_location(cause)
    if isinstance(cause, ZeroDivisionError):
        return f"it divides by a constant zero at {place}"
    for words, what, known in _KNOWN_FAILURES:
        if words in text:
            return f"{what} at {place}; {known}"
    if isinstance(cause, AttributeError) and cause.name is not None and cause.obj is None:  # a sentence of ours
        return f"{cause} at {place}"
    return f"{text} at {place}{way_out}"


_KNOWN_FAILURES: Final = (  # NumPy's words, and ours
    ("used as indices", "a condition is used as an index", "write taut.math.where(condition, a, b)"),
    ("read-only", "what a law is given is changed in place", "change a copy: q = x.q.copy()"),
    ("has no setter", "what a law is given is changed", "give the result a name of its own"),
    (
        "loop of ufunc does not support argument",
        "a NumPy function is used on an array of numbers and traced values",
        "make the array with taut.math.array",
    ),
)


def _symbols(graph: Graph, block: Block) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for field in block.fields:
        scalars = [Scalar(graph, graph.input()) for _ in range(field.size)]
        if field.shape == ():
            out[field.path] = scalars[0]
            continue
        array = traced_array(scalars).reshape(field.shape)
        array.flags.writeable = False
        out[field.path] = array
    return out


def _nodes(graph: Graph, values: Mapping[str, Any]) -> tuple[int, ...]:
    nodes: list[int] = []
    for path, value in values.items():
        for k, x in enumerate(np.asarray(value, dtype=object).flat):
            if isinstance(x, float) and math.isnan(x):
                raise TraceError(f"{path}[{k}] is NaN whatever the law is given", name=path, rule="no NaN")
            nodes.append(to_node(graph, x.number() if isinstance(x, Condition) else x))
    return tuple(nodes)


def over_rows(
    function: Callable[..., Values], **shapes: int | tuple[int, ...]
) -> Callable[..., dict[str, Float64Array]]:
    """A function of arrays, written with NumPy and taut.math, over many rows of each argument at once.

    It is traced once and evaluated by NumPy, without being compiled. Arguments are given by name, (k, *shape); the
    arrays that the function returns by name are (k, *shape) too.
    """
    block = Block.of({name: (shape,) if isinstance(shape, int) else shape for name, shape in shapes.items()})
    program = trace(lambda x, *_: (function(**x), {}), block, Block(), Block())

    def evaluate(**rows: Float64Array) -> dict[str, Float64Array]:
        given = np.hstack([rows[name].reshape(len(rows[name]), -1) for name in shapes])
        found = np.empty((len(given), program.outputs.size))
        for i in range(0, len(given), AT_ONE_GO):
            piece = slice(i, i + AT_ONE_GO)
            with np.errstate(all="ignore"):  # of branches that are not taken
                ends, _ = program.evaluated(given[piece].T)
            for column, end in enumerate(ends):
                found[piece, column] = end
        return program.outputs.views(found)

    return evaluate


def to_casadi(program: Program, name: str = "taut") -> Any:
    """A program as a `casadi.Function` (inputs, parameters, memory) -> (outputs, new memory), flat columns.

    Raises:
        MissingExtraError: CasADi is not installed.
        UsageError: It is no program.
    """
    try:
        casadi: Any = importlib.import_module("casadi")
    except ImportError as cause:
        raise missing_extra("a program as a CasADi function", "casadi", "oracles") from cause
    instance_of("program", program, Program, "a traced program, such as ctrl.program")
    blocks = {"inputs": program.inputs, "parameters": program.parameters, "memory": program.memory}
    symbols = [casadi.SX.sym(word, block.size) for word, block in blocks.items()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of shapes that NumPy's functions will give: all are scalars
        ends = program.evaluated(casadi.vertsplit(casadi.vertcat(*symbols)), casadi.if_else)
    columns = [casadi.vertcat(*end) for end in ends]
    return casadi.Function(name, symbols, columns, list(blocks), ["outputs", "new_memory"])
