"""MJCF files, against MuJoCo's own compiled model of the same text."""

from __future__ import annotations

import shutil
from importlib import metadata
from pathlib import Path

import mujoco
import numpy as np
import pytest
from arm_models import PAIR
from arm_oracles import assert_same_as_mujoco
from refusals import refused

from taut.arm.load import load_arm
from taut.arm.loaders.mjcf import mjcf_tree
from taut.arm.loaders.xml import read_xml
from taut.base.errors import ModelError
from taut.maths.snapshot import snapshot

ASSETS = Path(str(metadata.distribution("franky-sim").locate_file("franky_sim/assets")))
FINGERS = {"finger_joint1": 0.0, "finger_joint2": 0.0}

DEFAULTS = """\
<mujoco model="defaults">
  <compiler angle="degree" eulerseq="zyx"/>
  <default>
    <joint damping="0.3" armature="0.05" frictionloss="0.2"/>
    <geom density="800"/>
    <default class="wrist">
      <joint axis="1 0 0" damping="0.1" armature="0.01" range="-30 60"/>
    </default>
  </default>
  <worldbody>
    <body name="a" pos="0.1 0 0.2" euler="10 20 30">
      <joint name="j1" axis="0 0 1" range="-90 90"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.04"/>
      <body name="b" pos="0.3 0 0" axisangle="0 1 0 45" childclass="wrist">
        <joint name="j2"/>
        <geom type="box" size="0.1 0.02 0.03" pos="0.1 0 0"/>
        <geom type="sphere" size="0.05" pos="0.2 0 0" mass="0.5"/>
        <site name="tip" pos="0.2 0 0" zaxis="1 0 1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

ANCHORS = """\
<mujoco model="anchors">
  <compiler angle="radian"/>
  <option gravity="1 -2 -9"/>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <frame pos="0 0 1" euler="0.1 0.2 0.3">
      <body name="a" pos="0.1 0 0">
        <inertial mass="2" pos="0.1 0.02 0" fullinertia="0.02 0.05 0.06 0.001 0.002 -0.003"/>
        <joint name="hinge" axis="0 1 1" pos="0.05 0.1 -0.02" ref="0.4" range="-1 2"/>
        <body name="b" pos="0.3 0 0" quat="0.5 0.5 -0.5 0.5">
          <inertial mass="1" pos="0 0 0.1" quat="1 2 3 4" diaginertia="0.01 0.02 0.025"/>
          <joint name="slide" type="slide" axis="1 2 0" pos="0.1 0 0" ref="-0.1" range="-0.5 0.5" armature="0.3"/>
          <site name="tip" pos="0.1 0.2 0.3" euler="1 0 0"/>
        </body>
      </body>
    </frame>
  </worldbody>
</mujoco>
"""

GEOMS = """\
<mujoco model="geoms">
  <compiler inertiafromgeom="true" boundmass="0.01" boundinertia="0.0001"/>
  <worldbody>
    <body name="a">
      <inertial mass="77" pos="0 0 0" diaginertia="1 1 1"/>
      <joint name="j" axis="0 1 0"/>
      <geom type="cylinder" size="0.05 0.2" pos="0 0 0.2" density="2700"/>
      <geom type="ellipsoid" size="0.1 0.05 0.02" pos="0 0 0.5"/>
      <body name="eye" mocap="false" pos="0 0 0.5"/>
    </body>
  </worldbody>
</mujoco>
"""

INLINE_MESH = """\
<mujoco model="inline">
  <asset><mesh name="tetra" vertex="0 0 0  0.1 0 0  0 0.2 0  0 0 0.3"/></asset>
  <worldbody>
    <body name="a">
      <joint name="j" axis="1 0 0" pos="0 0 0.1"/>
      <geom type="mesh" mesh="tetra" density="3000"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("text", [PAIR, DEFAULTS, ANCHORS, GEOMS, INLINE_MESH], ids=lambda text: text.split('"')[1])
def test_mass_matrix_bias_and_frames_are_mujocos(text: str, tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(text)
    m = mujoco.MjModel.from_xml_string(text)
    arm = load_arm(file)
    assert_same_as_mujoco(arm, m)
    np.testing.assert_allclose(arm.viscous, m.dof_damping)
    np.testing.assert_allclose(arm.coulomb, m.dof_frictionloss)
    np.testing.assert_allclose(arm.rotor_inertia, m.dof_armature)
    np.testing.assert_allclose(arm.gravity, m.opt.gravity)
    for j, joint in enumerate(arm.joints):
        limits = m.jnt_range[j] if m.jnt_limited[j] else (-np.inf, np.inf)
        np.testing.assert_allclose((joint.lower, joint.upper), limits)


def test_fr3_is_read_without_any_of_its_meshes(tmp_path: Path) -> None:
    shutil.copy(ASSETS / "fr3.xml", tmp_path)
    arm = load_arm(tmp_path / "fr3.xml", locked=FINGERS, tool="hand")
    (tmp_path / "full").mkdir()
    shutil.copy(ASSETS / "fr3.xml", tmp_path / "full")
    shutil.copytree(ASSETS / "meshes", tmp_path / "full" / "assets")
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "full" / "fr3.xml"))
    assert_same_as_mujoco(arm, m)
    np.testing.assert_allclose(arm.effort, m.jnt_actfrcrange[:7, 1])
    np.testing.assert_allclose(arm.home, m.key_qpos[0, :7])
    assert not arm.visuals


def test_fr3s_meshes_are_shown_where_they_are(tmp_path: Path) -> None:
    shutil.copy(ASSETS / "fr3.xml", tmp_path)
    shutil.copytree(ASSETS / "meshes", tmp_path / "assets")
    arm = load_arm(tmp_path / "fr3.xml", locked=FINGERS, tool="hand")
    meshes = [visual for visual in arm.visuals if visual.shape == "mesh"]
    assert len(meshes) > 20
    assert all(Path(visual.file).parent == (tmp_path / "assets").resolve() for visual in meshes)


def test_the_finger_that_an_equality_ties_is_refused_until_it_is_held(tmp_path: Path) -> None:
    shutil.copy(ASSETS / "fr3.xml", tmp_path)
    with refused(ModelError):
        load_arm(tmp_path / "fr3.xml", tool="hand")


def test_what_a_mujoco_model_has_and_an_arm_has_not_is_noted(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(
        PAIR.replace('damping="0.1"', 'damping="0.1 0.2" stiffness="3"')
        .replace('<body name="fore"', '<body name="fore" gravcomp="1"')
        .replace("<motor", '<position joint="elbow" kp="10"/>\n    <motor')
        .replace(
            "</worldbody>", '</worldbody><tendon><fixed name="t"><joint joint="elbow" coef="1"/></fixed></tendon>'
        )
        .replace("</actuator>", '<motor name="pull" tendon="t"/></actuator>')
    )
    notes = load_arm(file).notes
    assert notes == (
        "springs left out, on 'shoulder'",
        "gravcomp left out, on 'fore'; a law compensates gravity",
        "1 tendon left out",
        "actuators with their own gains or motors: 'actuator0'; an Arm takes torques",
        "actuators that drive no joint are left out: 'pull'",
        "no speed limit on 'shoulder', 'elbow'",
        "no effort limit on 'elbow'",
    )


@pytest.mark.parametrize(
    ("actuators", "effort"),
    [
        ('<motor joint="shoulder" forcerange="-40 40"/>', 40.0),
        ('<motor joint="shoulder" forcerange="-40 30" gear="2"/>', 60.0),
        ('<motor joint="shoulder" ctrlrange="-1 1" gear="50"/>', 50.0),
        ('<motor joint="shoulder" ctrlrange="-1 1" gear="-50" forcerange="-0.5 0.5"/>', 25.0),
        ('<motor joint="shoulder" forcerange="-4 4"/><motor joint="shoulder" forcerange="-5 5"/>', 9.0),
        ('<position joint="shoulder" ctrlrange="-1 1" kp="100" forcerange="-7 7"/>', 7.0),
        ('<position joint="shoulder" ctrlrange="-1 1" kp="100"/>', np.inf),
        ('<motor joint="elbow" forcerange="-7 7"/>', np.inf),
    ],
)
def test_effort_is_what_actuators_and_the_joint_allow(actuators: str, effort: float, tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    motor = '<motor name="shoulder_motor" joint="shoulder" forcerange="-40 40"/>'
    file.write_text(PAIR.replace(motor, actuators))
    assert load_arm(file).effort[0] == pytest.approx(effort)
    file.write_text(PAIR.replace(motor, actuators).replace('range="-2 2"', 'range="-2 2" actuatorfrcrange="-3 3"'))
    assert load_arm(file).effort[0] == pytest.approx(min(effort, 3.0))


def test_includes_in_the_same_folder_are_followed_and_named(tmp_path: Path) -> None:
    head, _, rest = PAIR.partition("    <body ")
    body, _, tail = f"    <body {rest}".partition("  </worldbody>")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "body.xml").write_text(f"<mujocoinclude>\n{body}</mujocoinclude>\n")
    (tmp_path / "m.xml").write_text(f'{head}    <include file="parts/body.xml"/>\n  </worldbody>{tail}')
    assert_same_as_mujoco(load_arm(tmp_path / "m.xml"), mujoco.MjModel.from_xml_string(PAIR))
    broken = body.replace('mass="2"', 'mass="nan"').replace('axis="0 1 0"/>', 'axis="0 0 0"/>')
    (tmp_path / "parts" / "body.xml").write_text(f"<mujocoinclude>\n{broken}</mujocoinclude>\n")
    with pytest.raises(ModelError) as caught:
        load_arm(tmp_path / "m.xml")
    (problem,) = caught.value.problems
    assert problem.line == 3
    assert problem.message == "body 'upper' in 'parts/body.xml': mass of <inertial> must be finite; got 'nan'"


def test_an_include_through_a_link_that_leads_out_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "outside.xml").write_text("<mujocoinclude/>")
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "inside.xml").symlink_to(tmp_path / "outside.xml")
    (folder / "m.xml").write_text(PAIR.replace("<worldbody>", '<include file="inside.xml"/><worldbody>'))
    with refused(ModelError):
        load_arm(folder / "m.xml")


def test_included_files_are_bounded_together(tmp_path: Path) -> None:
    names = [f"part{i}.xml" for i in range(60)]
    for name in names:
        (tmp_path / name).write_text("<mujocoinclude/>")
    includes = "".join(f'<include file="{name}"/>' for name in names)
    (tmp_path / "m.xml").write_text(PAIR.replace("<worldbody>", f"{includes}<worldbody>"))
    with refused(ModelError):
        load_arm(tmp_path / "m.xml")


def test_a_body_with_two_joints_is_read_when_one_is_held(tmp_path: Path) -> None:
    text = PAIR.replace(
        'axis="0 1 0"/>', 'axis="0 1 0"/><joint name="twist" axis="1 0 0" pos="0 0.1 0" range="-1 1"/>'
    )
    file = tmp_path / "m.xml"
    file.write_text(text)
    m = mujoco.MjModel.from_xml_string(text)
    assert_same_as_mujoco(load_arm(file, locked={"twist": 0.0}), m)
    assert_same_as_mujoco(load_arm(file, locked={"elbow": 0.0}), m)


def test_a_free_base_can_be_held_still(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    base = '<body name="base"><freejoint name="root"/><inertial mass="9" pos="0 0 0" diaginertia="1 1 1"/>'
    file.write_text(
        PAIR.replace('<body name="upper"', f'{base}<body name="upper"').replace("</worldbody>", "</body></worldbody>")
    )
    with refused(ModelError):
        load_arm(file)
    assert load_arm(file, locked={"root": 0.0}).joint_names == ("shoulder", "elbow")


def test_a_mesh_that_gives_mass_to_nothing_that_moves_is_no_problem(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    asset = '<asset><mesh file="shell.stl"/><texture name="t" type="2d" file="a.png"/><hfield name="h" file="h.png" size="1 1 1 1"/></asset>'
    geoms = '<geom type="mesh" mesh="shell"/><geom type="hfield" hfield="h"/>'
    on_body = '<geom type="mesh" mesh="shell" euler="0 0 1"/>'
    file.write_text(
        PAIR.replace("<worldbody>", f"{asset}<worldbody>{geoms}").replace("<geom name=", f"{on_body}<geom name=")
    )
    assert_same_as_mujoco(load_arm(file), mujoco.MjModel.from_xml_string(PAIR))


def test_gravity_switched_off_in_the_file_is_off(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(PAIR.replace("<worldbody>", '<option><flag gravity="disable"/></option><worldbody>'))
    assert not load_arm(file).gravity.any()
    assert load_arm(file, gravity=(0, 0, -1.6)).gravity[2] == -1.6


def test_names_that_mujoco_lets_bodies_joints_and_sites_share_stay_apart(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(PAIR.replace("elbow", "fore").replace('site name="tip"', 'site name="fore"'))
    arm = load_arm(file)
    assert arm.joint_names == ("shoulder", "fore")
    assert arm.frame_names == ("world", "upper", "fore", "fore_")


def test_joints_and_bodies_without_names_get_some(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(PAIR.replace(' name="elbow"', "").replace(' name="fore"', ""))
    arm = load_arm(file)
    assert arm.joint_names == ("shoulder", "joint1")
    assert arm.frame_names == ("world", "upper", "body2", "tip")


def test_a_home_key_frame_out_of_the_limits_is_left_out_and_said(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(PAIR.replace("</mujoco>", '<keyframe><key name="home" qpos="3 1"/></keyframe></mujoco>'))
    arm = load_arm(file)
    np.testing.assert_allclose(arm.home, (0.0, 1.0))
    assert "the key frame 'home' puts joint 'shoulder' out of its limits" in arm.notes


def test_reading_alone_gives_a_tree_with_lines(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(PAIR)
    tree = mjcf_tree(read_xml(file), file)
    assert [(joint.name, joint.line) for joint in tree.joints] == [("shoulder", 6), ("elbow", 10)]
    assert [(link.name, link.line) for link in tree.links] == [("world", None), ("upper", 4), ("fore", 8)]


def test_names_with_every_odd_character_reach_mujoco_whole(tmp_path: Path) -> None:
    file = tmp_path / "m.xml"
    file.write_text(PAIR.replace('"elbow"', "\"a&amp;b &lt;c&gt; &quot;d&quot; 'e'\""))
    assert load_arm(file).joint_names[1] == "a&b <c> \"d\" 'e'"


# -------------------------------------------------------------------- friction and rotors


def test_the_rotors_of_actuators_are_mujocos(tmp_path: Path) -> None:
    """MuJoCo adds gear^2 armature to the mass matrix and gear^2 damping to the passive torques."""
    text = PAIR.replace(
        "<motor",
        '<motor joint="elbow" gear="50" armature="2e-5" damping="1e-5"/><motor joint="elbow" gear="0.5" ctrlrange="-1 1"/>'
        "<motor",
    )
    file = tmp_path / "m.xml"
    file.write_text(text)
    m = mujoco.MjModel.from_xml_string(text)
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    M = np.zeros((m.nv, m.nv))
    mujoco.mj_fullM(m, d, M)
    arm = load_arm(file)
    np.testing.assert_allclose(snapshot(arm, [0.0, 0.0]).M, M, rtol=1e-12)
    assert arm.rotor_inertia[1] == pytest.approx(m.dof_armature[1] + 50.0**2 * 2e-5)
    d.qvel[:] = (0.0, 1.0)
    mujoco.mj_forward(m, d)
    assert arm.viscous[1] == pytest.approx(-d.qfrc_passive[1])
    assert arm.gear.tolist() == [1.0, 50.0]  # that of the rotor; a motor without one only scales its control
