"""The command about robots, bringup, and the connection that run shares with it: its end lets no arm fall unasked."""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from taut.base.errors import TautError, UsageError
from taut.cli.command import DONE, FAILED, OF_SCENARIO, STATUS, Answer, Command, Say, scenario_of

if TYPE_CHECKING:
    from taut.runtime.realtime.robot import Robot

SUPPORT: Final = "the end of this command disables the motors, and the arm falls (Ctrl-C: at once): is it supported"


def _require_terminal(what: str) -> None:
    if not sys.stdin.isatty():
        raise UsageError(
            f"{what}; use a terminal, or --yes where the robot's space is clear and an arm that falls without its "
            "motors is supported"
        )


def _asked(question: str) -> bool:
    """Answer of a person."""
    _require_terminal(f"nobody answers '{question}?'")
    print(f"{question}? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


@contextlib.contextmanager
def connected(robot: Robot, *, yes: bool) -> Iterator[None]:
    """The connection of a command to a robot. Whatever ends it, motors that hold an arm are disabled after a yes."""
    from taut.runtime.realtime.shared import uninterrupted

    asks = not (robot.info.holds or yes)
    with robot:
        if asks:
            _require_terminal(f"before it disables the motors of {robot.info.name}, this command asks for support")
        try:
            yield
        finally:
            if asks:
                with contextlib.suppress(TautError), uninterrupted():
                    robot.stop()
                while _enabled(robot) and not _asked(SUPPORT):
                    pass


def _enabled(robot: Robot) -> bool:
    """Whether motors hold the arm that this command can disable; also where a driver does not know."""
    try:
        return robot.call("enabled") is not False
    except TautError:
        return robot.link.alive


def _bringup(arguments: argparse.Namespace, say: Say) -> Answer:
    from taut.arm.load import load_arm
    from taut.runtime.realtime.bringup import bring_up, remember
    from taut.runtime.realtime.connect import connect, hello_of
    from taut.scenarios.on_robot import controller_for, robot_named, start_of

    if (arguments.arm is None) == (arguments.scenario is None):
        raise UsageError(
            "bringup takes the robot's model: --arm ARM, or --scenario SCENARIO, whose law runs in shadow"
        )
    if arguments.arm is not None and (arguments.set or arguments.law or arguments.gain):
        raise UsageError("--set, --law and --gain change a scenario: give --scenario SCENARIO in place of --arm")
    if not arguments.yes:
        _require_terminal("bringup asks before each step")
    scenario = None if arguments.scenario is None else scenario_of(arguments)
    arm = load_arm(arguments.arm) if scenario is None else scenario.experiment.arm
    given = robot_named(arguments.robot, arm)
    hello, file = hello_of(arm=arm, **given), None
    robot = connect(arm=arm, **given)
    with connected(robot, yes=arguments.yes):
        ctrl, start = None, None
        if scenario is not None:
            ctrl = controller_for(robot, scenario.experiment, scenario.laws[scenario.shown.law])
            start = start_of(scenario.experiment)
        ask = (lambda _: True) if arguments.yes else _asked
        done = bring_up(robot, ctrl, start=start, ask=ask, say=say)
        if done.passed:
            file = remember(hello, arm)
    text = str(done) if file is None else f"{done}\nkept in {file}: taut run SCENARIO --robot {arguments.robot}"
    return Answer(text=text, data={**done.json(), "passed": done.passed}, status=DONE if done.passed else FAILED)


BRINGUP: Final = Command(
    name="bringup",
    help="Compare a robot with its model, test its joints and move it slowly, before a law acts on it.",
    run=_bringup,
    arguments={
        "robot": {"metavar": "ROBOT", "help": "an address such as franka://172.16.0.2, or a robot file (.toml)"},
        "--arm": {"metavar": "ARM", "help": "the robot's model: a name or a file"},
        "--scenario": {"metavar": "SCENARIO", "help": "its arm, load and start; its law runs in shadow"},
        **OF_SCENARIO,
        "--yes": {
            "action": "store_true",
            "help": "take every step without a question; the space must be clear, and the arm supported at the end",
        },
    },
    more=f"""examples:
  taut bringup franka://172.16.0.2 --arm fr3
  taut bringup my_arm.toml --scenario reach.toml --set arm.payload.mass=0.5

A robot file has the arguments of taut.connect: robot = "can://can0", or "my_driver.py:Class" with its address, and
the tables [motors], [options] and [limits]. Only the test of signs and the slow motions send anything; before them,
motors on CAN are enabled and hold the arm by themselves. The end of the command disables them, and an arm without
brakes falls: it asks until the arm is supported. What has passed is kept for this robot, model and load, and
`taut run SCENARIO --robot ROBOT` asks for it.

{STATUS}""",
)
