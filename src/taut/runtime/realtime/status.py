"""What a robot's loop does now, how its ticks were timed, and the error that its faults are."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.base.errors import TautError, UsageError
from taut.base.plot_style import INK, WIDTH, colour, prepared
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array
from taut.control.faults import Fault
from taut.record.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PARTS: Final = {
    "late": "lateness of a tick",
    "compute": "its computing",
    "driver": "the driver, with its waiting",
}
PERCENTILES: Final = (50.0, 99.0, 99.9, 100.0)
HISTOGRAM_HEIGHT: Final = 2.2  # [in] of a histogram
BINS: Final = 80


class RobotError(TautError, RuntimeError):
    """A robot's loop has latched a fault, `.fault`; `.run` is the record of the last 1000 ticks up to it."""

    fault: Fault
    run: Run

    @classmethod
    def of(cls, fault: Fault, run: Run) -> RobotError:
        """The error of a fault."""
        error = cls(str(fault), name=fault.name, joint=fault.joint, value=fault.value)
        error.fault, error.run = fault, run
        return error


@dataclass(frozen=True, kw_only=True, eq=False)
class Timing(Result):
    """How the ticks of a robot's loop were timed.

    Args:
        period: Of the loop [s].
        late: (k,) time of each tick behind its period [s].
        compute: (k,) time that law and safety limits took [s].
        driver: (k,) time in the driver's read and write, with the wait for a robot that keeps the time [s].
        lost: Periods that were missed.
    """

    period: float
    late: Float64Array
    compute: Float64Array
    driver: Float64Array
    lost: int

    @classmethod
    def of(cls, run: Run) -> Timing:
        """That of a robot's record; UsageError for another run."""
        if "loop.late" not in run.extra:
            raise UsageError("timing is of the record of a robot, from taut.connect", name="run")
        times = {name: np.array(run.extra[f"loop.{name}"]) for name in PARTS}
        return cls(period=1.0 / run.rate, lost=int(run.extra["loop.lost"].sum()), **times)

    @property
    def overruns(self) -> int:
        """Ticks whose computing took longer than a period."""
        return int((self.compute > self.period).sum())

    @property
    def share(self) -> float:
        """Median part of the period that computing takes [-]."""
        return float(np.median(self.compute)) / self.period if len(self.compute) else 0.0

    def content(self) -> Content:
        rows = [
            [words, *(f"{1e6 * x:.1f}" for x in np.percentile(getattr(self, name), PERCENTILES))]
            for name, words in PARTS.items()
            if len(self.late)
        ]
        counts = f"{len(self.late)} ticks, {self.lost} periods missed, {self.overruns} overruns"
        return Content(
            title="timing",
            summary=[f"{counts}; computing takes {100.0 * self.share:.2g} % of the period"],
            tables=[Table(columns=["[us]", "median", "99 %", "99.9 %", "largest"], rows=rows)],
            figures={"timing": self.plot},
        )

    def plot(self) -> Figure:
        """Histograms of lateness, of computing and of the driver's time, on logarithmic axes."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH, HISTOGRAM_HEIGHT), layout="constrained")
        for i, (ax, (name, words)) in enumerate(zip(figure.subplots(1, len(PARTS)), PARTS.items(), strict=True)):
            times = 1e6 * np.maximum(getattr(self, name), 1e-8)
            prepared(ax, title=words, xlabel="[us]", ylabel="ticks" if i == 0 else "")
            if len(times):
                edges = np.geomspace(times.min(), max(times.max(), 1.01 * times.min()), BINS)
                ax.hist(times, bins=edges, color=colour(i))
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.axvline(1e6 * self.period, color=INK, linewidth=0.8, linestyle=":")
        return figure


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotStatus(Result):
    """What a robot's loop does now.

    Args:
        state: idle (only reading), holding, running, shadow, fault, or gone (its process ended).
        fault: What is latched, or None.
        t: Time since the law began [s].
        q, v: (n,) measured [rad | m], [rad/s | m/s]; NaN where it ended before a tick.
        command: (n,) the last one, in the unit of its kind.
        ticks, lost, overruns: Ticks since the connection, periods that were missed, ticks whose computing took longer
            than a period.
        timing: Of the ticks that are kept.
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
    timing: Timing
    dropped: int
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        arrays = ", ".join(f"{name}={np.round(getattr(self, name), 4).tolist()}" for name in ("q", "v", "command"))
        fault = None if self.fault is None else self.fault.name
        return f"RobotStatus({self.state}, fault={fault}, t={self.t:.4g}, {arrays}, ticks={self.ticks})"

    def json(self) -> dict[str, Any]:
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        values |= {name: values[name].tolist() for name in ("q", "v", "command")}
        fault = None if self.fault is None else dataclasses.asdict(self.fault)
        return {**values, "fault": fault, "timing": self.timing.json()}

    def content(self) -> Content:
        timing = self.timing.content()
        counts = f"{self.ticks} ticks, {self.lost} periods missed, {self.overruns} overruns since it connected"
        return Content(
            title="robot",
            summary=[f"{self.state}; {counts}"],
            faults=[] if self.fault is None else [str(self.fault)],
            tables=timing.tables,
            notes=self.notes,
            figures=timing.figures,
        )
