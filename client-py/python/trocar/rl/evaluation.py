"""How well a policy does, with the uncertainty of a finite number of episodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from trocar.rl.config import Config
from trocar.sb3 import TrocarVecEnv, make_vec

SEED = 1_000_000
"""Of the first episode of evaluations while training."""
FINAL_SEED = 2_000_000
"""Of the first episode of evaluations afterwards."""


class Policy(Protocol):
    """What acts: every model of Stable-Baselines3 does."""

    def predict(self, observation: Any, /, *, deterministic: bool) -> tuple[NDArray[Any], Any]:
        """Actions of shape (environments, action dim), and something that is not used."""


@dataclass(frozen=True)
class Score:
    """Results of some episodes. Rates are of those that succeed; 0 for tasks without goals."""

    episodes: int
    """How many."""
    successes: int
    """Whose last step ended in success."""
    successes_ever: int
    """Of which any step did."""
    mean_return: float
    """Mean sum of rewards."""
    mean_length: float
    """Mean number of steps."""

    @property
    def success_rate(self) -> float:
        """Part of episodes whose last step ended in success."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of :attr:`success_rate`."""
        return wilson(self.successes, self.episodes)


def wilson(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """The score interval of a rate (Wilson 1927); ``z`` is that of 95 % by default."""
    rate = successes / trials
    denominator = 1 + z * z / trials
    middle = (rate + z * z / (2 * trials)) / denominator
    spread = math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    half = z * spread / denominator
    # Exactly 0 and 1 where all failed or none did, which rounding misses.
    low = middle - half if successes else 0.0
    return low, middle + half if successes < trials else 1.0


def score(policy: Policy, envs: TrocarVecEnv, seed: int, episodes: int | None = None) -> Score:
    """Runs the episodes of ``seed, seed + 1, …`` without exploring.

    Args:
        policy: The policy that acts.
        envs: Environments of the task; each runs episodes of its own.
        seed: Of the first episode.
        episodes: How many; as many as there are environments if ``None``.
    """
    episodes = envs.num_envs if episodes is None else episodes
    rows = [
        _round(policy, envs, seed + first)[: episodes - first]
        for first in range(0, episodes, envs.num_envs)
    ]
    lengths, returns, last, ever = np.concatenate(rows).T
    return Score(
        episodes,
        successes=int(last.sum()),
        successes_ever=int(ever.sum()),
        mean_return=float(returns.mean()),
        mean_length=float(lengths.mean()),
    )


def evaluate(
    policy: Policy,
    config: Config,
    options: dict[str, Any] | None = None,
    *,
    seed: int = FINAL_SEED,
    episodes: int = 200,
    envs: int = 50,
    server: str | None = None,
) -> dict[str, Any]:
    """How well a policy does, as ``python -m trocar.rl evaluate`` prints it.

    Args:
        policy: The policy that acts.
        config: What it was trained with.
        options: Other options of the task than those.
        seed: Of the first episode.
        episodes: How many.
        envs: Most environments at a time.
        server: Name of the server; a private one if ``None``.
    """
    options = config.options | (options or {})
    made = make_vec(config.task_id, min(envs, episodes), server=server, **options)
    try:
        result = score(policy, made, seed, episodes)
        has_goals = made.envs.task_spec.goal is not None
    finally:
        made.close()
    return {
        "options": options,
        "seed": seed,
        "episodes": result.episodes,
        "success_rate": result.success_rate if has_goals else None,
        "confidence_95": list(result.interval) if has_goals else None,
        "success_ever_rate": result.successes_ever / result.episodes if has_goals else None,
        "mean_return": result.mean_return,
        "mean_length": result.mean_length,
    }


def _round(policy: Policy, envs: TrocarVecEnv, seed: int) -> NDArray[np.float64]:
    """An episode of each environment: length, return, success at its end and ever, by row."""
    envs.seed(seed)
    observations = envs.reset()
    rows = np.zeros((envs.num_envs, 4))
    running = np.ones(envs.num_envs, np.bool_)
    while running.any():
        actions, _ = policy.predict(observations, deterministic=True)
        observations, rewards, dones, infos = envs.step(actions)
        success = np.array([info["is_success"] for info in infos])
        rows[running, 0] += 1
        rows[running, 1] += rewards[running]
        rows[running, 2] = success[running]
        rows[running, 3] = np.maximum(rows[running, 3], success[running])
        running &= ~dones
    return rows
