"""taut compare: laws on a scenario side by side, or one graded against a reference law."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import UsageError
from taut.cli.command import DONE, FAILED, STATUS, Answer, Command, Say
from taut.cli.values import load_law, named_values

if TYPE_CHECKING:
    from taut.analysis.comparison import Comparison
    from taut.analysis.grading import Grade
    from taut.control.law import Law
    from taut.record.run import Run

__all__ = ["COMPARE"]

EXAMPLES: Final = f"""examples:
  taut compare panda_payload --by rms_error --plot compared.png
  taut compare one_joint_pid --laws "soft: PID(kp=2, kd=2)" "stiff: PID(kp=20, kd=6)" PID
  taut compare one_joint_pid --law student.py:MyLaw --reference "PID(kp=2.205, kd=2)"

With --reference, the one law is graded: each figure passes within the tolerance, and so does the command in the
states of the reference's own run.

{STATUS}"""
OPTIONS: Final[dict[str, dict[str, Any]]] = {
    "laws": {
        "nargs": "+",
        "metavar": "LAW",
        "help": 'laws of the scenario by name, or as "PID(kp=100, kd=20)", or with a name, "stiff: PID(kp=900)"',
    },
    "law": {"action": "append", "metavar": "FILE.py:CLASS", "help": "a law of your own; once for each"},
    "gain": {
        "action": "append",
        "metavar": "NAME=VALUE",
        "help": "a gain of your own law, once for each gain",
    },
    "run": {"action": "append", "metavar": "FILE.mcap", "help": "a recorded run beside them"},
    "reference": {"metavar": "LAW", "help": "grade the one law against this one"},
    "tolerance": {"type": float, "metavar": "FRACTION", "help": "of a grade (default: 0.05)"},
    "case": {"metavar": "NAME", "help": "the case of a scenario that has cases"},
    "by": {"action": "append", "metavar": "FIGURE", "help": "a figure to rank by; again for the next one"},
    "noise": {
        "action": "append",
        "metavar": "SENSOR=VALUE",
        "help": "standard deviation to compare with, such as position=1e-5; 'none' leaves it out",
    },
    "model": {
        "metavar": "NAME=VALUE,...",
        "help": "spreads of the true arm (default: mass=0.2,friction=0.2; also com, inertia, payload, trials, seed); "
        "'none' leaves them out",
    },
    "set": {
        "action": "append",
        "metavar": "PATH=VALUE",
        "help": "a parameter of every loop, by its path",
    },
    "seed": {"type": int, "metavar": "N", "help": "of the noise (default: the scenario's)"},
    "plot": {"type": Path, "metavar": "FILE", "help": "a picture: .png, .pdf or .svg"},
    "report": {"type": Path, "metavar": "FILE.html", "help": "a report, one file"},
}


def _arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("scenario", nargs="?", metavar="SCENARIO", help="a built-in scenario, or a .toml file")
    for name, option in OPTIONS.items():
        several = option.keys() & {"action", "nargs"}
        command.add_argument(f"--{name}", default=[] if several else None, **option)


def _compare(arguments: argparse.Namespace, say: Say) -> Answer:
    """Compare or grade, and write the files.

    Raises:
        TautError: A request that is wrong; nothing has run then.
    """
    from taut.record.log.files import checked_target, written_aside
    from taut.record.report import report

    targets = {"plot": (".png", ".pdf", ".svg"), "report": (".html", ".htm")}
    files = {kind: path for kind in targets if (path := getattr(arguments, kind)) is not None}
    for kind, path in files.items():
        checked_target(kind, path, targets[kind])
    done = _compared(arguments)
    if "plot" in files:
        say(f"writing {files['plot']} ...")
        with written_aside("plot", files["plot"]) as aside:
            done.plot().savefig(aside, dpi=150)
    if "report" in files:
        say(f"writing {files['report']} ...")
        report(done, files["report"], repeat=shlex.join(["taut", *arguments.words]))
    lines = [str(done), *(f"{kind:8} {path}" for kind, path in files.items())]
    return Answer(text="\n".join(lines), data=done.json(), status=DONE if done.ok else FAILED)


def _compared(arguments: argparse.Namespace) -> Comparison | Grade:
    from taut.analysis.comparison import WrongModel
    from taut.scenarios.compare import USUAL, compare, grade

    laws = _laws(arguments)
    common: dict[str, Any] = {
        "case": arguments.case,
        "parameters": named_values(arguments.set, "--set", "plant.payload.mass=1.0"),
        "seed": arguments.seed,
    }
    if arguments.reference is not None:
        if len(laws) != 1 or arguments.scenario is None or arguments.run:
            raise UsageError("--reference grades one law on a scenario: taut compare SCENARIO --law FILE.py:CLASS")
        for name in ("by", "noise", "model"):
            if getattr(arguments, name):
                raise UsageError(f"--{name} is for a comparison; leave it out beside --reference")
        if arguments.tolerance is not None:
            common["tolerance"] = arguments.tolerance
        law = laws[0][1] if isinstance(laws[0], tuple) else laws[0]
        return grade(law, arguments.reference, arguments.scenario, **common)
    if arguments.tolerance is not None:
        raise UsageError("--tolerance is for a grade: --law FILE.py:CLASS --reference 'PID(kp=100, kd=20)'")
    model: WrongModel | None = USUAL
    if arguments.model == "none":
        model = None
    elif arguments.model is not None:
        model = WrongModel(**named_values(arguments.model.split(","), "--model", "mass=0.2,friction=0.2,trials=5"))
    quiet = arguments.noise == ["none"]
    noise = {} if quiet else named_values(arguments.noise, "--noise", "position=1e-5") or None
    return compare(laws or None, arguments.scenario, by=arguments.by, noise=noise, model=model, **common)


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
    arguments=_arguments,
    run=_compare,
    more=EXAMPLES,
)
