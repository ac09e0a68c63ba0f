"""What a robot's loop does now, and the error that its faults are."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.base.errors import TautError
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array
from taut.control.faults import Fault


class RobotError(TautError, RuntimeError):
    """A robot's loop has latched a fault, `.fault`: go on with `robot.recover()`."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(str(fault), name=fault.name, joint=fault.joint, value=fault.value)
        self.fault = fault


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotStatus(Result):
    """What a robot's loop does now.

    Args:
        state: idle (only reading), holding, running, shadow, fault, or gone (its process ended).
        fault: What is latched, or None.
        t: Time since the law began [s].
        q, v: (n,) measured [rad | m], [rad/s | m/s].
        command: (n,) the last one, in the unit of its kind.
        ticks, lost, overruns: Ticks since the connection, periods that were missed, ticks whose computing took longer
            than a period.
        compute, driver: Median, 99.9th percentile and largest time of a tick's computing, and of the driver with its
            waiting, in the ticks that are kept [s].
        dropped: Ticks that should be in the log and are lost.
        notes: What the system did not allow: real-time priority, locked memory.
    """

    state: str
    fault: Fault | None
    t: float
    q: Float64Array
    v: Float64Array
    command: Float64Array
    ticks: int
    lost: int
    overruns: int
    compute: tuple[float, float, float]
    driver: tuple[float, float, float]
    dropped: int
    notes: tuple[str, ...]

    def json(self) -> dict[str, Any]:
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        values |= {name: values[name].tolist() for name in ("q", "v", "command")}
        return {**values, "fault": None if self.fault is None else dataclasses.asdict(self.fault)}

    def content(self) -> Content:
        rows = [[name, *(f"{1e6 * x:.1f}" for x in getattr(self, name))] for name in ("compute", "driver")]
        counts = f"{self.ticks} ticks, {self.lost} periods missed, {self.overruns} overruns"
        return Content(
            title="robot",
            summary=[f"{self.state}; {counts}"],
            faults=[] if self.fault is None else [str(self.fault)],
            tables=[Table(columns=["time of a tick [us]", "median", "99.9 %", "largest"], rows=rows)],
            notes=self.notes,
        )


def percentiles(values: Float64Array) -> tuple[float, float, float]:
    """Median, 99.9th percentile, largest."""
    if not len(values):
        return 0.0, 0.0, 0.0
    found = np.percentile(values, [50.0, 99.9, 100.0])
    return float(found[0]), float(found[1]), float(found[2])
