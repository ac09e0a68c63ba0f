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
    from taut.runtime.realtime.connect import connect
    from taut.scenarios.on_robot import controller_for, start_of
    from taut.scenarios.scenario import load_scenario

    if (arguments.arm is None) == (arguments.scenario is None):
        raise UsageError(
            "bringup takes the robot's model: --arm ARM, or --scenario SCENARIO, whose law runs in shadow"
        )
    scenario = None if arguments.scenario is None else load_scenario(arguments.scenario)
    arm = load_arm(arguments.arm) if scenario is None else scenario.experiment.arm
    with connect(arguments.address, arm) as robot:
        ctrl, ref, start = None, None, None
        if scenario is not None:
            ctrl = controller_for(robot, scenario.experiment, scenario.laws[scenario.shown.law])
            start = start_of(scenario.experiment)
        ask = (lambda _: True) if arguments.yes else _asked
        done = bring_up(robot, ctrl, ref, start=start, ask=ask, say=say)
    file = remember(arguments.address, arm) if done.passed else None
    text = str(done) if file is None else f"{done}\nkept in {file}: taut run SCENARIO --robot {arguments.address}"
    return Answer(text=text, data={**done.json(), "passed": done.passed}, status=DONE if done.passed else FAILED)


BRINGUP: Final = Command(
    name="bringup",
    help="Compare a robot with its model, test its joints and move it slowly, before a law acts on it.",
    run=_bringup,
    arguments={
        "address": {"metavar": "ADDRESS", "help": "such as franka://172.16.0.2"},
        "--arm": {"metavar": "ARM", "help": "the robot's model: a name or a file"},
        "--scenario": {"metavar": "SCENARIO", "help": "its arm, load and start; its law runs in shadow"},
        "--yes": {"action": "store_true", "help": "take every step without a question; the space must be clear"},
    },
    more=f"""example:
  taut bringup franka://172.16.0.2 --arm fr3

Only the test of signs and the slow motions send anything. What has passed is kept for this address, model and load,
and `taut run SCENARIO --robot ADDRESS` asks for it.

{STATUS}""",
)
