"""The commands `taut doctor` and `taut report`, which read a recorded run."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from taut.base.errors import FileError
from taut.cli.command import DONE, STATUS, WRONG, Answer, Command, Say

__all__ = ["DOCTOR", "REPORT"]

EXAMPLES: Final = """examples:
  taut doctor run.mcap
  taut doctor run.mcap --arm my_arm.urdf --out findings

exit status:
  0  done, whatever was found
  2  the request was wrong: not a log, or a log too short or incomplete (a partial diagnosis is printed)
"""


def _doctor_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("run", type=Path, metavar="RUN", help="a log (.mcap) of a run")
    command.add_argument("--arm", metavar="MODEL", help="the arm that the controller was compiled for")
    command.add_argument("--out", type=Path, metavar="DIR", help="folder for a picture of each finding")


def _doctor(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.analysis.diagnosis.diagnosis import doctor
    from taut.arm.load import load_arm
    from taut.record.log.files import written_aside
    from taut.record.log.reading import load_run

    run = load_run(arguments.run)
    diagnosis = doctor(run, arm=None if arguments.arm is None else load_arm(arguments.arm))
    pictures: list[Path] = []
    if arguments.out is not None:
        try:
            arguments.out.mkdir(parents=True, exist_ok=True)
        except OSError as cause:
            raise FileError(
                f"folder '{arguments.out}' cannot be made: {cause.strerror}", name=str(arguments.out)
            ) from cause
        for i, finding in enumerate(diagnosis.findings, start=1):
            name = finding.name.replace(" ", "_").replace("-", "_")
            pictures.append(arguments.out / f"{i}_{name}.png")
            with written_aside("picture", pictures[-1]) as aside:
                finding.plot().savefig(aside, format="png", dpi=150)
    return Answer(
        text="\n".join([str(diagnosis), *(f"picture {path}" for path in pictures)]),
        data={
            "run": str(arguments.run),
            "healthy": diagnosis.healthy,
            **diagnosis.json(),
            "pictures": [str(path) for path in pictures],
        },
        status=WRONG if diagnosis.problems else DONE,
        remarks=[f"'{arguments.run}' is no whole run: {problem}" for problem in diagnosis.problems],
    )


def _report_arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("run", metavar="RUN.mcap", help="a log that taut run or run.save wrote")
    command.add_argument(
        "-o", "--out", type=Path, default=Path("report.html"), metavar="FILE.html", help="(default: report.html)"
    )
    command.add_argument("--title", default="", metavar="TEXT", help="a title, instead of the usual one")


def _report(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.record.log.files import checked_target
    from taut.record.log.reading import load_run
    from taut.record.report import report
    from taut.record.run_report import faults_of

    checked_target("report", arguments.out, (".html", ".htm"))
    run = load_run(arguments.run)
    report(run, arguments.out, title=arguments.title)
    faults = faults_of(run)
    return Answer(
        text=f"report   {arguments.out}",
        data={"report": str(arguments.out), "outcome": run.outcome.json()},
        status=WRONG if faults else DONE,
        remarks=[f"'{arguments.run}' is no whole run, and the report is of what there is: {each}" for each in faults],
    )


DOCTOR: Final = Command(
    name="doctor",
    help="Find what went wrong in a recorded run: oscillation, stiction, saturation, ...",
    arguments=_doctor_arguments,
    run=_doctor,
    more=EXAMPLES,
)
REPORT: Final = Command(
    name="report",
    help="Write a report of a recorded run: one HTML file with everything in it.",
    arguments=_report_arguments,
    run=_report,
    more=STATUS,
)
