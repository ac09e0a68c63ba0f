"""A law on a robot: its compiled tick, what feeds it, and the rows that it leaves, read as a Run or a fault."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.control.faults import Fault
from taut.record.info import ServoInfo, with_parameters
from taut.record.run import Run
from taut.runtime.realtime.ring import DROPPED, ERRNO, HEAD, Ring, Rows, outcome_of
from taut.runtime.realtime.sets import Controls, ServoSet
from taut.runtime.simulate import info_of

if TYPE_CHECKING:
    from taut.runtime.realtime.feeding import Feeder, References

CAPACITY: Final = 8192  # rows of the flight recorder
LAST_TICKS: Final = 1000  # rows with a fault
RING_MARGIN: Final = 64  # rows that may be overwritten while others are read


class Acting:
    """A law on a robot; `sends` is False of a shadow."""

    def __init__(
        self, made: ServoSet, references: References, parameters: Mapping[str, Float64Array], *, number: int,
        sends: bool, over: float,
    ) -> None:  # fmt: skip
        self.made, self.number, self.sends = made, number, sends
        self.feeder: Feeder | None = None
        self.controls = Controls(made, references.tables, parameters, over)
        self.ring = Ring.create(CAPACITY, made.row_size)
        arm = made.safe.side.arm
        self.layout = Rows(
            columns=made.columns(), measured=made.safe.measured, joint_names=arm.joint_names, units=arm.units,
            torques=made.safe.torques,
        )  # fmt: skip
        self._stopped: Float64Array | None = None  # the ticks up to a fault
        self.ended: Fault | None = None  # the first fault that was seen, also after it was cleared

    def rows(self, count: int = CAPACITY) -> Float64Array:
        """Copies of the last rows (k, row_size)."""
        head = int(self.ring.header[HEAD])
        return self.ring.read(max(0, head - min(count, CAPACITY - RING_MARGIN)), CAPACITY)[0]

    def column(self, rows: Float64Array, path: str) -> Float64Array:
        """One column (k, ...) of rows."""
        return self.layout.column(rows, path)

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
        fault = self.layout.fault(self.rows(1))
        return fault and self.layout.fault(self.rows())

    def run(self, name: str, arm: Arm, fault: Fault | None, rows: Float64Array | None = None) -> Run:
        """The rows that are kept, or these, as the record of the robot of that name."""
        rows = self.rows() if rows is None else rows
        safe, columns = self.made.safe, {path: x.copy() for path, x in self.layout.of_run(rows).items()}
        side, counts, header = safe.side, self.layout.counts(rows), self.ring.header
        extra = subtree(columns, "extra")
        q = columns["q"][0] if len(rows) and np.isfinite(columns["q"][0]).all() else arm.home
        limits = {name: vars(safe.limits)[name] for name in safe.limits.declared}
        servo = ServoInfo(
            digest=self.made.digest.hex(),
            measures=safe.measures,
            limits={name: np.asarray(value) for name, value in limits.items() if value is not None},
            adds=side.adds,
            at_rest=safe.at_rest,
            torque_rate=safe.torque_rate,
        )
        info = info_of(side, side.law, name, arm, q, side.parameters, servo=servo)
        return Run(
            **{path: columns[path] for path in ("t", "q", "v", "tau", "command")},
            terms=subtree(columns, "terms"),
            reference=side.law.reference.of(subtree(columns, "reference")),
            outcome=outcome_of(counts, fault, int(header[DROPPED]), int(header[ERRNO])),
            joint_names=arm.joint_names,
            units=arm.units,
            continuous=arm.continuous,
            kind=side.probe.kind,
            extra=extra,
            info=with_parameters(info, extra, columns["t"]),
            arm=arm,
        )

    def close(self) -> None:
        """Free the memory, which nobody feeds any more."""
        if self.feeder is not None:
            self.feeder.end()
            self.feeder = None  # or the two would keep each other's memory
        self.controls.shared.close()
        self.ring.close()
