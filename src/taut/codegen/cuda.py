"""CUDA: the code of `lanes/` as kernels of a GPU, a lane in each thread: rows of arrays in its memory, and loops.

The text is that of one lane of the CPU, with the number of the thread for that of the row. In PTX each operation is
rounded as it stands there, and only products that the program fuses are fused: doubles have the bits of the CPU. In
single precision numbers smaller than the normal ones are zero, as in lanes of the CPU. The driver makes code of it.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import TautError, UsageError, missing_extra
from taut.codegen.functions import SINGLE
from taut.codegen.lanes.loop import LaneLoop
from taut.codegen.lanes.rows import HOST, RowCode, host_array, named_memory, no_dlpack, row_step, unreadable
from taut.codegen.llvm import WARP, Lanes
from taut.codegen.native import ptx
from taut.codegen.program import Block

CUDA: Final = (2, 13)  # of DLPack's kinds of memory: that of a GPU, and what it shares with the CPU
LEGACY: Final = 1  # the default stream, as the driver and DLPack number it
CODES: Final = ("int", "uint", "float", "handle", "bfloat", "complex", "bool")  # of DLPack's types
READ_ONLY: Final = 1  # of DLPack's flags
ELSE: Final = "take device='cpu' and arrays in its memory"
NO_DRIVER: Final = f"device='cuda' needs the driver of an NVIDIA GPU, libcuda, and this machine has none; {ELSE}"

THREAD: Final = f"""
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
define internal i64 @thread() alwaysinline {{
 %t = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
 %b = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
 %first = mul i32 %b, {WARP}
 %k = add i32 %first, %t
 %i = zext i32 %k to i64
 ret i64 %i
}}
"""
ROWS: Final = """
define ptx_kernel void @tick(i64 %n, ptr byval([{words} x i64]) align 8 %places, ptr %finite) {attributes} {{
 %i = call i64 @thread()
 %inside = icmp slt i64 %i, %n
 br i1 %inside, label %go, label %end
go:
 %next = add i64 %i, 1
 call void @rows(i64 %i, i64 %next, i64 %n, ptr %places, ptr %finite)
 br label %end
end:
 ret void
}}
define ptx_kernel void @begin(i64 %n, ptr %mask, i64 %apart, ptr %fresh, ptr %ticks) {{
 %i = call i64 @thread()
 %inside = icmp slt i64 %i, %n
 br i1 %inside, label %look, label %end
look:
 %at = mul i64 %i, %apart
 %place = getelementptr i8, ptr %mask, i64 %at
 %truth = load i8, ptr %place
 %is = icmp ne i8 %truth, 0
 br i1 %is, label %go, label %end
go:
 %freshi = getelementptr {real}, ptr %fresh, i64 %i
 %ticksi = getelementptr {real}, ptr %ticks, i64 %i
 store {real} {one}, ptr %freshi
 store {real} {zero}, ptr %ticksi
 br label %end
end:
 ret void
}}
"""
LOOP: Final = """
define ptx_kernel void @all(i64 %ticks, i64 %first, i64 %groups, i64 %stride,
  ptr %rows, ptr %keys, ptr %parameters, ptr %memories, ptr %outputs) {attributes} {{
 %i = call i64 @thread()
 %g = udiv i64 %i, {warp}
 %lane = urem i64 %i, {warp}
 %shared = icmp eq i64 %stride, 0
 %far = mul i64 %g, %stride
 %apart = add i64 %far, %lane
 %at = select i1 %shared, i64 0, i64 %apart
 %row = getelementptr {real}, ptr %rows, i64 %at
 %key = getelementptr [2 x [{warp} x i32]], ptr %keys, i64 %g, i64 0, i64 %lane
 %parameter = getelementptr [{parameters} x [{warp} x {real}]], ptr %parameters, i64 %g, i64 0, i64 %lane
 %memory = getelementptr [{memory} x [{warp} x {real}]], ptr %memories, i64 %g, i64 0, i64 %lane
 %before = mul i64 %g, %ticks
 %recorded = getelementptr [{outputs} x [{warp} x {real}]], ptr %outputs, i64 %before, i64 0, i64 %lane
 %reduced = alloca [{outputs} x [{warp} x {real}]]
 call void @advance(i64 %ticks, i64 %first, i64 1, i64 %stride,
  ptr %row, ptr %key, ptr %parameter, ptr %memory, ptr %{made})
 ret void
}}
"""


def row_kernels(code: RowCode) -> str:
    """PTX of the kernels `tick`, a lane in each thread, and `begin`, which makes the next tick of lanes the first."""
    text = code.text() + THREAD + ROWS.format(
        words=code.words * len(code.fields), real=code.lanes.real.name, attributes=_attributes(code.lanes),
        one=code.lanes.number(1.0), zero=code.lanes.number(0.0),
    )  # fmt: skip
    return ptx(text, ("tick", "begin"))


def loop_kernel(code: LaneLoop) -> str:
    """PTX of the kernel `all`: some ticks of a loop in each thread, on blocks as those of the CPU."""
    text = code.text() + THREAD + LOOP.format(
        real=code.lanes.real.name, warp=WARP, made="recorded" if code.recorded else "reduced",
        attributes=_attributes(code.lanes), **code.sizes,
    )  # fmt: skip
    return ptx(text, ("all",))


def _attributes(lanes: Lanes) -> str:
    return '"denormal-fp-math-f32"="preserve-sign,preserve-sign"' if lanes.real is SINGLE else ""


# -------------------------------------------------------------------- the driver and its memory


class Gpu:
    """The first GPU of this machine, through NVIDIA's driver."""

    def __init__(self) -> None:
        try:
            from cuda.bindings import driver
        except ImportError as cause:
            try:
                ctypes.CDLL("nvcuda" if sys.platform == "win32" else "libcuda.so.1")
            except OSError:
                raise UsageError(NO_DRIVER, name="device") from cause
            raise missing_extra("device='cuda'", "cuda-bindings", "cuda") from cause
        self._driver: Any = driver
        self._context: Any = None
        try:
            self.call("cuInit", 0)
            self._context = self.call("cuDevicePrimaryCtxRetain", self.call("cuDeviceGet", 0))
        except TautError as cause:
            raise UsageError(f"device='cuda' needs an NVIDIA GPU: {cause}; {ELSE}", name="device") from cause
        except RuntimeError as cause:
            raise UsageError(NO_DRIVER, name="device") from cause

    def call(self, name: str, *arguments: Any) -> Any:
        """The result of one of the driver's functions; TautError where it fails."""
        if self._context is not None:
            self._driver.cuCtxPushCurrent(self._context)  # and not for good: that of the caller may be another GPU's
        error, *results = getattr(self._driver, name)(*arguments)
        if self._context is not None:
            self._driver.cuCtxPopCurrent()
        if int(error):
            raise TautError(f"{name} of CUDA gives {error.name}")
        return results[0] if results else None

    def functions(self, text: str, *names: str) -> list[Any]:
        """Kernels of PTX."""
        module = self.call("cuModuleLoadData", text.encode() + b"\0")
        return [self.call("cuModuleGetFunction", module, name.encode()) for name in names]

    def launch(self, kernel: Any, threads: int, *arguments: Any) -> None:
        """Run a kernel with these arguments, numbers of C, in at least so many threads.

        A block is one warp: few lanes use all of the GPU, and registers, not blocks, limit how many run at a time.
        """
        places = (ctypes.c_void_p * len(arguments))(*(ctypes.addressof(x) for x in arguments))
        grid, block = (-(-threads // WARP), 1, 1), (WARP, 1, 1)
        self.call("cuLaunchKernel", kernel, *grid, *block, 0, stream(), ctypes.addressof(places), 0)

    def copy(self, array: NDArray[Any]) -> _Memory:
        """A copy of an array, as it lies in memory."""
        memory = _Memory(self, array.nbytes)
        self.call("cuMemcpyHtoDAsync", memory.address, array.ctypes.data, array.nbytes, stream())
        return memory

    def fetch(self, array: NDArray[Any], address: int) -> None:
        """Fill an array, as it lies in memory, with what all work queued before leaves."""
        self.call("cuMemcpyDtoHAsync", array.ctypes.data, address, array.nbytes, stream())
        self.call("cuStreamSynchronize", stream())

    def room(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> DeviceArray:
        """Zeros for so many lanes, those of all lanes side by side."""
        size = prod(shape) * dtype.itemsize
        memory = _Memory(self, size)
        self.call("cuMemsetD8Async", memory.address, 0, size, stream())
        strides = (dtype.itemsize, *_strides(shape[1:], shape[0] * dtype.itemsize))
        return DeviceArray(self, memory.address, shape, strides, dtype, memory)


@functools.cache
def gpu() -> Gpu:
    """The GPU; UsageError where there is none."""
    return Gpu()


def stream() -> int:
    """Where work is queued: torch's current stream where torch uses the GPU, or else the legacy default stream."""
    torch = sys.modules.get("torch")
    used = torch is not None and torch.cuda.is_initialized()
    return (int(torch.cuda.current_stream(0).cuda_stream) if torch is not None and used else 0) or LEGACY


class _Memory:
    """Memory of a GPU, until it is collected."""

    def __init__(self, gpu: Gpu, size: int) -> None:
        self._gpu, self.address = gpu, int(gpu.call("cuMemAlloc", size))

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # where there was none, or the interpreter ends
            self._gpu.call("cuMemFree", self.address)


def _strides(shape: tuple[int, ...], step: int) -> tuple[int, ...]:
    """Bytes between the numbers of an array whose last ones are `step` apart, row by row."""
    return tuple(step * prod(shape[i + 1 :]) for i in range(len(shape)))


@dataclass(frozen=True, eq=False)
class DeviceArray:
    """An array in the memory of a GPU.

    Libraries read and write it where it is by its `__cuda_array_interface__`: torch.as_tensor(array, device="cuda").
    `numpy()` copies it.
    """

    gpu: Gpu
    address: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]  # bytes
    dtype: np.dtype[Any]
    owner: object  # keeps the memory
    writeable: bool = True

    @property
    def ndim(self) -> int:
        """Number of dimensions."""
        return len(self.shape)

    @property
    def itemsize(self) -> int:
        """Bytes of a number."""
        return self.dtype.itemsize

    @property
    def aligned(self) -> bool:
        """Whether all its numbers are at multiples of their size."""
        return all(x % self.itemsize == 0 for x in (self.address, *self.strides))

    @property
    def flags(self) -> DeviceArray:
        """`aligned` and `writeable`, as NumPy's arrays have them."""
        return self

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return {
            "version": 3, "shape": self.shape, "strides": self.strides, "typestr": self.dtype.str,
            "data": (self.address, not self.writeable), "stream": stream(),
        }  # fmt: skip

    def numpy(self) -> NDArray[Any]:
        """A copy in the memory of the CPU, of what all work queued before leaves."""
        spans = ((count - 1) * stride for count, stride in zip(self.shape, self.strides, strict=True))
        raw = np.empty(sum(spans) + self.itemsize, dtype=np.uint8)
        self.gpu.fetch(raw, self.address)
        return np.ndarray(self.shape, self.dtype, raw, strides=self.strides).copy()


# -------------------------------------------------------------------- tensors of others


class _Tensor(ctypes.Structure):
    """DLTensor of DLPack."""

    _fields_ = (
        ("data", ctypes.c_void_p), ("kind", ctypes.c_int32), ("device", ctypes.c_int32), ("ndim", ctypes.c_int32),
        ("code", ctypes.c_uint8), ("bits", ctypes.c_uint8), ("lanes", ctypes.c_uint16),
        ("shape", ctypes.POINTER(ctypes.c_int64)), ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("offset", ctypes.c_uint64),
    )  # fmt: skip


class _Versioned(ctypes.Structure):
    """DLManagedTensorVersioned of DLPack; before version 1.0 a capsule began with the tensor, without flags."""

    _fields_ = (
        ("version", ctypes.c_uint32 * 2), ("context", ctypes.c_void_p), ("deleter", ctypes.c_void_p),
        ("flags", ctypes.c_uint64), ("tensor", _Tensor),
    )  # fmt: skip


_POINTER: Final = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)
_NAME: Final = ctypes.PYFUNCTYPE(ctypes.c_char_p, ctypes.py_object)(("PyCapsule_GetName", ctypes.pythonapi))


def device_array(name: str, value: Any) -> DeviceArray:
    """A tensor with DLPack on the GPU, where it is. UsageError for one that is elsewhere.

    The queue waits for what makes it.
    """
    if isinstance(value, DeviceArray):
        return value
    if not hasattr(value, "__dlpack_device__"):
        raise no_dlpack(name, value)
    try:
        kind, number = (int(x) for x in value.__dlpack_device__())
        if kind in CUDA and number == 0:
            try:
                capsule = value.__dlpack__(stream=stream(), max_version=(1, 0))
            except TypeError:  # of a library before DLPack 1.0
                capsule = value.__dlpack__(stream=stream())
            return _of_capsule(capsule, value)
    except (BufferError, RuntimeError, TypeError, ValueError) as cause:
        raise unreadable(name, cause) from cause
    raise UsageError(
        f"{name} is in {named_memory(kind, number)}, and this batch runs on cuda:0; copy it there, such as by "
        "torch.as_tensor(q, device='cuda')",
        name=name,
    )


def _of_capsule(capsule: Any, owner: object) -> DeviceArray:
    title = _NAME(capsule)
    address = _POINTER(capsule, title)
    if title == b"dltensor_versioned":
        managed = _Versioned.from_address(address)
        tensor, writeable = managed.tensor, not managed.flags & READ_ONLY
    else:
        tensor, about = _Tensor.from_address(address), getattr(owner, "__cuda_array_interface__", None)
        writeable = about is not None and not about["data"][1]  # JAX's are not, Warp's are
    kind = CODES[tensor.code] if tensor.code < len(CODES) else "unknown"
    word = kind if kind == "bool" else f"{kind}{tensor.bits}"
    if word not in np.sctypeDict or tensor.lanes != 1:
        raise TypeError(f"its numbers are {word}")
    dtype, shape = np.dtype(word), tuple(tensor.shape[: tensor.ndim])
    steps = tuple(tensor.strides[: tensor.ndim]) if tensor.strides else _strides(shape, 1)
    strides = tuple(dtype.itemsize * step for step in steps)
    return DeviceArray(gpu(), (tensor.data or 0) + tensor.offset, shape, strides, dtype, owner, writeable)


# -------------------------------------------------------------------- the arrays of a batch


class CudaArrays:
    """The arrays of a `RowCode` on the GPU, by field, as `RowArrays` are on the CPU: with n rows, or one for all."""

    strided: Final = True  # the numbers of a row may lie any one distance apart

    def __init__(self, code: RowCode, n: int) -> None:
        self.code, self.n, self._gpu = code, n, gpu()
        self._dtype = np.dtype(code.lanes.real.dtype)
        self._tick, self._begin = self._gpu.functions(row_kernels(code), "tick", "begin")
        self.finite = self._gpu.room((n,), np.dtype(np.bool_))
        self._index = {path: k for k, path in enumerate(code.fields)}
        self._places = (ctypes.c_int64 * (3 * len(code.fields)))()
        self.kept: dict[str, DeviceArray] = {}
        self._sent: dict[str, tuple[bytes, DeviceArray]] = {}

    def room(self, shape: tuple[int, ...]) -> DeviceArray:
        """Zeros, (n, *shape)."""
        return self._gpu.room((self.n, *shape), self._dtype)

    def views(self, block: Block, rows: DeviceArray) -> Mapping[str, DeviceArray]:
        """The fields of a block, sharing the memory of (n, size) rows."""
        step = rows.strides[1]
        return {
            field.path: DeviceArray(
                self._gpu, rows.address + field.offset * step, (self.n, *field.shape),
                (rows.strides[0], *_strides(field.shape, step)), rows.dtype, rows.owner,
            )
            for field in block.fields
        }  # fmt: skip

    def array(self, name: str, value: Any) -> DeviceArray:
        """An array of a caller, where it is."""
        return device_array(name, value)

    def host(self, name: str, value: Any) -> NDArray[Any]:
        """An array of a caller, which may be on the GPU, on the CPU."""
        there = isinstance(value, np.ndarray) or value.__dlpack_device__()[0] in HOST
        return host_array(name, value) if there else device_array(name, value).numpy()

    def sent(self, path: str, array: NDArray[Any], *, per_lane: bool = False) -> DeviceArray:
        """A copy on the GPU, which stays until another one of this path is sent."""
        rows = array if per_lane else array[np.newaxis]
        before, there = self._sent.get(path, (b"", None))
        if there is None or there.shape != rows.shape:
            before, there = b"", self._gpu.room(rows.shape, array.dtype)
        content = np.moveaxis(rows, 0, -1).tobytes()  # the numbers of all lanes side by side
        if content != before:
            source = np.frombuffer(content, dtype=np.uint8)
            self._gpu.call("cuMemcpyHtoDAsync", there.address, source.ctypes.data, source.size, stream())
            self._sent[path] = content, there
        if per_lane:
            return there
        shape, strides = there.shape[1:], there.strides[1:]
        return DeviceArray(self._gpu, there.address, shape, strides, there.dtype, there.owner)

    def put(self, path: str, array: DeviceArray, *, per_lane: bool = True) -> None:
        """The array of a field, of which `row_step` has a step."""
        k, self.kept[path] = self._index[path], array
        lead = int(per_lane)
        step = row_step(array.shape[lead:], array.strides[lead:], self._dtype.itemsize)
        assert step is not None
        self._places[3 * k : 3 * k + 3] = [array.address, array.strides[0] if per_lane else 0, step]

    def begin(self, fresh: DeviceArray, ticks: DeviceArray, mask: DeviceArray) -> None:
        """The next tick of some lanes is their first."""
        numbers = self.n, mask.address, mask.strides[0], fresh.address, ticks.address
        self._gpu.launch(self._begin, self.n, *(ctypes.c_int64(x) for x in numbers))

    def run(self, threads: int = 1) -> None:  # noqa: ARG002
        """Queue the evaluation of all rows; `finite` (n,) then has those without NaN or infinity."""
        n, finite = ctypes.c_int64(self.n), ctypes.c_int64(self.finite.address)
        self._gpu.launch(self._tick, self.n, n, self._places, finite)


class GpuLoop:
    """Runs a `LaneLoop` on the GPU: blocks go there, and what is written comes back."""

    def __init__(self, code: LaneLoop) -> None:
        self._gpu, self._recorded = gpu(), code.recorded
        [self._all] = self._gpu.functions(loop_kernel(code), "all")

    def __call__(self, numbers: tuple[int, int, int, int], blocks: tuple[Any, ...]) -> None:
        there = [self._gpu.copy(block) for block in blocks]
        places = (*numbers, *(memory.address for memory in there))
        self._gpu.launch(self._all, numbers[2] * WARP, *(ctypes.c_int64(x) for x in places))
        for block, memory in list(zip(blocks, there, strict=True))[3 : 5 if self._recorded else 4]:
            self._gpu.fetch(block, memory.address)
