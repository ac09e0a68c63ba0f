"""The story of a wrong constraint: a board that is 10 degrees off the law's model, and what is done about it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.errors import RangeError, ScenarioError, ShapeError, UsageError
from taut.scenarios.run import run_scenario
from taut.scenarios.scenario import built_in_scenarios, load_scenario

TITLE = "wrong_board"


@pytest.mark.long
def test_each_remedy_reaches_its_pass_figures(tmp_path: Path) -> None:
    result = run_scenario(load_scenario(TITLE), tmp_path, say=lambda _: None)
    assert result.ok, result.missed


def pressed(tip: taut.environments.SpringTip | None) -> tuple[taut.Run, np.ndarray]:
    """A Panda that lands on a slanted plate and presses, and the plate's normal."""
    arm = taut.load_arm("panda")
    T, n = taut.snapshot(arm, arm.home).T(), np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    centre = T.p - 0.015 * n - np.array([0.0, 0.0, 0.002])
    plate = (
        f'<geom type="box" size="0.1 0.1 0.01" euler="0 {0.1} 0" pos="{centre[0]} {centre[1]} {centre[2]}" '
        'friction="0.5" priority="1" solref="0.005 1" solimp="0 0.9 0.002 0.5 1"/>'
    )
    plant = taut.MujocoPlant(
        arm,
        scene=f'<mujoco><compiler angle="radian"/><worldbody>{plate}</worldbody></mujoco>',
        tool_radius=0.005,
        friction=None,
        tip=tip,
    )
    law = taut.laws.HybridMotionForce(
        constraint=taut.Constraint.plane(point=T.p, normal=[0, 0, 1]),
        motion=taut.laws.TaskComputedTorque(kp=400.0, kd=40.0),
        kfi=5.0,
        kdamp=150.0,
    )
    ref = taut.pressing(taut.TaskMotion(pose=T), 10.0)
    return taut.run(taut.compile(law, arm), plant, ref, duration=1.5), n


@pytest.mark.long
def test_a_spring_tip_takes_the_impact_and_gives_way_by_the_force_over_its_stiffness() -> None:
    stiff, n = pressed(None)
    soft, _ = pressed(taut.environments.SpringTip(stiffness=1000.0))
    told = {name: out.extra["contact.normal_force"] for name, out in (("stiff", stiff), ("soft", soft))}
    for force in told.values():
        assert np.allclose(np.cross(force[-1], n), 0.0, atol=1e-6)
    assert np.linalg.norm(told["soft"], axis=1).max() < 0.6 * np.linalg.norm(told["stiff"], axis=1).max()
    # At rest: the force along the tool's axis, z, less the tip's own weight, over the stiffness. The slope counts what
    # the two rest apart along the plate. A light tip is deeper in the plate: solref is a stiffness per mass, 0.6 mm.
    apart = stiff.task.p[-1] - soft.task.p[-1]
    sunk, weight = (n @ apart) / n[2], 0.02 * 9.81
    assert np.isclose(sunk, (soft.extra["F_ext"][-1, 2] - weight) / 1000.0, atol=7e-4)
    assert soft.metrics.peak_normal_force == pytest.approx(np.linalg.norm(told["soft"], axis=1).max())
    error = 10.0 - np.linalg.norm(told["soft"], axis=1)
    assert soft.metrics.normal_force_error_rms == pytest.approx(np.sqrt(np.mean(error**2)))
    assert soft.metrics.path_error_peak < 0.02
    assert np.isnan(soft.metrics.normal_error)


def test_the_tips_of_a_scenario_and_its_press_are_read() -> None:
    cases = load_scenario(TITLE).cases
    plant = cases["compliant tool"].experiment.plant
    assert isinstance(plant, taut.MujocoPlant)
    joint = plant.model.joint("tip")
    assert joint.stiffness == [1000.0]
    assert joint.type == mujoco.mjtJoint.mjJNT_SLIDE
    law = cases["estimate of the normal"].laws["hybrid"]
    assert isinstance(law, taut.laws.NormalEstimate)
    assert isinstance(law.law, taut.laws.HybridMotionForce)
    sample = cases["low gains"].experiment.reference.at(1.0)  # type: ignore[union-attr]
    assert isinstance(sample, taut.trajectories.HybridMotion)
    assert sample.press.tolist() == [10.0]


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("press = 10.0", "press = -1.0"),
        ("press = 10.0", ""),
        ("stiffness = 1000", "stiffness = 0"),
        ("stiffness = 1000, ", ""),
    ],
)
def test_what_is_wrong_in_it_is_said(tmp_path: Path, old: str, new: str) -> None:
    source = built_in_scenarios()[TITLE]
    (tmp_path / "tilted_board.xml").write_text(source.with_name("tilted_board.xml").read_text())
    changed = source.read_text()
    assert old in changed
    file = tmp_path / "case.toml"
    file.write_text(changed.replace(old, new))
    with refused(ScenarioError):
        load_scenario(str(file))


def test_rows_of_a_pressing_motion_are_its_samples() -> None:
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    way = taut.trajectories.Line(T0=T, T1=taut.Pose.of(T.R, T.p + np.array([0.1, 0.0, 0.0])), duration=1.0)
    for press in (10.0, lambda t: 5.0 + t):
        made, times = taut.pressing(way, press), np.array([0.0, 0.3, 1.2])
        rows = made.rows(times)  # type: ignore[union-attr, misc]
        for name in type(rows).fields(7):
            one_by_one = np.stack([getattr(made.at(float(t)), name) for t in times])  # type: ignore[union-attr]
            assert np.array_equal(getattr(rows, name), one_by_one), name


def test_tips_that_are_none_are_refused() -> None:
    arm = taut.load_arm("panda")
    with refused(UsageError):
        taut.MujocoPlant(arm, tip=1000.0)  # type: ignore[arg-type]
    with refused(RangeError):
        taut.environments.SpringTip(stiffness=1.0, travel=-1.0)
    with refused(ShapeError):
        taut.environments.SpringTip(stiffness=[1.0, 2.0])
