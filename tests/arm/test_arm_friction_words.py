"""Friction, gears and rotors in the words of URDF and MJCF, as they are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm_models import DUO

import taut
from taut import Friction
from taut.arm.report import check_model, joint_table
from taut.errors import ModelError

SIMPLE = Friction(viscous=[0.1, 1.0 / 3.0], coulomb=[0.5, 0.0])
FULL = Friction(
    viscous=[0.1, 0.2], coulomb=[0.5, 0.1], static=[0.8, 0.1], stribeck=[0.05, 0.0], load_motor=[0.0, 0.02]
)

GEARED = """
<transmission name="t{i}"><type>transmission_interface/SimpleTransmission</type>
  <joint name="{joint}"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
  <actuator name="m{i}">{inside}</actuator>
</transmission>
"""


def written(folder: Path, text: str, name: str = "duo.urdf") -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def with_transmissions(*inside: tuple[str, str]) -> str:
    """The two-joint URDF with a transmission for each (joint, what stands in its actuator)."""
    text = "".join(GEARED.format(i=i, joint=joint, inside=words) for i, (joint, words) in enumerate(inside))
    return DUO.replace("</robot>", text + "</robot>")


# -------------------------------------------------------------------- reading gears


class TestTransmissions:
    def test_a_reduction_is_a_gear(self, tmp_path: Path) -> None:
        text = with_transmissions(("shoulder", "<mechanicalReduction>50</mechanicalReduction>"))
        arm = taut.load_arm(written(tmp_path, text))
        assert arm.gear.tolist() == [50.0, 1.0]
        assert not arm.rotor_inertia.any()

    def test_drakes_rotor_is_reflected_by_its_gear(self, tmp_path: Path) -> None:
        inside = '<drake:gear_ratio value="100"/><drake:rotor_inertia value="2e-5"/>'
        arm = taut.load_arm(written(tmp_path, with_transmissions(("elbow", inside))))
        same = taut.load_arm(written(tmp_path, DUO)).with_gears({"elbow": 100.0}, 2e-5)
        np.testing.assert_array_equal(arm.gear, same.gear)
        np.testing.assert_array_equal(arm.rotor_inertia, same.rotor_inertia)

    def test_a_rotor_without_a_gear_is_a_direct_drive(self, tmp_path: Path) -> None:
        text = with_transmissions(("elbow", '<drake:rotor_inertia value="0.01"/>'))
        assert taut.load_arm(written(tmp_path, text)).rotor_inertia.tolist() == [0.0, 0.01]

    def test_the_sign_of_a_reduction_is_a_direction_and_no_gear(self, tmp_path: Path) -> None:
        text = with_transmissions(("shoulder", "<mechanicalReduction>-101</mechanicalReduction>"))
        assert taut.load_arm(written(tmp_path, text)).gear[0] == 101.0

    def test_the_same_gear_twice_is_one_gear(self, tmp_path: Path) -> None:
        same = ("shoulder", "<mechanicalReduction>50</mechanicalReduction>")
        arm = taut.load_arm(written(tmp_path, with_transmissions(same, same)))
        assert arm.gear[0] == 50.0
        assert arm.notes == ()

    def test_two_that_contradict_each_other_are_left_out_and_said(self, tmp_path: Path) -> None:
        text = with_transmissions(
            ("shoulder", "<mechanicalReduction>50</mechanicalReduction>"),
            ("shoulder", "<mechanicalReduction>60</mechanicalReduction>"),
        )
        arm = taut.load_arm(written(tmp_path, text))
        assert arm.gear[0] == 1.0
        assert arm.notes == (
            "transmissions that contradict each other are left out, with their gears, on 'shoulder'",
        )

    def test_a_differential_is_left_out_and_said(self, tmp_path: Path) -> None:
        both = (
            '<transmission name="d"><joint name="shoulder"/><joint name="elbow"/><actuator name="a"/></transmission>'
        )
        arm = taut.load_arm(written(tmp_path, DUO.replace("</robot>", both + "</robot>")))
        assert arm.notes == (
            "transmissions of several joints or motors are left out, with their gears, on 'shoulder', 'elbow'",
        )

    @pytest.mark.parametrize(
        ("inside", "message"),
        [
            (
                "<mechanicalReduction>0</mechanicalReduction>",
                "<mechanicalReduction> of its transmission must not be 0: a gear has a ratio, and direct drive is 1",
            ),
            ("<mechanicalReduction>fifty</mechanicalReduction>", "must be one number; got 'fifty'"),
            ('<drake:gear_ratio value="nan"/>', "must be finite; got 'nan'"),
            ("<drake:gear_ratio/>", "must be one number; got none"),
            ('<drake:rotor_inertia value="-1e-5"/>', "must be >= 0 [kg m^2]; got -1e-05"),
        ],
    )
    def test_a_gear_that_cannot_be_is_told_with_its_line(self, inside: str, message: str, tmp_path: Path) -> None:
        with pytest.raises(ModelError) as told:
            taut.load_arm(written(tmp_path, with_transmissions(("elbow", inside))))
        (problem,) = told.value.problems
        assert message in problem.message
        assert problem.message.startswith("joint 'elbow': <")
        assert problem.line == DUO.count("\n") + 3

    def test_what_is_checked_shows_the_gear(self, tmp_path: Path) -> None:
        text = with_transmissions(("shoulder", "<mechanicalReduction>50</mechanicalReduction>"))
        report = check_model(written(tmp_path, text))
        (head,) = [line for line in report.text().splitlines() if line.startswith("joint ")]
        assert head.split()[-4:] == ["gear", "rotor", "inertia", "unit"]
        assert "gear" not in check_model("planar2").text()
        joints = report.json()["joints"]
        assert [joint["gear"] for joint in joints] == [50.0, 1.0]  # type: ignore[union-attr,index,call-overload]


def test_an_arms_friction_is_a_table() -> None:
    arm = taut.load_arm("planar2").with_joints(coulomb=0.1, static={"joint1": 0.4}, stribeck={"joint1": 0.05})
    head, first, second = str(joint_table(arm.joints)).splitlines()
    assert head.split()[-6:-1] == ["coulomb", "static", "stribeck", "rotor", "inertia"]
    assert first.split()[10:13] == ["0.1", "0.4", "0.05"]
    assert second.split()[10:13] == ["0.1", "same", "0"]
