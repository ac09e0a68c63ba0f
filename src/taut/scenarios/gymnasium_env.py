"""Gymnasium environments over scenarios: one arm, or many side by side in lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import float_array
from taut.base.errors import missing_extra
from taut.scenarios.episodes import Episode, Episodes

try:
    import gymnasium
    from gymnasium.error import ResetNeeded
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
        self._over = "before the first reset"

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """Begin an episode."""
        super().reset(seed=seed, options=options)
        self._lanes.begin(np.ones(1, dtype=np.bool_), self.np_random)
        self._over = ""
        return self._lanes.seen[0], {}

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, Info]:
        """One action."""
        if self._over:
            raise ResetNeeded(f"step was called {self._over}; call reset() first")
        given = float_array("action", action, shape=self.action_space.shape)[np.newaxis]
        reward, terminated, truncated = self._lanes.act(given, self.np_random)
        self._over = "after the end of the episode" if terminated[0] or truncated[0] else ""
        info = {"reason": str(self._lanes.info(terminated)["reason"][0])} if terminated[0] else {}
        return self._lanes.seen[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info


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
        self._over: NDArray[np.bool_] | None = None

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Numbers, Info]:
        """All begin an episode."""
        super().reset(seed=seed, options=options)
        self._over = np.zeros(self.num_envs, dtype=np.bool_)
        self._lanes.begin(~self._over, self.np_random)
        return self._lanes.seen, {}

    def step(self, actions: Numbers) -> tuple[Numbers, NDArray[Any], NDArray[Any], NDArray[Any], Info]:
        """One action of each."""
        begins = self._over
        if begins is None:
            raise ResetNeeded("step was called before the first reset; call reset() first")
        reward, terminated, truncated = self._lanes.act(actions, self.np_random)
        if begins.any():
            self._lanes.begin(begins, self.np_random)
        reward[begins], terminated[begins], truncated[begins] = 0.0, False, False
        self._over = terminated | truncated
        return self._lanes.seen, reward, terminated, truncated, self._lanes.info(terminated)


def spaces(lanes: Episodes) -> tuple[Any, Any]:
    """Observations and actions of one arm."""
    seen = Box(-np.inf, np.inf, lanes.seen.shape[1:], np.float32)
    return seen, Box(-1.0, 1.0, (lanes.action_size,), np.float32)
