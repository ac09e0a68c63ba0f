"""A Panda learns to follow a motion with a payload that its law does not know, by evolution of a linear policy.

Each of the arms side by side is a candidate; the best eighth of them make the next generation (the cross-entropy
method: Rubinstein and Kroese, 2004). Run it with `python examples/learning/follow.py`; it needs `pip install -e
".[arms,gym]"`, and takes ten seconds on two cores.
"""

from __future__ import annotations

import sys

import numpy as np

import taut

ARMS, SPREAD, SMALLEST = 128, 0.5, 0.02  # spreads of the gains: at first, at least


def returns(envs: taut.gym.ScenarioVectorEnv, policies: np.ndarray) -> np.ndarray:
    """(arms,) sums of rewards of an episode. Policies (arms, 2, 7) are gains of the error and of its rate."""
    seen, _ = envs.reset(seed=0)
    total, over = np.zeros(len(policies)), np.zeros(len(policies), dtype=bool)
    while not over.all():
        error, rate = seen[:, 14:21], seen[:, 21:28]
        actions = policies[:, 0] * error / 0.02 + policies[:, 1] * rate
        seen, reward, terminated, truncated, _ = envs.step(actions.astype(np.float32))
        total += np.where(over, 0.0, reward)
        over |= terminated | truncated
    return total


def learn(generations: int, seed: int = 0) -> tuple[float, float]:
    """Return of the policy before and after, of 150 at most."""
    episode = taut.gym.Episode(
        scenario="panda_payload",
        values={"plant.kind": "rigid", "run.duration": 3.0},
        decimation=20,
        width=0.05,
    )
    envs, rng = taut.gym.ScenarioVectorEnv(episode, ARMS), np.random.default_rng(seed)
    mean, std = np.zeros((2, 7)), np.full((2, 7), SPREAD)
    first = returns(envs, np.tile(mean, (ARMS, 1, 1)))[0]
    print(f"before: return {first:.1f}")
    for generation in range(generations):
        policies = mean + std * rng.standard_normal((ARMS, 2, 7))
        found = returns(envs, policies)
        best = policies[np.argsort(found)[-ARMS // 8 :]]
        mean, std = best.mean(axis=0), np.maximum(best.std(axis=0), SMALLEST)
        print(f"generation {generation + 1}: mean return {found.mean():.1f}, best {found.max():.1f}")
    last = returns(envs, np.tile(mean, (ARMS, 1, 1)))[0]
    print(f"after: return {last:.1f}")
    return first, last


if __name__ == "__main__":
    learn(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
