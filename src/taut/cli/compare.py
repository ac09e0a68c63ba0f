"""The command `taut compare`: what it takes, and what it prints."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import UsageError, unknown_name
from taut.cli.command import DONE, ENGINES, FAILED, STATUS, Answer, Command, Say
from taut.cli.values import load_law, named_values

if TYPE_CHECKING:
    from taut.analysis.compare.compare import Comparison
    from taut.analysis.compare.grading import Grade
    from taut.analysis.compare.truth import WrongModel
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
PICTURES: Final = (".png", ".pdf", ".svg")
OF_MODEL: Final = ("mass", "com", "inertia", "friction", "payload", "trials", "seed")


def _arguments(command: argparse.ArgumentParser) -> None:
    command.add_argument("scenario", nargs="?", metavar="SCENARIO", help="a built-in scenario, or a .toml file")
    command.add_argument(
        "--laws",
        nargs="+",
        default=[],
        metavar="LAW",
        help='laws of the scenario by name, or as "PID(kp=100, kd=20)", or with a name, "stiff: PID(kp=900)"',
    )
    command.add_argument(
        "--law", action="append", default=[], metavar="FILE.py:CLASS", help="a law of your own; once for each"
    )
    command.add_argument(
        "--gain", action="append", default=[], metavar="NAME=VALUE", help="a gain of your own law, once for each gain"
    )
    command.add_argument(
        "--run", action="append", default=[], dest="runs", metavar="FILE.mcap", help="a recorded run beside them"
    )
    command.add_argument("--reference", metavar="LAW", help="grade the one law against this one")
    command.add_argument(
        "--tolerance", type=_share, default=None, metavar="SHARE", help="of a grade: 0.05, or 5%% (default)"
    )
    command.add_argument("--case", metavar="NAME", help="the case of a scenario that has cases")
    command.add_argument(
        "--by", action="append", default=[], metavar="FIGURE", help="a figure to rank by; again for the next one"
    )
    command.add_argument(
        "--noise",
        action="append",
        default=[],
        metavar="SENSOR=VALUE",
        help="standard deviation to compare with, such as position=1e-5; 'none' leaves it out",
    )
    command.add_argument(
        "--model",
        metavar="NAME=VALUE,...",
        help="spreads of the true arm: mass=0.2,friction=0.2 (default), payload=1,trials=5,seed=0; or none",
    )
    command.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE", help="a parameter of every loop, by its path"
    )
    command.add_argument("--seed", type=int, metavar="N", help="of the noise (default: the scenario's)")
    command.add_argument("--plot", type=Path, metavar="FILE", help="a picture: .png, .pdf or .svg")
    command.add_argument("--report", type=Path, metavar="FILE.html", help="a report, one file")
    command.add_argument("--engine", choices=ENGINES, default="auto", help="as of taut run")


def _share(text: str) -> float:
    """0.05, or 5%.

    Raises:
        ArgumentTypeError: Neither, which argparse makes a sentence of.
    """
    try:
        value = float(text.removesuffix("%"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"takes a share, such as 0.05 or 5%; got {text!r}") from None
    return 0.01 * value if text.endswith("%") else value


def _compared(arguments: argparse.Namespace, say: Say) -> Comparison | Grade:
    """What the arguments ask for, with its files.

    Raises:
        TautError: A request that is wrong; nothing has run then.
    """
    from taut.analysis.compare.grading import TOLERANCE
    from taut.record.log.files import checked_target
    from taut.scenarios.compare import compare, grade

    if arguments.plot is not None:
        checked_target("picture", arguments.plot, PICTURES)
    if arguments.report is not None:
        checked_target("report", arguments.report, (".html", ".htm"))
    given = _given(arguments)
    common: dict[str, Any] = {
        "case": arguments.case,
        "parameters": named_values(arguments.set, "--set", "plant.payload.mass=1.0"),
        "seed": arguments.seed,
        "engine": arguments.engine,
        "say": say,
        "repeat": shlex.join(["taut", *arguments.words]),
    }
    if arguments.reference is None:
        if arguments.tolerance is not None:
            raise UsageError("--tolerance is for a grade: --law FILE.py:CLASS --reference 'PID(kp=100, kd=20)'")
        table = compare(
            given or None,
            arguments.scenario,
            by=arguments.by,
            noise=_noise(arguments.noise),
            model=_model(arguments.model),
            **common,
        )
        _write(table, arguments, say)
        return table
    _refuse_beside_grade(arguments, given)
    tolerance = TOLERANCE if arguments.tolerance is None else arguments.tolerance
    law = next(iter(given.values()))
    graded = grade(law, arguments.reference, arguments.scenario, tolerance=tolerance, **common)
    _write(graded, arguments, say)
    return graded


def _write(done: Comparison | Grade, arguments: argparse.Namespace, say: Say) -> None:
    """The picture and the report, where they are asked for."""
    from taut.record.log.files import written_aside
    from taut.record.report.report import report

    if arguments.plot is not None:
        say(f"writing {arguments.plot} ...")
        with written_aside("picture", arguments.plot) as aside:
            done.plot().savefig(aside, dpi=150)
    if arguments.report is not None:
        say(f"writing {arguments.report} ...")
        report(done, arguments.report)


def _refuse_beside_grade(arguments: argparse.Namespace, given: Mapping[str, object]) -> None:
    """A grade is of one law on a scenario."""
    if len(given) != 1 or arguments.runs:
        raise UsageError(f"--reference grades one law: --law FILE.py:CLASS, or --laws 'PID(...)'; got {len(given)}")
    if arguments.scenario is None:
        raise UsageError("--reference grades a law on a scenario; name one that `taut scenarios` lists")
    for name in ("by", "noise", "model"):
        if getattr(arguments, name):
            raise UsageError(f"--{name} is for a comparison; leave it out beside --reference")


def _given(arguments: argparse.Namespace) -> dict[str, Law | Run | str]:
    """Laws and runs by name, in the order in which they were asked for."""
    from taut.record.log.reading import load_run

    if arguments.gain and len(arguments.law) != 1:
        raise UsageError("--gain is for one law of your own: --law FILE.py:CLASS --gain kp=100")
    out: dict[str, Law | Run | str] = {}
    named: list[tuple[str, Law | Run | str]] = [(text, text) for text in arguments.laws]
    named += [(place.rpartition(":")[2], load_law(place, arguments.gain)) for place in arguments.law]
    named += [(Path(file).stem, load_run(file)) for file in arguments.runs]
    for name, value in named:
        label = (
            name.partition(":")[0].strip() if isinstance(value, str) and "(" not in name.partition(":")[0] else name
        )
        if label in out:
            raise UsageError(
                f"two laws are called '{label}'; name one of them otherwise: 'other: PID(kp=900)'", name="laws"
            )
        out[label] = value
    if not out and arguments.scenario is None:
        raise UsageError("compare takes a scenario, recorded runs (--run FILE.mcap), or both")
    return out


def _noise(texts: Sequence[str]) -> dict[str, Any] | None:
    if list(texts) == ["none"]:
        return {}
    return named_values(texts, "--noise", "position=1e-5") or None


def _model(text: str | None) -> WrongModel | None:
    """By how much the true arm may differ."""
    from taut.analysis.compare.truth import WrongModel
    from taut.scenarios.compare import USUAL

    if text is None:
        return USUAL
    if text == "none":
        return None
    numbers = named_values(text.split(","), "--model", "mass=0.2,friction=0.2,trials=5")
    for name in numbers:
        if name not in OF_MODEL:
            raise unknown_name("a wrong model", "number", name, OF_MODEL)
    stated = {"mass", "com", "inertia", "friction", "payload"} & numbers.keys()
    return WrongModel(**numbers) if stated else dataclasses.replace(USUAL, **numbers)


def _compare(arguments: argparse.Namespace, say: Say) -> Answer:
    done = _compared(arguments, say)
    files = [f"{kind:8} {path}" for kind in ("plot", "report") if (path := getattr(arguments, kind)) is not None]
    return Answer(text="\n".join([done.report(), *files]), data=done.json(), status=DONE if done.ok else FAILED)


COMPARE: Final = Command(
    name="compare",
    help="Compare laws on a scenario, or grade a law against a reference law.",
    arguments=_arguments,
    run=_compare,
    more=EXAMPLES,
)
