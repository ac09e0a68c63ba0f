"""What the tests of the graph share: a graph run natively, without a call path and without a check."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from taut.base.types import Float64Array
from taut.codegen.llvm import declarations, kernel
from taut.codegen.native import compiled
from taut.codegen.program import Block, Program
from taut.trace.array import traced_array
from taut.trace.graph import Graph
from taut.trace.scalar import Condition, Scalar, to_node, tracing


def native_values(graph: Graph, nodes: Sequence[int], inputs: Sequence[float]) -> Float64Array:
    """The numbers that nodes have at these inputs, in native code."""
    program = Program(
        graph=graph,
        inputs=Block.of({"x": (len(inputs),)}),
        parameters=Block(),
        memory=Block(),
        outputs=Block.of({"y": (len(nodes),)}),
        output_nodes=tuple(nodes),
        memory_nodes=(),
    )
    text = "\n".join([declarations(), kernel(program, "kernel")])
    module = compiled(program.content, lambda: text, ("kernel",))
    run = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5)(module["kernel"])
    x, y, nothing = np.array(inputs, dtype=np.float64), np.zeros(len(nodes)), np.zeros(0)
    run(*(array.ctypes.data for array in (x, nothing, nothing, nothing, y)))
    return y


def traced_value(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function gives when it is traced and the trace is evaluated at these arguments."""
    graph, numbers, symbols = Graph(), [], []
    for argument in arguments:
        flat = np.ravel(np.asarray(argument, dtype=np.float64))
        entries = [Scalar(graph, graph.input()) for _ in flat]
        numbers += flat.tolist()
        symbols.append(traced_array(entries).reshape(np.shape(argument)) if np.ndim(argument) else entries[0])
    with tracing(graph):
        result = np.asarray(function(*symbols), dtype=object)
        entries = [entry.number() if isinstance(entry, Condition) else entry for entry in result.ravel()]
        nodes = [to_node(graph, entry) for entry in entries]
    return graph.evaluate(nodes, numbers).reshape(result.shape)
