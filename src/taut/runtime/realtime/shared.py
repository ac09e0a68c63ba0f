"""Memory that processes share: created by the parent, freed with it, whatever the others do; their environment."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taut.base.types import Float64Array

Words = NDArray[np.int64]


def environment() -> dict[str, str]:
    """Environment of a child, which imports what this process does, also from a path that only this one knows."""
    paths = os.pathsep.join(dict.fromkeys(path or str(Path.cwd()) for path in sys.path))
    return {**os.environ, "PYTHONPATH": paths}


class _Memory(SharedMemory):
    """Shared memory whose views may outlive it."""

    def __del__(self) -> None:
        with contextlib.suppress(BufferError):
            super().__del__()


def _attached(name: str) -> SharedMemory:
    """Memory that another process removes; Python before 3.13 would remove it when this process ends."""
    if sys.version_info >= (3, 13):
        return _Memory(name, track=False)
    register: Callable[..., None] = resource_tracker.register
    resource_tracker.register = lambda *_: None
    try:
        return _Memory(name)
    finally:
        resource_tracker.register = register


class Shared:
    """A segment of 64-bit words, as whole numbers and as floats."""

    def __init__(self, memory: SharedMemory, *, owner: bool) -> None:
        self._memory, self._owner = memory, owner
        self.name = memory.name
        assert memory.buf is not None
        self.view = memory.buf.cast("q")  # of the words: a number from it costs a third of one from the array
        self.words: Words = np.frombuffer(self.view, dtype=np.int64)
        self.numbers: Float64Array = self.words.view(np.float64)

    @classmethod
    def create(cls, words: int) -> Shared:
        """A new segment of zeros; who creates it removes it."""
        return cls(_Memory(create=True, size=8 * words), owner=True)

    @classmethod
    def attach(cls, name: str) -> Shared:
        """The segment of that name, of another process."""
        return cls(_attached(name), owner=False)

    @property
    def address(self) -> int:
        """Where it begins in this process."""
        return int(self.words.ctypes.data)

    def close(self) -> None:
        """Leave it, and remove it where it was created. Views that are still about keep their memory."""
        del self.words, self.numbers, self.view
        with contextlib.suppress(BufferError):
            self._memory.close()
        if self._owner:
            with contextlib.suppress(FileNotFoundError):
                self._memory.unlink()
