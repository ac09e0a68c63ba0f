"""taut.native: any function of arrays as a native function of arrays."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from taut.base.checks import float_array
from taut.base.errors import UsageError
from taut.base.types import Array, Float64Array
from taut.codegen.call import Argument
from taut.codegen.kernel import Blocks, Call, Kernel
from taut.codegen.layout import Block
from taut.codegen.native import available, warn_of_plain_python
from taut.codegen.program import Values, trace

__all__ = ["NativeFunction", "native"]


def native(function: Callable[..., Array], **shapes: int | tuple[int, ...]) -> NativeFunction:
    """A native version of a function of arrays, written with NumPy and taut.math.

    Where llvmlite is missing it runs as plain Python, with a warning.

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
        self._lock = threading.Lock()  # where calls go through the blocks, in Python
        self._kernel: Kernel | None = None
        self.operations = 0
        self.call: Callable[..., Any] = self._slow
        """The bare builtin: the fastest way to call it."""
        if available():
            self._kernel = kernel = self._compiled()
            kernel.start()
            self.operations, self.call = kernel.operations, kernel.step
        else:
            warn_of_plain_python()

    def _compiled(self) -> Kernel:
        inputs, empty, none = Block.of(self._shapes), Block(), np.zeros(0)

        def of_blocks(values: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG001
            return {"result": self._function(*(values[name] for name in self._shapes))}, {}

        def nothing(values: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG001
            return {}, {}

        rng = np.random.default_rng(0)
        samples = [(rng.standard_normal(inputs.size), none, none) for _ in range(3)]
        return Kernel(
            "native",
            of_blocks,
            nothing,
            Blocks(inputs, empty, empty, trace(of_blocks, inputs, empty, empty).outputs),
            first=_never,
            failed=_never,
            call=Call(arguments=[Argument((name,)) for name in self._shapes], slow=self._slow),
            what=getattr(self._function, "__name__", "function"),
            samples=lambda: samples,
            guarded=False,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy is compiled anew; it can be pickled where the function can."""
        return NativeFunction, (self._function, self._shapes)

    def __call__(self, *args: Any) -> Float64Array:
        result: Float64Array = self.call(*args)
        return result

    def _slow(self, *args: Any, **kwargs: Any) -> Float64Array:
        """A call with anything but plain arrays: checked in words and converted."""
        names = ", ".join(self._shapes)
        if kwargs:
            raise UsageError(f"the function takes {names} by position; got {', '.join(kwargs)} by name")
        if len(args) != len(self._shapes):
            raise UsageError(f"the function takes {len(self._shapes)} arrays ({names}); got {len(args)}")
        given = zip(self._shapes.items(), args, strict=True)
        arrays = [float_array(name, value, shape=shape) for (name, shape), value in given]
        kernel = self._kernel
        if kernel is None:
            with np.errstate(all="ignore"):
                return np.array(self._function(*arrays), dtype=np.float64)
        if kernel.fast:
            return self(*arrays)
        with self._lock:
            for view, array in zip(kernel.blocks.views("inputs").values(), arrays, strict=True):
                view[...] = array
            kernel.tick()
            return kernel.blocks.views("outputs")["result"].copy()


def _never() -> None:
    raise AssertionError("a function without memory is always ready, and its numbers are not judged")


def _shape(name: str, shape: Any) -> tuple[int, ...]:
    sizes = shape if isinstance(shape, tuple) else (shape,)
    if all(isinstance(size, (int, np.integer)) and not isinstance(size, bool) and size > 0 for size in sizes):
        return tuple(int(size) for size in sizes)
    raise UsageError(f"{name} must be a length or a shape such as 7 or (3, 3); got {shape!r}", name=name)
