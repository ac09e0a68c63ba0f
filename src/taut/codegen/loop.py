"""The native loop: a kernel called many times without coming back to Python."""

from __future__ import annotations

import copy
import ctypes
import functools
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np

from taut.base.types import Float64Array
from taut.codegen.kernel import verified
from taut.codegen.layout import Block, Field
from taut.codegen.native import NativeModule, compiled, level_for
from taut.codegen.period import PeriodCode, write_period
from taut.codegen.program import Function
from taut.codegen.text import Writer
from taut.loop import Loop

__all__ = ["FloatLoop", "NativeLoop", "compiled_loop"]

COMMAND = "command"  # the output that must be finite as memory must be


class FloatLoop:
    """A step function and its substeps, run as plain Python: for debugging, and where llvmlite is missing.

    `example` has inputs, parameters and memory, flat, at which the step can be taken, to see what it records: zeros
    may be values that a law cannot work with.
    """

    operations = 0

    def __init__(
        self,
        step: Function,
        substep: Function,
        repeats: int,
        inputs: Block,
        parameters: Block,
        memory: Block,
        example: tuple[Float64Array, Float64Array, Float64Array],
    ) -> None:
        self._step, self._substep, self._repeats = step, substep, repeats
        self._inputs, self._parameters, self._memory = inputs, parameters, memory
        self.raised: Exception | None = None  # in the last run
        values = (block.views(flat) for block, flat in zip((inputs, parameters, memory), example, strict=True))
        with np.errstate(all="ignore"):
            record, _ = step(*(_copied(value) for value in values))
        self.outputs = Block.of({path: np.shape(value) for path, value in record.items()})

    def run(self, inputs: Float64Array, parameters: Float64Array, memory: Float64Array, outputs: Float64Array) -> int:
        """Steps with one row of inputs and of outputs each; the number of them that ended in finite memory.

        What the code of a step raises ends them too, and is kept in `raised`.
        """
        values = self._parameters.views(parameters)
        self.raised = None
        for k in range(len(inputs)):
            row = self._inputs.views(inputs[k])
            try:
                with np.errstate(all="ignore"):
                    record, after = self._step(row, values, _copied(self._memory.views(memory)))
                    for _ in range(self._repeats):
                        _, after = self._substep(row, values, after)
            except Exception as error:
                self.raised = error
                return k
            self.outputs.pack(record, outputs[k])
            new = self._memory.pack(after)
            if not (np.isfinite(new).all() and np.isfinite(record.get(COMMAND, 0.0)).all()):
                return k
            memory[:] = new
        return len(inputs)


def _copied(values: dict[str, Float64Array]) -> dict[str, Float64Array]:
    return {path: value.copy() if value.ndim else value[()] for path, value in values.items()}


class NativeLoop:
    """A step function and its substeps as one native loop.

    When it is compiled it is compared with the plain run at `example` (inputs, parameters, memory, flat) and near it.
    Where `ticks` are few it is compiled quickly; `expect` more of them and it is compiled again, to run fast.
    """

    raised: Exception | None = None  # compiled code raises nothing

    def __init__(
        self,
        step: Function,
        substep: Function,
        repeats: int,
        inputs: Block,
        parameters: Block,
        memory: Block,
        example: tuple[Float64Array, Float64Array, Float64Array],
        ticks: int | None = None,
    ) -> None:
        period = PeriodCode(step, substep, repeats, inputs, parameters, memory)
        self.outputs = period.step.outputs
        row, values, state = (part.copy() for part in example)  # a run goes on in the arrays that it began with
        example = row, values, state
        self.operations, self._length = period.operations, period.length
        checks = [verified("the loop", step, period.step, lambda: _samples(example))]
        if period.inner is not None:
            checks.append(verified("the plant", substep, period.inner, lambda: _samples(example), "substep"))

        def verify(module: NativeModule) -> None:
            for check in checks:
                check(module)

        names = ("loop", "kernel", *(("substep",) if repeats else ()))
        command = next((field for field in self.outputs.fields if field.path == COMMAND), None)

        def text() -> str:
            return "\n".join([period.text(), loop_text(memory.size, repeats, command)])

        self._at = functools.partial(compiled, repr(command).encode() + period.content, text, names, verify)
        self._level, self._ticks = -1, 0
        self.expect(ticks)

    def expect(self, ticks: int | None) -> None:
        """Get ready for so many ticks more, or for any number."""
        if ticks is not None:
            self._ticks += ticks
        level = level_for(None if ticks is None else self._ticks * self.operations / max(self._length, 1))
        if level <= self._level:
            return
        self._level = level
        self.module: NativeModule = self._at(level=level)
        kinds = [ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64, *[ctypes.c_void_p] * 3, ctypes.c_int64]
        self._loop = ctypes.CFUNCTYPE(ctypes.c_int64, *kinds)(self.module["loop"])

    def run(self, inputs: Float64Array, parameters: Float64Array, memory: Float64Array, outputs: Float64Array) -> int:
        """Steps with one row of inputs and of outputs each; the number of them that ended in finite memory.

        The interpreter's lock is released meanwhile.
        """
        for array in (inputs, parameters, memory, outputs):
            assert array.dtype == np.float64
            assert array.flags.c_contiguous
        assert inputs.shape[1:] == () or inputs.ndim == 2
        return int(
            self._loop(
                len(inputs),
                inputs.ctypes.data,
                inputs.shape[1],
                parameters.ctypes.data,
                memory.ctypes.data,
                outputs.ctypes.data,
                outputs.shape[1],
            )
        )


# A loop keeps its code, so that it is traced once however often it runs. The code is that of a twin of the loop: code
# that held the loop itself would never be released.
_COMPILED: Final[WeakKeyDictionary[Loop, NativeLoop | FloatLoop]] = WeakKeyDictionary()


def compiled_loop(
    loop: Loop,
    blocks: tuple[Block, Block, Block],
    example: tuple[Float64Array, Float64Array, Float64Array],
    *,
    sound: bool = True,
) -> NativeLoop | FloatLoop:
    """The code of a loop for its engine, made once.

    Args:
        loop: The loop.
        blocks: Of inputs, parameters and memory.
        example: A state of each, flat.
        sound: Whether engines can be compared at the example; plain Python that is not kept if they cannot.
    """
    made = _COMPILED.get(loop)
    if made is not None:
        if isinstance(made, NativeLoop):
            made.expect(loop.ticks)
        return made
    twin = copy.copy(loop)
    functions = twin.step, twin.substep, loop.plant.substeps - 1
    if loop.engine == "native" and sound:
        made = NativeLoop(*functions, *blocks, example, loop.ticks)
    else:
        made = FloatLoop(*functions, *blocks, example)
    if sound:
        _COMPILED[loop] = made
    return made


def _samples(
    example: tuple[Float64Array, Float64Array, Float64Array],
) -> list[tuple[Float64Array, Float64Array, Float64Array]]:
    """The example, and two states near it."""
    rng = np.random.default_rng(0)
    inputs, parameters, memory = example
    near = [memory + 0.01 * rng.standard_normal(memory.shape) for _ in range(2)]
    return [(inputs, parameters, m) for m in (memory, *near)]


def loop_text(memory_size: int, repeats: int, command: Field | None = None) -> str:
    """LLVM text of `loop`: `kernel`, then `substep` `repeats` times, for each row of inputs and outputs.

    It returns the number of steps done: fewer than asked where the new memory, or the command among the outputs, was
    not finite; new memory is then not kept. A drive that saturates would make a finite torque of an infinite command.
    """
    w = Writer()
    w.line(
        "entry:",
        f" %new = alloca [{max(memory_size, 1)} x double], align 32",
        " %none = icmp sle i64 %count, 0",
        " br i1 %none, label %end, label %head",
        "head:",
        " %k = phi i64 [0, %entry], [%next, %kept]",
        " %in_at = mul i64 %k, %input_stride",
        " %in = getelementptr double, ptr %inputs, i64 %in_at",
        " %out_at = mul i64 %k, %output_stride",
        " %out = getelementptr double, ptr %outputs, i64 %out_at",
    )
    write_period(w, "%parameters", "%memory", repeats, "check")
    guarded = [("%new", memory_size)]
    if command is not None:
        guarded.append((w.put(f"getelementptr double, ptr %out, i64 {command.offset}"), command.size))
    for pointer, size in guarded:
        wrong = w.not_finite(pointer, size)
        if wrong is not None:
            w.unless(wrong, "bad")
    w.line(" br label %kept", "bad:", " ret i64 %k", "kept:")
    w.copy("%new", "%memory", memory_size)
    w.line(
        " %next = add i64 %k, 1",
        " %done = icmp sge i64 %next, %count",
        " br i1 %done, label %end, label %head",
        "end:",
        " ret i64 %count",
    )
    return w.function(
        "i64 @loop(i64 %count, ptr %inputs, i64 %input_stride, ptr %parameters, ptr %memory, ptr %outputs, "
        "i64 %output_stride) nounwind"
    )
