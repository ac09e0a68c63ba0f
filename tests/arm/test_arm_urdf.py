"""URDF files that are fine: defaults, vendors' words, friction, and meshes that never lead out of their folder."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arm_models import DUO
from refusals import refused

from taut.arm.load import load_arm
from taut.arm.loaders.urdf import urdf_tree
from taut.arm.loaders.visuals import MeshPaths, OutsideError, file_inside
from taut.arm.loaders.xml import read_xml
from taut.base.errors import ModelError

VISUAL = '<visual><origin xyz="0 0 1"/><geometry>{}</geometry></visual>'


def written(folder: Path, text: str) -> Path:
    file = folder / "duo.urdf"
    file.write_text(text)
    return file


def with_shape(*shapes: str) -> str:
    return DUO.replace('<link name="tool"/>', f'<link name="tool">{"".join(shapes)}</link>')


def mesh(name: str, tag: str = "visual") -> str:
    return f'<{tag}><geometry><mesh filename="{name}"/></geometry></{tag}>'


def test_a_sound_file_gives_its_numbers(tmp_path: Path) -> None:
    arm = load_arm(written(tmp_path, DUO))
    shoulder, elbow = arm.joints
    assert (shoulder.name, shoulder.kind, shoulder.lower, shoulder.upper) == ("shoulder", "revolute", -2.0, 2.0)
    assert (shoulder.velocity, shoulder.effort, shoulder.viscous, shoulder.coulomb) == (3.0, 40.0, 0.1, 0.2)
    assert (elbow.kind, elbow.lower, elbow.upper) == ("continuous", -math.inf, math.inf)
    np.testing.assert_array_equal(shoulder.placement.p, (0.0, 0.0, 0.3))
    np.testing.assert_array_equal(arm.bodies[0].com, (0.2, 0.0, 0.0))
    np.testing.assert_array_equal(np.diag(arm.bodies[0].inertia), (0.01, 0.03, 0.03))
    assert arm.tool == "tool"
    assert arm.frame_names == ("base", "upper", "fore", "tool")
    assert arm.notes == ()


def test_an_axis_of_another_length_is_normalised_and_a_missing_one_is_x(tmp_path: Path) -> None:
    text = DUO.replace('<axis xyz="0 1 0"/>\n    <limit lower', '<axis xyz="0 3 4"/>\n    <limit lower')
    text = text.replace('    <axis xyz="0 1 0"/>\n    <limit velocity', "    <limit velocity")
    arm = load_arm(written(tmp_path, text))
    np.testing.assert_allclose(arm.joints[0].axis, (0.0, 0.6, 0.8))
    np.testing.assert_allclose(arm.joints[1].axis, (1.0, 0.0, 0.0))


def test_turned_inertials_and_fixed_links_are_lumped_as_pinocchio_does(tmp_path: Path) -> None:
    turned = DUO.replace('<origin xyz="0.2 0 0" rpy="0 0 0"/>', '<origin xyz="0.2 0.1 0" rpy="0.3 -0.4 0.5"/>')
    turned = turned.replace('ixy="0"', 'ixy="0.002"').replace('ixz="0"', 'ixz="-0.001"')
    camera = (
        '<link name="camera"><inertial><origin xyz="0 0.1 0" rpy="1 2 3"/><mass value="0.5"/>'
        '<inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="0.001" ixz="0" iyz="0.002"/></inertial></link>'
        '<joint name="c" type="fixed"><origin xyz="0.1 0.2 0.3" rpy="-1 0.5 2"/><parent link="upper"/>'
        '<child link="camera"/></joint></robot>'
    )
    text = turned.replace("</robot>", camera)
    arm, model = load_arm(written(tmp_path, text), tool="tool"), pin.buildModelFromXML(text)
    assert model.nv == arm.n == 2
    for body, inertia in zip(arm.bodies, list(model.inertias)[1:], strict=True):
        assert body.mass == pytest.approx(inertia.mass, abs=1e-12)
        np.testing.assert_allclose(body.com, inertia.lever, atol=1e-12)
        np.testing.assert_allclose(body.inertia, inertia.inertia, atol=1e-12)


def test_a_limit_may_be_as_large_as_a_file_likes(tmp_path: Path) -> None:
    arm = load_arm(
        written(tmp_path, DUO.replace('upper="2"', 'upper="1e16"').replace('effort="40"', 'effort="1e30"'))
    )
    assert (arm.upper[0], arm.effort[0]) == (1e16, 1e30)


def test_a_continuous_joint_ignores_position_limits_and_needs_no_others(tmp_path: Path) -> None:
    text = DUO.replace('<limit velocity="3" effort="20"/>', '<limit lower="0" upper="0" effort="20"/>')
    arm = load_arm(written(tmp_path, text))
    assert arm.joints[1].upper == math.inf
    assert arm.notes == (
        "'elbow': continuous, so the position limits in the file are left out",
        "no speed limit on 'elbow'",
    )


def test_vendors_words_are_fine(tmp_path: Path) -> None:
    text = DUO.replace(
        "</robot>",
        '<gazebo reference="fore"><mu1>0.2</mu1></gazebo><transmission name="t"><joint name="elbow"/></transmission>'
        '<ros2_control name="x" type="system"/><sensor name="s"/></robot>',
    ).replace(
        '<dynamics damping="0.1" friction="0.2"/>',
        '<dynamics D="1" K="7000" damping="0.1" friction="0.2" mu_coulomb="0"/>'
        '<safety_controller k_velocity="40"/><limits_ext lower="x"/>',
    )
    assert load_arm(written(tmp_path, text)).viscous[0] == 0.1


def test_rules_about_joints_do_not_bite_on_fixed_or_held_ones(tmp_path: Path) -> None:
    text = DUO.replace('<origin xyz="0.3 0 0"/>', '<origin xyz="0.3 0 0"/><axis xyz="0 0 0"/><limit effort="-1"/>')
    text = text.replace(
        '<limit velocity="3" effort="20"/>', '<limit velocity="-3" effort="0"/><mimic joint="shoulder"/>'
    )
    arm = load_arm(written(tmp_path, text), locked={"elbow": 0.5})
    assert arm.joint_names == ("shoulder",)
    np.testing.assert_allclose(arm.frame().placement.p, (0.4 + 0.3 * math.cos(0.5), 0.0, -0.3 * math.sin(0.5)))


def test_a_link_without_mass_is_fine_when_it_is_fixed_to_one_that_has(tmp_path: Path) -> None:
    zero = '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
    assert load_arm(written(tmp_path, with_shape(zero))).bodies[1].mass == 1.0


def test_a_robot_without_name_is_called_after_its_file(tmp_path: Path) -> None:
    arm = load_arm(written(tmp_path, DUO.replace(' name="duo"', "")))
    assert arm.name == "duo"
    assert arm.notes == ("the robot has no name; it is called 'duo' after its file",)


def test_a_urdf_may_be_called_xml(tmp_path: Path) -> None:
    (tmp_path / "duo.xml").write_text(DUO)
    assert load_arm(tmp_path / "duo.xml").name == "duo"


# -------------------------------------------------------------------- shapes to draw


def test_primitives_are_kept_with_their_place_and_colour(tmp_path: Path) -> None:
    material = '<material name="red"><color rgba="1 0 0 1"/></material>'
    box = VISUAL.format('<box size="1 2 3"/>').replace("</visual>", '<material name="red"/></visual>')
    text = with_shape(box, VISUAL.format('<sphere radius="0.5"/>')).replace("</robot>", f"{material}</robot>")
    first, second = load_arm(written(tmp_path, text)).visuals
    assert (first.shape, first.size, first.rgba) == ("box", (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 1.0))
    assert (second.shape, second.size) == ("sphere", (0.5,))
    np.testing.assert_array_equal(first.placement.p, (0.3, 0.0, 1.0))


@pytest.mark.parametrize(
    "shape",
    ['<box size="1 nan 3"/>', '<sphere radius="x"/>', "<sphere/>", '<cylinder radius="1"/>', '<cone size="1"/>', ""],
)
def test_a_wrong_shape_is_left_out_and_harms_nothing(shape: str, tmp_path: Path) -> None:
    assert load_arm(written(tmp_path, with_shape(VISUAL.format(shape)))).visuals == ()


@pytest.mark.parametrize(
    ("shape", "attribute"),
    [
        ('<box size="1 -1 3"/>', "size"),
        ('<sphere radius="-1"/>', "radius"),
        ('<cylinder radius="1" length="-2"/>', "length"),
    ],
)
@pytest.mark.parametrize("role", ["visual", "collision"])
def test_a_shape_of_negative_size_is_refused(shape: str, attribute: str, role: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError) as refused:
        load_arm(written(tmp_path, with_shape(VISUAL.format(shape).replace("visual", role))))
    (problem,) = refused.value.problems
    assert (problem.object, problem.attribute, problem.line) == ("tool", attribute, 17)


def test_a_collision_mesh_stands_in_for_a_visual_that_cannot_be_shown(tmp_path: Path) -> None:
    (tmp_path / "hand.stl").write_bytes(b"")
    arm = load_arm(written(tmp_path, with_shape(mesh("hand.dae"), mesh("hand.stl", "collision"))))
    assert [visual.file for visual in arm.visuals] == [str((tmp_path / "hand.stl").resolve())]
    assert arm.notes == ()


def test_meshes_of_other_types_are_noted(tmp_path: Path) -> None:
    arm = load_arm(written(tmp_path, with_shape(mesh("hand.dae"))))
    assert arm.visuals == ()
    (note,) = arm.notes
    assert note.startswith("1 mesh file not shown, such as 'hand.dae'")


ESCAPES = [
    "../secret.stl",
    "meshes/../../secret.stl",
    "/etc/secret.stl",
    "file:///etc/secret.stl",
    "http://example.org/secret.stl",
    "https://example.org/secret.obj",
    "C:/secret.stl",
    "..\\secret.stl",
    "package://other/secret.stl",
    "package://duo/../secret.stl",
    "package://duo//etc/secret.stl",
    "link.stl",
    "folder/secret.stl",
    "loop.stl",
    "gone.stl",
    "x" * 400 + ".stl",
]


def notes_of_a_model_that_shows(name: str, tmp_path: Path) -> tuple[str, ...]:
    """The notes of a model whose mesh has this name, beside a file that must not be reached; nothing is shown."""
    (tmp_path / "secret.stl").write_bytes(b"secret")
    folder = tmp_path / "model"
    folder.mkdir(exist_ok=True)
    for link, target in (("link.stl", "../secret.stl"), ("folder", ".."), ("loop.stl", "loop.stl")):
        (folder / link).unlink(missing_ok=True)
        (folder / link).symlink_to(target)
    file = written(folder, with_shape(mesh(name)))
    tree = urdf_tree(read_xml(file), file, {"duo": folder})
    assert [visual for link in tree.links for visual in link.visuals] == []
    assert tree.problems == []
    return tuple(tree.notes)


@pytest.mark.parametrize("name", ESCAPES)
def test_no_mesh_path_leads_out_of_its_folder(name: str, tmp_path: Path) -> None:
    (note,) = notes_of_a_model_that_shows(name, tmp_path)
    assert note.startswith("1 mesh file not shown")


@pytest.mark.bars
def test_escapes_are_counted(tmp_path: Path, bar: Callable[[str, object], None]) -> None:
    escapes = sum(not notes_of_a_model_that_shows(name, tmp_path) for name in ESCAPES)
    bar(f"row 23: mesh paths out of the model's folder, {len(ESCAPES)} kinds: escapes", escapes)
    assert escapes == 0


@pytest.mark.parametrize("name", ["a\0b.stl", "", "a\nb.stl"])
def test_odd_characters_make_no_path(name: str, tmp_path: Path) -> None:
    assert MeshPaths(tmp_path).resolve(name) == ""
    with pytest.raises(OutsideError):
        file_inside(tmp_path, name)


def test_a_link_that_stays_inside_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real.stl").write_bytes(b"")
    (tmp_path / "link.stl").symlink_to(tmp_path / "real.stl")
    assert MeshPaths(tmp_path).resolve("link.stl") == str((tmp_path / "real.stl").resolve())


def test_no_mesh_is_ever_opened(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.stl"  # opening it would wait for ever
    os.mkfifo(pipe)
    arm = load_arm(written(tmp_path, with_shape(mesh("pipe.stl"))))
    assert arm.visuals == ()


def test_every_problem_of_a_file_is_reported_in_the_order_of_its_lines(tmp_path: Path) -> None:
    text = DUO.replace("0.03", "x").replace('effort="20"', 'effort="-20"').replace('type="fixed"', 'type="welded"')
    with refused(ModelError) as caught:
        load_arm(written(tmp_path, text))
    lines = [problem.line for problem in caught.value.problems]
    assert lines == [8, 8, 31, 33]
