"""The same episodes in the task's environment: what a policy loses on the way to an arm."""

from __future__ import annotations

import math
from collections.abc import Sequence

import gymnasium as gym
import numpy as np

from trocar.dvrk.deploy.observation import Seen
from trocar.dvrk.deploy.policy import Policy
from trocar.dvrk.deploy.task import Task
from trocar.registration import NAMESPACE

BATCH = 50
"""Episodes that are played at once."""


def played(
    task: Task, policy: Policy, seeds: Sequence[int], server: str | None = None
) -> list[bool]:
    """Whether the last step of each episode succeeds in the environment of Gymnasium."""
    found: list[bool] = []
    for first in range(0, len(seeds), BATCH):
        found += _batch(task, policy, seeds[first : first + BATCH], server)
    return found


def _batch(task: Task, policy: Policy, seeds: Sequence[int], server: str | None) -> list[bool]:
    name = f"{NAMESPACE}/{task.spec.id}"
    envs = gym.make_vec(name, num_envs=len(seeds), server=server, **task.options)
    numbers = len(task.spec.action)
    ends: dict[int, bool] = {}
    try:
        seen, _ = envs.reset(seed=list(seeds))  # type: ignore[arg-type]
        while len(ends) < len(seeds):
            rows = [_row(seen, index) for index in range(len(seeds))]
            actions = np.array([policy(row, numbers) for row in rows])
            seen, _, terminations, truncations, infos = envs.step(actions)
            for index in np.flatnonzero(terminations | truncations).tolist():
                ends.setdefault(index, bool(infos["is_success"][index]))
    finally:
        envs.close()
    return [ends[index] for index in range(len(seeds))]


def _row(seen: Seen, index: int) -> Seen:
    """What is seen of one environment."""
    if isinstance(seen, dict):
        return {name: array[index] for name, array in seen.items()}
    return seen[index]


def difference(one: Sequence[bool], other: Sequence[bool]) -> tuple[float, float, float]:
    """How much more often ``one`` holds, in points, and the ends of the interval of 95 %.

    Episodes are paired: only those count that end differently (normal approximation).
    """
    pairs = np.array([one, other], np.float64)
    count = pairs.shape[1]
    apart = pairs[0] - pairs[1]
    spread = 1.96 * math.sqrt(float(np.var(apart)) / count)
    mean = float(apart.mean())
    return 100.0 * mean, 100.0 * (mean - spread), 100.0 * (mean + spread)
