"""The stories of docs/stories.md in MuJoCo: they pass, what is broken fails, and the page has the figures of the files."""

from __future__ import annotations

import dataclasses
import os
import re
import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from story_names import STORIES

import taut
from taut.base.errors import TautError
from taut.scenarios.references import SamplePolicy
from taut.scenarios.run import ScenarioResult, run_scenario
from taut.scenarios.scenario import Scenario, Trial, built_in_scenarios, load_scenario

WHOLE = bool(os.environ.get("TAUT_BARS"))  # `make bars`
ENDS = ("ur10_led", "ur10_led_drives")  # stories of many frequencies
LONG = (
    "panda_erases",
    "panda_writes",
    "panda_writes_round",
    "panda_polishes",
    "ur10_led",
)  # next to panda_presses, wheel_tool and ur10_led_drives
PAGE = Path(__file__).parents[2] / "docs" / "stories.md"


def without_files(scenario: Scenario) -> Scenario:
    outputs = dataclasses.replace(scenario.outputs, plot=None, video=None, log=None)
    return dataclasses.replace(scenario, outputs=outputs)


def at_its_ends(scenario: Scenario) -> Scenario:
    """The first and the last of its cases; `make bars` runs them all."""
    names = list(scenario.cases)
    kept = {name: scenario.cases[name] for name in (names[0], names[-1])}
    figures = tuple(figure for figure in scenario.figures if figure.case is None or figure.case in kept)
    outputs = dataclasses.replace(scenario.outputs, shown_case=names[0])
    return dataclasses.replace(scenario, cases=kept, figures=figures, outputs=outputs)


@pytest.fixture(scope="session")  # a group's tests are on one worker, and not one after the other
def told(tmp_path_factory: pytest.TempPathFactory) -> Any:
    @cache
    def run(name: str) -> ScenarioResult:
        scenario = without_files(load_scenario(name))
        if name in ENDS and not WHOLE:
            scenario = at_its_ends(scenario)
        return run_scenario(scenario, tmp_path_factory.mktemp(name), say=lambda text: None)

    return run


def marks(name: str) -> list[pytest.MarkDecorator]:
    return [pytest.mark.xdist_group(name), *([pytest.mark.long] if name in LONG else [])]


@pytest.mark.part(1)
@pytest.mark.bars
@pytest.mark.parametrize("name", [pytest.param(name, marks=marks(name)) for name in STORIES])
def test_a_story_reaches_its_pass_figures(name: str, told: Any) -> None:
    result = told(name)
    assert result.missed == []
    assert result.ok


@pytest.mark.parametrize("name", STORIES)
def test_a_story_makes_picture_film_and_log(name: str) -> None:
    outputs = load_scenario(name).outputs
    assert (outputs.plot, outputs.video, outputs.log) == (f"{name}.png", f"{name}.gif", f"{name}.mcap")


def bounds(figure: Mapping[str, Any]) -> str:
    return ", ".join(f"{sign} {figure[key]:g}" for key, sign in (("min", ">="), ("max", "<=")) if key in figure)


@pytest.mark.parametrize("name", STORIES)
def test_the_page_has_the_pass_figures_of_the_file(name: str) -> None:
    figures = tomllib.loads(built_in_scenarios()[name].read_text(encoding="utf-8"))["pass"]
    wanted = [
        " | ".join(["", f"{f.get('case', f.get('part', 'all'))}, {f['law']}", f"`{f['metric']}`", bounds(f)]).strip()
        for f in figures
    ]
    _, _, after = PAGE.read_text(encoding="utf-8").partition(f"## `{name}`\n")
    lines = [line for line in after.partition("\n## ")[0].splitlines() if re.match(r"\| .*`", line)]
    assert [line.rstrip(" |").rpartition(" | ")[0] for line in lines] == wanted


@pytest.mark.xdist_group("two_arms")
def test_the_arm_that_is_not_pushed_rests_and_each_part_has_its_own_metrics(told: Any) -> None:
    run = told("two_arms").runs[Trial("", "both")]
    left, right = run.part("left"), run.part("right")
    assert left.n == right.n == 7
    assert not set(left.joint_names) & set(right.joint_names)
    assert np.abs(right.v).max() < 1e-9
    assert np.isnan(right.metrics.peak_force)
    assert left.metrics.peak_force == pytest.approx(np.linalg.norm([8.0, 8.0, 5.0]), rel=1e-3)
    assert np.isnan(run.metrics.task_rms)


@pytest.mark.xdist_group("two_arms")
def test_a_run_has_parts_only_of_laws_side_by_side(told: Any) -> None:
    arm = taut.load_arm("one_joint")
    alone = taut.run(taut.compile(taut.laws.PID(kp=1.0), arm), taut.RigidPlant(arm), duration=0.01)
    with refused(TautError):
        alone.part("left")
    with refused(TautError):
        told("two_arms").runs[Trial("", "both")].part("lift")


@pytest.mark.long
@pytest.mark.xdist_group("xarm7_directions")
def test_deflections_are_as_one_to_the_stiffness(told: Any) -> None:
    runs = told("xarm7_directions").runs
    ways = [runs[Trial(f"along tool {axis}", "impedance")].metrics.task_final for axis in "xyz"]
    assert np.array(ways) / ways[2] == pytest.approx([4.0, 2.0, 1.0], rel=0.01)


@pytest.mark.long
@pytest.mark.xdist_group("cabinet_door")
def test_the_real_door_is_open_by_60_degrees_and_a_motion_alone_would_jam_it(told: Any) -> None:
    plant = told("cabinet_door").scenario.experiment.plant
    assert np.rad2deg(abs(plant.data.joint("door").qpos[0])) > 60.0
    story = load_scenario("cabinet_door").experiment
    ctrl = taut.compile(taut.laws.TaskComputedTorque(kp=900.0, kd=60.0), story.arm, rate=250.0)
    way: Any = story.reference
    out = taut.run(ctrl, story.plant, way.motion, duration=6.0)
    assert out.metrics.force_rms > 50.0


@pytest.mark.long
@pytest.mark.xdist_group("two_arms_bar")
def test_the_bar_itself_is_turned_and_squeezed_along_its_axis(told: Any) -> None:
    result = told("two_arms_bar")
    run, data = result.runs[Trial("", "hybrid")], result.scenario.experiment.plant.data
    turn = np.deg2rad(40.0)
    middle = data.body("bar").xpos + data.body("bar").xmat.reshape(3, 3) @ [0.0, -0.25, 0.0]
    assert np.abs(middle - [0.6, 0.0, 0.1]).max() < 0.002
    assert data.body("bar").xmat.reshape(3, 3)[:, 1] == pytest.approx([-np.sin(turn), np.cos(turn), 0.0], abs=0.004)
    along = np.sum(np.asarray(run.extra["F_ext"])[500:, :3] * run.task.R[500:, :, 1], axis=1)
    assert np.sqrt(np.mean((along - 20.0) ** 2)) < 0.1


@pytest.mark.long
@pytest.mark.xdist_group("wheel_tool")
def test_the_wheel_rolls_along_the_curve_by_friction_alone(told: Any) -> None:
    data = told("wheel_tool").scenario.experiment.plant.data
    x = np.linspace(0.0, 0.3, 10_001)
    y = 0.03 * (1.0 - np.cos(2.0 * np.pi * x / 0.3))
    length = np.hypot(np.diff(x), np.diff(y)).sum()
    assert 0.02 * abs(data.joint("axle").qpos[0]) == pytest.approx(length, abs=2e-3)


@pytest.mark.long
@pytest.mark.xdist_group("policy_10hz")
def test_a_blended_reference_is_that_of_the_chunk_when_the_next_one_comes(told: Any) -> None:
    runs = told("policy_10hz").runs
    blended, bare = (np.asarray(runs[Trial(case, "impedance")].reference.p) for case in ("blended", "not blended"))
    apart = np.abs(blended - bare).max(axis=1)
    assert 2e-3 < apart.max() < 0.02
    assert apart[99::100].max() < 1e-5


@pytest.mark.long
@pytest.mark.xdist_group("xarm7_directions")
def test_each_push_moves_the_tool_along_itself(told: Any) -> None:
    for i, axis in enumerate("xyz"):
        run = told("xarm7_directions").runs[Trial(f"along tool {axis}", "impedance")]
        moved = -run.task.position_error[-1]
        assert moved / np.linalg.norm(moved) == pytest.approx(run.task.R[0, :, i], abs=0.01)


# -------------------------------------------------------------------- another law, arm or seed: nothing is tuned


def changed(tmp_path: Path, name: str, *changes: tuple[str, str]) -> ScenarioResult:
    text = built_in_scenarios()[name].read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / f"{name}.toml"
    file.write_text(text, encoding="utf-8")
    return run_scenario(without_files(load_scenario(str(file))), tmp_path, say=lambda text: None)


@pytest.mark.long
def test_a_policy_of_another_seed_is_followed_as_well(tmp_path: Path) -> None:
    assert changed(tmp_path, "policy_10hz", ("seed = 1", "seed = 11"), ("duration = 5.0", "duration = 2.0")).ok


SHORT = (("duration = 3.5", "duration = 1.3"), ("t = 1.5", "t = 0.8"), ("t = 2.5", "t = 1.0"))


@pytest.mark.long
def test_another_arm_gives_way_as_well(tmp_path: Path) -> None:
    assert changed(tmp_path, "panda_pushed", ('model = "panda"', 'model = "xarm7"'), *SHORT).ok


@pytest.mark.long
def test_with_friction_the_tool_does_not_go_where_the_equation_says(tmp_path: Path) -> None:
    friction = ('friction = "none" ', "friction = { coulomb = 1.0 } ")
    missed = changed(tmp_path, "panda_pushed", friction, *SHORT).missed
    assert sum("impedance_error must be <= 5" in text for text in missed) == 2


def test_a_policy_is_the_same_at_the_same_time() -> None:
    arm = taut.load_arm("panda")
    x = taut.snapshot(arm, arm.home)
    policy = SamplePolicy(T=x.T(), seed=3)
    assert np.array_equal(policy(x).at(0.25).p, SamplePolicy(T=x.T(), seed=3)(x).at(0.25).p)
    assert not np.array_equal(policy(x).at(0.25).p, SamplePolicy(T=x.T(), seed=4)(x).at(0.25).p)
    assert policy(x).at(0.0).p == pytest.approx(x.T().p, abs=1e-12)


MISUSE = {
    'part = "left"': 'part = "lift"',
    '[laws."both".right]\nlaw': '[laws."both".right]\njoints = [1]\nlaw',
    'tool = "right_gripper"\n': "",
}


@pytest.mark.parametrize("old", MISUSE)
def test_laws_side_by_side_are_refused_in_words(old: str, tmp_path: Path) -> None:
    new = MISUSE[old]
    with refused(TautError):
        changed(tmp_path, "two_arms", (old, new))


POLICY = {
    "ahead = 4": "ahead = 0",
    "size = [0.06, 0.15]": "size = [0.06]",
    "disagreement = [0.002, 0.005]": "disagreement = [-0.002, 0.005]",
    "period = 0.1": "period = 0.0",
    'metric = "task_rms"': 'metric = "task_rms"\npart = "left"',
}


@pytest.mark.parametrize("old", POLICY)
def test_policies_are_refused_in_words(old: str, tmp_path: Path) -> None:
    new = POLICY[old]
    with refused(TautError):
        changed(tmp_path, "policy_10hz", (old, new))


# -------------------------------------------------------------------- contact


@pytest.mark.long
@pytest.mark.xdist_group("panda_erases")
def test_the_phases_of_a_story_tell_what_is_their_own(told: Any) -> None:
    """What the law of another phase remembered, such as an estimate, is not what this one took for true."""
    run = told("panda_erases").runs[Trial("", "task")]
    lying, erasing = run.phase("lie_down"), run.phase("erase")
    assert "law.lie_down.normal" in lying.extra
    assert "law.lie_down.normal" not in erasing.extra
    assert erasing.metrics.normal_error < 1.0 < lying.metrics.normal_error
    assert np.isnan(run.phase("approach").metrics.normal_error)


@pytest.mark.long
@pytest.mark.xdist_group("panda_writes")
def test_what_sticks_is_held_by_friction_within_its_cone(told: Any) -> None:
    stuck = told("panda_writes").runs[Trial("", "task")].phase("stick")
    x, y, z = stuck.extra["F_ext"][-1, :3]
    assert (x, z) == pytest.approx((-2.5, 10.0), abs=0.05)
    assert np.hypot(x, y) < 0.4 * z
    assert np.linalg.norm(stuck.task.twist[-1, :3]) < 1e-3


@pytest.mark.long
@pytest.mark.xdist_group("panda_writes_round")
def test_a_round_surface_is_written_on_at_its_speed(told: Any) -> None:
    wrote = told("panda_writes_round").runs[Trial("", "task")].phase("write")
    speed = np.linalg.norm(wrote.task.twist[:, :3], axis=1)
    assert np.median(speed[400:800]) == pytest.approx(0.2, rel=0.01)
    assert np.ptp(wrote.task.p[:, 2]) > 0.08


@pytest.mark.long
@pytest.mark.xdist_group("panda_polishes")
def test_a_surface_that_is_polished_goes_to_and_fro(told: Any) -> None:
    polished = told("panda_polishes").runs[Trial("", "task")].phase("polish").between(0.7, 4.1)
    assert np.abs(polished.task.twist[:, 2]).max() == pytest.approx(0.1, rel=0.05)
