"""Every arm of the catalogue, against Pinocchio reading the same file with the same joints locked."""

from __future__ import annotations

import ast
import re
from importlib import metadata
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from arm_oracles import pinocchio_of
from refusals import refused

from taut.arm.catalogue import CATALOGUE, Entry
from taut.arm.description import BASE
from taut.arm.load import load_arm
from taut.arm.report import check_model
from taut.arm.rules import rotor_doubts
from taut.base.errors import MissingExtraError

SAME = 1e-12  # both read the same decimal numbers; what differs is the order of a few sums
SNAPPED = 2e-11  # a rotation entry this close to 0 or +-1 is set exactly (taut.trace.pose.SNAP)
NAMES = sorted(CATALOGUE)


def file_of(entry: Entry) -> str:
    return str(metadata.distribution(entry.package).locate_file(entry.file))


def reduced(entry: Entry) -> pin.Model:
    """Pinocchio's model with the entry's joints locked.

    The SO-100 and SO-101 have a joint and a link of one name, which Pinocchio's reduction does not survive; so the
    locked joints get other names first.
    """
    root = ElementTree.parse(file_of(entry)).getroot()
    for joint in root.findall("joint"):
        joint.set(
            "name", f"locked {joint.get('name')}" if joint.get("name") in entry.locked else joint.get("name", "")
        )
    for mimic in [(joint, found) for joint in root.findall("joint") for found in joint.findall("mimic")]:
        mimic[0].remove(mimic[1])
    model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    q, ids = pin.neutral(model), []
    for name, position in entry.locked.items():
        ids.append(model.getJointId(f"locked {name}"))
        q[model.joints[ids[-1]].idx_q] = position
    return pin.buildReducedModel(model, ids, q)


def axis_of(model: pin.Model, i: int) -> np.ndarray:
    data = model.joints[i].createData()
    model.joints[i].calc(data, pin.neutral(model))
    S = np.asarray(data.S).reshape(6)
    return S[:3] + S[3:]


@pytest.mark.parametrize("name", NAMES)
def test_joints_are_where_pinocchio_puts_them(name: str) -> None:
    arm, model = load_arm(name), reduced(CATALOGUE[name])
    assert sorted(arm.joint_names) == sorted(model.names[1:])
    assert arm.n == len(CATALOGUE[name].home)
    for joint in arm.joints:
        i = model.getJointId(joint.name)
        parent = "universe" if joint.parent == BASE else arm.joints[joint.parent].name
        assert model.names[model.parents[i]] == parent
        np.testing.assert_allclose(joint.placement.p, model.jointPlacements[i].translation, atol=SAME)
        np.testing.assert_allclose(joint.placement.R, model.jointPlacements[i].rotation, atol=SNAPPED)
        np.testing.assert_allclose(joint.axis, axis_of(model, i), atol=SAME)


@pytest.mark.parametrize("name", NAMES)
def test_bodies_weigh_what_pinocchio_lumps(name: str) -> None:
    arm, model = load_arm(name), reduced(CATALOGUE[name])
    for joint, body in zip(arm.joints, arm.bodies, strict=True):
        inertia = model.inertias[model.getJointId(joint.name)]
        assert body.mass == pytest.approx(inertia.mass, abs=SAME)
        np.testing.assert_allclose(body.com, inertia.lever, atol=SAME)
        np.testing.assert_allclose(body.inertia, inertia.inertia, atol=SAME)
    assert arm.total_mass == pytest.approx(sum(inertia.mass for inertia in list(model.inertias)[1:]), abs=SAME)


@pytest.mark.parametrize("name", NAMES)
def test_limits_and_friction_are_those_of_the_file(name: str) -> None:
    entry = CATALOGUE[name]
    arm, model = load_arm(name), reduced(entry)
    for joint in arm.joints:
        here = model.joints[model.getJointId(joint.name)]
        assert (joint.viscous, joint.coulomb) == (model.damping[here.idx_v], model.friction[here.idx_v])
        assert joint.velocity == model.velocityLimit[here.idx_v]
        assert joint.effort == model.effortLimit[here.idx_v]
        if joint.kind == "continuous":
            assert here.nq == 2
            assert (joint.lower, joint.upper) == (-np.inf, np.inf)
        else:
            assert joint.lower == model.lowerPositionLimit[here.idx_q]
            assert joint.upper == model.upperPositionLimit[here.idx_q]


@pytest.mark.parametrize("name", NAMES)
def test_frames_are_where_pinocchio_puts_the_links(name: str) -> None:
    entry = CATALOGUE[name]
    arm, model = load_arm(name), reduced(entry)
    links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    assert {frame.name for frame in links} == set(arm.frame_names)
    for link in links:
        frame = arm.frame(link.name)
        moved_by = "universe" if frame.body == BASE else arm.joint_names[frame.body]
        assert model.names[link.parentJoint] == moved_by
        np.testing.assert_allclose(frame.placement.p, link.placement.translation, atol=SNAPPED)
        np.testing.assert_allclose(frame.placement.R, link.placement.rotation, atol=SNAPPED)


@pytest.mark.parametrize("name", NAMES)
def test_the_dynamics_that_follow_are_pinocchios(name: str) -> None:
    arm, theirs = load_arm(name), reduced(CATALOGUE[name])
    ours = pinocchio_of(arm)
    rng = np.random.default_rng(1)
    order = [theirs.joints[theirs.getJointId(joint)].idx_v for joint in arm.joint_names]
    for _ in range(3):
        v, a = rng.normal(size=arm.n), rng.normal(size=arm.n)
        q = arm.home + 0.1 * rng.normal(size=arm.n)
        q_theirs, v_theirs, a_theirs = pin.neutral(theirs), np.zeros(arm.n), np.zeros(arm.n)
        for i, joint in enumerate(arm.joints):
            here = theirs.joints[theirs.getJointId(joint.name)]
            angle = [np.cos(q[i]), np.sin(q[i])] if here.nq == 2 else [q[i]]
            q_theirs[here.idx_q : here.idx_q + here.nq] = angle
        v_theirs[order], a_theirs[order] = v, a
        expected = pin.rnea(theirs, theirs.createData(), q_theirs, v_theirs, a_theirs)[order]
        got = pin.rnea(ours, ours.createData(), q, v, a)
        np.testing.assert_allclose(got, expected, atol=1e-9 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("name", NAMES)
def test_home_is_inside_the_limits_and_no_singularity(name: str) -> None:
    arm = load_arm(name)
    assert (arm.lower <= arm.home).all()
    assert (arm.home <= arm.upper).all()
    model = pinocchio_of(arm)
    J = pin.computeFrameJacobian(model, model.createData(), arm.home, model.getFrameId(arm.tool))
    assert np.linalg.svd(J, compute_uv=False)[min(arm.n, 6) - 1] > 0.02


def test_the_panda_starts_in_the_pose_of_frankas_examples() -> None:
    arm = load_arm("panda")
    expected = [0, -np.pi / 4, 0, -3 * np.pi / 4, 0, np.pi / 2, np.pi / 4]
    np.testing.assert_allclose(arm.home, expected)
    assert arm.tool == "panda_hand_tcp"
    assert arm.commands == ("torque", "velocity", "position")


@pytest.mark.parametrize("name", ["ur3", "ur5", "ur10", "xarm7", "kinova"])
def test_an_arm_without_rotors_says_so_and_which_values_others_take(name: str) -> None:
    arm, report = load_arm(name), check_model(name)
    assert not arm.rotor_inertia.any()
    (note,) = [note for note in arm.notes if "no rotor inertia" in note]
    assert note in report.notes
    found = re.search(r"with_joints\(rotor_inertia=(.*)\)", note)
    assert found
    values = ast.literal_eval(found.group(1))
    heavier = arm.with_joints(rotor_inertia=values)
    np.testing.assert_array_equal(heavier.rotor_inertia, values)
    assert not list(rotor_doubts(heavier))
    gears = [note for note in report.notes if "gears and no rotor inertia" in note]
    assert len(gears) == (name in ("xarm7", "kinova"))


def test_kinovas_continuous_joints_have_one_entry_of_q_each() -> None:
    arm = load_arm("kinova")
    assert arm.continuous == (0, 3, 5)
    assert arm.home.shape == (6,)
    assert any("'j2s6s200_joint_1', 'j2s6s200_joint_4', 'j2s6s200_joint_6': continuous" in note for note in arm.notes)


def test_so101s_zero_axis_on_a_fixed_joint_is_no_problem() -> None:
    assert load_arm("so101").n == 5


def test_fr3_has_the_hand_that_the_clean_file_lacks() -> None:
    arm = load_arm("fr3")
    assert "fr3_hand_tcp" in arm.frame_names
    assert arm.bodies[-1].mass == pytest.approx(0.6271432862 + 0.6544 + 2 * 0.0291)
    assert arm.notes[0].startswith("rotor inertia is left out")
    np.testing.assert_allclose(np.array([4.206399e-5, 3.211626e-5]) * 120**2, [0.606, 0.462], atol=1e-3)
    np.testing.assert_allclose(3.211626e-5 * 80**2, 0.206, atol=1e-3)


def test_meshes_that_mujoco_can_show_lie_inside_the_package() -> None:
    arm = load_arm("panda")
    root = str(metadata.distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data"))
    files = [visual.file for visual in arm.visuals if visual.shape == "mesh"]
    assert len(files) == 9
    assert all(file.startswith(root) and file.endswith(".stl") for file in files)


@pytest.mark.parametrize("name", ["panda", "fr3"])
def test_a_missing_package_is_named_with_the_command_that_installs_it(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(wanted: str) -> metadata.Distribution:
        raise metadata.PackageNotFoundError(wanted)

    monkeypatch.setattr(metadata, "distribution", nothing)
    with refused(MissingExtraError):
        load_arm(name)


def test_an_entry_without_its_locks_is_refused_for_the_coupled_finger() -> None:
    with pytest.raises(ValueError, match="it mimics 'panda_finger_joint1'"):  # whose file lies elsewhere
        load_arm("panda", locked={"panda_finger_joint1": None, "panda_finger_joint2": None})
