"""Scenarios as environments of Gymnasium: its own checker, runs of taut, the vector form, and what is refused."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from refusals import refused

import taut
from taut.errors import RangeError, ShapeError, UnknownNameError, UsageError
from taut.gym import Episode, ScenarioEnv, ScenarioVectorEnv
from taut.scenarios.scenario import load_scenario

RIGID = {"plant.kind": "rigid"}
SHORT = {"run.duration": 0.1}
HEIGHT = 0.48  # [m] of a floor below the tool, which begins at 0.487 m
FLOOR = {"kind": "wall", "point": [0.0, 0.0, HEIGHT], "normal": [0.0, 0.0, 1.0], "stiffness": 1e4, "damping": 50.0}
ON_FLOOR = Episode(
    scenario="panda_payload",
    action="pose change",
    values=RIGID | {"plant.environment": FLOOR, "run.duration": 0.2},
    gains={"law.K": ((100, 10), (1000, 100))},
)


@pytest.mark.filterwarnings("ignore:.*A Box observation space (min|max)imum value is -?infinity")
@pytest.mark.parametrize(
    "episode",
    [
        Episode(scenario="one_joint_pid", action="torque", scale=2.0, values=SHORT),
        Episode(scenario="so101_servo", values={"plant.sensors": {"position": {"noise": 1e-3}}}),
        ON_FLOOR,
        pytest.param(Episode(scenario="cabinet_door", action="pose", values=SHORT), marks=pytest.mark.long),
    ],
    ids=["torque", "noise", "contact", "contact in MuJoCo"],
)
def test_an_environment_passes_the_checker_of_gymnasium(episode: Episode) -> None:
    check_env(ScenarioEnv(episode), skip_render_check=True)


def test_a_tool_that_goes_down_rests_on_the_floor() -> None:
    envs = ScenarioVectorEnv(ON_FLOOR, 2)
    envs.reset(seed=0)
    down = np.zeros(envs.action_space.shape)
    down[:, 2], down[0, 8] = -0.3, -1.0  # 3 mm in each step; the spring of one lane is soft upwards
    for _ in range(20):
        envs.step(down)
    arm = taut.load_arm("panda")
    heights = [taut.snapshot(arm, q).T().p[2] for q in envs._lanes.arms.q]
    assert HEIGHT - 5e-3 < heights[1] < heights[0] < HEIGHT


def experiment_of(episode: Episode) -> Any:
    scenario = load_scenario(episode.scenario, values=episode.values)
    return next(iter(scenario.cases.values()), scenario)


@pytest.mark.part(1)
@pytest.mark.parametrize(
    "episode",
    [
        Episode(scenario="panda_payload", decimation=5, values={"control.rate": 500}),  # in MuJoCo
        Episode(scenario="so101_servo", decimation=2),  # with several steps of the integrator
    ],
    ids=lambda episode: episode.scenario,
)
def test_an_action_of_zero_is_a_run_that_stays(episode: Episode) -> None:
    place = experiment_of(episode)
    ctrl = place.experiment.controller(next(iter(place.laws.values())))
    envs = ScenarioVectorEnv(episode, 2)
    seen, _ = envs.reset(seed=0)
    q0 = seen[0, : ctrl.arm.n].astype(float) if place.experiment.q0 is None else place.experiment.q0
    run = taut.run(ctrl, place.experiment.plant, taut.JointMotion(q=q0), duration=0.2, q0=q0)
    for k in range(1, 8):
        seen, *_ = envs.step(np.zeros(envs.action_space.shape))
        tick = k * episode.decimation
        now = np.hstack([run.q[tick], run.v[tick]])
        np.testing.assert_allclose(seen[:, : 2 * ctrl.arm.n], np.tile(now, (2, 1)), rtol=1e-5, atol=1e-6)


def test_observation_and_reward_are_those_of_the_reference() -> None:
    episode = Episode(scenario="gantry_decentralised", decimation=20, width=0.05, effort=0.0)
    envs, place = ScenarioVectorEnv(episode, 3), experiment_of(episode)
    n, reference = envs.action_space.shape[1], place.experiment.reference
    seen, _ = envs.reset(seed=0)
    for k in range(5):
        wanted = reference.at(k * 20 / place.experiment.rate)
        np.testing.assert_allclose(seen[:, 2 * n : 3 * n], wanted.q - seen[:, :n], atol=1e-6)
        np.testing.assert_allclose(seen[:, 3 * n :], wanted.v - seen[:, n : 2 * n], atol=1e-6)
        seen, reward, *_ = envs.step(np.array([[0.0], [1.0], [-1.0]]) * np.ones(n))
        error = np.sum(seen[:, 2 * n : 3 * n] ** 2, axis=1)
        np.testing.assert_allclose(reward, 1.0 / (1.0 + error / 0.05**2), rtol=1e-5)
    assert seen[1, 0] > seen[0, 0] > seen[2, 0]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        pytest.param("touch_and_press", {"run.duration": 0.4}, marks=pytest.mark.long),
        ("geared_force", {}),
        ("policy_10hz", {"run.duration": 0.4}),
        pytest.param("panda_springs", {}, marks=pytest.mark.long),
        pytest.param("panda_writes_round", {"run.duration": 0.4}, marks=pytest.mark.long),
        pytest.param("two_arms", {}, marks=pytest.mark.long),
    ],
)
def test_without_a_motion_that_is_known_its_own_law_shows_what_to_follow(name: str, values: Any) -> None:
    """Phases, forces, a source, a stiffness, a wall in MuJoCo, two arms."""
    env, scenario = ScenarioEnv(Episode(scenario=name, values=values)), load_scenario(name, values=values)
    place = next(iter(scenario.cases.values()), scenario)
    run = place.experiment.run(place.experiment.controller(next(iter(place.laws.values()))))
    n, action = run.q.shape[1], np.zeros(env.action_space.shape or ())
    seen, _ = env.reset(seed=0)
    for k in range(0, 300, 10):
        shown = (seen[: 2 * n] + seen[2 * n :]).reshape(2, n)
        np.testing.assert_allclose(shown, [run.q[k], run.v[k]], atol=1e-5 * max(1.0, np.abs(run.v[k]).max()))
        seen, *_ = env.step(action)


def test_poses_and_gains_of_an_action_reach_the_law() -> None:
    episode = Episode(scenario="panda_pushed", action="pose", values=RIGID | {"run.duration": 3.0}, decimation=100)
    x, y, turned = np.zeros(6), np.zeros(6), np.zeros(6)
    x[0], y[1], turned[5] = 0.5, -1.0, 0.4
    stiff = Episode(**{name: getattr(episode, name) for name in ("scenario", "action", "values", "decimation")},
                    gains={"law.K": ((50.0, 5.0), (3000.0, 300.0))})  # fmt: skip
    envs = ScenarioVectorEnv(stiff, 4)
    seen, _ = envs.reset(seed=0)
    start = seen[:, 14:20]
    actions = np.hstack([np.array([x, y, turned, x]), np.repeat([[1.0], [1.0], [1.0], [-1.0]], 6, axis=1)])
    for _ in range(9):  # before the push of the scenario
        seen, *_ = envs.step(actions)
    moved = start - seen[:, 14:20]
    wanted = np.array([0.1, -0.2, 0.2])  # half, and all, of 0.2 m; 0.4 of 0.5 rad
    np.testing.assert_allclose([moved[0, 0], moved[1, 1], moved[2, 5]], wanted, atol=0.01)
    assert moved[3, 0] < 0.8 * moved[0, 0]  # a soft spring lags behind


def test_each_lane_of_a_vector_environment_begins_anew_in_the_step_after_its_end() -> None:
    episode = Episode(scenario="one_joint_pid", action="torque", scale=2.0, values=SHORT)
    envs, well, others = ScenarioVectorEnv(episode, 5), ScenarioVectorEnv(episode, 5), [0, 1, 3, 4]
    first, _ = envs.reset(seed=3)
    well.reset(seed=3)
    actions = np.ones((5, 1), dtype=np.float32)
    broken = actions.copy()
    broken[2] = np.nan
    for k in range(12):
        seen, reward, terminated, truncated, info = envs.step(broken if k == 3 else actions)
        np.testing.assert_array_equal(seen[others], well.step(actions)[0][others])
        assert terminated.tolist() == [False, False, k == 3, False, False]
        assert info.keys() == ({"reason", "_reason"} if k == 3 else set())
        alone = k - 4  # steps of the lane that ended early
        assert truncated.tolist() == [(k == 9)] * 2 + [alone == 10] + [(k == 9)] * 2
        assert (reward == 0.0).tolist() == [k == 10] * 2 + [k in (3, 4)] + [k == 10] * 2
        if k == 4:
            np.testing.assert_array_equal(seen[2], first[2])
            assert (seen[others] != first[0]).any(axis=1).all()
        if k == 10:
            np.testing.assert_array_equal(seen[others], first[others])
    again, _ = envs.reset(seed=3)
    np.testing.assert_array_equal(again, first)


def test_an_episode_ends_with_a_reason_and_goes_on_after_a_reset() -> None:
    one = ScenarioEnv(Episode(scenario="one_joint_pid", action="torque", scale=2.0, values=SHORT))
    with pytest.raises(ResetNeeded, match="before the first reset"):
        one.step(np.zeros(1))
    for action, reason in ((np.nan, "the action is not finite"), (1.0, "the simulation diverged")):
        one.reset()
        assert one.step(np.zeros(1))[2:] == (False, False, {})
        one._lanes.arms.v[:] = 0.0 if np.isnan(action) else np.inf
        assert one.step(np.array([action]))[1:] == (0.0, True, False, {"reason": reason})
        with pytest.raises(ResetNeeded, match="after the end"):
            one.step(np.zeros(1))
    one.reset()
    while not one.step(np.zeros(1))[3]:
        pass
    with pytest.raises(ResetNeeded, match="after the end"):
        one.step(np.zeros(1))
    with pytest.raises(ResetNeeded):
        ScenarioVectorEnv(Episode(scenario="one_joint_pid"), 2).step(np.zeros((2, 1)))


def test_the_example_learns_to_follow() -> None:
    example = Path(__file__).parents[2] / "examples" / "learning" / "follow.py"
    first, last = runpy.run_path(str(example))["learn"](generations=4)
    assert last > 5.0 * first > 0.0


def test_what_is_no_episode_is_refused() -> None:
    wrong: list[tuple[Any, Any]] = [
        (UnknownNameError, {"scenario": "panda_paylod"}),
        (UsageError, {"scenario": "one_joint_pid", "action": "torques"}),
        (UnknownNameError, {"scenario": "gain_bounds", "case": "none of them"}),
        (UnknownNameError, {"scenario": "one_joint_pid", "law": "PDD"}),
        (UnknownNameError, {"scenario": "one_joint_pid", "gains": {"law.K": (1.0, 2.0)}}),
        (RangeError, {"scenario": "one_joint_pid", "gains": {"law.kp": (-1.0, 2.0)}}),
        (ShapeError, {"scenario": "one_joint_pid", "scale": [1.0, 2.0]}),
        (UsageError, {"scenario": "one_joint_pid", "action": "torque"}),
        (UsageError, {"scenario": "one_joint_pid", "gains": {"law.kp": (0.0, 2.0)}}),
        (UsageError, {"scenario": "one_joint_pid", "gains": {"law.kp": 2.0}}),
        (RangeError, {"scenario": "one_joint_pid", "decimation": 0}),
    ]
    for kind, arguments in wrong:
        with refused(kind):
            ScenarioEnv(Episode(**arguments))
    one = Episode(scenario="one_joint_pid", values=SHORT)
    with refused(UsageError):
        ScenarioEnv("one_joint_pid")
    for n in (0, 1.5):
        with refused(RangeError):
            ScenarioVectorEnv(one, n)
    env = ScenarioEnv(one)
    env.reset()
    with refused(ShapeError):
        env.step(np.zeros(3))
