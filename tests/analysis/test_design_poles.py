"""What a design tells of the slow poles of a force, of drives under an admittance, and of the weight's gradient."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import taut
from taut.analysis.design.words import gains_of

laws = taut.laws
POSE = [0.2, -1.2, 1.5, -1.0, 0.8, 0.3]


@pytest.mark.parametrize("velocity", ["measured", taut.sensors.Difference()], ids=str)
def test_the_pole_of_a_force_is_the_slowest_of_its_loop_on_an_arm_that_turns(velocity: Any) -> None:
    """A fit without the first tick knew too little of the sensor: 0.48 1/s of 5.33 were told, with a warning."""
    d = taut.design(
        laws.ForceControl, taut.load_arm("ur5"), at=POSE, force=5.0, zeta=0.7, contact=(1e4, 200.0), velocity=velocity
    )
    slowest = -max(mode.s.real for mode in d.tried.lin.modes)
    limit = d.limit("force pole")
    assert limit.value == pytest.approx(slowest, rel=1e-3)
    assert limit.ok
    assert all(np.abs(r.poles).min() > 0.99 * slowest for r in d.responses)  # simulated, they are the same


def test_an_admittance_on_drives_of_velocity_swings_as_its_mass_does() -> None:
    """It was fitted with one state, the error, and had zeta = 1 and omega_n = 4.7 beside 4.6 % of overshoot."""
    law = laws.Admittance(D=(1, 1), B=(1, 1), inner=laws.TaskVelocity(kp=50.0))
    d = taut.design(law, taut.load_arm("ur5"), at=POSE, K=(500.0, 20.0), D=(5.0, 0.1), zeta=0.7)
    for each, swing in zip(d.achieved, [10.0] * 3 + [200.0**0.5] * 3, strict=True):
        for seen in (each.predicted, each.simulated):
            assert seen.zeta == pytest.approx(0.7, rel=0.01)
            assert seen.omega_n == pytest.approx(swing, rel=0.01)
    assert d.limit("damping").ok


def fed() -> Any:
    return laws.FeedForward() + laws.PID(kp=1.0, kd=1.0)


def test_the_weights_gradient_is_in_what_is_designed_with_feedforward() -> None:
    """The servo rate was blamed for it: 0.941 "where the book has 0.8647", 0.334 s of 0.429 s."""
    d = taut.design(fed(), taut.load_arm("planar2"), zeta=1.0, omega_n=15.0)
    for each in d.achieved:
        assert each.designed.zeta == pytest.approx(each.predicted.zeta, rel=0.01)
        assert each.designed.settling == pytest.approx(each.predicted.settling, rel=0.01)
    weight = d.limit("weight")
    assert weight.value == pytest.approx(0.837, abs=0.001)  # of kp
    assert weight.ok
    assert "dg/dq adds to kp, and makes 0.837 of it" in weight.sentence
    assert "GravityPID with coupled=True makes" in d.limit("coupling").sentence  # a sum takes no coupled=True


def test_what_falls_over_is_refused_with_its_cause() -> None:
    """It said that no slower design can either, and to raise the rate, which has nothing to do with it."""
    arm = taut.load_arm("one_joint")
    up = [np.pi / 2.0 + 0.3] if abs(taut.snapshot(arm, [0.0]).g[0]) > 0.1 else [np.pi + 0.3]
    M, dt = float(taut.snapshot(arm, up).M[0, 0]), 1e-5
    falls = float(taut.snapshot(arm, np.add(up, dt)).g[0] - taut.snapshot(arm, np.subtract(up, dt)).g[0]) / (2.0 * dt)
    border = float(np.sqrt(-falls / M))  # M omega_n^2 = -dg/dq
    with pytest.raises(
        taut.errors.RangeError, match=r"the weight's gradient dg/dq takes more off kp than it has"
    ) as refused:
        taut.design(fed(), arm, at=up, zeta=1.0, omega_n=0.98 * border)
    assert "higher rate" not in str(refused.value)
    assert taut.design(fed(), arm, at=up, zeta=1.0, omega_n=1.02 * border).tried.lin.stable


def test_a_bandwidth_that_is_too_small_is_told_the_least() -> None:
    arm = taut.load_arm("planar2")
    with pytest.raises(
        taut.errors.RangeError, match=r"must be more than 0\.0005 omega_n = 0\.0015 rad/s.*; got 0\.0001"
    ):
        taut.design(laws.PID, arm, omega_n=3.0, bandwidth=1e-4)
    with pytest.raises(taut.errors.RangeError, match=r"must be at most 1\.554 omega_n = 4\.661 rad/s.*; got 9"):
        taut.design(laws.PID, arm, omega_n=3.0, bandwidth=9.0)


def test_the_picture_names_its_dashed_curves_once_and_no_gain_of_motion_that_is_not_free() -> None:
    d = taut.design(laws.Impedance, taut.load_arm("planar2"), at=[0.3, 0.8], K=(500.0, 20.0), zeta=0.7)
    names = [text.get_text() for text in d.plot().axes[0].get_legend().get_texts()]
    assert names == [*(each.direction for each in d.achieved), "designed"]
    assert "null.kp" in d.law.parameters()
    assert not any("null" in name for name in d.json()["gains"])
    assert not any("null" in row[0] for table in d.report_page().tables for row in table.rows)
    assert "null.kp" in gains_of(dataclasses.replace(d, arm=taut.load_arm("panda")))
