"""Gymnasium environments over scenarios: one arm, or many side by side in lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taut.base.errors import missing_extra
from taut.scenarios.episodes import Episode, Episodes

try:
    import gymnasium
    from gymnasium.spaces import Box
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as cause:
    raise missing_extra("an environment of Gymnasium", "gymnasium", "gym") from cause

Numbers = NDArray[np.float32]
Info = dict[str, Any]


class ScenarioEnv(gymnasium.Env[Numbers, Numbers]):
    """A scenario as an environment of Gymnasium. See `Episode` for actions, observations and rewards.

    Args:
        episode: What is learned.

    Example:
        >>> import taut
        >>> env = taut.gym.ScenarioEnv(taut.gym.Episode(scenario="one_joint_pid", action="torque", scale=2.0))
        >>> observation, _ = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        >>> observation.shape, terminated, truncated
        ((4,), False, False)
    """

    metadata = {"render_modes": []}  # noqa: RUF012  # as Gymnasium has it

    def __init__(self, episode: Episode) -> None:
        self._lanes = Episodes(episode, 1)
        self.observation_space, self.action_space = spaces(self._lanes)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """Begin an episode."""
        super().reset(seed=seed, options=options)
        self._lanes.begin(np.ones(1, dtype=np.bool_), self.np_random)
        return self._lanes.seen[0], {}

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, Info]:
        """One action."""
        reward, terminated, truncated = self._lanes.act(np.asarray(action)[np.newaxis], self.np_random)
        seen = self._lanes.seen[0]
        return seen, float(reward[0]), bool(terminated[0]), bool(truncated[0]), {}


class ScenarioVectorEnv(VectorEnv[Numbers, Numbers, NDArray[Any]]):
    """n arms in the same scenario as one vector environment of Gymnasium, stepped together in lanes.

    A lane whose episode has ended begins the next one in the step after, whose action does not count.

    Args:
        episode: What is learned.
        n: Number of arms.

    Example:
        >>> import taut
        >>> envs = taut.gym.ScenarioVectorEnv(taut.gym.Episode(scenario="one_joint_pid"), n=100)
        >>> observations, _ = envs.reset(seed=0)
        >>> observations, rewards, *_ = envs.step(envs.action_space.sample())
        >>> observations.shape, rewards.shape
        ((100, 4), (100,))
    """

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(self, episode: Episode, n: int) -> None:
        self._lanes, self.num_envs = Episodes(episode, n), n
        self.single_observation_space, self.single_action_space = spaces(self._lanes)
        self.observation_space = batch_space(self.single_observation_space, n)
        self.action_space = batch_space(self.single_action_space, n)
        self._over = np.zeros(n, dtype=np.bool_)

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """All begin an episode."""
        super().reset(seed=seed, options=options)
        self._over[:] = False
        self._lanes.begin(~self._over, self.np_random)
        return self._lanes.seen, {}

    def step(self, actions: Numbers) -> tuple[Numbers, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """One action of each."""
        reward, terminated, truncated = self._lanes.act(actions, self.np_random)
        begins = self._over
        if begins.any():
            self._lanes.begin(begins, self.np_random)
        reward[begins], terminated[begins], truncated[begins] = 0.0, False, False
        self._over = terminated | truncated
        return self._lanes.seen, reward, terminated, truncated, {}


def spaces(lanes: Episodes) -> tuple[Any, Any]:
    """Observations and actions of one arm."""
    seen = Box(-np.inf, np.inf, lanes.seen.shape[1:], np.float32)
    return seen, Box(-1.0, 1.0, (lanes.action_size,), np.float32)
