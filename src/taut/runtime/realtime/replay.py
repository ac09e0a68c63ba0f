"""Replay: the ticks of a robot's record, computed again from their own inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taut.base.checks import instance_of
from taut.base.errors import MatchError, TautError, UsageError, count_of
from taut.base.result import Content, Result, plain
from taut.base.types import Float64Array
from taut.codegen import native
from taut.codegen.engine import machine_code
from taut.codegen.program import Block
from taut.codegen.servo_loop import FUNCTIONS
from taut.control.safety import SafeSide, SafetyLimits
from taut.controller import Controller
from taut.record.info import ServoInfo
from taut.record.run import Run
from taut.runtime.realtime.sets import ServoSet


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay(Result):
    """The ticks of a record of a robot, computed again.

    Args:
        ticks: Of the record.
        identical: Ticks of which every output, and the memory that the next tick began with, are the same to the
            last bit.
        first: The first tick that is not, or None; with the column, and its number in the record and now.
    """

    ticks: int
    identical: int
    first: tuple[int, str, float, float] | None = None

    @property
    def ok(self) -> bool:
        """Whether every tick is the same."""
        return self.identical == self.ticks

    @property
    def percent(self) -> float:
        """Ticks that are the same [%]."""
        return 100.0 * self.identical / max(self.ticks, 1)

    def json(self) -> dict[str, Any]:
        first = None if self.first is None else [plain(cell) for cell in self.first]
        return {"ticks": self.ticks, "identical": self.identical, "percent": self.percent, "first": first}

    def content(self) -> Content:
        found = f"{self.identical} of {count_of(self.ticks, 'tick')} are bit-identical: {self.percent:.6g} %"
        faults = []
        if self.first is not None:
            tick, column, recorded, computed = self.first
            faults.append(f"tick {tick} differs first: {column} was {recorded!r}, and is {computed!r}")
        return Content(title="replay", summary=[found], faults=faults)


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
    known = {**run.extra, **run.arrays()}
    made = _same(run, ctrl, known)
    inputs, parameters, memory, outputs = (_packed(known, block, prefix) for block, prefix in made.row)
    new, computed = np.zeros_like(memory), np.zeros_like(outputs)
    code = native.link(made.code, FUNCTIONS)
    tick = machine_code(code["kernel"])
    for k in range(len(run)):
        tick(inputs[k], parameters[k], memory[k], new[k], computed[k])
    follows = np.append(np.diff(known["loop.tick"]) == 1.0, False)  # else the next row begins elsewhere
    after = np.where(follows[:, None], np.roll(memory, -1, axis=0), new)
    was, now = np.hstack((outputs, after)), np.hstack((computed, new))
    differs = was.view(np.int64) != now.view(np.int64)  # also of NaN
    first = None
    if differs.any():
        k, i = (int(x) for x in np.argwhere(differs)[0])
        names = [prefix + f.path for block, prefix in made.row[:1:-1] for f in block.fields for _ in range(f.size)]
        first = k, names[i], float(was[k, i]), float(now[k, i])
    return Replay(ticks=len(run), identical=int((~differs.any(axis=1)).sum()), first=first)


def require_servo(run: Run) -> ServoInfo:
    """What a robot's record states of its compiled tick; UsageError for another run."""
    if run.info.servo is None:
        raise UsageError("replay takes the record of a robot; this run is of another kind", name="run")
    return run.info.servo


def _same(run: Run, ctrl: Controller, known: Mapping[str, Float64Array]) -> ServoSet:
    """The compiled tick of a controller, which is that of the record. Raises MatchError."""
    servo = require_servo(run)
    try:
        safe = SafeSide(
            side=ctrl.side, limits=SafetyLimits(**servo.limits), measures=servo.measures, at_rest=servo.at_rest,
            torque_rate=servo.torque_rate,
        )  # fmt: skip
        safe.check()
        made = ServoSet(safe)
        shapes = {f"{prefix}{field.path}": field.shape for block, prefix in made.row for field in block.fields}
        same = made.digest.hex() == servo.digest and "loop.tick" in known
        if same and all(path in known and known[path].shape[1:] == shape for path, shape in shapes.items()):
            return made
    except TautError:  # limits, sensing or a program that do not go together
        pass
    raise MatchError(
        f"the record is not of this controller: it was made with {run.info.law} on arm '{run.info.arm}' at "
        f"{run.rate:g} Hz, {run.info.sensing}, limits {run.info.command_limits}; compile that law again, with the "
        "same arm",
        name="ctrl",
    )


def _packed(known: Mapping[str, Float64Array], block: Block, prefix: str) -> Float64Array:
    """(k, size) a block in every tick."""
    parts = [known[f"{prefix}{field.path}"] for field in block.fields]
    return np.ascontiguousarray(np.hstack([part.reshape(len(part), -1) for part in parts]))
