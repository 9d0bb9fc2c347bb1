"""Demonstrations as a replay buffer, from a Minari data set."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from minari import MinariDataset
from stable_baselines3 import HerReplayBuffer

import trocar
from trocar.demos import dataset_path, record
from trocar.errors import InvalidRequest, refuse
from trocar.rl.config import Config
from trocar.sb3 import TrocarVecEnv

SEED = 3_000_000
"""Of the first demonstration: far from the seeds of training and evaluation."""


def path_for(config: Config, folder: Path) -> Path:
    """Where the demonstrations of a configuration lie in ``folder``, one place for each options."""
    return dataset_path(folder, config.task, _name(config))


def made(
    config: Config,
    folder: Path,
    server: str | None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """The demonstrations of a configuration in ``folder``, which are recorded if need be."""
    recording = record(
        config.task,
        episodes=config.demos,
        out=folder,
        name=_name(config),
        seed=SEED,
        resume=True,
        server=server,
        progress=progress,
        **config.task_options,
    )
    return Path(recording.path)


def _name(config: Config) -> str:
    options = [f"{key}-{value}" for key, value in sorted(config.task_options.items())]
    words = "_".join(["expert", str(config.demos), *options])
    return (
        "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in words) + "-v0"
    )


def opened(path: Path, config: Config) -> MinariDataset:
    """The data set in a folder, for a configuration.

    Raises:
        ValueError: There is none, or it is of another task, options or version.
    """
    if not (path / "data").is_dir():
        raise refuse(InvalidRequest, "demos", str(path), "expected the folder of a Minari data set")
    dataset = MinariDataset(path / "data")
    check(dataset, config)
    return dataset


def buffer(dataset: MinariDataset, config: Config, envs: TrocarVecEnv) -> HerReplayBuffer:
    """A data set as a replay buffer that gives hindsight goals as that of experience does.

    Args:
        dataset: The data set.
        config: What is trained.
        envs: Environments of the task.
    """
    space = envs.observation_space
    assert isinstance(space, spaces.Dict)
    demos = HerReplayBuffer(
        int(dataset.total_steps),
        space,
        envs.action_space,
        envs,
        device="cpu",
        n_envs=1,
        n_sampled_goal=config.goals,
        goal_selection_strategy="future",
    )
    for episode in dataset.iterate_episodes():
        seen: dict[str, Any] = episode.observations
        last = len(episode.rewards) - 1
        for step, action in enumerate(episode.actions):
            timeout = bool(episode.truncations[step] and not episode.terminations[step])
            demos.add(
                {key: rows[step][None] for key, rows in seen.items()},
                {key: rows[step + 1][None] for key, rows in seen.items()},
                np.asarray(action, np.float32)[None],
                np.asarray(episode.rewards[step], np.float32)[None],
                np.array([step == last]),
                [{"TimeLimit.truncated": timeout}],
            )
    return demos


def check(dataset: MinariDataset, config: Config) -> None:
    """An error unless the data set is of this task, under these options, and of this version."""
    recipe = json.loads(dataset.storage.metadata.get("trocar", "{}"))
    wanted = {
        "task": config.task,
        "options": json.loads(json.dumps(config.task_options)),
        "version": trocar.__version__,
    }
    for name, value in wanted.items():
        if recipe.get(name) != value:
            allowed = f"expected a data set whose {name} is {value!r}"
            raise refuse(InvalidRequest, f"demos.{name}", recipe.get(name), allowed)
    if dataset.total_episodes == 0:
        raise refuse(InvalidRequest, "demos", 0, "expected a data set with episodes")
