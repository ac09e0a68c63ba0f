"""An Arm cannot be changed: every array that can be reached from it is its own, and read-only."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arm_models import PAIR

import taut
from taut.arm.builtin import BUILT_IN
from taut.arm.catalogue import CATALOGUE
from taut.arm.description import Arm, Body, Frame, Joint, Visual
from taut.trace.pose import Pose

R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
COMPUTED = ("lower", "upper", "velocity", "effort", "viscous", "coulomb", "rotor_inertia")


def arrays_of(thing: object, path: str = "arm", seen: set[int] | None = None) -> Iterator[tuple[str, np.ndarray]]:
    """Every array that can be reached, with the way to it."""
    seen = set() if seen is None else seen
    if id(thing) in seen or isinstance(thing, (str, int, float, type(None))):
        return
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        yield path, thing
        return
    parts: dict[str, object] = dict(getattr(thing, "__dict__", {}))
    parts |= {name: getattr(thing, name) for name in getattr(type(thing), "__slots__", ())}
    if isinstance(thing, dict):
        parts = {str(key): value for key, value in thing.items()}
    elif isinstance(thing, (tuple, list)):
        parts = {str(i): value for i, value in enumerate(thing)}
    for name, value in parts.items():
        yield from arrays_of(value, f"{path}.{name}", seen)


def assert_frozen(arm: Arm) -> None:
    for name in COMPUTED:  # kept by the arm once they are asked for
        getattr(arm, name)
    found = dict(arrays_of(arm))
    assert {"arm.bodies.0.com", "arm.joints.0.axis", "arm.joints.0.placement.R", "arm.home", "arm.gravity"} <= set(
        found
    )
    assert {"arm.T_WB.p", "arm.frames.0.placement.p", "arm.payload.com", *(f"arm.{n}" for n in COMPUTED)} <= set(
        found
    )
    for path, array in found.items():
        assert not array.flags.writeable, path
        base = array.base
        while isinstance(base, np.ndarray):  # nor through what it is a view of
            assert not base.flags.writeable, path
            base = base.base


@pytest.mark.parametrize("name", [*BUILT_IN, *CATALOGUE])
def test_every_array_of_a_known_arm_is_read_only(name: str) -> None:
    assert_frozen(taut.load_arm(name))


def made_in_every_way(tmp_path: Path) -> Iterator[tuple[str, Arm]]:
    file = tmp_path / "pair.xml"
    file.write_text(PAIR)
    yield "MJCF", taut.load_arm(file)
    yield "mounted", taut.load_arm("planar2", T_WB=Pose([0.0, 0.0, 1.0], R=R) @ Pose([0.1, 0.0, 0.0]))
    M, S = np.tile(np.eye(4), (3, 1, 1)), np.array([[0, 0, 1, 0, 0, 0], [0, 0, 1, 0, -1, 0]], dtype=float).T
    M[1, 0, 3] = M[2, 0, 3] = 1.0
    yield "screws", Arm.from_screws(M, np.tile(np.diag([0.1, 0.2, 0.2, 1, 1, 1]), (2, 1, 1)), S)
    yield "Pinocchio", taut.load_arm(pin.buildSampleModelManipulator(), tool="effector_body")
    arm = taut.load_arm("panda")
    yield "tool", arm.with_tool("panda_link8", Pose([0.1, 0.2, 0.3]))
    yield "gravity", arm.with_gravity(np.array([0.0, 1.0, -9.0]))
    yield "payload", arm.with_payload(1.0, com=np.array([0.1, 0.0, 0.0]), inertia=0.01 * np.eye(3))
    yield "subset", arm.subset(arm.joint_names[2:5])
    yield "perturbed", arm.perturbed(seed=1, mass=0.1, com=0.01, inertia=0.1, friction=0.1)
    yield "body", arm.with_body("panda_joint3", com=np.array([0.0, 0.1, 0.0]), inertia=0.1 * np.eye(3))
    yield "joints", arm.with_joints(viscous=np.ones(7))


def test_every_array_is_read_only_however_the_arm_was_made(tmp_path: Path) -> None:
    for how, arm in made_in_every_way(tmp_path):
        try:
            assert_frozen(arm)
        except AssertionError as error:
            raise AssertionError(how) from error


def test_what_was_handed_in_is_copied() -> None:
    com, inertia, axis, p, turn = np.zeros(3), np.eye(3), np.array([0.0, 0.0, 1.0]), np.zeros(3), np.array(R)
    placement = Pose.of(turn, p)
    home, gravity = np.zeros(1), np.array([0.0, 0.0, -9.81])
    arm = dataclasses.replace(
        taut.load_arm("one_joint"),
        bodies=(Body(mass=1.0, com=com, inertia=inertia),),
        joints=(Joint(name="j", kind="revolute", parent=-1, placement=placement, axis=axis),),
        frames=(Frame(name="tool", body=0, placement=placement),),
        visuals=(Visual(body=0, placement=placement, shape="sphere", size=(1.0,)),),
        tool="tool",
        home=home,
        gravity=gravity,
        T_WB=placement,
    )
    assert_frozen(arm)
    before = {path: array.copy() for path, array in arrays_of(arm)}
    for array in (com, inertia, axis, p, turn, home, gravity):
        array += 1.0
    for path, array in arrays_of(arm):
        np.testing.assert_array_equal(array, before[path], err_msg=path)


def test_what_is_not_an_arm_of_floats_is_a_pose_of_its_own() -> None:
    T = Pose(p=[1.0, 2.0, 3.0], R=R)
    for pose in (
        T,
        Pose(),
        T @ T,
        T.inverse(),
        T.inverse() @ T,
        Pose.of(np.array(R), np.zeros(3)),
        Pose.from_matrix(T.matrix),
    ):
        for array in (pose.R, pose.p):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 5.0


def test_gravity_is_not_changed_by_writing_into_a_body() -> None:
    arm = taut.load_arm("planar2")
    with pytest.raises(ValueError, match="read-only"):
        arm.bodies[0].com[0] = 5.0
