"""The commands about models: arms, laws, check, bench."""

from __future__ import annotations

import argparse
import re
import shutil
import textwrap
import time
import timeit
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from taut.base.errors import ModelError, count_of
from taut.base.result import Table
from taut.cli.command import DONE, WRONG, Answer, Command, Say

if TYPE_CHECKING:
    from taut.control.law import Law


def _arms(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.arm.report import arm_rows

    rows = arm_rows()
    table = Table(
        title="taut.load_arm(NAME)",
        columns=("arm", "joints", "commands", "from", "installed"),
        rows=[tuple((row | {"commands": ", ".join(row["commands"])}).values()) for row in rows],
    )
    return Answer(text=str(table), data=rows)


ARMS: Final = Command(name="arms", help="List the arms that taut knows by name.", run=_arms)


def _laws(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut import laws
    from taut.control.combine import law_classes
    from taut.controller.explain import statements, summary

    rows = [
        {
            "name": name,
            "summary": summary(cls),
            "law": statements(cls, "Law"),
            "closed_loop": statements(cls, "Closed loop"),
            "gains": {gain: field.unit for gain, field in cls.declared.items() if field.run_time},
            "reference": _reference_of(cls),
        }
        for name, cls in law_classes(laws).items()
    ]
    width = shutil.get_terminal_size((140, 0)).columns
    return Answer(text="\n\n".join(_law_text(row, width) for row in rows), data=rows)


def _reference_of(law: type[Law]) -> str:
    from taut.control.combine import SideBySide, Sum, Wrapper

    if issubclass(law, (Sum, SideBySide, Wrapper)):
        return "that of the law that it holds" if issubclass(law, Wrapper) else "that of its parts"
    return "none" if law.ignores_reference else law.reference.__name__


def _law_text(row: dict[str, Any], width: int) -> str:
    """A law for people, in lines of at most `width` letters."""
    gains = ", ".join(f"{name} [{unit}]" if unit else name for name, unit in row["gains"].items())
    parts = {"law": "; ".join(row["law"]), "closed loop": "; ".join(row["closed_loop"])}
    parts |= {"gains": gains or "none", "follows": row["reference"]}
    lines = textwrap.wrap(f"{row['name']}: {row['summary']}", width)
    for head, text in parts.items():
        one = re.sub(r" {3}([^;]+)", r" (\1)", text)  # the source of an equation
        indents = f"  {head:11}  ", " " * 15
        lines += textwrap.wrap(
            one, width, initial_indent=indents[0], subsequent_indent=indents[1], break_on_hyphens=False
        )
    return "\n".join(lines)


LAWS: Final = Command(name="laws", help="List the laws with their equations, gains and references.", run=_laws)


def _check(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    from taut.arm.load import open_model
    from taut.arm.report import check_model

    report = check_model(arguments.model)
    if report.tree is None and not arguments.json:
        with suppress(ModelError):  # a model that is broken has its report; a name without a model ends here
            open_model(arguments.model)
    return Answer(text=report.text(), data=report.json(), status=DONE if report.ok else WRONG)


CHECK: Final = Command(
    name="check",
    help="Read a robot model and report what is in it and everything that is wrong with it.",
    run=_check,
    arguments={"model": {"metavar": "MODEL", "help": "a name, a .urdf or an MJCF .xml file"}},
)

BENCH_DURATION: Final = 2.0  # [s] of the run that is timed


def _bench(arguments: argparse.Namespace, say: Say) -> Answer:  # noqa: ARG001
    import taut

    arm = taut.load_arm(arguments.arm)
    law = taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0)
    start = time.perf_counter()
    ctrl = taut.compile(law, arm)
    compiled = time.perf_counter() - start
    q, v, ref = arm.home, 0.0 * arm.home, taut.JointMotion(q=arm.home + 0.01)
    plant = taut.RigidPlant(arm, friction=None)
    steps, _ = (timer := timeit.Timer(lambda: ctrl.step(q, v, ref))).autorange()
    step = min(timer.repeat(5, steps)) / steps
    run = min(timeit.repeat(lambda: taut.run(ctrl, plant, ref, duration=BENCH_DURATION), number=1, repeat=5))
    rows = {
        "arm": f"{arm.name}, {count_of(arm.n, 'joint')}; computed torque, 1 kHz",
        "operations in a tick": f"{ctrl.operations}",
        "compile, or its cache": f"{1e3 * compiled:.0f} ms",
        "ctrl.step": f"{1e6 * step:.2f} us",
        "recorded run": f"{BENCH_DURATION / run:.0f} times real time",
    }
    return Answer(text="\n".join(f"{what:22} {figure}" for what, figure in rows.items()), data=rows)


BENCH: Final = Command(
    name="bench",
    help="Measure what a compile, a step and a run cost on this machine.",
    run=_bench,
    arguments={
        "arm": {"nargs": "?", "default": "planar3", "metavar": "ARM", "help": "name or file (default: planar3)"}
    },
)
