"""taut design: prints what `taut.design` finds."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import unknown_name
from taut.cli.command import DONE, FAILED, Answer, Command, Say, numbers

if TYPE_CHECKING:
    from taut.control.law import Law

__all__ = ["DESIGN"]

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
    if arguments.at:
        given["at"] = [pose if isinstance(pose, list) else [pose] for pose in arguments.at]
    if arguments.friction:
        given["friction"] = "arm"
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
    from taut.scenarios.laws import law_of_text

    if "(" in text:
        return law_of_text(text)[1]
    known = law_classes(laws)
    if text not in known:
        raise unknown_name("taut design", "law", text, known, hint="or write one with its parts: NAME(part=...)")
    return known[text]


DESIGN: Final = Command(
    name="design",
    help="Find the gains of a law from a specification, what of it the sampled loop has, and its limits.",
    run=_design,
    arguments={
        "law": {"metavar": "LAW", "help": "a law that `taut laws` lists; one that holds others is written with them"},
        "arm": {"metavar": "ARM", "nargs": "?", "help": "name or file (default: that of --plant, or panda)"},
        "--at": {
            "action": "append",
            "type": numbers,
            "metavar": "Q",
            "help": "a pose, such as 0,0.5,-1 [rad | m]; once for each (default: home)",
        },
        **{f"--{name}": {"type": numbers, "metavar": "X", "help": text} for name, text in NUMBERS.items()},
        "--plant": {
            "metavar": "FILE",
            "help": "a TOML file with [arm], [plant] and [control], as scenarios have: the plant, the rate and the "
            "filters with which the loop is judged",
        },
        "--coupled": {"action": "store_true", "help": "matrices for gains of PID and GravityPID"},
        "--friction": {"action": "store_true", "help": "the arm's own viscous friction counts as damping"},
    },
    more="""examples:
  taut design PID one_joint --zeta 1 --omega_n 10
  taut design Impedance panda --K 800,30 --zeta 0.7 --rate 1000
  taut design PID planar2 --zeta 1 --omega_n 10 --at -0.3,0.8
  taut design GravityPID ur10 --overshoot 5 --settling 0.5 --coupled --json
  taut design ForceControl panda --force 5 --zeta 0.7 --contact 10000,200
  taut design PID --plant backlash_cycle.toml --zeta 1 --omega_n 10
  taut design "HybridMotionForce(constraint={'kind': 'plane', 'point': [0.3, 0.0, 0.5], 'normal': [0, 0, 1]}, \\
      motion=TaskComputedTorque(kp=1, kd=1))" panda --zeta 1 --omega_n 10 --force 5

exit status:
  0  done, and all that was asked for is met
  1  done, and something that was asked for is missed, or the loop is unstable
  2  the request was wrong
""",
)
