"""Noise: standard normal numbers of a seed, a tick and a channel, the same bits in each engine and in every lane.

Law:  words = Philox-4x32-10 of the counter (tick, block, channel) under the key `seed`;
      normals = sqrt(-2 ln u) (cos, sin)(2 pi w) of each two words, u and w, as numbers from 0 to 1 (Box and Muller)

A counter in place of a state: neither how a run is cut into blocks nor what else is noisy changes a number, and a
million runs need no memory for it. The largest number is 6.7 standard deviations.

References:
    Salmon, Moraes, Dror and Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11 (2011), section 3.2.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import itertools
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array
from taut.codegen.engine import Engine
from taut.codegen.functions import DOUBLE, Real, logarithm, of_quadrant, traced
from taut.codegen.llvm import Lanes, Writer, declarations, function_text, result_type, spread
from taut.codegen.native import compiled, host_lanes
from taut.codegen.program import Block, Field, Program
from taut.trace import math as tm

NOISE: Final = "noise."  # begins the path of an input that is filled here
MAX_SEED: Final = 2**64 - 1
PHILOX_ROUNDS: Final = 10
MULTIPLIERS: Final = (0xD2511F53, 0xCD9E8D57)
WEYL: Final = (0x9E3779B9, 0xBB67AE85)  # added to the key in each round
WORD: Final = 0xFFFFFFFF
Words = NDArray[np.uint64]


def key(seed: Any) -> tuple[Any, Any]:
    """The two words of a seed, or of an array of seeds."""
    whole = np.asarray(seed, dtype=np.uint64)
    return whole & np.uint64(WORD), whole >> np.uint64(32)


@functools.cache
def channel(path: str) -> tuple[int, int]:
    """The two words of a measurement's name."""
    digest = hashlib.sha256(path.removeprefix(NOISE).encode()).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:8], "little")


def philox(keys: tuple[Any, Any], counter: tuple[Any, Any, Any, Any]) -> tuple[Words, ...]:
    """Four words of 32 bits, of arrays of keys and counters."""
    k, c = [np.asarray(word, dtype=np.uint64) for word in keys], [np.asarray(x, dtype=np.uint64) for x in counter]
    for turn in range(PHILOX_ROUNDS):
        low, high = (np.uint64(factor) * c[2 * i] for i, factor in enumerate(MULTIPLIERS))
        now = [(word + np.uint64(turn * step & WORD)) & np.uint64(WORD) for word, step in zip(k, WEYL, strict=True)]
        c = [
            (high >> np.uint64(32)) ^ c[1] ^ now[0],
            high & np.uint64(WORD),
            (low >> np.uint64(32)) ^ c[3] ^ now[1],
            low & np.uint64(WORD),
        ]
    return tuple(c)


def _two_normals(u: Any, w: Any, real: Real) -> Any:
    """Box and Muller, of two words as numbers."""
    quarters = w * 2.0**-30
    k = tm.floor(quarters + 0.5)
    sine, cosine = of_quadrant(k, (quarters - k) * (math.pi / 2.0), real)
    radius = tm.sqrt(-2.0 * logarithm((u + 0.5) * 2.0**-32, real))
    return radius * cosine, radius * sine


@functools.cache
def two_normals(real: Real) -> Program:
    """Two standard normal numbers of two words; without fused products, so that NumPy's bits are machine code's."""
    return traced(_two_normals, 2, real)


def blocks_of(inputs: Block) -> list[tuple[Field, int]]:
    """The noise among inputs, in blocks of four numbers: field, and number of the block in it."""
    noisy = [field for field in inputs.fields if field.path.startswith(NOISE)]
    return [(field, b) for field in noisy for b in range(-(-field.size // 4))]


class Noise:
    """Fills the noise among the inputs of a run."""

    def __init__(self, inputs: Block, engine: Engine) -> None:
        self._inputs, self._blocks = inputs, blocks_of(inputs)
        self._native = _NativeRows(inputs) if engine == "native" and self._blocks else None

    def fill(self, rows: Float64Array, first: int, seed: int) -> None:
        """Write the noise of a seed into rows (k, ...) of inputs, of the ticks from `first` on."""
        if not self._blocks:
            return
        if self._native is not None:
            self._native(rows, first, seed)
            return
        ticks = np.arange(first, first + len(rows))
        for field, block in self._blocks:
            words = philox(key(seed), (ticks, block, *channel(field.path)))
            numbers = itertools.chain(*(two_normals(DOUBLE).evaluated(_numbers(words[i : i + 2]))[0] for i in (0, 2)))
            for k, column in zip(range(4 * block, field.size), numbers, strict=False):
                rows[:, field.offset + k] = column


def _numbers(words: tuple[Words, ...]) -> list[Float64Array]:
    return [word.astype(np.float64) for word in words]


def noise_text(inputs: Block, lanes: Lanes) -> str:
    """LLVM text of `noise(inputs, key, key, tick)`, which writes the noise of a tick into a block of inputs.

    Keys and the tick are words in lanes, so that each lane may have its own seed.
    """
    t, word, cell = lanes.type, lanes.of("i32"), lanes.cell(lanes.real.name)
    lines = [f"define internal void @noise(ptr %inputs, {word} %key0, {word} %key1, {word} %tick) {{"]
    for n, (field, block) in enumerate(blocks_of(inputs)):
        constants = [f"{word} {lanes.same('i32', str(value))}" for value in (block, *channel(field.path))]
        given = ", ".join([f"{word} %key0", f"{word} %key1", f"{word} %tick", *constants])
        lines.append(f" %n{n} = call {result_type(lanes, 4)} @four_normals({given})")
        for k in range(min(4, field.size - 4 * block)):
            at = field.offset + 4 * block + k
            lines += [
                f" %n{n}.{k} = extractvalue {result_type(lanes, 4)} %n{n}, {k}",
                f" %p{n}.{k} = getelementptr {cell}, ptr %inputs, i64 {at}",
                f" store {t} %n{n}.{k}, ptr %p{n}.{k}, align {lanes.align}",
            ]
    two = function_text("two_normals", two_normals(lanes.real), lanes, fused={})
    return "\n".join([two, _four_normals(lanes), *lines, " ret void", "}"])


def _four_normals(lanes: Lanes) -> str:
    t, word, wide = lanes.type, lanes.of("i32"), lanes.of("i64")
    half = lanes.same("i64", "32")
    names = ("k0", "k1", "c0", "c1", "c2", "c3")
    lines = [
        f"define internal {result_type(lanes, 4)} @four_normals({', '.join(f'{word} %{n}' for n in names)}) "
        f"{lanes.attributes} {{"
    ]
    c = [f"%{name}" for name in names[2:]]
    for turn in range(PHILOX_ROUNDS):
        r = f"%r{turn}"
        for i, factor in enumerate(MULTIPLIERS):
            lines += [
                f" {r}.k{i} = add {word} %k{i}, {lanes.same('i32', str(turn * WEYL[i] & WORD))}",
                f" {r}.w{i} = zext {word} {c[2 * i]} to {wide}",
                f" {r}.p{i} = mul {wide} {r}.w{i}, {lanes.same('i64', str(factor))}",
                f" {r}.l{i} = trunc {wide} {r}.p{i} to {word}",
                f" {r}.s{i} = lshr {wide} {r}.p{i}, {half}",
                f" {r}.h{i} = trunc {wide} {r}.s{i} to {word}",
            ]
        for i in range(2):
            lines += [
                f" {r}.x{i} = xor {word} {r}.h{1 - i}, {c[2 * i + 1]}",
                f" {r}.c{i} = xor {word} {r}.x{i}, {r}.k{i}",
            ]
        c = [f"{r}.c0", f"{r}.l1", f"{r}.c1", f"{r}.l0"]
    lines += [f" %u{i} = uitofp {word} {x} to {t}" for i, x in enumerate(c)]
    two, four, before = result_type(lanes, 2), result_type(lanes, 4), "undef"
    for i in range(2):
        lines.append(f" %n{i} = call {two} @two_normals({t} %u{2 * i}, {t} %u{2 * i + 1})")
        for k in range(2):
            at = 2 * i + k
            lines += [
                f" %x{at} = extractvalue {two} %n{i}, {k}",
                f" %y{at} = insertvalue {four} {before}, {t} %x{at}, {at}",
            ]
            before = f"%y{at}"
    return "\n".join([*lines, f" ret {four} {before}", "}"])


class _NativeRows:
    """Noise of a run in machine code, with one tick in each lane."""

    def __init__(self, inputs: Block) -> None:
        self._lanes, self._size = Lanes(host_lanes(DOUBLE)), inputs.size
        self._columns = [f.offset + k for f in inputs.fields if f.path.startswith(NOISE) for k in range(f.size)]
        layout = repr((self._lanes, self._size, blocks_of(inputs)))
        self._module = compiled(f"noise {layout}".encode(), lambda: self._text(inputs), ("rows",))
        self._function = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 4, ctypes.c_void_p)(self._module["rows"])

    def __call__(self, rows: Float64Array, first: int, seed: int) -> None:
        made = np.empty((-(-len(rows) // self._lanes.count), self._size, self._lanes.count))
        self._function(first, len(made), *map(int, key(seed)), made.ctypes.data)
        flat = made[:, self._columns].transpose(0, 2, 1).reshape(-1, len(self._columns))
        rows[:, self._columns] = flat[: len(rows)]

    def _text(self, inputs: Block) -> str:
        """LLVM text of `rows(first tick, groups of ticks, key, key, groups of inputs)`."""
        lanes, w = self._lanes, Writer()
        word, steps = lanes.of("i32"), ", ".join(f"i32 {i}" for i in range(self._lanes.count))
        w.line(
            "entry:",
            " %none = icmp sle i64 %groups, 0",
            " br i1 %none, label %end, label %head",
            "head:",
            " %g = phi i64 [0, %entry], [%next, %head]",
            f" %group = getelementptr [{self._size} x {lanes.type}], ptr %made, i64 %g",
            f" %along = mul i64 %g, {lanes.count}",
            " %now = add i64 %first, %along",
        )
        for name in ("now", "low", "high"):
            w.line(f" %{name}32 = trunc i64 %{name} to i32", *spread(f"%{name}s", f"%{name}32", "i32", lanes))
        w.line(
            f" %tick = add {word} %nows, {f'<{steps}>' if lanes.count > 1 else '0'}",
            f" call void @noise(ptr %group, {word} %lows, {word} %highs, {word} %tick)",
            " %next = add i64 %g, 1",
            " %more = icmp slt i64 %next, %groups",
            " br i1 %more, label %head, label %end",
            "end:",
            " ret void",
        )
        head = f"void @rows(i64 %first, i64 %groups, i64 %low, i64 %high, ptr %made) {lanes.attributes}"
        return "\n".join([declarations(lanes), noise_text(inputs, lanes), w.function(head)])


def noise_block(shapes: Mapping[str, tuple[int, ...]]) -> Block:
    """A block of noise alone, by the name of the measurement."""
    return Block.of({f"{NOISE}{name}": shape for name, shape in shapes.items()})
