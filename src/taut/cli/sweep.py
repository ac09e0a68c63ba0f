"""The command that sweeps a scenario: many runs of one of its laws over ranges of its parameters."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import UsageError
from taut.cli.command import DONE, FAILED, GAIN, STATUS, Answer, ByName, Command, Say, numbers
from taut.cli.run import scenario_with_law

if TYPE_CHECKING:
    from taut.analysis.sweeps.distributions import Distribution


Range = tuple[str, Any, Any]


def _range(text: str) -> Range:
    """PATH=LOW:HIGH, or PATH=A,B,C, whose last is None."""
    path, equals, rest = text.partition("=")
    low, colon, high = rest.partition(":")
    if not equals or not path:
        raise argparse.ArgumentTypeError(f"must be PATH=LOW:HIGH, or PATH=A,B,C for a choice; got {text!r}")
    return path, numbers(low), numbers(high) if colon else None


def _varied(ranges: Sequence[Range]) -> dict[str, Distribution]:
    from taut.analysis.sweeps.distributions import choice, uniform

    return {
        path: choice(low if isinstance(low, list) else [low]) if high is None else uniform(low, high)
        for path, low, high in ranges
    }


def _count(text: str) -> int:
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not number.is_integer() or number < 1.0:
        raise argparse.ArgumentTypeError(f"must be a whole number, such as 10000 or 1e4; got {text!r}")
    return int(number)


def _sweep(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.analysis.sweeps.sweep import sweep
    from taut.loop import Loop, ModelPlant

    scenario, name = scenario_with_law(arguments, arguments.set)
    law, where = scenario.laws[name], scenario.experiment.prepared(scenario.laws[name])
    if where.events:
        raise UsageError(f"scenario '{scenario.name}' has events, which a sweep does not have; use another scenario")
    ctrl, plant, known = where.controller(law), where.plant, dict(where.parameters)
    given: dict[str, Any] = {"plant": plant, "ref": where.reference, "duration": where.duration}
    if ctrl.side.task is not None:
        del given["ref"]
    subject: Any = ctrl
    if isinstance(plant, ModelPlant):
        subject, given = Loop(ctrl, plant, given.get("ref"), duration=where.duration), {}
        for path, value in known.items():
            subject.parameters[path] = value
    else:
        for path in known.keys() & set(ctrl.parameters):
            ctrl.parameters[path] = known.pop(path)
        plant.set_parameters(known)
    found = sweep(
        subject, _varied(arguments.vary or ()), **given, samples=arguments.samples, seed=arguments.seed, q0=where.q0,
        v0=where.v0, metrics=arguments.metric, out=arguments.out, workers=arguments.workers,
        progress=False if arguments.json else None,
    )  # fmt: skip
    data = {"scenario": scenario.name, "law": name, "samples": found.samples, "complete": found.complete}
    text = str(found) if arguments.out is None else f"{found}\nsamples  {arguments.out}"
    return Answer(text=text, data={**data, **found.json()}, status=DONE if found.complete else FAILED)


SWEEP: Final = Command(
    name="sweep",
    help="Run a scenario many times over ranges of its parameters, and print percentiles of its metrics.",
    run=_sweep,
    arguments={
        "scenario": {"metavar": "SCENARIO", "help": "a name that `taut scenarios` lists, or a path"},
        "--vary": {
            "action": "append",
            "type": _range,
            "metavar": "PATH=LOW:HIGH",
            "help": "a parameter and its range, or a choice as PATH=A,B,C; once for each",
        },
        "--samples": {"type": _count, "default": 1000, "metavar": "N", "help": "number of runs (default: 1000)"},
        "--seed": {"type": int, "default": 0, "metavar": "N", "help": "of all that is drawn (default: 0)"},
        "--law": {"metavar": "NAME", "help": "one of its laws, or a law of your own: FILE.py:CLASS"},
        "--gain": GAIN,
        "--metric": {"action": "append", "metavar": "NAME", "help": "what is computed of each run; once for each"},
        "--out": {
            "type": Path,
            "metavar": "DIR",
            "help": "a Parquet file for each chunk; an interrupted sweep goes on",
        },
        "--workers": {"type": int, "metavar": "N", "help": "threads or processes (default: the number of cores)"},
        "--set": {
            "action": ByName,
            "metavar": "PATH=VALUE",
            "help": "another value of a key of the scenario, or of a parameter, by its path",
        },
    },
    more=f"""examples:
  taut sweep one_joint_pid --law PD --vary law.kp=1:9 --vary plant.payload.mass=0:0.5 --samples 1e5
  taut sweep panda_robust --law robust --vary plant.payload.mass=0:3 --out out/sweep

{STATUS}""",
)
