"""Kernel: a tick with blocks of its own, run by either engine; `taut.native`: any function of arrays as one."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from taut.base.checks import float_array
from taut.base.errors import UsageError, one_thread_at_a_time
from taut.base.types import Array, Float64Array
from taut.codegen.call import (
    METH_FASTCALL_KEYWORDS,
    METH_NOARGS,
    READY,
    TAKEN,
    CallPath,
    Context,
    layout_key,
    offsets,
    slot_offsets,
)
from taut.codegen.engine import Engine, Flat, Steps, machine_code, plain, verified
from taut.codegen.llvm import declarations, kernel
from taut.codegen.native import available, compiled, warn_of_plain_python
from taut.codegen.program import Block, Function, Program, Values, trace


class Blocks:
    """The numbers that a kernel reads and writes, each block one flat array."""

    __slots__ = ("before", "inputs", "layout", "memory", "outputs", "parameters", "seen")

    def __init__(self, inputs: Block, parameters: Block, memory: Block, outputs: Block) -> None:
        self.layout = {"inputs": inputs, "parameters": parameters, "memory": memory, "outputs": outputs}
        self.inputs = inputs.zeros()
        self.parameters = parameters.zeros()
        self.memory = memory.zeros()
        self.outputs = outputs.zeros()
        self.before = memory.zeros()  # memory as it was before the last tick
        self.seen = inputs.zeros()  # inputs as they were in the last tick

    def views(self, name: str) -> dict[str, Float64Array]:
        """The fields of one block, sharing its memory."""
        return self.layout[name].views(getattr(self, name))


class Alone:
    """Context manager of a tick that takes several steps in Python: UsageError where another thread is in it."""

    def __init__(self, taken: Callable[[bool], None]) -> None:  # called where a tick begins and ends
        self._lock, self._taken, self._depth = threading.RLock(), taken, 0

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise one_thread_at_a_time()
        self._depth += 1  # a tick that is the first one takes another one
        if self._depth == 1:
            self._taken(True)

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._taken(False)
        self._lock.release()


@dataclass(frozen=True, kw_only=True)
class Call:
    """The arguments of a kernel's `step`."""

    arguments: Sequence[str]  # the inputs that are arrays, by position
    slow: Callable[..., Any]  # takes a call that is not plain
    keywords: tuple[str, ...] = ()
    reference: type | None = None  # class of an object behind the arrays
    slots: Sequence[str] = ()  # the inputs that its slots are, each named as the last part of the path


class Kernel:
    """A tick with blocks of its own. TraceError where it cannot be traced, or the two engines differ."""

    step: Callable[..., Any]
    """Arrays in, a new array out; everything that is not plain goes to `Call.slow`."""
    tick: Callable[[], None]
    """One evaluation on the blocks; memory stays as it was where a number is not finite."""

    def __init__(
        self,
        engine: Engine,
        tick: Function,  # (inputs, parameters, memory) -> (outputs, new memory)
        start: Function,  # its outputs are the memory in the first tick
        blocks: Blocks,  # the first output is the result of a call
        *,
        first: Callable[[], None],  # takes a tick where memory has not started, or waits
        failed: Callable[[], Any],  # raises the error of a tick whose numbers are not finite
        call: Call | None,  # of `step`; None for a kernel that runs on its blocks alone
        what: str,
        samples: Callable[[], Sequence[Flat]],  # at which both engines are compared when it is compiled
        time: str | None = None,  # the input that is the time [s]
        dt: float = 0.0,
        guarded: bool = True,  # inputs, outputs and memory must be finite
        level: int | None = None,
    ) -> None:
        self.engine, self.blocks = engine, blocks
        self.program: Program | None = None  # the trace, in the native engine
        self.operations = 0
        self.fast = False  # whether calls go through the generated builtin
        self._first, self._failed, self._guarded, self._dt = first, failed, guarded, dt
        self._time = time
        self._new = blocks.memory.copy()
        self._words: dict[str, int] | Context = {"count": 0, "ready": 0}
        self._ready_word = READY
        self.alone = Alone(self._take)
        self.step, self.tick = call.slow if call is not None else _no_step, self._tick
        inputs, parameters, memory, outputs = blocks.layout.values()
        if engine == "float":
            self._evaluate = plain(tick, inputs, parameters, memory, new=memory, outputs=outputs)
            self._starter = plain(start, inputs, parameters, Block(), new=Block(), outputs=memory)
        else:
            self._compile(Steps(tick, inputs, parameters, memory), start, call, (what, samples), level)

    def _compile(
        self,
        steps: Steps,
        start: Function,
        call: Call | None,
        check: tuple[str, Callable[[], Sequence[Flat]]],
        level: int | None,
    ) -> None:
        program = trace(steps.step, steps.inputs, steps.parameters, steps.memory)
        starter = trace(start, steps.inputs, steps.parameters, Block())
        self.program, self.operations = program, program.operations
        slots: tuple[int, ...] | None = ()
        if call is not None and call.reference is not None:
            slots = slot_offsets(call.reference, tuple(path.rpartition(".")[2] for path in call.slots))
        self.fast = fast = offsets() is not None and slots is not None
        self._time = self._time if self._time is not None and _reads(program, self._time) else None
        path = CallPath(
            arguments=None if call is None else call.arguments,
            keywords=() if call is None else call.keywords,
            inputs=program.inputs,
            outputs=program.outputs,
            memory=program.memory,
            slots=dict(zip(call.slots, slots, strict=True)) if call is not None and slots else {},
            time=self._time,
            guarded=self._guarded,
        )

        def text() -> str:
            parts = [declarations(), kernel(program, "kernel"), kernel(starter, "start")]
            return "\n".join([*parts, path.text()] if fast else parts)

        content = b"".join([program.content, starter.content, layout_key(), repr((path, fast)).encode()])
        builtins = (*(("step",) if call is not None else ()), "tick") if fast else ()
        verify = verified(check[0], steps.step, program, check[1])
        self.module = compiled(content, text, ("kernel", "start", *builtins), verify, level)
        self._evaluate, self._starter = machine_code(self.module["kernel"]), machine_code(self.module["start"])
        if not fast:
            return
        blocks = self.blocks
        self._words = context = Context(
            self.module,
            {name: getattr(blocks, name) for name in (*blocks.layout, "before", "seen")},
            result_shape=program.outputs.fields[0].shape,
            dt=self._dt,
            reference=None if call is None else call.reference,
            keywords=path.keywords,
        )
        for name, function in (("slow", self.step), ("first", self._first), ("failed", self._failed)):
            context.python(name, function)
        if call is not None:
            self.step = context.builtin("step", METH_FASTCALL_KEYWORDS, "One tick: arrays in, a new array out.")
        self.tick = context.builtin("tick", METH_NOARGS, "One tick on the bound arrays.")

    @property
    def ready(self) -> bool:
        """True where memory has started, and the next tick may use it as it is."""
        return bool(self._words["ready"])

    @property
    def count(self) -> int:
        """Ticks since memory started."""
        return self._words["count"]

    def start(self) -> None:
        """Start memory from the inputs."""
        blocks, none = self.blocks, np.zeros(0)
        if self._time is not None:  # that of the last tick of the run before
            blocks.views("inputs")[self._time][...] = 0.0
        self._starter(blocks.inputs, blocks.parameters, none, none, blocks.memory)
        self._words["count"] = 0
        self.resume()

    def clear(self) -> None:
        """Forget, or wait: the next tick goes to the function `first`."""
        self._words["ready"] = 0

    def resume(self) -> None:
        """Go on after `clear`, with the memory that there is."""
        self._words["ready"] = self._ready_word

    def _take(self, taken: bool) -> None:
        """Send what other threads call to Python meanwhile, where they are refused: at no cost to any plain call."""
        self._ready_word = TAKEN if taken else READY
        if self._words["ready"]:
            self._words["ready"] = self._ready_word

    def preview(self, parameters: Float64Array) -> dict[str, Float64Array]:
        """The memory that a tick with these parameters would leave, by path. Nothing is changed but the time."""
        new = np.empty_like(self._new)
        self._run(parameters, new, np.empty_like(self.blocks.outputs))
        return self.blocks.layout["memory"].views(new)

    def _run(self, parameters: Float64Array, new: Float64Array, outputs: Float64Array) -> None:
        blocks = self.blocks
        if self._time is not None:
            blocks.views("inputs")[self._time][...] = self.count * self._dt
        self._evaluate(blocks.inputs, parameters, blocks.memory, new, outputs)

    def _tick(self) -> None:
        """The tick of plain Python, and of machine code where Python's objects lie in memory in an unknown way."""
        with self.alone:
            if self.ready:
                self._advance()
            else:
                self._first()

    def _advance(self) -> None:
        blocks = self.blocks
        if self._guarded and not np.isfinite(blocks.inputs).all():
            self._failed()
        self._run(blocks.parameters, self._new, blocks.outputs)
        if self._guarded and not (np.isfinite(blocks.outputs).all() and np.isfinite(self._new).all()):
            self._failed()
        blocks.seen[:] = blocks.inputs
        blocks.before[:] = blocks.memory
        blocks.memory[:] = self._new
        self._words["count"] = self.count + 1


def _no_step(*_: object, **__: object) -> NoReturn:
    raise AssertionError("this kernel runs on its blocks: tick()")


def _reads(program: Program, path: str) -> bool:
    """True where a program depends on one of its inputs."""
    field = program.inputs.field(path)
    index = range(field.offset, field.offset + field.size)
    return any(program.graph.ops[i] == 1 and program.graph.a[i] in index for i in program.live)


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

        rng = np.random.default_rng(0)
        samples = [(rng.standard_normal(inputs.size), none, none) for _ in range(3)]
        return Kernel(
            "native",
            of_blocks,
            lambda *_: ({}, {}),
            Blocks(inputs, empty, empty, trace(of_blocks, inputs, empty, empty).outputs),
            first=_never,
            failed=_never,
            call=Call(arguments=tuple(self._shapes), slow=self._slow),
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
