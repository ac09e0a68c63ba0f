"""Gears: reflected inertia, inertia matching, gears of some joints only, and units that cannot be right."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import taut
from taut.arm.report import check_model
from taut.arm.rules import rotor_doubts
from taut.arm.servo import matched_ratio, reflected_inertia
from taut.errors import RangeError, ShapeError, UnknownNameError

ROTOR = 2e-5  # [kg m^2] of a motor of 100 W


class TestTheChaptersNumbers:
    """Section 10.2.1.5: I_link = 1 kg m^2, I_motor = 1e-3 kg m^2."""

    def test_in_direct_drive_nearly_all_of_the_inertia_is_the_links(self) -> None:
        assert 1.0 / (1.0 + reflected_inertia(1.0, 1e-3)) == pytest.approx(0.999, abs=1e-6)

    def test_behind_a_gear_of_100_the_rotor_is_ten_times_the_link(self) -> None:
        assert reflected_inertia(100.0, 1e-3) == pytest.approx(10.0)

    def test_the_matched_ratio_halves_the_torque_and_accelerates_most(self) -> None:
        G = matched_ratio(1.0, 1e-3)
        assert reflected_inertia(G, 1e-3) == pytest.approx(1.0)
        a = [g / (1.0 + reflected_inertia(g, 1e-3)) for g in (G / 1.001, G, G * 1.001)]
        assert a[1] > max(a[0], a[2])


def test_the_share_of_the_rotors_is_that_of_the_mass_matrix() -> None:
    arm = taut.load_arm("planar2").with_gears([50.0, 100.0], [2e-4, 1e-5])
    for q in ([0.0, 0.0], [0.3, 2.0]):
        M = taut.snapshot(arm, q).M
        without = taut.snapshot(arm.with_joints(rotor_inertia=0.0), q).M
        np.testing.assert_allclose(taut.drives.rotor_share(arm, q), 1.0 - np.diag(without) / np.diag(M), rtol=1e-12)
    np.testing.assert_array_equal(taut.drives.rotor_share(arm), taut.drives.rotor_share(arm, arm.home))


def test_only_an_arm_has_rotors() -> None:
    with refused(taut.errors.UsageError):
        taut.drives.rotor_share("panda")  # type: ignore[arg-type]


def test_a_matched_gear_has_half_of_the_inertia() -> None:
    arm = taut.load_arm("one_joint")
    link = float(taut.snapshot(arm, [0.0]).M[0, 0])
    geared = arm.with_gears(matched_ratio(link, 1e-4), 1e-4)
    assert taut.drives.rotor_share(geared).tolist() == pytest.approx([0.5])


class TestGearsOfSomeJoints:
    def test_only_the_joints_that_are_named_change(self) -> None:
        arm = taut.load_arm("planar3").with_gears(30.0, ROTOR)
        for ratio, rotor in (
            ({"joint2": 80.0}, 1e-5),
            ({"joint2": 80.0}, [3e-5, 1e-5, 2e-5]),
        ):
            changed = arm.with_gears(ratio, rotor)
            assert changed.gear.tolist() == [30.0, 80.0, 30.0]
            np.testing.assert_allclose(changed.rotor_inertia, [900.0 * ROTOR, 0.064, 900.0 * ROTOR])

    def test_a_joint_must_be_there(self) -> None:
        with refused(UnknownNameError):
            taut.load_arm("planar3").with_gears({"joint9": 10.0}, ROTOR)


class TestWhatIsRefused:
    @pytest.mark.parametrize("ratio", [0.0, -10.0])
    def test_a_ratio_is_above_zero(self, ratio: float) -> None:
        with refused(RangeError):
            reflected_inertia(ratio, ROTOR)
        with refused(RangeError):
            taut.load_arm("planar2").with_gears({"joint2": ratio}, ROTOR)

    def test_an_inertia_is_not_negative(self) -> None:
        with refused(RangeError):
            reflected_inertia(10.0, -1e-5)
        with refused(RangeError):
            taut.load_arm("planar2").with_gears(10.0, [-1e-5, 1e-5])

    def test_matching_needs_both_inertias(self) -> None:
        with refused(RangeError):
            matched_ratio(1.0, 0.0)
        with refused(RangeError):
            matched_ratio(-1.0, 1e-3)

    def test_what_is_no_number(self) -> None:
        with refused(RangeError):
            reflected_inertia(math.nan, 1e-3)
        with refused(ShapeError):
            reflected_inertia([1.0, 2.0], 1e-3)  # type: ignore[arg-type]


class TestDoubts:
    """A wrong unit is off by 1e4 (kg cm^2), 1e6 (kg mm^2) or 1e7 (g cm^2)."""

    @pytest.mark.parametrize("factor", [1e4, 1e6, 1e7])
    @pytest.mark.parametrize("name", ["panda", "ur5", "so101", "planar2", "one_joint"])
    def test_a_wrong_unit_is_doubted_and_not_refused(self, name: str, factor: float) -> None:
        arm = taut.load_arm(name)
        rotor = float(taut.snapshot(arm, arm.home).M[0, 0]) / 100.0**2  # matched at the first joint
        assert not list(rotor_doubts(arm.with_gears(100.0, rotor)))
        with pytest.warns(RuntimeWarning) as told:
            doubted = arm.with_gears(100.0, rotor * factor)
        assert len(told) == arm.n
        assert doubted.rotor_inertia[0] == pytest.approx(1e4 * rotor * factor)

    def test_the_sentence_says_what_and_in_which_unit(self) -> None:
        with pytest.warns(RuntimeWarning) as told:
            taut.load_arm("one_joint").with_gears(100.0, 0.2)
        assert str(told[0].message) == (
            "the rotor inertia of joint 'joint1', 2000 [kg m^2] seen at the joint, gear 100, is hard to believe: no joint "
            "of its kind can see more than 0.5 [kg m^2] of links; if it was given in kg cm^2, kg mm^2 or g cm^2: 1 kg "
            "m^2 is 1e4, 1e6 and 1e7 of these"
        )

    def test_a_servo_on_a_light_wrist_is_believed(self) -> None:
        """The armature of an STS3215 is 200 times the largest inertia that the SO-101's last joint can see."""
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            arm = taut.load_arm("so101").with_joints(rotor_inertia=0.0284)
        assert taut.drives.rotor_share(arm)[-1] > 0.98

    def test_a_file_with_a_wrong_unit_is_doubted_where_it_is_checked(self, tmp_path: Path) -> None:
        file = tmp_path / "arm.xml"
        file.write_text(
            "<mujoco><worldbody><body name='link'><joint name='hinge' axis='0 1 0' armature='5000'/>"
            "<geom type='capsule' fromto='0 0 0 0 0 1' size='.02' mass='1'/></body></worldbody></mujoco>",
            encoding="utf-8",
        )
        report = check_model(file)
        assert report.ok
        assert any("rotor inertia of joint 'hinge', 5000 [kg m^2]" in note for note in report.notes)
        assert "note: the rotor inertia of joint 'hinge'" in report.text()
