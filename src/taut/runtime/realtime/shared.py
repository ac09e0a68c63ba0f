"""What processes share: memory without a name in any folder, freed with the last one that maps it; environment."""

from __future__ import annotations

import contextlib
import mmap
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array

Words = NDArray[np.int64]


def environment() -> dict[str, str]:
    """Environment of a child, which imports what this process does, also from a path that only this one knows."""
    paths = os.pathsep.join(dict.fromkeys(path or str(Path.cwd()) for path in sys.path))
    return {**os.environ, "PYTHONPATH": paths}


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C waits until the end; there it is dropped where an exception, or the end of the program, is under way."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is None:
        yield  # another thread hears no signals, and a handler that is not Python's cannot be set again
        return
    heard = list[object]()
    before = signal.signal(signal.SIGINT, lambda *given: heard.append(given))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if heard and sys.exc_info()[0] is None and threading.main_thread().is_alive():
        signal.raise_signal(signal.SIGINT)


class Shared:
    """A segment of 64-bit words, as whole numbers and as floats. It is mapped as long as anything views it."""

    def __init__(self, name: str, handle: int, keep: int | None = None) -> None:
        self.name, self._keep = name, keep
        mapped = mmap.mmap(handle, 0, mmap.MAP_SHARED | mmap.MAP_POPULATE)
        self.view = memoryview(mapped).cast("q")  # a number costs a third of one from an array
        self.words: Words = np.frombuffer(self.view, dtype=np.int64)
        self.numbers: Float64Array = self.words.view(np.float64)

    @classmethod
    def create(cls, words: int) -> Shared:
        """A new segment of zeros."""
        handle = os.memfd_create("taut")
        os.posix_fallocate(handle, 0, 8 * words)  # where there is not enough memory, an error here and not later
        return cls(f"/proc/{os.getpid()}/fd/{handle}", handle, handle)

    @classmethod
    def attach(cls, name: str) -> Shared:
        """The segment of that name, of another process that has not closed it."""
        with Path(name).open("r+b", buffering=0) as file:
            return cls(name, file.fileno())

    @property
    def address(self) -> int:
        """Where it begins in this process."""
        return int(self.words.ctypes.data)

    def close(self) -> None:
        """Leave it; others cannot attach to it any more."""
        self.view = memoryview(b"").cast("q")
        self.words, self.numbers = np.zeros(0, dtype=np.int64), np.zeros(0)
        if self._keep is not None:
            os.close(self._keep)
            self._keep = None
