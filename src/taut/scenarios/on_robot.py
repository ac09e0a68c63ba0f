"""A scenario on a robot, in place of its plant: after a bring-up, from the scenario's start, for its duration.

A robot of the command line is what `taut.connect` takes as a text, or a robot file: TOML with connect's arguments.
"""

from __future__ import annotations

import shlex
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.analysis.comparison import Experiment
from taut.arm.description import Arm
from taut.base.errors import FileError, TautError, UsageError
from taut.base.fields import Declared, Part, Plain
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.safety import SafetyLimits
from taut.control.tasks.task import Task
from taut.controller import Controller, compile
from taut.loop import state_at_start
from taut.record.log.reading import MAGIC, load_run
from taut.record.run import HALF, Run
from taut.runtime.events import Event
from taut.runtime.realtime.bringup import SPEED, passed_before
from taut.runtime.realtime.connect import connect, hello_of
from taut.runtime.realtime.robot import LOOK, Robot, require_stable
from taut.runtime.realtime.shared import uninterrupted
from taut.runtime.realtime.status import RobotError
from taut.runtime.robots.can import CanMotors
from taut.scenarios.reading import read, read_toml
from taut.scenarios.scenario import Scenario

TICK: Final = "loop.tick"  # column of a robot's record: number of the tick since it was connected
LOGGED: Final = 10.0  # [s] for a log to be whole, once its law has stopped


class RobotFile(Declared):
    """A robot file: arguments of `taut.connect`."""

    robot: Plain[str] = Plain(str)  # an address, or a driver of your own: "FILE.py:CLASS"
    address: Plain[str | None] = Plain(str, optional=True)  # given to a driver of your own
    motors: Part[CanMotors] = Part(CanMotors, optional=True)
    limits: Part[SafetyLimits] = Part(SafetyLimits, optional=True)  # the arm's where they are left out
    options: Plain[dict[str, Any] | None] = Plain(dict, optional=True)


def robot_named(words: str, arm: Arm) -> dict[str, Any]:
    """Arguments of `hello_of` and `taut.connect` for a robot of the command line: of a robot file, or an address.

    Raises:
        ScenarioError, FileError: Of the robot file.
    """
    if not words.endswith(".toml"):
        return {"robot": words}
    table = read_toml(words, f"robot file '{words}'", "robot file")
    file: RobotFile = read(RobotFile, table)
    given = {name: getattr(file, name) for name in file.specified}
    if ".py:" in file.robot:
        given["robot"] = str(table.folder / file.robot)
    if file.limits is not None:
        stated = {name: getattr(file.limits, name) for name in table.table("limits").values}
        given["limits"] = SafetyLimits.of(arm, **stated)
    return given


def robot_of(scenario: Scenario, again: str, words: str, log: Path) -> Robot:
    """The robot of the command line, connected, with a folder of logs: the scenario's arm has passed a bring-up.

    Raises:
        UsageError: No bring-up has passed for this robot, arm and load, and `again` are the words for it behind
            `taut bringup ROBOT`; or the scenario needs its plant.
    """
    arm = scenario.experiment.arm
    given = robot_named(words, arm)
    hello = hello_of(arm=arm, **given)
    if scenario.cases:
        raise UsageError(f"scenario '{scenario.name}' has cases, which differ in their plants; a robot is one plant")
    if not passed_before(hello, arm):
        raise UsageError(
            f"no bring-up has passed for {words} with arm '{arm.name}' and its load of {arm.payload.mass:g} kg; "
            f"nothing was sent; taut bringup {shlex.quote(words)} {again}",
            name="robot",
        )
    if scenario.experiment.preparation is not None:
        raise UsageError(f"scenario '{scenario.name}' prepares its runs on its plant, which a robot cannot do")
    return connect(arm=arm, log=log, **given)


def controller_for(robot: Robot, experiment: Experiment, law: Law | Task) -> Controller:
    """The law of a scenario, compiled for a robot: with the parameters of events at t = 0, without what it adds."""
    ctrl = compile(
        law, experiment.arm, rate=robot.rate, sensing=experiment.sensing, limits=experiment.limits, adds=robot.adds
    )
    for event in experiment.events:
        for path, value in event.set.items():
            if path not in ctrl.parameters:
                arm = experiment.arm.name
                raise UsageError(
                    f"the event sets {path}, which is of the plant; a robot with arm '{arm}' has none", name=path
                )
            if event.t == 0.0:
                ctrl.parameters[path] = value
    return ctrl


def ready_for(robot: Robot, experiment: Experiment, law: Law | Task) -> Controller:
    """Likewise, where the robot takes it at the start of the scenario, with its reference and all its events."""
    ctrl, q = controller_for(robot, experiment, law), start_of(experiment)
    robot.require(ctrl, _reference(experiment, ctrl), duration=experiment.duration, q=q)
    values = dict(ctrl.parameters)
    for event in _later(experiment):
        new = {path: ctrl.side.checked_parameter(path, value) for path, value in event.set.items()}
        ctrl.side.check_change(q, values, new)
        values |= new
        require_stable(ctrl, robot.plant, q, values)
    return ctrl


def _later(experiment: Experiment) -> list[Event]:
    """Its events in the order of time, without those at its start."""
    return sorted((event for event in experiment.events if event.t > 0.0), key=lambda event: event.t)


def _reference(experiment: Experiment, ctrl: Controller) -> object:
    return None if ctrl.side.task is not None else experiment.reference


def start_of(experiment: Experiment) -> Float64Array:
    """(n,) where the arm stands at the start of a scenario [rad | m]."""
    q, v = state_at_start(experiment.plant.arm, experiment.q0, experiment.v0)
    if np.any(v):
        raise UsageError("the scenario starts in motion, and a robot starts at rest; leave run.v0 out", name="v0")
    return q


def run_on_robot(robot: Robot, experiment: Experiment, ctrl: Controller, log: Path) -> tuple[Run, Path]:
    """Move slowly to the start of a scenario, let a law act for its duration, and stop: its log, read, and the file.

    A fault ends the run, and is its outcome. One before the law acts is raised.
    """
    others, error = set(log.iterdir()), None
    try:
        robot.move_to(start_of(experiment), speed=SPEED)
        robot.start(ctrl, _reference(experiment, ctrl), duration=experiment.duration)
        begun = time.monotonic()
        try:
            for event in _later(experiment):
                robot.wait(max(0.0, begun + event.t - time.monotonic()))
                robot.parameters.update(event.set)
            robot.wait(max(0.0, begun + experiment.duration - time.monotonic()))
        except TautError as cause:
            error = cause
        sent = robot.stop()
    except KeyboardInterrupt:
        with uninterrupted():
            robot.stop()
            files = sorted(set(log.iterdir()) - others)
        raise KeyboardInterrupt(*[f"what was logged until then is in {file}" for file in files[-1:]]) from None
    ticks = sent.extra[TICK][sent.extra["loop.sent"] > 0.5]
    if error is not None and not len(ticks):
        raise error
    run, file = _logged(log, others, ticks[-1])
    count = int(np.searchsorted(run.t, experiment.duration + HALF))
    if isinstance(error, RobotError):
        count = min(count, int(np.searchsorted(run.extra[TICK], error.fault.tick, "right")))
    outcome = run.outcome
    if error is not None and str(error) not in outcome.message:  # the log has no words of a driver
        outcome = replace(outcome, kind="stopped", message=str(error), joint=error.joint)
    return replace(run.ticks(slice(count)), outcome=replace(outcome, tick=count - 1)), file


def _logged(log: Path, others: set[Path], last: float) -> tuple[Run, Path]:
    """The file that has the last tick, among those that have come, as soon as it is whole."""
    until = time.monotonic() + LOGGED
    while time.monotonic() < until:
        for file in sorted(set(log.iterdir()) - others, reverse=True):
            if file.read_bytes().endswith(MAGIC) and (run := load_run(file)).extra[TICK][-1] >= last:
                return run, file
        time.sleep(LOOK)
    raise FileError(f"the log of the run is not whole after {LOGGED:g} s; what there is, is in {log}", name=str(log))
