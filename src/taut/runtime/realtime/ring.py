"""Ring: the last ticks of a real-time loop, in memory that outlives each of the processes that use it."""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.runtime.realtime.shared import Shared

WORDS: Final = 64  # of the header, int64 each
HEAD, CAPACITY, WIDTH, ENDED, DROPPED, SAFE, BEAT, LOGGER, PRODUCER, ERRNO = range(10)


class Ring:
    """Rows of doubles in shared memory: one process writes them, any number read them, and none waits for another.

    The producer writes row number k to `rows[k % capacity]` and then stores k + 1 in `header[HEAD]`. A reader copies
    rows and then looks at the head: what had been overwritten by then, it drops and counts.

    `header` is int64 (64,): HEAD, rows written in total; CAPACITY [rows]; WIDTH [doubles]; ENDED, 1 where the run is
    over; of the log process DROPPED and SAFE (rows that are lost, rows on the disk), BEAT (CLOCK_MONOTONIC [ns]),
    LOGGER, its process id, and ERRNO, why the last write failed; PRODUCER, the process id of who writes rows, 0 until
    it does. The rest is 0.
    """

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self.header = shared.words[:WORDS]
        self.capacity, self.width = int(self.header[CAPACITY]), int(self.header[WIDTH])
        self.rows: Float64Array = shared.numbers[WORDS : WORDS + self.capacity * self.width].reshape(-1, self.width)

    @classmethod
    def create(cls, capacity: int, width: int) -> Ring:
        """A new ring of so many rows of so many doubles, empty; closing it removes it."""
        shared = Shared.create(WORDS + capacity * width)
        shared.words[[CAPACITY, WIDTH]] = capacity, width
        return cls(shared)

    @classmethod
    def attach(cls, name: str) -> Ring:
        """The ring that another process created."""
        return cls(Shared.attach(name))

    @property
    def name(self) -> str:
        """Name by which another process attaches to it."""
        return self._shared.name

    def read(self, since: int, max_rows: int) -> tuple[Float64Array, int]:
        """Copies of at most so many rows from row number `since` on, and the count of rows before them that are lost.

        The next row to read is `since` + the count + their number.
        """
        head = int(self.header[HEAD])
        first = max(since, self._oldest())
        last = min(first + max_rows, head)
        rows = self.rows[np.arange(first, last) % self.capacity]
        lost = min(max(0, self._oldest() - first), len(rows))  # overwritten while they were copied
        return rows[lost:], first - since + lost

    def _oldest(self) -> int:
        """Number of the oldest row that is not, and is not being, overwritten."""
        return max(0, int(self.header[HEAD]) - self.capacity + 1)

    def close(self) -> None:
        """Leave the memory; who created the ring removes it."""
        self.header, self.rows = np.zeros(WORDS, dtype=np.int64), self.rows[:0].copy()
        self._shared.close()
