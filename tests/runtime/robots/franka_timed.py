"""A Franka driver that measures its own share of a period, without the wait for the robot."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from typing import Any

from taut.base.types import Float64Array
from taut.runtime.robots.franka import FrankaDriver

KEPT = 60_000


class Waiting:
    """A motion of the client's whose reads are timed: processor time, and the instant when they return."""

    def __init__(self, control: Any) -> None:
        self.control, self.spent, self.returned = control, 0.0, 0.0
        self.writeOnce = control.writeOnce

    def readOnce(self) -> Any:
        before = time.thread_time()
        found = self.control.readOnce()
        self.returned, self.spent = time.perf_counter(), time.thread_time() - before
        return found


class TimedDriver(FrankaDriver):
    """`robot.call("times")` gives the times since it was last called [s]."""

    def __init__(self, address: str) -> None:
        super().__init__(address)
        self.times: deque[float] = deque(maxlen=KEPT)
        self.reading = 0.0

    def begin(self) -> None:
        super().begin()
        self._control = Waiting(self._control)

    def read(self, measured: Mapping[str, Float64Array]) -> None:
        super().read(measured)
        if self._control is not None:
            self.reading = self._control.spent + time.perf_counter() - self._control.returned

    def write(self, command: Float64Array) -> None:
        before = time.perf_counter()
        super().write(command)
        self.times.append(self.reading + time.perf_counter() - before)

    def call(self, name: str, arguments: Mapping[str, Any]) -> Any:
        if name != "times":
            return super().call(name, arguments)
        found = list(self.times)
        self.times.clear()
        return found
