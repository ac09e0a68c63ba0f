"""The commands that analyse laws: compare them on a scenario, and design their gains."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import UsageError, unknown_name
from taut.cli.command import DONE, FAILED, GAIN, STATUS, Answer, ByName, Command, Say, load_law, numbers

if TYPE_CHECKING:
    from taut.analysis.comparison import Comparison
    from taut.analysis.grading import Grade
    from taut.control.law import Law
    from taut.record.run import Run


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
    from taut.scenarios.scenario import load_scenario

    laws = _laws(arguments)
    common: dict[str, Any] = {"case": arguments.case}
    scenario = arguments.scenario and load_scenario(arguments.scenario, values=arguments.set)
    if arguments.reference is None:
        if arguments.tolerance is not None:
            raise UsageError("--tolerance is for a grade: --law FILE.py:CLASS --reference 'PID(kp=100, kd=20)'")
        given = arguments.model
        model = USUAL if given is None else WrongModel(**given) if given else None
        return compare(laws or None, scenario, by=arguments.by, model=model, **common)
    if len(laws) != 1 or arguments.scenario is None or arguments.run:
        raise UsageError("--reference grades one law on a scenario: taut compare SCENARIO --law FILE.py:CLASS")
    for name in ("by", "model"):
        if getattr(arguments, name):
            raise UsageError(f"--{name} is for a comparison; leave it out beside --reference")
    if arguments.tolerance is not None:
        common["tolerance"] = arguments.tolerance
    law = laws[0][1] if isinstance(laws[0], tuple) else laws[0]
    return grade(law, arguments.reference, scenario, **common)


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
        "--set": {
            "action": ByName,
            "metavar": "PATH=VALUE",
            "help": "another value of a key of the scenario, or of a parameter, by its path",
        },
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


NUMBERS: Final = {
    "zeta": "damping ratio; 1 for critical damping",
    "overshoot": "of a step [%%], in place of zeta",
    "omega_n": "natural frequency [rad/s]: one, one for each joint, or linear,angular",
    "settling": "2 %% settling time of a step [s], likewise",
    "K": "stiffness: linear,angular [N/m, N m/rad], or of the joints",
    "contact": "stiffness of what is pressed on: linear,angular",
    "force": "pole of the force [1/s]",
    "integral": "ki as a fraction of its stability limit",
    "rate": "servo rate [Hz] (default: 1000)",
}


def _design(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.analysis.design.design import design
    from taut.arm.load import load_arm

    given: dict[str, Any] = {name: value for name in NUMBERS if (value := getattr(arguments, name)) is not None}
    if arguments.at is not None:
        given["at"] = arguments.at if isinstance(arguments.at, list) else [arguments.at]
    if arguments.plant is not None:
        given = _in_file(arguments.plant) | given
    arm = given.pop("arm", None)
    if arguments.arm is not None or arm is None:
        arm = load_arm(arguments.arm or "panda")
    found = design(_law(arguments.law), arm, coupled=arguments.coupled, **given)
    return Answer(text=str(found), data=found.json(), status=DONE if found.met else FAILED)


def _in_file(path: str) -> dict[str, Any]:
    """arm, plant, rate and sensing of a file: [arm], [plant] and [control] of a scenario, which may have more."""
    from taut.scenarios.reading import read_toml
    from taut.scenarios.scenario import read_control_side_and_plant

    read_in = read_control_side_and_plant(read_toml(path, f"plant '{path}'"))
    return {name: value for name, value in read_in.items() if name != "limits"}


def _law(text: str) -> type[Law] | Law:
    """A class of laws by its name, or a law as scenarios and `taut compare` write it."""
    from taut import laws
    from taut.control.combine import law_classes
    from taut.scenarios.sections import law_of_text

    if "(" in text:
        return law_of_text(text)[1]
    known = law_classes(laws)
    if text not in known:
        raise unknown_name("taut design", "law", text, known, hint="or write one with its parts: NAME(part=...)")
    return known[text]


DESIGN: Final = Command(
    name="design",
    help="Find the gains of a law from a specification, and report what the sampled loop achieves and its limits.",
    run=_design,
    arguments={
        "law": {"metavar": "LAW", "help": "a law that `taut laws` lists; one that holds others is written with them"},
        "arm": {"metavar": "ARM", "nargs": "?", "help": "name or file (default: that of --plant, or panda)"},
        "--at": {"type": numbers, "metavar": "Q", "help": "the pose, such as 0,0.5,-1 [rad | m] (default: home)"},
        **{f"--{name}": {"type": numbers, "metavar": "X", "help": text} for name, text in NUMBERS.items()},
        "--plant": {
            "metavar": "FILE",
            "help": "a TOML file with [arm], [plant] and [control], as scenarios have: the plant, the rate and the "
            "filters with which the loop is judged",
        },
        "--coupled": {"action": "store_true", "help": "matrices for gains of PID and GravityPID"},
    },
    more="""examples:
  taut design PID one_joint --zeta 1 --omega_n 10
  taut design Impedance panda --K 800,30 --zeta 0.7 --rate 1000
  taut design ComputedTorque planar2 --zeta 1 --omega_n 10 --at -0.3,0.8
  taut design GravityPID ur10 --overshoot 5 --settling 0.5 --coupled --json
  taut design ForceControl panda --force 1 --zeta 0.7 --contact 10000,200 --rate 4000
  taut scenarios gain_bounds > plant.toml
  taut design PID --plant plant.toml --zeta 1 --omega_n 10
  taut design "HybridMotionForce(constraint={'kind': 'plane', 'point': [0, 0, -0.2], 'normal': [0, 0, 1]}, \\
      motion=TaskComputedTorque(kp=1, kd=1))" gantry3 --zeta 1 --omega_n 10 --force 5

exit status:
  0  done, and all that was asked for is met
  1  done, and something that was asked for is missed, or the loop is unstable
  2  the request was wrong
""",
)
