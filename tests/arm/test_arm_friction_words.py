"""Friction, gears and rotors in the words of URDF and MJCF: there and back, and what they cannot say."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from arm_models import DUO, PAIR

import taut
from taut import Friction
from taut.arm.loaders.write_friction import to_mjcf_joints, to_urdf_dynamics
from taut.arm.report import check_model, joint_table
from taut.errors import ModelError, UsageError

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
        assert head.split()[-3:] == ["gear", "rotor", "unit"]
        assert "gear" not in check_model("planar2").text()
        joints = report.json()["joints"]
        assert [joint["gear"] for joint in joints] == [50.0, 1.0]  # type: ignore[union-attr,index,call-overload]


def test_an_arms_friction_is_a_table() -> None:
    arm = taut.load_arm("planar2").with_joints(coulomb=0.1, static={"joint1": 0.4}, stribeck={"joint1": 0.05})
    head, first, second = joint_table(arm.joints)
    assert head.split()[-5:-1] == ["friction", "static", "stribeck", "rotor"]
    assert first.split()[10:13] == ["0.1", "0.4", "0.05"]
    assert second.split()[10:13] == ["0.1", "same", "0"]


# -------------------------------------------------------------------- writing


def replaced(text: str, joint: str, xml: str) -> str:
    """The two-joint URDF with another <dynamics> in a joint, or the MJCF with other numbers."""
    head, _, rest = text.partition(f'<joint name="{joint}"')
    inside, _, tail = rest.partition("</joint>")
    inside = inside.replace('<dynamics damping="0.1" friction="0.2"/>', "")
    return f'{head}<joint name="{joint}"{inside}{xml}</joint>{tail}'


class TestUrdf:
    def test_what_it_can_say_comes_back_bit_by_bit(self, tmp_path: Path) -> None:
        arm = taut.load_arm(written(tmp_path, DUO)).with_friction(SIMPLE)
        words = to_urdf_dynamics(arm)
        text = DUO
        for name in arm.joint_names:
            text = replaced(text, name, words.xml(name))
        again = taut.load_arm(written(tmp_path, text))
        np.testing.assert_array_equal(again.viscous, arm.viscous)
        np.testing.assert_array_equal(again.coulomb, arm.coulomb)

    def test_what_it_cannot_say_is_said(self) -> None:
        arm = taut.load_arm("planar2").with_friction(FULL).with_gears({"joint2": 50.0}, 1e-5)
        assert to_urdf_dynamics(arm).notes == (
            "friction is the friction at rest by the URDF's specification, and nearly every engine takes it as dry "
            "friction in motion, as taut does: written is coulomb",
            "static friction above that in motion is left out, on 'joint1'",
            "the Stribeck effect is left out, on 'joint1'",
            "friction that grows with load is left out, on 'joint2'",
            "rotor inertia is left out, on 'joint2': <dynamics> has none; Drake reads drake:rotor_inertia and "
            "drake:gear_ratio in the <actuator> of a <transmission>, and so does taut",
        )

    def test_nothing_that_is_left_out_is_nothing_to_say(self) -> None:
        assert to_urdf_dynamics(taut.load_arm("planar2").with_friction(Friction(viscous=0.1))).notes == ()


class TestMjcf:
    def test_what_it_can_say_is_what_mujoco_computes_with(self, tmp_path: Path) -> None:
        arm = taut.load_arm(written(tmp_path, PAIR, "pair.xml")).with_friction(SIMPLE).with_gears([30.0, 50.0], 2e-5)
        words = to_mjcf_joints(arm)
        text = PAIR.replace('<joint name="shoulder" axis="0 1 0" range="-2 2" damping="0.1"/>', words.xml("shoulder"))
        text = text.replace('<joint name="elbow" axis="0 1 0"/>', words.xml("elbow"))
        m = mujoco.MjModel.from_xml_string(text)
        np.testing.assert_array_equal(m.dof_damping, arm.viscous)
        np.testing.assert_array_equal(m.dof_frictionloss, arm.coulomb)
        np.testing.assert_array_equal(m.dof_armature, arm.rotor_inertia)
        again = taut.load_arm(written(tmp_path, text, "again.xml"))
        np.testing.assert_array_equal(again.rotor_inertia, arm.rotor_inertia)
        np.testing.assert_array_equal(again.coulomb, arm.coulomb)

    def test_what_it_cannot_say_is_said(self) -> None:
        arm = taut.load_arm("planar2").with_friction(FULL).with_gears(50.0, 1e-5)
        assert to_mjcf_joints(arm).notes == (
            "frictionloss is a soft constraint of MuJoCo: a joint that should stick creeps, less with a stiffer "
            'solreffriction and solimpfriction, and not at all with <option noslip_iterations="..."/>',
            "static friction above that in motion is left out, on 'joint1'",
            "the Stribeck effect is left out, on 'joint1'",
            "friction that grows with load is left out, on 'joint2'",
            "the lugre attribute of MuJoCo's <dcmotor> has static friction and a Stribeck speed, behind its gear",
            "armature is the reflected inertia, gear^2 times that of the rotor: give no gear for it again",
        )

    def test_a_name_with_marks_is_quoted(self) -> None:
        words = to_mjcf_joints(taut.load_arm("one_joint"))
        odd = taut.drives.JointWords(element="joint", attributes={'a"<b': {"damping": 0.5}}, notes=())
        assert words.xml("joint1").startswith('<joint name="joint1" ')
        assert odd.xml('a"<b') == '<joint name=\'a"&lt;b\' damping="0.5"/>'

    def test_a_joint_that_should_stick_creeps_in_mujoco_without_noslip(self) -> None:
        """What the note says: 0.3 N m against a frictionloss of 0.5 N m, for ten seconds."""
        arm = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0]).with_joints(coulomb=0.5, viscous=0.0)
        creep = {}
        for option in ("", '<option noslip_iterations="10"/>'):
            text = (
                f"<mujoco>{option}<option gravity='0 0 0'/><worldbody><body>{to_mjcf_joints(arm).xml('joint1')}"
                "<geom type='capsule' fromto='0 0 0 0.3 0 0' size='.02' mass='1'/></body></worldbody></mujoco>"
            )
            m = mujoco.MjModel.from_xml_string(text)
            d = mujoco.MjData(m)
            d.qfrc_applied[0] = 0.3
            mujoco.mj_step(m, d, 5000)
            creep[option] = abs(float(d.qpos[0]))
        assert creep[""] > 1e-3
        assert creep['<option noslip_iterations="10"/>'] < 1e-3 * creep[""]


def test_a_joint_that_is_not_there_has_no_words() -> None:
    words = to_urdf_dynamics(taut.load_arm("one_joint"))
    with pytest.raises(
        taut.errors.UnknownNameError, match=r"^the arm has no joint 'joint2'; did you mean 'joint1'\?$"
    ):
        words.xml("joint2")


@pytest.mark.parametrize("write", [to_urdf_dynamics, to_mjcf_joints])
def test_only_an_arm_has_joints_with_names(write: object) -> None:
    with pytest.raises(UsageError, match=r"takes an Arm; got Friction; arm.with_friction\(...\) makes one"):
        write(SIMPLE)  # type: ignore[operator]
