"""Awkward arms and changed copies: branches, reversed joints, many joints, locked ones, modelling errors."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arm_oracles import pinocchio_of, random_q
from arm_urdf_text import as_urdf
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused, warned

import taut
from taut.arm.description import BASE, Arm, Friction, Payload
from taut.arm.load import load_arm
from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink, assemble
from taut.arm.parts import Body, Joint
from taut.arm.rules import check_inertia
from taut.base.errors import ModelError, RangeError, ShapeError, TautError, UnknownNameError, UsageError
from taut.trace.pose import Pose


def chain(n: int, seed: int = 0) -> Tree:
    """n joints of mixed kinds about slanted axes, some turned around."""
    rng = np.random.default_rng(seed)
    tree = Tree(name=f"chain{n}", source="test", links=[TreeLink(name="l0")])
    for i in range(n):
        inertia = Body(mass=1.0 + i % 3, com=rng.normal(size=3) * 0.1, inertia=np.diag([0.02, 0.03, 0.04]))
        tree.links.append(TreeLink(name=f"l{i + 1}", inertia=inertia))
        kind = ("revolute", "continuous", "prismatic")[i % 3]
        place = Pose(rng.normal(size=3) * 0.2, rpy=rng.normal(size=3))
        axis = rng.normal(size=3) if i % 2 else -np.eye(3)[i % 3]
        limits = {} if kind == "continuous" else {"lower": -1.0, "upper": 1.5}
        joint = Joint(name=f"j{i}", kind=kind, placement=place, axis=axis, **limits)
        tree.joints.append(TreeJoint(joint=joint, parent=f"l{i}", child=f"l{i + 1}"))
    return tree


def torso() -> Tree:
    """A turning trunk with two arms of two joints each."""
    tree = Tree(name="torso", source="test", links=[TreeLink(name="floor")])

    def add(name: str, parent: str, origin: Pose) -> None:
        inertia = Body(mass=1.0, com=np.array([0.1, 0.0, 0.0]), inertia=np.diag([0.01, 0.02, 0.02]))
        tree.links.append(TreeLink(name=name, inertia=inertia))
        joint = Joint(name=f"{name}_joint", kind="revolute", placement=origin, lower=-2.0, upper=2.0)
        tree.joints.append(TreeJoint(joint=joint, parent=parent, child=name))

    add("right_lower", "right_upper", Pose((0.3, 0, 0)))  # children may come before their parents
    add("trunk", "floor", Pose((0, 0, 0.5), rpy=(0, math.pi / 2, 0)))
    for side, y in (("left", 0.2), ("right", -0.2)):
        add(f"{side}_upper", "trunk", Pose((0, y, 0.4)))
    add("left_lower", "left_upper", Pose((0.3, 0, 0)))
    return tree


def same_motion(arm: Arm, q: np.ndarray, other: Arm, q_other: np.ndarray) -> None:
    """The shared frames of two arms stand in the same places."""
    models = [pinocchio_of(arm), pinocchio_of(other)]
    datas = [model.createData() for model in models]
    for model, data, at in zip(models, datas, (q, q_other), strict=True):
        pin.framesForwardKinematics(model, data, np.asarray(at, dtype=float))
    for name in other.frame_names:
        a, b = (data.oMf[model.getFrameId(name)] for model, data in zip(models, datas, strict=True))
        np.testing.assert_allclose(a.homogeneous, b.homogeneous, atol=1e-12)


# -------------------------------------------------------------------- awkward arms


@pytest.mark.parametrize("n", [1, 2, 7, 30])
def test_chains_of_any_length_are_assembled_in_order(n: int) -> None:
    arm = assemble(taut.Arm, chain(n))
    assert arm.joint_names == tuple(f"j{i}" for i in range(n))
    assert [joint.parent for joint in arm.joints] == list(range(-1, n - 1))
    assert arm.tool == f"l{n}"
    for joint in arm.joints:
        assert np.linalg.norm(joint.axis) == pytest.approx(1.0)


def test_a_joint_turned_around_is_the_same_arm_with_the_other_sign() -> None:
    tree, turned = chain(4), chain(4)
    for item in turned.joints:
        joint = item.joint
        item.joint = dataclasses.replace(joint, axis=-joint.axis, lower=-joint.upper, upper=-joint.lower)
    q = np.array([0.3, -0.4, 0.2, 0.1])
    same_motion(assemble(taut.Arm, tree), q, assemble(taut.Arm, turned), -q)


def test_two_arms_on_a_torso_are_two_whole_chains() -> None:
    arm = load_arm(torso(), tool="left_lower")
    assert arm.joint_names == (
        "trunk_joint",
        "left_upper_joint",
        "left_lower_joint",
        "right_upper_joint",
        "right_lower_joint",
    )
    assert [joint.parent for joint in arm.joints] == [BASE, 0, 1, 0, 3]
    assert arm.ancestors(4) == (0, 3, 4)
    with refused(UsageError):
        assemble(taut.Arm, torso())


def test_gravity_and_mounting_are_the_callers() -> None:
    arm = assemble(taut.Arm, chain(3), gravity=(9.81, 0, 0), T_WB=Pose(rpy=(math.pi, 0, 0)))
    np.testing.assert_array_equal(arm.gravity, (9.81, 0, 0))
    np.testing.assert_allclose(arm.T_WB.R, np.diag([1.0, -1.0, -1.0]), atol=1e-15)


def test_locking_joints_while_loading_or_afterwards_is_the_same_arm() -> None:
    tree = torso()
    whole = load_arm(tree, tool="left_lower")
    q = np.array([0.3, -0.5, 0.7, 0.2, -0.1])
    keep = ["trunk_joint", "left_lower_joint"]
    locked = {name: q[i] for i, name in enumerate(whole.joint_names) if name not in keep}
    early, late = load_arm(tree, tool="left_lower", locked=locked), whole.subset(keep, q)
    assert early.joint_names == late.joint_names == ("trunk_joint", "left_lower_joint")
    assert late.frame_names == whole.frame_names
    for a, b in zip(early.bodies, late.bodies, strict=True):
        assert set(a.links) == set(b.links)
        assert a.mass == pytest.approx(b.mass)
        np.testing.assert_allclose(a.com, b.com, atol=1e-14)
        np.testing.assert_allclose(a.inertia, b.inertia, atol=1e-14)
    same_motion(early, q[[0, 2]], late, q[[0, 2]])
    same_motion(whole, q, late, q[[0, 2]])


def test_a_subset_has_the_whole_arms_torques_where_it_moves() -> None:
    whole = load_arm("panda")
    keep = ["panda_joint2", "panda_joint4", "panda_joint6"]
    index = [whole.joint_index(name) for name in keep]
    part = whole.subset(keep)
    assert part.tool == whole.tool
    np.testing.assert_allclose(part.home, whole.home[index])
    rng = np.random.default_rng(0)
    for _ in range(3):
        q, v, a = whole.home.copy(), np.zeros(7), np.zeros(7)
        q[index] += 0.1 * rng.normal(size=3)
        v[index], a[index] = rng.normal(size=3), rng.normal(size=3)
        models = pinocchio_of(whole), pinocchio_of(part)
        expected = pin.rnea(models[0], models[0].createData(), q, v, a)[index]
        got = pin.rnea(models[1], models[1].createData(), q[index], v[index], a[index])
        np.testing.assert_allclose(got, expected, atol=1e-11)


def test_a_subset_keeps_what_the_arm_carries() -> None:
    arm = load_arm("planar3").with_payload(1.5, com=(0, 0, 0.1)).with_gravity((0, 0, -1))
    part = arm.mounted(Pose((1, 0, 0))).subset("joint2")
    assert (part.payload.mass, part.gravity[2], part.T_WB.p[0], part.n) == (1.5, -1.0, 1.0, 1)


def test_a_tool_can_be_another_frame_or_a_new_one() -> None:
    arm = load_arm("panda")
    assert arm.with_tool("panda_link8").frame().name == "panda_link8"
    new = arm.with_tool("panda_hand", Pose((0, 0, 0.2)), name="pen")
    np.testing.assert_allclose(new.frame().placement.p, (0, 0, 0.107 + 0.2), atol=1e-15)
    with refused(UnknownNameError):
        arm.with_tool("panda_hand_tpc")


# -------------------------------------------------------------------- modelling errors


@settings(deadline=None, max_examples=60, derandomize=True)
@given(
    seed=st.integers(0, 2**32),
    name=st.sampled_from(["panda", "so101", "planar2", "gantry3"]),
    mass=st.floats(0, 1),
    com=st.floats(0, 1),
    inertia=st.floats(0, 1),
    friction=st.floats(0, 1),
)
def test_a_perturbed_copy_is_always_a_possible_arm(
    seed: int, name: str, mass: float, com: float, inertia: float, friction: float
) -> None:
    arm = ARMS[name].perturbed(seed=seed, mass=mass, com=com, inertia=inertia, friction=friction)
    for body in arm.bodies:
        assert check_inertia(body.mass, body.inertia) is None
    assert (arm.viscous >= 0).all()
    model = pinocchio_of(arm)
    M = pin.crba(model, model.createData(), random_q(arm, np.random.default_rng(seed)))
    assert np.linalg.eigvalsh(M)[0] > 0


ARMS = {name: load_arm(name) for name in ("panda", "so101", "planar2", "gantry3")}


def test_a_perturbed_copy_is_drawn_once_from_its_seed() -> None:
    arm = load_arm("panda")
    once, again, other = (arm.perturbed(seed=seed, mass=0.1, com=0.01, inertia=0.2) for seed in (1, 1, 2))
    assert all((a.com == b.com).all() for a, b in zip(once.bodies, again.bodies, strict=True))
    assert once.total_mass == again.total_mass != other.total_mass
    same = arm.perturbed(seed=3)
    np.testing.assert_allclose([b.mass for b in same.bodies], [b.mass for b in arm.bodies])
    np.testing.assert_allclose(same.bodies[2].inertia, arm.bodies[2].inertia, atol=1e-15)


def test_the_spread_of_a_perturbed_mass_is_the_one_that_was_asked_for() -> None:
    arm = load_arm("planar2")
    logs = [math.log(arm.perturbed(seed=seed, mass=0.2).bodies[0].mass / 4.0) for seed in range(400)]
    assert np.std(logs) == pytest.approx(0.2, rel=0.1)


def test_a_flat_body_that_a_file_rounded_stays_possible() -> None:
    tree = chain(1)
    tree.links[1].inertia = Body(mass=1.0, com=np.zeros(3), inertia=np.diag([0.1, 0.2, 0.3 * (1 + 5e-7)]))
    arm = assemble(taut.Arm, tree)
    for seed in range(50):
        body = arm.perturbed(seed=seed, inertia=1.0).bodies[0]
        assert check_inertia(body.mass, body.inertia) is None


# -------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "error"),
    [
        (lambda arm: arm.with_body("joint1", mass=-1.0), ModelError),
        (lambda arm: arm.with_body("joint1", mass=math.nan), RangeError),
        (lambda arm: arm.with_body("joint1", com=[0, 0]), ShapeError),
        (lambda arm: arm.with_body("joint1", inertia=np.diag([9.0, 1, 1])), ModelError),
        (lambda arm: arm.with_body("joint1", inertia=[[1, 1, 0], [0, 1, 0], [0, 0, 1]]), ModelError),
        (lambda arm: arm.with_body("joint9", mass=1.0), UnknownNameError),
        (lambda arm: arm.with_joints(friction=1.0), UnknownNameError),
        (lambda arm: arm.with_joints(viscous=-1.0), RangeError),
        (lambda arm: arm.with_joints(viscous=[1.0, 2.0, 3.0]), ShapeError),
        (lambda arm: arm.with_joints(viscous="lots"), ShapeError),
        (lambda arm: arm.with_joints(effort={"joint2": 0.0}), RangeError),
        (lambda arm: arm.with_joints(effort={"elbow": 1.0}), UnknownNameError),
        (lambda arm: arm.with_joints(lower=[0.0, 2.0], upper=[1.0, 1.0]), ModelError),
        (lambda arm: arm.with_joints(rotor_inertia=math.inf), RangeError),
        (lambda arm: arm.with_joints(velocity=math.nan), RangeError),
        (lambda arm: arm.subset([]), UsageError),
        (lambda arm: arm.subset(["joint1", "joint1"]), UsageError),
        (lambda arm: arm.subset(["knee"]), UnknownNameError),
        (lambda arm: arm.subset(["joint1"], [0.0]), ShapeError),
        (lambda arm: arm.perturbed(seed=1, mass=-0.1), RangeError),
        (lambda arm: arm.perturbed(seed=1, com=math.inf), RangeError),
        (lambda arm: arm.perturbed(seed=1, inertia=50.0), RangeError),
        (lambda arm: arm.perturbed(seed=-1), RangeError),
        (lambda arm: arm.perturbed(seed="x"), RangeError),
        (lambda arm: arm.mounted("here"), UsageError),
        (lambda arm: arm.with_payload(-1.0), RangeError),
        (lambda arm: arm.with_payload(1.0, inertia=[1, 1, 3, 0, 0, 0]), RangeError),
        (lambda arm: arm.with_payload(1.0, inertia=[1, 1, 1, 5, 0, 0]), RangeError),
        (lambda arm: arm.with_tool("tool", Pose(), name="link1"), UsageError),
    ],
)  # fmt: skip
def test_impossible_copies_are_refused_in_words(change, error: type[TautError]) -> None:
    with refused(error):
        change(load_arm("planar2"))


def test_a_continuous_joint_gets_no_position_limits() -> None:
    with refused(ModelError):
        load_arm("kinova").with_joints(lower=-1.0, upper=1.0)
    limits = {"j2s6s200_joint_2": 1.0}
    assert load_arm("kinova").with_joints(lower=limits).lower[1] == 1.0


def test_a_changed_copy_leaves_the_arm_alone() -> None:
    arm = load_arm("planar2")
    heavier = arm.with_body("joint2", mass=9.0).with_joints(viscous={"joint2": 0.7}, effort=50.0)
    assert (arm.bodies[1].mass, arm.viscous[1], arm.effort[1]) == (2.0, 0.1, math.inf)
    assert (heavier.bodies[1].mass, heavier.viscous[1], heavier.effort[1]) == (9.0, 0.7, 50.0)
    with pytest.raises(ValueError, match="read-only"):
        arm.viscous[0] = 1.0


def test_a_point_mass_is_a_possible_payload() -> None:
    assert Payload(mass=1.0, com=[0, 0, 0.1]).inertia.tolist() == [0.0] * 6
    assert Payload(mass=1.0, inertia=np.diag([0.1, 0.2, 0.3])).inertia.tolist() == [0.1, 0.2, 0.3, 0.0, 0.0, 0.0]


# -------------------------------------------------------------------- there and back again

numbers = st.floats(-2, 2, allow_nan=False).map(lambda x: round(x, 6))
triples = st.tuples(numbers, numbers, numbers)


@st.composite
def trees(draw: st.DrawFn) -> Tree:
    """Any tree of up to six joints, with branches, fixed joints and frames without mass."""
    tree = Tree(name="drawn", source="test", links=[TreeLink(name="l0")])
    for i in range(draw(st.integers(1, 6))):
        sizes = np.array([abs(x) + 0.01 for x in draw(triples)])
        inertia = Body(mass=float(sizes.sum()), com=np.array(draw(triples)), inertia=np.diag(sizes.sum() - sizes))
        tree.links.append(TreeLink(name=f"l{i + 1}", inertia=inertia))
        kind = "revolute" if i == 0 else draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed"]))
        parent = f"l{draw(st.integers(0, i))}"
        place, axis = Pose(draw(triples), rpy=draw(triples)), np.array(draw(triples))
        values = {"velocity": 1.0 + abs(draw(numbers)), "effort": 1.0 + abs(draw(numbers))}
        values |= {"viscous": abs(draw(numbers)), "coulomb": abs(draw(numbers))}
        if kind in ("revolute", "prismatic"):
            values |= {"lower": -1.0 - abs(draw(numbers)), "upper": 1.0 + abs(draw(numbers))}
        axis = axis if np.linalg.norm(axis) > 0.1 else np.array([0.0, 0.0, 1.0])
        joint = Joint(name=f"j{i}", kind=kind, placement=place, axis=axis, **values)
        tree.joints.append(TreeJoint(joint=joint, parent=parent, child=f"l{i + 1}"))
    return tree


@settings(deadline=None, max_examples=60, derandomize=True)
@given(tree=trees())
def test_an_arm_written_as_urdf_and_read_back_is_the_same_arm(
    tree: Tree, tmp_path_factory: pytest.TempPathFactory
) -> None:
    arm = load_arm(tree, tool="l1")
    file = tmp_path_factory.mktemp("urdf") / "drawn.urdf"
    file.write_text(as_urdf(arm))
    again = load_arm(file, tool="l1")
    assert again.joint_names == arm.joint_names
    assert set(arm.frame_names) <= set(again.frame_names)
    for a, b in zip(again.joints, arm.joints, strict=True):
        assert (a.kind, a.parent, a.lower, a.upper) == (b.kind, b.parent, b.lower, b.upper)
        assert (a.velocity, a.effort, a.viscous, a.coulomb) == (b.velocity, b.effort, b.viscous, b.coulomb)
        np.testing.assert_allclose(a.placement.matrix, b.placement.matrix, atol=1e-9)
        np.testing.assert_allclose(a.axis, b.axis, atol=1e-12)
    for a, b in zip(again.bodies, arm.bodies, strict=True):
        assert a.mass == b.mass
        np.testing.assert_allclose(a.com, b.com, atol=1e-12)
        np.testing.assert_allclose(a.inertia, b.inertia, atol=1e-12)
    for frame in arm.frames:
        assert again.frame(frame.name).body == frame.body
        np.testing.assert_allclose(again.frame(frame.name).placement.matrix, frame.placement.matrix, atol=1e-9)


def test_a_round_trip_of_the_panda_keeps_its_dynamics(tmp_path: Path) -> None:
    arm = load_arm("panda")
    (tmp_path / "p.urdf").write_text(as_urdf(arm))
    again = load_arm(tmp_path / "p.urdf", tool=arm.tool)
    M = [pin.crba(model, model.createData(), arm.home) for model in map(pinocchio_of, (arm, again))]
    np.testing.assert_allclose(M[0], M[1], atol=1e-12)


def test_a_home_that_new_limits_exclude_is_moved_into_them_and_that_is_noted() -> None:
    arm = load_arm("planar3")
    made = arm.with_joints(lower={"joint1": 2.5}, upper={"joint1": 3.0})
    assert made.home[0] == 2.5
    np.testing.assert_array_equal(made.home[1:], arm.home[1:])
    assert made.notes[-1] == "home of 'joint1' was moved into the new limits"
    assert arm.with_joints(viscous=1.0).notes == arm.notes


def test_a_tool_is_named_by_a_text() -> None:
    with refused(UsageError):
        load_arm("planar2").with_tool(None)  # type: ignore[arg-type]
    with refused(UnknownNameError):
        load_arm("planar2").subset([0])  # type: ignore[list-item]


def test_friction_at_rest_that_is_as_in_motion_stays_so() -> None:
    """Friction(coulomb=1.0) says nothing of rest; another coulomb then counts at rest too."""
    arm = load_arm("planar2").with_friction(Friction(coulomb=1.0, load_motor=0.1))
    for coulomb in (0.5, 2.0):
        assert arm.with_joints(coulomb=coulomb).friction.static.tolist() == [coulomb, coulomb]
    assert arm.with_joints(load_motor=0.2).friction.load_motor_static.tolist() == [0.2, 0.2]
    apart = load_arm("planar2").with_friction(Friction(coulomb=1.0, static=[1.0, 1.5]))
    assert apart.with_joints(coulomb=0.5).friction.static.tolist() == [0.5, 1.5]


def test_a_payload_far_from_the_tool_by_any_measure_of_the_arm_is_warned_of() -> None:
    arm = load_arm("panda")
    with warned(RuntimeWarning):
        assert arm.with_payload(1.0, com=[0.0, 0.0, 50.0]).payload.com[2] == 50.0
    arm.with_payload(1.0, com=[0.0, 0.0, 0.5])
