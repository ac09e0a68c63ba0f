"""The report of a design and of a linear loop: their numbers as tables, pictures, settings, how to do it again."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.analysis.design.words import gains_of
from taut.arm.description import Arm
from taut.arm.load import load_arm
from taut.base.errors import TautError
from taut.base.result import cell_text
from taut.record.info import arm_json, differences
from taut.record.report.page import Page, Picture, Table
from taut.record.report.run_report import law_in_python

if TYPE_CHECKING:
    from taut.analysis.design.design import Design
    from taut.linear.linear_loop import LinearLoop

__all__ = ["page_of_design", "page_of_linear_loop"]

NUMBERS: Final = {"zeta": "damping ratio", "omega_n": "rad/s", "overshoot": "%", "settling": "s"}
TELLS: Final = 0.005  # participation of a state in a mode that is worth a word


def page_of_design(d: Design) -> Page:
    """Gains, designed against achieved numbers, limits, steps, and the lines that design it again."""
    missed = [each.sentence for each in d.limits if not each.ok]
    none = [each.sentence for each in d.limits if each.ok and math.isinf(each.limit)]
    count = len(d.limits) - len(none)
    alike = f"tried as {d.alone} alone, which {type(d.law).__name__} holds. " if d.alone else ""
    names = dict.fromkeys(each.name for each in d.requirements if not each.met)
    met = "All that was asked for is met" if d.met else f"Missed: {', '.join(names) or 'at another pose'}"
    kept = f"It keeps to {count - len(missed)} of {count} limits{''.join(f'; {sentence}' for sentence in none)}."
    return Page(
        title=f"Design: {type(d.law).__name__} on {d.arm.name} at {d.rate:g} Hz",
        summary=(
            f"{alike[:1].upper()}{alike[1:]}{met}. {kept}",
            *(f"Beyond a limit: {sentence}." for sentence in missed),
        ),
        tables=tuple(
            table
            for table in (_requirements(d), _gains(d), _achieved(d), _stiffness(d), _limits(d), _poses(d))
            if table.rows
        ),
        pictures=(Picture(title="Steps of each direction, and the torque that they take", figure=d.plot()),)
        if d.achieved
        else (),
        settings={
            "law": repr(d.law),
            "arm": d.arm.name,
            "rate": f"{d.rate:g} Hz",
            "predicted and simulated": d.motion,
            **{f"asked: {name}": _python(value) for name, value in d.asked.items()},
            "designed for": f"q = {np.round(d.q, 6).tolist()}",
            "steps that limits speak of": _python(d.step),
        },
        texts={"In words": d.report()},
        repeat=_again(d),
    )


def _requirements(d: Design) -> Table:
    """One row for each number that was asked for, in each direction."""
    rows = [
        (each.name, each.direction, "met" if each.met else "missed", each.unit, *map(_number, (each.asked, each.got)))
        for each in d.requirements
    ]
    heads = ("number", "direction", "verdict", "unit", "asked", "got")
    note = (
        "Got by the linear model of the sampled loop about its equilibrium; of a step the largest within the limits."
    )
    return Table(title="Asked and got", heads=heads, rows=rows, words=4, note=note)


def _gains(d: Design) -> Table:
    rows = [(f"law.{name}", _python(values)) for name, values in gains_of(d).items()]
    return Table(title="Gains, by path", heads=("parameter", "value"), rows=rows, words=2)


def _achieved(d: Design) -> Table:
    """One row for each direction and number, one column for each source."""
    on_plant = any(each.on_plant is not None for each in d.achieved)
    rows = []
    for name, unit in NUMBERS.items():
        for each in d.achieved:
            given = [each.designed, each.predicted, each.simulated, *([each.on_plant] if on_plant else [])]
            numbers = [math.nan if one is None else float(getattr(one, name)) for one in given]
            rows.append((name, each.direction, unit, *map(_number, numbers)))
    heads = ["number", "direction", "unit", "designed", "predicted", "simulated", *(["on plant"] if on_plant else [])]
    note = "Designed in continuous time; predicted by the linear model of the sampled loop; simulated in that loop."
    return Table(title="Designed against achieved", heads=heads, rows=rows, words=3, note=note)


def _stiffness(d: Design) -> Table:
    """What a small force at rest shows of a stiffness."""
    rows = [
        (each.direction, each.unit, *map(_number, (each.asked, each.designed, each.predicted, each.simulated)))
        for each in d.stiffness
    ]
    heads = ("direction", "unit", "K by itself", "designed", "predicted", "simulated")
    note = (
        "Designed with all of K: more than K by itself where the arm cannot move along one direction without another."
    )
    return Table(title="Stiffness at rest", heads=heads, rows=rows, words=2, note=note)


def _limits(d: Design) -> Table:
    rows = [
        (
            each.name,
            "kept" if each.ok else "beyond it",
            each.sentence,
            _number(each.value),
            _number(each.limit),
            each.unit,
        )
        for each in d.limits
    ]
    heads = ("limit", "verdict", "in words", "value", "limit", "unit")
    return Table(title="What the gains run into", heads=heads, rows=rows, words=3)


def _poses(d: Design) -> Table:
    rows = [
        (
            str(np.round(pose.q, 4).tolist()),
            "yes" if pose.stable else "no",
            "met" if pose.met else "missed",
            f"{pose.zeta[0]:.4g}",
            f"{pose.zeta[1]:.4g}",
            _number(pose.settling),
        )
        for pose in d.poses
    ]
    heads = ("q [rad | m]", "stable", "asked", "least zeta", "largest zeta", "settling [s]")
    return Table(title="Poses", heads=heads, rows=rows if len(rows) > 1 else [], words=3)


def _number(value: float) -> str:
    return "none" if math.isinf(value) else cell_text(value)


def _python(value: object) -> str:
    """A number or numbers as Python writes them."""
    array = np.asarray(value, dtype=np.float64)
    return f"{float(array):.9g}" if array.ndim == 0 else str(np.round(array, 9).tolist())


def _arm_in_python(arm: Arm) -> str:
    """The call that loads an arm by its name and tool; dots where that gives another one."""
    call = f'taut.load_arm("{arm.name}", tool="{arm.tool}")'
    try:
        apart = differences(arm_json(load_arm(arm.name, tool=arm.tool)), arm_json(arm))
    except TautError:
        return f"...   # your arm '{arm.name}', which taut does not load by its name"
    return f"...   # your arm: {call} has another {', '.join(apart)}" if apart else call


def _again(d: Design) -> str:
    """Lines of Python; what a design does not keep stands as a comment."""
    asked = "".join(f", {what}={_python(value)}" for what, value in d.asked.items())
    at = np.array([pose.q for pose in d.poses])
    return "\n".join(
        [
            "import taut",
            "",
            f"arm = {_arm_in_python(d.arm)}",
            f"law = {law_in_python(repr(d.law))}   # whose gains are replaced",
            f"at = {_python(at if len(at) > 1 else at[0])}",
            f"print(taut.design(law, arm, at=at, rate={d.rate!r}{asked}))",
            "# Give coupled=, friction=, delay=, velocity=, step= and plant= too, where they were given.",
        ]
    )


# -------------------------------------------------------------------- linear loops


def page_of_linear_loop(lin: LinearLoop) -> Page:
    """Poles with what swings in them, margins, the picture, and where it stands."""
    modes = [
        (
            f"{mode.s.real:.6g}" + (f" +- {mode.s.imag:.6g} j" if mode.s.imag else ""),
            ", ".join(f"{name} {100.0 * x:.0f} %" for name, x in mode.participation.items() if x > TELLS),
            cell_text(mode.omega_n),
            cell_text(mode.zeta),
        )
        for mode in lin.modes
    ]
    margins = [
        (
            each.joint,
            f"{each.gain[0]:.4g} to {each.gain[1]:.4g}",
            _number(each.phase),
            _number(1e3 * each.delay),
            cell_text(each.crossover),
        )
        for each in lin.margins.joints
    ]
    low, high = lin.margins.disk.gain
    disk = f"All commands at once: gain {low:.4g} to {high:.4g}, phase {lin.margins.disk.phase:.4g} deg."
    where = f"t = {lin.t:g} s of a run" if lin.t else "an equilibrium"
    return Page(
        title=f"Linear loop of {len(lin.states)} states at {1.0 / lin.dt:g} Hz",
        summary=(
            f"About {where}. The largest pole has modulus {lin.radius:.9g}: the loop is "
            f"{'stable' if lin.stable else 'unstable'}.",
            *(f"{sentence[:1].upper()}{sentence[1:]}." for sentence in lin.sides),
        ),
        tables=(
            Table(
                title="Modes",
                heads=("s [1/s]", "in", "omega_n [rad/s]", "zeta"),
                rows=modes,
                words=2,
                note="s = ln(z) / T of the poles z of the sampled loop.",
            ),
            Table(
                title="Margins of each joint's command",
                heads=("joint", "gain", "phase [deg]", "delay [ms]", "at [rad/s]"),
                rows=margins,
                words=2,
                note=disk,
            ),
        ),
        pictures=(Picture(title="Poles, sensitivity, compliance", figure=lin.plot()),),
        settings={
            "q": _python(lin.q),
            "period": f"{lin.dt:g} s",
            "states": ", ".join(lin.states),
            "inputs": ", ".join(lin.inputs),
            "outputs": ", ".join(lin.outputs),
            **{f"left out: {name}": reason for name, reason in lin.left_out.items()},
        },
        texts={"In words": str(lin)},
        repeat=f"import taut\n\nloop = ...   # the taut.Loop\nprint(taut.linearise(loop, at={_python(lin.q)}))"
        + (f"   # here: along a run, at t = {lin.t:g} s" if lin.t else ""),
    )
