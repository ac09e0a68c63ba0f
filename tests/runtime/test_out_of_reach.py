"""Targets that no joint positions reach: told in a sentence, and followed within what the arm can give."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest

import taut
from taut.base.types import Float64Array
from taut.control.laws.task_space import far_away
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.model import Chain, model_of
from taut.maths.singularity import Beyond, distance_beyond, spheres

Array = Float64Array
ARMS = ("panda", "ur10", "xarm7", "kinova")  # on the last nothing was tuned
LAWS = {
    "motion": taut.laws.TaskComputedTorque(kp=100.0, kd=20.0),
    "designed": taut.laws.Impedance(K=(500.0, 30.0), zeta=1.0),
    "light": taut.laws.Impedance(K=(800.0, 30.0), B=(20.0, 1.0)),
}
WAYS = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.2], [-1.0, 0.0, 0.5], [0.3, -0.3, -1.0]])


@functools.cache
def loop(name: str, law: str, duration: float) -> tuple[taut.Loop, Goal]:
    arm, goal = taut.load_arm(name), Goal(name)
    plant = taut.RigidPlant(arm, friction=None)
    return taut.Loop(taut.compile(LAWS[law], arm), plant, goal, duration=duration), goal


class Goal:
    """A pose to hold with the orientation of home: far away until t = `until`, then a little beside home."""

    def __init__(self, name: str) -> None:
        arm = taut.load_arm(name)
        self.T, self.until = taut.snapshot(arm, arm.home).T(), np.inf
        self.sphere = spheres(model_of(arm), None, "pose")[0]
        self.p = self.T.p

    def go(self, way: Array, times: float, until: float = np.inf) -> None:
        self.p = self.sphere.centre + times * self.sphere.radius * way / np.linalg.norm(way)
        self.until = until

    def rows(self, t: Array) -> TaskMotion:
        p = np.where((t < self.until)[:, None], self.p, np.add(self.T.p, [0.0, 0.02, 0.0]))
        R, still = np.broadcast_to(self.T.R, (len(t), 3, 3)), np.zeros((len(t), 6))
        return TaskMotion.of({"p": p, "R": R, "twist": still, "acceleration": still})

    def at(self, t: float) -> TaskMotion:
        rows = self.rows(np.array([t]))
        return TaskMotion.of({name: getattr(rows, name)[0] for name in TaskMotion.fields(0)})


CASES = [(name, law) for law in LAWS for name in ARMS]
CASES.sort(key=lambda case: case != ("kinova", "designed"))  # first the one that is run in the tests


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")  # "light" is too stiff for an xArm7 without friction
def test_a_target_far_out_of_reach_asks_no_more_than_the_arm_can_do(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    worst = np.zeros(2)
    for name, law in CASES[: share(12)]:
        arm, (run_of, goal) = taut.load_arm(name), loop(name, law, 3.0)
        for way in WAYS:
            for times in (1.2, 2.0, 5.0):
                goal.go(way, times)
                run = taut.run(run_of, progress=False)
                assert run.outcome.ok
                used = (np.abs(run.tau) / arm.effort).max(), (np.abs(run.v) / arm.velocity).max()
                assert max(used) < 1.0
                assert "the target was out of the tool's reach in 3001 of 3001 ticks, by " in run.outcome.message
                worst = np.maximum(worst, used)
    bar("targets out of reach: torque / effort, speed / limit", f"{worst[0]:.2f}, {worst[1]:.2f}")


@pytest.mark.parametrize(("name", "law"), [("panda", "motion"), ("ur10", "designed")])
def test_the_arm_comes_to_rest_stretched_towards_it(name: str, law: str) -> None:
    run_of, goal = loop(name, law, 20.0)
    goal.go(WAYS[0], 2.0)
    run = taut.run(run_of, progress=False)
    assert np.abs(run.v[-1]).max() < 2e-2
    offset = run.task.p[-1] - goal.sphere.centre
    assert offset @ WAYS[0] > 0.8 * goal.sphere.radius


@pytest.mark.parametrize("name", ["panda"])
def test_it_comes_back_when_the_target_does(name: str) -> None:
    """Within the limits of speed and torque all the way."""
    arm, (run_of, goal) = taut.load_arm(name), loop(name, "motion", 20.0)
    goal.go(WAYS[0], 3.0, until=10.0)
    run = taut.run(run_of, progress=False)
    assert run.task.position_error is not None
    assert np.linalg.norm(run.task.position_error[-1]) < 1e-3
    assert (np.abs(run.tau) / arm.effort).max() < 1.0
    assert (np.abs(run.v) / arm.velocity).max() < 1.0
    assert "in 10000 of 20001 ticks" in run.outcome.message


def test_within_reach_nothing_changes() -> None:
    """To the last bit: what is added is a term of its own, and zero."""
    arm = taut.load_arm("panda")
    q, T = np.array(arm.home), taut.snapshot(arm, arm.home).T()
    near, far = (taut.TaskMotion(pose=taut.Pose(np.add(T.p, [step, 0.0, 0.0]), R=T.R)) for step in (0.1, 3.0))
    for law, term in (
        (LAWS["designed"], "reach"),
        (taut.laws.Stiffness(K=(500.0, 30.0)), "reach"),
        (LAWS["motion"], "singularity"),
    ):
        ctrl = taut.compile(law, arm, engine="float")
        ctrl.step(q, np.zeros(7), near)
        assert np.array_equal(ctrl.terms[term], np.zeros(7))
        ctrl.step(q, np.zeros(7), far)
        assert np.abs(ctrl.terms[term]).max() > 1.0


def test_a_spring_of_stiffness_control_is_eased_to_a_twentieth_of_the_reach() -> None:
    arm = taut.load_arm("panda")
    x = taut.snapshot(arm, arm.home)
    T = x.T()
    ctrl = taut.compile(taut.laws.Stiffness(K=(500.0, 30.0)), arm)
    ctrl.step(arm.home, np.zeros(7), taut.TaskMotion(pose=taut.Pose(np.add(T.p, [9.0, 0.0, 0.0]), R=T.R)))
    most = 0.05 * spheres(model_of(arm), None, "pose")[0].radius
    pull = x.J().T @ np.array([500.0 * 9.0 / np.sqrt(1.0 + (9.0 / most) ** 2), 0.0, 0.0, 0.0, 0.0, 0.0])
    assert ctrl.terms["P"] + ctrl.terms["reach"] == pytest.approx(pull, rel=1e-9)


# -------------------------------------------------------------------- what is certain


@pytest.mark.parametrize("name", [*ARMS, "so101", "ur5", "planar3", "gantry3"])
def test_no_pose_that_an_arm_can_take_counts_as_out_of_reach(name: str) -> None:
    arm = taut.load_arm(name)
    low, high = (np.where(np.isfinite(end), end, side) for end, side in ((arm.lower, -np.pi), (arm.upper, np.pi)))
    q = np.random.default_rng(5).uniform(low, high, (20_000, arm.n))
    R, p = Chain.of(model_of(arm), None).poses(q)
    away = distance_beyond(spheres(model_of(arm), None, "pose"), p, R)
    assert away.max() < 1e-9
    assert away.max() > -0.05  # and some come near


def test_a_tool_that_reaches_as_a_point_may_be_out_of_reach_as_a_pose() -> None:
    """The wrist's centre of a Panda that hangs straight down at 0.9 m is 0.2 m above its tool, and too far out."""
    arm = taut.load_arm("panda")
    p, R = np.array([[0.9, 0.0, 0.5]]), taut.snapshot(arm, arm.home).T().R[None]
    assert distance_beyond(spheres(model_of(arm), None, "position"), p, R)[0] < 0.0
    assert distance_beyond(spheres(model_of(arm), None, "pose"), p, R)[0] > 0.15


def test_it_is_told_smoothly() -> None:
    arm = taut.load_arm("planar2")  # 0.9 m, its last joint 0.5 m from its first
    found = spheres(model_of(arm), None, "position")
    clear = [Beyond.of(found, np.array([r, 0.0, 0.0]), np.eye(3)) for r in (0.9, 0.9045, 0.9091, 0.99, 1.04, 1.081)]
    assert [float(each.clear) for each in clear] == pytest.approx([0.0, 0.5, 1.0, 1.0, 1.0, 1.0], abs=0.02)
    assert [float(each.far) for each in clear] == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.57, 1.0], abs=0.02)
    assert sorted(each.radius for each in spheres(model_of(arm), None, "pose")) == pytest.approx([0.5, 0.9])


def test_what_a_law_asks_for_decides_what_is_told() -> None:
    arm = taut.load_arm("panda")
    x = taut.snapshot(arm, arm.home)
    rows = {"p": np.array([[0.9, 0.0, 0.5]]), "R": x.T().R[None]}
    gains = {"kp": 100.0, "kd": 20.0}
    height = taut.Coordinates(function=lambda T: T.p[2:])
    of = {
        "height": taut.laws.TaskComputedTorque(**gains, error="coordinates", coordinates=height),
        "position": taut.laws.TaskComputedTorque(
            **gains, error="coordinates", coordinates=taut.Coordinates.position()
        ),
        "led": taut.laws.Admittance(D=(5.0, 0.5), B=(50.0, 5.0), inner=LAWS["motion"]),
        "joints": taut.laws.ComputedTorque(**gains),
        "whole": taut.via_joint_space(taut.laws.ComputedTorque(**gains)),
        "point": taut.via_joint_space(taut.laws.ComputedTorque(**gains), directions="position"),
    }
    away = {name: far_away(law, x, rows) for name, law in of.items()}
    assert away["height"] is None
    assert away["joints"] is None
    assert {name: bool(told[0] > 0.0) for name, told in away.items() if told is not None} == {
        "position": False,
        "led": True,
        "whole": True,
        "point": False,
    }


def test_a_run_that_diverges_says_that_the_target_was_out_of_reach_and_what_would_do() -> None:
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    law = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0, singularity="plain")
    ctrl = taut.compile(law, arm)
    goal = taut.TaskMotion(pose=taut.Pose([3.0, 0.0, 0.0], R=T.R))
    run = taut.run(ctrl, taut.RigidPlant(arm, friction=None), goal, duration=1.0)
    assert run.outcome.kind == "diverged"
    assert "more substeps; the target was out of the tool's reach in " in (run.outcome.message)
    assert run.outcome.message.endswith("ticks, by 2.2 m at least at t = 0 s; bring it nearer")
