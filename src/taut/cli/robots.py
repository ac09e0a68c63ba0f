"""The command about robots: bringup."""

from __future__ import annotations

import argparse
import sys
from typing import Final

from taut.base.errors import UsageError
from taut.cli.command import DONE, FAILED, STATUS, Answer, Command, Say


def _asked(question: str) -> bool:
    """What a person answers, at a terminal."""
    if not sys.stdin.isatty():
        raise UsageError("bringup asks before each step; use a terminal, or --yes where the robot's space is clear")
    print(f"{question}? [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _bringup(arguments: argparse.Namespace, say: Say) -> Answer:
    from taut.arm.load import load_arm
    from taut.runtime.realtime.bringup import bring_up, remember
    from taut.runtime.realtime.connect import connect, hello_of
    from taut.scenarios.on_robot import controller_for, robot_named, start_of
    from taut.scenarios.scenario import load_scenario

    if (arguments.arm is None) == (arguments.scenario is None):
        raise UsageError(
            "bringup takes the robot's model: --arm ARM, or --scenario SCENARIO, whose law runs in shadow"
        )
    scenario = None if arguments.scenario is None else load_scenario(arguments.scenario)
    arm = load_arm(arguments.arm) if scenario is None else scenario.experiment.arm
    given = robot_named(arguments.robot, arm)
    hello = hello_of(arm=arm, **given)
    with connect(arm=arm, **given) as robot:
        ctrl, ref, start = None, None, None
        if scenario is not None:
            ctrl = controller_for(robot, scenario.experiment, scenario.laws[scenario.shown.law])
            start = start_of(scenario.experiment)
        ask = (lambda _: True) if arguments.yes else _asked
        done = bring_up(robot, ctrl, ref, start=start, ask=ask, say=say)
        if not robot.info.holds:
            ask("support the arm: the end of the command disables its motors. Is it supported")
    file = remember(hello, arm) if done.passed else None
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
        "--yes": {"action": "store_true", "help": "take every step without a question; the space must be clear"},
    },
    more=f"""examples:
  taut bringup franka://172.16.0.2 --arm fr3
  taut bringup my_arm.toml --scenario reach.toml

A robot file has the arguments of taut.connect: robot = "can://can0", or "my_driver.py:Class" with its address, and
the tables [motors], [options] and [limits]. Only the test of signs and the slow motions send anything; before them,
motors on CAN are enabled and hold the arm by themselves, and the end of the command disables them. What has passed is
kept for this robot, model and load, and `taut run SCENARIO --robot ROBOT` asks for it.

{STATUS}""",
)
