"""The command that sweeps a scenario: many runs of one of its laws over ranges of its parameters."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import UsageError
from taut.cli.command import DONE, FAILED, GAIN, STATUS, Answer, ByName, Command, Say, numbers, words_again
from taut.cli.run import LAW_OF_SCENARIO, scenario_with_law

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

    out: dict[str, Distribution] = {}
    for path, low, high in ranges:
        if path in out:
            raise UsageError(f"--vary must be given once for each path; got {path!r} twice", name="vary")
        out[path] = choice(low if isinstance(low, list) else [low]) if high is None else uniform(low, high)
    return out


def _count(text: str) -> int:
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if not number.is_integer() or number < 1.0:
        raise argparse.ArgumentTypeError(f"must be a whole number, such as 10000 or 1e4; got {text!r}")
    return int(number)


def _sweep(arguments: argparse.Namespace, say: Say) -> Answer:
    from taut.control.law import Law
    from taut.scenarios.sweep import ScenarioSweep, sweep_scenario, written

    scenario, name = scenario_with_law(arguments, arguments.set)
    found = sweep_scenario(
        scenario, name, _varied(arguments.vary or ()), samples=arguments.samples, seed=arguments.seed,
        metrics=arguments.metric, out=arguments.out, workers=arguments.workers, ray=arguments.ray,
        progress=False if arguments.json else None,
    )  # fmt: skip
    made = ScenarioSweep(found=found, outputs={}, skipped={})
    if arguments.out is not None:
        say(f"writing to {arguments.out} ...")
        law = scenario.laws[name]
        own = {name: law} if ":" in name and isinstance(law, Law) else None
        more = f" {words_again(arguments, 'law', 'gain')}" if own else ""
        made = written(scenario, name, found, arguments.out, own=own, more=more)
    data = {"scenario": scenario.name, "law": name, **made.json()}
    return Answer(text=str(made), data=data, status=DONE if found.complete else FAILED)


SWEEP: Final = Command(
    name="sweep",
    help="Run a scenario many times over ranges of its parameters: success, percentiles, what matters, the worst.",
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
        "--law": LAW_OF_SCENARIO,
        "--gain": GAIN,
        "--metric": {"action": "append", "metavar": "NAME", "help": "what is computed of each run; once for each"},
        "--out": {
            "type": Path,
            "metavar": "DIR",
            "help": "folder for samples (Parquet), pictures, a report, the worst case; an interrupted sweep goes on",
        },
        "--ray": {
            "metavar": "ADDRESS",
            "help": "a Ray cluster: HOST:PORT, or auto for the one of this machine",
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
  taut run out/sweep/worst.toml

A run succeeds that comes to its end and meets the scenario's pass criteria of the law.

{STATUS}""",
)
