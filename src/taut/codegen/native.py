"""Native: LLVM text to machine code through llvmlite, kept in the cache. No C compiler is needed."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import itertools
import os
import platform
import stat
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from taut.base import __version__
from taut.base.errors import TautError, warn
from taut.codegen.functions import Real
from taut.trace import graph

LEVEL: Final = 2  # of LLVM's code generator; 3 gives nothing, 1 is no faster to compile
QUICK: Final = 0  # a fifth of the time to compile and less, three times that to run
PATIENCE: Final = 50_000  # calls of code until it was worth compiling well
LIBRARIES: Final = 64  # of one linker, which takes a millisecond to make
_LOCK: Final = threading.Lock()


def level_for(calls: float | None) -> int:
    """The level for code that is called so often, or any number of times."""
    return QUICK if calls is not None and calls <= PATIENCE else LEVEL


def available() -> bool:
    """True where llvmlite is installed, so that native code can be made."""
    return importlib.util.find_spec("llvmlite") is not None


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warn_of_plain_python() -> None:
    """The one line about running without native code."""
    warn("llvmlite is not installed, so laws run as plain Python, about 1000 times slower; pip install llvmlite")


@dataclass(frozen=True)
class NativeModule:
    """Compiled functions, by name. They live as long as this object."""

    addresses: dict[str, int]
    cached: bool
    code_bytes: int
    _library: Any = field(repr=False)

    def __getitem__(self, name: str) -> int:
        return self.addresses[name]


def _together() -> bool:
    """True where code is linked with its constants next to it, and addresses them relative to itself."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


@functools.cache
def host_lanes(real: Real) -> int:
    """Numbers of a type that one instruction of this processor computes with."""
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features()
    bits = 512 if features.get("avx512f") and features.get("avx512dq") else 256 if features.get("avx") else 128
    return bits // (8 * real.dtype().itemsize)


def _new_machine(level: int) -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=level,
        **({"codemodel": "small", "reloc": "pic"} if _together() else {}),
    )


@functools.cache
def _machine(level: int) -> Any:
    """LLVM's code generator for this processor."""
    return _new_machine(level)


@functools.lru_cache(maxsize=1)
def _jit(number: int) -> Any:  # noqa: ARG001
    """A linker that puts object code into this process; it takes over its machine, so it has its own.

    It keeps 9 kB of each library until the last of them is released: hence a new one after `LIBRARIES`.
    """
    import llvmlite.binding as llvm

    return llvm.create_lljit_compiler(_new_machine(LEVEL), use_jit_link=_together())


_LIBRARY_NUMBERS: Final = itertools.count()


def _sources() -> bytes:
    """A digest of the code that numbers and writes operations: another version's work is never taken for its own."""
    files = [Path(graph.__file__), *sorted(Path(__file__).parent.glob("*.py"))]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).digest()


@functools.cache
def _platform_key() -> bytes:
    """Everything besides the program that determines the machine code."""
    import llvmlite
    import llvmlite.binding as llvm

    parts = (
        __version__,
        _sources(),
        LEVEL,
        llvmlite.__version__,
        llvm.llvm_version_info,
        llvm.get_default_triple(),
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
    )
    return repr(parts).encode()


def compiled(
    content: bytes,  # what the text is made from: with the platform, the key in the cache
    text: Callable[[], str],  # called only where the cache has nothing
    names: Sequence[str],
    verify: Callable[[NativeModule], None] | None = None,  # raises where a module is wrong, which is not cached
    level: int | None = None,  # of LLVM's code generator, at least; the full one by default
    symbols: Mapping[str, int] | None = None,  # addresses of further functions that it calls
) -> NativeModule:
    """Machine code for a module of LLVM text. It gives the same numbers at each level."""
    return _made(content, text, names, verify, level, symbols)[0]


def object_code(
    content: bytes,
    text: Callable[[], str],
    names: Sequence[str],
    verify: Callable[[NativeModule], None] | None = None,
) -> bytes:
    """The same as `compiled`, as object code for `link` in another process."""
    return _made(content, text, names, verify, None)[1]


def link(code: bytes, names: Sequence[str]) -> NativeModule:
    """Object code of this machine as functions."""
    with _LOCK:
        return _linked(code, names, cached=True)


def _made(
    content: bytes,
    text: Callable[[], str],
    names: Sequence[str],
    verify: Callable[[NativeModule], None] | None,
    level: int | None,
    symbols: Mapping[str, int] | None = None,
) -> tuple[NativeModule, bytes]:
    level = LEVEL if level is None else level
    keys = [hashlib.sha256(_platform_key() + bytes([k]) + content).digest() for k in dict.fromkeys((level, LEVEL))]
    key, kept = keys[0], next(filter(None, map(load, reversed(keys))), None)
    with _LOCK:
        if kept is not None:
            try:
                return _linked(kept, names, cached=True, symbols=symbols), kept
            except RuntimeError:  # an object that LLVM does not take: compile it again
                pass
        code = _generated(text(), level)
        module = _linked(code, names, cached=False, symbols=symbols)
    if verify is not None:
        verify(module)
    store(key, code)
    return module, code


def _generated(text: str, level: int) -> bytes:
    import llvmlite.binding as llvm

    machine = _machine(level)
    try:
        module = llvm.parse_assembly(text)
        module.verify()
    except RuntimeError as cause:  # a fault of ours, never of the caller
        raise TautError(f"LLVM refuses generated code; please report this: {cause}") from cause
    # The graph is already folded and shared: of LLVM's passes only inlining is worth its time.
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=0))
    builder.getModulePassManager().run(module, builder)
    code: bytes = machine.emit_object(module)
    return code


GPU: Final = ("nvptx64-nvidia-cuda", "sm_75", "+ptx70")  # which later GPUs and drivers take


def ptx(text: str, entries: Sequence[str]) -> str:
    """PTX of LLVM text, all of whose functions are inlined into its entries: what they share is in registers."""
    import llvmlite.binding as llvm

    triple, cpu, features = GPU
    with _LOCK:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, features=features, opt=3)
        module = llvm.parse_assembly(text)
        module.triple, module.data_layout = triple, str(machine.target_data)
        for function in module.functions:
            if not function.is_declaration and function.name not in entries:
                function.linkage = "internal"
                function.add_function_attribute("alwaysinline")
        module.verify()
        builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
        builder.getModulePassManager().run(module, builder)
        out: str = machine.emit_assembly(module)
        return out


def _linked(
    code: bytes, names: Sequence[str], *, cached: bool, symbols: Mapping[str, int] | None = None
) -> NativeModule:
    import llvmlite.binding as llvm

    builder = llvm.JITLibraryBuilder().add_object_img(code)
    for name, address in (symbols or {}).items():
        builder.import_symbol(name, address)
    for name in names:
        builder.export_symbol(name)
    number = next(_LIBRARY_NUMBERS)
    library = builder.link(_jit(number // LIBRARIES), f"taut{number}")
    return NativeModule({name: int(library[name]) for name in names}, cached, len(code), library)


MAGIC: Final = b"taut2\n"  # then a digest of the rest: the key, and the content
DIGEST: Final = 32  # bytes of SHA-256
ENVIRONMENT: Final = "TAUT_CACHE_DIR"


def cache_folder() -> Path:
    """Folder of compiled code; the variable TAUT_CACHE_DIR moves it."""
    given = os.environ.get(ENVIRONMENT)
    if given:
        return Path(given).expanduser()
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "taut" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "taut"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taut"


def _private(info: os.stat_result) -> bool:
    """True where nobody else can write a file or folder, from which code is loaded and run."""
    if sys.platform == "win32":  # the folder stands in the user's own profile, with its access list
        return True
    return info.st_uid == os.getuid() and not info.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _usable_folder(*, make: bool) -> Path | None:
    """The folder, if it is there and ours alone; otherwise one warning says why not."""
    try:
        folder = cache_folder()
        if not folder.exists():
            if not make:
                return None
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        info = folder.stat()
    except (OSError, RuntimeError) as cause:  # RuntimeError: a user without a home folder
        _warn_once(f"the cache folder cannot be used ({cause}); code is compiled each time; set {ENVIRONMENT}")
        return None
    if not _private(info):
        _warn_once(
            f"the cache folder '{folder}' can be written by others, so no code is loaded from it; "
            f"chmod 700 it, or set {ENVIRONMENT}"
        )
        return None
    return folder


_WARNED: Final[set[str]] = set()


def _warn_once(text: str) -> None:
    if text not in _WARNED:
        _WARNED.add(text)
        warnings.warn(text, RuntimeWarning, stacklevel=4)


def load(key: bytes) -> bytes | None:
    """The entry of this key, or None where there is none that is whole, ours, and stored under this key."""
    folder = _usable_folder(make=False)
    if folder is None:
        return None
    try:
        with (folder / key.hex()).open("rb") as file:
            if not _private(os.fstat(file.fileno())):
                return None
            data = file.read()
    except OSError:
        return None
    head = len(MAGIC) + DIGEST
    if not data.startswith(MAGIC) or hashlib.sha256(data[head:]).digest() != data[len(MAGIC) : head]:
        return None  # cut off or damaged: it is compiled again and replaced
    if not data.startswith(key, head):
        return None  # the entry of another key, copied to this name
    return data[head + len(key) :]


def store(key: bytes, content: bytes) -> None:
    """Keep an entry. It appears whole or not at all, also with many processes at once."""
    folder = _usable_folder(make=True)
    if folder is None:
        return
    body = key + content
    data = MAGIC + hashlib.sha256(body).digest() + body
    name: str | None = None
    try:
        handle, name = tempfile.mkstemp(dir=folder, prefix="writing-")
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        Path(name).replace(folder / key.hex())
    except OSError as cause:
        if name is not None:
            with contextlib.suppress(OSError):
                Path(name).unlink()
        _warn_once(f"the cache folder '{folder}' cannot be written ({cause.strerror}); code is compiled each time")
