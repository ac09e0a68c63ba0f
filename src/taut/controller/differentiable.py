"""The tick of a controller as a function of torch tensors, with its exact derivative."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import float_array, instance_of
from taut.base.errors import ShapeError, UsageError, missing_extra, unknown_name
from taut.base.paths import subtree
from taut.codegen.functions import DOUBLE, SINGLE, Real
from taut.codegen.lanes.rows import TIME, RowArrays, RowCode, host_array
from taut.codegen.llvm import Lanes
from taut.codegen.native import cores, host_lanes
from taut.codegen.program import Block, Values, trace
from taut.control.trajectories.reference import Sample
from taut.controller.batch import reference_arrays
from taut.controller.calls import step_arguments
from taut.controller.controller import Controller
from taut.controller.kernel import DT, SideFunctions
from taut.trace.array import traced_array
from taut.trace.derivative import adjoints
from taut.trace.scalar import active_graph, to_node, to_symbol

REMEMBERED: Final = "memory"
REALS: Final = {np.dtype(real.dtype): real for real in (DOUBLE, SINGLE)}


def differentiable(ctrl: Controller) -> Differentiable:
    """The tick of a controller for torch: of many lanes at once, differentiable by all that goes in.

    It is a pure function, command, memory' = tick(q, v, ..., reference, parameters, memory). Its derivative is exact,
    in reverse mode, compiled from the graph of the law itself. At a non-smooth point it is that of one side; in a
    tick without memory it includes that of the start.

    Args:
        ctrl: The controller of a law.

    Raises:
        MissingExtraError: torch is not installed.
        UsageError: No controller, or one of a task or in the float engine.
    """
    return Differentiable(ctrl)


class Differentiable:
    """The tick of a controller as a function of torch tensors. Made by `taut.tensors.differentiable`; call it.

    A lane in which a number is not finite gets NaN in all of its results; in the derivative likewise.
    """

    def __init__(self, ctrl: Controller) -> None:
        instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
        if ctrl.side.task is not None or ctrl.engine != "native":
            raise UsageError("differentiable takes the controller of a law, with engine='native'", name="ctrl")
        try:
            self._torch: Any = importlib.import_module("torch")
        except ImportError as cause:
            raise missing_extra("a differentiable tick", "torch", "torch") from cause
        self._ctrl, self._side = ctrl, ctrl.side
        self._functions, program = SideFunctions(ctrl.side, record=False), ctrl.program
        self._command = program.outputs.fields[0]
        self._memory = program.memory.shapes
        given = {**program.inputs.shapes, **program.parameters.shapes}
        remembered = {f"{REMEMBERED}.{path}": shape for path, shape in self._memory.items()}
        self._blocks = {True: Block.of(given), False: Block.of({**given, **remembered})}  # by whether memory starts
        zero: dict[str, Any] = {path: np.zeros(shape) for path, shape in program.inputs.shapes.items()}
        self._constants = {path: value for path, value in zero.items() if not path.startswith("ref.")} | {DT: ctrl.dt}
        self._code = functools.cache(self._compiled)

    def __call__(
        self,
        q: Any,
        v: Any = None,
        ref: Sample | Mapping[str, Any] | None = None,
        *,
        parameters: Mapping[str, Any] | None = None,
        memory: Mapping[str, Any] | None = None,
        **measured: Any,
    ) -> tuple[Any, dict[str, Any]]:
        """One tick.

        Args:
            q: (n, joints) measured positions [rad | m], a tensor of float64 or float32, as all others.
            v: (n, joints) measured velocities [rad/s | m/s].
            ref: One sample for all lanes, or tensors by the names of its fields, as for `Batch.step`.
            parameters: By path, (n, ...) or (...) for all; those of the controller where left out. Their ranges are
                not checked.
            memory: That of the tick before; it starts from what is measured if left out.
            measured: F_ext, tau_meas and others, where the law needs them.

        Returns:
            The command (n, joints), and the new memory by path, with the time of the next tick, "t" [s].

        Raises:
            UsageError: Tensors of another type or in other memory, or something that is missing.
            ShapeError: A tensor of another shape.
        """
        given, _ = step_arguments(self._side, (), {"q": q, "v": v, **measured})
        if not isinstance(q, self._torch.Tensor) or q.ndim != 2:
            got = f"{type(q).__name__} of shape {tuple(np.shape(q))}"
            raise ShapeError(f"q must be a tensor of torch, (n, {self._side.arm.n}); got {got}", name="q")
        dtype = host_array("q", q.detach()).dtype
        if dtype not in REALS:
            raise UsageError(f"q must be float64 or float32; got {dtype}", name="q")
        for path in parameters or {}:
            if path not in self._ctrl.parameters:
                raise unknown_name("the controller", "parameter", path, self._ctrl.parameters)
        given = {**self._constants, **given, **self._ctrl.parameters, **(parameters or {})}
        given |= reference_arrays(self._side, ref, dtype)
        for path, value in (memory or {}).items():
            given[path if path == TIME else f"{REMEMBERED}.{path}"] = value
        first, real = memory is None, REALS[dtype]
        row = self._row(self._blocks[first], given, len(q), q.dtype)
        made = _function(self._torch).apply(
            row, self._code(first, False, real), lambda: self._code(first, True, real)
        )
        ends = np.cumsum([self._command.size, *(int(np.prod(shape)) for shape in self._memory.values())])
        command, *parts = self._torch.tensor_split(made, ends[:-1].tolist(), dim=1)
        new = {path: x.reshape(-1, *self._memory[path]) for path, x in zip(self._memory, parts, strict=True)}
        now = self._torch.as_tensor(given.get(TIME, 0.0), dtype=q.dtype)
        return command.reshape(-1, *self._command.shape), {**new, TIME: now.detach() + self._ctrl.dt}

    def _row(self, block: Block, given: Mapping[str, Any], n: int, dtype: Any) -> Any:
        """(n, size) all that goes in, side by side; what is the same for all lanes is spread."""
        parts = []
        for field in block.fields:
            if field.path not in given:
                raise UsageError(
                    f"{field.path} is missing; memory is what the tick before gave, whole", name=field.path
                )
            value = given[field.path]
            if not isinstance(value, self._torch.Tensor):
                value = self._torch.tensor(float_array(field.path, value), dtype=dtype)
            if value.dtype != dtype or value.device.type != "cpu":
                got = f"{value.dtype} on {value.device}"
                raise UsageError(f"{field.path} must be {dtype} on the CPU, as q is; got {got}", name=field.path)
            if tuple(value.shape) not in (field.shape, (n, *field.shape)):
                raise ShapeError(
                    f"{field.path} must have shape {(n, *field.shape)}, or {field.shape} for all lanes; got shape "
                    f"{tuple(value.shape)}",
                    name=field.path,
                )
            parts.append(value.expand(n, *field.shape).reshape(n, field.size))
        return self._torch.cat(parts, dim=1)

    # ---------------------------------------------------------------- code

    def _compiled(self, first: bool, backward: bool, real: Real) -> RowCode:
        """The tick of one row of numbers; or its derivative, of that row and a weight for each result."""
        block = self._blocks[first]
        results = self._command.size + sum(int(np.prod(shape)) for shape in self._memory.values())

        def tick(values: Values, *_: Values) -> tuple[Values, Values]:
            given = block.views(values["row"])
            given = {path: x[()] if x.ndim == 0 else x for path, x in given.items()}
            before = subtree(given, REMEMBERED) if not first else self._functions.start(given, given, {})[0]
            outputs, after = self._functions.tick(given, given, before)
            made = [outputs[self._command.path], *(after[path] for path in self._memory)]
            return {"made": np.concatenate([np.ravel(np.asarray(x, dtype=object)) for x in made])}, {}

        def derivative(values: Values, *_: Values) -> tuple[Values, Values]:
            graph = active_graph()
            assert graph is not None
            made = [to_node(graph, x) for x in tick(values)[0]["made"]]
            weights, wanted = ([to_node(graph, x) for x in values[name]] for name in ("weights", "row"))
            return {"slopes": traced_array([to_symbol(graph, i) for i in adjoints(graph, made, weights, wanted)])}, {}

        shapes = {"row": (block.size,)} | ({"weights": (results,)} if backward else {})
        program = trace(derivative if backward else tick, Block.of(shapes), Block(), Block())
        return RowCode(program, Lanes(host_lanes(real), real))


@functools.cache
def _function(torch: Any) -> Any:
    """The class of torch's that has a derivative of its own."""

    def run(code: RowCode, *tensors: Any) -> Any:
        made = torch.empty((len(tensors[0]), code.program.outputs.size), dtype=tensors[0].dtype)
        arrays = RowArrays(code, len(made))
        for path, tensor in zip(code.fields, (*tensors, made), strict=True):
            arrays.put(path, tensor.detach().contiguous().numpy())
        arrays.run(cores())
        return made

    class Rows(torch.autograd.Function):  # type: ignore[misc]
        @staticmethod
        def forward(ctx: Any, row: Any, code: RowCode, derivative: Any) -> Any:
            ctx.save_for_backward(row)
            ctx.derivative = derivative
            return run(code, row)

        @staticmethod
        @torch.autograd.function.once_differentiable  # type: ignore[untyped-decorator]
        def backward(ctx: Any, weights: Any) -> Any:
            return run(ctx.derivative(), *ctx.saved_tensors, weights), None, None

    return Rows
