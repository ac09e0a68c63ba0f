"""RowCode: a program for many rows of numbers at once, a row in each lane of the processor.

What goes in and out are arrays with a row for each of n lanes, as simulators have them. A row is a block as C has it,
fields in order; rows may lie any distance apart, and one row may serve all lanes. Numbers are put into lanes, and
taken out, on the way between memory and registers: a tenth of the time of an impedance law, a third of that of a PID.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import UsageError
from taut.codegen.lanes.loop import LANE_TICKS
from taut.codegen.lanes.writer import LaneWriter
from taut.codegen.llvm import Lanes, declarations, kernel
from taut.codegen.native import compiled
from taut.codegen.program import Block, Field, Program

LANE_FRESH: Final = "lane.fresh"  # 1.0 where the next tick starts the memory; lane.ticks is since that start
OPERATIONS: Final = 1_000_000  # that are worth another thread: 0.1 ms
TIME: Final = "t"  # an input of a tick that is made here, of lane.ticks and the period
PERIOD: Final = "dt"
HOST: Final = (1, 3)  # of DLPack's kinds of memory: that of the CPU, as it is and pinned
KINDS: Final = {2: "cuda", 4: "opencl", 7: "vulkan", 8: "metal", 10: "rocm", 13: "cuda", 14: "oneapi"}


class RowCode:
    """A pure function of rows; with a `start` it is a tick, whose memory goes on in its rows, and which has the time.

    A row in which a number that goes in, comes out or is remembered is not finite gives NaN in all that comes out,
    and its memory stays as it was; no other row sees it.

    Args:
        program: Whose outputs are what comes out.
        lanes: Number and type.
        start: Of the memory in the first tick, from inputs and parameters.
        substep: Of the memory, from that of the tick on; and how often.
    """

    def __init__(
        self,
        program: Program,
        lanes: Lanes,
        *,
        start: Program | None = None,
        substep: tuple[Program, int] | None = None,
    ) -> None:
        self.lanes, self.program, self._start, self._substep = lanes, program, start, substep
        more = {} if start is None else {LANE_FRESH: (), LANE_TICKS: ()}
        self.memory = Block.of({**program.memory.shapes, **more})
        inputs = [field for field in program.inputs.fields if start is None or field.path != TIME]
        self._given = [("inputs", field) for field in inputs]
        self._given += [("parameters", field) for field in program.parameters.fields]
        self._made = [("outputs", field) for field in program.outputs.fields]
        if start is not None:
            self._given.append(("memory", Field("memory", (self.memory.size,), 0)))
            self._made.append(self._given[-1])
        self.fields = list(dict.fromkeys(field.path for _, field in (*self._given, *self._made)))
        """All that goes in and out: fields of inputs and parameters by path, "memory" of a tick, and outputs."""
        self.words = 3 if lanes.thread else 2
        """Numbers of the place of a field: address, bytes from row to row, and in threads from number to number."""

    @functools.cached_property
    def rows(self) -> Any:
        """`rows` in machine code."""
        program, start, substep = self.program, self._start, self._substep
        content = repr((self.lanes, program.inputs, program.parameters, program.outputs)).encode() + program.content
        content += b"" if start is None else start.content
        content += b"" if substep is None else substep[0].content + repr(substep[1]).encode()
        self._module = compiled(b"rows" + content, self.text, ("rows",))
        return ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 3, *[ctypes.c_void_p] * 2)(self._module["rows"])

    # ---------------------------------------------------------------- text

    def text(self) -> str:
        """LLVM text of `rows(first group, last group, n, places, finite)`, and of what it calls."""
        lanes, start, substep = self.lanes, self._start, self._substep
        parts = [declarations(lanes), kernel(self.program, "kernel", lanes)]
        parts += [] if start is None else [kernel(start, "start", lanes)]
        parts += [] if substep is None else [kernel(substep[0], "substep", lanes)]
        return "\n".join([*parts, self._text()])

    def _text(self) -> str:
        program, lanes, w = self.program, self.lanes, LaneWriter(self.lanes)
        own, t, truth = program.memory.size, lanes.type, lanes.of("i1")
        sizes = {"inputs": program.inputs.size, "parameters": program.parameters.size, "memory": self.memory.size}
        sizes |= {"new": own, "outputs": program.outputs.size}
        w.line("entry:")
        for name, size in sizes.items():
            w.room(f"%{name}", size)
        w.flush()
        for k in range(len(self.fields)):
            for at, (name, kind) in enumerate((("base", "ptr"), ("stride", "i64"), ("step", "i64"))[: self.words]):
                w.line(f" %{name}at{k} = getelementptr i64, ptr %places, i64 {self.words * k + at}")
                w.line(f" %{name}{k} = load {kind}, ptr %{name}at{k}")
        w.line(
            " %end = sub i64 %n, 1",
            " %none = icmp sge i64 %first, %last",
            " br i1 %none, label %done, label %group",
            "group:",
            " %g = phi i64 [%first, %entry], [%g1, %leave]",
            " %begins = icmp eq i64 %g, %first",
            f" %row = mul i64 %g, {lanes.count}",
        )
        rows = []
        for i in range(lanes.count):  # lanes beyond the last row do what that of the last row does
            beyond = w.put(f"icmp sgt i64 {w.put(f'add i64 %row, {i}')}, %end")
            rows.append(w.put(f"select i1 {beyond}, i64 %end, i64 {w.put(f'add i64 %row, {i}')}"))
        for k, (block, field) in enumerate(self._given):  # what is the same for all is read once
            differs = w.put(f"icmp ne i64 %stride{k}, 0")
            w.line(f" br i1 {w.put(f'or i1 %begins, {differs}')}, label %read{k}, label %given{k}", f"read{k}:")
            self._gather(w, k, rows, block, field)
            w.line(f" br label %given{k}", f"given{k}:")
        if self._start is not None:
            self._begin(w)
        w.line(" call void @kernel(ptr %inputs, ptr %parameters, ptr %memory, ptr %new, ptr %outputs)")
        if self._substep is not None:
            before = f"given{len(self._given) - 1}" if self._start is None else "go"
            w.line(
                " br label %inner",
                "inner:",
                f" %i = phi i64 [0, %{before}], [%i1, %inner]",
                " call void @substep(ptr %inputs, ptr %parameters, ptr %new, ptr %new, ptr %new)",
                " %i1 = add i64 %i, 1",
                f" %again = icmp slt i64 %i1, {self._substep[1]}",
                " br i1 %again, label %inner, label %stepped",
                "stepped:",
            )
        checked = (("inputs", sizes["inputs"]), ("new", own), ("outputs", sizes["outputs"]))
        total = w.sum(t, [w.itself_away(f"%{name}", i) for name, size in checked for i in range(size)])
        w.line(f" %finites = fcmp oeq {t} {total}, {lanes.number(0.0)}")

        def choose(yes: str, no: str, block: str, i: int) -> None:
            w.store(w.put(f"select {truth} %finites, {t} {yes}, {t} {no}"), block, i)

        for i in range(program.outputs.size):
            choose(w.load("%outputs", i), lanes.number(np.nan), "%outputs", i)
        if self._start is not None:
            more = w.put(f"fadd {t} {w.load('%memory', own + 1)}, {lanes.number(1.0)}")
            new = [*(w.load("%new", i) for i in range(own)), lanes.number(0.0), more]
            for i, value in enumerate(new):
                choose(value, w.load("%memory", i), "%memory", i)
        for block, field in self._made:
            self._scatter(w, self.fields.index(field.path), rows, block, field)
        for i, row in enumerate(rows):
            bit = "%finites" if lanes.count == 1 else w.put(f"extractelement {truth} %finites, i64 {i}")
            place = w.put(f"getelementptr i8, ptr %finite, i64 {row}")
            w.line(f" store i8 {w.put(f'zext i1 {bit} to i8')}, ptr {place}")
        w.line(
            " br label %leave",
            "leave:",
            " %g1 = add i64 %g, 1",
            " %next = icmp slt i64 %g1, %last",
            " br i1 %next, label %group, label %done",
            "done:",
        )
        w.restore()
        w.line(" ret void")
        return w.function(f"void @rows(i64 %first, i64 %last, i64 %n, ptr %places, ptr %finite) {lanes.attributes}")

    def _begin(self, w: LaneWriter) -> None:
        """The time; and where a lane is fresh, its memory."""
        lanes, own, t = self.lanes, self.program.memory.size, self.lanes.type
        time, period = self.program.inputs.field(TIME), self.program.parameters.field(PERIOD)
        now = w.put(f"fmul {t} {w.load('%memory', own + 1)}, {w.load('%parameters', period.offset)}")
        w.store(now, "%inputs", time.offset)
        w.line(f" %fresh = fcmp oeq {t} {w.load('%memory', own)}, {lanes.number(1.0)}")
        word, truth = f"i{lanes.count}", lanes.of("i1")
        some = w.put(f"icmp ne {word} {w.put(f'bitcast {truth} %fresh to {word}')}, 0")
        w.line(f" br i1 {some}, label %begin, label %go", "begin:")
        w.line(" call void @start(ptr %inputs, ptr %parameters, ptr %new, ptr %new, ptr %new)")
        for i in range(own):
            begun = f"select {truth} %fresh, {t} {w.load('%new', i)}, {t} {w.load('%memory', i)}"
            w.store(w.put(begun), "%memory", i)
        w.line(" br label %go", "go:")

    # ---------------------------------------------------------------- rows to lanes and back

    def _pointers(self, w: LaneWriter, k: int, rows: list[str]) -> list[str]:
        """The row of each lane in an array."""
        shifts = [w.put(f"mul i64 {row}, %stride{k}") for row in rows]
        return [w.put(f"getelementptr i8, ptr %base{k}, i64 {shift}") for shift in shifts]

    def _number(self, w: LaneWriter, k: int, row: str, i: int) -> str:
        """Where a number of a row is."""
        if self.lanes.thread:
            return w.put(f"getelementptr i8, ptr {row}, i64 {w.put(f'mul i64 %step{k}, {i}')}")
        return w.put(f"getelementptr {self.lanes.real.name}, ptr {row}, i64 {i}")

    def _gather(self, w: LaneWriter, k: int, rows: list[str], block: str, field: Field) -> None:
        real, lanes, pointers = self.lanes.real.name, self.lanes, self._pointers(w, k, rows)
        for i in range(field.size):
            value = "poison"
            for lane, pointer in enumerate(pointers):
                one = w.put(f"load {real}, ptr {self._number(w, k, pointer, i)}")
                wide = lanes.count > 1
                value = w.put(f"insertelement {lanes.type} {value}, {real} {one}, i64 {lane}") if wide else one
            w.store(value, f"%{block}", field.offset + i)

    def _scatter(self, w: LaneWriter, k: int, rows: list[str], block: str, field: Field) -> None:
        real, lanes, pointers = self.lanes.real.name, self.lanes, self._pointers(w, k, rows)
        for i in range(field.size):
            value = w.load(f"%{block}", field.offset + i)
            for lane, pointer in enumerate(pointers):
                one = value if lanes.count == 1 else w.put(f"extractelement {lanes.type} {value}, i64 {lane}")
                w.line(f" store {real} {one}, ptr {self._number(w, k, pointer, i)}")


class RowArrays:
    """The arrays of a `RowCode`, by field: with n rows, or one row for all."""

    strided: Final = False  # the numbers of a row lie side by side

    def __init__(self, code: RowCode, n: int) -> None:
        self.code, self._rows, self.n, self.finite = code, code.rows, n, np.zeros(n, dtype=np.bool_)
        self._index = {path: k for k, path in enumerate(code.fields)}
        self._places = (ctypes.c_int64 * (2 * len(code.fields)))()
        self.kept: dict[str, NDArray[Any]] = {}

    def room(self, shape: tuple[int, ...]) -> NDArray[Any]:
        """Zeros, (n, *shape)."""
        return np.zeros((self.n, *shape), dtype=self.code.lanes.real.dtype)

    def views(self, block: Block, rows: NDArray[Any]) -> Mapping[str, NDArray[Any]]:
        """The fields of a block, sharing the memory of (n, size) rows."""
        return block.views(rows)

    def array(self, name: str, value: Any) -> NDArray[Any]:
        """An array of a caller, where it is."""
        return host_array(name, value)

    host = array

    def sent(self, path: str, array: NDArray[Any], *, per_lane: bool = False) -> NDArray[Any]:  # noqa: ARG002
        """An array of ours, where code reads it."""
        return array

    def begin(self, fresh: NDArray[Any], ticks: NDArray[Any], mask: NDArray[np.bool_]) -> None:
        """The next tick of some lanes is their first."""
        fresh[mask], ticks[mask] = 1.0, 0.0

    def put(self, path: str, array: NDArray[Any], *, per_lane: bool = True) -> None:
        """The array of a field: of the type of the code, its rows without gaps."""
        k, self.kept[path] = self._index[path], array
        self._places[2 * k], self._places[2 * k + 1] = array.ctypes.data, array.strides[0] if per_lane else 0

    def run(self, threads: int = 1) -> None:
        """Evaluate all rows; `finite` (n,) has those without NaN or infinity. Releases the GIL."""
        code, rows, n = self.code, self._rows, self.n
        groups = -(-n // code.lanes.count)
        threads = max(1, min(threads, groups, n * code.program.operations // OPERATIONS))
        ends = [groups * k // threads for k in range(threads + 1)]
        places = ctypes.addressof(self._places), self.finite.ctypes.data
        parts = itertools.pairwise(ends[1:])
        others = [_pool(threads).submit(rows, first, last, n, *places) for first, last in parts]
        rows(0, ends[1], n, *places)
        for other in others:
            other.result()


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="taut")


if hasattr(os, "register_at_fork"):  # the threads stay behind in the parent
    os.register_at_fork(after_in_child=_pool.cache_clear)


# -------------------------------------------------------------------- arrays of others


def host_array(name: str, value: Any) -> NDArray[Any]:
    """An array with DLPack as NumPy's, in the same memory. UsageError for one that is not in that of the CPU."""
    if isinstance(value, np.ndarray):
        return value
    if not hasattr(value, "__dlpack_device__"):
        raise no_dlpack(name, value)
    try:
        kind, number = value.__dlpack_device__()
        if kind in HOST:
            array: NDArray[Any] = np.from_dlpack(value)
            return array
    except (BufferError, RuntimeError, TypeError, ValueError) as cause:
        raise unreadable(name, cause) from cause
    place = named_memory(kind, number)
    raise UsageError(
        f"{name} is in {place}, and this batch runs on the CPU; copy it there, such as by q.cpu()", name=name
    )


def named_memory(kind: int, number: int) -> str:
    """Memory in words, by DLPack's numbers."""
    if kind in HOST:
        return "the memory of the CPU"
    return f"the memory of {KINDS.get(int(kind), f'device {int(kind)}')}:{number}"


def no_dlpack(name: str, value: Any) -> UsageError:
    """The error for what is no array."""
    got = type(value).__name__
    return UsageError(f"{name} must be an array with DLPack, of NumPy, torch, JAX or Warp; got {got}", name=name)


def unreadable(name: str, cause: Exception) -> UsageError:
    """The error for an array that its library does not give."""
    return UsageError(
        f"{name} cannot be read where it is: {cause}; a tensor of float32 or float64 without a gradient can, such as "
        "q.detach(); for gradients take taut.tensors.differentiable",
        name=name,
    )


def row_step(shape: Sequence[int], strides: Sequence[int], itemsize: int) -> int | None:
    """Bytes from one number of a row to the next, row by row; None where they lie unevenly."""
    wide = [(count, stride) for count, stride in zip(shape, strides, strict=True) if count != 1]
    step = wide[-1][1] if wide else itemsize
    for k, (_, stride) in enumerate(wide):
        if stride != step * prod(count for count, _ in wide[k + 1 :]):
            return None
    return step
