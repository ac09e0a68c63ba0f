"""Replay: the ticks of a robot's record, computed again from their own inputs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.base.checks import instance_of
from taut.base.errors import MatchError, UsageError, count_of
from taut.base.result import Content, Result
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.engine import machine_code
from taut.control.safety import SafeSide, SafetyLimits
from taut.controller import Controller
from taut.record.info import ServoInfo, versions
from taut.record.run import Run
from taut.runtime.realtime.sets import FUNCTIONS, ServoSet


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay(Result):
    """The ticks of a record of a robot, computed again.

    Args:
        ticks: Of the record.
        identical: Ticks of which every output, and the memory that the next tick began with, are the same to the
            last bit.
        first: The first tick that is not: its number, or None.
        column, recorded, computed: A number in which it differs, before and now.
        changed: Programs of another version than those of the record, by name.
    """

    ticks: int
    identical: int
    first: int | None = None
    column: str = ""
    recorded: float | None = None
    computed: float | None = None
    changed: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether every tick is the same."""
        return self.identical == self.ticks

    @property
    def percent(self) -> float:
        """Ticks that are the same [%]."""
        return 100.0 * self.identical / max(self.ticks, 1)

    def json(self) -> dict[str, Any]:
        return {**dataclasses.asdict(self), "percent": self.percent}

    def content(self) -> Content:
        found = f"{self.identical} of {count_of(self.ticks, 'tick')} are bit-identical: {self.percent:.6g} %"
        faults = []
        if self.first is not None:
            was = f"recorded {self.recorded!r}, computed {self.computed!r}"
            faults.append(f"tick {self.first} differs first, in {self.column}: {was}")
        notes = [f"{name} was {old} and is {versions().get(name)}" for name, old in self.changed.items()]
        return Content(title="replay", summary=[found], faults=faults, notes=notes)


def replay(run: Run, ctrl: Controller) -> Replay:
    """Compute every tick of a robot's record again, from the inputs, parameters and memory that it began with.

    On the machine of the record the results are the same to the last bit; on another processor they need not be.

    Args:
        run: Of a robot: `robot.run()`, or a log of `taut.connect(..., log=)`.
        ctrl: The controller that was started, made again by `taut.compile` with the same law, arm, rate, sensing,
            limits and `adds`. Values of parameters do not matter: they are in the record.

    Raises:
        UsageError: The run is no record of a robot.
        MatchError: The record is that of another law, arm or robot.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
        >>> with taut.connect(taut.RigidPlant(arm)) as robot:
        ...     robot.start(ctrl)
        ...     robot.wait(0.1)
        ...     run = robot.stop()
        >>> taut.analysis.replay(run, ctrl).percent
        100.0
    """
    instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
    servo = require_servo(run)
    limits = SafetyLimits(**servo.limits)
    made = ServoSet(SafeSide(side=ctrl.side, limits=limits, measures=servo.measures), dict(ctrl.parameters))
    if made.digest.hex() != servo.digest:
        raise MatchError(
            f"the record is not of this controller: it was made with {run.info.law} on arm '{run.info.arm}' at "
            f"{run.rate:g} Hz, sensing {run.info.sensing}, limits {run.info.command_limits}; compile that law again, "
            "with the same arm",
            name="ctrl",
        )
    inputs, parameters, memory, outputs = _blocks(run, made)
    new, computed = np.zeros_like(memory), np.zeros_like(outputs)
    code = native.link(made.code, FUNCTIONS)
    tick = machine_code(code["kernel"])
    for k in range(len(run)):
        tick(inputs[k], parameters[k], memory[k], new[k], computed[k])
    follows = np.append(np.diff(run.extra["loop.tick"]) == 1.0, False)  # else the next row begins elsewhere
    after = np.where(follows[:, None], np.roll(memory, -1, axis=0), new)
    was, now = (np.hstack(parts).view(np.int64) for parts in ((outputs, after), (computed, new)))
    differs = was != now
    found: dict[str, Any] = {}
    if differs.any():
        k, i = (int(x) for x in np.argwhere(differs)[0])
        fields = [
            *made.outputs.fields,
            *(dataclasses.replace(f, offset=f.offset + made.outputs.size) for f in made.memory.fields),
        ]
        field = next(f for f in fields if f.offset <= i < f.offset + f.size)
        found = {
            "first": k,
            "column": field.path,
            "recorded": was.view(np.float64)[k, i],
            "computed": now.view(np.float64)[k, i],
        }
    changed = {name: version for name, version in run.info.versions.items() if versions().get(name) != version}
    return Replay(ticks=len(run), identical=int((~differs.any(axis=1)).sum()), changed=changed, **found)


def require_servo(run: Run) -> ServoInfo:
    """What a robot's record states of its compiled tick; UsageError for another run."""
    if run.info.servo is None:
        raise UsageError(
            "replay takes the record of a robot, from taut.connect; this run is of another kind", name="run"
        )
    return run.info.servo


def _blocks(run: Run, made: ServoSet) -> list[Float64Array]:
    """(k, size) each: inputs, parameters, memory and outputs of every tick."""
    known = {**run.extra, **run.arrays(), **{f"terms.{name}": x for name, x in run.terms.items()}}
    out = []
    for block, prefix in (
        (made.inputs, ""),
        (made.parameters, "parameters."),
        (made.memory, "memory."),
        (made.outputs, ""),
    ):
        parts = [np.asarray(known[prefix + field.path]).reshape(len(run), -1) for field in block.fields]
        out.append(np.ascontiguousarray(np.hstack(parts)))
    return out
