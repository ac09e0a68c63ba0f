"""taut design: prints what `taut.design` finds."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any, Final

from taut.cli.command import DONE, FAILED, Answer, Command, Say

if TYPE_CHECKING:
    from taut.analysis.design.design import Design
    from taut.control.law import Law

__all__ = ["DESIGN", "EXAMPLES", "add_arguments", "design_of"]

EXAMPLES: Final = """examples:
  taut design PID --arm one_joint --zeta 1 --omega_n 10
  taut design Impedance --arm panda --K 800,30 --zeta 0.7 --rate 1000
  taut design PID --arm planar2 --zeta 1 --omega_n 10 --at -0.3,0.8
  taut design GravityPID --arm ur10 --overshoot 5 --settling 0.5 --coupled --json
  taut design ForceControl --arm panda --force 5 --zeta 0.7 --contact 10000,200
  taut design HybridMotionForce --arm panda --zeta 1 --omega_n 10 --force 5 \\
      --constraint '{ kind = "plane", point = [0.3, 0.0, 0.5], normal = [0, 0, 1] }'

exit status:
  0  done, and all that was asked for is met
  1  done, and something that was asked for is missed
  2  the request was wrong, or no loop with these gains is stable
"""
NUMBERS: Final = {
    "zeta": "damping ratio; 1 for critical damping",
    "overshoot": "of a step [%%], in place of zeta",
    "omega_n": "natural frequency [rad/s]",
    "settling": "exact 2 %% settling time of a step [s]",
    "bandwidth": "where the arm follows 3 dB less than at rest [rad/s]",
    "K": "stiffness: linear,angular [N/m, N m/rad], or of the joints",
    "D": "inertia to be felt at the tool: linear,angular [kg, kg m^2]",
    "contact": "stiffness of what is pressed on: linear,angular",
    "step": "step that is to keep within the torque limits [rad | m]",
}
SINGLE: Final = {
    "force": "pole of the force [1/s]",
    "integral": "ki as a share of the largest",
    "rate": "servo rate [Hz] (default: 1000)",
    "delay": "from the tick to the torque [s], whole periods",
}


def add_arguments(command: argparse.ArgumentParser) -> None:
    """The arguments of `taut design`."""
    command.add_argument("law", metavar="LAW", help="a law that `taut laws` lists")
    command.add_argument("--arm", default="panda", metavar="ARM", help="name or file (default: panda)")
    command.add_argument(
        "--at",
        action="append",
        metavar="Q",
        help="a pose, such as 0,0.5,-1 [rad | m]; once for each, the worst is designed for (default: home)",
    )
    for name, text in NUMBERS.items():
        command.add_argument(f"--{name}", metavar="X", help=text)
    for name, text in SINGLE.items():
        command.add_argument(f"--{name}", metavar="X", help=text)
    command.add_argument(
        "--constraint",
        metavar="TABLE",
        help="what HybridMotionForce touches, as scenarios write it: "
        '{ kind = "plane", point = [0.3, 0.0, 0.5], normal = [0, 0, 1] }, or an array of such',
    )
    command.add_argument("--coupled", action="store_true", help="matrices for gains of PID and GravityPID")
    command.add_argument("--friction", action="store_true", help="the arm's own viscous friction counts as damping")
    command.add_argument("--velocity", choices=("measured", "difference"), default="measured", help="how it is got")


def design_of(arguments: argparse.Namespace) -> Design:
    """The design that a command line asks for.

    Raises:
        UsageError, UnknownNameError, RangeError: What `taut.design` refuses, and texts that are no numbers.
    """
    from taut.analysis.design.design import design
    from taut.arm.load import load_arm

    given: dict[str, Any] = {}
    for name in (*NUMBERS, *SINGLE):
        text = getattr(arguments, name)
        if text is not None:
            given[name] = _numbers(name, text)
    if arguments.at:
        poses = [_numbers("at", text) for text in arguments.at]
        given["at"] = poses if len(poses) > 1 else poses[0]
    if arguments.friction:
        given["friction"] = "arm"
    return design(
        _law(arguments.law, arguments.constraint),
        load_arm(arguments.arm),
        coupled=arguments.coupled,
        velocity=arguments.velocity,
        **given,
    )


def _law(name: str, constraint: str | None) -> type[Law] | Law:
    """A law by name; of those that hold others, with the ones that are usual."""
    from taut import laws
    from taut.analysis.design.gains import RECIPES
    from taut.base.errors import UsageError, unknown_name

    known = [kind.__name__ for kind in RECIPES if kind is not laws.Sum]
    if name not in laws.__all__:
        raise unknown_name("taut design", "law", name, known)
    if name == "HybridMotionForce":
        return _hybrid(constraint)
    if constraint is not None:
        raise UsageError(
            f"--constraint has no meaning for {name}, which holds to none; leave it out", name="constraint"
        )
    if name == "ViaJointSpace":
        return laws.ViaJointSpace(inner=laws.ComputedTorque(kp=1.0, kd=1.0))
    found: type[Law] = getattr(laws, name)
    return found


def _hybrid(constraint: str | None) -> Law:
    """Hybrid motion and force over computed torque, against what the command line says.

    Raises:
        UsageError: Nothing is said.
        ScenarioError: What is said is no constraint.
    """
    from taut import laws
    from taut.base.errors import UsageError
    from taut.scenarios.laws import read_constraint
    from taut.scenarios.toml import table_of

    if constraint is None:
        raise UsageError(
            "HybridMotionForce needs what it touches: --constraint "
            "'{ kind = \"plane\", point = [0.3, 0.0, 0.5], normal = [0, 0, 1] }', in metres and world axes",
            name="constraint",
        )
    # One line, so that nothing beside the table can stand in it.
    table = table_of(f"constraint = {' '.join(constraint.split())}", "--constraint", "--constraint")
    table.only(("constraint",))
    held = read_constraint(table, "constraint")
    return laws.HybridMotionForce(constraint=held, motion=laws.TaskComputedTorque(kp=1.0, kd=1.0))


def _numbers(name: str, text: str) -> Any:
    """A number, or numbers with commas between them, in brackets or not."""
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
    return Answer(text=found.report(), data=found.json(), status=DONE if found.met else FAILED)


DESIGN: Final = Command(
    name="design",
    help="Find the gains of a law from a specification, and their limits.",
    arguments=add_arguments,
    run=_design,
    more=EXAMPLES,
)
