"""LaneLoop: a control period over many ticks of many runs at once, one run in each lane of the processor.

Blocks of numbers are (groups, numbers, lanes): what one instruction reads lies side by side. The bits of a lane are
those of `StepLoop`: the same program, of which outputs that nobody asks for are left out.
"""

from __future__ import annotations

import ctypes
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array
from taut.codegen.engine import Steps
from taut.codegen.lanes.writer import LaneWriter
from taut.codegen.llvm import CACHE_LINE, Lanes, declarations, kernel, products_in_sums
from taut.codegen.loop import COMMAND, TracedSteps
from taut.codegen.native import compiled
from taut.codegen.noise import NOISE, key, noise_text
from taut.codegen.program import Block, Program, Values, trace

Rows: TypeAlias = NDArray[np.floating[Any]]
Reduce: TypeAlias = Callable[[Values, Values, Values, Values], Values]
"""(inputs, parameters, record of a tick, what was kept before) -> what is kept after it, by path."""

Run: TypeAlias = Callable[[tuple[int, int, int, int], tuple[Any, ...]], None]
"""Of ticks, first tick, groups, numbers from group to group in rows; of rows, keys, parameters, memory, outputs."""

LANE_ALIVE: Final = "lane.alive"  # 1.0 until memory or command is not finite
LANE_TICKS: Final = "lane.ticks"  # that ended in finite memory and command


class NotInLanes(Exception):  # noqa: N818  # no error
    """The start of a loop is for numbers alone, such as that of a user's own plant."""


class LaneLoop:
    """The code of a step, its substeps and its start, in lanes.

    Args:
        steps: With a start; `NotInLanes` where that cannot be traced.
        lanes: Number and type.
        kept: Shapes of what is kept from tick to tick besides memory, by path; of a lane that has diverged as it was
            before.
        reduce: How; traced with the step.
        recorded: Whether outputs are written, as `StepLoop` writes them, and not reduced.
        run: Makes what runs it; machine code of the CPU if left out.
    """

    def __init__(
        self,
        steps: Steps,
        lanes: Lanes,
        *,
        kept: Mapping[str, tuple[int, ...]],
        reduce: Reduce,
        recorded: bool = False,
        run: Callable[[LaneLoop], Run] | None = None,
    ) -> None:
        self.lanes, self._steps, self.recorded = lanes, steps, recorded
        traced = TracedSteps(steps)
        if traced.start is None:
            raise NotInLanes
        self.kept = Block.of({} if recorded else dict(kept))
        self.memory = Block.of({**steps.memory.shapes, **self.kept.shapes, LANE_ALIVE: (), LANE_TICKS: ()})
        whole = self._traced(reduce)
        own = dataclasses.replace(whole, memory_nodes=whole.memory_nodes[: steps.memory.size])
        self.program = own if recorded else self._reduced(whole, own)
        self.outputs = self.program.outputs
        # The products that are rounded with their sums are those of the whole step, whatever is asked of it here.
        self._fused, self._traced_steps = products_in_sums(own), traced
        self.sizes = {"parameters": steps.parameters.size, "memory": self.memory.size, "outputs": self.outputs.size}
        self._run = (run or native_run)(self)

    @property
    def content(self) -> bytes:
        """What the text is made from."""
        head = repr((self.lanes, self.memory.size, self._steps.repeats, self.recorded, self.outputs)).encode()
        return head + self.program.content + self._traced_steps.content

    def text(self) -> str:
        """LLVM text of `advance`, and of what it calls."""
        lanes, start, inner = self.lanes, self._traced_steps.start, self._traced_steps.inner
        assert start is not None
        parts = [declarations(lanes), noise_text(self._steps.inputs, lanes)]
        parts += [kernel(self.program, "kernel", lanes, self._fused), kernel(start, "start", lanes)]
        parts += [] if inner is None else [kernel(inner, "substep", lanes)]
        return "\n".join([*parts, self._text()])

    def _traced(self, reduce: Reduce) -> Program:
        """The step and what is kept, as one program; memory of the step first."""
        steps, kept = self._steps, self.kept.shapes

        def both(inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:
            before = {path: memory[path] for path in steps.memory.shapes}
            record, after = steps.step(inputs, parameters, before)
            new = reduce(inputs, parameters, record, {path: memory[path] for path in kept}) if kept else {}
            return record, {**after, **new}

        return trace(both, steps.inputs, steps.parameters, Block.of({**steps.memory.shapes, **kept}))

    def _reduced(self, whole: Program, own: Program) -> Program:
        """The program whose outputs are what is kept, and the command, which must be finite."""
        command = whole.outputs.field(COMMAND)
        nodes = whole.memory_nodes[self._steps.memory.size :]
        nodes += whole.output_nodes[command.offset : command.offset + command.size]
        shapes = {**self.kept.shapes, COMMAND: command.shape}
        return dataclasses.replace(own, outputs=Block.of(shapes), output_nodes=nodes)

    # ---------------------------------------------------------------- blocks

    def block(self, groups: int, size: int, ticks: int | None = None) -> Rows:
        """Room for numbers of so many groups of lanes, at a cache line."""
        shape = (groups, size) if ticks is None else (groups, ticks, size)
        return _aligned((*shape, self.lanes.side), self.lanes.real.dtype)

    def spread(self, rows: Float64Array) -> Rows:
        """Numbers (runs, size) of each run in lanes; runs that fill the last group are like the last one."""
        w = self.lanes.side
        groups = -(-len(rows) // w)
        padded = rows[np.minimum(np.arange(groups * w), len(rows) - 1)]
        out = self.block(groups, rows.shape[1])
        out[...] = padded.reshape(groups, w, -1).transpose(0, 2, 1)
        return out

    def keys(self, seeds: NDArray[np.uint64]) -> NDArray[np.uint32]:
        """(groups, 2, lanes) keys of the noise of each run."""
        w = self.lanes.side
        groups = -(-len(seeds) // w)
        padded = seeds[np.minimum(np.arange(groups * w), len(seeds) - 1)]
        words = np.stack(key(padded)).astype(np.uint32)
        return np.ascontiguousarray(words.reshape(2, groups, w).transpose(1, 0, 2))

    @staticmethod
    def gathered(block: Rows, runs: int) -> Float64Array:
        """The inverse of `spread`: (runs, size), or (runs, ticks, size)."""
        moved = np.moveaxis(block, -1, 1)
        return moved.reshape(-1, *moved.shape[2:])[:runs].astype(np.float64)

    # ---------------------------------------------------------------- running

    def advance(
        self, first: int, rows: Rows, keys: Any, parameters: Rows, memory: Rows, outputs: Rows | None = None
    ) -> None:
        """Some ticks from `first` on, of all groups. Releases the GIL.

        Args:
            first: Number of the first of these ticks; 0 begins the runs.
            rows: Inputs without noise, (ticks, size) for all runs, or (groups, ticks, size, lanes).
            keys: Of the noise.
            parameters: (groups, size, lanes).
            memory: (groups, size, lanes), in which the runs go on; where they begin its first numbers are q and v.
            outputs: (groups, ticks, size, lanes) the record, where that is written.
        """
        ticks = rows.shape[-2] if rows.ndim == 2 else rows.shape[1]
        out = self.block(1, self.outputs.size) if outputs is None else outputs
        assert rows.dtype == self.lanes.real.dtype
        assert rows.flags.c_contiguous
        stride = 0 if rows.ndim == 2 else rows[0].size
        self._run((ticks, first, len(parameters), stride), (rows, keys, parameters, memory, out))

    # ---------------------------------------------------------------- text

    @property
    def row_size(self) -> int:
        """Number of inputs without noise, which stand before it."""
        fields = [field for field in self._steps.inputs.fields if not field.path.startswith(NOISE)]
        assert all(field.offset + field.size <= self._steps.inputs.size for field in fields)
        return sum(field.size for field in fields)

    def _text(self) -> str:
        """LLVM text of `advance`."""
        lanes, steps, w = self.lanes, self._steps, LaneWriter(self.lanes)
        own, real = steps.memory.size, self.lanes.real.name
        alive, ticks = (self.memory.field(path).offset for path in (LANE_ALIVE, LANE_TICKS))
        one, zero, truth = lanes.number(1.0), lanes.number(0.0), lanes.of("i1")
        step = self.outputs.size * lanes.side if self.recorded else 0
        w.enter(steps.start_inputs.size)
        w.group(steps.parameters.size, self.memory.size)
        w.line(" br i1 %starts, label %begin, label %group", "begin:")
        w.fill("%first_row", self.row_size, "begun")
        w.noise("%now", "0")
        for i in range(steps.inputs.size, steps.start_inputs.size):
            w.store(w.load("%memory", i - steps.inputs.size), "%own", i)
        w.line(" call void @start(ptr %own, ptr %parameter, ptr %memory, ptr %memory, ptr %memory)")
        for i in range(own, self.memory.size):
            w.store(one if i == alive else zero, "%memory", i)
        w.line(
            " br label %group",
            "group:",
            f" %span = mul i64 %ticks, {step}",
            " %outat = mul i64 %g, %span",
            f" %outs = getelementptr {real}, ptr %outputs, i64 %outat",
            f" %width = select i1 %shared, i64 {self.row_size}, i64 {self.row_size * lanes.side}",
            " br label %tick",
            "tick:",
            " %k = phi i64 [0, %group], [%k1, %kept]",
            " %along = mul i64 %k, %width",
            " %at = add i64 %shift, %along",
            f" %row = getelementptr {real}, ptr %rows, i64 %at",
            f" %outk = mul i64 %k, {step}",
            f" %out = getelementptr {real}, ptr %outs, i64 %outk",
            " %tick64 = add i64 %first, %k",
            " %tick32 = trunc i64 %tick64 to i32",
        )
        w.fill("%row", self.row_size, "filled")
        w.noise("%thistick", "%tick32")
        w.line(" call void @kernel(ptr %own, ptr %parameter, ptr %memory, ptr %memory, ptr %out)")
        if steps.repeats:
            w.line(
                " br label %inner",
                "inner:",
                " %i = phi i64 [0, %filled], [%i1, %inner]",
                " call void @substep(ptr %own, ptr %parameter, ptr %memory, ptr %memory, ptr %out)",
                " %i1 = add i64 %i, 1",
                f" %again = icmp slt i64 %i1, {steps.repeats}",
                " br i1 %again, label %inner, label %kept",
            )
        else:
            w.line(" br label %kept")
        w.line("kept:")
        command = self.outputs.field(COMMAND)
        numbers = [("%memory", i) for i in range(own)]
        numbers += [("%out", command.offset + i) for i in range(command.size)]
        total = w.sum(lanes.type, [w.itself_away(*number) for number in numbers])
        before = w.put(f"fcmp oeq {lanes.type} {w.load('%memory', alive)}, {one}")
        goes = w.put(f"and {truth} {before}, {w.put(f'fcmp oeq {lanes.type} {total}, {zero}')}")
        w.store(w.put(f"select {truth} {goes}, {lanes.type} {one}, {lanes.type} {zero}"), "%memory", alive)
        more = w.put(f"fadd {lanes.type} {w.load('%memory', ticks)}, {w.load('%memory', alive)}")
        w.store(more, "%memory", ticks)
        for i in range(self.kept.size):
            old, new = w.load("%memory", own + i), w.load("%out", i)
            w.store(w.put(f"select {truth} {goes}, {lanes.type} {new}, {lanes.type} {old}"), "%memory", own + i)
        w.line(
            " %k1 = add i64 %k, 1", " %on = icmp slt i64 %k1, %ticks", " br i1 %on, label %tick, label %done", "done:"
        )
        w.leave()
        numbers_in = "i64 %ticks, i64 %first, i64 %groups, i64 %stride"
        arguments = f"{numbers_in}, ptr %rows, ptr %keys, ptr %parameters, ptr %memories, ptr %outputs"
        return w.function(f"void @advance({arguments}) {lanes.attributes}")


def native_run(code: LaneLoop) -> Run:
    """`advance` in machine code."""
    module = compiled(code.content, code.text, ("advance",))
    advance = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 4, *[ctypes.c_void_p] * 5)(module["advance"])

    def run(numbers: tuple[int, int, int, int], blocks: tuple[Any, ...]) -> None:
        assert module  # the code lives as long as this
        advance(*numbers, *(block.ctypes.data for block in blocks))

    return run


def _aligned(shape: tuple[int, ...], dtype: type[np.floating[Any]]) -> Rows:
    """Zeros whose memory begins at a cache line."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + CACHE_LINE, dtype=np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + size].view(dtype).reshape(shape)
