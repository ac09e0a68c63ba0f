"""Arms from Pinocchio models in memory."""

from __future__ import annotations

from importlib import metadata

import numpy as np
import pinocchio as pin
import pytest
from arm_models import DUO
from arm_oracles import pinocchio_of
from refusals import refused

import taut
from taut.arm.catalogue import CATALOGUE
from taut.arm.load import load_arm
from taut.base.errors import ModelError, UsageError

INERTIA = pin.Inertia(2.0, np.array([0.1, 0.0, 0.0]), np.diag([0.02, 0.03, 0.04]))


def one_joint(joint: pin.JointModel) -> pin.Model:
    model = pin.Model()
    i = model.addJoint(0, joint, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5])), "j")
    model.appendBodyToJoint(i, INERTIA, pin.SE3.Identity())
    return model


@pytest.mark.parametrize("name", ["panda", "kinova", "xarm7", "ur5"])
def test_a_model_read_by_pinocchio_is_the_arm_read_by_us(name: str) -> None:
    entry = CATALOGUE[name]
    model = pin.buildModelFromUrdf(str(metadata.distribution(entry.package).locate_file(entry.file)))
    model = pin.buildReducedModel(model, [model.getJointId(joint) for joint in entry.locked], pin.neutral(model))
    theirs, ours = load_arm(model, tool=entry.tool), load_arm(name)
    assert theirs.joint_names == ours.joint_names
    assert theirs.tool == ours.tool
    for a, b in zip(theirs.joints, ours.joints, strict=True):
        assert (a.kind, a.parent, a.lower, a.upper) == (b.kind, b.parent, b.lower, b.upper)
        assert (a.velocity, a.effort, a.viscous, a.coulomb) == (b.velocity, b.effort, b.viscous, b.coulomb)
        np.testing.assert_allclose(a.placement.matrix, b.placement.matrix, atol=1e-11)
        np.testing.assert_allclose(a.axis, b.axis, atol=1e-12)
    for a, b in zip(theirs.bodies, ours.bodies, strict=True):
        np.testing.assert_allclose(a.inertia, b.inertia, atol=1e-12)
        np.testing.assert_allclose(a.com, b.com, atol=1e-12)
    for frame in ours.frames:
        np.testing.assert_allclose(theirs.frame(frame.name).placement.matrix, frame.placement.matrix, atol=1e-11)
        assert theirs.frame(frame.name).body == frame.body


@pytest.mark.parametrize(
    ("joint", "kind", "axis"),
    [
        (pin.JointModelRX(), "revolute", (1, 0, 0)),
        (pin.JointModelRY(), "revolute", (0, 1, 0)),
        (pin.JointModelRZ(), "revolute", (0, 0, 1)),
        (pin.JointModelRevoluteUnaligned(np.array([0.0, 0.6, 0.8])), "revolute", (0, 0.6, 0.8)),
        (pin.JointModelRUBX(), "continuous", (1, 0, 0)),
        (pin.JointModelRUBY(), "continuous", (0, 1, 0)),
        (pin.JointModelRUBZ(), "continuous", (0, 0, 1)),
        (pin.JointModelPX(), "prismatic", (1, 0, 0)),
        (pin.JointModelPY(), "prismatic", (0, 1, 0)),
        (pin.JointModelPZ(), "prismatic", (0, 0, 1)),
        (pin.JointModelPrismaticUnaligned(np.array([0.0, -0.6, 0.8])), "prismatic", (0, -0.6, 0.8)),
    ],
    ids=lambda value: value.shortname() if hasattr(value, "shortname") else None,
)
def test_hinges_and_slides_of_every_kind_are_read(joint: pin.JointModel, kind: str, axis: tuple[float, ...]) -> None:
    arm = load_arm(one_joint(joint))
    assert arm.joints[0].kind == kind
    np.testing.assert_allclose(arm.joints[0].axis, axis, atol=1e-15)
    assert (arm.lower[0], arm.upper[0]) == (-np.inf, np.inf)
    assert arm.tool == "j"
    assert arm.notes[-1] == "no effort limit on 'j'"


def test_a_continuous_joint_about_a_slanted_axis_is_read() -> None:
    slanted = DUO.replace('<axis xyz="0 1 0"/>\n    <limit velocity', '<axis xyz="0.6 0 -0.8"/>\n    <limit velocity')
    model = pin.buildModelFromXML(slanted)
    assert model.joints[2].shortname() == "JointModelRevoluteUnboundedUnaligned"
    arm = load_arm(model)
    assert [joint.kind for joint in arm.joints] == ["revolute", "continuous"]
    np.testing.assert_allclose(arm.joints[1].axis, (0.6, 0, -0.8), atol=1e-15)


@pytest.mark.parametrize(
    "joint",
    [
        pin.JointModelFreeFlyer(),
        pin.JointModelPlanar(),
        pin.JointModelSpherical(),
        pin.JointModelSphericalZYX(),
        pin.JointModelComposite(pin.JointModelRX()),
        pin.JointModelHX(0.1),
        pin.JointModelTranslation(),
    ],
    ids=lambda joint: joint.shortname(),
)
def test_other_joints_are_refused_in_words(joint: pin.JointModel) -> None:
    with refused(ModelError):
        load_arm(one_joint(joint))


def test_a_coupled_finger_is_refused() -> None:
    entry = CATALOGUE["panda"]
    file = str(metadata.distribution(entry.package).locate_file(entry.file))
    with refused(ModelError):
        load_arm(pin.buildModelFromUrdf(file, mimic=True))


def test_rotor_inertia_is_the_armature_or_the_rotors_own() -> None:
    model = pin.buildSampleModelManipulator()
    assert not hasattr(model, "missing")
    model = one_joint(pin.JointModelRX())
    model.rotorInertia, model.rotorGearRatio = np.array([1e-4]), np.array([100.0])
    assert load_arm(model).rotor_inertia[0] == pytest.approx(1.0)
    assert load_arm(model).gear[0] == 100.0
    model.armature = np.array([0.3])  # what Pinocchio's own algorithms add
    assert load_arm(model).rotor_inertia[0] == 0.3


def test_gravity_and_limits_are_the_models_own_unless_given() -> None:
    model = one_joint(pin.JointModelPZ())
    model.gravity.linear = np.array([1.0, 0.0, -3.7])
    model.lowerPositionLimit, model.upperPositionLimit = np.array([-0.1]), np.array([0.2])
    arm = load_arm(model)
    np.testing.assert_allclose(arm.gravity, (1.0, 0.0, -3.7))
    assert (arm.lower[0], arm.upper[0]) == (-0.1, 0.2)
    np.testing.assert_allclose(load_arm(model, gravity=(0, 0, -1)).gravity, (0, 0, -1))


def test_a_model_without_mass_is_refused() -> None:
    model = one_joint(pin.JointModelRX())
    model.inertias[1] = pin.Inertia.Zero()
    with refused(ModelError):
        load_arm(model)


def test_several_ends_make_the_tool_a_question() -> None:
    model = one_joint(pin.JointModelRX())
    for name in ("left", "right"):
        model.addFrame(pin.Frame(name, 1, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    with refused(UsageError):
        load_arm(model)
    assert load_arm(model, tool="right").tool == "right"


def test_there_and_back_again_is_the_same_arm() -> None:
    arm = load_arm("kinova")
    again = load_arm(pinocchio_of(arm), tool=arm.tool)
    for a, b in zip(again.bodies, arm.bodies, strict=True):
        np.testing.assert_allclose(a.inertia, b.inertia, atol=1e-15)
    for a, b in zip(again.joints, arm.joints, strict=True):
        np.testing.assert_allclose(a.placement.matrix, b.placement.matrix, atol=1e-15)


def test_load_arm_takes_one_with_all_its_options() -> None:
    arm = taut.load_arm("panda")
    model = pinocchio_of(arm)
    loaded = taut.load_arm(model, tool="panda_hand", locked={"panda_joint1": 0.5}, T_WB=taut.Pose([1.0, 0.0, 0.0]))
    assert loaded.joint_names == arm.joint_names[1:]
    np.testing.assert_array_equal(loaded.T_WB.p, [1.0, 0.0, 0.0])
