"""A GPU for tests: PTX run one thread after another, and the driver's functions on the memory of the CPU.

Each instruction is one statement of Python, with the rounding that PTX states: double arithmetic is Python's and libm's; a
single operation on floats is one on doubles that is rounded to a float, which gives the same number. What is not known
here is refused, so no instruction is taken for another.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import enum
import math
import re
import struct
import types
from typing import Any

import numpy as np

LIBM = ctypes.CDLL(ctypes.util.find_library("m") or ctypes.util.find_library("ucrtbase"))
INTEGER = {8: ctypes.c_uint8, 16: ctypes.c_uint16, 32: ctypes.c_uint32, 64: ctypes.c_uint64}
TINY = 2.0**-126  # the smallest normal float


def _libm(name: str, count: int, kind: Any = ctypes.c_double) -> Any:
    return ctypes.CFUNCTYPE(kind, *[kind] * count)((name, LIBM))


SQRT, FLOOR, FMA, FMAF = _libm("sqrt", 1), _libm("floor", 1), _libm("fma", 3), _libm("fmaf", 3, ctypes.c_float)


def bits(x: Any, width: int) -> int:
    """What a register holds, as a whole number."""
    if type(x) is not float:
        return int(x) & (1 << width) - 1
    return int.from_bytes(struct.pack("<d" if width == 64 else "<f", x), "little")


def real(x: Any, width: int) -> float:
    """What a register holds, as a number."""
    if type(x) is float:
        return x
    return float(struct.unpack("<d" if width == 64 else "<f", int(x).to_bytes(width // 8, "little"))[0])


def flushed(x: float) -> float:
    return math.copysign(0.0, x) if abs(x) < TINY else x


def single(x: float, flush: bool) -> float:
    y = ctypes.c_float(x).value
    return flushed(y) if flush else y


def quotient(a: float, b: float) -> float:
    with np.errstate(all="ignore"):
        return float(np.float64(a) / np.float64(b))


ARITHMETIC = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "neg": "-{0}", "abs": "abs({0})", "div": "quotient({0}, {1})",
    "rcp": "quotient(1.0, {0})", "sqrt": "SQRT({0})", "cvt": "FLOOR({0})", "min": "min({0}, {1})",
}  # fmt: skip
WHOLE = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "mad": "{0} * {1} + {2}", "shl": "{0} << {1}", "shr": "{0} >> {1}",
    "or": "{0} | {1}", "and": "{0} & {1}", "xor": "{0} ^ {1}", "min": "min({0}, {1})", "max": "max({0}, {1})", "cvt": "{0}", "mov": "{0}", "cvta": "{0}",
}  # fmt: skip
ORDER = {
    name: f"{{0}} {sign} {{1}}"
    for name, sign in {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}.items()
}
BETWEEN = ORDER | {  # of numbers, one of which may be NaN; u: or one is
    "ne": "{0} < {1} or {0} > {1}", "neu": "{0} != {1}", "equ": "not ({0} < {1} or {0} > {1})", "ltu": "not {0} >= {1}",
    "leu": "not {0} > {1}", "gtu": "not {0} <= {1}", "geu": "not {0} < {1}", "nan": "{0} != {0} or {1} != {1}",
}  # fmt: skip


class Kernel:
    """An entry of PTX as a function of Python, of one thread."""

    def __init__(self, name: str, parameters: str, body: str) -> None:
        self.parameters = re.findall(rf"\b{name}_param_\d+", parameters)
        lines, labels = [(0, [])], {}
        for line in body.splitlines():
            text = line.split("//")[0].strip().rstrip(";")
            if text.startswith("$") and text.endswith(":"):
                labels[text[:-1]] = len(lines)
                lines.append((len(lines), []))
            elif text and not text.startswith("."):
                lines[-1][1].append(text)
        self._labels, source = labels, ["def thread(tid_x, ctaid_x, ntid_x, places):", " at = 0", " while True:"]
        for number, block in lines:
            source.append(f"  if at == {number}:")
            source += [f"   {self._statement(text)}" for text in block]
            source.append(f"   at = {number + 1}")
        scope = dict(globals())
        exec("\n".join(source), scope)
        self.thread = scope["thread"]

    def _operand(self, text: str, width: int, kind: str) -> str:
        """An operand as a number ("f"), a whole number ("i"), one with a sign ("s"), or a truth value ("p")."""
        if re.fullmatch(r"0[dDfF][0-9A-Fa-f]+", text):
            value = f"real({int(text[2:], 16)}, {64 if text[1] in 'dD' else 32})"
            return value if kind == "f" else f"bits({value}, {width})"
        if re.fullmatch(r"-?\d+", text):
            return text if kind == "s" else str(int(text) % (1 << width))
        if text in self.parameters:
            return f"places[{self.parameters.index(text)}]"
        assert re.fullmatch(r"%\w+(\.x)?", text), text
        name = text[1:].replace(".", "_")
        if kind == "f":
            return f"real({name}, {width})"
        if kind == "s":
            return f"(bits({name}, {width}) ^ {1 << width - 1}) - {1 << width - 1}"
        return name if kind == "p" else f"bits({name}, {width})"

    def _statement(self, text: str) -> str:
        guard = re.match(r"@(!?)%(p\d+)\s+", text)
        if guard:
            condition = f"not {guard[2]}" if guard[1] else guard[2]
            return f"if {condition}: {self._statement(text[guard.end() :])}"
        upper = re.fullmatch(r"\{ \.reg \.b32 tmp; mov\.b64 \{tmp, %(r\d+)\}, %(rd\d+); \}", text)
        if upper:
            return f"{upper[1]} = bits({upper[2]}, 64) >> 32"
        op, rest = (*text.split(None, 1), "")[:2]
        head, *more = op.split(".")
        operands = [x.strip() for x in rest.split(",")] if rest else []
        if head == "ret":
            return "return"
        if head == "bra":
            return f"at = {self._labels[operands[0]]}; continue"
        kind = more[-1]
        if kind == "pred":
            sign = {"xor": "!=", "or": "or", "and": "and", "not": "not"}[head]
            names = [self._operand(x, 1, "p") for x in operands]
            return f"{names[0]} = not {names[1]}" if head == "not" else f"{names[0]} = {names[1]} {sign} {names[2]}"
        width, flush = int(kind[1:]), "ftz" in more
        if head in ("ld", "st"):
            assert more[0] in ("param", "global"), text
            place, shift = re.fullmatch(r"\[([^+\]]+)(?:\+(-?\d+))?\]", operands[head == "ld"]).groups()  # type: ignore[union-attr]
            place = f"INTEGER[{width}].from_address({self._operand(place, 64, 'i')} + {shift or 0})"
            if head == "ld":
                return f"{operands[0][1:]} = {place}.value"
            return f"{place}.value = {self._operand(operands[1], width, 'i')}"
        target = operands[0][1:].replace(".", "_")
        if head == "setp":
            signed = {"f": "f", "s": "s"}.get(kind[0], "i")
            a, b = (self._operand(x, width, signed) for x in operands[1:])
            if flush:
                a, b = f"flushed({a})", f"flushed({b})"
            return f"{target} = {(BETWEEN if signed == 'f' else ORDER)[more[0]].format(f'({a})', f'({b})')}"
        if head == "selp":
            a, b = (self._operand(x, width, "i") for x in operands[1:3])
            return f"{target} = {a} if {operands[3][1:]} else {b}"
        if head == "cvt" and more[0] == "rn":  # of a whole number
            assert (kind[0], more[-2][0]) == ("u", "f"), text
            value = f"float({self._operand(operands[1], width, 'i')})"
            return f"{target} = {value}" if more[-2] == "f64" else f"{target} = single({value}, {flush})"
        if kind[0] == "f":
            assert more[0] in ("rn", "rmi") or head in ("neg", "abs"), text
            assert (head == "cvt") == (more[0] == "rmi"), text
            values = [self._operand(x, width, "f") for x in operands[1:]]
            values = [f"flushed({x})" for x in values] if flush else values
            if head == "fma":
                value = f"{'FMA' if width == 64 else 'FMAF'}({', '.join(values)})"
            else:
                value = ARITHMETIC[head].format(*(f"({x})" for x in values))
            return f"{target} = {value}" if width == 64 else f"{target} = single({value}, {flush})"
        to = int(more[0][1:]) if head == "cvt" else width
        if head in ("mul", "mad") and kind[0] != "f":
            assert more[0] == "lo" or (more[0], kind[0]) in (("wide", "u"), ("hi", "u")), text
            to = 2 * width if more[0] == "wide" else width
            if more[0] == "hi":
                a, b = (self._operand(x, width, "i") for x in operands[1:])
                return f"{target} = {a} * {b} >> {width}"
        sign = "s" if kind[0] == "s" and head in ("min", "max", "shr") else "i"
        values = [self._operand(x, width, sign) for x in operands[1:]]
        return f"{target} = bits({WHOLE[head].format(*(f'({x})' for x in values))}, {to})"


class Machine(dict[str, Kernel]):
    """The entries of a module of PTX."""

    def __init__(self, text: str) -> None:
        super().__init__()
        for name, parameters, body in re.findall(r"\.visible \.entry (\w+)\(([^)]*)\)\s*\{(.*?)\n\}", text, re.S):
            self[name] = Kernel(name, parameters, body)


class Result(enum.IntEnum):
    CUDA_SUCCESS = 0
    CUDA_ERROR_OUT_OF_MEMORY = 2
    CUDA_ERROR_NO_DEVICE = 100


class Driver:
    """Those functions of cuda.bindings.driver that are called, on the memory of the CPU."""

    def __init__(self, devices: int = 1) -> None:
        self.devices, self.depth, self.streams = devices, 0, list[int]()
        self.memory: dict[int, Any] = {}

    def cuInit(self, flags: int) -> Any:
        return (Result.CUDA_SUCCESS if self.devices else Result.CUDA_ERROR_NO_DEVICE,)

    def cuDeviceGet(self, number: int) -> Any:
        return Result.CUDA_SUCCESS, number

    def cuDevicePrimaryCtxRetain(self, device: int) -> Any:
        return Result.CUDA_SUCCESS, "context"

    def cuCtxPushCurrent(self, context: str) -> Any:
        assert context == "context"
        self.depth += 1
        return (Result.CUDA_SUCCESS,)

    def cuCtxPopCurrent(self) -> Any:
        self.depth -= 1
        return Result.CUDA_SUCCESS, "context"

    def cuModuleLoadData(self, image: bytes) -> Any:
        assert image.endswith(b"\0")
        return Result.CUDA_SUCCESS, Machine(image.decode())

    def cuModuleGetFunction(self, module: Machine, name: bytes) -> Any:
        return Result.CUDA_SUCCESS, module[name.decode()]

    def cuMemAlloc(self, size: int) -> Any:
        if size > 1 << 24:
            return (Result.CUDA_ERROR_OUT_OF_MEMORY, None)
        room = np.full(size + 16, 0xFF, dtype=np.uint8)  # NaN, and a border that nobody may write
        address = room.ctypes.data + -room.ctypes.data % 8
        self.memory[address] = room, size
        return Result.CUDA_SUCCESS, address

    def cuMemFree(self, address: int) -> Any:
        del self.memory[address]
        return (Result.CUDA_SUCCESS,)

    def cuMemsetD8Async(self, address: int, value: int, size: int, stream: int) -> Any:
        return self._moved(stream, lambda: ctypes.memset(address, value, size))

    def cuMemcpyHtoDAsync(self, to: int, source: int, size: int, stream: int) -> Any:
        return self._moved(stream, lambda: ctypes.memmove(to, source, size))

    cuMemcpyDtoHAsync = cuMemcpyHtoDAsync

    def cuStreamSynchronize(self, stream: int) -> Any:
        return self._moved(stream, lambda: None)

    def cuLaunchKernel(self, kernel: Kernel, gx: int, gy: int, gz: int, bx: int, by: int, bz: int, shared: int, stream: int, places: int, extra: int) -> Any:  # fmt: skip
        assert (gy, gz, by, bz, shared, extra) == (1, 1, 1, 1, 0, 0)
        values = list((ctypes.c_uint64 * len(kernel.parameters)).from_address(places))

        def all_threads() -> None:
            for block in range(gx):
                for thread in range(bx):
                    kernel.thread(thread, block, bx, values)

        return self._moved(stream, all_threads)

    def _moved(self, stream: int, work: Any) -> Any:
        assert self.depth == 1
        self.streams.append(stream)
        work()
        return (Result.CUDA_SUCCESS,)

    def modules(self) -> dict[str, Any]:
        """What `from cuda.bindings import driver` finds."""
        bindings = types.ModuleType("cuda.bindings")
        bindings.driver = self  # type: ignore[attr-defined]
        return {"cuda": types.ModuleType("cuda"), "cuda.bindings": bindings}
