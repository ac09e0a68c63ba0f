"""Run: what it says of itself, and a stretch of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut


def test_a_run_says_what_it_is(noisy_run: taut.Run) -> None:
    assert repr(noisy_run) == "Run(250 ticks, 0.249 s, 3 joints, completed)"
    assert len(noisy_run) == 250
    assert noisy_run.n == 3
    assert noisy_run.effort_units == ("N m", "N", "N m")


@pytest.mark.parametrize(
    ("kind", "units"), [("torque", ("N m", "N")), ("velocity", ("rad/s", "m/s")), ("position", ("rad", "m"))]
)
def test_a_command_has_the_unit_of_its_kind(make_run: Any, kind: str, units: tuple[str, str]) -> None:
    assert make_run([0.0], [[0.0, 0.0]], kind=kind, units=("rad", "m")).command_units == units


def test_a_stretch_of_a_run_has_its_ticks_and_metrics(noisy_run: taut.Run) -> None:
    part = noisy_run.between(0.1, 0.2)
    assert len(part) == 101
    assert (part.t[0], part.t[-1]) == (noisy_run.t[100], noisy_run.t[200])
    for name, values in noisy_run.arrays().items():
        np.testing.assert_array_equal(part.arrays()[name], values[100:201])
    assert part.metrics.duration == pytest.approx(0.1)
    assert noisy_run.error is not None
    np.testing.assert_array_equal(part.metrics.final_error, noisy_run.error[200])


def test_a_stretch_without_ticks_is_refused(noisy_run: taut.Run, make_run: Any) -> None:
    for start, end in ((0.2, 0.1), (5.0, 6.0), (0.1, 0.1)):
        with refused(taut.errors.RangeError):
            noisy_run.between(start, end)
    with refused(taut.errors.RangeError):
        make_run([], np.zeros((0, 1))).between(0.0, 1.0)
    with refused(taut.errors.RangeError):
        noisy_run.between(np.nan, 1.0)


def test_a_run_says_the_gains_that_it_was_run_with(tmp_path: Path) -> None:
    """Not those that the law was compiled with: in the record, in the title of its plot, and in its log."""
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(taut.laws.GravityPID(kp=10.0, kd=1.0) + taut.laws.FrictionCompensation(), arm)
    ctrl.parameters["law.GravityPID.kp"] = 900.0
    loop = taut.Loop(ctrl, taut.RigidPlant(arm), taut.hold(), duration=0.1)
    loop.parameters["law.GravityPID.kd"] = 30.0
    plants = [taut.RigidPlant(arm), taut.MujocoPlant(arm)]
    for run in [*(taut.run(ctrl, plant, taut.hold(), duration=0.1) for plant in plants), taut.run(loop)]:
        kd = "30.0" if run.info.parameters["law.GravityPID.kd"] == 30.0 else "1.0"
        words = f"GravityPID(kp=900.0, kd={kd}) + FrictionCompensation()"
        assert run.info.law == words
        assert run.info.parameters["law.GravityPID.kp"] == 900.0
        assert "GravityPID(kp=900, kd=" in run.plot().get_suptitle()
        assert taut.load_run(run.save(tmp_path / "run.mcap")).info.law == words
