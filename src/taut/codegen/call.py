"""The call path: a Python builtin, generated with the kernel, that takes arrays and gives an array.

`step(q, v, ref)` checks types, lengths and contiguity, copies the numbers into the kernel's input block, runs the
kernel, and returns a new array; measurements follow by keyword, `F_ext=F`, in the order that the law states. `tick()`
works on the block alone and allocates nothing. All else (other keywords, lists, a first tick, a number that is not
finite) goes to a Python function.
"""

from __future__ import annotations

import ctypes
import functools
import importlib
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.base.types import Float64Array
from taut.codegen.llvm import Writer
from taut.codegen.native import NativeModule
from taut.codegen.program import Block

METH_NOARGS: Final = 0x4
METH_FASTCALL_KEYWORDS: Final = 0x82
NPY_DOUBLE: Final = 12
CONTIGUOUS_ALIGNED: Final = 0x1 | 0x100
PYARRAY_TYPE, PYARRAY_NEW = 2, 93  # places in NumPy's table of C functions, fixed by its ABI


@dataclass(frozen=True)
class Offsets:
    """Offsets of the parts of a NumPy array object [bytes]."""

    type_: int
    data: int
    nd: int
    dims: int
    descr: int
    flags: int


@functools.cache
def offsets() -> Offsets | None:
    """The offsets, verified on arrays of this process; None where they are not as expected."""
    base = object.__basicsize__
    found = Offsets(base - 8, base, base + 8, base + 16, base + 40, base + 48)
    try:
        arrays = (np.zeros(3), np.zeros((2, 5)), np.zeros(6)[::2], np.zeros((2, 5), order="F"))
        right = all(_as_expected(found, array) for array in arrays) and _numpy_table()[PYARRAY_TYPE] == id(np.ndarray)
    except (ValueError, OSError, AttributeError, TypeError):
        right = False
    if not right:
        warnings.warn(
            "NumPy's arrays lie in memory in an unknown way, so calls go through ctypes, which costs about 1 us each",
            RuntimeWarning,
            stacklevel=2,
        )
        return None
    return found


def _read(address: int, kind: Any) -> int:
    return int(kind.from_address(address).value or 0)


def _as_expected(at: Offsets, array: Float64Array) -> bool:
    here = id(array)
    dims = _read(here + at.dims, ctypes.c_void_p)
    flags = _read(here + at.flags, ctypes.c_int)
    return (
        _read(here + at.type_, ctypes.c_void_p) == id(np.ndarray)
        and _read(here + at.data, ctypes.c_void_p) == array.ctypes.data
        and _read(here + at.nd, ctypes.c_int) == array.ndim
        and all(_read(dims + 8 * i, ctypes.c_int64) == size for i, size in enumerate(array.shape))
        and _read(here + at.descr, ctypes.c_void_p) == id(array.dtype)
        and bool(flags & 0x1) == array.flags.c_contiguous
        and bool(flags & 0x100) == array.flags.aligned
    )


@functools.cache
def _numpy_table() -> Any:
    multiarray: Any = importlib.import_module("numpy._core._multiarray_umath")
    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.restype, get.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    address = get(multiarray._ARRAY_API, None)
    return ctypes.cast(address, ctypes.POINTER(ctypes.c_void_p))


@functools.cache
def slot_offsets(cls: type, names: tuple[str, ...]) -> tuple[int, ...] | None:
    """Offsets of the slots of a class [bytes], found by probing an instance; None if they cannot be."""
    probe: object = object.__new__(cls)
    marks = [object() for _ in names]
    for name, mark in zip(names, marks, strict=True):
        object.__setattr__(probe, name, mark)
    words = {_read(id(probe) + at, ctypes.c_void_p): at for at in range(object.__basicsize__, cls.__basicsize__, 8)}
    try:
        return tuple(words[id(mark)] for mark in marks)
    except KeyError:
        return None


def layout_key() -> bytes:
    """Memory layout of Python and NumPy on which generated code depends."""
    return repr((offsets(), object.__basicsize__)).encode()


WORDS: Final = (
    "ndarray",  # type object
    "float64",  # dtype object
    "new_array",  # PyArray_New
    "vectorcall",  # PyObject_Vectorcall
    "incref",  # Py_IncRef
    "none",
    "slow",  # Python function for calls of step that are not plain
    "first",  # Python function for a tick before memory has started
    "failed",  # Python function that raises when a number is not finite
    "reference",  # type of the object argument
    "inputs",
    "parameters",
    "memory",
    "new",
    "before",  # memory as it was before the last tick
    "seen",  # inputs as they were in the last tick
    "outputs",
    "shape",
    "keywords",  # addresses of the interned names of keyword arguments
    "ready",  # 0 until memory has started, then READY, or TAKEN while a thread is in the middle of a slow tick
    "count",  # ticks so far
    "dt",
)
WORD: Final = {name: i for i, name in enumerate(WORDS)}
READY: Final = 1
TAKEN: Final = 2
BUILTINS: Final = 2  # step and tick


class _Keeper(np.ndarray[Any, np.dtype[np.uint64]]):
    """The context's words as an array that keeps alive what they point to."""

    keep: list[Any]


class _MethodDef(ctypes.Structure):
    """CPython's PyMethodDef: the definition of a builtin function."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_char_p),
    )


DEFINITION_WORDS: Final = ctypes.sizeof(_MethodDef) // 8


class Context:
    """Run-time data of a generated call: blocks, counters, and the Python objects that it uses."""

    def __init__(
        self,
        module: NativeModule,
        blocks: Mapping[str, Float64Array],
        *,
        result_shape: tuple[int, ...],
        dt: float = 0.0,
        reference: type | None = None,
        keywords: Sequence[str] = (),
    ) -> None:
        self._words = np.zeros(len(WORDS) + BUILTINS * DEFINITION_WORDS, dtype=np.uint64).view(_Keeper)
        self._builtins = 0
        float64 = np.dtype(np.float64)
        interned = [sys.intern(name) for name in keywords]  # as the names in a caller's code are
        arrays: dict[str, np.ndarray[Any, Any]] = {
            **blocks,
            "new": blocks["memory"].copy(),
            "shape": np.array(result_shape or (1,), dtype=np.int64),
            "keywords": np.array([id(name) for name in interned] or [0], dtype=np.uint64),
        }
        self._words.keep = [module, float64, reference, interned, *arrays.values()]
        for name, array in arrays.items():
            self[name] = array.ctypes.data
        self["ndarray"], self["float64"], self["none"] = id(np.ndarray), id(float64), id(None)
        self["reference"] = id(reference)
        self["new_array"] = _numpy_table()[PYARRAY_NEW]
        self["vectorcall"] = _address(ctypes.pythonapi.PyObject_Vectorcall)
        self["incref"] = _address(ctypes.pythonapi.Py_IncRef)
        self._words.view(np.float64)[WORD["dt"]] = dt
        self._module = module

    def __setitem__(self, name: str, value: int) -> None:
        self._words[WORD[name]] = value

    def __getitem__(self, name: str) -> int:
        return int(self._words[WORD[name]])

    def python(self, name: str, function: Callable[..., Any]) -> None:
        """The Python function for one of the words."""
        self._words.keep.append(function)
        self[name] = id(function)

    def builtin(self, name: str, flags: int, doc: str) -> Callable[..., Any]:
        """A compiled function as a Python builtin."""
        # Its definition stands in the words' own buffer, which lives as long as the builtin: an object of its own
        # could be collected first when both are part of a cycle, and CPython reads it when the builtin goes.
        place = self._words.ctypes.data + 8 * (len(WORDS) + self._builtins * DEFINITION_WORDS)
        self._builtins += 1
        definition = _MethodDef.from_address(place)
        definition.name, definition.function = name.encode(), self._module[name]
        definition.flags, definition.doc = flags, doc.encode()
        self._words.keep.append(definition)  # it keeps the two texts
        make = ctypes.pythonapi.PyCFunction_NewEx
        make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p]
        made: Callable[..., Any] = make(place, self._words, None)
        return made


def _address(function: Any) -> int:
    address = ctypes.cast(function, ctypes.c_void_p).value
    assert address is not None
    return address


_BLOCKS: Final = ("inputs", "parameters", "memory", "new", "before", "seen", "outputs")


@dataclass(frozen=True, kw_only=True)
class CallPath:
    """LLVM text of the builtins `step` and `tick` around a function `kernel`."""

    arguments: Sequence[str] | None  # inputs that are arrays by position in `step`; None without a plain call
    inputs: Block
    outputs: Block  # the first field is the result
    memory: Block
    keywords: Sequence[str] = ()
    slots: Mapping[str, int]  # of an object behind the arrays: where each of its inputs stands [bytes]
    time: str | None = None  # the input that gets the number of ticks times dt
    guarded: bool = True  # refuses numbers that are not finite

    def text(self) -> str:
        """LLVM text of all functions."""
        parts = [self._advance(Writer()), self._tick(Writer())]
        if self.arguments is not None:
            parts.append(self._step(Writer(), [*self.arguments]))
        return "\n".join(parts)

    def _advance(self, w: Writer) -> str:
        """One tick on the blocks: 0, or 1 where a number is not finite; then memory stays as it was."""
        block = {name: _word(w, name) for name in _BLOCKS}
        if self.time is not None:
            ticks = w.put(f"sitofp i64 {_word(w, 'count', 'i64')} to double")
            t = w.put(f"fmul double {ticks}, {_word(w, 'dt', 'double')}")
            place = w.put(f"getelementptr double, ptr {block['inputs']}, i64 {self.inputs.field(self.time).offset}")
            w.line(f" store double {t}, ptr {place}")
        self._guard(w, block["inputs"], self.inputs)
        w.line(
            f" call void @kernel(ptr {block['inputs']}, ptr {block['parameters']}, ptr {block['memory']}, "
            f"ptr {block['new']}, ptr {block['outputs']})"
        )
        self._guard(w, block["outputs"], self.outputs)
        self._guard(w, block["new"], self.memory)
        w.copy(block["inputs"], block["seen"], self.inputs.size)
        w.copy(block["memory"], block["before"], self.memory.size)
        w.copy(block["new"], block["memory"], self.memory.size)
        more = w.put(f"add i64 {_word(w, 'count', 'i64')}, 1")
        place = w.put(f"getelementptr i64, ptr %context, i64 {WORD['count']}")
        w.line(f" store i64 {more}, ptr {place}", " ret i32 0")
        if self.guarded:
            w.line("bad:", " ret i32 1")
        return w.function("internal i32 @advance(ptr %context) nounwind")

    def _guard(self, w: Writer, pointer: str, block: Block) -> None:
        wrong = w.not_finite(pointer, block.size) if self.guarded else None
        if wrong is not None:
            w.unless(wrong, "bad")

    def _tick(self, w: Writer) -> str:
        """The builtin without arguments: the kernel on its own blocks; returns None."""
        _context(w)
        w.unless(w.put(f"icmp eq i64 {_word(w, 'ready', 'i64')}, 0"), "first")
        status = w.put("call i32 @advance(ptr %context)")
        w.unless(w.put(f"icmp ne i32 {status}, 0"), "failed")
        none, incref = _word(w, "none"), _word(w, "incref")
        w.line(f" call void {incref}(ptr {none})", f" ret ptr {none}")
        for label in ("first", "failed"):
            _leave(w, label, "ptr null, i64 0, ptr null")
        return w.function("ptr @tick(ptr %self, ptr %unused) nounwind")

    def _step(self, w: Writer, arguments: Sequence[str]) -> str:
        """The builtin with arguments: arrays in, a new array out."""
        _context(w)
        count = len(arguments) + bool(self.slots)
        w.unless(w.put(f"icmp ne i64 %nargs, {count}"), "slow")
        self._check_names(w)
        w.unless(w.put(f"icmp ne i64 {_word(w, 'ready', 'i64')}, {READY}"), "slow")
        inputs, ndarray, float64 = _word(w, "inputs"), _word(w, "ndarray"), _word(w, "float64")
        arrays = {path: w.load_at("%args", 8 * i) for i, path in enumerate(arguments)}
        if self.slots:
            sample = w.load_at("%args", 8 * len(arguments))
            kind = w.load_at(sample, _at().type_)
            w.unless(w.put(f"icmp ne ptr {kind}, {_word(w, 'reference')}"), "slow")
            arrays |= {path: w.load_at(sample, offset) for path, offset in self.slots.items()}
        arrays |= {path: w.load_at("%args", 8 * (count + i)) for i, path in enumerate(self.keywords)}
        for path, array in arrays.items():
            self._take(w, path, array, inputs, ndarray, float64)
        status = w.put("call i32 @advance(ptr %context)")
        w.unless(w.put(f"icmp ne i32 {status}, 0"), "failed")
        result = self.outputs.fields[0]
        new_array, shape, outputs = _word(w, "new_array"), _word(w, "shape"), _word(w, "outputs")
        made = w.put(
            f"call ptr {new_array}(ptr {ndarray}, i32 {len(result.shape)}, ptr {shape}, i32 {NPY_DOUBLE}, "
            "ptr null, ptr null, i32 0, i32 0, ptr null)"
        )
        w.unless(w.put(f"icmp eq ptr {made}, null"), "out")
        w.copy(outputs, w.load_at(made, _at().data), result.size)
        w.line(f" ret ptr {made}", "out:", " ret ptr null")
        _leave(w, "slow", "ptr %args, i64 %nargs, ptr %names")
        _leave(w, "failed", "ptr null, i64 0, ptr null")
        return w.function("ptr @step(ptr %self, ptr %args, i64 %nargs, ptr %names) nounwind")

    def _check_names(self, w: Writer) -> None:
        """The keywords must be the known ones in their order: their values stand behind the positional ones."""
        if not self.keywords:
            w.unless(w.put("icmp ne ptr %names, null"), "slow")
            return
        w.unless(w.put("icmp eq ptr %names, null"), "slow")
        size = w.load_at("%names", object.__basicsize__, "i64")
        w.unless(w.put(f"icmp ne i64 {size}, {len(self.keywords)}"), "slow")
        known = _word(w, "keywords")
        for i in range(len(self.keywords)):
            given, wanted = w.load_at("%names", tuple.__basicsize__ + 8 * i), w.load_at(known, 8 * i)
            w.unless(w.put(f"icmp ne ptr {given}, {wanted}"), "slow")

    def _take(self, w: Writer, path: str, array: str, inputs: str, ndarray: str, float64: str) -> None:
        """Check one array and copy its numbers into the input block."""
        field, at = self.inputs.field(path), _at()
        w.unless(w.put(f"icmp eq ptr {array}, null"), "slow")
        w.unless(w.put(f"icmp ne ptr {w.load_at(array, at.type_)}, {ndarray}"), "slow")
        w.unless(w.put(f"icmp ne ptr {w.load_at(array, at.descr)}, {float64}"), "slow")
        w.unless(w.put(f"icmp ne i32 {w.load_at(array, at.nd, 'i32')}, {len(field.shape)}"), "slow")
        if field.shape:
            dims = w.load_at(array, at.dims)
            for i, size in enumerate(field.shape):
                w.unless(w.put(f"icmp ne i64 {w.load_at(dims, 8 * i, 'i64')}, {size}"), "slow")
        good = w.put(f"and i32 {w.load_at(array, at.flags, 'i32')}, {CONTIGUOUS_ALIGNED}")
        w.unless(w.put(f"icmp ne i32 {good}, {CONTIGUOUS_ALIGNED}"), "slow")
        target = w.put(f"getelementptr double, ptr {inputs}, i64 {field.offset}")
        w.copy(w.load_at(array, at.data), target, field.size)


def _at() -> Offsets:
    at = offsets()
    assert at is not None
    return at


def _context(w: Writer) -> None:
    place = w.put(f"getelementptr i8, ptr %self, i64 {_at().data}")
    w.line(f" %context = load ptr, ptr {place}")


def _word(w: Writer, name: str, kind: str = "ptr") -> str:
    return w.load_at("%context", 8 * WORD[name], kind)


def _leave(w: Writer, label: str, arguments: str) -> None:
    """Hand over to a Python function and return what it returns."""
    w.line(f"{label}:")
    function, call = _word(w, label), _word(w, "vectorcall")
    result = w.put(f"call ptr {call}(ptr {function}, {arguments})")
    w.line(f" ret ptr {result}")
