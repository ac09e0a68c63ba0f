"""StepLoop: a control period, repeated without coming back to Python between its ticks, by either engine."""

from __future__ import annotations

import copy
import ctypes
import functools
from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np

from taut.base.errors import TautError
from taut.base.types import Float64Array
from taut.codegen.engine import Engine, Flat, Steps, machine_code, plain, verified
from taut.codegen.llvm import Writer, declarations, kernel
from taut.codegen.native import NativeModule, compiled, level_for
from taut.codegen.program import Block, Field, Program, Values, trace
from taut.loop import Kept, Loop

BLOCKS: Final = ("input", "parameter", "memory", "output")
COMMAND = "command"  # the output that must be finite as memory must be
Run: TypeAlias = Callable[..., int]
"""On arrays of inputs, parameters, memory and outputs; the number of ticks done."""


class TracedSteps:
    """A step and its substeps, traced: what the native code of a control period is written from."""

    def __init__(self, steps: Steps) -> None:
        blocks = steps.inputs, steps.parameters, steps.memory
        self.step: Program = trace(steps.step, *blocks)
        self.inner: Program | None = None
        if steps.repeats and steps.substep is not None:
            self.inner = trace(steps.substep, *blocks)
        self.repeats = steps.repeats
        self.start = _traced_start(steps)
        inner = 0 if self.inner is None else self.inner.operations
        self.operations = self.step.operations + inner * self.repeats  # of a period

    @property
    def content(self) -> bytes:
        """A digest of its code."""
        inner = b"" if self.inner is None else self.inner.content + self.repeats.to_bytes(8, "little")
        start = b"" if self.start is None else self.start.content
        return self.step.content + inner + start

    def text(self) -> str:
        """LLVM text of `kernel`, and of `substep` and `start` where there are some."""
        parts = [declarations(), kernel(self.step, "kernel")]
        if self.inner is not None:
            parts.append(kernel(self.inner, "substep"))
        if self.start is not None:
            parts.append(kernel(self.start, "start"))
        return "\n".join(parts)


def _traced_start(steps: Steps) -> Program | None:
    """The start of a loop; None of one that is for numbers alone, such as that of a user's own plant."""
    if steps.start is None:
        return None
    try:
        return trace(steps.start, steps.start_inputs, steps.parameters, Block())
    except TautError:
        return None


class StepLoop:
    """A step and its substeps as a loop over many ticks.

    Machine code is compared with plain Python, when it is compiled, at the example and near it: at zeros a law may
    be singular. For few ticks it is compiled quickly; `expect` more and it is compiled again, to run fast.
    """

    def __init__(
        self,
        steps: Steps,
        example: Flat,
        *,
        engine: Engine,
        ticks: int | None = None,
        begin: Float64Array | None = None,  # inputs of `start`, at which it is compared too
    ) -> None:
        self.engine, self._begin = engine, begin
        self.raised: Exception | None = None  # by plain Python in the last run; compiled code raises nothing
        self.operations = 0  # of a period, where it is traced
        self.starts = False  # whether `start` is machine code
        self.memory = steps.memory
        self.begun = b""  # the last start that was checked
        self.size = 0  # of a block of ticks that takes as long as its run wants; 0 until one has run
        self._steps = steps
        self._run: Run = self._plain_run
        self._level, self._ticks = -1, 0  # at which it is compiled, and for how many ticks
        if engine == "native":
            self._compile(TracedSteps(steps), tuple(part.copy() for part in example), ticks)
        else:
            blocks = steps.inputs, steps.parameters, steps.memory
            with np.errstate(all="ignore"):
                record, _ = steps.step(*(b.views(flat.copy()) for b, flat in zip(blocks, example, strict=True)))
            self.outputs = Block.of({path: np.shape(value) for path, value in record.items()})
            self._step = plain(steps.step, *blocks, new=steps.memory, outputs=self.outputs)
            if steps.substep is not None:
                self._substep = plain(steps.substep, *blocks, new=steps.memory, outputs=Block())

    def run(self, inputs: Float64Array, parameters: Float64Array, memory: Float64Array, outputs: Float64Array) -> int:
        """Ticks with one row of inputs and of outputs each; the number of them that ended in finite memory.

        With rows of memory, each tick goes on from its own and none ends the others; one row of inputs may serve all.
        What the Python code of a step raises ends the ticks, and is kept in `raised`. Machine code releases the GIL.
        """
        for array in (inputs, parameters, memory, outputs):
            assert array.dtype == np.float64
            assert array.flags.c_contiguous
        assert inputs.ndim == outputs.ndim == 2
        return self._run(inputs, parameters, memory, outputs)

    def start(self, inputs: Float64Array, parameters: Float64Array) -> Float64Array:
        """The memory in the first tick. Machine code, where there is some, checks nothing."""
        steps, memory = self._steps, self._steps.memory.zeros()
        assert steps.start is not None
        nothing = np.zeros(0)
        if self.starts:
            machine_code(self.module["start"])(inputs, parameters, nothing, nothing, memory)
        else:
            evaluate = plain(
                steps.start, steps.start_inputs, steps.parameters, Block(), new=Block(), outputs=steps.memory
            )
            evaluate(inputs, parameters, nothing, nothing, memory)
        return memory

    def expect(self, ticks: int | None) -> None:
        """Get ready for so many ticks more, or for any number."""
        if self.engine == "float":
            return
        if ticks is not None:
            self._ticks += ticks
        level = level_for(None if ticks is None else self._ticks * (1 + self._steps.repeats))
        if level > self._level:
            self._level = level
            self.module: NativeModule = self._at(level=level)
            self._run = native_loop(self.module["loop"])

    def _compile(self, traced: TracedSteps, example: tuple[Float64Array, ...], ticks: int | None) -> None:
        steps, self.outputs = self._steps, traced.step.outputs
        self.operations = traced.operations
        rng = np.random.default_rng(0)
        inputs, parameters, memory = example  # copies, for a run goes on in the arrays that it began with
        near = [memory, *(memory + 0.01 * rng.standard_normal(memory.shape) for _ in range(2))]
        samples = [(inputs, parameters, one) for one in near]
        checks = [verified("the loop", steps.step, traced.step, lambda: samples)]
        if traced.inner is not None and steps.substep is not None:
            checks.append(verified("the plant", steps.substep, traced.inner, lambda: samples, "substep"))

        def verify(module: NativeModule) -> None:
            for check in checks:
                check(module)

        self.starts = traced.start is not None
        if traced.start is not None and steps.start is not None:
            begin = [] if self._begin is None else [(self._begin.copy(), parameters, np.zeros(0))]
            checks.append(verified("the start of the loop", steps.start, traced.start, lambda: begin, "start"))
        more = {"substep": traced.inner, "start": traced.start}
        names = ("loop", "kernel", *(name for name, program in more.items() if program is not None))
        command = next((field for field in self.outputs.fields if field.path == COMMAND), None)

        def text() -> str:
            return "\n".join([traced.text(), loop_text(memory.size, traced.repeats, command)])

        self._at = functools.partial(compiled, repr(command).encode() + traced.content, text, names, verify)
        self.expect(ticks)

    def _plain_run(
        self, inputs: Float64Array, parameters: Float64Array, memory: Float64Array, outputs: Float64Array
    ) -> int:
        self.raised = None
        for k, given in enumerate(np.broadcast_to(inputs, (len(outputs), inputs.shape[1]))):
            old = memory if memory.ndim == 1 else memory[k]
            new = old.copy()
            try:
                self._step(given, parameters, old, new, outputs[k])
                for _ in range(self._steps.repeats):
                    self._substep(given, parameters, new, new, np.zeros(0))
            except Exception as error:
                self.raised = error
                return k
            command = self.outputs.views(outputs[k]).get(COMMAND, 0.0)
            if memory.ndim == 1 and not (np.isfinite(new).all() and np.isfinite(command).all()):
                return k
            old[:] = new
        return len(outputs)


def compiled_loop(
    loop: Loop, blocks: tuple[Block, Block, Block], example: Flat, q: Float64Array, v: Float64Array
) -> StepLoop:
    """The code of a loop for its engine, made once; compared with plain Python at an example, which began at q, v."""
    made = known_loop(loop)
    if made is not None:
        made.expect(loop.ticks)
        return made
    begin = np.concatenate([example[0], q, v])
    made = StepLoop(steps_of(loop, *blocks), example, engine=loop.engine, ticks=loop.ticks, begin=begin)
    loop.kept.code = made
    return made


def known_loop(loop: Loop) -> StepLoop | None:
    """The code of a loop, where it is made."""
    code: StepLoop | None = loop.kept.code
    return code


def steps_of(loop: Loop, inputs: Block, parameters: Block, memory: Block) -> Steps:
    """Start, step and substep of a loop, as it is now; they hold a twin of it, since it keeps the code."""
    twin, n = copy.copy(loop), loop.plant.arm.n
    vars(twin).update(side=copy.copy(loop.side), kept=Kept(), parameters={})

    def start(inputs: Values, parameters: Values, _: Values) -> tuple[Values, Values]:
        return twin.start(inputs["start.q"], inputs["start.v"], inputs, parameters), {}

    more = Block.of({**inputs.shapes, "start.q": (n,), "start.v": (n,)})
    return Steps(twin.step, inputs, parameters, memory, twin.substep, loop.plant.substeps - 1, start, more)


def native_loop(address: int) -> Run:
    """A compiled `loop` on arrays: rows of inputs, of parameters and of memory, or one for all ticks."""
    places = [ctypes.c_void_p, ctypes.c_int64]
    loop = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, *places * 4)(address)

    def run(*arrays: Float64Array) -> int:
        count, given = len(arrays[-1]), list[int]()
        for array in arrays:
            given += [array.ctypes.data, array.shape[1] if array.ndim == 2 and len(array) == count else 0]
        return int(loop(count, *given))

    return run


def loop_text(memory_size: int, repeats: int, command: Field | None = None) -> str:
    """LLVM text of `loop`: `kernel` from memory to %new, then `substep` in %new, for each row of the blocks.

    A stride of 0 is one row for all: of memory, in which each tick goes on from the last. That ends where memory or
    command is not finite, for a drive that saturates would make a finite torque of an infinite one. The number of
    steps done is returned.
    """
    w = Writer()
    w.line(
        "entry:",
        f" %new = alloca [{max(memory_size, 1)} x double], align 32",
        " %none = icmp sle i64 %count, 0",
        " br i1 %none, label %end, label %head",
        "head:",
        " %k = phi i64 [0, %entry], [%next, %kept]",
    )
    for name in BLOCKS:
        w.line(
            f" %{name}_at = mul i64 %k, %{name}_stride",
            f" %{name} = getelementptr double, ptr %{name}s, i64 %{name}_at",
        )
    w.line(" call void @kernel(ptr %input, ptr %parameter, ptr %memory, ptr %new, ptr %output)")
    if repeats:
        w.line(
            " br label %inner",
            "inner:",
            " %i = phi i64 [0, %head], [%i1, %inner]",
            " call void @substep(ptr %input, ptr %parameter, ptr %new, ptr %new, ptr %output)",
            " %i1 = add i64 %i, 1",
            f" %again = icmp slt i64 %i1, {repeats}",
            " br i1 %again, label %inner, label %check",
        )
    else:
        w.line(" br label %check")
    w.line("check:")
    guarded = [("%new", memory_size)]
    if command is not None:
        guarded.append((w.put(f"getelementptr double, ptr %output, i64 {command.offset}"), command.size))
    for pointer, size in guarded:
        wrong = w.not_finite(pointer, size)
        if wrong is not None:
            w.unless(wrong, "bad")
    w.line(
        " br label %kept",
        "bad:",
        " %alone = icmp ne i64 %memory_stride, 0",
        " br i1 %alone, label %kept, label %broken",
        "broken:",
        " ret i64 %k",
        "kept:",
    )
    w.copy("%new", "%memory", memory_size)
    w.line(
        " %next = add i64 %k, 1",
        " %done = icmp sge i64 %next, %count",
        " br i1 %done, label %end, label %head",
        "end:",
        " ret i64 %count",
    )
    blocks = ", ".join(f"ptr %{name}s, i64 %{name}_stride" for name in BLOCKS)
    return w.function(f"i64 @loop(i64 %count, {blocks}) nounwind")
