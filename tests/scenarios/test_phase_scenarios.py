"""Tasks in scenarios: [[phases]] with laws, references and guards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.scenarios.run import run_scenario
from taut.scenarios.scenario import built_in_scenarios, load_scenario

TASK = """
[arm]
model = "planar3"

[[phases]]
name = "go"
law = { law = "ComputedTorque", kp = 100, kd = 20 }
reference = { kind = "quintic", q0 = "home", q1 = [0.7, 1.0, 0.6], duration = 0.3 }
until = { elapsed = 0.25, settled = { q = 0.2 }, ticks = 5 }
timeout = 1.0

[[phases]]
name = "stay"
law = { law = "GravityPID", kp = 20, kd = 5 }
until = { contact = 5.0 }
timeout = 0.2
otherwise = "go"
then = "stay"

[plant]
kind = "rigid"
environment = { kind = "push", peak = [10, 0, 0], duration = 0.01 }

[run]
duration = 0.6

[[pass]]
law = "task"
part = "stay"
metric = "peak_error"
joint = "joint1"
max = 0.1
"""


HYBRID = """law = { law = "HybridMotionForce", constraint = { kind = "plane", point = [0, 0, 0.4], normal = [0, 0, 1] }, \
motion = { law = "TaskComputedTorque", kp = 100, kd = 20 } }"""
SOFT = 'law = { law = "TaskComputedTorque", kp = 100, kd = 40 }'
DEEPER = 'reference = { kind = "by", p = [0.0, 0.0, -0.02] }'


def test_a_hybrid_phase_goes_from_where_it_begins_and_presses(tmp_path: Path) -> None:
    text = (
        built_in_scenarios()["touch_and_press"].read_text(encoding="utf-8").replace(SOFT, HYBRID.replace("\\\n", ""))
    )
    law = loaded(text.replace(DEEPER, DEEPER.replace(" }", ", press = 5 }")), tmp_path).laws["task"]
    x = taut.snapshot(arm := taut.load_arm("panda", tool="panda_hand_tcp"), arm.home)
    sample = law.phases["press"].reference(x)
    assert sample.press.tolist() == [5.0]
    np.testing.assert_allclose(sample.p, x.T().p - [0.0, 0.0, 0.02])
    bare = loaded(text, tmp_path).laws["task"].phases["press"].reference(x)
    assert bare.press.tolist() == [0.0]
    line = loaded(
        text.replace(DEEPER, DEEPER.replace(" }", ", duration = 1, F_app = [0, 0, -3, 0, 0, 0] }")), tmp_path
    )
    ahead = line.laws["task"].phases["press"].reference(x)
    assert ahead.duration == 1.0
    assert ahead.at(0.3).F_app.tolist() == [0.0, 0.0, -3.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("hybrid", "more", "path"),
    [
        (False, "press = 5", "phases 2.reference.press"),
        (True, "press = -5", "phases 2.reference.press"),
        (True, "press = 5, lam = [3]", "phases 2.reference.press"),
    ],
)
def test_forces_of_a_phase_that_are_none_are_refused(hybrid: bool, more: str, path: str, tmp_path: Path) -> None:
    text = built_in_scenarios()["touch_and_press"].read_text(encoding="utf-8")
    assert text.count(DEEPER) == 1
    assert text.count(SOFT) == 1
    text = text.replace(DEEPER, DEEPER.replace(" }", f", {more} }}"))
    with pytest.raises(taut.errors.ScenarioError) as caught:
        loaded(text.replace(SOFT, HYBRID.replace("\\\n", "")) if hybrid else text, tmp_path)
    assert caught.value.name == path


MOVING = """
[arm]
model = "panda"
[[phases]]
name = "go"
law = { law = "ComputedTorque", kp = 100, kd = 20 }
reference = { kind = "transition", relative_to_home = true, q = [0.1, 0, 0, 0, 0, 0, 0], velocity = 1, acceleration = 5 }
[plant]
[run]
duration = 0.1
"""
TOOL = (
    ('"ComputedTorque"', '"TaskComputedTorque"'),
    ("q = [0.1, 0, 0, 0, 0, 0, 0], velocity = 1, acceleration = 5", "pose = { p = [0, 0.1, 0] }, duration = 0.8"),
)


@pytest.mark.parametrize("tool", [False, True])
def test_a_transition_begins_with_the_motion_in_which_its_phase_begins(tool: bool, tmp_path: Path) -> None:
    text = MOVING
    for old, new in TOOL if tool else ():
        text = text.replace(old, new)
    arm, v = taut.load_arm("panda"), np.linspace(-0.4, 0.5, 7)
    x = taut.snapshot(arm, arm.home + 0.1, v)
    move = loaded(text, tmp_path).laws["task"].phases["go"].reference(x)
    first, last = move.at(0.0), move.at(move.duration)
    if tool:
        np.testing.assert_allclose(first.p, x.T().p, atol=1e-12)
        np.testing.assert_allclose(first.twist, np.asarray(x.J()) @ v, atol=1e-12)
        np.testing.assert_allclose(last.p - taut.snapshot(arm, arm.home).T().p, [0.0, 0.1, 0.0], atol=1e-12)
    else:
        np.testing.assert_allclose([first.q, first.v], [x.q, v], atol=1e-12)
        np.testing.assert_allclose(last.q - arm.home, [0.1, 0, 0, 0, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        ('law = "ComputedTorque", kp = 100, kd = 20', 'law = "ForceControl"', "phases 1.reference.kind"),
        ("velocity = 1,", "velocity = 0,", "phases 1.reference.velocity"),
        ("velocity = 1,", "speed = 1,", "phases 1.reference.speed"),
        ("velocity = 1,", "", "phases 1.reference"),
        ('"transition"', '"transitoin"', "phases 1.reference.kind"),
        ("q = [0.1, 0, 0, 0, 0, 0, 0],", "", "phases 1.reference.q"),
    ],
)
def test_a_transition_that_is_none_is_refused_by_its_path(old: str, new: str, path: str, tmp_path: Path) -> None:
    assert old in MOVING
    with refused(taut.errors.ScenarioError) as caught:
        loaded(MOVING.replace(old, new), tmp_path)
    assert caught.value.name == path


def loaded(text: str, folder: Path) -> Any:
    file = folder / "mine.toml"
    file.write_text(text)
    return load_scenario(str(file))


def test_a_task_runs_from_a_file_and_has_a_line_for_each_visit_of_a_phase(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(TASK.replace('joint = "joint1"', f'joint = "{taut.load_arm("planar3").joint_names[0]}"'))
    result = run_scenario(load_scenario(str(file)), tmp_path / "out", say=lambda _: None)
    assert result.ok, result.missed
    run = next(iter(result.runs.values()))
    assert [(window.name, window.ended) for window in run.phases] == [
        ("go", "until"),
        ("stay", "timeout"),
        ("go", None),
    ]
    assert run.phases[0].end == pytest.approx(0.255)  # five ticks from 0.25 s on
    assert list(result.json()["metrics"]) == ["task", "go", "stay", "go 2"]


JUMP = """
[arm]
model = "planar2"
[[phases]]
name = "one"
law = { law = "PID", kp = 20, kd = 5 }
reference = { kind = "set-point", relative_to_home = true, q = [0, 0] }
until = { elapsed = 0.05 }
[[phases]]
name = "two"
law = { law = "PID", kp = 20, kd = 5 }
reference = { kind = "set-point", relative_to_home = true, q = [0.1, 0] }
[plant]
kind = "rigid"
[run]
duration = 0.1
[outputs]
columns = ["torque_jump"]
[[pass]]
law = "task"
metric = "torque_jump"
min = 1.9
"""


def test_a_jump_between_two_phases_is_in_the_row_of_the_whole_run(tmp_path: Path) -> None:
    result = run_scenario(loaded(JUMP, tmp_path), tmp_path / "out", say=lambda _: None)
    assert result.ok, result.missed
    values = {row[0]: row[1] for row in result.content().tables[0].rows}
    assert list(values) == ["task", "one", "two"]
    assert values["task"] > 1.9 > 10.0 * max(values["one"], values["two"])


def test_a_phase_of_one_tick_in_the_window_has_no_row(tmp_path: Path) -> None:
    text = JUMP.replace("[outputs]", "[outputs]\nwindow = [0.05, 0.1]")
    result = run_scenario(loaded(text, tmp_path), tmp_path / "out", say=lambda _: None)
    assert next(iter(result.runs.values())).phases[0].end == pytest.approx(0.051)
    table = result.content().tables[0]
    assert table.columns[1:] == ["two"]


def test_a_criterion_is_not_met_by_a_run_that_stopped(tmp_path: Path) -> None:
    text = JUMP.replace("min = 1.9", "max = 100.0").replace(
        'kind = "set-point", relative_to_home = true, q = [0.1, 0] }',
        'kind = "transition", relative_to_home = true, q = [0.1, 0], velocity = 1e-9, acceleration = 5 }',
    )
    moving = text.replace("q = [0, 0] }", "q = [0.5, 0] }")  # the second phase begins faster than its limit
    result = run_scenario(loaded(moving, tmp_path), tmp_path / "out", say=lambda _: None)
    assert [one.outcome.kind for one in result.runs.values()] == ["stopped"]
    assert ["this one stopped" in text for text in result.missed] == [True]
    assert "passed: 0 of 1 pass criteria" in result.content().summary


@pytest.mark.parametrize(
    ("old", "new", "path"),
    [
        ("until = { contact = 5.0 }", "until = { }", "phases 2.until"),
        ("until = { contact = 5.0 }", "until = { force = 5.0 }", "phases 2.until.force"),
        ('otherwise = "go"', 'otherwise = "og"', ""),
        ('otherwise = "go"', 'othrwise = "go"', "phases 2.othrwise"),
        ("timeout = 1.0", "timeout = -1.0", "phases 1.timeout"),
        (
            '{ kind = "quintic"',
            '{ kind = "steady", velocity = [0, 0, 1] }\nxx = { kind = "quintic"',
            "phases 1.reference.kind",
        ),
        ('{ kind = "quintic"', "{ kind = { a = 1 }", "phases 1.reference.kind"),
        ("[[phases]]", '[laws.a]\nlaw = "PID"\nkp = 1\n\n[[phases]]', ""),
        ("ticks = 5", "direction = [0, 0, 1]", "phases 1.until.direction"),
        ('part = "stay"', 'part = "sty"', "pass 1.part"),
        ('law = { law = "GravityPID", kp = 20, kd = 5 }', "", "phases 2.law"),
    ],
)
def test_what_is_wrong_with_a_task_is_refused_by_its_path(old: str, new: str, path: str, tmp_path: Path) -> None:
    assert old in TASK
    with pytest.raises(taut.errors.ScenarioError) as caught:
        loaded(TASK.replace(old, new, 1), tmp_path)
    assert caught.value.name == path
