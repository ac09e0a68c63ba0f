"""The notebooks: one for each section of the chapter; all in this process, and in a kernel as readers run them."""

from __future__ import annotations

import ast
import contextlib
import io
import logging
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from matplotlib.figure import Figure
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "notebooks"
NAMES = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
NUMBER = r"(-?\d+\.?\d*(?:e[+-]?\d+)?)"
pytestmark = pytest.mark.xdist_group("notebooks")  # some need the same run twice


@dataclass
class Done:
    """What a notebook printed and showed."""

    text: str = ""
    shown: list[Any] = field(default_factory=list)


@cache
def execute(name: str, change: str = "", to: str = "") -> Done:
    """The cells of a notebook in one namespace, in this process; some text changed, as a reader would."""
    done, names = Done(), {"__name__": name}
    cells = [cell.source for cell in nbformat.read(FOLDER / f"{name}.ipynb", 4).cells if cell.cell_type == "code"]
    assert not change or sum(change in source for source in cells) == 1
    for source in cells:
        lines = source.replace(change, to).splitlines() if change else source.splitlines()
        tree = ast.parse("\n".join(line for line in lines if not line.startswith("%")))
        last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(compile(tree, name, "exec"), names)
            if last is not None:
                done.shown.append(eval(compile(ast.Expression(last.value), name, "eval"), names))
        done.text += out.getvalue()
    return done


def numbers(text: str, pattern: str) -> list[float]:
    return [float(found) for found in re.findall(pattern.replace("#", NUMBER), text)]


def test_there_is_one_for_each_section() -> None:
    sections = ["10_1", "10_2_1", "10_2_2", "10_2_3", "10_3", "10_4", "10_5", "10_6"]
    assert [next(name for name in NAMES if name.startswith(f"{section}_")) for section in sections] == NAMES


@pytest.mark.part(1)
@pytest.mark.parametrize("name", NAMES)
def test_each_says_what_to_change_runs_and_shows_a_picture(name: str) -> None:
    kept = nbformat.read(FOLDER / f"{name}.ipynb", 4)
    assert any("## What to change" in cell.source for cell in kept.cells if cell.cell_type == "markdown")
    assert not any(cell.get("outputs") for cell in kept.cells)  # nothing old is kept
    assert any(isinstance(value, Figure) for value in execute(name).shown)


@pytest.mark.bars
def test_they_run_in_a_kernel(share: Callable[[int], int]) -> None:
    logging.getLogger("traitlets").setLevel(logging.ERROR)
    client = NotebookClient(nbformat.v4.new_notebook(), timeout=120, kernel_name="python3")
    with client.setup_kernel():  # one for all of them, each with an empty namespace
        for name in NAMES[: share(len(NAMES))]:
            notebook = nbformat.read(FOLDER / f"{name}.ipynb", 4)
            client.nb = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("%reset -f"), *notebook.cells])
            for i, cell in enumerate(client.nb.cells):
                client.execute_cell(cell, i)
            outputs = [output for cell in client.nb.cells for output in cell.get("outputs", [])]
            assert any("image/png" in output.get("data", {}) for output in outputs), name
            assert any(output.get("name") == "stdout" for output in outputs), name


def test_higher_rates_stop_paying() -> None:
    errors = numbers(execute("10_1_servo_rate").text, r"RMS error # mrad")
    assert len(errors) == 6
    assert errors[3] < 0.3 * errors[0]
    assert errors[5] > 0.95 * errors[4]


def test_with_an_exact_model_they_pay_on() -> None:
    errors = numbers(execute("10_1_servo_rate", "model_r = 0.08", "model_r = 0.1").text, r"RMS error # mrad")
    assert errors[5] < 0.25 * errors[3]


def test_an_integral_above_its_bound_never_rests() -> None:
    _, pid = numbers(execute("10_2_1_one_joint", "2.205, 2.0, 1.0", "2.205, 2.0, 10.0").text, r"least # rad")
    assert pid < -1.5


@pytest.mark.long
def test_the_error_of_the_body_leads_aside() -> None:
    straight, body = (
        numbers(execute("10_2_3_task_space", *change).text, r"# mm aside")[0]
        for change in ((), ('error = "decoupled"', 'error = "body"'))
    )
    assert body > 50.0 * straight


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_a_soft_joint_swings_without_damping() -> None:
    text = execute("10_6_other_topics", "2000.0, 5.0", "2000.0, 1.0").text
    assert numbers(text, r"swinging by # rad")[0] > 1.0
    assert numbers(execute("10_6_other_topics").text, r"swinging by # rad")[0] < 1e-6


def test_gravity_leaves_an_error_that_an_integral_takes_away() -> None:
    text = execute("10_2_1_one_joint").text
    pd, pid = numbers(text, r"error in the end # rad")
    assert 2.205 * pd == pytest.approx(0.981 * math.cos(pd), abs=2e-4)
    assert abs(pid) < 1e-3
    assert numbers(text, r"largest ki: #") == [9.261]


def test_computed_torque_follows_best() -> None:
    alone, gravity, both = numbers(execute("10_2_2_several_joints").text, r"largest error +# mrad")
    assert alone > 2.0 * gravity > 100.0 * both


def test_the_tool_arrives() -> None:
    assert numbers(execute("10_2_3_task_space").text, r"# mm are left")[0] < 0.01


def test_the_pole_of_the_force() -> None:
    assert numbers(execute("10_3_force").text, r"pole # 1/s")[0] == pytest.approx(-2.0, rel=0.01)


@pytest.mark.long
def test_motion_and_force_at_once() -> None:
    text = execute("10_4_hybrid").text
    assert "in contact: 3 free motions and 3 free forces" in text
    assert numbers(text, r"force in the end # N")[0] == pytest.approx(10.0, abs=0.01)
    assert numbers(text, r"largest error along the board # mm")[0] < 0.2


@pytest.mark.long
def test_both_kinds_of_control_move_as_equation_10_48() -> None:
    moved = numbers(execute("10_5_impedance").text, r"moves # mm")
    t = np.linspace(0.0, 0.9, 9001)
    force = np.where(t < 0.2, 20.0 * np.sin(np.pi * t / 0.2), 0.0)
    x = v = most = 0.0
    for f in force:  # 2 x'' + 20 x' + 400 x = f, in small steps
        v += 1e-4 * (f - 20.0 * v - 400.0 * x) / 2.0
        x += 1e-4 * v
        most = max(most, x)
    assert moved == pytest.approx([1e3 * most] * 3, rel=0.02)


def test_each_law_makes_something_of_an_unknown_load_and_a_soft_joint_rests() -> None:
    text = execute("10_6_other_topics").text
    computed, *others = numbers(text, r"largest error +# mrad")
    assert computed > 300.0 > 30.0 > max(others)
    trials = numbers(text, r"RMS error +# mrad")
    assert trials[-1] < 0.01 * trials[0]
    assert numbers(text, r"rests at # rad")[0] == pytest.approx(0.5, abs=1e-5)
    sag = 0.981 * math.cos(0.5) / 2000.0
    assert numbers(text, r"winds the spring up by # mrad")[0] == pytest.approx(1e3 * sag, rel=5e-3)
