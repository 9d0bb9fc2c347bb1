"""Episodes that a person drives, at the viewer's page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from trocar.demos._episodes import Episode, Track, episode_of
from trocar.dvrk.env import LiveEnv


def demonstrate(env: LiveEnv, seed: int) -> Episode:
    """The episode of a seed, as a person does it.

    It begins once they take an arm over, and ends with success, when they let go of all arms, or at
    the time limit.

    Args:
        env: A live environment, made with ``intervention=True``.
        seed: The episode's seed.
    """
    observation, _ = env.reset(seed=seed)
    env.wait_for_person()
    states, steps = Track(), Track()
    _note(states, observation)
    is_over = False
    while not is_over:
        observation, reward, terminated, truncated, info = env.step(None)
        is_over = terminated or truncated or info["is_success"] or not env.is_driven_by_person()
        _note(states, observation)
        steps.note(
            action=info["action"],
            reward=np.float32(reward),
            is_success=np.bool_(info["is_success"]),
            terminated=np.bool_(terminated),
            truncated=np.bool_(is_over and not terminated),
        )
    return episode_of({"seed": seed, **states.arrays(), **steps.arrays()})


def _note(states: Track, observation: dict[str, NDArray[np.float32]] | NDArray[np.float32]) -> None:
    nothing = np.zeros(0, np.float32)
    seen = observation if isinstance(observation, dict) else {"observation": observation}
    states.note(
        observation=seen["observation"],
        achieved_goal=seen.get("achieved_goal", nothing),
        desired_goal=seen.get("desired_goal", nothing),
        stage=np.uint8(0),
    )
