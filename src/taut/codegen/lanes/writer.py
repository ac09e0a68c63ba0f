"""LaneWriter: LLVM text of a function that goes over groups of lanes, with what all of them share."""

from __future__ import annotations

import platform
from typing import Final

from taut.codegen.functions import SINGLE
from taut.codegen.llvm import CACHE_LINE, Lanes, Writer, spread

FLUSH: Final = 0x8040  # bits of MXCSR: numbers smaller than the normal ones are zero, not a hundred times slower


class LaneWriter:
    """Writes a function that goes over groups of lanes; a writer, with what such functions share."""

    def __init__(self, lanes: Lanes) -> None:
        self._lanes, self._writer, self._cell = lanes, Writer(), lanes.cell(lanes.real.name)
        self.put, self.line, self.sum = self._writer.put, self._writer.line, self._writer.sum

    def enter(self, inputs: int) -> None:
        """The head of the function: room for the inputs of a group, and the loop over groups."""
        self.line("entry:")
        self.room("%own", inputs)
        self.flush()
        self.line(
            " %shared = icmp eq i64 %stride, 0",
            " %starts = icmp eq i64 %first, 0",
            " %none = icmp sle i64 %groups, 0",
            " br i1 %none, label %end, label %next_group",
        )

    def room(self, name: str, size: int) -> None:
        """Room on the stack for so many numbers in lanes."""
        self.line(f" {name} = alloca [{max(size, 1)} x {self._cell}], align {CACHE_LINE}")

    def flush(self) -> None:
        """Take what is smaller than normal numbers of single precision for zero, until `restore`."""
        if self._flushes:
            self.line(" %mode = alloca i32", " %flush = alloca i32", " call void @llvm.x86.sse.stmxcsr(ptr %mode)")
            old = self.put("load i32, ptr %mode")
            self.line(f" store i32 {self.put(f'or i32 {old}, {FLUSH}')}, ptr %flush")
            self.line(" call void @llvm.x86.sse.ldmxcsr(ptr %flush)")

    def restore(self) -> None:
        """The mode of the processor as it was before `flush`."""
        if self._flushes:
            self.line(" call void @llvm.x86.sse.ldmxcsr(ptr %mode)")

    @property
    def _flushes(self) -> bool:
        lanes = self._lanes
        return lanes.real is SINGLE and not lanes.thread and platform.machine() in ("x86_64", "AMD64")

    def group(self, parameters: int, memory: int) -> None:
        """The head of the loop over groups: where its blocks are."""
        t, word, words = self._cell, self._lanes.of("i32"), self._lanes.cell("i32")
        self.line("next_group:", " %g = phi i64 [0, %entry], [%g1, %done]", " %shift = mul i64 %g, %stride")
        self.line(f" %first_row = getelementptr {self._lanes.real.name}, ptr %rows, i64 %shift")
        self.line(f" %parameter = getelementptr [{parameters} x {t}], ptr %parameters, i64 %g")
        self.line(f" %memory = getelementptr [{memory} x {t}], ptr %memories, i64 %g")
        self.line(f" %key = getelementptr [2 x {words}], ptr %keys, i64 %g")
        for i in range(2):
            self.line(f" %keyp{i} = getelementptr {words}, ptr %key, i64 {i}")
            self.line(f" %key{i} = load {word}, ptr %keyp{i}, align 4")

    def fill(self, row: str, size: int, after: str) -> None:
        """The inputs of a tick but noise: one row for all lanes, or a row of each; then the label `after`."""
        real = self._lanes.real.name
        self.line(f" br i1 %shared, label %same_{after}, label %each_{after}", f"same_{after}:")
        for i in range(size):
            value = self.put(f"load {real}, ptr {self.put(f'getelementptr {real}, ptr {row}, i64 {i}')}")
            self.line(*spread(f"{value}.l", value, real, self._lanes))
            self.store(f"{value}.l", "%own", i)
        self.line(f" br label %{after}", f"each_{after}:")
        for i in range(size):
            self.store(self.load(row, i), "%own", i)
        self.line(f" br label %{after}", f"{after}:")

    def noise(self, name: str, tick: str) -> None:
        """The noise of a tick."""
        word = self._lanes.of("i32")
        self.line(*spread(name, tick, "i32", self._lanes))
        self.line(f" call void @noise(ptr %own, {word} %key0, {word} %key1, {word} {name})")

    def load(self, block: str, i: int) -> str:
        """The numbers of all lanes."""
        place = self.put(f"getelementptr {self._cell}, ptr {block}, i64 {i}")
        return self.put(f"load {self._lanes.type}, ptr {place}, align {self._lanes.align}")

    def store(self, value: str, block: str, i: int) -> None:
        """Write the numbers of all lanes."""
        t = self._lanes.type
        place = self.put(f"getelementptr {self._cell}, ptr {block}, i64 {i}")
        self.line(f" store {t} {value}, ptr {place}, align {self._lanes.align}")

    def itself_away(self, block: str, i: int) -> str:
        """x - x: zero but of what is not finite."""
        value = self.load(block, i)
        return self.put(f"fsub {self._lanes.type} {value}, {value}")

    def leave(self) -> None:
        """The end of the loop over groups, and of the function."""
        self.line(
            " %g1 = add i64 %g, 1",
            " %next = icmp slt i64 %g1, %groups",
            " br i1 %next, label %next_group, label %end",
        )
        self.line("end:")
        self.restore()
        self.line(" ret void")

    def function(self, head: str) -> str:
        """The text of the function, and of what it declares."""
        flush = ["declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)"]
        return "\n".join([*(flush if self._flushes else []), self._writer.function(head)])
