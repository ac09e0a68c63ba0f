"""A program as a CasADi function, for other tools and as an oracle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from taut.base.errors import UsageError, missing_extra
from taut.codegen.program import Program
from taut.trace.graph import Op

__all__ = ["to_casadi"]


def _casadi() -> Any:
    try:
        import casadi
    except ImportError as cause:
        raise missing_extra("a program as a CasADi function", "casadi", "oracles") from cause
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
