"""A law on a robot: its compiled tick, what feeds it, and the rows that it leaves, read as a Run or a fault."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.faults import CODES, Fault, fault_of
from taut.maths.snapshot import AT_TOOL
from taut.record.info import Outcome, RunInfo, versions
from taut.record.run import Run
from taut.runtime.realtime.ring import HEAD, Ring
from taut.runtime.realtime.sets import Controls, ServoSet

if TYPE_CHECKING:
    from taut.runtime.realtime.feeding import References

CAPACITY: Final = 8192  # rows of the flight recorder
LAST_TICKS: Final = 1000  # rows with a fault
RING_MARGIN: Final = 64  # rows that may be overwritten while others are read
LIMITED: Final = 1e-9  # [N m | ...] smaller is rounding
NOT_EXTRA: Final = ("t", "q", "v", "command")


class Acting:
    """A law on a robot; `sends` is False of a shadow."""

    def __init__(
        self, made: ServoSet, references: References, parameters: Mapping[str, Float64Array], *, number: int,
        sends: bool, over: float,
    ) -> None:  # fmt: skip
        self.made, self.number, self.sends = made, number, sends
        self.controls = Controls(made, references.tables, parameters, over)
        self.ring = Ring.create(CAPACITY, made.row_size)
        self.columns = made.columns()
        self._stopped: Float64Array | None = None  # the ticks up to a fault

    def rows(self, count: int = CAPACITY) -> Float64Array:
        """Copies of the last rows (k, row_size)."""
        head = int(self.ring.header[HEAD])
        return self.ring.read(max(0, head - min(count, CAPACITY - RING_MARGIN)), CAPACITY)[0]

    def column(self, rows: Float64Array, path: str) -> Float64Array:
        """One column (k, ...) of rows."""
        first, shape = self.columns[path]
        size = int(np.prod(shape, dtype=int))
        return rows[:, first : first + size].reshape(len(rows), *shape)

    def keep_fault(self, rows: Float64Array) -> None:
        """Keep the ticks up to a fault that the last row has, and drop them where it has none any more."""
        if not len(rows) or self.column(rows, "safe.fault")[-1] < 0.5:
            self._stopped = None
        elif self._stopped is None:
            self._stopped = self.rows(LAST_TICKS)

    @property
    def last_rows(self) -> Float64Array:
        """The last ticks (1000, row_size), those up to a fault where there is one."""
        return self.rows(LAST_TICKS) if self._stopped is None else self._stopped

    def fault(self) -> Fault | None:
        """What the ticks have latched, or None."""
        last = self.rows(1)
        code = int(self.column(last, "safe.fault")[-1]) if len(last) else 0
        if code == 0:
            return None
        rows = self.rows()
        faults = self.column(rows, "safe.fault")
        first = len(faults) - int(np.argmax(faults[::-1] != code)) if (faults != code).any() else 0
        tick = int(self.column(rows, "loop.tick")[first])
        index, value = (float(self.column(last, f"safe.{name}")[-1]) for name in ("index", "value"))
        arm, i, who, joint, units = self.made.safe.side.arm, int(index), "", None, ("rad", "N m")
        if code == CODES["sensor_not_finite"]:
            who, joint = _measurement(self.made.safe.measured, i, arm)
            value = float(rows[first, self.columns["q"][0] + max(i, 0)])
        elif i >= 0:
            joint = arm.joint_names[i]
            who, units = f"joint '{joint}'", (arm.units[i], "N" if arm.units[i] == "m" else "N m")
        return fault_of(code, tick, who=who, value=value, units=units, joint=joint)

    def run(self, name: str, arm: Arm, fault: Fault | None, rows: Float64Array | None = None) -> Run:
        """The rows that are kept, or these, as the record of the robot of that name."""
        rows = self.rows() if rows is None else rows
        side, columns = self.made.safe.side, {path: self.column(rows, path).copy() for path in self.columns}
        t, q = columns["t"], columns["q"]
        apart = ("reference.", "terms.")
        limited = int((np.abs(columns["safe.limited"]).max(axis=1) > LIMITED).sum())
        message = f"{len(t)} ticks, {int(columns['loop.lost'].sum())} periods missed, {limited} ticks limited"
        return Run(
            t=t,
            q=q,
            v=columns["v"],
            tau=columns.get("tau_meas", columns["command"]),
            command=columns["command"],
            terms=subtree(columns, "terms"),
            reference=side.law.reference.of(subtree(columns, "reference")),
            outcome=Outcome(
                kind="completed" if fault is None else "stopped",
                message=message if fault is None else f"{fault}; {message}",
                tick=len(t) - 1,
                joint=None if fault is None else fault.joint,
            ),
            joint_names=arm.joint_names,
            units=arm.units,
            continuous=arm.continuous,
            kind=side.probe.kind,
            extra={p: x for p, x in columns.items() if p not in NOT_EXTRA and not p.startswith(apart)},
            info=RunInfo(
                rate=side.rate,
                duration=max(len(t) - 1, 0) * side.dt,
                law=repr(side.law),
                arm=side.arm.name,
                plant=name,
                controller_arm=side.arm,
                plant_arm=arm,
                sensing=str(side.sensing),
                parameters={path: view.copy() for path, view in self.controls.views.items()},
                versions=versions(),
            ),
            arm=arm,
        )

    def close(self) -> None:
        """Free the memory."""
        self.controls.shared.close()
        self.ring.close()


def _measurement(measured: Mapping[str, tuple[int, ...]], index: int, arm: Arm) -> tuple[str, str | None]:
    """What a number of the measurements is called, and its joint."""
    for name, shape in measured.items():
        size = int(np.prod(shape, dtype=int))
        if index < size:
            joint = arm.joint_names[index] if shape == (arm.n,) and name not in AT_TOOL else None
            return (f"{name} of joint '{joint}'" if joint else f"{name}[{index}]"), joint
        index -= size
    return "a measurement", None
