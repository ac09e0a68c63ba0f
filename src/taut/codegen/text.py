"""Writer: LLVM text of the small functions around a kernel, line by line."""

from __future__ import annotations

__all__ = ["Writer"]


class Writer:
    """Collects the lines of one function; every value gets a name of its own."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0

    def name(self) -> str:
        """A fresh name for a value."""
        self._count += 1
        return f"%x{self._count}"

    def put(self, text: str) -> str:
        """A line that computes a value, and the value's name."""
        name = self.name()
        self.lines.append(f" {name} = {text}")
        return name

    def line(self, *lines: str) -> None:
        """Lines as they are."""
        self.lines += lines

    def function(self, head: str) -> str:
        """The lines so far as the body of a function."""
        text = "\n".join([f"define {head} {{", *self.lines, "}"])
        self.lines = []
        return text

    def unless(self, wrong: str, target: str) -> None:
        """Leave for the label `target` if a condition is true."""
        after = self.name()[1:]
        self.line(f" br i1 {wrong}, label %{target}, label %{after}", f"{after}:")

    def load_at(self, owner: str, offset: int, kind: str = "ptr") -> str:
        """What stands `offset` bytes behind a pointer."""
        place = self.put(f"getelementptr i8, ptr {owner}, i64 {offset}")
        return self.put(f"load {kind}, ptr {place}")

    def copy(self, source: str, target: str, size: int) -> None:
        """Copy `size` doubles."""
        for start, width in _pieces(size):
            kind = "double" if width == 1 else f"<{width} x double>"
            read = self.put(f"getelementptr double, ptr {source}, i64 {start}")
            value = self.put(f"load {kind}, ptr {read}, align 8")
            write = self.put(f"getelementptr double, ptr {target}, i64 {start}")
            self.line(f" store {kind} {value}, ptr {write}, align 8")

    def not_finite(self, block: str, size: int) -> str | None:
        """A truth value: whether a block has NaN or infinity in it; None for an empty block.

        x - x is zero for every other number.
        """
        differences: dict[int, list[str]] = {4: [], 1: []}
        for start, width in _pieces(size):
            kind = "double" if width == 1 else f"<{width} x double>"
            place = self.put(f"getelementptr double, ptr {block}, i64 {start}")
            value = self.put(f"load {kind}, ptr {place}, align 8")
            differences[width].append(self.put(f"fsub {kind} {value}, {value}"))
        if differences[4]:
            total = self._sum("<4 x double>", differences[4])
            differences[1] += [self.put(f"extractelement <4 x double> {total}, i64 {i}") for i in range(4)]
        if not differences[1]:
            return None
        return self.put(f"fcmp une double {self._sum('double', differences[1])}, 0.0")

    def _sum(self, kind: str, values: list[str]) -> str:
        """The sum of some values, by halves, so that no addition waits for all before it."""
        if len(values) == 1:
            return values[0]
        half = len(values) // 2
        return self.put(f"fadd {kind} {self._sum(kind, values[:half])}, {self._sum(kind, values[half:])}")


def _pieces(size: int) -> list[tuple[int, int]]:
    """A length as pieces of four doubles and single ones: (start, width)."""
    whole = size - size % 4
    return [(start, 4) for start in range(0, whole, 4)] + [(start, 1) for start in range(whole, size)]
