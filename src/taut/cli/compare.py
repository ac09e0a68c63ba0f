"""taut compare: laws on a scenario side by side, or one graded against a reference law."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import UsageError
from taut.cli.command import DONE, FAILED, GAIN, STATUS, Answer, ByName, Command, Say, load_law

if TYPE_CHECKING:
    from taut.analysis.comparison import Comparison
    from taut.analysis.grading import Grade
    from taut.control.law import Law
    from taut.record.run import Run

__all__ = ["COMPARE"]


def _compare(arguments: argparse.Namespace, say: Say) -> Answer:
    """Compare or grade, and write the report; a request that is wrong is refused before anything runs."""
    from taut.record.log.files import checked_target
    from taut.record.report import report

    file = arguments.report
    if file is not None:
        checked_target("report", file, (".html", ".htm"))
    done = _compared(arguments)
    if file is not None:
        say(f"writing {file} ...")
        report(done, file, repeat=shlex.join(["taut", *arguments.words]))
    text = str(done) if file is None else f"{done}\nreport   {file}"
    return Answer(text=text, data=done.json(), status=DONE if done.ok else FAILED)


def _compared(arguments: argparse.Namespace) -> Comparison | Grade:
    from taut.analysis.comparison import WrongModel
    from taut.scenarios.compare import USUAL, compare, grade

    laws = _laws(arguments)
    common: dict[str, Any] = {"case": arguments.case, "parameters": arguments.set}
    if arguments.reference is None:
        if arguments.tolerance is not None:
            raise UsageError("--tolerance is for a grade: --law FILE.py:CLASS --reference 'PID(kp=100, kd=20)'")
        given = arguments.model
        model = USUAL if given is None else WrongModel(**given) if given else None
        return compare(laws or None, arguments.scenario, by=arguments.by, model=model, **common)
    if len(laws) != 1 or arguments.scenario is None or arguments.run:
        raise UsageError("--reference grades one law on a scenario: taut compare SCENARIO --law FILE.py:CLASS")
    for name in ("by", "model"):
        if getattr(arguments, name):
            raise UsageError(f"--{name} is for a comparison; leave it out beside --reference")
    if arguments.tolerance is not None:
        common["tolerance"] = arguments.tolerance
    law = laws[0][1] if isinstance(laws[0], tuple) else laws[0]
    return grade(law, arguments.reference, arguments.scenario, **common)


def _laws(arguments: argparse.Namespace) -> list[str | tuple[str, Law | Run | str]]:
    """Laws and runs, in the order in which they were given: texts, laws of files, runs."""
    from taut.record.log.reading import load_run

    if arguments.gain and len(arguments.law) != 1:
        raise UsageError("--gain is for one law of your own: --law FILE.py:CLASS --gain kp=100")
    laws: list[str | tuple[str, Law | Run | str]] = list(arguments.laws)
    laws += [(place.rpartition(":")[2], load_law(place, arguments.gain)) for place in arguments.law]
    laws += [(Path(file).stem, load_run(file)) for file in arguments.run]
    if not laws and arguments.scenario is None:
        raise UsageError("compare takes a scenario, recorded runs (--run FILE.mcap), or both")
    return laws


COMPARE: Final = Command(
    name="compare",
    help="Compare laws on a scenario, or grade a law against a reference law.",
    run=_compare,
    arguments={
        "scenario": {"nargs": "?", "metavar": "SCENARIO", "help": "a built-in scenario, or a .toml file"},
        "--laws": {
            "nargs": "+",
            "default": [],
            "metavar": "LAW",
            "help": 'laws of the scenario by name, or as "PID(kp=100, kd=20)", or with a name, "stiff: PID(kp=900)"',
        },
        "--law": {
            "action": "append",
            "default": [],
            "metavar": "FILE.py:CLASS",
            "help": "a law of your own; once for each",
        },
        "--gain": GAIN,
        "--run": {"action": "append", "default": [], "metavar": "FILE.mcap", "help": "a recorded run beside them"},
        "--reference": {"metavar": "LAW", "help": "grade the one law against this one"},
        "--tolerance": {"type": float, "metavar": "FRACTION", "help": "of a grade (default: 0.05)"},
        "--case": {"metavar": "NAME", "help": "the case of a scenario that has cases"},
        "--by": {
            "action": "append",
            "default": [],
            "metavar": "FIGURE",
            "help": "a figure to rank by; again for the next one",
        },
        "--model": {
            "nargs": "*",
            "action": ByName,
            "metavar": "NAME=VALUE",
            "help": "spreads of the true arm (default: mass=0.2 friction=0.2; also com, inertia, payload, trials, "
            "seed); alone it leaves them out",
        },
        "--set": {"action": ByName, "metavar": "PATH=VALUE", "help": "a parameter of every loop, by its path"},
        "--report": {"type": Path, "metavar": "FILE.html", "help": "a report with the picture, one file"},
    },
    more=f"""examples:
  taut compare panda_payload --by rms_error --report compared.html
  taut compare one_joint_pid --laws "soft: PID(kp=2, kd=2)" "stiff: PID(kp=20, kd=6)" PID
  taut compare one_joint_pid --law student.py:MyLaw --reference "PID(kp=2.205, kd=2)"

With --reference, the one law is graded: each figure passes within the tolerance, and so does the command in the
states of the reference's own run.

{STATUS}""",
)
