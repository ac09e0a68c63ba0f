"""taut.native: any function of arrays as a native function of arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import UsageError
from taut.base.types import Array, Float64Array
from taut.codegen.call import Argument
from taut.codegen.kernel import Blocks, NativeKernel, verified
from taut.codegen.layout import Block
from taut.codegen.program import Values, trace

__all__ = ["NativeFunction", "native"]


def native(function: Callable[..., Array], **shapes: int | tuple[int, ...]) -> NativeFunction:
    """A native version of a function of arrays, written with NumPy and taut.math.

    Args:
        function: Takes arrays by position and gives one array.
        shapes: Shape of each argument, in order; a number is the length of a vector.

    Returns:
        A function of float64 arrays that gives a new array.

    Raises:
        TraceError: The function cannot be traced.
        UsageError: A shape that is none.

    Example:
        >>> import taut
        >>> rotate = taut.native(lambda a, p: taut.math.array([p[0] * taut.math.cos(a), p[0]]), a=(), p=2)
        >>> rotate(0.0, [1.0, 2.0]).tolist()
        [1.0, 1.0]
    """
    return NativeFunction(function, shapes)


class NativeFunction:
    """A function of arrays in native code. Made by `taut.native`; call it like the function."""

    def __init__(self, function: Callable[..., Array], shapes: dict[str, Any]) -> None:
        self._shapes = {name: _shape(name, shape) for name, shape in shapes.items()}
        self._function = function
        inputs = Block.of(self._shapes)

        def of_blocks(values: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG001
            return {"result": function(*(values[name] for name in self._shapes))}, {}

        def nothing(values: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG001
            return {}, {}

        program = trace(of_blocks, inputs, Block(), Block())
        self._blocks = blocks = Blocks(inputs, Block(), Block(), program.outputs)
        rng = np.random.default_rng(0)
        empty = np.zeros(0)
        samples = [(rng.standard_normal(inputs.size), empty, empty) for _ in range(3)]
        name = getattr(function, "__name__", "function")
        self._kernel = NativeKernel(
            program,
            trace(nothing, inputs, Block(), Block()),
            blocks,
            arguments=[Argument((name,)) for name in self._shapes],
            reference=None,
            time=None,
            dt=0.0,
            guarded=False,
            slow=self._slow,
            failed=self._slow,
            verify=verified(name, of_blocks, program, samples),
        )
        self._kernel.start()
        self.operations = program.operations
        self.call = self._kernel.step
        """The bare builtin: the fastest way to call it."""

    def __call__(self, *args: Any) -> Float64Array:
        result: Float64Array = self.call(*args)
        return result

    def _slow(self, *args: Any, **kwargs: Any) -> Float64Array:
        if kwargs or len(args) != len(self._shapes):
            raise UsageError(f"the function takes {', '.join(self._shapes)} by position; got {len(args)}")
        views = self._blocks.views("inputs")
        for (name, shape), value in zip(self._shapes.items(), args, strict=True):
            views[name][...] = finite_array(name, value, shape=shape)
        self._kernel.tick()
        return self._blocks.views("outputs")["result"].copy()


def _shape(name: str, shape: Any) -> tuple[int, ...]:
    if isinstance(shape, int) and not isinstance(shape, bool) and shape > 0:
        return (shape,)
    if isinstance(shape, tuple) and all(isinstance(size, int) and size > 0 for size in shape):
        return shape
    raise UsageError(f"{name} must be a length or a shape such as 7 or (3, 3); got {shape!r}", name=name)
