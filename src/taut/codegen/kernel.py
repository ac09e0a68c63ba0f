"""Kernels: a program with blocks of its own, run natively or on plain floats, behind one interface."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Sequence
from typing import Any, Literal, NoReturn, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import TraceError, one_thread_at_a_time
from taut.base.types import Float64Array
from taut.codegen.call import (
    METH_FASTCALL_KEYWORDS,
    METH_NOARGS,
    READY,
    TAKEN,
    Argument,
    CallPath,
    Context,
    layout_key,
    offsets,
    slot_offsets,
)
from taut.codegen.layout import Block
from taut.codegen.llvm import declarations, kernel
from taut.codegen.native import NativeModule, compiled
from taut.codegen.program import Function, Program, trace

__all__ = ["Alone", "Blocks", "FloatKernel", "Kernel", "NativeKernel", "verified"]

VERIFY_TOLERANCE = 1e-9  # relative to the largest number of the result; far above rounding, far below a fault
ULPS = 4.0  # by which inputs are moved to see how large rounding becomes where a state makes it large
TRIALS, LARGER = 3, 100.0  # times what they show is rounding too
POINTERS = [ctypes.c_void_p] * 5

Flat: TypeAlias = tuple[Float64Array, Float64Array, Float64Array]
"""Inputs, parameters and memory."""
Bools: TypeAlias = NDArray[np.bool_]


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
    """A tick that takes several steps in Python, which one thread at a time may be in. A context manager.

    Args:
        taken: Is told when a thread begins such a tick, and when it ends.

    Raises:
        UsageError: Another thread is in it.
    """

    def __init__(self, taken: Callable[[bool], None] | None = None) -> None:
        self._lock, self._taken, self._depth = threading.RLock(), taken, 0

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise one_thread_at_a_time()
        self._depth += 1  # a tick that is the first one takes another one
        if self._taken is not None and self._depth == 1:
            self._taken(True)

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._taken is not None and self._depth == 0:
            self._taken(False)
        self._lock.release()


class Kernel(Protocol):
    """What a controller needs of an engine."""

    blocks: Blocks
    operations: int
    program: Program | None
    """The trace; None in the float engine."""
    alone: Alone
    """What a tick in Python is in."""
    engine: Literal["native", "float"]
    step: Callable[..., Any]
    """Arrays in, a new array out; everything that is not plain goes to the function `slow`."""
    tick: Callable[[], None]
    """One evaluation on the blocks; memory stays as it was where a number is not finite. It goes to the function
    `first` where memory has not started."""

    def start(self) -> None:
        """Start memory from the inputs."""

    @property
    def ready(self) -> bool:
        """Whether memory has started."""

    @property
    def count(self) -> int:
        """Ticks since memory started."""

    def clear(self) -> None:
        """Forget, or wait: the next tick goes to the function `first`."""

    def resume(self) -> None:
        """Go on after `clear`, with the memory that there is."""

    def preview(self, parameters: Float64Array) -> dict[str, Float64Array]:
        """The memory that a tick with these parameters would leave, by path. Nothing is changed but the time."""


class FloatKernel:
    """A function run as plain Python on floats: for debugging, and where llvmlite is missing."""

    engine: Literal["native", "float"] = "float"
    operations = 0

    def __init__(
        self,
        function: Function,
        starter: Function,
        blocks: Blocks,
        *,
        time: str | None,
        dt: float,
        slow: Callable[..., Any] | None,
        first: Callable[[], None],
        failed: Callable[[], Any],
    ) -> None:
        self.blocks = blocks
        self.program: Program | None = None
        self.alone = Alone()
        self._function, self._starter = function, starter
        self._time, self._dt = time, dt
        self._first, self._failed = first, failed
        self._count = 0
        self._started = False
        self.step = slow or _no_step
        self.tick = self._tick

    def start(self) -> None:
        blocks = self.blocks
        with np.errstate(all="ignore"):
            values, _ = self._starter(_copies(blocks.views("inputs")), _copies(blocks.views("parameters")), {})
        blocks.layout["memory"].pack(values, blocks.memory)
        self._count, self._started = 0, True

    @property
    def ready(self) -> bool:
        return self._started

    @property
    def count(self) -> int:
        return self._count

    def clear(self) -> None:
        self._started = False

    def resume(self) -> None:
        self._started = True

    def preview(self, parameters: Float64Array) -> dict[str, Float64Array]:
        blocks = self.blocks
        self._set_time()
        given = (blocks.views("inputs"), blocks.layout["parameters"].views(parameters), blocks.views("memory"))
        with np.errstate(all="ignore"):
            _, after = self._function(*(_copies(values) for values in given))
        return blocks.layout["memory"].views(blocks.layout["memory"].pack(after))

    def _set_time(self) -> None:
        if self._time is not None:
            self.blocks.views("inputs")[self._time][...] = self._count * self._dt

    def _tick(self) -> None:
        with self.alone:
            if self._started:
                self._advance()
            else:
                self._first()

    def _advance(self) -> None:
        blocks = self.blocks
        self._set_time()
        if not np.isfinite(blocks.inputs).all():
            self._failed()
        with np.errstate(all="ignore"):
            given = (_copies(blocks.views(name)) for name in ("inputs", "parameters", "memory"))
            outputs, after = self._function(*given)
        new = blocks.layout["memory"].pack(after)
        blocks.layout["outputs"].pack(outputs, blocks.outputs)
        if not (np.isfinite(blocks.outputs).all() and np.isfinite(new).all()):
            self._failed()
        blocks.seen[:] = blocks.inputs
        blocks.before[:] = blocks.memory
        blocks.memory[:] = new
        self._count += 1


def _frozen(x: Float64Array) -> Float64Array:
    out = x.copy()
    out.flags.writeable = False
    return out if out.ndim else out[()]


def _copies(values: dict[str, Float64Array]) -> dict[str, Float64Array]:
    return {name: _frozen(value) for name, value in values.items()}


class NativeKernel:
    """A program compiled with its call path."""

    engine: Literal["native", "float"] = "native"

    def __init__(
        self,
        program: Program,
        starter: Program,
        blocks: Blocks,
        *,
        arguments: Sequence[Argument] | None,
        keywords: Sequence[str] = (),
        reference: type | None,
        time: str | None,
        dt: float,
        guarded: bool,
        slow: Callable[..., Any] | None,
        first: Callable[[], None],
        failed: Callable[[], Any],
        verify: Callable[[NativeModule], None] | None,
        level: int | None = None,
    ) -> None:
        self.blocks = blocks
        self.program: Program | None = program
        self.operations = program.operations
        self.alone = Alone(self._take)
        objects = [argument for argument in arguments or () if argument.is_object]
        names = tuple(path.rpartition(".")[2] for argument in objects for path in argument.fields)
        slots = slot_offsets(reference, names) if reference is not None else ()
        self.fast = fast = offsets() is not None and slots is not None
        path = CallPath(
            arguments=arguments,
            keywords=keywords,
            inputs=program.inputs,
            outputs=program.outputs,
            memory=program.memory,
            slots=slots or (),
            time=time if time is not None and _reads(program, time) else None,
            guarded=guarded,
        )

        def text() -> str:
            parts = [declarations(), kernel(program, "kernel"), kernel(starter, "start")]
            return "\n".join([*parts, path.text()] if fast else parts)

        content = b"".join(
            [program.content, starter.content, layout_key(), repr((path, fast)).encode()],
        )
        builtins = (*(("step",) if arguments is not None else ()), "tick") if fast else ()
        self.module = compiled(content, text, ("kernel", "start", *builtins), verify, level)
        self._kernel = _callable(self.module["kernel"])
        self._start = _callable(self.module["start"])
        self._first, self._failed, self._guarded = first, failed, guarded
        self._time, self._dt = path.time, dt
        self._new = blocks.memory.copy()
        self._context: Context | None = None
        self._plain_count, self._plain_ready, self._ready_word = 0, False, READY
        self.step, self.tick = slow or _no_step, self._plain_tick
        if fast:
            self._context = context = Context(
                self.module,
                inputs=blocks.inputs,
                parameters=blocks.parameters,
                memory=blocks.memory,
                before=blocks.before,
                seen=blocks.seen,
                outputs=blocks.outputs,
                result_shape=program.outputs.fields[0].shape,
                dt=dt,
                reference=reference,
                keywords=keywords,
            )
            for name, function in (("slow", self.step), ("first", first), ("failed", failed)):
                context.python(name, function)
            if arguments is not None:
                self.step = context.builtin("step", METH_FASTCALL_KEYWORDS, "One tick: arrays in, a new array out.")
            self.tick = context.builtin("tick", METH_NOARGS, "One tick on the bound arrays.")

    def start(self) -> None:
        blocks = self.blocks
        self._start(
            blocks.inputs.ctypes.data,
            blocks.parameters.ctypes.data,
            None,
            None,
            blocks.memory.ctypes.data,
        )
        self._set(count=0, ready=True)

    def _set(self, *, count: int, ready: bool) -> None:
        if self._context is not None:
            self._context["count"], self._context["ready"] = count, self._ready_word if ready else 0
        else:
            self._plain_count, self._plain_ready = count, ready

    def _take(self, taken: bool) -> None:
        """Send what other threads call to Python meanwhile, where they are refused: at no cost to any plain call."""
        self._ready_word = TAKEN if taken else READY
        if self._context is not None and self._context["ready"]:
            self._context["ready"] = self._ready_word

    @property
    def ready(self) -> bool:
        return bool(self._context["ready"]) if self._context is not None else self._plain_ready

    @property
    def count(self) -> int:
        return self._context["count"] if self._context is not None else self._plain_count

    def clear(self) -> None:
        self._set(count=self.count, ready=False)

    def resume(self) -> None:
        self._set(count=self.count, ready=True)

    def preview(self, parameters: Float64Array) -> dict[str, Float64Array]:
        new = np.empty_like(self._new)
        self._run(parameters, new, np.empty_like(self.blocks.outputs))
        return self.blocks.layout["memory"].views(new)

    def _run(self, parameters: Float64Array, new: Float64Array, outputs: Float64Array) -> None:
        """The kernel through ctypes: new memory and outputs from the blocks' inputs and memory."""
        blocks = self.blocks
        if self._time is not None:
            blocks.views("inputs")[self._time][...] = self.count * self._dt
        arrays = (blocks.inputs, parameters, blocks.memory, new, outputs)
        self._kernel(*(array.ctypes.data for array in arrays))

    def _plain_tick(self) -> None:
        """The tick through ctypes, where Python's objects lie in memory in an unknown way."""
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
        self._set(count=self.count + 1, ready=True)


def _no_step(*_: object, **__: object) -> NoReturn:
    raise AssertionError("this kernel runs on its blocks: tick()")


def _callable(address: int) -> Callable[..., None]:
    function: Callable[..., None] = ctypes.CFUNCTYPE(None, *POINTERS)(address)
    return function


def _reads(program: Program, path: str) -> bool:
    """Whether a program depends on one of its inputs."""
    field = program.inputs.field(path)
    index = range(field.offset, field.offset + field.size)
    return any(program.graph.ops[i] == 1 and program.graph.a[i] in index for i in program.live)


def verified(
    what: str,
    function: Function,
    program: Program,
    samples: Callable[[], Sequence[Flat]],
    name: str = "kernel",
) -> Callable[[NativeModule], None]:
    """A check that the compiled kernel gives what the function gives on plain floats, and that two traces agree.

    Args:
        what: What is compiled, for the message.
        function: The function itself.
        program: Its trace.
        samples: Gives inputs, parameters and memory to compare at, flat.
        name: The kernel's name in the module.
    """

    def plain(inputs: Float64Array, parameters: Float64Array, memory: Float64Array) -> list[Float64Array]:
        with np.errstate(all="ignore"):
            outputs, after = function(
                _copies(program.inputs.views(inputs)),
                _copies(program.parameters.views(parameters)),
                _copies(program.memory.views(memory)),
            )
        return [program.outputs.pack(outputs), program.memory.pack(after)]

    def by_rounding(sample: Flat, wanted: list[Float64Array]) -> list[Float64Array]:
        """How much the results move by rounding alone: near a singularity, more than any fixed tolerance."""
        rng, moved = np.random.default_rng(0), [np.zeros_like(part) for part in wanted]
        for _ in range(TRIALS):
            near = [x * (1.0 + ULPS * np.finfo(float).eps * rng.uniform(-1.0, 1.0, x.shape)) for x in sample]
            for most, part, value in zip(moved, plain(*near), wanted, strict=True):
                np.maximum(most, np.nan_to_num(np.abs(part - value), posinf=0.0), out=most)
        return moved

    def check(module: NativeModule) -> None:
        if trace(function, program.inputs, program.parameters, program.memory).content != program.content:
            raise _unsteady(f"{what}: two traces of the same code differ")
        run = _callable(module[name])
        for k, sample in enumerate(samples()):
            new, outputs = sample[2].copy(), program.outputs.zeros()
            run(*(array.ctypes.data for array in (*sample, new, outputs)))
            results = plain(*sample)
            if k == 0 and not all(
                np.array_equal(a, b, equal_nan=True) for a, b in zip(results, plain(*sample), strict=True)
            ):
                raise _unsteady(f"{what}: two runs of the same code differ")
            wrong = [_differ(got, wanted) for got, wanted in zip((outputs, new), results, strict=True)]
            if any(part.any() for part in wrong):
                allowed = by_rounding(sample, results)
                for got, wanted, rounding in zip((outputs, new), results, allowed, strict=True):
                    _require_same(what, got, wanted, _differ(got, wanted, LARGER * rounding))

    return check


def _differ(got: Float64Array, wanted: Float64Array, rounding: Float64Array | float = 0.0) -> Bools:
    scale = max(1.0, float(np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0)))
    atol = np.broadcast_to(VERIFY_TOLERANCE * scale + rounding, wanted.shape)
    return ~np.isclose(got, wanted, rtol=0.0, atol=atol, equal_nan=True)


def _require_same(what: str, got: Float64Array, wanted: Float64Array, wrong: Bools) -> None:
    if wrong.any():
        raise TraceError(
            f"{what}: compiled code and plain Python differ, {got[wrong][0]:.6g} and "
            f"{wanted[wrong][0]:.6g}; it does something else when it is traced, or it makes rounding "
            "errors large, such as by the root of a difference that is zero",
            rule="agrees with the plain run",
        )


def _unsteady(how: str) -> TraceError:
    return TraceError(
        f"{how}; a law must give the same at the same inputs: no random numbers, no clock, no state outside its "
        "memory",
        rule="a pure function",
    )
