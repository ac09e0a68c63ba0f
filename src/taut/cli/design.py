"""taut design: prints what `taut.design` finds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.cli.command import DONE, FAILED, Answer, Command, Say

if TYPE_CHECKING:
    from taut.analysis.design.result import Design
    from taut.control.law import Law

__all__ = ["DESIGN", "EXAMPLES", "add_arguments", "design_of"]

EXAMPLES: Final = """examples:
  taut design PID one_joint --zeta 1 --omega_n 10
  taut design Impedance panda --K 800,30 --zeta 0.7 --rate 1000
  taut design PID planar2 --zeta 1 --omega_n 10 --at -0.3,0.8
  taut design GravityPID ur10 --overshoot 5 --settling 0.5 --coupled --json
  taut design ForceControl panda --force 5 --zeta 0.7 --contact 10000,200
  taut design PID --plant backlash_cycle.toml --zeta 1 --omega_n 10
  taut design HybridMotionForce panda --zeta 1 --omega_n 10 --force 5 \\
      --constraint '{ kind = "plane", point = [0.3, 0.0, 0.5], normal = [0, 0, 1] }'

exit status:
  0  done, and all that was asked for is met
  1  done, and something that was asked for is missed, or the loop is unstable
  2  the request was wrong
"""
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


def add_arguments(command: argparse.ArgumentParser) -> None:
    """The arguments of `taut design`."""
    command.add_argument("law", metavar="LAW", help="a law that `taut laws` lists")
    command.add_argument("arm", metavar="ARM", nargs="?", help="name or file (default: that of --plant, or panda)")
    command.add_argument(
        "--at", action="append", metavar="Q", help="a pose, such as 0,0.5,-1 [rad | m]; once for each (default: home)"
    )
    for name, text in NUMBERS.items():
        command.add_argument(f"--{name}", metavar="X", help=text)
    command.add_argument(
        "--plant",
        type=Path,
        metavar="FILE",
        help="a TOML file with [arm], [plant] and [control], as scenarios have: the plant, the rate and the filters "
        "with which the loop is judged",
    )
    command.add_argument(
        "--constraint",
        metavar="TABLE",
        help="what HybridMotionForce touches, as scenarios write it: "
        '{ kind = "plane", point = [0.3, 0.0, 0.5], normal = [0, 0, 1] }, or an array of such',
    )
    command.add_argument("--coupled", action="store_true", help="matrices for gains of PID and GravityPID")
    command.add_argument("--friction", action="store_true", help="the arm's own viscous friction counts as damping")


def design_of(arguments: argparse.Namespace) -> Design:
    """The design that a command line asks for.

    Raises:
        UsageError, UnknownNameError, RangeError, ScenarioError: What `taut.design` refuses, texts that are no
            numbers, and files that are no plants.
    """
    from taut.analysis.design.design import design
    from taut.arm.load import load_arm

    given: dict[str, Any] = {
        name: _numbers(name, text) for name in NUMBERS if (text := getattr(arguments, name)) is not None
    }
    if arguments.at:
        given["at"] = [_numbers("at", text) for text in arguments.at]
    if arguments.friction:
        given["friction"] = "arm"
    if arguments.plant is not None:
        given = _in_file(arguments.plant) | given
    arm = given.pop("arm", None)
    if arguments.arm is not None or arm is None:
        arm = load_arm(arguments.arm or "panda")
    return design(_law(arguments.law, arguments.constraint), arm, coupled=arguments.coupled, **given)


def _in_file(path: Path) -> dict[str, Any]:
    """arm, plant, rate and sensing of a file: [arm], [plant] and [control] of a scenario, which may have more."""
    from taut.scenarios.experiment import read_control_side_and_plant
    from taut.scenarios.reading import read_toml

    read_in = read_control_side_and_plant(read_toml(path, f"plant '{path}'"))
    return {name: value for name, value in read_in.items() if name != "limits"}


def _law(name: str, constraint: str | None) -> type[Law] | Law:
    """A law by name; of those that hold others, with the ones that are usual.

    Raises:
        UnknownNameError: No such law.
        UsageError: A constraint that is missing, or that does not apply.
    """
    from taut import laws
    from taut.base.errors import UsageError, unknown_name
    from taut.control.law import Law

    known = [
        each
        for each in laws.__all__
        if isinstance(getattr(laws, each), type) and issubclass(getattr(laws, each), Law)
    ]
    if name not in known:
        raise unknown_name("taut design", "law", name, known)
    if name == "HybridMotionForce":
        return laws.HybridMotionForce(
            constraint=_constraint(constraint), motion=laws.TaskComputedTorque(kp=1.0, kd=1.0)
        )
    if constraint is not None:
        raise UsageError(f"--constraint does not apply to {name}; leave it out", name="constraint")
    if name == "ViaJointSpace":
        return laws.ViaJointSpace(inner=laws.ComputedTorque(kp=1.0, kd=1.0))
    found: type[Law] = getattr(laws, name)
    return found


def _constraint(text: str | None) -> Any:
    """The constraint of a command line, as scenarios write it.

    Raises:
        UsageError: None is given.
        ScenarioError: It is no constraint.
    """
    from taut.base.errors import UsageError
    from taut.scenarios.laws import read_constraint
    from taut.scenarios.reading import table_of

    if text is None:
        raise UsageError(
            "HybridMotionForce needs its constraint: --constraint "
            "'{ kind = \"plane\", point = [0.3, 0.0, 0.5], normal = [0, 0, 1] }', in metres and world axes",
            name="constraint",
        )
    # One line, so that nothing beside the table can stand in it.
    table = table_of(f"constraint = {' '.join(text.split())}", "--constraint", "--constraint")
    table.only(("constraint",))
    return read_constraint(table, "constraint")


def _numbers(name: str, text: str) -> Any:
    """A number, or numbers with commas between them, in brackets or not.

    Raises:
        UsageError: Something else.
    """
    inside = text.strip().removesuffix("%" if name == "overshoot" else "")
    inside = inside[1:-1] if inside[:1] == "[" and inside[-1:] == "]" else inside
    try:
        flat = [float(value) for value in inside.split(",")]  # NaN too, which the design refuses by name
    except ValueError:
        from taut.base.errors import UsageError

        raise UsageError(
            f"--{name} takes a number, or numbers with commas between them, such as --{name} 800,30; got '{text}'",
            name=name,
        ) from None
    return flat[0] if len(flat) == 1 and name != "at" else flat


def _design(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    found = design_of(arguments)
    return Answer(text=str(found), data=found.json(), status=DONE if found.met else FAILED)


DESIGN: Final = Command(
    name="design",
    help="Find the gains of a law from a specification, what of it the sampled loop has, and its limits.",
    arguments=add_arguments,
    run=_design,
    more=EXAMPLES,
)
