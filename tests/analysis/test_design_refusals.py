"""What a design refuses, and steps that are too large for the limits of the joints."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import taut

laws = taut.laws
PAIR = (1e4, 200.0)


@pytest.mark.parametrize(
    ("law", "name", "asked"),
    [
        (laws.PID, "one_joint", {"zeta": 1.0, "omega_n": 3000.0}),
        (laws.ComputedTorque, "planar2", {"zeta": 0.1, "bandwidth": 900.0}),
        (laws.GravityPID, "planar2", {"zeta": 0.7, "settling": 0.002}),
        (laws.GravityPID, "planar2", {"K": 1e6, "settling": 0.01}),  # K stood, and no slower design was stable
        (laws.PID, "planar2", {"zeta": 0.7, "omega_n": 20.0, "integral": 0.99}),  # as above: ki is in the way
        (laws.VelocityPI, "gantry3", {"zeta": 0.7, "omega_n": 5000.0}),
        (laws.TaskVelocity, "gantry3", {"settling": 0.0005}),
        (laws.Impedance, "planar2", {"zeta": 0.7, "K": (1e7, 1e5)}),
        (laws.ForceControl, "gantry3", {"zeta": 0.7, "contact": PAIR, "force": 500.0}),
        (laws.GravityCompensation, "gantry3", {"bandwidth": 5000.0}),
    ],
)
def test_what_is_not_stable_is_refused_with_what_is_in_the_way(law: Any, name: str, asked: dict[str, Any]) -> None:
    arm = taut.load_arm(name)
    where = [0.3, 0.8] if name == "planar2" else arm.home
    with pytest.raises(taut.errors.RangeError, match=r"cannot be met: at 1000 Hz ") as refused:
        taut.design(law, arm, at=where, **asked)
    assert refused.value.value is not None
    assert refused.value.value > 1.0
    assert "nearest" not in str(refused.value)
    assert "up to" not in str(refused.value)


@pytest.mark.parametrize(
    ("law", "asked"),
    [
        (laws.ForceControl, {"zeta": 0.7, "contact": PAIR, "force": 5.0, "step": (5000.0, 500.0)}),  # KeyError: 'K'
        (laws.Impedance, {"zeta": 0.7, "K": (2000.0, 50.0), "step": (3.0, 0.5)}),
        (laws.VelocityPI, {"bandwidth": 5.0, "step": 100.0}),  # rad/s were compared with N m
    ],
)
def test_the_largest_step_is_met_and_a_larger_one_is_missed(law: Any, asked: dict[str, Any]) -> None:
    arm = taut.load_arm("gantry3").with_joints(velocity=1.0)
    d = taut.design(law, arm, **asked)
    rows = [each for each in d.requirements if each.name == "step"]
    assert not d.met
    assert any(not row.met for row in rows)
    by_unit = {unit: min(row.got for row in rows if row.unit == unit) for unit in {row.unit for row in rows}}
    step = [0.999 * by_unit.get(unit, by_unit.get("N m", 1.0)) for unit in ("m", "rad")]
    if law is laws.ForceControl:
        step = [0.999 * by_unit["N"], 500.0]
    d = taut.design(law, arm, **asked | {"step": step})
    limit = d.limit("speed" if law is laws.VelocityPI else "torque")
    assert limit.ok
    assert all(row.met for row in d.requirements if row.name == "step")
    assert limit.value / limit.limit == pytest.approx(0.999, abs=0.005)


def test_a_step_of_drives_is_one_of_speed() -> None:
    arm = taut.load_arm("gantry3").with_joints(velocity=1.0)
    d = taut.design(laws.VelocityPI, arm, bandwidth=5.0, step=1.0)
    assert [row.got for row in d.requirements if row.name == "step"] == pytest.approx([0.2] * 3, rel=1e-2)
    assert d.limit("speed").value == pytest.approx(5.0, rel=1e-2)


def test_bounds_of_friction_hold_for_every_joint() -> None:
    arm = taut.load_arm("planar2").with_joints(viscous=[0.3, 0.6]).with_gravity([0.0, 0.0, 0.0])
    for law, asked in (
        (laws.PID, {"zeta": 0.001, "omega_n": 0.3}),
        (laws.PID, {"zeta": 0.001, "K": 0.02}),
        (laws.GravityCompensation, {"bandwidth": 0.01}),
        (laws.GravityCompensation, {"settling": 1e3}),
    ):
        with pytest.raises(taut.errors.RangeError, match="friction of joint 'joint2' alone") as refused:
            taut.design(law, arm, at=[0.3, 0.8], friction="arm", rate=100.0, **asked)
        name, bound = re.findall(r"^(\w+) must be at (?:least|most) ([\d.]+)", str(refused.value))[0]
        taut.design(law, arm, at=[0.3, 0.8], friction="arm", rate=100.0, **asked | {name: float(bound)})


@pytest.mark.parametrize(
    ("law", "asked", "words"),
    [
        (laws.PID, {"zeta": 0.7, "K": 0.0}, r"K\[0\] .* must be > 0"),
        (laws.ComputedTorque, {"zeta": 0.7, "K": 0.0}, r"K\[0\] .* must be > 0"),
        (laws.Stiffness, {"zeta": 0.7, "K": (0.0, 0.0)}, "K of Stiffness must be > 0 in some direction"),
        (laws.ForceControl, {"zeta": 0.7, "force": 5.0, "contact": (1e4, 0.0)}, "stiff in every direction"),
        (laws.ForceControl, {"zeta": 0.7, "force": 0.0, "contact": PAIR}, "force must be > 0"),
        (laws.ForceControl(kdamp=(50.0, 5.0)), {"force": 5.0}, "needs contact, the stiffness of what is pressed on"),
        (laws.GravityCompensation, {"bandwidth": 5.0, "step": 0.1}, "step has no meaning for GravityCompensation"),
        (laws.TaskVelocity, {"bandwidth": 5.0, "step": 0.1}, r"step needs one number in m and one in rad"),
    ],
)
def test_what_has_no_meaning_is_a_sentence(law: Any, asked: dict[str, Any], words: str) -> None:
    with pytest.raises(taut.TautError, match=words):
        taut.design(law, taut.load_arm("ur10"), **asked)


def test_damping_that_a_law_of_force_has_is_tried_on_the_contact() -> None:
    """It was asked for zeta, or, without a contact, refused for a force that integrates in the air."""
    arm = taut.load_arm("gantry3")
    m = np.sort(np.diag(np.asarray(taut.snapshot(arm, arm.home).M)))[::-1]
    d = taut.design(laws.ForceControl(kdamp=(800.0, 5.0)), arm, force=5.0, contact=(1e4, 100.0))
    for each, mass in zip(d.achieved, m, strict=True):
        roots = np.roots([mass, 800.0, 1e4, 5.0 * 1e4])
        pair = roots[np.abs(roots.imag) > 0][0]
        assert each.designed.zeta == pytest.approx(-pair.real / abs(pair), rel=1e-9)
        assert each.simulated.zeta == pytest.approx(each.predicted.zeta, rel=0.005)
