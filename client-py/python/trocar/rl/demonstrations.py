"""Demonstrations as episodes: of the server's expert, or of a Minari data set."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from gymnasium import spaces
from minari import MinariDataset
from numpy.typing import NDArray
from stable_baselines3 import HerReplayBuffer

import trocar
from trocar.demos import Episode
from trocar.errors import InvalidRequest, refuse
from trocar.rl.config import Config
from trocar.rl.episodes import Episodes, Seen, play
from trocar.sb3 import TrocarVecEnv
from trocar.vector import TrocarVectorEnv

SEED = 3_000_000
"""Of the first demonstration: far from the seeds of training and evaluation."""

AT_A_TIME = 50
"""Most episodes that the expert runs at a time; it changes none of them."""


def expert(config: Config, server: str | None = None) -> Episodes:
    """The expert's episodes of :data:`SEED` and the seeds after it, but those that fail.

    With ``demo_noise``, its actions are disturbed on their way, and what it wanted is the label: so
    demonstrations show how to come back to the way. Source: Laskey et al., DART: Noise Injection
    for Robust Imitation Learning, CoRL 2017.

    Raises:
        ValueError: All of them do.
    """
    count = min(AT_A_TIME, config.demos)
    options = {"autoreset_mode": "disabled", "expert": True, "server": server, **config.options}
    envs = TrocarVectorEnv(config.task, count, **options)
    shown = Episodes(envs.task_spec, config.demos)
    random = np.random.default_rng(SEED)
    try:
        for first in range(0, config.demos, count):
            # One for each episode, so that some hardly stray and others do.
            noise = 2 * config.demo_noise * random.random((count, 1))

            def act(seen: Seen, noise: NDArray[np.float64] = noise) -> NDArray[np.float32]:
                wanted = seen.infos["expert_action"]
                disturbed = wanted + noise[seen.envs] * random.standard_normal(wanted.shape)
                action: NDArray[np.float32] = disturbed.clip(-1.0, 1.0).astype(np.float32)
                return action

            played = play(envs, act, range(SEED + first, SEED + first + count))
            is_asked_for = np.arange(count) < config.demos - first
            shown.add(played, played.succeeded & is_asked_for)
    finally:
        envs.close()
    if not len(shown):
        raise refuse(InvalidRequest, "demos", config.demos, "expected episodes that succeed")
    return shown


def recorded(path: Path, config: Config, server: str | None = None) -> Episodes:
    """The episodes of a Minari data set, for a configuration.

    Raises:
        ValueError: There is none, or it is of another task, options or version.
    """
    if not (path / "data").is_dir():
        raise refuse(InvalidRequest, "demos", str(path), "expected the folder of a Minari data set")
    dataset = MinariDataset(path / "data")
    check(dataset, config)
    envs = TrocarVectorEnv(config.task, 1, server=server, **config.options)
    envs.close()
    numbers = range(int(dataset.total_episodes))
    told = dataset.storage.get_episode_metadata(numbers)
    shown = []
    for episode, metadata in zip(dataset.iterate_episodes(numbers), told, strict=True):
        seen = episode.observations
        nothing = np.zeros((len(episode.rewards) + 1, 0), np.float32)
        arrays = seen if isinstance(seen, dict) else {"observation": seen}
        shown.append(
            Episode(
                seed=int(metadata["seed"]),
                observation=arrays["observation"],
                achieved_goal=arrays.get("achieved_goal", nothing),
                desired_goal=arrays.get("desired_goal", nothing),
                stage=episode.infos["expert_stage"],
                action=np.asarray(episode.actions, np.float32),
                reward=np.asarray(episode.rewards, np.float32),
                is_success=episode.infos["is_success"][1:],
                terminated=np.asarray(episode.terminations),
                truncated=np.asarray(episode.truncations),
            )
        )
    return _succeeded(envs.task_spec, shown)


def _succeeded(spec: trocar.TaskSpec, shown: list[Episode]) -> Episodes:
    good = [episode for episode in shown if episode.succeeded]
    if not good:
        raise refuse(InvalidRequest, "demos", len(shown), "expected episodes that succeed")
    return Episodes.of(spec, good)


def buffer(demos: Episodes, config: Config, envs: TrocarVecEnv) -> HerReplayBuffer:
    """Episodes as a replay buffer that gives hindsight goals as that of experience does.

    Args:
        demos: The episodes.
        config: What is trained.
        envs: Environments of the task.
    """
    space = envs.observation_space
    assert isinstance(space, spaces.Dict)
    filled = HerReplayBuffer(
        demos.steps,
        space,
        envs.action_space,
        envs,
        device="cpu",
        n_envs=1,
        n_sampled_goal=config.goals,
        goal_selection_strategy="future",
    )
    for episode, time in zip(*demos.every_step(), strict=True):
        now, after = (
            {
                "observation": demos.observation[episode, at][None],
                "achieved_goal": demos.achieved[episode, at][None],
                "desired_goal": demos.desired[episode][None],
            }
            for at in (time, time + 1)
        )
        last = time + 1 == demos.length[episode]
        timeout = bool(last and not demos.terminated[episode, time])
        filled.add(
            now,
            after,
            demos.action[episode, time][None],
            demos.reward[episode, time][None],
            np.array([last]),
            [{"TimeLimit.truncated": timeout}],
        )
    return filled


def check(dataset: MinariDataset, config: Config) -> None:
    """An error unless the data set is of this task, under these options, and of this version."""
    recipe = json.loads(dataset.storage.metadata.get("trocar", "{}"))
    wanted = {
        "task": config.task,
        "options": json.loads(json.dumps(config.options)),
        "version": trocar.__version__,
    }
    for name, value in wanted.items():
        if recipe.get(name) != value:
            allowed = f"expected a data set whose {name} is {value!r}"
            raise refuse(InvalidRequest, f"demos.{name}", recipe.get(name), allowed)
    if dataset.total_episodes == 0:
        raise refuse(InvalidRequest, "demos", 0, "expected a data set with episodes")
