"""A robot of unit masses without gravity, that fails when it is told to, and writes down what is asked of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taut.robots import DriverError, RobotDriver, RobotInfo


class FaultyDriver(RobotDriver):
    def __init__(
        self, address: str, *, n: int = 2, log: str = "", refuses: str = "", rebinds: bool = False, **declared: Any
    ) -> None:
        self._rebinds = rebinds
        self.address, self.n, self._log, self._refuses, self._declared = address, n, log, refuses, declared
        self.q, self.v = np.full(n, 0.5), np.zeros(n)
        self._fails: dict[str, str] = {}
        self._load = 0.0
        self._grasped = 0.0  # [s]

    def _note(self, what: str) -> None:
        if self._log:
            with Path(self._log).open("a", encoding="utf-8") as file:
                print(what, *self.v.round(4), file=file)

    def open(self) -> RobotInfo:
        if self._refuses:
            raise DriverError(f"nobody answers at {self.address}; switch it on", kind=self._refuses)
        declared = {"rate": 1000.0, "takes": "torque", "adds": ("gravity", "coriolis"), **self._declared}
        return RobotInfo(name=f"robot at {self.address}", n=self.n, **declared)

    def read(self, measured: Mapping[str, Any]) -> None:
        self._fail("read")
        if self._rebinds:
            measured["q"], measured["v"] = self.q, self.v  # type: ignore[index]  # which leaves the arrays as they are
            return
        measured["q"][:], measured["v"][:] = self.q, self.v

    def begin(self) -> None:
        self._note("begin")
        self._fail("begin")

    def write(self, command: Any) -> None:
        self._fail("write")
        self.v += 1e-3 * command
        self.q += 1e-3 * self.v

    def end(self) -> None:
        self._note("end")
        self._fail("end")

    def recover(self) -> None:
        self._note("recover")
        self._fail("recover")

    def set_load(self, mass: float, com: Any, inertia: Any) -> None:
        self._load = mass

    def call(self, name: str, arguments: Mapping[str, Any]) -> Any:
        if name == "fail":
            self._fails = dict(arguments)
            return None
        if name == "push":
            self.v += arguments["v"]
            return None
        if name == "place":
            self.q[:] = arguments["q"]
            return None
        if name == "grasp":
            self._grasped = time.monotonic()
            return None
        if name == "gripper":
            return {"busy": time.monotonic() < self._grasped + 0.05, "error": None, "width": 0.02}
        return super().call(name, arguments)

    def close(self) -> None:
        self._note("close")

    def _fail(self, where: str) -> None:
        how = self._fails.pop(where, "")
        if how == "hang":
            while True:
                pass
        elif how == "ValueError":
            raise ValueError("a bug in the driver")
        elif how:
            raise DriverError(f"the robot failed in {where}", kind=how)
