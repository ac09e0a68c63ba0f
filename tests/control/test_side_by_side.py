"""Laws on disjoint joints: two arms on a torso, against each arm alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut

ROUNDING = 1e-12


@pytest.fixture(scope="module")
def baxter() -> taut.Arm:
    return taut.load_arm("baxter")


def held(side: str, **gains: Any) -> taut.Law:
    return taut.laws.Impedance(**({"K": (400.0, 20.0), "B": (40.0, 2.0), "tool": f"{side}_gripper"} | gains))


def both(arm: taut.Arm, shift: float = 0.02) -> Any:
    x = taut.snapshot(arm, arm.home)
    poses = {side: x.T(f"{side}_gripper") for side in ("left", "right")}
    return taut.together(
        **{side: taut.TaskMotion(pose=taut.Pose(T.p + shift * np.eye(3)[0], R=T.R)) for side, T in poses.items()}
    )


@pytest.mark.part(1)
@pytest.mark.parametrize("engine", ["native", "float"])
def test_each_arm_gets_the_torque_that_it_would_get_alone(baxter: taut.Arm, engine: Any) -> None:
    law = taut.SideBySide(left=held("left"), right=held("right", K=(200.0, 10.0)))
    ctrl = taut.compile(law, baxter, engine=engine)
    rng = np.random.default_rng(1)
    q, v = baxter.home + rng.uniform(-0.1, 0.1, 14), rng.uniform(-0.5, 0.5, 14)
    ref = both(baxter)
    tau = ctrl.step(q, v, ref)
    for side, stiffness in (("left", (400.0, 20.0)), ("right", (200.0, 10.0))):
        own = [i for i, name in enumerate(baxter.joint_names) if name.startswith(side)]
        arm = baxter.subset([baxter.joint_names[i] for i in own])
        alone = taut.compile(held(side, K=stiffness), arm, engine=engine)
        wanted = alone.step(q[own], v[own], getattr(ref, side))
        assert np.abs(tau[own] - wanted).max() <= ROUNDING * np.abs(wanted).max()
    assert np.abs(sum(ctrl.terms.values()) - tau).max() <= 1e-10


def test_a_gain_of_one_side_is_reached_by_its_name(baxter: taut.Arm) -> None:
    ctrl = taut.compile(taut.SideBySide(left=held("left"), right=held("right")), baxter)
    before = ctrl.step(baxter.home, np.zeros(14), both(baxter))
    ctrl.parameters["law.left.K"] = (800.0, 20.0)
    change = ctrl.step(baxter.home, np.zeros(14), both(baxter)) - before
    left = np.array([name.startswith("left") for name in baxter.joint_names])
    assert np.abs(change[left]).max() > 1.0
    assert np.abs(change[~left]).max() == 0.0


def test_both_come_to_rest_where_they_are_asked_to(baxter: taut.Arm) -> None:
    law = taut.SideBySide(left=held("left"), right=held("right"))
    run = taut.run(taut.compile(law, baxter), taut.RigidPlant(baxter, friction=None), both(baxter), duration=3.0)
    x0, x = taut.snapshot(baxter, baxter.home), taut.snapshot(baxter, run.q[-1])
    for frame in ("left_gripper", "right_gripper"):
        assert x.T(frame).p - x0.T(frame).p == pytest.approx([0.02, 0.0, 0.0], abs=5e-4)


def test_without_a_reference_both_hold_where_they_are(baxter: taut.Arm) -> None:
    law = taut.SideBySide(left=held("left"), right=held("right"))
    run = taut.run(taut.compile(law, baxter), taut.RigidPlant(baxter, friction=None), duration=0.2)
    assert np.abs(run.q - baxter.home).max() <= 1e-9


def test_a_trajectory_and_a_sample_go_together(baxter: taut.Arm) -> None:
    right = tuple(name for name in baxter.joint_names if name.startswith("right"))
    law = taut.SideBySide(left=held("left"), right=(taut.laws.ComputedTorque(kp=100.0, kd=20.0), right))
    q0 = baxter.home[: len(right)]
    wave = taut.trajectories.Sine(center=q0, amplitude=0.1, frequency=0.5)
    ref = taut.together(left=both(baxter).left, right=wave)
    run = taut.run(taut.compile(law, baxter), taut.RigidPlant(baxter, friction=None), ref, duration=4.0)
    assert np.abs(run.q[-1000:, : len(right)] - wave.rows(run.t[-1000:]).q).max() <= 1e-3


def test_joints_that_carry_two_parts_are_refused() -> None:
    arm = taut.load_arm("panda")
    law = taut.SideBySide(a=held("x", tool="panda_hand_tcp"), b=held("x", tool="panda_link4"))
    with refused(taut.errors.MatchError):
        taut.compile(law, arm).needs  # noqa: B018


def test_joints_without_a_law_are_refused(baxter: taut.Arm) -> None:
    with refused(taut.errors.MatchError):
        taut.compile(taut.SideBySide(left=held("left")), baxter).needs  # noqa: B018


@pytest.mark.parametrize(
    "laws",
    [
        {},
        {"left": 3.0},
        {"left": taut.laws.PID(kp=1.0)},
    ],
)
def test_what_is_no_law_is_refused(laws: dict[str, Any]) -> None:
    with refused(taut.errors.UsageError):
        taut.SideBySide(**laws)


def test_references_side_by_side_must_be_references() -> None:
    with refused(taut.errors.UsageError):
        taut.together(left=3)  # type: ignore[arg-type]
    with refused(taut.errors.UsageError):
        taut.together(left=taut.hold())


def test_parts_of_two_kinds_of_command_are_refused(baxter: taut.Arm) -> None:
    right = tuple(name for name in baxter.joint_names if name.startswith("right"))
    law = taut.SideBySide(left=held("left"), right=(taut.laws.VelocityPI(kp=1.0), right))
    with refused(taut.errors.MatchError):
        taut.compile(law, baxter).needs  # noqa: B018


def test_references_of_other_names_are_told_with_both_lists(baxter: taut.Arm) -> None:
    pose = taut.snapshot(baxter, baxter.home).T("left_gripper")
    still = taut.TaskMotion(pose=pose)
    ctrl = taut.compile(taut.SideBySide(left=held("left"), right=held("right")), baxter)
    for given in (
        taut.together(left=still, rihgt=still),
        taut.together(left=taut.trajectories.Line(T0=pose, T1=pose, duration=1.0)),
    ):
        with refused(taut.errors.UsageError):
            taut.run(ctrl, taut.RigidPlant(baxter), given, duration=0.01)
