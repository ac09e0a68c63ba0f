"""taut.inverse_kinematics against Pinocchio's poses: how often it finds a target, and what it says where it does not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from maths_oracles import Oracle, catalogue_oracle, oracle_of, random_state, random_tree, torso
from refusals import refused

import taut
from taut.base.types import Float64Array
from taut.maths.ik import IkOutcome, task_of

Bar = Callable[[str, object], None]
Share = Callable[[int], int]
TOLERANCE = (1e-6, 1e-6)  # the default
NAMED = ("panda", "fr3", "ur3", "ur10", "xarm7", "z1", "kinova")


def posed(oracle: Oracle, q: Float64Array) -> taut.Pose:
    M = oracle.pose(q)
    return taut.Pose(M.translation, R=M.rotation)


def left(oracle: Oracle, q: Float64Array, target: taut.Pose) -> tuple[float, float]:
    """What Pinocchio says of the error."""
    M = oracle.pose(q)
    return float(np.linalg.norm(M.translation - target.p)), float(np.linalg.norm(pin.log3(target.R @ M.rotation.T)))


def check_found(arm: taut.Arm, oracle: Oracle, count: int, seed: int) -> int:
    """How many of the targets are found; what is found is right, and within the limits."""
    rng, solved = np.random.default_rng(seed), 0
    for _ in range(count):
        target = posed(oracle, random_state(arm, rng)[0])
        found = taut.inverse_kinematics(arm, target)
        solved += found.ok
        assert (found.q >= arm.lower).all()
        assert (found.q <= arm.upper).all()
        linear, angular = left(oracle, found.q, target)
        assert found.ok == (linear < TOLERANCE[0] * 1.001 and angular < TOLERANCE[1] * 1.001)
        assert np.allclose((linear, angular), found.error, rtol=1e-6, atol=1e-9)
    return solved


@pytest.mark.part(2)
@pytest.mark.bars
@pytest.mark.parametrize("name", NAMED)
def test_targets_within_reach_are_found(name: str, share: Share, bar: Bar) -> None:
    arm, count = taut.load_arm(name), share(1000)
    solved = check_found(arm, catalogue_oracle(name, arm), count, seed=1)
    bar(f"inverse kinematics of {name}, from home, {count} random targets within reach: found", solved)
    assert solved == count


@pytest.mark.bars
def test_targets_of_arms_that_nobody_has_seen_are_found(share: Share, bar: Bar) -> None:
    """Chains and trees with joints of all kinds about any axes."""
    found = asked = 0
    for seed in range(share(60)):
        rng = np.random.default_rng(1000 + seed)
        arm = torso(rng) if seed % 4 == 0 else random_tree(rng, int(rng.integers(6, 9)), branches=False)
        arm = dataclasses.replace(arm, payload=taut.Payload())
        found += check_found(arm, oracle_of(arm), 10, seed)
        asked += 10
    bar(f"inverse kinematics of random arms, {asked} random targets within reach: found", found)
    assert found == asked


class TestArmsWithJointsToSpare:
    def test_end_where_nothing_of_the_way_to_the_posture_is_free(self) -> None:
        arm, rng = taut.load_arm("panda"), np.random.default_rng(2)
        for _ in range(5):
            q = np.clip(arm.home + 0.3 * rng.normal(size=7), arm.lower + 0.1, arm.upper - 0.1)
            posture = np.clip(q + 0.1 * rng.normal(size=7), arm.lower, arm.upper)
            target = taut.snapshot(arm, q).T()
            found = taut.inverse_kinematics(arm, target, q0=q, posture=posture)
            assert found.ok
            J = taut.snapshot(arm, found.q).J()
            inside = (found.q > arm.lower).all() and (found.q < arm.upper).all()
            assert inside
            assert np.abs((np.eye(7) - np.linalg.pinv(J) @ J) @ (posture - found.q)).max() <= 1e-6

    def test_stay_where_they_are_if_they_are_there(self) -> None:
        arm = taut.load_arm("panda")
        found = taut.inverse_kinematics(arm, taut.snapshot(arm, arm.home).T())
        assert np.abs(found.q - arm.home).max() <= 1e-9

    def test_bring_the_position_alone_home_with_less_motion(self) -> None:
        arm = taut.load_arm("panda")
        target = taut.snapshot(arm, arm.home + 0.2).T()
        whole, part = (taut.inverse_kinematics(arm, target, directions=d) for d in ("all", "position"))
        assert whole.ok
        assert part.ok
        assert np.linalg.norm(part.q - arm.home) < np.linalg.norm(whole.q - arm.home)
        assert np.abs(taut.snapshot(arm, part.q).T().p - target.p).max() < 1e-6


class TestArmsOfFiveJoints:
    ARM = taut.load_arm("so101")

    def test_say_what_is_left_of_six_directions_and_it_is_least(self) -> None:
        target = taut.snapshot(self.ARM, self.ARM.home).T() @ taut.Pose(rpy=[0.0, 0.3, 0.0])
        found = taut.inverse_kinematics(self.ARM, target)
        assert found.outcome is IkOutcome.FEWER_JOINTS
        assert found.sentence.startswith("the joints move the tool in fewer directions than were asked for")
        x = taut.snapshot(self.ARM, found.q)
        task = task_of(self.ARM, None, "all")
        assert np.abs(task.seen(x.T(), x.J()).T @ task.error(x.T(), target)).max() <= 1e-6


def test_a_tool_that_may_spin_points_where_it_is_told() -> None:
    arm = taut.load_arm("ur10")
    target = taut.snapshot(arm, arm.home + 0.2).T() @ taut.Pose(rpy=[0.0, 0.0, 1.0])
    found = taut.inverse_kinematics(arm, target, directions="pointing")
    T = taut.snapshot(arm, found.q).T()
    assert found.ok
    assert np.abs(T.p - target.p).max() < 1e-6
    assert np.abs(T.R[:, 2] - target.R[:, 2]).max() < 1e-6
    assert np.linalg.norm(pin.log3(np.array(target.R.T @ T.R))) > 0.1  # the spin was left free


class TestWhatCannotBeReached:
    def test_a_target_out_of_reach_is_approached_as_far_as_the_arm_goes(self) -> None:
        """The plane arm stretches out towards it: the distance that is left is known."""
        arm = taut.load_arm("planar2").with_tool("tool")
        T = taut.snapshot(arm, [0.4, 0.0]).T()
        away = taut.Pose(T.p * 1.5, R=T.R)
        found = taut.inverse_kinematics(arm, away, directions="position")
        assert found.outcome is IkOutcome.OUT_OF_REACH
        assert found.error[0] == pytest.approx(0.5 * np.linalg.norm(T.p), rel=1e-6)
        assert "no start that was tried leads to the target" in found.sentence
        assert "m and 0 rad are left after" in found.sentence

    def test_a_joint_at_its_limit_is_named(self) -> None:
        arm = taut.load_arm("gantry3")
        T = taut.snapshot(arm, arm.home).T()
        found = taut.inverse_kinematics(arm, taut.Pose(T.p + np.array([0.8, 0.1, 0.0]), R=T.R), restarts=3)
        assert found.outcome is IkOutcome.AT_LIMIT
        assert found.held == (arm.joint_names[0],)
        assert found.error[0] == pytest.approx(0.3, abs=1e-6)
        assert found.sentence.startswith(
            f"a joint is at its limit, and the others cannot make up for it ('{arm.joint_names[0]}'): 0.3 m and"
        )


def test_hinges_that_turn_further_than_once_end_near_the_start() -> None:
    arm = taut.load_arm("kinova")
    q0 = arm.home + np.array([2.0 * np.pi, 0.0, 0.0, -4.0 * np.pi, 0.0, 2.0 * np.pi])
    target = taut.snapshot(arm, arm.home + 0.3).T()
    found = taut.inverse_kinematics(arm, target, q0=q0)
    assert found.ok
    assert np.abs(found.q - q0)[list(arm.continuous)].max() <= np.pi


def test_the_same_seed_finds_the_same() -> None:
    arm = taut.load_arm("z1")
    target = taut.snapshot(arm, random_state(arm, np.random.default_rng(5))[0]).T()
    one, two = (taut.inverse_kinematics(arm, target, seed=7) for _ in range(2))
    assert np.array_equal(one.q, two.q)


def test_another_frame_than_the_tool_goes_to_the_target() -> None:
    arm = taut.load_arm("panda")
    target = taut.snapshot(arm, arm.home + 0.1).T("panda_link8")
    found = taut.inverse_kinematics(arm, target, frame="panda_link8")
    assert np.abs(taut.snapshot(arm, found.q).T("panda_link8").p - target.p).max() < 1e-6


ARM = taut.load_arm("panda")
POSE = taut.snapshot(ARM, ARM.home).T()


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda: taut.inverse_kinematics("panda", POSE), taut.errors.UsageError),
        (lambda: taut.inverse_kinematics(ARM, np.eye(4)), taut.errors.UsageError),
        (lambda: taut.inverse_kinematics(ARM, POSE, frame="panda_hand_tpc"), taut.errors.UnknownNameError),
        (lambda: taut.inverse_kinematics(ARM, POSE, directions="five"), taut.errors.UsageError),
        (lambda: taut.inverse_kinematics(ARM, POSE, q0=np.zeros(6)), taut.errors.ShapeError),
        (lambda: taut.inverse_kinematics(ARM, POSE, q0=np.zeros(7)), taut.errors.RangeError),
        (lambda: taut.inverse_kinematics(ARM, POSE, q0=np.degrees(ARM.home)), taut.errors.RangeError),
        (lambda: taut.inverse_kinematics(ARM, POSE, posture=[np.nan] * 7), taut.errors.RangeError),
        (lambda: taut.inverse_kinematics(ARM, POSE, tolerance=(1e-6, 0.0)), taut.errors.RangeError),
        (lambda: taut.inverse_kinematics(ARM, POSE, restarts=-1), taut.errors.RangeError),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(call: Callable[[], object], error: type[Exception]) -> None:
    with refused(error):
        call()
