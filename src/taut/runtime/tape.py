"""Tape: the rows of a run while it goes on, its outcome, and the Run that they make."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import NumericalError, RangeError, TautError, UsageError
from taut.base.paths import subtree
from taut.base.types import Float64Array
from taut.codegen.program import Block, failure
from taut.control.command import wild_term
from taut.control.law import Law
from taut.control.laws.task_space import far_away
from taut.control.lawside import LawSide
from taut.control.tasks.task import NO_CONTACT
from taut.control.trajectories.force_reference import HybridMotion
from taut.control.trajectories.samples import Chunk
from taut.loop import AnyPlant
from taut.maths.snapshot import Snapshot
from taut.record.info import Outcome, RunInfo
from taut.record.parts import PhaseWindow, outcome_with_phases, windows
from taut.record.run import Run

COLUMNS = ("q", "v", "tau", "command")
SANE: Final = 1e6  # [rad/s | m/s]
SEEN: Final = 1e-3  # [m] out of reach: less than that is nobody's concern
LOOKS: Final = 200  # ticks of a run in which the references of hybrid laws are checked
BEYOND: Final = 0.01  # [rad | m] beyond a limit: more than an engine's soft stop gives way


class Tape:
    """Two tables with one row per tick: the loop's inputs (t, ref.*), and its record (q, v, tau, terms.*)."""

    def __init__(self, side: LawSide, plant: AnyPlant, ticks: int, inputs: Block, outputs: Block) -> None:
        self._side = side
        self._plant = plant
        try:
            self.input_rows = np.zeros((ticks, inputs.size))
            self.output_rows = np.zeros((ticks, outputs.size))
        except (MemoryError, ValueError, OverflowError) as cause:
            size = 8e-9 * ticks * (inputs.size + outputs.size)
            raise RangeError(
                f"the record of {ticks:g} ticks needs {size:.3g} GB of memory; make duration= shorter, or the rate "
                "lower",
                name="duration",
            ) from cause
        self.inputs = inputs.views(self.input_rows)
        self.outputs = outputs.views(self.output_rows)
        self.inputs["t"][...] = np.arange(ticks) * side.dt
        self.info = RunInfo()
        self._phases = () if side.task is None else side.task.names
        self.unstable = ""  # why the loop is, where the run starts

    def reference(self, first: int, end: int) -> dict[str, Float64Array]:
        """The reference's columns for some ticks, to be filled."""
        return {name: column[first:end] for name, column in subtree(self.inputs, "ref").items()}

    def piece(self, first: int, end: int, outcome: Outcome) -> Run:
        """The ticks from first to end as a Run; its arrays share the tape's memory."""
        self._leave_out(first, end)
        arm, rows = self._side.arm, {name: column[first:end] for name, column in self.outputs.items()}
        extra = {name: rows[name] for name in rows if name not in COLUMNS and not name.startswith("terms.")}
        return Run(
            t=self.inputs["t"][first:end],
            q=rows["q"],
            v=rows["v"],
            tau=rows["tau"],
            command=rows["command"],
            terms=subtree(rows, "terms"),
            reference=self._side.law.reference.of(self.reference(first, end)),
            outcome=outcome,
            joint_names=arm.joint_names,
            units=arm.units,
            continuous=arm.continuous,
            kind=self._side.probe.kind,
            extra=extra,
            info=self.info,
            arm=self._plant.arm,
        )

    def _leave_out(self, first: int, end: int) -> None:
        """Set the recorded memory of a phase to NaN in the ticks in which the phase does not act."""
        for column, values in self.outputs.items() if self._phases else ():
            if column.startswith("law."):
                values[first:end][~self._acting(column, first, end)] = np.nan

    def _acting(self, path: str, first: int, end: int) -> NDArray[np.bool_]:
        """(k,) whether the phase with this memory acts; not where it is refused for want of contact."""
        phase, ended = (self.outputs[name][first:end] for name in ("phase", "phase_ended"))
        acts: NDArray[np.bool_] = (phase == self._phases.index(path.split(".")[1])) & (ended != NO_CONTACT)
        return acts

    def completed(self) -> Outcome:
        """The outcome of a run that came to its end; it says where the arm went that a real one cannot go."""
        ticks, arm = len(self.output_rows), self._plant.arm
        message = f"completed: {ticks} ticks, {(ticks - 1) * self._side.dt:g} s"
        q = np.ascontiguousarray(self.outputs["q"].T)
        beyond = np.maximum(arm.lower - q.min(axis=1), q.max(axis=1) - arm.upper)
        if (beyond > BEYOND).any():
            joint = int(np.argmax(beyond))
            message += (
                f"; joint '{arm.joint_names[joint]}' went {beyond[joint]:.3g} {arm.units[joint]} beyond its limits, "
                "where a real one meets its stop"
            )
        message += self._remarks(ticks) + self._inadmissible(ticks) + self.out_of_reach(ticks)
        return Outcome(kind="completed", message=message, tick=ticks - 1)

    def explained(self, outcome: Outcome) -> Outcome:
        """The outcome with how the phases of a task ended, and why the loop is unstable where it is."""
        if self.unstable:
            outcome = dataclasses.replace(outcome, message=f"{outcome.message}; {self.unstable}")
        if not self._phases or outcome.tick < 0:
            return outcome
        rows = slice(outcome.tick + 1)
        phase, ended = (self.outputs[name][rows] for name in ("phase", "phase_ended"))
        return outcome_with_phases(
            windows(self._phases, phase, ended, self.inputs["t"][rows]), outcome, self._contact_at
        )

    def _contact_at(self, window: PhaseWindow) -> str:
        """Measurements of a phase in the tick in which it began without contact, in words."""
        row = {name: column[window.first] for name, column in self.outputs.items()}
        row |= {name.removeprefix("sensed."): values for name, values in row.items() if name.startswith("sensed.")}
        seen: dict[str, Any] = {name: row[name] for name in ("q", "v", "F_ext") if name in row}
        if "F_ext" in self._side.needs and "F_ext" not in seen:  # a plant of the user's that does not record it
            return ""
        x = Snapshot(self._side.model, q=seen["q"], v=seen["v"], t=window.start, measured=seen)
        assert self._side.task is not None
        return self._side.task.phases[window.name].contact_state(x)

    def _remarks(self, ticks: int) -> str:
        """Sensors that reached the end of their range in the first ticks of the run, and the notices of the law."""
        said, sensors = "", [name for name in self.outputs if name.startswith("saturated.")]
        texts = {name: f"the sensor of {name.removeprefix('saturated.')} was at its range" for name in sensors}
        texts |= {
            name: "a command was beyond the springs of the drives, and limited,"
            for name in texts
            if name == "saturated.drives"
        }
        for path, text in (texts | dict(self._side.notices)).items():
            there = self.outputs[path][:ticks] != 0.0
            if self._phases and path not in texts:
                there[~self._acting(path, 0, ticks)] = False
            if there.ndim > 1:
                text += f" (index {', '.join(str(i) for i in np.flatnonzero(there.any(axis=0)))})"
                there = there.any(axis=1)
            at = np.flatnonzero(there)
            if len(at):
                said += f"; {text} in {len(at)} of {ticks} ticks, first at t = {self.inputs['t'][at[0]]:.6g} s"
        return said

    def _inadmissible(self, ticks: int) -> str:
        """Parts of the reference that hybrid laws left out; those of a stream are not known before a run."""
        from taut.control.laws.wrappers import check_streamed

        whole, task = self._side.law, self._side.task
        t, rows, home, said = self.inputs["t"][:ticks], self.reference(0, ticks), self._side.arm.home, ""
        for name, law in {"": whole}.items() if isinstance(whole, Law) else whole.laws.items():
            acts = self._acting(f"law.{name}", 0, ticks) if task else np.full(ticks, True)
            seen = np.flatnonzero(acts)[:: max(1, int(acts.sum()) // LOOKS)]
            if len(seen) and issubclass(law.reference, HybridMotion):
                x = Snapshot(self._side.model, q=home, v=0.0 * home, t=t[seen[0]])
                samples = [whole.reference.of({field: rows[field][i] for field in rows}) for i in seen]
                asked = tuple(task.sample_of(name, sample) for sample in samples) if task else tuple(samples)
                followed = Chunk(times=t[seen] - t[seen[0]], samples=asked)
                try:
                    check_streamed(law, x, followed)
                except (RangeError, UsageError) as left_out:
                    said += f"; the law left out a part of what was asked for: {left_out}"
        return said

    def out_of_reach(self, ticks: int) -> str:
        """Targets of the first ticks that were certainly out of the tool's reach, and by how much, in words."""
        x = Snapshot(self._side.model, q=self._side.arm.home, v=np.zeros(self._side.arm.n))
        away = far_away(self._side.law, x, self.reference(0, ticks))
        at = np.flatnonzero(np.zeros(ticks) if away is None else away > SEEN)
        if away is None or not len(at):
            return ""
        worst = int(np.argmax(away))
        return (
            f"; the target was out of the tool's reach in {len(at)} of {ticks} ticks, by {away[worst]:.3g} m at "
            f"least at t = {self.inputs['t'][worst]:.6g} s; bring it nearer"
        )

    def refused(self, tick: int, new: Mapping[str, object], error: RangeError) -> Outcome:
        """The outcome of a run that ends before an event, whose new values have no meaning there."""
        t = self.inputs["t"][tick]
        message = f"stopped at t = {t:.6g} s, before the event that sets {', '.join(new)}: {error}"
        return Outcome(kind="stopped", message=message, tick=tick - 1)

    def without_numbers(self, tick: int, error: NumericalError | RangeError) -> Outcome:
        """The outcome of a run that ends before a tick in which a law or a sensor gave no finite numbers."""
        where = "" if isinstance(error, RangeError) else f", tick {tick}"  # which the other names itself
        message = f"{error} (t = {self.inputs['t'][tick]:.6g} s{where})"
        return Outcome(kind="diverged", message=message, tick=tick - 1, joint=error.joint)

    def failed(self, tick: int, error: Exception) -> Outcome:
        """The outcome where a function or the plant fails before a tick; a refusal in the first tick is raised."""
        if tick == 0 and isinstance(error, TautError):
            raise error
        how = str(error) if isinstance(error, TautError) else failure(error)
        message = f"stopped at t = {self.inputs['t'][tick]:.6g} s (tick {tick}): {how}"
        return Outcome(kind="stopped", message=message, tick=tick - 1)

    def is_sane(self, tick: int) -> bool:
        """True where the motion in a row is one that an arm can have; the fault is then in the law."""
        return bool((np.abs(self.outputs["v"][tick]) < SANE).all())

    def diverged(self, tick: int) -> Outcome:
        """The outcome when the step after row `tick` did not give finite numbers."""
        names, units = self._side.arm.joint_names, self._side.arm.units
        finite = np.isfinite(self.output_rows[tick]).all()
        kept = tick + int(finite)
        t = self.inputs["t"][tick]
        wild = ~np.isfinite(self.outputs["command"][tick])
        if wild.any() and self.is_sane(tick):
            term = wild_term(subtree({path: rows[tick] for path, rows in self.outputs.items()}, "terms"))
            joint = int(np.argmax(wild)) if term is None else term.joint
            message = (
                f"the law gives {self.outputs['command'][tick, joint]} for joint '{names[joint]}' at t = {t:.6g} s "
                f"(tick {tick}){'' if term is None else f', of which the term {term.name!r} is {term.value}'}, where "
                "the arm moves as an arm can"
            )
            return Outcome(kind="diverged", message=message, tick=kept - 1, joint=names[joint])
        speeds = np.abs(self.outputs["v"][tick])
        joint = int(np.argmax(np.where(np.isfinite(speeds), speeds, np.inf)))
        message = (
            f"the simulation diverged at t = {t:.6g} s (tick {tick}): joint '{names[joint]}' was at "
            f"{speeds[joint]:.3g} {units[joint]}/s; try smaller gains, a higher rate or more substeps"
            f"{self._remarks(kept)}{self.out_of_reach(kept)}"
        )
        return Outcome(kind="diverged", message=message, tick=kept - 1, joint=names[joint])
