"""A scenario on a robot, in place of its plant: after a bring-up, from the scenario's start, for its duration."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.analysis.comparison import Experiment
from taut.arm.description import Arm
from taut.base.errors import FileError, UsageError
from taut.base.types import Float64Array
from taut.control.law import Law
from taut.control.tasks.task import Task
from taut.controller import Controller, compile
from taut.loop import state_at_start
from taut.record.log.reading import MAGIC, load_run
from taut.record.run import Run
from taut.runtime.realtime.bringup import SPEED, passed_before
from taut.runtime.realtime.connect import connect
from taut.runtime.realtime.robot import LOOK, Robot
from taut.scenarios.scenario import Scenario

LOGGED: Final = 10.0  # [s] for a log to be whole, once its law has stopped


def robot_of(scenario: Scenario, address: str, log: Path) -> Robot:
    """The robot at an address, connected, with a folder of logs, for a scenario whose arm has passed a bring-up.

    Raises:
        UsageError: No bring-up has passed for this address, Arm and load; or the scenario needs its plant.
    """
    arm = scenario.experiment.arm
    if scenario.cases:
        raise UsageError(f"scenario '{scenario.name}' has cases, which differ in their plants; a robot is one plant")
    if not passed_before(address, arm):
        raise UsageError(
            f"no bring-up has passed for {address} with arm '{arm.name}' and its load of {arm.payload.mass:g} kg; "
            f"nothing was sent; taut bringup {address} --scenario {scenario.name}",
            name="robot",
        )
    if scenario.experiment.preparation is not None:
        raise UsageError(f"scenario '{scenario.name}' prepares its runs on its plant, which a robot cannot do")
    return connect(address, arm, log=log)


def controller_for(robot: Robot, experiment: Experiment, law: Law | Task) -> Controller:
    """The law of a scenario, compiled for a robot: what the robot adds itself is left out."""
    return compile(
        law, experiment.arm, rate=robot.rate, sensing=experiment.sensing, limits=experiment.limits, adds=robot.adds
    )


def start_of(experiment: Experiment) -> Float64Array:
    """(n,) where the arm stands at the start of a scenario [rad | m]."""
    q, v = state_at_start(experiment.plant.arm, experiment.q0, experiment.v0)
    if np.any(v):
        raise UsageError("the scenario starts in motion, and a robot starts at rest; leave run.v0 out", name="v0")
    return q


def run_on_robot(robot: Robot, experiment: Experiment, law: Law | Task, log: Path) -> Run:
    """Move slowly to the start of a scenario, let the law act for its duration, and stop: its log, read again."""
    ctrl = controller_for(robot, experiment, law)
    events = sorted(experiment.events, key=lambda event: event.t)
    for event in events:
        _check(ctrl, event.set, experiment.arm)
    robot.move_to(start_of(experiment), speed=SPEED)
    others = set(log.iterdir())
    robot.start(ctrl, None if ctrl.side.task is not None else experiment.reference, duration=experiment.duration)
    begun = time.monotonic()
    for event in events:
        robot.wait(max(0.0, begun + event.t - time.monotonic()))
        for path, value in event.set.items():
            robot.parameters[path] = value
    robot.wait(max(0.0, begun + experiment.duration - time.monotonic()))
    robot.stop()
    return _logged(log, others).between(0.0, experiment.duration)


def _logged(log: Path, others: set[Path]) -> Run:
    """The law's file among those that have come, as soon as it is whole; the holder's has another name."""
    until = time.monotonic() + LOGGED
    while time.monotonic() < until:
        files = sorted(file for file in set(log.iterdir()) - others if not file.stem.endswith("-hold"))
        if files and files[0].read_bytes().endswith(MAGIC):
            return load_run(files[0])
        time.sleep(LOOK)
    raise FileError(f"the log of the run is not whole after {LOGGED:g} s; what there is, is in {log}", name=str(log))


def _check(ctrl: Controller, values: Mapping[str, Any], arm: Arm) -> None:
    for path, value in values.items():
        if path not in ctrl.parameters:
            raise UsageError(
                f"the event sets {path}, which is of the plant; a robot with arm '{arm.name}' has none", name=path
            )
        ctrl.side.checked_parameter(path, value)
