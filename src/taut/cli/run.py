"""The commands of scenarios and of recorded runs: run, scenarios, export, doctor, report."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import TautError, UsageError
from taut.base.result import Table
from taut.cli.command import (
    DONE,
    FAILED,
    GAIN,
    OF_SCENARIO,
    STATUS,
    WRONG,
    Answer,
    Command,
    Say,
    load_law,
    scenario_of,
    words_again,
)
from taut.cli.robots import connected

if TYPE_CHECKING:
    from taut.record.run import Run
    from taut.scenarios.scenario import Scenario


def _run(arguments: argparse.Namespace, say: Say) -> Answer:
    from taut.scenarios.run import run_scenario

    scenario, remarks = scenario_of(arguments), list[str]()
    folder = arguments.out or Path("out") / scenario.name
    with contextlib.ExitStack() as stack:
        robot = None
        if arguments.robot is not None:
            from taut.scenarios.on_robot import robot_of

            again = words_again(arguments, "scenario", "set", "law", "gain")
            robot = robot_of(scenario, again, arguments.robot, folder / "robot")
            stack.enter_context(connected(robot, yes=arguments.yes))
            rate = scenario.experiment.rate
            if robot.rate != rate:
                remarks = [f"[control] rate = {rate:g} Hz is not used on a robot: this one has {robot.rate:g} Hz"]
        result = run_scenario(scenario, folder, say=say, engine=arguments.engine, robot=robot)
    status = DONE if result.ok else FAILED
    return Answer(text=str(result), data=result.json(), status=status, remarks=remarks)


RUN: Final = Command(
    name="run",
    help="Run a scenario: a built-in one by its name, or a .toml file.",
    run=_run,
    arguments={
        "scenario": {"metavar": "SCENARIO", "help": "a name that `taut scenarios` lists, or a path"},
        "--out": {"type": Path, "metavar": "DIR", "help": "folder for the files (default: out/SCENARIO)"},
        **OF_SCENARIO,
        "--robot": {
            "metavar": "ROBOT",
            "help": "on this robot instead of the scenario's plant, once `taut bringup` has passed: an address, or a "
            "robot file",
        },
        "--yes": {"action": "store_true", "help": "an arm that falls without its motors is supported: do not ask"},
        "--engine": {
            "choices": ("auto", "native", "float"),
            "default": "auto",
            "help": "native: machine code; float: plain Python, slow; auto: the first that is there (default)",
        },
    },
    more=f"""examples:
  taut run one_joint_pid
  taut run my_scenario.toml --out results
  taut run one_joint_pid --set laws.PD.kp=5 --set run.duration=2
  taut run one_joint_pid --law my_law.py:Spring --gain k=2.0
  taut run panda_payload --robot franka://172.16.0.2

The metrics are printed as a table; below it stands each file that was made.

{STATUS}""",
)


def _scenarios(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.scenarios.reading import read_toml
    from taut.scenarios.scenario import built_in_scenarios, scenario_file

    known = built_in_scenarios() if arguments.name is None else {"": scenario_file(arguments.name)}
    rows = [
        {"name": path.stem, "title": read_toml(path).text("title", path.stem), "file": str(path)}
        for path in known.values()
    ]
    if arguments.name is not None:
        text = known[""].read_text(encoding="utf-8-sig")
        return Answer(text=text.rstrip(), data={**rows[0], "text": text})
    columns = ("scenario", "what it shows")
    table = Table(title="taut run SCENARIO", columns=columns, rows=[(row["name"], row["title"]) for row in rows])
    return Answer(text=str(table), data=rows)


SCENARIOS: Final = Command(
    name="scenarios",
    help="List the built-in scenarios, or print the file of one.",
    run=_scenarios,
    arguments={"name": {"nargs": "?", "metavar": "NAME", "help": "print the file of this one"}},
)


LAW_OF_SCENARIO: Final[Mapping[str, Any]] = {
    "metavar": "NAME",
    "help": "name of one of its laws, needed where it has several; or a law of your own, as in run: FILE.py:CLASS",
}


def scenario_with_law(arguments: argparse.Namespace, values: Mapping[str, Any] | None = None) -> tuple[Scenario, str]:
    """A scenario with one of its laws: that of --law, which may be one of the user's own, or its only one."""
    from taut.scenarios.scenario import load_scenario

    name = arguments.law
    own = {name: load_law(name, arguments.gain)} if name is not None and ":" in name else None
    scenario = load_scenario(arguments.scenario, own, values=values)
    if name is None and len(scenario.laws) == 1:
        name = next(iter(scenario.laws))
    if name not in scenario.laws:
        got = "none was named" if name is None else f"got '{name}'"
        laws = f"law{'s' * (len(scenario.laws) > 1)} {', '.join(map(repr, scenario.laws))}"
        way = "give --law NAME" if len(scenario.laws) > 1 else "leave --law out"
        raise UsageError(f"scenario '{scenario.name}' has the {laws}; {got}; {way}")
    return scenario, name


def _export(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.controller.export_c import export_c

    scenario, name = scenario_with_law(arguments)
    laws = scenario.laws
    ctrl = scenario.experiment.prepared(laws[name]).controller(laws[name])
    files = [str(file) for file in export_c(ctrl, arguments.out, prefix=arguments.prefix, real=arguments.real)]
    cost = f"{ctrl.operations} operations a tick; to compare it with Python: make -C {arguments.out} test"
    return Answer(text="\n".join([*files, cost]), data={"scenario": scenario.name, "law": name, "files": files})


EXPORT: Final = Command(
    name="export",
    help="Write a law of a scenario as C99 for firmware, with a self-test.",
    run=_export,
    arguments={
        "scenario": {"metavar": "SCENARIO", "help": "a name that `taut scenarios` lists, or a path"},
        "--law": LAW_OF_SCENARIO,
        "--gain": GAIN,
        "--out": {"type": Path, "default": Path("firmware"), "metavar": "DIR", "help": "(default: firmware)"},
        "--prefix": {"default": "ctrl", "help": "what files, types and functions begin with (default: ctrl)"},
        "--real": {"choices": ("double", "float"), "default": "double", "help": "type of numbers (default: double)"},
    },
)


def _of(run: Run) -> str:
    """What was recorded, in a line."""
    return f"law {run.info.law or 'not recorded'}, arm {run.info.arm or 'not recorded'}"


def _doctor(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.analysis.diagnosis.diagnosis import doctor
    from taut.record.log.reading import load_run

    run = load_run(arguments.run)
    diagnosis = doctor(run)
    return Answer(
        text=f"{_of(run)}\n{diagnosis}",
        data={"run": arguments.run, "healthy": diagnosis.healthy, **diagnosis.json()},
        status=WRONG if diagnosis.problems else DONE,
        remarks=[f"'{arguments.run}' is no whole run: {problem}" for problem in diagnosis.problems],
    )


DOCTOR: Final = Command(
    name="doctor",
    help="Find what went wrong in a recorded run: oscillation, stiction, saturation, ...",
    run=_doctor,
    arguments={"run": {"metavar": "RUN.mcap", "help": "a log of taut.connect(..., log=), taut run or run.save"}},
    more="""exit status:
  0  done, whatever was found
  2  the request was wrong: not a log, or a log too short or incomplete (a partial diagnosis is printed)
""",
)


def _report(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.record.log.files import checked_target
    from taut.record.log.reading import load_run
    from taut.record.report import faults_of, report

    checked_target("report", arguments.out, (".html", ".htm"))
    run = load_run(arguments.run)
    report(run, arguments.out)
    faults = faults_of(run)
    return Answer(
        text=f"{_of(run)}\nreport   {arguments.out}",
        data={"report": str(arguments.out), "outcome": run.outcome.json()},
        status=WRONG if faults else DONE,
        remarks=[f"'{arguments.run}' is no whole run, and the report is of what there is: {each}" for each in faults],
    )


REPORT: Final = Command(
    name="report",
    help="Write a report of a recorded run: one HTML file with everything in it.",
    run=_report,
    arguments={
        **DOCTOR.arguments,
        "--out": {
            "type": Path,
            "default": Path("report.html"),
            "metavar": "FILE.html",
            "help": "(default: report.html)",
        },
    },
)


def _repair(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.record.log.files import checked_target
    from taut.record.log.reading import intact_parts

    source = Path(arguments.run)
    target = checked_target("log", arguments.out or source.with_name(f"{source.stem}-repaired.mcap"), (".mcap",))
    rows = list[dict[str, Any]]()
    for part in intact_parts(source):
        if len(part):
            file = target if not rows else target.with_stem(f"{target.stem}-{len(rows) + 1}")
            row = {
                "file": str(part.save(file)),
                "ticks": len(part),
                "start": float(part.t[0]),
                "end": float(part.t[-1]),
            }
            rows.append({**row, "outcome": part.outcome.json()})
    lines = [f"{row['file']}  {row['ticks']} ticks, {row['start']:g} to {row['end']:g} s" for row in rows]
    remarks = [row["outcome"]["message"] for row in rows]
    text = "\n".join(lines) or "no whole tick is left in it"
    return Answer(
        text=text, data={"run": arguments.run, "files": rows}, status=DONE if rows else FAILED, remarks=remarks
    )


REPAIR: Final = Command(
    name="repair",
    help="Write the whole ticks of a damaged or unfinished log as a log that every reader of MCAP takes.",
    run=_repair,
    arguments={
        **DOCTOR.arguments,
        "--out": {"type": Path, "metavar": "FILE.mcap", "help": "(default: RUN-repaired.mcap)"},
    },
    more="""Ticks after a damaged stretch go into a file of their own, RUN-repaired-2.mcap. RUN.mcap stays as it is.

exit status:
  0  done
  1  no whole tick is left in it
  2  the request was wrong: not a log, or one without a whole description
""",
)


def _replay(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.arm.load import load_arm
    from taut.controller import compile
    from taut.record.log.reading import load_run
    from taut.runtime.realtime.replay import replay, require_servo
    from taut.scenarios.sections import law_of_text, of_text

    run = load_run(arguments.run)
    servo, info = require_servo(run), run.info
    arm = run.arms[0] if arguments.arm is None else load_arm(arguments.arm)
    own = None if arguments.law is None else load_law(arguments.law, arguments.gain)
    try:
        law = own or law_of_text(info.law)[1]
        sensing, cut = of_text(info.sensing, "sensing"), info.command_limits
        limits = None if cut == "none" else of_text(f"Limits({cut})", "limits")
    except TautError as cause:
        raise UsageError(
            "the law cannot be made from its text in the log; give --law FILE.py:CLASS, or in Python its controller "
            f"to taut.analysis.replay: {cause}",
            name="law",
        ) from cause
    result = replay(run, compile(law, arm, rate=run.rate, adds=servo.adds, sensing=sensing, limits=limits))
    return Answer(text=f"{_of(run)}\n{result}", data=result.json(), status=DONE if result.ok else FAILED)


REPLAY: Final = Command(
    name="replay",
    help="Compute every tick of a robot's log again, and compare the results to the last bit.",
    run=_replay,
    arguments={
        "run": {"metavar": "RUN.mcap", "help": "a log that taut.connect(..., log=) wrote"},
        "--law": {"metavar": "FILE.py:CLASS", "help": "the law, where it is one of your own"},
        "--gain": GAIN,
        "--arm": {"metavar": "ARM", "help": "name or file of the arm (default: the one in the log)"},
    },
    more="""exit status:
  0  all ticks are bit-identical
  1  some are not
  2  the request was wrong: no log of a robot, or another law or arm
""",
)
