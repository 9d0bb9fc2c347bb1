"""The same episodes in the task's environment: what a policy loses on the way to an arm."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import gymnasium as gym
import numpy as np

from trocar.dvrk.deploy.policy import Policy
from trocar.dvrk.deploy.task import Task
from trocar.registration import NAMESPACE


def played(task: Task, policy: Policy, seeds: Iterable[int], server: str | None) -> Iterator[bool]:
    """Whether the last step of each episode succeeds in the environment of Gymnasium."""
    env = gym.make(f"{NAMESPACE}/{task.spec.id}", server=server, **task.options)
    try:
        for seed in seeds:
            seen, info = env.reset(seed=seed)
            is_over = False
            while not is_over:
                action = policy(seen, len(task.spec.action))
                seen, _, terminated, truncated, info = env.step(action)
                is_over = terminated or truncated
            yield bool(info["is_success"])
    finally:
        env.close()


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
