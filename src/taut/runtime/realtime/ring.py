"""Ring: the last ticks of a real-time loop, in memory that outlives each of the processes that use it; its rows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.types import Float64Array
from taut.control.faults import CODES, Fault, fault_of
from taut.maths.snapshot import AT_TOOL
from taut.record.info import Outcome
from taut.runtime.realtime.shared import Shared

LIMITED: Final = 1e-9  # [N m | ...] smaller is rounding
OF_A_RUN: Final = ("t", "q", "v", "command")
GROUPS: Final = ("terms.", "reference.")

WORDS: Final = 64  # of the header, int64 each
HEAD, CAPACITY, WIDTH, ENDED, DROPPED, SAFE, LOGGER, ERRNO = range(8)


class Ring:
    """Rows of doubles in shared memory: one process writes them, any number read them, and none waits for another.

    The producer writes row number k to `rows[k % capacity]` and then stores k + 1 in `header[HEAD]`. A reader copies
    rows and then looks at the head: what had been overwritten by then, it drops and counts.

    `header` is int64 (64,): HEAD, rows written in total; CAPACITY [rows]; WIDTH [doubles]; ENDED, 1 where no more
    will come; of the log process DROPPED, rows that are lost; SAFE, the number of the first row that is neither in a
    file, nor lost, nor meant for none; LOGGER, its process id, and ERRNO, why the last write failed. The rest is 0.
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
        shared.words[:] = 0  # its pages are there before a loop attaches
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

    @property
    def done(self) -> bool:
        """Whether no more rows will come, and none is left for the log process."""
        return bool(self.header[ENDED]) and self.header[SAFE] == self.header[HEAD]

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
        """Leave the memory."""
        self.header, self.rows = self.header.copy(), self.rows[:0].copy()
        self._shared.close()


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """What stands where in the rows of a ring. Plain data, which other processes take."""

    columns: Mapping[str, tuple[int, tuple[int, ...]]]  # first double and shape, by path
    measured: Mapping[str, tuple[int, ...]]  # shapes, in the order of the kernel's inputs
    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    torques: bool  # what the commands are

    def column(self, rows: Float64Array, path: str) -> Float64Array:
        """One column (k, ...) of rows."""
        first, shape = self.columns[path]
        size = int(np.prod(shape, dtype=int))
        return rows[:, first : first + size].reshape(len(rows), *shape)

    def of_run(self, rows: Float64Array) -> dict[str, Float64Array]:
        """The columns by the names of `Run.arrays`, in its order."""
        known = {path: self.column(rows, path) for path in self.columns}
        out = {name: known[name] for name in ("t", "q", "v")}
        command = known["command"]
        unmeasured = command if self.torques else np.full_like(command, np.nan)
        out |= {"tau": known.get("tau_meas", unmeasured), "command": command}
        out |= {path: x for group in GROUPS for path, x in known.items() if path.startswith(group)}
        return out | {f"extra.{p}": x for p, x in known.items() if p not in OF_A_RUN and not p.startswith(GROUPS)}

    def fault(self, rows: Float64Array) -> Fault | None:
        """What is latched in the last of these rows, or None; its tick is the first one of them that has it."""
        faults = self.column(rows, "safe.fault")
        code = int(faults[-1]) if len(rows) else 0
        if code == 0:
            return None
        first = len(faults) - int(np.argmax(faults[::-1] != code)) if (faults != code).any() else 0
        tick = int(self.column(rows, "loop.tick")[first])
        index, value = (float(self.column(rows, f"safe.{name}")[-1]) for name in ("index", "value"))
        i, who, joint, units = int(index), "", None, ("rad", "N m")
        if code == CODES["sensor_not_finite"]:
            who, joint = self._measurement(i)
            value = float(rows[first, self.columns["q"][0] + max(i, 0)])
        elif i >= 0:
            joint = self.joint_names[i]
            who, units = f"joint '{joint}'", (self.units[i], "N" if self.units[i] == "m" else "N m")
        return fault_of(code, tick, who=who, value=value, units=units, joint=joint)

    def _measurement(self, index: int) -> tuple[str, str | None]:
        """What a number of the measurements is called, and its joint."""
        for name, shape in self.measured.items():
            size = int(np.prod(shape, dtype=int))
            if index < size:
                of_joints = shape == (len(self.joint_names),) and name not in AT_TOOL
                joint = self.joint_names[index] if of_joints else None
                return (f"{name} of joint '{joint}'" if joint else f"{name}[{index}]"), joint
            index -= size
        return "a measurement", None

    def counts(self, rows: Float64Array) -> Float64Array:
        """(3,) ticks, periods missed, and ticks whose command was limited."""
        limited = (np.abs(self.column(rows, "safe.limited")) > LIMITED).any(axis=1)
        return np.array([len(rows), self.column(rows, "loop.lost").sum(), limited.sum()])


def outcome_of(counts: Float64Array, fault: Fault | None, dropped: int, errno: int) -> Outcome:
    """How a stretch of a robot's loop ended; `dropped` ticks are in no log file, because of `errno`."""
    ticks, lost, limited = (int(count) for count in counts)
    message = f"{ticks} ticks, {lost} periods missed, {limited} ticks limited"
    if dropped:
        why = os.strerror(errno) if errno else "it was written too slowly"
        message += f"; {dropped} ticks are not in the log: {why}"
    return Outcome(
        kind="completed" if fault is None else "stopped",
        message=message if fault is None else f"{fault}; {message}",
        tick=ticks - 1,
        joint=None if fault is None else fault.joint,
        dropped=dropped,
    )
