"""The graph as a CasADi function, and a CasADi function as law code: exchange with other tools, and an oracle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from taut.base.errors import TraceError, UsageError, missing_extra
from taut.base.types import Array
from taut.codegen.program import Program
from taut.trace.array import has_symbols, traced_array
from taut.trace.graph import Op

__all__ = ["from_casadi", "to_casadi"]


def _casadi() -> Any:
    try:
        import casadi
    except ImportError as cause:
        raise missing_extra("the way to and from CasADi", "casadi", "oracles") from cause
    return casadi


def to_casadi(program: Program, name: str = "taut") -> Any:
    """A program as a `casadi.Function` (inputs, parameters, memory) -> (outputs, new memory), flat columns.

    Args:
        program: A traced program.
        name: Name of the function.

    Raises:
        MissingExtraError: CasADi is not installed.
        UsageError: It is no program.
    """
    ca = _casadi()
    if not isinstance(program, Program):  # callers without a type checker
        raise UsageError(f"to_casadi takes a traced program, such as ctrl.program; got {type(program).__name__}")
    blocks = [
        ca.SX.sym(word, block.size)
        for word, block in (
            ("inputs", program.inputs),
            ("parameters", program.parameters),
            ("memory", program.memory),
        )
    ]
    graph = program.graph
    symbols = ca.vertcat(*blocks)
    value: dict[int, Any] = {}
    table = _operations(ca)
    for i in program.live:
        op = Op(graph.ops[i])
        if op == Op.CONST:
            value[i] = ca.SX(graph.value[i])
        elif op == Op.INPUT:
            value[i] = symbols[graph.a[i]]
        else:
            value[i] = table[op](*(value[x] for x in graph.operands(i)))
    ends = [ca.vertcat(*(value[i] for i in nodes)) for nodes in (program.output_nodes, program.memory_nodes)]
    return ca.Function(name, blocks, ends, ["inputs", "parameters", "memory"], ["outputs", "new_memory"])


def _operations(ca: Any) -> dict[Op, Callable[..., Any]]:
    return {
        Op.ADD: lambda a, b: a + b,
        Op.SUB: lambda a, b: a - b,
        Op.MUL: lambda a, b: a * b,
        Op.DIV: lambda a, b: a / b,
        Op.NEG: lambda a: -a,
        Op.SQRT: ca.sqrt,
        Op.SIN: ca.sin,
        Op.COS: ca.cos,
        Op.ASIN: ca.asin,
        Op.ACOS: ca.acos,
        Op.ATAN2: ca.atan2,
        Op.EXP: ca.exp,
        Op.LOG: ca.log,
        Op.TANH: ca.tanh,
        Op.ABS: ca.fabs,
        Op.FLOOR: ca.floor,
        Op.MIN: ca.fmin,
        Op.MAX: ca.fmax,
        Op.SELECT: ca.if_else,
        Op.LT: lambda a, b: a < b,
        Op.LE: lambda a, b: a <= b,
        Op.EQ: lambda a, b: a == b,
        Op.AND: ca.logic_and,
        Op.OR: ca.logic_or,
        Op.NOT: ca.logic_not,
    }


def from_casadi(function: Any) -> Callable[..., Any]:
    """A CasADi SX function as law code: it takes and gives arrays of floats or of traced values.

    Args:
        function: A `casadi.Function` of dense inputs; an MX function is expanded first.

    Returns:
        A function of arrays in the order of the CasADi inputs, which gives one array, or a tuple of them. Columns of
        one are given as vectors.

    Raises:
        UsageError: It is no CasADi function.
        TraceError: It uses an operation that a graph does not have.
    """
    ca = _casadi()
    if not isinstance(function, ca.Function):
        raise UsageError(f"from_casadi takes a casadi.Function; got {type(function).__name__}")
    if function.has_free():
        raise UsageError(f"{function.name()} has free variables; give them as inputs")
    try:
        expanded = function if function.is_a("SXFunction") else function.expand()
    except RuntimeError as cause:
        raise UsageError(f"{function.name()} cannot be expanded into an SX function: {cause}") from cause

    def run(*arguments: Any) -> Any:
        if len(arguments) != expanded.n_in():
            raise UsageError(f"{function.name()} takes {expanded.n_in()} arrays; got {len(arguments)}")
        flat = [np.asarray(a, dtype=object).ravel(order="F") for a in arguments]
        for k, entries in enumerate(flat):
            if entries.size != expanded.nnz_in(k):
                raise UsageError(
                    f"{function.name()}: argument {k} needs {expanded.nnz_in(k)} numbers; got {entries.size}"
                )
        outputs = [np.zeros(expanded.nnz_out(k), dtype=object) for k in range(expanded.n_out())]
        _execute(ca, expanded, flat, outputs)
        results = tuple(_shaped(expanded.sparsity_out(k), values) for k, values in enumerate(outputs))
        return results[0] if len(results) == 1 else results

    return run


def _execute(ca: Any, function: Any, inputs: list[Any], outputs: list[Any]) -> None:
    """Run the instructions of an SX function on our numbers."""
    table = _from_operations(ca)
    # NumPy's numbers divide by zero and take odd powers as the compiled code does, with NaN and infinity.
    number: Callable[[Any], Any] = float if any(map(has_symbols, inputs)) else np.float64
    work: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        i, o = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_INPUT:
            given = inputs[i[0]][i[1]]
            work[o[0]] = given if has_symbols(given) else number(given)
        elif op == ca.OP_OUTPUT:
            outputs[o[0]][o[1]] = work[i[0]]
        elif op == ca.OP_CONST:
            work[o[0]] = number(function.instruction_constant(k))
        elif op in table:
            work[o[0]] = table[op](*(work[x] for x in i))
        else:
            raise TraceError(f"{function.name()} uses CasADi's {_name(ca, op)}, which taut's graph does not have")


def _name(ca: Any, op: int) -> str:
    names = (name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == op)
    return next(names, f"operation {op}")


def _from_operations(ca: Any) -> dict[int, Callable[..., Any]]:
    from taut.trace import math as tm

    def truth(condition: Any) -> Any:
        return tm.where(condition, 1.0, 0.0)  # a CasADi condition is a number

    def cosh(x: Any) -> Any:
        return 0.5 * (tm.exp(x) + tm.exp(-x))

    return {
        ca.OP_ADD: lambda a, b: a + b,
        ca.OP_SUB: lambda a, b: a - b,
        ca.OP_MUL: lambda a, b: a * b,
        ca.OP_DIV: lambda a, b: a / b,
        ca.OP_NEG: lambda a: -a,
        ca.OP_SQ: lambda a: a * a,
        ca.OP_TWICE: lambda a: 2.0 * a,
        ca.OP_INV: lambda a: 1.0 / a,
        ca.OP_SQRT: tm.sqrt,
        ca.OP_SIN: tm.sin,
        ca.OP_COS: tm.cos,
        ca.OP_TAN: tm.tan,
        ca.OP_ASIN: tm.asin,
        ca.OP_ACOS: tm.acos,
        ca.OP_ATAN: lambda a: tm.atan2(a, 1.0),
        ca.OP_ATAN2: tm.atan2,
        ca.OP_EXP: tm.exp,
        ca.OP_LOG: tm.log,
        ca.OP_TANH: tm.tanh,
        ca.OP_SINH: lambda a: tm.tanh(a) * cosh(a),
        ca.OP_COSH: cosh,
        ca.OP_HYPOT: lambda a, b: tm.sqrt(a * a + b * b),
        ca.OP_FABS: tm.abs,
        ca.OP_COPYSIGN: lambda a, b: tm.where(b < 0.0, -tm.abs(a), tm.abs(a)),
        ca.OP_FLOOR: tm.floor,
        ca.OP_CEIL: lambda a: -tm.floor(-a),
        ca.OP_FMOD: lambda a, b: a - b * tm.sign(a / b) * tm.floor(tm.abs(a / b)),
        ca.OP_SIGN: tm.sign,
        ca.OP_FMIN: tm.minimum,
        ca.OP_FMAX: tm.maximum,
        ca.OP_POW: lambda a, b: a**b,
        ca.OP_CONSTPOW: lambda a, b: a**b,
        ca.OP_LT: lambda a, b: truth(a < b),
        ca.OP_LE: lambda a, b: truth(a <= b),
        ca.OP_EQ: lambda a, b: truth(a == b),
        ca.OP_NE: lambda a, b: truth(a != b),
        ca.OP_NOT: lambda a: truth(a == 0.0),
        ca.OP_AND: lambda a, b: truth((a != 0.0) & (b != 0.0)),
        ca.OP_OR: lambda a, b: truth((a != 0.0) | (b != 0.0)),
        ca.OP_IF_ELSE_ZERO: lambda c, a: tm.where(c != 0.0, a, 0.0),
        ca.OP_ASSIGN: lambda a: a,
    }


def _shaped(sparsity: Any, values: Any) -> Array:
    """Nonzeros by column as a dense array; a column becomes a vector."""
    rows, columns = sparsity.shape
    dense = np.zeros((rows, columns), dtype=object)
    dense[:] = 0.0
    for (row, column), value in zip(zip(*sparsity.get_triplet(), strict=True), values, strict=True):
        dense[row, column] = value
    out = dense[:, 0] if columns == 1 else dense
    return traced_array(out) if has_symbols(out) else out.astype(np.float64)
