"""The commands `taut run` and `taut scenarios`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from taut.base.errors import UsageError
from taut.base.result import Table
from taut.cli.command import DONE, ENGINES, FAILED, STATUS, Answer, Command, Say
from taut.cli.values import load_law, named_values

__all__ = ["RUN", "SCENARIOS"]

EXAMPLES: Final = f"""examples:
  taut run one_joint_pid
  taut run my_scenario.toml --out results
  taut run one_joint_pid --set laws.PD.kp=5 --set run.duration=2
  taut run one_joint_pid --law my_law.py:Spring --gain k=2.0

The metrics are printed as a table; below it stands each file that was made.

{STATUS}"""


def _run_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("scenario", metavar="SCENARIO", help="a name that `taut scenarios` lists, or a path")
    command.add_argument("--out", type=Path, metavar="DIR", help="folder for the files (default: out/SCENARIO)")
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="another value of a key, by its path in the file, or of a parameter: law.kp=5; once for each",
    )
    command.add_argument(
        "--law",
        metavar="FILE.py:CLASS",
        help="a law of your own instead of the scenario's laws, whose pass figures then do not count",
    )
    command.add_argument(
        "--gain",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a gain of that law, such as kp=100 or kp=[100,50]; once for each gain",
    )
    command.add_argument(
        "--engine",
        choices=ENGINES,
        default="auto",
        help="native: machine code; float: plain Python, slow; auto: the first that is there (default)",
    )


def _run(arguments: argparse.Namespace, say: Say) -> Answer:
    from taut.scenarios.run import run_scenario
    from taut.scenarios.scenario import load_scenario

    if arguments.gain and arguments.law is None:
        raise UsageError("--gain is for a law of your own: --law FILE.py:CLASS --gain kp=100")
    own = None if arguments.law is None else {arguments.law: load_law(arguments.law, arguments.gain)}
    values = named_values(arguments.set, "--set", "law.kp=5", of="path", words=True)
    scenario = load_scenario(arguments.scenario, own, values=values)
    folder = arguments.out or Path("out") / scenario.name
    result = run_scenario(scenario, folder, say=say, engine=arguments.engine)
    return Answer(text=str(result), data=result.json(), status=DONE if result.ok else FAILED)


def _scenarios_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("name", nargs="?", metavar="NAME", help="print the file of this one")


def _scenarios(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.scenarios.reading import read_toml
    from taut.scenarios.scenario import built_in_scenarios, scenario_file

    if arguments.name is not None:
        path = scenario_file(arguments.name)
        title = read_toml(path).text("title", path.stem)
        text = path.read_text(encoding="utf-8-sig")
        return Answer(text=text.rstrip(), data={"name": path.stem, "title": title, "file": str(path), "text": text})
    rows = [(name, read_toml(path).text("title", name), str(path)) for name, path in built_in_scenarios().items()]
    table = Table(title="taut run SCENARIO", columns=("scenario", "what it shows"), rows=[row[:2] for row in rows])
    return Answer(text=str(table), data=[dict(zip(("name", "title", "file"), row, strict=True)) for row in rows])


RUN: Final = Command(
    name="run",
    help="Run a scenario: a built-in one by its name, or a .toml file.",
    arguments=_run_arguments,
    run=_run,
    more=EXAMPLES,
)
SCENARIOS: Final = Command(
    name="scenarios",
    help="List the built-in scenarios, or print the file of one.",
    arguments=_scenarios_arguments,
    run=_scenarios,
)
