"""A control period as native code: a step, and the substeps that follow it, for all loops that call them."""

from __future__ import annotations

from taut.codegen.layout import Block
from taut.codegen.llvm import declarations, kernel
from taut.codegen.program import Function, Program, trace
from taut.codegen.text import Writer

__all__ = ["PeriodCode", "write_period"]


class PeriodCode:
    """A step function and its substeps, traced.

    Args:
        step: (inputs, parameters, memory) -> (outputs, new memory).
        substep: The same for each further part of a period; its outputs do not count.
        repeats: How many of them.
        inputs: Block of both.
        parameters: Likewise.
        memory: Likewise.

    Raises:
        TraceError: A function that cannot be traced.
    """

    def __init__(
        self, step: Function, substep: Function, repeats: int, inputs: Block, parameters: Block, memory: Block
    ) -> None:
        self.step: Program = trace(step, inputs, parameters, memory)
        self.inner: Program | None = trace(substep, inputs, parameters, memory) if repeats else None
        self.repeats = repeats

    @property
    def operations(self) -> int:
        """Of a period."""
        return self.step.operations + (self.inner.operations * self.repeats if self.inner else 0)

    @property
    def length(self) -> int:
        """Operations in the code, which may run more than once."""
        return self.step.operations + (self.inner.operations if self.inner else 0)

    @property
    def content(self) -> bytes:
        """What tells its code from that of another one."""
        inner = b"" if self.inner is None else self.inner.content + self.repeats.to_bytes(8, "little")
        return self.step.content + inner

    def text(self) -> str:
        """LLVM text of `kernel`, and of `substep` where there are some."""
        parts = [declarations(), kernel(self.step, "kernel")]
        if self.inner is not None:
            parts.append(kernel(self.inner, "substep"))
        return "\n".join(parts)


def write_period(w: Writer, parameters: str, memory: str, repeats: int, after: str) -> None:
    """LLVM text, in a block called head, of `kernel` from `memory` to %new, and `repeats` times `substep` in %new.

    Inputs are at %in and outputs at %out; a block called `after` begins where it ends.
    """
    w.line(f" call void @kernel(ptr %in, ptr {parameters}, ptr {memory}, ptr %new, ptr %out)")
    if repeats:
        w.line(
            " br label %inner",
            "inner:",
            " %i = phi i64 [0, %head], [%i1, %inner]",
            f" call void @substep(ptr %in, ptr {parameters}, ptr %new, ptr %new, ptr %out)",
            " %i1 = add i64 %i, 1",
            f" %again = icmp slt i64 %i1, {repeats}",
            f" br i1 %again, label %inner, label %{after}",
        )
    else:
        w.line(f" br label %{after}")
    w.line(f"{after}:")
