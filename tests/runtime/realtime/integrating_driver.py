"""A robot of integrators: it takes velocities, and measures positions alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from taut.runtime.robots.driver import RobotDriver, RobotInfo

RATE = 500.0
HOME = np.array([0.0, -1.5, 1.5, 0.0, 0.5, 0.0])


class IntegratingDriver(RobotDriver):
    def __init__(self, address: str) -> None:
        self.q, self.v = HOME.copy(), np.zeros(6)

    def open(self) -> RobotInfo:
        return RobotInfo(name="integrators", n=6, rate=RATE, takes="velocity", measures=())

    def read(self, measured: Mapping[str, Any]) -> None:
        self.q += self.v / RATE
        measured["q"][:] = self.q

    def begin(self) -> None:
        self.v[:] = 0.0

    def write(self, command: Any) -> None:
        self.v[:] = command

    def end(self) -> None:
        self.v[:] = 0.0

    def close(self) -> None:
        pass
