"""Replay: the ticks of a robot's record, computed again from their own inputs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.base.checks import instance_of
from taut.base.errors import MatchError, TautError, UsageError, count_of
from taut.base.result import Content, Result
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.engine import machine_code
from taut.codegen.program import Block
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
    other = MatchError(
        f"the record is not of this controller: it was made with {run.info.law} on arm '{run.info.arm}' at "
        f"{run.rate:g} Hz, {run.info.sensing}, limits {run.info.command_limits}; compile that law again, with the "
        "same arm",
        name="ctrl",
    )
    try:
        safe = SafeSide(side=ctrl.side, limits=SafetyLimits(**servo.limits), measures=servo.measures)
        safe.check()
        made = ServoSet(safe, dict(ctrl.parameters))
    except TautError as cause:
        raise other from cause
    known = {**run.extra, **run.arrays(), **{f"terms.{name}": x for name, x in run.terms.items()}}
    shapes = {f"{prefix}{field.path}": field.shape for block, prefix in made.row for field in block.fields}
    there = all(known[path].shape[1:] == shape for path, shape in shapes.items() if path in known)
    if made.digest.hex() != servo.digest or not {*shapes, "loop.tick"} <= known.keys() or not there:
        raise other
    inputs, parameters, memory, outputs = (_packed(known, block, prefix) for block, prefix in made.row)
    new, computed = np.zeros_like(memory), np.zeros_like(outputs)
    code = native.link(made.code, FUNCTIONS)
    tick = machine_code(code["kernel"])
    for k in range(len(run)):
        tick(inputs[k], parameters[k], memory[k], new[k], computed[k])
    follows = np.append(np.diff(run.extra["loop.tick"]) == 1.0, False)  # else the next row begins elsewhere
    after = np.where(follows[:, None], np.roll(memory, -1, axis=0), new)
    was, now = (np.hstack(parts).view(np.int64) for parts in ((outputs, after), (computed, new)))  # also of NaN
    differs = was != now
    found: dict[str, Any] = {}
    if differs.any():
        k, i = (int(x) for x in np.argwhere(differs)[0])
        names = [prefix + f.path for block, prefix in made.row[:1:-1] for f in block.fields for _ in range(f.size)]
        values = {"recorded": was, "computed": now}
        found = {name: float(array.view(np.float64)[k, i]) for name, array in values.items()}
        found |= {"first": k, "column": names[i]}
    changed = {name: version for name, version in run.info.versions.items() if versions().get(name) != version}
    return Replay(ticks=len(run), identical=int((~differs.any(axis=1)).sum()), changed=changed, **found)


def require_servo(run: Run) -> ServoInfo:
    """What a robot's record states of its compiled tick; UsageError for another run."""
    if run.info.servo is None:
        raise UsageError(
            "replay takes the record of a robot, from taut.connect; this run is of another kind", name="run"
        )
    return run.info.servo


def _packed(known: Mapping[str, Float64Array], block: Block, prefix: str) -> Float64Array:
    """(k, size) a block in every tick."""
    parts = [known[f"{prefix}{field.path}"] for field in block.fields]
    return np.ascontiguousarray(np.hstack([part.reshape(len(part), -1) for part in parts]))
